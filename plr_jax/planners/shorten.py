"""Paths made cheaper off the lattices: straight shortcuts of one robot while the others keep their motions.

A shortcut collides in many of the path's motions or in none, as a rule. So a few motions far from one another are
tested first, and the rest of them where these are free. A robot that gained nothing is left alone until one that
stood in its way has moved.
"""

from contextlib import suppress
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import runs
from plr_jax._deadline import require_time
from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax.collision.team import JointMotionTest, Traffic, circles
from plr_jax.robots.robot import between

Path = Float[np.ndarray, "steps robots dof"]
Rows = Int[np.ndarray, "m"]

_LONGEST = 32  # steps that one shortcut spans at most
_STRIDES = (16, 4, 1)  # between motions that are tested one batch after the other
_LEAST_SAVING = 1e-4  # share of its length that a shortcut saves at least
_LEAST_ROUND_GAIN = 1e-3  # share of the cost below which another round is not worth its time


def shorten(problem: Problem, path: Path, test: JointMotionTest) -> Path:
    """The path with each robot's motions replaced by shortcuts, in turn, until that gains little.

    The path has as many rows, solves the problem as well, and is never costlier. It ends early at the deadline
    of the test.
    """
    traffic, cost = Traffic(test.robots, path), path_cost(problem, path)
    hopeful = np.ones(len(test.robots), dtype=bool)
    in_way = np.zeros((len(hopeful), len(hopeful)), dtype=bool)  # of each robot, who kept it from gaining
    # First and last rows of the motions and of all that may be a shortcut.
    begin, place = runs(np.minimum(np.arange(len(path))[::-1], _LONGEST))
    end, gains = begin + 1 + place, True
    with suppress(TimeoutError):
        while gains:
            for i in range(len(hopeful)):
                if not hopeful[i]:
                    continue
                rows, in_way[i] = _with_shortcuts(problem, traffic, i, test, begin, end)
                hopeful[i] = len(rows) < len(path)
                if hopeful[i]:
                    q, before = traffic.path[:, i].copy(), traffic.path[:, i]
                    for first, last in pairwise(rows):  # at constant speed; the rows themselves stay as they are
                        share = np.arange(1, last - first)[:, None] / (last - first)
                        q[first + 1 : last] = between(before[first], before[last], share)
                    traffic.move(i, q)
                    hopeful |= in_way[:, i]
            before, cost = cost, path_cost(problem, traffic.path)
            gains = before - cost > _LEAST_ROUND_GAIN * before
    return traffic.path


def halved(path: Float[np.ndarray, "steps robots dof"]) -> Float[np.ndarray, "finer robots dof"]:
    """The same path with a row in the middle of every motion."""
    finer = np.repeat(path, 2, axis=0)[:-1]
    finer[1::2] = between(path[:-1], path[1:], np.full((1, 1, 1), 0.5))
    return finer


def _with_shortcuts(
    problem: Problem, traffic: Traffic, i: int, test: JointMotionTest, begin: Rows, end: Rows
) -> tuple[list[int], Bool[np.ndarray, "robots"]]:
    """Rows on one robot's shortest way from first to last in the graph of shortcuts, and who stands in its way.

    ``TimeoutError`` past the deadline of the test.
    """
    # 1. Shortcuts that save something and hit no wall.
    q, own = traffic.path[:, i], end == begin + 1
    cost = straight_costs(q[begin], q[end], problem.rotation_weights[i])
    so_far = np.concatenate([[0.0], np.cumsum(cost[own])])
    useful = own | (cost < (1 - _LEAST_SAVING) * (so_far[end] - so_far[begin]))
    begin, end, cost, own = begin[useful], end[useful], cost[useful], own[useful]
    shortcuts = np.flatnonzero(~own)
    shortcuts = shortcuts[test.of_walls[i](q[begin[shortcuts]], q[end[shortcuts]], test.deadline)]
    # 2. Those that keep clear of the other robots, each cut into its pieces in the motions of the path.
    apart, in_way = np.ones(len(shortcuts), dtype=bool), np.zeros(len(test.robots), dtype=bool)
    since, until = begin[shortcuts], end[shortcuts]
    owner, step = runs(until - since)
    motion, later = since[owner] + step, np.ones(len(owner), dtype=bool)
    for stride in _STRIDES:
        require_time(test.deadline, "all shortcuts were tested")
        now = np.flatnonzero(later & (motion % stride == 0) & apart[owner])
        later[now] = False
        edge = owner[now]
        q0, q1, count = q[since[edge]], q[until[edge]], (until - since)[edge, None]
        first, last = (between(q0, q1, (step[now] + ahead)[:, None] / count) for ahead in (0, 1))
        piece, other = traffic.near(i, circles(first[:, None], last[:, None]), motion[now])
        meet = test.meet(i, first[piece], last[piece], traffic, motion[now[piece]], other)
        apart[edge[piece[meet]]], in_way[other[meet]] = False, True
    # 3. The cheapest way along what is left. An entry of 0 is an edge of no cost.
    own[shortcuts[apart]] = True
    graph = csr_array((cost[own], (begin[own], end[own])), shape=(len(q), len(q)))
    previous = dijkstra(graph, indices=0, return_predecessors=True)[1]
    rows = [len(q) - 1]
    while rows[-1] > 0:
        rows.append(int(previous[rows[-1]]))
    return rows[::-1], in_way
