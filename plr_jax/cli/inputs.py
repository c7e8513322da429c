"""Arguments and options of the commands: maps with the options of their readers, goals, output files."""

import errno
import os
import shlex
import stat
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from jaxtyping import Bool, Float

from plr_jax.cli.app import numbers_of, reason_of, warn

if TYPE_CHECKING:
    from plr_jax import NearestGoal, VisibilityGraph
    from plr_jax.geometry.workspace import Workspace

SCENES = ("maze", "thin_maze", "floor_plan")
DEFAULT_BYTES = 4_096  # size limit of a file by default
PICTURES = (".png", ".pdf", ".svg")
_VOLUMES = (".npy", ".3dmap", ".stl", ".obj", ".ply")  # supported in Python only
_SAME_BOX = 1e-6  # boxes that differ by less than this share of their width count as equal
_OPTION_TYPES = {"resolution": float, "threshold": float, "drop_specks": int, "radius": float}  # others: str

MapArgument = Annotated[
    str,
    typer.Argument(
        metavar="MAP",
        help=f"A scene ({', '.join(SCENES)}) or a file: a picture (.png, .pgm, ...), a map of map_server (.yaml; "
        'costs are ignored), GeoJSON (.geojson, .json; bounded by its "bbox", or else by its polygons), well-known '
        "text (.wkt), a Moving AI grid (.map), polygons with holes (.json), a scene (.json).",
        show_default=False,
        autocompletion=lambda: list(SCENES),
    ),
]
FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A file of a PLR or of pairs.", show_default=False)
]
GoalOption = Annotated[
    list[str] | None,
    typer.Option(
        "--goal",
        "-g",
        metavar="X,Y",
        help="The goal; given several times, the nearest of several goals, such as exits. Scenes of one robot and "
        "files of PLRs have a default goal.",
        show_default=False,
    ),
]


def choices(names: Sequence[str]) -> dict[str, Any]:
    return {"metavar": f"[{'|'.join(names)}]", "autocompletion": lambda: list(names)}


def _reading_option(help: str, default: str, **others: Any) -> Any:
    return typer.Option(help=help, show_default=default, rich_help_panel="How MAP is read", **others)


ResolutionOption = Annotated[float | None, _reading_option("Side of a pixel of a picture, in workspace units.", "1")]
ThresholdOption = Annotated[
    float | None, _reading_option("Lightness above which a pixel is free, from 0 (black) to 1 (white).", "0.5")
]
DropSpecksOption = Annotated[
    int | None, _reading_option("Drop obstacles and free components of at most this many pixels.", "0")
]
PolygonsOption = Annotated[
    str | None,
    _reading_option(
        "Whether polygons are obstacles or free space.",
        "obstacles in GeoJSON, free in .wkt",
        **choices(("obstacles", "free")),
    ),
]
RadiusOption = Annotated[
    float | None,
    _reading_option(
        "Radius of a disc robot, in workspace units; distances are for its center. Error bounds are proven for the "
        "grown obstacles, whose round corners are polygons; outlines of pictures may be off by half a pixel.",
        "0, a point",
    ),
]


def parse_goals(text: str) -> Float[np.ndarray, "goals 2"]:
    goals = []
    for goal in text.split(";"):
        goals.append(numbers_of(goal))
        if len(goals[-1]) != 2 or not np.isfinite(goals[-1]).all():
            raise ValueError(f"--goal must be two numbers X,Y in one argument, such as 3,28, got {goal!r}.")
    return np.array(goals)


def joined_goals(goals: list[str] | None) -> str | None:
    return ";".join(goals) if goals else None


def oracle_of(workspace: "Workspace", goals: Float[np.ndarray, "goals 2"]) -> "VisibilityGraph | NearestGoal":
    from plr_jax import NearestGoal, VisibilityGraph

    first: Any = VisibilityGraph(workspace, goals[0])
    return first if len(goals) == 1 else NearestGoal([first, *map(first.with_goal, goals[1:])])


def option_of(key: str) -> str:
    return f"--{key.replace('_', '-')}"


@dataclass(frozen=True)
class NamedMap:
    """A map, goal and options (None: defaults), as on the command line; ``str`` returns the label in files."""

    name: str
    goal: str | None = None
    resolution: float | None = None
    threshold: float | None = None
    drop_specks: int | None = None
    polygons: str | None = None
    radius: float | None = None

    def __str__(self) -> str:
        return shlex.join([self.name, *(f"{option_of(key)}={value}" for key, value in self.given_options().items())])

    @classmethod
    def parse(cls, text: str) -> "NamedMap":
        try:
            name, *options = shlex.split(text)
            pairs = [option.removeprefix("--").split("=", 1) for option in options]
            given = {key.replace("-", "_"): value for key, value in pairs}
            named = cls(name, **{key: _OPTION_TYPES.get(key, str)(value) for key, value in given.items()})  # type: ignore[reportArgumentType]
            if named.goal is not None:
                parse_goals(named.goal)
        except (ValueError, TypeError, IndexError):
            named = None
        if named is None or (named.name not in SCENES and not Path(named.name).suffix):
            raise ValueError(f"expected a map and its options, such as 'scan.png --resolution=0.05', got {text!r}.")
        return named

    def given_options(self) -> dict[str, Any]:
        fields_of_map = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        return {key: value for key, value in fields_of_map.items() if value is not None}

    def free_pixels(self) -> Bool[np.ndarray, "rows columns"] | None:
        from plr_jax.scenes._pictures import PICTURE_ENDINGS, YAML_ENDINGS, free_pixels

        if self.name in SCENES or Path(self.name).suffix.lower() not in (*PICTURE_ENDINGS, *YAML_ENDINGS):
            return None
        return free_pixels(Path(self.name), *([] if self.threshold is None else [self.threshold]))

    def read(self) -> tuple["Workspace", Float[np.ndarray, "goals 2"] | None]:
        """Return the map's workspace, inflated by the option ``radius``, and the goals, or None without goals."""
        from plr_jax import scenes

        if Path(self.name).suffix.lower() in _VOLUMES:
            raise ValueError(
                f"MAP must be a map in the plane, got the volume {self.name}: in Python use solve_eikonal with "
                "VoxelSpace(scenes.read_volume(...))."
            )
        goals = None if self.goal is None else parse_goals(self.goal)
        reading = {key: value for key, value in self.given_options().items() if key not in ("goal", "radius")}
        if self.name not in SCENES and not Path(self.name).suffix:
            raise ValueError(f"MAP must be a scene ({', '.join(SCENES)}) or a file of a map, got {self.name!r}.")
        if self.name in SCENES or (Path(self.name).suffix.lower() == ".json" and scenes.is_scene(self.name)):
            if reading:
                options = ", ".join(map(option_of, reading))
                raise ValueError(f"{self.name} is a scene, which has no options of a reader: leave out {options}.")
            problem = getattr(scenes, self.name)() if self.name in SCENES else scenes.load(self.name)
            workspace = problem.workspace
            if goals is None and len(problem.robots) == 1:
                goals = problem.goals[:, :2]
        else:
            workspace = self._read_file(reading, goals)
        return (workspace if self.radius is None else workspace.inflate(self.radius)), goals

    def _read_file(self, reading: dict[str, Any], goals: Float[np.ndarray, "goals 2"] | None) -> "Workspace":
        from plr_jax.scenes import read_geojson
        from plr_jax.scenes._workspaces import options_of, reader_of

        reader = reader_of(Path(self.name))
        known = options_of(reader)
        if unknown := ", ".join(option_of(key) for key in reading if key not in known):
            others = ", ".join(option_of(field.name) for field in fields(self) if field.name in known)
            raise ValueError(
                f"{self.name}: expected options of this kind of map ({others or 'none'}), got {unknown}."
            )
        workspace = reader(Path(self.name), **reading)
        if reader is read_geojson and goals is not None and not workspace.bounds.contains(goals).all():
            raise ValueError(
                f"The goal must be within the bounds {workspace.bounds} of {self.name}, got {self.goal}: give "
                'the file a "bbox" that contains it. Without one, the bounds are the bounding box of its polygons.'
            )
        return workspace


def read_map_of_file(
    file: Path, content: Any, map_text: str | None, goal: str | None, *, is_needed: bool
) -> tuple["Workspace | None", Float[np.ndarray, "goals 2"] | None]:
    """Return the workspace and the goals from which a file of distances was built; None for what is not known.

    The file's label names them; the user's ``map_text`` (MAP and options) and ``goal`` override the label. A map is
    also looked for beside ``file``. If a map that is not needed cannot be read, a warning is shown.
    """
    try:
        labeled = NamedMap.parse(getattr(content, "label", ""))
    except ValueError:
        labeled = None
    if map_text is not None:
        named = NamedMap.parse(map_text)
        if labeled is not None and Path(named.name).name == Path(labeled.name).name:
            named = replace(labeled, name=named.name, **named.given_options())
        elif labeled is not None:
            named = replace(named, goal=named.goal or labeled.goal)
    elif labeled is not None:
        beside = file.parent / Path(labeled.name).name
        is_moved = labeled.name not in SCENES and not Path(labeled.name).exists() and beside.exists()
        named = replace(labeled, name=str(beside)) if is_moved else labeled
    elif goal is not None:
        raise ValueError(f"{file} does not name its map: give --map together with --goal.")
    else:
        return None, None
    named = replace(named, goal=goal or named.goal)
    try:
        workspace, targets = named.read()
    except (OSError, ValueError) as error:
        if map_text is not None:
            raise
        reason = reason_of(error).rstrip(".")
        missing = f"the map that {file} was built from cannot be read ({reason}): name it with --map"
        if is_needed:
            raise ValueError(f"{missing}.") from error
        warn(f"{missing}; drawn without its obstacles.")
        return None, None if named.goal is None else parse_goals(named.goal)
    ours, theirs = workspace.bounds, content.domain
    if ours.dim != theirs.dim or not np.allclose(
        [ours.lo, ours.hi], [theirs.lo, theirs.hi], rtol=0, atol=_SAME_BOX * ours.width.max()
    ):
        warn(
            f"the map covers {ours}, but {file} covers {theirs}: it may be another map, or this map read with "
            "other options, such as --resolution."
        )
    return workspace, targets


def require_writable(
    path: Path | None, endings: Sequence[str] = (), *, inputs: Sequence[str | Path | None] = ()
) -> None:
    """Raise an error if a file cannot be written, is one of the inputs, or has none of the ``endings``, if any."""
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
            raise ValueError(f"{path} is an input and must not be overwritten: name another output file.")
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "No such folder", str(path.parent))
    # A file is replaced by a new one in its folder, but a device or pipe is written to directly.
    places = [path] * (mode is not None) + [folder] * (mode is None or stat.S_ISREG(mode))
    if not all(os.access(place, os.W_OK) for place in places):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
