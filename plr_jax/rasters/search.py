"""Shortest paths over a raster whose costs are constant in each cell.

:func:`search` runs Dijkstra's algorithm on a graph of straight edges between corners (o) and centers (x) of open
cells, shorter than five cells, with their exact costs. Where costs jump, paths refract, so a side between two cells
beside such a jump has two nodes (.), with edges to all nodes of its two cells. With heights, the middles of all sides
are nodes instead, and edges are up to three cells long::

    o-------o-------o-------o     Costs jump between the second and the third column. Edges lead from each corner and
    |   x   |   x   .   x   |     center to the corners and centers around it, in all directions in which they pass no
    |       |       .       |     other corner or center.
    o-------o--.-.--o--.-.--o
    |   x   |   x   .   x   |
    |       |       .       |
    o-------o-------o-------o

Reference: Mitchell and Papadimitriou, "The weighted region problem", 1991.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise, product
from math import floor, gcd
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int32
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import as_numbers, batches, path_from_root, shortened
from plr_jax._progress import Progress

_LENGTH = 9.5  # most half cells of an edge, if cells are square: 88 edges at each corner and center
_LENGTH_OVER_HEIGHTS = 6  # most half cells of an edge with heights: 72 edges at each node
# A *band* is a group of rows whose cells have about the same shape (width / height). Its rows have the same edges.
_BAND = 1.25  # ratio of the largest to the smallest shape in a band
_MOST_BANDS = 16  # cells that are more than about 1.25**16 times as long as wide have the same edges
_JUMP = 1.25  # least factor between costs of neighbors beside which sides have nodes; 1.1 is hardly more exact
UNITS = 6  # parts of the width and height of a cell, in which places of nodes are counted
_HALF = UNITS // 2
_NODES_AT_ONCE = 8192  # nodes whose edges are computed at a time, so that their arrays stay in the CPU's cache
_SAME_DIRECTION = 1e-9  # largest difference of unit vectors along a straight path
Raster = Float[np.ndarray, "rows columns"]
AtCorners = Float[np.ndarray, "rows+1 columns+1"]
Nearest = Int[np.ndarray, "rows columns"]
Sides = Float[np.ndarray, "2"]
Scale = Float[np.ndarray, " rows"]
CellIndices = Int[np.ndarray, "k 2"]  # rows and columns
Points = Float[np.ndarray, "k 2"]
Slope = Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]
Cell = tuple[int, int]  # row and column, also of an offset between cells
Place = tuple[int, int]  # row and column, in units
# Kinds of nodes: their places in the cell. Each cell has its center, and the nodes of its lower and its left side.
CORNER, CENTER = (0, 0), (_HALF, _HALF)
_AT_SIDES = (0, 2), (0, 4), (2, 0), (4, 0)
_MIDDLES = (0, _HALF), (_HALF, 0)  # of sides
# Offsets, in half cells, from the center of a cell to the corners and centers in the cell and beside it.
_NEAR = np.array([step for step in product(range(-3, 4), repeat=2) if sum(step) % 2 == 0])
AtOffset = Callable[[Cell], np.ndarray]  # values of the cells that lie at an offset from other cells
# Stretches of a motion: the share of the motion at which each ends, and the factor of the cost in it.
Stretches = Sequence[tuple[float, float | np.ndarray]]


class Relief(NamedTuple):
    """Heights of a raster's cells, and the factor of the cost at each slope (rise over run) toward the sources."""

    height: Raster
    slope_fn: Slope


class PathTree(NamedTuple):
    """Shortest paths from the centers of a raster's cells to the nearest source.

    Coordinates are relative to the raster's lower left corner.
    """

    next_node: Int[np.ndarray, " nodes"]  # of each node the next one of its path; negative without a path
    place: Int32[np.ndarray, "places 2"]  # row and column, in units, of each node that is no source
    sources: Points  # the sources, which are the nodes after those of ``place``: source k is node len(place) + k
    node_of: Int32[np.ndarray, "rows columns"]  # the node in the center of each cell; negative in barriers
    side: Sides  # of a cell
    period: float | None  # width of the raster if its last column meets the first one
    is_flat: bool  # whether vertices can be left out where paths do not turn

    def path(self, row: int, column: int) -> Points:
        """Return the vertices of the path from the center of a cell: both ends, and the points where the path turns.

        With heights, all nodes of the path are vertices. If there is no path, the result has no vertices. A path
        around a raster with a period leaves the raster.
        """
        # 1. Follow the next nodes up to a source.
        *nodes, last = path_from_root(self.next_node, int(self.node_of[row, column]))[::-1]
        if last < (num_nodes := len(self.place)):
            return np.empty((0, 2))
        path = np.append(self.place[nodes][:, ::-1] / UNITS * self.side, self.sources[last - num_nodes, None], axis=0)
        if self.period is not None:
            path[:, 0] = np.unwrap(path[:, 0], period=self.period)
        # 2. Leave out equal vertices, and vertices at which the path does not turn.
        path = path[np.append(True, np.diff(path, axis=0).any(axis=1))]  # a source may lie on a node
        edges = np.diff(path, axis=0)
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        is_turn = (np.abs(np.diff(edges, axis=0)) > _SAME_DIRECTION).any(axis=1) | (not self.is_flat)
        return path[np.r_[True, is_turn, True][: len(path)]]


def search(
    cost: Raster, side: Sides, points: Points, wraps: bool, squeeze: bool, scale: Scale | None, relief: Relief | None
) -> tuple[Raster, AtCorners, Nearest, PathTree]:
    """Find shortest paths from raster cells to the nearest of the sources ``points``.

    Args:
        cost: Cost per unit of length in each cell; ``inf`` in barriers.
        side: Width and height of a cell.
        points: Sources, relative to the raster's lower left corner, in cells that are no barriers.
        wraps: Whether the last column meets the first one.
        squeeze: Whether paths pass between two barriers that touch in a corner.
        scale: If given, for each row, the length of one unit of x, such as the cosine of the latitude.
        relief: If given, the cost at each place is multiplied by the factor of the slope there.

    Returns:
        The costs of paths from the centers of cells; the costs of paths from the corners of cells (``inf`` where a
        corner is no node); the index of each cell's nearest source (-1 without a path); and the paths.
    """
    # 1. List the steps of edges, by the shape of cells. Rows of cells of about the same shape are a band.
    shape = side[0] / side[1] * (np.ones(len(cost)) if scale is None else scale)
    band = np.clip(np.rint(np.log(shape) / np.log(_BAND)), -_MOST_BANDS, _MOST_BANDS).astype(int)
    steps = {each: _steps(_BAND**each, relief is not None) for each in np.unique(band).tolist()}
    longest = max(abs(n) for by_kind in steps.values() for step in by_kind[CENTER] for n in step)
    # 2. Put a rim around the raster: barriers or, beside the first and the last column of a raster that wraps, the
    #    columns at the other end. A cell has a flat index in the raster with its rim. Nodes have the flat index of
    #    their cell.
    points, first = np.unique(points, axis=0, return_index=True)  # of equal sources, the first counts
    columns = cost.shape[1]
    home = cells_of(points, side, cost.shape)
    rim_width = longest // UNITS + 1
    rim = ((rim_width, rim_width), (0, 0)), ((0, 0), (rim_width, rim_width))
    around: Any = {"mode": "wrap"} if wraps else {"constant_values": np.inf}
    cost = np.pad(np.pad(cost, rim[0], constant_values=np.inf), rim[1], **around)
    width = cost.shape[1]
    inside = np.s_[rim_width:-rim_width, rim_width:-rim_width]
    flat_cost, is_open = cost.ravel(), np.isfinite(cost)
    if scale is not None:
        scale = np.pad(scale, rim_width, mode="edge")
    if relief is not None:
        height = np.pad(np.pad(relief.height, rim[0], mode="edge"), rim[1], mode="wrap" if wraps else "edge").ravel()
    # 3. Number the nodes: corners and centers of open cells and, with heights, the middles of sides. Without heights,
    #    sides have nodes if both cells have a neighbor where the cost jumps. Paths pass no corner where two barriers
    #    touch, unless they squeeze through.
    a, b, c, d = is_open[:-1, :-1], is_open[:-1, 1:], is_open[1:, :-1], is_open[1:, 1:]  # a and b are the lower cells
    is_contact = (a == d) & (b == c) & (a != b) & (not squeeze)
    is_node = {CORNER: np.pad((a | b | c | d) & ~is_contact, ((1, 0), (1, 0))), CENTER: is_open}
    if relief is None:
        cross = ndimage.generate_binary_structure(2, 1)
        most = ndimage.maximum_filter(np.where(is_open, cost, 0.0), footprint=cross)
        is_rough = is_open & (most / _JUMP > ndimage.minimum_filter(cost, footprint=cross))
        is_node |= {kind: is_rough & np.roll(is_rough, 1, axis=int(kind[0] > 0)) for kind in _AT_SIDES}
    else:
        is_node |= {kind: is_open | np.roll(is_open, 1, axis=int(kind[0] > 0)) for kind in _MIDDLES}
    nodes, number, num_nodes = {}, {}, 0
    for kind, is_one in is_node.items():
        last = columns + rim_width + (not wraps and kind[1] == 0)  # one column has only the nodes of the left side
        nodes[kind] = np.flatnonzero(is_one & (np.arange(width) >= rim_width) & (np.arange(width) < last))
        numbers = np.full(is_one.shape, -1, np.int32)
        numbers.ravel()[nodes[kind]] = num_nodes + np.arange(len(nodes[kind]))
        number[kind] = (np.pad(numbers[:, rim_width:-rim_width], rim[1], mode="wrap") if wraps else numbers).ravel()
        num_nodes += len(nodes[kind])

    def ends_of(step: Place, kind: Place, begin: Int[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
        # The nodes to which a step leads from nodes of a kind in the cells `begin`; negative if it leads to none.
        (row, end_y), (column, end_x) = (divmod(at + along, UNITS) for at, along in zip(kind, step, strict=True))
        return number[end_y, end_x][begin + row * width + column]

    def values_around(table: np.ndarray, block: Int[np.ndarray, " n"]) -> AtOffset:
        # A function from an offset to the values of a table in the cells at this offset from the cells of a block. It
        # stores its answers, since motions of several steps ask for the same offsets.
        return cache(lambda cell: table[block + cell[0] * width + cell[1]])

    # 4. Compute the edges of all nodes, sorted by node, then step, in blocks of nodes of one kind and one band. The
    #    cost of an edge is its length times the mean cost along it; an infinite cost is no edge.
    band = np.pad(band, rim_width, mode="edge")
    band_starts = np.flatnonzero(np.diff(band)) + 1
    blocks = [
        (kind, steps[int(band[block[0] // width])][kind], block)
        for kind, of_kind in nodes.items()
        for in_band in np.split(of_kind, np.searchsorted(of_kind, band_starts * width))
        for block in batches(in_band, _NODES_AT_ONCE)
    ]
    size = len(points) * len(_NEAR) + sum(len(listed) * len(block) for _, listed, block in blocks)
    ends, costs = np.empty(size, np.int32), np.empty(size)
    num_edges, counts = 0, []
    with Progress("cost_distance", "edges", size) as progress:
        for kind, listed, block in blocks:
            end, cost_of = np.empty((len(listed), len(block)), np.int32), np.empty((len(listed), len(block)))
            row, cost_in_plane = block // width, values_around(flat_cost, block)
            height_at = None if relief is None else values_around(height, block)
            for k, (i, j) in enumerate(listed):
                length = float(np.hypot(*(side[::-1] * (i, j)))) / UNITS
                cost_at, length_at = cost_in_plane, (lambda _: length)  # noqa: B023
                if scale is not None:  # in a row, the motion is `ratio` times as long
                    ratio = np.hypot(side[0] * j * scale, side[1] * i) / UNITS / length
                    cost_at = lambda cell: ratio[row + cell[0]] * cost_in_plane(cell)  # noqa: B023, E731
                    length_at = lambda beyond: length * ratio[row + beyond]  # noqa: B023, E731
                stretches: Stretches = [(1.0, 1.0)]
                if relief is not None and height_at is not None:
                    stretches = _slope_factors((i, j), kind, length_at, height_at, relief.slope_fn)
                end[k] = ends_of((i, j), kind, block)
                cost_of[k] = length * mean_along((i, j), kind, cost_at, stretches, squeeze)
            is_edge = ((end >= 0) & (cost_of < np.inf)).T
            counts.append(is_edge.sum(axis=1))
            table = slice(num_edges, num_edges := num_edges + int(counts[-1].sum()))
            ends[table], costs[table] = end.T[is_edge], cost_of.T[is_edge]
            progress.update(end.size)
    # 5. Add the edges of sources to the nodes in and beside their cells. With heights, sources move to the centers of
    #    their cells, at no cost.
    if relief is None:
        near, costs_to_near = _NEAR, _straight_costs(cost, side, scale, points, home, rim_width, squeeze)
    else:
        near, costs_to_near = np.zeros((1, 2), int), np.zeros((len(points), 1))
        points = (home[:, ::-1] + 0.5) * side
    flat_home = (home + rim_width) @ (width, 1)
    to_near = np.stack([ends_of((_HALF * i, _HALF * j), CENTER, flat_home) for i, j in near.tolist()], axis=1)
    table = slice(num_edges, num_edges + to_near.size)
    ends[table] = np.maximum(to_near, 0).ravel()
    costs[table] = np.where(to_near < 0, np.inf, costs_to_near).ravel()
    counts.append(np.full(len(points), len(near)))
    # 6. Find shortest paths outward from all sources at once.
    begins = np.append(0, np.concatenate(counts).cumsum()).astype(np.int32)  # with 64 bits, SciPy copies all ends
    graph = csr_array((costs[: begins[-1]], ends[: begins[-1]], begins), shape=(len(begins) - 1,) * 2)
    sources = num_nodes + np.arange(len(points))
    distance, toward, source = dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)

    nearest_of = np.append(first, -1)[np.maximum(source - num_nodes, -1)]

    def raster_of(kind: Place, values: np.ndarray, elsewhere: Any) -> Any:
        # Values of all corners or centers, from values of all nodes.
        table = np.full(cost.shape, elsewhere, values.dtype)
        table.ravel()[nodes[kind]] = values[number[kind][nodes[kind]]]
        return table[inside] if kind == CENTER else table[rim_width : 1 - rim_width, rim_width : 1 - rim_width]

    place = [UNITS * (np.stack(np.divmod(nodes[kind], width), axis=1) - rim_width) + kind for kind in nodes]
    node_of = number[CENTER].reshape(cost.shape)[inside]
    period = float(columns * side[0]) if wraps else None
    tree = PathTree(toward, np.concatenate(place).astype(np.int32), points, node_of, side, period, relief is None)
    at_centers, at_corners = (raster_of(kind, distance, np.inf) for kind in (CENTER, CORNER))
    return at_centers, at_corners, raster_of(CENTER, nearest_of, -1), tree


def _steps(shape: float, has_heights: bool) -> dict[Place, list[Place]]:
    """Return, for each kind of nodes (corner, center, at a side), the vectors to the ends of its edges.

    Vectors are steps in rows and columns, in parts of a cell (``UNITS`` to a cell). Cells are ``shape`` times as wide
    as high.
    """
    # 1. Edges between corners and centers have all directions in which they pass no other corner or center, up to a
    #    length. Counted in half cells, corners have even places and centers odd ones:
    #
    #      4  o       o       o    A step (i, j) has two odd or two even numbers, so i + j is even. It passes no
    #      3      x       x        node if gcd(i, j) is 1. If gcd(i, j) is 2, it passes one place,
    #      2  o       o       o    (i / 2, j / 2), which is no node if i / 2 + j / 2 is odd.
    #      1      x       x
    #      0  o       o       o    With heights, all these places are nodes, so gcd(i, j) is 1.
    #         0   1   2   3   4
    #
    height, width = shape**-0.5, shape**0.5  # of a cell with the area 1
    longest = _LENGTH_OVER_HEIGHTS if has_heights else _LENGTH
    most_i, most_j = int(longest / height), int(longest / width)
    halves = [
        (i, j)
        for i, j in product(range(-most_i, most_i + 1), range(-most_j, most_j + 1))
        if (gcd(i, j), (i + j) % (1 if has_heights else 4)) in ((1, 0), (1, 2), (2, 2))
        and np.hypot(i * height, j * width) <= longest
    ]
    if has_heights:
        return {kind: [(_HALF * i, _HALF * j) for i, j in halves] for kind in (CORNER, CENTER, *_MIDDLES)}
    kinds = CORNER, CENTER, *_AT_SIDES
    steps = {kind: [(_HALF * i, _HALF * j) for i, j in halves if kind not in _AT_SIDES] for kind in kinds}
    # 2. Edges from and to nodes at sides stay in a cell.
    for (a, b), (y, x) in product(kinds, product(range(-UNITS, UNITS + 1), repeat=2)):
        end = y % UNITS, x % UNITS
        is_in_cell = (a == 0 or y >= 0) and (b == 0 or x >= 0) and (y, x) != (a, b)
        if is_in_cell and end in kinds and (end in _AT_SIDES or (a, b) in _AT_SIDES):
            steps[a, b].append((y - a, x - b))
    return steps


def _straight_costs(
    cost: Raster, side: Sides, scale: Scale | None, points: Points, home: CellIndices, rim_width: int, squeeze: bool
) -> Float[np.ndarray, "k nodes"]:
    """Return the costs of straight motions from points to the nodes in each point's cell and in the cells beside it.

    Nodes are centers and corners of cells, at the offsets ``_NEAR``, in half cells, from the center of the point's
    cell. ``home`` has the row and column of this cell. ``cost`` and ``scale`` have a rim of ``rim_width`` cells. A
    motion through a barrier costs ``inf``, as does a motion between two barriers that touch in a corner, unless it
    may ``squeeze``.
    """
    # A motion leaves the row and the column of the first cell at most once each, so it passes up to three cells:
    #
    #      +-------+-------+        `begin` and `change` are rows and columns, in cells. `exits` are the shares of
    #      |       | . end |        the motion at which it leaves the row and the column; 1 if it does not. The first
    #      |       .       |        cell has the share `first` of the motion, the second cell the share last - first,
    #      +-----.-+-------+        and the third cell the rest.
    #      | begin |       |
    #      +-------+-------+
    #
    # 1. Find where the motion leaves the row and the column, and the cells.
    begin, home, near = points[:, None, ::-1] / side[::-1], home[:, None], _NEAR
    change = home + 0.5 + near / 2 - begin

    def cost_in(cells: Int[np.ndarray, "k nodes 2"]) -> Float[np.ndarray, "k nodes"]:
        # The costs of the motions if they were in these cells.
        row, column = np.moveaxis(cells + rim_width, 2, 0)
        ratio = 1.0 if scale is None else scale[row]
        return cost[row, column] * np.hypot(change[..., 1] * side[0] * ratio, change[..., 0] * side[1])

    with np.errstate(divide="ignore", invalid="ignore"):
        exits = np.where(np.abs(near) > 1, (home + (near > 0) - begin) / change, 1.0)
        first, last = exits.min(axis=2), exits.max(axis=2)
        beyond = np.sign(near) * (exits < 1)
        cells = home + 0 * beyond, home + beyond * (exits == first[..., None]), home + beyond
        # 2. Add the costs in the cells. Along the border to the previous cell, the cheaper cell counts.
        is_along = (change == 0) & (near < 0)
        sides = [(cost_in(each), cost_in(each - is_along)) for each in cells]
        cost_1, cost_2, cost_3 = (np.minimum(*each) for each in sides)
        total = first * cost_1 + (last - first) * cost_2 + (1 - last) * cost_3  # NaN where a barrier is touched
        # 3. Where a motion passes a corner, one of the other two cells there must be no barrier; a motion along a
        #    border stays on one side of it. A source in a corner is a source of all cells there.
        beside = (cost_in(home + beyond * axis) for axis in ((1, 0), (0, 1)))
        is_contact = (first == last) & (first > 0) & (first < 1) & np.isinf(np.minimum(*beside))
        for share, before, after in zip((first, last), sides, sides[1:], strict=False):
            one_side = np.minimum(*(np.maximum(*each) for each in zip(before, after, strict=True)))
            is_contact |= (share > 0) & (share < 1) & np.isinf(one_side)
    return np.where(np.isnan(total) | (is_contact & (not squeeze)), np.inf, total)


def mean_along(
    step: Place, kind: Place, cost_at: AtOffset, stretches: Stretches = ((1.0, 1.0),), squeeze: bool = False
) -> np.ndarray:
    """Return the mean cost per length of a straight motion from each of many cells; ``inf`` if a barrier stops it.

    Each motion goes by the vector ``step``, from the node of the ``kind`` (such as the center) in its cell. For an
    offset in rows and columns, ``cost_at`` returns the costs of the cells that lie at this offset from the cells
    where motions begin. In each of the ``stretches`` of the motion, costs are multiplied by a factor. Unless motions
    ``squeeze`` through, they do not pass between two barriers that touch in a corner.
    """
    # 1. Cut the motion where it enters another cell: at the shares of the way where a coordinate is a multiple of
    #    `UNITS`. Cut it where stretches end, too. A piece lies in the cell of its middle.
    #
    #      +-------+-------+-------+
    #      |       |      .|.  x   |      From center to center by one row and two columns: cuts at 1/4, 1/2 and 3/4.
    #      +-------+---.---+-------+
    #      |   x  .|.      |       |
    #      +-------+-------+-------+
    #
    (y, x), (i, j) = kind, step
    borders = {(m - at) / n for at, n in ((y, i), (x, j)) for m in range(*sorted((at, at + n))) if m % UNITS == 0}
    cuts = sorted({0.0} | borders | {end for end, _ in stretches})
    middles = [(a + b) / 2 for a, b in pairwise(cuts)]
    cells = [(floor((y + i * share) / UNITS), floor((x + j * share) / UNITS)) for share in middles]
    # 2. Add the cost of each piece. Along the border of two cells the cheaper one counts.
    mean: Any = 0.0
    for (a, b), (row, column) in zip(pairwise(cuts), cells, strict=True):
        cost = cost_at((row, column))
        if i == y == 0 or j == x == 0:
            cost = np.minimum(cost, cost_at((row - (i == 0), column - (j == 0))))
        mean = mean + (b - a) * next(factor for end, factor in stretches if b <= end) * cost
    # 3. Where the motion passes a corner, one of the other two cells there must be no barrier.
    for a, b in pairwise(cells):
        if a[0] != b[0] and a[1] != b[1] and not squeeze:
            mean = np.where(np.isinf(np.minimum(cost_at((a[0], b[1])), cost_at((b[0], a[1])))), np.inf, mean)
    return mean


def _slope_factors(
    step: Place, kind: Place, length_at: Callable[[int], Any], height_at: AtOffset, slope_fn: Slope
) -> Stretches:
    """Cut a motion by the vector ``step`` into stretches of one slope each; return their ends and cost factors.

    The motion begins in many cells, at the node of the ``kind`` (such as the center) of each.

    The motion is cut where it crosses a row or a column of centers. Heights are bilinear at its ends and where it is
    cut, and linear along each stretch. ``height_at`` returns the heights of the cells at an offset from the cells in
    which the motions begin, and ``length_at`` the motion's length if it were in a row at an offset.
    """
    (y, x), (i, j) = kind, step
    crossed = {
        Fraction(m - at, n)
        for at, n in ((y, i), (x, j))
        for m in range(*sorted((at, at + n)))
        if (m - _HALF) % UNITS == 0 and m != at
    }
    shares = sorted({Fraction(0), Fraction(1)} | crossed)
    heights = []
    for share in shares:
        (row, up), (column, right) = (divmod((at + n * share - _HALF) / UNITS, 1) for at, n in ((y, i), (x, j)))
        corners = product(((row, 1 - up), (row + 1, up)), ((column, 1 - right), (column + 1, right)))
        heights.append(sum(float(a * b) * height_at((r, c)) for (r, a), (c, b) in corners if a * b))
    stretches = []
    for (a, b), (low, high) in zip(pairwise(shares), pairwise(heights), strict=True):
        # The slope toward the sources: the motion leads from the sources.
        cuts = sorted({a, b, *(Fraction(m - y, i) for m in range(*sorted((y, y + i))) if m % UNITS == 0)})
        pieces = [(c, d) for c, d in pairwise(cuts) if a <= c and d <= b]  # in one row of cells each
        run = sum(float(d - c) * length_at(floor((y + i * (c + d) / 2) / UNITS)) for c, d in pieces)
        slope = (low - high) / run
        factor = as_numbers("slope_cost's answer", slope_fn(slope), "numbers")
        if factor.shape not in ((), slope.shape) or not (factor > 0).all():
            expected = f"slope_cost must return positive numbers of shape {slope.shape}"
            raise ValueError(f"{expected}, got {shortened(factor)}.")
        stretches.append((float(b), factor))
    return stretches


def cells_of(points: Float[np.ndarray, "*k 2"], side: Sides, shape: tuple[int, int]) -> Int[np.ndarray, "*k 2"]:
    """Return the row and column of the raster cell of each point.

    ``points`` are relative to the raster's lower corner; ``side`` is the width and height of a cell.
    """
    return np.minimum((points / side).astype(np.int64)[..., ::-1], np.array(shape) - 1)
