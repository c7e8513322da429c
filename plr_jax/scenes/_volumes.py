"""Readers of volumes: arrays of voxels, lists of occupied ones, and meshes."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_bool, as_finite, shortened
from plr_jax._files import errors_named, text_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.scenes._meshes import MESH_ENDINGS, free_of_mesh, triangles_of

VOLUME_ENDINGS = (".npy", ".3dmap", *MESH_ENDINGS)
_MOST_VOXELS, _MOST_RANK = 2**28, 4
_SMALL, _VOXELS_PER_BYTE = 2**24, 2**8  # what a list may promise, whatever it holds, and else for what it holds
_MOST_BYTES = 2**25  # of a list


def read_volume(
    path: str | os.PathLike[str],
    *,
    pitch: float | int | None = None,
    bounds: Box | ArrayLike | None = None,
    fill: bool = True,
) -> Bool[np.ndarray, "..."]:
    """Read which voxels of a volume are free.

    Args:
        path: One of three kinds of files, by its ending.

            ``.npy``: an array of one to four axes, of booleans, or of integers 0 and 1, which is free; at most
            268,435,456 voxels. No pickles.

            ``.3dmap``: voxels of the Moving AI benchmarks, ``voxel nx ny nz`` in the first line, then the indices
            ``x y z`` of one blocked voxel a line; at most 32 MiB, and as many voxels, but above 16,777,216 at most
            256 for each byte of the file.

            ``.stl``, ``.obj``, ``.ply``: a mesh of triangles, by trimesh (``pip install 'plr-jax[meshes]'``); at most
            64 MiB and 16,777,216 voxels. A voxel is blocked if the surface meets it, its faces included, to a
            millionth of a voxel: nothing is free that the mesh touches, and where the surface lies in a plane of the
            grid, the voxels on both sides are blocked.
        pitch: Of a mesh, and needed there: the width of the voxels, in its units.
        bounds: Of a mesh, the Box, or its corners, that the voxels fill, the last ones beyond it if the pitch does
            not divide its width. None: the bounding box of the mesh, in whose lower corner voxel ``[0, 0, 0]`` is.
        fill: Of a mesh, whether what its surface encloses is blocked as well: all voxels from which no way, face by
            face, leads to the faces of the grid. So are the rooms of a closed building: False leaves them free. A
            surface with holes that are wider than a voxel encloses nothing.

    Returns:
        True where a voxel is free, in C order; ``[i, j, k]`` is the voxel ``i`` along the first axis, ``x``.

    Raises:
        ValueError: If the file is of no such kind, is damaged or too large, nothing in it is free, or an argument is
            out of range or given for another kind of file.
        ImportError: If there is no trimesh to read a mesh.
        OSError: If the file cannot be read.

    References:
        D. Brewer and N. Sturtevant, "Benchmarks for pathfinding in 3D voxel space", SoCS 2018.
    """
    free, _ = volume_of(path, pitch, bounds, fill)
    if not free.any():
        enclosed = ": fill=False leaves free what the surface encloses" if is_mesh(path) and fill else ""
        raise ValueError(f"{path}: the volume has no free voxel{enclosed}.")
    return free


def is_mesh(path: str | os.PathLike[str]) -> bool:
    """Whether a file is of a mesh, by its ending."""
    return Path(path).suffix.lower() in MESH_ENDINGS


def volume_of(
    path: str | os.PathLike[str], pitch: float | int | None, bounds: Box | ArrayLike | None, fill: bool
) -> tuple[Bool[np.ndarray, "..."], Box]:
    """Which voxels of a volume are free, and the box that they fill: in units of the mesh, else of voxels."""
    path, fill = Path(path), as_bool("fill", fill)
    ending = path.suffix.lower()
    with errors_named(path):
        if ending not in VOLUME_ENDINGS:
            raise ValueError(f"expected a file that ends in one of {', '.join(VOLUME_ENDINGS)}.")
        if is_mesh(path):
            return _read_mesh(path, pitch, bounds, fill)
        if pitch is not None or bounds is not None or not fill:
            raise ValueError(f"pitch, bounds and fill are for meshes ({', '.join(MESH_ENDINGS)}): leave them out.")
        free = _READERS[ending](path)
        return free, Box(np.zeros(free.ndim), free.shape)


def _read_mesh(
    path: Path, pitch: float | None, bounds: Box | ArrayLike | None, fill: bool
) -> tuple[Bool[np.ndarray, "x y z"], Box]:
    if pitch is None:
        raise ValueError("a mesh needs a pitch, the width of its voxels: give one.")
    pitch = as_finite("pitch", pitch, positive=True)
    box = None if bounds is None else Box.of(bounds, "bounds")
    if box is not None and box.dim != 3:
        raise ValueError(f"bounds of a mesh must be a Box of three axes, got {box}.")
    triangles = triangles_of(path)
    free, lo = free_of_mesh(triangles, pitch, box, fill), triangles.min(axis=(0, 1)) if box is None else box.lo
    return free, Box(lo, lo + pitch * np.array(free.shape))


def _read_array(path: Path) -> Bool[np.ndarray, "..."]:
    try:  # mapped, so that a header promises no more than the file holds
        values = np.lib.format.open_memmap(path, mode="r")
    except OSError:
        raise
    except Exception as error:  # NumPy's reader of headers raises many kinds
        raise ValueError(f"expected an array of NumPy, got something else or a damaged file ({error}).") from None
    if not 1 <= values.ndim <= _MOST_RANK or not 0 < values.size <= _MOST_VOXELS:
        expected = f"one to {_MOST_RANK} axes and one to {_MOST_VOXELS:,} voxels"
        raise ValueError(f"expected {expected}, got shape {shortened(values.shape)}.")
    numbers = values.view(np.uint8) if values.dtype == bool else values  # a file may hold bytes that are no booleans
    if values.dtype.kind not in "biu" or numbers.min() < 0 or numbers.max() > 1:
        raise ValueError(f"expected booleans, or integers 0 and 1, got other values or type, {values.dtype}.")
    return np.array(numbers, dtype=bool, order="C")


def _read_list(path: Path) -> Bool[np.ndarray, "x y z"]:
    text = text_of(path, _MOST_BYTES)
    first, _, rest = text.partition("\n")
    shape = _promised(first, len(text))
    blocked = _indices(rest.splitlines())
    bad = ~((blocked >= 0) & (blocked < shape) & (blocked == np.floor(blocked))).all(axis=1)
    if bad.any():
        raise ValueError(f"expected indices of voxels within {shape}, got {blocked[bad.argmax()].tolist()}.")
    free = np.ones(shape, bool)
    free[tuple(blocked.astype(np.int64).T)] = False
    return free


def _promised(line: str, num_bytes: int) -> tuple[int, int, int]:
    """How many voxels there are along each axis, by the first line."""
    match line.split():
        case ["voxel", *sizes] if len(sizes) == 3 and all(size.isdecimal() and len(size) < 10 for size in sizes):
            shape = int(sizes[0]), int(sizes[1]), int(sizes[2])
        case _:
            raise ValueError(
                f"not a list of voxels: expected 'voxel nx ny nz' in its first line, got {shortened(line)}."
            )
    most = min(_MOST_VOXELS, max(_SMALL, _VOXELS_PER_BYTE * num_bytes))
    if not 0 < shape[0] * shape[1] * shape[2] <= most:
        raise ValueError(f"expected one to {most:,} voxels in a file of this size, got {' x '.join(sizes)}.")
    return shape


def _indices(lines: list[str]) -> Float[np.ndarray, "voxels 3"]:
    lines = [line for line in lines if line and not line.isspace()]
    if not lines:
        return np.zeros((0, 3))
    try:
        indices = np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError as error:
        raise ValueError(f"expected a blocked voxel 'x y z' a line ({error}).") from None
    if indices.shape[1] != 3:
        raise ValueError(f"expected a blocked voxel 'x y z' a line, got {shortened(lines[0])}.")
    return indices


_READERS: dict[str, Callable[[Path], Bool[np.ndarray, "..."]]] = {".npy": _read_array, ".3dmap": _read_list}
