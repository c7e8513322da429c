"""Readers of the YAML problems and solutions of db-CBS and dynobench, benchmarks of kinodynamic planning.

Robots are holonomic here, with the shapes that they have in the benchmarks.

References:
    A. Moldagalieva, J. Ortiz-Haro, M. Toussaint, W. Hönig, "db-CBS: Discontinuity-Bounded Conflict-Based Search for
    Multi-Robot Kinodynamic Motion Planning", ICRA 2024.
"""

from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace
from plr_jax.robots import Robot

# In db-CBS a unicycle_first_order_0 is this rectangle; a dynobench model of that name is a disc.
_SHAPES: dict[str, Robot] = {
    "unicycle_first_order_0": RectangleRobot(0.5, 0.25),
    "unicycle_first_order_0_sphere": DiscRobot(0.4),
    "unicycle1_v0": RectangleRobot(0.5, 0.25),
    "unicycle2_v0": RectangleRobot(0.5, 0.25),
    "single_integrator": DiscRobot(0.1),
    "single_integrator_0": DiscRobot(0.1),
    "double_integrator_0": DiscRobot(0.1),
    "integrator2_2d_v0": DiscRobot(0.1),
}


def read_problem(path: Path) -> Problem:
    """Read a problem. Speeds, and the headings of discs in a team of discs, are dropped.

    Raises:
        ValueError: If a robot is of an unknown type, or the problem is impossible.
    """
    data = yaml.safe_load(path.read_text())
    environment, entries = data["environment"], data["robots"]
    if unknown := [entry["type"] for entry in entries if entry["type"] not in _SHAPES]:
        raise ValueError(f"{path}: expected robots of the types {', '.join(_SHAPES)}, got {unknown[0]!r}.")
    robots = [_SHAPES[entry["type"]] for entry in entries]
    dof = max(robot.dof for robot in robots)
    corners = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    boxes = [np.array(box["center"]) + np.array(box["size"]) * corners for box in environment.get("obstacles") or []]
    ends = np.zeros((2, len(robots), dof))
    for end, key in zip(ends, ("start", "goal"), strict=True):
        for i, robot in enumerate(robots):
            end[i, : robot.dof] = entries[i][key][: robot.dof]
    try:
        return Problem(Workspace((environment["min"], environment["max"]), boxes), robots, ends[0], ends[1])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_trajectories(path: Path) -> Float[np.ndarray, "steps robots 3"]:
    """Read a solution as positions and headings, one row a time step. A robot that is done waits where it is."""
    data = yaml.safe_load(path.read_text())
    tracks = [np.array([state[:3] for state in entry["states"]], float) for entry in data.get("result", [data])]
    steps = np.arange(max(map(len, tracks)))
    return np.stack([track[np.minimum(steps, len(track) - 1)] for track in tracks], axis=1)
