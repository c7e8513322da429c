"""Workspaces and cost maps from maps of ROS's ``map_server``."""

import numpy as np
import pytest
from PIL import Image

from plr_jax import Workspace, scenes

YAML = """image: map.png
resolution: 0.5
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
GRAY = np.array([[254, 205, 0], [254, 254, 254], [254, 254, 254]], np.uint8)  # free, unknown, occupied


def written(folder, yaml=YAML, gray=GRAY):
    Image.fromarray(gray).save(folder / "map.png")
    (folder / "map.yaml").write_text(yaml)
    return folder / "map.yaml"


def num_free(path, **options):
    return scenes.read_map_server(path, tolerance=0, **options).free_space.area / 0.25


def test_unknown_pixels_are_occupied_by_default(tmp_path):
    path = written(tmp_path)
    workspace = scenes.read_map_server(path)
    np.testing.assert_array_equal([workspace.bounds.lo, workspace.bounds.hi], [(-1, 2), (0.5, 3.5)])
    assert num_free(path) == 7 and num_free(path, unknown_is_free=True) == 8
    # The first row is the highest.
    free = scenes.read_workspace(path, tolerance=0).is_free([(-0.75, 3.25), (-0.25, 3.25), (0.25, 2.25)])
    np.testing.assert_array_equal(free, [True, False, True])


def test_yaw_turns_map_about_corner(tmp_path):
    path = written(tmp_path, YAML.replace("0.0]", "0.3]"))
    expected = Workspace.from_mask(GRAY[::-1] == 254, 0.5, (-1, 2, 0.3))
    assert scenes.read_map_server(path).free_space.equals(expected.free_space)


def test_pixels_below_free_threshold_are_free(tmp_path):
    for change, pixels in [
        (("negate: 0", "negate: 1"), 1),  # the black one
        (("negate: 0", "negate: true"), 1),
        (("free_thresh: 0.196", "free_thresh: 0.197"), 8),  # pixels of 205 are occupied by 50 / 255 = 0.19608
        (("free_thresh: 0.196\n", ""), 7),
        (("negate: 0\n", ""), 7),
        ((", 0.0]", "]"), 7),
        (("0.196", "0.196\nmode: scale"), 7),
    ]:
        assert num_free(written(tmp_path, YAML.replace(*change))) == pixels


def test_raw_pixels_are_percents(tmp_path):
    gray = np.array([[0, 19, 20, 65, 100, 101, 255]], np.uint8)
    path = written(tmp_path, YAML + "mode: raw\n", gray)
    assert num_free(path) == 2
    assert num_free(path, unknown_is_free=True) == 6  # all but 100 and 65 is none above 0.65


def test_alpha_counts_by_mode(tmp_path):
    for pixel, mode, negate, value in [
        # Trinary: occupancy is 1 - (red + green + blue + alpha) / 1020.
        ((200, 200, 200, 255), "trinary", 0, 0),  # 0.162; 0.216 without alpha
        ((180, 180, 180, 255), "trinary", 0, -1),  # 0.221
        ((255, 255, 255, 0), "trinary", 0, -1),  # 0.25
        ((255, 255, 255, 128), "trinary", 0, 0),  # 0.125
        ((60, 30, 0, 255), "trinary", 0, 100),  # 0.662; the mean of the colors alone is 0.882
        ((64, 50, 0, 255), "trinary", 0, -1),  # 0.638
        ((0, 0, 0, 0), "trinary", 0, 100),  # 1
        # With negate it is the mean itself.
        ((0, 0, 0, 255), "trinary", 1, -1),  # 0.25
        ((0, 0, 0, 128), "trinary", 1, 0),  # 0.125
        ((255, 255, 255, 0), "trinary", 1, 100),  # 0.75
        ((200, 200, 200), "trinary", 0, -1),  # no alpha: 0.216
        ((200, 200, 200, 255), "scale", 0, 4),  # (0.2157 - 0.196) / (0.65 - 0.196) * 100 = 4.3
        ((255, 255, 255, 254), "scale", 0, -1),
        ((40, 40, 40, 0), "raw", 0, 40),
    ]:
        yaml = YAML.replace("negate: 0", f"negate: {negate}\nmode: {mode}")
        pixels = np.full((1, 2, len(pixel)), pixel, np.uint8)
        background = 0 if mode == "raw" or negate else 255  # a free pixel
        pixels[0, 1] = [*[background] * 3, 255 * (not negate)][: len(pixel)]
        path = written(tmp_path, yaml, pixels)
        assert num_free(path) == 1 + (value == 0)
        assert num_free(path, unknown_is_free=True) == 1 + (value <= 65)
        costs = scenes.read_cost_map(path, cost_travel_multiplier=252).values[0, 0] - 1  # of bytes, inf where blocked
        if value in (-1, 100):
            assert costs == np.inf
        else:
            np.testing.assert_allclose(costs, np.interp(value, (0, 1, 98), (0, 1, 252)))


def grid_of(path):
    """The occupancy grid that a cost map was made of, the first row the highest."""
    cost = scenes.read_cost_map(path, cost_travel_multiplier=252, unknown_is_free=True)
    costs = np.where(cost.free, cost.values - 1, 254)[::-1]
    return np.interp(costs, (0, 1, 252, 254), (0, 1, 98, 100))


def test_trinary_cost_map_blocks_occupied_pixels(tmp_path):
    cost = scenes.read_cost_map(written(tmp_path))
    np.testing.assert_array_equal(cost.values, [[1, 1, 1], [1, 1, 1], [1, np.inf, np.inf]])
    np.testing.assert_array_equal([cost.domain.lo, cost.domain.hi], [(-1, 2), (0.5, 3.5)])
    free = scenes.read_cost_map(tmp_path / "map.yaml", unknown_is_free=True, interpolation="nearest")
    np.testing.assert_array_equal(free.values, [[1, 1, 1], [1, 1, 1], [1, 3, np.inf]])
    assert free.interpolation == "nearest"
    x = np.random.default_rng(0).uniform(cost.domain.lo, cost.domain.hi, (300, 2))
    workspace = scenes.read_map_server(tmp_path / "map.yaml", tolerance=0)
    column, row = np.floor((x - cost.domain.lo) / 0.5).astype(int).T
    np.testing.assert_array_equal(workspace.is_free(x), cost.free[row, column])


def test_scaled_cost_map_rises_between_thresholds(tmp_path):
    gray = np.full((1, 5, 4), 255, np.uint8)
    gray[0, :, :3] = np.array([255, 200, 153, 102, 0])[:, None]
    gray[0, 0, 3] = 9  # transparent
    path = written(tmp_path, YAML + "mode: scale\n", gray)
    share = (1 - np.array([200, 153, 102]) / 255 - 0.196) / (0.65 - 0.196)
    np.testing.assert_allclose(grid_of(path), [[98, *np.rint(100 * share), 100]])
    assert not scenes.read_cost_map(path).free[0, 0]
    path = written(tmp_path, YAML.replace("0.65", "0.1") + "mode: scale\n", gray)  # nothing is between
    np.testing.assert_array_equal(scenes.read_cost_map(path, unknown_is_free=True).free, [[1, 0, 0, 0, 0]])


def test_raw_cost_map_has_percents_without_thresholds(tmp_path):
    path = written(tmp_path, YAML + "mode: raw\n", np.array([[0, 19, 66, 98, 99, 100, 101, 255]], np.uint8))
    np.testing.assert_allclose(grid_of(path), [[0, 19, 66, 98, 100, 100, 98, 98]])
    np.testing.assert_array_equal(scenes.read_cost_map(path).free, [[1, 1, 1, 1, 0, 0, 0, 0]])


def test_broken_map_raises(tmp_path):
    for yaml, message in [
        ("", "missing image, resolution, origin"),
        ("image: a.pgm\norigin: [0, 0, 0]", "expected the keys image, resolution, origin; missing resolution"),
        (YAML.replace("0.5", "0"), "resolution must be a positive"),
        (YAML.replace("0.5", ".nan"), "resolution must be a finite number, got nan"),
        (YAML.replace("0.5", "1e-300"), "resolution must be at least 1.6e-11 at coordinates up to 2"),
        (YAML.replace("0.5", "1e-09").replace("-1.0", "1e6"), "resolution must be at least .* choose an origin"),
        (YAML.replace("0.5", "1e308"), "choose a larger unit"),
        (YAML.replace("[-1.0, 2.0, 0.0]", "3"), r"origin must be \[x, y, yaw\], got 3"),
        (YAML.replace("2.0, ", "x, "), "origin must be a finite number, got 'x'"),
        (YAML.replace("negate: 0", "negate: 2"), "negate must be 0 or 1"),
        (YAML.replace("0.65", "high"), "occupied_thresh must be a finite number"),
        (YAML + "mode: new\n", "mode must be 'trinary', 'scale' or 'raw'"),
        (YAML.replace("map.png", "[map.png]"), r"image must be the name of a picture, got \['map.png'\]"),
        (YAML.replace("map.png", "''"), "image must be the name of a picture, got ''"),
        (YAML.replace("map.png", ".."), "image must be the name of a picture, got '..'"),
        (YAML.replace("map.png", "map.yaml"), "expected a picture"),
    ]:
        with pytest.raises(ValueError, match=rf"(?s)^\S*map\.yaml: .*{message}"):
            scenes.read_map_server(written(tmp_path, yaml))


def test_missing_picture_raises(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"named as image in .*map\.yaml: '.*none\.png'"):
        scenes.read_map_server(written(tmp_path, YAML.replace("map.png", "none.png")))


def test_broken_cost_map_raises(tmp_path):
    for change, message in [
        (("0.0]", "0.3]"), "expected an origin with yaw 0 for a raster, got 0.3: rotate the picture"),
        (("0.5", "1e-300"), "resolution must be at least 1.6e-11 at coordinates up to 2"),
        (("0.65", "-1"), "leave a cell that is not blocked"),
    ]:
        with pytest.raises(ValueError, match=rf"(?s)^\S*map\.yaml: .*{message}"):
            scenes.read_cost_map(written(tmp_path, YAML.replace(*change)))
