"""Readers of maps that are pictures, where light is free, alone or beside the YAML of ROS's ``map_server``."""

import errno
import math
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_bool, as_finite, as_number, shortened
from plr_jax._files import errors_named, yaml_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.masks import require_resolved_pixels
from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces import RasterCost

if TYPE_CHECKING:
    from PIL.Image import Image

PICTURE_ENDINGS = (".png", ".pgm", ".pbm", ".ppm", ".pnm", ".bmp", ".gif", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
YAML_ENDINGS = (".yaml", ".yml")
_FORMATS = ("PNG", "PPM", "BMP", "GIF", "JPEG", "TIFF", "WEBP")  # of Pillow's those that run no other program
_MOST_PIXELS, _MOST_DECODED, _MOST_BYTES = 2**24, 3 * 2**24, 2**26
_SMALL, _PIXELS_PER_BYTE = 2**22, 2**12  # what a file may promise, whatever it holds, and else for what it holds
_BYTES = {"1": 1, "L": 1, "P": 1}  # of a decoded pixel, where they are not 4
_BAND = 2**18  # pixels that become numbers at a time
OPAQUE = 255
_BITS_PER_SAMPLE, _PHOTOMETRIC, _SAMPLE_FORMAT = 258, 262, 339  # tags of TIFF
_PIXEL_SCALE, _TIE_POINT, _TRANSFORMATION, _GEO_KEYS, _GDAL_NODATA = 33550, 33922, 34264, 34735, 42113  # of GeoTIFF
_PIXEL_IS_POINT = 1025, 0, 1, 2  # a key of GeoTIFF, by which places in the raster are those of pixels' centers
_IS_GEOGRAPHIC = 1024, 0, 1, 2  # a key of GeoTIFF, by which coordinates are longitudes and latitudes
_BLACK_IS_ZERO, _SIGNED = 1, 2
_GRAY_STEP = {"L;2": 85, "L;4": 17}  # of PNG: between two of a few grays, of 256


def read_image(
    path: str | os.PathLike[str],
    resolution: float | int = 1.0,
    origin: ArrayLike = (0, 0),
    *,
    threshold: float | int = 0.5,
    tolerance: float | int = 0.5,
    drop_specks: int = 0,
    squeeze: bool = False,
) -> Workspace:
    """Read a picture of a map, such as a scanned floor plan, as a workspace.

    What is light is free. Lightness is the mean of a pixel's colors, black 0 and white 1. Transparent pixels are seen
    as on white paper, and the picture as its file says that it is to be turned. The lowest row has the least ``y``.

    Args:
        path: A picture of at most 16,777,216 pixels, 12,582,912 in color, but above 4,194,304 at most 4,096 for each
            byte of the file: PNG, PGM, PBM, PPM, BMP, GIF (its first frame), JPEG, TIFF or WebP, in 8 or 16 bits a
            color.
        resolution: As for :meth:`Workspace.from_mask`, and so are ``origin``, ``tolerance``, ``drop_specks`` and
            ``squeeze``.
        origin: Of the outer corner of the picture's lower left pixel.
        threshold: Lightness above which a pixel is free, from 0 to less than 1.
        tolerance: Of the outline, in pixels.
        drop_specks: Pixels of components that are dropped.
        squeeze: As for the class.

    Returns:
        The workspace; its bounds are the bounding box of what is free.

    Raises:
        ValueError: If the file is no such picture, is damaged or too large, nothing in it is free, or an argument is
            out of range.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    threshold = as_number("threshold", threshold, "a number from 0 to less than 1", lambda number: 0 <= number < 1)
    with errors_named(path):
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free_pixels(path, threshold), resolution, origin, row0="top", **options)


def free_pixels(path: Path, threshold: float | int = 0.5) -> Bool[np.ndarray, "rows columns"]:
    """Which pixels of a picture are free, or of a map of ``map_server``; the picture's first row first."""
    if path.suffix.lower() in YAML_ENDINGS:
        return _MapServer.read(path).free(unknown_is_free=False)
    with opened(path) as picture:
        free = np.empty((picture.height, picture.width), bool)
        for rows, light, full, alpha in bands(picture):
            on_white = light if alpha is None else full + (light - full) * (alpha / OPAQUE)
            free[rows] = on_white > threshold * full
    return free


@contextmanager
def opened(path: Path, *, floats: bool = False) -> Iterator["Image"]:
    """A picture, decoded and turned as it says; ``ValueError`` if it is none, damaged, or too large to be decoded.

    Args:
        path: The file.
        floats: Whether its pixels may be floating-point numbers.
    """
    from PIL import Image, ImageOps

    with path.open("rb") as file, warnings.catch_warnings():
        num_bytes = os.fstat(file.fileno()).st_size
        if num_bytes > _MOST_BYTES:
            raise ValueError(f"expected a picture of at most {_MOST_BYTES:,} bytes, got a larger file.")
        warnings.simplefilter("ignore")  # of Pillow, about what is refused here or does not matter
        try:
            picture = Image.open(file, formats=_FORMATS)
        except Exception as error:  # Pillow's decoders raise anything
            expected = "a TIFF of 32-bit floats" if floats else f"a picture ({', '.join(_FORMATS)})"
            raise ValueError(f"expected {expected}, got something else ({error}).") from None
        with picture:
            _require_modest(picture, num_bytes)
            if not (floats and picture.mode == "F"):
                _require_plain(picture)
            try:
                ImageOps.exif_transpose(picture, in_place=True)
            except Exception as error:
                raise ValueError(f"the picture is damaged ({error or type(error).__name__}).") from None
            yield picture


def _require_modest(picture: "Image", num_bytes: int) -> None:
    num_pixels = picture.width * picture.height
    if num_pixels > _MOST_PIXELS or num_pixels * _BYTES.get(picture.mode, 4) > _MOST_DECODED:
        raise ValueError(
            f"expected a picture of at most {_MOST_PIXELS:,} pixels, {_MOST_DECODED // 4:,} in color, got "
            f"{picture.width:,} x {picture.height:,}: make it smaller."
        )
    most = max(_SMALL, _PIXELS_PER_BYTE * num_bytes)
    if num_pixels > most:
        raise ValueError(
            f"expected at most {most:,} pixels in a file of {num_bytes:,} bytes, got {picture.width:,} x "
            f"{picture.height:,}: it is damaged, or nearly all of it is of one color and can be cut off."
        )


def _require_plain(picture: Any) -> None:
    """Refuse pixels of which Pillow does not tell how light they are, or which of them are transparent."""
    raw = str(picture.tile[0][3]) if picture.tile else ""
    tags, is_deep = getattr(picture, "tag_v2", None), picture.mode.startswith("I")  # more than 8 bits of gray
    is_plain = tags is None or _SIGNED not in tags.get(_SAMPLE_FORMAT, ())
    if tags and is_deep:
        is_plain &= tags.get(_BITS_PER_SAMPLE) == (16,) and tags.get(_PHOTOMETRIC) == _BLACK_IS_ZERO
    if picture.mode == "F" or not is_plain:
        raise ValueError(
            "expected black, gray or color in 8 or 16 bits, unsigned and 0 for black, got a TIFF of others: save it "
            "in 8 bits."
        )
    if picture.mode == "RGB" and "16" in raw and "transparency" in picture.info:
        raise ValueError("expected a transparent color of 8 bits, got one of 16: save it with an alpha channel.")
    if raw in _GRAY_STEP and "transparency" in picture.info:  # which Pillow counts otherwise than pixels
        picture.info["transparency"] *= _GRAY_STEP[raw]


class Band(NamedTuple):
    """Some rows of a picture: which, how light their pixels are, up to ``full``, and how opaque, up to 255."""

    rows: slice
    light: Int[np.ndarray, "rows columns"]
    full: int
    alpha: Int[np.ndarray, "rows columns"] | None  # None: all of them are


def bands(picture: "Image") -> Iterator[Band]:
    """The rows of a picture, some at a time, from the top."""
    step = max(1, _BAND // picture.width)
    for top in range(0, picture.height, step):
        bottom = min(top + step, picture.height)
        part = picture.crop((0, top, picture.width, bottom))
        yield Band(slice(top, bottom), *_light_of(part))


def _light_of(
    part: "Image",
) -> tuple[Int[np.ndarray, "rows columns"], int, Int[np.ndarray, "rows columns"] | None]:
    if part.mode.startswith("I"):
        light, clear = np.asarray(part, np.int32), part.info.get("transparency")
        return light, 2**16 - 1, None if clear is None else np.where(light == clear, 0, OPAQUE)
    if part.mode in ("1", "L") and not part.has_transparency_data:
        return np.asarray(part.convert("L"), np.int32), 2**8 - 1, None
    red, green, blue, alpha = np.moveaxis(np.asarray(part.convert("RGBA")), 2, 0).astype(np.int32)
    return red + green + blue, 3 * (2**8 - 1), alpha if part.has_transparency_data else None


# Readers of the maps of ROS's ``map_server``: a YAML file beside a picture.


_REQUIRED = ("image", "resolution", "origin")
_MODES = ("trinary", "scale", "raw")
_RAW_FULL, _RAW_MOST = 255, 100  # a raw pixel is a share of occupancy in percent; unknown is what is beyond
_FREE, _OCCUPIED, _UNKNOWN = 0, 100, -1  # of occupancy grids


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
    ``occupied_thresh`` occupied, else unknown. What transparency means depends on the mode. ``trinary``: in a picture
    with an alpha channel, lightness is the mean of red, green, blue and alpha, as in ROS and in Nav2 up to Jazzy.
    ``scale``: pixels that are not opaque are unknown. ``raw``: pixels from 0 to 100 are the occupancy in percent, and
    other pixels are unknown; alpha does not count.

    ``origin`` is the pose ``[x, y, yaw]`` of the lower left pixel's outer corner: the map is turned about it by
    ``yaw`` radians, counterclockwise, whatever that does to the bounds.

    Args:
        path: The ``.yaml`` file. Its ``image`` is relative to its folder. ``negate`` is 0 where it is missing,
            ``occupied_thresh`` 0.65, ``free_thresh`` 0.196, and ``mode`` ``trinary``.
        unknown_is_free: Whether what is unknown is free; else it is an obstacle.
        tolerance: As for :meth:`Workspace.from_mask`, and so are ``drop_specks`` and ``squeeze``.
        drop_specks: Pixels of components that are dropped.
        squeeze: As for the class.

    Returns:
        The workspace, in meters; its bounds are the bounding box of what is free. It knows no costs: what lies
        between the thresholds is unknown, in the mode ``scale`` as well, where :func:`read_cost_map` has costs.

    Raises:
        ValueError: If the file is no such map, its picture is damaged or too large, or nothing in it is free.
        OSError: If a file cannot be read.

    References:
        http://wiki.ros.org/map_server; https://docs.nav2.org/configuration/packages/configuring-map-server.html.
    """
    path = Path(path)
    unknown_is_free = as_bool("unknown_is_free", unknown_is_free)
    with errors_named(path):
        map_server = _MapServer.read(path)
        free = map_server.free(unknown_is_free)
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free, map_server.resolution, map_server.origin, row0="top", **options)


def read_cost_map(
    path: str | os.PathLike[str],
    *,
    cost_travel_multiplier: float | int = 2.0,
    unknown_is_free: bool = False,
    interpolation: str = "bilinear",
) -> RasterCost:
    """Read a map of ROS's ``map_server``, or a TIFF of costs, as a cost map in the frame of the map.

    Pixels of ``map_server`` become the values of an occupancy grid as it makes them. In the mode ``trinary`` they are
    0 where :func:`read_map_server` finds them free, 100 where occupied, and -1 where unknown. In the mode ``scale``
    what is neither is from 0 to 100 as its occupancy is between the thresholds, rounded, and only what is not opaque
    is unknown (gray 205, which means that elsewhere, is free). In the mode ``raw``, which knows no thresholds, they
    are the percents themselves. Occupied cells are blocked; of a map without other costs
    ``read_cost_map(path).inflated(inscribed_radius)`` is what a robot's cost map is.

    Pixels of a TIFF of 32-bit floats are the factors themselves. A cell is blocked where the factor is ``inf``, NaN,
    or the value that GDAL's tag names as missing. A GeoTIFF lies where its tags say, in its own units; in other files
    a pixel is a square of side 1, and the outer corner of the lower left one is ``(0, 0)``.

    Args:
        path: The ``.yaml`` file, as for :func:`read_map_server`, or a ``.tif`` or ``.tiff`` file of one channel of
            floats; of a map that is not turned.
        cost_travel_multiplier: As for :meth:`RasterCost.from_occupancy_grid`, and so is ``unknown_is_free``; neither
            is for a TIFF.
        unknown_is_free: Whether what is unknown may be passed, as dear as the dearest cell; else it is blocked.
        interpolation: As for :class:`RasterCost`.

    Returns:
        The cost map of all pixels of the picture, in meters or in the units of the GeoTIFF.

    Raises:
        ValueError: If the file is no such map, it is turned, its picture is damaged or too large, all is blocked, or
            an option is given that is not for this kind of file.
        OSError: If a file cannot be read.

    Warns:
        UserWarning: If the coordinates of a GeoTIFF are degrees, in which lengths then are.

    References:
        https://docs.nav2.org/configuration/packages/configuring-map-server.html;
        OGC GeoTIFF Standard 1.1, 2019.
    """
    path = Path(path)
    with errors_named(path):
        if path.suffix.lower() in (".tif", ".tiff"):
            if (cost_travel_multiplier, unknown_is_free) != (2.0, False):
                raise ValueError("cost_travel_multiplier and unknown_is_free are not for a TIFF: leave them out.")
            return _read_factors(path, interpolation)
        map_server = _MapServer.read(path)
        x, y, yaw = map_server.origin
        if yaw != 0:
            raise ValueError(
                f"expected an origin with yaw 0, as the cells of a raster lie along the axes, got {yaw:g}: turn the "
                "picture."
            )
        grid = map_server.cells(map_server.occupancy_grid, np.int8)[::-1]
        require_resolved_pixels(grid.shape, map_server.resolution, max(abs(x), abs(y)))
        hi = x + grid.shape[1] * map_server.resolution, y + grid.shape[0] * map_server.resolution
        return RasterCost.from_occupancy_grid(
            grid,
            ((x, y), hi),
            cost_travel_multiplier=cost_travel_multiplier,
            unknown_is_free=unknown_is_free,
            interpolation=interpolation,
        )


def _read_factors(path: Path, interpolation: str) -> RasterCost:
    """The cost map whose factors are the pixels of a TIFF."""
    with opened(path, floats=True) as picture:
        if picture.mode != "F":
            raise ValueError(
                f"expected a TIFF of 32-bit floats, got a picture of mode {picture.mode}. For gray values of "
                "map_server give its .yaml file."
            )
        tags: Any = picture.tag_v2  # type: ignore[reportAttributeAccessIssue]
        factors = np.array(picture, np.float32)[::-1]
    # 1. What is missing.
    with np.errstate(over="ignore"):
        factors[factors == np.float32(str(tags.get(_GDAL_NODATA, "nan")).strip(" \0"))] = np.inf
    # 2. Where the pixels are: one place in the raster, that place in the map, and the sides of a pixel.
    if _TRANSFORMATION in tags:
        raise ValueError(
            "expected a GeoTIFF whose rows lie along x, got one with a transformation: turn the picture."
        )
    rows, columns = factors.shape
    column, row, _, x, y, _ = _doubles(tags, _TIE_POINT, (0, rows, 0, 0, 0, 0))
    sides = _doubles(tags, _PIXEL_SCALE, (1, 1, 0))[:2]
    along_x, along_y = (as_finite("a pixel's side", side, positive=True) for side in sides)
    keys = np.ravel(tags.get(_GEO_KEYS, ()))
    keys = keys[: len(keys) // 4 * 4].reshape(-1, 4).tolist()
    if [*_PIXEL_IS_POINT] in keys:
        column, row = column + 0.5, row + 0.5
    if [*_IS_GEOGRAPHIC] in keys:
        warnings.warn("Coordinates are degrees, and so are lengths: project the raster to meters.", stacklevel=4)
    lo = x - column * along_x, y - (rows - row) * along_y
    require_resolved_pixels(factors.shape, min(along_x, along_y), float(np.abs(lo).max()))
    hi = lo[0] + columns * along_x, lo[1] + rows * along_y
    return RasterCost(factors.astype(np.float64), (lo, hi), interpolation)


def _doubles(tags: Any, tag: int, default: tuple[float | int, ...]) -> tuple[Any, ...]:
    values = tags.get(tag, default)
    if not isinstance(values, tuple) or len(values) != len(default) or not np.isfinite(values).all():
        raise ValueError(f"expected {len(default)} finite numbers in the tag {tag}, got {shortened(values)}.")
    return values


@dataclass(frozen=True, eq=False)
class _MapServer:
    """What the YAML file of a map says."""

    image: Path
    resolution: float
    origin: Float[np.ndarray, "3"]
    mode: str
    negate: bool
    free_thresh: float
    occupied_thresh: float

    @classmethod
    def read(cls, path: Path) -> "_MapServer":
        """The file of a map; ``ValueError`` if it is none, an error of the system if its picture is missing."""
        entry = yaml_of(path)
        missing = [key for key in _REQUIRED if not isinstance(entry, dict) or key not in entry]
        if missing:
            raise ValueError(f"expected the keys {', '.join(_REQUIRED)}; missing {', '.join(missing)}.")
        if not isinstance(entry["image"], str) or (image := path.parent / entry["image"]).is_dir():
            raise ValueError(f"image must be the name of a picture, got {shortened(entry['image'])}.")
        if not image.exists():
            raise FileNotFoundError(errno.ENOENT, f"No such picture, which is the image of {path}", str(image))
        mode, negate = entry.get("mode", "trinary"), entry.get("negate", 0)
        if mode not in _MODES:
            raise ValueError(f"mode must be one of {', '.join(_MODES)}, got {shortened(mode)}.")
        if negate not in (0, 1):
            raise ValueError(f"negate must be 0 or 1, got {shortened(negate)}.")
        resolution, origin = as_finite("resolution", _number(entry, "resolution"), positive=True), _origin(entry)
        thresholds = _number(entry, "free_thresh", 0.196), _number(entry, "occupied_thresh", 0.65)
        return cls(image, resolution, origin, mode, bool(negate), *thresholds)

    def cells(
        self, value_of: Callable[[Float[np.ndarray, "rows columns"]], Shaped[np.ndarray, "rows columns"]], dtype: Any
    ) -> Shaped[np.ndarray, "rows columns"]:
        """What a function makes of the pixels' occupancy, NaN where it is unknown; the picture's first row first."""
        with errors_named(self.image), opened(self.image) as picture:
            cells = np.empty((picture.height, picture.width), dtype)
            for rows, light, full, alpha in bands(picture):
                if self.mode == "trinary" and alpha is not None:
                    light = 0.75 * light + 0.25 * full * (alpha / OPAQUE)
                occupancy = (light if self.negate else full - light) / full
                if self.mode == "raw":
                    percent = np.rint(_RAW_FULL * light / full)
                    occupancy = np.where(percent <= _RAW_MOST, percent / _RAW_MOST, np.nan)
                if self.mode == "scale" and alpha is not None:
                    occupancy = np.where(alpha == OPAQUE, occupancy, np.nan)
                cells[rows] = value_of(occupancy)
        return cells

    def free(self, unknown_is_free: bool) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels are free; the picture's first row first."""
        least, most = self.free_thresh, self.occupied_thresh
        return self.cells(lambda occupancy: ~(occupancy > most) if unknown_is_free else occupancy < least, bool)

    def occupancy_grid(self, occupancy: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
        """Values of cells of ROS's ``OccupancyGrid``, from 0 to 100, and -1 where they are unknown."""
        between = np.full(occupancy.shape, _UNKNOWN, np.float64)
        if self.mode == "raw":
            return np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_RAW_MOST * occupancy))
        least, most = self.free_thresh, self.occupied_thresh
        if self.mode == "scale" and least < most:
            share = np.clip((occupancy - least) / (most - least), 0.0, 1.0)
            between = np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_OCCUPIED * share))
        return np.where(occupancy > most, _OCCUPIED, np.where(occupancy < least, _FREE, between))


def _number(entry: dict[str, Any], key: str, default: float | None = None) -> float:
    value = entry.get(key, default)
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{key} must be a finite number, got {shortened(value)}.")
    return float(value)


def _origin(entry: dict[str, Any]) -> Float[np.ndarray, "3"]:
    value = entry["origin"]
    if not isinstance(value, list) or len(value) not in (2, 3):
        raise ValueError(f"origin must be [x, y, yaw], got {shortened(value)}.")
    return np.array([_number({"origin": each}, "origin") for each in [*value, 0.0][:3]])
