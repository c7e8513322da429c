"""Paths of any angle through voxels with sides of 1, pulled taut: how long shortest paths are.

A shortest path is straight but where it bends around edges of blocked voxels. So those of a :class:`VoxelGraph` are
followed, shortened as by Theta*, pulled to edges, and exchanged for one another where that is shorter. They stay
paths that a point can follow: never shorter than the shortest.

References:
    K. Daniel et al., "Theta*: any-angle path planning on grids", JAIR 39, 2010.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax import VoxelGraph, VoxelSpace

_STEPS = np.array([step for step in product((-1, 0, 1), repeat=3) if any(step)])
_CORNERS = np.array(list(product((-1, 0, 1), repeat=3)))  # of voxels, from the nearest one on
_BESIDE = np.array(list(product((-1, 0, 1), repeat=2)))  # of the edges along an axis, from the nearest one on
_REACH = 2.0  # from bends, of points that are put on their legs
_ROUNDS = 5
_LEAST_GAIN = 1e-9
_AT_ONCE = 1 << 23  # pairs of points that are compared

Points = Float[np.ndarray, "n 3"]
Voxels = Int[np.ndarray, "n"]


class Paths(NamedTuple):
    """All points of the paths, one path after the other, each from its start to the goal; and whose they are."""

    points: Points
    path: Int[np.ndarray, " n"]

    @property
    def is_bend(self) -> Bool[np.ndarray, " n"]:
        """Which points are neither the first nor the last of their path."""
        same = self.path[1:] == self.path[:-1]
        return np.append(False, same) & np.append(same, False)

    @property
    def position(self) -> Int[np.ndarray, " n"]:
        """How many points are before each in its path."""
        return np.arange(len(self.path)) - np.searchsorted(self.path, self.path)

    @property
    def to_goal(self) -> Float[np.ndarray, " n"]:
        """Length of the path from each point on."""
        legs = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        legs = np.append(np.where(self.path[1:] == self.path[:-1], legs, 0.0), 0.0)
        beyond = np.cumsum(legs[::-1])[::-1]
        return beyond - beyond[np.searchsorted(self.path, self.path, side="right") - 1]

    @property
    def lengths(self) -> Float[np.ndarray, " paths"]:
        """Length of each path."""
        return self.to_goal[self.position == 0]


class _Remembered:
    """A function of rows of points, asked once for each: paths share many, of which most soon stay as they are."""

    def __init__(self, function: Callable[..., np.ndarray]):
        self.function = function
        self.known: dict[bytes, np.ndarray] = {}

    def __call__(self, *columns: Points) -> np.ndarray:
        rows = np.concatenate(columns, axis=1)
        keys = [row.tobytes() for row in rows]
        new = {key: i for i, key in enumerate(keys) if key not in self.known}
        answers = self.function(*np.split(rows[list(new.values())], len(columns), axis=1))
        self.known |= zip(new, answers, strict=True)
        return np.array([self.known[key] for key in keys], answers.dtype).reshape(-1, *answers.shape[1:])


def taut_paths(space: VoxelSpace, graph: VoxelGraph, x: Points) -> Paths:
    """Short paths from points, of which the graph leads all to its goal, to that goal."""
    sees = _Remembered(space.are_free)
    moved, moved_alike = (_Remembered(partial(each, space)) for each in (_moved, _moved_alike))
    paths = _without_bends(sees, _followed(space, graph, x))
    for _ in range(_ROUNDS):
        paths = _without_bends(sees, _pulled(moved, _with_points_beside(paths)))
        paths = _slid(moved_alike, _pulled(moved, _exchanged(space, paths)))
    return paths


def _followed(space: VoxelSpace, graph: VoxelGraph, x: Points) -> Paths:
    """Where the graph leads, from center to center of voxels, of which each has the next one in sight."""
    shape = space.free.shape

    def voxels(q: Points) -> Voxels:
        return np.asarray(np.ravel_multi_index(tuple(np.floor(q.T).astype(np.int64)), shape, mode="clip"))

    def centers(voxel: Voxels) -> Points:
        return np.stack(np.unravel_index(voxel, shape), axis=1) + 0.5

    root, following, found = voxels(graph.goal[None])[0], np.full(space.free.size, -1), []
    front = np.unique(voxels(x))
    while len(front := front[(following[front] < 0) & (front != root)]):
        following[front] = voxels(_next_centers(space, graph, centers(front)))
        found.append(front)
        front = np.unique(following[front])
    following[root] = root
    left, is_known = np.concatenate(found), np.zeros(space.free.size, bool)
    in_sight, is_known[root] = following.copy(), True
    while len(left):
        is_next = is_known[following[left]]
        voxel, left = left[is_next], left[~is_next]
        further = in_sight[following[voxel]]
        sees = space.are_free(centers(voxel), centers(further))
        in_sight[voxel] = np.where(sees, further, following[voxel])
        is_known[voxel] = True
    columns = [voxels(x)]
    while (columns[-1] != root).any():
        columns.append(in_sight[columns[-1]])
    between = [centers(column) for column in columns]
    return _of_columns([x, *between, np.tile(graph.goal, (len(x), 1))])


def _next_centers(space: VoxelSpace, graph: VoxelGraph, q: Points) -> Points:
    """The centers of neighbors by way of which the graph leads from centers to its goal."""
    around = q[:, None] + _STEPS
    length = graph(around.reshape(-1, 3)).reshape(len(q), -1) + np.linalg.norm(_STEPS, axis=1)
    return around[np.arange(len(q)), _shortest_free(space, length, q[:, None], around)]


def _of_columns(columns: list[Points]) -> Paths:
    """Paths from their first points, their second ones and so on; the same one twice in turn counts once."""
    rows = np.stack(columns, axis=1)
    is_new = np.append(np.ones((len(rows), 1), bool), (rows[:, 1:] != rows[:, :-1]).any(axis=2), axis=1)
    return Paths(rows[is_new], np.nonzero(is_new)[0])


def _without_bends(sees: _Remembered, paths: Paths) -> Paths:
    """The paths without bends whose neighbors see each other: every second one at a time, until all are looked at."""
    parity, num_seen = 0, 0
    while num_seen < 2:
        at = np.flatnonzero(paths.is_bend & (paths.position % 2 == parity))
        is_seen = sees(paths.points[at - 1], paths.points[at + 1])
        keep = np.ones(len(paths.path), bool)
        keep[at[is_seen]] = False
        paths = Paths(paths.points[keep], paths.path[keep])
        parity, num_seen = 1 - parity, 0 if is_seen.any() else num_seen + 1
    return paths


def _with_points_beside(paths: Paths) -> Paths:
    """The paths with a point more on both legs of every bend, so that it may give way to several."""
    at = np.flatnonzero(paths.is_bend)
    parts = [(np.arange(len(paths.path), dtype=float), paths)]
    for side, most in ((-1, 0.5), (1, 0.4)):
        leg = paths.points[at + side] - paths.points[at]
        share = np.minimum(_REACH / np.maximum(np.linalg.norm(leg, axis=1), _REACH), most)
        parts.append((at + side / 4, Paths(paths.points[at] + share[:, None] * leg, paths.path[at])))
    order = np.argsort(np.concatenate([place for place, _ in parts]))
    points, path = (np.concatenate(each)[order] for each in zip(*(part for _, part in parts), strict=True))
    return Paths(points, path)


def _pulled(moved: _Remembered, paths: Paths) -> Paths:
    """The paths with bends moved, every second one at a time, where that makes them shorter."""
    points = paths.points.copy()
    for turn in range(4):
        at = np.flatnonzero(paths.is_bend & (paths.position % 2 != turn % 2))
        points[at] = moved(*(points[at + k] for k in (-1, 0, 1)))
    return Paths(points, paths.path)


def _moved(space: VoxelSpace, a: Points, p: Points, b: Points) -> Points:
    """Where paths from a over p to b bend best: at p, or at corners or on edges of voxels beside it."""
    ways = [np.round(p) + beside for beside in _CORNERS]
    for axis in range(3):
        across = [each for each in range(3) if each != axis]
        for beside in _BESIDE:
            line, way = np.round(p[:, across]) + beside, np.empty_like(p)
            to_a, to_b = (np.linalg.norm(end[:, across] - line, axis=1) for end in (a, b))
            way[:, across], way[:, axis] = line, a[:, axis] + _straight(to_a, to_b, (b - a)[:, axis])
            ways.append(way)
    way = np.stack(ways, axis=1)
    return _shorter(space, a, [p], [way], b)[0]


def _slid(moved_alike: _Remembered, paths: Paths) -> Paths:
    """The paths with every two bends in turn moved alike along an axis, where that makes them shorter."""
    points, path = paths.points.copy(), paths.path
    is_pair = paths.is_bend & np.append(paths.is_bend[1:], False)
    for turn in range(6):
        at = np.flatnonzero(is_pair & (paths.position % 3 == turn % 3))
        both = moved_alike(*(points[at + k] for k in (-1, 0, 1, 2)))
        points[at], points[at + 1] = both[:, 0], both[:, 1]
    return Paths(points, path)


def _moved_alike(space: VoxelSpace, a: Points, p: Points, q: Points, b: Points) -> Float[np.ndarray, "n 2 3"]:
    """Where paths from a over p and q to b bend best, if both bends move by the same along one axis.

    By as much as a straight path would have it, or only to where p or q comes to a face: the edge may end there.
    """
    by = []
    for axis in range(3):
        across = [each for each in range(3) if each != axis]
        to_a, to_b = (np.linalg.norm((end - begin)[:, across], axis=1) for begin, end in ((p, a), (q, b)))
        best = (a - p)[:, axis] + _straight(to_a, to_b, (b - q - a + p)[:, axis])
        for begin in (p[:, axis], q[:, axis]):
            to_face = np.where(best > 0, np.floor(begin) + 1, np.ceil(begin) - 1) - begin
            by.append(np.where(np.abs(to_face) < np.abs(best), to_face, best)[:, None] * np.eye(3)[axis])
        by.append(best[:, None] * np.eye(3)[axis])
    moved = np.stack(by, axis=1)
    return np.stack(_shorter(space, a, [p, q], [p[:, None] + moved, q[:, None] + moved], b), axis=1)


def _straight(to_a: np.ndarray, to_b: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """By how much of a difference along an edge a straight path has changed when it meets that edge."""
    return np.divide(to_a * difference, to_a + to_b, out=np.zeros(len(to_a)), where=to_a + to_b > 0)


def _shorter(space: VoxelSpace, a: Points, old: list[Points], ways: list[np.ndarray], b: Points) -> list[Points]:
    """The bends of the shortest free paths from a to b, of old ones and ways, ``(n, ways, 3)`` each."""

    def length(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return np.linalg.norm(first - a[:, None], axis=2) + np.linalg.norm(last - b[:, None], axis=2)

    before, after = length(old[0][:, None], old[-1][:, None]), length(ways[0], ways[-1])
    after[after > before - _LEAST_GAIN] = np.inf
    near = np.isfinite(after)
    for way in ways:
        after[near] = np.where(space.is_free(way[near]), after[near], np.inf)
    best = _shortest_free(space, after, a[:, None], *ways, b[:, None])
    return [np.where(best[:, None] < 0, p, way[np.arange(len(p)), best]) for p, way in zip(old, ways, strict=True)]


def _shortest_free(space: VoxelSpace, length: np.ndarray, *points: np.ndarray) -> Int[np.ndarray, " n"]:
    """Which of the ways through points, ``(n, ways, 3)``, is the shortest that is free; -1: none of finite length."""
    points = tuple(np.broadcast_to(each, (*length.shape, 3)) for each in points)
    choice, left = np.full(len(length), -1), np.arange(len(length))
    while len(left):
        best = length[left].argmin(axis=1)
        is_way = np.isfinite(length[left, best])
        left, best = left[is_way], best[is_way]
        free = np.ones(len(left), bool)
        for begin, end in pairwise(points):
            free[free] = space.are_free(begin[left, best][free], end[left, best][free])
        choice[left[free]] = best[free]
        length[left, best] = np.inf
        left = left[~free]
    return choice


def _exchanged(space: VoxelSpace, paths: Paths) -> Paths:
    """The paths, going on from starts and bends by way of another bend in sight, one a voxel, if that is shorter."""
    distinct, node = np.unique(paths.points, axis=0, return_inverse=True)
    node, to_goal = node.ravel(), paths.to_goal
    by_length = np.lexsort((to_goal, node))
    first = by_length[np.searchsorted(node[by_length], np.arange(len(distinct)))]
    to_goal, goal, starts, bends = to_goal[first], node[-1], node[paths.position == 0], np.unique(node[paths.is_bend])
    if not len(bends):
        return paths
    bends = bends[np.unique(np.floor(distinct[bends]), axis=0, return_index=True)[1]]
    following, asked = node[np.minimum(first + 1, len(node) - 1)], np.concatenate([starts, bends])
    for some in np.array_split(asked, len(asked) * len(bends) // _AT_ONCE + 1):
        length = np.linalg.norm(distinct[some][:, None] - distinct[bends], axis=2) + to_goal[bends]
        length[length > to_goal[some][:, None] - _LEAST_GAIN] = np.inf
        best = _shortest_free(space, length, distinct[some][:, None], distinct[bends])
        following[some] = np.where(best < 0, following[some], bends[best])
    following[goal] = goal
    columns = [starts]
    while (columns[-1] != goal).any():
        columns.append(following[columns[-1]])
    return _of_columns([distinct[column] for column in columns])
