import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.leaves.plane.codec import FLOAT_BITS, StoredPlanes, encode_planes


@given(seed=st.integers(0, 1000), bits=st.integers(4, 20), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_rounding_is_within_half_a_step(seed, bits, scale):
    rng = np.random.default_rng(seed)
    center = scale * rng.uniform(-1, 5, size=30)
    half = scale * rng.normal(size=(30, 3))
    center[rng.random(30) < 0.2] = np.inf
    center[0] = scale
    planes = encode_planes(center, half, bits)
    again_center, again_half = planes.decode()
    blocked = np.isinf(center)
    np.testing.assert_array_equal(planes.unreachable, blocked)
    assert np.isinf(again_center[blocked]).all()
    # The step spans the center values (or the half-differences, where those are far larger), but for its rounding.
    spread = max(np.ptp(center[~blocked]), np.abs(half[~blocked]).max() / 256)
    assert planes.step <= spread / (2**bits - 2) * (1 + 1e-5) + abs(scale) * 1e-5
    half_a_step = planes.step * (0.5 + 1e-9)
    assert np.abs(again_center[~blocked] - center[~blocked]).max() <= half_a_step
    assert np.abs(again_half[~blocked] - half[~blocked]).max() <= half_a_step


def test_floats_are_kept_to_32_bits():
    center, half = np.array([0.1, np.inf, -3.0]), np.array([[0.3], [np.nan], [7.0]])
    again_center, again_half = encode_planes(center, half, FLOAT_BITS).decode()
    np.testing.assert_array_equal(again_center, center.astype(np.float32))
    np.testing.assert_array_equal(again_half, np.array([[0.3], [0.0], [7.0]], np.float32))


@pytest.mark.parametrize("bits", [4, 8, 16])
def test_a_constant_is_kept_to_32_bits(bits):
    planes = encode_planes(np.full(3, 2.5), np.zeros((3, 2)), bits)
    np.testing.assert_allclose(planes.decode()[0], 2.5, rtol=1e-6)
    assert not planes.unreachable.any()


@pytest.mark.parametrize(("bits", "expected"), [(10, [[4, 0, 0, 9], [2, 0]]), (FLOAT_BITS, [[32] * 4, [32] * 2])])
def test_widths_hold_the_largest_half_difference_of_their_depth(bits, expected):
    half = np.array([[3, 0], [-4, 0], [0, 0], [200, -1]])
    depth = np.array([[0, 1], [0, 1], [2, 1], [3, 0]])
    planes = StoredPlanes(bits, 0.0, 1.0, np.zeros(4, np.int64), half)
    assert [widths.tolist() for widths in planes.widths(depth)] == expected
