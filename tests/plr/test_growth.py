"""Rules of growth: which leaf is split next, and along which axis."""

import numpy as np
import pytest
from plr_helpers import UNIT, lstsq_plane, sampler_of

from plr_jax.plr import best_axis, center_error, largest_error, maximum_depth
from plr_jax.plr.growth import _sum_of_squares_after_split
from plr_jax.plr.sampling import MAX_ASPECT_BITS, Sampler, sample_pattern
from plr_jax.plr.tree import Cells


def fit(distance_fn, cells=None, weight_fn=None, max_axis_depth=14):
    return sampler_of(distance_fn, UNIT, weight_fn, 64, max_axis_depth)(Cells.root(2) if cells is None else cells)


def test_best_axis_splits_largest_bend_below_max_depth():
    assert best_axis(fit(lambda x: np.abs(x[:, 0] - 0.5) + x[:, 1]))[0] == 0
    assert best_axis(fit(lambda x: np.abs(x[:, 1] - 0.5) + x[:, 0]))[0] == 1
    bend = lambda x: np.abs(x[:, 0] - 0.125) + 1e-3 * np.abs(x[:, 1] - 0.3)  # noqa: E731
    cells = Cells(np.array([[2, 0]]), np.array([[0, 0]]))
    assert [best_axis(fit(bend, cells, max_axis_depth=most))[0] for most in (14, 2)] == [0, 1]


def test_best_axis_limits_the_aspect_of_cells():
    cells, aspects = Cells.root(2), set()
    for _ in range(10):
        cells = cells.split(best_axis(fit(lambda x: (x[:, 0] > 1 / 3) * 1.0, cells)))
        aspects.add(int(np.ptp(cells.depth, axis=1).max()))
    assert max(aspects) == MAX_ASPECT_BITS


def test_sum_of_squares_after_split_equals_two_separate_fits():
    rng = np.random.default_rng(3)
    pattern = sample_pattern(2, 50, 0.0, 0)
    blocked = rng.random((2, 50)) < [[0.0], [0.4]]
    table = np.where(blocked, np.inf, rng.random((2, 50)))
    found = Sampler(lambda x: table.ravel(), UNIT, None, pattern, pattern, 14)(Cells.root(2).split(np.array([0])))
    for cell in range(2):
        for axis in range(2):
            expected = 0.0
            for side in (pattern.u[:, axis] <= 0, pattern.u[:, axis] > 0):
                keep = side & ~blocked[cell]
                plane = lstsq_plane(pattern.u[keep], table[cell, keep], pattern.weight[keep])
                rest = table[cell, keep] - plane[0] - pattern.u[keep] @ plane[1:]
                expected += np.sum(pattern.weight[keep] * rest**2)
            assert _sum_of_squares_after_split(found)[cell, axis] == pytest.approx(expected, rel=1e-6)


def test_maximum_depth_splits_all_reachable_cells():
    halves = Cells.root(2).split(np.array([0]))
    priority = maximum_depth(fit(lambda x: np.where(x[:, 0] < 0.5, 1.0, np.inf), halves))
    np.testing.assert_array_equal(priority, [np.inf, 0])


def test_largest_error_and_center_error_of_a_fit():
    found = fit(lambda x: (x[:, 0] > 0.9) * 1.0, weight_fn=lambda x: 2.0 - x[:, 0])
    x = found.cells.points(found.pattern.u, UNIT)[0]
    expected = np.max((2 - x[:, 0]) * np.abs(found.residual[0]))
    np.testing.assert_allclose(largest_error(found), expected)
    assert expected > 0.1
    bump = fit(lambda x: 1.0 * (np.abs(x - 0.5).max(axis=1) < 0.01))
    assert center_error(bump)[0] == np.abs(bump.residual[0, 0]) > 0.5
    corner = fit(lambda x: 1.0 * (x.min(axis=1) > 0.9))
    assert center_error(corner)[0] < largest_error(corner)[0]
    blocked = fit(lambda x: np.where(np.abs(x - 0.5).max(axis=1) < 0.1, np.inf, x[:, 0] > 0.5))
    assert center_error(blocked)[0] == largest_error(blocked)[0] > 0.1
