"""Cost distances over rasters, beside distances in closed form, exact shortest paths and one-dimensional sums."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import minimize_scalar

from plr_jax import VisibilityGraph, Workspace, cost_distance
from plr_jax.eikonal import rasters


def centers(shape, cell_size=(1, 1)):
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    return np.stack([x, y], axis=-1) * cell_size


@pytest.mark.parametrize("cell_size", [1, (2, 0.5)])
def test_equal_costs_give_euclidean_distances_to_the_nearest_source(cell_size):
    shape, side = (60, 80), np.broadcast_to(cell_size, 2)
    sources = np.array([(10.2, 15.9), (70.7, 40.1), (69.0, 41.0)]) * side
    result = cost_distance(np.full(shape, 3.0), sources, cell_size=cell_size)
    to_each = np.linalg.norm(centers(shape, side)[:, :, None] - sources, axis=3)
    np.testing.assert_allclose(result.distance, 3 * to_each.min(axis=2), atol=0.004 * 3 * to_each.max())
    two = np.sort(to_each, axis=2)
    is_clear = two[..., 1] - two[..., 0] > 0.01 * two[..., 0]
    assert (result.nearest == to_each.argmin(axis=2))[is_clear].all()
    assert is_clear.mean() > 0.8


@pytest.mark.parametrize("source", [(4, 4), (4.05, 4.05), (4, 4.5)])
def test_a_source_at_a_corner_or_side_of_cells_reaches_all_cells_around(source):
    result = cost_distance(np.ones((9, 9)), [source, source])
    np.testing.assert_allclose(result.distance, np.linalg.norm(centers((9, 9)) - source, axis=2), atol=0.03)
    assert (result.nearest == 0).all()  # the first of equal ones


def test_along_a_border_the_cheaper_cell_counts_from_the_source_on():
    costs = np.full((2, 30_000), 9)  # large, so that cells are not divided
    costs[0, :2] = costs[1, 2] = 1
    result = cost_distance(costs, [(1.2, 1)])
    np.testing.assert_allclose(result.distance[1, 2], 0.8 + np.hypot(0.5, 0.5))


def test_a_source_just_inside_the_upper_border_is_in_the_last_cell():
    source = np.nextafter(1, 0)  # divided by the side of a cell, it rounds to 3.0
    inside = cost_distance(np.ones((3, 3)), [(source, 0.5)], cell_size=1 / 3)
    np.testing.assert_allclose(inside.distance, cost_distance(np.ones((3, 3)), [(1, 0.5)], cell_size=1 / 3).distance)


def test_costs_of_any_size_are_only_compared_with_one_another():
    expected = cost_distance(np.ones((4, 5)), [(0.5, 0.5)]).distance
    for size in (1e-200, 1e200):
        np.testing.assert_allclose(cost_distance(size * np.ones((4, 5)), [(0.5, 0.5)]).distance / size, expected)


def test_paths_refract_where_costs_jump():
    costs = np.ones((60, 60))
    costs[:, 30:] = 4
    result = cost_distance(costs, [(10.5, 20.5)])

    def fermat(x, y):
        ways = lambda at: np.hypot(30 - 10.5, at - 20.5) + 4 * np.hypot(x - 30, y - at)  # noqa: E731
        return minimize_scalar(ways, bounds=(0, 60), method="bounded", options={"xatol": 1e-9}).fun

    cells = [(i, j) for i in range(2, 60, 12) for j in range(31, 60, 7)]
    expected = [fermat(j + 0.5, i + 0.5) for i, j in cells]
    np.testing.assert_allclose([result.distance[cell] for cell in cells], expected, rtol=0.003)


def test_barriers_are_walked_around_and_what_they_close_off_is_not_reached():
    costs = np.ones((40, 40))
    costs[10:40, 20] = np.nan
    costs[0:5, 0:6] = np.inf
    costs[1:4, 1:4] = 1  # a closed room
    workspace = Workspace(
        ((0, 0), (40, 40)), [[(20, 10), (21, 10), (21, 40), (20, 40)], [(0, 0), (6, 0), (6, 5), (0, 5)]]
    )
    result = cost_distance(costs, [(10.5, 30.5)])
    truth = VisibilityGraph(workspace, (10.5, 30.5))(centers(costs.shape).reshape(-1, 2)).reshape(costs.shape)
    reached = np.isfinite(truth)
    np.testing.assert_allclose(result.distance[reached], truth[reached], atol=0.01 * truth[reached].max())
    assert np.isinf(result.distance[~reached]).all()
    assert (result.nearest == np.where(reached, 0, -1)).all()


@pytest.mark.parametrize("heights", [None, np.zeros((2, 2))])
def test_no_path_passes_between_barriers_that_touch_in_a_corner(heights):
    result = cost_distance([[1, np.nan], [np.nan, 1]], [(0.9, 0.9)], heights=heights)
    assert np.isfinite(result.distance).tolist() == [[True, False], [False, False]]


def test_a_mask_of_sources_is_numbered_by_rows():
    mask = np.zeros((20, 30), bool)
    mask[3, 25] = mask[15, 2] = True
    by_mask = cost_distance(np.ones((20, 30)), mask)
    by_points = cost_distance(np.ones((20, 30)), [(25.5, 3.5), (2.5, 15.5)])
    np.testing.assert_array_equal(by_mask.distance, by_points.distance)
    np.testing.assert_array_equal(by_mask.nearest, by_points.nearest)
    assert by_mask.nearest[3, 25] == 0
    assert by_mask.nearest[15, 2] == 1


def test_an_xarray_keeps_its_coordinates_and_gives_them_to_points():
    xarray = pytest.importorskip("xarray")
    costs = 1 + np.random.default_rng(0).random((20, 30))
    costs[4, 4] = -9999
    raster = xarray.DataArray(
        costs[::-1],  # from north to south, as in a GeoTIFF
        dims=("y", "x"),
        coords={"y": 5000 + 10 * np.arange(20)[::-1], "x": 700 + 10 * np.arange(30)},
        attrs={"_FillValue": -9999, "crs": "EPSG:32633"},
    )
    result = cost_distance(raster, [(700.0, 5000.0), (940.0, 5170.0)])
    costs[4, 4] = np.nan
    expected = cost_distance(costs, [(5, 5), (245, 175)], cell_size=10)
    np.testing.assert_allclose(result.distance.values, expected.distance[::-1])
    np.testing.assert_array_equal(result.nearest.values, expected.nearest[::-1])
    assert result.distance.sel(x=700, y=5000) == 0
    assert result.distance.sel(x=740, y=5040) == np.inf
    assert result.distance.attrs == {"crs": "EPSG:32633"}
    points = xarray.DataArray([(700.0, 5000.0), (940.0, 5170.0)], dims=("site", "xy"))
    np.testing.assert_array_equal(cost_distance(raster, points).nearest, result.nearest)
    mask = raster.copy(data=np.zeros(raster.shape, bool))
    mask[19, 0] = mask[2, 24] = True
    np.testing.assert_array_equal(cost_distance(raster, mask).nearest, 1 - result.nearest.where(raster > 0, 2))


def test_a_geotiff_is_read_and_written_by_rioxarray(tmp_path):
    rioxarray = pytest.importorskip("rioxarray")
    raster = raster_of(np.ones((20, 30)), 300_005.0 + 10 * np.arange(30), 5_000_195.0 - 10 * np.arange(20))
    raster[4, 4] = -9999
    raster.rio.write_crs("EPSG:32633").rio.write_nodata(-9999).rio.to_raster(tmp_path / "costs.tif")
    for masked in (True, False):
        costs = rioxarray.open_rasterio(tmp_path / "costs.tif", masked=masked).squeeze("band")
        result = cost_distance(costs, [(300_005, 5_000_195)])  # the center of the north-western cell
        result.distance.rio.to_raster(tmp_path / "distance.tif")
        found = rioxarray.open_rasterio(tmp_path / "distance.tif").squeeze("band")
        assert found.rio.crs == costs.rio.crs and found.rio.transform() == costs.rio.transform()
        assert np.isinf(found.values[4, 4]) and np.isfinite(found.values).sum() == 20 * 30 - 1
        np.testing.assert_allclose(found.values[0], 10 * np.arange(30), atol=0.1)


@pytest.mark.parametrize(("dtype", "no_data", "scale"), [("uint8", 255, 1), ("int16", -32768, 0.01)])
def test_results_from_a_geotiff_of_integers_are_written_as_they_are(dtype, no_data, scale, tmp_path):
    rioxarray, rasterio = pytest.importorskip("rioxarray"), pytest.importorskip("rasterio")
    raster = raster_of(np.full((20, 30), 40.0), 300_005.0 + 10 * np.arange(30), 5_000_195.0 - 10 * np.arange(20))
    raster[:, 20] = no_data
    raster.astype(dtype).rio.write_crs("EPSG:32633").rio.write_nodata(no_data).rio.to_raster(tmp_path / "costs.tif")
    with rasterio.open(tmp_path / "costs.tif", "r+") as file:
        file.scales, file.units = (scale,), ("s/m",)
    costs = rioxarray.open_rasterio(tmp_path / "costs.tif", mask_and_scale=True).squeeze("band")
    np.testing.assert_allclose(costs[0, :20], 40 * scale)
    result = cost_distance(costs, [(300_005, 5_000_195), (300_105, 5_000_195)])
    assert result.distance.values[:, :20].max() > 255 * scale
    for name in ("distance", "nearest"):
        written = getattr(result, name)
        written.rio.to_raster(tmp_path / f"{name}.tif")
        read = rioxarray.open_rasterio(tmp_path / f"{name}.tif", mask_and_scale=True).squeeze("band")
        np.testing.assert_array_equal(read.values, written.values)
        assert read.rio.crs == costs.rio.crs and "units" not in read.attrs


def test_a_hiker_climbs_more_slowly_than_she_descends():
    x = np.arange(41) + 0.5
    heights = np.broadcast_to(0.2 * x, (5, 41))
    down = cost_distance(np.ones((5, 41)), [(0.5, 2.5)], heights=heights)
    up = cost_distance(np.ones((5, 41)), [(0.5, 2.5)], heights=heights, from_sources=True)
    # Tobler, 1993: 6 exp(-3.5 |slope + 0.05|) kilometers per hour.
    kilometers_per_hour = 6 * np.exp(-3.5 * np.abs(np.array([-0.2, 0.2]) + 0.05))
    seconds = 40 / (kilometers_per_hour / 3.6)
    np.testing.assert_allclose([down.distance[2, 40], up.distance[2, 40]], seconds)


def test_a_slope_function_of_ones_gives_euclidean_distances():
    result = cost_distance(np.ones((40, 40)), [(20.5, 20.5)], heights=np.eye(40), slope_cost=np.ones_like)
    truth = np.linalg.norm(centers((40, 40)) - 20.5, axis=2)
    assert (result.distance >= truth - 1e-9).all()
    np.testing.assert_allclose(result.distance, truth, rtol=0.004)


def cost_along(path, costs):
    """Integrate costs, constant in each cell, along a polyline; the cheaper cell counts along a border of two."""
    total = 0.0
    for begin, change in zip(path[:-1], np.diff(path, axis=0), strict=True):
        cuts = [0.0, 1.0]
        for axis in (0, 1):
            lines = np.arange(np.floor(min(path[:, axis])), max(path[:, axis]) + 1)
            cuts.extend((lines - begin[axis]) / change[axis] if change[axis] else [])
        cuts = np.unique(np.clip(cuts, 0, 1))
        for a, b in pairwise(cuts):
            middle = begin + (a + b) / 2 * change
            beside = np.floor(middle[::-1] + list(product((-1e-9, 1e-9), repeat=2))).astype(int)
            total += (b - a) * np.linalg.norm(change) * costs[tuple(beside.T)].min()
    return total


@pytest.mark.parametrize("side", [12, 260])  # cells are divided; cells are not divided
def test_the_cost_of_a_path_is_the_distance(side):
    costs = np.pad(np.random.default_rng(3).choice([1.0, 2, 5, np.nan], (side, side)), 1, constant_values=1)
    sources = [(0.3, 5.2), (side + 1.5, 1.5), (6, side + 1.0)]
    result = cost_distance(costs, sources)
    for i, j in [(0, 0), (side + 1, side + 1), (side, 0), (side // 2, side + 1), (0, side // 2)]:
        path = result.path((j + 0.9, i + 0.1))  # anywhere in the cell
        np.testing.assert_array_equal(path[0], (j + 0.5, i + 0.5))
        np.testing.assert_array_equal(path[-1], sources[result.nearest[i, j]])
        np.testing.assert_allclose(cost_along(path, np.where(np.isnan(costs), 1e9, costs)), result.distance[i, j])
    assert result.path(sources[1]).tolist() == [[side + 1.5, 1.5]]


@pytest.mark.parametrize("from_sources", [False, True])
def test_a_path_over_heights_has_the_directed_cost(from_sources):
    heights = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(40, 50)), 3) * 40
    result = cost_distance(
        np.ones((40, 50)), [(3.1, 4.8), (45.5, 30.5)], heights=heights, cell_size=10, from_sources=from_sources
    )
    height = RegularGridInterpolator((np.arange(40) + 0.5, np.arange(50) + 0.5), heights)
    for i, j in [(39, 0), (20, 25), (0, 49)]:
        path = result.path((10 * j + 5, 10 * i + 5))
        walk = path[::-1] if from_sources else path
        seconds = 0.0
        for a, b in zip(walk[:-1] / 10, walk[1:] / 10, strict=True):
            count = int(np.abs(b - a).max().round())  # between rows and columns of centers, heights are linear
            slope = np.diff(height(np.linspace(a, b, count + 1)[:, ::-1])) / (10 * np.linalg.norm(b - a) / count)
            seconds += 10 * np.linalg.norm(b - a) * np.mean(3.6 / 6 * np.exp(3.5 * np.abs(slope + 0.05)))
        np.testing.assert_allclose(seconds, result.distance[i, j])


def test_paths_have_the_coordinates_of_an_xarray_and_end_where_there_is_none():
    raster = raster_of(np.ones((20, 30)), 305.0 + 10 * np.arange(30), 695.0 - 10 * np.arange(20))
    raster[:, 20] = np.nan
    result = cost_distance(raster, [(305, 695)])
    path = result.path((485, 505))
    np.testing.assert_array_equal(path[[0, -1]], [(485, 505), (305, 695)])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    np.testing.assert_allclose(length, result.distance.sel(x=485, y=505))
    assert result.path((595, 695)).shape == result.path((505, 505)).shape == (0, 2)
    with pytest.raises(ValueError, match=r"point must lie in the raster .*, got \(485, 705\)"):
        result.path((485, 705))


@pytest.mark.full
def test_bounds_hold_where_costs_jump_and_every_cell_that_is_reached_has_some():
    costs = np.ones((60, 60))
    costs[:, 30:] = 4
    costs[10:, 40] = np.nan
    result = cost_distance(costs, [(10.3, 20.6), (50.5, 50.5)], bounds=True)
    reached = np.isfinite(costs)
    assert np.isfinite(result.upper[reached]).all() and np.isinf(result.lower[~reached]).all()
    left = centers((60, 60))[:, :30]
    truth = np.linalg.norm(left - (10.3, 20.6), axis=2)
    assert (result.lower[:, :30] <= truth).all()
    assert (result.upper[:, :30] >= truth).all()
    assert ((result.lower <= result.distance) & (result.distance <= result.upper)).all()
    assert (result.upper[reached] - result.lower[reached]).mean() < 0.04 * result.distance[reached].mean()


@pytest.mark.full
@pytest.mark.parametrize("source", [(4.5, 33.5), (4.2, 33.9)])
def test_bounds_do_not_pass_a_diagonal_wall_of_cells_that_touch_in_corners(source):
    costs = np.ones((40, 40))
    costs[np.arange(36), np.arange(36)] = np.nan
    result = cost_distance(costs, [source], bounds=True)
    workspace = Workspace.from_mask(np.isfinite(costs), tolerance=0)
    truth = VisibilityGraph(workspace, source)(centers(costs.shape).reshape(-1, 2)).reshape(costs.shape)
    reached = np.isfinite(costs)
    assert (result.lower <= truth + 1e-9)[reached].all()
    assert (result.upper >= truth - 1e-9)[reached].all()
    assert (result.upper[reached] - result.lower[reached]).mean() < 0.05 * truth[reached].mean()


def test_paths_bend_at_the_corners_of_a_ford_one_cell_wide():
    costs = np.ones((40, 40))
    costs[:, 20] = 1e6
    costs[5, 20] = 1
    result = cost_distance(costs, [(10.5, 20.5)])
    # Down to the upper left corner of the ford, through it, and up from its upper right corner.
    x, y = np.moveaxis(centers(costs.shape)[6:, 21:], 2, 0)
    truth = np.hypot(20 - 10.5, 6 - 20.5) + 1 + np.hypot(x - 21, y - 6)
    np.testing.assert_allclose(result.distance[6:, 21:], truth, rtol=0.002)


def test_a_front_marches_over_rasters_too_large_for_a_search(monkeypatch):
    monkeypatch.setattr(rasters, "MOST_CELLS", 0)
    costs, sources = np.full((60, 80), 3.0), np.array([(10.2, 15.9), (70.7, 40.1), (69.0, 41.0)])
    costs[:, 0] = np.nan
    result = cost_distance(costs, sources)
    to_each = np.linalg.norm(centers(costs.shape)[:, 1:, None] - sources, axis=3)
    np.testing.assert_allclose(result.distance[:, 1:], 3 * to_each.min(axis=2), atol=1.5 * 3)  # cells
    two = np.sort(to_each, axis=2)
    is_clear = two[..., 1] - two[..., 0] > 1.5
    assert (result.nearest[:, 1:] == to_each.argmin(axis=2))[is_clear].all()
    assert (result.nearest[:, 0] == -1).all()
    with pytest.raises(ValueError, match=r"distances come without paths.*plr_jax\.descend"):
        result.path((0.5, 0.5))
    with pytest.raises(ValueError, match="differ by a factor of at most 100,000, got costs from 1 to 1e"):
        cost_distance([[1, 1e6]], [(0.5, 0.5)])


def test_a_plr_of_stated_bytes():
    result = cost_distance(np.ones((50, 50)), [(10.5, 10.5)], max_bytes=2048)
    truth = np.linalg.norm(centers((50, 50)) - 10.5, axis=2)
    assert result.plr.num_bytes <= 2048
    assert np.abs(np.asarray(result.plr(centers((50, 50)))) - truth).mean() < 0.01 * truth.mean()


@pytest.mark.parametrize(
    ("costs", "sources", "options", "message"),
    [
        (np.ones(3), [(0, 0)], {}, "costs must have shape"),
        ([[1, 0.0]], [(0.5, 0.5)], {}, "costs must be positive, got 0 in 1 cells. Use a small cost"),
        ([[1, np.nan]], [(0.5, 0.5), (1.5, 0.5)], {}, r"in barriers, got source 1 at \[1.5, 0.5\]"),
        ([[1, 1.0]], [(2.5, 0.5)], {}, r"in the raster .*, got source 0 at \[2.5, 0.5\]"),
        ([[1, 1.0, 1]], np.ones((1, 3)), {}, "must be boolean"),
        ([[1, 1.0]], np.ma.masked_array([[True, False]], [[True, False]]), {}, "at least one source"),
        ([[1, 1.0]], np.zeros((1, 2), bool), {}, "at least one source, got none"),
        ([[1, 1.0]], np.ones((2, 2), bool), {}, r"must have the raster's shape \(1, 2\), got \(2, 2\)"),
        ([[1, 1.0]], [(0.5, 0.5)], {"cell_size": -1}, "one or two positive numbers, got -1"),
        ([[1, 1.0]], [(0.5, 0.5)], {"heights": [[1.0]]}, r"heights must have shape \(1, 2\)"),
        ([[1, 1.0]], [(0.5, 0.5)], {"heights": [[1.0, 1]], "slope_cost": "hill"}, "or a function"),
        ([[1, 1.0]], [(0.5, 0.5)], {"heights": [[1.0, 1]], "bounds": True}, "without bounds"),
        (
            [[1, 1.0]],
            [(0.5, 0.5)],
            {"heights": [[1.0, 1]], "slope_cost": np.zeros_like},
            "must return positive numbers",
        ),
    ],
)
def test_wrong_arguments_are_named(costs, sources, options, message):
    with pytest.raises(ValueError, match=message):
        cost_distance(costs, sources, **options)


def raster_of(values, x, y=(0.0, 1.0), dims=("y", "x")):
    xarray = pytest.importorskip("xarray")
    along = (x, y) if dims[0] == "x" else (y, x)
    coordinates = {name: np.array(values) for name, values in zip(dims, along, strict=True)}
    return xarray.DataArray(np.array(values, float), dims=dims, coords=coordinates)


@pytest.mark.parametrize(
    ("costs", "options", "message"),
    [
        (lambda: raster_of(np.ones((2, 3)), [0, 1, 3]), {}, "'x' must be evenly spaced, got steps from 1 to 2"),
        (lambda: raster_of(np.ones((3, 2)), [0, 1, 2], dims=("x", "y")), {}, "y and x in this order"),
        (lambda: raster_of(np.ones((2, 2)), [0, 1]), {"cell_size": 30}, "cell_size is for arrays"),
    ],
)
def test_coordinates_that_are_not_those_of_a_raster_are_named(costs, options, message):
    with pytest.raises(ValueError, match=message):
        cost_distance(costs(), [(0, 0)], **options)


def test_heights_and_masks_need_the_coordinates_of_the_costs():
    costs, heights = raster_of(np.ones((2, 2)), [0, 1]), raster_of([[0, 1], [2, -9999]], [0, 1])
    with pytest.raises(ValueError, match=r"heights must have the dimensions .* and coordinates of costs"):
        cost_distance(costs, [(0, 0)], heights=heights[::-1])
    with pytest.raises(ValueError, match=r"A mask of sources must have the dimensions .* and coordinates of costs"):
        cost_distance(costs, heights[::-1] == 0)
    heights.attrs["nodata"] = -9999
    assert np.isinf(cost_distance(costs, [(0, 0)], heights=heights).distance.values).tolist() == [
        [False] * 2,
        [False, True],
    ]


@pytest.mark.parametrize("by", ["names", "units", "crs"])
def test_degrees_are_no_lengths(by):
    raster = raster_of(np.ones((2, 2)), [0, 1], dims=("lat", "lon") if by == "names" else ("y", "x"))
    if by == "units":
        raster.x.attrs["units"] = "degrees_east"
    if by == "crs":
        raster = raster.assign_coords(spatial_ref=((), 0, {"crs_wkt": 'GEOGCS["WGS 84"]'}))
    with pytest.warns(UserWarning, match="seem to be degrees.* project the raster"):
        cost_distance(raster, [(0, 0)])
