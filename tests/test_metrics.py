import dataclasses
import json

import numpy as np
import pytest

from plr_jax import Workspace, metrics
from plr_jax.geometry.box import Box

GRID = Box((0, 0), (2, 1)).grid(8).reshape(-1, 2)
LINE = np.stack([np.arange(4.0), np.zeros(4)], axis=1)
# The right half is closed off.
WALLED = Workspace(((0, 0), (2, 1)), [[(1.0, 0.0), (1.5, 0.0), (1.5, 1.0), (1.0, 1.0)]])


def from_origin(x):
    return np.hypot(x[:, 0], x[:, 1])


def always(answer):
    return lambda x: np.full(len(x), answer)


def report_of(answer, distance, x=None):
    """Return the error report of answers against distances, at ``x`` or at (0, 0), (1, 0), ..."""
    x = np.stack([np.arange(len(answer)), np.zeros(len(answer))], axis=1) if x is None else x
    return metrics.error_map(lambda x: np.array(answer), lambda x: np.array(distance), x)


def test_report_of_known_errors():
    report = report_of([0.0, 1.1, 1.7, 3.0], [0.0, 1, 2, 3])
    assert report.max == pytest.approx(0.3) and report.mean == pytest.approx(0.1)
    assert report.quantiles[0.5] == pytest.approx(0.05)
    assert (report.max_at, report.max_distance, report.num_points) == ((2.0, 0.0), 3.0, 4)
    assert (report.num_unreachable, report.num_unanswered, report.num_invented) == (0, 0, 0)
    assert "max error 0.3 at (2, 0), mean 0.1, over 4 points" in str(report)
    assert json.loads(json.dumps(dataclasses.asdict(report)))["num_points"] == 4


def test_place_of_largest_error_is_rounded_like_distances():
    for scale, origin, said in [
        (1.0, (691104.23456, 5334012.65432), "691106.2346, 5334012.6543"),
        (1e6, (691104.23456, 5334012.65432), "2691104, 5334013"),
        (1e-3, (0.0, 0.5), "0.002, 0.5"),
        (0.0, (691104.23456, 0.5), "691104.2346, 0.5"),
    ]:
        distance = scale * np.arange(4.0)
        report = report_of(distance + scale * np.eye(4)[2], distance, origin + scale * LINE)
        assert f"at ({said}), mean" in str(report)


def test_infinite_answers_are_counted_not_averaged():
    inf, nan = np.inf, np.nan
    report = report_of([1.5, 1.0, inf, nan, inf, 2.0, nan], [1.0, 1.0, 1.0, 1.0, inf, inf, inf])
    assert (report.num_points, report.num_unreachable, report.num_unanswered, report.num_invented) == (7, 3, 2, 1)
    assert (report.max, report.mean) == (0.5, 0.25)
    assert "over 4 points; 2 of them not answered" in str(report)


def test_report_agrees_with_numpy():
    answer, distance = np.random.default_rng(0).exponential(size=(2, 500))
    report, error = report_of(answer, distance), np.abs(answer - distance)
    assert report.max == error.max() and report.mean == pytest.approx(error.mean())
    assert report.quantiles == {q: np.quantile(error, q) for q in (0.5, 0.9, 0.99, 0.999)}


def test_functions_are_called_once_and_may_change_points():
    asked, x = [], np.array([[0.0, 1], [3, 4]])

    def recorded(x):
        asked.append(x.copy())
        x -= 1
        return from_origin(x)

    report = metrics.error_map(recorded, recorded, x)
    np.testing.assert_array_equal(asked, [[[0, 1], [3, 4]]] * 2)
    np.testing.assert_array_equal(x, [[0, 1], [3, 4]])
    assert (report.max, report.max_distance, report.num_points) == (0.0, np.hypot(2, 3), 2)


def test_masked_distances_are_unreachable():
    def masked(x):
        return np.ma.masked_array(from_origin(x), x[:, 0] > 0.5, fill_value=0.0)

    x = [[0.25, 0], [0.75, 0], [1, 0]]
    report = metrics.error_map(from_origin, masked, x)
    assert (report.max, report.num_unreachable, report.num_invented) == (0.0, 2, 2)
    report = metrics.error_map(masked, from_origin, x)
    assert (report.max, report.num_unanswered) == (0.0, 2)
    grid = metrics.error_grid(from_origin, masked, WALLED, resolution=8)
    assert (grid[:, :2] == 0).all() and np.isnan(grid[:, 2:]).all()


def test_undefined_error_raises():
    for approximation, distance, x, message in [
        (from_origin, from_origin, np.empty((0, 2)), "at least one point, got none"),
        (from_origin, from_origin, np.zeros(2), r"shape \(n, dim\), got \(2,\)"),
        (from_origin, from_origin, WALLED, r"x must be numbers of shape \(n, dim\), got Workspace"),
        (lambda x: np.zeros((len(x), 1)), from_origin, GRID, "approximation must give one number per point"),
        (from_origin, lambda x: np.zeros(3), GRID, "distance function must give one number per point"),
        (from_origin, always(np.nan), GRID, "distance function gives NaN at"),
        (from_origin, always(1j), GRID, "distance function's answer must be real numbers"),
        (from_origin, always(np.inf), GRID, "No error is defined"),
        (always(np.inf), from_origin, GRID, "No error is defined"),
    ]:
        with pytest.raises(ValueError, match=message):
            metrics.error_map(approximation, distance, x)


def test_error_grid_has_error_at_cell_centers():
    grid = metrics.error_grid(
        lambda x: np.where(x[:, 1] > 0.75, np.inf, from_origin(x) + x[:, 0]),
        lambda x: np.where(x[:, 0] <= 1, from_origin(x), np.inf),
        WALLED,
        resolution=8,
    )
    # 8 x 4 cells of side 0.25; columns 4, 5 are the wall, 6, 7 cannot be reached; the top row is unanswered.
    expected = np.tile([0.125, 0.375, 0.625, 0.875, np.nan, np.nan, np.nan, np.nan], (4, 1))
    expected[3, :4] = np.inf
    np.testing.assert_allclose(grid, expected, atol=1e-12)
