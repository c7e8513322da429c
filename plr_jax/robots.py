"""Robots as convex bodies: their shapes, their configurations, and straight motions between configurations."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import as_finite, set_fields
from plr_jax.geometry.boundary import as_polygon
from plr_jax.geometry.vectors import cross_product, distance_to_segment

_ROUNDING = 1e-12  # slack of the checks of a body, as a share of its size
_HALF_TURN = 0.5 + 1e-10  # in full turns; the excess absorbs the rounding of headings up to 1e5
_MOST_VERTICES = 1_000
_CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])  # of a rectangle, front left first
Headings: TypeAlias = Float[np.ndarray, "*#batch"]
Configurations: TypeAlias = Float[np.ndarray, "*#batch dof"]
Points: TypeAlias = Float[np.ndarray, "n 2"]
Rows: TypeAlias = Int[np.ndarray, " n"]
Moments: TypeAlias = Float[np.ndarray, " n"]


class Robot:
    """A convex body that moves in the plane: all points within ``rounding`` of its ``core``.

    The *reference point* is the origin of the core's coordinates. It must lie in the body, since distances measure
    the path of this point. A configuration is the position of the reference point, followed by the heading if the
    body can turn. The heading is the angle, in radians counterclockwise, by which the body is turned about the
    reference point.

    A new shape is a subclass that sets the three attributes. Robots of equal shape must be equal and have the same
    hash, as frozen dataclasses do.

    Attributes:
        rounding: Radius by which the core is rounded, in workspace units, at least 0.
        dof: Degrees of freedom: 2 for a position, 3 for a position and a heading.
        core: Vertices ``(vertices, 2)`` at heading 0 of a convex polygon (counterclockwise), a segment or a point.
    """

    rounding: float
    dof: int
    core: Float[np.ndarray, "vertices 2"]

    @cached_property
    def inscribed_radius(self) -> float:
        """Radius of the largest disc around the reference point in the body.

        If the reference point is outside the body, the result is minus its distance from the body.
        """
        core = self.core
        if len(core) > 2 and (depth := side_offsets(core, np.zeros((1, 2))).min()) >= 0:
            return self.rounding + float(depth)
        return self.rounding - float(distance_to_segment(*core.T, *(np.roll(core, -1, axis=0) - core).T).min())

    @cached_property
    def circumscribed_radius(self) -> float:
        """Radius of the smallest disc around the reference point that contains the body."""
        return self.rounding + float(np.hypot(*self.core.T).max())

    @cached_property
    def breadth(self) -> float:
        """Smallest distance between two parallel lines that enclose the body."""
        across = side_offsets(self.core, self.core).max(axis=1).min() if len(self.core) > 2 else 0.0
        return float(across) + 2 * self.rounding

    @cached_property
    def half_sides(self) -> Float[np.ndarray, "2"] | None:
        """Half length and half width, if the core is a box or a point, centered on the reference point; else None.

        The sides of the box are parallel to the axes. A segment along an axis counts as a box of width 0.
        """
        # A box with k sides of positive length has 2**k vertices, all with the same |x| and |y|.
        half = np.abs(self.core[0])
        return half if len(self.core) == 2 ** np.count_nonzero(half) and (np.abs(self.core) == half).all() else None


def check_body(name: str, robot: Robot) -> None:
    """Raise a ``ValueError`` unless a robot's core is convex and counterclockwise, and its body holds the origin.

    The origin of the core's coordinates is the robot's reference point. The error message begins with ``name``.
    """
    core, rounding, dof = np.asarray(robot.core), robot.rounding, robot.dof
    if core.ndim != 2 or core.shape[1] != 2 or len(core) == 0 or not np.isfinite(core).all():
        raise ValueError(f"{name} must have a core of finite vertices (n, 2), got {robot.core!r:.200}.")
    if not (np.isfinite(rounding) and rounding >= 0 and dof in (2, 3)):
        expected = "a finite rounding of at least 0 and a dof of 2 or 3"
        raise ValueError(f"{name} must have {expected}, got {rounding!r} and {dof!r}.")
    slack = _ROUNDING * robot.circumscribed_radius
    sides = np.roll(core, -1, axis=0) - core
    if len(core) > 1 and ((sides == 0).all(axis=1).any() or side_offsets(core, core).min() < -slack):
        expected = "convex, its vertices counterclockwise and each given once"
        raise ValueError(f"{name} must be {expected}, got {core.tolist()}.")
    if robot.inscribed_radius < -slack:
        expected = "its reference point, the origin of its vertices, inside or on its boundary"
        got = f"it is {-robot.inscribed_radius:.3g} outside. Shift the vertices {core.tolist()}"
        raise ValueError(f"{name} must have {expected}; {got}.")


def side_offsets(core: Float[np.ndarray, "k 2"], x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k n"]:
    """Return the signed distance of each point ``x[j]`` to the line of each side ``i`` of a polygon, ``(k, n)``.

    Side ``i`` leads from vertex ``i`` to the next vertex. Distances are positive on the left of the side: on the
    inside, if the vertices are counterclockwise.
    """
    side = np.roll(core, -1, axis=0) - core
    return cross_product((side / np.linalg.norm(side, axis=1, keepdims=True))[:, None], x - core[:, None])


def shorter_turn(theta0: Headings, theta1: Headings) -> Float[np.ndarray, "*batch"]:
    """Return the shorter turns from headings ``theta0`` to ``theta1``, in radians, positive counterclockwise.

    Half a turn counts as positive.
    """
    # turns - ceil(turns - 1/2) lies in (-1/2, 1/2], so half a turn is positive.
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * (turns - np.ceil(turns - _HALF_TURN))


def smaller_angle(theta0: Headings, theta1: Headings) -> Float[np.ndarray, "*batch"]:
    """Return the angles between headings, in radians from 0 to pi; they satisfy the triangle inequality."""
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * np.abs(turns - np.rint(turns))


def between(q0: Configurations, q1: Configurations, t: Float[np.ndarray, "*#batch 1"]) -> Configurations:
    """Return the configurations at fractions ``t``, from 0 to 1, of straight motions from ``q0`` to ``q1``.

    Headings turn the shorter way.
    """
    change = q1 - q0
    change[..., 2:] = shorter_turn(q0[..., 2:], q1[..., 2:])
    return q0 + t * change


def rows_around(times: Float[np.ndarray, " steps"], when: Moments) -> tuple[Rows, Rows, Moments]:
    """Return, for each time in ``when``, the indices of the waypoints before and after it, and the fraction between.

    A path reaches its waypoint ``i`` at ``times[i]``, in nondecreasing order. Earlier times count as the first time,
    later times as the last. The fraction is the share of the time from the waypoint before to the waypoint after.
    """
    # A time at the end belongs to the last motion. A path of one row has no motion: both rows are its only row.
    last = len(times) - 1
    when = np.clip(when, times[0], times[-1])
    row = np.minimum(np.searchsorted(times, when, side="right") - 1, max(last - 1, 0))
    after = np.minimum(row + 1, last)
    spent, length = when - times[row], times[after] - times[row]
    return row, after, np.divide(spent, length, out=np.ones_like(spent), where=length > 0)


def placed(robot: Robot, points: Points, q: Float[np.ndarray, "*batch dof"]) -> Float[np.ndarray, "*batch n 2"]:
    """Return the workspace positions of points, given in the frame of a robot, at each configuration of ``q``."""
    x, y = points.T
    heading = q[..., 2:] if robot.dof == 3 else np.zeros((*q.shape[:-1], 1))
    c, s = np.cos(heading), np.sin(heading)
    return q[..., None, :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1)


def footprint(robot: Robot, q: Float[np.ndarray, "*batch dof"]) -> Any:
    """Return a robot's core at each configuration of ``q`` as Shapely geometries, without its ``rounding``."""
    corners = placed(robot, robot.core, q)
    if len(robot.core) == 1:
        return shapely.points(corners[..., 0, :])
    return shapely.polygons(corners) if len(robot.core) > 2 else shapely.linestrings(corners)


@dataclass(frozen=True, eq=False, init=False)
class PolygonRobot(Robot):
    """A convex polygon, with configurations ``(x, y, theta)``: position of the reference point, and heading.

    The polygon turns about the reference point, the origin of the vertices' frame. Distances measure the path of this
    point, so the polygon must contain it, if only on its boundary. The heading is in radians, counterclockwise,
    periodic, and 0 for the polygon as given.

    Args:
        vertices: From 3 to 1,000 corners ``(n, 2)``, in workspace units, in either order, closed or not; stored
            counterclockwise from the first one on. ``ValueError`` if collinear, not convex, or the origin is outside.
    """

    vertices: Float[np.ndarray, "n 2"]
    rounding = 0.0
    dof = 3

    def __init__(self, vertices: Any):
        name = "PolygonRobot vertices"
        polygon = shapely.remove_repeated_points(as_polygon(name, vertices))
        if not isinstance(polygon, shapely.Polygon) or len(polygon.interiors):
            raise ValueError(f"{name} must form one polygon without holes, got {vertices!r:.200}.")
        ring = shapely.get_coordinates(polygon)[:-1]
        if not polygon.exterior.is_ccw:
            ring = np.roll(ring[::-1], 1, axis=0)
        if len(ring) > _MOST_VERTICES:
            raise ValueError(f"{name} must be at most {_MOST_VERTICES:,}, got {len(ring):,}. Simplify the outline.")
        ring.flags.writeable = False
        set_fields(self, vertices=ring, core=ring)
        check_body(name, self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PolygonRobot) and np.array_equal(self.vertices, other.vertices)

    def __hash__(self) -> int:
        return hash(self.vertices.tobytes())

    def __repr__(self) -> str:
        return f"PolygonRobot({self.vertices.tolist()})"


@dataclass(frozen=True, init=False)
class RectangleRobot(Robot):
    """A rectangle, with configurations ``(x, y, theta)``: center and heading.

    The heading is the direction of the ``length``, in radians counterclockwise from the x axis, and periodic.
    ``length`` and ``width`` are in workspace units, positive and finite, else ``ValueError``.
    """

    length: float
    width: float
    rounding = 0.0
    dof = 3

    def __init__(self, length: Any, width: Any):
        for name, side in (("length", length), ("width", width)):
            set_fields(self, **{name: as_finite(f"RectangleRobot {name}", side, positive=True)})
        set_fields(self, core=_CORNERS * np.array([self.length, self.width]) / 2)


@dataclass(frozen=True)
class PointRobot(Robot):
    """A point, with configurations ``(x, y)``; points never collide with points, nor with a wall that they touch."""

    rounding = 0.0
    dof = 2
    core = np.zeros((1, 2))


@dataclass(frozen=True, init=False)
class DiscRobot(Robot):
    """A disc, with configurations ``(x, y)`` of its center; ``radius`` is positive and finite, in workspace units."""

    radius: float
    dof = 2
    core = PointRobot.core

    def __init__(self, radius: Any):
        radius = as_finite("DiscRobot radius", radius, positive=True)
        set_fields(self, radius=radius, rounding=radius)
