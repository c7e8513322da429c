"""Fast tests of whether obstacles hide points from each other, for the queries of a PairPLR in ``query.py``.

- :class:`NearWalls` tests a point and a corner. A leaf of the partition lists the corners where paths from its points
  may turn first. Only the few walls between the leaf and such a corner can hide the corner. :func:`near_entries`
  finds these walls, first for runs of neighbor leaves, then for ever shorter runs: a wall that is not between a large
  box and a corner is not between a part of the box and the corner.
- :func:`updated` recomputes only some rows of an array, in batches.
"""

from collections.abc import Callable
from dataclasses import field
from functools import reduce
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.export import is_symbolic_dim
from jaxtyping import Array, Bool, Float, Int, UInt32

from plr_jax._arrays import padded, parts, ragged_indices, size_in_eighths, take_ragged
from plr_jax._compiled import pytree
from plr_jax.pairs.portable import crossings

_RUN = 4  # neighbor leaves, or runs of them, that are combined into a longer run
_STEP = 4  # the number of walls read for every entry is a multiple of this: fewer functions are compiled
_SHORT = 4  # walls of an entry that are tested first; few entries have more
_LONG = np.uint32(2**31)  # added to the first wall of an entry that has more
_FEW_ROWS = 2**6  # rows tested against all walls of their entries
_NUM_BATCHES = 16  # more rows are tested in batches of at least this part of them
_COST = 4  # testing a wall that each point reads for itself takes as long as testing 4 walls that all points share
_AT_ONCE = 2**15  # pairs of a list entry and a wall tested together
_BLOCK = 2**20  # pairs of a corner and a wall handled together
_MOST_TESTS = 2**25  # tests of a block of walls in one round
_MOST_PAIRS = 2**24  # pairs of a list entry and a near wall that fit into memory

State = TypeVar("State")
Points = Float[Array, "n 2"]
Rows = UInt32[Array, "n"]
Flags = Bool[Array, "n"]
Boxes = tuple[Float[np.ndarray, "leaves 2"], Float[np.ndarray, "leaves 2"]]  # lower and upper corners
Corners = Float[np.ndarray, "corners 2"]
Walls = Float[np.ndarray, "walls 4"]
Entries = Int[np.ndarray, "entries"]  # a number for each list entry: a leaf, and a corner that the leaf lists
EntryPoints = Float[np.ndarray, "entries 2"]
Hulls = tuple[EntryPoints, EntryPoints, EntryPoints]  # each is the convex hull of a box (two corners) and a point
Pairs = Int[np.ndarray, "pairs"]  # a number for each pair
_Shape = tuple[int, int]
NearPairs = tuple[Int[np.ndarray, " near"], Int[np.ndarray, " near"]]  # list entries, and a wall near each


@pytree
class NearWalls:
    """For each leaf (a box of the domain) and each corner that it lists, the walls that may hide the corner."""

    # Both ends (ax, ay, bx, by) of walls: the walls of the first list entry, of the second one, and so on. Entries
    # are sorted by leaf; `first[leaf, place]` is the index of the first wall of the leaf's corner at this place.
    ends: Float[Array, "4 walls"]
    first: UInt32[Array, "leaves longest"]  # plus 2**31 if the entry has more than 4 walls
    # Walls that queries read for every entry. For most entries these include walls of the next entries, which do no
    # harm: any wall may be tested.
    most: int = field(metadata={"static": True})

    @staticmethod
    def of(
        boxes: Boxes, leaf: Entries, listed: Entries, corners: Corners, walls: Walls, margin: float, shape: _Shape
    ) -> "NearWalls | None":
        """Find the walls that may hide each listed corner from points of its leaf; None if they are too many.

        Entry ``i`` says that leaf ``leaf[i]`` lists corner ``listed[i]``; both are indices, and leaves ascend. A wall
        may hide the corner if it is within ``margin`` of the convex hull of the leaf and the corner. ``shape`` is the
        shape of the attribute ``first``: leaves, and places in their lists.
        """
        # For each entry, a query reads as many walls as the longest list has. A wall that a point reads for itself
        # takes `_COST` times as long as a wall that all points share. So no time is saved if the longest list has
        # more than len(walls) / `_COST` walls.
        most_worthwhile = len(walls) // _COST // _STEP * _STEP
        if (near := near_entries(boxes, leaf, listed, corners, walls, margin, most_worthwhile)) is None:
            return None
        entry, wall = near
        counts = np.bincount(entry, minlength=len(leaf))
        most = -(-int(counts.max(initial=1)) // _STEP) * _STEP
        first = np.zeros(shape, np.uint32)
        packed = np.cumsum(counts) - counts + np.where(counts > _SHORT, _LONG, 0)
        first[ragged_indices(np.bincount(leaf, minlength=shape[0]))] = packed  # at (leaf, place in its list)
        # The last entries read `most` walls, past the last wall: the padding has walls of length 0, which nothing
        # crosses.
        ends = padded(walls[wall].astype(np.float32), size_in_eighths(len(wall) + most))
        return NearWalls(jax.device_put(np.ascontiguousarray(ends.T)), jax.device_put(first), most)

    def hide(self, leaf: Rows, place: Rows, x: Points, corner: Points) -> Flags:
        """Return whether walls hide a corner from each point ``x[i]`` of leaf ``leaf[i]``.

        The corner is at ``corner[i]``, and is number ``place[i]`` in the leaf's list of corners.
        """
        # The first walls decide most rows. The others are tested against all walls of their entries, in batches.
        packed, size = self.first[leaf, place], x.shape[0]
        first, is_long = packed % _LONG, packed >= _LONG
        if self.most <= _SHORT or is_symbolic_dim(size) or size <= _FEW_ROWS:
            return self._are_crossed(self.most, first, x, corner)
        hidden = self._are_crossed(_SHORT, first, x, corner)

        def test_all_walls(_: Any, *rows: Any) -> Flags:
            return self._are_crossed(self.most, *rows)

        return updated(hidden, is_long & ~hidden, size // _NUM_BATCHES, test_all_walls, first, x, corner)

    def _are_crossed(self, most: int, first: Rows, x: Points, corner: Points) -> Flags:
        # Walls have moved a little into their obstacles, with free space on their left. So a line of sight through an
        # obstacle crosses one wall into it and one wall out of it. A single crossing is due to rounding, or to a thin
        # obstacle (see `is_hidden` in `query.py`).
        along = jnp.arange(most, dtype=jnp.uint32)[None]
        walls = tuple(row.at[first[:, None] + along].get(mode="promise_in_bounds") for row in self.ends)
        inward, outward = crossings(x.T[:, :, None], corner.T[:, :, None], walls)
        return inward.any(axis=1) & outward.any(axis=1)


def updated(
    state: State, is_open: Flags, size: int, update: Callable[..., State], *columns: Any, leaves_rest: bool = False
) -> State:
    """Replace the rows of ``state``, a tree of arrays, where ``is_open`` is true, in batches of ``size`` rows.

    ``update`` maps rows of ``state``, and the same rows of the arrays ``columns``, to new rows of ``state``. With
    ``leaves_rest``, the last batch is left out if it has fewer than ``size`` rows and is not the only batch.
    """
    # 1. Pack flags into words. Bit b of word w tells whether row b * len(words) + w is open. With 3 words, rows are
    #
    #              word 0   word 1   word 2      The *rank* of an open row is its number among the open rows, counted
    #       bit 0     0        1        2        word by word, in each word from the lowest bit.
    #       bit 1     3        4        5
    bits = jnp.pad(is_open, (0, -len(is_open) % 32)).reshape(32, -1).astype(jnp.uint32)
    words = reduce(jnp.bitwise_or, (row << np.uint32(bit) for bit, row in enumerate(bits)))
    ends = jnp.cumsum(jax.lax.population_count(words))  # number of open rows up to each word

    # 2. Update batch after batch, the rows of ranks `done * size`, `done * size + 1`, ...
    def next_rows(done: Array, state: State) -> State:
        # Find the word of each row, by its rank, then the bit, by its rank in the word: bisection over the bits. If
        # the lower half of the bits has too few open rows, go on with the upper half.
        rank = done * size + jnp.arange(size, dtype=jnp.uint32)
        row = jnp.searchsorted(ends, rank, side="right").astype(jnp.uint32)
        word = words.at[row].get(mode="clip")
        rank -= ends.at[row].get(mode="clip") - jax.lax.population_count(word)
        row = jnp.where(row < len(words), row, len(is_open))  # past the end if fewer are left
        for half in (16, 8, 4, 2, 1):
            below = jax.lax.population_count(word & np.uint32(2**half - 1))
            is_above = rank >= below
            rank = jnp.where(is_above, rank - below, rank)
            word = jnp.where(is_above, word >> np.uint32(half), word)
            row = jnp.where(is_above, row + half * len(words), row)
        new_rows = update(*jax.tree.map(lambda column: column.at[row].get(mode="clip"), (state, *columns)))
        return jax.tree.map(lambda old, new: old.at[row].set(new, mode="drop", unique_indices=True), state, new_rows)

    num_batches = (ends[-1] + np.uint32(size - 1)) // np.uint32(size)
    if leaves_rest:
        num_batches = jnp.minimum(num_batches, jnp.maximum(ends[-1] // np.uint32(size), 1))
    return jax.lax.fori_loop(jnp.uint32(0), num_batches, next_rows, state)


def near_entries(
    boxes: Boxes, leaf: Entries, listed: Entries, corners: Corners, walls: Walls, margin: float, most: int
) -> NearPairs | None:
    """Find the walls near the convex hull of a leaf's box and a corner, for each corner that the leaf lists.

    Entry ``i`` says that leaf ``leaf[i]`` lists corner ``listed[i]``. Return pairs of an entry and a wall, as
    indices. No wall within ``margin`` of the hull is missing; a few walls are farther away. The result is None if an
    entry has more than ``most`` walls, or all pairs take too much memory.
    """
    # Leaves ascend in `leaf`, entries in the result. A few of the walls found are farther away. Corners are handled
    # in blocks, to save memory.
    near_pairs, count = [np.zeros((2, 0), np.int32)], 0
    for block in parts(np.full(len(corners), len(walls)), _BLOCK):  # slices of corners
        entries = np.flatnonzero((listed >= block.start) & (listed < block.stop))
        corner = listed[entries]
        near = _near_entries(boxes, leaf[entries], corner - block.start, corners[corner], walls, margin)
        if near is None or np.bincount(near[0]).max(initial=0) > most or count + len(near[0]) > _MOST_PAIRS:
            return None
        count += len(near[0])
        near_pairs.append(np.stack([entries[near[0]].astype(np.int32), near[1]]))
    entry, wall = np.concatenate(near_pairs, axis=1)
    order = np.argsort(entry, kind="stable")
    return entry[order], wall[order]


def _near_entries(
    boxes: Boxes, leaf: Entries, corner: Entries, point: EntryPoints, walls: Walls, margin: float
) -> NearPairs | None:
    # Entry `i` is a corner at `point[i]`, with the index `corner[i]`, of the list of leaf `leaf[i]`. Leaves at
    # neighbor indices are near one another. So first find the walls near runs of four leaves, by recursion; only
    # these walls are candidates for each leaf of a run. Pairs are returned in the order of entries.
    #
    # `boxes` are leaves in the first call, then runs of 4, 16, ... leaves; "leaf" below stands for any of them.
    #
    #     leaves    0  1  2  3 |  4  5  6  7 | ...    entry:      (leaf, corner), if the leaf lists the corner
    #     runs           0     |       1     | ...    run entry:  (run, corner), if a leaf of the run lists the corner
    #
    # A wall that is not near a run entry is near none of its entries.
    #
    # 1. Find the candidates of each entry.
    lo, hi = boxes
    if len(lo) == 1:  # all walls, for all entries
        first, candidates = np.array([0, len(walls)]), np.arange(len(walls), dtype=np.int32)
        run_entry = np.zeros(len(leaf), np.int64)
    else:
        # Run entries are the entries of the recursion. `heads` holds one entry of each run entry, and `run_entry` the
        # run entry of each entry.
        begin = np.arange(0, len(lo), _RUN)
        runs = np.minimum.reduceat(lo, begin), np.maximum.reduceat(hi, begin)
        key = leaf // _RUN * (corner.max(initial=0) + 1) + corner
        _, heads, run_entry = np.unique(key, return_index=True, return_inverse=True)
        if (near := _near_entries(runs, leaf[heads] // _RUN, corner[heads], point[heads], walls, margin)) is None:
            return None
        run_entries, candidates = near  # pairs, in the order of run entries
        first = np.searchsorted(run_entries, np.arange(len(heads) + 1))
    # 2. Test them. The candidates of entry `i` are `candidates[first[k] : first[k + 1]]` with `k = run_entry[i]`.
    tests = first[run_entry + 1] - first[run_entry]
    if tests.sum() > _MOST_TESTS:
        return None
    tested = np.flatnonzero(tests).astype(np.int32)
    near_pairs = [np.zeros((2, 0), np.int32)]
    for part in parts(tests[tested], _AT_ONCE):
        entries = tested[part]
        index, row = take_ragged(first, run_entry[entries])  # candidates, and the row in `entries` of their entry
        wall, box = candidates[index], leaf[entries]
        near = _near_pairs((lo[box], hi[box], point[entries]), row, walls, wall, margin)
        near_pairs.append(np.stack([entries[row[near]], wall[near]]))
    entry, wall = np.concatenate(near_pairs, axis=1)
    return entry, wall


def _near_pairs(hulls: Hulls, entry: Pairs, walls: Walls, wall: Pairs, margin: float) -> Int[np.ndarray, " near"]:
    """Return the indices ``k`` for which the hull of index ``entry[k]`` and the wall of index ``wall[k]`` are near.

    A hull is the convex hull of a leaf's box and a corner, given by the box's two corners and this corner. No pair
    within ``margin`` of one another is missing; a few pairs are farther apart.
    """
    # A wall is apart if an axis across a side of the hull or across the wall separates both by more than the margin.
    # Below, `u x v` is the cross product, positive if v is to the left of u.
    lo, hi, corner = hulls
    a, b = walls[:, :2], walls[:, 2:]
    # 1. Compare the bounding boxes: most are apart. Boxes meet if all four comparisons hold, four bytes of value 1.
    #    NumPy compares four bytes at once faster than it combines them.
    of_walls = np.concatenate([np.minimum(a, b), -np.maximum(a, b)], axis=1)
    of_hulls = np.concatenate([np.maximum(hi, corner) + margin, margin - np.minimum(lo, corner)], axis=1)
    meets = of_walls.take(wall, axis=0) <= of_hulls.take(entry, axis=0)
    pairs = np.flatnonzero(meets.view(np.uint32) == 0x01010101)
    # 2. Find the two lines from the corner c that touch the box.
    #
    #             l _________       l, r:  as seen from c, the leftmost and the rightmost corner of the box
    #            . |         |      d:     r - c for one line, c - l for the other, so that the hull is left of d
    #          .   |_________| r    least: minimum over the box's corners w of d x (w - c); 0 unless c is in the box
    #        c  .  .  .  .  '
    #
    #    Points p of the hull have d x p >= d x c + least. A wall is apart if both of its ends have less, by more than
    #    `reach`, by which d x p can change within the margin: d x p < limit = d x c + least - reach.
    #
    #    To find r, let w_i be the box's corners relative to c: cross[i, j] = w_i x w_j, (4, 4, n). No w_j is to the
    #    right of w_r, so the minimum of cross[r, j] over j is 0, for j = r. With c in the box, or by rounding, this
    #    minimum may be negative for all corners: take the corner for which it is largest. For l, change the signs.
    box_corners = np.stack([lo, np.stack([hi[:, 0], lo[:, 1]], axis=1), np.stack([lo[:, 0], hi[:, 1]], axis=1), hi])
    x, y = (box_corners - corner).transpose(2, 0, 1)
    cross = x[:, None] * y - y[:, None] * x
    lines = []
    for sign in (1, -1):  # touching r, touching l
        least = (sign * cross).min(axis=1)
        touched = least.argmax(axis=0), np.arange(len(lo))
        dx, dy = sign * x[touched], sign * y[touched]
        reach = margin * (np.abs(dx) + np.abs(dy))
        at_corner = dx * corner[:, 1] - dy * corner[:, 0]
        lines.append((dx, dy, least[touched] + at_corner - reach))
    # 3. Test the axis across the wall, with e = b - a: all of the hull has e x (p - a) > 0, or all of it < 0. In the
    #    box, this product is from middle - half to middle + half, here with the margin. Then test the axes across
    #    both lines.
    columns = np.stack([*((lo + hi) / 2).T, *((hi - lo) / 2).T, *corner.T, *lines[0], *lines[1]])
    middle_x, middle_y, half_x, half_y, cx, cy, *of_lines = columns.take(entry[pairs], axis=1)
    ax, ay, bx, by = walls.T.take(wall[pairs], axis=1)
    ex, ey = bx - ax, by - ay
    turn, size_x, size_y = ex * ay - ey * ax, np.abs(ex), np.abs(ey)
    middle, at_corner = ex * middle_y - ey * middle_x - turn, ex * cy - ey * cx - turn
    reach = margin * (size_x + size_y)
    half = size_x * half_y + size_y * half_x + reach
    is_apart = (np.minimum(middle - half, at_corner - reach) > 0) | (np.maximum(middle + half, at_corner + reach) < 0)
    for dx, dy, limit in (of_lines[:3], of_lines[3:]):
        is_apart |= np.maximum(dx * ay - dy * ax, dx * by - dy * bx) < limit
    return pairs[~is_apart]
