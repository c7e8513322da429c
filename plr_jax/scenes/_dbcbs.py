"""Readers of the YAML problems and solutions of db-CBS and dynobench.

Both are benchmarks of kinodynamic planning; here their robots are holonomic, with the shapes they have there.
"""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax._files import errors_named, yaml_of
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import DiscRobot, RectangleRobot, Robot, team_dof

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
_MOST_CONFIGURATIONS = 10**7  # trajectories are filled up to the longest, so a small file could mean a huge path
_EXPECTED = "expected trajectories, each with a list of states [x, y, heading, ...] of finite numbers under 'states'"


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
    with errors_named(path):
        data = yaml_of(path)
        if not isinstance(data, dict) or not {"environment", "robots"} <= set(data):
            raise ValueError('expected the keys "environment" and "robots".')
        robots = [_robot(i, entry) for i, entry in enumerate(_list("robots", data["robots"]))]
        dof = team_dof(robots)
        starts, goals = (
            [_state(i, key, entry[key], robots[i], dof) for i, entry in enumerate(data["robots"])]
            for key in ("start", "goal")
        )
        return Problem(_workspace(data["environment"]), robots, starts, goals)


def read_trajectories(path: str | os.PathLike[str]) -> Float[np.ndarray, "steps robots 3"]:
    """Read a solution of db-CBS or dynobench as a path.

    Args:
        path: The ``.yaml`` file: one trajectory, or a list of them under ``"result"``.

    Returns:
        Positions and headings ``(steps, robots, 3)``, one row a time step. A robot that is done waits where
        it is. What a state holds beyond them is dropped. The path of a team without headings, of the problem that
        :func:`read_dbcbs` gives, is ``path[..., : problem.dof]``.

    Raises:
        ValueError: If the file is no such solution.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    with errors_named(path):
        data = yaml_of(path)
        result = data.get("result", [data]) if isinstance(data, dict) else [data]
        tracks = [_track(entry) for entry in _list("result", result)]
        steps = max(map(len, tracks), default=0)
        if not 0 < steps * len(tracks) <= _MOST_CONFIGURATIONS:
            raise ValueError(f"{_EXPECTED}, at most {_MOST_CONFIGURATIONS:,} together, got {len(tracks)} x {steps}.")
        return np.stack([track[np.minimum(np.arange(steps), len(track) - 1)] for track in tracks], axis=1)


def _track(entry: Any) -> Float[np.ndarray, "steps 3"]:
    states = entry.get("states") if isinstance(entry, dict) else None
    if not (isinstance(states, list) and states and all(_are_numbers(state, 3) for state in states)):
        raise ValueError(f"{_EXPECTED}, got {shortened(states)}.")
    return np.array([state[:3] for state in states], dtype=np.float64)


def _list(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f'expected "{name}" to be a list, got {shortened(value)}.')
    return value


def _robot(i: int, entry: Any) -> Robot:
    if not isinstance(entry, dict) or not {"type", "start", "goal"} <= set(entry):
        raise ValueError(f'expected robot {i} to have the keys "type", "start" and "goal", got {shortened(entry)}.')
    if not isinstance(entry["type"], str) or entry["type"] not in _SHAPES:
        raise ValueError(f"robot {i} has type {shortened(entry['type'])}; known are {', '.join(_SHAPES)}.")
    return _SHAPES[entry["type"]]


def _state(i: int, key: str, state: Any, robot: Robot, dof: int) -> list[float]:
    """Position and, where the team has one, heading."""
    needed = robot.dof
    if not _are_numbers(state, needed):
        raise ValueError(f"expected robot {i} to have a {key} of at least {needed} numbers, got {shortened(state)}.")
    return [*map(float, state[:needed]), 0.0][:dof]


def _workspace(environment: Any) -> Workspace:
    if not isinstance(environment, dict) or not {"min", "max"} <= set(environment):
        raise ValueError(f'expected "environment" to have the keys "min" and "max", got {shortened(environment)}.')
    obstacles = [_box(i, entry) for i, entry in enumerate(_list("obstacles", environment.get("obstacles") or []))]
    return Workspace((environment["min"], environment["max"]), obstacles)


def _box(i: int, entry: Any) -> Float[np.ndarray, "4 2"]:
    sides: list[Any] = [entry.get(key) for key in ("center", "size")] if isinstance(entry, dict) else []
    is_box = bool(sides) and entry.get("type") == "box"
    if not (is_box and all(_are_numbers(side, 2) and len(side) == 2 for side in sides)):
        raise ValueError(f"expected obstacle {i} to be a box with a center and a size, got {shortened(entry)}.")
    center, size = np.array(sides, dtype=np.float64)
    return center + 0.5 * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


def _are_numbers(value: Any, least: int) -> bool:
    """Whether a value is a list that begins with so many finite numbers."""
    return (
        isinstance(value, list)
        and len(value) >= least
        and all(isinstance(x, int | float) and math.isfinite(x) for x in value[:least])
    )
