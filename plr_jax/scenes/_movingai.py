"""Read grid maps (``.map``) and lists of queries (``.scen``) of the Moving AI benchmarks."""

import os
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import shortened
from plr_jax._files import errors_named, text_of
from plr_jax.geometry.workspace import Workspace

_PASSABLE = ".GS"
_HEADER_LINES = 4
_SCEN_COLUMNS = 9


def read_map(path: str | os.PathLike[str], *, squeeze: bool = False) -> Workspace:
    """Read a Moving AI ``.map`` grid as a polygonal workspace; its bounds are the bounding box of the free cells.

    The cell in column ``x`` and row ``y`` of the file is the square ``[x, x + 1] x [y, y + 1]``. So a picture with
    ``y`` up shows the map upside down. Cells are free if they are ``.`` or ``G`` (ground), or ``S`` (swamp, at no
    extra cost). ``squeeze`` says whether a path may pass between two blocked cells that touch in one corner.
    ``ValueError`` is raised if the file is not a Moving AI map, its rows do not match its header, or no cell is free.

    References: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE TCIAIG 4(2), 2012;
    https://movingai.com/benchmarks/formats.html.
    """
    with errors_named(path) as file:
        return Workspace.from_mask(_passable_cells(text_of(file).splitlines()), tolerance=0, squeeze=squeeze)


def read_cells(path: str | os.PathLike[str]) -> Bool[np.ndarray, "rows columns"]:
    """Read which cells of a Moving AI ``.map`` grid are free, as a boolean array for :class:`GridGraph`.

    Rows are in the order of the file. Cells and errors are as for :func:`read_map`.
    """
    with errors_named(path) as file:
        return _passable_cells(text_of(file).splitlines())


def _passable_cells(lines: list[str]) -> Bool[np.ndarray, "rows columns"]:
    """Return which cells are passable, ``(rows, columns)``, given the lines of a ``.map`` file, in their order."""
    # 1. Read the numbers of rows and columns in the header.
    match [line.split() for line in lines[:_HEADER_LINES]]:
        case [["type", _], ["height", height], ["width", width], ["map"]] if (
            height.isdecimal() and width.isdecimal() and int(height) > 0 and int(width) > 0
        ):
            rows, columns = int(height), int(width)
        case _:
            header = "the lines 'type octile', 'height N', 'width N' and 'map'"
            got = shortened(lines[:_HEADER_LINES])
            raise ValueError(f"expected a Moving AI map that begins with {header}, got {got}.")
    # 2. Read the rows, one character per cell; more lines may follow.
    grid = lines[_HEADER_LINES : _HEADER_LINES + rows]
    if len(grid) < rows:
        raise ValueError(f"expected {rows} rows, as the header says, got {len(grid)}.")
    for number, line in enumerate(grid, start=_HEADER_LINES + 1):
        if len(line) != columns:
            raise ValueError(f"line {number}: expected {columns} cells, got {len(line)}.")
    free = np.isin(np.array([list(line) for line in grid]), list(_PASSABLE))
    if not free.any():
        raise ValueError(f"expected at least one passable cell (one of {', '.join(_PASSABLE)}), got none.")
    return free


@dataclass(frozen=True, eq=False)
class Scenario:
    """The queries of a Moving AI ``.scen`` file, one per row, in the order of the file.

    Attributes:
        map_name: Name of the map, as given in the file.
        starts, goals: Points, ``(n, 2)``, as in the file: the corner of each cell with the least ``x`` and ``y``. Add
            0.5 for the cell's center in the coordinates of :func:`read_map`. For a :class:`GridGraph` of
            :func:`read_cells`, the corners already select the right cells. In the closed free space, shortest paths
            between corners may be shorter than between centers.
        octile_lengths: Published lengths of shortest paths on the 8-connected grid, ``(n,)``, rounded to about six
            digits. Apart from rounding, a Euclidean shortest path is never longer.
    """

    map_name: str
    starts: Float[np.ndarray, "n 2"]
    goals: Float[np.ndarray, "n 2"]
    octile_lengths: Float[np.ndarray, " n"]


def read_scen(path: str | os.PathLike[str]) -> Scenario:
    """Read the queries of a Moving AI ``.scen`` file, whose points are corners of cells (see :class:`Scenario`).

    ``ValueError`` is raised if the file is invalid or has no queries.
    """
    with errors_named(path) as file:
        lines = text_of(file).splitlines()
        if not lines or lines[0].split()[:1] != ["version"]:
            raise ValueError("expected a Moving AI scenario, whose first line is 'version 1', got another file.")
        names, rows = [], []  # a row is start x, start y, goal x, goal y and octile length
        for number, line in enumerate(lines[1:], start=2):
            if not line.strip():
                continue
            # Fields are separated by tabs, or else by spaces, which names of maps do not hold then.
            fields = line.split("\t") if "\t" in line else line.split()
            try:
                numbers = [float(field) for field in fields[4:]]
            except ValueError:
                numbers = []
            if len(fields) != _SCEN_COLUMNS or not numbers or not np.isfinite(numbers).all():
                columns = "bucket, map, width, height, start x, start y, goal x, goal y and octile length"
                raise ValueError(f"line {number}: expected {columns}, got {shortened(line)}.")
            names.append(fields[1])
            rows.append(numbers)
        if not rows:
            raise ValueError("expected at least one query, got none.")
    table = np.array(rows)
    return Scenario(names[0], table[:, 0:2], table[:, 2:4], table[:, 4])
