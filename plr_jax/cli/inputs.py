"""Read and check what users give to commands: maps, goals, names of output files, and tables of points."""

import os
import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import plr_jax
from plr_jax.cli.app import reason_of, warn

SCENES = ("maze", "thin_maze", "floor_plan")
DEFAULT_BYTES = 4_096  # size limit of a file by default
PICTURES = (".png", ".pdf", ".svg")
_OPTION_TYPES = {"resolution": float, "threshold": float, "drop_specks": int, "polygons": str, "radius": float}
_BLOCK_BYTES = 1 << 20  # bytes of a table read at a time, which bounds the memory
_MOST_OF_ROW = 80  # most characters of a bad row in a warning
_TABLE_HEADER = re.compile(r"""([\s"'#]*[^\W\d][^,]*(,|$))+""")  # each field begins with a letter or _


def parse_goals(texts: Sequence[str], form: str = "X,Y") -> Float[np.ndarray, "goals dim"]:
    """Convert texts such as ``3,28``, numbers as in ``form``, to goals, ``(goals, dim)``; else ``ValueError``."""
    goals = np.empty(0)
    with suppress(ValueError):
        goals = np.array([text.split(",") for text in texts], float)
    if goals.shape != (len(texts), dim := form.count(",") + 1) or not np.isfinite(goals).all():
        expected = f"{dim} numbers {form} in one argument, such as {'1,' * (dim - 2)}3,28"
        raise ValueError(f"--goal must be {expected}, got {' and '.join(texts) or 'none'}.")
    return goals


def oracle_of(workspace: "plr_jax.Workspace", goals: Float[np.ndarray, "goals 2"]) -> Any:
    """Return the exact distance function to the goal, or to the nearest of several goals."""
    first: Any = plr_jax.VisibilityGraph(workspace, goals[0])
    return first if len(goals) == 1 else plr_jax.NearestGoal([first, *map(first.with_goal, goals[1:])])


class NamedMap(NamedTuple):
    """A map as given on the command line: a scene or a file, its goals, and the options with which it is read.

    ``name`` is the name of a scene or the path of a file. If ``goals`` is None, the scene's own goal is used.
    ``options`` has arguments of :func:`plr_jax.scenes.read_workspace`, and the ``radius`` of a disc robot, if any.
    """

    name: str
    goals: Float[np.ndarray, "goals 2"] | None
    options: dict[str, Any]

    @property
    def label(self) -> str:
        """The text that describes this map in a PLR's file, such as ``scan.png --goal=3,28 --resolution=0.05``."""
        words = [] if self.goals is None else ["--goal=" + ";".join(f"{x!r},{y!r}" for x, y in self.goals.tolist())]
        words += [f"--{key.replace('_', '-')}={value}" for key, value in self.options.items()]
        return shlex.join([self.name, *words])

    @classmethod
    def of_label(cls, label: str) -> "NamedMap | None":
        """Convert a text such as :attr:`label` back to the map that it describes; None if it describes no map."""
        with suppress(ValueError, KeyError):
            name, *words = shlex.split(label)
            arguments = dict(word.removeprefix("--").split("=", 1) for word in words)
            goals = parse_goals(arguments.pop("goal").split(";")) if "goal" in arguments else None
            options = {key.replace("-", "_"): value for key, value in arguments.items()}
            named = cls(name, goals, {key: _OPTION_TYPES[key](value) for key, value in options.items()})
            return named if name in SCENES or Path(name).suffix else None
        return None

    def read(self) -> tuple["plr_jax.Workspace", Float[np.ndarray, "goals 2"] | None]:
        """Return the workspace, with obstacles grown by the option ``radius``, and the goals.

        If :attr:`goals` is None, the goal is taken from a scene with one robot; other maps have no goals (None).
        """
        reading = {key: value for key, value in self.options.items() if key != "radius"}
        if self.name in SCENES:
            if reading:
                raise ValueError(f"{self.name} is a scene, which is read without options, got {', '.join(reading)}.")
            problem = getattr(plr_jax.scenes, self.name)()
            workspace = problem.workspace
        elif not Path(self.name).suffix:
            raise ValueError(f"MAP must be a scene ({', '.join(SCENES)}) or a file of a map, got {self.name!r}.")
        elif plr_jax.scenes.is_building(self.name):
            workspace, problem = plr_jax.scenes.read_building(self.name).plane, None
        else:
            workspace = plr_jax.scenes.read_workspace(self.name, **reading)
            problem = plr_jax.scenes.load(self.name) if plr_jax.scenes.is_scene(self.name) else None
        goals = self.goals
        if goals is None and problem is not None and len(problem.robots) == 1:
            goals = problem.goals[:, :2]
        return workspace.inflate(self.options.get("radius", 0.0)), goals


def read_map_of_file(
    file: Path, content: Any, map: str | None, *, is_needed: bool = False
) -> tuple["plr_jax.Workspace | None", Float[np.ndarray, "goals 2"] | None]:
    """Return the workspace and the goals of the map from which a PLR's file was built; None where they are unknown.

    ``content`` is the PLR in the file; its label names the map, the goals and the options. If ``map`` is given, it
    replaces the map's name. Otherwise, a map that does not exist under its name is searched for in the folder of the
    file. If the map cannot be read, ``ValueError`` is raised if ``map`` is given or ``is_needed``; else a warning is
    printed, and the workspace is None.
    """
    # 1. Find the map. The options of the label hold for another map too.
    named = NamedMap.of_label(getattr(content, "label", "")) or NamedMap(map or "", None, {})
    if not named.name:
        return None, None
    beside = file.parent / Path(named.name).name
    if map is not None:
        named = named._replace(name=map)
    elif named.name not in SCENES and not Path(named.name).exists() and beside.exists():
        named = named._replace(name=str(beside))
    # 2. Read it.
    try:
        return named.read()
    except (OSError, ValueError) as error:
        reason = reason_of(error).rstrip(".")
        message = f"the map that {file} was built from cannot be read ({reason}): name it with --map"
        if is_needed or map is not None:
            raise ValueError(f"{message}.") from error
        warn(f"{message}; drawn without its obstacles.")
        return None, named.goals


def check_output(path: Path | None, endings: Sequence[str] = (), inputs: Sequence[str | Path | None] = ()) -> None:
    """Raise a ``ValueError`` if an output file cannot be written, is one of ``inputs``, or has none of ``endings``.

    Commands call this function before the work starts. If ``endings`` is empty, any file name is accepted.
    """
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        raise ValueError(f"{path} must end in {' or '.join(endings)}.")
    if path.exists() and any(file is not None and Path(file).exists() and path.samefile(file) for file in inputs):
        raise ValueError(f"{path} is an input and must not be overwritten: name another output file.")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ValueError(f"{path} must be a file that you may write, in a folder that exists.")


def read_points(file: Any, name: str, dim: int) -> Iterator[Float[np.ndarray, "n dim"]]:
    """Yield the points of a table block by block: ``dim`` comma-separated numbers per line, after an optional header.

    ``file`` is a binary file, called ``name`` in messages. Blank lines are skipped. Rows that are not points become
    NaN; for each block, a warning names the first such row. ``ValueError`` is raised if the table has no rows.
    """
    expected = f"{dim} comma-separated numbers"
    may_be_header = is_empty = True
    num_lines = 0  # number of lines in earlier blocks
    for block in _blocks_of_lines(file):
        # 1. Number the lines of the block from 1, and drop blank ones, and the header if this is the first row.
        lines = block.split("\n")
        numbers = [number for number, line in enumerate(lines, 1) if line.strip()]
        rows = [lines[number - 1].strip() for number in numbers]
        if rows and may_be_header:
            may_be_header = False
            # A header looks like names, and cannot be read as numbers, as nan,inf can.
            if _TABLE_HEADER.fullmatch(rows[0]) and _parse_rows(rows[:1], dim)[1]:
                del rows[0], numbers[0]
        # 2. Read the numbers.
        if rows:
            is_empty = False
            points, bad = _parse_rows(rows, dim)
            if bad:
                where = f"{name}, line {num_lines + numbers[bad[0]]}"
                more = f", as for {len(bad) - 1:,} more rows" if len(bad) > 1 else ""
                warn(f"{where}: expected {expected}, got {rows[bad[0]][:_MOST_OF_ROW]!r}; the answer is nan{more}.")
            yield points
        num_lines += len(lines)
    if is_empty:
        raise ValueError(f"{name} has no points: expected {expected} in each line.")


def _blocks_of_lines(file: Any) -> Iterator[str]:
    """Yield the text of a binary file in blocks of whole lines.

    A block is yielded as soon as its lines arrive, so that rows typed into a pipe are answered at once.
    """
    rest = b""
    while data := file.read1(_BLOCK_BYTES):
        block, newline, rest = (rest + data).rpartition(b"\n")
        if newline:
            yield block.decode("utf-8-sig", "replace")
    yield rest.decode("utf-8-sig", "replace")


def _parse_rows(rows: list[str], dim: int) -> tuple[Float[np.ndarray, "n dim"], list[int]]:
    """Return the numbers of rows, NaN in bad rows, and the indices of bad rows.

    ``np.loadtxt`` reads many rows fast, but reads none if one is bad: then each half of the rows is read by itself.
    """
    with suppress(ValueError):
        if (read := np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)).shape == (len(rows), dim):
            return read, []
    if len(rows) == 1:
        return np.full((1, dim), np.nan), [0]
    half = len(rows) // 2
    (first, bad), (second, others) = _parse_rows(rows[:half], dim), _parse_rows(rows[half:], dim)
    return np.concatenate([first, second]), bad + [half + row for row in others]
