"""Shorten a path robot by robot: the best set of straight shortcuts for one while the others keep their motions.

A shortcut collides in many of the path's motions or in none, as a rule: a few motions far from one another are tested
first, and the rest of those that are free in them. A robot that gained nothing is left alone until one that stood in
its way has moved.
"""

from itertools import pairwise

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import runs
from plr_jax._deadline import require_time
from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax.collision.broad_phase import Traffic, circles
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.robots.motion import between

Path = Float[np.ndarray, "steps robots dof"]
Rows = Int[np.ndarray, "m"]
InWay = Bool[np.ndarray, "robots"]

_LONGEST = 32  # steps that one shortcut spans at most
_STRIDES = (16, 4, 1)  # between motions that are tested one batch after the other
_LEAST_SAVING = 1e-4  # share of its length that a shortcut saves at least
_GAIN = 1e-3  # share of the cost below which another round is not worth its time


def shorten(problem: Problem, path: Path, test: JointMotionTest) -> Path:
    """The path with each robot's motions replaced by shortcuts, in turn, until that gains little.

    The path has as many rows, solves the problem as well, and is never costlier. It ends early at the deadline
    of the test.
    """
    traffic, cost, spans = Traffic(test.robots, path), path_cost(problem, path), _spans(len(path))
    hopeful = np.ones(len(test.robots), dtype=bool)
    in_way = np.zeros((len(hopeful), len(hopeful)), dtype=bool)  # of each robot, who kept it from gaining
    while True:
        for i in range(len(hopeful)):
            if not hopeful[i]:
                continue
            try:
                rows, in_way[i] = _shortened(problem, traffic, i, test, spans)
            except TimeoutError:
                return traffic.path
            hopeful[i] = len(rows) < len(path)
            if hopeful[i]:
                traffic.move(i, _along(traffic.path[:, i], rows))
                hopeful |= in_way[:, i]
        before, cost = cost, path_cost(problem, traffic.path)
        if before - cost <= _GAIN * before:
            return traffic.path


def halved(path: Float[np.ndarray, "steps robots dof"]) -> Float[np.ndarray, "finer robots dof"]:
    """The same path with a row in the middle of every motion."""
    finer = np.repeat(path, 2, axis=0)[:-1]
    finer[1::2] = between(path[:-1], path[1:], np.full((1, 1, 1), 0.5))
    return finer


def _spans(steps: int) -> tuple[Rows, Rows]:
    """First and last rows of the motions and of all that may be a shortcut."""
    begin, place = runs(np.minimum(np.arange(steps)[::-1], _LONGEST))
    return begin, begin + 1 + place


def _shortened(
    problem: Problem, traffic: Traffic, i: int, test: JointMotionTest, spans: tuple[Rows, Rows]
) -> tuple[list[int], InWay]:
    """Rows on one robot's shortest way from first to last in the graph of shortcuts, and who stands in its way.

    ``TimeoutError`` past the deadline of the test.
    """
    q, weight, (begin, end) = traffic.path[:, i], problem.rotation_weights[i], spans
    cost = straight_costs(q[begin], q[end], weight)
    own = end == begin + 1
    so_far = np.concatenate([[0.0], np.cumsum(cost[own])])
    useful = own | (cost < (1 - _LEAST_SAVING) * (so_far[end] - so_far[begin]))
    begin, end, cost, own = begin[useful], end[useful], cost[useful], own[useful]
    shortcuts = np.flatnonzero(~own)
    shortcuts = shortcuts[test.of_walls[i](q[begin[shortcuts]], q[end[shortcuts]], test.deadline)]
    apart, in_way = _apart(test, traffic, i, begin[shortcuts], end[shortcuts])
    own[shortcuts[apart]] = True
    return _shortest(begin[own], end[own], cost[own], len(q)), in_way


def _apart(
    test: JointMotionTest, traffic: Traffic, i: int, begin: Rows, end: Rows
) -> tuple[Bool[np.ndarray, "m"], InWay]:
    """Whether shortcuts of one robot keep clear of the others, and with whom those that do not are seen to collide.

    Each is cut into the pieces that it makes in the motions of the path. ``TimeoutError`` past the deadline of the
    test.
    """
    apart, in_way = np.ones(len(begin), dtype=bool), np.zeros(len(test.robots), dtype=bool)
    count = end - begin
    owner, step = runs(count)
    motion = begin[owner] + step
    later = np.ones(len(owner), dtype=bool)
    for stride in _STRIDES:
        require_time(test.deadline, "all shortcuts were tested")
        now = np.flatnonzero(later & (motion % stride == 0) & apart[owner])
        later[now] = False
        edge, share = owner[now], count[owner[now], None, None]
        q0, q1 = traffic.path[begin[edge], i][:, None], traffic.path[end[edge], i][:, None]
        first, last = (between(q0, q1, (step[now] + ahead)[:, None, None] / share) for ahead in (0, 1))
        piece, other = traffic.near(i, circles(first, last), motion[now])
        meet = test.meet(i, first[piece, 0], last[piece, 0], traffic, motion[now[piece]], other)
        apart[edge[piece[meet]]], in_way[other[meet]] = False, True
    return apart, in_way


def _shortest(begin: Rows, end: Rows, cost: Float[np.ndarray, "m"], steps: int) -> list[int]:
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
