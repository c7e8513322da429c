"""Polygons from outside, checked, and what Shapely leaves to do with them."""

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import compress
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from shapely.geometry import GeometryCollection, LinearRing, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from plr_jax._arrays import as_numbers, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import Boundary, RingEdges
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import cross_product

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
    return tuple(as_polygon(f"{name} {i}", shape) for i, shape in enumerate(_one_by_one(shapes)))


def _one_by_one(shapes: Iterable[Any]) -> Iterator[Any]:
    for shape in shapes:
        yield from _one_by_one(shape.geoms) if isinstance(shape, GeometryCollection) else (shape,)


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


def as_components(
    components: Sequence[Any],
) -> tuple[list[Polygon | MultiPolygon], list[list[Polygon | MultiPolygon]]]:
    """The outer rings, and the holes of each, of components ``{"outer": ring, "holes": [ring, ...]}``.

    A Shapely polygon is a component, too, its own holes being a part of what is called its outer ring here.

    Raises:
        ValueError: If there is no component, or one has another form or an invalid ring.
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
    return outers, holes


def united_within(bounds: Box, outers: list[Any], holes: list[list[Any]]) -> Any:
    """What outer rings less the holes of each cover of bounds, up to rounding, as a MultiPolygon."""
    box = shapely.box(*bounds.lo, *bounds.hi)
    rings = [box, *outers, *(hole for of_one in holes for hole in of_one)]
    merged = iter(merge_vertices(rings, 8 * grid_of(bounds)))
    box, outers = next(merged), [next(merged) for _ in outers]
    blocked = [shapely.union_all([next(merged) for _ in of_one]) for of_one in holes]
    united = shapely.union_all(shapely.difference(outers, blocked))
    return MultiPolygon(polygons_of(shapely.intersection(box, united)))


def rounding_of(bounds: Box) -> float:
    """Error to expect of coordinates within bounds."""
    return rounding_at(bounds.width.max(), np.abs([bounds.lo, bounds.hi]).max())


def rounding_at(width: float, reach: float) -> float:
    """Error to expect of coordinates up to ``reach``: 1e-12 of the larger side, or more far from the origin."""
    return float(max(1e-12 * width, 1e-15 * reach))


def grid_of(bounds: Box) -> float:
    """A power of two near the rounding error, so that integers and dyadic fractions are not rounded."""
    return float(2.0 ** np.ceil(np.log2(rounding_of(bounds))))


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


def thicker_than(width: float, geometry: Any) -> tuple[Polygon, ...]:
    """The polygons of a geometry without slivers: less area than a strip of such a width, as long as half around."""
    polygons = polygons_of(geometry)
    is_thick = shapely.area(polygons) > width / 2 * shapely.length(polygons)
    return tuple(compress(polygons, is_thick.tolist()))


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


def sample_triangles(triangles: Float[np.ndarray, "triangles 3 2"], n: int, seed: int) -> Float[np.ndarray, "n 2"]:
    """Points drawn uniformly from triangles that do not overlap."""
    # From triangles and not by rejection, which would take forever where free space is a sliver.
    corner, first, second = triangles.transpose(1, 0, 2)
    first, second = first - corner, second - corner
    area = np.abs(cross_product(first, second))
    rng = np.random.default_rng(seed)
    pick = rng.choice(len(area), n, p=area / area.sum())
    u, v = rng.random((2, n, 1))
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])  # the far half of the parallelogram, folded back
    return corner[pick] + u * first[pick] + v * second[pick]


def merge_vertices(geometries: Sequence[Any], tolerance: float) -> list[Any]:
    """Geometries in which vertices as near to one another as the tolerance are the same, none of them dropped."""
    numbers, index = np.unique(shapely.get_coordinates(geometries) @ [1, 1j], return_inverse=True)
    points = np.stack([numbers.real, numbers.imag], axis=1)
    i, j = KDTree(points).query_pairs(tolerance, output_type="ndarray").T
    graph = scipy.sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(points), len(points)))
    _, first, group = np.unique(connected_components(graph)[1], return_index=True, return_inverse=True)
    return list(shapely.set_coordinates(np.array(geometries, dtype=object), points[first[group]][index]))


_PREPARED = threading.local()


def prepared(owner: Any, name: str, make: Callable[[], Any]) -> Any:
    """An owner's geometry, prepared for many queries of this thread alone: GEOS may crash where two query one."""
    of_owner = vars(_PREPARED).setdefault("geometries", WeakKeyDictionary()).setdefault(owner, {})
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
    region = _simplified(rounded(free, grid), 4 * grid)
    # Snapped coarser and coarser where that is not enough, until nothing is thinner than edges may be cut beside.
    coarser = 32 * grid
    while not (edges := RingEdges.of(region, 8 * grid)).is_told_apart:
        if coarser > 256 * grid:
            raise ValueError(
                f"Obstacles leave walls or gaps too thin to be told apart: make them thicker than "
                f"{coarser:.1e} or leave them out; far from the origin, translate the workspace there first."
            )
        region = _simplified(shapely.set_precision(region, coarser), 0.0)
        coarser *= 2
    return Region(region, edges.boundary, coarser == 32 * grid)


def region_after(free: Any, bounds: Box, old: Boundary) -> Region:
    """The same of free space that had some boundary, and changed here and there: vertices are rounded one by one."""
    grid = grid_of(bounds)
    rounded = shapely.transform(free, lambda points: np.rint(points / grid) * grid)
    if not shapely.is_valid(rounded):  # as slivers become, which rounding leaves no area
        return region_of(free, bounds)
    region = _simplified(rounded, 4 * grid)
    edges = RingEdges.of(region, 8 * grid, old)
    return Region(region, edges.boundary, True) if edges.is_told_apart else region_of(free, bounds)


def _simplified(geometry: Any, tolerance: float) -> Polygon | MultiPolygon:
    parts = polygons_of(geometry)
    if not parts:
        raise ValueError("The workspace has no free space: the obstacles cover its bounds.")
    # A normalized ring starts at an extreme vertex, so simplifying also reaches collinear ones at its seam.
    region = shapely.normalize(parts[0] if len(parts) == 1 else MultiPolygon(parts))
    return shapely.simplify(region, tolerance)
