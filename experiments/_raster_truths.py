"""Truths for cost distances over rasters: graphs and a march that share no code with the package.

Rasters have the origin of coordinates in a corner; row ``i`` and column ``j`` are a square of side 1, times ``side``
(width, height). Heights are those of the cells' centers, and bilinear between centers.

References: Lanthier, Maheshwari, Sack, "Approximating shortest paths on weighted polyhedral surfaces", 2001.
"""

from collections.abc import Callable, Iterator
from itertools import combinations, pairwise, product
from math import dist, gcd
from typing import Any

import numpy as np
import skfmm
from jaxtyping import Float
from scipy import ndimage
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

RADIUS = 6_371_008.8  # of the earth, in meters
Raster = Float[np.ndarray, "rows columns"]
Cell = tuple[int, int]  # row and column
Pair = tuple[float, float]  # x and y, or longitude and latitude
Factor = Callable[[np.ndarray], np.ndarray]


def over_sides(costs: Raster, sources: list[Cell], points: int) -> Raster:
    """Return costs of shortest paths over straight edges between points of the sides of each cell.

    Each side has ``points`` parts of equal length, with nodes between them; edges join nodes at different sides of a
    cell, neighbors along sides, and centers to all nodes around them. Costs err by the square of a part.
    """
    rows, columns = costs.shape
    place = np.arange(rows * points + 1)[:, None] % points * (np.arange(columns * points + 1) % points) == 0
    number = np.where(place, place.ravel().cumsum().reshape(place.shape) - 1, -1)
    centers = place.sum() + np.arange(costs.size).reshape(costs.shape)
    lines = {*product((0, 1), (0, points))}  # those of a cell's sides: axis and place
    ring = [p for p in product(range(points + 1), repeat=2) if lines & {*enumerate(p)}]
    nodes: dict[Any, Any] = {p: number[p[0] :: points, p[1] :: points][:rows, :columns] for p in ring}
    nodes[points / 2, points / 2] = centers
    ways = [(p, q) for p, q in combinations(nodes, 2) if not lines & {*enumerate(p)} & {*enumerate(q)}]
    edges = [(nodes[p], nodes[q], costs * dist(p, q)) for p, q in ways]
    padded = np.pad(costs, 1, constant_values=np.inf)
    across = np.minimum(padded[:-1], padded[1:])[:, 1:-1].repeat(points, axis=1)  # the cheaper cell counts
    along = np.minimum(padded[:, :-1], padded[:, 1:])[1:-1].repeat(points, axis=0)
    edges.append((number[::points, :-1], number[::points, 1:], across))
    edges.append((number[:-1, ::points], number[1:, ::points], along))
    begin, end = (np.concatenate([edge[k].ravel() for edge in edges]).astype(np.int32) for k in (0, 1))
    cost = np.concatenate([edge[2].ravel() for edge in edges]) / points
    graph = coo_array((cost, (begin, end)), shape=(centers.max() + 1,) * 2).tocsr()
    return dijkstra(graph, directed=False, indices=[centers[at] for at in sources], min_only=True)[centers]


def over_lattice(
    costs: Raster, heights: Raster, side: Pair, source: Cell, factor: Factor, reach: int, finer: int
) -> Raster:
    """Return costs of shortest paths over a lattice of ``finer`` nodes a cell, with edges up to ``reach`` nodes long.

    The cost of an edge is the integral along it, toward the source, of the cost times ``factor(slope)``.
    """
    shape = [count * finer + 1 for count in costs.shape]
    steps = [(i, j) for i, j in product(range(-reach, reach + 1), repeat=2) if gcd(i, j) == 1]
    number = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    ends, weights = (np.empty((*shape, len(steps)), kind) for kind in (np.int32, float))
    padded = np.pad(costs, reach, constant_values=np.inf)
    y, x = (np.arange(count) for count in shape)
    for k, (i, j) in enumerate(steps):
        length = np.hypot(i * side[1], j * side[0]) / finer
        cuts = sorted({0.0, 1.0} | {part / abs(n) for n in (i, j) for part in range(1, abs(n))})
        total, before = 0.0, _bilinear(heights, y / finer - 0.5, x / finer - 0.5)
        for a, b in pairwise(cuts):
            after = _bilinear(heights, (y + b * i) / finer - 0.5, (x + b * j) / finer - 0.5)
            slope = (before - after) / ((b - a) * length)
            middle = (y[:, None] + (a + b) / 2 * i) / finer, (x + (a + b) / 2 * j) / finer
            total, before = total + (b - a) * _cost_at(padded, reach, *middle) * factor(slope), after
        weights[..., k] = length * total
        ends[..., k] = number[np.ix_(np.clip(y + i, 0, shape[0] - 1), np.clip(x + j, 0, shape[1] - 1))]
    begins = np.arange(number.size + 1) * len(steps)
    graph = csr_array((weights.ravel(), ends.ravel(), begins), shape=(number.size,) * 2)
    start = number[finer * source[0] + finer // 2, finer * source[1] + finer // 2]
    distance = dijkstra(graph, indices=start).reshape(shape)
    return distance[finer // 2 :: finer, finer // 2 :: finer]


def _cost_at(padded: Raster, rim: int, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    # Costs of cells at (y, x). On the side of two cells, rounding up and down gives both, and the cheaper one counts.
    low, high = (padded[tuple(np.floor(at + off).astype(int) + rim for at in (y, x))] for off in (-1e-6, 1e-6))
    return np.minimum(low, high)


def _bilinear(heights: Raster, y: np.ndarray, x: np.ndarray) -> Raster:
    # Heights at all (y, x), in cells from the center of the first cell; beyond the centers, the nearest height.
    shares = [
        np.maximum(1 - np.abs(np.clip(values, 0, count - 1)[:, None] - np.arange(count)), 0)
        for values, count in zip((y, x), heights.shape, strict=True)
    ]
    return shares[0] @ heights @ shares[1].T


def cost_of_path(path: Float[np.ndarray, "n 2"], costs: Raster, heights: Raster, side: Pair, factor: Factor) -> float:
    """Return the integral of cost times ``factor(slope)`` along a path of vertices ``(x, y)``.

    Costs are those of cells. Heights are linear between crossings of rows and columns of cells' centers.
    """
    total, padded = 0.0, np.pad(costs, 1, constant_values=np.inf)
    for begin, end in pairwise(path / side):
        length = np.linalg.norm((end - begin) * side)
        halves = np.unique(np.concatenate([[0.0, 1.0], *_crossings(2 * begin, 2 * end)]))
        middles = np.unique(np.concatenate([[0.0, 1.0], *_crossings(begin - 0.5, end - 0.5)]))
        places = begin + middles[:, None] * (end - begin) - 0.5
        at_middles = ndimage.map_coordinates(heights, places.T[::-1], order=1, mode="nearest")
        slope = np.diff(np.interp(halves, middles, at_middles)) / (np.diff(halves) * length)
        inside = begin + (halves[:-1, None] + halves[1:, None]) / 2 * (end - begin)
        total += np.sum(np.diff(halves) * length * _cost_at(padded, 1, *inside.T[::-1]) * factor(slope))
    return float(total)


def _crossings(begin: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    # Shares of the way from one point to another at which a coordinate is whole, for each coordinate.
    for a, b in zip(begin, end, strict=True):
        if a != b:
            share = (np.arange(np.ceil(min(a, b)), np.floor(max(a, b)) + 1) - a) / (b - a)
            yield share[(share > 1e-9) & (share < 1 - 1e-9)]


def great_circle(longitude: np.ndarray, latitude: np.ndarray, source: Pair) -> np.ndarray:
    """Return the lengths, in meters, of great circles to a source ``(longitude, latitude)``, all in degrees."""
    x, y, x0, y0 = (np.radians(each) for each in (longitude, latitude, *source))
    haversine = np.sin((y - y0) / 2) ** 2 + np.cos(y) * np.cos(y0) * np.sin((x - x0) / 2) ** 2
    return 2 * RADIUS * np.arcsin(np.minimum(np.sqrt(haversine), 1))


def marched_on_sphere(costs: Raster, origin: Pair, step: float, sources: list[Cell], finer: int) -> Raster:
    """Return costs of paths on a sphere by a march over Mercator's map, with ``finer`` nodes a cell along parallels.

    The raster's first corner is ``origin``, longitude and latitude; its cells are ``step`` degrees wide and high. At
    the latitude y, the map is ``1 / cos(y)`` times as large as the sphere. NaN beside barriers.
    """
    rows, columns = costs.shape
    south, north = (np.arcsinh(np.tan(np.radians(origin[1] + count * step))) for count in (0, rows))
    width = float(np.radians(step)) / finer
    latitude = np.degrees(np.arctan(np.sinh(np.arange(south + width / 2, north, width))))
    longitude = origin[0] + (np.arange(columns * finer) + 0.5) * step / finer
    row = np.minimum(((latitude - origin[1]) / step).astype(int), rows - 1)
    cost = costs[row].repeat(finer, axis=1)
    is_open = np.isfinite(cost)
    speed = 1 / np.where(is_open, cost * RADIUS * np.cos(np.radians(latitude))[:, None], 1.0)
    at = [origin[k] + (np.arange(count) + 0.5) * step for k, count in ((1, rows), (0, columns))]
    place_y = (np.arcsinh(np.tan(np.radians(at[0]))) - south) / width - 0.5
    places = np.meshgrid(place_y, (np.arange(columns) + 0.5) * finer - 0.5, indexing="ij")
    least = np.full(costs.shape, np.inf)
    for i, j in sources:
        length = great_circle(longitude, latitude[:, None], (at[1][j], at[0][i]))
        first = 0.45 * np.radians(step) * RADIUS * np.cos(np.radians(at[0][i]))  # stays in the source's cell
        front = np.ma.masked_array((length - first) / first, ~is_open)
        time = np.ma.filled(skfmm.travel_time(front, speed, dx=width, order=2), np.nan) + first * costs[i, j]
        time = np.where(length < first, length * costs[i, j], time)
        found = ndimage.map_coordinates(time, places, order=1)
        least = np.where(np.isnan(found), found, np.minimum(least, found))
    return least
