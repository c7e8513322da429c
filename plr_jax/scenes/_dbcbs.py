"""Readers of the YAML problems and solutions of db-CBS and dynobench.

Both are benchmarks of kinodynamic planning; here their robots are holonomic, with the shapes they have there.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.disc import DiscRobot
from plr_jax.robots.motion import team_dof
from plr_jax.robots.rectangle import RectangleRobot
from plr_jax.robots.robot import Robot

# A db-CBS unicycle_first_order_0 is this rectangle, though a dynobench model of that name is a disc.
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


def read_dbcbs(path: str | os.PathLike[str]) -> Problem:
    """Read a problem of db-CBS or dynobench.

    Discs move in the plane and rectangles in SE(2), both as they please: what a state holds beyond position
    and heading (speeds), and a disc's heading, is dropped.

    Args:
        path: The ``.yaml`` file.

    Returns:
        The problem.

    Raises:
        ValueError: If the file is no such problem, has a robot or obstacle of unknown type (trailers, for
            one), or describes an impossible problem, such as two robots with one goal.
        OSError: If the file cannot be read.

    References:
        A. Moldagalieva, J. Ortiz-Haro, M. Toussaint, W. Hönig, "db-CBS: Discontinuity-Bounded
        Conflict-Based Search for Multi-Robot Kinodynamic Motion Planning", ICRA 2024.
    """
    path = Path(path)
    data = _read_yaml(path)
    try:
        if not isinstance(data, dict) or not {"environment", "robots"} <= set(data):
            raise ValueError('expected the keys "environment" and "robots".')
        robots = [_robot(i, entry) for i, entry in enumerate(_list("robots", data["robots"]))]
        dof = team_dof(robots)
        starts, goals = (
            [_state(i, key, entry[key], robots[i], dof) for i, entry in enumerate(data["robots"])]
            for key in ("start", "goal")
        )
        return Problem(_workspace(data["environment"]), robots, starts, goals)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_trajectories(path: str | os.PathLike[str]) -> Float[np.ndarray, "steps robots 3"]:
    """Read a solution of db-CBS or dynobench as a path.

    Args:
        path: The ``.yaml`` file: one trajectory, or a list of them under ``"result"``.

    Returns:
        Positions and headings ``(steps, robots, 3)``, one row a time step. A robot that is done waits where
        it is. What a state holds beyond them is dropped.

    Raises:
        ValueError: If the file is no such solution.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    data = _read_yaml(path)
    try:
        results = data.get("result", [data])
        tracks = [
            np.array([state[:3] for state in result["states"]], dtype=np.float64).reshape(-1, 3) for result in results
        ]
        steps = max(map(len, tracks))
        if min(map(len, tracks)) == 0:
            raise ValueError
        return np.stack([track[np.minimum(np.arange(steps), len(track) - 1)] for track in tracks], axis=1)
    except (AttributeError, TypeError, KeyError, IndexError, ValueError):
        raise ValueError(
            f"{path}: expected trajectories, each with a list of states [x, y, heading, ...] under 'states'."
        ) from None


def _read_yaml(path: Path) -> Any:
    import yaml

    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected YAML ({error}).") from None


def _list(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f'expected "{name}" to be a list, got {value!r:.80}.')
    return value


def _robot(i: int, entry: Any) -> Robot:
    if not isinstance(entry, dict) or not {"type", "start", "goal"} <= set(entry):
        raise ValueError(f'expected robot {i} to have the keys "type", "start" and "goal", got {entry!r:.80}.')
    if entry["type"] not in _SHAPES:
        raise ValueError(f"robot {i} has type {entry['type']!r}; known are {', '.join(_SHAPES)}.")
    return _SHAPES[entry["type"]]


def _state(i: int, key: str, state: Any, robot: Robot, dof: int) -> list[float]:
    """Position and, where the team has one, heading."""
    needed = robot.dof
    numbers = isinstance(state, list) and all(isinstance(x, int | float) for x in state)
    if not numbers or len(state) < needed:
        raise ValueError(f"expected robot {i} to have a {key} of at least {needed} numbers, got {state!r:.80}.")
    return [*map(float, state[:needed]), 0.0][:dof]


def _workspace(environment: Any) -> Workspace:
    if not isinstance(environment, dict) or not {"min", "max"} <= set(environment):
        raise ValueError(f'expected "environment" to have the keys "min" and "max", got {environment!r:.80}.')
    obstacles = [_box(i, entry) for i, entry in enumerate(_list("obstacles", environment.get("obstacles") or []))]
    return Workspace((environment["min"], environment["max"]), obstacles)


def _box(i: int, entry: Any) -> Float[np.ndarray, "4 2"]:
    try:
        if entry["type"] != "box":
            raise ValueError
        center, size = np.array([entry["center"], entry["size"]], dtype=np.float64).reshape(2, 2)
    except (TypeError, KeyError, ValueError):
        raise ValueError(f"expected obstacle {i} to be a box with a center and a size, got {entry!r:.80}.") from None
    return center + 0.5 * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
