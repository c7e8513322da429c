"""Nodes of best-first search for two turning rectangles, under cost-to-go that knows turns and under less.

The tangle as published, and variants whose starts alone are moved, so that heuristics are built once. ``SE(2)`` is
the sum of what ``solve_eikonal`` says of each rectangle's positions and headings; ``centers`` the sum of the exact
distances of the rectangles' centers, as if they were discs of the inscribed radius; ``straight line`` knows no wall.
Another variant is planned before, so that all is compiled and the map is known.
"""

import time
from collections.abc import Callable
from typing import Any

from experiments._planning import is_valid, plan
from plr_jax import (
    BLOptions,
    HeuristicFn,
    Problem,
    RigidBodySpace,
    robot_distance_fns,
    scenes,
    solve_eikonal,
    straight_line,
    sum_of_distances,
)

MAX_LEAVES, _SMOKE_LEAVES = 50_000, 2_000
NUM_STARTS = 10
TIME_LIMIT = 60.0


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    published = scenes.tangle()
    problems = [published, *(_moved(published, seed + k) for k in range(1, 1 if smoke else NUM_STARTS))]
    max_leaves = _SMOKE_LEAVES if smoke else MAX_LEAVES
    heuristics: dict[str, Callable[[], HeuristicFn]] = {
        "straight line": lambda: straight_line(published),
        "centers": lambda: sum_of_distances(robot_distance_fns(published)),
        "SE(2)": lambda: turning(published, max_leaves, seed),
    }
    rows, options = [], BLOptions(searchers=("bl",), time_limit=TIME_LIMIT)
    for name, make in heuristics.items():
        began = time.perf_counter()
        heuristic = make()
        built = time.perf_counter() - began
        row: dict[str, Any] = {
            "heuristic": name,
            "built": built,
            "at_start": float(heuristic(published.starts[None])[0]),
        }
        plan(_moved(published, seed), heuristic, options)
        runs = [(problem, *plan(problem, heuristic, options)) for problem in problems]
        row["nodes"] = [solution.stats.num_nodes for _, solution, _ in runs]
        row["seconds"] = [seconds for *_, seconds in runs]
        row["cost"] = [solution.cost if solution.solved else None for _, solution, _ in runs]
        row["valid"] = [is_valid(problem, solution) for problem, solution, _ in runs]
        rows.append(row)
    return {"max_leaves": max_leaves, "starts": len(problems), "rows": rows}


def turning(problem: Problem, max_leaves: int, seed: int) -> HeuristicFn:
    """Cost-to-go of each rectangle, alone, turns included."""
    plrs = [
        solve_eikonal(
            RigidBodySpace(problem.workspace, robot, problem.rotation_weight), goal, max_leaves=max_leaves, seed=seed
        )
        for robot, goal in zip(problem.robots, problem.goals, strict=True)
    ]
    return sum_of_distances(plrs)


def _moved(problem: Problem, seed: int) -> Problem:
    """The problem from other starts."""
    other = scenes.perturbed(problem, seed=seed)
    return Problem(problem.workspace, problem.robots, other.starts, problem.goals, problem.rotation_weight)
