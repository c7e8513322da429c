"""A hand-written Numba loop over the very tables that a PLR's query reads: what compiled code can do with them."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax import PLR
from plr_jax.plr.frame import Frame
from plr_jax.plr.tables import Tables

_FRACTION_BITS = 23  # of a 32-bit float
_POINTS_A_TASK = 2**14

Loop = Callable[[Float[np.ndarray, "n dim"]], Float[np.ndarray, " n"]]
Kernel = Callable[..., None]
"""A compiled loop of the points, their values to be written, the blocks' words, the leaves of slots, the planes."""


def numba_loop(plr: PLR, parallel: bool) -> Loop:
    """A function of float32 points that answers what the PLR answers, in one compiled loop over the points.

    Args:
        plr: The PLR.
        parallel: Whether the points are shared out among all cores (``prange``).
    """
    import numba

    tables = plr.tables
    kernel = _kernel(plr)
    words = (
        np.empty((0, 0), np.uint32)
        if tables.blocks is None
        else np.stack([np.asarray(word) for word in tables.blocks.words])
    )
    leaf_of_slot, planes = np.asarray(tables.leaf_of_slot), np.asarray(tables.leaf_parameters).reshape(-1)

    @numba.njit
    def serial(x, words, leaf_of_slot, planes):
        values = np.empty(len(x), np.float32)
        kernel(x, values, words, leaf_of_slot, planes)
        return values

    # One ``prange`` over points would keep the compiler from vectorizing the loop; tasks of many points do not.
    @numba.njit(parallel=True)
    def shared_out(x, words, leaf_of_slot, planes):
        values = np.empty(len(x), np.float32)
        for task in numba.prange((len(x) + _POINTS_A_TASK - 1) // _POINTS_A_TASK):
            part = slice(task * _POINTS_A_TASK, (task + 1) * _POINTS_A_TASK)
            kernel(x[part], values[part], words, leaf_of_slot, planes)
        return values

    loop = shared_out if parallel else serial
    return lambda x: loop(x, words, leaf_of_slot, planes)


@lru_cache(maxsize=1)
def _kernel(plr: PLR) -> Kernel:
    """The loop over a PLR's table, compiled once for one core and for all."""
    return _flat_kernel(plr.tables) if plr.tables.blocks is None else _two_level_kernel(plr.tables)


def _flat_kernel(tables: Tables) -> Kernel:
    """The loop over a flat table.

    Sizes, shifts and masks are constants to the compiler, so that loops over the axes are unrolled. Masked indices
    are safe for any point, NaN included.
    """
    import numba

    dim, place, value_of = tables.dim, _place(tables), _value_of(tables)
    mask, right = _block_bits(tables)

    @numba.njit(error_model="numpy", fastmath={"contract"})
    def kernel(x, values, words, leaf_of_slot, planes):
        for i in range(len(x)):
            slot = np.int32(0)
            for axis in range(dim):
                slot |= (place(x[i, axis], axis) & mask[axis]) >> right[axis]
            values[i] = value_of(x, i, leaf_of_slot[np.uint32(slot)], planes)

    return kernel


def _two_level_kernel(tables: Tables) -> Kernel:
    """The loop over a table of blocks and the blocks' own tables."""
    import numba

    dim, place, value_of = tables.dim, _place(tables), _value_of(tables)
    mask, right = _block_bits(tables)
    blocks = tables.blocks
    assert blocks is not None
    word_of = tuple(np.repeat(np.arange(len(blocks.axes)), blocks.axes).tolist())
    at_bit = tuple(blocks.width * slot for axes in blocks.axes for slot in range(axes))
    start_bit, width_mask = blocks.axes[0] * blocks.width, 2**blocks.width - 1
    below = tuple(np.asarray(blocks.shift).tolist())

    @numba.njit(error_model="numpy", fastmath={"contract"})
    def kernel(x, values, words, leaf_of_slot, planes):
        for i in range(len(x)):
            block = np.int32(0)
            for axis in range(dim):
                block |= (place(x[i, axis], axis) & mask[axis]) >> right[axis]
            slot = np.int64(0)
            for axis in range(dim):
                bits = np.int64((words[word_of[axis], np.uint32(block)] >> at_bit[axis]) & width_mask)
                within = np.int64(place(x[i, axis], axis)) & ((1 << below[axis]) - 1)
                slot = (slot << bits) | (within >> (below[axis] - bits))
            slot += words[0, np.uint32(block)] >> start_bit
            values[i] = value_of(x, i, leaf_of_slot[np.uint64(slot)], planes)

    return kernel


def _place(tables: Tables) -> Callable[[Any, int], Any]:
    """A point's place along an axis, in units of ``2**-23`` of the domain's width."""
    import numba

    lo, start, scale = (_row(tables, row) for row in (Frame.LO, Frame.START, Frame.SCALE))
    largest, unit, one = np.float32(2 - 2.0**-_FRACTION_BITS), np.float32(2**_FRACTION_BITS), np.float32(1)

    @numba.njit(inline="always")
    def place(coordinate, axis):
        placed = (coordinate - lo[axis]) * scale[axis] + start[axis]
        return np.int32((min(placed, largest) - one) * unit)

    return place


def _block_bits(tables: Tables) -> tuple[tuple[int, ...], tuple[int, ...]]:
    mask, right = np.asarray(tables.bits).astype(np.int32)
    return tuple(mask), tuple(right)


def _row(tables: Tables, row: Frame) -> tuple[np.float32, ...]:
    return tuple(np.asarray(tables.frame)[row])


def _value_of(tables: Tables) -> Callable[[Any, int, Any, Any], Any]:
    """Value of a leaf's plane at a point; ``inf`` outside the domain, and for NaN, which the PLR would pass on."""
    import numba

    dim, infinite = tables.dim, np.float32(np.inf)
    lo, hi = _row(tables, Frame.LO), _row(tables, Frame.HI)
    a_leaf, a_term = (1, tables.leaf_parameters.shape[1]) if tables.leaf_parameters.ndim == 2 else (dim + 1, 1)

    @numba.njit(inline="always")
    def value_of(x, i, leaf, planes):
        at = np.uint32(leaf * a_leaf)
        value, inside = planes[at], True
        for axis in range(dim):
            above = x[i, axis] - lo[axis]
            value += planes[at + np.uint32((axis + 1) * a_term)] * above
            inside &= (above >= 0) & (x[i, axis] <= hi[axis])
        return value if inside else infinite

    return value_of
