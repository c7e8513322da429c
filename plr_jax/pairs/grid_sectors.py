"""Which cells each corner of a grid sees, by scans of the sectors around it, and the distances between corners.

Cells of a sector of a corner are numbered by the steps to them: ``ahead`` along the rows of a view of the grid, and
``aside``, to the next row, which on 8-connected grids is a diagonal step. A sector is a quadrant or an octant; views
are flipped and transposed so that all sectors look alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import runs

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


# Distances between all corners of a grid: shortest paths over the graph of those that see each other.


FAR = {np.dtype(np.uint16): 2**16 - 1, np.dtype(np.int32): 2**30}
"""What stands for no path, by type: no sum of distances that are there reaches it."""

_AT_ONCE = 2**22  # distances held in double precision


def corner_distances(
    free: Bool[np.ndarray, "rows columns"], connectivity: int
) -> Shaped[np.ndarray, "corners_by_corners"]:
    """Distance in units of each corner to those before it and to itself, row by row of a triangle.

    As 16-bit integers if they are all small enough, else 32-bit ones; see :data:`FAR`.
    """
    graph = _graph(free, connectivity)
    corners = np.count_nonzero(corner_cells(free))
    triangle = np.empty(corners * (corners + 1) // 2)
    step = max(_AT_ONCE // max(corners, 1), 1)
    for begin in range(0, corners, step):
        block = np.arange(begin, min(begin + step, corners))
        of_block = csgraph.dijkstra(graph, directed=False, indices=block)
        before = np.arange(corners) <= block[:, None]
        triangle[block[0] * (block[0] + 1) // 2 : (block[-1] + 1) * (block[-1] + 2) // 2] = of_block[before]
    return _as_integers(triangle, 2 * int(open_length(connectivity, *map(np.int64, free.shape))))


def _graph(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> csr_array:
    """Corners, joined if they see each other with no corner between them."""
    places = np.flatnonzero(corner_cells(free))
    corner, cell = seen_by_corners(free, connectivity)
    at = np.minimum(np.searchsorted(places, cell), len(places) - 1)
    is_corner = (places[at] == cell) if len(places) else np.zeros(0, bool)
    a, b = corner[is_corner], at[is_corner]
    (row, column), (other_row, other_column) = (np.divmod(places[ends], free.shape[1]) for ends in (a, b))
    lengths = open_length(connectivity, abs(row - other_row), abs(column - other_column)).astype(float)
    return csr_array((lengths, (a, b)), shape=(len(places), len(places)))


def _as_integers(distances: Float[np.ndarray, "n"], most_beside: int) -> Shaped[np.ndarray, "n"]:
    """Distances as integers, to which at most so much is added in a query."""
    longest = int(distances.max(initial=0, where=np.isfinite(distances))) + most_beside
    fitting = [dtype for dtype, far in FAR.items() if longest < far]
    if not fitting:
        raise ValueError(f"Paths of up to {longest} units are too long; distances of pairs go up to {2**30}.")
    return np.where(np.isfinite(distances), distances, FAR[fitting[0]]).astype(fitting[0])
