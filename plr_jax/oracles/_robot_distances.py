"""Distance functions for the robots of a team, from which the planner's heuristic is made."""

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles._visibility_graph import VisibilityGraph

_SLACK = 4  # robots are shrunk by this many times the workspace's tolerance


def robot_distance_fns(problem: Problem, inflated: bool = True) -> list[VisibilityGraph]:
    """Return, for each robot, a function of the distance to the robot's goal, without the other robots.

    Each function takes positions ``(n, 2)``; distances are ``inf`` at blocked positions. If ``inflated``, obstacles
    are grown by the robot's inscribed radius: distances of discs are exact up to a tolerance, and distances of other
    robots are lower bounds. Otherwise distances are those of a point robot, which are shorter, as in section V-B of
    the paper (Putman et al.). Robots of equal size share the preprocessing of the map.
    """
    first: dict[float, VisibilityGraph] = {}  # the first robot's oracle for each radius of inflation
    distance_fns = []
    for robot, goal in zip(problem.robots, problem.goals, strict=True):
        # A robot may overlap a wall by the tolerance, and fits through a passage of exactly its own width.
        radius = max(0.0, robot.inscribed_radius - _SLACK * problem.workspace.tolerance) if inflated else 0.0
        if radius in first:
            oracle = first[radius].with_goal(_snapped(goal[:2], first[radius].workspace))
        else:
            workspace = problem.workspace.inflate(radius) if radius > 0 else problem.workspace
            oracle = first[radius] = VisibilityGraph(workspace, _snapped(goal[:2], workspace))
        distance_fns.append(oracle)
    return distance_fns


def exact_lower_bound(problem: Problem) -> float:
    """Return the sum of the robots' exact distances to their goals, a lower bound of the cost of all team paths.

    Each robot counts as alone in the workspace, and turns cost nothing. The bound is ``inf`` if a robot cannot reach
    its goal.
    """
    pairs = zip(robot_distance_fns(problem), problem.starts, strict=True)
    return float(sum(distance_fn(start[None, :2])[0] for distance_fn, start in pairs))


def _snapped(goal: Float[np.ndarray, "2"], workspace: Workspace) -> Float[np.ndarray, "2"]:
    """Return the goal, moved to the nearest free point if the goal is outside free space only by rounding.

    The goal is not moved if it is at most ``workspace.tolerance`` outside, since it then counts as free. Nor is it
    moved if it is more than 1,000 times the tolerance outside, since rounding errors are smaller.
    """
    if workspace.is_free_to_tolerance(goal[None])[0]:
        return goal
    nearest = shapely.get_coordinates(shapely.shortest_line(workspace.free_space, shapely.Point(goal)))[0]
    return nearest if np.linalg.norm(nearest - goal) <= 1e3 * workspace.tolerance else goal
