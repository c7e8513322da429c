"""Read maps that are stored as pictures, alone or with the YAML file of ROS's ``map_server``; light means free."""

import errno
import math
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_bool, as_finite, as_number, shortened
from plr_jax._files import errors_named, yaml_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.masks import require_resolved_pixels
from plr_jax.geometry.workspace import Workspace

if TYPE_CHECKING:
    from PIL.Image import Image

    from plr_jax.spaces import RasterCost

Gray = Int[np.ndarray, "rows columns"]
PICTURE_ENDINGS = (".png", ".pgm", ".pbm", ".ppm", ".pnm", ".bmp", ".gif", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
YAML_ENDINGS = (".yaml", ".yml")
_FORMATS = ("PNG", "PPM", "BMP", "GIF", "JPEG", "TIFF", "WEBP")  # Pillow decodes these without external programs
# Limits of a picture, which bound the memory and time that any file takes.
_MOST_BYTES = 2**26  # bytes of the file
_MOST_PIXELS = 2**24
_MOST_DECODED = 3 * 2**24  # bytes of all decoded pixels
_SMALL = 2**22  # pixels that a file of any size may have
_PIXELS_PER_BYTE = 2**12  # most pixels per byte of the file, for larger pictures
_BYTES_PER_PIXEL = {"1": 1, "L": 1, "P": 1}  # by Pillow's mode, when decoded; all other modes take 4
_BAND = 2**18  # pixels that are converted at a time, which bounds the memory
_NUMBERS = "one channel of 32-bit floats, or of integers of 16 or 32 bits"
_NUMBER_MODES = "F", "I", "I;16", "I;16B"  # modes of Pillow for such pixels
OPAQUE = 255  # largest value of an alpha channel
_GRAY_STEP = {"L;2": 85, "L;4": 17}  # 8-bit step between gray levels of PNG files with 2 or 4 bits
# Tags of TIFF, two of their values, and tags of GeoTIFF.
_BITS_PER_SAMPLE, _PHOTOMETRIC, _SAMPLE_FORMAT = 258, 262, 339
_BLACK_IS_ZERO, _SIGNED = 1, 2  # values of _PHOTOMETRIC and of _SAMPLE_FORMAT
_PIXEL_SCALE, _TIE_POINT, _TRANSFORMATION, _GEO_KEYS, _GDAL_NODATA = 33550, 33922, 34264, 34735, 42113
# Entries of _GEO_KEYS: the key, the tag that holds its value (0: this entry), the number of values, and the value.
_PIXEL_IS_POINT = [1025, 0, 1, 2]  # raster coordinates refer to pixel centers
_IS_GEOGRAPHIC = [1024, 0, 1, 2]  # coordinates are longitudes and latitudes


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
    """Read a picture of a map, such as a scanned floor plan, as a workspace whose bounds enclose the free pixels.

    Lightness is the mean of a pixel's color channels, 0 for black and 1 for white. Transparent pixels appear on
    white. The orientation stored in the file is applied. The lowest row has the smallest ``y``.

    Args:
        path: A PNG, PGM, PBM, PPM, BMP, GIF (first frame), JPEG, TIFF or WebP file with 8 or 16 bits per channel. At
            most 16,777,216 pixels, or 12,582,912 in color; if above 4,194,304, at most 4,096 per byte of the file.
        resolution: Side of a pixel, in workspace units.
        origin: Position of the outer corner of the lower left pixel.
        threshold: Lightness above which a pixel is free, from 0 to less than 1.
        tolerance: Tolerance of the outline, in pixels, as for :meth:`Workspace.from_mask`.
        drop_specks: Blocked components of at most this many pixels become free. Then free components of at most this
            many pixels become blocked.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Raises:
        ValueError: If the file is no such picture, damaged or too large, nothing is free, or an argument is invalid.
    """
    threshold = as_number("threshold", threshold, "a number from 0 to less than 1", lambda number: 0 <= number < 1)
    with errors_named(path) as file:
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free_pixels(file, threshold), resolution, origin, row0="top", **options)


def free_pixels(path: Path, threshold: float | int = 0.5) -> Bool[np.ndarray, "rows columns"]:
    """Return which pixels are free: lighter than ``threshold`` (1 is white). Row 0 is the top row of the picture.

    The ``.yaml`` file of a map of ROS's ``map_server`` has thresholds of its own; unknown pixels are not free.
    """
    if path.suffix.lower() in YAML_ENDINGS:
        return _MapServer.read(path).free(unknown_is_free=False)
    with open_picture(path) as picture:
        free = np.empty((picture.height, picture.width), bool)
        for rows, light, white, alpha in bands(picture):
            # A pixel of opacity a = alpha / OPAQUE over white appears as a * light + (1 - a) * white.
            on_white = light if alpha is None else white + (light - white) * (alpha / OPAQUE)
            free[rows] = on_white > threshold * white
    return free


@contextmanager
def open_picture(path: Path, *, numbers: bool = False) -> Iterator["Image"]:
    """Open a picture, check it, and turn it upright; ``numbers`` also allows a TIFF with one channel of numbers.

    ``ValueError`` is raised if the file is no picture, is damaged or too large, or Pillow does not decode its pixels
    reliably.
    """
    from PIL import Image, ImageOps

    with path.open("rb") as file, warnings.catch_warnings():
        # 1. Read the header, which tells the size and the kind of pixels.
        num_bytes = os.fstat(file.fileno()).st_size
        if num_bytes > _MOST_BYTES:
            raise ValueError(f"expected a picture of at most {_MOST_BYTES:,} bytes, got a larger file.")
        warnings.simplefilter("ignore")  # Pillow warns of what is rejected here or harmless
        try:
            picture = Image.open(file, formats=_FORMATS)
        except Exception as error:  # Pillow's decoders raise any kind of error
            expected = f"a TIFF of {_NUMBERS}" if numbers else f"a picture ({', '.join(_FORMATS)})"
            raise ValueError(f"expected {expected}, got something else ({error}).") from None
        with picture:
            # 2. Reject pictures that take too much memory, before any pixel is decoded.
            _require_limits(picture, num_bytes)
            if not (numbers and picture.mode in _NUMBER_MODES):
                _require_plain(picture, numbers)  # also scales the transparent gray
            # 3. Decode the pixels, and apply the orientation that the file states.
            try:
                ImageOps.exif_transpose(picture, in_place=True)
            except Exception as error:
                raise ValueError(f"expected a complete picture, got a damaged one ({error}).") from None
            yield picture


def _require_limits(picture: "Image", num_bytes: int) -> None:
    """Raise a ``ValueError`` if a picture has too many pixels to decode, in all or per byte of its file.

    ``num_bytes`` is the size of the file.
    """
    size = f"{picture.width:,} x {picture.height:,}"
    num_pixels = picture.width * picture.height
    if num_pixels > _MOST_PIXELS or num_pixels * _BYTES_PER_PIXEL.get(picture.mode, 4) > _MOST_DECODED:
        limits = f"at most {_MOST_PIXELS:,} pixels, {_MOST_DECODED // 4:,} in color"
        raise ValueError(f"expected a picture of {limits}, got {size}: make it smaller.")
    max_pixels = max(_SMALL, _PIXELS_PER_BYTE * num_bytes)
    if num_pixels > max_pixels:
        limit = f"at most {max_pixels:,} pixels in a file of {num_bytes:,} bytes"
        raise ValueError(f"expected {limit}, got {size}: it is damaged, or nearly all of one color; crop it.")


def _require_plain(picture: Any, numbers: bool) -> None:
    """Raise a ``ValueError`` if Pillow does not decode the lightness or opacity of a picture reliably.

    In PNG files with 2 or 4 bits per pixel, one gray level may stand for transparent pixels. Pillow scales the pixels
    to 8 bits, but not this level: this function scales ``picture.info["transparency"]`` in place. If ``numbers``, the
    error message is for a reader of costs.
    """
    # 1. TIFF: unsigned numbers; gray of more than 8 bits has exactly 16, with 0 for black.
    tags = getattr(picture, "tag_v2", None)
    is_plain = tags is None or _SIGNED not in tags.get(_SAMPLE_FORMAT, ())
    if tags and picture.mode.startswith("I"):  # gray of more than 8 bits
        is_plain &= tags.get(_BITS_PER_SAMPLE) == (16,) and tags.get(_PHOTOMETRIC) == _BLACK_IS_ZERO
    if picture.mode == "F" or not is_plain:
        raise ValueError(
            "expected black, gray or color in 8 or 16 bits, unsigned and 0 for black, got a TIFF of other pixels: "
            f"save it in 8 bits{'' if numbers else ' for a map of walls; scenes.read_cost_map reads costs'}."
        )
    # 2. PNG: a color or gray that counts as transparent must be comparable with the pixels that Pillow decodes.
    if picture.tile and "transparency" in picture.info:
        raw_mode = str(picture.tile[0][3])  # how the file stores pixels: "L;4" is gray of 4 bits
        if picture.mode == "RGB" and "16" in raw_mode:
            raise ValueError("expected a transparent color of 8 bits, got 16 bits: save it with an alpha channel.")
        if raw_mode in _GRAY_STEP:
            picture.info["transparency"] *= _GRAY_STEP[raw_mode]


def bands(picture: "Image") -> Iterator[tuple[slice, Gray, int, Gray | None]]:
    """Yield a picture in bands of rows, to bound the memory.

    Each item is the slice of the band's rows, and the three results of :func:`_lightness` for these rows: the
    lightness of the pixels, the lightness of white, and the opacity.
    """
    step = max(1, _BAND // picture.width)
    for top in range(0, picture.height, step):
        bottom = min(top + step, picture.height)
        yield slice(top, bottom), *_lightness(picture.crop((0, top, picture.width, bottom)))


def _lightness(part: "Image") -> tuple[Gray, int, Gray | None]:
    """Return the lightness of each pixel, the lightness of white, and opacity from 0 to 255 (None if opaque)."""
    # Gray of 16 bits, and opaque gray of 8 bits, stay as they are; else lightness is the sum of red, green and blue.
    if part.mode.startswith("I"):
        light = np.asarray(part, np.int32)
        transparent = part.info.get("transparency")  # the gray of all pixels that are transparent
        return light, 2**16 - 1, None if transparent is None else np.where(light == transparent, 0, OPAQUE)
    if part.mode in ("1", "L") and not part.has_transparency_data:
        return np.asarray(part.convert("L"), np.int32), 2**8 - 1, None
    red, green, blue, alpha = np.moveaxis(np.asarray(part.convert("RGBA")), 2, 0).astype(np.int32)
    return red + green + blue, 3 * (2**8 - 1), alpha if part.has_transparency_data else None


_REQUIRED = ("image", "resolution", "origin")
_MODES = ("trinary", "scale", "raw")
_RAW_WHITE = 255  # mode "raw" reads pixels as integers from 0 (black) to this
_RAW_MOST = 100  # mode "raw": pixels up to this are occupancy in percent, others unknown
_FREE, _OCCUPIED, _UNKNOWN = 0, 100, -1  # values of occupancy grids


def read_map_server(
    path: str | os.PathLike[str],
    *,
    unknown_is_free: bool = False,
    tolerance: float | int = 0.5,
    drop_specks: int = 0,
    squeeze: bool = False,
) -> Workspace:
    """Read a map of ROS's ``map_server``, a robot's occupancy grid, as a workspace in meters.

    The occupancy of a pixel is ``1 - lightness``, with lightness from 0 (black) to 1 (white). If ``negate`` is set,
    it is the lightness itself. A pixel is free below ``free_thresh``, occupied above ``occupied_thresh``, and unknown
    between. The ``mode`` changes how pixels are read:

    - ``trinary``: in a picture with an alpha channel, lightness is the mean of red, green, blue and alpha, as in ROS
      and in Nav2 up to Jazzy.
    - ``scale``: pixels that are not opaque are unknown. (:func:`read_cost_map` reads costs between the thresholds.)
    - ``raw``: pixels from 0 to 100 are the occupancy in percent, others are unknown; alpha is ignored.

    ``origin`` is the pose ``[x, y, yaw]`` of the outer corner of the lower left pixel, about which the map is rotated
    by ``yaw`` radians counterclockwise. The bounds of the workspace are the bounding box of the free pixels.

    The ``.yaml`` file's ``image`` is relative to its folder. Defaults are ``negate`` 0, ``occupied_thresh`` 0.65,
    ``free_thresh`` 0.196 and ``mode`` ``trinary``. ``unknown_is_free`` says whether unknown pixels are free or
    obstacles; other arguments are as for :func:`read_image`. ``ValueError`` is raised if the file is not such a map,
    its picture is damaged or too large, or nothing is free.

    References: http://wiki.ros.org/map_server;
    https://docs.nav2.org/configuration/packages/configuring-map-server.html.
    """
    unknown_is_free = as_bool("unknown_is_free", unknown_is_free)
    with errors_named(path) as file:
        map_server = _MapServer.read(file)
        free = map_server.free(unknown_is_free)
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free, map_server.resolution, map_server.origin, row0="top", **options)


def read_cost_map(
    path: str | os.PathLike[str],
    *,
    cost_travel_multiplier: float | int = 2.0,
    unknown_is_free: bool = False,
    interpolation: str = "bilinear",
) -> "RasterCost":
    """Read a map of ROS's ``map_server``, or a TIFF of cost factors, as a cost map in the frame of the map.

    Pixels of a ``.yaml`` map, in meters and without rotation, become values of an occupancy grid, by mode:

    - ``trinary``: 0 where :func:`read_map_server` finds free pixels, 100 where occupied, -1 where unknown.
    - ``scale``: as ``trinary``, but between the thresholds values rise linearly from 0 to 100, rounded. Only pixels
      that are not opaque are unknown; so gray 205, which means unknown elsewhere, is free.
    - ``raw``: the percentages in the pixels, without thresholds.

    Occupied cells are blocked. If all other cells are free or unknown, the usual costs around obstacles are added by
    ``read_cost_map(path).inflated(inscribed_radius)``. ``cost_travel_multiplier`` and ``unknown_is_free`` are as for
    :meth:`RasterCost.from_occupancy_grid`; leave them out for a TIFF. ``interpolation`` is as
    for :class:`RasterCost`.

    Pixels of a ``.tif`` or ``.tiff`` file with one channel of 32-bit floats, or of integers of 16 or 32 bits, are the
    factors themselves: costs per unit of length. ``inf``, NaN and the no-data value of GDAL block a cell. A GeoTIFF
    (OGC standard 1.1, 2019) lies where its tags say, in its own units; a warning tells if these are degrees. In other
    TIFFs a pixel has side 1, and the outer corner of the lower left pixel is at ``(0, 0)``: the file's first row has
    the highest y.

    Raises:
        ValueError: If the file is not such a map, is rotated, its picture is damaged or too large, all cells are
            blocked, or an option is not for this kind of file.
    """
    with errors_named(path) as file:
        from plr_jax.spaces import RasterCost  # slow to import, and other readers do not need it

        if file.suffix.lower() in (".tif", ".tiff"):
            if (cost_travel_multiplier, unknown_is_free) != (2.0, False):
                raise ValueError("cost_travel_multiplier and unknown_is_free are not for a TIFF: leave them out.")
            return RasterCost(*_read_factors(file), interpolation)
        map_server = _MapServer.read(file)
        x, y, yaw = map_server.origin
        if yaw != 0:
            raise ValueError(f"expected an origin with yaw 0 for a raster, got {yaw:g}: rotate the picture.")
        grid = map_server.cells(map_server.occupancy_grid, np.int8)[::-1]
        require_resolved_pixels(grid.shape, map_server.resolution, max(abs(x), abs(y)))
        hi = x + grid.shape[1] * map_server.resolution, y + grid.shape[0] * map_server.resolution
        options: Any = {"unknown_is_free": unknown_is_free, "interpolation": interpolation}
        return RasterCost.from_occupancy_grid(
            grid, ((x, y), hi), cost_travel_multiplier=cost_travel_multiplier, **options
        )


def _read_factors(path: Path) -> tuple[Float[np.ndarray, "rows columns"], tuple[Any, Any]]:
    """Read a TIFF of cost factors; return the factors and the lower and upper corner of the raster.

    Row 0 of the factors has the lowest ``y``. Cells without data are ``inf``.
    """
    with open_picture(path, numbers=True) as picture:
        if picture.mode not in _NUMBER_MODES:
            advice = "For a map of map_server give its .yaml file."
            raise ValueError(f"expected a TIFF of {_NUMBERS}, got a picture of mode {picture.mode}. {advice}")
        tags: Any = picture.tag_v2  # type: ignore[reportAttributeAccessIssue]
        factors = np.array(picture, np.float64)[::-1]
    # 1. Block cells without data. Floats were rounded to 32 bits when they were written.
    no_data = float(str(tags.get(_GDAL_NODATA, "nan")).strip(" \0"))
    with np.errstate(over="ignore"):
        factors[factors == (float(np.float32(no_data)) if picture.mode == "F" else no_data)] = np.inf
    # 2. Locate the raster by the tie point: `column` and `row`, counted from the upper left corner of the raster, lie
    #    at (x, y) of the map.
    #      +-----------+    x = lo_x + column * along_x
    #      | o (x, y)  |    y = lo_y + (rows - row) * along_y, since rows count downward
    #      |           |
    #     lo-----------+
    if _TRANSFORMATION in tags:
        raise ValueError("expected a GeoTIFF whose rows lie along x, got a transformation: rotate the picture.")
    rows, columns = factors.shape
    column, row, _, x, y, _ = _doubles(tags, _TIE_POINT, (0, rows, 0, 0, 0, 0))  # by default lo is at (0, 0)
    sides = _doubles(tags, _PIXEL_SCALE, (1, 1, 0))[:2]
    along_x, along_y = (as_finite("a pixel's side", side, positive=True) for side in sides)
    keys = np.ravel(tags.get(_GEO_KEYS, ()))
    keys = keys[: len(keys) // 4 * 4].reshape(-1, 4).tolist()
    if _PIXEL_IS_POINT in keys:  # they are counted from the center of the upper left pixel, not from its corner
        column, row = column + 0.5, row + 0.5
    if _IS_GEOGRAPHIC in keys:
        warnings.warn("Coordinates are degrees, and so are lengths: project the raster to meters.", stacklevel=3)
    lo = x - column * along_x, y - (rows - row) * along_y
    require_resolved_pixels(factors.shape, min(along_x, along_y), float(np.abs(lo).max()))
    return factors, (lo, (lo[0] + columns * along_x, lo[1] + rows * along_y))


def _doubles(tags: Any, tag: int, default: tuple[float | int, ...]) -> tuple[Any, ...]:
    """Return the numbers of a TIFF tag, or ``default`` if there is no such tag.

    ``ValueError`` is raised unless the numbers are finite and as many as in ``default``.
    """
    values = tags.get(tag, default)
    if not isinstance(values, tuple) or len(values) != len(default) or not np.isfinite(values).all():
        raise ValueError(f"expected {len(default)} finite numbers in the tag {tag}, got {shortened(values)}.")
    return values


@dataclass(frozen=True, eq=False)
class _MapServer:
    """The ``.yaml`` file of a map of ROS's ``map_server``."""

    image: Path
    resolution: float  # side of a pixel in meters
    origin: Float[np.ndarray, "3"]  # x, y and yaw of the lower left corner of the picture
    mode: str
    negate: bool
    free_thresh: float
    occupied_thresh: float

    @classmethod
    def read(cls, path: Path) -> "_MapServer":
        """Read and check the ``.yaml`` file of a map, with ROS's defaults; the picture is read later."""
        # 1. Find the picture.
        entry = yaml_of(path)
        missing = [key for key in _REQUIRED if not isinstance(entry, dict) or key not in entry]
        if missing:
            raise ValueError(f"expected the keys {', '.join(_REQUIRED)}; missing {', '.join(missing)}.")
        if not isinstance(entry["image"], str) or (image := path.parent / entry["image"]).is_dir():
            raise ValueError(f"image must be the name of a picture, got {shortened(entry['image'])}.")
        if not image.exists():
            raise FileNotFoundError(errno.ENOENT, f"No such picture, named as image in {path}", str(image))
        # 2. Check what its pixels mean, and where it lies.
        mode = entry.get("mode", "trinary")
        if mode not in _MODES:
            raise ValueError(f"mode must be one of {', '.join(_MODES)}, got {shortened(mode)}.")
        negate = entry.get("negate", 0)
        if negate not in (0, 1):
            raise ValueError(f"negate must be 0 or 1, got {shortened(negate)}.")
        resolution = as_finite("resolution", _number("resolution", entry["resolution"]), positive=True)
        origin = entry["origin"]
        if not isinstance(origin, list) or len(origin) not in (2, 3):
            raise ValueError(f"origin must be [x, y, yaw], got {shortened(origin)}.")
        origin = np.array([_number("origin", value) for value in [*origin, 0.0][:3]])
        free_thresh = _number("free_thresh", entry.get("free_thresh", 0.196))
        occupied_thresh = _number("occupied_thresh", entry.get("occupied_thresh", 0.65))
        return cls(image, resolution, origin, mode, bool(negate), free_thresh, occupied_thresh)

    def cells(
        self, value_of: Callable[[Float[np.ndarray, "rows columns"]], Shaped[np.ndarray, "rows columns"]], dtype: Any
    ) -> Shaped[np.ndarray, "rows columns"]:
        """Return ``value_of`` of each pixel's occupancy, as an array of ``dtype`` whose row 0 is the top row.

        ``value_of`` maps arrays of occupancies to arrays. Occupancies are from 0 to 1, NaN where unknown.
        """
        with errors_named(self.image), open_picture(self.image) as picture:
            cells = np.empty((picture.height, picture.width), dtype)
            for rows, light, white, alpha in bands(picture):
                # Lightness is from 0 to `white`, alpha from 0 to OPAQUE; as in ROS, alpha counts as a fourth color.
                if self.mode == "trinary" and alpha is not None:
                    light = 0.75 * light + 0.25 * white * (alpha / OPAQUE)
                occupancy = (light if self.negate else white - light) / white
                if self.mode == "raw":
                    percent = np.rint(_RAW_WHITE * light / white)
                    occupancy = np.where(percent <= _RAW_MOST, percent / _RAW_MOST, np.nan)
                if self.mode == "scale" and alpha is not None:
                    occupancy = np.where(alpha == OPAQUE, occupancy, np.nan)
                cells[rows] = value_of(occupancy)
        return cells

    def free(self, unknown_is_free: bool) -> Bool[np.ndarray, "rows columns"]:
        """Return which pixels are free, ``(rows, columns)``; row 0 is the top row of the picture."""
        # A comparison with NaN (unknown) is False. So an unknown pixel passes only the first test.
        if unknown_is_free:
            return self.cells(lambda occupancy: ~(occupancy > self.occupied_thresh), bool)
        return self.cells(lambda occupancy: occupancy < self.free_thresh, bool)

    def occupancy_grid(self, occupancy: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
        """Convert occupancy (0 to 1, NaN where unknown) to values of ROS's ``OccupancyGrid``, by mode and thresholds.

        The values are 0 (free) to 100 (occupied), and -1 where unknown.
        """
        # Below the lower threshold a pixel is free, above the upper one occupied. Between them it is unknown, but in
        # mode "scale" occupied in part. Mode "raw" has no thresholds.
        if self.mode == "raw":
            return np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_RAW_MOST * occupancy))
        between = np.full(occupancy.shape, _UNKNOWN, np.float64)  # also where occupancy is NaN: comparisons are False
        lowest, highest = self.free_thresh, self.occupied_thresh
        if self.mode == "scale" and lowest < highest:
            fraction = np.clip((occupancy - lowest) / (highest - lowest), 0.0, 1.0)
            between = np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_OCCUPIED * fraction))
        return np.where(occupancy > highest, _OCCUPIED, np.where(occupancy < lowest, _FREE, between))


def _number(name: str, value: object) -> float:
    return as_number(name, value, "a finite number", math.isfinite)
