"""Any-angle shortest paths on a grid that JAX may trace; paths bend only at convex corners of blocked cells.

A segment of a path is tested against blocked cells row by row. Its ends are first moved into free cells, to a
:func:`margin` from the cells' sides. The part of the segment inside a row of cells is extended along the row by a
fourth of this margin at both ends. So a segment that grazes a corner may count as blocked; the path that bends at
this corner is equally long. Cells are bits of words, so that all cells of a row are tested at once.
"""

from collections.abc import Iterator
from functools import lru_cache, reduce
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32, UInt32

from plr_jax._compiled import pytree
from plr_jax.traced.corner_paths import Broadcast, CornerPaths, length_if_seen
from plr_jax.traced.steps import WORD, Mask, Points, Shape, Words, containing_cells, pack

# Each point, as the end of a segment, is stored as two points inside free cells: moved into the first, and into the
# last free one of up to four cells around it. Both are equal for a point with one free cell around it.
#      |         A segment from x to the right begins at the last point, a segment to the left at the first one
#    . x .       (`_end_facing`). So it begins in a free cell, and does not cross the border on which x lies.
#      |
Ends = Float[Array, "*batch 2 2"]
MOST_CORNERS = 2**12  # most corners of a map; the distances between so many take 64 MB
# If a grid has at most so many inner cell corners, each of them counts as a possible convex corner, and sight tests
# use tables of crossed cells. In larger grids, convex corners are listed: by default up to half of all corners.
MAX_LATTICE = 2**8


def margin(shape: Shape, dtype: Any) -> float:
    """Return the least distance, in cell widths, that :meth:`GridCorners.placed` keeps to the sides of a cell.

    The margin is 32 times the machine epsilon of ``dtype``, times the larger number in ``shape``.
    """
    return 32 * float(jnp.finfo(dtype).eps) * max(shape)


def is_unobstructed(blocked: Words, shape: Shape, a: Broadcast, b: Broadcast) -> Bool[Array, "..."]:
    """Return whether each segment from ``a`` to ``b`` crosses no cell of ``blocked``, a grid packed by :func:`pack`.

    The ends must be inside of cells, as :meth:`GridCorners.placed` returns them.
    """
    # In each row of cells, a segment crosses the columns from `first` to `last`. In a word of 32 columns these are
    # the bits from `begin` to `end`: all ones shifted up to `begin`, and those shifted down to `end`.
    #   begin = 2, end = 5:   ...11111100 & ...00111111 = ...00111100
    hit, all_ones = jnp.zeros((), jnp.uint32), jnp.uint32(0xFFFFFFFF)
    slack = margin(shape, a.dtype) / 4  # less than the margin: an extended segment stays in the cell where it ends
    for row, (first, last, is_crossed) in enumerate(_columns(jnp, shape, slack, a, b)):
        first, last = first.astype(jnp.int32), last.astype(jnp.int32)
        in_row = jnp.zeros((), jnp.uint32)
        for word in range(blocked.shape[1]):
            begin, end = first - WORD * word, last - WORD * word
            from_first = all_ones << jnp.clip(begin, 0, WORD - 1).astype(jnp.uint32)
            ones = from_first & (all_ones >> (WORD - 1 - jnp.clip(end, 0, WORD - 1)).astype(jnp.uint32))
            if blocked.shape[1] > 1:  # the interval may miss this word
                ones = jnp.where((begin < WORD) & (end >= 0), ones, jnp.uint32(0))
            in_row |= blocked[row, word] & ones
        hit |= jnp.where(is_crossed, in_row, jnp.uint32(0))
    return hit == 0


def _columns(xp: Any, shape: Shape, slack: float, a: Any, b: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Yield, for each row of cells, the first and last column of each segment, and whether the segment meets the row.

    Segments lead from ``a`` to ``b``. The part of a segment in the row is extended by ``slack`` columns at both ends.
    ``xp`` is NumPy or ``jax.numpy``.
    """
    # The segment is at y0 + t * dy, with t from 0 to 1. It crosses the line below row k at t = (k - y0) / dy, clipped
    # to [0, 1]: equal values at both lines of a row mean that the segment misses the row. A segment that goes down
    # crosses the upper line first.
    h, w = shape
    (x0, y0), (x1, y1) = (xp.moveaxis(point, -1, 0) for point in (a, b))
    dx, dy = x1 - x0, y1 - y0
    # A tiny slope for level segments makes all their length lie in their row.
    inverse = 1 / xp.where(dy == 0, 1e-30, dy)
    t_below = xp.clip(-y0 * inverse, 0, 1)
    x_below = x0 + dx * t_below
    for row in range(h):
        t_above = xp.clip((row + 1 - y0) * inverse, 0, 1)
        x_above = x0 + dx * t_above
        first = xp.clip(xp.floor(xp.minimum(x_below, x_above) - slack), 0, w - 1)
        last = xp.clip(xp.floor(xp.maximum(x_below, x_above) + slack), 0, w - 1)
        yield first, last, t_below != t_above
        t_below, x_below = t_above, x_above


def are_unobstructed(table: UInt32[np.ndarray, "words n m"], blocked: UInt32[Array, " words"]) -> Bool[Array, "n m"]:
    """Return which of ``n x m`` segments cross no blocked cell.

    ``table`` has the cells that each segment crosses, as packed bits (see :func:`crossed_cells`); ``blocked`` has the
    blocked cells in the same form.
    """
    return reduce(jnp.bitwise_or, (crossed & word for crossed, word in zip(table, blocked, strict=True))) == 0


@lru_cache(maxsize=8)
def lattice(shape: Shape) -> Float[np.ndarray, "corners 2"]:
    """Return the points ``(x, y)`` inside the grid at which four cells meet, row by row."""
    return cell_centers((shape[0] - 1, shape[1] - 1)) + 0.5


def cell_centers(shape: Shape) -> Float[np.ndarray, "cells 2"]:
    """Return the centers ``(x, y)`` of all cells, row by row."""
    rows, columns = np.indices(shape).reshape(2, -1)
    return np.stack([columns, rows], axis=1) + 0.5


@lru_cache(maxsize=16)
def crossed_cells(shape: Shape, from_centers: bool) -> UInt32[np.ndarray, "words n corners"]:
    """Return a table of the cells that segments cross, as packed bits.

    The segments end at each inner corner of the grid (see :func:`lattice`). They start at each inner corner, or with
    ``from_centers`` at each cell's center.

    A segment through a third corner counts as crossing all four cells there. If one of these cells is blocked, a path
    that bends at this corner is equally long. A segment along a grid line counts as crossing only the cells on its
    left. So two corners on the line see each other if the segment is free in one of its two directions.

    Number the cells row by row, ``row * columns + column``. Cell ``32 * w + i`` is bit ``i`` of the word at
    ``[w, start, end]``.
    """
    # The ends move towards each other by a small share, the nudge, of the segment's length:
    #   +---+---b---+       The cells below and left of a, and above and right of b, do not count as crossed. A corner
    #   |   |  /|   |       in between is within the slack of `_columns`, a thousandth of the nudge, of all its cells.
    #   +---+-/-+---+       If the segment is level or upright, both ends also move to its left, into the cells there.
    #   |   |/  |   |
    #   +---a---+---+
    a = (cell_centers(shape) if from_centers else lattice(shape))[:, None]
    b = lattice(shape)[None]
    along = b - a
    # Turned left by 90 degrees, or 0 for slanted segments: only level and upright segments move to their left.
    left = np.where((along == 0).any(axis=-1, keepdims=True), along[..., ::-1] * [-1, 1], 0)
    nudge = 1e-3 / max(shape)
    a, b = a + nudge * (along + left), b - nudge * (along - left)
    # Bits of cells, `(n, corners, h, w)`, then packed into words.
    bits = np.zeros((*along.shape[:2], *shape), bool)
    for row, (first, last, is_crossed) in enumerate(_columns(np, shape, nudge / 1e3, a, b)):
        column = np.arange(shape[1])
        bits[:, :, row] = (first[..., None] <= column) & (column <= last[..., None]) & is_crossed[..., None]
    flat = bits.reshape(*along.shape[:2], -1)
    flat = np.pad(flat, ((0, 0), (0, 0), (0, -flat.shape[2] % WORD)))
    words = np.packbits(flat, axis=2, bitorder="little").view("<u4")
    return np.ascontiguousarray(np.moveaxis(words, 2, 0)).astype(np.uint32)


def _end_facing(ends: Float[Array, "*#batch 2 2"], x: Broadcast) -> Float[Array, "... 2"]:
    # Return the end, of each pair of `Ends`, that lies towards x.
    first, second = ends[..., 0, :], ends[..., 1, :]
    is_second = jnp.sum((x - (first + second) / 2) * (second - first), axis=-1) > 0
    return jnp.where(is_second[..., None], second, first)


@pytree
class GridCorners:
    """The convex corners of a grid: cell corners with exactly one blocked cell around them, where paths can bend."""

    free: Bool[Array, "*maps h w"]  # padded to two rows and columns or more
    index: Int32[Array, "*maps corners"]  # index of each corner in :func:`lattice`
    is_convex: Bool[Array, "*maps corners"]  # False for padding

    @property
    def _is_lattice(self) -> bool:
        # ``index`` lists all inner cell corners of the grid, few enough for the tables of ``crossed_cells``.
        return len(self.index) <= MAX_LATTICE and len(self.index) == len(lattice(self.free.shape))

    def points(self, dtype: jnp.dtype) -> Float[Array, "corners 2"]:
        corners = jnp.asarray(lattice(self.free.shape), dtype)
        return corners if self._is_lattice else corners[self.index]

    def _inset_points(self, dtype: jnp.dtype) -> Float[Array, "corners 2"]:
        """Return, for each corner, a close point inside the cell opposite to the blocked cell, for tests of sight."""
        #   +---+---+    A corner (o) with one blocked cell (#) around it. Along each axis, blocked cells before it
        #   |   | x |    minus blocked cells after it, summed over both rows or columns, are 1 or -1: the direction
        #   +---o---+    `away` from the blocked cell to x. Here both are 1. Corners that are not convex may have the
        #   | # |   |    sum 0; any point inside a cell will do for them.
        #   +---+---+
        blocked = (~self.free).astype(dtype)
        along_x, along_y = blocked[:, :-1] - blocked[:, 1:], blocked[:-1] - blocked[1:]
        away = along_x[:-1] + along_x[1:], along_y[:, :-1] + along_y[:, 1:]
        away = jnp.where(jnp.stack(away, axis=-1) < 0, -1, 1).reshape(-1, 2)[self.index]
        return self.points(dtype) + margin(self.free.shape, dtype) * away.astype(dtype)

    def _are_free(self, a: Broadcast, b: Broadcast) -> Bool[Array, "..."]:
        return is_unobstructed(pack(~self.free), self.free.shape, a, b)

    def placed(self, x: Points) -> tuple[Ends, Bool[Array, "*batch"]]:
        """Move each point into two free cells around it: the first and the last of up to four cells.

        Both cells are the same if only one is free. Return the moved points, ``(..., 2, 2)``, and whether the point
        is in the grid and has a free cell around it.
        """
        (rows, columns), is_inside = containing_cells(self.free.shape, x)
        is_free, cells = self.free[rows, columns], jnp.stack([columns, rows], axis=-1)
        which = jnp.stack([is_free.argmax(axis=0), 3 - is_free[::-1].argmax(axis=0)])  # first and last free cell
        cell = jnp.moveaxis(jnp.take_along_axis(cells, which[..., None], axis=0), 0, -2).astype(x.dtype)
        inset = margin(self.free.shape, x.dtype)
        return jnp.clip(x[..., None, :], cell + inset, cell + 1 - inset), is_inside & is_free.any(axis=0)

    def see_each_other(self, a: Float[Array, "*#batch 2 2"], b: Float[Array, "*#batch 2 2"]) -> Bool[Array, "..."]:
        return self._are_free(_end_facing(a, b.mean(axis=-2)), _end_facing(b, a.mean(axis=-2)))

    def seen_from(self, ends: Ends) -> Bool[Array, "n corners"]:
        corners = self._inset_points(ends.dtype)[None]
        return self._are_free(_end_facing(ends[:, None], corners), corners)

    def seen_from_centers(self, dtype: jnp.dtype) -> Bool[Array, "cells corners"]:
        if self._is_lattice:
            table = crossed_cells(self.free.shape, from_centers=True)
            return are_unobstructed(table, pack(~self.free.reshape(1, -1))[0])
        return self.seen_from(self.placed(jnp.asarray(cell_centers(self.free.shape), dtype))[0])

    def lengths(self, dtype: jnp.dtype) -> Float[Array, "corners corners"]:
        """Return the matrix of distances between convex corners that see each other; ``inf`` for all other pairs."""
        if self._is_lattice:
            # Entry (i, j) of the table holds the cells on the left of grid lines on the way from i to j. On the way
            # from j to i, the left is the other side.
            crossed = crossed_cells(self.free.shape, from_centers=False)
            blocked = pack(~self.free.reshape(1, -1))[0]
            seen = are_unobstructed(crossed, blocked) | are_unobstructed(crossed.swapaxes(1, 2), blocked)
        else:
            inset = self._inset_points(dtype)
            seen = self._are_free(inset[:, None], inset[None])
        seen &= self.is_convex[None] & self.is_convex[:, None] & ~jnp.eye(len(self.index), dtype=bool)
        points = self.points(dtype)
        return length_if_seen(seen, points[:, None], points[None])


def convex_corners(free: Mask, count: int) -> tuple[GridCorners, Bool[Array, ""]]:
    """Return up to ``count`` convex corners of blocked cells, and whether these are all convex corners of the map."""
    # Pad to at least two rows and columns, so that there is a lattice corner; cells beyond the grid are blocked.
    free = jnp.pad(free, ((0, int(free.shape[0] == 1)), (0, int(free.shape[1] == 1))))
    around = jnp.stack([free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:]]).reshape(4, -1)
    is_convex = jnp.sum(~around, axis=0) == 1
    if count >= is_convex.size:
        return GridCorners(free, jnp.arange(is_convex.size, dtype=jnp.int32), is_convex), jnp.array(True)
    index = jnp.nonzero(is_convex, size=count, fill_value=0)[0].astype(jnp.int32)
    num_convex = is_convex.sum()
    return GridCorners(free, index, jnp.arange(count) < num_convex), num_convex <= count


@pytree
class GridPaths(CornerPaths):
    """Shortest paths to one goal on a grid."""

    corners: GridCorners

    def cells(self) -> Float[Array, "h w"]:
        # Return the distances from the centers of all cells, also of cells that pad the grid (`convex_corners`).
        x = jnp.asarray(cell_centers(self.corners.free.shape), self.goals.dtype)
        seen = self.corners.seen_from_centers(x.dtype)
        return self.distance_given_sight(x, self.corners.placed(x), seen).reshape(self.corners.free.shape)
