"""Obstacle corners of a grid: from which cells paths bend at them, and the distances between them.

::

    . . . . y    A *corner* (c) is a free cell diagonal to a blocked cell (#), with both cells in between free. Cells
    . c . . .    *see* each other if obstacles block none of the paths between them that are shortest on an empty
    . . # . .    grid. If x and y do not, a shortest path bends first at a corner i and last at a corner j. Then its
    x . # . .    length is open_length(x, i) + D(i, j) + open_length(j, y), with D the distance between corners.

1. :func:`taut_corners` lists for each cell the corners at which a path from there may bend first.
2. :func:`corners_in_sight` finds the edges of a graph of corners.
3. :func:`corner_distances` computes D by vertex elimination on this graph: eliminate corners one by one, and join the
   neighbors of each by edges as long as the path through it, unless shorter edges join them. In reverse order, each
   distance is then a minimum over the corner's neighbors at its elimination.

Step 3 stores D as a :class:`CornerTable` or, for many corners, as :class:`CornerLabels`. ``GRIDS.md`` has the proofs
and references. ``grid_query.py`` has the query.
"""

import heapq
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int32, Integer, Shaped

from plr_jax._arrays import parts, ragged_indices
from plr_jax._compiled import pytree
from plr_jax._progress import Progress

# Lengths of steps in units, by connectivity: integers, so that sums are exact in any order.
STRAIGHT = {4: 1, 8: 985}
DIAGONAL = {4: 2, 8: 1393}  # 1393 / 985 is a convergent of the square root of 2, 3.6e-7 below it
FAR = 2**30  # length in units that stands for no path: no sum of existing distances reaches it
_NO_PATH = FAR + 2**20  # FAR or more even after adding differences to it
# Limits of the tables:
MOST_IN_TABLE = 2**14  # most corners with a full table: 134 MB at 8 bits, four times as much during construction
_MOST_BYTES = 2**30  # size of the largest table
_ANCESTOR_BYTES = 8  # of an ancestor and the distance to it
_MOST_WORK = 2**27  # pairs of neighbors joined during elimination; more take minutes
# Of a `CornerTable`, by connectivity. A difference is at most twice as many steps, in units, and fits into its type.
_MOST_STEPS_FROM_CENTER = {4: 63, 8: 16}
_DIFFERENCE_TYPES = {4: np.dtype(np.int8), 8: np.dtype(np.int16)}
_AT_ONCE = 2**22  # cells listed in one step, which bounds the memory
_MANY = "The grid's obstacles have too many corners for tables of 2**30 bytes, or for minutes of work"
_TOO_LARGE = f"{_MANY}: cut the map, or use a GridGraph, which searches."
_TOO_LONG = f"Paths of the grid are too long: distances of pairs go up to {FAR} units. Cut the map."
_DIAGONALS = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # steps along rows and columns
Grid = Bool[np.ndarray, "rows columns"]
_Cells = Int[np.ndarray, "pairs"]
_Edges = list[dict[int, int]]  # for each corner, lengths of edges by their other end


def open_length(connectivity: int, rows: Any, columns: Any) -> Any:
    """Return the path length between cells that are ``rows`` and ``columns`` apart on an empty grid.

    Lengths are integers, in units of which a straight step has ``STRAIGHT[connectivity]``.
    """
    straight = abs(rows - columns)
    diagonal = (rows + columns - straight) // 2  # the smaller of rows and columns
    return STRAIGHT[connectivity] * straight + DIAGONAL[connectivity] * diagonal


def corner_cells(free: Grid) -> Grid:
    """Return the mask of obstacle corners: free cells diagonal to a blocked cell, with both cells in between free."""
    return np.logical_or.reduce(_blocked_diagonals(free))


def _blocked_diagonals(free: Grid) -> Shaped[np.ndarray, "4 rows columns"]:
    # For each diagonal direction (k, m), mark the cells (c) at which a path can bend around a blocked neighbor there:
    #
    #      c .       k rows and m columns lead from c to the blocked cell.
    #      . #
    #
    rows, columns = free.shape
    around = np.pad(free, 1)

    def beside(k: int, m: int) -> Grid:
        return around[1 + k : 1 + k + rows, 1 + m : 1 + m + columns]

    return np.stack([free & beside(k, 0) & beside(0, m) & ~beside(k, m) for k, m in _DIAGONALS])


def corners_in_sight(free: Grid, connectivity: int) -> tuple[_Cells, _Cells]:
    """Return all pairs of obstacle corners that see each other with no third corner in between.

    Corners have indices in row-major order. The two arrays hold the smaller and the larger index of each pair.
    """
    places = np.flatnonzero(corner_cells(free))
    corner_at = np.full(free.size, -1, np.int32)  # by cell, -1 for none
    corner_at[places] = np.arange(len(places))
    # 1. Scan the sectors of all corners, in rows that end at the first other corner: the two see each other.
    keys = [np.zeros(0, np.int64)]  # corners i < j have the key i * len(places) + j
    for sector in _sectors(free, connectivity):
        is_corner = np.logical_or.reduce(list(sector.blocked.values()))
        for corner, width, row in _scan(sector, is_corner, is_corner):
            last = corner_at[sector.cells(corner, row, width - 1)]
            is_pair = (last >= 0) & (last != corner)
            ends = corner[is_pair], last[is_pair]
            keys.append(np.minimum(*ends) * len(places) + np.maximum(*ends))
    # 2. Keep each pair once: both corners find it.
    return np.divmod(np.unique(np.concatenate(keys)), max(len(places), 1))


def taut_corners(free: Grid, connectivity: int) -> tuple[Int[np.ndarray, " cells_plus_one"], _Cells]:
    """Return, as a CSR matrix, the obstacle corners where a shortest path from each cell of a grid may bend first.

    With the result ``(first, corners)``, the indices of the corners of cell ``i`` are
    ``corners[first[i] : first[i + 1]]``. Cells have indices in row-major order.
    """
    from scipy.sparse import csr_array

    # 1. Collect runs of cells that are taut at a corner c, row by row of each sector: a shortest path from them can
    #    bend at c, around a blocked diagonal neighbor of c. In a quadrant, cells are straight ahead of c (A),
    #    straight aside (S), or both ahead and aside (B). In an octant, each row begins with a cell of kind B.
    #
    #       2 | S B B      Cells A are taut if a blocked diagonal is ahead, cells S if one is aside, and cells B if
    #       1 | S B B      one is ahead or aside but not both.
    #       0 | c A A
    #
    #    Cells past another corner, at which they are taut, are listed for that corner only. Such cells are further
    #    ahead and a blocked diagonal is ahead, or they are further aside and one is aside. A diagonal step goes ahead
    #    as well as aside.
    runs = [np.zeros((4, 0), np.int64)]  # corner, first cell, step, number of cells
    for sector in _sectors(free, connectivity):
        blocked = sector.blocked
        ahead = blocked[1, 1] | blocked[-1, 1]
        aside = blocked[1, 1] | blocked[1, -1]
        either = blocked[1, -1] | blocked[-1, 1]
        taut_ahead, taut_aside, taut_both = (mask[sector.row, sector.column] for mask in (ahead, aside, either))
        taut_first = taut_both if sector.is_slanted else taut_aside
        for corner, width, row in _scan(sector, ahead, ahead | aside if sector.is_slanted else aside):
            # The first cell of row 0 is the corner itself. Adjacent sectors share the cells straight ahead and aside.
            has_first = taut_first[corner] & sector.keeps_aside & (row > 0)
            has_others = taut_both[corner] if row else taut_ahead[corner] & sector.keeps_ahead
            begin = np.where(has_first, 0, 1)
            length = np.where(has_others, width, 1) - begin
            is_run = length > 0
            first = sector.cells(corner[is_run], row, begin[is_run])
            runs.append(np.stack([corner[is_run], first, np.full(len(first), sector.steps[1]), length[is_run]]))
    taut = np.concatenate(runs, axis=1)
    if taut[3].sum() > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    corner, first, step, length = taut[:, np.argsort(taut[0], kind="stable")]
    # 2. List the cells of these runs by corner.
    cells, end = np.empty(int(length.sum()), np.int32), 0
    for part in parts(length, _AT_ONCE):
        run, place = ragged_indices(length[part])
        cells[end : end + len(run)] = first[part][run] + step[part][run] * place
        end += len(run)
    num_corners = int(corner.max(initial=-1)) + 1
    first = np.append(0, np.cumsum(np.bincount(corner, weights=length, minlength=num_corners))).astype(np.int32)
    # 3. List the corners by cell: transpose a sparse matrix, in linear time.
    table = csr_array((np.ones(len(cells), np.int8), cells, first), shape=(num_corners, free.size)).tocsc()
    return table.indptr, table.indices


class _Sector(NamedTuple):
    """A quadrant or octant around each corner, in a flipped, mirrored or transposed view of the grid.

    ::

        2 |     . .       In the view, the sector reaches from corner c along rising columns, *ahead*, and rising
        1 |   . . .       rows, *aside*. Row i of an octant (slanted) begins i columns ahead of the corner, and row i
        0 | c . . .       of a quadrant right beside the corner.
    """

    free: Grid  # the view
    blocked: dict[tuple[int, int], Grid]  # corners with a blocked neighbor, by the neighbor's direction in the view
    place: Int[np.ndarray, " corners"]  # number of each corner's cell in the grid
    row: Int[np.ndarray, " corners"]  # of each corner in the view
    column: Int[np.ndarray, " corners"]
    steps: tuple[int, ...]  # by which the numbers of cells change from row to row, and from column to column
    is_slanted: bool  # whether the sector is an octant
    keeps_ahead: bool  # whether this one of two adjacent sectors owns the cells straight ahead of a corner
    keeps_aside: bool

    def cells(self, corner: _Cells, aside: int, ahead: _Cells) -> _Cells:
        # The numbers, in the grid, of one cell of each corner's sector: in row `aside`, at index `ahead` of the row.
        columns = ahead + aside if self.is_slanted else ahead
        return self.place[corner] + aside * self.steps[0] + columns * self.steps[1]


def _sectors(free: Grid, connectivity: int) -> Iterator[_Sector]:
    """Yield the sectors of all corners: four quadrants, or eight octants if steps may be diagonal."""
    # A view is the grid, transposed or not, with rows reversed if flipped, with columns reversed if mirrored.
    free, place = np.ascontiguousarray(free), np.flatnonzero(corner_cells(free))
    corners = np.unravel_index(place, free.shape)
    is_slanted = connectivity == 8
    both = (False, True)
    for is_transposed, is_flipped, is_mirrored in product(both[: 1 + is_slanted], both, both):
        row, column = corners[::-1] if is_transposed else corners
        view = (free.T if is_transposed else free)[:: -1 if is_flipped else 1, :: -1 if is_mirrored else 1]
        steps, view = view.strides, np.ascontiguousarray(view)  # a cell takes a byte
        blocked = dict(zip(_DIAGONALS, _blocked_diagonals(view), strict=True))
        row = view.shape[0] - 1 - row if is_flipped else row
        column = view.shape[1] - 1 - column if is_mirrored else column
        # Flipped sectors share the cells ahead; mirrored quadrants or transposed octants, the cells aside.
        keeps_ahead = not is_flipped
        keeps_aside = not (is_transposed if is_slanted else is_mirrored)
        yield _Sector(view, blocked, place, row, column, steps, is_slanted, keeps_ahead, keeps_aside)


def _scan(sector: _Sector, ends_row: Grid, ends_later: Grid) -> Iterator[tuple[_Cells, _Cells, int]]:
    """Yield ``(corner, width, i)`` for row ``i`` = 0, 1, ... of the sectors: which corners see how many of its cells.

    Row ``i`` of a corner's sector is ``i`` rows aside of the corner, and its first ``width`` cells are seen.
    ``ends_row`` and ``ends_later`` are masks of cells. A row ends with its first cell in ``ends_row``. Later rows are
    at most as long, and end before the column (in an octant: the diagonal) of each cell in ``ends_later``.
    """
    #    2 | v v . .      A corner c sees a cell of the next row if it sees the cell before, straight or diagonally,
    #    1 | v v # .      and all cells up to there allow this step. Here it sees the cells v and *. Row 0 ends with
    #    0 | c v v * .    a cell in `ends_row` (*), row 1 before a blocked cell (#), and row 2 is as short as row 1.
    beside = np.pad(sector.free, ((0, 1), (0, 1)))
    may_step_aside = sector.free & beside[1:, :-1]
    if sector.is_slanted:
        may_step_aside &= beside[:-1, 1:] & beside[1:, 1:]
    to_end, to_later, to_illegal = map(_steps_to, (ends_row, ends_later, ~may_step_aside))
    row, column = sector.row, sector.column  # of the first cell of each corner's current row
    corner, aside = np.arange(len(row)), 0
    width = _steps_to(~sector.free)[row, column]
    while len(corner):
        # 1. This row has the cells up to its first one in `ends_row`: `end + 1` cells if it is long enough.
        offset = int(aside == 0)  # the corner itself ends nothing
        end, later = (steps[row, column + offset] + offset for steps in (to_end, to_later))
        yield corner, np.minimum(width, end + 1), aside
        # 2. The next row has at most as many: those before the first cell in `ends_later` and the first illegal step.
        width = np.minimum.reduce([width, end + 1, later, to_illegal[row, column]])
        aside += 1
        is_seeing = width > 0
        corner, width, row = corner[is_seeing], width[is_seeing], row[is_seeing] + 1
        column = column[is_seeing] + int(sector.is_slanted)


def _steps_to(wanted: Grid) -> Int32[np.ndarray, "rows columns_plus_one"]:
    """Return the number of steps from each cell to the first wanted cell at or after it in its row.

    Without such a cell, the result is the number of steps to the end of the row.
    """
    rows, columns = wanted.shape
    place = np.full((rows, columns + 1), columns, np.int32)  # the column of wanted cells, else the row's end
    np.copyto(place[:, :-1], np.arange(columns, dtype=np.int32), where=wanted)
    return np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1] - np.arange(columns + 1, dtype=np.int32)


def looked_up(table: Any, index: Any) -> Any:
    """Return ``table[index]``, a NumPy array if ``index`` is one, else a JAX array; indices must be in range."""
    if isinstance(index, np.ndarray):
        return np.asarray(table)[index]
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")


@pytree
class CornerTable:
    """Distances between all obstacle corners, each stored as a small difference from a distance between two centers.

    A center is a corner that represents the corners near it.

    ::

        a ----------- b        D(a, b) = D(center of a, center of b) + difference(a, b)
         :             :
          center of a   center of b
    """

    center: Integer[Array, " corners"]  # index of a center near each corner
    between_centers: Int32[Array, "centers centers"]
    # The distance of corners a >= b, minus the distance between the centers near both, is at index a (a + 1) / 2 + b.
    differences: Integer[Array, " triangle"]

    def between(self, a: Any, b: Any) -> Any:
        """Return integer path lengths between corners with indices ``a`` and ``b``; at least FAR without a path.

        The shapes of ``a`` and ``b`` must broadcast.
        """
        xp: Any = np if isinstance(a, np.ndarray) else jnp
        high, low = xp.maximum(a, b), xp.minimum(a, b)
        center, other = (looked_up(self.center, corner).astype(np.int32) for corner in (a, b))
        between = looked_up(xp.asarray(self.between_centers).ravel(), center * len(self.between_centers) + other)
        return between + looked_up(self.differences, (high * (high + 1) >> 1) + low).astype(np.int32)


@pytree
class CornerLabels:
    """Path lengths from each obstacle corner of a grid to its ancestors in a tree.

    A corner counts as its own last ancestor. The distance between two corners is the least sum of their distances to
    a common ancestor. Vertex elimination gives the tree: the parent of a corner is the neighbor that is eliminated
    next after the corner.
    """

    first: Int32[Array, " corners_plus_one"]  # index of each corner's first entry
    ancestor: Int32[Array, " ancestors"]
    length: Int32[Array, " ancestors"]

    def between(self, a: Any, b: Any) -> Any:
        """Return integer path lengths between corners with indices ``a`` and ``b``; ``_NO_PATH`` without a path.

        The shapes of ``a`` and ``b`` must broadcast.
        """
        # Lists of ancestors begin at the root: the common ones come first, up to the last common ancestor.
        #
        #     ancestors of a: root, child, grandchild, ..., a
        #     ancestors of b: root, child, other, ..., b
        #
        begins = [looked_up(self.first, corner) for corner in (a, b)]
        xp: Any = np if isinstance(a, np.ndarray) else jnp
        shorter = xp.minimum(*(looked_up(self.first, end + 1) - looked_up(self.first, end) for end in (a, b)))

        def at(table: Int32[Array, " ancestors"], place: Any) -> list[Any]:
            last = len(table) - 1
            return [looked_up(table, xp.minimum(begin + place, last)) for begin in begins]

        def is_common(place: Any) -> Any:
            return (place < shorter) & xp.equal(*at(self.ancestor, place))

        def after_place(state: tuple[Any, Any]) -> tuple[Any, Any]:
            place, least = state
            return place + 1, xp.where(is_common(place), xp.minimum(least, xp.add(*at(self.length, place))), least)

        state = xp.int32(0), xp.full(shorter.shape, _NO_PATH, np.int32)
        if xp is np:
            while is_common(state[0]).any():
                state = after_place(state)
            return state[1]
        return lax.while_loop(lambda state: is_common(state[0]).any(), after_place, state)[1]


def corner_distances(free: Grid, connectivity: int) -> CornerTable | CornerLabels:
    """Return the path lengths between all obstacle corners of a grid.

    The result is a :class:`CornerTable` of all pairs of corners or, for many corners, :class:`CornerLabels`, which
    have the path lengths from each corner to its ancestors in a tree. ``ValueError`` if there are too many corners,
    or paths are too long.
    """
    most = FAR - 2 * int(open_length(connectivity, *map(np.int64, free.shape)))  # a query adds two straight legs
    if most < 0:
        raise ValueError(_TOO_LONG)
    # 1. Build the graph of corners that see each other, with edges as long as on an empty grid.
    places, ends = np.flatnonzero(corner_cells(free)), corners_in_sight(free, connectivity)
    (row, column), (other_row, other_column) = (np.divmod(places[end], free.shape[1]) for end in ends)
    lengths = np.minimum(open_length(connectivity, abs(row - other_row), abs(column - other_column)), FAR)
    edges: _Edges = [{} for _ in places]
    for a, b, length in zip(*(each.tolist() for each in (*ends, lengths)), strict=True):
        edges[a][b] = edges[b][a] = length
    has_table = len(edges) <= MOST_IN_TABLE
    if has_table and len(edges) * (len(edges) + 1) // 2 * _DIFFERENCE_TYPES[connectivity].itemsize > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    # 2. Eliminate corners, and compute distances in reverse order: to ancestors if there are many corners, else all.
    with Progress("construct_grid_pairs", "corners", 2 * len(edges)) as progress:
        order, uppers = _eliminated(edges, progress)
        if not has_table:
            labels = _labels(order, uppers, progress)
            if labels.length.max(initial=0) > most // 2:
                raise ValueError(_TOO_LONG)
            return labels
        distances = _all_pairs(order, uppers, progress)
    # 3. Check that all corners of a connected component have distances below `most`. The corner of a component that
    #    is eliminated last, which has no neighbors left, stands for the component.
    component = np.arange(len(order))
    for corner in reversed(order):
        component[corner] = component[next(iter(uppers[corner]), corner)]
    if np.count_nonzero(distances < most) != (np.bincount(component, minlength=1) ** 2).sum():
        raise ValueError(_TOO_LONG)
    return _compressed(distances, connectivity)


def _compressed(distances: Int32[np.ndarray, "corners corners"], connectivity: int) -> CornerTable:
    # Choose centers so that each corner is near one. Distances differ from distances between the centers of both
    # corners by at most twice the radius, so that the differences need few bits.
    radius = _MOST_STEPS_FROM_CENTER[connectivity] * STRAIGHT[connectivity]
    center, centers = np.full(len(distances), -1), []
    for corner, lengths in enumerate(distances):
        if center[corner] < 0:
            center[(center < 0) & (lengths <= radius)] = len(centers)
            centers.append(corner)
    between = distances[np.ix_(centers, centers)]
    # List the differences row by row: row a has those to the corners b <= a.
    kind = _DIFFERENCE_TYPES[connectivity]
    rows = (lengths[: a + 1] - between[center[a], center[: a + 1]] for a, lengths in enumerate(distances))
    differences = np.concatenate([np.zeros(0, kind), *(row.astype(kind) for row in rows)])
    return CornerTable(*map(jnp.asarray, (center.astype(np.min_scalar_type(len(centers))), between, differences)))


def _eliminated(edges: _Edges, progress: Progress) -> tuple[list[int], _Edges]:
    """Eliminate all corners of a graph; return their order, and each corner's edges to corners eliminated later.

    To eliminate a corner, join its neighbors by edges as long as the path through the corner. ``edges[i]`` maps each
    neighbor of corner ``i`` to the length of the edge. It is modified in place, and becomes the second result: the
    edges that corner ``i`` has when it is eliminated.
    """
    # 1. Choose the corner with the least sum of the number of its neighbors and its level: elimination joins all
    #    neighbors to one another, and the tree of ancestors should be shallow. The level is the length of the longest
    #    chain of corners eliminated before, each of which was a neighbor of the next. A corner is pushed again when
    #    either changes; older entries of the heap are skipped.
    is_labeled = len(edges) > MOST_IN_TABLE  # neighbors are ancestors then
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
        if work > _MOST_WORK or (is_labeled and _ANCESTOR_BYTES * num_edges > _MOST_BYTES):
            raise ValueError(_TOO_LARGE)
        progress.update()
        # 2. Remove the corner v, and join its neighbors a and b: w(a, b) becomes at most w(a, v) + w(v, b).
        #
        #      a --- v --- b    becomes    a --- b
        #
        for a, to_a in nearby.items():
            of_a = edges[a]
            del of_a[corner]
            for b, to_b in nearby.items():
                if b != a and to_a + to_b < of_a.get(b, FAR):
                    of_a[b] = to_a + to_b
            level[a] = max(level[a], level[corner] + 1)
            heapq.heappush(heap, (len(of_a) + level[a], level[a], a))
    return order, edges


def _labels(order: list[int], uppers: _Edges, progress: Progress) -> CornerLabels:
    """Return the path lengths from each corner to its ancestors in the tree of vertex elimination.

    ``order`` has the corners in the order of elimination, and ``uppers[i]`` maps each neighbor of corner ``i`` that
    is eliminated later to the length of the edge.
    """
    # 1. A corner's parent is the neighbor eliminated next. Its depth is the number of ancestors above it.
    place = np.argsort(order)  # inverts the permutation
    depth, parent = np.zeros(len(order), np.int64), np.full(len(order), -1)
    for corner in reversed(order):
        if uppers[corner]:
            parent[corner] = min(uppers[corner], key=place.__getitem__)
            depth[corner] = depth[parent[corner]] + 1
    # 2. The list of a corner is the list of its parent, followed by the corner. Entries of corner i:
    #
    #        first[i]   first[i] + 1   ...                first[i] + depth[i]
    #        root       its child      ...   parent of i   i
    first = np.concatenate([[0], np.cumsum(depth + 1)])
    if _ANCESTOR_BYTES * first[-1] > _MOST_BYTES:
        raise ValueError(_TOO_LARGE)
    ancestor, length = (np.zeros(first[-1], np.int32) for _ in range(2))
    for corner in reversed(order):
        progress.update()
        own = first[corner + 1] - 1  # the entry of the corner itself, with length 0
        ancestor[own] = corner
        if not uppers[corner]:
            continue
        above = slice(first[corner], own)
        ancestor[above] = ancestor[first[parent[corner]] : first[parent[corner] + 1]]
        # 3. D(v, c) = min over neighbors u of w(v, u) + D(u, c), for ancestors c of v. Of u and c, the deeper one is
        #    a descendant of the other, and its list has their distance.
        nearby = np.array(list(uppers[corner]))
        lengths = np.fromiter(uppers[corner].values(), np.int64, len(nearby))
        places = np.arange(depth[corner])
        of_neighbor = first[nearby][:, None] + places
        of_ancestor = first[ancestor[above]] + depth[nearby][:, None]
        via_neighbor = length[np.where(places <= depth[nearby][:, None], of_neighbor, of_ancestor)] + lengths[:, None]
        length[above] = np.minimum(via_neighbor.min(axis=0), FAR)
    return CornerLabels(*map(jnp.asarray, (first.astype(np.int32), ancestor, length)))


def _all_pairs(order: list[int], uppers: _Edges, progress: Progress) -> Int32[np.ndarray, "corners corners"]:
    # In the reverse order of elimination, a corner v comes after its neighbors u, and all paths from it to earlier
    # corners t lead over one of them:
    #   D(v, t) = min over neighbors u of w(v, u) + D(u, t).
    # Rows are in this order until the end, so that `distances[:n, :n]` is known before row n.
    place = np.argsort(order[::-1])  # inverts the permutation
    distances = np.full((len(order), len(order)), _NO_PATH, np.int32)
    for n, corner in enumerate(reversed(order)):
        progress.update()
        distances[n, n] = 0
        if nearby := uppers[corner]:
            lengths = np.fromiter(nearby.values(), np.int32, len(nearby))
            via_neighbor = distances[place[list(nearby)], :n] + lengths[:, None]
            distances[n, :n] = distances[:n, n] = np.minimum(via_neighbor.min(axis=0), _NO_PATH)
    return distances[np.ix_(place, place)]
