"""Readers of grid maps (``.map``) of the Moving AI benchmarks."""

import os

import numpy as np
from jaxtyping import Bool

from plr_jax._arrays import shortened
from plr_jax._files import errors_named, text_of
from plr_jax.geometry.workspace import Workspace

_PASSABLE = ".GS"
_HEADER_LINES = 4


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

    Rows are in the order of the file. Cells and errors are as for :func:`read_map`. The starts, goals and published
    lengths of a ``.scen`` file are ``np.loadtxt(path, skiprows=1, usecols=range(4, 9))``.
    Its points are cells of a :class:`GridGraph`; add 0.5 for the centers of these cells in :func:`read_map`.
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
