"""What the commands are given: scenes, goals, points, names of files to write."""

import errno
import os
import re
import stat
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from plr_jax._problem import Problem

SCENES = ("maze", "thin_maze", "floor_plan")
TEAM_SCENES = ("single_door", "four_rooms", "cross", "tangle", *SCENES)
BEST = "best"
LEAVES = (BEST, "plane", "continuous", "smooth", "cone")
DEFAULT_BYTES = 4_096
"""Largest size of a PLR that a command makes, where no limit is given."""

PICTURES = (".png", ".pdf", ".svg")
_NUMBER = re.compile(r"\s*[-+]?((\d+(\.\d*)?|\.\d+)(e[-+]?\d+)?|inf(inity)?|nan)\s*", re.ASCII | re.IGNORECASE)
_POINTS = {
    1: ("one number", "X", "3"),
    2: ("two numbers", "X,Y", "3,28"),
    3: ("three numbers", "X,Y,Z", "3,28,5"),
    4: ("four numbers", "X,Y,Z,W", "3,28,5,1"),
}
"""How many numbers the points of so many axes are, what they are called, and an example."""
_DEFAULT_ROBOTS = {"four_rooms": 4, "cross": 2}


class Heuristic(StrEnum):
    """The heuristics that ``plr-jax plan`` knows."""

    lattice = "lattice"
    none = "none"
    straight_line = "straight-line"
    point_plr = "point-plr"
    plr = "plr"
    oracle = "oracle"


def read_problem(name: str, num_robots: int | None) -> "Problem":
    """The problem that a SCENE argument means: a scene, of its default size if it has several, or a file.

    ``ValueError`` if it is none of these, has no such number of robots, or is impossible.
    """
    from plr_jax import scenes

    if num_robots is not None and name not in _DEFAULT_ROBOTS:
        raise ValueError(f"--robots is for the scenes {' and '.join(_DEFAULT_ROBOTS)}, not for {name!r}.")
    if name in _DEFAULT_ROBOTS:
        return getattr(scenes, name)(_DEFAULT_ROBOTS[name] if num_robots is None else num_robots)
    if name in TEAM_SCENES:
        return getattr(scenes, name)()
    match Path(name).suffix:
        case ".json":
            return scenes.load(name)
        case ".yaml" | ".yml":
            return scenes.read_dbcbs(name)
    raise ValueError(
        f"SCENE must be a scene ({', '.join(TEAM_SCENES)}) or a file ending in .json or .yaml, got {name!r}."
    )


def require_writable(
    path: Path | None, endings: Sequence[str] = (), *, inputs: Sequence[str | Path | None] = ()
) -> None:
    """Refuse a file that cannot be written before the work that it would hold is done, or whose name ends otherwise.

    None is nothing to write; where there are no endings, any will do. No file is written over one of the inputs.
    """
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        raise ValueError(f"{path} must end in {' or '.join(endings)}.")
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        mode = None
    folder = path.resolve().parent
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    for file in inputs:
        if mode is not None and file is not None and os.path.exists(file) and os.path.samefile(file, path):
            raise ValueError(f"{path} is read, and would be written over: name another file to write.")
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "No such folder", str(path.parent))
    # A file is replaced by a new one in its folder, but a device or a pipe is written to.
    places = [path] * (mode is not None) + [folder] * (mode is None or stat.S_ISREG(mode))
    if not all(os.access(place, os.W_OK) for place in places):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def parse_goal(text: str, num_axes: int = 2) -> Float[np.ndarray, "num_axes"]:
    """The point that ``X,Y`` means, or one of another number of coordinates."""
    goal = np.array(numbers_of(text))
    if goal.shape != (num_axes,) or not np.isfinite(goal).all():
        many, names, example = _POINTS[num_axes]
        raise ValueError(f"--goal must be {many} {names} in one argument, such as {example}, got {text!r}.")
    return goal


def numbers_of(line: str) -> list[float]:
    """The comma-separated numbers of a line, ``nan`` and ``inf`` among them; none if a field is not one.

    They are decimal, of ASCII, with spaces around them or not: ``1_000``, which Python reads, is none.
    """
    fields = line.split(",")
    return [float(field) for field in fields] if all(map(_NUMBER.fullmatch, fields)) else []
