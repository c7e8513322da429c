"""Distances on a grid that JAX may trace, along steps from each cell to its 4 or 8 neighbors."""

from functools import reduce
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int32, UInt32

from plr_jax._compiled import pytree

Mask = Bool[Array, "h w"]
Words = UInt32[Array, "h words"]
Grids = UInt32[Array, "h words *grids"]
Shape = tuple[int, ...]
Points = Float[Array, "*batch 2"]
Cells = tuple[Int32[Array, " 4 *batch"], Int32[Array, " 4 *batch"]]
Distances = Float[Array, "h w"]
WORD = 32  # bits of a word; each is a cell of a row, and the first column is in the lowest bit
_PLACES = np.arange(WORD, dtype=np.uint32)[None, None]


def pack(cells: Mask) -> Words:
    """Pack a boolean grid into words of 32 bits: column ``c`` of a row is bit ``c % 32`` of the word ``c // 32``."""
    h, w = cells.shape
    bits = jnp.pad(cells, ((0, 0), (0, -w % WORD))).reshape(h, -1, WORD)
    return (bits.astype(jnp.uint32) << _PLACES).sum(axis=2, dtype=jnp.uint32)


def unpack(words: Words, w: int) -> UInt32[Array, "h w"]:
    """Return the cells of a packed grid of ``w`` columns, as integers 0 and 1: the inverse of :func:`pack`."""
    return ((words[:, :, None] >> _PLACES) & jnp.uint32(1)).reshape(len(words), -1)[:, :w]


def single_cell(shape: Shape, row: Int32[Array, ""], column: Int32[Array, ""]) -> Words:
    """Return a grid in which only the cell at ``row`` and ``column`` is set, packed as by :func:`pack`."""
    rows, words = jnp.indices((shape[0], -(-shape[1] // WORD)), dtype=jnp.int32)
    bit = jnp.uint32(1) << (column % WORD).astype(jnp.uint32)
    return jnp.where((rows == row) & (words == column // WORD), bit, jnp.uint32(0))


def neighbors_of(words: Grids) -> Grids:
    """Return all cells that share a side with any of the given cells, as grids packed by :func:`pack`."""
    # To the next column is one bit up; between words, the highest bit leads to the lowest bit of the next word.
    in_row = (words << 1) | (words >> 1)
    if words.shape[1] > 1:
        none = jnp.zeros_like(words[:, :1])
        in_row |= jnp.concatenate([none, words[:, :-1] >> (WORD - 1)], axis=1)
        in_row |= jnp.concatenate([words[:, 1:] << (WORD - 1), none], axis=1)
    none = jnp.zeros_like(words[:1])
    return in_row | jnp.concatenate([words[1:], none]) | jnp.concatenate([none, words[:-1]])


def containing_cells(shape: Shape, x: Points) -> tuple[Cells, Bool[Array, "*batch"]]:
    """Return rows and columns of the up to four cells around each point, and whether the point is in the grid.

    Rows and columns are arrays ``(4, ...)``, of the cells lower left, lower right, upper left and upper right of the
    point. Some of the four cells are equal, unless the point is an inner corner of the grid. A point outside the grid
    is first moved to the nearest point of the grid.
    """
    size = jnp.broadcast_to(jnp.array(shape[::-1], x.dtype), x.shape)
    clipped = jnp.clip(x, 0, size)
    upper = jnp.minimum(jnp.floor(clipped), size - 1).astype(jnp.int32)
    lower = jnp.maximum(jnp.ceil(clipped) - 1, 0).astype(jnp.int32)
    rows = jnp.stack([lower[..., 1], lower[..., 1], upper[..., 1], upper[..., 1]])
    columns = jnp.stack([lower[..., 0], upper[..., 0], lower[..., 0], upper[..., 0]])
    return (rows, columns), jnp.all(clipped == x, axis=-1)


@pytree
class Steps:
    """A table of the path length from each cell to the goal's cell.

    A point on the border of several cells counts as in the cell of least length.
    """

    table: Float[Array, "*maps h w"]

    @classmethod
    def to_goal(cls, free: Mask, goal: Float[Array, "2"], moves: Literal[4, 8]) -> "Steps":
        cells, is_inside = containing_cells(free.shape, goal)
        start = reduce(jnp.bitwise_or, (single_cell(free.shape, *cell) for cell in zip(*cells, strict=True)))
        return cls(distances(free, jnp.where(is_inside, start, jnp.uint32(0)), moves))

    def cells(self) -> Distances:
        return self.table

    def distance(self, x: Float[Array, "n 2"]) -> Float[Array, " n"]:
        cells, is_inside = containing_cells(self.table.shape, x)
        return jnp.where(is_inside, self.table[cells].min(axis=0), jnp.inf)


@pytree
class StepPairs:
    """A table of the path length between any two cells.

    A point on the border of several cells counts as in the cell that gives the least length.
    """

    table: Float[Array, "*maps h w h w"]

    @classmethod
    def of_grid(cls, free: Mask, moves: Literal[4, 8]) -> "StepPairs":
        rows, columns = jnp.indices(free.shape, dtype=jnp.int32).reshape(2, -1)
        to_cell = jax.vmap(lambda row, column: distances(free, single_cell(free.shape, row, column), moves))
        return cls(to_cell(rows, columns).reshape(free.shape * 2))

    def distance(self, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, " n"]:
        h, w = self.table.shape[:2]
        ((rows, columns), is_x_inside), (others, is_y_inside) = (containing_cells((h, w), end) for end in (x, y))
        # Each of the four cells of x with each of the four cells of y, as an index into the flat table.
        places = (rows * w + columns)[:, None] * (h * w) + (others[0] * w + others[1])[None]
        # A gather for each of the 16 pairs of cells takes an eighth of the time of one gather for all.
        get = self.table.ravel().at
        steps = reduce(jnp.minimum, (get[place].get(mode="promise_in_bounds") for place in places.reshape(16, -1)))
        return jnp.where(is_x_inside & is_y_inside, steps, jnp.inf)


def distances(free: Mask, start: Words, moves: Literal[4, 8]) -> Distances:
    """Return the path length from each cell to the nearest cell of the set ``start``; ``inf`` without a path.

    ``start`` is packed by :func:`pack`. ``moves`` is 4 or 8, the number of neighbors that a step may lead to.
    """
    w, start = free.shape[1], start & pack(free)
    if moves == 8:
        return _octile_distances(free, unpack(start, w) == 1)
    reached, digits = _breadth_first_search(pack(free), start)
    level = sum((unpack(plane, w) << digit for digit, plane in enumerate(digits)), jnp.uint32(0))
    return jnp.where(unpack(reached, w) == 1, level.astype(jnp.float32), jnp.inf)


@custom_vmap
def _breadth_first_search(passable: Grids, start: Grids) -> tuple[Grids, UInt32[Array, "digits h words *grids"]]:
    """Return the cells that can be reached from the cells ``start``, and their numbers of steps, as packed grids.

    ``passable`` are the cells that steps may enter. The numbers of steps are binary: grid ``k`` has digit ``k``
    (worth ``2**k``) of each cell's number.
    """
    # `powers` are the numbers of the digits from the third on. Paths are shorter than the padded grid has cells.
    h, words = passable.shape[:2]
    powers = jnp.arange((h * words * WORD // 4).bit_length(), dtype=jnp.uint32).reshape(-1, *[1] * passable.ndim)

    def has_digit(number):
        return (number >> powers) & 1 == 1

    def four_levels(state):
        # Round f, of `fours`, finds the cells at 4 f + 1 to 4 f + 4 steps: new[0] to new[3]. Their two lowest digits
        # are 01, 10, 11 and 00; their other digits are those of f, and of f + 1 for the last.
        fours, reached, ones_plane, twos_plane, planes, _ = state
        new = []
        for _ in range(4):
            grown = passable & (reached | neighbors_of(reached))
            new.append(grown ^ reached)
            reached = grown
        planes |= jnp.where(has_digit(fours), (new[0] | new[1] | new[2])[None], jnp.uint32(0))
        planes |= jnp.where(has_digit(fours + 1), new[3][None], jnp.uint32(0))
        any_new = jnp.any(new[3] != 0)
        return fours + 1, reached, ones_plane | new[0] | new[2], twos_plane | new[1] | new[2], planes, any_new

    none = jnp.zeros_like(start)
    first = jnp.uint32(0), start, none, none, jnp.zeros((len(powers), *start.shape), jnp.uint32), jnp.array(True)
    _, reached, ones_plane, twos_plane, planes, _ = jax.lax.while_loop(lambda state: state[-1], four_levels, first)
    return reached, jnp.concatenate([ones_plane[None], twos_plane[None], planes])


# Grids of a batch are the last axis, which is three times as fast as the first.
@_breadth_first_search.def_vmap
def _(size: Any, is_mapped: list[bool], *arguments: Any):
    pairs = zip(arguments, is_mapped, strict=True)
    batches = (words if mapped else jnp.broadcast_to(words, (size, *words.shape)) for words, mapped in pairs)
    reached, digits = _breadth_first_search(*(jnp.moveaxis(words, 0, -1) for words in batches))
    return (jnp.moveaxis(reached, -1, 0), jnp.moveaxis(digits, -1, 0)), (True, True)


# Integer lengths keep sums of steps exact. 3363 / 2378 is a convergent of sqrt(2), above it by 6.3e-8.
_STRAIGHT, _DIAGONAL, _FAR = 2378, 3363, 2**29
MOST_CELLS = _FAR // _DIAGONAL  # for ``moves=8``: a path has fewer steps than cells, so its length is below ``_FAR``


def _octile_distances(free: Mask, start: Mask) -> Distances:
    """Return the path length from each cell to the nearest cell of ``start``, on the 8-connected grid.

    Rounds relax all cells at once. The unit of length is a step between cells that share a side. ``inf`` without a
    path.
    """
    # Arrays have a rim of one cell, which no path reaches: `at` is the grid, moved by a step.
    h, w = free.shape

    def at(padded, down: int, right: int):
        return padded[1 + down : h + 1 + down, 1 + right : w + 1 + right]

    # A diagonal step into a cell is legal if both cells beside it are free.
    margin = jnp.pad(free, 1)
    diagonals = [(down, right) for down in (-1, 1) for right in (-1, 1)]
    is_legal = [at(margin, down, 0) & at(margin, 0, right) for down, right in diagonals]
    costs = [jnp.where(legal, _DIAGONAL, _FAR).astype(jnp.int32) for legal in is_legal]
    least = jnp.where(free, 0, _FAR).astype(jnp.int32)

    def relaxed(state):
        # One round of the Bellman-Ford algorithm, for all cells at once.
        old, _ = state
        near = jnp.minimum(at(old, 0, 1), at(old, 0, -1))
        near = jnp.minimum(near, jnp.minimum(at(old, 1, 0), at(old, -1, 0)))
        new = jnp.minimum(at(old, 0, 0), near + _STRAIGHT)
        for (down, right), cost in zip(diagonals, costs, strict=True):
            new = jnp.minimum(new, at(old, down, right) + cost)
        new = jnp.pad(jnp.maximum(new, least), 1, constant_values=_FAR)
        return new, jnp.any(new != old)

    first: Int32[Array, "h_and_2 w_and_2"] = jnp.where(jnp.pad(start, 1), 0, _FAR).astype(jnp.int32)
    units = at(jax.lax.while_loop(lambda state: state[1], relaxed, (first, jnp.array(True)))[0], 0, 0)
    return jnp.where(units < _FAR, units.astype(jnp.float32) / _STRAIGHT, jnp.inf)
