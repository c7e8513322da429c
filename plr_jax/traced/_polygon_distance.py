"""Distances among polygons that JAX may trace: the public function :func:`polygon_distance`."""

from typing import TypeAlias, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from plr_jax._arrays import require_integer
from plr_jax._compiled import broadcast_shape, pytree
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.traced.corner_paths import CornerPairs, CornerPaths
from plr_jax.traced.fields import FAR, as_array, as_floats, as_points, distance, replace_nonfinite, require_one_map
from plr_jax.traced.polygons import PolygonCorners

Bounds = Box | ArrayLike | None
MOST_VERTICES = 256  # tests of sight grow with the cube of the number of vertices


@pytree
class PolygonDistance:
    """The distance from any point to the nearest of some goals among polygons; made by :func:`polygon_distance`.

    ``has_no_answers`` is true if a coordinate of a goal or of the bounds is NaN, or a row of the polygons is neither
    finite nor all NaN. Then all distances are NaN.
    """

    paths: CornerPaths  # relative to `origin`
    origin: Float[Array, "*maps 2"]
    has_no_answers: Bool[Array, "*maps"]

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance from each point ``(..., 2)`` to the nearest goal, ``(...)``.

        Distances are ``inf`` with gradient 0 inside polygons, outside the bounds and where no path exists. They are
        NaN where a coordinate is NaN, and if ``has_no_answers`` is true. ``ValueError`` if points are not real.
        """
        require_one_map(self, "jax.vmap(lambda field, x: field(x))(fields, x)")
        return _distance(self, as_points("x", x))

    def __repr__(self) -> str:
        return f"PolygonDistance({self.paths.corners}, {self.paths.goals.shape[-2]} goals)"


@pytree
class PolygonDistances:
    """The distance between any two points among polygons; made by :func:`polygon_distance` without a goal."""

    paths: CornerPairs
    origin: Float[Array, "*maps 2"]
    has_no_answers: Bool[Array, "*maps"]

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance between each point of ``x`` and the point of ``y`` at the same index.

        Both arrays are real, ``(..., 2)``. Their leading axes must broadcast, else ``ValueError``. Distances are
        ``inf`` or NaN as for :class:`PolygonDistance`.
        """
        require_one_map(self, "jax.vmap(lambda field, x, y: field(x, y))(fields, x, y)")
        x, y = as_points("x", x), as_points("y", y)
        broadcast_shape("x and y", x, y)
        return _distance(self, x, y)

    def __repr__(self) -> str:
        return f"PolygonDistances({self.paths.corners})"


Field: TypeAlias = PolygonDistance | PolygonDistances


@overload
def polygon_distance(polygons: ArrayLike, goal: None, *, bounds: Bounds = None) -> PolygonDistances: ...
@overload
def polygon_distance(polygons: ArrayLike, goal: ArrayLike, *, bounds: Bounds = None) -> PolygonDistance: ...
def polygon_distance(polygons: ArrayLike, goal: ArrayLike | None, *, bounds: Bounds = None) -> Field:
    """Return a function that measures shortest paths among polygons whose vertices may be traced, as inside ``jit``.

        field = plr_jax.polygon_distance(polygons, goal)
        field(x)  # distances (n,) to the goal from points x, (n, 2)

    Distances have gradients with respect to vertices, goals and points. Where two paths are equally short, the
    gradient is that of one of them. At a corner of a polygon, it is that of the segment to the path's next turn. All
    arguments may be created in ``jax.jit`` and batched by ``jax.vmap``. Invalid shapes raise ``ValueError``, also in
    tracing.

    Polygons may overlap and touch. Paths may touch walls, but not pass between two polygons that touch in a point.
    Distances are those of ``VisibilityGraph`` in ``Workspace(bounds, polygons)``, with these exceptions:

    - A point where two polygons touch, or a polygon and the bounds, belongs to the free space on one side of the
      contact only. Paths from the other side to this point lead around the polygons.
    - The tip of an acute angle between walls of two polygons or bounds may count as blocked.
    - In 32 bits, gaps narrower than 3e-5 of the map's size may count as closed, and a point closer to a wall than
      1e-6 of this size may count as on either side of it. In 64 bits, these are 1e-13 and 1e-15.

    A program of new shapes takes seconds to compile: jit the function that makes and calls the field, and pad maps to
    one shape. 1,000 points among 64 vertices then take milliseconds.

    Args:
        polygons: Simple polygons, ``(m, k, 2)``, clockwise or counterclockwise, not necessarily convex. Distances
            are wrong, without an error, if a polygon crosses itself: they may even be ``inf`` outside. Pad polygons
            of fewer vertices by repeated vertices or by rows of NaN (after you rotate or scale them: in gradients, 0
            times NaN is NaN). Of equal vertices, one has the gradient. At most 256 vertices, ``m * k``, with padding.
        goal: Goal ``(2,)``, or several goals ``(g, 2)``: distances are those to the nearest goal. No path leads to a
            goal that is not free. None: the result is a :class:`PolygonDistances`, of pairs of points.
        bounds: The region's ``Box``, or its corners ``((x0, y0), (x1, y1))``. Everything outside is blocked,
            so bounds without width leave nothing free. None: the whole plane, up to coordinates of 1e17.
    """
    polygons = as_floats(as_points("polygons", polygons))
    if polygons.ndim != 3:
        advice = "use polygons[None] for one polygon, jax.vmap for several maps"
        raise ValueError(f"polygons must have shape (m, k, 2), got {polygons.shape}: {advice}.")
    if (count := polygons.shape[0] * polygons.shape[1]) > MOST_VERTICES:
        got = f"{count:,} with padding, in an array of shape {polygons.shape}"
        advice = "use VisibilityGraph, whose vertex_gradient has the derivatives"
        raise ValueError(f"polygon_distance takes at most {MOST_VERTICES} vertices, got {got}: {advice}.")
    if goal is not None:
        goal = as_floats(as_points("goal", goal))
        if goal.ndim > 2 or not goal.size:
            raise ValueError(f"goal must have shape (2,) or (g, 2) with g >= 1, got {goal.shape}.")
        goal = goal.reshape(-1, 2)
    if bounds is None:
        bounds = ((-FAR / 10, -FAR / 10), (FAR / 10, FAR / 10))
    elif isinstance(bounds, Box):
        if bounds.is_periodic:
            raise ValueError(f"bounds must not have periodic axes, got {bounds}.")
        bounds = np.stack([bounds.lo, bounds.hi])
    bounds = as_floats(as_points("bounds", bounds))
    if bounds.shape != (2, 2):
        raise ValueError(f"bounds must be a Box or its corners ((x0, y0), (x1, y1)), got shape {bounds.shape}.")
    return _make(polygons, goal, bounds)


def polygons_of_discs(centers: ArrayLike, radii: ArrayLike, corners: int = 16) -> Float[Array, "m corners 2"]:
    """Return regular polygons around discs, for :func:`polygon_distance`: paths stay outside the discs.

    ``centers`` are ``(m, 2)``, ``radii`` a number or ``(m,)``. Both may be traced, and the result has gradients with
    respect to both. A polygon has ``corners`` corners, at least 3, at ``1 / cos(pi / corners)`` times the radius: 2 %
    outside the disc for 16. ``ValueError`` for other arguments.
    """
    require_integer("corners", corners, 3)
    centers = as_floats(as_points("centers", centers))
    radii = as_floats(as_array(radii, "radii must be a number or (m,)"))
    if centers.ndim != 2 or radii.shape not in ((), (len(centers),)):
        raise ValueError(f"centers must be (m, 2), radii a number or (m,), got {centers.shape} and {radii.shape}.")
    angle = 2 * np.pi * (np.arange(corners) + 0.5) / corners
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) / np.cos(np.pi / corners)
    return centers[:, None] + radii.reshape(-1, 1, 1) * jnp.asarray(around, centers.dtype)[None]


@jax.jit
def _make(polygons: Float[Array, "m k 2"], goals: Float[Array, "g 2"] | None, bounds: Float[Array, "2 2"]) -> Field:
    dtype = jnp.result_type(*(each.dtype for each in (polygons, goals, bounds) if each is not None))
    # 1. Mark padding by rows of NaN. A map without polygons gets one of padding alone.
    polygons = jnp.full((1, 1, 2), jnp.nan, dtype) if polygons.size == 0 else polygons.astype(dtype)
    is_finite = jnp.isfinite(polygons).all(axis=2, keepdims=True)
    has_no_answers = ~(is_finite | jnp.isnan(polygons).all(axis=2, keepdims=True)).all() | jnp.isnan(bounds).any()
    # 2. Move the origin to the middle of the map, around which floats are most precise.
    lo = jnp.where(is_finite, polygons, jnp.inf).min(axis=(0, 1))
    hi = jnp.where(is_finite, polygons, -jnp.inf).max(axis=(0, 1))
    origin = jax.lax.stop_gradient(jnp.where(is_finite.any(), (lo + hi) / 2, 0))
    polygons = jnp.where(is_finite, polygons - origin[None, None], jnp.nan)
    corners = PolygonCorners.of_polygons(polygons, bounds.astype(dtype) - origin[None])
    if goals is None:
        return PolygonDistances(CornerPairs.of_map(corners), origin, has_no_answers)
    goals = goals.astype(dtype)
    paths = CornerPaths.to_goals(corners, replace_nonfinite(goals - origin[None]))
    return PolygonDistance(paths, origin, has_no_answers | jnp.isnan(goals).any())


@jax.jit
def _distance(field: Field, *points: Array | np.ndarray) -> Float[Array, "*batch"]:
    moved = [x.astype(jnp.promote_types(x.dtype, field.origin.dtype)) for x in map(as_floats, points)]
    return distance(field, *(x - jnp.broadcast_to(field.origin.astype(x.dtype), x.shape) for x in moved))
