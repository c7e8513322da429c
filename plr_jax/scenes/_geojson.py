"""Readers of polygons in JSON: GeoJSON, and outer rings with holes."""

import math
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax._files import errors_named, json_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import as_polygon
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace

# Reader of polygon files: free space as outer rings with holes, in JSON.


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


_DEGREES = np.array([180.0, 90.0])
_SMALL = 1.0  # degrees: what is mapped is smaller
_HOLDS = {
    "FeatureCollection": "features",
    "Feature": "geometry",
    "GeometryCollection": "geometries",
    "MultiPolygon": "coordinates",
    "Polygon": "coordinates",
}  # what is read, and the key under which it holds what it is made of
_NOT_READ = ("Point", "MultiPoint", "LineString", "MultiLineString")


def read_geojson(
    path: str | os.PathLike[str],
    *,
    polygons: Literal["obstacles", "free"] = "obstacles",
    bounds: Box | ArrayLike | None = None,
    squeeze: bool = False,
) -> Workspace:
    """Read the polygons of a GeoJSON file as a workspace.

    Coordinates are taken as they are, as points of a plane with equal units along both axes. Degrees of longitude and
    latitude are not: what looks like them is read with a warning. Project it first, to UTM for one.

    Args:
        path: A FeatureCollection, a Feature, or a geometry: polygons, multipolygons and collections of them.
            Features without a geometry count for nothing, altitudes are dropped.
        polygons: Whether the polygons are obstacles or free space.
        bounds: The bounds, as for :class:`Workspace`. None: the file's ``"bbox"``, or the bounding box of all
            polygons.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Returns:
        The workspace.

    Raises:
        ValueError: If the file is no GeoJSON, has a geometry of another kind or a polygon that is not simple and
            finite, nothing is free, or an argument is none of the above.
        OSError: If the file cannot be read.

    References:
        H. Butler et al., "The GeoJSON Format", RFC 7946, 2016.
    """
    path = Path(path)
    if polygons not in ("obstacles", "free"):
        raise ValueError(f"polygons must be 'obstacles' or 'free', got {shortened(polygons)}.")
    with errors_named(path):
        document = json_of(path)
        if not is_geojson(document):
            raise ValueError(f'expected GeoJSON, an object of "type" {", ".join(_HOLDS)}, got {shortened(document)}.')
        found = list(_polygons(document, ""))
        if not found:
            raise ValueError("expected a polygon at least, got none: the file has no feature with a geometry.")
        extent = shapely.total_bounds(found).reshape(2, 2)
        _warn_of_degrees(path, extent)
        box = Box.of(_bbox(document, extent) if bounds is None else bounds, "bounds")
        if polygons == "free":
            return Workspace.from_polygons(found, box, squeeze=squeeze)
        try:
            return Workspace(box, found, squeeze=squeeze)
        except ValueError as error:
            if bounds is not None or document.get("bbox") is not None:
                raise
            raise ValueError(
                f'{error} They are the bounding box of the polygons: give the file a "bbox" with room around those '
                "(or bounds, in Python), or say that polygons are 'free'."
            ) from error


def is_geojson(document: Any) -> bool:
    """Whether what a JSON file holds is to be GeoJSON."""
    return isinstance(document, dict) and document.get("type") in (*_HOLDS, *_NOT_READ)


def _polygons(entry: Any, where: str) -> Iterator[shapely.Polygon | shapely.MultiPolygon]:
    """All polygons of an object, which an error names by where it is in the file."""
    kind, place = entry.get("type") if isinstance(entry, dict) else None, where or "the file"
    if not isinstance(kind, str) or kind not in _HOLDS:
        got = shortened(entry if kind is None else kind)
        raise ValueError(f'{place}: expected an object of "type" {", ".join(_HOLDS)}, got {got}.')
    key = _HOLDS[kind]
    if key not in entry:
        raise ValueError(f'{place}: a {kind} needs the key "{key}", and this one has only {", ".join(entry)}.')
    parts = entry[key]
    if kind == "Feature":
        if parts is not None:
            yield from _polygons(parts, f"{where} geometry".strip())
        return
    if not isinstance(parts, list):
        raise ValueError(f'{place}: expected "{key}" of a {kind} to be a list, got {shortened(parts)}.')
    match kind:
        case "Polygon":
            yield _polygon(parts, f"{where} polygon".strip())
        case "MultiPolygon":
            for i, rings in enumerate(parts):
                yield _polygon(rings, f"{where} polygon {i}".strip())
        case _:
            for i, part in enumerate(parts):
                yield from _polygons(part, f"{where} {key}[{i}]".strip())


def _polygon(rings: Any, where: str) -> Any:
    if not isinstance(rings, list) or not rings:
        raise ValueError(f"{where}: expected a list of rings, got {shortened(rings)}.")
    outer, *holes = (_ring(ring, where) for ring in rings)
    return as_polygon(where, shapely.Polygon(outer, holes))


def _ring(ring: Any, where: str) -> Float[np.ndarray, "n 2"]:
    if not (isinstance(ring, list) and len(ring) >= 3 and all(map(_is_position, ring))):
        expected = "a ring, a list of at least 3 finite points [x, y] of numbers"
        raise ValueError(f"{where}: expected {expected}, got {shortened(ring)}.")
    return np.array([point[:2] for point in ring], dtype=np.float64)


def _is_position(value: Any) -> bool:
    """Whether a value is a list that begins with two finite numbers, which texts and truth values are not."""
    return (
        isinstance(value, list)
        and len(value) >= 2
        and all(type(along) in (int, float) and math.isfinite(along) for along in value[:2])
    )


def _bbox(document: dict[str, Any], extent: Float[np.ndarray, "2 2"]) -> Any:
    """The box that a document states, west, south, east and north, perhaps with altitudes; or the extent."""
    bbox = document.get("bbox")
    if bbox is None:
        return extent
    half = len(bbox) // 2 if isinstance(bbox, list) and len(bbox) in (4, 6) else 0
    if not (half and _is_position(bbox) and _is_position(bbox[half:])):
        raise ValueError(
            f'expected "bbox" to be 4 finite numbers, [x0, y0, x1, y1], or 6 with altitudes, got {shortened(bbox)}.'
        )
    return bbox[:2], bbox[half : half + 2]


def _warn_of_degrees(path: Path, extent: Float[np.ndarray, "2 2"]) -> None:
    """Warn of coordinates like those of a town: far from the origin for their extent, and no more than degrees."""
    width = np.ptp(extent, axis=0).max()
    if (np.abs(extent) <= _DEGREES).all() and width < _SMALL and np.abs(extent).max() > 10 * width:
        warnings.warn(
            f"{path}: coordinates look like degrees of longitude and latitude. They are taken for points of a plane, "
            "in which a degree is as long along x as along y; project them first, to UTM for one.",
            stacklevel=3,
        )
