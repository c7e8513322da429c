"""The shapes of robots: a point, a disc, a rectangle, a convex polygon."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._arrays import as_finite
from plr_jax.geometry.polygons import as_polygon
from plr_jax.robots.robot import Robot, check_body

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
        vars(self).update(vertices=ring, core=ring)
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
            vars(self)[name] = as_finite(f"RectangleRobot {name}", side, positive=True)
        # The corner ahead to the left first.
        vars(self)["core"] = _CORNERS * np.array([self.length, self.width]) / 2


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
        vars(self).update(radius=radius, rounding=radius)
