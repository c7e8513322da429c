"""Reader of GeoJSON: polygons that are obstacles, or free space."""

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax._documents import errors_named, json_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.geometry.polygons import as_polygon
from plr_jax.geometry.workspace import Workspace

_DEGREES = np.array([180.0, 90.0])
_SMALL = 1.0  # degrees: what is mapped is smaller
_GEOMETRIES = ("Polygon", "MultiPolygon", "GeometryCollection")


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
            raise ValueError('expected GeoJSON: an object with "type" FeatureCollection, Feature or Polygon.')
        found = list(_polygons(document, ""))
        if not found:
            raise ValueError("the file has no polygon.")
        extent = shapely.total_bounds(found).reshape(2, 2)
        _warn_of_degrees(path, extent)
        box = Box.of(_bbox(document, extent) if bounds is None else bounds, "bounds")
        if polygons == "obstacles":
            return Workspace(box, found, squeeze=squeeze)
        return Workspace.from_polygons(found, box, squeeze=squeeze)


def is_geojson(document: Any) -> bool:
    """Whether what a JSON file holds is to be GeoJSON."""
    kinds = ("FeatureCollection", "Feature", "Point", "MultiPoint", "LineString", "MultiLineString", *_GEOMETRIES)
    return isinstance(document, dict) and document.get("type") in kinds


def _polygons(entry: Any, where: str) -> Iterator[shapely.Polygon | shapely.MultiPolygon]:
    """All polygons of an object, which an error names by where it is in the file."""
    match entry:
        case {"type": "FeatureCollection", "features": list(features)}:
            for i, feature in enumerate(features):
                yield from _polygons(feature, f"features[{i}]")
        case {"type": "Feature", "geometry": None}:
            return
        case {"type": "Feature", "geometry": geometry}:
            yield from _polygons(geometry, where)
        case {"type": "GeometryCollection", "geometries": list(geometries)}:
            for i, geometry in enumerate(geometries):
                yield from _polygons(geometry, f"{where} geometries[{i}]".strip())
        case {"type": "MultiPolygon", "coordinates": list(several)}:
            for i, rings in enumerate(several):
                yield _polygon(rings, f"{where} polygon {i}".strip())
        case {"type": "Polygon", "coordinates": rings}:
            yield _polygon(rings, f"{where} polygon".strip())
        case {"type": str(kind)}:
            raise ValueError(f"{where or 'the file'}: expected {', '.join(_GEOMETRIES)}, got {shortened(kind)}.")
        case _:
            raise ValueError(f"{where or 'the file'}: expected a GeoJSON object, got {shortened(entry)}.")


def _polygon(rings: Any, where: str) -> Any:
    if not isinstance(rings, list) or not rings:
        raise ValueError(f"{where}: expected a list of rings, got {shortened(rings)}.")
    outer, *holes = (_ring(ring, where) for ring in rings)
    return as_polygon(where, shapely.Polygon(outer, holes))


def _ring(ring: Any, where: str) -> Float[np.ndarray, "n 2"]:
    try:
        points = np.array([point[:2] for point in ring], dtype=np.float64)
    except (TypeError, ValueError, KeyError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[-1] != 2 or len(points) < 3 or not np.isfinite(points).all():
        raise ValueError(f"{where}: expected a ring of at least 3 finite points [x, y], got {shortened(ring)}.")
    return points


def _bbox(document: dict[str, Any], extent: Float[np.ndarray, "2 2"]) -> Any:
    """The box that a document states, west, south, east and north, perhaps with altitudes; or the extent."""
    bbox = document.get("bbox")
    if bbox is None:
        return extent
    if not isinstance(bbox, list) or len(bbox) not in (4, 6):
        raise ValueError(f'expected "bbox" to be 4 or 6 numbers, got {shortened(bbox)}.')
    half = len(bbox) // 2
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
