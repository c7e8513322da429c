import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import metrics
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace

GRID = Box((0, 0), (2, 1)).grid(8).reshape(-1, 2)
# The right half is closed off.
WALLED = Workspace(((0, 0), (2, 1)), [[(1.0, 0.0), (1.5, 0.0), (1.5, 1.0), (1.0, 1.0)]])


def from_origin(x):
    return np.hypot(x[:, 0], x[:, 1])


def left_of_wall(x):
    return np.where(x[:, 0] <= 1, from_origin(x), np.inf)


def test_known_errors_give_known_numbers():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    report = metrics.error_map(lambda x: x[:, 0] + np.array([0.0, 0.1, -0.3, 0.0]), lambda x: x[:, 0], points)
    assert report.max == pytest.approx(0.3)
    assert report.mean == pytest.approx(0.1)
    assert report.quantiles[0.5] == pytest.approx(0.05)
    assert report.max_at == (2.0, 0.0)
    assert report.max_distance == 3.0
    assert report.num_points == 4
    assert (report.num_unreachable, report.num_unanswered, report.num_invented) == (0, 0, 0)
    assert "max error 0.3 at (2, 0), mean 0.1, over 4 points" in str(report)


@pytest.mark.parametrize(
    ("scale", "origin", "said"),
    [
        (1.0, (691104.23456, 5334012.65432), "691106.2346, 5334012.6543"),
        (1e3, (691104.23456, 5334012.65432), "693104.2, 5334012.7"),
        (1e6, (691104.23456, 5334012.65432), "2691104, 5334013"),
        (1e-3, (0.0, 0.5), "0.002, 0.5"),
        (0.0, (691104.23456, 0.5), "691104.2346, 0.5"),
    ],
)
def test_the_place_of_the_largest_error_is_told_as_finely_as_distances(scale, origin, said):
    points = np.array(origin) + scale * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    distance = scale * np.arange(4.0)
    report = metrics.error_map(lambda x: distance + scale * np.eye(4)[2], lambda x: distance, points)
    assert f"at ({said}), mean" in str(report)


def test_infinite_answers_are_counted_and_not_averaged():
    inf, nan = np.inf, np.nan
    distance = np.array([1.0, 1.0, 1.0, 1.0, inf, inf, inf])
    answer = np.array([1.5, 1.0, inf, nan, inf, 2.0, nan])
    points = np.zeros((7, 3))
    report = metrics.error_map(lambda x: answer, lambda x: distance, points)
    assert report.num_points == 7
    assert report.num_unreachable == 3
    assert report.num_unanswered == 2
    assert report.num_invented == 1
    assert report.max == 0.5
    assert report.mean == 0.25
    assert "over 4 points; 2 of them not answered" in str(report)


@given(st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6)), min_size=1, max_size=50))
def test_report_agrees_with_numpy_on_the_raw_errors(pairs):
    answer, distance = np.array(pairs).T
    report = metrics.error_map(lambda x: answer, lambda x: distance, np.zeros((len(answer), 2)))
    error = np.abs(answer - distance)
    assert report.max == error.max()
    assert report.mean == pytest.approx(error.mean())
    assert list(report.quantiles) == sorted(report.quantiles)
    values = list(report.quantiles.values())
    assert values == sorted(values)
    assert values[-1] <= report.max


def test_both_functions_are_asked_the_points_given_once():
    asked = []

    def recorded(x):
        asked.append(x)
        return from_origin(x)

    report = metrics.error_map(recorded, recorded, [[0, 1], [3, 4]])
    np.testing.assert_array_equal(asked, [[[0, 1], [3, 4]]] * 2)
    assert (report.max, report.max_distance, report.num_points) == (0.0, 5.0, 2)


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


def test_functions_that_compute_in_place_do_no_harm():
    def in_place(x):
        x -= 1
        return x[:, 0]

    x = np.array([[1.0, 1], [2, 2]])
    assert metrics.error_map(lambda x: x[:, 0] - 1, in_place, x).max == 0
    np.testing.assert_array_equal(x, [[1, 1], [2, 2]])


def test_a_report_is_json():
    report = metrics.error_map(lambda x: x[:, 0], from_origin, GRID)
    assert json.loads(json.dumps(dataclasses.asdict(report)))["num_points"] == 32


@pytest.mark.parametrize(
    ("approximation", "distance", "x", "message"),
    [
        (from_origin, from_origin, np.empty((0, 2)), "needs points.*got none"),
        (from_origin, from_origin, np.zeros(2), r"shape \(n, dim\), got \(2,\)"),
        (from_origin, from_origin, WALLED, r"x must be numbers of shape \(n, dim\), got Workspace"),
        (lambda x: np.zeros((len(x), 1)), from_origin, GRID, "approximation must give one number a point"),
        (from_origin, lambda x: np.zeros(3), GRID, "distance function must give one number a point"),
        (from_origin, lambda x: np.full(len(x), np.nan), GRID, "distance function gives NaN at"),
        (from_origin, lambda x: np.full(len(x), -np.inf), GRID, "distance function gives -inf at"),
        (from_origin, lambda x: from_origin(x) * 1j, GRID, "distance function's answer must be real numbers"),
        (from_origin, lambda x: np.full(len(x), np.inf), GRID, "No error is defined"),
        (lambda x: np.full(len(x), np.inf), from_origin, GRID, "No error is defined"),
    ],
)
def test_what_has_no_error_is_refused(approximation, distance, x, message):
    with pytest.raises(ValueError, match=message):
        metrics.error_map(approximation, distance, x)


def test_error_grid_has_the_error_of_every_cell_center():
    def approximation(x):
        return np.where(x[:, 1] > 0.75, np.inf, from_origin(x) + x[:, 0])

    grid = metrics.error_grid(approximation, left_of_wall, WALLED, resolution=8)
    # 8 x 4 cells of side 0.25; columns 4, 5 are the wall, 6, 7 cannot be reached; the top row is unanswered.
    expected = np.tile([0.125, 0.375, 0.625, 0.875, np.nan, np.nan, np.nan, np.nan], (4, 1))
    expected[3, :4] = np.inf
    np.testing.assert_allclose(grid, expected, atol=1e-12)
