"""Meshes of triangles as voxels: each that the surface meets is blocked, and what it encloses."""

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, runs
from plr_jax.geometry.box import Box

MESH_ENDINGS = (".stl", ".obj", ".ply")
_MOST_BYTES, _MOST_VOXELS, _MOST_ROWS, _MOST_MET = 2**26, 2**24, 2**22, 2**26
_AT_A_TIME = 2**15  # slabs or rows, which bounds the memory
_TOUCHES = 1e-6  # of a voxel: how far from one the surface still counts as meeting it

_FARTHEST = 2**30  # in voxels, so that rounding is less than that

Triangles: TypeAlias = Float[np.ndarray, "n 3 3"]
Edges: TypeAlias = Float[np.ndarray, "_ 2 _ n"]
Voxels: TypeAlias = Bool[np.ndarray, "x y z"]


def triangles_of(path: Path) -> Triangles:
    """The triangles of a mesh's file; ``ValueError`` if it is none."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(
            "Meshes are read by trimesh, which is not installed: pip install 'plr-jax[meshes]'."
        ) from error
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ValueError(f"expected a mesh of at most {_MOST_BYTES:,} bytes, got a larger file.")
    kind = path.suffix[1:].lower()
    if kind == "obj" or (kind == "stl" and len(data) != _size_of_stl(data)):
        data = data.decode("utf-8", "replace").encode()  # else trimesh would guess in which encoding a text is
    try:  # from memory, so that files that it names are not looked for
        options: Any = {"process": False, "skip_materials": True}
        with _unlogged():
            mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, **options)
        triangles = np.asarray(mesh.triangles, np.float64)
    except Exception as error:  # trimesh's readers raise anything
        raise ValueError(f"expected a mesh, got something else or a damaged file ({error}).") from None
    if triangles.shape[1:] != (3, 3) or not len(triangles) or not np.isfinite(triangles).all():
        raise ValueError("expected a mesh of triangles with corners 'x y z', finite ones, got none or others.")
    return triangles


@contextmanager
def _unlogged() -> Iterator[None]:
    """Without what trimesh logs: tracebacks, of parts of a file that it then does without."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(level)


def _size_of_stl(data: bytes) -> int:
    """How many bytes a binary STL file has, by its header."""
    header, triangle = 84, 50
    return header + triangle * int.from_bytes(data[header - 4 : header], "little")


def free_of_mesh(triangles: Triangles, pitch: float, bounds: Box | None, fill: bool) -> Voxels:
    """Which voxels of a grid over bounds, or over the mesh, are free of it."""
    lo = triangles.min(axis=(0, 1)) if bounds is None else bounds.lo
    hi = triangles.max(axis=(0, 1)) if bounds is None else bounds.hi
    with np.errstate(over="ignore", invalid="ignore"):
        count = np.maximum(1.0, np.ceil((hi - lo) / pitch - _TOUCHES))
        triangles = (triangles - lo) / pitch
    if not count.prod() <= _MOST_VOXELS:
        sizes = " x ".join(f"{along:.6g}" for along in count)
        raise ValueError(f"expected at most {_MOST_VOXELS:,} voxels, got {sizes}: give a larger pitch.")
    blocked = np.zeros(count.astype(np.int64).tolist(), bool)
    meets = (triangles.min(axis=1) <= count + 1) & (triangles.max(axis=1) >= -1)
    _block_surface(triangles[meets.all(axis=1)], blocked)
    return _outside(blocked) if fill else ~blocked


def _outside(blocked: Voxels) -> Voxels:
    """The free voxels that are connected, face by face, to the faces of the grid."""
    from scipy import ndimage

    labeled: Any = ndimage.label(np.logical_not(blocked, out=blocked))
    part = labeled[0]
    reached = np.zeros(int(part.max()) + 1, bool)
    for axis in range(part.ndim):
        for end in (0, -1):
            reached[np.take(part, end, axis)] = True
    reached[0] = False
    return reached[part]


# Scan conversion: triangles are cut into slabs between planes of the grid, these into rows along another axis, and
# what is left of a triangle in a row meets a run of voxels. Pieces are convex: their outlines say how far they reach.


def _block_surface(triangles: Triangles, blocked: Voxels) -> None:
    """Block all voxels that triangles, in units of voxels, meet, their faces included."""
    if not (np.abs(triangles) <= _FARTHEST).all():
        raise ValueError(f"expected triangles within {_FARTHEST:,} voxels of the bounds, got one that leads farther.")
    order = np.argsort(blocked.shape, kind="stable")  # runs along the longest axis
    blocked, corners = blocked.transpose(order), triangles.transpose(2, 1, 0)[order]
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=1)
    edges = np.where(edges[:1, :1] > edges[:1, 1:], edges[:, ::-1], edges)
    num_rows = num_met = 0
    for triangle, slab in _layers(edges[0], blocked.shape[0]):
        outlines = _outlines(_clipped(edges[..., triangle], slab))
        for piece, row in _layers(outlines[0], blocked.shape[1]):
            (along,) = _clipped(outlines[..., piece], row)
            first, count = _reaches(along, blocked.shape[2])
            num_rows, num_met = num_rows + len(row), num_met + int(count.sum())
            if num_rows > _MOST_ROWS or num_met > _MOST_MET:
                raise ValueError("the triangles meet too many voxels, one after the other: give a larger pitch.")
            run, place = runs(count)
            blocked[slab[piece][run], row[run], first[run] + place] = True


def _layers(
    ends: Float[np.ndarray, "2 _ n"], size: int
) -> Iterator[tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]]:
    """Pieces and the layers of the grid across an axis that they reach into, some at a time."""
    first, count = _reaches(ends, size)
    for part in parts(count, _AT_A_TIME):
        piece, place = runs(count[part])
        yield piece + part.start, first[part][piece] + place


def _reaches(ends: Float[np.ndarray, "2 _ n"], size: int) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """The first layer across an axis that each piece reaches into, and how many of them the grid has."""
    lowest, highest = np.fmin.reduce(ends, axis=(0, 1)), np.fmax.reduce(ends, axis=(0, 1))
    first = np.maximum(np.ceil(lowest - _TOUCHES) - 1, 0).astype(np.int64)
    last = np.minimum(np.floor(highest + _TOUCHES), size - 1).astype(np.int64)
    return first, np.maximum(last - first + 1, 0)


def _clipped(edges: Edges, layer: Int[np.ndarray, "n"]) -> Edges:
    """What of edges is within a layer each across the first axis, along the others; NaN if nothing is."""
    begin, end = edges[0]
    change, floor, ceiling = end - begin, layer - _TOUCHES, layer + 1 + _TOUCHES
    change[change == 0] = np.nan  # an edge in the layer, all of it, or in none
    enters, leaves = (floor - begin) / change, (ceiling - begin) / change
    shares = np.fmax(np.fmin(enters, leaves), 0.0), np.fmin(np.fmax(enters, leaves), 1.0)
    is_outside = (np.maximum(begin, end) < floor) | (np.minimum(begin, end) > ceiling)
    ends = [edges[1:, 0] + np.where(is_outside, np.nan, share) * (edges[1:, 1] - edges[1:, 0]) for share in shares]
    return np.stack(ends, axis=1)


def _outlines(edges: Edges) -> Edges:
    """The outlines of triangles in slabs: of edges, which ascend, what is within, and what joins their ends."""
    return np.concatenate(
        [edges, *(np.stack([of, np.roll(of, -1, axis=1)], axis=1) for of in (edges[:, 0], edges[:, 1]))], axis=2
    )
