"""A 2-D region with polygonal obstacles: what is free, how far it is to a wall, what can be seen."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from plr_jax._arrays import (
    as_bool,
    as_finite,
    as_points,
    require_integer,
    set_fields,
    shortened,
)
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import (
    Boundary,
    Region,
    advice_on_cells,
    as_bounds,
    as_polygon,
    as_polygons,
    components_region,
    grid_of,
    grown_boundary,
    merge_vertices,
    polygons_of,
    prepared_geometry,
    region_after_change,
    region_of,
    rounding_of,
    triangulate,
)
from plr_jax.geometry.box import Box
from plr_jax.geometry.masks import placed_region, rounded_one_by_one
from plr_jax.geometry.triangulation import Triangulation, triangulation_of
from plr_jax.geometry.vectors import cross_product

_MITRE_LIMIT = 1.5  # how far the corner of grown free space may be from the one it grew from: tips are cut off
_MANY_EDGES = 1000  # above which the nearest is found sooner by a tree than by prepared lines


@dataclass(frozen=True, eq=False, init=False)
class Workspace:
    """Bounds and polygonal obstacles in the plane.

    Free space is closed: the boundary of an obstacle and the bounds are free, and so is whatever lies within
    ``tolerance`` of them: such a point is taken to be the nearest one of free space, and one as near to a point in
    which obstacles touch to be that point, on both of its sides. Obstacles may overlap, touch, and leave the bounds;
    together they cover the interior of their union. Coordinates are rounded to a grid a thousand times finer than
    ``tolerance``, so that what touches up to rounding touches. Walls and gaps thinner than a hundredth of
    ``tolerance`` vanish, and where several meet, those thinner than a quarter of it may; far from the origin, than
    twice of it.

    Args:
        bounds: The region's Box, or its corners ``((x0, y0), (x1, y1))``.
        obstacles: Rings ``(n, 2)`` (closed or not, either orientation) and Shapely polygons (holes allowed), linear
            rings, multipolygons and collections of them, in any iterable; or one such Shapely geometry.
        squeeze: Whether a path may pass between two obstacles (or an obstacle and the bounds) that touch in
            a single point. The point itself is free either way.
        region: The free space and its boundary, if they are known; bounds and obstacles are then taken as they are.

    Attributes:
        bounds: The region's Box.
        obstacles: The obstacles as Shapely polygons, in the order given; for free space given as polygons,
            and after ``inflate``, the connected parts of the bounds that are not free.
        squeeze: As given.
        free_space: The free space as a valid, normalized Shapely Polygon or MultiPolygon without collinear
            vertices.
        boundary: The boundary of free space as vertices and edges, free space on the left of each edge.

    Raises:
        ValueError: If the bounds are not a 2-D box or have a periodic axis, an obstacle is not a simple polygon of
            finite coordinates and positive area, nothing is free, walls or gaps are too thin to be told apart, or the
            bounds are so far from the origin that ``tolerance`` is a tenth of their shorter side.
    """

    bounds: Box
    obstacles: tuple[Polygon | MultiPolygon, ...] = field(repr=False)
    squeeze: bool
    free_space: Polygon | MultiPolygon = field(repr=False)
    boundary: Boundary = field(repr=False)
    _is_in_place: bool = field(repr=False)

    def __init__(
        self,
        bounds: Box | ArrayLike,
        obstacles: Any = (),
        *,
        squeeze: bool = False,
        region: Region | None = None,
    ):
        squeeze = as_bool("squeeze", squeeze)
        if region is not None:  # its bounds may be more slender than those given from outside, as after inflating
            bounds = Box.of(bounds)
        else:
            bounds, obstacles = as_bounds(bounds), as_polygons("Obstacle", obstacles)
            box, *merged = merge_vertices([shapely.box(*bounds.lo, *bounds.hi), *obstacles], 8 * grid_of(bounds))
            region = region_of(shapely.difference(box, shapely.union_all(merged)), bounds)
        set_fields(self, bounds=bounds, obstacles=tuple(obstacles), squeeze=squeeze, free_space=region.polygon)
        set_fields(self, boundary=region.boundary, _is_in_place=region.is_in_place)
        self._prepare()

    def __setstate__(self, state: dict[str, Any]) -> None:
        set_fields(self, **state)
        self._prepare()

    def _prepare(self) -> None:
        # GEOS builds an index at the first look, which must not happen in two threads at a time.
        shapely.prepare(self.free_space)
        shapely.intersects_xy(self.free_space, *self.bounds.lo)

    @classmethod
    def from_polygons(
        cls, components: Sequence[Any], bounds: Box | ArrayLike | None = None, *, squeeze: bool = False
    ) -> "Workspace":
        """A workspace whose free space is given, as polygons with holes.

        Args:
            components: Each a Shapely polygon or multipolygon, or ``{"outer": ring, "holes": [ring, ...]}``
                (``"holes"`` may be left out). Holes may overlap one another and leave the outer ring; components
                are united, and what leaves the bounds is cut off.
            bounds: As for the class; None: the bounding box of the components, holes filled.
            squeeze: As for the class.

        Returns:
            The workspace.

        Raises:
            ValueError: If there is no component, one has another form, a ring is not simple, finite and of
                positive area, the bounds are none, or nothing within them is free.
        """
        return cls._from_free_space(*components_region(components, bounds), squeeze)

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
    ) -> "Workspace":
        """A workspace whose free space is given as pixels.

        Free pixels are joined along edges. Blocked ones are joined at corners as well: where only corners of free
        pixels touch, ``squeeze`` says whether a path may pass. The outline of the free pixels is traced exactly, then
        drawn with fewer corners. That never joins what is apart nor parts what is joined, and leaves passages and
        walls a quarter of a pixel at least; a passage becomes narrower by twice the tolerance at most.

        Args:
            free: Which pixels are free, booleans ``(rows, columns)``. What is beyond them is not free.
            resolution: Side of a pixel, in workspace units; 8e-12 of the largest coordinate at least.
            origin: The outer corner ``(x, y)`` of the first column's lowest pixel, or ``(x, y, yaw)``: the grid is
                then turned about that corner by ``yaw`` radians, counterclockwise.
            row0: Whether the first row is the one of least ``y``, ``"bottom"``, or of most, as in images, ``"top"``.
            tolerance: How far the outline may be from that of the pixels, and that from it, in pixels: half a pixel
                draws inclined walls straight; 0 keeps every corner.
            drop_specks: Components of at most so many pixels are dropped: blocked ones become free, and then free
                ones blocked.
            squeeze: As for the class.

        Returns:
            The workspace; its bounds are the bounding box of its free space.

        Raises:
            ValueError: If ``free`` is no such array, nothing in it is free, or another argument is none of the above.
        """
        region = placed_region(free, resolution, origin, row0=row0, tolerance=tolerance, drop_specks=drop_specks)
        x0, y0, x1, y1 = region.bounds
        return cls._from_free_space(as_bounds(((x0, y0), (x1, y1))), region, squeeze, rounded_one_by_one)

    @classmethod
    def _from_free_space(
        cls, bounds: Box, free: Any, squeeze: bool, rounded: Callable[[Any, float], Any] = shapely.set_precision
    ) -> "Workspace":
        blocked = np.array(polygons_of(shapely.difference(shapely.box(*bounds.lo, *bounds.hi), free)), object)
        # Slivers have less area than a strip as wide as the grid and half as long as their outline.
        blocked = blocked[shapely.area(blocked) > grid_of(bounds) / 2 * shapely.length(blocked)].tolist()
        return cls(bounds, blocked, squeeze=squeeze, region=region_of(free, bounds, rounded))

    @property
    def tolerance(self) -> float:
        """How far outside free space a point still counts as free.

        1e-9 of the longer side of the bounds or 1e-12 of their largest coordinate, whichever is more: far from
        the origin, coordinates are coarser.
        """
        return 1e3 * rounding_of(self.bounds)

    @cached_property
    def triangulation(self) -> Triangulation:
        """Triangles that fill free space between the edges of ``boundary``."""
        return triangulation_of(self.boundary, self.tolerance)

    @property
    def is_triangulated(self) -> bool:
        """Whether ``triangulation`` has been computed."""
        return "triangulation" in self.__dict__

    def use_triangulation(self, triangulation: Triangulation) -> None:
        """Use a triangulation of ``boundary`` that was found from the one before a change."""
        set_fields(self, triangulation=triangulation)

    def _grown(self, tolerance: float) -> Any:
        """Free space grown by a tolerance."""

        def grow() -> Any:
            return self.free_space.buffer(tolerance, join_style="mitre", mitre_limit=_MITRE_LIMIT)

        return prepared_geometry(self, ("grown", tolerance), grow)

    @property
    def walls(self) -> Any:
        """The boundary of free space as Shapely lines, prepared for many queries."""
        return prepared_geometry(self, "walls", lambda: self.free_space.boundary)

    @property
    def edge_tree(self) -> shapely.STRtree:
        """The edges of ``boundary``, in their order, as Shapely lines in a tree."""
        return self.boundary.tree

    @cached_property
    def _triangles(self) -> Float[np.ndarray, "triangles 3 2"]:
        return triangulate(self.free_space)

    def is_free(self, x: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether points lie in closed free space.

        Args:
            x: Points, ``(n, 2)``.

        Returns:
            True where free, walls included (to ``tolerance``); False outside the bounds, and for points that are not
            finite. Of 32-bit points, those on the bounds as 32 bits round them outward are inside. So what is free is
            what queries take to be inside as well.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_points("x", self.bounds.settled(x), 2)
        return self.bounds.contains(x) & self.is_free_to_tolerance(x)

    def is_free_to_tolerance(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """The same for what has been computed: also true outside the bounds, by no more than ``tolerance``."""
        return shapely.intersects_xy(self._grown(self.tolerance), x[:, 0], x[:, 1])

    def clearance(self, x: ArrayLike) -> Float[np.ndarray, "n"]:
        """Signed distance to the nearest obstacle or bound.

        Args:
            x: Points, ``(n, 2)``.

        Returns:
            Distance to the boundary of free space, in workspace units: positive in free space, zero on a
            wall, negative in an obstacle or outside the bounds; NaN for points that are not finite.

        Raises:
            ValueError: If ``x`` has another shape.
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

    def is_visible(self, a: ArrayLike, b: ArrayLike, tolerance: int | float | None = None) -> Bool[np.ndarray, "n"]:
        """Whether whole segments lie in closed free space.

        A segment may slide along walls and pass through corners. It crosses no wall, however thin. One that passes
        through a point in which two obstacles touch, from one side to the other, is not visible unless ``squeeze``
        is set.

        Args:
            a: Start points, ``(n, 2)``.
            b: End points, ``(n, 2)``.
            tolerance: How far outside free space points still count as free, for ends that are known no better, such
                as those that a file rounds; None: the workspace's own.

        Returns:
            True where a path in free space keeps within ``tolerance`` of the segment; False where an end is not
            finite.

        Raises:
            ValueError: If the shapes are others or differ, or the tolerance is negative or not finite.
        """
        a, b = as_points("a", a, 2), as_points("b", b, 2)
        if len(a) != len(b):
            raise ValueError(f"Segments need as many starts as ends, got {len(a)} and {len(b)}.")
        tolerance = self.tolerance if tolerance is None else as_finite("tolerance", tolerance)
        free = self._grown(tolerance)
        visible = shapely.intersects_xy(free, *a.T) & shapely.intersects_xy(free, *b.T)
        moving = np.flatnonzero(visible & (a != b).any(axis=1))
        segments: Any = shapely.linestrings(np.stack([a[moving], b[moving]], axis=1))
        visible[moving] = shapely.covers(self._grown(2 * tolerance), segments)
        # What leaves free space, or comes near to a contact, is looked at again: free space that is grown has no thin
        # walls, and paths through contacts.
        kept = visible[moving]
        moving, segments = moving[kept], segments[kept]
        own = prepared_geometry(self, "free", lambda: shapely.transform(self.free_space, np.copy))
        doubted = ~shapely.covers(own, segments)
        if len(contacts := self.boundary.contacts):
            points: Any = shapely.points(self.boundary.vertices[contacts])
            doubted[shapely.STRtree(points).query(segments, predicate="dwithin", distance=tolerance)[0]] = True
        if len(moving := moving[doubted]):
            mesh = self.triangulation
            visible[moving] = mesh.are_joined(mesh.place(a[moving]), mesh.place(b[moving]), tolerance, self.squeeze)
        return visible

    def inflate(self, radius: float) -> "Workspace":
        """The workspace of a disc's center: obstacles grown, and bounds shrunk, by its radius.

        The grown obstacles' sides are exact. Their corners, arcs in truth, become polygons inscribed in the
        arcs, so a distance in the inflated workspace is never longer than the true one. A path around one
        corner is too short by at most 0.16 % of the arc, or by 2e-5 of the longer side of free space if that is
        more. Passages exactly as wide as the disc are closed.

        Args:
            radius: Radius of the disc, in workspace units, at least 0.

        Returns:
            The inflated workspace.

        Raises:
            ValueError: If the radius is negative or not finite, or leaves no free space.
        """
        if as_finite("radius", radius) == 0:
            return self
        if (self.bounds.width <= 2 * radius).any():
            raise ValueError(f"Inflating by {radius:g} leaves no free space within {self.bounds}.")
        grown = grown_boundary(self.boundary, radius, grid_of(self.bounds))
        free = shapely.difference(self.free_space, grown)
        if shapely.area(free) == 0:
            raise ValueError(f"Inflating by {radius:g} leaves no free space; use a smaller radius.")
        bounds = Box(self.bounds.lo + radius, self.bounds.hi - radius)
        return Workspace._from_free_space(bounds, free, self.squeeze)

    def with_obstacles(self, add: Any = (), remove: Any = ()) -> "Workspace":
        """The workspace after obstacles are set down and taken away.

        Args:
            add: Obstacles as for the class, which are numbered on.
            remove: Numbers of obstacles, or obstacles themselves, rings or Shapely polygons that equal these. What
                others cover stays blocked.

        Returns:
            The workspace. All other obstacles keep their numbers: in the place of one that is gone is an empty one,
            which files of scenes leave out.

        Raises:
            ValueError: If an added obstacle is none as for the class, a removed one is none of these or already gone,
                or nothing is left free.
        """
        added, gone = as_polygons("Added obstacle", add), self._numbers_of(remove)
        obstacles = (*(Polygon() if i in gone else each for i, each in enumerate(self.obstacles)), *added)
        if not self._is_in_place:  # or obstacles may not fit into their places any more
            return Workspace(self.bounds, obstacles, squeeze=self.squeeze)
        box, grid, removed = shapely.box(*self.bounds.lo, *self.bounds.hi), grid_of(self.bounds), sorted(gone)
        free, opened = self.free_space, [self.obstacles[i] for i in removed]
        beside = np.array(obstacles)[shapely.intersects(obstacles, shapely.union_all(opened))].tolist()
        free, box, *merged = merge_vertices([free, box, *opened, *beside, *added], 8 * grid)
        if opened:
            opened, beside = merged[: len(removed)], merged[len(removed) : len(removed) + len(beside)]
            opened = shapely.difference(
                shapely.intersection(box, shapely.union_all(opened)), shapely.union_all(beside)
            )
            free = shapely.union(free, opened)
        if added:
            free = shapely.difference(free, shapely.union_all(merged[len(merged) - len(added) :]))
        region = region_after_change(free, self.bounds, self.boundary)
        return Workspace(self.bounds, obstacles, squeeze=self.squeeze, region=region)

    def _numbers_of(self, remove: Any) -> set[int]:
        """Numbers of obstacles that are to be removed; ``ValueError`` if one is none."""
        numbers: set[int] = set()
        if not isinstance(remove, BaseGeometry | Iterable):
            raise ValueError(f"remove must be a list of numbers or polygons of obstacles, got {shortened(remove)}.")
        for each in [remove] if isinstance(remove, BaseGeometry) else remove:
            if isinstance(each, BaseGeometry) or (isinstance(each, Iterable) and not isinstance(each, str)):
                shape = as_polygon("Removed obstacle", each)
                number = next((i for i, own in enumerate(self.obstacles) if own.equals(shape)), -1)
            else:
                require_integer("Each number of an obstacle to remove", each, 0)
                number = int(each)
            if not 0 <= number < len(self.obstacles) or self.obstacles[number].is_empty:
                raise ValueError(
                    f"remove must be numbers of obstacles, below {len(self.obstacles)}, or polygons that equal one, "
                    f"and not those that are gone, got {shortened(each)}."
                )
            numbers.add(number)
        return numbers

    def sample_free(self, n: int, seed: int) -> Float[np.ndarray, "n 2"]:
        """Points drawn uniformly from free space.

        Args:
            n: Number of points, at least 0.
            seed: Seed of the generator; the same seed gives the same points.

        Returns:
            Free points, ``(n, 2)``.

        Raises:
            ValueError: If ``n`` or the seed is no integer of at least 0.
        """
        require_integer("n", n, 0)
        require_integer("seed", seed, 0)
        # From triangles and not by rejection, which would take forever where free space is a sliver.
        corner, first, second = self._triangles.transpose(1, 0, 2)
        first, second = first - corner, second - corner
        area = np.abs(cross_product(first, second))
        rng = np.random.default_rng(seed)
        pick = rng.choice(len(area), n, p=area / area.sum())
        u, v = rng.random((2, n, 1))
        u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])  # the far half of the parallelogram, folded back
        return corner[pick] + u * first[pick] + v * second[pick]


def require_workspace(workspace: object) -> None:
    """Raise ``ValueError`` if it is something else, which says what to do with pixels and voxels."""
    if not isinstance(workspace, Workspace):
        got = f"an array of shape {workspace.shape}" if isinstance(workspace, np.ndarray) else shortened(workspace)
        raise ValueError(f"workspace must be a Workspace, got {got}.{advice_on_cells(workspace)}")
