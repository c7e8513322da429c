import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition

from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.leaves.plane import (
    FLOAT_BITS,
    StoredPlanes,
    encode_planes,
    planes_bits,
    read_planes,
    unreachable_code,
    write_planes,
)


@settings(max_examples=40, deadline=None)
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


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 5), bits=st.sampled_from([4, 11, 16, 20, 32]))
def test_what_is_read_is_what_was_written(seed, dim, bits):
    rng = np.random.default_rng(seed)
    depth = random_partition(seed, dim, 30).depth
    center = np.where(rng.random(len(depth)) < 0.2, np.inf, rng.normal(size=len(depth)))
    center[0] = 1.0
    planes = encode_planes(center, rng.normal(size=depth.shape), bits)
    body = BitWriter()
    write_planes(body, depth, planes)
    assert body.num_bits == planes_bits(depth, planes)
    again = read_planes(BitReader(body.to_bytes()), depth)
    np.testing.assert_array_equal(again.center, planes.center)
    np.testing.assert_array_equal(again.half, planes.half)
    assert (again.bits, again.offset, again.step) == (planes.bits, planes.offset, planes.step)


def test_the_mark_of_unreachable_leaves():
    assert unreachable_code(8) == 255
    assert np.array([unreachable_code(32)], np.uint32).view(np.float32)[0] == np.inf


def test_planes_beyond_floats_are_refused():
    with pytest.raises(ValueError, match="scale them down"):
        encode_planes(np.array([1e31]), np.zeros((1, 2)), 16)
    with pytest.raises(ValueError, match="scale them down"):
        encode_planes(np.array([1.0]), np.full((1, 2), -1e31), FLOAT_BITS)
