"""Whether proofs hold on random maps with what they stumble over: slivers, thin gaps, notches, walls that touch.

As in :mod:`experiments.proving._bounds`, with the oracle as truth. A map's number gives it back: its seed is
``[seed, number]``.
"""

from typing import Any

import jax
import numpy as np
import shapely
from jaxtyping import Float
from tqdm import tqdm

from experiments._tables import aligned
from experiments.proving._bounds import NO_VIOLATIONS, violations
from experiments.proving._sizes import LEAVES
from plr_jax import VisibilityGraph, Workspace, construct

MAPS, POINTS, BUDGET = 200, 100_000, 600

_WIDTHS = -6.0, -3.0  # of gaps, notches and thin walls, as powers of ten of the map's width
_SCALES = (1.0, 40.0, 1_000.0)

Ring = Float[np.ndarray, "n 2"]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_maps, points = (2, 5_000) if smoke else (MAPS, POINTS)
    totals: dict[str, dict[str, Any]] = {leaf: {"maps": 0, "points": 0, **NO_VIOLATIONS} for leaf in LEAVES}
    options = {"max_bytes": BUDGET, "certified": True, "leaf_bounds": True}
    examples, refused = [], []
    for number in tqdm(range(num_maps), desc="slivers", disable=None):
        if not smoke:  # PLRs of other maps have tables of other shapes: hundreds of compiled queries otherwise
            jax.clear_caches()
        rng = np.random.default_rng([seed, number])
        workspace, goal = random_workspace(rng)
        oracle, plrs = VisibilityGraph(workspace, goal), {}
        for leaf in LEAVES:
            try:
                plrs[leaf] = construct(oracle, workspace.bounds, leaf=leaf, **options)
            except Exception as error:  # whatever goes wrong on a random map is a result
                refused.append({"map": number, "leaf": leaf, "error": f"{type(error).__name__}: {error}"})
        for row in violations(workspace, goal, plrs, {"oracle": oracle}, points, rng) if plrs else []:
            total = totals[row["leaf"]]
            total["maps"] += 1
            for name in ("points", "violations", "by_tolerance"):
                total[name] += row[name]
            total["worst"] = max(total["worst"], row["worst"] / float(workspace.bounds.width.max()))
            if row["violations"] + row["by_tolerance"]:
                examples.append({"map": number, **row})
    return {"num_maps": num_maps, "totals": totals, "examples": examples, "refused": refused}


def random_workspace(rng: np.random.Generator) -> tuple[Workspace, Float[np.ndarray, "2"]]:
    """A map of random scale and place with 4 to 10 features, and a free goal, in a quarter of them a corner."""
    scale, origin = rng.choice(_SCALES), rng.choice([0.0, 0.0, -0.37, 3.0]) * np.ones(2)
    rings = [ring for _ in range(rng.integers(4, 11)) for ring in rng.choice(_FEATURES)(rng)]
    rings = [scale * (origin + ring) for ring in rings if shapely.Polygon(ring).is_valid]
    bounds = tuple(scale * origin), tuple(scale * (origin + 1))
    workspace = Workspace(bounds, rings, squeeze=bool(rng.random() < 0.25))
    goal = workspace.sample_free(1, int(rng.integers(2**31)))[0]
    if rng.random() < 0.25:
        goal = workspace.boundary.vertices[rng.integers(len(workspace.boundary.vertices))]
    return workspace, goal


def _thin(rng: np.random.Generator) -> float:
    return float(10.0 ** rng.uniform(*_WIDTHS))


def _box(x0: float, y0: float, x1: float, y1: float) -> Ring:
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def _turned(ring: Ring, rng: np.random.Generator) -> Ring:
    """As it is, mirrored at the diagonal, or turned by any angle."""
    kind = rng.integers(3)
    if kind == 0:
        return ring
    if kind == 1:
        return ring[::-1, ::-1].copy()
    angle, center = rng.uniform(0, 2 * np.pi), ring.mean(axis=0)
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    return center + (ring - center) @ turn.T


def _star(rng: np.random.Generator) -> list[Ring]:
    """A polygon of 3 to 8 vertices, not convex in general, which may overlap others."""
    count = int(rng.integers(3, 9))
    angle = np.sort(rng.uniform(0, 2 * np.pi, count)) + 1e-3 * np.arange(count)
    radius = rng.uniform(0.03, 0.2, (count, 1))
    return [rng.random(2) + radius * np.column_stack([np.cos(angle), np.sin(angle)])]


def _gap(rng: np.random.Generator) -> list[Ring]:
    """Two boxes with a thin gap between them, turned together."""
    (x, y), (width, height), gap = rng.uniform(0, 0.8, 2), rng.uniform(0.05, 0.25, 2), _thin(rng)
    pair = np.concatenate([_box(x, y, x + width, y + height), _box(x + width + gap, y, x + 2 * width, y + height)])
    pair = _turned(pair, rng)
    return [pair[:4], pair[4:]]


def _notch(rng: np.random.Generator) -> list[Ring]:
    """A box with a thin notch in its upper side."""
    (x, y), (width, height), notch = rng.uniform(0, 0.8, 2), rng.uniform(0.05, 0.3, 2), _thin(rng)
    at, floor = x + rng.uniform(0.1, 0.8) * width, y + rng.uniform(0.1, 0.9) * height
    top = [(x + width, y + height), (at + notch, y + height), (at + notch, floor), (at, floor), (at, y + height)]
    return [_turned(np.array([(x, y), (x + width, y), *top, (x, y + height)]), rng)]


def _needle(rng: np.random.Generator) -> list[Ring]:
    """A thin wall."""
    (x, y), length = rng.uniform(0, 0.9, 2), rng.uniform(0.1, 0.7)
    return [_turned(_box(x, y, x + length, y + _thin(rng)), rng)]


def _contact(rng: np.random.Generator) -> list[Ring]:
    """Two boxes that share a vertex, or a triangle that touches a side of a box with its tip."""
    (x, y), (width, height) = rng.uniform(0.1, 0.8, 2), rng.uniform(0.05, 0.25, 2)
    box = _box(x, y, x + width, y + height)
    if rng.random() < 0.5:
        return [box, _box(x + width, y + height, x + 1.5 * width, y + 1.7 * height)]
    tip = (x + rng.uniform(0.1, 0.9) * width, y + height)
    return [box, np.array([tip, (tip[0] + 0.05, tip[1] + 0.1), (tip[0] - 0.03, tip[1] + 0.1)])]


def _wedge(rng: np.random.Generator) -> list[Ring]:
    """Two triangles whose sides nearly meet: free space between them thins out to a needle's width."""
    (x, y), length, gap = rng.uniform(0.1, 0.7, 2), rng.uniform(0.1, 0.3), _thin(rng)
    lower = np.array([(x, y), (x + length, y), (x, y + 0.1)])
    upper = np.array([(x + length, y + gap), (x + length, y + 0.1), (x, y + 0.1 + gap)])
    pair = _turned(np.concatenate([lower, upper]), rng)
    return [pair[:3], pair[3:]]


_FEATURES = np.array([_star, _gap, _notch, _needle, _contact, _wedge], dtype=object)


def table(results: dict[str, Any]) -> str:
    rows = [["leaf", "maps", "points", "violations", "worst, of the width", "by tolerance"]]
    for leaf, total in results["totals"].items():
        counts = [f"{total['maps']}", f"{total['points']:,}", f"{total['violations']:,}", f"{total['worst']:.2g}"]
        rows.append([leaf, *counts, f"{total['by_tolerance']:,}"])
    refused = [f"not built: map {each['map']}, {each['leaf']}: {each['error']}" for each in results["refused"]]
    return "\n".join([aligned(rows, numbers=5).rstrip(), *refused]) + "\n"
