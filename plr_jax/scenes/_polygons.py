"""Reader of polygon files: free space as outer rings with holes, in JSON."""

import os
from pathlib import Path
from typing import Any

import shapely

from plr_jax._documents import errors_named, json_of
from plr_jax.geometry.workspace import Workspace


def read_polygons(path: str | os.PathLike[str], *, squeeze: bool = False) -> Workspace:
    """Read a workspace from a JSON file of free-space polygons.

    A ring is a list of ``[x, y]`` points. Three shapes of file are understood::

        {"components": [{"outer": ring, "holes": [ring, ...]}, ...]}
        {"outer": ring, "holes": [ring, ...]}
        {"boundary": ring, "holes": [ring, ...]}        (extremitypathfinder)

    ``"holes"`` may be missing; other keys are ignored.

    Args:
        path: The ``.json`` file.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Returns:
        The workspace; its bounds are the bounding box of the polygons.

    Raises:
        ValueError: If the file is no JSON, has none of these shapes, or a ring is invalid.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    with errors_named(path):
        return Workspace.from_polygons(_components(json_of(path)), squeeze=squeeze)


def rings_of(polygon: shapely.Polygon) -> dict[str, Any]:
    """A polygon as a document holds it: ``{"outer": ring, "holes": [ring, ...]}``."""
    outer, *holes = (shapely.get_coordinates(ring)[:-1].tolist() for ring in (polygon.exterior, *polygon.interiors))
    return {"outer": outer, "holes": holes}


def _components(data: Any) -> list[Any]:
    match data:
        case {"components": list(components)}:
            return components
        case {"outer": _}:
            return [data]
        case {"boundary": ring}:
            return [{**data, "outer": ring}]
    raise ValueError(
        'expected {"components": [{"outer", "holes"}, ...]}, {"outer", "holes"} or {"boundary", "holes"}.'
    )
