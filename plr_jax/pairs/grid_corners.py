"""Distances between all corners of a grid, by elimination over the graph of those that see each other.

Corners are taken out of the graph one by one, each time one with the fewest neighbors, which are joined by edges as
long as the way over it. Distances of the last ones are known first; from one that was taken out a shortest path to
those that were taken out later leads over one of its neighbors. So each takes a minimum over a few rows of distances,
where a search from it would visit all corners. No row depends on the order of sums, which are whole numbers.

The neighbors of a corner when it is taken out are among its *ancestors*: the one that is taken out first is its
parent, and so on. Any path between two corners passes a common ancestor of both. Up to :data:`MOST_IN_TABLE` corners,
all distances are kept; of more, only those to ancestors, of which there are few where a map has narrow passages.

References:
    D. J. Rose, R. E. Tarjan and G. S. Lueker, "Algorithmic aspects of vertex elimination on graphs", SIAM J. Comput.
    5(2), 1976. J. Dibbelt, B. Strasser and D. Wagner, "Customizable contraction hierarchies", ACM JEA 21, 2016.
    D. Ouyang et al., "When hierarchy meets 2-hop-labeling", SIGMOD 2018.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int32, Integer, Shaped
from tqdm import tqdm

from plr_jax._arrays import parts, ragged_indices

_Numbers = TypeVar("_Numbers")

# Lengths of steps in units, as integers, so that sums have no rounding and do not depend on their order.
STRAIGHT = {4: 1, 8: 985}
DIAGONAL = {4: 2, 8: 1393}  # 1393 / 985 is a convergent of the square root of 2, 3.6e-7 below it


def open_length(connectivity: int, rows: _Numbers, columns: _Numbers) -> _Numbers:
    """Length in units of a shortest path between cells so many rows and columns apart, without obstacles.

    Of arrays of integers at least 0, NumPy or JAX. A diagonal step of a 4-connected grid is two straight ones.
    """
    straight = abs(rows - columns)  # pyright: ignore[reportOperatorIssue]
    diagonal = (rows + columns - straight) // 2  # pyright: ignore[reportOperatorIssue]
    return STRAIGHT[connectivity] * straight + DIAGONAL[connectivity] * diagonal


FAR = 2**30
"""No path, in units: no sum of distances that are there reaches it."""
MOST_IN_TABLE = 2**14
"""Corners between which all distances are kept: of 8 bits, they take 134 MB, and four times that until then."""
_MOST_BYTES = 2**30  # of the largest table
_TOO_LARGE = (
    "The grid's obstacles have too many corners for tables of 2**30 bytes, or for minutes of work: cut the map, or "
    "ask a GridGraph, which searches."
)
_TOO_LONG = f"Paths of the grid are too long: distances of pairs go up to {FAR} units. Cut the map."
_DIAGONALS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
_AT_ONCE = 2**22  # cells of runs that are listed at once

_Cells = Int[np.ndarray, "pairs"]


def corner_cells(free: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Corners: free cells with a blocked cell diagonally beside them, and free cells on both sides of that one."""
    return np.logical_or.reduce(_blocked_diagonals(free))


def corners_in_sight(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> tuple[_Cells, _Cells]:
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
    free: Bool[np.ndarray, "rows columns"], connectivity: int
) -> tuple[Int[np.ndarray, "cells_plus_one"], Int32[np.ndarray, "pairs"]]:
    """Return the corners that each cell sees and is taut at, with no such corner between them.

    Cells and corners are numbered in row-major order. The first result is where the corners of each cell begin, the
    second the corners, in the order of their numbers. Raises ``ValueError`` if a byte for each is too much.
    """
    from scipy.sparse import csr_array

    # 1. Runs of cells that are taut at a corner: the corner, the first cell, the step to the next, and their number.
    found = [np.zeros((4, 0), np.int64)]
    for sector in _sectors(free, connectivity):
        # Beyond a corner in this sector, those further ahead are taut at it if a blocked diagonal of it is ahead, and
        # those further aside if one is aside; a diagonal step goes ahead as well.
        blocked = sector.blocked
        at = {along: cells[sector.row, sector.column] for along, cells in blocked.items()}
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
            found.append(np.stack([corner[some], first, np.full(len(first), sector.column_step), length[some]]))
    taut = np.concatenate(found, axis=1)
    if taut[3].sum() > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    corner, first, step, length = taut[:, np.argsort(taut[0], kind="stable")]
    # 2. The cells of these runs, listed by corners.
    cells, end = np.empty(int(length.sum()), np.int32), 0
    for some in parts(length, _AT_ONCE):
        run, place = ragged_indices(length[some])
        cells[end : end + len(run)] = first[some][run] + step[some][run] * place
        end += len(run)
    num_corners = int(corner.max(initial=-1)) + 1
    first = np.append(0, np.cumsum(np.bincount(corner, weights=length, minlength=num_corners))).astype(np.int32)
    # 3. The corners, listed by cells: the transposed sparse matrix, in linear time.
    table = csr_array((np.ones(len(cells), np.int8), cells, first), shape=(num_corners, free.size)).tocsc()
    return table.indptr, table.indices


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

    def cells(self, corner: _Cells, aside: int, ahead: _Cells) -> _Cells:
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
) -> Iterator[tuple[_Cells, _Cells, int]]:
    """Row by row, what corners see in a sector: their numbers, how many cells ahead, and the steps aside.

    A row ends with the first cell that ``ends_row``; later rows end one step after it, and before one that
    ``ends_later``.
    """
    beside = np.pad(sector.free, ((0, 1), (0, 1)))
    may_step_aside = sector.free & beside[1:, :-1]
    if sector.slanted:
        may_step_aside &= beside[:-1, 1:] & beside[1:, 1:]
    to_blocked, to_end = _steps_to(~sector.free), _steps_to(ends_row)
    to_later, to_illegal = _steps_to(ends_later), _steps_to(~may_step_aside)
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


_NO_PATH = FAR + 2**20  # so that what is a little less is no path either
_MOST_STEPS_FROM_CENTER = {4: 63, 8: 16}  # so that twice as many units fit into 8 bits, or into 16
_MOST_WORK = 2**27  # pairs of neighbors of all corners when they are taken out; more take minutes
_ANCESTOR_BYTES = 8


def looked_up(table: Shaped[Array, "rows ..."], index: Int[Array, "*n"]) -> Shaped[Array, "..."]:
    """Rows of a table, by indices that are certainly inside the table."""
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class CornerTable:
    """Distances of corners in units, as those of centers nearby and small differences.

    Attributes:
        center: Number of the center of each corner, which a short path joins to it.
        between_centers: Their distances, at least :data:`FAR` if there is no path.
        differences: How much longer each corner's way to those before it and to itself is than that between their
            centers, row by row of a triangle.
    """

    center: Integer[Array, "corners"]
    between_centers: Int32[Array, "centers centers"]
    differences: Integer[Array, "triangle"]

    def between(self, a: Int32[Array, "*#n"], b: Int32[Array, "*#n"]) -> Int32[Array, "*#n"]:
        """Distances in units between corners, at least :data:`FAR` without a path."""
        high, low = jnp.maximum(a, b), jnp.minimum(a, b)
        center, other = (looked_up(self.center, corner).astype(jnp.int32) for corner in (a, b))
        between = looked_up(self.between_centers.ravel(), center * len(self.between_centers) + other)
        return between + looked_up(self.differences, (high * (high + 1) >> 1) + low).astype(jnp.int32)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class CornerLabels:
    """Distances of corners to their ancestors in units, from the last one taken out to themselves.

    Attributes:
        first: Where the ancestors of each corner begin, and their number.
        ancestor: Numbers of these.
        length: Their distances.
    """

    first: Int32[Array, "corners_plus_one"]
    ancestor: Int32[Array, "ancestors"]
    length: Int32[Array, "ancestors"]

    def between(self, a: Int32[Array, "*#n"], b: Int32[Array, "*#n"]) -> Int32[Array, "*#n"]:
        """As those of a table: the least sum over common ancestors."""
        begins = [looked_up(self.first, corner) for corner in (a, b)]
        common = jnp.minimum(
            *(looked_up(self.first, corner + 1) - looked_up(self.first, corner) for corner in (a, b))
        )

        def at(table: Int32[Array, "ancestors"], place: Int32[Array, ""]) -> list[Int32[Array, "..."]]:
            last = len(table) - 1
            return [looked_up(table, jnp.minimum(begin + place, last)) for begin in begins]

        def is_common(place: Int32[Array, ""]) -> Bool[Array, "..."]:
            one, other = at(self.ancestor, place)
            return (place < common) & (one == other)

        def with_place(state: _PlaceAndLeast) -> _PlaceAndLeast:
            place, least = state
            one, other = at(self.length, place)
            return place + 1, jnp.where(is_common(place), jnp.minimum(least, one + other), least)

        start = jnp.int32(0), jnp.full(common.shape, _NO_PATH, jnp.int32)
        return lax.while_loop(lambda state: is_common(state[0]).any(), with_place, start)[1]


_PlaceAndLeast = tuple[Int32[Array, ""], Int32[Array, "..."]]


_Edges = list[dict[int, int]]


def corner_distances(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> CornerTable | CornerLabels:
    """Distances between all corners of a grid, in row-major order.

    Raises:
        ValueError: If paths are so long that their lengths do not fit into 30 bits, if the tables would take too many
            bytes, or if so many corners are in passages so wide that taking them out would take minutes.
    """
    most = FAR - 2 * int(open_length(connectivity, *map(np.int64, free.shape)))  # to which a query adds the rest
    if most < 0:
        raise ValueError(_TOO_LONG)
    # 1. The graph of corners in sight: the length of each corner's edges, by the other end.
    places = np.flatnonzero(corner_cells(free))
    ends = corners_in_sight(free, connectivity)
    (row, column), (other_row, other_column) = (np.divmod(places[end], free.shape[1]) for end in ends)
    lengths = np.minimum(open_length(connectivity, abs(row - other_row), abs(column - other_column)), FAR)
    edges: _Edges = [{} for _ in places]
    for a, b, length in zip(*(one.tolist() for one in (*ends, lengths)), strict=True):
        edges[a][b] = edges[b][a] = length
    size, kind = len(edges) * (len(edges) + 1) // 2, np.dtype(np.int8 if connectivity == 4 else np.int16)
    has_table = len(edges) <= MOST_IN_TABLE
    if has_table and size * kind.itemsize > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    # 2. Elimination, and the distances of the corners that were taken out last first.
    with tqdm(
        desc="construct_grid_pairs", unit=" corners", total=2 * len(edges), delay=2, leave=False, disable=None
    ) as progress:
        order, uppers = _eliminated(edges, progress)
        if not has_table:
            labels = _labels(order, uppers, progress)
            if labels.length.max(initial=0) > most // 2:
                raise ValueError(_TOO_LONG)
            return labels
        distances = _all_pairs(order, uppers, progress)
    part = np.arange(len(order))  # that paths join: all are taken out of it but one that has no neighbors left
    for corner in reversed(order):
        part[corner] = part[next(iter(uppers[corner]), corner)]
    if np.count_nonzero(distances < most) != (np.bincount(part, minlength=1) ** 2).sum():
        raise ValueError(_TOO_LONG)
    # 3. Centers, so many that each corner is near one, and differences from the distances between centers.
    radius = _MOST_STEPS_FROM_CENTER[connectivity] * STRAIGHT[connectivity]
    center, centers = np.full(len(distances), -1), []
    for corner, row in enumerate(distances):
        if center[corner] < 0:
            center[(center < 0) & (row <= radius)] = len(centers)
            centers.append(corner)
    centers = np.array(centers, np.int64)
    between = distances[np.ix_(centers, centers)]
    differences = np.empty(size, kind)
    for corner, row in enumerate(distances):
        begin = corner * (corner + 1) // 2
        expected = between[center[corner], center[: corner + 1]]
        differences[begin : begin + corner + 1] = row[: corner + 1] - expected
    return CornerTable(*map(jnp.asarray, (center.astype(np.min_scalar_type(len(centers))), between, differences)))


def _eliminated(edges: _Edges, progress: tqdm) -> tuple[list[int], _Edges]:
    """An order of elimination, and the neighbors that each corner has when it is taken out.

    Of corners with as few neighbors those are first that are not above others, so that chains have few ancestors.
    """
    level = [0] * len(edges)
    heap = [(len(nearby), 0, corner) for corner, nearby in enumerate(edges)]
    heapq.heapify(heap)
    is_left, order, num_edges, work = [True] * len(edges), [], 0, 0
    while heap:
        key, _, corner = heapq.heappop(heap)
        nearby = edges[corner]
        if not is_left[corner] or key != len(nearby) + level[corner]:
            continue
        is_left[corner] = False
        order.append(corner)
        num_edges, work = num_edges + len(nearby), work + len(nearby) ** 2
        is_labeled = len(edges) > MOST_IN_TABLE  # then each neighbor is one of the ancestors
        if work > _MOST_WORK or (is_labeled and _ANCESTOR_BYTES * num_edges > _MOST_BYTES):
            raise ValueError(_TOO_LARGE)
        progress.update()
        for a, to_a in nearby.items():
            of_a = edges[a]
            del of_a[corner]
            for b, to_b in nearby.items():
                if b != a and to_a + to_b < of_a.get(b, FAR):
                    of_a[b] = to_a + to_b
            level[a] = max(level[a], level[corner] + 1)
            heapq.heappush(heap, (len(of_a) + level[a], level[a], a))
    return order, edges


def _labels(order: list[int], uppers: _Edges, progress: tqdm) -> CornerLabels:
    """Distances of all corners to their ancestors, those of the last ones first."""
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    depth, parent = np.zeros(len(order), np.int64), np.full(len(order), -1)
    for corner in reversed(order):
        if uppers[corner]:
            parent[corner] = min(uppers[corner], key=place.__getitem__)
            depth[corner] = depth[parent[corner]] + 1
    first = np.concatenate([[0], np.cumsum(depth + 1)])
    if _ANCESTOR_BYTES * first[-1] > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    ancestor, length = (np.zeros(first[-1], np.int32) for _ in range(2))
    for corner in reversed(order):
        progress.update()
        own = slice(first[corner], first[corner + 1])
        ancestor[own.stop - 1] = corner
        if not uppers[corner]:
            continue
        above = slice(own.start, own.stop - 1)
        ancestor[above] = ancestor[first[parent[corner]] : first[parent[corner] + 1]]
        nearby = np.array(list(uppers[corner]))
        lengths = np.fromiter(uppers[corner].values(), np.int64, len(nearby))
        # Of a neighbor and an ancestor one is above the other, whose list has their distance.
        places = np.arange(depth[corner])
        of_neighbor = first[nearby][:, None] + places
        of_ancestor = first[ancestor[above]] + depth[nearby][:, None]
        over = length[np.where(places <= depth[nearby][:, None], of_neighbor, of_ancestor)] + lengths[:, None]
        length[above] = np.minimum(over.min(axis=0), FAR)
    return CornerLabels(*map(jnp.asarray, (first.astype(np.int32), ancestor, length)))


def _all_pairs(order: list[int], uppers: _Edges, progress: tqdm) -> Int32[np.ndarray, "corners corners"]:
    """Distances of all corners, those that were taken out last first."""
    place = np.empty(len(order), np.int64)
    place[order[::-1]] = np.arange(len(order))
    distances = np.full((len(order), len(order)), _NO_PATH, np.int32)
    for known, corner in enumerate(reversed(order)):
        progress.update()
        distances[known, known] = 0
        nearby = uppers[corner]
        if nearby:
            lengths = np.fromiter(nearby.values(), np.int32, len(nearby))
            over = distances[place[list(nearby)], :known] + lengths[:, None]
            distances[known, :known] = distances[:known, known] = np.minimum(over.min(axis=0), _NO_PATH)
    return distances[np.ix_(place, place)]
