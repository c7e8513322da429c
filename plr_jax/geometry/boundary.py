"""The boundary of a polygonal region as a graph: its edges, and the free sectors at its vertices."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import found
from plr_jax._deadline import require_time
from plr_jax.geometry.vectors import arc, cross_product, left_normal, pseudo_angle, turn_between

_COLLARS, _REGIONS = 256, 8  # of walls and of regions, united at a time, between two looks at the clock
_TIP = 100  # tolerances from an end of an edge, where an edge of a blunter tip is not beside the other one any more
_MOST_CHORDS = 8
"""Chords a quarter circle around the corners of inflated obstacles: a path along one is 0.16 % too short."""
_SHORTENING = 2e-5
"""Length, in longer sides of the region, by which a path around one corner may be too short with fewer chords."""


@dataclass(frozen=True, eq=False)
class Boundary:
    """The boundary of a polygonal region as a graph: vertices, and edges with the region on their left.

    At each vertex the region is a union of sectors. Every sector opens counterclockwise from the edge that
    leaves the vertex to the edge that arrives at it, so there is one for each edge: sector ``e`` lies at the
    first vertex of edge ``e``. Where the region touches itself in one point, that vertex has several.

    Args:
        vertices: Distinct vertices, ``(vertices, 2)``.
        edges: Indices of the first and last vertex of each edge, ``(edges, 2)``.
        sector_end: The vertex towards which sector ``e`` closes, ``(edges,)``.
    """

    vertices: Float[np.ndarray, "vertices 2"]
    edges: Int[np.ndarray, "edges 2"]
    sector_end: Int[np.ndarray, "edges"]

    @cached_property
    def segments(self) -> Float[np.ndarray, "edges 2 2"]:
        """First and last point of each edge."""
        return self.vertices[self.edges]

    @cached_property
    def normal(self) -> Float[np.ndarray, "edges 2"]:
        """Unit normal of each edge, into the region."""
        start, end = self.segments.transpose(1, 0, 2)
        return left_normal(end - start)

    @cached_property
    def offset(self) -> Float[np.ndarray, "edges"]:
        """``normal @ x`` on each edge; beside the edge, the region is where it is more."""
        return (self.normal * self.segments.sum(axis=1)).sum(axis=1) / 2

    @property
    def contacts(self) -> Int[np.ndarray, "contacts"]:
        """Vertices in which the region touches itself: those of more than one sector."""
        return np.flatnonzero(np.bincount(self.edges[:, 0], minlength=len(self.vertices)) > 1)

    def is_reflex(self, tolerance: float) -> Bool[np.ndarray, "edges"]:
        """Whether each sector is wider than half a turn, by a corner that stands out by ``tolerance``."""
        corner = self.vertices[self.edges[:, 0]]
        to_start = self.vertices[self.edges[:, 1]] - corner
        to_end = self.vertices[self.sector_end] - corner
        span = np.linalg.norm(to_start - to_end, axis=1)
        return cross_product(to_start, to_end) < -tolerance * span

    def in_sector(
        self, edge: int | np.integer, offsets: Float[np.ndarray, "n 2"], tolerance: float
    ) -> Bool[np.ndarray, "n"]:
        """Whether offsets from the first vertex of an edge lie in the closed sector there."""
        vertex = self.vertices[self.edges[edge, 0]]
        start = self.vertices[self.edges[edge, 1]] - vertex
        end = self.vertices[self.sector_end[edge]] - vertex
        left_of_start = cross_product(start, offsets) >= -tolerance * np.linalg.norm(start)
        right_of_end = cross_product(end, offsets) <= tolerance * np.linalg.norm(end)
        return left_of_start & right_of_end if cross_product(start, end) > 0 else left_of_start | right_of_end

    def is_squeezed(
        self, a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"], tolerance: float
    ) -> Bool[np.ndarray, "n"]:
        """Whether segments in free space change from one sector to another in a point contact."""
        squeezes = np.zeros(len(a), dtype=bool)
        contacts: Any = shapely.points(self.vertices[self.contacts])
        segments = shapely.linestrings(np.stack([a, b], axis=1))
        segment, contact = shapely.STRtree(contacts).query(segments, predicate="dwithin", distance=tolerance)
        for vertex, s in zip(self.contacts[contact], segment, strict=True):
            ends = np.stack([a[s], b[s]]) - self.vertices[vertex]
            if np.linalg.norm(ends, axis=1).min() <= tolerance:
                continue
            inside = [self.in_sector(e, ends, tolerance) for e in np.flatnonzero(self.edges[:, 0] == vertex)]
            squeezes[s] |= not any(both.all() for both in inside)
        return squeezes


def thin_walls(boundary: Boundary, tree: shapely.STRtree, tolerance: float) -> Float[np.ndarray, "walls 3 2"]:
    """Edges beside others, or of tips, through which free space that is grown by a tolerance would meet itself.

    Each twice: as its first point, again, and its last one; and as the vertex before it, its first and last point.
    Some are none, but stand beside a gap as thin.

    Args:
        boundary: The boundary of free space.
        tree: Its edges.
        tolerance: By which free space is grown.
    """
    start, end = boundary.segments.transpose(1, 0, 2)
    way = end - start
    step = way * np.minimum(_TIP * tolerance / np.linalg.norm(way, axis=1), 0.5)[:, None]
    point, beside = tree.query(
        shapely.points(np.concatenate([start, start + step, end - step])), predicate="dwithin", distance=2 * tolerance
    )
    edge, is_vertex = point % len(way), point < len(way)
    apart = (edge != beside) & ~(is_vertex & (boundary.edges[beside] == boundary.edges[edge, :1]).any(axis=1))
    thin = np.union1d(edge[apart], beside[apart])
    start, end, before = start[thin], end[thin], boundary.vertices[boundary.sector_end[thin]]
    return np.concatenate([np.stack([start, start, end], axis=1), np.stack([before, start, end], axis=1)])


def are_crossed(
    walls: Float[np.ndarray, "walls 3 2"], a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Whether segments cross walls of ``thin_walls`` from side to side.

    Neither do those that end on a wall, to the tolerance, nor those that come as near to the end of one.
    """
    lines: Any = shapely.linestrings(walls)
    segment, wall = shapely.STRtree(lines).query(
        shapely.linestrings(np.stack([a, b], axis=1)), predicate="intersects"
    )
    ends_apart = ~np.any(
        [shapely.dwithin(lines[wall], shapely.points(x[segment]), tolerance) for x in (a, b)], axis=0
    )
    segment, wall = segment[ends_apart], wall[ends_apart]
    normal = left_normal(b[segment] - a[segment])[:, None]
    first, middle, last = (normal * (walls[wall] - a[segment][:, None])).sum(axis=2).T
    through = (first * last < 0) & (np.minimum(np.abs(first), np.abs(last)) > tolerance)
    through &= (middle == first) | (np.abs(middle) <= tolerance)
    return np.isin(np.arange(len(a)), segment[through])


@dataclass(frozen=True, eq=False)
class RingEdges:
    """Rings of a region before edges are split where a vertex lies on one.

    Args:
        vertices: Distinct vertices, in order.
        edges: Indices of the first and last vertex of each edge, the region on its left.
        vertex: Vertices as near as the tolerance to edges of which they are no ends.
        edge: These edges.
        tolerance: The tolerance.
    """

    vertices: Float[np.ndarray, "vertices 2"]
    edges: Int[np.ndarray, "edges 2"]
    vertex: Int[np.ndarray, "pairs"]
    edge: Int[np.ndarray, "pairs"]
    tolerance: float

    @classmethod
    def of(cls, region: Any, tolerance: float, known: Boundary | None = None) -> "RingEdges":
        """That of a valid Shapely (Multi)Polygon; edges and vertices of a known boundary are near no others of it."""
        rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
        points, ring = shapely.get_coordinates(rings, return_index=True)
        numbers, index = np.unique(points @ [1, 1j], return_inverse=True)  # ordered by x, then y
        vertices, inner = np.stack([numbers.real, numbers.imag], axis=1), ring[1:] == ring[:-1]
        edges = np.stack([index[:-1][inner], index[1:][inner]], axis=1)
        all_vertices, all_edges = np.arange(len(vertices)), np.arange(len(edges))
        if known is None:
            return cls(vertices, edges, *_near(vertices, edges, tolerance, all_vertices, all_edges), tolerance)
        of_known, of_edge = places_of(vertices, edges, known)
        is_new = ~np.isin(all_vertices, of_known), ~np.isin(all_edges, of_edge)
        new_vertices, new_edges = (np.flatnonzero(each) for each in is_new)
        pairs = (
            _near(vertices, edges, tolerance, all_vertices, new_edges),
            _near(vertices, edges, tolerance, new_vertices, np.flatnonzero(~is_new[1])),
        )
        vertex, edge = np.concatenate(pairs, axis=1)
        return cls(vertices, edges, vertex, edge, tolerance)

    @property
    def is_told_apart(self) -> bool:
        """Whether vertices lie on edges, to a quarter of the tolerance, or not even to all of it.

        If one does neither, or is as near to another vertex, edges that are split there may cross or cover one
        another.
        """
        start, end = self.vertices[self.edges[self.edge]].transpose(1, 0, 2)
        along, way = end - start, self.vertices[self.vertex] - start
        is_beside = np.abs(cross_product(along, way)) > self.tolerance / 4 * np.linalg.norm(along, axis=1)
        is_beyond = ((way * along).sum(axis=1) <= 0) | (((way - along) * along).sum(axis=1) >= 0)
        first, last = np.sort(self._pieces, axis=1).T
        pieces = np.sort(first * np.int64(len(self.vertices)) + last)
        return not (is_beside | is_beyond).any() and bool((pieces[1:] != pieces[:-1]).all())

    @cached_property
    def _pieces(self) -> Int[np.ndarray, "pieces 2"]:
        return _split(self.vertices, self.edges, self.vertex, self.edge)

    @property
    def boundary(self) -> Boundary:
        """The boundary of the region, edges split where a vertex lies on one."""
        vertices, edges = self.vertices, self._pieces
        # A sector closes at the start of the arriving edge that comes first counterclockwise. Around a vertex leaving
        # and arriving edges alternate, so a leaving one is closed by its successor.
        at, other = edges.T.ravel(), edges[:, ::-1].T.ravel()
        direction = vertices[other] - vertices[at]
        order = np.lexsort((pseudo_angle(direction[:, 0], direction[:, 1]), at))
        first, end = (np.searchsorted(at[order], at[order], side=side) for side in ("left", "right"))
        successor = order[first + (np.arange(len(order)) - first + 1) % (end - first)]
        ends = np.empty(len(order), dtype=np.intp)
        ends[order] = other[successor]
        return Boundary(vertices, edges, ends[: len(edges)])


def places_of(
    vertices: Float[np.ndarray, "vertices 2"], edges: Int[np.ndarray, "edges 2"], old: Boundary
) -> tuple[Int[np.ndarray, "old_vertices"], Int[np.ndarray, "old_edges"]]:
    """Which vertices and edges those of a boundary are, to the bit; -1 for none."""
    vertex = found(vertices @ [1, 1j], old.vertices @ [1, 1j])
    size = np.int64(len(vertices))
    start, end = vertex[old.edges].T
    wanted = np.where((start < 0) | (end < 0), -1, start * size + end)
    return vertex, found(edges[:, 0] * size + edges[:, 1], wanted)


def _near(
    vertices: Float[np.ndarray, "vertices 2"],
    edges: Int[np.ndarray, "edges 2"],
    tolerance: float,
    some_vertices: Int[np.ndarray, "some_vertices"],
    some_edges: Int[np.ndarray, "some_edges"],
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Some of the vertices that lie on some of the edges, and these, without the ends of edges."""
    none = np.empty(0, int)
    if not (len(some_vertices) and len(some_edges)):
        return none, none
    if len(some_edges) < len(edges) or len(some_vertices) < len(vertices):  # what is nowhere near is left out at once
        some_vertices = some_vertices[_meet(vertices[some_vertices, None], vertices[edges[some_edges]], tolerance)]
        if not len(some_vertices):
            return none, none
        some_edges = some_edges[_meet(vertices[edges[some_edges]], vertices[some_vertices, None], tolerance)]
    lines: Any = shapely.linestrings(vertices[edges[some_edges]])
    points = shapely.points(vertices[some_vertices])
    vertex, edge = shapely.STRtree(lines).query(points, predicate="dwithin", distance=tolerance)
    vertex, edge = some_vertices[vertex], some_edges[edge]
    apart = (edges[edge] != vertex[:, None]).all(axis=1)
    return vertex[apart], edge[apart]


def _meet(
    boxes: Float[np.ndarray, "n k 2"], others: Float[np.ndarray, "m l 2"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Whether boxes around points meet the one around all others."""
    lo, hi = others.min(axis=(0, 1)) - tolerance, others.max(axis=(0, 1)) + tolerance
    return ((boxes.min(axis=1) <= hi) & (boxes.max(axis=1) >= lo)).all(axis=1)


def _split(
    vertices: Float[np.ndarray, "vertices 2"],
    edges: Int[np.ndarray, "edges 2"],
    vertex: Int[np.ndarray, "pairs"],
    edge: Int[np.ndarray, "pairs"],
) -> Int[np.ndarray, "pieces 2"]:
    """Edges cut at vertices that lie on them."""
    along = np.linalg.norm(vertices[vertex] - vertices[edges[edge, 0]], axis=1)
    owner = np.concatenate([np.arange(len(edges)), edge])
    start = np.concatenate([edges[:, 0], vertex])
    order = np.lexsort((np.concatenate([np.zeros(len(edges)), along]), owner))
    owner, start = owner[order], start[order]
    last = np.append(owner[1:] != owner[:-1], True)
    return np.stack([start, np.where(last, edges[owner, 1], np.roll(start, -1))], axis=1)


def grown_boundary(boundary: Boundary, radius: float, tolerance: float, deadline: float) -> Any:
    """What a disc's center must avoid beside a boundary: a strip along each wall and a fan around each reflex corner.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    offset = radius * boundary.normal
    strips = np.concatenate([boundary.segments, boundary.segments[:, ::-1] + offset[:, None]], axis=1)
    edge_of = {tuple(edge): i for i, edge in enumerate(boundary.edges.tolist())}
    arriving = np.array([edge_of[ends] for ends in zip(boundary.sector_end, boundary.edges[:, 0], strict=True)])
    is_reflex = boundary.is_reflex(tolerance)
    # ``k`` chords of an arc are shorter than it by ``radius turn^3 / (24 k^2)``.
    turn, side = turn_between(offset, offset[arriving]), np.ptp(boundary.vertices, axis=0).max()
    most, enough = _MOST_CHORDS * turn / (np.pi / 2), np.sqrt(radius * turn**3 / (24 * _SHORTENING * side))
    num_chords = np.maximum(1, np.ceil(np.minimum(most, enough) - 1e-9)).astype(int)
    regions = []
    # Edges of one ring follow one another, so that most neighbors are united early.
    for begin in range(0, len(strips), _COLLARS):
        require_time(deadline, "the obstacles were grown")
        collars: Any = shapely.polygons(strips[begin : begin + _COLLARS])
        collars = collars.tolist()
        for edge in begin + np.flatnonzero(is_reflex[begin : begin + _COLLARS]):
            corner = boundary.vertices[boundary.edges[edge, 0]]
            rim = arc(corner, offset[edge], offset[arriving[edge]], num_chords[edge])
            collars.append(shapely.polygons(np.vstack([corner, rim])))
        regions.append(shapely.union_all(collars))
    return _united(regions, deadline)


def _united(regions: list[Any], deadline: float) -> Any:
    """The union of regions: of some at a time, until one is left."""
    while len(regions) > 1:
        united = []
        for begin in range(0, len(regions), _REGIONS):
            require_time(deadline, "the obstacles were grown")
            united.append(shapely.disjoint_subset_union_all(regions[begin : begin + _REGIONS]))
        regions = united
    require_time(deadline, "the obstacles were grown")
    return regions[0]
