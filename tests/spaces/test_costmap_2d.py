"""Cost maps of robots as rasters of factors, and their inflation."""

import numpy as np
import pytest

from plr_jax import RasterCost

BOUNDS = ((0.0, 0.0), (8.0, 1.0))


def test_bytes_of_a_cost_map_cost_as_smac_has_it():
    values = np.array([[0, 1, 126, 252, 253, 254, 255, 63]], np.uint8)
    cost = RasterCost.from_costmap(values, BOUNDS)
    np.testing.assert_array_equal(cost.free, [[1, 1, 1, 1, 0, 0, 0, 1]])
    np.testing.assert_allclose(cost.values[cost.free], [1, 1 + 2 / 252, 2, 3, 1.5])
    known = RasterCost.from_costmap(values, BOUNDS, unknown_is_free=True, interpolation="nearest")
    np.testing.assert_array_equal(known.free, [[1, 1, 1, 1, 0, 0, 1, 1]])
    assert known.values[0, 6] == 3 and known.interpolation == "nearest"
    navfn = RasterCost.from_costmap(values, BOUNDS, cost_travel_multiplier=252 * 0.8 / 50)
    np.testing.assert_allclose(50 * navfn.values[0, :4], 50 + 0.8 * values[0, :4])


def test_an_occupancy_grid_has_the_costs_that_it_was_published_of():
    costs = np.arange(256)
    published = np.where(costs == 0, 0, 1 + 97 * (costs - 1) // 251)  # as Costmap2DPublisher rounds them
    published[253:] = 99, 100, -1
    bounds = ((0, 0), (256, 1))
    grid = RasterCost.from_occupancy_grid(published.astype(np.int8)[None], bounds)
    of_bytes = RasterCost.from_costmap(costs[None], bounds)
    np.testing.assert_array_equal(grid.free, of_bytes.free)
    np.testing.assert_allclose(grid.values[0, :253], of_bytes.values[0, :253], atol=2 * 2.6 / 252)
    np.testing.assert_array_equal(grid.values[0, [0, 1, 252]], of_bytes.values[0, [0, 1, 252]])
    assert RasterCost.from_occupancy_grid([[-1]], ((0, 0), (1, 1)), unknown_is_free=True).values == 3


def test_inflation_falls_as_the_layer_of_nav2_has_it():
    free = np.ones((41, 41), bool)
    free[20, 20] = False
    plain = RasterCost(np.where(free, 1.0, np.inf), ((0, 0), (4.1, 4.1)))
    cost = plain.inflated(0.25, inflation_radius=1.0, cost_scaling_factor=3.0, cost_travel_multiplier=4.0)
    rows, columns = np.indices(free.shape)
    distance = 0.1 * np.hypot(rows - 20, columns - 20)
    np.testing.assert_array_equal(cost.free, distance > 0.25)
    expected = np.where(distance <= 1.0, 1 + 4 * np.exp(-3 * (distance - 0.25)), 1.0)
    on_rim = np.abs(distance - 1.0) < 1e-9
    np.testing.assert_allclose(cost.values[cost.free & ~on_rim], expected[cost.free & ~on_rim])


def test_inflation_raises_costs_and_lowers_none():
    values = np.array([[np.inf, 1, 1, 2.9, 1, 1]])
    cost = RasterCost(values, ((0, 0), (6, 1))).inflated(0, inflation_radius=3, cost_scaling_factor=1.0)
    np.testing.assert_allclose(cost.values, [[np.inf, 1 + 2 / np.e, 1 + 2 / np.e**2, 2.9, 1, 1]])
    assert RasterCost([[1.0, 2.0]], ((0, 0), (2, 1))).inflated(9).free.all()


def test_pixels_need_not_be_square():
    values = np.ones((5, 5))
    values[2, 2] = np.inf
    cost = RasterCost(values, ((0, 0), (5, 10))).inflated(1.0)
    np.testing.assert_array_equal(~cost.free, [[0] * 5, [0] * 5, [0, 1, 1, 1, 0], [0] * 5, [0] * 5])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: RasterCost.from_costmap([[-1]], BOUNDS), "from 0 to 255, .* use from_occupancy_grid, got -1.0"),
        (lambda: RasterCost.from_costmap([[256]], BOUNDS), "got 256.0"),
        (lambda: RasterCost.from_costmap([[np.nan]], BOUNDS), "got nan"),
        (lambda: RasterCost.from_costmap([["x"]], BOUNDS), "values must be numbers from 0 to 255"),
        (lambda: RasterCost.from_occupancy_grid([[101]], BOUNDS), "from -1 to 100, .* use from_costmap, got 101.0"),
        (lambda: RasterCost.from_costmap([[254]], BOUNDS), "leave a cell that is not blocked"),
        (lambda: RasterCost.from_costmap([[0]], BOUNDS, cost_travel_multiplier=-1), "cost_travel_multiplier must"),
        (lambda: RasterCost.from_costmap([[0]], BOUNDS, unknown_is_free=1), "unknown_is_free must be True or False"),
        (lambda: RasterCost([[1.0, np.inf]], BOUNDS).inflated(9), "leave a cell that is not blocked"),
        (lambda: RasterCost([[1.0]], BOUNDS).inflated(-1), "inscribed_radius must"),
        (lambda: RasterCost([[1.0]], BOUNDS).inflated(1, inflation_radius=np.inf), "inflation_radius must"),
        (lambda: RasterCost([[1.0]], BOUNDS).inflated(1, cost_scaling_factor="x"), "cost_scaling_factor must"),
    ],
    ids=range(12),
)
@pytest.mark.usefixtures("unchecked_types")
def test_what_is_no_cost_map_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
