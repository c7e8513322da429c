"""Readers of polygons: outer rings with holes in JSON, GeoJSON, and well-known text."""

import math
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseMultipartGeometry

from plr_jax._arrays import shortened
from plr_jax._files import errors_named, json_of, text_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import as_polygon
from plr_jax.geometry.box import Box
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
        match json_of(path):
            case {"components": list(components)}:
                pass
            case {"outer": outer, **others} | {"boundary": outer, **others}:
                components = [{**others, "outer": outer}]
            case _:
                raise ValueError(
                    'expected {"components": [{"outer", "holes"}, ...]}, {"outer", "holes"} or {"boundary", "holes"}.'
                )
        return Workspace.from_polygons(components, squeeze=squeeze)


_DEGREES = np.array([180.0, 90.0])
_SMALL = 1.0  # degrees: what is mapped is smaller
_PARTS_KEY = {
    "FeatureCollection": "features",
    "Feature": "geometry",
    "GeometryCollection": "geometries",
    "MultiPolygon": "coordinates",
    "Polygon": "coordinates",
}  # objects that are read, and the key of their parts
_MOST_NESTED = 32  # parentheses of WKT, which GEOS reads by recursion
_UNSUPPORTED = ("Point", "MultiPoint", "LineString", "MultiLineString")


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
            What is null or empty counts for nothing, altitudes are dropped.
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
    with errors_named(path):
        document = json_of(path)
        if not is_geojson(document):
            raise ValueError(
                f'expected GeoJSON, an object of "type" {", ".join(_PARTS_KEY)}, got {shortened(document)}.'
            )
        found, bbox = list(_polygons(document, "")), document.get("bbox")
        if bounds is None and bbox is not None:  # west, south, east and north, perhaps with altitudes
            half = len(bbox) // 2 if isinstance(bbox, list) and len(bbox) in (4, 6) else 0
            if not (half and _is_position(bbox) and _is_position(bbox[half:])):
                raise ValueError(
                    'expected "bbox" to be 4 finite numbers, [x0, y0, x1, y1], or 6 with altitudes, '
                    f"got {shortened(bbox)}."
                )
            bounds = bbox[:2], bbox[half : half + 2]
        return _workspace_of(path, found, polygons, bounds, squeeze)


def read_wkt(
    path: str | os.PathLike[str],
    *,
    polygons: Literal["obstacles", "free"] = "free",
    bounds: Box | ArrayLike | None = None,
    squeeze: bool = False,
) -> Workspace:
    """Read the polygons of a geometry in well-known text as a workspace, such as a walkable area of JuPedSim.

    Args:
        path: A ``.wkt`` file of one geometry: a polygon, a multipolygon, or a collection of them. Empty geometries
            count for nothing, altitudes and measures are dropped. Units are as for :func:`read_geojson`.
        polygons: Whether the polygons are free space or obstacles.
        bounds: The bounds, as for :class:`Workspace`. None: the bounding box of all polygons.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Returns:
        The workspace.

    Raises:
        ValueError: If the file is no WKT, has a geometry of another kind or a polygon that is not simple and finite,
            nothing is free, or an argument is none of the above.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    with errors_named(path):
        text = text_of(path)
        codes = np.frombuffer(text.encode(), np.uint8)
        if np.cumsum((codes == ord("(")).astype(np.int64) - (codes == ord(")"))).max(initial=0) > _MOST_NESTED:
            raise ValueError(f"expected parentheses at most {_MOST_NESTED} deep, got deeper ones.")
        try:
            with np.errstate(all="ignore"):
                geometry = shapely.force_2d(shapely.from_wkt(text))
        except (shapely.errors.GEOSException, NotImplementedError) as error:
            raise ValueError(
                f"expected one geometry in WKT, got something else ({error}). Put several geometries into a "
                "GEOMETRYCOLLECTION."
            ) from None
        found = [as_polygon(f"polygon {i}", part) for i, part in enumerate(_parts(geometry)) if not part.is_empty]
        return _workspace_of(path, found, polygons, bounds, squeeze)


def _parts(geometry: Any) -> Iterator[Any]:
    if isinstance(geometry, BaseMultipartGeometry):
        for part in geometry.geoms:
            yield from _parts(part)
    else:
        yield geometry


def _workspace_of(
    path: Path, found: list[Any], polygons: str, bounds: Box | ArrayLike | None, squeeze: bool
) -> Workspace:
    """The workspace of polygons, whose bounding box gives the bounds where there are none."""
    if polygons not in ("obstacles", "free"):
        raise ValueError(f"polygons must be 'obstacles' or 'free', got {shortened(polygons)}.")
    if not found:
        raise ValueError("expected a polygon at least, got none: the file has no geometry that is not empty.")
    extent = shapely.total_bounds(found).reshape(2, 2)
    width = np.ptp(extent, axis=0).max()
    # Coordinates of a town in degrees are far from the origin for their extent, and no more than 180 and 90.
    if (np.abs(extent) <= _DEGREES).all() and width < _SMALL and np.abs(extent).max() > 10 * width:
        warnings.warn(
            f"{path}: coordinates look like degrees of longitude and latitude. They are taken for points of a "
            "plane, in which a degree is as long along x as along y; project them first, to UTM for one.",
            stacklevel=3,
        )
    box = Box.of(extent if bounds is None else bounds, "bounds")
    if polygons == "free":
        return Workspace.from_polygons(found, box, squeeze=squeeze)
    try:
        return Workspace(box, found, squeeze=squeeze)
    except ValueError as error:
        if bounds is not None:
            raise
        raise ValueError(
            f"{error} They are the bounding box of the polygons: give bounds with room around those (in GeoJSON a "
            "\"bbox\"), or say that polygons are 'free'."
        ) from error


def is_geojson(document: Any) -> bool:
    """Whether what a JSON file holds is to be GeoJSON."""
    return isinstance(document, dict) and document.get("type") in (*_PARTS_KEY, *_UNSUPPORTED)


def _polygons(entry: Any, where: str) -> Iterator[shapely.Polygon | shapely.MultiPolygon]:
    """All polygons of an object, which an error names by where it is in the file. What is null or empty has none."""
    if entry is None:
        return
    kind, place = entry.get("type") if isinstance(entry, dict) else None, where or "the file"
    if isinstance(kind, str) and kind in _UNSUPPORTED and not entry.get("coordinates"):
        return
    if not isinstance(kind, str) or kind not in _PARTS_KEY:
        got = shortened(entry if kind is None else kind)
        raise ValueError(f'{place}: expected an object of "type" {", ".join(_PARTS_KEY)}, got {got}.')
    key = _PARTS_KEY[kind]
    if key not in entry:
        raise ValueError(f'{place}: a {kind} needs the key "{key}", and this one has only {", ".join(entry)}.')
    parts = entry[key]
    if kind == "Feature":
        yield from _polygons(parts, f"{where} geometry".strip())
        return
    if not isinstance(parts, list | None):
        raise ValueError(f'{place}: expected "{key}" of a {kind} to be a list, got {shortened(parts)}.')
    match kind:
        case "Polygon":
            yield from _polygon(parts, f"{where} polygon".strip())
        case "MultiPolygon":
            for i, rings in enumerate(parts or ()):
                yield from _polygon(rings, f"{where} polygon {i}".strip())
        case _:
            for i, part in enumerate(parts or ()):
                yield from _polygons(part, f"{where} {key}[{i}]".strip())


def _polygon(rings: Any, where: str) -> Iterator[Any]:
    """The polygon of rings; none if they are null or empty."""
    if not isinstance(rings, list | None):
        raise ValueError(f"{where}: expected a list of rings, got {shortened(rings)}.")
    rings = rings or []
    given = [ring for ring in rings if ring not in (None, [])]
    for ring in given:
        if not (isinstance(ring, list) and len(ring) >= 3 and all(map(_is_position, ring))):
            expected = "a ring, a list of at least 3 finite points [x, y] of numbers"
            raise ValueError(f"{where}: expected {expected}, got {shortened(ring)}.")
    if given and given[0] is not rings[0]:
        raise ValueError(f"{where}: expected an outer ring before its holes, got an empty one.")
    if given:
        outer, *holes = (np.array([point[:2] for point in ring], dtype=np.float64) for ring in given)
        yield as_polygon(where, shapely.Polygon(outer, holes))


def _is_position(value: Any) -> bool:
    """Whether a value is a list that begins with two finite numbers, which texts and truth values are not."""
    return (
        isinstance(value, list)
        and len(value) >= 2
        and all(type(along) in (int, float) and math.isfinite(along) for along in value[:2])
    )
