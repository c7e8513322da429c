"""Read volumes as arrays of free voxels: from arrays, from lists of blocked voxels, and from meshes."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_bool, as_finite, parts, ragged_indices, shortened
from plr_jax._files import errors_named, text_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.scenes._meshes import MESH_ENDINGS, Triangles, read_mesh

# Limits of arrays and lists.
_MOST_VOXELS = 2**28
_MOST_RANK = 4
_MOST_LIST_BYTES = 2**25
_SMALL_LIST = 2**24  # voxels of a volume that a list of any size may have
_VOXELS_PER_BYTE = 2**8  # most voxels per byte of a list, for larger volumes
# Limits of meshes.
_MOST_MESH_VOXELS = 2**24
_MOST_ROWS, _MOST_MET = 2**22, 2**26  # rows and voxels that the triangles meet, each counted once per triangle
_AT_A_TIME = 2**15  # slabs or rows in a batch, which bounds the memory
_TOUCHES = 1e-6  # voxels: a surface this close to a voxel meets it
_FARTHEST = 2**30  # voxels: within this distance, rounding errors of coordinates stay below `_TOUCHES`
Edges: TypeAlias = Float[np.ndarray, "_ 2 _ n"]  # (axis, begin or end, edge, polygon)
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
        fill: For meshes, whether to block what the surface encloses as well: all voxels with no path through free
            voxels and their faces to the border of the grid. A surface with holes wider than a voxel encloses
            nothing.

    Raises:
        ValueError: If the file has another ending, is damaged or too large, no voxel is free, or an argument is
            invalid or not for this kind of file.
    """
    fill = as_bool("fill", fill)
    with errors_named(path) as file:
        ending = file.suffix.lower()
        is_mesh = ending in MESH_ENDINGS
        if ending not in (".npy", ".3dmap", *MESH_ENDINGS):
            raise ValueError(f"expected a file that ends in one of .npy, .3dmap, {', '.join(MESH_ENDINGS)}.")
        if is_mesh:
            if pitch is None:
                raise ValueError("expected a pitch, the side of a voxel, for a mesh: give one.")
            box = None if bounds is None else Box.of(bounds, "bounds")
            if box is not None and box.dim != 3:
                raise ValueError(f"bounds of a mesh must be a Box of three axes, got {box}.")
            free = free_of_mesh(read_mesh(file), as_finite("pitch", pitch, positive=True), box, fill)
        elif pitch is not None or bounds is not None or not fill:
            raise ValueError(f"pitch, bounds and fill are for meshes ({', '.join(MESH_ENDINGS)}): leave them out.")
        else:
            free = _read_array(file) if ending == ".npy" else _read_list(file)
        if not free.any():
            enclosed = "; fill=False leaves free what the surface encloses" if is_mesh and fill else ""
            raise ValueError(f"expected at least one free voxel, got none{enclosed}.")
    return free


def _read_array(path: Path) -> Bool[np.ndarray, "..."]:
    """Read which voxels are free from a ``.npy`` file of booleans, or of integers 0 (blocked) and 1 (free)."""
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
    """Read which voxels are free from a text file that lists the blocked ones, after a line with the grid's shape."""
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
    lines = [line for line in body.splitlines() if line and not line.isspace()]
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
    """Return which voxels no triangle meets. With ``fill``, voxels that the surface encloses are not free either.

    Voxels are cubes of side ``pitch`` that fill the box ``bounds`` from its lower corner on. If ``bounds`` is None,
    it is the bounding box of the triangles.
    """
    lo = triangles.min(axis=(0, 1)) if bounds is None else bounds.lo
    hi = triangles.max(axis=(0, 1)) if bounds is None else bounds.hi
    # 1. Make an empty grid, and convert to units of voxels. Huge numbers overflow to inf or NaN, and are rejected.
    with np.errstate(over="ignore", invalid="ignore"):
        shape = np.maximum(1.0, np.ceil((hi - lo) / pitch - _TOUCHES))
        num_voxels = shape.prod()
        triangles = (triangles - lo) / pitch
    if not num_voxels <= _MOST_MESH_VOXELS:
        sizes = " x ".join(f"{along:.6g}" for along in shape)
        raise ValueError(f"expected at most {_MOST_MESH_VOXELS:,} voxels, got {sizes}: give a larger pitch.")
    blocked = np.zeros(shape.astype(np.int64).tolist(), bool)
    # 2. Block the surface; only triangles whose bounding boxes are near the grid can meet it.
    is_near = (triangles.min(axis=1) <= shape + 1) & (triangles.max(axis=1) >= -1)
    _block_surface(triangles[is_near.all(axis=1)], blocked)
    # 3. Block what the surface encloses: free voxels that are not connected through faces to the grid's border.
    if fill:
        from scipy import ndimage

        ndimage.binary_fill_holes(blocked, output=blocked)
    return ~blocked


def _block_surface(triangles: Triangles, blocked: Voxels) -> None:
    """Set ``blocked`` to True, in place, in all voxels that meet a triangle; coordinates are in units of voxels.

    Each triangle is cut along the first axis into slabs that are one voxel thick, and each slab along the second axis
    into rows. In each row, the outline of the triangle's piece gives a range of voxels along the third axis. The axes
    are sorted first, so that the third axis has the most voxels.
    """
    if not (np.abs(triangles) <= _FARTHEST).all():
        raise ValueError(f"expected triangles within {_FARTHEST:,} voxels of the bounds, got one farther away.")
    # 1. Sort the axes, so that ranges run along the longest axis; `blocked` becomes a view of the caller's array.
    order = np.argsort(blocked.shape, kind="stable")
    blocked = blocked.transpose(order)
    corners = triangles.transpose(2, 1, 0)[order]  # (axis, corner, triangle)
    # 2. List the edges (axis, end, edge, triangle). Each begins at its lower end along the first axis, so that an
    #    edge is clipped in the same way for both of its triangles.
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=1)
    edges = np.where(edges[:1, :1] > edges[:1, 1:], edges[:, ::-1], edges)
    # 3. Clip to slabs, then to rows, in batches. Each clipping drops the axis along which it clips.
    num_rows = num_met = 0
    for triangle, slab in _split_into_layers(edges[0], blocked.shape[0]):
        outlines = _outlines(_clip_to_layers(edges[..., triangle], slab))
        for piece, row in _split_into_layers(outlines[0], blocked.shape[1]):
            (along,) = _clip_to_layers(outlines[..., piece], row)
            first, count = _layer_range(along, blocked.shape[2])
            num_rows += len(row)
            num_met += int(count.sum())
            if num_rows > _MOST_ROWS or num_met > _MOST_MET:
                raise ValueError("the triangles meet too many voxels in all: give a larger pitch.")
            run, place = ragged_indices(count)
            blocked[slab[piece][run], row[run], first[run] + place] = True


def _split_into_layers(
    ends: Float[np.ndarray, "2 _ n"], size: int
) -> Iterator[tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]]:
    """Yield all pairs of a polygon and a layer of voxels that the polygon reaches.

    Pairs come in batches: an array of polygon indices and an array of layer indices. Layers are one voxel thick, and
    numbered from 0 to ``size - 1`` along an axis. ``ends`` has the coordinates, along this axis, of both ends of the
    polygons' edges, ``(2, edges, polygons)``.
    """
    first, count = _layer_range(ends, size)
    for part in parts(count, _AT_A_TIME):
        polygon, place = ragged_indices(count[part])
        yield polygon + part.start, first[part][polygon] + place


def _layer_range(ends: Float[np.ndarray, "2 _ n"], size: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the first layer of voxels that each polygon reaches along an axis, and how many layers it reaches.

    ``ends`` has the coordinates, along the axis, of both ends of the polygons' edges, ``(2, edges, polygons)``, in
    voxels. Layers are numbered from 0 to ``size - 1``.
    """
    # Layer k spans k to k + 1: a polygon from `lowest` to `highest` touches it if k + 1 >= lowest - _TOUCHES and
    # k <= highest + _TOUCHES. Edges that were clipped away are NaN, which `fmin` and `fmax` ignore.
    lowest = np.fmin.reduce(ends, axis=(0, 1))
    highest = np.fmax.reduce(ends, axis=(0, 1))
    first = np.maximum(np.ceil(lowest - _TOUCHES) - 1, 0).astype(np.int64)
    last = np.minimum(np.floor(highest + _TOUCHES), size - 1).astype(np.int64)
    return first, np.maximum(last - first + 1, 0)


def _clip_to_layers(edges: Edges, layer: Int[np.ndarray, " n"]) -> Edges:
    """Clip the edges of polygon ``i`` to layer ``layer[i]`` of voxels along the first axis, and drop this axis.

    Edges have the shape ``(axes, begin and end, edges, polygons)``. An edge outside of the layer becomes NaN.
    """
    # The point begin + t * (end - begin) of an edge lies in the layer for t between `enters` and `leaves`, in either
    # order. An edge parallel to the layer lies in it as a whole or not at all: t is NaN, which `fmax` and `fmin`
    # replace by 0 and 1.
    begin, end = edges[0]
    floor, ceiling = layer - _TOUCHES, layer + 1 + _TOUCHES
    change = end - begin
    change[change == 0] = np.nan
    enters, leaves = (floor - begin) / change, (ceiling - begin) / change
    clipped_range = np.fmax(np.fmin(enters, leaves), 0.0), np.fmin(np.fmax(enters, leaves), 1.0)
    is_outside = (np.maximum(begin, end) < floor) | (np.minimum(begin, end) > ceiling)
    ends = [edges[1:, 0] + np.where(is_outside, np.nan, t) * (edges[1:, 1] - edges[1:, 0]) for t in clipped_range]
    return np.stack(ends, axis=1)


def _outlines(edges: Edges) -> Edges:
    """Return nine segments for each triangle whose three edges were clipped to a layer of voxels.

    Three are the clipped edges, three join the first ends of these edges, and three join their second ends.
    """
    #     ends   o------o   ceiling    Each of the three edges is joined to the next, so all pairs are joined. The
    #           /        \             segments are the outline of the piece, or lie inside it, since it is convex.
    #   begins o----------o floor      A segment from an edge that was clipped away is NaN.
    joins = [np.stack([ends, np.roll(ends, -1, axis=1)], axis=1) for ends in (edges[:, 0], edges[:, 1])]
    return np.concatenate([edges, *joins], axis=2)
