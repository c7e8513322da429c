"""Reader of maps that are pictures: light is free, dark is not."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Int

from plr_jax._arrays import as_number
from plr_jax._documents import errors_named
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace

if TYPE_CHECKING:
    from PIL.Image import Image

PICTURE_ENDINGS = (".png", ".pgm", ".pbm", ".ppm", ".pnm", ".bmp", ".gif", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
_FORMATS = ("PNG", "PPM", "BMP", "GIF", "JPEG", "TIFF", "WEBP")  # of Pillow's those that run no other program
_MOST_PIXELS, _MOST_DECODED, _MOST_BYTES = 2**24, 3 * 2**24, 2**26
_BYTES = {"1": 1, "L": 1, "P": 1}  # of a decoded pixel, where they are not 4
_BAND = 2**18  # pixels that become numbers at a time
OPAQUE = 255
_BITS_PER_SAMPLE, _PHOTOMETRIC, _SAMPLE_FORMAT = 258, 262, 339  # tags of TIFF
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
        path: A picture of at most 16,777,216 pixels, 12,582,912 in color: PNG, PGM, PBM, PPM, BMP, GIF
            (its first frame), JPEG, TIFF or WebP, in 8 or 16 bits a color.
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
        with opened(path) as picture:
            free = np.empty((picture.height, picture.width), bool)
            for rows, light, full, alpha in bands(picture):
                on_white = light if alpha is None else full + (light - full) * (alpha / OPAQUE)
                free[rows] = on_white > threshold * full
        return Workspace.from_mask(
            free, resolution, origin, row0="top", tolerance=tolerance, drop_specks=drop_specks, squeeze=squeeze
        )


@contextmanager
def opened(path: Path) -> Iterator["Image"]:
    """A picture, decoded and turned as it says; ``ValueError`` if it is none, damaged, or too large to be decoded."""
    from PIL import Image, ImageOps

    with path.open("rb") as file, warnings.catch_warnings():
        if os.fstat(file.fileno()).st_size > _MOST_BYTES:
            raise ValueError(f"expected a picture of at most {_MOST_BYTES:,} bytes, got a larger file.")
        warnings.simplefilter("ignore")  # of Pillow, about what is refused here or does not matter
        try:
            picture = Image.open(file, formats=_FORMATS)
        except Exception as error:  # Pillow's decoders raise anything
            raise ValueError(f"expected a picture ({', '.join(_FORMATS)}), got something else ({error}).") from None
        with picture:
            _require_modest(picture)
            _require_plain(picture)
            try:
                turned = ImageOps.exif_transpose(picture)
                turned.load()
            except Exception as error:
                raise ValueError(f"the picture is damaged ({error or type(error).__name__}).") from None
            yield turned


def _require_modest(picture: "Image") -> None:
    num_pixels = picture.width * picture.height
    if num_pixels > _MOST_PIXELS or num_pixels * _BYTES.get(picture.mode, 4) > _MOST_DECODED:
        raise ValueError(
            f"expected a picture of at most {_MOST_PIXELS:,} pixels, {_MOST_DECODED // 4:,} in color, got "
            f"{picture.width:,} x {picture.height:,}: make it smaller."
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
    if part.mode in ("1", "L") and "transparency" not in part.info:
        return np.asarray(part.convert("L"), np.int32), 2**8 - 1, None
    red, green, blue, alpha = np.moveaxis(np.asarray(part.convert("RGBA")), 2, 0).astype(np.int32)
    return red + green + blue, 3 * (2**8 - 1), alpha
