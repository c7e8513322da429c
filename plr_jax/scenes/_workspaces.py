"""Read workspaces: polygons in JSON, GeoJSON or well-known text (WKT), and files of any supported format.

:func:`read_workspace` chooses the reader by the file's ending and content.
"""

import inspect
import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry, BaseMultipartGeometry

from plr_jax._arrays import as_numbers, require_choice, shortened
from plr_jax._files import StrPath, errors_named, json_of, text_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import as_polygon, flatten_collections
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._grids import read_map
from plr_jax.scenes._pictures import PICTURE_ENDINGS, YAML_ENDINGS, read_image, read_map_server
from plr_jax.scenes._scenes import is_scene, load


def read_polygons(path: StrPath, *, squeeze: bool = False) -> Workspace:
    """Read a workspace from a JSON file of free-space polygons; its bounds are the bounding box of the polygons.

    The file has one of these forms. A ring is a list of points ``[x, y]``; ``"holes"`` is optional::

        {"components": [{"outer": ring, "holes": [ring, ...]}, ...]}
        {"outer": ring, "holes": [ring, ...]}
        {"boundary": ring, "holes": [ring, ...]}        (extremitypathfinder)

    Other keys are ignored. ``squeeze`` says whether a path may pass between two obstacles that touch in one point.
    An invalid file raises ``ValueError``.
    """
    with errors_named(path) as file:
        match json_of(file):
            case {"components": list(components)}:
                pass
            case {"outer": outer, **others} | {"boundary": outer, **others}:
                components = [{**others, "outer": outer}]
            case _:
                forms = '{"components": [{"outer", "holes"}, ...]}, {"outer", "holes"} or {"boundary", "holes"}'
                raise ValueError(f"expected {forms}.")
        return Workspace.from_polygons(components, squeeze=squeeze)


Bounds: TypeAlias = Box | ArrayLike | None
Role: TypeAlias = Literal["obstacles", "free"]  # of the polygons in a file
_DEGREES = np.array([180.0, 90.0])
_MAX_TOWN = 1.0  # degrees: coordinates that span less may be longitudes and latitudes
_SUPPORTED_TYPES = ("FeatureCollection", "Feature", "GeometryCollection", "MultiPolygon", "Polygon")
_UNSUPPORTED_TYPES = ("Point", "MultiPoint", "LineString", "MultiLineString")
# Parts of well-known text that are dropped: in "SRID=4326; POLYGON ZM ((1 2 3 4, ..." the reference "SRID=4326;", the
# dimensions "ZM", and in each point the altitude 3 and the measure 4.
_REFERENCE = re.compile(r"(?i)^\s*srid\s*=\s*\d+\s*;")
_DIMENSIONS = re.compile(r"(?i)([a-z])\s*(?:z|m|zm)\s*(?=\(|empty)")
_NUMBER = r"\s*[-+]?(?:nan|inf|[\d.]+(?:e[-+]?\d+)?)"
_ALTITUDES = re.compile(rf"(?i)([(,]{_NUMBER}\s{_NUMBER})(?:\s{_NUMBER}){{1,2}}(?=\s*[,)])")
_MOST_NESTED = 32  # parentheses of WKT: GEOS parses them by recursion


def read_geojson(
    path: StrPath, *, polygons: Role = "obstacles", bounds: Bounds = None, squeeze: bool = False
) -> Workspace:
    """Read the polygons of a GeoJSON file (RFC 7946) as a workspace.

    Coordinates are points of a plane with one unit for both axes. Project degrees of longitude and latitude first,
    for example to UTM; a warning tells if coordinates look like degrees.

    Args:
        path: A file with a FeatureCollection, a Feature, or a geometry: polygons, multipolygons and collections of
            them. Features without a geometry, and empty geometries, are skipped; altitudes are dropped.
        polygons: Whether the polygons are obstacles or free space.
        bounds: Bounds of the workspace. None: the file's ``"bbox"``, or else the bounding box of all polygons.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Raises:
        ValueError: If the file is not GeoJSON, has other geometries or a polygon that crosses itself or is not
            finite, nothing is free, or an argument is invalid.
    """
    with errors_named(path) as file:
        # 1. Read the polygons. GEOS refuses features whose geometry is null, which GeoJSON allows: skip them.
        if not _is_geojson(document := json_of(file)):
            raise ValueError(f'expected GeoJSON of "type" {", ".join(_SUPPORTED_TYPES)}, got {shortened(document)}.')
        if isinstance(items := document.get("features"), list):
            document["features"] = [f for f in items if not isinstance(f, dict) or f.get("geometry", f) is not None]
        try:
            geometry = shapely.from_geojson(json.dumps(document))
        except shapely.errors.GEOSException as error:
            raise ValueError(f"expected polygons in GeoJSON, got something else ({error}).") from None
        # 2. Read the bounds: [west, south, east, north], or six numbers with altitudes.
        if bounds is None and (bbox := document.get("bbox")) is not None:
            expected = "4 numbers, [x0, y0, x1, y1], or 6 with altitudes"
            if (corners := as_numbers('"bbox"', bbox, expected)).shape not in ((4,), (6,)):
                raise ValueError(f'"bbox" must be {expected}, got {shortened(bbox)}.')
            bounds = corners.reshape(2, -1)[:, :2]
        return _workspace(file, geometry, polygons, bounds, squeeze)


def read_wkt(path: StrPath, *, polygons: Role = "free", bounds: Bounds = None, squeeze: bool = False) -> Workspace:
    """Read the polygons of a geometry in well-known text as a workspace, such as a walkable area of JuPedSim.

    A ``.wkt`` file has one polygon, one multipolygon, or one collection of polygons and multipolygons. Empty
    geometries are skipped; altitudes, measures and ``SRID=...;`` are dropped. Arguments, units and errors are those
    of :func:`read_geojson`, except for two defaults: polygons are free space, and bounds are the bounding box of the
    polygons.
    """
    with errors_named(path) as file:
        text = text_of(file)
        codes = np.frombuffer(text.encode(), np.uint8)
        depth = np.cumsum((codes == ord("(")).astype(np.int64) - (codes == ord(")")))  # of nested parentheses
        if depth.max(initial=0) > _MOST_NESTED:
            raise ValueError(f"expected parentheses at most {_MOST_NESTED} deep, got deeper ones.")
        try:
            with np.errstate(all="ignore"):  # NaN, or a number too large for a float, would give a warning
                # GEOS refuses a geometry of which only some points have altitudes.
                text = _ALTITUDES.sub(r"\1", _DIMENSIONS.sub(r"\1 ", _REFERENCE.sub("", text)))
                geometry = shapely.from_wkt(text)
        except (shapely.errors.GEOSException, NotImplementedError) as error:
            advice = "Put several geometries into a GEOMETRYCOLLECTION."
            raise ValueError(f"expected one geometry in WKT, got something else ({error}). {advice}") from None
        return _workspace(file, geometry, polygons, bounds, squeeze)


def _workspace(path: Path, geometry: Any, polygons: str, bounds: Bounds, squeeze: bool) -> Workspace:
    """Return a workspace whose obstacles or, if ``polygons`` is "free", whose free space are the polygons.

    ``geometry`` is a Shapely geometry of polygons. If ``bounds`` is None, the bounds are its bounding box.
    ``squeeze`` says whether paths may pass between obstacles that touch in a point. A warning tells if coordinates
    look like degrees.
    """
    require_choice("polygons", polygons, get_args(Role))
    parts = flatten_collections(shapely.force_2d(geometry), BaseMultipartGeometry)
    shapes = [as_polygon(f"polygon {i}", part) for i, part in enumerate(parts) if not part.is_empty]
    if not shapes:
        raise ValueError("expected at least one polygon, got none: all geometries of the file are empty.")
    extent = shapely.total_bounds(shapes).reshape(2, 2)
    width = np.ptp(extent, axis=0).max()
    # A town in degrees is small and far from the origin, and within 180 and 90 degrees.
    if (np.abs(extent) <= _DEGREES).all() and width < _MAX_TOWN and np.abs(extent).max() > 10 * width:
        problem = f"{path}: coordinates look like degrees of longitude and latitude"
        use = "but are used as points of a plane, in which a degree is as long along x as along y"
        warnings.warn(f"{problem}, {use}. Project them first, for example to UTM.", stacklevel=3)
    box = Box.of(extent if bounds is None else bounds, "bounds")
    if polygons == "free":
        return Workspace.from_polygons(shapes, box, squeeze=squeeze)
    try:
        return Workspace(box, shapes, squeeze=squeeze)
    except ValueError as error:
        if bounds is not None:
            raise
        advice = 'give larger bounds (in GeoJSON a "bbox")'
        reason = f"{error} The bounds are the bounding box of the polygons"
        raise ValueError(f"{reason}: {advice}, or polygons='free'.") from error


def _is_geojson(document: Any) -> bool:
    return isinstance(document, dict) and document.get("type") in (*_SUPPORTED_TYPES, *_UNSUPPORTED_TYPES)


_READERS: dict[str, Callable[..., Workspace]] = {
    ".map": read_map,
    ".json": read_polygons,  # or another reader, chosen by the content
    ".geojson": read_geojson,
    ".wkt": read_wkt,
    **dict.fromkeys(YAML_ENDINGS, read_map_server),
    **dict.fromkeys(PICTURE_ENDINGS, read_image),
}


def read_workspace(path: StrPath | BaseGeometry, **options: Any) -> Workspace:
    """Read a workspace from a file of any supported format, chosen by the file's ending and content.

    - picture, such as ``.png``: :func:`read_image`; map of ``map_server``, ``.yaml``: :func:`read_map_server`
    - GeoJSON, ``.json`` or ``.geojson``: :func:`read_geojson`; well-known text, ``.wkt``: :func:`read_wkt`
    - Moving AI grid, ``.map``: :func:`read_map`; polygons with holes, ``.json``: :func:`read_polygons`
    - scene, ``.json``: :func:`load`; Shapely polygons of free space (no file): :meth:`Workspace.from_polygons`

    Options are those of the reader. Pictures have their lowest row at the lowest ``y``. So do ``.map`` grids with
    ``row0="top"``; by default, their first row is at the lowest ``y``. Other files have coordinates. A file or an
    option that is not supported raises ``ValueError``.
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
    if (ending := path.suffix.lower()) not in _READERS:
        raise ValueError(f"{path}: expected a file that ends in one of {', '.join(_READERS)}.")
    if ending == ".json" and is_scene(path):
        return lambda path: load(path).workspace
    with errors_named(path):
        return read_geojson if ending == ".json" and _is_geojson(json_of(path)) else _READERS[ending]
