"""Shorten a path within corridors: the cheapest motions of one robot, or of two at a time, close about theirs.

At each row, a robot may stand where it stands or a little off, on a small pattern of configurations. The cheapest
sequence that collides with nothing is found by dynamic programming over the rows; the other robots keep their
motions. Two robots that touch have to move together: neither gains by making way alone. Where the corridors stop
gaining, they are made narrower.
"""

import time
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax.collision.joint_motion import JointMotionTest

Path = Float[np.ndarray, "steps robots dof"]
Corridor = Float[np.ndarray, "steps size dof"]

_GAIN = 3e-3  # share of the cost below which the corridors are narrowed
_NARROWINGS = 3
_REACH = 4  # widths of a corridor within which two robots count as touching
_MARGIN = 3  # rows before and after those in which they do
_FIVE = np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)], dtype=np.float64)


def shorten_in_corridors(problem: Problem, path: Path, test: JointMotionTest, width: float, deadline: float) -> Path:
    """The path with the cheapest motions of each robot, and of each two, in narrower and narrower corridors.

    The pattern's configurations are ``width`` apart at first. The path has as many rows, solves the problem as well,
    and is never costlier. It ends early at the deadline, on the clock of ``time.perf_counter``.
    """
    path, cost = path.copy(), path_cost(problem, path)
    narrowest, diagonal = width / 2**_NARROWINGS, False
    while width > narrowest:
        for robots, rows in _groups(problem, path, width):
            if time.perf_counter() > deadline:
                return path
            path[rows] = _shortened(problem, path[rows], robots, test, width, diagonal)
        diagonal = not diagonal
        before, cost = cost, path_cost(problem, path)
        if before - cost <= _GAIN * before:
            width /= 2
    return path


def _groups(problem: Problem, path: Path, width: float) -> Iterator[tuple[tuple[int, ...], slice]]:
    """What is shortened together: every robot alone, and each two in the rows in which they touch."""
    for i, robot in enumerate(problem.robots):
        yield (i,), slice(0, len(path))
        for j in range(i):
            reach = robot.circumscribed_radius + problem.robots[j].circumscribed_radius + _REACH * width
            offset = path[:, i, :2] - path[:, j, :2]
            rows = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < reach)
            if len(rows):
                yield (i, j), slice(max(rows[0] - _MARGIN, 0), rows[-1] + _MARGIN + 1)


def _shortened(
    problem: Problem, path: Path, robots: tuple[int, ...], test: JointMotionTest, width: float, diagonal: bool
) -> Path:
    """The robots' cheapest motions within their corridors, both ends as they are."""
    corridors = [_corridor(problem, path[:, i], i, width, diagonal) for i in robots]
    costs = [_costs(problem, path, robots, i, own, test) for i, own in zip(robots, corridors, strict=True)]
    cost = costs[0]
    if len(robots) == 2:
        # From each two of their places to each two.
        (i, j), (a, b) = robots, corridors
        mine = a[:-1, :, None, None, None], a[1:, None, None, :, None]
        theirs = b[:-1, None, :, None, None], b[1:, None, None, None, :]
        cost = costs[0][:, :, None, :, None] + costs[1][:, None, :, None, :]
        cost[~test.apart(i, *mine, j, *theirs)] = np.inf
        cost = cost.reshape(len(cost), cost.shape[1] * cost.shape[2], -1)
    places = np.unravel_index(_cheapest(cost), [corridor.shape[1] for corridor in corridors])
    shortened, rows = path.copy(), np.arange(len(path))
    for i, corridor, place in zip(robots, corridors, places, strict=True):
        shortened[:, i] = corridor[rows, place]
    return shortened


def _corridor(problem: Problem, q: Float[np.ndarray, "steps dof"], i: int, width: float, diagonal: bool) -> Corridor:
    """Configurations about each row, the row itself first; at both ends nothing else."""
    axes = np.sqrt(0.5) * np.array([[1, 1], [-1, 1]]) if diagonal else np.eye(2)
    offsets = np.zeros((len(_FIVE), q.shape[1]))
    offsets[:, :2] = width * _FIVE @ axes
    if problem.robots[i].dof == 3:
        turns = np.zeros((2, 3))
        turns[:, 2] = np.array([1, -1]) * width / problem.robots[i].circumscribed_radius
        offsets = np.concatenate([offsets, turns])
    corridor = q[:, None] + offsets
    corridor[[0, -1]] = q[[0, -1], None]
    return corridor


def _costs(
    problem: Problem, path: Path, robots: tuple[int, ...], i: int, corridor: Corridor, test: JointMotionTest
) -> Float[np.ndarray, "motions size size"]:
    """Cost of every motion within a robot's corridor; ``inf`` if it hits a wall or a robot that keeps its motions."""
    begin, end = corridor[:-1, :, None], corridor[1:, None, :]
    cost = straight_costs(begin, end, problem.rotation_weights[i])
    motion = np.arange(len(begin))[:, None, None]
    free = test.apart_from_others(i, begin, end, path, motion, but=robots)
    row, first, last = np.nonzero(free)
    free[row, first, last] = test.of_walls[i](corridor[row, first], corridor[row + 1, last])
    cost[~free] = np.inf
    return cost


def _cheapest(cost: Float[np.ndarray, "motions size size"]) -> Int[np.ndarray, "steps"]:
    """Places of the cheapest sequence of motions, from place 0 to place 0."""
    size, rows = cost.shape[1], np.arange(cost.shape[1])
    so_far = np.full(size, np.inf)
    so_far[0] = 0.0
    previous = np.empty((len(cost), size), dtype=np.intp)
    for motion, through in enumerate(cost):
        total = so_far[:, None] + through
        previous[motion] = total.argmin(axis=0)
        so_far = total[previous[motion], rows]
    places = np.zeros(len(cost) + 1, dtype=np.intp)
    for motion in range(len(cost) - 1, -1, -1):
        places[motion] = previous[motion, places[motion + 1]]
    return places
