"""Read a workspace from a file of any supported format: :func:`read_workspace`."""

import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from shapely.geometry.base import BaseGeometry

from plr_jax._files import errors_named, json_of
from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._geojson import is_geojson, read_geojson, read_polygons, read_wkt
from plr_jax.scenes._grids import read_map
from plr_jax.scenes._pictures import PICTURE_ENDINGS, YAML_ENDINGS, read_image, read_map_server
from plr_jax.scenes._scenes import is_scene, load

_READERS: dict[str, Callable[..., Workspace]] = {
    ".map": read_map,
    ".json": read_polygons,  # or another reader, chosen by the content
    ".geojson": read_geojson,
    ".wkt": read_wkt,
    **dict.fromkeys(YAML_ENDINGS, read_map_server),
    **dict.fromkeys(PICTURE_ENDINGS, read_image),
}


def read_workspace(path: str | os.PathLike[str] | BaseGeometry, **options: Any) -> Workspace:
    """Read a workspace from a file of any supported format, chosen by the file's ending and content.

    - picture, such as ``.png``: :func:`read_image`; map of ``map_server``, ``.yaml``: :func:`read_map_server`
    - GeoJSON, ``.json`` or ``.geojson``: :func:`read_geojson`; well-known text, ``.wkt``: :func:`read_wkt`
    - Moving AI grid, ``.map``: :func:`read_map`; polygons with holes, ``.json``: :func:`read_polygons`
    - scene, ``.json``: :func:`load`; Shapely polygons of free space (no file): :meth:`Workspace.from_polygons`

    Options are those of the reader. A file or an option that is not supported raises ``ValueError``.
    """
    path = path if isinstance(path, BaseGeometry) else Path(path)
    reader = _reader_of(path) if isinstance(path, Path) else Workspace.from_polygons
    accepted = list(inspect.signature(reader).parameters)[1:]
    if unknown := ", ".join(name for name in options if name not in accepted):
        known = ", ".join(accepted) or "none"
        raise ValueError(f"{path}: expected options of this kind of file ({known}), got {unknown}.")
    return reader(path, **options)


def _reader_of(path: Path) -> Callable[..., Workspace]:
    """Return the function that reads a file, chosen by the ending, and for ``.json`` by the content."""
    ending = path.suffix.lower()
    if ending not in _READERS:
        raise ValueError(f"{path}: expected a file that ends in one of {', '.join(_READERS)}.")
    if ending == ".json" and is_scene(path):
        return lambda path: load(path).workspace
    with errors_named(path):
        return read_geojson if ending == ".json" and is_geojson(json_of(path)) else _READERS[ending]
