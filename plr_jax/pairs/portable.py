"""Distances between pairs of points in NumPy, as ``FORMAT.md`` defines them bit for bit for all languages."""

from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_queries, parts, ragged_indices
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.pairs.stored import PairsFileData, distances_table
from plr_jax.plr.frame import Frame, Outside, frame_of
from plr_jax.plr.portable.arithmetic import ARRAYS, CodedTree, fraction_along
from plr_jax.plr.portable.javascript import js_file_reader
from plr_jax.plr.portable.numpy import LeafTable
from plr_jax.plr.portable.writers import format_domain

# How far walls move for sight, in domain widths: several times the rounding error of a query.
RECEDING = 32 * float(np.finfo(np.float32).eps)
MARGIN = RECEDING / 4  # distance in domain widths within which a wall may matter: more than a query's rounding error
_ROUNDINGS = 16 * float(np.finfo(np.float32).eps)  # relative error of a distance: more than a query rounds
SHRUNK, STRETCHED = np.float32(1 - _ROUNDINGS), np.float32(1 + _ROUNDINGS)
ENDS = np.float32(4 * np.finfo(np.float32).eps)  # relative error of the ends of the domain for points in 32 bits
_AT_ONCE = 2**19  # pairs of a segment and a wall that are tested together
_PAIRS = 2**12  # pairs of points that are answered together
_Points = Float[np.ndarray, "n 2"]
_Lengths = Float[np.ndarray, "n"]
_Flags = Bool[np.ndarray, " n"]


def point_rounding(half: Any, middle: Any) -> Any:
    """Bound the error of a distance that is due to the rounding of points to 32 bits.

    ``half`` is half the width of the domain, and ``middle`` the absolute value of its center, both along each axis.
    """
    # Points in 64 bits, relative to the middle, are rounded to 32 bits: an error of at most an eps of `half`. From
    # points in 32 bits, `first`, the middle in 32 bits, is subtracted, then `rest`, its rounding error: each
    # difference is at most about `half`, so that both err by at most an eps of it, and `first + rest` is the middle
    # up to eps**2 of it. A path has two such points, and two rounded corners.
    return _ROUNDINGS * (half + np.finfo(np.float32).eps * middle)


def crossings(p: Any, q: Any, wall: Any) -> tuple[Any, Any]:
    """Return whether segments from ``p`` to ``q`` cross walls into an obstacle, and whether out of an obstacle.

    A wall is given by its ends, ``(ax, ay, bx, by)``, with free space on its left. Points are ``(x, y)``. The shapes
    of all coordinates must broadcast.
    """
    # With e = b - a and d = q - p, the segment crosses the wall if the sides of p and q, the signs of e x (p - a) and
    # e x (q - a), differ, and only one of a and b is left of the segment: d x (p - a) <= 0. Seen along the wall, free
    # space is on the left, so a segment into the obstacle has b on its left:
    #
    #            p  free
    #      a ----|---> b
    #            v  obstacle
    (px, py), (qx, qy), (ax, ay, bx, by) = p, q, wall
    ex, ey, dx, dy = bx - ax, by - ay, qx - px, qy - py
    # Differences between close points are exact. They tell sides even if a segment and a wall are almost in line.
    away_x, away_y = px - ax, py - ay
    crosses = (ex * away_y - ey * away_x) * (ex * (qy - ay) - ey * (qx - ax)) < 0
    a_is_left, b_is_left = dx * away_y <= dy * away_x, dx * (py - by) <= dy * (px - bx)
    return crosses & b_is_left & ~a_is_left, crosses & a_is_left & ~b_is_left


def are_crossed(p: _Points, q: _Points, walls: Float[np.ndarray, "4 walls"], both_ways: bool = False) -> _Flags:
    """Return whether each segment from ``p[i]`` to ``q[i]`` crosses any wall.

    With ``both_ways``, the segment must cross both a wall into an obstacle and a wall out of an obstacle. Columns of
    ``walls`` are the ends ``(ax, ay, bx, by)``, with free space on the left.
    """
    crossed = np.zeros(len(p), bool)
    for part in parts(np.full(len(p), walls.shape[1]), _AT_ONCE):
        inward, outward = crossings(p[part].T[:, :, None], q[part].T[:, :, None], walls)
        goes_in, goes_out = inward.any(axis=1), outward.any(axis=1)
        crossed[part] = goes_in & goes_out if both_ways else goes_in | goes_out
    return crossed


def winding(p: Any, wall: Any) -> tuple[Any, Any]:
    """Return whether each wall crosses a horizontal ray upward, and whether it crosses the ray downward.

    The ray starts at the point ``p`` and leads to the right. A wall leads from ``(ax, ay)`` to ``(bx, by)``. The
    winding number of the walls around the point is the number of upward minus the number of downward crossings.
    """
    # A wall upward crosses the ray if its ends are below and above it, and the point is on its left.
    (px, py), (ax, ay, bx, by) = p, wall
    side = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    return (ay <= py) & (by > py) & (side > 0), (by <= py) & (ay > py) & (side < 0)


@dataclass(frozen=True, eq=False)
class MovedObstacles:
    """Walls and corners of a PairPLR's file, moved slightly so that rounding cannot open a wall, or hide a corner.

    If ``is_certain``, no wall opens; otherwise no corner is hidden. Coordinates are relative to the domain's middle.
    """

    walls: Float[np.ndarray, "walls 4"]
    corners: Float[np.ndarray, "corners 2"]  # the last, at `inf`, is padding
    moved: float  # farthest that a corner is from its position in the file
    is_certain: bool  # whether every path found is certainly free

    @staticmethod
    def of(stored: PairsFileData, is_certain: bool, for_lower_bounds: bool = False) -> "MovedObstacles":
        """Build the obstacles of a PairPLR's file: its walls and corners, moved a little because queries round.

        If ``is_certain``, walls move into free space: a path between them is certainly free. Otherwise walls move
        into their obstacles, so that rounding hides no corner. With ``for_lower_bounds``, walls of thin obstacles are
        left out too, and paths may pass between obstacles that touch. Then a point that the walls hide is certainly
        hidden.
        """
        outline, domain = stored.outline, stored.domain
        width, middle = float(domain.width.max()), (domain.lo + domain.hi) / 2
        receding = RECEDING * width
        # 1. Move corners, for certain paths twice as far as walls.
        if is_certain:
            corners = np.concatenate([outline.moved_points(-2 * receding)[stored.corner], stored.places])
        else:
            # Corners at the end of a wall move in front of it, or rounding would hide them: by at most `0.2 * MITRE`
            # margins, so that no corner moves through an obstacle close ahead whose walls move back.
            before = outline.moved_points(-0.2 * MARGIN * width)[stored.corner]
            corners = stored.points.copy()
            ends_sight = np.flatnonzero(outline.ends_sight(receding)[stored.corner])
            corners[ends_sight] = before[ends_sight]
        moved = float(np.linalg.norm(corners - stored.points, axis=1).max(initial=0.0))
        # 2. Move walls.
        walls = outline.moved_walls(-receding if is_certain else receding, moves_all=for_lower_bounds)
        if is_certain:
            walls = np.concatenate([walls, outline.around_thin_walls(receding)])
            # No certainly free path turns at a corner that a wall cuts off from the place to which the corner moves.
            corners[are_crossed(stored.points, corners, outline.moved_walls(0.0).T)] = np.inf
        elif for_lower_bounds:
            walls = walls[~outline.is_thin]
        # 3. Make both relative to the middle.
        walls -= np.tile(middle, 2)
        return MovedObstacles(walls, np.append(corners - middle, [[np.inf, np.inf]], axis=0), moved, is_certain)

    @cached_property
    def wall_ends(self) -> Float[np.ndarray, "4 walls"]:
        return np.ascontiguousarray(self.walls.T, np.float32)

    def hides(self, p: _Points, q: _Points) -> _Flags:
        """Return whether walls hide ``q[i]`` from ``p[i]``.

        If ``is_certain``, one crossed wall hides the point. Otherwise the segment must cross both a wall into an
        obstacle and a wall out of an obstacle.
        """
        return are_crossed(p, q, self.wall_ends, both_ways=not self.is_certain)

    def encloses(self, p: _Points) -> Bool[np.ndarray, " n"]:
        """Return whether points are in the free space that the walls enclose, by the winding number."""
        inside = np.zeros(len(p), bool)
        for part in parts(np.full(len(p), len(self.walls)), _AT_ONCE):
            up, down = winding(p[part].T[:, :, None], self.wall_ends)
            inside[part] = up.sum(axis=1) - down.sum(axis=1) == 1
        return inside


class NumpyPairs:
    """The distance between any two points as a function in NumPy, without JAX; made by :meth:`PairPLR.numpy`.

    ``f(x, y)`` is the distance, and ``f.bounds(x, y)`` are its proven bounds. Points are rounded to 32 bits relative
    to the middle of ``domain``, a :class:`Box`.
    """

    def __init__(self, stored: PairsFileData) -> None:
        # 1. The domain, relative to its middle.
        domain, middle = stored.domain, (stored.domain.lo + stored.domain.hi) / 2
        self.domain, self._middle = domain, middle
        self._frame = frame_of(Box(domain.lo - middle, domain.hi - middle))
        self._ends = self._frame[Frame.HI]
        self._half = (domain.width / 2).astype(np.float32)
        self._rounded_ends = self._half + ENDS * (self._half + np.abs(middle.astype(np.float32)))
        # 2. Leaves, and the corners that each lists: a row per leaf, padded with the number of corners, an index at
        #    which all distances and coordinates are `inf`.
        count, corners = len(stored.cells), stored.num_corners
        self._leaves = LeafTable(CodedTree(stored.tree, np.arange(count)))
        lengths = np.diff(stored.lists.indptr)
        self._lists = np.full((count, max(1, lengths.max(initial=0))), corners)
        self._lists[ragged_indices(lengths)] = stored.lists.indices
        self._distances, self._has_arcs = distances_table(stored, corners + 1), len(stored.arcs.start) > 0
        # 3. Walls and corners, moved in three ways, and what both bounds leave for errors.
        self._obstacles = MovedObstacles.of(stored, is_certain=False)
        self._upper_obstacles = MovedObstacles.of(stored, is_certain=True)
        self._lower_obstacles = MovedObstacles.of(stored, is_certain=False, for_lower_bounds=True)
        point_error = float(point_rounding(domain.width / 2, np.abs(middle)).max())
        self._lower_error = np.float32(stored.rounding + 2 * self._obstacles.moved + point_error)
        self._upper_error = np.float32(stored.rounding + 2 * self._upper_obstacles.moved + point_error)

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Any:
        """Return distances between points ``(..., 2)`` whose shapes broadcast, ``(...)`` in float32.

        Distances are ``inf`` outside the domain and without a path, NaN where a coordinate is NaN. Swapped points
        have the same distance to the last bit. ``ValueError`` if points are not real numbers with two coordinates, or
        do not broadcast.
        """
        p, q, shape = self._from_middle(x, y)
        return _in_blocks(partial(self._lengths, self._obstacles), self._ends, np.inf, p, q).reshape(shape)[()]

    def bounds(self, x: ArrayLike, y: ArrayLike) -> tuple[Any, Any]:
        """Return proven lower and upper bounds, ``(...)`` in float32, of distances; see :meth:`PairPLR.bounds`."""
        p, q, shape = self._from_middle(x, y)
        lower, upper = _in_blocks(self._bounds, self._ends, np.inf, p, q).reshape(2, *shape)
        return lower[()], upper[()]

    def _from_middle(self, x: ArrayLike, y: ArrayLike) -> tuple[_Points, _Points, tuple[int, ...]]:
        """Broadcast points; return ``x`` and ``y`` as rows, and the shape of the batch.

        Rows are relative to the middle of the domain, in 32-bit floats.
        """
        x, y = (as_queries(points, 2).astype(np.float64, copy=False) for points in (x, y))
        try:
            x, y = np.broadcast_arrays(x, y)
        except ValueError:
            raise ValueError(f"x and y must broadcast, got shapes {x.shape} and {y.shape}.") from None
        with np.errstate(over="ignore", invalid="ignore"):
            p, q = ((points.reshape(-1, 2) - self._middle).astype(np.float32) for points in (x, y))
        return p, q, x.shape[:-1]

    # The functions below are PairPLR's for few points. Points are relative to the middle of the domain, in 32 or 64
    # bits; answers have the same precision. Points in 32 bits that rounding moves out of the domain are inside.

    def _distances_between(self, p: _Points, q: _Points, outside: Outside) -> _Lengths:
        if outside == "clamp":
            (p, shift_p), (q, shift_q) = map(self._clamped, (p, q))
            return self._distances_between(p, q, "inf") + (shift_p + shift_q)
        return _in_blocks(partial(self._lengths, self._obstacles), self._rounded_ends, float(outside), p, q)

    def _bounds_between(self, p: _Points, q: _Points) -> Float[np.ndarray, "2 n"]:
        return _in_blocks(self._bounds, self._rounded_ends, np.inf, p, q)

    def _distances_to(
        self, p: _Points, goal: _Points, to_corners: Float[np.ndarray, "n size"], outside: Outside
    ) -> _Lengths:
        """Return the distance from each point ``p[i]`` to ``goal[i]``.

        ``to_corners[i]`` has the distances from ``goal[i]`` to all corners. Points are relative to the middle of the
        domain.
        """
        if outside == "clamp":
            p, shift = self._clamped(p)
            return self._distances_to(p, goal, to_corners, "inf") + shift

        def lengths(p: Any, goal: Any, to_corners: Any) -> Float[np.ndarray, " some"]:
            single, goal = p.astype(np.float32), goal.astype(np.float32)

            def paths(hidden: Int[np.ndarray, " hidden"]) -> tuple[Any, Any, Any]:
                # The goal counts as the only last turn, as its distances to corners are known.
                listed, turns, legs = self._legs(self._obstacles, single[hidden])
                return turns, goal[hidden, None], (legs + to_corners[hidden[:, None], listed])[:, :, None]

            length, via, _ = _shortest(self._obstacles, single, goal, paths)
            # Add the change of the leg due to the part of the point that 32 bits lose.
            return length + (_length(p - via) - _length(single - via))

        return _in_blocks(lengths, self._rounded_ends, float(outside), p, goal, to_corners)

    def _to_corners(self, goals: _Points, size: int) -> Float[np.ndarray, "n {size}"]:
        """Return the length of the shortest path from each goal to each corner, ``inf`` without a path.

        Rows are padded with ``inf`` to ``size`` columns. Rows of goals outside the domain have no meaning. Goals are
        relative to the middle of the domain.
        """
        # 1. Find the legs from goals to the corners that their leaves list: `inf` if walls hide a corner.
        goals = np.where((np.abs(goals) <= self._rounded_ends).all(axis=1, keepdims=True), goals, 0)
        listed, turns, legs = self._legs(self._obstacles, goals)
        goal, place = np.nonzero(np.isfinite(legs))
        legs[goal, place] += np.where(self._obstacles.hides(goals[goal], turns[goal, place]), np.float32(np.inf), 0)
        # 2. Minimize over the first turns, column by column of the lists. Columns beyond the corners stay `inf`.
        lengths = np.full((len(goals), size), np.inf, np.float32)
        to_known = lengths[:, : len(self._distances)]  # a view: `lengths` is modified through it
        for leg, corners in zip(legs.T, listed.T, strict=True):
            np.minimum(to_known, leg[:, None] + self._distances[corners], out=to_known)
        return lengths

    def _clamped(self, p: _Points) -> tuple[_Points, _Lengths]:
        """Move finite points outside the domain to the nearest point of the domain; also return how far they move."""
        is_beyond = np.isfinite(p).all(axis=1, keepdims=True) & (np.abs(p) > self._rounded_ends)  # by axis
        nearest = np.where(is_beyond, np.copysign(self._half.astype(p.dtype), p), p)
        with np.errstate(invalid="ignore"):
            return nearest, np.where(is_beyond.any(axis=1), np.hypot(*(p - nearest).T), p.dtype.type(0))

    def _bounds(self, p: _Points, q: _Points) -> Float[np.ndarray, "2 n"]:
        p, q = p.astype(np.float32), q.astype(np.float32)
        lower = np.maximum(SHRUNK * self._lengths(self._lower_obstacles, p, q) - self._lower_error, np.float32(0))
        is_clear = self._upper_obstacles.encloses(p) & self._upper_obstacles.encloses(q)
        length = np.where(is_clear, self._lengths(self._upper_obstacles, p, q), np.float32(np.inf))
        return np.stack([lower, STRETCHED * length + self._upper_error])

    def _lengths(self, obstacles: MovedObstacles, p: _Points, q: _Points) -> _Lengths:
        """Return the length of the shortest path from each ``p[i]`` to ``q[i]``.

        The path is straight if the walls of ``obstacles`` allow it, else it turns at corners of ``obstacles``.
        Points are relative to the middle of the domain.
        """
        # 1. Sort the points of each pair lexicographically, so that swapped points get the same bits. Arcs have one
        #    direction.
        swaps = ((p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1])))[:, None] & ~self._has_arcs
        p, q = np.where(swaps, q, p), np.where(swaps, p, q)
        # 2. Find shortest paths in 32 bits: |p - i| + (|q - j| + D(i, j)) through listed corners i and j.
        single_p, single_q = p.astype(np.float32), q.astype(np.float32)

        def paths(hidden: Int[np.ndarray, " hidden"]) -> tuple[Any, Any, Any]:
            of_p, turns_p, legs_p = self._legs(obstacles, single_p[hidden])
            of_q, turns_q, legs_q = self._legs(obstacles, single_q[hidden])
            onward = legs_q[:, None] + self._distances[of_p[:, :, None], of_q[:, None]]
            return turns_p, turns_q, legs_p[:, :, None] + onward

        length, via_p, via_q = _shortest(obstacles, single_p, single_q, paths, self._has_arcs)
        if p.dtype == np.float32:
            return length

        # 3. Add the change of both legs due to the part of the points that 32 bits lose.
        def legs(p: _Points, q: _Points) -> _Lengths:
            is_straight = ((via_p == single_q) & (via_q == single_p)).all(axis=1)
            return np.where(is_straight, _length(p - q), _length(p - via_p) + _length(q - via_q))

        return length + (legs(p, q) - legs(single_p, single_q))

    def _legs(
        self, obstacles: MovedObstacles, p: _Points
    ) -> tuple[Int[np.ndarray, "n longest"], Float[np.ndarray, "n longest 2"], Float[np.ndarray, "n longest"]]:
        """Return the corners listed by the leaf that holds each point: indices, positions, distances to the point."""
        above = np.clip(p, self._frame[Frame.LO], self._ends).T - self._frame[Frame.LO][:, None]
        places = [fraction_along(ARRAYS, *along_axis) for along_axis in zip(above, self._frame.T, strict=True)]
        listed = self._lists[self._leaves.rows(places)]
        turns = obstacles.corners[listed].astype(np.float32)
        return listed, turns, _length(p[:, None] - turns)


def _in_blocks(
    answer: Callable[..., np.ndarray], ends: ArrayLike, outside: float, p: _Points, q: _Points, *others: Any
) -> Float[np.ndarray, "*answers n"]:
    """Return the result of ``answer`` for pairs of points ``p[i]`` and ``q[i]``, block by block.

    ``others`` are more columns that ``answer`` takes. Points are relative to the middle of the domain. A pair gets
    ``outside`` if a coordinate is beyond ``ends``, half the width of the domain, and NaN if a coordinate is NaN.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        farthest = np.maximum(np.abs(p), np.abs(q))
        fixed_answers = np.where((farthest > ends).any(axis=1), outside, 0.0).astype(p.dtype)
        fixed_answers[np.isnan(farthest).any(axis=1)] = np.nan
        inside = np.flatnonzero(fixed_answers == 0)
        # At least one block, perhaps empty: its answer has the dtype and the first axes of all answers.
        blocks = [inside[first : first + _PAIRS] for first in range(0, max(1, len(inside)), _PAIRS)]
        block_answers = [answer(*(column[block] for column in (p, q, *others))) for block in blocks]
    answers = np.broadcast_to(fixed_answers, (*block_answers[0].shape[:-1], len(p))).copy()
    answers[..., inside] = np.concatenate(block_answers, axis=-1)
    return answers


def _shortest(
    obstacles: MovedObstacles, p: _Points, q: _Points, paths: Callable[..., Any], has_arcs: bool = False
) -> tuple[_Lengths, _Points, _Points]:
    """Return the length, the first turn and the last turn of the shortest path from each ``p[i]`` to ``q[i]``.

    ``paths`` maps the indices of ``n`` pairs of points to possible first turns ``(n, k, 2)``, possible last turns
    ``(n, m, 2)``, and the length of the path through each first and last turn ``(n, k, m)``. If a path is straight or
    missing, its first turn is ``q[i]`` and its last turn ``p[i]``.
    """
    # 1. Straight paths.
    lengths, via_p, via_q = _length(p - q), q.copy(), p.copy()
    hidden = np.flatnonzero(obstacles.hides(p, q))
    lengths[hidden] = np.inf
    # 2. For other pairs, try the shortest path first, and drop the turns that its ends do not see, until a path is
    #    free or none is left. Arcs may be shorter than straight paths.
    hidden = np.arange(len(p)) if has_arcs else hidden
    turns_p, turns_q, lengths_via = paths(hidden)
    pending = np.arange(len(hidden))  # indices in `hidden`
    while len(pending):
        i, j = np.divmod(lengths_via[pending].reshape(len(pending), -1).argmin(axis=1), lengths_via.shape[2])
        length, rows = lengths_via[pending, i, j], hidden[pending]
        first, last = turns_p[pending, i], turns_q[pending, j]
        hidden_p, hidden_q = obstacles.hides(p[rows], first), obstacles.hides(q[rows], last)
        lengths_via[pending[hidden_p], i[hidden_p]] = np.inf
        lengths_via[pending[hidden_q], :, j[hidden_q]] = np.inf
        is_shorter = length < lengths[rows]
        is_free = is_shorter & ~(hidden_p | hidden_q)
        found = rows[is_free]
        lengths[found], via_p[found], via_q[found] = length[is_free], first[is_free], last[is_free]
        pending = pending[is_shorter & ~is_free]
    return lengths, via_p, via_q


def _length(v: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    return np.sqrt(v[..., 0] * v[..., 0] + v[..., 1] * v[..., 1])


def js_pairs_reader() -> str:
    return Path(__file__).with_name("pairs.js").read_text(encoding="utf-8")


def js_pairs_module(data: bytes, domain: Box) -> str:
    """Return a JavaScript module with the file ``data`` and functions that answer as :meth:`PairPLR.numpy` does."""
    template = Template(Path(__file__).with_name("pairs_module.js").read_text(encoding="utf-8"))
    readers, file = f"{js_file_reader()}\n{js_pairs_reader()}", b64encode(data).decode()
    return template.substitute(DOMAIN=format_domain(domain), READERS=readers, FILE=file)
