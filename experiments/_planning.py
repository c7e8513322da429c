"""What the experiments on planning share: the scenes of Table II, the heuristics, a plan that has been checked."""

import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
from jaxtyping import Float

from plr_jax import (
    BLOptions,
    HeuristicFn,
    Problem,
    Solution,
    bl_plan,
    construct,
    robot_distance_fns,
    scenes,
    straight_line,
    sum_of_distances,
    validate,
    zero,
)
from plr_jax.planners.driver import Run

PLR_BYTES, SMOKE_BYTES = 4_096, 512

SCENES: dict[str, Callable[[], Problem]] = {
    "single door": scenes.single_door,
    "four rooms 2": lambda: scenes.four_rooms(2),
    "four rooms 3": lambda: scenes.four_rooms(3),
    "four rooms 4": lambda: scenes.four_rooms(4),
    "four rooms 8": lambda: scenes.four_rooms(8),
    "cross 2": lambda: scenes.cross(2),
    "cross 3": lambda: scenes.cross(3),
    "tangle": scenes.tangle,
}

NONE, STRAIGHT, POINT_PLR, PLR, EXACT = HEURISTICS = ("none", "straight line", "PLR, point robots", "PLR", "exact")
BL_ALONE = ("bl",)  # the paper's search: no LaCAM, and no robots one after the other


def build(problem: Problem, name: str, plr_bytes: int = PLR_BYTES) -> HeuristicFn:
    """A heuristic of :data:`HEURISTICS` for a problem, its PLRs of so many bytes each."""
    if name == NONE:
        return zero()
    if name == STRAIGHT:
        return straight_line(problem)
    oracles = robot_distance_fns(problem, inflated=name != POINT_PLR)
    if name == EXACT:
        return sum_of_distances(oracles)
    return sum_of_distances([construct(oracle, problem.workspace.bounds, max_bytes=plr_bytes) for oracle in oracles])


def plan(problem: Problem, heuristic: HeuristicFn | None, options: BLOptions) -> tuple[Solution, float]:
    """A solution of BL, and its seconds from call to return."""
    began = time.perf_counter()
    solution = bl_plan(problem, heuristic, options)
    return solution, time.perf_counter() - began


def is_valid(problem: Problem, solution: Solution) -> bool | None:
    """Whether a solution's path is valid; None if it has none."""
    return None if solution.path is None else validate(problem, solution.path).valid


def reversed_team(problem: Problem) -> Problem:
    """The team on its way back: the map is the same, starts and goals are not."""
    return Problem(problem.workspace, problem.robots, problem.goals, problem.starts)


def plan_and_check(
    problem: Problem, heuristic: HeuristicFn | None, options: BLOptions
) -> tuple[Solution, float, bool | None]:
    """A plan, and whether its first path and its last one are valid; None if there is none."""
    first: list[Float[np.ndarray, "steps robots dof"]] = []
    record = Run.record

    def kept(self: Run, path: Float[np.ndarray, "steps robots dof"], found_by: str, factor: float) -> None:
        if not first:
            first.append(path)
        record(self, path, found_by, factor)

    with mock.patch.object(Run, "record", kept):
        solution, seconds = plan(problem, heuristic, options)
    checks = [validate(problem, path).valid for path in first] + [is_valid(problem, solution)]
    return solution, seconds, None if solution.path is None else all(checks)


def solve(
    problem: Problem, heuristic: str, plr_bytes: int = PLR_BYTES
) -> tuple[Solution, Float[np.ndarray, "steps robots dof"]]:
    """The first path of BL alone under a heuristic, to nine decimals, and how it was found.

    A path that is missing, or not valid when rounded, is an error, and ends the experiment.
    """
    solution, _ = plan(problem, build(problem, heuristic, plr_bytes), BLOptions(searchers=BL_ALONE))
    if solution.path is None:
        raise RuntimeError(f"The scene was not solved: {solution.status}.")
    path = np.round(solution.path, 9)
    report = validate(problem, path)
    if not report.valid:
        raise RuntimeError(f"The path is not valid: {report.message}")
    return solution, path


def solved_scene(name: str, plr_bytes: int = PLR_BYTES) -> dict[str, Any]:
    """A scene as published, solved under PLRs, for JSON."""
    solution, path = solve(SCENES[name](), PLR, plr_bytes)
    return {"cost": solution.cost, "makespan": solution.makespan, "path": path.tolist()}
