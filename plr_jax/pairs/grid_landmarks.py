"""Bounds of the distances between all pairs of cells of a grid, in any number of bytes: differential heuristics.

A landmark is a cell whose distances from all cells are kept. Those of two cells differ by at most the distance
between these, and their sum is at least that. Each part of the grid, of cells that paths join, has as many landmarks,
as far from one another as can be, so that islands are as well off as what is around them. Distances are kept in 16
bits, as multiples of a whole number of units; rounding down costs a bound less than two such steps.

References:
    A. V. Goldberg and C. Harrelson, "Computing the shortest path: A* search meets graph theory", SODA 2005.
    N. R. Sturtevant, A. Felner, M. Barrer, J. Schaeffer and N. Burch, "Memory-based heuristics for explicit state
    spaces", IJCAI 2009: differential heuristics.
"""

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from hashlib import sha256
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Int32, Integer, Num, UInt16, UInt32
from tqdm import tqdm

import plr_jax
from plr_jax.pairs.grid_corners import FAR, MOST_BYTES, looked_up, open_length
from plr_jax.pairs.grid_query import Cells, bits_of, cells_of, in_steps, narrow, squares_around, whole_steps
from plr_jax.plr.work import Checkpoint, Chunk, Done

MOST_LANDMARKS = 2**10

_AT_ONCE = 4  # landmarks searched from by workers at once, told apart by open lengths; more are worse ones
_CHUNK = 1024  # pairs taken at once


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LandmarkTables:
    """Distances of all free cells from landmarks.

    Attributes:
        free: Bits of the cells in row-major order, the lowest of a word first.
        before: Free cells before each word.
        part: Which part of the grid each free cell is in, in row-major order.
        lengths: From each free cell to the landmarks of its part, rounded down.
        shape: Rows and columns of the grid.
        connectivity: 4 or 8.
        step: Units of which lengths are multiples.
    """

    free: UInt32[Array, "words"]
    before: Int32[Array, "words"]
    part: Integer[Array, "cells"]
    lengths: UInt16[Array, "cells landmarks"]
    shape: tuple[int, int] = field(metadata={"static": True})
    connectivity: int = field(metadata={"static": True})
    step: int = field(metadata={"static": True})

    @property
    def num_landmarks(self) -> int:
        """Landmarks of each part."""
        return self.lengths.shape[1]


def landmarks_within(
    free: Bool[np.ndarray, "rows columns"], connectivity: int, max_bytes: int, exact_bytes: int | None = None
) -> int:
    """How many landmarks there is room for; raises ``ValueError`` if there is none for one, saying what is enough.

    Of a grid with a free cell. Of open land exact tables may take less than one landmark.
    """
    parts = _Parts.of(_Grid.of(free, connectivity))
    without = _tables(parts, np.zeros((len(parts.part), 0), np.uint16), 1)
    of_each, others = 2 * len(parts.part), sum(table.nbytes for table in jax.tree_util.tree_leaves(without))
    if others + of_each > max_bytes:
        least = min(others + of_each, exact_bytes or others + of_each)
        _steps.cache_clear()
        raise ValueError(f"max_bytes must be at least {least} for this grid, got {max_bytes}.")
    return int(min((min(max_bytes, MOST_BYTES) - others) // of_each, np.diff(parts.first).max(), MOST_LANDMARKS))


@contextmanager
def _letting_go() -> Iterator[None]:
    """However it ends, legal steps are kept no longer."""
    try:
        yield
    finally:
        _steps.cache_clear()


@_letting_go()
def landmark_tables(
    free: Bool[np.ndarray, "rows columns"],
    connectivity: int,
    num_landmarks: int,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> LandmarkTables:
    """Tables of a grid with a free cell, the same whatever the executor.

    Raises:
        ValueError: If paths are so long that twice their lengths do not fit into 30 bits, or the checkpoint is of
            other work.
        OSError: If the checkpoint cannot be read or written.
    """
    grid = _Grid.of(free, connectivity)
    parts = _Parts.of(grid)
    score = grid.lengths_from(parts.order[parts.first[:-1]])
    longest = 2 * int(score.max())  # no path is longer than the way over a cell as far from all others
    if longest > FAR - 2**20:
        raise ValueError(f"Paths of up to {longest} units are too long; bounds of pairs go up to {FAR}.")
    step = max(-(-longest // np.iinfo(np.uint16).max), 1)
    kept = None
    if checkpoint is not None:
        work = f"{plr_jax.__version__} {free.shape} {connectivity} {num_landmarks}".encode() + grid.cells
        kept = Checkpoint(checkpoint, sha256(work).digest())
    done = Done.of(num_landmarks, kept)
    table = np.empty((len(parts.part), num_landmarks), np.uint16)
    nearest = np.full(len(table), FAR, np.int32)
    with tqdm(
        desc="construct_grid_pairs", unit=" landmarks", total=num_landmarks, initial=done.count, delay=2, leave=False,
        disable=None,
    ) as progress:  # fmt: skip
        for begin in range(0, num_landmarks, _AT_ONCE):
            some, chunks = range(begin, min(begin + _AT_ONCE, num_landmarks)), []
            for number in some:
                cells = parts.farthest(score)
                apart = parts.open_lengths_from(cells)
                score = np.minimum(score, apart) if number else apart
                if done.results[number] is None:
                    chunks.append(Chunk([number], partial(_column, grid, cells, step)))
            done.build(chunks, executor, progress)
            for number in some:
                table[:, number] = np.frombuffer(done.results[number] or b"", "<u2")
                nearest = np.minimum(nearest, step * table[:, number].astype(np.int32))
            score = nearest
    done.finish()
    return _tables(parts, table, step)


@dataclass(frozen=True)
class _Grid:
    """The cells of a grid as bits, few for a worker to be sent."""

    cells: bytes
    shape: tuple[int, int]
    connectivity: int

    @classmethod
    def of(cls, free: Bool[np.ndarray, "rows columns"], connectivity: int) -> "_Grid":
        return cls(np.packbits(free).tobytes(), free.shape, connectivity)

    @property
    def free(self) -> Bool[np.ndarray, "rows columns"]:
        """Which cells are free."""
        bits = np.unpackbits(np.frombuffer(self.cells, np.uint8), count=self.shape[0] * self.shape[1])
        return bits.reshape(self.shape).astype(bool)

    def lengths_from(self, cells: Int[np.ndarray, "parts"]) -> Int32[np.ndarray, "free"]:
        """Length in units from each free cell to the one of these in its part."""
        from scipy.sparse import csgraph

        lengths = csgraph.dijkstra(_steps(self), directed=False, indices=cells, min_only=True)
        return np.minimum(lengths, FAR).astype(np.int32)


@lru_cache(maxsize=1)  # workers are sent one grid again and again
def _steps(grid: _Grid) -> Any:
    """Lengths in units of the legal steps between free cells, each in one of its directions, a sparse matrix."""
    from scipy.sparse import csr_array

    from plr_jax.oracles._grids import legal_steps

    begin, end, is_diagonal = legal_steps(grid.free, grid.connectivity)
    number = np.cumsum(grid.free.ravel(), dtype=np.int32) - 1
    straight, diagonal = (float(open_length(grid.connectivity, *way)) for way in ((0, 1), (1, 1)))
    ends, size = (number[begin], number[end]), int(number[-1]) + 1
    return csr_array((np.where(is_diagonal, diagonal, straight), ends), shape=(size, size))


def _column(grid: _Grid, cells: Int[np.ndarray, "parts"], step: int) -> list[bytes]:
    """The lengths to a landmark, one cell of each part, as they are kept."""
    return [(grid.lengths_from(cells) // step).astype("<u2").tobytes()]


@dataclass(frozen=True, eq=False)
class _Parts:
    """The free cells of a grid by the parts that paths join.

    Attributes:
        grid: The grid.
        part: The part of each free cell.
        order: Free cells, part by part.
        first: Where those of each part begin, and their number.
    """

    grid: _Grid
    part: Int32[np.ndarray, "free"]
    order: Int[np.ndarray, "free"]
    first: Int[np.ndarray, "parts_plus_one"]

    @classmethod
    def of(cls, grid: _Grid) -> "_Parts":
        from scipy.sparse import csgraph

        num_parts, part = csgraph.connected_components(_steps(grid), directed=False)
        first = np.concatenate([[0], np.cumsum(np.bincount(part, minlength=num_parts))])
        return cls(grid, part, np.argsort(part, kind="stable"), first)

    def farthest(self, score: Int32[np.ndarray, "free"]) -> Int[np.ndarray, "parts"]:
        """Of each part, the first cell with the largest score."""
        in_order = score[self.order]
        largest = np.maximum.reduceat(in_order, self.first[:-1])
        places = np.flatnonzero(in_order == largest[self.part[self.order]])
        return self.order[places[np.searchsorted(places, self.first[:-1])]]

    def open_lengths_from(self, cells: Int[np.ndarray, "parts"]) -> Int32[np.ndarray, "free"]:
        """Open length from each free cell to the one of these in its part, or less than a path that is far."""
        row, column = (places.astype(np.int64) for places in np.nonzero(self.grid.free))
        here = cells[self.part]
        lengths = open_length(self.grid.connectivity, abs(row - row[here]), abs(column - column[here]))
        return np.minimum(lengths, FAR).astype(np.int32)


def _tables(parts: _Parts, lengths: UInt16[np.ndarray, "free landmarks"], step: int) -> LandmarkTables:
    free = bits_of(parts.grid.free)
    in_word = np.bitwise_count(free).astype(np.int32)
    before, part = np.cumsum(in_word, dtype=np.int32) - in_word, narrow(parts.part)
    tables = jnp.asarray(free), jnp.asarray(before), jnp.asarray(part), jnp.asarray(lengths)
    return LandmarkTables(*tables, parts.grid.shape, parts.grid.connectivity, step)


@partial(jax.jit, static_argnames="above")
def evaluate_bounds(
    tables: LandmarkTables, x: Num[Array, "*batch 2"], y: Num[Array, "*batch 2"], *, above: bool
) -> Float[Array, "*batch"]:
    """Lower bounds of the distances between the cells of points, or upper ones; ``inf`` where there is no path."""
    (p, p_inside), (q, q_inside) = (cells_of(tables.shape, points.reshape(-1, 2)) for points in (x, y))
    lengths = _bounds_between_cells(tables, p, q, above)
    return in_steps(tables.connectivity, lengths, p_inside & q_inside).reshape(x.shape[:-1])


@partial(jax.jit, static_argnames="radius")
def bounds_around(
    tables: LandmarkTables, goals: Num[Array, "n 2"], positions: Num[Array, "n 2"], *, radius: int
) -> Int32[Array, "n width width"]:
    """Lower bounds of the steps to goals from squares of cells around positions; -1 where there is no path."""
    (position, inside), (goal, goal_inside) = (cells_of(tables.shape, points) for points in (positions, goals))
    row, column, on_grid = squares_around(tables.shape, position, radius)
    cells = jnp.where(on_grid[..., None], jnp.stack([row, column], axis=-1), 0)
    ends = cells.reshape(-1, 2), jnp.broadcast_to(goal, cells.shape).reshape(-1, 2)
    lengths = _bounds_between_cells(tables, *ends, above=False).reshape(on_grid.shape)
    return whole_steps(tables.connectivity, lengths, on_grid & inside & goal_inside)


def _bounds_between_cells(tables: LandmarkTables, p: Cells, q: Cells, above: bool) -> Int32[Array, "n"]:
    """Bounds of lengths in units, at least ``FAR`` where there is no path."""
    size = min(_CHUNK, max(len(p), 1))
    chunks = jnp.pad(jnp.stack([p, q]), ((0, 0), (0, -len(p) % size), (0, 0))).reshape(2, -1, size, 2)

    def of_chunk(ends: Int32[Array, "2 size 2"]) -> Int32[Array, "size"]:
        p, q = ends
        (a, a_free), (b, b_free) = (_numbers(tables, cells) for cells in ends)
        to_a, to_b = (looked_up(tables.lengths, cell).astype(jnp.int32) for cell in (a, b))
        if above:
            length = tables.step * (to_a + to_b).min(axis=1) + 2 * (tables.step - 1)
            length = jnp.where((p == q).all(axis=1), 0, jnp.minimum(length, FAR - 1))  # no path is as long
        else:
            length = tables.step * jnp.abs(to_a - to_b).max(axis=1) - (tables.step - 1)
            length = jnp.maximum(length, open_length(tables.connectivity, *jnp.abs(p - q).T))
        joined = a_free & b_free & (looked_up(tables.part, a) == looked_up(tables.part, b))
        return jnp.where(joined, length, FAR)

    return lax.map(of_chunk, chunks.swapaxes(0, 1)).reshape(-1)[: len(p)]


def _numbers(tables: LandmarkTables, cells: Cells) -> tuple[Int32[Array, "n"], Bool[Array, "n"]]:
    """Numbers of cells among the free ones in row-major order, some number of a blocked one; and which are free."""
    cell = cells[:, 0] * tables.shape[1] + cells[:, 1]
    word, bit = looked_up(tables.free, cell >> 5), jnp.uint32(1) << (cell & 31).astype(jnp.uint32)
    number = looked_up(tables.before, cell >> 5) + lax.population_count(word & (bit - 1)).astype(jnp.int32)
    return jnp.minimum(number, len(tables.part) - 1), (word & bit) != 0
