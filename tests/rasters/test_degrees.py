"""Cost distances over rasters in degrees, compared with great circles and with sums along paths."""

from itertools import pairwise

import numpy as np
import pytest
from raster_helpers import cost_along

from plr_jax import cost_distance
from plr_jax.rasters import _cost_distance


@pytest.fixture(autouse=True)
def _few_cells(monkeypatch):
    """Divide cells of small rasters into fewer parts, which is quick."""
    monkeypatch.setattr(_cost_distance, "_FINE_CELLS", 3_000)


def degrees_raster(values, west, south, step):
    """Return a DataArray of longitudes and latitudes, from north to south; ``values`` start in the south."""
    xarray = pytest.importorskip("xarray")
    rows, columns = np.shape(values)
    lat, lon = (start + step * (np.arange(count) + 0.5) for start, count in ((south, rows), (west, columns)))
    return xarray.DataArray(np.array(values, float), {"lat": lat, "lon": lon}, ("lat", "lon"))[::-1]


def great_circle(lon, lat, place):
    """Return the distance in meters along great circles of the mean earth."""
    lon, lat, (lon0, lat0) = np.radians(lon), np.radians(lat), np.radians(place)
    cosine = np.sin(lat) * np.sin(lat0) + np.cos(lat) * np.cos(lat0) * np.cos(lon - lon0)
    return 6_371_008.8 * np.arccos(np.clip(cosine, -1, 1))


@pytest.mark.parametrize("most_cells", [10**6, 0])
def test_distances_in_degrees_are_great_circles(most_cells, monkeypatch):
    monkeypatch.setattr(_cost_distance, "MOST_CELLS", most_cells)
    raster = degrees_raster(np.full((40, 180), 2.0), -180, -20, 2)  # around the earth, 20 S to 60 N
    sources = [(171.0, 31.0), (-61.0, 5.0)]
    result = cost_distance(raster, sources)
    lon, lat = np.meshgrid(raster.lon, raster.lat)
    truth = 2 * np.stack([great_circle(lon, lat, source) for source in sources])
    least = truth.min(axis=0)
    is_inside = (np.abs(lat - 20) < 25) & (least > 4e6) & (least < 1.6e7)  # other great circles leave the raster
    error = np.abs(result.distance.values - least)[is_inside] / least[is_inside]
    assert error.mean() < 0.002 and error.max() < 0.015
    is_clear = is_inside & (np.abs(truth[0] - truth[1]) > 1e6)
    assert (result.nearest.values == truth.argmin(axis=0))[is_clear].all()
    assert result.distance.sel(lon=171, lat=31) < 1e5


def test_paths_in_degrees_pass_the_antimeridian_and_barriers():
    costs = np.ones((40, 180))
    costs[10:20, 175] = np.nan
    result = cost_distance(degrees_raster(costs, -180, -20, 2), [(-163.0, 11.0)])
    path = result.path((161.0, 11.0))
    np.testing.assert_allclose(path[[0, -1]], [(161, 11), (197, 11)], atol=1e-9)  # east of 180
    steps = [great_circle(*a, b) for a, b in pairwise(path)]
    np.testing.assert_allclose(sum(steps), result.distance.sel(lon=161, lat=11), rtol=0.003)
    assert sum(steps) > 1.001 * great_circle(161, 11, (197, 11))
    assert np.isinf(result.distance.values[::-1][10:20, 175]).all()


@pytest.mark.parametrize("side", [8, 60])  # cells are divided; cells are not divided
def test_cost_along_path_in_degrees_is_the_distance(side):
    costs = np.random.default_rng(3).choice([1.0, 2, 5, np.inf], (side, side))
    costs[side // 2] = 1
    raster = degrees_raster(costs, 20, 82 - side, 1)
    result = cost_distance(raster, [(20.3, 82.2 - side / 2)])
    count = side * result._grid.parts[0]
    scale = np.cos(np.radians(82 - side + (np.arange(count) + 0.5) / count * side))
    meters = 6_371_008.8 * np.radians(1)
    for i, j in np.argwhere(np.isfinite(result.distance.values[::-1]))[:: side // 4].tolist():
        path = (result.path((20.5 + j, 82.5 - side + i)) - (20, 82 - side)) * meters
        along = cost_along(path, costs, (meters, meters), parts=result._grid.parts, scale=scale)
        np.testing.assert_allclose(along, result.distance.values[::-1][i, j], rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("most_cells", [10**6, 0])
def test_thin_barriers_in_degrees_have_no_gaps(most_cells, monkeypatch):
    monkeypatch.setattr(_cost_distance, "MOST_CELLS", most_cells)
    costs = np.ones((80, 30))
    costs[np.arange(80), np.arange(80) * 30 // 80] = np.nan
    costs[0, :] = np.nan
    result = cost_distance(degrees_raster(costs, 10, 4, 1), [(12.5, 80.5)])
    row, column = np.indices(costs.shape)
    is_east = column > row * 30 // 80
    assert np.isinf(result.distance.values[::-1][is_east]).all()
    assert np.isfinite(result.distance.values[::-1][~is_east & np.isfinite(costs)]).all()


@pytest.mark.parametrize("from_sources", [False, True])
def test_heights_in_degrees_may_come_alone(from_sources):
    meters = 6_371_008.8 * np.radians(1) * np.cos(np.radians(np.arange(50, 60) + 0.5))  # of a degree along parallels
    heights = degrees_raster(np.tile(1e4 * np.arange(20), (10, 1)), 0, 50, 1)
    heights[9, 19] = np.nan
    options = {"slope_cost": lambda slope: np.where(slope > 0, 3.0, 1.0), "from_sources": from_sources}
    result = cost_distance(1.0, [(0.5, 55.5)], heights=heights, **options)
    expected = (3 if from_sources else 1) * 10 * meters[5]
    np.testing.assert_allclose(result.distance.sel(lon=10.5, lat=55.5), expected, rtol=0.02)
    assert np.isinf(result.distance.values[9, 19]) and np.isinf(result.distance).sum() == 1


def test_a_plr_in_degrees_wraps():
    result = cost_distance(degrees_raster(np.ones((20, 90)), -180, -40, 4), [(-178, 2)], max_bytes=1024)
    lon = np.array([-179.9, 179.9, 170, -170])
    values = result.plr(np.stack([lon, np.full(4, 2.0)], axis=1))
    np.testing.assert_allclose(values, great_circle(lon, 2.0, (-178, 2)), atol=4e5)
    assert abs(values[0] - values[1]) < 5e4


@pytest.mark.parametrize(
    ("raster", "options", "message"),
    [
        ([[1, 1.0]], {"degrees": True}, "degrees=True needs a DataArray"),
        ((np.ones((2, 2)), 0, 84, 1), {}, r"between latitudes -85 and 85 degrees, got 84 to 86: crop it"),
        ((np.ones((2, 361)), 0, 0, 1), {}, r"at most 360 degrees, got 361"),
        ((np.ones((2, 2)), 0, 0, 1), {"bounds": True}, "no proven bounds, which need a plane"),
    ],
)
def test_invalid_degrees_raise(raster, options, message):
    with pytest.raises(ValueError, match=message):
        cost_distance(degrees_raster(*raster) if isinstance(raster, tuple) else raster, [(0.5, 0.5)], **options)
