"""A 2-D workspace with polygonal obstacles: which points are free, clearance, visibility, inflation, changes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from plr_jax._arrays import as_bool, as_finite, as_finite_point, as_points, require_integer, set_fields, shortened
from plr_jax._types import FAR_AWAY, ArrayLike, BoxTest, Points, Reach
from plr_jax.geometry import boundary
from plr_jax.geometry.boundary import Boundary, Region, as_bounds, grid_of, merge_vertices, prepared_geometry
from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import connected_groups
from plr_jax.geometry.masks import placed_region, rounded_one_by_one
from plr_jax.geometry.triangulation import Triangulation, triangulation_of
from plr_jax.geometry.vectors import cross_product

_MITRE_LIMIT = 1.5  # corners of grown free space are cut off beyond this multiple of the tolerance
_MANY_EDGES = 1000  # with more edges, a tree finds the nearest one faster than prepared lines do


@dataclass(frozen=True, eq=False, init=False)
class Workspace:
    """Bounds and polygonal obstacles in the plane.

    Obstacles may overlap, touch, and leave the bounds; the interior of their union is blocked. Free space is closed:
    it includes the boundary of obstacles and the bounds. A point up to ``tolerance`` outside of free space is treated
    as the nearest point of free space. A point within ``tolerance`` of a contact of obstacles is treated as the
    contact, and lies on both sides of it. For points that come as 32-bit floats, such as states of a JAX program, the
    step between two such floats replaces ``tolerance`` if it is larger: see ``settled``. Oracles, planners and paths
    take points in the same way.

    Coordinates are rounded to a thousandth of ``tolerance``, so walls that touch up to rounding do touch. Walls and
    gaps thinner than a hundredth of ``tolerance`` vanish from ``free_space``, on which all distances and proofs are
    based. Where several thin walls or gaps meet, walls and gaps thinner than half of ``tolerance`` may vanish, or
    thinner than twice ``tolerance`` if they are far from the origin.

    Args:
        bounds: The region's Box, or its corners ``((x0, y0), (x1, y1))``.
        obstacles: An iterable of rings ``(n, 2)`` (closed or not, either orientation), Shapely polygons (holes
            allowed), linear rings, multipolygons and collections; or one such Shapely geometry. Holes may share sides
            with the rim and with one another, and rings may touch themselves, but not cross themselves.
        squeeze: Whether a path may pass between two obstacles (or an obstacle and the bounds) that touch in a single
            point. The point itself is free either way.
        region: For internal use.

    Attributes:
        obstacles: Shapely polygons, in the order given. If free space was given, and after ``inflate``: the connected
            parts of the bounds that are not free.
        free_space: The free space as a valid, normalized Shapely (Multi)Polygon without collinear vertices.
        boundary: The boundary of free space as vertices and edges, free space on the left of each edge.

    Raises:
        ValueError: If the bounds are not a valid 2-D box, or too far from the origin for their size. If an obstacle
            crosses itself, has no area, or has a coordinate that is not finite. If nothing is free. If so many thin
            walls or gaps meet that some remain even after coordinates were rounded to half of ``tolerance``.
    """

    bounds: Box
    obstacles: tuple[Polygon | MultiPolygon, ...] = field(repr=False)
    squeeze: bool
    free_space: Polygon | MultiPolygon = field(repr=False)
    boundary: Boundary = field(repr=False)
    _is_in_place: bool = field(repr=False)

    def __init__(
        self, bounds: Box | ArrayLike, obstacles: Any = (), *, squeeze: bool = False, region: Region | None = None
    ):
        squeeze = as_bool("squeeze", squeeze)
        if region is not None:  # do not check the bounds, which may have become very slender by inflating
            bounds = Box.of(bounds)
        else:
            bounds, obstacles = as_bounds(bounds), boundary.as_polygons("Obstacle", obstacles)
            box, *merged = merge_vertices([shapely.box(*bounds.lo, *bounds.hi), *obstacles], 8 * grid_of(bounds))
            region = boundary.region_of(shapely.difference(box, shapely.union_all(merged)), bounds)
        set_fields(self, bounds=bounds, obstacles=tuple(obstacles), squeeze=squeeze, boundary=region.boundary)
        self.__setstate__({"free_space": region.polygon, "_is_in_place": region.is_in_place})

    def __setstate__(self, state: dict[str, Any]) -> None:
        set_fields(self, **state)
        # GEOS builds an index in the first query, which must not happen in two threads at a time.
        shapely.prepare(self.free_space)
        shapely.intersects_xy(self.free_space, *self.bounds.lo)

    @classmethod
    def from_polygons(cls, components: Any, bounds: Box | ArrayLike | None = None, *, squeeze: bool = False) -> Self:
        """Build a workspace whose free space is given as polygons with holes.

        ``components`` is a Shapely polygon, multipolygon or collection; or a list of such geometries and of mappings
        ``{"outer": ring, "holes": [ring, ...]}``, where ``"holes"`` is optional. Holes may overlap, and may reach
        beyond the outer ring. Free space is the union of the components within the bounds. By default, the bounds are
        the bounding box of the components. ``ValueError`` if there is no component, a component or the bounds are
        invalid, or nothing is free.
        """
        return cls._from_free_space(*boundary.components_region(components, bounds), squeeze)

    @classmethod
    def from_mask(
        cls,
        free: ArrayLike,
        resolution: float | int = 1.0,
        origin: ArrayLike = (0, 0),
        *,
        row0: str = "bottom",
        tolerance: float | int = 0.5,
        drop_specks: int = 0,
        squeeze: bool = False,
    ) -> Self:
        """Build a workspace whose free space is given as pixels; its bounds are the bounding box of free space.

        Free pixels are 4-connected and blocked pixels 8-connected: where free pixels touch at a corner only,
        ``squeeze`` decides whether a path may pass. The outline of the free pixels is simplified so that connectivity
        is preserved: passages and walls stay at least a quarter of a pixel wide, and a passage narrows by at most
        twice the tolerance. ``ValueError`` if an argument is invalid or no pixel is free.

        Args:
            free: Whether each pixel is free, booleans ``(rows, columns)``. Everything outside is blocked.
            resolution: Side of a pixel, in workspace units; at least 8e-12 of the largest coordinate.
            origin: The outer corner ``(x, y)`` of the first column's lowest pixel, or ``(x, y, yaw)``, which turns
                the grid about that corner by ``yaw`` radians, counterclockwise.
            row0: ``"bottom"`` if the first row has the lowest ``y``; ``"top"`` if the highest, as in images.
            tolerance: Largest distance, in pixels, between the simplified and the exact outline, either way. Half a
                pixel makes inclined walls straight; 0 keeps every corner.
            drop_specks: Connected components of at most this many pixels are removed: blocked components become free,
                then free components become blocked.
            squeeze: Whether a path may pass between two obstacles that touch in a single point.
        """
        region = placed_region(free, resolution, origin, row0=row0, tolerance=tolerance, drop_specks=drop_specks)
        return cls._from_free_space(as_bounds(np.reshape(region.bounds, (2, 2))), region, squeeze, rounded_one_by_one)

    @classmethod
    def _from_free_space(
        cls, bounds: Box, free: Any, squeeze: bool, rounded: Callable[[Any, float], Any] = shapely.set_precision
    ) -> Self:
        box = shapely.box(*bounds.lo, *bounds.hi)
        blocked = np.array(boundary.polygons_of(shapely.difference(box, free)), object)
        # Drop slivers, whose area is less than half their perimeter times the grid spacing.
        blocked = blocked[shapely.area(blocked) > grid_of(bounds) / 2 * shapely.length(blocked)].tolist()
        return cls(bounds, blocked, squeeze=squeeze, region=boundary.region_of(free, bounds, rounded))

    @property
    def tolerance(self) -> float:
        """Distance from free space up to which points count as free, in workspace units.

        It is 1e-9 of the bounds' longer side, or 1e-12 of the largest coordinate if that is more.
        """
        return 1e3 * boundary.rounding_of(self.bounds)

    @property
    def obstacle_vertices(self) -> Float[np.ndarray, "vertices 2"]:
        """The vertices of ``obstacles``, ring after ring, each ring without its repeated last vertex.

        Rings have the order and orientation given. For each polygon, the outer ring comes first, then the holes.
        """
        rings = shapely.get_rings(shapely.get_parts(np.array(self.obstacles, object)))
        points, ring = shapely.get_coordinates(rings, return_index=True)
        return points[np.append(ring[1:] == ring[:-1], False)[: len(ring)]]

    @cached_property
    def triangulation(self) -> Triangulation:
        """Triangles that fill free space."""
        return triangulation_of(self.boundary, self.tolerance)

    @property
    def is_triangulated(self) -> bool:
        """Whether ``triangulation`` has been computed."""
        return "triangulation" in self.__dict__

    def use_triangulation(self, triangulation: Triangulation) -> None:
        """Use a known triangulation instead of computing one; its triangles must fill free space."""
        set_fields(self, triangulation=triangulation)

    def _grown(self, tolerance: float) -> Any:
        grow = partial(self.free_space.buffer, tolerance, join_style="mitre", mitre_limit=_MITRE_LIMIT)
        return prepared_geometry(self, ("grown", tolerance), grow)

    @property
    def walls(self) -> Any:
        """The boundary of free space as Shapely lines, prepared for many queries."""
        return prepared_geometry(self, "walls", lambda: self.free_space.boundary)

    @property
    def edge_tree(self) -> shapely.STRtree:
        """A Shapely ``STRtree`` of the boundary's edges as line segments, with the indices of ``boundary.edges``."""
        return self.boundary.tree

    @cached_property
    def _triangles(self) -> Float[np.ndarray, "triangles 3 2"]:
        return boundary.triangulate(self.free_space)

    def settled(self, x: ArrayLike, domain: Box | None = None) -> ArrayLike:
        """Move points ``(..., 2)`` of 32-bit floats that lie outside free space only by rounding to its boundary.

        A step is the spacing of 32-bit floats at the point. A point beyond the domain (by default the bounds) moves
        as by :meth:`Box.settled`. A point in an obstacle moves to the nearest free point if that is at most one step
        away. A point within one step of a place where obstacles touch moves to this place. All other points, and
        points of 64-bit floats, keep their coordinates.
        """
        domain = self.bounds if domain is None else domain
        settled = domain.settled(x)
        if settled is x or not len(inside := np.flatnonzero(domain.contains(settled.reshape(-1, 2)))):
            return settled
        points = settled.reshape(-1, 2)  # a view: changes of the points change the result
        step = np.hypot(*np.spacing(np.asarray(x).reshape(-1, 2)[inside]).T).astype(np.float64)
        # 1. Move points that are not free to the nearest wall, if it is within a step.
        blocked = np.flatnonzero(~shapely.intersects_xy(self.free_space, *points[inside].T))
        row, _, foot = self.boundary.feet(points[inside[blocked]], float(step.max()))
        is_near = np.linalg.norm(foot - points[inside[blocked[row]]], axis=1) <= step[blocked[row]]
        points[inside[blocked[row[is_near]]]] = np.clip(foot[is_near], domain.lo, domain.hi)
        # 2. Move points to contacts within a step.
        places: Any = shapely.points(points[inside])
        row, contact = self.boundary.contact_tree.query(places, predicate="dwithin", distance=step)
        points[inside[row]] = self.boundary.vertices[self.boundary.contacts[contact]]
        return settled

    def is_free(self, x: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether points ``(n, 2)`` lie within ``tolerance`` of free space.

        Points that are not finite or outside the bounds are not free. Points of 32-bit floats that lie outside only
        by rounding are free.
        """
        x = as_points("x", self.settled(x), 2)
        return self.bounds.contains(x) & self.is_free_to_tolerance(x)

    def is_free_to_tolerance(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return whether points lie within ``tolerance`` of free space, even if just outside the bounds."""
        return shapely.intersects_xy(self._grown(self.tolerance), x[:, 0], x[:, 1])

    def reachable(self, x: ArrayLike, goal: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether free paths lead from points ``(n, 2)`` to a goal ``(2,)``.

        The answer is exact up to ``tolerance``: it compares the connected parts of free space that contain the points
        and the goal. It is False for points that are not free, and for all points if the goal is not free.
        """
        x, goal = as_points("x", self.settled(x), 2), as_finite_point("goal", self.settled(goal), 2)
        parts, is_reached = shapely.get_parts(self.free_space), self.is_free(x)
        tree = shapely.STRtree(parts[joined_parts(parts, goal[None], self.tolerance, self.squeeze)])
        beside = tree.query(np.asarray(shapely.points(x)), predicate="dwithin", distance=self.tolerance)[0]
        return is_reached & np.isin(np.arange(len(x)), beside)

    def reach(self, goals: Float[np.ndarray, "goals 2"], domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach a goal, or free points that do not.

        The result is None if a path leads from every free point to one of the ``goals``.
        """
        # 1. Find the connected parts of free space that reach a goal.
        parts = shapely.get_parts(self.free_space)
        if len(parts) < 2:
            return None
        is_reached = joined_parts(parts, goals, self.tolerance, self.squeeze)
        if is_reached.all():
            return None
        # 2. Scale the parts to fractions of the domain.
        parts = shapely.transform(parts, lambda x: (x - domain.lo) / domain.width)
        reached, cut_off = shapely.multipolygons(parts[is_reached]), shapely.multipolygons(parts[~is_reached])
        # 3. Subtract the points near reached ones from cut-off parts. Only reached points near these parts matter.
        x0, y0, x1, y1 = shapely.bounds(parts[~is_reached]).T
        around = shapely.union_all(shapely.box(x0 - FAR_AWAY, y0 - FAR_AWAY, x1 + FAR_AWAY, y1 + FAR_AWAY))
        near = shapely.buffer(shapely.intersection(reached, around), FAR_AWAY)
        return Reach(*map(_meeting, (reached, cut_off, shapely.difference(cut_off, near))))

    def clearance(self, x: ArrayLike) -> Float[np.ndarray, " n"]:
        """Return the signed distance, in workspace units, of points ``(n, 2)`` to the boundary of free space.

        The distance is positive in free space, 0 on walls, and negative in obstacles and outside the bounds. It is
        NaN for points that are not finite.
        """
        x = as_points("x", x, 2)
        finite = np.isfinite(x).all(axis=1)
        result = np.full(len(x), np.nan)
        points: Any = shapely.points(x[finite])
        if len(self.boundary.edges) > _MANY_EDGES:
            distance = self.edge_tree.query_nearest(points, return_distance=True, all_matches=False)[1]
        else:
            distance = shapely.distance(points, self.walls)
        free = shapely.intersects_xy(self.free_space, x[finite, 0], x[finite, 1])
        result[finite] = np.where(free, distance, -distance)
        return result

    def is_visible(self, a: ArrayLike, b: ArrayLike, tolerance: int | float | None = None) -> Bool[np.ndarray, " n"]:
        """Return whether whole segments from ``a`` to ``b``, both ``(n, 2)``, lie in closed free space.

        A segment may slide along walls and pass through corners, but not cross a wall, however thin. It may cross a
        point in which two obstacles touch only if ``squeeze`` is set. The result is True if a free path stays within
        ``tolerance`` (None: the workspace's) of the segment, and False if an end is not finite.
        """
        a, b = as_points("a", self.settled(a), 2), as_points("b", self.settled(b), 2)
        if len(a) != len(b):
            raise ValueError(f"Segments must have as many starts as ends, got {len(a)} and {len(b)}.")
        tolerance = self.tolerance if tolerance is None else as_finite("tolerance", tolerance)
        # 1. Both ends of a visible segment are within the tolerance of free space, and the segment within twice it.
        free = self._grown(tolerance)
        visible = shapely.intersects_xy(free, *a.T) & shapely.intersects_xy(free, *b.T)
        moving = np.flatnonzero(visible & (a != b).any(axis=1))
        segments: Any = shapely.linestrings(np.stack([a[moving], b[moving]], axis=1))
        visible[moving] = shapely.covers(self._grown(2 * tolerance), segments)
        # 2. Grown free space lacks thin walls and opens contacts: doubt segments that leave it or pass contacts.
        stays = visible[moving]
        moving, segments = moving[stays], segments[stays]
        free_space = prepared_geometry(self, "free", lambda: shapely.transform(self.free_space, np.copy))
        is_doubted = ~shapely.covers(free_space, segments)
        is_doubted |= self.boundary.touches_contact(segments, tolerance)
        # 3. Test these exactly.
        if len(moving := moving[is_doubted]):
            mesh = self.triangulation
            visible[moving] = mesh.are_joined(mesh.place(a[moving]), mesh.place(b[moving]), tolerance, self.squeeze)
        return visible

    def inflate(self, radius: float, outside: bool = False) -> "Workspace":
        """Return the workspace of a disc's center: obstacles grown, and bounds shrunk, by its radius.

        By default, round corners become polygons inside their arcs, so that distances are lower bounds. A path around
        one corner is too short by at most 0.16 % of the arc, or 2e-5 of the longer side of free space if that is
        more. A passage between corners, even if a little narrower than the disc, may stay open.

        If ``outside``, round corners become polygons around their arcs, so that paths in the workspace keep the
        radius from all obstacles, up to rounding. A path around one corner is too long by at most twice the error
        above. Such a polygon reaches up to 1.09 radii from its corner, so a passage between corners that is hardly
        wider than the disc may be closed.

        Each round corner becomes several corners, in all often too many for a PLR of a few KB. For such a PLR, grow
        obstacles by Shapely's ``buffer(radius, join_style="mitre")``, which adds hardly any corners.

        A straight passage exactly as wide as the disc is closed. ``ValueError`` if the radius is negative or not
        finite, or nothing stays free.
        """
        if as_finite("radius", radius) == 0:
            return self
        if (self.bounds.width <= 2 * radius).any():
            raise ValueError(f"Inflating by {radius:g} leaves no free space in {self.bounds}; use a smaller radius.")
        grown = boundary.grown_boundary(self.boundary, radius, as_bool("outside", outside))
        free = shapely.difference(self.free_space, grown)
        if shapely.area(free) == 0:
            raise ValueError(f"Inflating by {radius:g} leaves no free space; use a smaller radius.")
        return Workspace._from_free_space(Box(self.bounds.lo + radius, self.bounds.hi - radius), free, self.squeeze)

    def with_obstacles(self, add: Any = (), remove: Any = ()) -> "Workspace":
        """Return the workspace after obstacles are added and removed.

        Obstacles to add are given as for the constructor, and appended to ``obstacles``. Obstacles to remove are
        given by indices in ``obstacles``, or by equal rings or Shapely polygons. Parts of removed obstacles that
        other obstacles cover stay blocked. All obstacles keep their indices: an empty polygon, which scene files
        leave out, replaces a removed obstacle. ``ValueError`` if an added obstacle is invalid, an obstacle to remove
        does not exist (any more), or nothing is free.
        """
        added, gone = boundary.as_polygons("Added obstacle", add), self._numbers_of(remove)
        obstacles = (*(Polygon() if i in gone else obstacle for i, obstacle in enumerate(self.obstacles)), *added)
        if not self._is_in_place:  # vertices have moved by more than rounding, so obstacles may no longer fit
            return Workspace(self.bounds, obstacles, squeeze=self.squeeze)
        # 1. Make vertices equal that differ by rounding: of free space, and of removed, added and adjacent obstacles.
        box = shapely.box(*self.bounds.lo, *self.bounds.hi)
        removed = [self.obstacles[i] for i in sorted(gone)]
        beside = np.array(obstacles)[shapely.intersects(obstacles, shapely.union_all(removed))].tolist()
        geometries = [self.free_space, box, *removed, *beside, *added]
        free, box, *merged = merge_vertices(geometries, 8 * grid_of(self.bounds))
        # 2. Add the removed obstacles to free space, where no other obstacle covers them, and subtract added ones.
        if removed:
            opened = shapely.intersection(box, shapely.union_all(merged[: len(removed)]))
            covered = shapely.union_all(merged[len(removed) : len(removed) + len(beside)])
            free = shapely.union(free, shapely.difference(opened, covered))
        if added:
            free = shapely.difference(free, shapely.union_all(merged[len(merged) - len(added) :]))
        region = boundary.region_after_change(free, self.bounds, self.boundary)
        return Workspace(self.bounds, obstacles, squeeze=self.squeeze, region=region)

    def _numbers_of(self, remove: Any) -> set[int]:
        """Return the indices in ``obstacles`` of the items of ``remove``, which are indices or equal polygons."""
        numbers: set[int] = set()
        if not isinstance(remove, BaseGeometry | Iterable):
            raise ValueError(f"remove must be a list of obstacle numbers or polygons, got {shortened(remove)}.")
        for item in [remove] if isinstance(remove, BaseGeometry) else remove:
            if isinstance(item, BaseGeometry) or (isinstance(item, Iterable) and not isinstance(item, str)):
                shape = boundary.as_polygon("Removed obstacle", item)
                number = next((i for i, obstacle in enumerate(self.obstacles) if obstacle.equals(shape)), -1)
            else:
                require_integer("Each number of an obstacle to remove", item, 0)
                number = int(item)
            if not 0 <= number < len(self.obstacles) or self.obstacles[number].is_empty:
                expected = f"numbers of obstacles, below {len(self.obstacles)}, or polygons that equal one"
                raise ValueError(f"remove must be {expected}, and not removed already, got {shortened(item)}.")
            numbers.add(number)
        return numbers

    def sample_free(self, n: int, seed: int) -> Float[np.ndarray, "n 2"]:
        """Draw ``n`` points uniformly from free space, ``(n, 2)``; the same seed gives the same points."""
        require_integer("n", n, 0)
        require_integer("seed", seed, 0)
        # Sample triangles; rejection from the bounds would take forever if free space is a sliver.
        corner, first, second = self._triangles.transpose(1, 0, 2)
        first, second = first - corner, second - corner
        area = np.abs(cross_product(first, second))
        rng = np.random.default_rng(seed)
        pick = rng.choice(len(area), n, p=area / area.sum())
        u, v = rng.random((2, n, 1))
        u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])  # fold the far half of the parallelogram back
        return corner[pick] + u * first[pick] + v * second[pick]


def joined_parts(parts: Any, points: Points, tolerance: float, may_squeeze: bool) -> Bool[np.ndarray, " parts"]:
    """Return whether each polygon of ``parts`` comes within ``tolerance`` of one of the points.

    If ``may_squeeze``, the result is also True for every polygon that a chain of touching polygons joins to such a
    polygon.
    """
    places, group = np.asarray(shapely.points(points)), part_groups(parts, may_squeeze)
    return np.isin(group, group[shapely.STRtree(parts).query(places, predicate="dwithin", distance=tolerance)[1]])


def part_groups(parts: Any, may_squeeze: bool) -> Int[np.ndarray, " parts"]:
    """Return a group number for each polygon of ``parts``.

    If ``may_squeeze``, polygons that touch have the same number. Otherwise all numbers differ.
    """
    if not may_squeeze:
        return np.arange(len(parts))
    return connected_groups(len(parts), shapely.STRtree(parts).query(parts, predicate="intersects"))


def _meeting(polygons: Any) -> BoxTest:
    shapely.prepare(polygons)
    return lambda lo, hi: shapely.intersects(polygons, shapely.box(*lo.T, *hi.T))


def require_workspace(workspace: object) -> None:
    if not isinstance(workspace, Workspace):
        got = f"an array of shape {workspace.shape}" if isinstance(workspace, np.ndarray) else shortened(workspace)
        raise ValueError(f"workspace must be a Workspace, got {got}.{boundary.advice_on_cells(workspace)}")
