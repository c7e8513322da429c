"""Robots: the shapes that move through a workspace, and what their configurations mean."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class PointRobot:
    """A point that translates in the plane: its configuration is its position ``(x, y)``.

    Points never collide with one another, nor with a wall that they only touch.
    """

    @property
    def inscribed_radius(self) -> float:
        """Radius of the largest disc about the center within the robot: 0."""
        return 0.0

    @property
    def circumscribed_radius(self) -> float:
        """Radius of the smallest disc about the center around the robot: 0."""
        return 0.0


@dataclass(frozen=True, init=False)
class DiscRobot:
    """A disc that translates in the plane: its configuration is its center ``(x, y)``.

    Args:
        radius: Its radius, in workspace units, positive.

    Raises:
        ValueError: If the radius is not a positive finite number.
    """

    radius: float

    def __init__(self, radius: Any):
        object.__setattr__(self, "radius", _positive("DiscRobot radius", radius))

    @property
    def inscribed_radius(self) -> float:
        """Radius of the largest disc about the center within the robot: its own."""
        return self.radius

    @property
    def circumscribed_radius(self) -> float:
        """Radius of the smallest disc about the center around the robot: its own."""
        return self.radius


@dataclass(frozen=True, init=False)
class RectangleRobot:
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

    def __init__(self, length: Any, width: Any):
        object.__setattr__(self, "length", _positive("RectangleRobot length", length))
        object.__setattr__(self, "width", _positive("RectangleRobot width", width))

    @property
    def inscribed_radius(self) -> float:
        """Radius of the largest disc about the center within the robot: half its shorter side."""
        return min(self.length, self.width) / 2

    @property
    def circumscribed_radius(self) -> float:
        """Radius of the smallest disc about the center around the robot: half its diagonal."""
        return float(np.hypot(self.length, self.width)) / 2


Robot: TypeAlias = PointRobot | DiscRobot | RectangleRobot
"""Any robot."""


def team_dof(robots: Sequence[Robot]) -> int:
    """Numbers in each robot's configuration: 2 if all are round, else 3, the round ones' heading ignored.

    Args:
        robots: The team.

    Returns:
        2 or 3.
    """
    return 3 if any(isinstance(robot, RectangleRobot) for robot in robots) else 2


def shorter_turn(
    theta0: Float[np.ndarray, "*#batch"], theta1: Float[np.ndarray, "*#batch"]
) -> Float[np.ndarray, "*batch"]:
    """The turn by which a motion goes from one heading to another: the shorter one.

    Args:
        theta0: First headings, radians.
        theta1: Last headings, radians.

    Returns:
        Signed turns in (-pi, pi], counterclockwise positive. Half a turn goes counterclockwise.
    """
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * (turns - np.ceil(turns - 0.5))


def between(
    q0: Float[np.ndarray, "*#batch dof"], q1: Float[np.ndarray, "*#batch dof"], t: Float[np.ndarray, "*#batch 1"]
) -> Float[np.ndarray, "*batch dof"]:
    """Configurations along straight motions, which turn the shorter way.

    Args:
        q0: Configurations at the start of the motions, of 2 coordinates or 3.
        q1: Configurations at the end.
        t: Share of each motion, from 0 to 1.

    Returns:
        The configurations; at 0 those at the start, at 1 those at the end but for rounding and whole turns.
    """
    change = q1 - q0
    change[..., 2:] = shorter_turn(q0[..., 2:], q1[..., 2:])
    return q0 + t * change


def footprint(robot: Robot, q: Float[np.ndarray, "dof"]) -> Any:
    """The set that a robot covers, less its rounding: a disc's is its center.

    Args:
        robot: The robot.
        q: Its configuration; a round robot's heading may be there or not.

    Returns:
        A Shapely Polygon for a rectangle, a Point for a round robot.
    """
    import shapely

    if not isinstance(robot, RectangleRobot):
        return shapely.Point(q[:2])
    ahead = np.array([np.cos(q[2]), np.sin(q[2])])
    left = np.array([-ahead[1], ahead[0]])
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return shapely.Polygon([q[:2] + i * robot.length / 2 * ahead + j * robot.width / 2 * left for i, j in signs])


def _positive(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not (np.isfinite(number) and number > 0):
        raise ValueError(f"{name} must be a positive finite number, got {value!r}.")
    return number
