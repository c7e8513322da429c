"""Checks and rounding of polygons, and the boundary of a polygonal region as a graph of vertices and edges."""

import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry import GeometryCollection, LinearRing, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry, BaseMultipartGeometry

from plr_jax._arrays import PickledWithoutCaches, as_numbers, batches, index_of, require_type, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import connected_groups
from plr_jax.geometry.vectors import arc, cross_product, left_normal, orientation, pseudo_angle, turn_between

_COLLARS = 256  # strips along walls that are united in one call
_REGIONS = 8  # unions of strips that are united in one call
# Polygons in place of arcs around the corners of inflated obstacles. Tangents make paths twice as much too long as
# chords make them too short.
_MOST_CHORDS = 8  # per quarter circle: a path along them is 0.16 % too short
_SHORTENING = 2e-5  # of the longer side: enough chords if a path around one corner is too short by less than this
_LARGEST_TURN = np.pi / 4  # from one tangent to the next, in radians, so that tangents end within 1.09 radii
LARGEST_COORDINATE = 1e100  # below it, products of two areas do not overflow; above its inverse, no underflow
_MEETING = 1e-12  # largest width, as a share of a ring's length, of a part where the ring crosses itself by rounding
_COARSEST = 0.1  # largest tolerance of a workspace, as a share of its shorter side
_PREPARED = threading.local()
Vertices: TypeAlias = Float[np.ndarray, "vertices 2"]
Edges: TypeAlias = Int[np.ndarray, "edges 2"]
Indices: TypeAlias = Int[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class Boundary(PickledWithoutCaches):
    """The boundary of a polygonal region: vertices, and edges with the region on their left.

    An edge is the pair of indices of the vertices where it starts and ends.
    """

    vertices: Vertices
    edges: Edges
    # *Sector* ``e`` is a range of directions into the region at the start of edge ``e``: from this edge
    # counterclockwise to the edge that arrives from vertex ``sector_end[e]``.
    sector_end: Int[np.ndarray, " edges"]

    @cached_property
    def segments(self) -> Float[np.ndarray, "edges 2 2"]:
        return self.vertices[self.edges]

    @cached_property
    def normal(self) -> Float[np.ndarray, "edges 2"]:
        return left_normal(self.segments[:, 1] - self.segments[:, 0])

    @cached_property
    def offset(self) -> Float[np.ndarray, " edges"]:
        return (self.normal * self.segments.sum(axis=1)).sum(axis=1) / 2

    @cached_property
    def tree(self) -> shapely.STRtree:
        return shapely.STRtree(np.asarray(shapely.linestrings(self.segments)))

    @cached_property
    def contacts(self) -> Int[np.ndarray, "contacts"]:
        """Indices of the vertices at which several edges start: points where the region touches itself."""
        return np.flatnonzero(np.bincount(self.edges[:, 0], minlength=len(self.vertices)) > 1)

    @cached_property
    def contact_tree(self) -> shapely.STRtree:
        return shapely.STRtree(np.asarray(shapely.points(self.vertices[self.contacts])))

    def touches_contact(self, shapes: Any, distance: float) -> Bool[np.ndarray, " n"]:
        """Return whether each Shapely shape comes within ``distance`` of a point where the region touches itself."""
        touches = np.zeros(len(shapes), dtype=bool)
        touches[self.contact_tree.query(shapes, predicate="dwithin", distance=distance)[0]] = True
        return touches

    def feet(self, x: Vertices, within: float | None = None) -> tuple[Indices, Indices, Float[np.ndarray, "m 2"]]:
        """Project points ``x`` onto their nearest edges; points farther than ``within`` from all edges are left out.

        If ``within`` is None, no point is left out.

        Returns:
            For each projected point, its index in ``x``, the index of its nearest edge, and the nearest point on the
            edge.
        """
        points: Any = shapely.points(x)
        point, edge = self.tree.query_nearest(points, max_distance=within, all_matches=False)
        lines: Any = self.tree.geometries[edge]
        along = shapely.line_locate_point(lines, points[point])
        return point, edge, shapely.get_coordinates(shapely.line_interpolate_point(lines, along))

    def is_reflex(self) -> Bool[np.ndarray, " edges"]:
        """Return whether the region's interior angle at the start of each edge is greater than pi."""
        # Counterclockwise through the region, the sector opens along the edge and closes along the one that arrives.
        corner = self.vertices[self.edges[:, 0]]
        opens = self.vertices[self.edges[:, 1]] - corner
        closes = self.vertices[self.sector_end] - corner
        return orientation(*opens.T, *closes.T) < 0


def ring_boundary(region: Any, tolerance: float, old: Boundary | None = None) -> Boundary | None:
    """Return the boundary of a Shapely (multi)polygon; edges are split at vertices that lie on them.

    A vertex lies on an edge if their distance is at most ``tolerance / 4``. The result is None if two edges coincide,
    or if a vertex is within ``tolerance`` of an edge but does not lie on it. To save time, ``old`` may be the
    boundary before a local change: vertices of ``old`` are not tested against edges of ``old``.
    """
    # 1. Number the distinct points of all rings, ordered by x, then y. Edges join consecutive ones of a ring.
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    numbers, index = np.unique(points @ [1, 1j], return_inverse=True)
    vertices = np.stack([numbers.real, numbers.imag], axis=1)
    is_joined = ring[1:] == ring[:-1]
    edges = np.stack([index[:-1][is_joined], index[1:][is_joined]], axis=1)
    # 2. Pairs of a vertex and an edge within the tolerance; at least one of the two is new.
    is_new_vertex, is_new_edge = np.ones(len(vertices), bool), np.ones(len(edges), bool)
    if old is not None:
        same_vertex, same_edge = match_boundary(vertices, edges, old)
        is_new_vertex[same_vertex[same_vertex >= 0]] = is_new_edge[same_edge[same_edge >= 0]] = False
    new_edges, old_edges = np.flatnonzero(is_new_edge), np.flatnonzero(~is_new_edge)
    of_new = vertices_near_edges(vertices, edges, tolerance, np.arange(len(vertices)), new_edges)
    of_old = vertices_near_edges(vertices, edges, tolerance, np.flatnonzero(is_new_vertex), old_edges)
    vertex, edge = np.concatenate([of_new, of_old], axis=1)
    # 3. Test whether each vertex lies beside the edge, by more than a quarter of the tolerance, or beyond its ends.
    start, end = vertices[edges[edge]].transpose(1, 0, 2)
    along, offset = end - start, vertices[vertex] - start
    is_beside = np.abs(cross_product(along, offset)) > tolerance / 4 * np.linalg.norm(along, axis=1)
    is_beyond = ((offset * along).sum(axis=1) <= 0) | (((offset - along) * along).sum(axis=1) >= 0)
    # 4. Cut edges at the vertices on them. The pieces of edge `owner` start at its start and at these vertices,
    #    sorted by distance. Each piece ends where the next one starts, the last one at the edge's end.
    owner, first = np.append(np.arange(len(edges)), edge), np.append(edges[:, 0], vertex)
    order = np.lexsort((np.append(np.zeros(len(edges)), np.linalg.norm(offset, axis=1)), owner))
    owner, first = owner[order], first[order]
    is_last = np.append(owner[1:] != owner[:-1], True)
    edges = np.stack([first, np.where(is_last, edges[owner, 1], np.roll(first, -1))], axis=1)
    pairs = np.sort(edges.min(axis=1) * np.int64(len(vertices)) + edges.max(axis=1))
    if (is_beside | is_beyond).any() or (pairs[1:] == pairs[:-1]).any():
        return None
    # 5. Leaving and arriving edges alternate around a vertex, so a sector ends at the successor of the leaving edge.
    #     s                  Each edge counts twice: row k at its start, and row len(edges) + k at its end, as seen
    #      \   sector        from there. Sort these rows by vertex, then counterclockwise. The rows of vertex v lie
    #       v ----- e --->   from begin to end - 1. Cyclically, the row after edge e belongs to the edge that arrives
    #                        from s, so sector_end[e] = s.
    at, neighbor = edges.T.ravel(), edges[:, ::-1].T.ravel()
    direction = vertices[neighbor] - vertices[at]
    order = np.lexsort((pseudo_angle(direction[:, 0], direction[:, 1]), at))
    begin, end = (np.searchsorted(at[order], at[order], side=side) for side in ("left", "right"))
    successor = order[begin + (np.arange(len(order)) - begin + 1) % (end - begin)]
    sector_end = np.empty(len(order), dtype=np.intp)
    sector_end[order] = neighbor[successor]
    return Boundary(vertices, edges, sector_end[: len(edges)])


def match_boundary(vertices: Vertices, edges: Edges, old: Boundary) -> tuple[Indices, Indices]:
    """Return the index in ``vertices`` of each vertex of ``old``, and the index in ``edges`` of each edge of ``old``.

    The index is -1 for vertices and edges that do not exist any more.
    """
    vertex = index_of(vertices @ [1, 1j], old.vertices @ [1, 1j])
    size = np.int64(len(vertices))
    start, end = vertex[old.edges].T
    keys = np.where((start < 0) | (end < 0), -1, start * size + end)
    return vertex, index_of(edges[:, 0] * size + edges[:, 1], keys)


def vertices_near_edges(
    vertices: Vertices, edges: Edges, tolerance: float, some_vertices: Indices, some_edges: Indices
) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
    """Return the pairs of a vertex and an edge within ``tolerance`` of each other, as two arrays of indices.

    Only the vertices with the indices ``some_vertices`` and the edges with the indices ``some_edges`` are tested. An
    edge and its own ends are no pairs.
    """
    # First drop vertices far from the box of all edges, then edges far from the box of the remaining vertices.
    segments = vertices[edges[some_edges]]
    some_vertices = some_vertices[boxes_near(vertices[some_vertices, None], segments, tolerance)]
    near = boxes_near(segments, vertices[some_vertices, None], tolerance)
    some_edges, segments = some_edges[near], segments[near]
    lines: Any = shapely.linestrings(segments)
    points = shapely.points(vertices[some_vertices])
    vertex, edge = shapely.STRtree(lines).query(points, predicate="dwithin", distance=tolerance)
    vertex, edge = some_vertices[vertex], some_edges[edge]
    apart = (edges[edge] != vertex[:, None]).all(axis=1)
    return vertex[apart], edge[apart]


def boxes_near(x: Float[np.ndarray, "n k 2"], y: Float[np.ndarray, "m l 2"], reach: float) -> Bool[np.ndarray, " n"]:
    """Return, for each ``i``, whether the bounding box of the points ``x[i]`` is near the bounding box of ``y``.

    Boxes are near if they are at most ``reach`` apart along each axis. There is one box of all points ``y``.
    """
    lo, hi = y.min(axis=(0, 1), initial=np.inf) - reach, y.max(axis=(0, 1), initial=-np.inf) + reach
    return ((x.min(axis=1) <= hi) & (x.max(axis=1) >= lo)).all(axis=1)


def grown_boundary(boundary: Boundary, radius: float, outside: bool) -> Any:
    """Return the part of a region that lies within ``radius`` of the region's boundary, as a Shapely geometry.

    The part has arcs around reflex corners, which are replaced by polylines: by chords of the arc or, if ``outside``,
    by tangents, so that the result contains the arc.
    """
    #    sector .- - - - - - -     The part consists of strips on the left of all edges, and of sectors of discs at
    #         /  |   strip         reflex corners: from the strip of the edge that starts at the corner c,
    #        - - c--------> edge   counterclockwise to the strip of the edge that arrives from s.
    #      strip |#########
    #            |# obstacle
    #            s
    # 1. Find the edge that arrives at the start of each edge, and the angle between their normals.
    offset = radius * boundary.normal
    edge_of = {tuple(edge): i for i, edge in enumerate(boundary.edges.tolist())}
    arriving = np.array([edge_of[ends] for ends in zip(boundary.sector_end, boundary.edges[:, 0], strict=True)])
    turn = turn_between(offset, offset[arriving])
    # 2. Choose the numbers of chords. An arc of angle t is longer than k chords by about radius * t^3 / (24 k^2).
    side = np.ptp(boundary.vertices, axis=0).max()
    most = _MOST_CHORDS * turn / (np.pi / 2)
    needed = np.sqrt(radius * turn**3 / (24 * _SHORTENING * side))
    least = np.maximum(1, outside * turn / _LARGEST_TURN)
    num_chords = np.ceil(np.maximum(least, np.minimum(most, needed)) - 1e-9).astype(int)
    # 3. Unite strips and sectors, some at a time. Edges of a ring are consecutive: most neighbors are united early.
    strips = np.concatenate([boundary.segments, boundary.segments[:, ::-1] + offset[:, None]], axis=1)
    is_reflex = boundary.is_reflex()
    regions = []
    for begin in range(0, len(strips), _COLLARS):
        collars = np.asarray(shapely.polygons(strips[begin : begin + _COLLARS])).tolist()
        for edge in begin + np.flatnonzero(is_reflex[begin : begin + _COLLARS]):
            corner = boundary.vertices[boundary.edges[edge, 0]]
            rim = arc(corner, offset[edge], offset[arriving[edge]], num_chords[edge], outside)
            collars.append(shapely.polygons(np.vstack([corner, rim])))
        regions.append(shapely.union_all(collars))
    while len(regions) > 1:
        regions = [shapely.disjoint_subset_union_all(some) for some in batches(regions, _REGIONS)]
    return regions[0]


def as_polygons(name: str, shapes: Any) -> tuple[Polygon | MultiPolygon, ...]:
    require_type(f"{name}s", shapes, BaseGeometry | Iterable, "a list of rings (n, 2) or Shapely polygons")
    return tuple(as_polygon(f"{name} {i}", shape) for i, shape in enumerate(flatten_collections(shapes)))


def flatten_collections(shapes: Any, kind: type = GeometryCollection) -> Iterator[Any]:
    """Yield the geometries in ``shapes``; parts replace each geometry of the class ``kind``, a collection."""
    items: Any = [shapes] if isinstance(shapes, BaseGeometry) else shapes
    for shape in items:
        yield from flatten_collections(shape.geoms, kind) if isinstance(shape, kind) else (shape,)


def as_polygon(name: str, ring: Any) -> Polygon | MultiPolygon:
    """Check a ring of vertices ``(n, 2)`` or a Shapely polygon, and return a Shapely polygon.

    Errors call the value ``name``.
    """
    ring = Polygon(ring) if isinstance(ring, LinearRing) else ring
    is_polygon = isinstance(ring, Polygon | MultiPolygon)
    if isinstance(ring, BaseGeometry) and not is_polygon:
        raise ValueError(f"{name} must be a polygon, got a {ring.geom_type}; widen lines and points with buffer().")
    if is_polygon and ring.is_empty:
        return ring
    points = shapely.get_coordinates(ring) if is_polygon else as_numbers(name, ring, "numbers of shape (n, 2)")
    if points.ndim != 2 or points.shape[1] != 2:
        hint = " Put a single ring into a list." if points.shape == (2,) else ""
        raise ValueError(f"{name} must have shape (n, 2), got {points.shape}.{hint}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} must have finite coordinates; remove infinite ones and NaN.")
    if np.abs(points).max(initial=0.0) > LARGEST_COORDINATE:
        raise ValueError(f"{name} must have coordinates up to {LARGEST_COORDINATE:g}; choose a larger unit.")
    if (num := len(np.unique(points, axis=0))) < 3:
        raise ValueError(f"{name} has {num} distinct vertices; a polygon needs at least three.")
    if shapely.area(shapely.convex_hull(shapely.multipoints(points))) <= 1e-12 * np.ptp(points, axis=0).max() ** 2:
        raise ValueError(f"{name} has zero area: all its vertices lie on one line.")
    polygon = ring if is_polygon else Polygon(points)
    polygon = polygon if polygon.is_valid else _repaired(name, polygon)
    if polygon.is_empty:
        raise ValueError(f"{name} has no area outside of its holes: leave it out, or leave out the holes.")
    return polygon


def _repaired(name: str, shape: Polygon | MultiPolygon) -> Polygon | MultiPolygon:
    """Make an invalid Shapely polygon valid: return the union of its polygons, each without its holes.

    ``ValueError`` is raised if a ring crosses itself; the message calls the polygon ``name``.
    """
    parts = []
    for part in shapely.get_parts(shape):
        outer, *holes = (_inside_of_ring(name, ring) for ring in shapely.get_rings(part))
        parts.append(shapely.difference(outer, shapely.union_all(holes)))
    polygons = polygons_of(shapely.union_all(parts))
    return polygons[0] if len(polygons) == 1 else MultiPolygon(polygons)


def _inside_of_ring(name: str, ring: LinearRing) -> Any:
    # By Green's theorem, an area counts as often as the ring winds around it. The even-odd rule counts it once or
    # never. So both areas differ if the ring crosses itself, but not if it only touches itself.
    polygon = Polygon(ring)
    inside = polygon if polygon.is_valid else MultiPolygon(polygons_of(shapely.make_valid(polygon)))
    if abs(inside.area - polygon.area) > _MEETING * ring.length**2:
        got = f"{name} is not a simple polygon ({shapely.is_valid_reason(polygon)})"
        repair = "repair it with shapely.make_valid, which keeps what an odd number of turns surround"
        raise ValueError(f"{got}: split it into rings that do not cross, or {repair}.")
    return inside


def components_region(components: Any, bounds: Box | ArrayLike | None) -> tuple[Box, MultiPolygon]:
    """Return the bounds, and the free space: the union of all components without their holes, within the bounds.

    A component is a Shapely polygon, or a mapping with a ring "outer" and a list of rings "holes". If ``bounds`` is
    None, the bounds are the bounding box of the components.
    """
    # 1. Check each component, and subtract its holes.
    polygons = []
    for i, part in enumerate(flatten_collections(components, BaseMultipartGeometry)):
        if isinstance(part, BaseGeometry):
            polygons.append(as_polygon(f"Component {i}", part))
            continue
        rings = part.get("holes", ()) if isinstance(part, Mapping) and "outer" in part else None
        if not isinstance(rings, list | tuple | np.ndarray):
            expected = "a mapping with an 'outer' ring and a list of 'holes', or a Shapely polygon"
            raise ValueError(f"Component {i} must be {expected}, got {shortened(part)}.")
        blocked = [as_polygon(f"Hole {j} of component {i}", ring) for j, ring in enumerate(rings)]
        polygons.append(shapely.difference(as_polygon(f"Outer ring {i}", part["outer"]), shapely.union_all(blocked)))
    if not polygons:
        raise ValueError("Free space needs at least one component, got none.")
    # 2. Unite the components in the bounds.
    bounds = as_bounds(shapely.total_bounds(polygons).reshape(2, 2) if bounds is None else bounds)
    box, *polygons = merge_vertices([shapely.box(*bounds.lo, *bounds.hi), *polygons], 8 * grid_of(bounds))
    return bounds, MultiPolygon(polygons_of(shapely.intersection(box, shapely.union_all(polygons))))


def rounding_of(bounds: Box) -> float:
    return rounding_at(bounds.width.max(), np.abs([bounds.lo, bounds.hi]).max())


def rounding_at(width: float, reach: float) -> float:
    """Return the rounding error of coordinates up to ``reach`` in a workspace whose longer side is ``width``."""
    return float(max(1e-12 * width, 1e-15 * reach))


def grid_of(bounds: Box) -> float:
    return grid_at(1e3 * rounding_of(bounds))


def grid_at(tolerance: float) -> float:
    """Return the spacing of the grid to which vertices are rounded: a power of two, about ``tolerance / 1000``."""
    return float(2.0 ** np.ceil(np.log2(tolerance / 1e3)))


def advice_on_cells(value: object) -> str:
    """Return advice for an error message if ``value`` is an array of pixels or voxels, else an empty text."""
    other_library = "GridField for distances that another library computed"
    for_volumes = f"VoxelSpace(free) with solve_eikonal, VoxelGraph(free, goal), or {other_library}"
    advice = {2: " For pixels, use Workspace.from_mask(free).", 3: f" For volumes, use {for_volumes}."}
    return advice.get(value.ndim, "") if isinstance(value, np.ndarray) else ""


def as_bounds(value: Box | ArrayLike) -> Box:
    """Check that a value can be the bounds of a workspace, and return it as a Box.

    Bounds must be a 2-D box without periodic axes, and not too large, small, slender or far from the origin for
    64-bit coordinates.
    """
    if isinstance(value, np.ndarray) and (value.ndim == 3 or value.dtype == bool):
        raise ValueError(f"Bounds must be a Box, got an array of shape {value.shape}.{advice_on_cells(value)}")
    bounds = Box.of(value, "Bounds")
    if bounds.dim != 2:
        raise ValueError(f"A workspace must have 2 dimensions, got bounds of {bounds.dim}.")
    if bounds.is_periodic:
        raise ValueError(f"A workspace must not have periodic axes, got {bounds}.")
    if np.abs([bounds.lo, bounds.hi]).max() > LARGEST_COORDINATE:
        expected = f"coordinates up to {LARGEST_COORDINATE:g}"
        raise ValueError(f"A workspace must have {expected}, got {bounds}: choose a larger unit.")
    if bounds.width.max() < 1 / LARGEST_COORDINATE:
        expected = f"at least {1 / LARGEST_COORDINATE:g}"
        raise ValueError(f"A workspace's longer side must be {expected}, got {bounds}: choose a smaller unit.")
    if (tolerance := 1e3 * rounding_of(bounds)) > _COARSEST * bounds.width.min():
        expected = f"at least {1 / _COARSEST:g} times its tolerance, {tolerance:g}"
        advice = "choose less slender bounds, or move the origin nearer to them"
        raise ValueError(f"A workspace's shorter side must be {expected}, got {bounds}: {advice}.")
    return bounds


def polygons_of(geometry: Any) -> tuple[Polygon, ...]:
    parts: Any = shapely.get_parts(geometry)
    return tuple(part for part in parts if isinstance(part, Polygon) and part.area > 0)


def triangulate(region: Any) -> Float[np.ndarray, "triangles 3 2"]:
    """Return triangles that fill a Shapely (multi)polygon, in any order and orientation."""
    try:
        triangles = shapely.constrained_delaunay_triangles(region)
    except shapely.errors.GEOSException:  # GEOS fails on some polygons whose rings touch: halve the region
        if len(parts := polygons_of(region)) == 1:
            lo, hi = np.array(region.bounds).reshape(2, 2)
            upper, lower, axis = hi.copy(), lo.copy(), np.argmax(hi - lo)
            upper[axis] = lower[axis] = (lo[axis] + hi[axis]) / 2
            halves = shapely.intersection(region, [shapely.box(*lo, *upper), shapely.box(*lower, *hi)])
            parts = [polygon for half in halves for polygon in polygons_of(half)]
        return np.concatenate([triangulate(polygon) for polygon in parts])
    return shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]


def merge_vertices(geometries: Sequence[Any], tolerance: float) -> list[Any]:
    """Return copies of Shapely geometries in which vertices within ``tolerance`` of one another are made equal."""
    # Group the distinct vertices that chains of such pairs join. The first of a group, by x, then y, replaces all.
    numbers, index = np.unique(shapely.get_coordinates(geometries) @ [1, 1j], return_inverse=True)
    points = np.stack([numbers.real, numbers.imag], axis=1)
    places: Any = shapely.points(points)
    pairs = shapely.STRtree(places).query(places, predicate="dwithin", distance=tolerance)
    _, first, group = np.unique(connected_groups(len(points), pairs), return_index=True, return_inverse=True)
    return list(shapely.set_coordinates(np.array(geometries, dtype=object), points[first[group]][index]))


def prepared_geometry(owner: Any, name: Hashable, make: Callable[[], Any]) -> Any:
    """Return the Shapely geometry ``make()``, prepared for queries.

    The result is cached by owner, name and thread, so that ``make`` is called once for each.
    """
    # GEOS may crash if threads share a prepared geometry.
    of_owner = _PREPARED.__dict__.setdefault("of_owners", WeakKeyDictionary()).setdefault(owner, {})  # in this thread
    if name not in of_owner:
        of_owner[name] = make()
        shapely.prepare(of_owner[name])
    return of_owner[name]


class Region(NamedTuple):
    """A region of free space, and its boundary as a graph."""

    polygon: Polygon | MultiPolygon
    boundary: Boundary
    is_in_place: bool  # whether walls moved by rounding only; else thin walls or gaps were closed


def region_of(free: Any, bounds: Box, rounded: Callable[[Any, float], Any] = shapely.set_precision) -> Region:
    """Return free space, a Shapely geometry, as a region with vertices on a grid.

    ``rounded(free, grid)`` rounds the vertices to multiples of ``grid``. ``ValueError`` is raised if nothing is free,
    or walls or gaps are too thin.
    """
    # 1. Round after the overlay, not within it: only then do walls that meet up to rounding share a vertex.
    grid = grid_of(bounds)
    with np.errstate(divide="ignore", invalid="ignore"):  # GEOS divides by coordinates near 0, such as 1e-163
        region = _simplify(rounded(free, grid), 4 * grid)
    # 2. If walls or gaps are thinner than edges can be split reliably, snap to coarser and coarser grids (four).
    coarser = 32 * grid
    while (boundary := ring_boundary(region, 8 * grid)) is None:
        if coarser > 256 * grid:
            advice = f"make them thicker than {coarser:.1e} or leave them out"
            far = "If the workspace is far from the origin, translate it there first."
            raise ValueError(f"Obstacles leave walls or gaps that are too thin: {advice}. {far}")
        # Morphological opening removes spikes of free space, which snapping could widen to a passage.
        for radius in (-coarser / 2, coarser / 2):
            region = shapely.buffer(region, radius, join_style="mitre", mitre_limit=1e3)
        region = _simplify(shapely.set_precision(region, coarser), 0.0)
        coarser *= 2
    return Region(region, boundary, coarser == 32 * grid)


def region_after_change(free: Any, bounds: Box, old: Boundary) -> Region:
    """Return free space as a region, like :func:`region_of`, but in less time after a local change.

    ``old`` is the boundary before the change. Parts of the boundary that did not change are not tested for walls and
    gaps that are too thin.
    """
    grid = grid_of(bounds)
    rounded = shapely.transform(free, lambda points: np.rint(points / grid) * grid)
    if not shapely.is_valid(rounded):  # rounding may leave a sliver without area
        return region_of(free, bounds)
    region = _simplify(rounded, 4 * grid)
    boundary = ring_boundary(region, 8 * grid, old)
    return region_of(free, bounds) if boundary is None else Region(region, boundary, True)


def _simplify(geometry: Any, tolerance: float) -> Polygon | MultiPolygon:
    parts = polygons_of(geometry)
    if not parts:
        raise ValueError("The workspace has no free space: the obstacles cover its bounds.")
    # A normalized ring starts at an extreme vertex, so its start is not collinear and may stay.
    return shapely.simplify(shapely.normalize(parts[0] if len(parts) == 1 else MultiPolygon(parts)), tolerance)
