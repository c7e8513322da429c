"""Visibility graphs in files: a zip archive of NumPy arrays, without pickles, that ``np.load`` can read as well.

It holds the workspace (bounds, whether to squeeze, free space and obstacles as well-known binary), the goal, and what
is costly to find: the visibility polygons of the corners and the edges of the graph. What is read is checked, so that
a file can at worst be refused.
"""

import io
import zipfile
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Shaped
from shapely.geometry import MultiPolygon, Polygon

from plr_jax._atomic import write_atomically
from plr_jax.geometry.box import Box
from plr_jax.geometry.corners import CornerVisibility, find_corners
from plr_jax.geometry.polygons import as_polygons
from plr_jax.geometry.visibility import VisibilityTable
from plr_jax.geometry.workspace import Workspace

_VERSION = 1
_ARRAYS = {
    "version": ("i", ()),
    "bounds": ("f", (2, 2)),
    "squeeze": ("b", ()),
    "free_space": ("u", (None,)),
    "obstacles": ("u", (None,)),
    "goal": ("f", (2,)),
    "cut": ("f", (None, 2)),
    "first": ("i", (None,)),
    "key": ("f", (None,)),
    "edge": ("i", (None,)),
    "edges": ("i", (None, 2)),
}
"""Kind of the numbers of each array, and its shape, where None is any number."""


def write_visibility(
    path: Path, workspace: Workspace, goal: Float[np.ndarray, "2"], corners: CornerVisibility
) -> None:
    """Write what :func:`read_visibility` reads."""
    table, file = corners.table, io.BytesIO()
    geometries: Any = workspace.free_space, shapely.geometrycollections(list(workspace.obstacles))
    geometries = [np.frombuffer(shapely.to_wkb(each), np.uint8) for each in geometries]
    bounds = np.stack([workspace.bounds.lo, workspace.bounds.hi])
    of_corners = table.cut, table.first, table.key, table.edge, corners.edges
    values: Any = _VERSION, bounds, workspace.squeeze, *geometries, goal, *of_corners
    np.savez(file, **dict(zip(_ARRAYS, values, strict=True)))
    write_atomically(path, file.getvalue())


def read_visibility(path: Path) -> tuple[Workspace, Float[np.ndarray, "2"], CornerVisibility]:
    """The workspace, the goal, and what the corners see, of a file.

    Raises:
        ValueError, EOFError, BadZipFile, ShapelyError: If the file is truncated, corrupt, of another kind or version.
        OSError: If it cannot be read.
    """
    arrays = _arrays(path)
    if arrays["version"] != _VERSION:
        raise ValueError(f"it is of version {arrays['version']}, this release reads version {_VERSION}")
    free: Any
    free, obstacles = (shapely.from_wkb(arrays[name].tobytes()) for name in ("free_space", "obstacles"))
    polygons = as_polygons("Obstacle", obstacles)
    if not isinstance(free, Polygon | MultiPolygon) or free.is_empty or not free.is_valid:
        raise ValueError("its free space is no valid polygon")
    workspace = Workspace.restored(Box(*arrays["bounds"]), polygons, bool(arrays["squeeze"]), free)
    return workspace, arrays["goal"], _corners(arrays, workspace)


def _arrays(path: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """The arrays of a file, of the kinds and shapes that they must have, and no larger than the file."""
    data = io.BytesIO(path.read_bytes())  # so that only what cannot be read, and no wrong place in it, is an OSError
    arrays = {}
    try:
        with zipfile.ZipFile(data) as archive:
            missing = {f"{name}.npy" for name in _ARRAYS} - set(archive.namelist())
            if missing:
                raise ValueError(f"it has no {min(missing)}")
            for name, (kind, shape) in _ARRAYS.items():
                member = archive.getinfo(f"{name}.npy")
                if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
                    raise ValueError(f"{name} is compressed")
                arrays[name] = _array(name, kind, shape, io.BytesIO(archive.read(member)))
    except RuntimeError as error:  # so zipfile calls what it has no code for, and what is encrypted
        raise ValueError(f"it cannot be unpacked: {error}") from error
    return arrays


def _array(name: str, kind: str, shape: tuple[int | None, ...], data: io.BytesIO) -> Shaped[np.ndarray, "..."]:
    np.lib.format.read_magic(data)
    try:
        found, _, dtype = np.lib.format.read_array_header_1_0(data)
    except (TokenError, SyntaxError, RecursionError, TypeError) as error:  # it is read as Python
        raise ValueError(f"{name} has a header that cannot be read") from error
    fits = len(found) == len(shape) and all(n in (None, m) for n, m in zip(shape, found, strict=True))
    if dtype.kind != kind or not fits:
        raise ValueError(f"{name} has numbers of kind {dtype.kind} and shape {found}")
    array = np.frombuffer(data.read(), dtype)
    if array.size != np.prod(found, dtype=object) or (kind == "f" and not np.isfinite(array).all()):
        raise ValueError(f"{name} is incomplete or has numbers that are not finite")
    return array.reshape(found)


def _corners(arrays: dict[str, Shaped[np.ndarray, "..."]], workspace: Workspace) -> CornerVisibility:
    """What the corners see, if the arrays are in order and name nothing that is not there."""
    corners, views = find_corners(workspace)
    count, num_walls = len(corners.points), len(workspace.boundary.edges)
    cut, first, key, edge, edges = (arrays[name] for name in ("cut", "first", "key", "edge", "edges"))
    counts = np.diff(first)
    if len(cut) != count or len(counts) != count or first[0] != 0 or not (counts > 0).all():
        raise ValueError(f"it has not one visibility polygon for each of {count} corners")
    if (np.abs((cut * cut).sum(axis=1) - 1) > 1e-9).any():
        raise ValueError("directions of its visibility polygons are no unit vectors")
    if not len(key) == len(edge) == first[-1]:
        raise ValueError("its visibility polygons are incomplete")
    turn = key - 4.0 * np.repeat(np.arange(count), counts)
    if (np.diff(key) < 0).any() or (turn < 0).any() or (turn > 4).any():
        raise ValueError("its visibility polygons are out of order")
    if (edge < -1).any() or (edge >= num_walls).any() or (edges < 0).any() or (edges >= count).any():
        raise ValueError("it names corners or walls that its workspace has not")
    table = VisibilityTable(workspace.boundary, workspace.tolerance, corners.points, cut, first, key, edge)
    return CornerVisibility(corners, views, table, edges)
