"""Which cells are taut at each corner of a grid, and which corners see each other, by scans of sectors around them.

Cells of a sector of a corner are numbered by the steps to them: ``ahead`` along the rows of a view of the grid, and
``aside``, to the next row, which on 8-connected grids is a diagonal step. A sector is a quadrant or an octant; views
are flipped and transposed so that all sectors look alike. What a corner sees in a row is a run of cells, and all that
is asked of a cell is the same for those of a run but its first; so runs are what scans work on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Int, Int32, Shaped

from plr_jax._arrays import parts, runs

# Lengths of steps as integers, so that sums have no rounding and do not depend on their order.


_Numbers = TypeVar("_Numbers")

CONNECTIVITIES = (4, 8)
_STRAIGHT = {4: 1, 8: 985}
_DIAGONAL = {4: 2, 8: 1393}  # 1393 / 985 is a convergent of the square root of 2, 3.6e-7 below it


def units(connectivity: int) -> int:
    """How many units long a straight step is."""
    return _STRAIGHT[connectivity]


def open_length(connectivity: int, rows: _Numbers, columns: _Numbers) -> _Numbers:
    """Length in units of a shortest path between cells so many rows and columns apart, without obstacles.

    Of arrays of integers at least 0, NumPy or JAX. A diagonal step of a 4-connected grid is two straight ones.
    """
    straight = abs(rows - columns)  # pyright: ignore[reportOperatorIssue]
    diagonal = (rows + columns - straight) // 2  # pyright: ignore[reportOperatorIssue]
    return _STRAIGHT[connectivity] * straight + _DIAGONAL[connectivity] * diagonal


class TablesTooLarge(ValueError):
    """Tables that hold exact distances of a grid would take more bytes than allowed, or too long to make."""

    def __init__(self, most_bytes: int):
        super().__init__(most_bytes)

    def __str__(self) -> str:
        return (
            f"The grid's obstacles have too many corners for exact tables of {self.args[0]:,} bytes: cut the map, or "
            "give max_bytes, and where exact tables take more, or minutes, distances are proven bounds instead."
        )


_DIAGONALS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
_AT_ONCE = 2**22  # cells of runs that are listed at once

Cells = Int[np.ndarray, "pairs"]


def corner_cells(free: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Corners: free cells with a blocked cell diagonally beside them, and free cells on both sides of that one."""
    return np.logical_or.reduce(_blocked_diagonals(free))


def corners_in_sight(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> tuple[Cells, Cells]:
    """Pairs of corners that see each other with no corner between them, by their numbers in row-major order.

    Each pair is there once, its lower number first.
    """
    places = np.flatnonzero(corner_cells(free))
    number = np.full(free.size, -1, np.int32)
    number[places] = np.arange(len(places))
    found = [np.zeros(0, np.int64)]
    for sector in _sectors(free, connectivity):
        corners = np.logical_or.reduce(list(sector.blocked.values()))
        for corner, width, aside in _scan(sector, corners, corners):
            last = number[sector.cells(corner, aside, width - 1)]  # as no run goes on behind a corner
            other = (last >= 0) & (last != corner)
            ends = corner[other], last[other]
            found.append(np.minimum(*ends) * len(places) + np.maximum(*ends))
    return np.divmod(np.unique(np.concatenate(found)), max(len(places), 1))


def taut_corners(
    free: Bool[np.ndarray, "rows columns"], connectivity: int, most_bytes: int
) -> tuple[Int[np.ndarray, "cells_plus_one"], Int32[np.ndarray, "pairs"]]:
    """Corners that each cell sees and is taut at, with no such corner between them.

    Cells and corners are numbered in row-major order. Where the corners of each cell begin, and the corners, in the
    order of their numbers. Raises ``TablesTooLarge`` if a byte for each is too much.
    """
    taut = _taut_runs(free, connectivity)
    if taut.length.sum() > most_bytes:
        raise TablesTooLarge(most_bytes)
    order = np.argsort(taut.corner, kind="stable")
    taut = _Runs(*(one[order] for one in taut))
    cells = np.empty(int(taut.length.sum()), np.int32)
    end = 0
    for some in parts(taut.length, _AT_ONCE):
        run, place = runs(taut.length[some])
        cells[end : end + len(run)] = taut.first[some][run] + taut.step[some][run] * place
        end += len(run)
    corners = int(taut.corner.max(initial=-1)) + 1
    counts = np.bincount(taut.corner, weights=taut.length, minlength=corners)
    return _transposed(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), cells, free.size)


def _transposed(
    first: Int32[np.ndarray, "corners_plus_one"], cells: Int32[np.ndarray, "pairs"], num_cells: int
) -> tuple[Int[np.ndarray, "cells_plus_one"], Int32[np.ndarray, "pairs"]]:
    """Lists of cells by corners as lists of corners by cells, in linear time."""
    from scipy.sparse import csr_array

    table = csr_array((np.ones(len(cells), np.int8), cells, first), shape=(len(first) - 1, num_cells)).tocsc()
    return table.indptr, table.indices  # of the type of those given


class _Runs(NamedTuple):
    """Cells that corners see: ``length`` ones from ``first``, each ``step`` behind the one before."""

    corner: Cells
    first: Cells
    step: Cells
    length: Cells


def _taut_runs(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> _Runs:
    """The cells that are taut at each corner, by runs."""
    found = [_Runs(*(np.zeros((4, 0), np.int64)))]
    for sector in _sectors(free, connectivity):
        # Beyond a corner in this sector, those further ahead are taut at it if a blocked diagonal of it is ahead, and
        # those further aside if one is aside; a diagonal step goes ahead as well.
        blocked, at = sector.blocked, {along: sector.of_corners(cells) for along, cells in sector.blocked.items()}
        ahead, aside = blocked[1, 1] | blocked[-1, 1], blocked[1, 1] | blocked[1, -1]
        # Whether cells beside a corner are taut at it: with exactly one of row and column beyond its own, or both.
        if_ahead, if_aside, if_both = (at[one] | at[other] for one, other in _TAUT)
        straight = if_both if sector.slanted else if_aside
        for corner, width, rows in _scan(sector, ahead, ahead | aside if sector.slanted else aside):
            if rows:
                starts, goes_on = straight[corner] & sector.keeps_aside, if_both[corner]
            else:
                starts, goes_on = np.zeros(len(corner), bool), if_ahead[corner] & sector.keeps_ahead
            begin = np.where(starts, 0, 1)
            length = np.where(goes_on, width, 1) - begin
            some = length > 0
            first = sector.cells(corner[some], rows, begin[some])
            found.append(_Runs(corner[some], first, np.full(len(first), sector.column_step), length[some]))
    return _Runs(*map(np.concatenate, zip(*found, strict=True)))


_TAUT = (((1, 1), (-1, 1)), ((1, 1), (1, -1)), ((1, -1), (-1, 1)))
"""Blocked diagonals of a corner at which what is straight ahead, straight aside, and both is taut."""


@dataclass(frozen=True)
class _Sector:
    """A view of a grid in which a sector of every corner extends to higher rows and columns.

    ``row`` and ``column`` are those of the corners in the view, in the order of their numbers; ``origin`` and the
    steps give the cells of the grid. ``keeps_ahead`` and ``keeps_aside`` say whether cells straight ahead, and
    straight aside, which two sectors share, are this one's.
    """

    free: Bool[np.ndarray, "rows columns"]
    blocked: dict[tuple[int, int], Bool[np.ndarray, "rows columns"]]
    row: Int[np.ndarray, "corners"]
    column: Int[np.ndarray, "corners"]
    origin: int
    row_step: int
    column_step: int
    slanted: bool
    keeps_ahead: bool
    keeps_aside: bool

    def of_corners(self, values: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "corners"]:
        """Values at the corners."""
        return values[self.row, self.column]

    def steps_aside(self) -> Bool[np.ndarray, "rows columns"]:
        """Whether the step aside from each cell is legal."""
        beside = np.pad(self.free, ((0, 1), (0, 1)))
        above = self.free & beside[1:, :-1]
        return above & beside[:-1, 1:] & beside[1:, 1:] if self.slanted else above

    def cells(self, corner: Cells, aside: int, ahead: Cells) -> Cells:
        """Cells so many steps from corners."""
        column = self.column[corner] + ahead + (aside if self.slanted else 0)
        return self.origin + (self.row[corner] + aside) * self.row_step + column * self.column_step


def _sectors(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> Iterator[_Sector]:
    corners = np.nonzero(corner_cells(free))
    slanted = connectivity == 8
    for transposed, flipped, mirrored in product((False, True)[: 1 + slanted], (False, True), (False, True)):
        view = np.ascontiguousarray(
            (free.T if transposed else free)[:: -1 if flipped else 1, :: -1 if mirrored else 1]
        )
        (row, column), steps = corners, (free.shape[1], 1)
        if transposed:
            row, column, steps = column, row, steps[::-1]
        last_row, last_column = view.shape[0] - 1, view.shape[1] - 1
        yield _Sector(
            free=view,
            blocked=dict(zip(_DIAGONALS, _blocked_diagonals(view), strict=True)),
            row=last_row - row if flipped else row,
            column=last_column - column if mirrored else column,
            origin=last_row * steps[0] * flipped + last_column * steps[1] * mirrored,
            row_step=-steps[0] if flipped else steps[0],
            column_step=-steps[1] if mirrored else steps[1],
            slanted=slanted,
            # Sectors that are flipped share what is ahead; mirrored quadrants, or transposed octants, what is aside.
            keeps_ahead=not flipped,
            keeps_aside=not (transposed if slanted else mirrored),
        )


def _scan(
    sector: _Sector, ends_row: Bool[np.ndarray, "rows columns"], ends_later: Bool[np.ndarray, "rows columns"]
) -> Iterator[tuple[Cells, Cells, int]]:
    """Row by row, what corners see in a sector: their numbers, how many cells ahead, and the steps aside.

    A row ends with the first cell that ``ends_row``; later rows end one step after it, and before one that
    ``ends_later``.
    """
    to_blocked, to_end = _steps_to(~sector.free), _steps_to(ends_row)
    to_later, to_illegal = _steps_to(ends_later), _steps_to(~sector.steps_aside())
    row, column = sector.row, sector.column
    corner, aside = np.arange(len(row)), 0
    width = to_blocked[row, column]
    while len(corner):
        own = int(aside == 0)  # the corner itself ends nothing
        end, later = (steps[row, column + own] + own for steps in (to_end, to_later))
        yield corner, np.minimum(width, end + 1), aside
        width = np.minimum.reduce([width, end + 1, later, to_illegal[row, column]])
        aside += 1
        seeing = width > 0
        corner, width, row = corner[seeing], width[seeing], row[seeing] + 1
        column = column[seeing] + int(sector.slanted)


def _steps_to(wanted: Bool[np.ndarray, "rows columns"]) -> Int32[np.ndarray, "rows columns_plus_one"]:
    """Steps from each cell of a row, and from behind its last, to the first that is wanted, or to the border."""
    rows, columns = wanted.shape
    place = np.full((rows, columns + 1), columns, np.int32)
    np.copyto(place[:, :-1], np.arange(columns, dtype=np.int32), where=wanted)
    return np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1] - np.arange(columns + 1, dtype=np.int32)


def _blocked_diagonals(free: Bool[np.ndarray, "rows columns"]) -> Shaped[np.ndarray, "4 rows columns"]:
    """Of each cell, whether a path can go around its diagonal neighbor, in each of the diagonal directions."""
    rows, columns = free.shape
    around = np.pad(free, 1)

    def beside(k: int, m: int) -> Bool[np.ndarray, "rows columns"]:
        return around[1 + k : 1 + k + rows, 1 + m : 1 + m + columns]

    return np.stack([free & beside(k, 0) & beside(0, m) & ~beside(k, m) for k, m in _DIAGONALS])
