"""One door for all maps: a workspace from a file of any kind that can be read."""

import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from plr_jax._files import errors_named, json_of
from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._file import is_scene, load
from plr_jax.scenes._geojson import is_geojson, read_geojson, read_polygons, read_wkt
from plr_jax.scenes._movingai import read_map
from plr_jax.scenes._pictures import PICTURE_ENDINGS, YAML_ENDINGS, read_image, read_map_server

_ENDINGS = (".map", ".json", ".geojson", ".wkt", *YAML_ENDINGS, *PICTURE_ENDINGS)


def read_workspace(path: str | os.PathLike[str], **options: Any) -> Workspace:
    """Read a workspace from a file of any kind, by its ending and what is in it.

    Args:
        path: A picture (:func:`read_image`); a map of ``map_server``, ``.yaml`` (:func:`read_map_server`); GeoJSON,
            ``.json`` or ``.geojson`` (:func:`read_geojson`); well-known text, ``.wkt`` (:func:`read_wkt`); a Moving
            AI grid, ``.map`` (:func:`read_map`); polygons with holes, ``.json`` (:func:`read_polygons`); a scene,
            ``.json`` (:func:`load`).
        **options: Those of the reader.

    Returns:
        The workspace.

    Raises:
        ValueError: If the file is of no such kind, is damaged, or has no such option.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    reader = reader_of(path)
    known = options_of(reader)
    if unknown := ", ".join(name for name in options if name not in known):
        raise ValueError(f"{path}: {unknown} is no option of files of this kind; they have {known or 'none'}.")
    return reader(path, **options)


def options_of(reader: Callable[..., Workspace]) -> list[str]:
    """What a reader can be told besides the path."""
    return list(inspect.signature(reader).parameters)[1:]


def reader_of(path: Path) -> Callable[..., Workspace]:
    """The reader of a file; ``ValueError`` if there is none."""
    match path.suffix.lower():
        case ".map":
            return read_map
        case ".geojson":
            return read_geojson
        case ".wkt":
            return read_wkt
        case ".json":
            if is_scene(path):
                return _workspace_of_scene
            with errors_named(path):
                return read_geojson if is_geojson(json_of(path)) else read_polygons
        case ending if ending in YAML_ENDINGS:
            return read_map_server
        case ending if ending in PICTURE_ENDINGS:
            return read_image
    raise ValueError(f"{path}: expected a file that ends in one of {', '.join(_ENDINGS)}.")


def _workspace_of_scene(path: Path) -> Workspace:
    return load(path).workspace
