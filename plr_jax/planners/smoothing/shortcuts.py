"""Shorten a path robot by robot: the best set of straight shortcuts for one while the others keep their motions."""

import time
from itertools import pairwise

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import runs
from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.robots.motion import between

_LONGEST = 32  # steps that one shortcut spans at most
_LEAST_SAVING = 1e-4  # share of its length that a shortcut saves at least
_GAIN = 1e-3  # share of the cost below which another round is not worth its time


def shorten(
    problem: Problem, path: Float[np.ndarray, "steps robots dof"], test: JointMotionTest, deadline: float
) -> Float[np.ndarray, "steps robots dof"]:
    """The path with each robot's motions replaced by shortcuts, in turn, until that gains little.

    The path has as many rows, solves the problem as well, and is never costlier. It ends early at the deadline, on
    the clock of ``time.perf_counter``.
    """
    path, cost = path.copy(), path_cost(problem, path)
    while True:
        for i in range(len(problem.robots)):
            if time.perf_counter() > deadline:
                return path
            path[:, i] = _shortened(problem, path, i, test)
        before, cost = cost, path_cost(problem, path)
        if before - cost <= _GAIN * before:
            return path


def halved(path: Float[np.ndarray, "steps robots dof"]) -> Float[np.ndarray, "finer robots dof"]:
    """The same path with a row in the middle of every motion."""
    finer = np.repeat(path, 2, axis=0)[:-1]
    finer[1::2] = between(path[:-1], path[1:], np.full((1, 1, 1), 0.5))
    return finer


def _shortened(
    problem: Problem, path: Float[np.ndarray, "steps robots dof"], i: int, test: JointMotionTest
) -> Float[np.ndarray, "steps dof"]:
    """One robot's motions along the shortest way from its first row to its last in the graph of shortcuts."""
    q, steps, weight = path[:, i], len(path), problem.rotation_weights[i]
    so_far = np.concatenate([[0.0], np.cumsum(straight_costs(q[:-1], q[1:], weight))])
    begin, end = np.triu_indices(steps, 2)
    near = end - begin <= _LONGEST
    begin, end = begin[near], end[near]
    cost = straight_costs(q[begin], q[end], weight)
    shorter = cost < (1 - _LEAST_SAVING) * (so_far[end] - so_far[begin])
    begin, end, cost = begin[shorter], end[shorter], cost[shorter]
    free = test.of_walls[i](q[begin], q[end])
    begin, end, cost = begin[free], end[free], cost[free]
    free = _apart(test, path, i, begin, end)
    begin, end, cost = begin[free], end[free], cost[free]
    begin = np.concatenate([begin, np.arange(steps - 1)])
    end = np.concatenate([end, np.arange(1, steps)])
    cost = np.concatenate([cost, np.diff(so_far)])
    return _along(q, _shortest(begin, end, cost, steps))


def _shortest(
    begin: Int[np.ndarray, "m"], end: Int[np.ndarray, "m"], cost: Float[np.ndarray, "m"], steps: int
) -> list[int]:
    """Rows on the shortest way from the first to the last, all edges leading forward."""
    graph = scipy.sparse.csr_array((cost, (begin, end)), shape=(steps, steps))  # an entry of 0 is an edge of no cost
    previous = dijkstra(graph, indices=0, return_predecessors=True)[1]
    rows = [steps - 1]
    while rows[-1] > 0:
        rows.append(int(previous[rows[-1]]))
    return rows[::-1]


def _along(q: Float[np.ndarray, "steps dof"], rows: list[int]) -> Float[np.ndarray, "steps dof"]:
    """The motions between some rows at constant speed; the rows themselves stay as they are."""
    result = q.copy()
    for begin, end in pairwise(rows):
        if end > begin + 1:
            result[begin + 1 : end] = between(q[begin], q[end], np.arange(1, end - begin)[:, None] / (end - begin))
    return result


def _apart(
    test: JointMotionTest,
    path: Float[np.ndarray, "steps robots dof"],
    i: int,
    begin: Int[np.ndarray, "m"],
    end: Int[np.ndarray, "m"],
) -> Bool[np.ndarray, "m"]:
    """Whether shortcuts of one robot keep clear of the motions of the others, each cut into the rows' pieces."""
    count = end - begin
    owner, step = runs(count)
    motion, share = begin[owner] + step, count[owner, None]
    q0, q1 = path[begin, i][owner], path[end, i][owner]
    piece = between(q0, q1, step[:, None] / share), between(q0, q1, (step[:, None] + 1) / share)
    apart = np.ones(len(begin), dtype=bool)
    apart[owner[~test.apart_from_others(i, *piece, path, motion)]] = False
    return apart
