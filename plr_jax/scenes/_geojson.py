"""Read files of polygons as workspaces: JSON files of rings, GeoJSON, and well-known text (WKT)."""

import math
import os
import re
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
    """Read a workspace from a JSON file of free-space polygons; its bounds are the bounding box of the polygons.

    The file has one of these forms. A ring is a list of points ``[x, y]``; ``"holes"`` is optional::

        {"components": [{"outer": ring, "holes": [ring, ...]}, ...]}
        {"outer": ring, "holes": [ring, ...]}
        {"boundary": ring, "holes": [ring, ...]}        (extremitypathfinder)

    Other keys are ignored. ``squeeze`` says whether a path may pass between two obstacles that touch in one point.
    An invalid file raises ``ValueError``.
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
_MAX_TOWN = 1.0  # degrees: coordinates that span less may be longitudes and latitudes
_PARTS_KEY = {
    "FeatureCollection": "features",
    "Feature": "geometry",
    "GeometryCollection": "geometries",
    "MultiPolygon": "coordinates",
    "Polygon": "coordinates",
}  # supported objects, and the key of their parts
# Parts of well-known text that are dropped: in "SRID=4326; POLYGON ZM ((1 2 3 4, ..." the reference "SRID=4326;", the
# dimensions "ZM", and in each point the altitude 3 and the measure 4.
_REFERENCE = re.compile(r"(?i)^\s*srid\s*=\s*\d+\s*;")
_DIMENSIONS = re.compile(r"(?i)([a-z])\s*(?:z|m|zm)\s*(?=\(|empty)")
_NUMBER = r"\s*[-+]?(?:nan|inf|[\d.]+(?:e[-+]?\d+)?)"
_ALTITUDES = re.compile(rf"(?i)([(,]{_NUMBER}\s{_NUMBER})(?:\s{_NUMBER}){{1,2}}(?=\s*[,)])")
_MOST_NESTED = 32  # parentheses of WKT: GEOS parses them by recursion
_UNSUPPORTED = ("Point", "MultiPoint", "LineString", "MultiLineString")


def read_geojson(
    path: str | os.PathLike[str],
    *,
    polygons: Literal["obstacles", "free"] = "obstacles",
    bounds: Box | ArrayLike | None = None,
    squeeze: bool = False,
) -> Workspace:
    """Read the polygons of a GeoJSON file (RFC 7946) as a workspace.

    Coordinates are points of a plane with one unit for both axes. Project degrees of longitude and latitude first,
    for example to UTM; a warning tells if coordinates look like degrees.

    Args:
        path: A file with a FeatureCollection, a Feature, or a geometry: a polygon, a multipolygon, or a collection of
            these geometries. Null and empty geometries are skipped, altitudes are dropped.
        polygons: Whether the polygons are obstacles or free space.
        bounds: Bounds of the workspace. None: the file's ``"bbox"``, or else the bounding box of all polygons.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Raises:
        ValueError: If the file is not GeoJSON, has other geometries or a polygon that crosses itself or is not
            finite, nothing is free, or an argument is invalid.
    """
    path = Path(path)
    with errors_named(path):
        document = json_of(path)
        if not is_geojson(document):
            raise ValueError(f'expected GeoJSON of "type" {", ".join(_PARTS_KEY)}, got {shortened(document)}.')
        shapes, bbox = list(_polygons(document, "")), document.get("bbox")
        if bounds is None and bbox is not None:  # [west, south, east, north], or six numbers with altitudes
            half = len(bbox) // 2 if isinstance(bbox, list) and len(bbox) in (4, 6) else 0
            if not (half and _is_position(bbox) and _is_position(bbox[half:])):
                raise ValueError(
                    'expected "bbox" to be 4 finite numbers, [x0, y0, x1, y1], or 6 with altitudes, '
                    f"got {shortened(bbox)}."
                )
            bounds = bbox[:2], bbox[half : half + 2]
        return _workspace_of(path, shapes, polygons, bounds, squeeze)


def read_wkt(
    path: str | os.PathLike[str],
    *,
    polygons: Literal["obstacles", "free"] = "free",
    bounds: Box | ArrayLike | None = None,
    squeeze: bool = False,
) -> Workspace:
    """Read the polygons of a geometry in well-known text as a workspace, such as a walkable area of JuPedSim.

    A ``.wkt`` file has one polygon, one multipolygon, or one collection of polygons and multipolygons. Empty
    geometries are skipped; altitudes, measures and ``SRID=...;`` are dropped. Arguments, units and errors are those
    of :func:`read_geojson`, except for two defaults: polygons are free space, and bounds are the bounding box of the
    polygons.
    """
    path = Path(path)
    with errors_named(path):
        text = text_of(path)
        codes = np.frombuffer(text.encode(), np.uint8)
        if np.cumsum((codes == ord("(")).astype(np.int64) - (codes == ord(")"))).max(initial=0) > _MOST_NESTED:
            raise ValueError(f"expected parentheses at most {_MOST_NESTED} deep, got deeper ones.")
        try:
            with np.errstate(all="ignore"):
                # GEOS refuses a geometry of which only some points have altitudes.
                text = _ALTITUDES.sub(r"\1", _DIMENSIONS.sub(r"\1 ", _REFERENCE.sub("", text)))
                geometry = shapely.from_wkt(text)
        except (shapely.errors.GEOSException, NotImplementedError) as error:
            raise ValueError(
                f"expected one geometry in WKT, got something else ({error}). Put several geometries into a "
                "GEOMETRYCOLLECTION."
            ) from None
        shapes = [as_polygon(f"polygon {i}", part) for i, part in enumerate(_parts(geometry)) if not part.is_empty]
        return _workspace_of(path, shapes, polygons, bounds, squeeze)


def _parts(geometry: Any) -> Iterator[Any]:
    if isinstance(geometry, BaseMultipartGeometry):
        for part in geometry.geoms:
            yield from _parts(part)
    else:
        yield geometry


def _workspace_of(
    path: Path, shapes: list[Any], polygons: str, bounds: Box | ArrayLike | None, squeeze: bool
) -> Workspace:
    """Return a workspace with the obstacles ``shapes``; if ``polygons`` is "free", ``shapes`` are the free space.

    If ``bounds`` is None, the bounds are the bounding box of ``shapes``. ``squeeze`` says whether paths may pass
    between obstacles that touch in a point. A warning tells if coordinates look like degrees.
    """
    if polygons not in ("obstacles", "free"):
        raise ValueError(f"polygons must be 'obstacles' or 'free', got {shortened(polygons)}.")
    if not shapes:
        raise ValueError("expected at least one polygon, got none: all geometries of the file are empty.")
    extent = shapely.total_bounds(shapes).reshape(2, 2)
    width = np.ptp(extent, axis=0).max()
    # A town in degrees is small and far from the origin, and within 180 and 90 degrees.
    if (np.abs(extent) <= _DEGREES).all() and width < _MAX_TOWN and np.abs(extent).max() > 10 * width:
        warnings.warn(
            f"{path}: coordinates look like degrees of longitude and latitude, but are used as points of a plane, in "
            "which a degree is as long along x as along y. Project them first, for example to UTM.",
            stacklevel=3,
        )
    box = Box.of(extent if bounds is None else bounds, "bounds")
    if polygons == "free":
        return Workspace.from_polygons(shapes, box, squeeze=squeeze)
    try:
        return Workspace(box, shapes, squeeze=squeeze)
    except ValueError as error:
        if bounds is not None:
            raise
        raise ValueError(
            f'{error} The bounds are the bounding box of the polygons: give larger bounds (in GeoJSON a "bbox"), or '
            "polygons='free'."
        ) from error


def is_geojson(document: Any) -> bool:
    return isinstance(document, dict) and document.get("type") in (*_PARTS_KEY, *_UNSUPPORTED)


def _polygons(entry: Any, where: str) -> Iterator[shapely.Polygon | shapely.MultiPolygon]:
    """Yield the polygons in a GeoJSON object; ``where`` names the object's place in the file for error messages."""
    if entry is None:
        return
    kind = entry.get("type") if isinstance(entry, dict) else None
    place = where or "the file"
    # Empty points and lines are skipped, as empty polygons are.
    if isinstance(kind, str) and kind in _UNSUPPORTED and not entry.get("coordinates"):
        return
    if not isinstance(kind, str) or kind not in _PARTS_KEY:
        got = shortened(entry if kind is None else kind)
        raise ValueError(f'{place}: expected an object of "type" {", ".join(_PARTS_KEY)}, got {got}.')
    key = _PARTS_KEY[kind]
    if key not in entry:
        raise ValueError(f'{place}: expected a {kind} to have the key "{key}", got only {", ".join(entry)}.')
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
    """Yield the polygon of a list of rings, outer ring first, or nothing if all rings are empty.

    ``where`` names the polygon's place in the file for error messages.
    """
    if not isinstance(rings, list | None):
        raise ValueError(f"{where}: expected a list of rings, got {shortened(rings)}.")
    rings = rings or []
    nonempty = [ring for ring in rings if ring not in (None, [])]
    for ring in nonempty:
        if not (isinstance(ring, list) and len(ring) >= 3 and all(map(_is_position, ring))):
            expected = "a ring, a list of at least 3 finite points [x, y] of numbers"
            raise ValueError(f"{where}: expected {expected}, got {shortened(ring)}.")
    if nonempty and nonempty[0] is not rings[0]:
        raise ValueError(f"{where}: expected an outer ring before its holes, got an empty one.")
    if nonempty:
        outer, *holes = (np.array([point[:2] for point in ring], dtype=np.float64) for ring in nonempty)
        yield as_polygon(where, shapely.Polygon(outer, holes))


def _is_position(value: Any) -> bool:
    pair = value[:2] if isinstance(value, list) else []
    return len(pair) == 2 and all(type(along) in (int, float) and math.isfinite(along) for along in pair)
