"""Which points of a traced grid see each other: cells that straight segments cross, row by row, as bits.

Segments run between points inside free cells, which are kept :func:`margin` from the sides of these, and count as
crossing what they pass within a fourth of that. So a segment that grazes a corner of a blocked cell may count as
crossing it: a path by way of that corner is as long. None passes where two blocked cells touch.

For ends that do not depend on the map, centers of cells and corners of cells, the bits are found once, on the host.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32, UInt32

from plr_jax.traced.bits import WORD, Mask, Shape, Words, packed

Points = Float[Array, "*batch 2"]
Broadcast = Float[Array, "*#batch 2"]
Ends = Float[Array, "*batch 2 2"]
Cells = tuple[Int32[Array, "*batch"], ...]


def margin(shape: Shape, dtype: Any) -> float:
    """How far points are kept from the sides of cells: 32 units in the last place of the largest coordinate."""
    return 32 * float(jnp.finfo(dtype).eps) * max(shape)


def free_cells(free: Mask, x: Points) -> tuple[Cells, Cells, Bool[Array, "*batch"]]:
    """Rows and columns of two free cells that hold points, sides included, and whether there is any.

    They are the lowest and the highest: where free cells touch in a point, and blocked ones as well, both of them.
    """
    size = jnp.broadcast_to(jnp.array(free.shape[::-1], x.dtype), x.shape)
    clipped = jnp.clip(x, 0, size)
    upper = jnp.minimum(jnp.floor(clipped), size - 1).astype(jnp.int32)
    lower = jnp.maximum(jnp.ceil(clipped) - 1, 0).astype(jnp.int32)
    lowest = highest = upper[..., 1], upper[..., 0]
    is_free = jnp.zeros(x.shape[:-1], bool)
    for cell in product((lower[..., 1], upper[..., 1]), (lower[..., 0], upper[..., 0])):
        here = free[cell]
        lowest = tuple(jnp.where(here & ~is_free, new, old) for new, old in zip(cell, lowest, strict=True))
        highest = tuple(jnp.where(here, new, old) for new, old in zip(cell, highest, strict=True))
        is_free |= here
    return lowest, highest, is_free & jnp.all(clipped == x, axis=-1)


def inside_free_cells(free: Mask, x: Points) -> tuple[Ends, Bool[Array, "*batch"]]:
    """Points moved inside each of their two free cells, and whether there are any."""
    *cells, is_free = free_cells(free, x)
    cell = jnp.stack([jnp.stack([column, row], axis=-1) for row, column in cells], axis=-2).astype(x.dtype)
    inset = margin(free.shape, x.dtype)
    return jnp.clip(x[..., None, :], cell + inset, cell + 1 - inset), is_free


def towards(ends: Float[Array, "*#batch 2 2"], x: Broadcast) -> Float[Array, "... 2"]:
    """Of both the one on the side of other points."""
    first, second = ends[..., 0, :], ends[..., 1, :]
    is_second = jnp.sum((x - (first + second) / 2) * (second - first), axis=-1) > 0
    return jnp.where(is_second[..., None], second, first)


def crosses_nothing(blocked: Words, shape: Shape, a: Broadcast, b: Broadcast) -> Bool[Array, "..."]:
    """Whether segments between points, both inside free cells, cross no blocked cell."""
    hit = jnp.zeros((), jnp.uint32)
    for row, (first, last, is_crossed) in enumerate(_columns(jnp, shape, margin(shape, a.dtype) / 4, a, b)):
        first, last = first.astype(jnp.int32), last.astype(jnp.int32)
        in_row = jnp.zeros((), jnp.uint32)
        for word in range(blocked.shape[1]):
            in_row |= blocked[row, word] & _ones(first - WORD * word, last - WORD * word, blocked.shape[1] > 1)
        hit |= jnp.where(is_crossed, in_row, jnp.uint32(0))
    return hit == 0


def _ones(first, last, beyond: bool) -> UInt32[Array, "..."]:
    """A word whose bits from the first to the last are set; ends may lie beyond the word where that is said."""
    every = jnp.uint32(0xFFFFFFFF)
    from_first = every << jnp.clip(first, 0, WORD - 1).astype(jnp.uint32)
    to_last = every >> (WORD - 1 - jnp.clip(last, 0, WORD - 1)).astype(jnp.uint32)
    ones = from_first & to_last
    return jnp.where((first < WORD) & (last >= 0), ones, jnp.uint32(0)) if beyond else ones


def _columns(xp: Any, shape: Shape, slack: float, a: Any, b: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Of each row the first and last column that segments cross there, and whether they cross the row at all.

    With NumPy or with JAX as ``xp``; no end may lie on a line between rows.
    """
    h, w = shape
    (x0, y0), (x1, y1) = (xp.moveaxis(point, -1, 0) for point in (a, b))
    dx, dy = x1 - x0, y1 - y0
    # Level segments cross the row they are in with all their length: any steep enough slope says so.
    inverse = 1 / xp.where(dy == 0, 1e-30, dy)
    at, x_at = xp.clip(-y0 * inverse, 0, 1), None
    x_at = x0 + dx * at
    for row in range(h):
        until = xp.clip((row + 1 - y0) * inverse, 0, 1)
        x_until = x0 + dx * until
        first = xp.clip(xp.floor(xp.minimum(x_at, x_until) - slack), 0, w - 1)
        last = xp.clip(xp.floor(xp.maximum(x_at, x_until) + slack), 0, w - 1)
        yield first, last, at != until
        at, x_at = until, x_until


# Ends that do not depend on the map.


def flat_words(blocked: Mask) -> UInt32[Array, "words"]:
    """The blocked cells of a grid, row after row, as bits."""
    return packed(blocked.reshape(1, -1))[0]


def sees_between(table: UInt32[np.ndarray, "words n m"], blocked: UInt32[Array, "words"]) -> Bool[Array, "n m"]:
    """Whether the segments of a table cross no blocked cell."""
    hit = jnp.zeros((), jnp.uint32)
    for crossed, word in zip(table, blocked, strict=True):
        hit |= crossed & word
    return hit == 0


@lru_cache(maxsize=8)
def lattice(shape: Shape) -> Float[np.ndarray, "corners 2"]:
    """The corners of cells that are inside the grid, row by row."""
    rows, columns = np.mgrid[1 : shape[0], 1 : shape[1]].reshape(2, -1)
    return np.stack([columns, rows], axis=1).astype(float)


def cell_centers(shape: Shape) -> Float[np.ndarray, "cells 2"]:
    """The centers of cells, row by row."""
    rows, columns = np.indices(shape).reshape(2, -1)
    return np.stack([columns, rows], axis=1) + 0.5


@lru_cache(maxsize=16)
def crossed_cells(shape: Shape, from_centers: bool) -> UInt32[np.ndarray, "words n corners"]:
    """Cells that segments cross from each corner of a cell, or center of one, to each corner, as bits.

    Where a segment passes through a corner, it counts as crossing all four cells: if one is blocked, a path by way
    of that corner is as long, and if two are, none passes. A segment along a line of the grid counts as running on
    its left: two corners see each other if one of both ways is free, or by way of one where free sides change.
    """
    a, b = (cell_centers(shape) if from_centers else lattice(shape))[:, None], lattice(shape)[None]
    along = b - a
    left = np.where((along == 0).any(axis=-1, keepdims=True), along[..., ::-1] * [-1, 1], 0)
    nudge = 1e-3 / max(shape)
    a, b = a + nudge * (along + left), b - nudge * (along - left)
    bits = np.zeros((*along.shape[:2], *shape), bool)
    for row, (first, last, is_crossed) in enumerate(_columns(np, shape, nudge / 1e3, a, b)):
        column = np.arange(shape[1])
        bits[:, :, row] = (first[..., None] <= column) & (column <= last[..., None]) & is_crossed[..., None]
    flat = bits.reshape(*along.shape[:2], -1)
    flat = np.pad(flat, ((0, 0), (0, 0), (0, -flat.shape[2] % WORD)))
    words = np.packbits(flat, axis=2, bitorder="little").view("<u4")
    return np.ascontiguousarray(np.moveaxis(words, 2, 0)).astype(np.uint32)
