"""Maps of map_server as cost maps."""

import numpy as np
import pytest
from PIL import Image

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


def test_a_trinary_map_blocks_what_read_map_server_has_occupied(tmp_path):
    cost = scenes.read_cost_map(written(tmp_path))
    np.testing.assert_array_equal(cost.values, [[1, np.inf, np.inf], [1, 1, 1]])
    np.testing.assert_array_equal([cost.domain.lo, cost.domain.hi], [(-1, 2), (0.5, 3)])
    free = scenes.read_cost_map(tmp_path / "map.yaml", unknown_is_free=True, interpolation="nearest")
    np.testing.assert_array_equal(free.values, [[1, 3, np.inf], [1, 1, 1]])
    x = np.random.default_rng(0).uniform(cost.domain.lo, cost.domain.hi, (300, 2))
    workspace = scenes.read_map_server(tmp_path / "map.yaml", tolerance=0)
    column, row = np.floor((x - cost.domain.lo) / 0.5).astype(int).T
    np.testing.assert_array_equal(workspace.is_free(x), cost.free[row, column])
    assert free.interpolation == "nearest"


def test_a_scaled_map_has_costs_between_the_thresholds(tmp_path):
    gray = np.full((1, 5, 4), 255, np.uint8)
    gray[0, :, :3] = np.array([255, 200, 153, 102, 0])[:, None]
    gray[0, 0, 3] = 9  # transparent
    path = written(tmp_path, YAML + "mode: scale\n", gray)
    share = (1 - np.array([200, 153, 102]) / 255 - 0.196) / (0.65 - 0.196)
    np.testing.assert_allclose(grid_of(path), [[98, *np.rint(100 * share), 100]])
    assert not scenes.read_cost_map(path).free[0, 0]
    path = written(tmp_path, YAML.replace("0.65", "0.1") + "mode: scale\n", gray)  # nothing is between
    np.testing.assert_array_equal(scenes.read_cost_map(path, unknown_is_free=True).free, [[1, 0, 0, 0, 0]])


def test_a_raw_map_has_its_percents_whatever_the_thresholds(tmp_path):
    path = written(tmp_path, YAML + "mode: raw\n", np.array([[0, 19, 66, 98, 99, 100, 101, 255]], np.uint8))
    np.testing.assert_allclose(grid_of(path), [[0, 19, 66, 98, 100, 100, 98, 98]])
    np.testing.assert_array_equal(scenes.read_cost_map(path).free, [[1, 1, 1, 1, 0, 0, 0, 0]])


def test_a_map_alone_becomes_a_robots_cost_map_in_one_call(tmp_path):
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
        (YAML.replace("0.0]", "0.3]"), "expected an origin with yaw 0, .* got 0.3: turn the picture"),
        (YAML.replace("0.5", "0"), "resolution must be a positive"),
        (YAML.replace("0.5", "1e-300"), "resolution must be at least 1.6e-11 at coordinates up to 2"),
        (YAML.replace("0.5", "1e308"), "choose a larger unit"),
        (YAML + "mode: new\n", "mode must be one of trinary, scale, raw"),
        (YAML.replace("map.png", "map.yaml"), "expected a picture"),
        (YAML.replace("0.65", "-1"), "leave a cell that is not blocked"),
    ],
    ids=range(8),
)
def test_what_is_no_cost_map_is_refused_by_name(yaml, message, tmp_path):
    path = written(tmp_path, yaml)
    with pytest.raises(ValueError, match=rf"(?s)^\S*map\.yaml: .*{message}"):
        scenes.read_cost_map(path)
