"""Cost distance over a raster: a search for shortest paths, proven lower bounds, and a march over large rasters.

Dijkstra's algorithm finds shortest paths over straight edges, up to four cells long, between centers and corners of
cells, with exact costs for costs that are constant in each cell. With heights, edges join centers alone and are up to
six cells long.

References: Mitchell and Papadimitriou, "The weighted region problem", 1991. For the march see ``march.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from math import floor, gcd
from typing import Any

import numpy as np
import skfmm
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import as_numbers, shortened
from plr_jax.eikonal.program import rescaling_of

# Most cells of a search for paths, which takes about 4 kB a cell: into which smaller rasters are divided; by default;
# and if bounds or heights need the search.
_FINE_CELLS, MOST_CELLS, MOST_ON_REQUEST = 60_000, 1 << 21, 1 << 22
_HALVES, _REACH = 8, 6  # most half cells along each axis of an edge, and most cells of an edge with heights
_LARGEST_RATIO = 1e5  # of two costs in a march; at 1e6, scikit-fmm returns NaN
_TINY = 1e-9  # distance in cells from a source to the front of a march
_ROUNDING = 1e-9  # relative error of the cost of a path: far more than its sums round
# Lower bounds start this share below the distances, and are projected so often, by so much of the way that a
# projection asks for. Where costs jump, 400 projections halve the gap that 100 leave.
_SLACK, _PROJECTIONS, _RELAXATION = 0.02, 400, 1.5
Raster = Float[np.ndarray, "rows columns"]
AtCorners = Float[np.ndarray, "rows+1 columns+1"]
Nearest = Int[np.ndarray, "rows columns"]
Sides = Float[np.ndarray, "2"]
Points = Float[np.ndarray, "k 2"]
Slope = Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]


def parts_of_cells(cost: Raster, side: Sides) -> Int[np.ndarray, "2"]:
    # Odd numbers for rows and columns, larger for a small raster.
    scale = max(np.sqrt(_FINE_CELLS / cost.size * side.min() / side.max()), 1.0)
    wanted = side[::-1] / side.min() * ((scale - 1) // 2 * 2 + 1)
    return (np.ceil((wanted - 1.5) / 2) * 2 + 1).astype(int)


@dataclass(frozen=True)
class PathTree:
    """Shortest paths from the centers of a raster's cells, or of parts of cells, to the nearest of given points."""

    next_node: Int[np.ndarray, " nodes"]  # of corners, if any, of centers, and of sources; negative if there is none
    shape: tuple[int, int]  # rows and columns of parts of cells
    side: Sides  # of a part
    ends: Points  # where paths reach the sources

    def path(self, center: Float[np.ndarray, "2"]) -> Points:
        """Return the vertices of the path from a cell's center: both ends and all turns; none without a path."""
        (rows, columns), first_source = self.shape, len(self.next_node) - len(self.ends)
        num_corners, vertices = first_source - rows * columns, []
        row, column = (center / self.side).astype(int)[::-1]
        node = num_corners + row * columns + column
        while node < first_source:
            if node < 0:
                return np.empty((0, 2))
            is_center = int(node >= num_corners)
            row, column = divmod(node - is_center * num_corners, columns + 1 - is_center)
            vertices.append((column + is_center / 2, row + is_center / 2) * self.side)
            node = self.next_node[node]
        vertices.append(self.ends[node - first_source])
        path = np.array(vertices)
        path = path[np.append(True, np.diff(path, axis=0).any(axis=1))]  # a source may lie on a node
        edges = np.diff(path, axis=0)
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        is_turn = (np.abs(np.diff(edges, axis=0)) > _ROUNDING).any(axis=1)
        return path[np.r_[True, is_turn, True][: len(path)]]


def search_finely(
    cost: Raster, side: Sides, points: Points, parts: Int[np.ndarray, "2"], bounds: bool
) -> tuple[list[np.ndarray], PathTree]:
    # Results for whole cells: costs of paths, indices of sources, perhaps lower and upper bounds.
    fine, of_part = cost.repeat(parts[0], axis=0).repeat(parts[1], axis=1), side / parts[::-1]
    distance, at_corners, nearest, tree = search(fine, of_part, points)
    results = [distance, nearest]
    if bounds:
        assert at_corners is not None
        results += [_below(fine, of_part, points, distance, at_corners), distance * (1 + _ROUNDING)]
    return [table[parts[0] // 2 :: parts[0], parts[1] // 2 :: parts[1]] for table in results], tree


def _below(cost: Raster, side: Sides, points: Points, at_centers: Raster, at_corners: AtCorners) -> Raster:
    """Return a proven lower bound of the least cost of a path from each cell's center to the sources ``points``.

    A function is a lower bound if it is at most 0 at the sources and nowhere steeper than the cost of the cell. The
    costs of known paths from centers and corners, linear in the four triangles around each center, are made less
    steep by repeated projections, and at last rescaled to be such a function.
    """
    # 1. The triangles, one at each side of a cell: the ends of the side, its axis, and the most cost there.
    least = cost.min()  # costs are divided by the least, so that squares neither overflow nor vanish
    cost, at_centers, at_corners = cost / least, at_centers / least, at_corners / least
    ends = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]
    is_known = np.isfinite(at_corners)  # paths do not pass where two barriers touch: nothing binds such a corner
    sides, axes = list(zip(ends, (*ends[1:], ends[0]), strict=True)), (0, 1, 0, 1)
    most = [np.where(is_known[p] & is_known[q], cost, np.inf) for p, q in sides]
    middle, corner = (np.where(np.isfinite(u), (1 - _SLACK) * u, 0.0) for u in (at_centers, at_corners))

    def steepness(triangle: int) -> Raster:
        (p, q), axis = sides[triangle], axes[triangle]
        along, across = (corner[q] - corner[p]) / side[axis], (corner[p] + corner[q] - 2 * middle) / side[1 - axis]
        return np.sqrt(along * along + across * across) / most[triangle]

    # 2. Project.
    for _ in range(_PROJECTIONS):
        change, count = ([np.zeros_like(values) for values in (middle, corner)] for _ in range(2))
        for triangle, (p, q) in enumerate(sides):
            excess, mean = np.maximum(steepness(triangle), 1.0), (corner[p] + corner[q] + middle) / 3
            shrinkage, is_steep = 1 / excess - 1, excess > 1
            for kind, values, place in ((0, middle, ...), (1, corner, p), (1, corner, q)):
                change[kind][place] += shrinkage * (values[place] - mean)
                count[kind][place] += is_steep
        middle += _RELAXATION * change[0] / np.maximum(count[0], 1)
        corner += _RELAXATION * change[1] / np.maximum(count[1], 1)
    # 3. Rescale. A corner that nothing binds counts as the reflection of the opposite corner in the center.
    factor = (1 + _ROUNDING) * np.max([steepness(triangle) for triangle in range(4)], axis=0)
    around = np.stack([u for p in ends for u in (corner[p], 2 * middle - corner[p])])
    lower = np.interp(middle, *rescaling_of(*(u.ravel() for u in (around.min(0), around.max(0), factor))))
    # 4. Subtract the largest value that a source may have.
    home = cells_of(points, side, cost.shape)
    to_center = np.linalg.norm(points - (home[:, ::-1] + 0.5) * side, axis=1)
    home = tuple(home.T)
    most_at_sources = np.max(lower[home] + cost[home] * to_center)
    lower = np.maximum(lower - most_at_sources - _ROUNDING * np.abs(lower).max(), 0.0)
    return np.where(np.isfinite(at_centers), least * lower, np.inf)


def cells_of(points: Float[np.ndarray, "*k 2"], side: Sides, shape: tuple[int, int]) -> Int[np.ndarray, "*k 2"]:
    """Return the row and column of the raster cell of each point, given relative to the raster's lower corner."""
    return np.minimum((points / side).astype(np.int64)[..., ::-1], np.array(shape) - 1)


def march(cost: Raster, side: Sides, points: Points) -> tuple[Raster, Nearest]:
    """Return approximate cost distances of all cells, and the nearest source of each, by fast marching."""
    least, most = cost.min(), cost.max(where=np.isfinite(cost), initial=0)
    if most > _LARGEST_RATIO * least:
        raise ValueError(
            f"costs of more than {MOST_CELLS:,} cells must differ by a factor of at most {_LARGEST_RATIO:,.0f}, got "
            f"costs from {least:g} to {most:g}. Reduce the largest, or make their cells barriers."
        )
    cost = cost / least  # scikit-fmm ignores some small costs
    home = tuple(cells_of(points, side, cost.shape)[::-1].T)
    front, label = np.full(cost.shape, side.min()), np.full(cost.shape, -1, np.int32)
    front[home], label[home] = -_TINY * side.min(), np.arange(len(points))[::-1]  # the first of several sources
    distance = np.where(label >= 0, 0.0, np.inf)
    if (np.isfinite(cost) & (label < 0)).any():
        front = np.ma.MaskedArray(front, np.isinf(cost))
        time = skfmm.travel_time(front, 1 / cost, dx=side[::-1].tolist(), order=2)
        distance = np.where(label >= 0, 0.0, np.ma.filled(time, np.inf))
    label = _labels(distance, cost, side, label) if len(points) > 1 else np.where(np.isfinite(distance), 0, -1)
    return least * distance, label


def _labels(distance: Raster, cost: Raster, step: Sides, label: Nearest) -> Nearest:
    """Return the index of the source that steepest descent of the distance reaches from each cell of a raster."""
    # `step`: width and height of a cell; `label`: the source's index in cells with a source, -1 in other cells.
    # 1. The next node: of sixteen around it, the one through which the distance is least.
    toward = np.arange(distance.size, dtype=np.int32 if distance.size < 2**31 else np.int64).reshape(distance.shape)
    index, least = toward.copy(), np.full(distance.shape, np.inf)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)):
        first = np.maximum([0, 0], [-i, -j])
        last = np.array(distance.shape) - np.maximum([0, 0], [i, j])

        def part(values: np.ndarray, cell: tuple[int, int], first=first, last=last) -> np.ndarray:
            return values[first[0] + cell[0] : last[0] + cell[0], first[1] + cell[1] : last[1] + cell[1]]

        cost_of_step = float(np.hypot(*(step[::-1] * (i, j)))) * _mean_along(2 * i, 2 * j, 1, partial(part, cost))
        for a, b in (((0, 0), (i, j)), ((i, j), (0, 0))):
            through = part(distance, b) + cost_of_step
            is_better = (through < part(least, a)) & (part(distance, b) < part(distance, a))
            part(least, a)[is_better] = through[is_better]
            part(toward, a)[is_better] = part(index, b)[is_better]
    del index, least
    # 2. Replace each successor by its successor until nothing changes.
    toward = np.where(label >= 0, np.arange(label.size).reshape(label.shape), toward).ravel()
    while not np.array_equal(further := toward[toward], toward):
        toward = further
    return label.ravel()[toward].reshape(label.shape)


def search(
    cost: Raster,
    side: Sides,
    points: Points,
    height: Raster | None = None,
    slope_fn: Slope = np.ones_like,
    from_sources: bool = False,
) -> tuple[Raster, AtCorners | None, Nearest, PathTree]:
    """Find shortest paths from raster cells to the nearest of the sources ``points``.

    ``side`` is the width and height of a cell. With heights, costs are multiplied by ``slope_fn`` of the slope of a
    motion toward the sources, or away from them if ``from_sources``. Return the paths' costs at the centers and at
    the corners (None with heights) of cells, the indices of the nearest sources, and the paths.
    """
    # 1. Costs and heights with a rim of barriers. Barriers get the height of the nearest cell.
    points, first = np.unique(points, axis=0, return_index=True)  # of equal sources, the first counts
    home, (rows, columns) = cells_of(points, side, cost.shape), cost.shape
    if height is not None:
        nearest_open: Any = ndimage.distance_transform_edt(
            np.isinf(cost), sampling=side[::-1], return_distances=False, return_indices=True
        )
        height = np.pad(height[tuple(nearest_open)], _REACH, mode="edge")
    cost = np.pad(cost, _REACH, constant_values=np.inf)
    # 2. Nodes are corners of cells, then centers. Steps of edges are in half cells, and pass no other node. Counted
    #    in half cells, corners have even places and centers odd ones. So both numbers of a step are odd, or both are
    #    even. A step (2 i, 2 j) passes the place (i, j), which is a node if i + j is even.
    halves, corner_shape = (1,), (0, 0)
    steps = [(2 * i, 2 * j) for i, j in product(range(-_REACH, _REACH + 1), repeat=2) if gcd(i, j) == 1]
    if height is None:
        halves, corner_shape = (0, 1), (rows + 1, columns + 1)
        half_steps = product(range(-_HALVES, _HALVES + 1), repeat=2)
        steps = [(i, j) for i, j in half_steps if (gcd(i, j), (i + j) % 4) in ((1, 0), (1, 2), (2, 2))]
    corners = corner_shape[0] * corner_shape[1]
    node = np.arange(corners + rows * columns)
    nodes = node[:corners].reshape(corner_shape), node[corners:].reshape(rows, columns)
    # 3. Straight motions from sources to nodes in and beside their cells. With heights, sources are moved to centers.
    near, straight = np.zeros((1, 2), int), np.zeros((len(points), 1))
    if height is None:
        near = np.array([step for step in product(range(-3, 4), repeat=2) if sum(step) % 2 == 0])
        straight = _straight_costs(cost, side, points, home, near)
    # 4. The cost of each edge: its length, times the mean cost along it, times the mean factor of its parts' slopes.
    size = len(node) * len(steps)
    ends, costs = np.zeros(size + straight.size, np.int32), np.append(np.empty(size), straight)
    end, weight = ends[:size].reshape(len(node), -1), costs[:size].reshape(len(node), -1)
    for half in halves:
        begin_nodes = nodes[half]
        rows_here = slice(begin_nodes[0, 0], begin_nodes[-1, -1] + 1)

        def beside(values: np.ndarray, offset: tuple[int, int], shape=begin_nodes.shape) -> np.ndarray:
            i, j = _REACH + offset[0], _REACH + offset[1]
            return values[i : i + shape[0], j : j + shape[1]]

        for edge, (i, j) in enumerate(steps):
            length = float(np.hypot(*(side[::-1] * (i, j)))) / 2
            of_edges = length * _mean_along(i, j, half, partial(beside, cost))
            if height is not None:
                of_edges *= _mean_factor(i // 2, j // 2, length, partial(beside, height), slope_fn, from_sources)
            weight[rows_here, edge] = of_edges.ravel()
            end_nodes = nodes[(half + i) % 2]
            row, column = (
                np.clip(np.arange(n, dtype=np.int32) + (half + offset) // 2, 0, most - 1)
                for n, most, offset in zip(begin_nodes.shape, end_nodes.shape, (i, j), strict=True)
            )
            end[rows_here, edge] = ((end_nodes[0, 0] + row * end_nodes.shape[1])[:, None] + column).ravel()
    to_near = ends[size:].reshape(straight.shape)
    for edge, step in enumerate(near):
        end_nodes = nodes[(1 + step[0]) % 2]
        to_near[:, edge] = end_nodes[tuple(np.clip(home + (1 + step) // 2, 0, np.array(end_nodes.shape) - 1).T)]
    if height is None:  # no path passes where two barriers touch in a corner
        is_barrier = np.isinf(cost[_REACH - 1 : 1 - _REACH, _REACH - 1 : 1 - _REACH])
        a, b, c, d = (is_barrier[i : i + rows + 1, j : j + columns + 1] for i, j in product((0, 1), repeat=2))
        contacts = nodes[0][(a == d) & (b == c) & (a != b)]
        weight[contacts] = np.inf
    # 5. Shortest paths from all sources at once; an infinite weight is no edge.
    begins = np.append(np.arange(0, size, len(steps)), size + len(near) * np.arange(len(points) + 1))
    graph = csr_array((costs, ends, begins), shape=(len(begins) - 1,) * 2)
    sources = len(node) + np.arange(len(points))
    distance, toward, source = dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
    nearest = np.append(first, -1)[np.maximum(source[nodes[1]] - len(node), -1)]
    tree = PathTree(toward, (rows, columns), side, points if height is None else (home[:, ::-1] + 0.5) * side)
    if height is not None:
        return distance[nodes[1]], None, nearest, tree
    distance[contacts] = np.inf
    return distance[nodes[1]], distance[nodes[0]], nearest, tree


def _straight_costs(
    cost: Float[np.ndarray, "padded_rows padded_columns"],
    side: Sides,
    points: Points,
    home: Int[np.ndarray, "k 2"],  # row and column of each point's cell
    near: Int[np.ndarray, "nodes 2"],  # offsets from the center of that cell, in half cells
) -> Float[np.ndarray, "k nodes"]:
    """Return costs of straight motions from points to nodes in and beside their cells; ``inf`` through barriers."""
    begin = points[:, None, ::-1] / side[::-1]
    change = home[:, None] + 0.5 + near / 2 - begin
    with np.errstate(divide="ignore", invalid="ignore"):
        # A motion leaves the row and the column of the first cell at most once each.
        leaves = np.where(np.abs(near) > 1, (home[:, None] + (near > 0) - begin) / change, 1.0)
        first, last = leaves.min(axis=2), leaves.max(axis=2)
        beyond = np.sign(near) * (leaves < 1)
        cells = home[:, None], home[:, None] + beyond * (leaves == first[..., None]), home[:, None] + beyond
        is_along = (change == 0) & (near < 0)  # along the border to the previous cell: the cheaper cell counts
        here, between, there = (
            np.minimum(*(cost[tuple(np.moveaxis(each + _REACH, 2, 0))] for each in (cell, cell - is_along)))
            for cell in cells
        )
        mean = first * here + (last - first) * between + (1 - last) * there  # NaN where a barrier is touched
    return np.where(np.isnan(mean), np.inf, mean) * np.linalg.norm(change[..., ::-1] * side, axis=2)


def _mean_factor(
    i: int,
    j: int,
    length: float,
    height_at: Callable[[tuple[int, int]], np.ndarray],
    slope_fn: Slope,
    from_sources: bool,
) -> np.ndarray:
    # Of motions from all cells by (i, j) cells if `from_sources`, else of the motions back.
    heights, count = [], max(abs(i), abs(j))
    for part in range(count + 1):
        (i0, to_i), (j0, to_j) = (divmod(steps * part, count) for steps in (i, j))
        # One of the two coordinates is whole: between two cells, heights are interpolated.
        beyond, fraction = (i0 + (to_i > 0), j0 + (to_j > 0)), max(to_i, to_j) / count
        heights.append((1 - fraction) * height_at((i0, j0)) + fraction * height_at(beyond))
    slopes = np.diff(heights, axis=0) * (count if from_sources else -count) / length
    factor = as_numbers("slope_cost's answer", slope_fn(slopes), "numbers")
    if factor.shape not in ((), slopes.shape) or not (factor > 0).all():
        raise ValueError(f"slope_cost must return positive numbers of shape {slopes.shape}, got {shortened(factor)}.")
    return np.mean(np.broadcast_to(factor, slopes.shape), axis=0)


def _mean_along(i: int, j: int, half: int, cost_at: Callable[[tuple[int, int]], np.ndarray]) -> np.ndarray:
    """Return the mean costs along straight motions from many cells, ``inf`` where barriers stop the motion.

    Each motion goes by ``i`` half cells across rows and ``j`` across columns. It begins in the center of a cell
    (``half`` is 1) or in the cell's lower corner (``half`` is 0). For an offset in rows and columns, ``cost_at``
    returns the costs of the cells that lie at this offset from the cells where motions begin.
    """
    # 1. Cut the motion where it enters another cell.
    ends = {0.0, 1.0}
    for change in (i, j):
        ends |= {
            abs(at - half) / abs(change)
            for at in range(min(half, half + change), max(half, half + change) + 1)
            if change and at % 2 == 0
        }
    cuts = sorted(ends)
    middles = [((half + i * (a + b) / 2) / 2, (half + j * (a + b) / 2) / 2) for a, b in pairwise(cuts)]
    cells = [(floor(row), floor(column)) for row, column in middles]
    # 2. Along the border of two cells the cheaper one counts.
    mean: Any = 0.0
    for (a, b), (row, column) in zip(pairwise(cuts), cells, strict=True):
        cost = cost_at((row, column))
        if half == 0 and 0 in (i, j):
            cost = np.minimum(cost, cost_at((row - (i == 0), column - (j == 0))))
        mean = mean + (b - a) * cost
    for a, b in pairwise(cells):
        if a[0] != b[0] and a[1] != b[1]:  # a corner: one of the other two cells there must be no barrier
            mean = np.where(np.isinf(np.minimum(cost_at((a[0], b[1])), cost_at((b[0], a[1])))), np.inf, mean)
    return mean
