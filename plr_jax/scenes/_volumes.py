"""Readers of volumes: arrays of voxels, lists of blocked voxels, and meshes, which are voxelized."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_bool, as_finite, parts, ragged_indices, shortened
from plr_jax._files import errors_named, text_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.scenes._meshes import MESH_ENDINGS, Triangles, read_mesh

_MOST_VOXELS, _MOST_RANK = 2**28, 4
_MOST_LIST_BYTES = 2**25
_SMALL_LIST, _VOXELS_PER_BYTE = 2**24, 2**8  # most voxels of a list: this many, or this many per byte of the file
_MOST_MESH_VOXELS = 2**24
_MOST_ROWS, _MOST_MET = 2**22, 2**26  # rows and voxels that the triangles meet, each counted once per triangle
_AT_A_TIME = 2**15  # slabs or rows in a batch, which bounds the memory
_TOUCHES = 1e-6  # voxels: a surface this close to a voxel meets it
_FARTHEST = 2**30  # voxels: within this distance, rounding errors of coordinates stay below `_TOUCHES`
Edges: TypeAlias = Float[np.ndarray, "_ 2 _ n"]
Voxels: TypeAlias = Bool[np.ndarray, "x y z"]


def read_volume(
    path: str | os.PathLike[str],
    *,
    pitch: float | int | None = None,
    bounds: Box | ArrayLike | None = None,
    fill: bool = True,
) -> Bool[np.ndarray, "..."]:
    """Read which voxels of a volume are free: a boolean array ``free[x, y, z]`` in C order.

    Args:
        path: A file of one of three kinds, by its ending.

            - ``.npy``: an array of one to four axes and at most 268,435,456 voxels: booleans or integers, 0 for
              blocked and 1 for free. No pickles.
            - ``.3dmap``: voxels of the Moving AI benchmarks (Brewer and Sturtevant, SoCS 2018). The first line is
              ``voxel nx ny nz``; each other line has the indices ``x y z`` of a blocked voxel. At most 32 MiB and
              268,435,456 voxels; if above 16,777,216, at most 256 voxels per byte of the file.
            - ``.stl``, ``.obj``, ``.ply``: a mesh of plane polygons, text or binary; at most 64 MiB and 16,777,216
              voxels. A voxel is blocked if the surface meets or touches it, up to a millionth of a voxel.
        pitch: Side of a voxel, in units of the mesh; for meshes only, which need it.
        bounds: For meshes, the box, or its corners, that the voxels fill from the lower corner on; the last voxels
            may extend beyond it. None: the bounding box of the mesh.
        fill: For meshes, whether to block what the surface encloses as well: all voxels with no path through faces to
            the border of the grid. A surface with holes wider than a voxel encloses nothing.

    Raises:
        ValueError: If the file has another ending, is damaged or too large, no voxel is free, or an argument is
            invalid or not for this kind of file.
    """
    path, fill = Path(path), as_bool("fill", fill)
    ending = path.suffix.lower()
    is_mesh = ending in MESH_ENDINGS
    with errors_named(path):
        if ending not in (".npy", ".3dmap", *MESH_ENDINGS):
            raise ValueError(f"expected a file that ends in one of .npy, .3dmap, {', '.join(MESH_ENDINGS)}.")
        if not is_mesh:
            if pitch is not None or bounds is not None or not fill:
                raise ValueError(
                    f"pitch, bounds and fill are for meshes ({', '.join(MESH_ENDINGS)}): leave them out."
                )
            free = _read_array(path) if ending == ".npy" else _read_list(path)
        else:
            if pitch is None:
                raise ValueError("expected a pitch, the side of a voxel, for a mesh: give one.")
            box = None if bounds is None else Box.of(bounds, "bounds")
            if box is not None and box.dim != 3:
                raise ValueError(f"bounds of a mesh must be a Box of three axes, got {box}.")
            free = free_of_mesh(read_mesh(path), as_finite("pitch", pitch, positive=True), box, fill)
    if not free.any():
        enclosed = "; fill=False leaves free what the surface encloses" if is_mesh and fill else ""
        raise ValueError(f"{path}: expected at least one free voxel, got none{enclosed}.")
    return free


def _read_array(path: Path) -> Bool[np.ndarray, "..."]:
    """Read booleans, or integers 0 and 1, from a ``.npy`` file."""
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


def _read_list(path: Path) -> Voxels:
    """Read a text file that lists blocked voxels after a line with the numbers of voxels."""
    text = text_of(path, _MOST_LIST_BYTES)
    first, _, rest = text.partition("\n")
    # 1. Read the number of voxels along each axis.
    match first.split():
        case ["voxel", *sizes] if len(sizes) == 3 and all(size.isdecimal() and len(size) < 10 for size in sizes):
            shape = int(sizes[0]), int(sizes[1]), int(sizes[2])
        case _:
            raise ValueError(f"expected a list of voxels with first line 'voxel nx ny nz', got {shortened(first)}.")
    most = min(_MOST_VOXELS, max(_SMALL_LIST, _VOXELS_PER_BYTE * len(text)))
    if not 0 < shape[0] * shape[1] * shape[2] <= most:
        raise ValueError(f"expected one to {most:,} voxels in a file of this size, got {' x '.join(sizes)}.")
    free = np.ones(shape, bool)
    # 2. Read the indices of blocked voxels.
    lines = [line for line in rest.splitlines() if line and not line.isspace()]
    if not lines:
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


def free_of_mesh(triangles: Triangles, pitch: float, bounds: Box | None, fill: bool) -> Voxels:
    """Return which voxels no triangle meets and, with ``fill``, the surface does not enclose."""
    lo = triangles.min(axis=(0, 1)) if bounds is None else bounds.lo
    hi = triangles.max(axis=(0, 1)) if bounds is None else bounds.hi
    with np.errstate(over="ignore", invalid="ignore"):
        count = np.maximum(1.0, np.ceil((hi - lo) / pitch - _TOUCHES))
        triangles, size = (triangles - lo) / pitch, count.prod()
    if not size <= _MOST_MESH_VOXELS:
        sizes = " x ".join(f"{along:.6g}" for along in count)
        raise ValueError(f"expected at most {_MOST_MESH_VOXELS:,} voxels, got {sizes}: give a larger pitch.")
    blocked = np.zeros(count.astype(np.int64).tolist(), bool)
    meets = (triangles.min(axis=1) <= count + 1) & (triangles.max(axis=1) >= -1)
    _block_surface(triangles[meets.all(axis=1)], blocked)
    free = ~blocked
    if not fill:
        return free
    # Voxels that are not connected to the border of the grid through faces are enclosed.
    from scipy import ndimage

    labeled: Any = ndimage.label(free)
    part = labeled[0]
    reached = np.zeros(int(part.max()) + 1, bool)
    for axis in range(part.ndim):
        reached[np.take(part, (0, -1), axis)] = True
    reached[0] = False
    return reached[part]


def _block_surface(triangles: Triangles, blocked: Voxels) -> None:
    # Cut triangles into slabs between planes of the grid, and slabs into rows along a second axis. In each row, the
    # outline of a piece gives the range of voxels that the piece meets. Coordinates are in units of voxels.
    if not (np.abs(triangles) <= _FARTHEST).all():
        raise ValueError(f"expected triangles within {_FARTHEST:,} voxels of the bounds, got one farther away.")
    order = np.argsort(blocked.shape, kind="stable")  # ranges of voxels run along the longest axis
    blocked, corners = blocked.transpose(order), triangles.transpose(2, 1, 0)[order]
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=1)
    edges = np.where(edges[:1, :1] > edges[:1, 1:], edges[:, ::-1], edges)
    num_rows = num_met = 0
    for triangle, slab in _split_into_layers(edges[0], blocked.shape[0]):
        outlines = _outlines(_clip_to_layers(edges[..., triangle], slab))
        for piece, row in _split_into_layers(outlines[0], blocked.shape[1]):
            (along,) = _clip_to_layers(outlines[..., piece], row)
            first, count = _layer_range(along, blocked.shape[2])
            num_rows, num_met = num_rows + len(row), num_met + int(count.sum())
            if num_rows > _MOST_ROWS or num_met > _MOST_MET:
                raise ValueError("the triangles meet too many voxels in all: give a larger pitch.")
            run, place = ragged_indices(count)
            blocked[slab[piece][run], row[run], first[run] + place] = True


def _split_into_layers(
    ends: Float[np.ndarray, "2 _ n"], size: int
) -> Iterator[tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]]:
    # Batches of pairs: the indices of a polygon and of a layer of voxels that it reaches along one axis.
    first, count = _layer_range(ends, size)
    for part in parts(count, _AT_A_TIME):
        piece, place = ragged_indices(count[part])
        yield piece + part.start, first[part][piece] + place


def _layer_range(ends: Float[np.ndarray, "2 _ n"], size: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    lowest, highest = np.fmin.reduce(ends, axis=(0, 1)), np.fmax.reduce(ends, axis=(0, 1))
    first = np.maximum(np.ceil(lowest - _TOUCHES) - 1, 0).astype(np.int64)
    last = np.minimum(np.floor(highest + _TOUCHES), size - 1).astype(np.int64)
    return first, np.maximum(last - first + 1, 0)


def _clip_to_layers(edges: Edges, layer: Int[np.ndarray, " n"]) -> Edges:
    """Clip edges to a layer of voxels along the first axis, and drop this axis; NaN if nothing of an edge is left."""
    begin, end = edges[0]
    change, floor, ceiling = end - begin, layer - _TOUCHES, layer + 1 + _TOUCHES
    change[change == 0] = np.nan  # an edge parallel to the layer lies in it as a whole or not at all
    enters, leaves = (floor - begin) / change, (ceiling - begin) / change
    fractions = np.fmax(np.fmin(enters, leaves), 0.0), np.fmin(np.fmax(enters, leaves), 1.0)
    is_outside = (np.maximum(begin, end) < floor) | (np.minimum(begin, end) > ceiling)
    ends = [edges[1:, 0] + np.where(is_outside, np.nan, t) * (edges[1:, 1] - edges[1:, 0]) for t in fractions]
    return np.stack(ends, axis=1)


def _outlines(edges: Edges) -> Edges:
    """Return the outlines of clipped triangles: the clipped edges, and segments that join ends of these edges."""
    return np.concatenate(
        [edges, *(np.stack([ends, np.roll(ends, -1, axis=1)], axis=1) for ends in (edges[:, 0], edges[:, 1]))], axis=2
    )
