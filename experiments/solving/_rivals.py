"""Configuration spaces that count what they are asked: the price of a method in tests of freedom."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax import Box, GridField, Roadmap
from plr_jax.geometry import graph as graphs
from plr_jax.spaces import ConfigurationSpace, FreeTest, MotionCost, SeesBoxes


@dataclass
class Tests:
    """How often a space was asked, and about how many configurations, motions and boxes."""

    calls: int = 0
    configurations: int = 0
    motions: int = 0
    boxes: int = 0

    def add(self, kind: str, asked: np.ndarray) -> None:
        """One call more."""
        self.calls += 1
        setattr(self, kind, getattr(self, kind) + len(asked))

    def for_json(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class CountedSpace:
    """A configuration space, and how often it was asked."""

    space: ConfigurationSpace
    tests: Tests = field(default_factory=Tests)

    @property
    def domain(self) -> Box:
        return self.space.domain

    @property
    def motion_cost(self) -> MotionCost:
        return self.space.motion_cost

    def is_free(self, q: Any) -> Bool[np.ndarray, " n"]:
        self.tests.add("configurations", q)
        return self.space.is_free(q)

    def are_free(self, q0: Any, q1: Any) -> Bool[np.ndarray, " n"]:
        self.tests.add("motions", q0)
        return self.space.are_free(q0, q1)

    def classify(self, lo: Any, hi: Any) -> Int8[np.ndarray, " n"]:
        self.tests.add("boxes", lo)
        return self.space.classify(lo, hi)


@dataclass(frozen=True, eq=False)
class CountedSeeingSpace(CountedSpace):
    """The same of a space that sees boxes: each box that is looked into counts as one more."""

    def sees_boxes(self, q: Any, lo: Any, hi: Any) -> Bool[np.ndarray, " n"]:
        assert isinstance(self.space, SeesBoxes)
        self.tests.add("boxes", lo)
        return self.space.sees_boxes(q, lo, hi)


def counted(space: ConfigurationSpace) -> CountedSpace:
    """The space with everything that it can do, none of it asked yet."""
    return CountedSeeingSpace(space) if isinstance(space, SeesBoxes) else CountedSpace(space)


# Cost-to-go on regular grids: Dijkstra's algorithm among many neighbors, and fast marching (scikit-fmm).
#
# Values are at the centers of a grid's cells, and read between them by :class:`plr_jax.GridField`.

_AT_ONCE = 1 << 20  # cells tested at a time, which bounds the memory
_RADIUS = 4.0  # cells: around the goal, where motions are straight

Sizes = tuple[int, ...]
Cells = Int[np.ndarray, "n"]


def even_sizes(domain: Box, scale: Float[np.ndarray, " dim"], num_cells: int) -> Sizes:
    """About so many cells whose sides cost the same, where a unit along each axis counts by a scale."""
    sides = domain.width * scale
    spacing = (np.prod(sides) / num_cells) ** (1 / domain.dim)
    return tuple(int(size) for size in np.maximum(1, np.rint(sides / spacing)))


def centers(domain: Box, sizes: Sizes, cell: Cells) -> Float[np.ndarray, "n dim"]:
    """Centers of cells, by number; the first coordinate runs fastest, as a GridField wants it."""
    place = np.stack(np.unravel_index(cell, sizes[::-1])[::-1], axis=1)
    return domain.lo + domain.width * (place + 0.5) / sizes


def free_cells(space: FreeTest, sizes: Sizes) -> Bool[np.ndarray, " cells"]:
    """Which cells have a center that is free."""
    return np.concatenate([space.is_free(centers(space.domain, sizes, part)) for part in _parts(sizes)])


def _parts(sizes: Sizes) -> Iterator[Cells]:
    num_cells = int(np.prod(sizes))
    for begin in range(0, num_cells, _AT_ONCE):
        yield np.arange(begin, min(begin + _AT_ONCE, num_cells))


def all_neighbors(dim: int, reach: int) -> list[tuple[int, ...]]:
    """Offsets of at most so many cells along each axis, the shortest in each direction, of two opposite ones one."""
    offsets = product(range(-reach, reach + 1), repeat=dim)
    return [each for each in offsets if np.gcd.reduce(each) == 1 and each > tuple(-step for step in each)]


def grid_search(
    space: ConfigurationSpace, goal: Float[np.ndarray, " dim"], sizes: Sizes, offsets: Sequence[tuple[int, ...]]
) -> GridField:
    """Cost-to-go along free motions between cells that are an offset apart, by Dijkstra's algorithm."""
    cells = np.flatnonzero(free_cells(space, sizes))
    node = np.full(int(np.prod(sizes)), -1, np.int32)
    node[cells] = np.arange(len(cells))
    links = [_links_to_goal(space, goal, sizes, cells), *_links(space, sizes, cells, node, offsets)]
    begin, end, cost = (np.concatenate(each) for each in zip(*links, strict=True))
    graph = csr_array((cost, (begin, end)), shape=(len(cells) + 1,) * 2)
    values = np.full(len(node), np.inf)
    values[cells] = dijkstra(graph, directed=False, indices=len(cells))[:-1]
    return GridField(values.reshape(sizes[::-1]), space.domain)


Links = tuple[Cells, Cells, Float[np.ndarray, " n"]]


def _links(
    space: ConfigurationSpace, sizes: Sizes, cells: Cells, node: Cells, offsets: Sequence[tuple[int, ...]]
) -> Iterator[Links]:
    """Free motions from each cell to that at each offset, and their costs."""
    domain, place = space.domain, np.stack(np.unravel_index(cells, sizes[::-1])[::-1], axis=1)
    for offset in offsets:
        target = np.where(domain.periodic, (place + offset) % sizes, place + offset)
        inside = np.flatnonzero(((target >= 0) & (target < sizes)).all(axis=1))
        other = node[np.ravel_multi_index(tuple(target[inside].T[::-1]), sizes[::-1])]
        begin, end = inside[other >= 0], other[other >= 0].astype(np.int64)
        q0, q1 = (centers(domain, sizes, cells[which]) for which in (begin, end))
        free = space.are_free(q0, q1)
        yield begin[free], end[free], space.motion_cost.lengths(q0[free], q1[free], domain)


def _links_to_goal(space: ConfigurationSpace, goal: Float[np.ndarray, " dim"], sizes: Sizes, cells: Cells) -> Links:
    """Free motions from the cells around the goal to it, which has the number after theirs."""
    x = centers(space.domain, sizes, cells)
    steps = np.abs(space.domain.difference(x, goal[None])) / space.domain.width * sizes
    near = np.flatnonzero((steps <= _RADIUS).all(axis=1))
    to_goal = np.tile(goal, (len(near), 1))
    near = near[space.are_free(x[near], to_goal)]
    cost = space.motion_cost.lengths(x[near], to_goal[: len(near)], space.domain)
    return near, np.full(len(near), len(cells)), cost


def marched(
    space: ConfigurationSpace,
    goal: Float[np.ndarray, " dim"],
    sizes: Sizes,
    factor: Callable[[Any], Float[np.ndarray, " n"]] | None = None,
) -> GridField:
    """Cost-to-go by fast marching of second order, where cost is Euclidean length times a factor, 1 if None.

    The front starts from a ball around the goal, of four cells where it sees all of them, else of as many as it does,
    within which the factor is the goal's.
    """
    import skfmm

    domain, shape = space.domain, sizes[::-1]
    spacing = (domain.width / sizes)[::-1]
    from_goal = np.concatenate(
        [
            np.linalg.norm(domain.difference(centers(domain, sizes, part), goal[None]), axis=1)
            for part in _parts(sizes)
        ]
    ).reshape(shape)
    speed = np.ones(shape)
    if factor is not None:
        costs = [factor(centers(domain, sizes, part)) for part in _parts(sizes)]
        speed = 1 / np.concatenate(costs).reshape(shape)
    blocked = ~free_cells(space, sizes).reshape(shape)
    radius = _radius(space, goal, sizes, from_goal)
    periodic: Any = domain.periodic[::-1]
    front: Any = np.ma.MaskedArray(from_goal - radius, blocked)
    time = skfmm.travel_time(front, speed, dx=spacing.tolist(), order=2, periodic=periodic)
    slowness = 1.0 if factor is None else float(factor(goal[None])[0])
    time = np.where(from_goal > radius, np.ma.filled(time, np.nan) + radius * slowness, from_goal * slowness)
    return GridField(np.where(blocked, np.nan, time), domain)


def _radius(space: ConfigurationSpace, goal: Float[np.ndarray, " dim"], sizes: Sizes, from_goal: np.ndarray) -> float:
    """Of a ball around the goal that holds a cell's center, and if possible no more than centers that it sees."""
    spacing = space.domain.width / sizes
    near = np.flatnonzero(from_goal.ravel() <= _RADIUS * spacing.max())
    x = centers(space.domain, sizes, near)
    unseen = near[~space.are_free(x, np.tile(goal, (len(near), 1)))]
    seen_to = from_goal.ravel()[unseen].min(initial=_RADIUS * spacing.max())
    return float(max(np.linalg.norm(spacing), seen_to - spacing.max()))


# PRM* in any configuration space, with the space's own cost of motions.

_BYTES_A_FLOAT = 4


class SampledCosts(NamedTuple):
    """Cost-to-go of the samples of a roadmap, and what it took."""

    vertices: Float[np.ndarray, "v dof"]
    costs: Float[np.ndarray, " v"]
    roadmap: Roadmap
    seconds: float
    tests: dict[str, Any]

    @property
    def num_bytes(self) -> int:
        """Of what answers for this goal: coordinates and costs of the vertices, in float32."""
        return _BYTES_A_FLOAT * (self.vertices.size + self.costs.size)


def prm_star(space: ConfigurationSpace, goal: Float[np.ndarray, " dof"], num_samples: int, seed: int) -> SampledCosts:
    """A roadmap of a space, its samples' costs those of the space, which need not be Euclidean lengths."""
    asked = counted(space)
    scale = space.motion_cost.scale
    began = time.perf_counter()
    roadmap = Roadmap(
        space.domain, asked.is_free, goal, num_samples, seed=seed, is_visible=asked.are_free, weights=scale
    )
    costs = roadmap.distances
    if len(space.motion_cost.blocks) > 1:
        measure = partial(space.motion_cost.lengths, domain=space.domain)
        graph = graphs.Graph(roadmap.graph.vertices, roadmap.graph.edges, measure)
        costs, _ = graphs.dijkstra(graph.adjacency, 0)
    seconds = time.perf_counter() - began
    return SampledCosts(roadmap.graph.vertices, costs, roadmap, seconds, asked.tests.for_json())
