"""Reader of the maps of ROS's ``map_server``: a YAML file beside a picture."""

import errno
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_bool, shortened
from plr_jax._documents import errors_named, yaml_of
from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._pictures import OPAQUE, bands, opened

_REQUIRED = ("image", "resolution", "origin")
_OPTIONAL = ("negate", "occupied_thresh", "free_thresh", "mode")
_MODES = ("trinary", "scale", "raw")
_RAW_FULL, _RAW_MOST = 255, 100  # a raw pixel is a share of occupancy in percent; unknown is what is beyond


def read_map_server(
    path: str | os.PathLike[str],
    *,
    unknown_is_free: bool = False,
    tolerance: float | int = 0.5,
    drop_specks: int = 0,
    squeeze: bool = False,
) -> Workspace:
    """Read a map of ROS's ``map_server``, a robot's occupancy grid, as a workspace in the frame of the map.

    A pixel's occupancy is ``1 - lightness``, with ``negate`` its lightness. Below ``free_thresh`` it is free, above
    ``occupied_thresh`` occupied, else unknown. In the mode ``scale`` pixels that are not opaque are unknown as well;
    in the mode ``raw`` pixels from 0 to 100 are the occupancy in percent, and others unknown. ``origin`` is the pose
    ``[x, y, yaw]`` of the lower left pixel's outer corner: the map is turned about it by ``yaw`` radians,
    counterclockwise, whatever that does to the bounds.

    Args:
        path: The ``.yaml`` file. Its ``image`` is relative to its folder. ``negate`` is 0 where it is missing,
            ``occupied_thresh`` 0.65, ``free_thresh`` 0.196, and ``mode`` ``trinary``.
        unknown_is_free: Whether what is unknown is free; else it is an obstacle.
        tolerance: As for :meth:`Workspace.from_mask`, and so are ``drop_specks`` and ``squeeze``.
        drop_specks: Pixels of components that are dropped.
        squeeze: As for the class.

    Returns:
        The workspace, in meters; its bounds are the bounding box of what is free.

    Raises:
        ValueError: If the file is no such map, its picture is damaged or too large, or nothing in it is free.
        OSError: If a file cannot be read.

    References:
        http://wiki.ros.org/map_server; https://docs.nav2.org/configuration/packages/configuring-map-server.html.
    """
    path = Path(path)
    unknown_is_free = as_bool("unknown_is_free", unknown_is_free)
    with errors_named(path):
        entry = yaml_of(path)
        missing = [key for key in _REQUIRED if not isinstance(entry, dict) or key not in entry]
        if missing:
            raise ValueError(f"expected the keys {', '.join(_REQUIRED)}; missing {', '.join(missing)}.")
        if not isinstance(entry["image"], str) or (image := path.parent / entry["image"]).is_dir():
            raise ValueError(f"image must be the name of a picture, got {shortened(entry['image'])}.")
        if not image.exists():
            raise FileNotFoundError(errno.ENOENT, f"No such picture, which is the image of {path}", str(image))
        resolution, (x, y, yaw) = _number(entry, "resolution"), _origin(entry["origin"])
        with errors_named(image):
            free = _free_pixels(image, entry, unknown_is_free)
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free, resolution, (x, y, yaw), row0="top", **options)


def is_map_server(document: Any) -> bool:
    """Whether what a YAML file holds is to be such a map: it has a key of one, if perhaps not all that it needs."""
    return isinstance(document, dict) and any(key in document for key in (*_REQUIRED, *_OPTIONAL))


def _free_pixels(image: Path, entry: dict[str, Any], unknown_is_free: bool) -> Bool[np.ndarray, "rows columns"]:
    mode, negate = entry.get("mode", "trinary"), entry.get("negate", 0)
    if mode not in _MODES:
        raise ValueError(f"mode must be one of {', '.join(_MODES)}, got {shortened(mode)}.")
    if negate not in (0, 1):
        raise ValueError(f"negate must be 0 or 1, got {shortened(negate)}.")
    least, most = _number(entry, "free_thresh", 0.196), _number(entry, "occupied_thresh", 0.65)
    with opened(image) as picture:
        free = np.empty((picture.height, picture.width), bool)
        for rows, light, full, alpha in bands(picture):
            occupancy = (light if negate else full - light) / full
            if mode == "raw":
                percent = np.rint(_RAW_FULL * light / full)
                occupancy = np.where(percent <= _RAW_MOST, percent / _RAW_MOST, np.nan)
            if mode == "scale" and alpha is not None:
                occupancy = np.where(alpha == OPAQUE, occupancy, np.nan)
            free[rows] = ~(occupancy > most) if unknown_is_free else occupancy < least
    return free


def _number(entry: dict[str, Any], key: str, default: float | None = None) -> float:
    value = entry.get(key, default)
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{key} must be a finite number, got {shortened(value)}.")
    return float(value)


def _origin(value: Any) -> Float[np.ndarray, "3"]:
    if not isinstance(value, list) or len(value) not in (2, 3):
        raise ValueError(f"origin must be [x, y, yaw], got {shortened(value)}.")
    return np.array([_number({"origin": each}, "origin") for each in [*value, 0.0][:3]])
