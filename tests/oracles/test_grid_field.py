import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from plr_jax import Box, GridField

WIDE = Box((0, 0), (3, 2))
ROWS = np.array([[0.0, 1, 2], [10, 11, 12]])
"""Two rows, y = 0.5 and 1.5, of three columns, x = 0.5, 1.5 and 2.5."""


def at(field, *points):
    return field(np.array(points, float)).tolist()


def test_beyond_the_outer_centers_it_is_constant():
    field = GridField(ROWS, ((0, 0), (3, 2)))
    assert at(field, (0, 0), (3, 2), (0, 1.5), (1, 0), (3, 1)) == [0, 12, 10, 0.5, 7]
    assert at(GridField([[7.0]], WIDE), (0, 0), (1, 2), (3, 2)) == [7, 7, 7]


def test_outside_there_is_none():
    field = GridField(ROWS, WIDE)
    outside = [(-1e-9, 1), (3.0000001, 1), (1, -1e-9), (1, 2.0000001), (np.nan, 1), (1, np.nan), (np.inf, 1)]
    assert at(field, *outside) == [np.inf] * 7
    assert field(np.zeros((0, 2))).shape == (0,) and field(np.zeros((1, 2), np.float32)).dtype == np.float64


@pytest.mark.parametrize("blocked", [np.nan, np.inf, "masked"])
def test_cells_without_a_value_are_out_of_reach_and_count_for_none_beside(blocked):
    values = np.ma.masked_less(ROWS, 1) if blocked == "masked" else np.where(ROWS < 1, blocked, ROWS)
    field = GridField(values, WIDE)
    assert at(field, (0.5, 0.5), (0.99, 0.99), (0, 0)) == [np.inf] * 3
    assert at(field, (1.01, 0.5), (0.5, 1.01), (2, 0.5)) == [1, 10, 1.5]
    # In the middle of four cells, three of them with a value; at a face the cell above decides.
    assert at(field, (1, 1)) == [pytest.approx((1 + 10 + 11) / 3)]
    assert at(field, (1.25, 1.25)) == [pytest.approx((3 * 1 + 3 * 10 + 9 * 11) / 15)]
    assert np.isinf(field.values).sum() == 1


@given(st.integers(1, 3), st.integers(0, 10**6))
def test_between_centers_it_is_what_scipy_says(dim, seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(2, 5, dim)
    values, lo, width = rng.random(shape), rng.normal(size=dim), rng.random(dim) + 0.5
    centers = [lo[i] + width[i] * (np.arange(shape[i]) + 0.5) / shape[i] for i in range(dim)]
    x = np.array([rng.uniform(along[0], along[-1], 20) for along in centers]).T
    expected = RegularGridInterpolator(centers, values)(x)
    np.testing.assert_allclose(GridField(values.T, (lo, lo + width))(x), expected, atol=1e-12)


def test_a_field_of_scikit_fmm_around_an_obstacle():
    skfmm = pytest.importorskip("skfmm")
    x, y = np.moveaxis(Box((0, 0), (3, 2)).grid(300), -1, 0)
    phi = np.ma.masked_array(np.hypot(x - 0.5, y - 0.5) - 0.05, (x > 1) & (x < 1.2) & (y < 1.5))
    field = GridField(np.maximum(skfmm.distance(phi, dx=0.01), 0), WIDE)
    around = np.hypot(0.5, 1.0) + 0.2 + np.hypot(0.8, 1.0)  # (0.5, 0.5), (1, 1.5), (1.2, 1.5), (2, 0.5)
    assert field([(2.0, 0.5)])[0] == pytest.approx(around - 0.05, rel=0.01)
    assert at(field, (1.1, 0.5)) == [np.inf]


def test_along_a_periodic_axis_the_last_cells_are_neighbors_of_the_first():
    field = GridField([[0.0], [1], [2], [3]], Box((0, 0), (1, 4), periodic=(False, True)))
    at_y = [(0.5, y) for y in (0, 4, 0.25, 3.75, -1.5, 8.5)]
    assert at(field, *at_y) == [1.5, 1.5, 0.75, 2.25, 2, 0]
    assert at(field, (1.5, 0.5), (0.5, np.inf)) == [np.inf, np.inf]


def test_values_are_kept_as_they_were_but_for_masked_ones_which_may_be_anything():
    values = ROWS.astype(int)
    field = GridField(values, WIDE)
    values += 5
    assert at(field, (0.5, 0.5)) == [0]
    with pytest.raises(ValueError, match="read-only"):
        field.values[0, 0] = 1
    assert at(GridField(np.ma.masked_less(ROWS - 1, 0), WIDE), (1.5, 0.5), (0.5, 0.5)) == [0, np.inf]
    with pytest.raises(ValueError, match=r"x must have shape \(n, 2\)"):
        field(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("values", "bounds", "message"),
    [
        (ROWS - 1, WIDE, r"at least 0, got -1 at \(0, 0\); mask"),
        (np.where(ROWS > 1, ROWS, -np.inf), WIDE, "at least 0, got -inf"),
        (ROWS[0], WIDE, r"grid of 2 axes.*got shape \(3,\)"),
        (np.zeros((0, 3)), WIDE, "at least one, got shape"),
        (ROWS * 1j, WIDE, "values must be distances on a grid of 2 axes"),
        (ROWS, ((0, 0), (0, 1)), "positive width"),
        (ROWS, 5, "The bounds must be a Box or its corners"),
    ],
)
def test_bad_input_is_refused(values, bounds, message):
    with pytest.raises(ValueError, match=message):
        GridField(values, bounds)
