"""The boundary of a polygonal region as a graph: its edges, and the free sectors at its vertices."""

import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from shapely.geometry import GeometryCollection, LinearRing, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from plr_jax._arrays import as_numbers, index_of, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import arc, cross_product, left_normal, orientation, pseudo_angle, turn_between

_COLLARS, _REGIONS = 256, 8  # of walls and of regions, united at a time
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

    @cached_property
    def tree(self) -> shapely.STRtree:
        """The edges, in their order, as Shapely lines in a tree."""
        segments: Any = shapely.linestrings(self.segments)
        return shapely.STRtree(segments)

    @cached_property
    def contacts(self) -> Int[np.ndarray, "contacts"]:
        """Vertices in which the region touches itself: those of more than one sector."""
        return np.flatnonzero(np.bincount(self.edges[:, 0], minlength=len(self.vertices)) > 1)

    def is_reflex(self) -> Bool[np.ndarray, "edges"]:
        """Whether each sector is wider than half a turn."""
        corner = self.vertices[self.edges[:, 0]]
        to_start = self.vertices[self.edges[:, 1]] - corner
        to_end = self.vertices[self.sector_end] - corner
        return orientation(*to_start.T, *to_end.T) < 0


def ring_boundary(region: Any, tolerance: float, known: Boundary | None = None) -> Boundary | None:
    """Return the boundary of a valid Shapely (Multi)Polygon, edges split where a vertex lies on one.

    Args:
        region: The region.
        tolerance: How near a vertex is to an edge that it splits.
        known: A boundary, of which edges and vertices are near no others of it, to save looking at them again.

    Returns:
        The boundary. None if a vertex is about a tolerance from an edge, or as near to another vertex: edges that are
        split there may cross or cover one another.
    """
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    numbers, index = np.unique(points @ [1, 1j], return_inverse=True)  # ordered by x, then y
    vertices, inner = np.stack([numbers.real, numbers.imag], axis=1), ring[1:] == ring[:-1]
    edges = np.stack([index[:-1][inner], index[1:][inner]], axis=1)
    # 1. Vertices as near as the tolerance to edges of which they are no ends.
    is_new_vertex, is_new_edge = np.ones(len(vertices), bool), np.ones(len(edges), bool)
    if known is not None:
        for is_new, of_known in zip(
            (is_new_vertex, is_new_edge), match_boundary(vertices, edges, known), strict=True
        ):
            is_new[of_known[of_known >= 0]] = False
    new_edges, old_edges = np.flatnonzero(is_new_edge), np.flatnonzero(~is_new_edge)
    of_new = _vertices_near_edges(vertices, edges, tolerance, np.arange(len(vertices)), new_edges)
    of_old = _vertices_near_edges(vertices, edges, tolerance, np.flatnonzero(is_new_vertex), old_edges)
    vertex, edge = np.concatenate([of_new, of_old], axis=1)
    # 2. Edges are cut at vertices on them, to a quarter of the tolerance. Others may not be even near.
    start, end = vertices[edges[edge]].transpose(1, 0, 2)
    along, way = end - start, vertices[vertex] - start
    is_beside = np.abs(cross_product(along, way)) > tolerance / 4 * np.linalg.norm(along, axis=1)
    is_beyond = ((way * along).sum(axis=1) <= 0) | (((way - along) * along).sum(axis=1) >= 0)
    owner, first = np.append(np.arange(len(edges)), edge), np.append(edges[:, 0], vertex)
    order = np.lexsort((np.append(np.zeros(len(edges)), np.linalg.norm(way, axis=1)), owner))
    owner, first = owner[order], first[order]
    is_last = np.append(owner[1:] != owner[:-1], True)
    edges = np.stack([first, np.where(is_last, edges[owner, 1], np.roll(first, -1))], axis=1)
    pieces = np.sort(edges.min(axis=1) * np.int64(len(vertices)) + edges.max(axis=1))
    if (is_beside | is_beyond).any() or (pieces[1:] == pieces[:-1]).any():
        return None
    # 3. A sector closes at the start of the arriving edge that comes first counterclockwise. Around a vertex leaving
    #    and arriving edges alternate, so a leaving one is closed by its successor.
    at, other = edges.T.ravel(), edges[:, ::-1].T.ravel()
    direction = vertices[other] - vertices[at]
    order = np.lexsort((pseudo_angle(direction[:, 0], direction[:, 1]), at))
    begin, end = (np.searchsorted(at[order], at[order], side=side) for side in ("left", "right"))
    successor = order[begin + (np.arange(len(order)) - begin + 1) % (end - begin)]
    ends = np.empty(len(order), dtype=np.intp)
    ends[order] = other[successor]
    return Boundary(vertices, edges, ends[: len(edges)])


def match_boundary(
    vertices: Float[np.ndarray, "vertices 2"], edges: Int[np.ndarray, "edges 2"], old: Boundary
) -> tuple[Int[np.ndarray, "old_vertices"], Int[np.ndarray, "old_edges"]]:
    """Which vertices and edges those of a boundary are, to the bit; -1 for none."""
    vertex = index_of(vertices @ [1, 1j], old.vertices @ [1, 1j])
    size = np.int64(len(vertices))
    start, end = vertex[old.edges].T
    wanted = np.where((start < 0) | (end < 0), -1, start * size + end)
    return vertex, index_of(edges[:, 0] * size + edges[:, 1], wanted)


def _vertices_near_edges(
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
        some_vertices = some_vertices[
            _boxes_meet(vertices[some_vertices, None], vertices[edges[some_edges]], tolerance)
        ]
        if not len(some_vertices):
            return none, none
        some_edges = some_edges[_boxes_meet(vertices[edges[some_edges]], vertices[some_vertices, None], tolerance)]
    lines: Any = shapely.linestrings(vertices[edges[some_edges]])
    points = shapely.points(vertices[some_vertices])
    vertex, edge = shapely.STRtree(lines).query(points, predicate="dwithin", distance=tolerance)
    vertex, edge = some_vertices[vertex], some_edges[edge]
    apart = (edges[edge] != vertex[:, None]).all(axis=1)
    return vertex[apart], edge[apart]


def _boxes_meet(
    boxes: Float[np.ndarray, "n k 2"], others: Float[np.ndarray, "m l 2"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Whether boxes around points meet the one around all others."""
    lo, hi = others.min(axis=(0, 1)) - tolerance, others.max(axis=(0, 1)) + tolerance
    return ((boxes.min(axis=1) <= hi) & (boxes.max(axis=1) >= lo)).all(axis=1)


def grown_boundary(boundary: Boundary, radius: float, tolerance: float) -> Any:
    """What a disc's center must avoid beside a boundary: a strip along each wall and a fan around each corner."""
    offset = radius * boundary.normal
    strips = np.concatenate([boundary.segments, boundary.segments[:, ::-1] + offset[:, None]], axis=1)
    edge_of = {tuple(edge): i for i, edge in enumerate(boundary.edges.tolist())}
    arriving = np.array([edge_of[ends] for ends in zip(boundary.sector_end, boundary.edges[:, 0], strict=True)])
    is_reflex = boundary.is_reflex()
    # ``k`` chords of an arc are shorter than it by ``radius turn^3 / (24 k^2)``.
    turn, side = turn_between(offset, offset[arriving]), np.ptp(boundary.vertices, axis=0).max()
    most, enough = _MOST_CHORDS * turn / (np.pi / 2), np.sqrt(radius * turn**3 / (24 * _SHORTENING * side))
    num_chords = np.maximum(1, np.ceil(np.minimum(most, enough) - 1e-9)).astype(int)
    regions = []
    # Edges of one ring follow one another, so that most neighbors are united early.
    for begin in range(0, len(strips), _COLLARS):
        collars: Any = shapely.polygons(strips[begin : begin + _COLLARS])
        collars = collars.tolist()
        for edge in begin + np.flatnonzero(is_reflex[begin : begin + _COLLARS]):
            corner = boundary.vertices[boundary.edges[edge, 0]]
            rim = arc(corner, offset[edge], offset[arriving[edge]], num_chords[edge])
            collars.append(shapely.polygons(np.vstack([corner, rim])))
        regions.append(shapely.union_all(collars))
    while len(regions) > 1:
        starts = range(0, len(regions), _REGIONS)
        regions = [shapely.disjoint_subset_union_all(regions[begin : begin + _REGIONS]) for begin in starts]
    return regions[0]


# Polygons from outside, checked, and what Shapely leaves to do with them.


LARGEST_COORDINATE = 1e100
"""Areas, and products of two of them, are finite below; and of sides above its inverse they are not 0."""
_COARSEST = 0.1  # tolerance of a workspace, as a share of its shorter side


def as_polygons(name: str, shapes: Any) -> tuple[Polygon | MultiPolygon, ...]:
    """Valid polygons in the order given: those of a collection one by one, a multipolygon as one.

    Args:
        name: What one of them is called in an error, before its number.
        shapes: A Shapely polygon, linear ring, multipolygon or collection of those; or an iterable of these and of
            rings ``(n, 2)``, closed or not.

    Raises:
        ValueError: If ``shapes`` is something else, or one is not a valid polygon, saying what is wrong with it.
    """
    shapes = [shapes] if isinstance(shapes, BaseGeometry) else shapes
    if not isinstance(shapes, Iterable):
        raise ValueError(f"{name}s must be rings (n, 2) or Shapely polygons in a list, got {shortened(shapes)}.")
    return tuple(as_polygon(f"{name} {i}", shape) for i, shape in enumerate(_flatten_collections(shapes)))


def _flatten_collections(shapes: Iterable[Any]) -> Iterator[Any]:
    for shape in shapes:
        yield from _flatten_collections(shape.geoms) if isinstance(shape, GeometryCollection) else (shape,)


def as_polygon(name: str, ring: Any) -> Polygon | MultiPolygon:
    """A valid polygon of finite coordinates and positive area.

    Args:
        name: What it is called in an error.
        ring: Its ring, ``(n, 2)``, closed or not; or a Shapely polygon or linear ring.

    Raises:
        ValueError: If it is none, saying what is wrong with it.
    """
    if isinstance(ring, LinearRing):
        ring = Polygon(ring)
    if isinstance(ring, Polygon | MultiPolygon):
        if ring.is_empty:  # which blocks nothing
            return ring
        polygon, points = ring, shapely.get_coordinates(ring)
    elif isinstance(ring, BaseGeometry):
        raise ValueError(
            f"{name} must be a polygon, got a {ring.geom_type}; give lines and points a width with buffer()."
        )
    else:
        points, polygon = as_numbers(name, ring, "numbers of shape (n, 2)"), None
    if points.ndim != 2 or points.shape[1] != 2:
        hint = " One ring alone goes into a list." if points.shape == (2,) else ""
        raise ValueError(f"{name} must have shape (n, 2), got {points.shape}.{hint}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} has coordinates that are not finite; remove them.")
    if np.abs(points).max(initial=0.0) > LARGEST_COORDINATE:
        raise ValueError(f"{name} has coordinates beyond {LARGEST_COORDINATE:g}; choose a larger unit.")
    distinct = np.unique(points, axis=0)
    if len(distinct) < 3:
        raise ValueError(f"{name} has {len(distinct)} distinct vertices; a polygon needs at least three.")
    scale = np.ptp(points, axis=0).max()
    if shapely.area(shapely.convex_hull(shapely.multipoints(distinct))) <= 1e-12 * scale**2:
        raise ValueError(f"{name} has zero area: its vertices lie on one line.")
    polygon = Polygon(points) if polygon is None else polygon
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        raise ValueError(f"{name} is not a simple polygon ({reason}); split it into rings that do not cross.")
    return polygon


def components_region(components: Sequence[Any], bounds: Box | ArrayLike | None) -> tuple[Box, MultiPolygon]:
    """Bounds, and what components ``{"outer": ring, "holes": [ring, ...]}`` cover of them, up to rounding.

    A Shapely polygon is a component, too, its own holes being a part of what is called its outer ring here.

    Raises:
        ValueError: If there is no component, one has another form or an invalid ring, or the bounds are none.
    """
    outers, holes = [], []
    for i, part in enumerate(components):
        if isinstance(part, BaseGeometry):
            outers.append(as_polygon(f"Component {i}", part))
            holes.append([])
            continue
        rings = part.get("holes", ()) if isinstance(part, Mapping) and "outer" in part else None
        if not isinstance(rings, list | tuple | np.ndarray):
            raise ValueError(
                f"Component {i} must be a mapping with an 'outer' ring and a list of 'holes', or a Shapely polygon, "
                f"got {shortened(part)}."
            )
        outers.append(as_polygon(f"Outer ring {i}", part["outer"]))
        holes.append([as_polygon(f"Hole {j} of component {i}", ring) for j, ring in enumerate(rings)])
    if not outers:
        raise ValueError("Free space needs at least one component, got none.")
    bounds = as_bounds(shapely.total_bounds(outers).reshape(2, 2) if bounds is None else bounds)
    rings = [shapely.box(*bounds.lo, *bounds.hi), *outers, *(hole for of_one in holes for hole in of_one)]
    merged = iter(merge_vertices(rings, 8 * grid_of(bounds)))
    box, outers = next(merged), [next(merged) for _ in outers]
    blocked = [shapely.union_all([next(merged) for _ in of_one]) for of_one in holes]
    united = shapely.union_all(shapely.difference(outers, blocked))
    return bounds, MultiPolygon(polygons_of(shapely.intersection(box, united)))


def rounding_of(bounds: Box) -> float:
    """Error to expect of coordinates within bounds."""
    return rounding_at(bounds.width.max(), np.abs([bounds.lo, bounds.hi]).max())


def rounding_at(width: float, reach: float) -> float:
    """Error to expect of coordinates up to ``reach``: 1e-12 of the larger side, or more far from the origin."""
    return float(max(1e-12 * width, 1e-15 * reach))


def grid_of(bounds: Box) -> float:
    """A power of two near the rounding error, so that integers and dyadic fractions are not rounded."""
    return grid_at(1e3 * rounding_of(bounds))


def grid_at(tolerance: float) -> float:
    """The grid of a workspace's vertices, a thousand times finer than its tolerance."""
    return float(2.0 ** np.ceil(np.log2(tolerance / 1e3)))


def advice_on_cells(value: object) -> str:
    """What to do with an array of pixels or voxels, which is no map itself; nothing if it is none."""
    if not isinstance(value, np.ndarray) or value.ndim not in (2, 3):
        return ""
    if value.ndim == 2:
        return " Of pixels a map is Workspace.from_mask(free)."
    return (
        " What serves volumes: VoxelSpace(free), for solve_eikonal, VoxelGraph(free, goal), and GridField, for "
        "distances of voxels that another library found."
    )


def as_bounds(value: Box | ArrayLike) -> Box:
    """The bounds of a workspace, a Box of the plane or its corners; ``ValueError`` if they are something else."""
    if isinstance(value, np.ndarray) and (value.ndim == 3 or value.dtype == bool):
        raise ValueError(f"Bounds must be a Box, got an array of shape {value.shape}.{advice_on_cells(value)}")
    bounds = Box.of(value, "Bounds")
    if bounds.dim != 2:
        raise ValueError(f"A workspace has two dimensions, got bounds of {bounds.dim}.")
    if bounds.is_periodic:
        raise ValueError(f"A workspace is a part of the plane, without periodic axes, got {bounds}.")
    if max(np.abs(bounds.lo).max(), np.abs(bounds.hi).max()) > LARGEST_COORDINATE:
        raise ValueError(
            f"A workspace's coordinates go to {LARGEST_COORDINATE:g}, got {bounds}: choose a larger unit."
        )
    if bounds.width.max() < 1 / LARGEST_COORDINATE:
        raise ValueError(
            f"A workspace's longer side is at least {1 / LARGEST_COORDINATE:g}, got {bounds}: choose a smaller unit."
        )
    if (tolerance := 1e3 * rounding_of(bounds)) > _COARSEST * bounds.width.min():
        raise ValueError(
            f"A workspace's shorter side is at least {1 / _COARSEST:g} times what coordinates there resolve, "
            f"{tolerance:g}, got {bounds}: choose bounds that are less slender, or an origin that is near."
        )
    return bounds


def polygons_of(geometry: Any) -> tuple[Polygon, ...]:
    """The polygons of a geometry, without the points and lines of a degenerate overlay."""
    parts: Any = shapely.get_parts(geometry)
    return tuple(part for part in parts if isinstance(part, Polygon) and part.area > 0)


def triangulate(region: Any) -> Float[np.ndarray, "triangles 3 2"]:
    """Triangles that fill a region of polygons and do not overlap.

    GEOS fails at some polygons whose rings touch one another: such a region is cut in two until it does not.
    """
    try:
        triangles: Any = shapely.get_parts(shapely.constrained_delaunay_triangles(region))
    except shapely.errors.GEOSException:
        if len(parts := polygons_of(region)) == 1:
            lo, hi = np.array(region.bounds).reshape(2, 2)
            upper, lower, axis = hi.copy(), lo.copy(), np.argmax(hi - lo)
            upper[axis] = lower[axis] = (lo[axis] + hi[axis]) / 2
            halves = shapely.intersection(region, [shapely.box(*lo, *upper), shapely.box(*lower, *hi)])
            parts = [polygon for half in halves for polygon in polygons_of(half)]
        return np.concatenate([triangulate(polygon) for polygon in parts])
    return shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]


def merge_vertices(geometries: Sequence[Any], tolerance: float) -> list[Any]:
    """Geometries in which vertices as near to one another as the tolerance are the same, none of them dropped."""
    numbers, index = np.unique(shapely.get_coordinates(geometries) @ [1, 1j], return_inverse=True)
    points = np.stack([numbers.real, numbers.imag], axis=1)
    i, j = KDTree(points).query_pairs(tolerance, output_type="ndarray").T
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(points), len(points)))
    _, first, group = np.unique(connected_components(graph)[1], return_index=True, return_inverse=True)
    return list(shapely.set_coordinates(np.array(geometries, dtype=object), points[first[group]][index]))


class _Prepared(threading.local):
    def __init__(self):
        self.of_owner: WeakKeyDictionary[Any, dict[Hashable, Any]] = WeakKeyDictionary()


_PREPARED = _Prepared()


def prepared_geometry(owner: Any, name: Hashable, make: Callable[[], Any]) -> Any:
    """An owner's geometry, prepared for many queries of this thread alone: GEOS may crash where two query one."""
    of_owner = _PREPARED.of_owner.setdefault(owner, {})
    if name not in of_owner:
        of_owner[name] = make()
        shapely.prepare(of_owner[name])
    return of_owner[name]


class Region(NamedTuple):
    """Free space as a workspace keeps it, its boundary, and whether vertices are moved by no more than rounding."""

    polygon: Polygon | MultiPolygon
    boundary: Boundary
    is_in_place: bool


def region_of(free: Any, bounds: Box, rounded: Callable[[Any, float], Any] = shapely.set_precision) -> Region:
    """Free space as a workspace keeps it: rounded, normalized, without collinear vertices.

    Vertices lie apart, and on edges or beside them, by 8 grids: walls and gaps thinner than that vanish. ``rounded``
    moves vertices to multiples of a number. ``ValueError`` if there is no free space.
    """
    # Rounding last, not within the overlay: only so do walls that meet up to rounding meet in one vertex.
    grid = grid_of(bounds)
    region = _simplify(rounded(free, grid), 4 * grid)
    # Snapped coarser and coarser where that is not enough, until nothing is thinner than edges may be cut beside.
    coarser = 32 * grid
    while (boundary := ring_boundary(region, 8 * grid)) is None:
        if coarser > 256 * grid:
            raise ValueError(
                f"Obstacles leave walls or gaps too thin to be told apart: make them thicker than "
                f"{coarser:.1e} or leave them out; far from the origin, translate the workspace there first."
            )
        region = _simplify(shapely.set_precision(region, coarser), 0.0)
        coarser *= 2
    return Region(region, boundary, coarser == 32 * grid)


def region_after_change(free: Any, bounds: Box, old: Boundary) -> Region:
    """The same of free space that had some boundary, and changed here and there: vertices are rounded one by one."""
    grid = grid_of(bounds)
    rounded = shapely.transform(free, lambda points: np.rint(points / grid) * grid)
    if not shapely.is_valid(rounded):  # as slivers become, which rounding leaves no area
        return region_of(free, bounds)
    region = _simplify(rounded, 4 * grid)
    boundary = ring_boundary(region, 8 * grid, old)
    return region_of(free, bounds) if boundary is None else Region(region, boundary, True)


def _simplify(geometry: Any, tolerance: float) -> Polygon | MultiPolygon:
    parts = polygons_of(geometry)
    if not parts:
        raise ValueError("The workspace has no free space: the obstacles cover its bounds.")
    # A normalized ring starts at an extreme vertex, so simplifying also reaches collinear ones at its seam.
    region = shapely.normalize(parts[0] if len(parts) == 1 else MultiPolygon(parts))
    return shapely.simplify(region, tolerance)
