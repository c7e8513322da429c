"""Readers of grids of free and blocked cells: maps of the Moving AI benchmarks, and volumes of voxels."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool

from plr_jax._arrays import shortened
from plr_jax._files import StrPath, errors_named, text_of
from plr_jax.geometry.workspace import Workspace

_PASSABLE = ".GS"  # letters of free cells of a map
_HEADER_LINES = 4  # of a map
_MOST_VOXELS = 2**28
_MOST_RANK = 4
_MOST_LIST_BYTES = 2**25
_SMALL_LIST = 2**24  # voxels of a volume that a list of any size may have
_VOXELS_PER_BYTE = 2**8  # most voxels per byte of a list, for larger volumes


def read_map(path: StrPath, *, row0: str = "bottom", squeeze: bool = False) -> Workspace:
    """Read a Moving AI ``.map`` grid as a polygonal workspace; its bounds are the bounding box of the free cells.

    Rows of the file go down, while ``y`` goes up. ``row0`` says where the first row is:

    - ``"bottom"``: at the lowest ``y``. The cell in column ``x`` and row ``y`` is the square ``[x, x + 1] x
      [y, y + 1]``, and the point ``(x, y)`` of a ``.scen`` file has its center at ``(x + 0.5, y + 0.5)``. Plots show
      the map upside down.
    - ``"top"``: at the highest ``y``, so that plots show the map upright. In a map of ``height`` rows, the point
      ``(x, y)`` of a ``.scen`` file has its center at ``(x + 0.5, height - 0.5 - y)``.

    Cells are free if they are ``.`` or ``G`` (ground), or ``S`` (swamp, at no extra cost). ``squeeze`` says whether a
    path may pass between two blocked cells that touch in one corner. ``ValueError`` is raised if the file is not a
    Moving AI map, its rows do not match its header, no cell is free, or ``row0`` is another word.

    References: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE TCIAIG 4(2), 2012;
    https://movingai.com/benchmarks/formats.html.
    """
    cells = read_cells(path)
    with errors_named(path):
        return Workspace.from_mask(cells, row0=row0, tolerance=0, squeeze=squeeze)


def read_cells(path: StrPath) -> Bool[np.ndarray, "rows columns"]:
    """Read which cells of a Moving AI ``.map`` grid are free, as a boolean array for :class:`GridGraph`.

    Rows are in the order of the file, so ``y`` goes down in it. Cells and errors are as for :func:`read_map`. The
    starts, goals and published lengths of a ``.scen`` file are ``np.loadtxt(path, skiprows=1, usecols=range(4, 9))``.
    Its points are cells of a :class:`GridGraph`; :func:`read_map` says where their centers are in a workspace.
    """
    with errors_named(path) as file:
        lines = text_of(file).splitlines()
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
        if len(grid := lines[_HEADER_LINES : _HEADER_LINES + rows]) < rows:
            raise ValueError(f"expected {rows} rows, as the header says, got {len(grid)}.")
        for number, line in enumerate(grid, start=_HEADER_LINES + 1):
            if len(line) != columns:
                raise ValueError(f"line {number}: expected {columns} cells, got {len(line)}.")
        if not (free := np.isin(np.array([list(line) for line in grid]), list(_PASSABLE))).any():
            raise ValueError(f"expected at least one passable cell (one of {', '.join(_PASSABLE)}), got none.")
        return free


def read_volume(path: StrPath) -> Bool[np.ndarray, "..."]:
    """Read which voxels of a volume are free: a boolean array ``free[x, y, z]`` in C order.

    The file is of one of two kinds, by its ending:

    - ``.npy``: an array of one to four axes and at most 268,435,456 voxels: booleans or integers, 0 for blocked and 1
      for free. No pickles.
    - ``.3dmap``: voxels of the Moving AI benchmarks (Brewer and Sturtevant, SoCS 2018). The first line is
      ``voxel nx ny nz``; each other line has the indices ``x y z`` of a blocked voxel. At most 32 MiB and 268,435,456
      voxels; with more than 16,777,216 voxels, at most 256 voxels per byte of the file.

    Meshes become voxels by trimesh: ``free = ~trimesh.load_mesh(path).voxelized(pitch).fill().matrix``. A file that
    has another ending, is damaged or too large, or has no free voxel raises ``ValueError``.
    """
    with errors_named(path) as file:
        if (ending := file.suffix.lower()) not in (".npy", ".3dmap"):
            raise ValueError("expected a file that ends in .npy or .3dmap; trimesh turns meshes into voxels.")
        free = _read_voxel_array(file) if ending == ".npy" else _read_voxel_list(file)
        if not free.any():
            raise ValueError("expected at least one free voxel, got none.")
    return free


def _read_voxel_array(path: Path) -> Bool[np.ndarray, "..."]:
    """Read a boolean array, True for free voxels, from a ``.npy`` file of booleans, or integers 0 and 1."""
    try:  # memory-mapped: a header that promises more than the file holds fails early
        values = np.lib.format.open_memmap(path, mode="r")
    except OSError:
        raise
    except Exception as error:  # NumPy's header parser raises many kinds of errors
        raise ValueError(f"expected an array of NumPy, got something else or a damaged file ({error}).") from None
    if not 1 <= values.ndim <= _MOST_RANK or not 0 < values.size <= _MOST_VOXELS:
        expected = f"one to {_MOST_RANK} axes and one to {_MOST_VOXELS:,} voxels"
        raise ValueError(f"expected {expected}, got shape {shortened(values.shape)}.")
    numbers = values.view(np.uint8) if values.dtype == bool else values  # its bytes may be neither 0 nor 1
    if values.dtype.kind not in "biu" or numbers.min() < 0 or numbers.max() > 1:
        raise ValueError(f"expected booleans, or integers 0 and 1, got other values or type, {values.dtype}.")
    return np.array(numbers, dtype=bool, order="C")


def _read_voxel_list(path: Path) -> Bool[np.ndarray, "x y z"]:
    """Read a boolean array, True for free voxels, from a text file: the grid's shape, then the blocked voxels."""
    text = text_of(path, _MOST_LIST_BYTES)
    header, _, body = text.partition("\n")
    # 1. Read the number of voxels along each axis.
    match header.split():
        case ["voxel", *sizes] if len(sizes) == 3 and all(size.isdecimal() and len(size) < 10 for size in sizes):
            shape = int(sizes[0]), int(sizes[1]), int(sizes[2])
        case _:
            raise ValueError(f"expected a list of voxels with first line 'voxel nx ny nz', got {shortened(header)}.")
    max_voxels = min(_MOST_VOXELS, max(_SMALL_LIST, _VOXELS_PER_BYTE * len(text)))
    if not 0 < shape[0] * shape[1] * shape[2] <= max_voxels:
        raise ValueError(f"expected one to {max_voxels:,} voxels in a file of this size, got {' x '.join(sizes)}.")
    free = np.ones(shape, bool)
    # 2. Read the indices of blocked voxels.
    if not (lines := [line for line in body.splitlines() if line and not line.isspace()]):
        return free
    try:
        blocked = np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError as error:
        raise ValueError(f"expected a blocked voxel 'x y z' in each line ({error}).") from None
    if blocked.shape[1] != 3:
        raise ValueError(f"expected a blocked voxel 'x y z' in each line, got {shortened(lines[0])}.")
    bad = ~((blocked >= 0) & (blocked < shape) & (blocked == np.floor(blocked))).all(axis=1)
    if bad.any():
        raise ValueError(f"expected indices of voxels within {shape}, got {blocked[bad.argmax()].tolist()}.")
    free[tuple(blocked.astype(np.int64).T)] = False
    return free
