"""Read maps that are stored as pictures, alone or with the YAML file of ROS's ``map_server``; light means free."""

import errno
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_bool, as_finite, as_number, require_choice, shortened
from plr_jax._files import StrPath, errors_named, yaml_of
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
_BYTES_PER_PIXEL = {"1": 1, "L": 1, "P": 1}  # of a decoded pixel by mode of Pillow; all other modes take 4
OPAQUE = 255  # largest value of an alpha channel
_GRAY_STEP = {"L;2": 85, "L;4": 17}  # 8-bit step between gray levels of PNG files with 2 or 4 bits
_TIFF_ADVICE = "for costs use RasterCost or cost_distance with its path, after pip install 'plr-jax[gis]'"


def read_image(
    path: StrPath,
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
            most 16,777,216 pixels, or 12,582,912 in color. A picture of more than 4,194,304 pixels may have at most
            4,096 pixels per byte of its file.
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
        with open_picture(file) as picture:
            light, white, alpha = _lightness(picture)
        # A pixel of opacity a = alpha / OPAQUE over white appears as a * light + (1 - a) * white.
        on_white = light if alpha is None else white + (light - white) * (alpha / OPAQUE)
        return Workspace.from_mask(on_white > threshold * white, resolution, origin, row0="top", **options)


@contextmanager
def open_picture(path: Path) -> Iterator["Image"]:
    """Open a picture, check it, and turn it upright.

    ``ValueError`` is raised if the file is no picture, is damaged or too large, or Pillow does not decode its pixels
    reliably.
    """
    from PIL import Image, ImageOps

    with path.open("rb") as file, warnings.catch_warnings():
        # 1. Read the header, which tells the size and the kind of pixels.
        if (num_bytes := os.fstat(file.fileno()).st_size) > _MOST_BYTES:
            raise ValueError(f"expected a picture of at most {_MOST_BYTES:,} bytes, got a larger file.")
        warnings.simplefilter("ignore")  # Pillow warns of what is rejected here or harmless
        hint = f" If it is a GeoTIFF, {_TIFF_ADVICE}." if "tif" in path.suffix.lower() else ""
        try:
            picture = Image.open(file, formats=_FORMATS)
        except Exception as error:  # Pillow's decoders raise any kind of error
            expected = f"expected a picture ({', '.join(_FORMATS)})"
            raise ValueError(f"{expected}, got something else ({error}).{hint}") from None
        with picture:
            # 2. Reject pictures that take too much memory, before any pixel is decoded.
            _require_limits(picture, num_bytes)
            _require_plain(picture)  # also scales the transparent gray
            # 3. Decode the pixels, and apply the orientation that the file states.
            try:
                ImageOps.exif_transpose(picture, in_place=True)
            except Exception as error:
                raise ValueError(f"expected a complete picture, got a damaged one ({error}).{hint}") from None
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
    if num_pixels > (max_pixels := max(_SMALL, _PIXELS_PER_BYTE * num_bytes)):
        limit = f"at most {max_pixels:,} pixels in a file of {num_bytes:,} bytes"
        raise ValueError(f"expected {limit}, got {size}: it is damaged, or nearly all of one color; crop it.")


def _require_plain(picture: Any) -> None:
    """Raise a ``ValueError`` if Pillow does not decode the lightness or opacity of a picture reliably.

    In PNG files with 2 or 4 bits per pixel, one gray level may stand for transparent pixels. Pillow scales the pixels
    to 8 bits, but not this level: this function scales ``picture.info["transparency"]`` in place.
    """
    # 1. TIFF: unsigned numbers; gray of more than 8 bits has exactly 16, with 0 for black. Pillow misreads channels
    #    of 16 bits that are stored one after the other.
    tags = picture.tag_v2.named() if picture.format == "TIFF" else {}
    bits = tags.get("BitsPerSample", ())
    is_plain = picture.mode != "F" and 2 not in tags.get("SampleFormat", ())  # 2: signed
    if tags and picture.mode.startswith("I"):  # gray of more than 8 bits
        is_plain &= bits == (16,) and tags.get("PhotometricInterpretation") == 1  # 1: 0 is black
    elif 16 in bits:
        is_plain &= tags.get("PlanarConfiguration") != 2  # 2: one channel after the other
    if not is_plain:
        got = f"a TIFF of other pixels: save it in 8 bits for a map of walls; {_TIFF_ADVICE}"
        raise ValueError(f"expected black, gray or color in 8 or 16 bits, unsigned and 0 for black, got {got}.")
    # 2. PNG: a color or gray that counts as transparent must be comparable with the pixels that Pillow decodes.
    if picture.tile and "transparency" in picture.info:
        raw_mode = str(picture.tile[0][3])  # how the file stores pixels: "L;4" is gray of 4 bits
        if picture.mode == "RGB" and "16" in raw_mode:
            raise ValueError("expected a transparent color of 8 bits, got 16 bits: save it with an alpha channel.")
        if raw_mode in _GRAY_STEP:
            picture.info["transparency"] *= _GRAY_STEP[raw_mode]


def _lightness(picture: "Image") -> tuple[Gray, int, Gray | None]:
    """Return the lightness of each pixel, the lightness of white, and opacity from 0 to 255 (None if opaque)."""
    # Gray of 16 bits, and opaque gray of 8 bits, stay as they are; else lightness is the sum of red, green and blue.
    if picture.mode.startswith("I"):
        light = np.asarray(picture, np.int32)
        transparent = picture.info.get("transparency")  # the gray of all pixels that are transparent
        return light, 2**16 - 1, None if transparent is None else np.where(light == transparent, 0, OPAQUE)
    if picture.mode in ("1", "L") and not picture.has_transparency_data:
        return np.asarray(picture.convert("L"), np.int32), 2**8 - 1, None
    red, green, blue, alpha = np.moveaxis(np.asarray(picture.convert("RGBA")), 2, 0).astype(np.int32)
    return red + green + blue, 3 * (2**8 - 1), alpha if picture.has_transparency_data else None


_REQUIRED = ("image", "resolution", "origin")
_MODES = ("trinary", "scale", "raw")
_RAW_WHITE = 255  # mode "raw" reads pixels as integers from 0 (black) to this
_RAW_MOST = 100  # mode "raw": pixels up to this are occupancy in percent, others unknown
_FREE, _OCCUPIED, _UNKNOWN = 0, 100, -1  # values of occupancy grids


def read_map_server(
    path: StrPath,
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
    by ``yaw`` radians counterclockwise. Before this rotation, the lowest row has the smallest ``y``, as in
    :func:`read_image`. The bounds of the workspace are the bounding box of the free pixels.

    The ``.yaml`` file's ``image`` is relative to its folder. Defaults are ``negate`` 0, ``occupied_thresh`` 0.65,
    ``free_thresh`` 0.196 and ``mode`` ``trinary``. ``unknown_is_free`` says whether unknown pixels are free or
    obstacles; other arguments are as for :func:`read_image`. ``ValueError`` is raised if the file is not such a map,
    its picture is damaged or too large, or nothing is free.

    References: http://wiki.ros.org/map_server;
    https://docs.nav2.org/configuration/packages/configuring-map-server.html.
    """
    unknown_is_free = as_bool("unknown_is_free", unknown_is_free)
    with errors_named(path) as file:
        occupancy, resolution, origin, _, free_thresh, occupied_thresh = _MapServer.read(file)
        # A comparison with NaN (unknown) is False. So an unknown pixel passes only the first test.
        free = ~(occupancy > occupied_thresh) if unknown_is_free else occupancy < free_thresh
        options: Any = {"tolerance": tolerance, "drop_specks": drop_specks, "squeeze": squeeze}
        return Workspace.from_mask(free, resolution, origin, row0="top", **options)


def read_cost_map(
    path: StrPath,
    *,
    cost_travel_multiplier: float | int = 2.0,
    unknown_is_free: bool = False,
    interpolation: str = "bilinear",
) -> "RasterCost":
    """Read a map of ROS's ``map_server`` as a cost map in the frame of the map.

    Pixels of the map, in meters and without rotation, become values of an occupancy grid, by mode:

    - ``trinary``: 0 where :func:`read_map_server` finds free pixels, 100 where occupied, -1 where unknown.
    - ``scale``: as ``trinary``, but between the thresholds values rise linearly from 0 to 100, rounded. Only pixels
      that are not opaque are unknown; so gray 205, which means unknown elsewhere, is free.
    - ``raw``: the percentages in the pixels, without thresholds.

    Occupied cells are blocked. If all others are free or unknown, ``read_cost_map(path).inflated(inscribed_radius)``
    adds the usual costs around obstacles. ``cost_travel_multiplier`` and ``unknown_is_free`` are as for
    :meth:`RasterCost.from_occupancy_grid`. A GeoTIFF of cost factors is read by ``RasterCost(path)``.

    Raises:
        ValueError: If the file is not such a map, is rotated, its picture is damaged or too large, or all cells are
            blocked.
    """
    with errors_named(path) as file:
        from plr_jax.spaces import RasterCost  # slow to import, and other readers do not need it

        map_server = _MapServer.read(file)
        x, y, yaw = map_server.origin
        if yaw != 0:
            raise ValueError(f"expected an origin with yaw 0 for a raster, got {yaw:g}: rotate the picture.")
        grid = map_server.occupancy_grid()[::-1]
        require_resolved_pixels(grid.shape, map_server.resolution, max(abs(x), abs(y)))
        bounds = (x, y), (x + grid.shape[1] * map_server.resolution, y + grid.shape[0] * map_server.resolution)
        options: Any = {"unknown_is_free": unknown_is_free, "interpolation": interpolation}
        return RasterCost.from_occupancy_grid(grid, bounds, cost_travel_multiplier=cost_travel_multiplier, **options)


class _MapServer(NamedTuple):
    """The ``.yaml`` file of a map of ROS's ``map_server``."""

    occupancy: Float[np.ndarray, "rows columns"]  # of pixels, 0 to 1, NaN where unknown; row 0 is the top row
    resolution: float  # side of a pixel in meters
    origin: Float[np.ndarray, "3"]  # x, y and yaw of the lower left corner of the picture
    mode: str
    free_thresh: float
    occupied_thresh: float

    @classmethod
    def read(cls, path: Path) -> "_MapServer":
        """Read and check the ``.yaml`` file of a map, with ROS's defaults, and its picture."""
        # 1. Find the picture.
        entry = yaml_of(path)
        if missing := [key for key in _REQUIRED if not isinstance(entry, dict) or key not in entry]:
            raise ValueError(f"expected the keys {', '.join(_REQUIRED)}; missing {', '.join(missing)}.")
        if not isinstance(entry["image"], str) or (image := path.parent / entry["image"]).is_dir():
            raise ValueError(f"image must be the name of a picture, got {shortened(entry['image'])}.")
        if not image.exists():
            raise FileNotFoundError(errno.ENOENT, f"No such picture, named as image in {path}", str(image))
        # 2. Check what its pixels mean, and where it lies.
        require_choice("mode", mode := entry.get("mode", "trinary"), _MODES)
        if (negate := entry.get("negate", 0)) not in (0, 1):
            raise ValueError(f"negate must be 0 or 1, got {shortened(negate)}.")
        resolution = as_finite("resolution", _number("resolution", entry["resolution"]), positive=True)
        if not isinstance(origin := entry["origin"], list) or len(origin) not in (2, 3):
            raise ValueError(f"origin must be [x, y, yaw], got {shortened(origin)}.")
        origin = np.array([_number("origin", value) for value in [*origin, 0.0][:3]])
        free_thresh = _number("free_thresh", entry.get("free_thresh", 0.196))
        occupied_thresh = _number("occupied_thresh", entry.get("occupied_thresh", 0.65))
        return cls(_occupancy(image, mode, bool(negate)), resolution, origin, mode, free_thresh, occupied_thresh)

    def occupancy_grid(self) -> Float[np.ndarray, "rows columns"]:
        """Return occupancies as in ROS's ``OccupancyGrid``: 0 to 100, -1 where unknown; row 0 is the top row."""
        occupancy, _, _, mode, lowest, highest = self
        # Below the lower threshold a pixel is free, above the upper one occupied. Between them it is unknown, but in
        # mode "scale" occupied in part. Mode "raw" has no thresholds.
        if mode == "raw":
            return np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_RAW_MOST * occupancy))
        between = np.full(occupancy.shape, _UNKNOWN, np.float64)  # also where occupancy is NaN: comparisons are False
        if mode == "scale" and lowest < highest:
            fraction = np.clip((occupancy - lowest) / (highest - lowest), 0.0, 1.0)
            between = np.where(np.isnan(occupancy), _UNKNOWN, np.rint(_OCCUPIED * fraction))
        return np.where(occupancy > highest, _OCCUPIED, np.where(occupancy < lowest, _FREE, between))


def _occupancy(image: Path, mode: str, is_negated: bool) -> Float[np.ndarray, "rows columns"]:
    """Return the occupancy of all pixels of a picture, 0 to 1, NaN where unknown; row 0 is the top row."""
    with errors_named(image), open_picture(image) as picture:
        light, white, alpha = _lightness(picture)
    # Lightness is from 0 to `white`, alpha from 0 to OPAQUE; as in ROS, alpha counts as a fourth color.
    if mode == "trinary" and alpha is not None:
        light = 0.75 * light + 0.25 * white * (alpha / OPAQUE)
    if mode == "raw":
        percent = np.rint(_RAW_WHITE * light / white)
        return np.where(percent <= _RAW_MOST, percent / _RAW_MOST, np.nan)
    occupancy = (light if is_negated else white - light) / white
    return np.where(alpha == OPAQUE, occupancy, np.nan) if mode == "scale" and alpha is not None else occupancy


def _number(name: str, value: object) -> float:
    return as_number(name, value, "a finite number", np.isfinite)
