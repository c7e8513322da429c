"""Whether proofs hold: points at which the truth is outside of its bounds, of which there must be none.

Leaf by leaf bounds of cones, planes and continuous leaves, at points half of which are uniform and half beside walls,
corners and borders of cells (:mod:`experiments.proving._hard_points`). Batches take turns: points in double
precision, which a query rounds; points in single precision; points in double precision with JAX computing in it. The
truth is that of the exact oracle, at the very points that are asked about; on the two mazes also that of code that
shares nothing with the package. What the oracle itself rounds, 1e-15 of the largest distance, does not count. Points
are free as the workspace has it, to its tolerance: broken bounds of points that are in an obstacle by less than that
are counted apart, since answers of the oracle mean little there.
"""

import itertools
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from experiments._tables import aligned
from experiments.baselines._brute_distance import MAZE, THIN_MAZE, BruteDistance
from experiments.benchmarks._maps import load_map
from experiments.proving._hard_points import mixed_points
from experiments.proving._sizes import LEAVES
from experiments.proving._slivers import random_workspace
from plr_jax import PLR, DistanceFn, VisibilityGraph, Workspace, construct

BUDGETS = {"maze": 1_024, "thin_maze": 1_024, "arena": 4_096, "den312d": 4_096, "floor_plan": 4_096}
POINTS, SLIVER_POINTS, SLIVER_MAPS = 10_000_000, 100_000, 200
_SMOKE_POINTS, _SMOKE_SLIVER_POINTS, _SMOKE_MAPS = 100_000, 5_000, 3
_BATCH = 250_000
_SLIVER_BUDGET = 600
_ROUNDING = 1e-15
_KEPT = 3  # examples of violations, a row
_WALLS = {"maze": MAZE, "thin_maze": THIN_MAZE}
_NONE = {"violations": 0, "in_obstacles": 0, "worst": 0.0}
QUERIES = ("double, rounded", "single", "double")

Points = Float[np.ndarray, "n 2"]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
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
        counts = violations(workspace, plrs, truths, _SMOKE_POINTS if smoke else POINTS, rng)
        rows += [{"map": name, **row} for row in counts]
        print(f"{name}: {[row['violations'] for row in counts]}", flush=True)
    return {"rows": rows, "slivers": _slivers(seed, smoke)}


def certified(oracle: Any, workspace: Workspace, budget: int, seed: int) -> dict[str, PLR]:
    """PLRs with bounds of every leaf."""
    options = {"max_bytes": budget, "certified": True, "leaf_bounds": True, "seed": seed}
    return {leaf: construct(oracle, workspace.bounds, leaf=leaf, **options) for leaf in LEAVES}


def violations(
    workspace: Workspace,
    plrs: dict[str, PLR],
    truths: dict[str, DistanceFn],
    num_points: int,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Of each PLR and each truth, how many points reach the goal and how many of these break a bound."""
    rows: dict[tuple[str, str], dict[str, Any]] = {
        pair: {"leaf": pair[0], "truth": pair[1], "points": 0, **_NONE, "examples": []}
        for pair in itertools.product(plrs, truths)
    }
    asked, query = 0, itertools.cycle(QUERIES)
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
                _count(rows[leaf, name], workspace, x, distance, lower, upper, how)
    return list(rows.values())


def _bounds(plr: PLR, x: Points, how: str) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    with jax.enable_x64(how == "double"):
        lower, upper = plr.bounds(x.astype(np.float32) if how == "single" else x)
        return np.asarray(lower, float), np.asarray(upper, float)


def _count(
    row: dict[str, Any],
    workspace: Workspace,
    x: Points,
    distance: Float[np.ndarray, "n"],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    how: str,
) -> None:
    """Add to a row what these points show; those outside of the domain by rounding get no bounds."""
    reached = np.isfinite(distance) & np.isfinite(upper)
    rounding = _ROUNDING * distance[reached].max(initial=0.0)
    beyond = np.maximum(lower[reached] - distance[reached], distance[reached] - upper[reached])
    broken = np.flatnonzero(beyond > rounding)
    clearance = workspace.clearance(x[reached][broken])
    row["points"] += int(reached.sum())
    row["violations"] += int((clearance >= 0).sum())
    row["in_obstacles"] += int((clearance < 0).sum())
    row["worst"] = max(row["worst"], float(beyond[broken][clearance >= 0].max(initial=0.0)))
    order = np.lexsort((-beyond[broken], clearance < 0))[: _KEPT - len(row["examples"])]
    for at, room in zip(broken[order], clearance[order], strict=True):
        point = {"x": x[reached][at].tolist(), "clearance": float(room), "query": how}
        point["distance"] = float(distance[reached][at])
        row["examples"].append(point | {"bounds": [float(lower[reached][at]), float(upper[reached][at])]})


def _slivers(seed: int, smoke: bool) -> dict[str, Any]:
    """The same on random maps, whose number gives them back: the seed of each is ``[seed, number]``."""
    num_maps, points = (_SMOKE_MAPS, _SMOKE_SLIVER_POINTS) if smoke else (SLIVER_MAPS, SLIVER_POINTS)
    totals: dict[str, dict[str, Any]] = {leaf: {"maps": 0, "points": 0, **_NONE} for leaf in LEAVES}
    options = {"max_bytes": _SLIVER_BUDGET, "certified": True, "leaf_bounds": True}
    examples, refused = [], []
    for number in tqdm(range(num_maps), desc="slivers", disable=None):
        jax.clear_caches()  # PLRs of other maps have tables of other shapes: hundreds of compiled queries otherwise
        rng = np.random.default_rng([seed, number])
        workspace, goal = random_workspace(rng)
        oracle, plrs = VisibilityGraph(workspace, goal), {}
        for leaf in LEAVES:
            try:
                plrs[leaf] = construct(oracle, workspace.bounds, leaf=leaf, **options)
            except Exception as error:  # whatever goes wrong on a random map is a result
                refused.append({"map": number, "leaf": leaf, "error": f"{type(error).__name__}: {error}"})
        for row in violations(workspace, plrs, {"oracle": oracle}, points, rng) if plrs else []:
            total = totals[row["leaf"]]
            total["maps"] += 1
            for name in ("points", "violations", "in_obstacles"):
                total[name] += row[name]
            total["worst"] = max(total["worst"], row["worst"] / float(workspace.bounds.width.max()))
            if row["violations"] + row["in_obstacles"]:
                examples.append({"map": number, **row})
    return {"num_maps": num_maps, "totals": totals, "examples": examples, "refused": refused}


def table(results: dict[str, Any]) -> str:
    rows = [["map", "leaf", "truth", "points", "violations", "worst", "in obstacles"]]
    for row in results["rows"]:
        counts = [f"{row['points']:,}", f"{row['violations']:,}", f"{row['worst']:.2g}", f"{row['in_obstacles']:,}"]
        rows.append([row["map"], row["leaf"], row["truth"], *counts])
    slivers = results["slivers"]
    for leaf, total in slivers["totals"].items():
        counts = [f"{total['points']:,}", f"{total['violations']:,}", f"{total['worst']:.2g} of the width"]
        rows.append([f"{total['maps']} with slivers", leaf, "oracle", *counts, f"{total['in_obstacles']:,}"])
    refused = [f"not built: map {each['map']}, {each['leaf']}: {each['error']}" for each in slivers["refused"]]
    return "\n".join([aligned(rows, numbers=4).rstrip(), *refused]) + "\n"


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """No figure."""
    return []
