"""Read xarray's ``DataArray`` as a raster of two dimensions, y and x, with coordinates of the cell centers.

The functions return the raster's values, and the box that its cells fill. xarray need not be installed.
"""

import warnings
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, filled_with_inf
from plr_jax.geometry.box import Box

NO_DATA = "_FillValue", "nodata", "missing_value"  # attributes of a DataArray: values of cells without data
_X_NAMES = {"x", "lon", "longitude", "easting"}
_Y_NAMES = {"y", "lat", "latitude", "northing"}
_DEGREES = {"lon", "longitude", "lat", "latitude"}
_UNEVEN = 1e-3  # largest difference of two steps between coordinates, as a share of a step


def is_data_array(raster: Any) -> bool:
    # By its attributes: xarray may not be installed.
    return all(hasattr(raster, name) for name in ("dims", "coords", "attrs"))


def raster_values(name: str, raster: Any, expected: str = "a raster of numbers") -> Float[np.ndarray, "..."]:
    """Return the values of a raster as float64, with ``inf`` for cells that are masked, NaN or without data.

    The attributes of a ``DataArray`` name the values of cells without data. ``expected`` describes a valid raster in
    error messages. The result is a copy.
    """
    values = np.array(as_numbers(name, filled_with_inf(raster), expected))
    if is_data_array(raster):
        for key in NO_DATA:
            values[values == raster.attrs.get(key)] = np.inf
    values[np.isnan(values)] = np.inf
    return values


def data_array_box(name: str, raster: Any) -> tuple[Box, tuple[slice, slice]]:
    """Return the box that the cells of a ``DataArray`` fill, and the slices of its rows and columns.

    An array of the raster's values, indexed by the slices, has ascending coordinates along both axes. If coordinates
    look like degrees, a warning is issued. Error messages call the raster ``name``.
    """
    # 1. Check the names and the units of the dimensions.
    if len(raster.dims) != 2:
        raise ValueError(f'{name} must have the dimensions y and x, got {raster.dims}: use squeeze("band") for one.')
    if str(raster.dims[0]).lower() in _X_NAMES or str(raster.dims[1]).lower() in _Y_NAMES:
        raise ValueError(f"{name} must have the dimensions y and x in this order, got {raster.dims}: transpose it.")
    in_degrees = any(str(axis).lower() in _DEGREES for axis in raster.dims)
    in_degrees |= any(str(raster[axis].attrs.get("units", "")).startswith("degree") for axis in raster.dims)
    in_degrees |= any(_is_geographic(coordinate.attrs) for coordinate in raster.coords.values())
    if in_degrees:
        advice = "project the raster, with rioxarray by raster.rio.reproject(raster.rio.estimate_utm_crs())"
        message = f"Coordinates {raster.dims} seem to be degrees, so that lengths are in degrees: {advice}."
        warnings.warn(message, UserWarning, stacklevel=4)
    # 2. Along x, then y: coordinates are centers of cells, half a step from their sides.
    lo, hi, slices = [], [], []
    for axis in raster.dims[::-1]:
        along = as_numbers(f"coordinates {axis!r}", raster[axis].values, "numbers")
        steps = np.diff(along)
        side = abs(along[-1] - along[0]) / len(steps) if len(steps) else 1.0
        if side == 0 or not (np.abs(np.abs(steps) - side) <= _UNEVEN * side).all():
            spaced = f"got steps from {steps.min():g} to {steps.max():g}"
            raise ValueError(f"coordinates {axis!r} must be evenly spaced, {spaced}.")
        lo.append(along.min() - side / 2)
        hi.append(lo[-1] + side * len(along))
        slices.append(slice(None, None, -1 if along[0] > along[-1] else None))
    return Box(lo, hi), (slices[1], slices[0])  # slices of rows (y) come first


def _is_geographic(attributes: dict[str, Any]) -> bool:
    name, text = (str(attributes.get(key, "")) for key in ("grid_mapping_name", "crs_wkt"))  # the CF conventions
    return name == "latitude_longitude" or text.startswith("GEOG")


def opened(name: str, raster: Any) -> Any:
    return raster


def is_in_degrees(raster: Any) -> bool:
    in_degrees = any(str(axis).lower() in _DEGREES for axis in raster.dims)
    in_degrees |= any(str(raster[axis].attrs.get("units", "")).startswith("degree") for axis in raster.dims)
    return in_degrees or any(_is_geographic(coordinate.attrs) for coordinate in raster.coords.values())
