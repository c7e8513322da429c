"""Configurations: where they place a body, and the straight motions between them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from plr_jax.robots.robot import Robot

_HALF_TURN = 0.5 + 1e-10  # of a full turn: what headings as large as 1e5 lose by rounding leaves it half a turn


def team_dof(robots: Sequence[Robot]) -> int:
    """Numbers in a robot's configuration: 2 if none has a heading, else 3, where that of the others is ignored."""
    return max((robot.dof for robot in robots), default=2)


def shorter_turn(
    theta0: Float[np.ndarray, "*#batch"], theta1: Float[np.ndarray, "*#batch"]
) -> Float[np.ndarray, "*batch"]:
    """Signed shorter turns from one heading to another, counterclockwise positive: nothing else says which way it is.

    Half a turn goes counterclockwise, and so does one that falls short of it by at most 1e-10 of a full turn: where
    headings were rounded, or wrapped into another range, the way is the same. So turns are at most 6.3e-10 above pi.
    """
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * (turns - np.ceil(turns - _HALF_TURN))


def smaller_angle(
    theta0: Float[np.ndarray, "*#batch"], theta1: Float[np.ndarray, "*#batch"]
) -> Float[np.ndarray, "*batch"]:
    """Angles between headings, from 0 to pi: what the shorter turn costs, whichever way half a turn goes.

    Unlike the turn, the angle is a metric, so that a detour is never cheaper.
    """
    turns = (theta1 - theta0) / (2 * np.pi)
    return 2 * np.pi * np.abs(turns - np.rint(turns))


def between(
    q0: Float[np.ndarray, "*#batch dof"], q1: Float[np.ndarray, "*#batch dof"], t: Float[np.ndarray, "*#batch 1"]
) -> Float[np.ndarray, "*batch dof"]:
    """Configurations at a share from 0 to 1 of straight motions, which turn the shorter way.

    At 1 they are those at the end but for rounding and whole turns.
    """
    change = q1 - q0
    change[..., 2:] = shorter_turn(q0[..., 2:], q1[..., 2:])
    return q0 + t * change


def motions_under_way(
    times: Float[np.ndarray, "steps"], when: Float[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
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
