"""A query of pairs without JAX, by an arithmetic that other readers keep to as well, bit for bit.

All operations are those of IEEE 754, rounded to nearest, none fused, in 32-bit floats unless 64 are named. What is
called a *number* is computed once from the file in 64 bits, by the operations of ``tables.py`` and ``outline.py``,
and rounded to 32 once.

1.  *Points* are counted from the middle of the domain in 64 bits, and rounded. The answer is NaN where a coordinate
    is, else ``inf`` where one is farther from the middle than half the domain's width, rounded up. Of two points that
    with the smaller coordinates, the first one first, is ``p``, the other one ``q``.
2.  *Sight.* A wall from ``a`` to ``b`` has the numbers of its ends and, from these, ``e = b - a`` and ``turn = e[0]
    a[1] - e[1] a[0]``. The line from ``p`` to ``q`` crosses it if ``(e[0] p[1] - e[1] p[0] - turn) (e[0] q[1] - e[1]
    q[0] - turn) < 0``, going in if ``d[0] a[1] - d[1] a[0] < m <= d[0] b[1] - d[1] b[0]``, out the other way, where
    ``d = q - p`` and ``m = d[0] p[1] - d[1] p[0]``. It is blocked if it goes in across one wall and out across one.
3.  *Lengths* are ``sqrt(d[0] d[0] + d[1] d[1])``. If ``p`` and ``q`` see one another, the distance is theirs; else
    the least ``|p - i| + (|q - j| + D(i, j))`` of corners ``i`` that ``p`` sees and ``j`` that ``q`` sees, of those
    that their leaves list, or ``inf``. The leaf of a point is found as that of a PLR (see ``plr/portable``).
4.  *Bounds.* The lower one is ``max(shrunk distance - less, 0)``. The upper one is ``stretched length + more``, of
    the length that is found likewise among walls and corners that are moved into free space, where going in or out
    alone is enough to be blocked; ``inf`` unless both points are inside those walls: those that go up to the right of
    a point, less those that go down, are one.

``pairs(x, y)`` finds the same ways, but for rounding: its answers may be of another way that is as short, and
compilers may fuse its operations.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import runs
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.pairs.stored import Stored, distances_table
from plr_jax.plr.frame import Frame, frame_of
from plr_jax.plr.portable.arithmetic import CodedTree, Operations, Point, Value, length, partitioned_axes
from plr_jax.plr.portable.numpy import ARRAYS, LeafTable, as_float_points

RECEDING = 32 * float(np.finfo(np.float32).eps)
"""How far walls move back for sight, in widths of the domain: several times what a query rounds."""
MARGIN = RECEDING / 4
"""How near to a hull, in widths of the domain, walls may hide its corner from it: more than a query rounds."""
_ROUNDINGS = 16 * float(np.finfo(np.float32).eps)  # of a distance: more than a query rounds
_SHRUNK, _STRETCHED = np.float32(1 - _ROUNDINGS), np.float32(1 + _ROUNDINGS)
_AT_ONCE = 2**19  # lines and walls that are held against one another together
_PAIRS = 2**12  # that are answered together


def straight_line_of(do: Operations, p: Point, q: Point) -> Point:
    """What of lines between points is compared with walls."""
    dx, dy = (do.let("d", to - along) for along, to in zip(p, q, strict=True))
    return [dx, dy, do.let("moment", dx * p[1] - dy * p[0])]


def crossings(do: Operations, p: Point, q: Point, line: Point, wall: Any) -> tuple[Value, Value]:
    """Whether lines between points cross walls, going in, and going out; walls are as :func:`walls_with_sides`."""
    (px, py), (qx, qy), (dx, dy, moment), (ax, ay, bx, by, ex, ey, turn) = p, q, line, wall
    crosses = do.let("crosses", (ex * py - ey * px - turn) * (ex * qy - ey * qx - turn) < 0)
    of_a, of_b = do.let("a", dx * ay - dy * ax), do.let("b", dx * by - dy * bx)
    return crosses & (of_b >= moment) & (of_a < moment), crosses & (of_a >= moment) & (of_b < moment)


def winding(do: Operations, p: Point, wall: Any) -> tuple[Value, Value]:
    """Whether walls go up, and down, on the right of points."""
    (px, py), (_, ay, _, by, ex, ey, turn) = p, wall
    beside = do.let("beside", ex * py - ey * px - turn)
    return (ay <= py) & (by > py) & (beside > 0), (by <= py) & (ay > py) & (beside < 0)


def straight_length(do: Operations, p: Point, q: Point) -> Value:
    """Lengths of straight ways."""
    return length(do, [do.let("d", along - to) for along, to in zip(p, q, strict=True)], (0, 1))


def walls_with_sides(walls: Float[np.ndarray, "walls 4"]) -> Float[np.ndarray, "walls 7"]:
    """Walls in 32 bits, and of each what tells on which side of it points are."""
    ax, ay, bx, by = walls.astype(np.float32).T
    ex, ey = bx - ax, by - ay
    return np.stack([ax, ay, bx, by, ex, ey, ex * ay - ey * ax], axis=1)


def seen_corners(stored: Stored) -> Float[np.ndarray, "corners 2"]:
    """The corners, those whose walls do not move back a little before them, or what is rounded would hide them."""
    distance = 1.25 * MARGIN * float(stored.domain.width.max())  # farther than a contact's walls move
    moved = stored.outline.moved_points(-distance)[stored.corner]
    return np.where(stored.outline.stays[stored.corner, None], moved, stored.points)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What ways are among.

    Attributes:
        walls: Walls, counted from the middle of the domain, as :func:`walls_with_sides` has them.
        corners: Corners likewise, and last one of ``inf``.
        is_certain: Whether what counts as a way is certainly free.
    """

    walls: Float[np.ndarray, "walls 7"]
    corners: Float[np.ndarray, "corners 2"]
    is_certain: bool

    def hides(self, p: Float[np.ndarray, "n 2"], q: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether walls are between points."""
        hidden, step = np.zeros(len(p), bool), max(1, _AT_ONCE // max(1, len(self.walls)))
        for first in range(0, len(p), step):
            a, b = (list(end[first : first + step].T[:, :, None]) for end in (p, q))
            crossed = crossings(ARRAYS, a, b, straight_line_of(ARRAYS, a, b), list(self.walls.T))
            goes_in, goes_out = (each.any(axis=1) for each in crossed)
            hidden[first : first + step] = goes_in | goes_out if self.is_certain else goes_in & goes_out
        return hidden

    def encloses(self, p: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether points are inside the walls."""
        inside, step = np.zeros(len(p), bool), max(1, _AT_ONCE // max(1, len(self.walls)))
        for first in range(0, len(p), step):
            up, down = winding(ARRAYS, list(p[first : first + step].T[:, :, None]), list(self.walls.T))
            inside[first : first + step] = up.sum(axis=1) - down.sum(axis=1) == 1
        return inside


class NumpyPairs:
    """Pairs that are asked in NumPy: what ``pairs.numpy()`` gives.

    The arithmetic is that of the description of this module, which :meth:`PairPLR.js_module` keeps to as well.
    """

    def __init__(self, stored: Stored) -> None:
        """Of what a file holds."""
        domain, middle = stored.domain, (stored.domain.lo + stored.domain.hi) / 2
        width, half = float(domain.width.max()), domain.width / 2
        self.domain, self._middle = domain, middle
        frame = frame_of(Box(domain.lo - middle, domain.hi - middle))
        self._axes, self._ends = partitioned_axes(frame), frame[Frame.HI]
        count, corners = len(stored.cells), len(stored.corner)
        self._leaves = LeafTable.of(CodedTree.of(stored.levels, 2, np.arange(count)))
        lengths = np.bincount(stored.leaf, minlength=count)
        self._lists = np.full((count, max(1, lengths.max(initial=0))), corners)
        self._lists[runs(lengths)] = stored.listed
        seen, proud = seen_corners(stored), stored.outline.moved_points(-2 * RECEDING * width)[stored.corner]
        self._seen, self._free = (
            Surroundings(
                walls_with_sides(stored.outline.moved_walls(back * RECEDING * width) - np.tile(middle, 2)),
                np.append(points - middle, [[np.inf, np.inf]], axis=0).astype(np.float32),
                back < 0,
            )
            for back, points in ((1.0, seen), (-1.0, proud))
        )
        self._distances = distances_table(stored, corners + 1)
        aside, farther = (
            2 * np.linalg.norm(points - stored.points, axis=1).max(initial=0.0) for points in (seen, proud)
        )
        rounds = _ROUNDINGS * float((half + np.abs(middle)).max())
        self._less, self._more = (np.float32(stored.rounding + each + rounds) for each in (aside, farther))

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Any:
        """Distance between points.

        Args:
            x: Points, ``(..., 2)``.
            y: Points, of a shape that broadcasts with that of ``x``.

        Returns:
            Distances, ``(...)``, float32: ``inf`` outside the domain and where no path joins the points, NaN where a
            coordinate is. ``f(x, y) == f(y, x)``, to the bit.

        Raises:
            ValueError: If points are not real numbers of two coordinates, or do not broadcast.
        """
        return self._answered(x, y, lambda p, q: self._lengths(self._seen, p, q)[:, None])[..., 0][()]

    def bounds(self, x: ArrayLike, y: ArrayLike) -> tuple[Any, Any]:
        """Proven bounds of the distance between points of free space, as :meth:`PairPLR.bounds`.

        Args:
            x: Points, as for a call.
            y: Points.

        Returns:
            Lower and upper bounds, ``(...)`` each, float32.

        Raises:
            ValueError: As for a call.
        """
        bounds = self._answered(x, y, self._bounds)
        return bounds[..., 0][()], bounds[..., 1][()]

    def _answered(self, x: ArrayLike, y: ArrayLike, answer: Callable[..., np.ndarray]) -> np.ndarray:
        """Answers to pairs of points, part by part."""
        x, y = (as_float_points(each, 2).astype(np.float64, copy=False) for each in (x, y))
        try:
            x, y = np.broadcast_arrays(x, y)
        except ValueError:
            raise ValueError(f"x and y must broadcast, got shapes {x.shape} and {y.shape}.") from None
        with np.errstate(over="ignore", invalid="ignore"):
            p, q = ((each.reshape(-1, 2) - self._middle).astype(np.float32) for each in (x, y))
            farthest = np.maximum(np.abs(p), np.abs(q))
            outside = np.where((farthest > self._ends).any(axis=1), np.float32(np.inf), np.float32(0))
            outside = np.where(np.isnan(farthest).any(axis=1), np.float32(np.nan), outside)
            swaps = ((p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1])))[:, None]
            p, q = np.where(swaps, q, p), np.where(swaps, p, q)
            parts = [np.zeros((0, 2), np.float32)[:, : answer(p[:0], q[:0]).shape[1]]]
            for first in range(0, len(p), _PAIRS):
                part = slice(first, first + _PAIRS)
                inside, beyond = np.flatnonzero(outside[part] == 0), outside[part, None]
                answers = np.repeat(beyond, parts[0].shape[1], axis=1)
                answers[inside] = answer(p[part][inside], q[part][inside])
                parts.append(answers)
        answers = np.concatenate(parts)
        return answers.reshape(*x.shape[:-1], answers.shape[1])

    def _bounds(self, p: Float[np.ndarray, "n 2"], q: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        lower = np.maximum(_SHRUNK * self._lengths(self._seen, p, q) - self._less, np.float32(0))
        is_clear = self._free.encloses(p) & self._free.encloses(q)
        upper = _STRETCHED * np.where(is_clear, self._lengths(self._free, p, q), np.float32(np.inf)) + self._more
        return np.stack([lower, upper], axis=1)

    def _lengths(
        self, around: Surroundings, p: Float[np.ndarray, "n 2"], q: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n"]:
        """Lengths of shortest ways among what is around."""
        lengths = straight_length(ARRAYS, list(p.T), list(q.T))
        hidden = np.flatnonzero(around.hides(p, q))
        p, q = p[hidden], q[hidden]
        (of_p, legs_p), (of_q, legs_q) = (self._legs(around, each) for each in (p, q))
        ways = legs_p[:, :, None] + (legs_q[:, None] + self._distances[of_p[:, :, None], of_q[:, None]])
        shortest, open_ = np.full(len(p), np.inf, np.float32), np.arange(len(p))
        while len(open_):  # strike corners off that a point does not see, of the shortest ways first
            i, j = np.divmod(ways[open_].reshape(len(open_), -1).argmin(axis=1), of_q.shape[1])
            length = ways[open_, i, j]
            hidden_p = around.hides(p[open_], around.corners[of_p[open_, i]])
            hidden_q = around.hides(q[open_], around.corners[of_q[open_, j]])
            ways[open_[hidden_p], i[hidden_p]] = np.inf
            ways[open_[hidden_q], :, j[hidden_q]] = np.inf
            is_done = (length == np.inf) | ~(hidden_p | hidden_q)
            shortest[open_[is_done]] = length[is_done]
            open_ = open_[~is_done]
        lengths[hidden] = shortest
        return lengths

    def _legs(
        self, around: Surroundings, p: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, "n longest"], Float[np.ndarray, "n longest"]]:
        """The corners that points' leaves list, and how far they are."""
        places = [axis.place(ARRAYS, axis.above(along)) for axis, along in zip(self._axes, p.T, strict=True)]
        listed = self._lists[self._leaves.rows(places)]
        corners = around.corners[listed]
        return listed, straight_length(ARRAYS, list(p.T[:, :, None]), [corners[..., 0], corners[..., 1]])
