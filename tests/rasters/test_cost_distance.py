"""Cost distances over rasters, compared with closed forms, exact shortest paths and sums along paths."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from raster_helpers import cost_along
from scipy.optimize import minimize_scalar

from plr_jax import VisibilityGraph, Workspace, cost_distance
from plr_jax.rasters import _cost_distance


@pytest.fixture(autouse=True)
def _few_cells(monkeypatch):
    """Divide cells of small rasters into fewer parts, which is quick."""
    monkeypatch.setattr(_cost_distance, "_FINE_CELLS", 3_000)


def centers(shape, cell_size=(1, 1)):
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    return np.stack([x, y], axis=-1) * cell_size


def raster_of(values, x=None, y=None, dims=("y", "x"), **attrs):
    """Return a DataArray; without coordinates, cells of side 10 from north to south, as in a GeoTIFF."""
    xarray = pytest.importorskip("xarray")
    x = 300_005.0 + 10 * np.arange(np.shape(values)[1]) if x is None else x
    y = 5_000_195.0 - 10 * np.arange(np.shape(values)[0]) if y is None else y
    coords = {dims[0]: np.array(y if dims[0] != "x" else x), dims[1]: np.array(x if dims[0] != "x" else y)}
    return xarray.DataArray(np.array(values, float), coords, dims, attrs=attrs)


NORTH_WEST = (300_005, 5_000_195)  # the center of the first cell of such a raster


def check_euclidean(result, sources, side, tolerance, clear):
    """Check distances at a cost of 3, and the nearest source where the second one is clearly farther."""
    shape = result.distance.shape
    to_each = np.linalg.norm(centers(shape, side)[:, :, None] - sources, axis=3)
    reached = np.isfinite(result.distance)
    np.testing.assert_allclose(result.distance[reached], 3 * to_each.min(axis=2)[reached], atol=tolerance)
    nearest, second = np.sort(to_each, axis=2)[..., :2].transpose(2, 0, 1)
    is_clear = reached & (second - nearest > clear)
    assert (result.nearest == to_each.argmin(axis=2))[is_clear].all() and is_clear.mean() > 0.6


@pytest.mark.parametrize("cell_size", [1, (2, 0.5)])
def test_equal_costs_give_euclidean_distances(cell_size):
    side = np.broadcast_to(cell_size, 2)
    sources = np.array([(5.2, 7.9), (35.7, 20.1), (34.0, 21.0)]) * side
    result = cost_distance(np.full((30, 40), 3.0), sources, cell_size=cell_size)
    check_euclidean(result, sources, side, tolerance=0.5, clear=0.3)
    assert np.isfinite(result.distance).all()


@pytest.mark.parametrize("source", [(4, 4), (4.05, 4.05), (4, 4.5)])
def test_sources_between_cells_reach_all_cells_around(source):
    result = cost_distance(np.ones((9, 9)), [source, source])
    np.testing.assert_allclose(result.distance, np.linalg.norm(centers((9, 9)) - source, axis=2), atol=0.03)
    assert (result.nearest == 0).all()  # the first of equal sources


def test_cheaper_cell_counts_along_borders():
    costs = np.full((2, 1_500), 9)  # so many cells are not divided
    costs[0, :2] = costs[1, 2] = 1
    result = cost_distance(costs, [(1.2, 1)])
    np.testing.assert_allclose(result.distance[1, 2], 0.8 + np.hypot(0.5, 0.5))


def test_sources_at_the_upper_border_are_in_the_last_cell():
    source = np.nextafter(1, 0)  # divided by the side of a cell, it rounds to 3.0
    inside, at = (cost_distance(np.ones((3, 3)), [(x, 0.5)], cell_size=1 / 3).distance for x in (source, 1))
    np.testing.assert_allclose(inside, at)


def test_distances_scale_with_costs_of_any_size():
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
    np.testing.assert_allclose([result.distance[cell] for cell in cells], expected, rtol=0.005)


def test_paths_go_around_barriers():
    costs = np.ones((40, 40))
    costs[10:40, 20] = np.nan
    costs[0:5, 0:6] = np.inf
    costs[1:4, 1:4] = 1  # a closed room
    walls = [(20, 10), (21, 10), (21, 40), (20, 40)], [(0, 0), (6, 0), (6, 5), (0, 5)]
    workspace = Workspace(((0, 0), (40, 40)), walls)
    result = cost_distance(costs, [(10.5, 30.5)])
    truth = VisibilityGraph(workspace, (10.5, 30.5))(centers(costs.shape).reshape(-1, 2)).reshape(costs.shape)
    reached = np.isfinite(truth)
    np.testing.assert_allclose(result.distance[reached], truth[reached], atol=0.01 * truth[reached].max())
    assert np.isinf(result.distance[~reached]).all()
    assert (result.nearest == np.where(reached, 0, -1)).all()


@pytest.mark.parametrize("num_parts", [1, 3_000])  # cells are not divided; cells are divided
@pytest.mark.parametrize("heights", [None, np.zeros((2, 2))])
def test_no_path_passes_between_touching_barriers(heights, num_parts, monkeypatch):
    monkeypatch.setattr(_cost_distance, "_FINE_CELLS", num_parts)
    for source, reached in [((0.9, 0.9), (True, False)), ((0.5, 0.5), (True, False)), ((1.5, 1.5), (False, True))]:
        result = cost_distance([[1, np.nan], [np.nan, 1]], [source], heights=heights)
        assert np.isfinite(result.distance[[0, 1], [0, 1]]).tolist() == list(reached)
        assert np.isinf(result.distance[[0, 1], [1, 0]]).all()
    if heights is None:  # a source between the barriers is a source of both cells
        result = cost_distance([[1, np.nan], [np.nan, 1]], [(1, 1)])
        np.testing.assert_allclose(result.distance[[0, 1], [0, 1]], np.sqrt(0.5))


@pytest.mark.parametrize("source", [(1, 0), (1, 0.5)])
def test_paths_from_grid_lines_do_not_pass_between_touching_barriers(source, monkeypatch):
    monkeypatch.setattr(_cost_distance, "_FINE_CELLS", 1)
    costs = np.ones((20, 20))
    costs[0, 0] = costs[1, 1:15] = np.nan
    assert cost_distance(costs, [source]).distance[1, 0] > 2 * 13
    assert cost_distance(costs.T, [source[::-1]]).distance[0, 1] > 2 * 13
    assert cost_distance(costs, [source], squeeze=True).distance[1, 0] < 2


def test_points_beside_the_raster_by_rounding_are_on_its_border():
    result = cost_distance(np.ones((3, 3)), [(3 + 1e-9, 1.5)], cell_size=1)
    assert result.distance[1, 2] == pytest.approx(0.5) and len(result.path((-1e-9, 1.5))) == 2


def test_masks_number_sources_by_rows():
    mask = np.zeros((20, 30), bool)
    mask[3, 25] = mask[15, 2] = True
    by_mask, by_points = (cost_distance(np.ones(mask.shape), each) for each in (mask, [(25.5, 3.5), (2.5, 15.5)]))
    np.testing.assert_array_equal(by_mask.distance, by_points.distance)
    np.testing.assert_array_equal(by_mask.nearest, by_points.nearest)
    assert by_mask.nearest[mask].tolist() == [0, 1]


def test_data_arrays_keep_coordinates():
    costs, sources = 1 + np.random.default_rng(0).random((20, 30)), [(700.0, 5000.0), (940.0, 5170.0)]
    costs[4, 4] = -9999
    x, y = 700 + 10 * np.arange(30), 5000 + 10 * np.arange(20)[::-1]
    raster = raster_of(costs[::-1], x, y, _FillValue=-9999, crs="EPSG:32633")
    result = cost_distance(raster, sources)
    costs[4, 4] = np.nan
    expected = cost_distance(costs, [(5, 5), (245, 175)], cell_size=10)
    np.testing.assert_allclose(result.distance.values, expected.distance[::-1])
    np.testing.assert_array_equal(result.nearest.values, expected.nearest[::-1])
    assert result.distance.sel(x=700, y=5000) == 0
    assert result.distance.sel(x=740, y=5040) == np.inf
    assert result.distance.attrs == {"crs": "EPSG:32633"}
    points = type(raster)(sources, dims=("site", "xy"))
    np.testing.assert_array_equal(cost_distance(raster, points).nearest, result.nearest)
    mask = raster.copy(data=np.zeros(raster.shape, bool))
    mask[19, 0] = mask[2, 24] = True
    np.testing.assert_array_equal(cost_distance(raster, mask).nearest, 1 - result.nearest.where(raster > 0, 2))


@pytest.mark.parametrize(("dtype", "no_data", "scale"), [("uint8", 255, 1), ("int16", -32768, 0.01)])
def test_results_from_integer_geotiffs_are_not_scaled(dtype, no_data, scale, tmp_path):
    rioxarray, rasterio = pytest.importorskip("rioxarray"), pytest.importorskip("rasterio")
    raster = raster_of(np.full((20, 30), 40.0))
    raster[:, 20] = no_data
    raster = raster.astype(dtype).rio.write_crs("EPSG:32633").rio.write_nodata(no_data)
    raster.rio.to_raster(tmp_path / "costs.tif")
    with rasterio.open(tmp_path / "costs.tif", "r+") as file:
        file.scales, file.units = (scale,), ("s/m",)
    costs = rioxarray.open_rasterio(tmp_path / "costs.tif", mask_and_scale=True).squeeze("band")
    np.testing.assert_allclose(costs[0, :20], 40 * scale)
    result = cost_distance(costs, [NORTH_WEST, (300_105, 5_000_195)])
    assert result.distance.values[:, :20].max() > 255 * scale
    for written in (result.distance, result.nearest):
        written.rio.to_raster(tmp_path / "result.tif")
        read = rioxarray.open_rasterio(tmp_path / "result.tif", mask_and_scale=True).squeeze("band")
        np.testing.assert_array_equal(read.values, written.where(written != -1).values)  # -1 is no data
        assert read.rio.crs == costs.rio.crs and read.rio.transform() == costs.rio.transform()
        assert "units" not in read.attrs
        read.close()


@pytest.mark.parametrize("side", [12, 80])  # cells are divided; cells are not divided
def test_cost_along_path_is_the_distance(side):
    costs = np.pad(np.random.default_rng(3).choice([1.0, 2, 5, np.nan], (side, side)), 1, constant_values=1)
    sources = [(0.3, 5.2), (side + 1.5, 1.5), (6, side + 1.0)]
    result = cost_distance(costs, sources)
    for i, j in [(0, 0), (side + 1, side + 1), (side, 0), (side // 2, side + 1), (0, side // 2)]:
        path = result.path((j + 0.9, i + 0.1))  # anywhere in the cell
        np.testing.assert_array_equal(path[0], (j + 0.5, i + 0.5))
        np.testing.assert_array_equal(path[-1], sources[result.nearest[i, j]])
        np.testing.assert_allclose(cost_along(path, np.nan_to_num(costs, nan=np.inf)), result.distance[i, j])
    assert result.path(sources[1]).tolist() == [[side + 1.5, 1.5]]


@given(st.data())
def test_cost_along_path_is_the_distance_on_every_raster(data):
    shape = data.draw(st.tuples(st.integers(1, 8), st.integers(2, 9)))
    costs = data.draw(arrays(float, shape, elements=st.sampled_from([1.0, 1, 2, 5, 9, np.inf])))
    costs[0, 0] = 1
    heights = data.draw(st.none() | arrays(float, shape, elements=st.integers(0, 12).map(float)))
    side = data.draw(st.sampled_from([(1, 1), (2, 0.5)]))
    squeeze, from_sources = data.draw(st.booleans()), data.draw(st.booleans())
    num_parts = data.draw(st.sampled_from([1, 1_000]))
    options = {"heights": heights, "slope_cost": asymmetric, "squeeze": squeeze, "from_sources": from_sources}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_cost_distance, "_FINE_CELLS", num_parts)
        result = cost_distance(costs, [np.multiply(side, (0.3, 0.6))], cell_size=side, **options)
    for i, j in np.argwhere(np.isfinite(result.distance)).tolist():
        path = result.path(np.array((j + 0.5, i + 0.5)) * side)
        path = path[::-1] if from_sources else path
        along = cost_along(path, costs, side, heights, asymmetric, result._grid.parts)
        np.testing.assert_allclose(along, result.distance[i, j], rtol=1e-9, atol=1e-12)


def asymmetric(slope):
    return 1 + slope**2 + np.maximum(slope, 0)


def test_costs_that_vary_with_slopes_count_where_they_are():
    costs, heights = np.array([[1.0, 9, 9, 1]] * 2), np.array([[0.0, 0, 5, 5]] * 2)
    options = {"heights": heights, "slope_cost": lambda slope: 1 + np.abs(slope)}
    assert cost_distance(costs, [(3.5, 0.5)], **options).distance[0, 0] == pytest.approx(5 + 9 * 6 + 5)


def test_paths_of_data_arrays_use_their_coordinates():
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


def test_bounds_hold_in_every_reached_cell():
    costs = np.ones((60, 60))
    costs[:, 30:] = 4
    costs[10:, 40] = np.nan
    result = cost_distance(costs, [(10.3, 20.6), (50.5, 50.5)], bounds=True)
    reached = np.isfinite(costs)
    assert np.isfinite(result.upper[reached]).all() and np.isinf(result.lower[~reached]).all()
    left = centers((60, 60))[:, :30]
    truth = np.linalg.norm(left - (10.3, 20.6), axis=2)
    assert (result.lower[:, :30] <= truth).all() and (result.upper[:, :30] >= truth).all()
    assert ((result.lower <= result.distance) & (result.distance <= result.upper)).all()
    assert (result.upper[reached] - result.lower[reached]).mean() < 0.04 * result.distance[reached].mean()


def test_bounds_do_not_pass_diagonal_walls():
    source = 4.2, 33.9
    costs = np.ones((40, 40))
    costs[np.arange(36), np.arange(36)] = np.nan
    result = cost_distance(costs, [source], bounds=True)
    workspace = Workspace.from_mask(np.isfinite(costs), tolerance=0)
    truth = VisibilityGraph(workspace, source)(centers(costs.shape).reshape(-1, 2)).reshape(costs.shape)
    reached = np.isfinite(costs)
    assert ((result.lower <= truth + 1e-9) & (result.upper >= truth - 1e-9))[reached].all()
    assert (result.upper[reached] - result.lower[reached]).mean() < 0.05 * truth[reached].mean()


def test_fronts_march_over_large_rasters(monkeypatch):
    monkeypatch.setattr(_cost_distance, "MOST_CELLS", 0)
    costs, sources = np.full((60, 80), 3.0), np.array([(10.2, 15.9), (70.7, 40.1), (69.0, 41.0)])
    costs[:, 0] = np.nan
    result = cost_distance(costs, sources)
    check_euclidean(result, sources, (1, 1), tolerance=1.5 * 3, clear=1.5)
    assert (result.nearest[:, 0] == -1).all() and np.isfinite(result.distance[:, 1:]).all()
    with pytest.raises(ValueError, match=r"distances come without paths.*plr_jax\.descend"):
        result.path((0.5, 0.5))
    with pytest.raises(ValueError, match="differ by a factor of at most 100,000, got costs from 1 to 1e"):
        cost_distance([[1, 1e6]], [(0.5, 0.5)])


def test_results_have_a_plr_within_max_bytes():
    result = cost_distance(np.ones((50, 50)), [(10.5, 10.5)], max_bytes=512)
    truth = np.linalg.norm(centers((50, 50)) - 10.5, axis=2)
    assert result.plr.num_bytes <= 512
    assert np.abs(result.plr.numpy()(centers((50, 50))) - truth).mean() < 0.01 * truth.mean()


TWO, FIRST = [[1, 1.0]], [(0.5, 0.5)]  # costs of two cells, and the center of the first as a source


@pytest.mark.parametrize(
    ("costs", "sources", "options", "message"),
    [
        (np.ones(3), [(0, 0)], {}, "costs must have shape"),
        ([[1, 0.0]], FIRST, {}, "costs must be positive, got 0 in 1 cells. Use a small cost"),
        ([[1, np.nan]], [(0.5, 0.5), (1.5, 0.5)], {}, r"in barriers, got source 1 at \[1.5, 0.5\]"),
        (TWO, [(2.5, 0.5)], {}, r"in the raster .*, got source 0 at \[2.5, 0.5\]"),
        ([[1, 1.0, 1]], np.ones((1, 3)), {}, "must be boolean"),
        (TWO, np.ma.masked_array([[True, False]], [[True, False]]), {}, "at least one source"),
        (TWO, np.ones((2, 2), bool), {}, r"must have the raster's shape \(1, 2\), got \(2, 2\)"),
        ([[1, 1e308]], FIRST, {}, r"from 1e-290 to 1e290 .* got costs 1 to 1e\+308, lengths 1 to 2\."),
        ([[1e-100, 1e100]], FIRST, {}, r"at most 1e140 apart: got costs 1e-100 to 1e\+100"),
        (TWO, FIRST, {"cell_size": 1e300}, r"from 1e-140 to 1e140; .* lengths 1e\+300 to 2e\+300"),
        (TWO, FIRST, {"cell_size": -1}, "one or two positive numbers, got -1"),
        (TWO, FIRST, {"heights": [[1.0]]}, r"heights must have shape \(1, 2\)"),
        (TWO, FIRST, {"heights": TWO, "slope_cost": "hill"}, "or a function"),
        (TWO, FIRST, {"heights": TWO, "bounds": True}, "without bounds"),
        (TWO, FIRST, {"heights": TWO, "slope_cost": np.zeros_like}, "positive numbers of shape .*, got array"),
        (TWO, FIRST, {"heights": TWO, "slope_cost": lambda x: [1, 2, 3]}, r"shape \(\d+,\), got array"),
    ],
)
def test_invalid_arguments_raise(costs, sources, options, message):
    with pytest.raises(ValueError, match=message):
        cost_distance(costs, sources, **options)


def test_invalid_coordinates_raise():
    for raster, options, message in (
        (raster_of(np.ones((2, 3)), [0, 1, 3]), {}, "'x' must be evenly spaced, got steps from 1 to 2"),
        (raster_of(np.ones((3, 2)), [0, 1, 2], [0, 1], ("x", "y")), {}, "y and x in this order"),
        (raster_of(np.ones((2, 2))), {"cell_size": 30}, "cell_size is for arrays"),
    ):
        with pytest.raises(ValueError, match=message):
            cost_distance(raster, [(0, 0)], **options)


def test_heights_and_masks_need_coordinates_of_costs():
    pytest.importorskip("rioxarray")
    costs, heights = raster_of(np.ones((2, 2)), [0, 1], [0, 1]), raster_of([[0, 1], [2, -9999]], [0, 1], [0, 1])
    with pytest.raises(
        ValueError, match=r"heights must have the dimensions .*, coordinates and reference system of costs"
    ):
        cost_distance(costs, [(0, 0)], heights=heights[::-1])
    with pytest.raises(
        ValueError, match=r"A mask of sources must have the dimensions .*, coordinates and reference system of costs"
    ):
        cost_distance(costs, heights[::-1] == 0)
    with pytest.raises(
        ValueError, match=r"heights must have .* reference system of costs, got other ones: .* rio.reproject_match"
    ):
        cost_distance(costs.rio.write_crs(32632), [(0, 0)], heights=heights.rio.write_crs(32633))
    heights.attrs["nodata"] = -9999
    distance = cost_distance(costs, [(0, 0)], heights=heights).distance
    assert np.isinf(distance.values).tolist() == [[False, False], [False, True]]


def test_own_slope_costs_count_uphill_and_downhill():
    options = {"heights": 2.0 * np.arange(9)[None], "slope_cost": lambda slope: np.where(slope > 0, 3.0, 1.0)}
    for from_sources, expected in ((False, 8), (True, 24)):
        found = cost_distance(np.ones((1, 9)), FIRST, **options, from_sources=from_sources)
        assert found.distance[0, 8] == pytest.approx(expected)


def test_squeezing_paths_pass_between_barriers():
    costs = np.full((4, 4), np.nan)
    costs[range(4), range(4)] = 1
    result = cost_distance(costs, [(0.5, 0.5)], squeeze=True)
    np.testing.assert_allclose(result.distance[range(4), range(4)], np.sqrt(2) * np.arange(4))
    assert result.path((3.5, 3.5)).tolist() == [[3.5, 3.5], [0.5, 0.5]]
