"""Points at which proofs are put to the test: uniform ones, and ones beside walls, corners and borders of cells."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import shapely
from jaxtyping import Float, Int
from tqdm import tqdm

from experiments.baselines._brute_distance import MAZE, THIN_MAZE, BruteDistance
from experiments.benchmarks._maps import load_map
from experiments.proving._sizes import LEAVES
from plr_jax import PLR, DistanceFn, VisibilityGraph, Workspace, construct

_NEAREST, _FARTHEST = -12.0, -2.0  # offsets as powers of ten, of the domain's width

Points = Float[np.ndarray, "n 2"]


def mixed_points(workspace: Workspace, plrs: Sequence[PLR], count: int, rng: np.random.Generator) -> Points:
    """Free points, so many: half uniform, a sixth each beside walls, corners and borders of cells.

    Offsets are log-uniform from 1e-12 to 1e-2 of the domain's width: across walls and borders to either side, from
    corners anywhere. One in ten is none at all.
    """
    uniform = workspace.sample_free(count // 2, int(rng.integers(2**31)))
    beside = (
        lambda: _beside_walls(workspace, count // 6, rng),
        lambda: _beside_corners(workspace, count // 6, rng),
        lambda: _beside_cells(workspace, plrs, count // 6, rng),
    )
    return np.concatenate([uniform, *(_free(draw, count // 6, workspace) for draw in beside)])


def _free(draw: Callable[[], Points], count: int, workspace: Workspace) -> Points:
    """The first free ones of many points that are drawn again and again."""
    found = np.empty((0, 2))
    while len(found) < count:
        points = draw()
        found = np.concatenate([found, points[workspace.is_free(points)]])
    return found[:count]


def _offsets(workspace: Workspace, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 1"]:
    size = 10.0 ** rng.uniform(_NEAREST, _FARTHEST, (count, 1)) * workspace.bounds.width.max()
    return size * rng.choice([-1.0, 1.0], (count, 1)) * (rng.random((count, 1)) >= 0.1)


def _beside_walls(workspace: Workspace, count: int, rng: np.random.Generator) -> Points:
    edge = rng.integers(len(workspace.boundary.segments), size=count)
    start, end = workspace.boundary.segments[edge].transpose(1, 0, 2)
    along = start + rng.random((count, 1)) * (end - start)
    return along + _offsets(workspace, count, rng) * workspace.boundary.normal[edge]


def _beside_corners(workspace: Workspace, count: int, rng: np.random.Generator) -> Points:
    vertex = rng.integers(len(workspace.boundary.vertices), size=count)
    angle = rng.uniform(0, 2 * np.pi, count)
    toward = np.column_stack([np.cos(angle), np.sin(angle)])
    return workspace.boundary.vertices[vertex] + _offsets(workspace, count, rng) * toward


def _beside_cells(workspace: Workspace, plrs: Sequence[PLR], count: int, rng: np.random.Generator) -> Points:
    boxes = [np.concatenate(plr.leaf_boxes, axis=1) for plr in plrs]
    boxes = np.concatenate(boxes)[_evenly([len(each) for each in boxes], count, rng)]
    place = rng.random((count, 2))
    at_border = rng.integers(3, size=count)  # across x, across y, at a corner
    for axis in range(2):
        on = at_border != axis
        place[on, axis] = rng.integers(2, size=on.sum())
    points = boxes[:, :2] + place * (boxes[:, 2:] - boxes[:, :2])
    return points + _offsets(workspace, count, rng) * rng.choice([-1.0, 0.0, 1.0], (count, 2))


def _evenly(sizes: list[int], count: int, rng: np.random.Generator) -> Int[np.ndarray, " count"]:
    """Random indices into lists one after the other, of each list equally many."""
    which = rng.integers(len(sizes), size=count)
    return np.cumsum([0, *sizes])[which] + (rng.random(count) * np.array(sizes)[which]).astype(int)


# Whether proofs hold: points at which the truth is outside of its bounds, of which there must be none.
#
# Leaf by leaf bounds of cones, planes and continuous leaves, at points half of which are uniform and half beside
# walls, corners and borders of cells. Batches take turns: points in double
# precision, which a query rounds; points in single precision; points in double precision with JAX computing in it.
# The truth is that of the exact oracle, at the very points that are asked about; on the two mazes also that of code
# that shares nothing with the package. What the oracle itself rounds, 1e-15 of the largest distance, does not count.
#
# The oracle answers to the workspace's tolerance: at points, too, that are in an obstacle by less than that, or in a
# part of free space that only touches the goal's part in a point less than that away. No path leads from there to the
# goal, so nothing is proven of them; where they are beyond the bounds, they are counted apart, by exact predicates.

BUDGETS = {"maze": 1_024, "thin_maze": 1_024, "arena": 4_096, "den312d": 4_096, "floor_plan": 4_096}
POINTS, _SMOKE_POINTS = 10_000_000, 100_000
_BATCH = 250_000
_ROUNDING = 1e-15
_KEPT = 3  # examples of violations, a row
_WALLS = {"maze": MAZE, "thin_maze": THIN_MAZE}
NO_VIOLATIONS = {"violations": 0, "by_tolerance": 0, "worst": 0.0}
QUERIES = ("double, rounded", "single", "double")


def bounds(seed: int, smoke: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    rows = []
    for name in ["maze"] if smoke else BUDGETS:
        if (found := load_map(name)) is None:
            continue
        workspace, goal = found
        truths: dict[str, DistanceFn] = {"oracle": VisibilityGraph(workspace, goal)}
        if name in _WALLS:
            truths["brute force"] = BruteDistance(_WALLS[name], goal)
        plrs = certified(truths["oracle"], workspace, BUDGETS[name], seed)
        counts = violations(workspace, goal, plrs, truths, _SMOKE_POINTS if smoke else POINTS, rng)
        rows += [{"map": name, **row} for row in counts]
        print(f"{name}: {[row['violations'] for row in counts]}", flush=True)
    return {"rows": rows}


def certified(oracle: Any, workspace: Workspace, budget: int, seed: int) -> dict[str, PLR]:
    """PLRs with bounds of every leaf."""
    options = {"max_bytes": budget, "certified": "leaves", "seed": seed}
    return {leaf: construct(oracle, workspace.bounds, leaf=leaf, **options) for leaf in LEAVES}


def violations(
    workspace: Workspace,
    goal: Float[np.ndarray, "2"],
    plrs: dict[str, PLR],
    truths: dict[str, DistanceFn],
    num_points: int,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Of each PLR and each truth, how many points reach the goal and how many of these break a bound."""
    rows: dict[tuple[str, str], dict[str, Any]] = {
        pair: {"leaf": pair[0], "truth": pair[1], "points": 0, **NO_VIOLATIONS, "examples": []}
        for pair in itertools.product(plrs, truths)
    }
    asked, query, part = 0, itertools.cycle(QUERIES), part_of_goal(workspace, goal)
    while asked < num_points:
        how = next(query)
        x = mixed_points(workspace, list(plrs.values()), min(_BATCH, num_points), rng)
        if how == "single":
            x = x.astype(np.float32).astype(float)
            x = x[workspace.is_free(x)]
        asked += len(x)
        distances = {name: truth(x) for name, truth in truths.items()}
        for leaf, plr in plrs.items():
            lower, upper = _bounds(plr, x, how)
            for name, distance in distances.items():
                inside = plr.domain.contains(x) & np.isfinite(distance)
                answers = distance[inside], lower[inside], upper[inside]
                _count(rows[leaf, name], part, x[inside], *answers, how)
    return list(rows.values())


def part_of_goal(workspace: Workspace, goal: Float[np.ndarray, "2"]) -> shapely.Geometry:
    """The part of free space from which paths lead to the goal; all that touch it where they may squeeze through."""
    if workspace.squeeze:
        return workspace.free_space
    parts = shapely.get_parts(workspace.free_space)
    return shapely.union_all(parts[shapely.distance(parts, shapely.points(goal)) <= workspace.tolerance])


def _bounds(plr: PLR, x: Points, how: str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    with jax.enable_x64(how == "double"):
        lower, upper = plr.bounds(x.astype(np.float32) if how == "single" else x)
        return np.asarray(lower, float), np.asarray(upper, float)


def _count(
    row: dict[str, Any],
    part: shapely.Geometry,
    x: Points,
    distance: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    how: str,
) -> None:
    """Add to a row what points of the domain show that reach the goal: there a bound that is no number is broken."""
    rounding = _ROUNDING * distance.max(initial=0.0)
    holds = (lower - rounding <= distance) & (distance <= upper + rounding) & np.isfinite(upper)
    broken = np.flatnonzero(~holds)
    beyond = np.maximum(lower - distance, distance - upper)[broken]
    exactly = np.asarray(shapely.covers(part, shapely.points(x[broken])))
    row["points"] += len(x)
    row["violations"] += int(exactly.sum())
    row["by_tolerance"] += int((~exactly).sum())
    row["worst"] = max(row["worst"], float(np.nan_to_num(beyond[exactly]).max(initial=0.0)))
    order = np.lexsort((-beyond, ~exactly))[: _KEPT - len(row["examples"])]
    for at, is_exact in zip(broken[order], exactly[order], strict=True):
        point = {"x": x[at].tolist(), "violation": bool(is_exact), "query": how}
        point["distance"] = float(distance[at])
        row["examples"].append(point | {"bounds": np.nan_to_num([lower[at], upper[at]]).tolist()})


# Whether proofs hold on random maps with what they stumble over: slivers, thin gaps, notches, walls that touch.
#
# As in :mod:`experiments.proving._bounds`, with the oracle as truth. A map's number gives it back: its seed is
# ``[seed, number]``.

MAPS, SLIVER_POINTS, BUDGET = 200, 100_000, 600

_WIDTHS = -6.0, -3.0  # of gaps, notches and thin walls, as powers of ten of the map's width
_SCALES = (1.0, 40.0, 1_000.0)

Ring = Float[np.ndarray, "n 2"]


def slivers(seed: int, smoke: bool) -> dict[str, Any]:
    num_maps, points = (2, 5_000) if smoke else (MAPS, SLIVER_POINTS)
    totals: dict[str, dict[str, Any]] = {leaf: {"maps": 0, "points": 0, **NO_VIOLATIONS} for leaf in LEAVES}
    options = {"max_bytes": BUDGET, "certified": "leaves"}
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
