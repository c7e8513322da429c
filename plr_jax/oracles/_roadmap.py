"""Probabilistic roadmaps (PRM*): near-optimal distances in any dimension."""

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from plr_jax import _arrays
from plr_jax._progress import Progress
from plr_jax._types import ArrayLike, Distances, Points, Reach
from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import Graph, dijkstra, first_visible, path_to_root
from plr_jax.geometry.workspace import Workspace, require_workspace


class Metric(NamedTuple):
    """A metric of configurations: the Euclidean norm of their difference, with a weight for each axis.

    Along periodic axes, the difference goes the short way around.
    """

    domain: Box
    weights: Float[np.ndarray, " dim"]

    @property
    def widths(self) -> Float[np.ndarray, " dim"]:
        return self.weights * self.domain.width

    def lengths(self, a: Float[np.ndarray, "#n dim"], b: Points) -> Float[np.ndarray, " n"]:
        return np.linalg.norm(self.weights * self.domain.difference(b, a), axis=1)

    def tree(self, vertices: Points) -> KDTree:
        periods = np.where(self.domain.periodic, self.widths, 0.0) if self.domain.is_periodic else None
        return KDTree(self.tree_coordinates(vertices), boxsize=periods)

    def tree_coordinates(self, x: Points) -> Points:
        """Return the coordinates of configurations in the k-d tree: there, Euclidean distances equal the metric."""
        # In a k-d tree, periodic axes must run from 0 to below their period.
        around = self.weights * (self.domain.wrapped(x) - self.domain.lo)
        around = np.where(around < self.widths, around, 0.0)  # rounding may reach the full period
        return np.where(self.domain.periodic, around, self.weights * x)


Flags: TypeAlias = Bool[np.ndarray, " n"]
IsFree: TypeAlias = Callable[[Points], Flags]
IsVisible: TypeAlias = Callable[[Points, Points], Flags]
_BATCH = 2**18  # configurations tested at a time: a few tens of megabytes
_EDGES_A_STEP = 2**15  # edges tested between two updates of the progress bar
# Sampling gives up after so many draws if a smaller part of them is free.
_MIN_FREE_FRACTION = 1e-4
_DRAWS_BEFORE_GIVING_UP = 100_000


def prm_star_radius(num_vertices: int, dim: int, free_volume: float) -> float:
    """Return the connection radius of PRM* for ``n >= 2`` vertices, proportional to ``(log n / n)^(1/dim)``.

    ``free_volume`` is the volume of free space; its length unit is also the unit of the radius.
    """
    # Karaman and Frazzoli (2011): gamma = 2 ((1 + 1/d) volume of free space / volume of the unit ball)^(1/d).
    unit_ball_volume = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1)
    gamma = 2 * ((1 + 1 / dim) * free_volume / unit_ball_volume) ** (1 / dim)
    return gamma * (math.log(num_vertices) / num_vertices) ** (1 / dim)


def sample_free(metric: Metric, is_free: IsFree, num_samples: int, seed: int) -> tuple[Points, float]:
    """Draw free configurations uniformly, ``(num_samples, dim)``; also return the estimated volume of free space.

    The volume is that of free space after each axis is scaled by its weight in ``metric``. ``ValueError`` if hardly
    any configuration is free.
    """
    domain = metric.domain
    rng = np.random.default_rng(seed)
    batch = max(num_samples, 1000)
    accepted, num_free, num_drawn = [], 0, 0
    while num_free < num_samples:
        draws = domain.lo + domain.width * rng.random((batch, domain.dim))
        accepted.append(draws[is_free(draws)])
        num_free += len(accepted[-1])
        num_drawn += batch
        if num_drawn >= _DRAWS_BEFORE_GIVING_UP and num_free < _MIN_FREE_FRACTION * num_drawn:
            advice = "shrink the domain around free space, or check is_free"
            raise ValueError(f"Only {num_free} of {num_drawn} draws from the domain {domain} are free; {advice}.")
    return np.concatenate(accepted)[:num_samples], float(np.prod(metric.widths)) * num_free / num_drawn


def visible_edges(vertices: Points, tree: KDTree, radius: float, is_visible: IsVisible) -> Int[np.ndarray, "e 2"]:
    """Return index pairs of vertices at most ``radius`` apart that a free straight motion joins, ``(edges, 2)``.

    ``tree`` is the k-d tree of the vertices, and ``is_visible`` the test of motions.
    """
    pairs = tree.query_pairs(radius, output_type="ndarray")
    visible = np.zeros(len(pairs), dtype=bool)
    with Progress("Roadmap", "edges", len(pairs)) as progress:
        for rows in _arrays.slices(len(pairs), _EDGES_A_STEP):
            start, end = pairs[rows].T
            visible[rows] = is_visible(vertices[start], vertices[end])
            progress.update(len(start))
    return pairs[visible].astype(np.int32)


def _checked_is_free(domain: Box, is_free: IsFree, x: Points) -> Flags:
    # The test is called only for configurations in the domain; others are not free.
    if (inside := domain.contains(x)).any():
        inside[inside] = _arrays.as_booleans("is_free", is_free(domain.wrapped(x[inside])), int(inside.sum()))
    return inside


def _checked_is_visible(domain: Box, is_visible: IsVisible, a: Points, b: Points) -> Flags:
    if len(a) == 0:
        return np.zeros(0, dtype=bool)
    return _arrays.as_booleans("is_visible", is_visible(a, domain.image_near(b, a)), len(a))


def _is_visible_sampled(metric: Metric, is_free: IsFree, resolution: float, a: Points, b: Points) -> Flags:
    """Return whether the straight motion from each ``a[i]`` to ``b[i]``, two free configurations, is free.

    Only configurations on the motion at most ``resolution`` apart are tested.
    """
    # Divide each motion into equal steps, and test the points between steps, coarsely first: a motion that was found
    # not to be free is tested no further.
    #
    #     a - 1 - 2 - 3 - 4 - 5 - 6 - 7 - b      Of 8 steps, stride 4 tests point 4, stride 2 points 2 and 6, and
    #                                            stride 1 all odd points: odd multiples of the stride.
    b = metric.domain.image_near(b, a)
    change = b - a
    num_steps = np.ceil(metric.lengths(a, b) / resolution).astype(np.int64)
    is_visible = np.ones(len(a), dtype=bool)
    stride = 1 << max(int(num_steps.max(initial=0)) - 1, 0).bit_length()
    while stride := stride // 2:
        # Of the n - 1 points between n steps, (n - 1) // stride are multiples of the stride; the odd ones are new.
        num_tests = np.where(is_visible, (np.maximum(num_steps - 1, 0) // stride + 1) // 2, 0)
        for rows in _arrays.parts(num_tests, _BATCH):
            row, test = _arrays.ragged_indices(num_tests[rows])
            motion = rows.start + row
            x = a[motion] + ((1 + 2 * test) * stride / num_steps[motion])[:, None] * change[motion]
            is_visible[motion[~is_free(x)]] = False
    return is_visible


@dataclass(frozen=True, eq=False, init=False)
class Roadmap:
    """Distance to a goal over a probabilistic roadmap (PRM*), a `DistanceFn` in any dimension.

    The vertices are free configurations, drawn uniformly, and the goal. Two vertices within the PRM* radius that see
    each other are joined by a straight edge (Karaman and Frazzoli, "Sampling-based algorithms for optimal motion
    planning", IJRR 2011, section 3.3). A query takes the shortest path through one of the vertices that the point
    sees within the radius. If the edge test is right, the answer is never below the true distance, and approaches it
    as samples are added. Lengths are Euclidean norms of differences times the ``weights``, the short way around
    periodic axes. ``ValueError`` if an argument is invalid, or fewer than 1 in 10,000 draws are free.

    Args:
        domain: The box of configurations, or its corners ``(lo, hi)``. Outside it nothing is free. Along periodic
            axes, such as angles, points are wrapped into it.
        is_free: Collision test, from configurations ``(n, dim)`` in the domain to booleans ``(n,)``, for any ``n``.
            The answer for a point must not depend on the other points.
        goal: A free configuration, ``(dim,)``.
        num_samples: Number of free configurations to draw, at least 1.
        seed: Seed of the samples. With the same seed, more samples extend the sequence.
        is_visible: Exact test of straight motions, from free starts and ends ``(n, dim)`` to booleans ``(n,)``.
            Around periodic axes a motion may leave the domain: its end is the image nearest to its start.
        resolution: Instead of ``is_visible``: the largest step, in weighted units, between points of a straight
            motion that are tested with ``is_free``. Thinner obstacles can be passed through.
        weights: Weight of a unit along each axis, ``(dim,)``, positive, such as the length of a radian. None: 1 each.

    Attributes:
        radius: Connection radius, in the units of ``weights``.
        graph: Vertices and edges; vertex 0 is the goal, the others are the samples.
        distances: Distance of each vertex to the goal, ``inf`` if the roadmap does not connect them.
    """

    domain: Box
    is_free: IsFree
    is_visible: IsVisible
    radius: float
    graph: Graph
    distances: Float[np.ndarray, " vertices"]
    _metric: Metric
    _parents: Int[np.ndarray, " vertices"]
    _tree: KDTree
    _workspace: Workspace | None = None

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
        weights: ArrayLike | None = None,
    ):
        # 1. Check the arguments, and wrap the tests so that they check answers.
        _arrays.require_integer("num_samples", num_samples, 1)
        domain = Box.of(domain, "The domain")
        is_free = partial(_checked_is_free, domain, is_free)  # unlike a closure, it can be pickled if the test can
        weights = np.ones(domain.dim) if weights is None else _arrays.as_finite_point("weights", weights, domain.dim)
        if (weights <= 0).any():
            raise ValueError(f"weights must be positive, one per axis, got {weights.tolist()}.")
        metric = Metric(domain, weights)
        if (is_visible is None) == (resolution is None):
            raise ValueError("Give is_visible, an exact test of motions, or resolution, the step of a sampled test.")
        if is_visible is None:
            step = _arrays.as_finite("resolution", resolution, positive=True)
            is_visible = partial(_is_visible_sampled, metric, is_free, step)
        else:
            is_visible = partial(_checked_is_visible, domain, is_visible)
        goal = _free_goal(domain, is_free, goal)
        # 2. Draw vertices, join near ones that see each other, and find shortest paths to the goal.
        samples, free_volume = sample_free(metric, is_free, num_samples, seed)
        vertices = np.concatenate([goal[None], samples])
        radius = prm_star_radius(len(vertices), domain.dim, free_volume)
        tree = metric.tree(vertices)
        _arrays.set_fields(self, domain=domain, is_free=is_free, is_visible=is_visible, radius=radius, _metric=metric)
        self._search(Graph(vertices, visible_edges(vertices, tree, radius, is_visible), metric.lengths), tree)

    def __repr__(self) -> str:
        vertices, edges = len(self.graph.vertices), len(self.graph.edges)
        goal = _arrays.format_numbers(self.graph.vertices[0])
        return f"Roadmap({self.domain}, goal={goal}, {vertices} vertices, {edges} edges)"

    @classmethod
    def from_workspace(cls, workspace: Workspace, goal: ArrayLike, num_samples: int, *, seed: int = 0) -> "Roadmap":
        """Build the roadmap of a point robot in a workspace, with exact edge tests; see the class for arguments."""
        require_workspace(workspace)
        arguments = workspace.bounds, workspace.is_free, workspace.settled(goal), num_samples
        oracle = cls(*arguments, seed=seed, is_visible=workspace.is_visible)
        _arrays.set_fields(oracle, _workspace=workspace)
        return oracle

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach the goal, or free points that do not.

        Paths are those of the workspace, not of the roadmap. The result is None if a path leads from every free
        point, or if the roadmap was not built from a workspace.
        """
        return None if self._workspace is None else self._workspace.reach(self.goal[None], domain)

    def with_goal(self, goal: ArrayLike) -> "Roadmap":
        """Return the roadmap of the same samples for another free goal ``(dim,)``, testing only the goal's edges.

        The result equals a new construction with this goal and the same seed. ``ValueError`` if the goal is not free.
        """
        goal = _free_goal(self.domain, self.is_free, self._settled(goal))
        samples, edges = self.graph.vertices[1:], self.graph.edges
        # Replace the goal, vertex 0, and its edges.
        near = np.flatnonzero(self._metric.lengths(goal[None], samples) <= self.radius)
        near = near[self.is_visible(np.tile(goal, (len(near), 1)), samples[near])]
        to_goal = np.stack([np.zeros_like(near), 1 + near], axis=1).astype(edges.dtype)
        vertices = np.concatenate([goal[None], samples])
        edges = np.concatenate([to_goal, edges[(edges > 0).all(axis=1)]])
        oracle = copy(self)
        oracle._search(Graph(vertices, edges, self._metric.lengths), self._metric.tree(vertices))
        return oracle

    def _search(self, graph: Graph, tree: KDTree) -> None:
        distances, parents = dijkstra(graph.adjacency, 0)
        graph.vertices.flags.writeable = distances.flags.writeable = False
        _arrays.set_fields(self, graph=graph, distances=distances, _parents=parents, _tree=tree)

    @property
    def goal(self) -> Float[np.ndarray, "dim"]:
        """The goal, vertex 0 of the graph."""
        return self.graph.vertices[0]

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.domain.dim

    @property
    def num_bytes(self) -> int:
        """Bytes of vertices (float64), edges (int32) and lengths (float64), which suffice to search for any goal."""
        return sum(array.nbytes for array in (self.graph.vertices, self.graph.edges, self.graph.lengths))

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance ``(n,)`` of each point ``(n, dim)`` to the goal along the roadmap.

        Lengths count with the ``weights`` of the constructor. If a point sees no vertex within ``radius``, vertices
        within 2, 4, ... times the radius are tried. The distance is ``inf`` for a point that is not free, is outside
        the domain, has a NaN, or sees no vertex from which the goal can be reached.
        """
        return self._first_vertices(_arrays.as_points("x", self._settled(x), self.dim))[0]

    def shortest_path(self, x: ArrayLike) -> Float[np.ndarray, "m dim"]:
        """Return the path from a point ``(dim,)`` to the goal along the roadmap, as vertices ``(m, dim)``.

        A call with this point returns the length of the path. There is one vertex if the point is the goal, none if
        the length is ``inf``. Along periodic axes, vertices are wrapped into the domain, and the path goes the short
        way around.
        """
        x = self.domain.wrapped(_arrays.as_point("The start", self._settled(x), self.dim)[None])
        distance, first = self._first_vertices(x)
        if not np.isfinite(distance[0]):
            return np.empty((0, self.domain.dim))
        return path_to_root(self.graph, self._parents, x[0], int(first[0]))

    def _settled(self, x: ArrayLike) -> ArrayLike:
        # Move points that rounding to 32 bits has put outside the domain or into obstacles.
        return self.domain.settled(x, self.is_free) if self._workspace is None else self._workspace.settled(x)

    def _first_vertices(self, x: Points) -> tuple[Distances, Int[np.ndarray, " n"]]:
        """Return each point's distance to the goal, and the index of the first vertex on the path from the point.

        The index is -1 if the point is not free or sees no vertex.
        """
        distance, first = np.full(len(x), np.inf), np.full(len(x), -1)
        pending, inner, outer = np.flatnonzero(self.is_free(x)), -np.inf, self.radius
        diameter = np.linalg.norm(self._metric.widths)  # no two configurations of the domain are farther apart
        while pending.size and inner < diameter:
            distance[pending], first[pending] = self._connect(x[pending], inner, outer)
            pending = pending[first[pending] < 0]
            inner, outer = outer, 2 * outer
        return distance, first

    def _connect(self, x: Points, inner: float, outer: float) -> tuple[Distances, Int[np.ndarray, " n"]]:
        """Return each point's distance to the goal along the roadmap, and the index of the path's first vertex.

        Only vertices whose distance from the point is above ``inner`` and at most ``outer`` are tried. The index is
        -1 if the point sees none of them.
        """
        # 1. Count the vertices near each point, and choose how many points to handle together.
        places, vertices = self._metric.tree_coordinates(x), self.graph.vertices
        count = self._tree.query_ball_point(places, outer, return_length=True)
        step = max(1, _BATCH // max(1, count.max()))
        distance, first = np.empty(len(x)), np.empty(len(x), int)
        # The tree's bound is exclusive. If a point has fewer vertices near it than others, the tree fills its row up
        # with infinite lengths, and the number of vertices as index.
        limit = np.nextafter(outer, np.inf)
        distances = np.append(self.distances, np.inf)

        def sees(batch, vertex, point, column):
            return self.is_visible(batch[point], vertices[vertex[point, column]])

        with Progress("Roadmap", "queries", len(x)) as progress:
            for rows in _arrays.slices(len(x), step):
                # 2. Find the near vertices, and the length of the path through each; NaN excludes a vertex.
                #    The tree refuses to look for no vertices.
                batch, nearest = x[rows], np.arange(1, 1 + max(1, int(count[rows].max())))
                length, vertex = self._tree.query(places[rows], k=nearest, distance_upper_bound=limit)
                through = length + distances[vertex]
                through[(length <= inner) | np.isinf(length)] = np.nan
                # 3. Take the shortest path whose first vertex is visible. If none is, the column is -1.
                column, shortest = first_visible(through, partial(sees, batch, vertex), at_once=1)
                vertex = np.where(column < 0, -1, np.take_along_axis(vertex, column, axis=1))
                distance[rows], first[rows] = shortest[:, 0], vertex[:, 0]
                progress.update(len(batch))
        return distance, first


def _free_goal(domain: Box, is_free: IsFree, goal: ArrayLike) -> Float[np.ndarray, " dim"]:
    goal = domain.wrapped(_arrays.as_finite_point("The goal", domain.settled(goal, is_free), domain.dim))
    if not domain.contains(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is outside the domain {domain}; move it inside.")
    if not is_free(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is not free; move it to a free configuration.")
    return goal
