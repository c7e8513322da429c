import numpy as np
import pytest

from plr_jax.plr.sampling.cell_fit import sample_pattern


@pytest.mark.parametrize("dim", [1, 2, 3, 6])
def test_pattern_starts_at_the_center_and_fills_the_cell(dim):
    pattern = sample_pattern(dim, 100, 0.0, 0)
    assert pattern.u.shape == (100, dim) and len(pattern.weight) == 100
    np.testing.assert_array_equal(pattern.u[0], 0)
    assert np.abs(pattern.u).max() <= 1
    # Low discrepancy: each half of each axis holds close to half of the samples.
    assert np.all(np.abs(np.mean(pattern.u > 0, axis=0) - 0.5) <= 0.06)
    np.testing.assert_array_equal(pattern.u, sample_pattern(dim, 100, 0.0, 0).u)
    assert not np.array_equal(pattern.u, sample_pattern(dim, 100, 0.0, 1).u)


def test_every_face_is_sampled_with_little_weight():
    pattern = sample_pattern(3, 90, 0.0, 0)
    on_face = np.abs(pattern.u) == 1
    for axis in range(3):
        for side in (-1, 1):
            assert np.count_nonzero(pattern.u[:, axis] == side) >= 5
    assert pattern.weight[on_face.any(axis=1)].max() < 0.1 * pattern.weight[~on_face.any(axis=1)].min()


def test_margin_reaches_beyond_the_cell():
    assert np.abs(sample_pattern(2, 200, 0.25, 0).u).max() == pytest.approx(1.5)
