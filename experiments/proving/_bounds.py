"""Whether proofs hold: points at which the truth is outside of its bounds, of which there must be none.

Leaf by leaf bounds of cones, planes and continuous leaves, at points half of which are uniform and half beside walls,
corners and borders of cells (:mod:`experiments.proving._hard_points`). Batches take turns: points in double
precision, which a query rounds; points in single precision; points in double precision with JAX computing in it. The
truth is that of the exact oracle, at the very points that are asked about; on the two mazes also that of code that
shares nothing with the package. What the oracle itself rounds, 1e-15 of the largest distance, does not count.

The oracle answers to the workspace's tolerance: at points, too, that are in an obstacle by less than that, or in a
part of free space that only touches the goal's part in a point less than that away. No path leads from there to the
goal, so nothing is proven of them; where they are beyond the bounds, they are counted apart, by exact predicates.
"""

import itertools
from typing import Any

import jax
import numpy as np
import shapely
from jaxtyping import Float

from experiments._tables import aligned
from experiments.baselines._brute_distance import MAZE, THIN_MAZE, BruteDistance
from experiments.benchmarks._maps import load_map
from experiments.proving._hard_points import mixed_points
from experiments.proving._sizes import LEAVES
from plr_jax import PLR, DistanceFn, VisibilityGraph, Workspace, construct

BUDGETS = {"maze": 1_024, "thin_maze": 1_024, "arena": 4_096, "den312d": 4_096, "floor_plan": 4_096}
POINTS, _SMOKE_POINTS = 10_000_000, 100_000
_BATCH = 250_000
_ROUNDING = 1e-15
_KEPT = 3  # examples of violations, a row
_WALLS = {"maze": MAZE, "thin_maze": THIN_MAZE}
NO_VIOLATIONS = {"violations": 0, "by_tolerance": 0, "worst": 0.0}
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
        counts = violations(workspace, goal, plrs, truths, _SMOKE_POINTS if smoke else POINTS, rng)
        rows += [{"map": name, **row} for row in counts]
        print(f"{name}: {[row['violations'] for row in counts]}", flush=True)
    return {"rows": rows}


def certified(oracle: Any, workspace: Workspace, budget: int, seed: int) -> dict[str, PLR]:
    """PLRs with bounds of every leaf."""
    options = {"max_bytes": budget, "certified": True, "leaf_bounds": True, "seed": seed}
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


def _bounds(plr: PLR, x: Points, how: str) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    with jax.enable_x64(how == "double"):
        lower, upper = plr.bounds(x.astype(np.float32) if how == "single" else x)
        return np.asarray(lower, float), np.asarray(upper, float)


def _count(
    row: dict[str, Any],
    part: shapely.Geometry,
    x: Points,
    distance: Float[np.ndarray, "n"],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
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


def table(results: dict[str, Any]) -> str:
    rows = [["map", "leaf", "truth", "points", "violations", "worst", "by tolerance"]]
    for row in results["rows"]:
        counts = [f"{row['points']:,}", f"{row['violations']:,}", f"{row['worst']:.2g}", f"{row['by_tolerance']:,}"]
        rows.append([row["map"], row["leaf"], row["truth"], *counts])
    return aligned(rows, numbers=4)
