"""Planning problems: robots in a workspace, each with a start and a goal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._robot import PointRobot, Robot
from plr_jax._types import ArrayLike
from plr_jax._workspace import Workspace

_DOF = 2


@dataclass(frozen=True, eq=False)
class Problem:
    """Robots in a workspace, each to go from its start to its goal.

    Args:
        workspace: Where they move.
        robots: The robots, at least one.
        starts: Start configurations, ``(robots, dof)``, workspace units; ``dof`` is 2 for points.
        goals: Goal configurations, ``(robots, dof)``.

    Raises:
        ValueError: If there is no robot, starts or goals have the wrong shape or are not finite, or a start
            or goal lies outside the bounds or inside an obstacle. Boundaries are free.
    """

    workspace: Workspace
    robots: tuple[Robot, ...]
    starts: Float[np.ndarray, "robots dof"]
    goals: Float[np.ndarray, "robots dof"]

    def __init__(self, workspace: Workspace, robots: Sequence[Robot], starts: ArrayLike, goals: ArrayLike):
        robots = tuple(robots)
        for i, robot in enumerate(robots):
            if not isinstance(robot, PointRobot):
                raise ValueError(f"Robot {i} must be a robot such as PointRobot(), got {robot!r}.")
        if not robots:
            raise ValueError("A problem needs at least one robot, got none.")
        object.__setattr__(self, "workspace", workspace)
        object.__setattr__(self, "robots", robots)
        for name, value in (("starts", starts), ("goals", goals)):
            configurations = _configurations(name, value, len(robots))
            _require_free(name, configurations, workspace)
            object.__setattr__(self, name, configurations)


def _configurations(name: str, value: ArrayLike, num_robots: int) -> Float[np.ndarray, "robots dof"]:
    try:
        configurations = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be numbers of shape (robots, dof) = ({num_robots}, {_DOF}), got {value!r}."
        ) from None
    if configurations.shape != (num_robots, _DOF):
        raise ValueError(
            f"{name} must have shape (robots, dof) = ({num_robots}, {_DOF}), got {configurations.shape}."
        )
    broken = np.flatnonzero(~np.isfinite(configurations).all(axis=1))
    if broken.size:
        raise ValueError(f"{name} must be finite, got {configurations[broken[0]]} for robot {broken[0]}.")
    configurations.flags.writeable = False
    return configurations


def _require_free(name: str, configurations: Float[np.ndarray, "robots dof"], workspace: Workspace) -> None:
    stuck = np.flatnonzero(~workspace.is_free(configurations))
    if stuck.size == 0:
        return
    i = stuck[0]
    q, verb = configurations[i], {"starts": "starts", "goals": "has its goal"}[name]
    if not workspace.bounds.contains(q[None])[0]:
        raise ValueError(f"Robot {i} {verb} outside the bounds: {q.tolist()} is not in {workspace.bounds}.")
    obstacle = int(shapely.STRtree(workspace.obstacles).nearest(shapely.Point(q)))
    clearance = workspace.clearance(q[None])[0]
    raise ValueError(
        f"Robot {i} {verb} in collision with obstacle {obstacle} at {q.tolist()} (clearance {clearance:.3g})."
    )
