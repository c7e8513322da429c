"""Scenes, which are planning problems: scene files, ready-made scenes, and random variants of a scene.

A scene file is JSON, in the format that :func:`load` describes. The ready-made scenes are those of the paper and of
the experiments. Most of them are files in the folder ``published``; a door and a crowd are generated for any team
size.
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_points, require_integer, shortened
from plr_jax._files import StrPath, errors_named, format_name, json_of, require_format, write_atomically
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import DiscRobot, PointRobot, PolygonRobot, RectangleRobot, Robot

_KIND = "scene"
_VERSION = 3
_SHAPES: dict[str, tuple[type[Robot], tuple[str, ...], int]] = {  # class, fields, first version of the format
    "point": (PointRobot, (), 1),
    "disc": (DiscRobot, ("radius",), 2),
    "rectangle": (RectangleRobot, ("length", "width"), 2),
    "polygon": (PolygonRobot, ("vertices",), 3),
}


def save(problem: Problem, path: StrPath) -> None:
    """Write a problem as a scene file, usually ``.json``; an interrupted write leaves no partial file.

    ``ValueError`` is raised if the format lacks a robot's shape, ``OSError`` if the file cannot be written.
    """
    weight = problem.rotation_weight
    entries = [_robot_entry(i, robot) for i, robot in enumerate(problem.robots)]
    scene = {
        "format": format_name(_KIND),
        "version": max(1 if weight is None else 2, *(_SHAPES[entry["shape"]][2] for entry in entries)),
        "workspace": workspace_entry(problem.workspace),
        "robots": entries,
        "starts": problem.starts.tolist(),
        "goals": problem.goals.tolist(),
        **({} if weight is None else {"rotation_weight": weight}),
    }
    write_atomically(Path(path), (json.dumps(scene, indent=1) + "\n").encode())


def load(path: StrPath) -> Problem:
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
        require_format(scene, _KIND, _VERSION, ("workspace", "robots", "starts", "goals"))
        if not isinstance(scene["robots"], list):
            raise ValueError(f'expected "robots" to be a list, got {shortened(scene["robots"])}.')
        robots = [_read_robot(i, entry, scene["version"]) for i, entry in enumerate(scene["robots"])]
        weight = scene.get("rotation_weight") if scene["version"] > 1 else None
        return Problem(read_workspace_entry(scene["workspace"]), robots, scene["starts"], scene["goals"], weight)


def is_scene(path: StrPath) -> bool:
    """Return whether the file ``path`` is JSON that declares itself a scene of this format, of any version."""
    with suppress(ValueError):
        scene = json_of(Path(path))
        return isinstance(scene, dict) and scene.get("format") == format_name(_KIND)
    return False


def _robot_entry(i: int, robot: Robot) -> dict[str, Any]:
    for shape, (robot_class, fields, _) in _SHAPES.items():
        if type(robot) is robot_class:
            return {"shape": shape, **{field: np.asarray(getattr(robot, field)).tolist() for field in fields}}
    raise ValueError(f"Robot {i} must have one of the shapes {', '.join(_SHAPES)} to be saved, got {robot!r}.")


def _read_robot(i: int, entry: Any, version: int) -> Robot:
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


def workspace_entry(workspace: Workspace) -> dict[str, Any]:
    obstacles = []
    for polygon in shapely.get_parts(workspace.obstacles):
        if not polygon.is_empty:
            outer, *holes = (shapely.get_coordinates(ring)[:-1].tolist() for ring in shapely.get_rings(polygon))
            obstacles.append({"outer": outer, "holes": holes})
    bounds = [workspace.bounds.lo.tolist(), workspace.bounds.hi.tolist()]
    return {"bounds": bounds, "squeeze": workspace.squeeze, "obstacles": obstacles}


def read_workspace_entry(entry: Any) -> Workspace:
    """Make the workspace of a scene from its entry in a decoded JSON file."""
    keys = ("bounds", "obstacles", "squeeze")
    if not isinstance(entry, dict) or any(key not in entry for key in keys):
        raise ValueError(f'expected "workspace" to have the keys {", ".join(keys)}, got {shortened(entry)}.')
    bounds, obstacles, squeeze = (entry[key] for key in keys)
    if not isinstance(squeeze, bool):
        raise ValueError(f'expected "squeeze" to be true or false, got {shortened(squeeze)}.')
    if not isinstance(obstacles, list):
        raise ValueError(f'expected "obstacles" to be a list, got {shortened(obstacles)}.')
    return Workspace(bounds, [_read_obstacle(i, obstacle) for i, obstacle in enumerate(obstacles)], squeeze=squeeze)


def _read_obstacle(i: int, entry: Any) -> Any:
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


_MOST_MOVES = 1000  # random moves that are tried for a start or goal of a variant


def perturbed(problem: Problem, seed: int, distance: float | int = 0.1) -> Problem:
    """Return a variant of a problem with its starts and goals moved slightly, all still free.

    Positions move by at most ``distance``, in workspace units, and headings by at most ``distance / r`` radians,
    where ``r`` is the robot's circumscribed radius. An argument out of range, or no free variant, raises
    ``ValueError``.
    """
    as_finite("distance", distance, positive=True)
    require_integer("seed", seed, 0)
    rng = np.random.default_rng(seed)
    for i, end in np.ndindex(len(problem.robots), 2):
        problem = _moved(problem, end, i, rng, distance)
    return problem


def _moved(problem: Problem, end: int, i: int, rng: np.random.Generator, distance: float | int) -> Problem:
    """Return the problem with the start (``end`` 0) or goal (``end`` 1) of robot ``i`` moved to a random free place.

    The new place is at most ``distance`` away, in workspace units. If the robot can turn, its heading changes, too.
    """
    # The square root makes the random positions uniform in the disc of radius `distance`.
    for _ in range(_MOST_MOVES):
        ends = np.stack([problem.starts, problem.goals])
        angle, radius = rng.uniform(0, 2 * np.pi), distance * np.sqrt(rng.uniform())
        ends[end, i, :2] += radius * np.array([np.cos(angle), np.sin(angle)])
        if problem.robots[i].dof == 3:
            ends[end, i, 2] += rng.uniform(-1, 1) * distance / problem.robots[i].circumscribed_radius
        with suppress(ValueError):
            return Problem(problem.workspace, problem.robots, ends[0], ends[1], problem.rotation_weight)
    name = ("start", "goal")[end]
    raise ValueError(f"Robot {i} has no other free {name} within {distance:g} in {_MOST_MOVES:,} attempts.")


_RADIUS = 0.4  # radius of the discs at a door and in a crowd
_MOST_AT_A_DOOR = 50  # largest number of robots
# The obstacles beside a door.
_WALLS = [[(10.0, y0), (11.0, y0), (11.0, y1), (10.0, y1)] for y0, y1 in ((0.0, 9.4), (10.6, 20.0))]
_COVERED = 0.15  # share of the square that a crowd covers
_CLEAR = 0.05  # smallest gap between discs of a crowd, and to walls
_MOST_TRIALS = 1_000_000  # random positions that are tried for the starts of a crowd, and for its goals


def door(num_robots: int) -> Problem:
    """Discs of radius 0.4 in two halls, 10 x 20 each, that change halls through one door, 1.5 diameters wide.

    The first half of the robots start in the left hall. The other half start at the mirror images of these places in
    the right hall. Each robot's goal is the mirror image of its start. ``ValueError`` is raised unless ``num_robots``
    is even, from 2 to 50.
    """
    require_integer("num_robots", num_robots, 2)
    if num_robots % 2 or num_robots > _MOST_AT_A_DOOR:
        raise ValueError(f"num_robots must be an even number from 2 to 50, got {num_robots!r}.")
    row, column = np.divmod(np.arange(num_robots // 2), 5)  # rows of five
    left = np.stack([1 + 1.7 * column, 2 + 3.9 * row], axis=1)
    right = left * (-1, 1) + (21, 0)
    starts, goals = np.concatenate([left, right]), np.concatenate([right, left])
    return Problem(Workspace(((0, 0), (21, 20)), _WALLS), [DiscRobot(_RADIUS)] * num_robots, starts, goals)


def crowd(num_robots: int, seed: int = 0) -> Problem:
    """Discs of radius 0.4 that cover 15 % of an open square, with random starts and goals.

    Starts keep 0.05 clear of the walls and of one another, and so do goals. ``ValueError`` is raised if an argument
    is out of range or no positions are found.
    """
    require_integer("num_robots", num_robots, 1)
    require_integer("seed", seed, 0)
    side = np.sqrt(num_robots * np.pi * _RADIUS**2 / _COVERED)
    rng = np.random.default_rng(seed)
    starts, goals = (_scattered(num_robots, side, rng) for _ in range(2))
    return Problem(Workspace(((0, 0), (side, side)), []), [DiscRobot(_RADIUS)] * num_robots, starts, goals)


def _scattered(num_robots: int, side: float, rng: np.random.Generator) -> Float[np.ndarray, "robots 2"]:
    """Draw random centers of discs in a square of width ``side``, with gaps between discs and to the sides.

    The discs have radius 0.4; gaps are at least 0.05. ``ValueError`` if no positions are found.
    """
    places = np.empty((0, 2))
    margin = _RADIUS + _CLEAR
    for _ in range(_MOST_TRIALS):
        place = rng.uniform(margin, side - margin, 2)
        if (np.hypot(*(places - place).T) >= 2 * _RADIUS + _CLEAR).all():
            places = np.append(places, [place], axis=0)
            if len(places) == num_robots:
                return places
    raise ValueError(f"Found no positions for {num_robots} robots: try another seed.")


_FOLDER = Path(__file__).parent / "published"
# In the scenes of points, no wall lies on a dyadic line, where the side of a cell would coincide with the wall.


def maze() -> Problem:
    """A point robot that moves from (0.93, 0.95) to (0.06, 0.07) in the unit square, among six walls 0.04 thick."""
    return load(_FOLDER / "maze.json")


def thin_maze() -> Problem:
    """A point robot in the scene of :func:`maze` with walls 0.01 thick, across which distances jump."""
    return load(_FOLDER / "thin_maze.json")


def floor_plan() -> Problem:
    """A point robot that moves on a furnished office floor from the lounge (23.2, 11.6) to the kitchen (1.2, 1.2).

    The floor, 24 m x 15 m, has eleven rooms, walls 0.16 m thick, doors 0.8 to 1.4 m wide, and more than 200 corners.
    """
    return load(_FOLDER / "floor_plan.json")


def single_door() -> Problem:
    """A disc of radius 0.4 in two rooms, together 10 x 10, joined by a door 1.25 diameters wide."""
    return load(_FOLDER / "single_door.json")


def four_rooms(num_robots: int) -> Problem:
    """Discs of radius 0.4 that change rooms through a shared center, with doors 1.25 diameters wide.

    ``num_robots`` is 2 to 4, one per room, or 8, two per room; else ``ValueError``. Each disc goes to the opposite
    room.
    """
    return _load_team("four_rooms", num_robots, (2, 3, 4, 8))


def cross(num_robots: int) -> Problem:
    """Discs of radius 0.4 in two crossing hallways, 1.5 diameters wide: two discs cannot pass each other.

    ``num_robots`` is 2 or 3, else ``ValueError``. Two discs face each other in one hallway; a third is in the other.
    """
    return _load_team("cross", num_robots, (2, 3))


def tangle() -> Problem:
    """Two rectangles, 1.8 x 0.5, that swap places in a hallway with a bay on each side.

    The rectangles can neither pass each other nor turn in the hallway. Each bay is too narrow and too shallow to park
    in.
    """
    return load(_FOLDER / "tangle.json")


def _load_team(name: str, num_robots: int, numbers: tuple[int, ...]) -> Problem:
    if not isinstance(num_robots, int | np.integer) or num_robots not in numbers:
        raise ValueError(f"The scene {name} must have {', '.join(map(str, numbers))} robots, got {num_robots!r}.")
    return load(_FOLDER / f"{name}_{num_robots}.json")
