"""Workspaces from pictures, and files that are no pictures."""

import struct
import warnings
import zlib
from itertools import product

import numpy as np
import pytest
from PIL import Image

from plr_jax import Workspace, scenes
from plr_jax.scenes._pictures import open_picture

WALL = np.full((6, 8), 255, np.uint8)
WALL[0:4, 3:5] = 0  # from the top: the way around it is below
FREE = WALL[::-1] > 127


def assert_free(path, free=FREE, **options):
    workspace, expected = scenes.read_image(path), Workspace.from_mask(np.array(free, bool), **options)
    assert workspace.free_space.equals(expected.free_space) and workspace.bounds == expected.bounds


@pytest.mark.parametrize("name", ["a.png", "a.pgm", "a.ppm", "a.bmp", "a.gif", "a.tif", "a.webp", "A.PNG"])
def test_pictures_of_all_formats_are_read(name, tmp_path):
    picture = Image.fromarray(WALL)
    options = {"lossless": True} if name.endswith("webp") else {}
    (picture.convert("RGB") if name.endswith(("ppm", "webp")) else picture).save(tmp_path / name, **options)
    assert_free(tmp_path / name)
    assert scenes.read_workspace(tmp_path / name).is_free([(4, 1.0), (4, 3)]).tolist() == [True, False]


@pytest.mark.parametrize("mode", ["1", "L", "P", "LA", "RGB", "RGBA", "I;16"])
def test_pixels_of_all_modes_are_light_or_dark(mode, tmp_path):
    deep = Image.fromarray(WALL.astype(np.uint16) * 257)
    (deep if mode == "I;16" else Image.fromarray(WALL).convert(mode)).save(tmp_path / "a.png")
    assert_free(tmp_path / "a.png")


def test_pgm_of_16_bits_is_read(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 8 6 65535\n" + (WALL.astype(">u2") * 257).tobytes())
    assert_free(tmp_path / "a.pgm")


def test_pixels_above_threshold_are_free(tmp_path):
    Image.fromarray(np.array([[50, 51, 52, 200]], np.uint8)).save(tmp_path / "a.pgm")
    for threshold, count in ((0.0, 4), (0.2, 2), (0.5, 1)):
        assert scenes.read_image(tmp_path / "a.pgm", threshold=threshold).free_space.area == count
    for threshold in (1.0, -0.1, np.nan):
        with pytest.raises(ValueError, match="threshold must be a number from 0 to less than 1"):
            scenes.read_image(tmp_path / "a.pgm", threshold=threshold)


def test_lightness_is_mean_of_colors(tmp_path):
    colors = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [0, 255, 255]]], np.uint8)
    Image.fromarray(colors).save(tmp_path / "a.png")
    for threshold, count in ((0.3, 5), (0.4, 2)):
        assert scenes.read_image(tmp_path / "a.png", threshold=threshold).free_space.area == count
    with pytest.raises(ValueError, match="free"):
        scenes.read_image(tmp_path / "a.png", threshold=0.7)


def test_transparent_pixels_lie_on_white(tmp_path):
    pixels = np.zeros((1, 4, 4), np.uint8)
    pixels[0, :, 3] = [0, 100, 200, 255]  # black, ever less transparent
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert scenes.read_image(tmp_path / "a.png").free_space.area == 2
    palette = Image.fromarray(np.array([[0, 1]], np.uint8)).convert("P")
    palette.save(tmp_path / "b.png", transparency=0)
    assert scenes.read_image(tmp_path / "b.png").free_space.area == 1


def test_stored_orientation_is_applied(tmp_path):
    exif = Image.Exif()
    exif[274] = 6  # to be turned by a quarter, clockwise
    Image.fromarray(WALL).save(tmp_path / "a.png", exif=exif)
    assert_free(tmp_path / "a.png", np.rot90(WALL, -1)[::-1] > 127)


def test_options_of_masks_are_passed_on(tmp_path):
    noisy = WALL.copy()
    noisy[5, 0] = 0
    Image.fromarray(noisy).save(tmp_path / "a.png")
    workspace = scenes.read_image(tmp_path / "a.png", 0.5, (1, 2), drop_specks=1, tolerance=0, squeeze=True)
    assert workspace.free_space.equals(Workspace.from_mask(FREE, 0.5, (1, 2), tolerance=0).free_space)
    assert workspace.squeeze


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, data=b"", bits=8, kind=0, transparent=()):
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))
    clear = chunk(b"tRNS", struct.pack(f">{len(transparent)}H", *transparent)) if transparent else b""
    return b"\x89PNG\r\n\x1a\n" + header + clear + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def tiff(pixels, bits, sample_format=1, photometric=1):
    """One row of a gray TIFF."""
    data = pixels.tobytes()
    values = {256: len(data) * 8 // bits, 257: 1, 258: bits, 259: 1, 262: photometric, 273: 8, 277: 1, 278: 1}
    values |= {279: len(data), 339: sample_format}
    tags = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in values.items())
    return struct.pack("<2sHI", b"II", 42, 8 + len(data)) + data + struct.pack("<H", len(values)) + tags + bytes(4)


GRAYS = np.array([0, 1000, 40_000, 65_535])
ROW_16 = b"\0" + GRAYS.astype(">u2").tobytes()


def test_transparent_gray_lies_on_white(tmp_path):
    for bits, row, clear, free in [
        (1, b"\0\x50", (0,), [1, 1, 1, 1]),
        (1, b"\0\x50", (1,), [0, 1, 0, 1]),
        (2, b"\0\x1b", (0,), [1, 0, 1, 1]),
        (2, b"\0\x1b", (1,), [0, 1, 1, 1]),
        (2, b"\0\x1b", (3,), [0, 0, 1, 1]),
        (4, b"\0\x05\xaf", (4,), [0, 0, 1, 1]),
        (4, b"\0\x05\xaf", (5,), [0, 1, 1, 1]),
        (16, ROW_16, (), [0, 0, 1, 1]),
        (16, ROW_16, (1000,), [0, 1, 1, 1]),
        (16, ROW_16, (0,), [1, 0, 1, 1]),
    ]:
        (tmp_path / "a.png").write_bytes(png(4, 1, row, bits, transparent=clear))
        assert_free(tmp_path / "a.png", [free])


def test_transparent_color_of_16_bits_raises(tmp_path):
    pixels = b"\0" + np.repeat(GRAYS, 3).astype(">u2").tobytes()
    (tmp_path / "a.png").write_bytes(png(4, 1, pixels, 16, kind=2))
    assert_free(tmp_path / "a.png", [[0, 0, 1, 1]])
    (tmp_path / "a.png").write_bytes(png(4, 1, pixels, 16, kind=2, transparent=(3, 3, 3)))
    with pytest.raises(ValueError, match=r"a\.png: expected a transparent color of 8 bits, got 16 bits: save it"):
        scenes.read_image(tmp_path / "a.png")


def test_gray_tiff_is_read(tmp_path):
    gray = (GRAYS // 257).astype(np.uint8)
    for data in (tiff(gray, 8), tiff(255 - gray, 8, photometric=0), tiff(GRAYS.astype("<u2"), 16)):
        (tmp_path / "a.tif").write_bytes(data)
        assert_free(tmp_path / "a.tif", [[0, 0, 1, 1]])


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_tiffs_of_both_byte_orders_are_read_as_by_rasterio(dtype, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path, grays = tmp_path / "a.tif", np.random.default_rng(0).integers(256, size=(16, 32)).astype(dtype)
    for order, compress, tiled in product(("LITTLE", "BIG"), ("none", "lzw", "deflate", "packbits"), (False, True)):
        options = {"ENDIANNESS": order, "compress": compress} | (
            {"blockxsize": 16, "blockysize": 16} if tiled else {}
        )
        size = {"height": 16, "width": 32, "count": 1, "dtype": dtype, "tiled": tiled}
        with (
            warnings.catch_warnings(action="ignore"),
            rasterio.open(path, "w", driver="GTiff", **size, **options) as f,
        ):
            f.write(grays, 1)
        with open_picture(path) as picture:
            np.testing.assert_array_equal(np.asarray(picture), grays)


def test_geotiffs_that_are_no_pictures_name_their_reader(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    place = {"height": 4, "width": 4, "transform": rasterio.Affine(10, 0, 3e5, 0, -10, 5e6), "crs": "EPSG:32633"}
    for options in [
        {"dtype": "int16"},
        {"dtype": "float32"},
        {"dtype": "uint32"},
        {"dtype": "uint8", "compress": "lerc"},
        {"dtype": "uint16", "count": 3, "photometric": "rgb", "interleave": "band"},
        {"dtype": "uint8", "BIGTIFF": "YES", "ENDIANNESS": "BIG"},
    ]:
        with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", **{"count": 1} | place | options) as file:
            file.write(np.ones((options.get("count", 1), 4, 4), options["dtype"]))
        with pytest.raises(ValueError, match=r"use RasterCost or cost_distance .* pip install 'plr-jax\[gis\]'"):
            scenes.read_image(tmp_path / "a.tif")


def test_tiff_of_other_numbers_raises(tmp_path):
    for data in [
        tiff(GRAYS.astype("<u4"), 32),
        tiff(np.array([0, -5, 1000, 32767], "<i2"), 16, 2),
        tiff(np.array([0, -5, 127], "i1"), 8, 2),
        tiff(GRAYS.astype("<u2"), 16, photometric=0),
        tiff(np.array([0, 15, 255, 128, 15, 255], np.uint8), 12),
        tiff(np.array([0, 0.5, 1], "<f4"), 32, 3),
    ]:
        (tmp_path / "a.tif").write_bytes(data)
        expected = (
            "expected black, gray or color in 8 or 16 bits, unsigned and 0 for black, got a TIFF of other pixels"
        )
        with pytest.raises(ValueError, match=rf"a\.tif: {expected}: save it in 8 bits .*; for costs use RasterCost"):
            scenes.read_image(tmp_path / "a.tif")


def test_broken_picture_raises(tmp_path):
    for name, content, message in [
        ("a.png", b"", "expected a picture"),
        ("a.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "expected a picture"),  # by Ghostscript
        ("a.png", png(4, 4, bytes(20))[:40], "damaged|expected a picture"),
        ("a.png", png(4, 4, bytes(3)), "damaged"),
        ("a.png", png(40_000, 40_000), "expected a picture"),
        ("a.png", png(12_000, 8_000), "at most 16,777,216 pixels, 12,582,912 in color, got 12,000 x 8,000"),
        ("a.png", png(4_000, 4_000, kind=2), "at most 16,777,216 pixels, 12,582,912 in color, got 4,000 x 4,000"),
        ("a.png", png(3_000, 2_000), "at most 4,194,304 pixels in a file of [0-9]+ bytes, got 3,000 x 2,000"),
        ("a.pgm", b"P5 4 4 255\nabc", "damaged"),
        ("a.pgm", b"P5 -4 4 255\nabc", "expected a picture"),
        ("a.pgm", b"P2 2 2 255\n1 2 3 x", "damaged"),
        ("a.png", png(4, 4, bytes(20)), "No pixel of 4 x 4 is free"),
    ]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=rf"^\S*{name}: .*({message})"):
            scenes.read_image(tmp_path / name)


def test_missing_picture_raises(tmp_path):
    with pytest.raises(FileNotFoundError):
        scenes.read_image(tmp_path / "none.png")
