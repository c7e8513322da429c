"""Cost maps from TIFF files of factors."""

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from plr_jax import scenes

FACTORS = np.array([[1, 2.5, 3], [4, np.inf, 0.5]], np.float32)  # the first row is the highest
TAGS = {"scale": 33550, "tie": 33922, "transformation": 34264, "keys": 34735, "nodata": 42113}
PIXEL_IS_POINT = (1, 1, 0, 2, 1024, 0, 1, 1, 1025, 0, 1, 2)
PIXEL_IS_AREA = (1, 1, 0, 1, 1025, 0, 1, 1)


def tiff(folder, factors=FACTORS, **tags):
    info = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in tags.items():
        number = TAGS[tag]
        info.tagtype[number] = {"nodata": 2, "keys": 3}.get(tag, 12)
        info[number] = value
    Image.fromarray(factors).save(folder / "a.tif", tiffinfo=info)
    return folder / "a.tif"


def geo(scale, row, column, x, y, **tags):
    """Tags by which raster coordinates (row, column) lie at (x, y)."""
    return {"scale": (*scale, 0.0), "tie": (row, column, 0.0, x, y, 0.0), **tags}


def test_tiff_of_floats_lies_where_tags_say(tmp_path):
    for tags, lo, hi in [
        ({}, (0, 0), (3, 2)),
        ({"scale": (0.5, 0.5, 0.0)}, (0, 0), (1.5, 1)),
        (geo((0.5, 0.25), 0.0, 0.0, 1e5, 5e6), (1e5, 5e6 - 0.5), (1e5 + 1.5, 5e6)),
        (geo((2.0, 2.0), 1.0, 1.0, 10.0, 20.0), (8, 18), (14, 22)),
        (geo((2.0, 2.0), 0.0, 0.0, 10.0, 20.0, keys=PIXEL_IS_POINT), (9, 17), (15, 21)),
        (geo((2.0, 2.0), 0.0, 0.0, 10.0, 20.0, keys=PIXEL_IS_AREA), (10, 16), (16, 20)),
    ]:
        cost = scenes.read_cost_map(tiff(tmp_path, **tags), interpolation="nearest")
        np.testing.assert_array_equal(cost.values, FACTORS[::-1])
        np.testing.assert_array_equal([cost.domain.lo, cost.domain.hi], [lo, hi])
        centers = np.array([(0.5, 0.75), (5 / 6, 0.75), (1 / 6, 0.25), (5 / 6, 0.25)])  # as shares of the width
        np.testing.assert_array_equal(cost(lo + centers * np.subtract(hi, lo)), [2.5, 3, 4, 0.5])


def test_coordinates_in_degrees_warn(tmp_path):
    with pytest.warns(UserWarning, match="Coordinates are degrees"):
        scenes.read_cost_map(tiff(tmp_path, keys=(1, 1, 0, 1, 1024, 0, 1, 2)))


@pytest.mark.parametrize("missing", ["-9999", "nan", "0 ", "-3.4028234663852886e+38", "1e300"])
def test_missing_data_is_blocked(missing, tmp_path):
    with np.errstate(over="ignore"):
        factors = np.where(np.isinf(FACTORS), np.float32(missing), FACTORS)
    cost = scenes.read_cost_map(tiff(tmp_path, factors, nodata=missing))
    np.testing.assert_array_equal(cost.values, FACTORS[::-1])


@pytest.mark.parametrize("kind", [np.int16, np.uint16, np.int32])
def test_tiff_of_integers_is_read(kind, tmp_path):
    missing = 0 if kind == np.uint16 else -9999
    cost = scenes.read_cost_map(tiff(tmp_path, np.array([[1, 300], [missing, 7]], kind), nodata=str(missing)))
    np.testing.assert_array_equal(cost.values, [[np.inf, 7], [1, 300]])


def test_broken_tiff_raises(tmp_path):
    for factors, tags, message in [
        (np.zeros((2, 3), np.uint8), {}, "expected a TIFF of one channel of .*, got a picture of mode L"),
        (np.zeros((2, 3), np.float32), {}, r"values must be from 1e-30 to 1e\+30"),
        (-FACTORS, {}, "got -"),
        (FACTORS, {"transformation": tuple(range(16))}, "got a transformation: rotate the picture"),
        (FACTORS, {"scale": (1.0, 1.0)}, r"3 finite numbers in the tag 33550, got \(1.0, 1.0\)"),
        (FACTORS, {"scale": (0.0, 1.0, 1.0)}, "a pixel's side must be"),
        (FACTORS, {"tie": (0.0,) * 12}, "6 finite numbers in the tag 33922"),
        (FACTORS, geo((1e-9, 1e-9), 0.0, 0.0, 1e6, 1e6), "resolution must be at least"),
        (np.full((2, 2), 7, np.float32), {"nodata": "7"}, "leave a cell that is not blocked"),
        (FACTORS, {"nodata": "none"}, "could not convert string to float: 'none'"),
    ]:
        with pytest.raises(ValueError, match=rf"(?s)^\S*a\.tif: .*{message}"):
            scenes.read_cost_map(tiff(tmp_path, factors, **tags))


def test_tiff_refuses_options_of_map_server(tmp_path):
    for options in ({"unknown_is_free": True}, {"cost_travel_multiplier": 1.0}):
        with pytest.raises(ValueError, match="unknown_is_free are not for a TIFF"):
            scenes.read_cost_map(tiff(tmp_path), **options)
