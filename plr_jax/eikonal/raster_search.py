"""Cost distance over a raster: a search for shortest paths, proven lower bounds, and a march over large rasters.

The costs of a raster are constant in each cell. ``rasters.py`` calls one of three functions::

    search_finely    without heights, cells divided into parts; with proven bounds on request
    search           with heights
    march            without heights, many cells: an approximation

:func:`search` runs Dijkstra's algorithm on a graph of straight edges between corners (o) and centers (x) of cells, up
to four cells long, with their exact costs. With heights, edges join centers alone and are up to six cells long::

    o-------o-------o
    |   x   |   x   |     Edges lead from each node to the nodes around it, in all directions in which
    o-------o-------o     they pass no other node.
    |   x   |   x   |
    o-------o-------o

References: Mitchell and Papadimitriou, "The weighted region problem", 1991. For the march see ``march.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from math import floor, gcd
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import as_numbers, path_from_root, shortened
from plr_jax.eikonal.march import travel_times
from plr_jax.eikonal.program import rescaling_of
from plr_jax.geometry.graph import path_ends
from plr_jax.spaces._raster_cost import nearest_cells

# Numbers of cells for a search for paths, which takes about 4 kB a cell:
_FINE_CELLS = 60_000  # smaller rasters are divided into about so many cells: 240 MB
MOST_CELLS = 1 << 21  # most cells by default: 8 GB
MOST_ON_REQUEST = 1 << 22  # most cells if bounds or heights need the search: 17 GB
# Edges of the graph:
_HALVES = 8  # most half cells of an edge along each axis, without heights
_REACH = 6  # most cells of an edge along each axis, with heights; also the width of the rim of barriers
# Marches:
_LARGEST_RATIO = 1e5  # of two costs in a march; at 1e6, scikit-fmm returns NaN
_TINY = 1e-9  # distance in cells from a source to the front of a march
# Lower bounds:
_SLACK = 0.02  # share by which lower bounds start below the distances
_PROJECTIONS = 400  # rounds of projections; where costs jump, 400 halve the gap that 100 leave
_RELAXATION = 1.5  # step of a round, as a multiple of the step that projections ask for
_ROUNDING = 1e-9  # relative error of the cost of a path: far more than its sums round
Raster = Float[np.ndarray, "rows columns"]
AtCorners = Float[np.ndarray, "rows+1 columns+1"]
Nearest = Int[np.ndarray, "rows columns"]
Sides = Float[np.ndarray, "2"]
Points = Float[np.ndarray, "k 2"]
Slope = Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]
Cell = tuple[int, int]  # row and column, also of an offset between cells
AtOffset = Callable[[Cell], np.ndarray]  # values of the cells that lie at an offset from other cells


@dataclass(frozen=True)
class PathTree:
    """Shortest paths from the centers of a raster's cells, or of parts of cells, to the nearest source.

    Sources are given points. Coordinates are relative to the raster's lower corner.
    """

    # For each node the next one of its path, negative without a path. Nodes are, with parts instead of cells:
    #   | corners, row by row (none with heights) | centers, row by row | sources |
    next_node: Int[np.ndarray, " nodes"]
    shape: tuple[int, int]  # rows and columns of parts of cells
    side: Sides  # of a part
    ends: Points  # where paths reach the sources

    def path(self, center: Float[np.ndarray, "2"]) -> Points:
        """Return the vertices of the path from the center of a cell: both ends, and the points where the path turns.

        ``center`` is relative to the raster's lower corner. If there is no path, the result has no vertices.
        """
        rows, columns = self.shape
        first_source = len(self.next_node) - len(self.ends)
        num_corners = first_source - rows * columns
        # 1. Follow the next nodes up to a source.
        row, column = (center / self.side).astype(int)[::-1].tolist()
        *nodes, last = path_from_root(self.next_node, num_corners + row * columns + column)[::-1]
        if last < first_source:
            return np.empty((0, 2))
        is_center = np.array(nodes) >= num_corners
        row, column = np.divmod(nodes - num_corners * is_center, columns + 1 - is_center)
        vertices = (np.stack([column, row], axis=1) + is_center[:, None] / 2) * self.side
        # 2. Leave out equal vertices, and vertices at which the path does not turn.
        path = np.append(vertices, self.ends[last - first_source, None], axis=0)
        path = path[np.append(True, np.diff(path, axis=0).any(axis=1))]  # a source may lie on a node
        edges = np.diff(path, axis=0)
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        is_turn = (np.abs(np.diff(edges, axis=0)) > _ROUNDING).any(axis=1)
        return path[np.r_[True, is_turn, True][: len(path)]]


def parts_of_cells(cost: Raster, side: Sides) -> Int[np.ndarray, "2"]:
    """Return numbers of rows and columns into which to divide each cell.

    The parts are about square, and a small raster has about ``_FINE_CELLS`` of them. The numbers are odd: the center
    of a cell is the center of a part.
    """
    scale = max(np.sqrt(_FINE_CELLS / cost.size * side.min() / side.max()), 1.0)
    wanted = side[::-1] / side.min() * ((scale - 1) // 2 * 2 + 1)
    return (np.ceil((wanted - 1.5) / 2) * 2 + 1).astype(int)


def search_finely(
    cost: Raster, side: Sides, points: Points, parts: Int[np.ndarray, "2"], bounds: bool
) -> tuple[list[np.ndarray], PathTree]:
    """Divide each cell into ``parts[0]`` rows and ``parts[1]`` columns of parts, and search for paths from all parts.

    Paths lead to the nearest of the sources ``points``. Return a list of rasters with one entry per cell, that of the
    cell's middle part, and the paths. The rasters are the costs of paths, the indices of the sources that paths lead
    to and, if ``bounds``, lower and upper bounds of the least cost. ``side`` is the width and height of a cell.
    """
    fine = cost.repeat(parts[0], axis=0).repeat(parts[1], axis=1)
    part_side = side / parts[::-1]
    distance, at_corners, nearest, tree = search(fine, part_side, points)
    results = [distance, nearest]
    if bounds and at_corners is not None:
        results += [_lower_bound(fine, part_side, points, distance, at_corners), distance * (1 + _ROUNDING)]
    return [table[parts[0] // 2 :: parts[0], parts[1] // 2 :: parts[1]] for table in results], tree


def search(
    cost: Raster, side: Sides, points: Points, height: Raster | None = None, slope_fn: Slope = np.ones_like
) -> tuple[Raster, AtCorners | None, Nearest, PathTree]:
    """Find shortest paths from raster cells to the nearest of the sources ``points``.

    ``side`` is the width and height of a cell. If ``height`` is given, the cost of a motion is multiplied by
    ``slope_fn(slope)``, with the slope (rise over run) of the motion toward the sources.

    Returns:
        The costs of paths from the centers of cells; the costs of paths from the corners of cells (None with
        heights); the index of each cell's nearest source (-1 without a path); and the paths.
    """
    # 1. Pad costs with a rim of barriers, so that edges may leave the raster.
    points, first = np.unique(points, axis=0, return_index=True)  # of equal sources, the first counts
    rows, columns = cost.shape
    home = cells_of(points, side, cost.shape)
    is_open = np.isfinite(cost)
    cost = np.pad(cost, _REACH, constant_values=np.inf)
    # 2. Number the nodes: corners of cells (`nodes[0]`, none with heights), then centers (`nodes[1]`), then sources.
    num_corners = (rows + 1) * (columns + 1) if height is None else 0
    num_nodes = num_corners + rows * columns
    nodes = {1: np.arange(num_corners, num_nodes).reshape(rows, columns)}
    if height is None:
        nodes[0] = np.arange(num_corners).reshape(rows + 1, columns + 1)
        # 3. List the steps of edges from each node, in half cells, so that they pass no other node. Counted in half
        #    cells, corners have even places and centers odd ones:
        #
        #      4  o       o       o    A step (i, j) has two odd or two even numbers, so i + j is even. It passes no
        #      3      x       x        node if gcd(i, j) is 1. If gcd(i, j) is 2, it passes one place,
        #      2  o       o       o    (i / 2, j / 2), which is no node if i / 2 + j / 2 is odd.
        #      1      x       x
        #      0  o       o       o
        #         0   1   2   3   4
        #
        half_steps = product(range(-_HALVES, _HALVES + 1), repeat=2)
        steps = [(i, j) for i, j in half_steps if (gcd(i, j), (i + j) % 4) in ((1, 0), (1, 2), (2, 2))]
        # 4. Edges from sources lead to nodes in and beside their cells, at offsets `near` from the centers of cells.
        near = np.array([step for step in product(range(-3, 4), repeat=2) if sum(step) % 2 == 0])
        costs_to_near = _straight_costs(cost, side, points, home, near)
    else:
        # With heights, edges join centers, and sources move to centers, at no cost. Barriers get the height of the
        # nearest cell.
        steps = [(2 * i, 2 * j) for i, j in product(range(-_REACH, _REACH + 1), repeat=2) if gcd(i, j) == 1]
        near, costs_to_near = np.zeros((1, 2), int), np.zeros((len(points), 1))
        points = (home[:, ::-1] + 0.5) * side
        height = np.pad(height[nearest_cells(is_open, side[::-1])], _REACH, mode="edge")
    # 5. List the edges of all nodes, by node and step. The cost of an edge is its length, times the mean cost along
    #    it, times the mean factor of its parts' slopes. Fill the arrays in place, as they take most of the memory.
    numbers = {half: np.pad(of_half, _REACH, mode="edge") for half, of_half in nodes.items()}

    def end_nodes(half: int, i: int, j: int) -> np.ndarray:
        # The nodes to which a step leads from all corners (`half` is 0) or centers (1) of cells. From a node at the
        # place 2 * row + half, the step i leads to 2 * ((half + i) // 2 + row) + (half + i) % 2. Where the edge
        # leaves the raster, any node will do: its cost is infinite.
        return _beside(numbers[(half + i) % 2], ((half + i) // 2, (half + j) // 2), nodes[half].shape)

    to_near = np.stack([end_nodes(1, i, j)[tuple(home.T)] for i, j in near.tolist()], axis=1)
    size = num_nodes * len(steps)
    ends = np.append(np.empty(size, np.int32), to_near.astype(np.int32))
    costs = np.append(np.empty(size), costs_to_near)
    end, cost_of = ends[:size].reshape(num_nodes, -1), costs[:size].reshape(num_nodes, -1)
    for half, begin_nodes in nodes.items():
        edges = slice(begin_nodes[0, 0], begin_nodes[-1, -1] + 1)
        cost_at = partial(_beside, cost, shape=begin_nodes.shape)
        for step, (i, j) in enumerate(steps):
            length = float(np.hypot(*(side[::-1] * (i, j)))) / 2
            of_step = length * _mean_along(i, j, half, cost_at)
            if height is not None:
                height_at = partial(_beside, height, shape=begin_nodes.shape)
                of_step *= _mean_factor(i // 2, j // 2, length, height_at, slope_fn)
            end[edges, step], cost_of[edges, step] = end_nodes(half, i, j).ravel(), of_step.ravel()
    if height is None:  # no path passes where two barriers touch in a corner
        is_barrier = np.isinf(cost[_REACH - 1 : 1 - _REACH, _REACH - 1 : 1 - _REACH])
        # The cells around each corner: a and b below it, c and d above it.
        a, b, c, d = (is_barrier[i : i + rows + 1, j : j + columns + 1] for i, j in product((0, 1), repeat=2))
        contacts = nodes[0][(a == d) & (b == c) & (a != b)]
        cost_of[contacts] = np.inf
    # 6. Find shortest paths outward from all sources at once; an infinite cost is no edge.
    begins = np.append(np.arange(0, size, len(steps)), size + len(near) * np.arange(len(points) + 1))
    graph = csr_array((costs, ends, begins), shape=(len(begins) - 1,) * 2)
    sources = num_nodes + np.arange(len(points))
    distance, toward, source = dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
    nearest = np.append(first, -1)[np.maximum(source[nodes[1]] - num_nodes, -1)]
    tree = PathTree(toward, (rows, columns), side, points)
    if height is not None:
        return distance[nodes[1]], None, nearest, tree
    distance[contacts] = np.inf
    return distance[nodes[1]], distance[nodes[0]], nearest, tree


def _beside(values: np.ndarray, offset: Cell, shape: tuple[int, ...], first: Cell = (_REACH, _REACH)) -> np.ndarray:
    # The values of the cells that lie at an offset, in rows and columns, from the cells of a part of a raster, or of
    # a raster without rim. The part has the given shape, and begins at the cell `first`.
    i, j = np.add(first, offset)
    return values[i : i + shape[0], j : j + shape[1]]


def _straight_costs(
    cost: Raster, side: Sides, points: Points, home: Int[np.ndarray, "k 2"], near: Int[np.ndarray, "nodes 2"]
) -> Float[np.ndarray, "k nodes"]:
    """Return the costs of straight motions from points to the nodes in each point's cell and in the cells beside it.

    Nodes are centers and corners of cells, at the offsets ``near``, in half cells, from the center of the point's
    cell. ``home`` has the row and column of this cell. ``cost`` has a rim of ``_REACH`` cells. A motion through a
    barrier costs ``inf``.
    """
    # A motion leaves the row and the column of the first cell at most once each, so it passes up to three cells:
    #
    #      +-------+-------+        `begin` and `change` are rows and columns, in cells. `leaves` are the shares of
    #      |       | . end |        the motion at which it leaves the row and the column; 1 if it does not. The first
    #      |       .       |        cell has the share `first` of the motion, the second cell the share last - first,
    #      +-----.-+-------+        and the third cell the rest.
    #      | begin |       |
    #      +-------+-------+
    #
    # 1. Find where the motion leaves the row and the column, and the cells.
    begin = points[:, None, ::-1] / side[::-1]
    change = home[:, None] + 0.5 + near / 2 - begin
    with np.errstate(divide="ignore", invalid="ignore"):
        leaves = np.where(np.abs(near) > 1, (home[:, None] + (near > 0) - begin) / change, 1.0)
        first, last = leaves.min(axis=2), leaves.max(axis=2)
        beyond = np.sign(near) * (leaves < 1)
        cells = home[:, None], home[:, None] + beyond * (leaves == first[..., None]), home[:, None] + beyond
        # 2. Average the costs of the cells. Along the border to the previous cell, the cheaper cell counts.
        is_along = (change == 0) & (near < 0)
        cost_1, cost_2, cost_3 = (
            np.minimum(*(cost[tuple(np.moveaxis(each + _REACH, 2, 0))] for each in (cell, cell - is_along)))
            for cell in cells
        )
        mean = first * cost_1 + (last - first) * cost_2 + (1 - last) * cost_3  # NaN where a barrier is touched
    return np.where(np.isnan(mean), np.inf, mean) * np.linalg.norm(change[..., ::-1] * side, axis=2)


def _mean_along(i: int, j: int, half: int, cost_at: AtOffset) -> np.ndarray:
    """Return the mean cost per length of a straight motion from each of many cells; ``inf`` if a barrier stops it.

    Each motion goes by ``i`` half cells across rows and by ``j`` half cells across columns. All motions begin in the
    center of a cell (``half`` is 1) or in its lower corner (``half`` is 0). For an offset in rows and columns,
    ``cost_at`` returns the costs of the cells that lie at this offset from the cells where motions begin.
    """
    # 1. Cut the motion where it enters another cell: at the shares of the way where a coordinate, which starts at
    #    `half` and counts half cells, is even. The middle of each piece, in cells, tells its cell.
    #
    #      +-------+-------+-------+
    #      |       |      .|.  x   |      From center to center by i = 2 and j = 4: cuts at 1/4, 1/2 and 3/4.
    #      +-------+---.---+-------+
    #      |   x  .|.      |       |
    #      +-------+-------+-------+
    #
    cuts = sorted({0.0, 1.0} | {k / abs(n) for n in (i, j) for k in range(1, abs(n)) if (half + k) % 2 == 0})
    cells = [(floor((half + i * (a + b) / 2) / 2), floor((half + j * (a + b) / 2) / 2)) for a, b in pairwise(cuts)]
    # 2. Add the cost of each piece. Along the border of two cells the cheaper one counts.
    mean: Any = 0.0
    for (a, b), (row, column) in zip(pairwise(cuts), cells, strict=True):
        cost = cost_at((row, column))
        if half == 0 and 0 in (i, j):
            cost = np.minimum(cost, cost_at((row - (i == 0), column - (j == 0))))
        mean = mean + (b - a) * cost
    # 3. Where the motion passes a corner, one of the other two cells there must be no barrier.
    for a, b in pairwise(cells):
        if a[0] != b[0] and a[1] != b[1]:
            mean = np.where(np.isinf(np.minimum(cost_at((a[0], b[1])), cost_at((b[0], a[1])))), np.inf, mean)
    return mean


def _mean_factor(i: int, j: int, length: float, height_at: AtOffset, slope_fn: Slope) -> np.ndarray:
    """Return, for each cell, the mean of ``slope_fn`` along the motion to it from the cell at offset ``(i, j)``.

    The motion is cut into ``max(abs(i), abs(j))`` equal parts, and ``slope_fn`` is called with the slope of each
    part. ``length`` is the motion's length; ``height_at`` returns the heights at an offset from all cells.
    """
    # At the ends of parts, the place along the longer axis is whole. Along the other axis it is between two cells, i0
    # or j0 and the next one: interpolate their heights.
    heights, count = [], max(abs(i), abs(j))
    for part in range(count + 1):
        (i0, rest_i), (j0, rest_j) = (divmod(steps * part, count) for steps in (i, j))
        beyond = i0 + (rest_i > 0), j0 + (rest_j > 0)
        fraction = max(rest_i, rest_j) / count
        heights.append((1 - fraction) * height_at((i0, j0)) + fraction * height_at(beyond))
    slopes = np.diff(heights, axis=0) * -count / length
    factor = as_numbers("slope_cost's answer", slope_fn(slopes), "numbers")
    if factor.shape not in ((), slopes.shape) or not (factor > 0).all():
        raise ValueError(f"slope_cost must return positive numbers of shape {slopes.shape}, got {shortened(factor)}.")
    return np.mean(np.broadcast_to(factor, slopes.shape), axis=0)


def _lower_bound(cost: Raster, side: Sides, points: Points, at_centers: Raster, at_corners: AtCorners) -> Raster:
    """Return a proven lower bound of the least cost of a path from each cell's center to the sources ``points``.

    A function is a lower bound if it is at most 0 at the sources and nowhere steeper than the cost of the cell. The
    costs of known paths from centers and corners, linear in the four triangles around each center, are nearly such a
    function. Repeated projections make steep triangles less steep, and a final rescaling removes the rest.
    """
    # 1. Divide costs by the least, so that squares neither overflow nor vanish.
    least = cost.min()
    cost, at_centers, at_corners = cost / least, at_centers / least, at_corners / least
    # 2. List the triangles of a cell, one at each side. Triangle k has the side from corner k to the next corner,
    #    along an axis, and the center m. The corners k of all cells are the part places[k] of the table of corners.
    #
    #      3-------2
    #      | \ 2 / |
    #      |3  m  1|
    #      | / 0 \ |
    #      0-------1
    #
    places = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]
    triangles = list(zip(places, (*places[1:], places[0]), (0, 1, 0, 1), strict=True))
    is_known = np.isfinite(at_corners)  # paths do not pass where two barriers touch: nothing binds such a corner
    most = [np.where(is_known[p] & is_known[q], cost, np.inf) for p, q, _ in triangles]  # largest slopes
    middle, corner = (np.where(np.isfinite(u), (1 - _SLACK) * u, 0.0) for u in (at_centers, at_corners))

    def steepness(triangle: int) -> Raster:
        # The slope of the linear function over its largest value. Along the side of length s, it is (u_q - u_p) / s.
        # Across, from the center to the middle of the side, half the other side of the cell away, it is
        # ((u_p + u_q) / 2 - u_m) / (t / 2).
        p, q, axis = triangles[triangle]
        along = (corner[q] - corner[p]) / side[axis]
        across = (corner[p] + corner[q] - 2 * middle) / side[1 - axis]
        return np.sqrt(along * along + across * across) / most[triangle]

    # 3. Project: move the three values of a steep triangle towards their mean, until its slope is allowed. All
    #    triangles are treated at once, and each value takes the mean of the changes that steep triangles ask for.
    for _ in range(_PROJECTIONS):
        change, count = ([np.zeros_like(values) for values in (middle, corner)] for _ in range(2))
        for triangle, (p, q, _) in enumerate(triangles):
            excess = np.maximum(steepness(triangle), 1.0)
            mean = (corner[p] + corner[q] + middle) / 3
            shrinkage, is_steep = 1 / excess - 1, excess > 1
            for kind, values, place in ((0, middle, ...), (1, corner, p), (1, corner, q)):
                change[kind][place] += shrinkage * (values[place] - mean)
                count[kind][place] += is_steep
        middle += _RELAXATION * change[0] / np.maximum(count[0], 1)
        corner += _RELAXATION * change[1] / np.maximum(count[1], 1)
    # 4. Rescale. A corner that nothing binds counts as the reflection of the opposite corner in the center.
    factor = (1 + _ROUNDING) * np.max([steepness(triangle) for triangle in range(4)], axis=0)
    around = np.stack([u for p in places for u in (corner[p], 2 * middle - corner[p])])
    lower = np.interp(middle, *rescaling_of(*(u.ravel() for u in (around.min(0), around.max(0), factor))))
    # 5. Subtract the largest value that a source may have: that of its cell's center, and the cost of the motion
    #    there.
    row, column = cells_of(points, side, cost.shape).T
    to_center = np.linalg.norm(points - (np.stack([column, row], axis=1) + 0.5) * side, axis=1)
    at_sources = np.max(lower[row, column] + cost[row, column] * to_center)
    lower = np.maximum(lower - at_sources - _ROUNDING * np.abs(lower).max(), 0.0)
    return np.where(np.isfinite(at_centers), least * lower, np.inf)


def march(cost: Raster, side: Sides, points: Points) -> tuple[Raster, Nearest]:
    """Return approximate cost distances of all cells by fast marching, and the index of each cell's nearest source.

    The sources are ``points``; ``side`` is the width and height of a cell. Without a path to a source, the distance
    is ``inf`` and the index -1.
    """
    least, most = cost.min(), cost.max(where=np.isfinite(cost), initial=0)
    if most > _LARGEST_RATIO * least:
        expected = f"costs of more than {MOST_CELLS:,} cells must differ by a factor of at most {_LARGEST_RATIO:,.0f}"
        advice = "Reduce the largest, or make their cells barriers."
        raise ValueError(f"{expected}, got costs from {least:g} to {most:g}. {advice}")
    cost = cost / least  # scikit-fmm ignores some small costs
    # 1. Begin with a front around cells with a source. In a cell with several sources the first one counts: it is
    #    written last.
    home = tuple(cells_of(points, side, cost.shape)[::-1].T)
    label = np.full(cost.shape, -1, np.int32)
    label[home] = np.arange(len(points))[::-1]
    front = np.where(label >= 0, -_TINY * side.min(), side.min())
    # 2. March, unless all free cells have a source.
    is_open = np.isfinite(cost)
    distance = np.where(label >= 0, 0.0, np.inf)
    if (is_open & (label < 0)).any():
        distance = np.where(label >= 0, 0.0, travel_times(front, is_open, cost, side[::-1], (False, False)))
    # 3. Find the nearest source of each cell.
    if len(points) == 1:
        return least * distance, np.where(np.isfinite(distance), 0, -1)
    return least * distance, _reached_sources(distance, cost, side, label)


def _reached_sources(distance: Raster, cost: Raster, step: Sides, label: Nearest) -> Nearest:
    """Return the index of the source that steepest descent of the distance reaches from each cell of a raster.

    ``step`` is the width and height of a cell. ``label`` is the source's index in cells with a source, else -1.
    """
    # 1. Find the next cell of each cell (o): of the sixteen cells around it (x), the one through which the distance
    #    is least. Try eight steps and their opposites.
    #
    #      . x . x .      For a step (i, j), `part(values, (0, 0))` are the values of all cells from which the step
    #      x x x x x      stays in the raster, and `part(values, (i, j))` those of the cells to which it leads.
    #      . x o x .
    #      x x x x x
    #      . x . x .
    #
    toward = np.arange(distance.size, dtype=np.int32 if distance.size < 2**31 else np.int64).reshape(distance.shape)
    index = toward.copy()
    least = np.where(label >= 0, -np.inf, np.inf)  # a cell with a source has no next cell
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)):
        shape = distance.shape[0] - abs(i), distance.shape[1] - abs(j)
        part = partial(_beside, shape=shape, first=(max(-i, 0), max(-j, 0)))
        cost_of_step = float(np.hypot(*(step[::-1] * (i, j)))) * _mean_along(2 * i, 2 * j, 1, partial(part, cost))
        for a, b in (((0, 0), (i, j)), ((i, j), (0, 0))):
            through = part(distance, b) + cost_of_step
            is_better = (through < part(least, a)) & (part(distance, b) < part(distance, a))
            part(least, a)[is_better] = through[is_better]
            part(toward, a)[is_better] = part(index, b)[is_better]
    del index, least
    # 2. Follow the next cells. They have smaller distances, so paths end: in cells with a source, or where no next
    #    cell is better.
    return label.ravel()[path_ends(toward.ravel())].reshape(label.shape)


def cells_of(points: Float[np.ndarray, "*k 2"], side: Sides, shape: tuple[int, int]) -> Int[np.ndarray, "*k 2"]:
    """Return the row and column of the raster cell of each point.

    ``points`` are relative to the raster's lower corner; ``side`` is the width and height of a cell.
    """
    return np.minimum((points / side).astype(np.int64)[..., ::-1], np.array(shape) - 1)
