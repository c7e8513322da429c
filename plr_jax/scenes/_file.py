"""The scene file: a problem stored as JSON, in the format that :func:`load` describes."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from plr_jax._arrays import as_finite, as_points, shortened
from plr_jax._files import errors_named, format_name, json_of, require_format, write_atomically
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import DiscRobot, PointRobot, PolygonRobot, RectangleRobot, Robot

_KIND = "scene"
_VERSION = 3
_SHAPES: dict[str, tuple[type[Robot], tuple[str, ...], int]] = {  # class, fields, first version of the format
    "point": (PointRobot, (), 1),
    "disc": (DiscRobot, ("radius",), 2),
    "rectangle": (RectangleRobot, ("length", "width"), 2),
    "polygon": (PolygonRobot, ("vertices",), 3),
}
_KEYS = ("workspace", "robots", "starts", "goals")


def save(problem: Problem, path: str | os.PathLike[str]) -> None:
    """Write a problem as a scene file, usually ``.json``; an interrupted write leaves no partial file.

    ``ValueError`` is raised if the format lacks a robot's shape, ``OSError`` if the file cannot be written.
    """
    weight = problem.rotation_weight
    entries = [_robot_entry(i, robot) for i, robot in enumerate(problem.robots)]
    scene = {
        "format": format_name(_KIND),
        "version": max(1 if weight is None else 2, *(_SHAPES[entry["shape"]][2] for entry in entries)),
        "workspace": _workspace_entry(problem.workspace),
        "robots": entries,
        "starts": problem.starts.tolist(),
        "goals": problem.goals.tolist(),
        **({} if weight is None else {"rotation_weight": weight}),
    }
    write_atomically(Path(path), (json.dumps(scene, indent=1) + "\n").encode())


def load(path: str | os.PathLike[str]) -> Problem:
    """Read a problem from a scene file.

    A file of version 3 is one object with these keys; coordinates are in workspace units, headings in radians::

        "format":     "plr_jax scene"
        "version":    3
        "workspace":  {"bounds": [[x0, y0], [x1, y1]],
                       "squeeze": whether paths may pass between obstacles that touch in one point,
                       "obstacles": [{"outer": ring, "holes": [ring, ...]}, ...]}
        "robots":     [{"shape": "point"} or {"shape": "disc", "radius": r}
                       or {"shape": "rectangle", "length": l, "width": w}
                       or {"shape": "polygon", "vertices": ring}, ...]
        "starts":     [[x, y], ...]     one configuration per robot; [x, y, heading] if any robot has a heading
        "goals":      [[x, y], ...]
        "rotation_weight": cost of a turn by one radian; optional, by default a robot's circumscribed radius

    A ring is a list of points ``[x, y]``. ``"holes"`` are optional. Obstacles may overlap and leave the bounds.
    Version 1 has only points and no ``"rotation_weight"``; version 2 has no polygons. :func:`save` writes the oldest
    sufficient version, and enough digits to read the same float64 numbers back. A file that is no scene, is damaged,
    has a newer version, or describes an impossible problem raises ``ValueError``.
    """
    with errors_named(path) as file:
        scene = json_of(file)
        require_format(scene, _KIND, _VERSION, _KEYS)
        if not isinstance(scene["robots"], list):
            raise ValueError(f'expected "robots" to be a list, got {shortened(scene["robots"])}.')
        robots = [_robot(i, entry, scene["version"]) for i, entry in enumerate(scene["robots"])]
        weight = scene.get("rotation_weight") if scene["version"] > 1 else None
        weight = None if weight is None else as_finite("rotation_weight", weight)
        return Problem(_workspace(scene["workspace"]), robots, scene["starts"], scene["goals"], weight)


def is_scene(path: str | os.PathLike[str]) -> bool:
    """Return whether the file ``path`` is JSON that declares itself a scene of this format, of any version."""
    try:
        scene = json_of(Path(path))
    except ValueError:
        return False
    return isinstance(scene, dict) and scene.get("format") == format_name(_KIND)


def _robot_entry(i: int, robot: Robot) -> dict[str, Any]:
    for shape, (robot_class, fields, _) in _SHAPES.items():
        if type(robot) is robot_class:
            return {"shape": shape, **{field: np.asarray(getattr(robot, field)).tolist() for field in fields}}
    raise ValueError(f"Robot {i} must have one of the shapes {', '.join(_SHAPES)} to be saved, got {robot!r}.")


def _robot(i: int, entry: Any, version: int) -> Robot:
    """Make robot ``i`` of a scene from its entry in a decoded JSON file of the given format ``version``."""
    fields_of = {shape: fields for shape, (_, fields, first_version) in _SHAPES.items() if first_version <= version}
    shape = str(entry.get("shape")) if isinstance(entry, dict) else ""
    if shape not in fields_of or set(entry) != {"shape", *fields_of[shape]}:
        forms = [str({"shape": name} | {field: f"<{field}>" for field in fields_of[name]}) for name in fields_of]
        got = f"in version {version}, got {shortened(entry)}"
        raise ValueError(f"expected robot {i} to be like {' or '.join(forms)} {got}.")
    try:
        return _SHAPES[shape][0](*(entry[field] for field in fields_of[shape]))
    except ValueError as error:
        raise ValueError(f"robot {i}: {error}") from None


def _workspace_entry(workspace: Workspace) -> dict[str, Any]:
    obstacles = []
    for polygon in shapely.get_parts(workspace.obstacles):
        if not polygon.is_empty:
            outer, *holes = (shapely.get_coordinates(ring)[:-1].tolist() for ring in shapely.get_rings(polygon))
            obstacles.append({"outer": outer, "holes": holes})
    bounds = [workspace.bounds.lo.tolist(), workspace.bounds.hi.tolist()]
    return {"bounds": bounds, "squeeze": workspace.squeeze, "obstacles": obstacles}


def _workspace(entry: Any) -> Workspace:
    """Make the workspace of a scene from its entry in a decoded JSON file."""
    keys = ("bounds", "obstacles", "squeeze")
    if not isinstance(entry, dict) or any(key not in entry for key in keys):
        raise ValueError(f'expected "workspace" to have the keys {", ".join(keys)}, got {shortened(entry)}.')
    bounds, obstacles, squeeze = (entry[key] for key in keys)
    if not isinstance(squeeze, bool):
        raise ValueError(f'expected "squeeze" to be true or false, got {shortened(squeeze)}.')
    if not isinstance(obstacles, list):
        raise ValueError(f'expected "obstacles" to be a list, got {shortened(obstacles)}.')
    return Workspace(bounds, [_obstacle(i, obstacle) for i, obstacle in enumerate(obstacles)], squeeze=squeeze)


def _obstacle(i: int, entry: Any) -> Any:
    """Return obstacle ``i`` of a scene from its entry in a decoded JSON file: a ring, or a polygon with holes."""
    if not isinstance(entry, dict) or "outer" not in entry or not isinstance(entry.get("holes", []), list):
        form = '{"outer": ring, "holes": [ring, ...]}'
        raise ValueError(f"expected obstacle {i} to be {form}, got {shortened(entry)}.")
    if not entry.get("holes"):
        return entry["outer"]
    try:
        outer, *holes = (as_points("it", ring, 2) for ring in [entry["outer"], *entry["holes"]])
        return shapely.Polygon(outer, holes)
    except ValueError as error:
        raise ValueError(f"expected rings of obstacle {i} to be lists of at least three points ({error}).") from None
