"""Cost maps from maps of ``map_server`` and from TIFF files."""

import struct

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from plr_jax import RasterCost, scenes

YAML = """image: map.png
resolution: 0.5
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
GRAY = np.array([[254, 254, 254], [254, 205, 0]], np.uint8)  # free, unknown, occupied


def written(folder, yaml=YAML, gray=GRAY):
    Image.fromarray(gray).save(folder / "map.png")
    (folder / "map.yaml").write_text(yaml)
    return folder / "map.yaml"


def grid_of(path):
    """The occupancy grid that a cost map was made of, the first row the highest."""
    cost = scenes.read_cost_map(path, cost_travel_multiplier=252, unknown_is_free=True)
    costs = np.where(cost.free, cost.values - 1, 254)[::-1]
    return np.interp(costs, (0, 1, 252, 254), (0, 1, 98, 100))


def test_trinary_map_blocks_occupied_pixels(tmp_path):
    cost = scenes.read_cost_map(written(tmp_path))
    np.testing.assert_array_equal(cost.values, [[1, np.inf, np.inf], [1, 1, 1]])
    np.testing.assert_array_equal([cost.domain.lo, cost.domain.hi], [(-1, 2), (0.5, 3)])
    free = scenes.read_cost_map(tmp_path / "map.yaml", unknown_is_free=True, interpolation="nearest")
    np.testing.assert_array_equal(free.values, [[1, 3, np.inf], [1, 1, 1]])
    assert free.interpolation == "nearest"
    x = np.random.default_rng(0).uniform(cost.domain.lo, cost.domain.hi, (300, 2))
    workspace = scenes.read_map_server(tmp_path / "map.yaml", tolerance=0)
    column, row = np.floor((x - cost.domain.lo) / 0.5).astype(int).T
    np.testing.assert_array_equal(workspace.is_free(x), cost.free[row, column])


def test_scaled_map_costs_rise_between_thresholds(tmp_path):
    gray = np.full((1, 5, 4), 255, np.uint8)
    gray[0, :, :3] = np.array([255, 200, 153, 102, 0])[:, None]
    gray[0, 0, 3] = 9  # transparent
    path = written(tmp_path, YAML + "mode: scale\n", gray)
    share = (1 - np.array([200, 153, 102]) / 255 - 0.196) / (0.65 - 0.196)
    np.testing.assert_allclose(grid_of(path), [[98, *np.rint(100 * share), 100]])
    assert not scenes.read_cost_map(path).free[0, 0]
    path = written(tmp_path, YAML.replace("0.65", "0.1") + "mode: scale\n", gray)  # nothing is between
    np.testing.assert_array_equal(scenes.read_cost_map(path, unknown_is_free=True).free, [[1, 0, 0, 0, 0]])


def test_raw_map_has_percents_without_thresholds(tmp_path):
    path = written(tmp_path, YAML + "mode: raw\n", np.array([[0, 19, 66, 98, 99, 100, 101, 255]], np.uint8))
    np.testing.assert_allclose(grid_of(path), [[0, 19, 66, 98, 100, 100, 98, 98]])
    np.testing.assert_array_equal(scenes.read_cost_map(path).free, [[1, 1, 1, 1, 0, 0, 0, 0]])


def test_cost_map_can_be_inflated(tmp_path):
    gray = np.full((20, 30), 254, np.uint8)
    gray[:, 15] = 0
    cost = scenes.read_cost_map(written(tmp_path, gray=gray)).inflated(0.5, inflation_radius=3.0)
    assert isinstance(cost, RasterCost)
    np.testing.assert_array_equal(cost.free, np.tile(np.abs(np.arange(30) - 15) > 1, (20, 1)))
    assert cost.values[4, 13] == pytest.approx(1 + 2 * np.exp(-5.0))


@pytest.mark.parametrize(
    ("yaml", "message"),
    [
        ("", "missing image, resolution, origin"),
        (YAML.replace("0.0]", "0.3]"), "expected an origin with yaw 0 for a raster, got 0.3: rotate the picture"),
        (YAML.replace("0.5", "1e-300"), "resolution must be at least 1.6e-11 at coordinates up to 2"),
        (YAML.replace("0.5", "1e308"), "choose a larger unit"),
        (YAML.replace("map.png", "map.yaml"), "expected a picture"),
        (YAML.replace("0.65", "-1"), "leave a cell that is not blocked"),
    ],
    ids=range(6),
)
def test_broken_map_raises(yaml, message, tmp_path):
    with pytest.raises(ValueError, match=rf"(?s)^\S*map\.yaml: .*{message}"):
        scenes.read_cost_map(written(tmp_path, yaml))


# --- TIFF of factors -----------------------------------------------------------------------------------

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


@pytest.mark.parametrize(
    ("tags", "lo", "hi"),
    [
        ({}, (0, 0), (3, 2)),
        ({"scale": (0.5, 0.5, 0.0)}, (0, 0), (1.5, 1)),
        (geo((0.5, 0.25), 0.0, 0.0, 1e5, 5e6), (1e5, 5e6 - 0.5), (1e5 + 1.5, 5e6)),
        (geo((2.0, 2.0), 1.0, 1.0, 10.0, 20.0), (8, 18), (14, 22)),
        (geo((2.0, 2.0), 0.0, 0.0, 10.0, 20.0, keys=PIXEL_IS_POINT), (9, 17), (15, 21)),
        (geo((2.0, 2.0), 0.0, 0.0, 10.0, 20.0, keys=PIXEL_IS_AREA), (10, 16), (16, 20)),
    ],
    ids=range(6),
)
def test_tiff_of_floats_lies_where_tags_say(tags, lo, hi, tmp_path):
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


def test_tiff_of_64_bit_floats_raises(tmp_path):
    data = FACTORS.astype("<f8").tobytes()
    entries = {256: 3, 257: 2, 258: 64, 259: 1, 262: 1, 273: 8, 277: 1, 278: 2, 279: len(data), 339: 3}
    tags = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in entries.items())
    header = struct.pack("<2sHI", b"II", 42, 8 + len(data))
    (tmp_path / "a.tif").write_bytes(header + data + struct.pack("<H", len(entries)) + tags + bytes(4))
    expected = "a TIFF of one channel of 32-bit floats, or of integers .*"
    with pytest.raises(ValueError, match=rf"a\.tif: expected {expected}, got something else"):
        scenes.read_cost_map(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("factors", "tags", "message"),
    [
        (GRAY, {}, "expected a TIFF of one channel of 32-bit floats, .*, got a picture of mode L"),
        (np.zeros((2, 3), np.float32), {}, r"values must be from 1e-30 to 1e\+30"),
        (-FACTORS, {}, "got -"),
        (FACTORS, {"transformation": tuple(range(16))}, "got a transformation: rotate the picture"),
        (FACTORS, {"scale": (1.0, 1.0)}, r"3 finite numbers in the tag 33550, got \(1.0, 1.0\)"),
        (FACTORS, {"scale": (0.0, 1.0, 1.0)}, "a pixel's side must be"),
        (FACTORS, {"tie": (0.0,) * 12}, "6 finite numbers in the tag 33922"),
        (FACTORS, geo((1e-9, 1e-9), 0.0, 0.0, 1e6, 1e6), "resolution must be at least"),
        (np.full((2, 2), 7, np.float32), {"nodata": "7"}, "leave a cell that is not blocked"),
        (FACTORS, {"nodata": "none"}, "could not convert string to float: 'none'"),
    ],
    ids=range(10),
)
def test_broken_tiff_raises(factors, tags, message, tmp_path):
    with pytest.raises(ValueError, match=rf"(?s)^\S*a\.tif: .*{message}"):
        scenes.read_cost_map(tiff(tmp_path, factors, **tags))


def test_tiff_refuses_options_of_map_server(tmp_path):
    for options in ({"unknown_is_free": True}, {"cost_travel_multiplier": 1.0}):
        with pytest.raises(ValueError, match="unknown_is_free are not for a TIFF"):
            scenes.read_cost_map(tiff(tmp_path), **options)
