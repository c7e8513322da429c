"""Distances between all obstacle corners of a grid, by vertex elimination on the graph of visible corners.

Eliminate corners one by one, and join the neighbors of each by edges as long as the path through it, unless shorter
edges join them. In reverse order, each distance is then a minimum over the corner's neighbors at its elimination.
``GRIDS.md`` has the proofs and references.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int32, Integer, Shaped
from tqdm import tqdm

from plr_jax._arrays import parts, ragged_indices
from plr_jax._compiled import pytree

# Lengths of steps in units: integers, so that sums are exact in any order.
STRAIGHT = {4: 1, 8: 985}
DIAGONAL = {4: 2, 8: 1393}  # 1393 / 985 is a convergent of the square root of 2, 3.6e-7 below it


def open_length(connectivity: int, rows: Any, columns: Any) -> Any:
    # Integers: a straight step has the length `STRAIGHT[connectivity]`.
    straight = abs(rows - columns)
    diagonal = (rows + columns - straight) // 2
    return STRAIGHT[connectivity] * straight + DIAGONAL[connectivity] * diagonal


FAR = 2**30  # length in units that stands for no path: no sum of existing distances reaches it
MOST_IN_TABLE = 2**14  # most corners with a full table: 134 MB at 8 bits, four times as much during construction
_MOST_BYTES = 2**30  # size of the largest table
_TOO_LARGE = (
    "The grid's obstacles have too many corners for tables of 2**30 bytes, or for minutes of work: cut the map, or "
    "use a GridGraph, which searches."
)
_TOO_LONG = f"Paths of the grid are too long: distances of pairs go up to {FAR} units. Cut the map."
_DIAGONALS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
_AT_ONCE = 2**22  # cells listed in one step
Grid = Bool[np.ndarray, "rows columns"]
_Cells = Int[np.ndarray, "pairs"]


def corner_cells(free: Grid) -> Grid:
    """Return the mask of obstacle corners: free cells diagonal to a blocked cell, with both cells in between free."""
    return np.logical_or.reduce(_blocked_diagonals(free))


def corners_in_sight(free: Grid, connectivity: int) -> tuple[_Cells, _Cells]:
    """Return all pairs of obstacle corners, by index, that see each other with no third corner in between."""
    places = np.flatnonzero(corner_cells(free))
    number = np.full(free.size, -1, np.int32)
    number[places] = np.arange(len(places))
    pairs = [np.zeros(0, np.int64)]
    for sector in _sectors(free, connectivity):
        corners = np.logical_or.reduce(list(sector.blocked.values()))
        for corner, width, aside in _scan(sector, corners, corners):
            last = number[sector.cells(corner, aside, width - 1)]  # no run continues past a corner
            other = (last >= 0) & (last != corner)
            ends = corner[other], last[other]
            pairs.append(np.minimum(*ends) * len(places) + np.maximum(*ends))
    return np.divmod(np.unique(np.concatenate(pairs)), max(len(places), 1))


def taut_corners(
    free: Grid, connectivity: int
) -> tuple[Int[np.ndarray, " cells_plus_one"], Int32[np.ndarray, " pairs"]]:
    """Return, as a CSR matrix, the obstacle corners where a shortest path from each cell of a grid may bend first."""
    from scipy.sparse import csr_array

    # 1. Collect runs of cells that are taut at a corner: corner, first cell, step, number of cells.
    runs = [np.zeros((4, 0), np.int64)]
    for sector in _sectors(free, connectivity):
        # Paths from cells past a corner can bend at it ("taut") if the cells are further ahead and a blocked diagonal
        # is ahead, or further aside and one is aside. A diagonal step goes ahead as well.
        blocked = sector.blocked
        at = {along: cells[sector.row, sector.column] for along, cells in blocked.items()}
        ahead, aside = blocked[1, 1] | blocked[-1, 1], blocked[1, 1] | blocked[1, -1]
        # Whether cells are taut at a corner: those straight ahead, straight aside, and both ahead and aside.
        if_ahead, if_aside, if_both = (at[diagonal] | at[other_diagonal] for diagonal, other_diagonal in _TAUT)
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
            runs.append(np.stack([corner[some], first, np.full(len(first), sector.column_step), length[some]]))
    taut = np.concatenate(runs, axis=1)
    if taut[3].sum() > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    corner, first, step, length = taut[:, np.argsort(taut[0], kind="stable")]
    # 2. List the cells of these runs by corner.
    cells, end = np.empty(int(length.sum()), np.int32), 0
    for some in parts(length, _AT_ONCE):
        run, place = ragged_indices(length[some])
        cells[end : end + len(run)] = first[some][run] + step[some][run] * place
        end += len(run)
    num_corners = int(corner.max(initial=-1)) + 1
    first = np.append(0, np.cumsum(np.bincount(corner, weights=length, minlength=num_corners))).astype(np.int32)
    # 3. List the corners by cell: transpose a sparse matrix, in linear time.
    table = csr_array((np.ones(len(cells), np.int8), cells, first), shape=(num_corners, free.size)).tocsc()
    return table.indptr, table.indices


# Blocked diagonals around which paths from cells straight ahead, straight aside, and both ahead and aside can bend.
_TAUT = (((1, 1), (-1, 1)), ((1, 1), (1, -1)), ((1, -1), (-1, 1)))


@dataclass(frozen=True)
class _Sector:
    """A quadrant or octant around each corner, in a flipped, mirrored or transposed view of the grid.

    ::

        2 |     . .       In the view, the sector reaches from corner c along rising columns, *ahead*, and rising
        1 |   . . .       rows, *aside*. Row i of an octant (slanted) begins i columns ahead of the corner, and row i
        0 | c . . .       of a quadrant right beside the corner.
    """

    free: Grid
    blocked: dict[tuple[int, int], Grid]
    row: Int[np.ndarray, " corners"]
    column: Int[np.ndarray, " corners"]
    origin: int  # number in the grid of the view's first cell
    row_step: int
    column_step: int
    slanted: bool  # whether the sector is an octant
    keeps_ahead: bool  # whether this one of two adjacent sectors owns the cells straight ahead of a corner
    keeps_aside: bool

    def cells(self, corner: _Cells, aside: int, ahead: _Cells) -> _Cells:
        # The numbers, in the grid, of cells of corners' sectors.
        column = self.column[corner] + ahead + (aside if self.slanted else 0)
        return self.origin + (self.row[corner] + aside) * self.row_step + column * self.column_step


def _sectors(free: Grid, connectivity: int) -> Iterator[_Sector]:
    """Yield the sectors of all corners: four quadrants, or eight octants if steps may be diagonal."""
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
            # Flipped sectors share the cells ahead; mirrored quadrants or transposed octants, the cells aside.
            keeps_ahead=not flipped,
            keeps_aside=not (transposed if slanted else mirrored),
        )


def _scan(sector: _Sector, ends_row: Grid, ends_later: Grid) -> Iterator[tuple[_Cells, _Cells, int]]:
    # Yield, row by row, the corners that still see cells of the row, how many cells each sees, and the row's number.
    # Row `i` is `i` rows aside of the corner and extends ahead of it. A row ends with its first cell in `ends_row`.
    # Later rows are at most as long, and end before the columns of cells in `ends_later`.
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
        offset = int(aside == 0)  # the corner itself ends nothing
        end, later = (steps[row, column + offset] + offset for steps in (to_end, to_later))
        yield corner, np.minimum(width, end + 1), aside
        width = np.minimum.reduce([width, end + 1, later, to_illegal[row, column]])
        aside += 1
        seeing = width > 0
        corner, width, row = corner[seeing], width[seeing], row[seeing] + 1
        column = column[seeing] + int(sector.slanted)


def _steps_to(wanted: Grid) -> Int32[np.ndarray, "rows columns_plus_one"]:
    """Return the steps from each cell to the first wanted cell at or after it in its row, or to the row's end."""
    rows, columns = wanted.shape
    place = np.full((rows, columns + 1), columns, np.int32)
    np.copyto(place[:, :-1], np.arange(columns, dtype=np.int32), where=wanted)
    return np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1] - np.arange(columns + 1, dtype=np.int32)


def _blocked_diagonals(free: Grid) -> Shaped[np.ndarray, "4 rows columns"]:
    # For each diagonal direction, mark free cells where a path can bend around the blocked neighbor there.
    rows, columns = free.shape
    around = np.pad(free, 1)

    def beside(k: int, m: int) -> Grid:
        return around[1 + k : 1 + k + rows, 1 + m : 1 + m + columns]

    return np.stack([free & beside(k, 0) & beside(0, m) & ~beside(k, m) for k, m in _DIAGONALS])


_NO_PATH = FAR + 2**20  # FAR or more even after adding differences to it
_MOST_STEPS_FROM_CENTER = {4: 63, 8: 16}  # twice as many steps, in units, fit into 8 or 16 bits
_MOST_WORK = 2**27  # pairs of neighbors joined during elimination; more take minutes
_ANCESTOR_BYTES = 8


def looked_up(table: Any, index: Any) -> Any:
    if isinstance(index, np.ndarray):
        return np.asarray(table)[index]
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")


@pytree
class CornerTable:
    """Distances between all obstacle corners: those between centers near them, plus small differences."""

    center: Integer[Array, " corners"]  # index of a center near each corner
    between_centers: Int32[Array, "centers centers"]
    # For each corner and all up to it, row by row: the distance minus that between the centers near both corners.
    differences: Integer[Array, " triangle"]

    def between(self, a: Any, b: Any) -> Any:
        xp: Any = np if isinstance(a, np.ndarray) else jnp
        high, low = xp.maximum(a, b), xp.minimum(a, b)
        center, other = (looked_up(self.center, corner).astype(np.int32) for corner in (a, b))
        between = looked_up(xp.asarray(self.between_centers).ravel(), center * len(self.between_centers) + other)
        return between + looked_up(self.differences, (high * (high + 1) >> 1) + low).astype(np.int32)


@pytree
class CornerLabels:
    """Distances from each obstacle corner of a grid to its ancestors in a tree; a corner is its own last ancestor.

    The distance between two corners is the least sum of their distances to a common ancestor. Vertex elimination
    gives the tree: a corner's parent is, of its neighbors when it is eliminated, the one eliminated next.
    """

    first: Int32[Array, " corners_plus_one"]  # index of each corner's first entry
    ancestor: Int32[Array, " ancestors"]
    length: Int32[Array, " ancestors"]

    def between(self, a: Any, b: Any) -> Any:
        """Return distances between corners ``a`` and ``b``, arrays that broadcast; ``_NO_PATH`` without a path."""
        begins = [looked_up(self.first, corner) for corner in (a, b)]
        xp: Any = np if isinstance(a, np.ndarray) else jnp
        common = xp.minimum(*(looked_up(self.first, corner + 1) - looked_up(self.first, corner) for corner in (a, b)))

        def at(table: Int32[Array, " ancestors"], place: Any) -> list[Any]:
            last = len(table) - 1
            return [looked_up(table, xp.minimum(begin + place, last)) for begin in begins]

        def is_common(place: Any) -> Any:
            one, other = at(self.ancestor, place)
            return (place < common) & (one == other)

        def with_place(state: tuple[Any, Any]) -> tuple[Any, Any]:
            place, least = state
            one, other = at(self.length, place)
            return place + 1, xp.where(is_common(place), xp.minimum(least, one + other), least)

        start = xp.int32(0), xp.full(common.shape, _NO_PATH, np.int32)
        if xp is np:
            while is_common(start[0]).any():
                start = with_place(start)
            return start[1]
        return lax.while_loop(lambda state: is_common(state[0]).any(), with_place, start)[1]


_Edges = list[dict[int, int]]


def corner_distances(free: Grid, connectivity: int) -> CornerTable | CornerLabels:
    """Return path lengths between all obstacle corners of a grid; ``ValueError`` if they are too many or too long."""
    most = FAR - 2 * int(open_length(connectivity, *map(np.int64, free.shape)))  # a query adds the legs
    if most < 0:
        raise ValueError(_TOO_LONG)
    # 1. Build the graph of corners that see each other: edge lengths by their other end.
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
    # 2. Eliminate corners, and compute distances in reverse order.
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
    part = np.arange(len(order))  # connected component: the last eliminated corner has no neighbors left
    for corner in reversed(order):
        part[corner] = part[next(iter(uppers[corner]), corner)]
    if np.count_nonzero(distances < most) != (np.bincount(part, minlength=1) ** 2).sum():
        raise ValueError(_TOO_LONG)
    # 3. Choose centers so that each corner is near one, and store differences from distances between centers.
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
    # The edges of a corner remain those at its elimination, to corners that are eliminated later.
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
        is_labeled = len(edges) > MOST_IN_TABLE  # neighbors are ancestors then
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
    """Return the distances of each corner to its ancestors, in the reverse order of elimination."""
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
        entries = slice(first[corner], first[corner + 1])
        ancestor[entries.stop - 1] = corner
        if not uppers[corner]:
            continue
        above = slice(entries.start, entries.stop - 1)
        ancestor[above] = ancestor[first[parent[corner]] : first[parent[corner] + 1]]
        nearby = np.array(list(uppers[corner]))
        lengths = np.fromiter(uppers[corner].values(), np.int64, len(nearby))
        # One of a neighbor and an ancestor is an ancestor of the other, whose list has their distance.
        places = np.arange(depth[corner])
        of_neighbor = first[nearby][:, None] + places
        of_ancestor = first[ancestor[above]] + depth[nearby][:, None]
        via_neighbor = length[np.where(places <= depth[nearby][:, None], of_neighbor, of_ancestor)] + lengths[:, None]
        length[above] = np.minimum(via_neighbor.min(axis=0), FAR)
    return CornerLabels(*map(jnp.asarray, (first.astype(np.int32), ancestor, length)))


def _all_pairs(order: list[int], uppers: _Edges, progress: tqdm) -> Int32[np.ndarray, "corners corners"]:
    # In the reverse order of elimination, a corner's neighbors come before it: all paths from it to earlier corners
    # lead over one of them.
    place = np.empty(len(order), np.int64)
    place[order[::-1]] = np.arange(len(order))
    distances = np.full((len(order), len(order)), _NO_PATH, np.int32)
    for n, corner in enumerate(reversed(order)):
        progress.update()
        distances[n, n] = 0
        nearby = uppers[corner]
        if nearby:
            lengths = np.fromiter(nearby.values(), np.int32, len(nearby))
            via_neighbor = distances[place[list(nearby)], :n] + lengths[:, None]
            distances[n, :n] = distances[:n, n] = np.minimum(via_neighbor.min(axis=0), _NO_PATH)
    return distances[np.ix_(place, place)]
