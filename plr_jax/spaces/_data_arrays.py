"""Read xarray's ``DataArray`` as a raster of two dimensions, y and x, with coordinates of the cell centers.

The functions open files of rasters, and return a raster's values, the box that its cells fill, and whether its
coordinates are degrees. xarray need not be installed.
"""

import os
import re
import warnings
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, filled_with_inf
from plr_jax._files import errors_named
from plr_jax.geometry.box import Box

# Attributes of a DataArray: values of cells without data; scales and offsets of values; reference systems.
_NO_DATA = "_FillValue", "missing_value", "nodata", "nodatavals", "fill_value"
_SCALES = ("scale_factor", 1.0), ("scales", 1.0), ("add_offset", 0.0), ("offsets", 0.0)
_REFERENCES = "crs_wkt", "spatial_ref", "crs", "grid_mapping_name"
# The first of these words in a reference system tells whether it is geographic (group 1) or projected.
_KIND = re.compile(
    r"(?i)(\b(?:GEOG|GEOD)\w*[\[(]|PROJ=L(?:AT|ON)|LATITUDE_LONGITUDE)|\bPROJ\w*[\[(]|PROJ=(?!OB_TRAN)"
)
# Units and radii (in meters, or feet) of geographic reference systems whose coordinates are not degrees on the Earth.
_ELSEWHERE = re.compile(r'(?i)"grad"|(?:(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*|\+[AR]=)(?!(?:6[34]|20[89])\d{5}\b)')
_X_NAMES = {"x", "lon", "longitude", "easting"}
_Y_NAMES = {"y", "lat", "latitude", "northing"}
_DEGREES = {"lon", "longitude", "lat", "latitude"}
_UNEVEN = 0.02  # largest distance of a coordinate from even spacing, as a share of a cell
_LEAST = -1e30  # costs and heights below are values of cells without data


def is_data_array(raster: Any) -> bool:
    # By its attributes: xarray may not be installed. A Dataset has no shape.
    return all(hasattr(raster, name) for name in ("dims", "coords", "attrs", "shape"))


def opened(name: str, raster: Any) -> Any:
    """Read the file of a raster if ``raster`` is its path, a ``str`` or ``os.PathLike``; else return ``raster``.

    rioxarray reads the file's only band, scales it as the file states, and puts NaN into cells without data.
    """
    if not isinstance(raster, str | os.PathLike):
        return raster
    with errors_named(raster):
        try:
            import rioxarray

            # Values stay numbers if their unit is minutes (decode), and are read once (cache).
            options: Any = {"mask_and_scale": True, "decode_times": False, "decode_timedelta": False, "cache": False}
            file: Any = rioxarray.open_rasterio(raster, **options)
            if not is_data_array(file) or len(file) != 1:
                advice = "choose one, as by rioxarray.open_rasterio(path, mask_and_scale=True)[0]"
                raise ValueError(f"{name} must be a file of one band, got several: {advice}.")
            band = file.squeeze(file.dims[0]).load()
        except ImportError as error:
            raise ImportError(f"{name} is a path, which needs rioxarray: pip install 'plr-jax[gis]'.") from error
        except OSError as error:
            kind = ValueError if os.path.exists(raster) else FileNotFoundError
            raise kind(f"{name} must be a file that rioxarray reads ({error.__cause__ or error}).") from None
    file.close()
    band.encoding.pop("_FillValue", None)  # such cells are NaN; where the file's mask allows the value, it is valid
    return band


def raster_values(name: str, raster: Any, expected: str = "a raster of numbers") -> Float[np.ndarray, "..."]:
    """Return the values of a raster as float64, with ``inf`` for cells that are masked, NaN or without data.

    Which values stand for cells without data is read from a ``DataArray``'s attributes or encoding. ``expected``
    describes a valid raster in error messages. The result is a copy.
    """
    cells: Any = np.asarray(raster) if is_data_array(raster) else filled_with_inf(raster)
    values = np.array(as_numbers(name, cells, expected))
    with np.errstate(over="ignore"):
        for number in _no_data_values(name, raster) if is_data_array(raster) else ():
            # NumPy rounds Python's number to the type of the cells. Cells of 64 bits may have been float32 before.
            rounded = np.float32(number) if cells.dtype.kind == "f" else number
            values[(cells == number) | (cells == rounded)] = np.inf
    values[np.isnan(values)] = np.inf
    if (lowest := values.min(initial=0.0, where=values > -np.inf)) < _LEAST:
        advice = "mask such cells, or name the value by raster.rio.write_nodata"
        raise ValueError(f"{name} must be {expected}, got {lowest:g}, which looks like no data: {advice}.")
    return values


def _no_data_values(name: str, raster: Any) -> set[float]:
    """Return the values that stand for cells without data in a ``DataArray``.

    ``ValueError`` if its attributes say that its values must still be scaled.
    """
    values = set()
    for table in (raster.attrs, raster.encoding):
        is_scaled = any(number != neutral for key, neutral in _SCALES for number in _numbers(table.get(key)))
        if is_scaled and table is raster.attrs:
            advice = "open it with mask_and_scale=True, or delete the attributes if its values are scaled"
            raise ValueError(f"{name} has attributes scale_factor or add_offset of values to be scaled: {advice}.")
        # An encoding describes the file: its value is not comparable with cells that were scaled since.
        values |= {number for key in _NO_DATA if not is_scaled for number in _numbers(table.get(key))}
    with suppress(Exception):  # rioxarray may not be imported
        values = values or set(_numbers(raster.rio.nodata))
    return values


def _numbers(value: Any) -> list[float]:
    """Return the numbers of an attribute, which may be a number, text, an array or a tuple."""
    numbers = []
    for entry in np.ravel(value):
        with suppress(TypeError, ValueError, OverflowError):  # None, or text of another kind
            numbers.append(float(entry))
    return numbers


def data_array_box(name: str, raster: Any) -> tuple[Box, tuple[slice, slice]]:
    """Return the box that the cells of a ``DataArray`` fill, and the slices of its rows and columns.

    An array of the raster's values, indexed by the slices, has ascending coordinates along both axes. Error messages
    call the raster ``name``.
    """
    # 1. Check the names of the dimensions, and the grid.
    if len(raster.dims) != 2:
        raise ValueError(f'{name} must have the dimensions y and x, got {raster.dims}: use squeeze("band") for one.')
    if str(raster.dims[0]).lower() in _X_NAMES or str(raster.dims[1]).lower() in _Y_NAMES:
        raise ValueError(f"{name} must have the dimensions y and x in this order, got {raster.dims}: transpose it.")
    if 0 in raster.shape:
        raise ValueError(f"{name} must have at least one cell, got shape {raster.shape}.")
    axes = raster.dims[::-1]
    tables = (_numbers(str(table.attrs.get("GeoTransform", "")).split()) for table in raster.coords.values())
    transform = next((table for table in tables if len(table) == 6), None)
    _, dx, x_skew, _, y_skew, dy = transform or (0, 1, 0, 0, 0, 1)
    if transform and not all(axis in raster.coords for axis in axes):
        kind = "rotated" if x_skew or y_skew else "placed by ground control points, or without coordinates"
        raise ValueError(f"{name} is {kind}: straighten it, with rioxarray by raster.rio.reproject(raster.rio.crs).")
    # 2. Coordinates are centers of cells. A single row or column has cells of the shape that the file states.
    coordinates = [as_numbers(f"coordinates {axis!r}", raster[axis].values, "numbers") for axis in axes]
    sides = np.array([abs(along[-1] - along[0]) / max(len(along) - 1, 1) for along in coordinates])
    cell = np.abs([dx, dy]) if 0 < abs(dx * dy) < np.inf else np.ones(2)
    sides = np.where(np.array(raster.shape[::-1]) > 1, sides, cell * ((sides / cell).max() or 1.0))
    for axis, along, side in zip(axes, coordinates, sides, strict=True):
        if not np.isfinite(along).all():
            raise ValueError(f"coordinates {axis!r} must be finite, got {along[~np.isfinite(along)][0]}.")
        if side == 0 or not (np.abs(along - np.linspace(along[0], along[-1], len(along))) <= _UNEVEN * side).all():
            steps = np.diff(along)
            spaced = f"got steps from {steps.min():g} to {steps.max():g}"
            raise ValueError(f"coordinates {axis!r} must be evenly spaced, {spaced}.")
    lo = np.array([along.min() for along in coordinates]) - sides / 2
    columns, rows = (slice(None, None, -1 if along[0] > along[-1] else None) for along in coordinates)
    return Box(lo, lo + sides * raster.shape[::-1]), (rows, columns)


def is_in_degrees(raster: Any) -> bool:
    """Return whether the coordinates of a ``DataArray`` are degrees of longitude and latitude.

    The units of the coordinates decide; else the first reference system that is found; else the dimensions' names.
    Reference systems of other planets, or in other units, raise ``ValueError``.
    """
    units = [str(raster[axis].attrs.get(key)).lower() for axis in raster.dims for key in ("units", "standard_name")]
    if any(unit.startswith(("degree", "longitude", "latitude")) for unit in units):
        return True
    tables = [*(coordinate.attrs for coordinate in raster.coords.values()), raster.attrs]
    texts = [str(table[key]) for table in tables for key in _REFERENCES if key in table]
    with suppress(Exception):  # rioxarray may not be imported
        texts.append(raster.rio.crs.to_wkt())
    for text in texts:
        if not (kind := _KIND.search(text)):
            with suppress(Exception), warnings.catch_warnings(action="ignore"):  # not installed, or no such system
                import pyproj

                text = pyproj.CRS.from_user_input(text).to_wkt()
                kind = _KIND.search(text)
        if kind:
            if kind[1] and _ELSEWHERE.search(text):
                raise ValueError(f"Coordinates must be degrees on the Earth, got {text[:60]}...: project the raster.")
            return kind[1] is not None
    # GDAL keeps the attributes of a NetCDF file's coordinates under names such as "lat#units".
    names = [*map(str, raster.dims), *(key.split("#")[0] for key in map(str, raster.attrs) if "#" in key)]
    return any(name.lower() in _DEGREES for name in names)
