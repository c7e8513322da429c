from itertools import product

import numpy as np
import pytest
from eikonal_helpers import EMPTY, use_few_nodes
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from plr_jax import Box, RasterCost, solve_eikonal
from plr_jax.spaces import CostMap
from plr_jax.spaces._raster_cost import SparseTable

UNIT = ((0, 0), (1, 1))
SHAPES = [(7,), (1,), (6, 9), (1, 5), (4, 5, 6), (3, 2, 2, 4)]


def random_raster(shape, interpolation="bilinear", *, periodic=None, seed=0):
    """Return a raster of factors of very different sizes, a fifth of its cells blocked, in a random box."""
    rng = np.random.default_rng(seed)
    values = np.exp(rng.normal(0, 2, shape))
    values[(rng.random(shape) < 0.2) & (values.size > 1)] = np.inf
    lo, width = rng.normal(0, 5, len(shape)), rng.uniform(0.5, 20, len(shape))
    return RasterCost(values, Box(lo, lo + width, periodic), interpolation)


def boxes_of(cost, n, seed=1):
    """Return boxes from far below a pixel to the raster's size, some beyond it, a third along halves of pixels."""
    rng, (lo, width) = np.random.default_rng(seed), (cost.domain.lo, cost.domain.width)
    pixel = width / cost.values.shape[::-1]
    a = lo + width * rng.uniform(-0.2, 1.1, (n, cost.dim))
    size = width * 2.0 ** -rng.uniform(-0.5, 10, (n, 1)) * rng.uniform(0.3, 1, (n, cost.dim))
    a[::3] = lo + pixel * np.round((a[::3] - lo) / pixel * 2) / 2
    size[::3] = pixel * rng.integers(0, 4, size[::3].shape) / 2
    return a, a + size


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("periodic", [False, True])
def test_bounds_contain_values_at_points_of_boxes(shape, interpolation, periodic):
    cost = random_raster(shape, interpolation, periodic=[periodic] + [False] * (len(shape) - 1))
    assert isinstance(cost, CostMap)
    lo, hi = boxes_of(cost, 200)
    lower, upper = cost.bounds(lo, hi)
    share = np.random.default_rng(2).random((len(lo), 30, len(shape)))
    share[:, :10] = np.round(share[:, :10])  # corners
    points = np.clip(lo[:, None] + share * (hi - lo)[:, None], lo[:, None], hi[:, None])
    values = cost(points.reshape(-1, len(shape))).reshape(-1, 30)
    assert (lower[:, None] <= values).all() and (values <= upper[:, None]).all()
    assert (lower > 0).all() and np.isfinite(upper).all()


@pytest.mark.parametrize("shape", [(40,), (30, 25), (9, 8, 7)], ids=str)
def test_bounds_of_small_boxes_equal_their_extremes(shape):
    cost = random_raster(shape)
    pixel = cost.domain.width / shape[::-1]
    lo, hi = boxes_of(cost, 150)
    lower, upper = cost.bounds(lo, hi)
    # The interpolation has its extremes on lines through centers of cells, or on the box's sides.
    for i in range(len(lo)):
        centers = (cost.domain.lo[a] + pixel[a] * (np.arange(shape[::-1][a]) + 0.5) for a in range(cost.dim))
        lines = [np.unique(np.clip([lo[i, a], *c, hi[i, a]], lo[i, a], hi[i, a])) for a, c in enumerate(centers)]
        values = cost(np.array(list(product(*lines))))
        if (hi[i] - lo[i] <= 2 * pixel).all():
            np.testing.assert_allclose([lower[i], upper[i]], [values.min(), values.max()], rtol=1e-9)
    grown = cost.bounds(lo - pixel, hi + pixel)
    assert (grown[0] <= lower).all() and (upper <= grown[1]).all()
    whole = cost.bounds(cost.domain.lo[None] - 1, cost.domain.hi[None] + 1)
    np.testing.assert_allclose(np.ravel(whole), [cost.values.min(), cost.values[cost.free].max()], rtol=1e-6)


def test_bounds_of_nearest_cells_count_touched_cells():
    cost = RasterCost([[1.0, 2, 4], [8, 16, 32]], ((0, 0), (3, 2)), "nearest")
    np.testing.assert_array_equal(cost([(0.2, 0.9), (1, 0.5), (1, 1), (3, 2), (-7, 9)]), [1, 2, 16, 32, 8])
    lo, hi = np.array([(0.2, 0.2), (0.2, 0.2), (1.2, 1.0)]), np.array([(0.8, 0.8), (1, 0.8), (1.8, 1.2)])
    np.testing.assert_allclose(cost.bounds(lo, hi), [(1, 1, 2), (1, 2, 16)], rtol=1e-12)


@pytest.mark.parametrize("shape", [(6,), (6, 9), (3, 2, 2, 4)], ids=str)
def test_interpolation_equals_scipy(shape):
    values = np.random.default_rng(0).uniform(1, 9, shape)
    bounds = Box(np.arange(len(shape)), np.arange(len(shape)) + 2.5)
    cost = RasterCost(values, bounds)
    x = np.random.default_rng(1).uniform(bounds.lo, bounds.hi, (500, len(shape)))
    pixel = bounds.width / shape[::-1]
    centers = [lo + side * (np.arange(n) + 0.5) for lo, side, n in zip(bounds.lo, pixel, shape[::-1], strict=True)]
    inner = np.clip(x, bounds.lo + pixel / 2, bounds.hi - pixel / 2)
    np.testing.assert_allclose(cost(x), RegularGridInterpolator(centers, values.T)(inner), rtol=1e-13)


def test_blocked_cells_take_the_nearest_free_factor():
    values = np.random.default_rng(0).uniform(1, 9, (12, 10))
    blocked = np.random.default_rng(1).random(values.shape) < 0.4
    forms = np.where(blocked, np.inf, values), np.where(blocked, np.nan, values), np.ma.array(values, mask=blocked)
    x = np.stack(np.meshgrid(np.arange(10) + 0.5, 2 * np.arange(12) + 1.0), axis=-1)
    for form in forms:
        cost = RasterCost(form, ((0, 0), (10, 24)))
        np.testing.assert_array_equal(cost.free, ~blocked)
        np.testing.assert_array_equal(cost.values, forms[0])
        np.testing.assert_array_equal(cost(x[~blocked]), values[~blocked])
        distance, _ = cKDTree(x[~blocked]).query(x[blocked])
        among = np.linalg.norm(x[blocked][:, None] - x[~blocked], axis=2) <= distance[:, None] + 1e-9
        assert (among & (cost(x[blocked])[:, None] == values[~blocked])).any(axis=1).all()


def test_periodic_rasters_interpolate_across_the_seam():
    values = np.array([1.0, 2, 3, 5])
    cost = RasterCost(values, Box([0], [4], [True]))
    np.testing.assert_allclose(cost([[0], [4], [-0.25], [3.75], [400.5], [-3.5]]), [3, 3, 4, 4, 1, 1])
    lower, upper = cost.bounds(np.array([[3.5], [-0.5], [401.5], [1]]), np.array([[4.5], [0.5], [402.5], [7]]))
    np.testing.assert_allclose([lower, upper], [(1, 1, 2, 1), (5, 5, 3, 5)], rtol=1e-6)


def test_periodic_rasters_inflate_across_the_seam():
    values = np.random.default_rng(0).uniform(1, 2, (3, 8))
    values[:, 1] = values[2, 6] = np.inf
    bounds, x = Box((0, 0), (8, 3), (True, False)), np.random.default_rng(1).uniform(0, (8, 3), (200, 2))

    def at(turn):
        cost = RasterCost(np.roll(values, turn, axis=1), bounds)
        return cost(x + np.array((turn, 0))), np.roll(cost.inflated(0.2, inflation_radius=3).values, -turn, axis=1)

    for turn in range(1, 8):
        for here, there in zip(at(0), at(turn), strict=True):
            np.testing.assert_allclose(here, there, rtol=1e-12)


def test_extra_coordinates_are_ignored_and_infinite_ones_give_nan():
    cost = random_raster((6, 9))
    x = np.random.default_rng(0).uniform(cost.domain.lo, cost.domain.hi, (50, 2))
    lo, hi = boxes_of(cost, 50)
    longer = [np.append(each, np.ones((50, 1)), axis=1) for each in (x, lo, hi)]
    np.testing.assert_array_equal(cost(longer[0]), cost(x))
    np.testing.assert_array_equal(cost.bounds(*longer[1:]), cost.bounds(lo, hi))
    np.testing.assert_array_equal(np.isnan(cost([(np.nan, 0), (0, np.inf), (1e300, -1e300)])), [True, True, False])
    with pytest.raises(ValueError, match=r"q must have at least 2 coordinates, as RasterCost\(6 x 9 cells.*\(3, 1\)"):
        cost(np.zeros((3, 1)))
    with pytest.raises(ValueError, match="hi nowhere below lo"):
        cost.bounds(hi, lo)


@pytest.mark.parametrize("shape", [(1,), (37,), (1, 3), (17, 40), (3, 500), (9, 8, 11)], ids=str)
@pytest.mark.parametrize("max_entries", [2**26, 1500])
def test_sparse_tables_return_extremes_of_blocks(shape, max_entries, monkeypatch):
    monkeypatch.setattr("plr_jax.spaces._raster_cost._MAX_ENTRIES", max_entries)
    rng = np.random.default_rng(0)
    values = rng.integers(1, 1000, shape) * 1.0
    ends = np.sort(rng.integers(0, shape, (2, 80, len(shape))), axis=0)
    blocks = [values[tuple(slice(a, b + 1) for a, b in zip(*each, strict=True))] for each in zip(*ends, strict=True)]
    exact = np.array([[block.min() for block in blocks], [block.max() for block in blocks]])
    np.testing.assert_array_equal(SparseTable(values).extremes(*ends), exact)
    least, most = SparseTable(values / 7).extremes(*ends)  # 32 bits round these values
    assert (least <= exact[0] / 7).all() and (most >= exact[1] / 7).all()
    np.testing.assert_allclose([least, most], exact / 7, rtol=2e-7)


def test_space_is_free_in_cells_that_are_not_blocked():
    cost = random_raster((4, 5, 6))
    x = np.random.default_rng(0).uniform(cost.domain.lo, cost.domain.hi, (500, 3))
    cell = np.floor((x - cost.domain.lo) / cost.domain.width * (6, 5, 4)).astype(int)
    is_free = cost.space().is_free(x)
    assert cost.space().domain == cost.domain
    np.testing.assert_array_equal(is_free, cost.free[tuple(cell.T[::-1])])
    clear = cost.space(0.1 * cost.domain.width.min()).is_free(x)
    assert 0 < clear.sum() < is_free.sum() and not (clear & ~is_free).any()


STRIP = ((0.0, 0.0), (8.0, 1.0))


def test_costs_of_bytes_follow_smac_and_navfn():
    values = np.array([[0, 1, 126, 252, 253, 254, 255, 63]], np.uint8)
    cost = RasterCost.from_costmap(values, STRIP)
    np.testing.assert_array_equal(cost.free, [[1, 1, 1, 1, 0, 0, 0, 1]])
    np.testing.assert_allclose(cost.values[cost.free], [1, 1 + 2 / 252, 2, 3, 1.5])
    known = RasterCost.from_costmap(values, STRIP, unknown_is_free=True, interpolation="nearest")
    np.testing.assert_array_equal(known.free, [[1, 1, 1, 1, 0, 0, 1, 1]])
    assert known.values[0, 6] == 3 and known.interpolation == "nearest"
    navfn = RasterCost.from_costmap(values, STRIP, cost_travel_multiplier=252 * 0.8 / 50)
    np.testing.assert_allclose(50 * navfn.values[0, :4], 50 + 0.8 * values[0, :4])


def test_occupancy_grids_recover_published_costs():
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


def nav2_inflated(costs, resolution, inscribed_radius, inflation_radius, scaling):
    """Return bytes as Nav2's inflation layer raises them, for every cell and lethal cell one by one."""
    raised, lethal = costs.astype(float), np.argwhere(costs == 254)
    for cell in np.ndindex(costs.shape):
        cells = min((np.hypot(*(at - np.array(cell))) for at in lethal), default=np.inf)
        if 0 < cells <= np.ceil(inflation_radius / resolution):
            inside = cells * resolution <= inscribed_radius
            cost = 253 if inside else 252 * np.exp(-scaling * (cells * resolution - inscribed_radius))
            raised[cell] = 253 if inside and costs[cell] == 255 else max(costs[cell], cost)
    return raised


@pytest.mark.parametrize("unknown_is_free", [False, True])
def test_inflation_equals_nav2(unknown_is_free):
    rng = np.random.default_rng(0)
    costs = rng.choice([0, 40, 252, 253, 254, 255], (17, 23), p=[0.6, 0.1, 0.05, 0.1, 0.05, 0.1])
    bounds, radii = ((-1.0, 2.0), (-1 + 23 / 4, 2 + 17 / 4)), (0.3, 0.6)  # 0.6 is 2.4 cells: 3 in Nav2
    options = {"unknown_is_free": unknown_is_free, "interpolation": "nearest", "cost_travel_multiplier": 3.0}
    inflation = {"inflation_radius": radii[1], "cost_scaling_factor": 2.0, "cost_travel_multiplier": 3.0}
    cost = RasterCost.from_costmap(costs, bounds, **options).inflated(radii[0], **inflation)
    expected = RasterCost.from_costmap(nav2_inflated(costs, 0.25, *radii, 2.0), bounds, **options)
    np.testing.assert_allclose(cost.values, expected.values)
    assert cost.interpolation == "nearest" and 0 < cost.free.sum() < (costs < 253).sum()
    again = cost.inflated(radii[0], **inflation)
    np.testing.assert_array_equal(again.values, cost.values)  # cells that inflation blocked are not inflated again


def test_inflation_radius_rounds_up_to_whole_cells():
    """At resolution 0.1, 0.55 are 6 cells and 0.3 exactly 3, however the bounds round."""
    for lo in (0.0, 0.1, 1 / 3, 100.7, 5e5):
        values = np.ones((1, 12))
        values[0, 0] = np.inf
        plain = RasterCost(values, ((lo, 0), (lo + 1.2, 0.1)))
        for radius, cells in ((0.55, 6), (0.3, 3), (0.31, 4), (0.05, 1)):
            cost = plain.inflated(0.0, inflation_radius=radius, cost_scaling_factor=0.1)
            np.testing.assert_array_equal(cost.values[0, 1:] > 1, np.arange(1, 12) <= cells)
        for radius, cells in ((0.3, 3), (0.29, 2), (0.35, 3)):
            np.testing.assert_array_equal(plain.inflated(radius).free[0], np.arange(12) > cells)


def test_inflation_measures_distances_on_oblong_pixels():
    values = np.ones((5, 5))
    values[2, 2] = np.inf
    cost = RasterCost(values, ((0, 0), (5, 10))).inflated(1.0)
    np.testing.assert_array_equal(~cost.free, [[0] * 5, [0] * 5, [0, 1, 1, 1, 0], [0] * 5, [0] * 5])
    assert RasterCost([[1.0, 2.0]], ((0, 0), (2, 1))).inflated(9).free.all()


def test_data_arrays_are_placed_by_their_coordinates():
    xarray = pytest.importorskip("xarray")
    values = np.array([[1.0, 2, 3], [4, -9999, 6]])  # the first row is the north
    raster = xarray.DataArray(values, {"y": [25.0, 15.0], "x": [2.0, 3, 4]}, ("y", "x"), attrs={"_FillValue": -9999})
    cost = RasterCost(raster, interpolation="nearest")
    np.testing.assert_array_equal(cost.domain.lo, [1.5, 10])
    np.testing.assert_array_equal(cost.domain.hi, [4.5, 30])
    np.testing.assert_array_equal(cost([[2.1, 24], [4.2, 11], [2, 16]]), [1, 6, 4])
    assert not cost.space().is_free([[3.0, 15.0]])[0]
    with pytest.raises(ValueError, match="leave the bounds out"):
        RasterCost(raster, ((0, 0), (3, 2)))
    with pytest.raises(ValueError, match=r"must have the dimensions y and x, got \('band', 'y', 'x'\)"):
        RasterCost(raster.expand_dims("band"))


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_solver_bounds_contain_cost_across_stripes(interpolation, monkeypatch):
    use_few_nodes(monkeypatch)
    cost = RasterCost(np.tile(np.linspace(1, 3, 16)[:, None], (1, 16)), UNIT, interpolation)
    plr, y = solve_eikonal(EMPTY, (0.5, 0.0), cost_map=cost, max_leaves=60).numpy(), (np.arange(4000) + 0.5) / 4000
    along = np.cumsum(cost(np.column_stack([0 * y + 0.5, y])))[:-1] / 4000
    lower, upper = plr.bounds(np.column_stack([0 * y + 0.5, y + 0.5 / 4000])[:-1])
    assert (lower <= along + 1e-3).all() and (along <= upper + 1e-3).all()
    assert (upper - lower)[-1] < 0.4 * along[-1]
