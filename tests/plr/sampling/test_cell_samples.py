import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_samples import fit_cells, least_squares, midrange, sum_of_squares_after_split
from plr_jax.plr.sampling.pattern import Pattern, sample_pattern


def lstsq_twin(u, value, weight):
    """One cell at a time, by numpy.linalg.lstsq on rows scaled by the square root of their weight."""
    root = np.sqrt(weight)
    design = np.concatenate([np.ones((len(u), 1)), u], axis=1) * root[:, None]
    return np.linalg.lstsq(design, value * root, rcond=None)[0]


@given(seed=st.integers(0, 1000), dim=st.integers(1, 5))
def test_batched_fit_equals_lstsq_cell_by_cell(seed, dim):
    rng = np.random.default_rng(seed)
    pattern = sample_pattern(dim, 40, 0.0, seed)
    value = rng.normal(size=(6, 40))
    weight = np.ones((6, 40))
    weight[2:] = rng.random((4, 40)) < 0.6
    weight[4:] *= rng.uniform(0.1, 3, size=(2, 40))
    center, half = least_squares(pattern, value, weight)
    for cell in range(6):
        expected = lstsq_twin(pattern.u, value[cell], weight[cell] * pattern.weight)
        np.testing.assert_allclose(np.r_[center[cell], half[cell]], expected, rtol=1e-6, atol=1e-7)


def test_undetermined_directions_get_slope_zero():
    pattern = Pattern(np.array([[0.0, 0.0], [0.5, 0.25], [-0.5, 0.25], [0.3, -0.9]]), np.ones(4))
    value = np.array([[7.0, 0, 0, 0], [0, 3.0, 1.0, 0], [5.0, 5.0, 5.0, 5.0]])
    weight = np.array([[1.0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])
    center, half = least_squares(pattern, value, weight)
    np.testing.assert_allclose(center, [7, 2, 0], atol=1e-6)
    np.testing.assert_allclose(half, [[0, 0], [2, 0], [0, 0]], atol=1e-6)


def test_least_squares_leaves_the_range_of_its_samples():
    """The false step of the paper's Theorem 2: V = 0, 0, 1 at 0, 1, 2 gives the line -1/6 at 0."""
    pattern = Pattern(np.array([[-1.0], [0], [1]]), np.ones(3))
    center, half = least_squares(pattern, np.array([[0.0, 0, 1]]), np.ones((1, 3)))
    assert center[0] - half[0, 0] == pytest.approx(-1 / 6)


@given(seed=st.integers(0, 1000), dim=st.integers(1, 4), share=st.sampled_from([0.0, 0.3, 1.0]))
def test_midrange_errs_as_far_above_as_below(seed, dim, share):
    rng = np.random.default_rng(seed)
    pattern = sample_pattern(dim, 40, 0.0, seed)
    weight = 1.0 * (rng.random((3, 40)) >= share)
    value = rng.normal(size=(3, 40)) * (weight > 0)
    center, half = midrange(pattern, value, weight)
    _, slope = least_squares(pattern, value, weight)
    np.testing.assert_array_equal(half, slope)
    error = value - (center[:, None] + half @ pattern.u.T)
    for row, counts in zip(error, weight > 0, strict=True):
        if counts.any():
            assert row[counts].max() == pytest.approx(-row[counts].min(), abs=1e-9)
    assert np.isfinite(center).all()


def test_fit_marks_blocked_cells_and_keeps_residuals():
    cells = Cells.root(1).split(np.array([0]))
    pattern = sample_pattern(1, 16, 0.0, 0)
    fit = fit_cells(cells, Box([0.0], [2.0]), lambda x: np.where(x[:, 0] < 1, 3 + 2 * x[:, 0], np.inf), None, pattern)
    assert np.isfinite(fit.center[0]) and np.isinf(fit.center[1])
    np.testing.assert_allclose([fit.center[0], fit.half[0, 0]], [4.0, 1.0], atol=1e-7)
    assert np.abs(fit.residual).max() < 1e-7
    assert not fit.reachable[1].any()


def test_weights_pull_the_plane_and_zero_weights_do_not_void_it():
    bend = lambda x: np.abs(x[:, 0] - 1.0)  # noqa: E731
    pattern = sample_pattern(1, 64, 0.0, 0)
    root, domain = Cells.root(1), Box([0.0], [2.0])
    left = fit_cells(root, domain, bend, lambda x: 1.0 * (x[:, 0] < 1), pattern)
    np.testing.assert_allclose(left.half[0, 0], -1.0, atol=1e-6)
    unweighted = fit_cells(root, domain, bend, None, pattern)
    nowhere = fit_cells(root, domain, bend, lambda x: np.zeros(len(x)), pattern)
    np.testing.assert_allclose(nowhere.center, unweighted.center, atol=1e-8)


def test_sum_of_squares_after_split_equals_two_separate_fits():
    rng = np.random.default_rng(3)
    pattern = sample_pattern(2, 50, 0.0, 0)
    blocked = rng.random((2, 50)) < [[0.0], [0.4]]
    table = np.where(blocked, np.inf, rng.random((2, 50)))
    halves = Cells.root(2).split(np.array([0]))
    fit = fit_cells(halves, Box((0, 0), (1, 1)), lambda x: table.ravel(), None, pattern)
    for cell in range(2):
        for axis in range(2):
            expected = 0.0
            for side in (pattern.u[:, axis] <= 0, pattern.u[:, axis] > 0):
                keep = side & ~blocked[cell]
                plane = lstsq_twin(pattern.u[keep], table[cell, keep], pattern.weight[keep])
                rest = table[cell, keep] - plane[0] - pattern.u[keep] @ plane[1:]
                expected += np.sum(pattern.weight[keep] * rest**2)
            assert sum_of_squares_after_split(fit)[cell, axis] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("oracle", "message"),
    [
        (lambda x: x, "one distance a point"),
        (lambda x: np.ones(len(x) - 1), "one distance a point"),
        (lambda x: np.full(len(x), np.nan), "got nan at"),
        (lambda x: np.full(len(x), -np.inf), "got -inf at"),
    ],
)
def test_bad_oracles_are_refused(oracle, message):
    with pytest.raises(ValueError, match=message):
        fit_cells(Cells.root(2), Box((0, 0), (1, 1)), oracle, None, sample_pattern(2, 8, 0.0, 0))


@pytest.mark.parametrize("weights", [lambda x: -np.ones(len(x)), lambda x: x, lambda x: np.full(len(x), np.nan)])
def test_bad_weights_are_refused(weights):
    with pytest.raises(ValueError, match="one finite weight >= 0 a point"):
        fit_cells(
            Cells.root(2), Box((0, 0), (1, 1)), lambda x: np.ones(len(x)), weights, sample_pattern(2, 8, 0.0, 0)
        )
