"""Probabilistic roadmaps (PRM*): near-optimal distances in any dimension."""

import math
from collections.abc import Iterator

import networkx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from tqdm import tqdm

from plr_jax._arrays import as_finite_point, as_point, as_points
from plr_jax._box import Box
from plr_jax._graph import Graph, astar, dijkstra, to_networkx
from plr_jax._types import ArrayLike, Distances, Points
from plr_jax._workspace import Workspace
from plr_jax.oracles._local_planner import (
    IsFree,
    IsVisible,
    checked_is_free,
    checked_is_visible,
    first_visible,
)

_BATCH = 2**18  # points or pairs of points held at a time: a few tens of megabytes
_MIN_FREE_FRACTION = 1e-4
_DRAWS_BEFORE_GIVING_UP = 100_000


class Roadmap:
    """Distance to a goal over a probabilistic roadmap (PRM*), a `DistanceFn` in any dimension.

    Free configurations drawn uniformly, and the goal, are the vertices; every two that see each other
    within the PRM* radius are joined by a straight edge. One run of Dijkstra's algorithm from the goal
    gives each vertex its distance. A query point is joined to every vertex that it sees within the
    radius and takes the shortest way through one of them. The answer is the length of a path that
    exists, so never below the true distance (as far as the edge test can be trusted), and approaches
    it as samples are added.

    Lengths are Euclidean. To weight an axis, such as an angle, scale the coordinates.

    Args:
        domain: The box of configurations, or its corners ``(lo, hi)``. Outside it nothing is free.
        is_free: Collision test of a batch, ``(n, dim)`` configurations to ``(n,)`` booleans. It is
            called with points of the domain only, in batches of any size, and must not depend on the
            rest of the batch.
        goal: A free configuration, ``(dim,)``.
        num_samples: Number of free configurations to draw, at least 1. Samples of one seed are a
            sequence: more of them extend it.
        seed: Seed of the samples.
        is_visible: Exact test of straight motions, ``(n, dim)`` starts and ``(n, dim)`` ends, all of
            them free, to ``(n,)`` booleans. Give either this or ``resolution``.
        resolution: Where there is no exact test: the largest step, in units of the domain, between
            the points at which a straight motion is tested with ``is_free``. Obstacles thinner than
            this can be passed through.

    Raises:
        ValueError: If the domain is no box, the goal is not free, fewer than 1 in 10,000 draws are free, a
            test returns anything but one boolean a point, or an argument is out of range.

    References:
        Karaman and Frazzoli, "Sampling-based algorithms for optimal motion planning", IJRR 2011:
        section 3.3 on PRM*. The free volume in its radius is estimated by the fraction of draws that
        are free.
    """

    def __init__(
        self,
        domain: Box | ArrayLike,
        is_free: IsFree,
        goal: ArrayLike,
        num_samples: int,
        *,
        seed: int = 0,
        is_visible: IsVisible | None = None,
        resolution: float | None = None,
    ):
        if not isinstance(num_samples, int | np.integer) or num_samples < 1:
            raise ValueError(f"num_samples must be a whole number of at least 1, got {num_samples!r}.")
        self._domain = domain = Box.of(domain)
        self._is_free = checked_is_free(domain, is_free)
        self._is_visible = checked_is_visible(self._is_free, is_visible, resolution)
        goal = _checked_goal(domain, self._is_free, goal)
        samples, free_volume = _sample_free(domain, self._is_free, num_samples, seed)
        vertices = np.concatenate([goal[None], samples])
        self._radius = prm_star_radius(len(vertices), domain.dim, free_volume)
        self._density = len(vertices) / free_volume
        self._tree = KDTree(vertices)
        self._graph = Graph(vertices, _visible_edges(self._tree, self._radius, self._is_visible))
        self._distances, _ = dijkstra(self._graph, 0)
        vertices.flags.writeable = self._distances.flags.writeable = False

    @classmethod
    def from_workspace(cls, workspace: Workspace, goal: ArrayLike, num_samples: int, seed: int = 0) -> "Roadmap":
        """Roadmap of a point robot in a workspace, every edge tested exactly.

        Args:
            workspace: The workspace; its bounds are the domain.
            goal: A free point, ``(2,)``.
            num_samples: Number of free points to draw, at least 1.
            seed: Seed of the samples.
        """
        return cls(workspace.bounds, workspace.is_free, goal, num_samples, seed=seed, is_visible=workspace.is_visible)

    def __call__(self, x: ArrayLike) -> Distances:
        """Distance of each point to the goal along the roadmap.

        A point that sees no vertex within the radius looks in twice, four times, ... the radius until it
        sees one.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Distances, in units of the domain. ``inf`` for points outside the domain, with a NaN, or
            not free; for points that see no vertex; and where no vertex seen is joined to the goal.

        Raises:
            ValueError: If ``x`` is not of shape ``(n, dim)``.
        """
        x = as_points("x", x, self._domain.dim)
        answer = np.full(len(x), np.inf)
        pending = np.flatnonzero(self._is_free(x))
        for inner, outer in self._rings():
            if pending.size == 0:
                break
            distance, connected = self._connect(x[pending], inner, outer)
            answer[pending] = distance
            pending = pending[~connected]
        return answer

    def shortest_path(self, x: ArrayLike) -> Float[np.ndarray, "m dim"]:
        """The path whose length the query answers, found by A*.

        Args:
            x: A point, ``(dim,)``.

        Returns:
            The path's corners, from ``x`` to the goal; no rows where the distance is ``inf``.

        Raises:
            ValueError: If ``x`` is not of shape ``(dim,)``.
        """
        x = as_point("The start", x, self._domain.dim)[None]
        path = astar(self._graph, self._visible_vertices(x), goal=0) if self._is_free(x)[0] else []
        if not path:
            return np.empty((0, self._domain.dim))
        corners = self._graph.vertices[path]
        return corners if np.array_equal(corners[0], x[0]) else np.concatenate([x, corners])

    @property
    def domain(self) -> Box:
        """The box of configurations."""
        return self._domain

    @property
    def goal(self) -> Float[np.ndarray, "dim"]:
        """The goal, vertex 0 of the graph."""
        return self._graph.vertices[0]

    @property
    def radius(self) -> float:
        """Connection radius, in units of the domain."""
        return self._radius

    @property
    def graph(self) -> Graph:
        """Vertices and edges; vertex 0 is the goal."""
        return self._graph

    @property
    def distances(self) -> Float[np.ndarray, "v"]:
        """Distance of each vertex to the goal, ``inf`` where the roadmap does not join them."""
        return self._distances

    @property
    def num_vertices(self) -> int:
        """Number of vertices: the samples and the goal."""
        return self._graph.num_vertices

    @property
    def num_edges(self) -> int:
        """Number of undirected edges."""
        return self._graph.num_edges

    @property
    def num_bytes(self) -> int:
        """Bytes of the roadmap as a file would hold it: float64 vertices, int32 edges, float64 lengths.

        This is what a search for any goal needs. The distances to this goal, the k-d tree and the
        adjacency matrix follow from it and are not counted.
        """
        return self._graph.num_bytes

    def to_networkx(self) -> networkx.Graph:
        """The roadmap in NetworkX: position as ``pos`` of a node, length as ``weight`` of an edge."""
        return to_networkx(self._graph)

    def _rings(self) -> Iterator[tuple[float, float]]:
        """Inner and outer radii of the rings in which a query looks for vertices, until all are in."""
        inner, outer = -1.0, self._radius
        diagonal = float(np.linalg.norm(self._domain.width))
        while inner < diagonal:
            yield inner, outer
            inner, outer = outer, 2 * outer

    def _connect(self, x: Points, inner: float, outer: float) -> tuple[Distances, Bool[np.ndarray, "n"]]:
        """Distance through the vertices seen between two radii, and whether there are any."""
        expected = self._density * unit_ball_volume(self._domain.dim) * outer**self._domain.dim
        step = max(1, int(_BATCH / min(max(expected, 1.0), self.num_vertices)))
        parts = [self._connect_batch(x[i : i + step], inner, outer) for i in range(0, len(x), step)]
        distance, connected = zip(*parts, strict=True)
        return np.concatenate(distance), np.concatenate(connected)

    def _connect_batch(self, x: Points, inner: float, outer: float) -> tuple[Distances, Bool[np.ndarray, "n"]]:
        pairs = KDTree(x).sparse_distance_matrix(self._tree, outer, output_type="ndarray")
        pairs = pairs[pairs["v"] > inner]
        through = pairs["v"] + self._distances[pairs["j"]]
        order = np.lexsort((through, pairs["i"]))
        point, vertex, through = pairs["i"][order], pairs["j"][order], through[order]

        def sees(pair: Int[np.ndarray, "p"]) -> Bool[np.ndarray, "p"]:
            return self._is_visible(x[point[pair]], self._graph.vertices[vertex[pair]])

        first = first_visible(point, len(x), sees)
        connected = first >= 0
        return np.where(connected, np.append(through, np.inf)[first], np.inf), connected

    def _visible_vertices(self, x: Float[np.ndarray, "1 dim"]) -> dict[int, float]:
        """Every vertex to which a query at a free point is joined, with the length of that edge."""
        length = np.linalg.norm(self._graph.vertices - x, axis=1)
        for inner, outer in self._rings():
            near = np.flatnonzero((inner < length) & (length <= outer))
            seen = near[self._is_visible(np.repeat(x, len(near), axis=0), self._graph.vertices[near])]
            if seen.size:
                return dict(zip(seen.tolist(), length[seen].tolist(), strict=True))
        return {}


def prm_star_radius(num_vertices: int, dim: int, free_volume: float) -> float:
    """Connection radius of PRM*, ``gamma (log n / n)^(1/dim)``.

    Args:
        num_vertices: Number of vertices ``n``, at least 2.
        dim: Dimension of the space.
        free_volume: Volume of free space.

    References:
        Karaman and Frazzoli, IJRR 2011, section 3.3: asymptotically optimal for any ``gamma`` above
        ``2 (1 + 1/dim)^(1/dim) (free_volume / unit_ball_volume)^(1/dim)``; this bound itself is taken.
    """
    gamma = 2 * ((1 + 1 / dim) * free_volume / unit_ball_volume(dim)) ** (1 / dim)
    return gamma * (math.log(num_vertices) / num_vertices) ** (1 / dim)


def unit_ball_volume(dim: int) -> float:
    """Volume of the Euclidean ball of radius 1."""
    return math.pi ** (dim / 2) / math.gamma(dim / 2 + 1)


def _sample_free(domain: Box, is_free: IsFree, num_samples: int, seed: int) -> tuple[Points, float]:
    """The first free draws of a uniform sequence over the domain, and an estimate of the free volume."""
    rng = np.random.default_rng(seed)
    batch = max(num_samples, 1000)
    accepted, num_free, num_drawn = [], 0, 0
    while num_free < num_samples:
        draws = domain.lo + domain.width * rng.random((batch, domain.dim))
        accepted.append(draws[is_free(draws)])
        num_free += len(accepted[-1])
        num_drawn += batch
        if num_drawn >= _DRAWS_BEFORE_GIVING_UP and num_free < _MIN_FREE_FRACTION * num_drawn:
            raise ValueError(
                f"Only {num_free} of {num_drawn} configurations drawn from the domain {domain} are free; "
                f"tighten the domain around free space, or check is_free."
            )
    return np.concatenate(accepted)[:num_samples], float(np.prod(domain.width)) * num_free / num_drawn


def _visible_edges(tree: KDTree, radius: float, is_visible: IsVisible) -> Int[np.ndarray, "e 2"]:
    """Pairs of vertices within the radius that see each other."""
    pairs = tree.query_pairs(radius, output_type="ndarray")
    step = 2**15
    visible = np.zeros(len(pairs), dtype=bool)
    with tqdm(total=len(pairs), desc="Roadmap edges", unit="edge", delay=3, disable=None) as progress:
        for i in range(0, len(pairs), step):
            start, end = pairs[i : i + step].T
            visible[i : i + step] = is_visible(tree.data[start], tree.data[end])
            progress.update(len(start))
    return pairs[visible].astype(np.int32)


def _checked_goal(domain: Box, is_free: IsFree, goal: ArrayLike) -> Float[np.ndarray, "dim"]:
    point = as_finite_point("The goal", goal, domain.dim)
    if not domain.contains(point[None])[0]:
        raise ValueError(f"The goal {point.tolist()} is outside the domain {domain}; move it inside.")
    if not is_free(point[None])[0]:
        raise ValueError(f"The goal {point.tolist()} is not free; move it to a free configuration.")
    return point
