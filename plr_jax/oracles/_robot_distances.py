"""One exact distance function for each robot of a problem: the terms of a team's heuristic."""

import math
import time

import numpy as np
import shapely
import shapely.ops
from jaxtyping import Float

from plr_jax._arrays import deadline_after, require_time
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles._visibility_graph import VisibilityGraph

_LEAST_TIME = 1e-9  # seconds
_SLACK = 4  # tolerances


def robot_distance_fns(
    problem: Problem, inflated: bool = True, *, time_limit: float | int = math.inf
) -> list[VisibilityGraph]:
    """Exact distance of each robot to its goal, alone among the obstacles.

    Robots of one size share the visibility of the corners.

    Args:
        problem: The robots, their workspace and their goals.
        inflated: Whether obstacles are grown by each robot's radius (of one that turns, its inscribed radius), so
            that distances are those of its reference point. False gives the paper's point robots, whose distances
            are shorter.
        time_limit: Seconds that all of it may take. A single call of Shapely is not cut short.

    Returns:
        A distance function of the position ``(n, 2)`` for each robot, never longer than the robot's own shortest
        path. ``inf`` where its center cannot be.

    Raises:
        TimeoutError: If the time limit passes first.

    References:
        Section V-B of the paper, which uses the point robots' distances.
    """
    deadline = deadline_after(time_limit)
    first: dict[float, VisibilityGraph] = {}
    distance_fns = []
    for done, (robot, goal) in enumerate(zip(problem.robots, problem.goals, strict=True)):
        require_time(deadline, f"all distances were known: those of {done} of {len(problem.robots)} robots were")
        # A robot may overlap a wall by the tolerance, and fits a passage exactly as wide as it is.
        radius = max(0.0, robot.inscribed_radius - _SLACK * problem.workspace.tolerance) if inflated else 0.0
        if radius in first:
            distance_fns.append(first[radius].with_goal(_snapped(goal[:2], first[radius].workspace)))
            continue
        time_left = max(_LEAST_TIME, deadline - time.perf_counter())
        workspace = problem.workspace.inflate(radius, time_limit=time_left) if radius > 0 else problem.workspace
        time_left = max(_LEAST_TIME, deadline - time.perf_counter())
        first[radius] = VisibilityGraph(workspace, _snapped(goal[:2], workspace), time_limit=time_left)
        distance_fns.append(first[radius])
    return distance_fns


def _snapped(goal: Float[np.ndarray, "2"], workspace: Workspace) -> Float[np.ndarray, "2"]:
    """The goal, moved into free space where rounding left it just outside, as that of a robot that touches a wall."""
    if workspace.is_free_to_tolerance(goal[None])[0]:
        return goal
    nearest = shapely.get_coordinates(shapely.ops.nearest_points(workspace.free_space, shapely.Point(goal))[0])[0]
    close = np.linalg.norm(nearest - goal) <= 1e3 * workspace.tolerance
    return nearest if close else goal
