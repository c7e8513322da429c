"""Differential heuristics (ALT): distances from landmarks, and the bounds that the triangle inequality makes of them.

``|d(l, x) - d(l, y)|`` and the straight line are lower bounds, ``d(l, x) + d(l, y)`` is an upper one; the estimate
lies a share of the way from the largest lower to the least upper bound, and that share is fitted to pairs. The
distances of a landmark are stored at the nodes of a grid, or as a PLR of cones, which is as good as exact.

Landmarks are chosen "farthest", each as far from those before as can be; by "avoid", where the shortest paths from a
random root are bounded worst; or "greedy", each the one of a pool that lowers the lower bounds' mean error most. Of
these, each number of landmarks takes the best by pairs and exact distances.

A. Goldberg, C. Harrelson, "Computing the shortest path: A* search meets graph theory", SODA 2005; A. Goldberg,
R. Werneck, "Computing point-to-point shortest paths from external memory", ALENEX 2005.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from experiments.summaries._given import Candidates, CompiledSummary, Given, Pairs, Points, compiled, straight
from experiments.summaries._node_tables import NodeGrid, finest_grid, rounded
from plr_jax import Roadmap, construct
from plr_jax.geometry.graph import Graph, dijkstra

_COUNTS = (1, 2, 4, 8, 16, 32, 64, 128)
_BITS = (8, 16)
_PLR_BYTES = (256, 512, 1_024, 2_048, 4_096)  # above, a PLR of these maps gains nothing that landmarks would notice
_MOST_PLRS = 64  # of which those of the largest map take a quarter of an hour
_POOL, _SMOKE_POOL = 2_000, 100  # vertices of the roadmap that landmarks are chosen from
_GREEDY_POOL = 400
_FITTED, _SMOKE_FITTED = 5_000, 500  # pairs that landmarks are chosen and shares fitted by
_SHARES = np.linspace(0, 1, 41)

OfPoint = Callable[[Array], Array]
"""Distances of a point, ``(2,)``, from every landmark."""


def tables(given: Given) -> Candidates:
    """Tables of 8 and 16 bits, for several numbers of landmarks."""
    chosen = _Landmarks(given)
    for count in _COUNTS[:1] if given.smoke else _COUNTS:
        for bits in _BITS:
            grid = finest_grid(given.workspace, lambda grid: grid.table_bytes(count, bits), given.max_bytes)  # noqa: B023
            if grid is not None:
                name, points = chosen.best(count)
                made = _from_table(grid, given.fields(grid.free)(points).T, bits)
                share, summary = _summary(grid.table_bytes(count, bits), made, chosen.pairs)
                nodes = f"{len(grid.free):,} nodes of {bits} bits"
                yield f"{count} landmarks, {name}, {nodes}, {share:.3g} of the way", summary


def plrs(given: Given) -> Candidates:
    """A PLR of cones a landmark, for several numbers of landmarks."""
    chosen = _Landmarks(given)
    counts = sorted({min(_MOST_PLRS, given.max_bytes // size) for size in _PLR_BYTES} - {0})
    for count in counts[:1] if given.smoke else counts:
        name, points = chosen.best(count)
        made = [
            construct(
                given.exact.with_goal(point),
                given.workspace.bounds,
                leaf="cone",
                max_bytes=given.max_bytes // count,
                seed=given.seed,
            )
            for point in points
        ]
        num_bytes = sum(plr.num_bytes for plr in made)
        share, summary = _summary(num_bytes, lambda x: jnp.stack([plr(x) for plr in made]), chosen.pairs)  # noqa: B023
        yield f"{count} landmarks, {name}, {share:.3g} of the way", summary


def _from_table(grid: NodeGrid, distances: Float[np.ndarray, "free landmarks"], bits: int) -> OfPoint:
    table = jnp.asarray(rounded(distances, bits)[grid.nearest])
    return lambda x: grid.read(table, x)


def _summary(num_bytes: int, of_point: OfPoint, pairs: Pairs) -> tuple[float, CompiledSummary]:
    """The share of the way from the lower to the upper bounds that fits pairs best, and the summary of it."""

    def bounds(x: Array, y: Array) -> tuple[Array, Array]:
        at_x, at_y = of_point(x), of_point(y)
        return jnp.maximum(straight(x, y), jnp.abs(at_x - at_y).max()), (at_x + at_y).min()

    ends = (jnp.asarray(column, jnp.float32) for column in (pairs.x, pairs.y))
    lower, upper = jax.jit(jax.vmap(bounds))(*ends)
    share = _best_share(np.asarray(lower), np.asarray(upper), pairs.distance)

    def of_pair(x: Array, y: Array) -> Array:
        lower, upper = bounds(x, y)
        return lower + share * jnp.maximum(upper - lower, 0)

    return share, compiled(num_bytes, of_pair)


def _best_share(lower: np.ndarray, upper: np.ndarray, distance: np.ndarray) -> float:
    gap = np.maximum(upper - lower, 0)
    return float(min(_SHARES, key=lambda share: np.abs(lower + share * gap - distance).mean()))


class _Landmarks:
    """Landmarks of one map, in the orders in which each way of choosing takes them."""

    def __init__(self, given: Given):
        self.given = given
        self.pairs = given.training.first(_SMOKE_FITTED if given.smoke else _FITTED)
        samples = _SMOKE_POOL if given.smoke else _POOL
        self.graph = Roadmap.from_workspace(given.workspace, given.exact.goal, samples, seed=given.seed).graph
        self._orders: dict[str, Points] = {}
        self._most = 2 if given.smoke else max(_COUNTS)

    def best(self, count: int) -> tuple[str, Points]:
        """The way of choosing so many landmarks that has the least mean error, and they."""
        if not self._orders:
            vertices = self.graph.vertices
            self._orders = {
                "farthest": vertices[_farthest(self.given, vertices, self._most)],
                "avoid": vertices[_avoid(self.given, self.graph, self._most)],
                "greedy": _greedy(self.given, vertices, self.pairs, self._most),
            }
            at_x, at_y = (self.given.fields(end) for end in (self.pairs.x, self.pairs.y))
            self._fields = {name: (at_x(points), at_y(points)) for name, points in self._orders.items()}
        errors = {name: self._error(*(field[:count] for field in ends)) for name, ends in self._fields.items()}
        name = min(errors, key=lambda name: errors[name])
        return name, self._orders[name][:count]

    def _error(self, at_x: Float[np.ndarray, "landmarks n"], at_y: Float[np.ndarray, "landmarks n"]) -> float:
        length = np.linalg.norm(self.pairs.x - self.pairs.y, axis=1)
        lower = np.maximum(length, np.abs(at_x - at_y).max(axis=0))
        gap = (at_x + at_y).min(axis=0) - lower
        share = _best_share(lower, lower + gap, self.pairs.distance)
        return float(np.abs(lower + share * gap - self.pairs.distance).mean())


def _farthest(given: Given, vertices: Points, most: int) -> Int[np.ndarray, "most"]:
    """Each the farthest from those before; the first is the farthest from a random vertex."""
    start = np.random.default_rng(given.seed).integers(len(vertices))
    fields = given.fields(vertices)
    chosen, nearest = [], fields(vertices[[start]])[0]
    for _ in range(most):
        chosen.append(int(nearest.argmax()))
        field = fields(vertices[chosen[-1:]])[0]
        nearest = field if len(chosen) == 1 else np.minimum(nearest, field)
    return np.array(chosen)


def _avoid(given: Given, graph: Graph, most: int) -> Int[np.ndarray, "most"]:
    """Each a leaf of a random root's tree of shortest paths, down the branch whose bounds are worst in sum."""
    rng = np.random.default_rng(given.seed)
    chosen: list[int] = []
    fields, lower = given.fields(graph.vertices), np.zeros(len(graph.vertices))
    known = np.empty((0, len(graph.vertices)))
    while len(chosen) < most:
        distances, parents = dijkstra(graph, root := int(rng.integers(len(graph.vertices))))
        if len(chosen):
            lower = np.abs(known - known[:, [root]]).max(axis=0)
        vertex = _worst_leaf(distances, parents, np.maximum(distances - lower, 0), set(chosen), root)
        chosen.append(vertex)
        known = np.concatenate([known, fields(graph.vertices[[vertex]])])
    return np.array(chosen)


def _worst_leaf(
    distances: Float[np.ndarray, "v"],
    parents: Int[np.ndarray, "v"],
    weight: Float[np.ndarray, "v"],
    landmarks: set[int],
    root: int,
) -> int:
    """The leaf at the end of the heaviest branches; those that lead to a landmark weigh nothing."""
    size, blocked = weight.copy(), np.isin(np.arange(len(weight)), list(landmarks))
    reached = np.flatnonzero(np.isfinite(distances))
    for vertex in reached[np.argsort(-distances[reached])]:
        if blocked[vertex]:
            size[vertex] = 0
        if vertex != root:
            size[parents[vertex]] += size[vertex]
            blocked[parents[vertex]] |= blocked[vertex]
    vertex = int(np.where(blocked, -1, size).argmax())
    while len(children := np.flatnonzero(parents == vertex)):
        vertex = int(children[size[children].argmax()])
    return vertex


def _greedy(given: Given, vertices: Points, pairs: Pairs, most: int) -> Points:
    """Each the one of a pool, of corners of the map too, that lowers the mean error of the lower bounds most."""
    corners = given.workspace.boundary.vertices
    rng = np.random.default_rng(given.seed)
    pool = np.concatenate([rng.permutation(corners)[: _GREEDY_POOL // 2], vertices[: _GREEDY_POOL // 2]])
    bounds = np.abs(given.fields(pairs.x)(pool) - given.fields(pairs.y)(pool))
    best, chosen = np.linalg.norm(pairs.x - pairs.y, axis=1), []
    for _ in range(most):
        sums = np.maximum(bounds, best).sum(axis=1)
        sums[chosen] = -1
        chosen.append(int(sums.argmax()))
        best = np.maximum(best, bounds[chosen[-1]])
    return pool[chosen]
