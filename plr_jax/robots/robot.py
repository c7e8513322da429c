"""What a robot is to the rest of the library: a convex body as data, placed and moved by configurations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import as_finite, set_fields
from plr_jax.geometry.boundary import as_polygon
from plr_jax.geometry.vectors import cross_product, distance_to_segment

_ROUNDING = 1e-12  # of the body's size


class Robot:
    """A convex body that moves in the plane: all points within ``rounding`` of its ``core``.

    Planners, checks and pictures read these three and what follows from them, never the class, so that a new shape
    is a class that states them. The *reference point* is the origin of the core's frame: a configuration holds its
    position, and the heading by which the body is turned about it. It must be a point of the body: where it cannot
    be, the robot cannot be, and its way is what distances measure. Robots of one shape must be equal and hash alike,
    as frozen dataclasses do.

    Attributes:
        rounding: Radius by which the core is rounded, in workspace units, at least 0.
        dof: Numbers in a configuration that mean something: 2 for a position, 3 for a position and a heading.
        core: Vertices of the core at heading 0: a convex polygon's, counterclockwise, or a segment's two, or one.
    """

    rounding: float
    dof: int
    core: Float[np.ndarray, "vertices 2"]

    @cached_property
    def inscribed_radius(self) -> float:
        """Radius of the largest disc about the reference point within the robot; negative if it is outside."""
        core = self.core
        if len(core) > 2 and (depth := side_offsets(core, np.zeros((1, 2))).min()) >= 0:
            return self.rounding + float(depth)
        return self.rounding - float(distance_to_segment(*core.T, *(np.roll(core, -1, axis=0) - core).T).min())

    @cached_property
    def circumscribed_radius(self) -> float:
        """Radius of the smallest disc about the reference point around the robot."""
        return self.rounding + float(np.hypot(*self.core.T).max())

    @cached_property
    def breadth(self) -> float:
        """Smallest distance of two parallel lines between which the robot fits."""
        across = side_offsets(self.core, self.core).max(axis=1).min() if len(self.core) > 2 else 0.0
        return float(across) + 2 * self.rounding

    @cached_property
    def half_sides(self) -> Float[np.ndarray, "2"] | None:
        """Half the length and the width of a core that is a box about the reference point, 0 if it is that point."""
        half = np.abs(self.core[0])
        is_box = len(self.core) == 2 ** np.count_nonzero(half) and (np.abs(self.core) == half).all()
        return half if is_box else None


def check_body(name: str, robot: Robot) -> None:
    """Refuse what is no convex body about its reference point.

    Raises:
        ValueError: If the core is no array ``(vertices, 2)`` of finite numbers, or its vertices are not those of a
            convex polygon, each once and counterclockwise; the rounding is negative or not finite; the degrees of
            freedom are not 2 or 3; or the reference point is not in the body.
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
        expected = "its reference point, the origin of its vertices, within it or on its boundary"
        got = f"it is {-robot.inscribed_radius:.3g} outside. Shift the vertices {core.tolist()}"
        raise ValueError(f"{name} must have {expected}; {got}.")


def side_offsets(core: Float[np.ndarray, "k 2"], x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k n"]:
    """How far points lie to the left of each side of a polygon."""
    side = np.roll(core, -1, axis=0) - core
    return cross_product((side / np.linalg.norm(side, axis=1, keepdims=True))[:, None], x - core[:, None])


# Configurations: where they place a body, and the straight motions between them.


_HALF_TURN = 0.5 + 1e-10  # of a full turn: what headings as large as 1e5 lose by rounding leaves it half a turn


Headings: TypeAlias = Float[np.ndarray, "*#batch"]
Configurations: TypeAlias = Float[np.ndarray, "*#batch dof"]
Rows: TypeAlias = Int[np.ndarray, "n"]
Moments: TypeAlias = Float[np.ndarray, "n"]


def team_dof(robots: Sequence[Robot]) -> int:
    """Numbers in a robot's configuration: 2 if none has a heading, else 3, where that of the others is ignored."""
    return max((robot.dof for robot in robots), default=2)


def shorter_turn(theta0: Headings, theta1: Headings) -> Float[np.ndarray, "*batch"]:
    """Signed shorter turns from one heading to another, counterclockwise positive: nothing else says which way it is.

    Half a turn goes counterclockwise, and so does one that falls short of it by at most 1e-10 of a full turn: where
    headings were rounded, or wrapped into another range, the way is the same. So turns are at most 6.3e-10 above pi.
    """
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * (turns - np.ceil(turns - _HALF_TURN))


def smaller_angle(theta0: Headings, theta1: Headings) -> Float[np.ndarray, "*batch"]:
    """Angles between headings, from 0 to pi: what the shorter turn costs, whichever way half a turn goes.

    Unlike the turn, the angle is a metric, so that a detour is never cheaper.
    """
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * np.abs(turns - np.rint(turns))


def between(
    q0: Configurations, q1: Configurations, t: Float[np.ndarray, "*#batch 1"]
) -> Float[np.ndarray, "*batch dof"]:
    """Configurations at a share from 0 to 1 of straight motions, which turn the shorter way.

    At 1 they are those at the end but for rounding and whole turns.
    """
    change = q1 - q0
    change[..., 2:] = shorter_turn(q0[..., 2:], q1[..., 2:])
    return q0 + t * change


def motions_under_way(times: Float[np.ndarray, "steps"], when: Moments) -> tuple[Rows, Rows, Moments]:
    """Which motion of a path is under way at some moments: its rows, and the share of it that is done.

    Args:
        times: When the path reaches its rows, at least one; never falling.
        when: The moments, which are clipped to these times.

    Returns:
        The row before and the row after, and a share from 0 to 1: exactly 0 at a row's own time, of rows at one time
        at that of the last, and exactly 1 at the end of the path.
    """
    last = len(times) - 1
    when = np.clip(when, times[0], times[-1])
    row = np.minimum(np.searchsorted(times, when, side="right") - 1, max(last - 1, 0))
    after = np.minimum(row + 1, last)
    spent, length = when - times[row], times[after] - times[row]
    return row, after, np.divide(spent, length, out=np.ones_like(spent), where=length > 0)


def placed(robot: Robot, points: Float[np.ndarray, "n 2"], q: Float[np.ndarray, "dof"]) -> Float[np.ndarray, "n 2"]:
    """Points of a robot's own frame, at heading 0 about the origin, where a configuration places them.

    The heading of a robot that has none may be there or not.
    """
    if robot.dof == 2:
        return q[:2] + points
    cos, sin = np.cos(q[2]), np.sin(q[2])
    return q[:2] + points @ np.array([[cos, sin], [-sin, cos]])


def footprint(robot: Robot, q: Float[np.ndarray, "dof"]) -> Any:
    """The set that a robot covers, less its rounding, as a Shapely geometry; a heading is as for :func:`placed`.

    A Polygon, LineString or Point, as the core has three vertices or more, two, or one: a disc's is its center.
    """
    import shapely

    corners = placed(robot, robot.core, q)
    return (shapely.Point, shapely.LineString, shapely.Polygon)[min(len(corners), 3) - 1](corners)


# The shapes of robots: a point, a disc, a rectangle, a convex polygon.


# A convex polygon.


_MOST_VERTICES = 1_000


@dataclass(frozen=True, eq=False, init=False)
class PolygonRobot(Robot):
    """A convex polygon in SE(2): its configuration is ``(x, y, theta)``, its reference point and its heading.

    The reference point is the origin of the vertices' frame: ``(x, y)`` is its position, about which the polygon
    turns. It must lie in the polygon or on its boundary, since distances are those of its way. The heading is in
    radians, counterclockwise from the x axis, 0 for the polygon as given, and periodic.

    Args:
        vertices: Its corners ``(n, 2)``, in workspace units, in either order, closed or not; kept counterclockwise,
            the first one first.

    Raises:
        ValueError: If the vertices are not finite, fewer than three or more than 1,000, on one line or not convex, or
            the polygon does not contain the origin.
    """

    vertices: Float[np.ndarray, "n 2"]
    rounding = 0.0
    dof = 3

    def __init__(self, vertices: Any):
        name = "PolygonRobot vertices"
        polygon = shapely.remove_repeated_points(as_polygon(name, vertices))
        if not isinstance(polygon, shapely.Polygon) or len(polygon.interiors):
            raise ValueError(f"{name} must be those of one polygon without holes, got {vertices!r:.200}.")
        ring = shapely.get_coordinates(polygon)[:-1]
        if not polygon.exterior.is_ccw:
            ring = np.roll(ring[::-1], 1, axis=0)
        if len(ring) > _MOST_VERTICES:
            raise ValueError(f"{name} must be at most {_MOST_VERTICES:,}, got {len(ring):,}; simplify the outline.")
        ring.flags.writeable = False
        set_fields(self, vertices=ring, core=ring)
        check_body(name, self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PolygonRobot) and np.array_equal(self.vertices, other.vertices)

    def __hash__(self) -> int:
        return hash(self.vertices.tobytes())

    def __repr__(self) -> str:
        return f"PolygonRobot({self.vertices.tolist()})"


# A rectangle.


_CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])


@dataclass(frozen=True, init=False)
class RectangleRobot(Robot):
    """A rectangle in SE(2): its configuration is its center and heading ``(x, y, theta)``.

    The heading, in radians, is the direction of its length, counterclockwise from the x axis; it is
    periodic, so ``theta`` and ``theta + 2 pi`` are the same.

    Args:
        length: Side along the heading, in workspace units, positive.
        width: Side across the heading, in workspace units, positive.

    Raises:
        ValueError: If a side is not a positive finite number.
    """

    length: float
    width: float
    rounding = 0.0
    dof = 3

    def __init__(self, length: Any, width: Any):
        for name, side in (("length", length), ("width", width)):
            set_fields(self, **{name: as_finite(f"RectangleRobot {name}", side, positive=True)})
        # The corner ahead to the left first.
        set_fields(self, core=_CORNERS * np.array([self.length, self.width]) / 2)


# A point, and a disc.


@dataclass(frozen=True)
class PointRobot(Robot):
    """A point that translates in the plane: its configuration is its position ``(x, y)``.

    Points never collide with one another, nor with a wall that they only touch.
    """

    rounding = 0.0
    dof = 2
    core = np.zeros((1, 2))


@dataclass(frozen=True, init=False)
class DiscRobot(Robot):
    """A disc that translates in the plane: its configuration is its center ``(x, y)``.

    Args:
        radius: Its radius, in workspace units, positive.

    Raises:
        ValueError: If the radius is not a positive finite number.
    """

    radius: float
    dof = 2
    core = PointRobot.core

    def __init__(self, radius: Any):
        radius = as_finite("DiscRobot radius", radius, positive=True)
        set_fields(self, radius=radius, rounding=radius)
