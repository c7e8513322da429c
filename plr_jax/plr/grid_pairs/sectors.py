"""Which cells each corner of a grid sees: scans of the sectors around it, all corners at once.

Cells of a sector of a corner are numbered by the steps to them: ``ahead`` along the rows of a view of the grid, and
``aside``, to the next row, which on 8-connected grids is a diagonal step. A sector is a quadrant or an octant; views
are flipped and transposed so that all sectors look alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Bool, Int, Shaped

from plr_jax._arrays import runs

_DIAGONALS = ((1, 1), (1, -1), (-1, 1), (-1, -1))

Cells = Int[np.ndarray, "pairs"]


def corner_cells(free: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Corners: free cells with a blocked cell diagonally beside them, and free cells on both sides of that one."""
    return np.logical_or.reduce(_blocked_diagonals(free))


def seen_by_corners(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> tuple[Cells, Cells]:
    """Pairs of a corner, by its number in row-major order, and a cell that it sees with no corner between them.

    Cells are numbered in row-major order; a corner does not see itself.
    """
    found = []
    for sector in _sectors(free, connectivity):
        corners = corner_cells(sector.free)
        for corner, ahead, aside in _scan(sector, corners, corners):
            found.append(sector.pairs(corner, ahead, aside, np.ones(len(corner), bool)))
    return _joined(found)


def taut_at_corners(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> tuple[Cells, Cells]:
    """Pairs of a corner and a cell that it sees and that is taut at it, with no such corner between them.

    Numbered as those of :func:`seen_by_corners`.
    """
    found = []
    for sector in _sectors(free, connectivity):
        blocked = dict(zip(_DIAGONALS, _blocked_diagonals(sector.free), strict=True))
        # Beyond a corner in this sector, those further ahead are taut at it if a blocked diagonal of it is ahead, and
        # those further aside if one is aside; a diagonal step goes ahead as well.
        ahead, aside = blocked[1, 1] | blocked[-1, 1], blocked[1, 1] | blocked[1, -1]
        kinds = [(along, sector.of_corners(blocked[along])) for along in _DIAGONALS]
        for corner, columns, rows in _scan(sector, ahead, ahead | aside if sector.slanted else aside):
            right = columns + rows if sector.slanted else columns
            taut = [kind[corner] & ((k * rows > 0) != (m * right > 0)) for (k, m), kind in kinds]
            found.append(sector.pairs(corner, columns, rows, np.logical_or.reduce(taut)))
    return _joined(found)


@dataclass(frozen=True)
class _Sector:
    """A view of a grid in which a sector of every corner extends to higher rows and columns.

    ``keeps_ahead`` and ``keeps_aside`` say whether cells straight ahead, and straight aside, which two sectors share,
    are this one's.
    """

    free: Bool[np.ndarray, "rows columns"]
    cells: Int[np.ndarray, "rows columns"]
    number: Int[np.ndarray, "rows columns"]
    slanted: bool
    keeps_ahead: bool
    keeps_aside: bool

    def of_corners(self, values: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "corners"]:
        """Values at the corners, in the order of their numbers."""
        result = np.zeros(self.number.max(initial=-1) + 1, bool)
        result[self.number[self.number >= 0]] = values[self.number >= 0]
        return result

    def steps_aside(self) -> Bool[np.ndarray, "rows columns"]:
        """Whether the step aside from each cell is legal."""
        beside = np.pad(self.free, ((0, 1), (0, 1)))
        above = self.free & beside[1:, :-1]
        return above & beside[:-1, 1:] & beside[1:, 1:] if self.slanted else above

    def pairs(
        self,
        corner: Int[np.ndarray, "scanned"],
        ahead: Int[np.ndarray, "scanned"],
        aside: Int[np.ndarray, "scanned"],
        wanted: Bool[np.ndarray, "scanned"],
    ) -> tuple[Cells, Cells]:
        """Numbers of corners and cells, of the wanted pairs that are this sector's."""
        wanted = wanted & np.where(ahead == 0, self.keeps_aside & (aside > 0), (aside > 0) | self.keeps_ahead)
        start_row, start_column = self.starts()
        corner, ahead, aside = corner[wanted], ahead[wanted], aside[wanted]
        column = start_column[corner] + ahead + (aside if self.slanted else 0)
        return corner, self.cells[start_row[corner] + aside, column]

    def starts(self) -> tuple[Int[np.ndarray, "corners"], Int[np.ndarray, "corners"]]:
        """Row and column of each corner, in the order of their numbers."""
        row, column = np.nonzero(self.number >= 0)
        order = np.argsort(self.number[row, column])
        return row[order], column[order]


def _sectors(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> Iterator[_Sector]:
    corners = corner_cells(free)
    number = np.where(corners, np.cumsum(corners).reshape(corners.shape) - 1, -1)
    cells = np.arange(free.size).reshape(free.shape)
    slanted = connectivity == 8
    for transposed, flipped, mirrored in product((False, True)[: 1 + slanted], (False, True), (False, True)):
        view = partial(_view, transposed=transposed, flipped=flipped, mirrored=mirrored)
        # Sectors that are flipped share what is ahead; mirrored quadrants, or transposed octants, what is aside.
        keeps_aside = not (transposed if slanted else mirrored)
        yield _Sector(view(free), view(cells), view(number), slanted, not flipped, keeps_aside)


def _view(
    grid: Shaped[np.ndarray, "rows columns"], transposed: bool, flipped: bool, mirrored: bool
) -> Shaped[np.ndarray, "_ _"]:
    return (grid.T if transposed else grid)[:: -1 if flipped else 1, :: -1 if mirrored else 1]


def _scan(
    sector: _Sector, ends_row: Bool[np.ndarray, "rows columns"], ends_later: Bool[np.ndarray, "rows columns"]
) -> Iterator[tuple[Cells, Cells, Cells]]:
    """Row by row, what corners see in a sector: their numbers, and the steps ahead and aside.

    A row ends with the first cell that ``ends_row``; later rows end one step after it, and before one that
    ``ends_later``.
    """
    to_blocked, to_end = _steps_to(~sector.free), _steps_to(ends_row)
    to_later, to_illegal = _steps_to(ends_later), _steps_to(~sector.steps_aside())
    row, column = sector.starts()
    corner, aside = np.arange(len(row)), 0
    width = to_blocked[row, column]
    while len(corner):
        own = int(aside == 0)  # the corner itself ends nothing
        end, later = (steps[row, column + own] + own for steps in (to_end, to_later))
        which, ahead = runs(np.minimum(width, end + 1))
        yield corner[which], ahead, np.full(len(which), aside)
        width = np.minimum.reduce([width, end + 1, later, to_illegal[row, column]])
        aside += 1
        seeing = width > 0
        corner, width, row = corner[seeing], width[seeing], row[seeing] + 1
        column = column[seeing] + int(sector.slanted)


def _steps_to(wanted: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "rows columns_plus_one"]:
    """Steps from each cell of a row, and from behind its last, to the first that is wanted, or to the border."""
    columns = wanted.shape[1]
    place = np.pad(np.where(wanted, np.arange(columns), columns), ((0, 0), (0, 1)), constant_values=columns)
    return np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1] - np.arange(columns + 1)


def _blocked_diagonals(free: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "4 rows columns"]:
    """Of each cell, whether a path can go around its diagonal neighbor, in each of the diagonal directions."""
    rows, columns = free.shape
    around = np.pad(free, 1)

    def beside(k: int, m: int) -> Bool[np.ndarray, "rows columns"]:
        return around[1 + k : 1 + k + rows, 1 + m : 1 + m + columns]

    return np.stack([free & beside(k, 0) & beside(0, m) & ~beside(k, m) for k, m in _DIAGONALS])


def _joined(found: list[tuple[np.ndarray, np.ndarray]]) -> tuple[Cells, Cells]:
    none = [np.zeros(0, np.int64)]
    return np.concatenate(none + [corner for corner, _ in found]), np.concatenate(none + [cell for _, cell in found])
