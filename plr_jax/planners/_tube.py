"""Bend a path robot by robot: the cheapest motions within a narrow tube about one robot's, the others keeping theirs.

At each row, a robot may stand where it stands or a little off, on a small pattern of configurations. The cheapest
sequence that collides with nothing is found by dynamic programming over the rows. Where the tubes stop gaining, they
are made narrower.
"""

import time

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._collision import motions_apart
from plr_jax._obstacles import MotionTest
from plr_jax._problem import Problem, path_cost
from plr_jax._robot import RectangleRobot
from plr_jax.planners._shorten import robot_costs

_GAIN = 1e-3  # share of the cost below which the tubes are narrowed
_NARROWINGS = 4
_EIGHT = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)], dtype=np.float64)


def bend(
    problem: Problem,
    path: Float[np.ndarray, "steps robots dof"],
    tests: list[MotionTest],
    width: float,
    deadline: float,
) -> Float[np.ndarray, "steps robots dof"]:
    """The path with each robot's motions bent in turn, in narrower and narrower tubes.

    Args:
        problem: The problem.
        path: A path that solves it.
        tests: Each robot's motion test.
        width: Distance of the pattern's configurations at first, in workspace units.
        deadline: When to stop, on the clock of ``time.perf_counter``.

    Returns:
        A path of as many rows that solves the problem, never costlier.
    """
    path, cost = path.copy(), path_cost(problem, path)
    narrowest = width / 2**_NARROWINGS
    while width > narrowest:
        for i, test in enumerate(tests):
            if time.perf_counter() > deadline:
                return path
            path[:, i] = _bent(problem, path, i, test, width)
        before, cost = cost, path_cost(problem, path)
        if before - cost <= _GAIN * before:
            width /= 2
    return path


def _bent(
    problem: Problem, path: Float[np.ndarray, "steps robots dof"], i: int, test: MotionTest, width: float
) -> Float[np.ndarray, "steps dof"]:
    """One robot's cheapest motions within its tube, by dynamic programming from the first row to the last."""
    tube = _tube(problem, path[:, i], i, width)
    steps, size = tube.shape[:2]
    begin, end = tube[:-1, :, None], tube[1:, None, :]
    cost = robot_costs(problem, i, begin, end)
    free = _free(problem, path, i, begin, end, test)
    cost[~free] = np.inf
    cheapest, previous = (
        cost[0, 0],
        np.zeros((steps, size), dtype=np.intp),
    )  # both ends stay: begin at the pattern's 0
    for row in range(1, steps - 1):
        through = cheapest[:, None] + cost[row]
        previous[row + 1] = through.argmin(axis=0)
        cheapest = through.min(axis=0)
    bent, at = path[:, i].copy(), 0
    for row in range(steps - 1, 0, -1):
        bent[row] = tube[row, at]
        at = previous[row, at]
    return bent


def _tube(
    problem: Problem, q: Float[np.ndarray, "steps dof"], i: int, width: float
) -> Float[np.ndarray, "steps size dof"]:
    """Configurations about each row, the row itself first; at both ends nothing else."""
    pattern = np.zeros((len(_EIGHT), q.shape[1]))
    pattern[:, :2] = width * _EIGHT
    if isinstance(problem.robots[i], RectangleRobot):
        turns = np.zeros((2, 3))
        turns[:, 2] = np.array([1, -1]) * width / problem.robots[i].circumscribed_radius
        pattern = np.concatenate([pattern, turns])
    tube = q[:, None] + pattern
    tube[[0, -1]] = q[[0, -1], None]
    return tube


def _free(
    problem: Problem,
    path: Float[np.ndarray, "steps robots dof"],
    i: int,
    begin: Float[np.ndarray, "motions size 1 dof"],
    end: Float[np.ndarray, "motions 1 size dof"],
    test: MotionTest,
) -> Bool[np.ndarray, "motions size size"]:
    """Which motions of one robot keep clear of the others' and of obstacles."""
    free = np.ones((len(begin), begin.shape[1], begin.shape[1]), dtype=bool)
    for j, other in enumerate(problem.robots):
        if j != i:
            theirs = path[:-1, j, None, None], path[1:, j, None, None]
            free &= motions_apart(problem.robots[i], begin, end, other, *theirs, problem.workspace.tolerance)
    row, first, last = np.nonzero(free)
    free[row, first, last] = test(begin[row, first, 0], end[row, 0, last])
    return free
