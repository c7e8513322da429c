"""The MAP of a command: what is read, how, and which goal is in it."""

import shlex
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from jaxtyping import Float

from plr_jax.cli._app import reason_of, warn
from plr_jax.cli._inputs import SCENES, parse_goal

if TYPE_CHECKING:
    from plr_jax._problem import Problem
    from plr_jax.geometry.box import Box
    from plr_jax.geometry.workspace import Workspace

_KINDS: dict[str, type] = {
    "resolution": float,
    "threshold": float,
    "drop_specks": int,
    "radius": float,
}  # of options; others are texts
_SPECK = 1e-5
"""Share of the map's area up to which an obstacle is called a speck."""
_SAME = 1e-6
"""In shares of their width boxes that are called the same may differ."""


@dataclass(frozen=True)
class NamedMap:
    """A map as a command names it. As text it is a part of a command line, from which it can be named again.

    Attributes:
        name: MAP: the name of a scene, or a file.
        goal: ``X,Y``; None: that of a scene of one robot, if it is one.
        resolution: As for the reader of such a file, and so are the others; None: the reader's own.
        radius: Of the disc whose center's distance is meant; None: that of a point.
    """

    name: str
    goal: str | None = None
    resolution: float | None = None
    threshold: float | None = None
    drop_specks: int | None = None
    polygons: str | None = None
    radius: float | None = None

    def __str__(self) -> str:
        return command_text(**vars(self))

    @classmethod
    def of(cls, text: str) -> "NamedMap":
        """The map that such a text names; ``ValueError`` if it is none."""
        given: dict[str, Any] = {}
        try:
            name, *options = shlex.split(text)
            for option in options:
                key, value = option.removeprefix("--").split("=", 1)
                key = key.replace("-", "_")
                given[key] = _KINDS.get(key, str)(value)
            named = cls(name, **given)
            named.given_goal()
        except (ValueError, TypeError):
            named = None
        if named is None or named._is_unknown:
            raise ValueError(f"expected a map and options of it, got {text!r}.")
        return named

    def to(self, goal: Float[np.ndarray, "2"]) -> "NamedMap":
        """The same with its goal said."""
        return replace(self, goal=",".join(repr(float(along)) for along in goal))

    @property
    def _reading(self) -> dict[str, Any]:
        """The options of the reader."""
        return {
            name: value
            for name, value in vars(self).items()
            if name not in ("name", "goal", "radius") and value is not None
        }

    @property
    def _is_unknown(self) -> bool:
        """Whether it is no map, by its name."""
        return self.name not in SCENES and not Path(self.name).suffix

    def given_goal(self) -> Float[np.ndarray, "2"] | None:
        """The goal, if it is said; ``ValueError`` if that is none."""
        return None if self.goal is None else parse_goal(self.goal)

    def is_of_pixels(self) -> bool:
        """Whether it is a picture or has one, as maps of map_server do."""
        from plr_jax.scenes import read_image, read_map_server
        from plr_jax.scenes._workspaces import reader_of

        return self.name not in SCENES and reader_of(Path(self.name)) in (read_image, read_map_server)

    def read(self) -> tuple["Workspace", Float[np.ndarray, "2"] | None]:
        """The workspace, of the center of a disc if there is a radius, and the goal if there is one.

        ``ValueError`` if MAP is neither the name of a scene nor the path of a file that can be read, or has no such
        option.
        """
        workspace, goal = self._read()
        return (workspace if self.radius is None else workspace.inflate(self.radius)), goal

    def _read(self) -> tuple["Workspace", Float[np.ndarray, "2"] | None]:
        given = self.given_goal()
        if self._is_unknown:
            raise ValueError(f"MAP must be a scene ({', '.join(SCENES)}) or a map's file, got {self.name!r}.")
        problem = self._problem()
        if problem is None:
            return self._read_file(given), given
        if self._reading:
            options = ", ".join(map(option_of, self._reading))
            raise ValueError(f"{self.name} is a scene, which is read as it is: leave out {options}.")
        own = problem.goals[0, :2] if len(problem.robots) == 1 else None
        return problem.workspace, own if given is None else given

    def _read_file(self, goal: Float[np.ndarray, "2"] | None) -> "Workspace":
        """The workspace in a file that is no scene, by options that its reader knows, and with room for the goal."""
        from plr_jax.scenes import read_geojson
        from plr_jax.scenes._workspaces import options_of, reader_of

        reader = reader_of(Path(self.name))
        known = options_of(reader)
        if unknown := ", ".join(option_of(key) for key in self._reading if key not in known):
            others = ", ".join(option_of(field.name) for field in fields(self) if field.name in known)
            raise ValueError(
                f"{self.name}: {unknown} is no option of maps of this kind; they have {others or 'none of these'}."
            )
        workspace = reader(Path(self.name), **self._reading)
        if reader is read_geojson and goal is not None and not workspace.bounds.contains(goal[None])[0]:
            raise ValueError(
                f"The goal {goal.tolist()} lies outside the bounds {workspace.bounds} of {self.name}: give the file "
                'a "bbox" with room for it; without one the bounds are those of its polygons.'
            )
        return workspace

    def _problem(self) -> "Problem | None":
        """The scene that it is, if it is one."""
        from plr_jax import scenes

        if self.name in SCENES:
            return getattr(scenes, self.name)()
        if Path(self.name).suffix == ".json" and scenes.is_scene(self.name):
            return scenes.load(self.name)
        return None


def command_text(name: str, **options: Any) -> str:
    """The part of a command line that names a map or a volume with the options that are given."""
    given = {key: value for key, value in options.items() if value is not None}
    return shlex.join([name, *(f"{option_of(key)}={value}" for key, value in given.items())])


def map_of_file(file: Path, label: str, name: str | None, **options: Any) -> NamedMap | None:
    """The map and the goal of a PLR's file; None if neither its label nor the user names a map.

    Args:
        file: The file. A map that its label names is looked for as it was named, and beside the file.
        label: The file's label.
        name: MAP, which the user names instead.
        **options: The goal and options of the reader that the user gives. Where they are None they are the label's;
            those of the reader if the map has the name of the label's.

    Raises:
        ValueError: If there are options of a map, but no map.
    """
    given = {key: value for key, value in options.items() if value is not None}
    try:
        own = NamedMap.of(label)
    except ValueError:
        own = None
    if name is None and own is None:
        if given:
            raise ValueError(
                f"{file} does not say of which map it is: {', '.join(map(option_of, given))} needs --map."
            )
        return None
    if own is None:
        return NamedMap(str(name), **given)
    if name is None:
        beside = file.parent / Path(own.name).name
        is_moved = own.name not in SCENES and not Path(own.name).exists() and beside.exists()
        name = str(beside) if is_moved else own.name
    elif Path(name).name != Path(own.name).name:
        own = NamedMap(name, own.goal)
    return replace(own, name=name, **given)


def read_map_of_file(
    file: Path, held: Any, name: str | None, *, goal: str | None, is_needed: bool, **reading: Any
) -> tuple["Workspace | None", Float[np.ndarray, "2"] | None]:
    """The workspace and the goal of :func:`map_of_file`, None where they are not said.

    A map that the label alone names may not be on this machine: it is left out, with a warning; ``ValueError`` if it
    ``is_needed``, or the user says how to read it. One of other bounds than what the file holds is warned of.
    """
    named = map_of_file(file, getattr(held, "label", ""), name, goal=goal, **reading)
    if named is None:
        return None, None
    given = named.given_goal()
    try:
        workspace, goal_point = named.read()
    except (OSError, ValueError) as error:
        if name is not None:
            raise
        reason = reason_of(error).rstrip(".")
        missing = f"the map that {file} was built of cannot be read ({reason}): name it with --map"
        if is_needed or any(value is not None for value in reading.values()):
            raise ValueError(f"{missing}.") from error
        warn(f"{missing}; drawn without its obstacles.")
        return None, given
    if not _same_box(workspace.bounds, held.domain):
        warn(
            f"the map is {workspace.bounds}, but {file} covers {held.domain}: it may be of another map, or of this "
            "one read with other options, such as --resolution."
        )
    return workspace, goal_point


def _same_box(one: "Box", other: "Box") -> bool:
    return one.dim == other.dim and all(
        np.allclose(a, b, rtol=0, atol=_SAME * one.width.max()) for a, b in ((one.lo, other.lo), (one.hi, other.hi))
    )


def option_of(key: str) -> str:
    """The option of a command that a field of a map is given by."""
    return f"--{key.replace('_', '-')}"


def say_vertices(workspace: "Workspace") -> None:
    """Print how many vertices a workspace has that pixels were made into, and how many of them are for specks."""
    import shapely

    parts = np.concatenate([shapely.get_parts(workspace.obstacles), shapely.get_parts(workspace.free_space)])
    small = parts[shapely.area(parts) <= _SPECK * np.prod(workspace.bounds.width)]
    specks = ""
    if len(small):
        of_them = int(np.sum(shapely.get_num_coordinates(small) - 1))
        specks = f", {of_them:,} of them of specks ({len(small):,}; --drop-specks N drops those of at most N pixels)"
    typer.echo(f"map     {len(workspace.boundary.vertices):,} vertices{specks}")
