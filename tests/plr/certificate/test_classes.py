"""Classes of leaves, against all partitions of few leaves, and as a file keeps them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.certificate import (
    Certificate,
    LeafBounds,
    Proof,
    in_classes,
    read_certificate,
    read_classes,
    write_classes,
)
from plr_jax.plr.coding import BitReader, BitWriter

FACTOR = 2.0 ** ((np.arange(256) - 255) / 12)


def written(codes):
    body = BitWriter()
    write_classes(body, codes)
    return body


@given(st.integers(0, 10_000), st.integers(1, 400), st.integers(0, 3000))
def test_no_leaf_is_in_a_class_of_lower_codes_all_keep_their_room_and_are_read_as_written(seed, num_leaves, room):
    """Most codes are small, some large."""
    rng = np.random.default_rng(seed)
    codes = rng.geometric(0.03, (2, num_leaves)) + 150 * (rng.random((2, num_leaves)) < 0.02)
    codes = np.clip(codes, 0, 255)
    found = in_classes(codes, FACTOR, rng.random(num_leaves), room)
    assert (found >= codes).all()
    np.testing.assert_array_equal(found.max(axis=1), codes.max(axis=1))
    assert written(found).num_bits <= room or (found == found[:, :1]).all()
    assert np.unique(found, axis=1).shape[1] <= 16
    count = 1 + seed % 16
    for some in (found, rng.integers(256, size=(2, count))[:, rng.integers(count, size=num_leaves) ** 2 // count]):
        np.testing.assert_array_equal(read_classes(BitReader(written(some).to_bytes()), num_leaves), some)


@pytest.mark.parametrize("seed", range(5))
def test_two_classes_are_the_best_two(seed):
    """With room for two of few leaves, no other cut of the range of codes has a smaller mean width."""
    rng = np.random.default_rng(seed)
    codes, volume = np.where(rng.random(200) < 0.03, 255, rng.integers(20, 40, (2, 200))), rng.random(200)
    found = in_classes(codes, FACTOR, volume, 130)
    assert np.unique(found, axis=1).shape[1] == 2
    key = codes.max(axis=0)
    for _, cut in pairwise(np.unique(key)):
        upper = key >= cut
        classes = np.where(upper, codes[:, upper].max(axis=1)[:, None], codes[:, ~upper].max(axis=1)[:, None])
        widths = [volume @ FACTOR[each].sum(axis=0) for each in (found, classes)]
        assert written(classes).num_bits > 130 or widths[0] <= widths[1]


@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_classes_hold_and_are_far_narrower_where_few_leaves_are_bad(seed):
    rng = np.random.default_rng(seed)
    lower, upper = -(10.0 ** (-8 + 3 * rng.random(5000))), 10.0 ** (-8 + 3 * rng.random(5000))
    lower[rng.integers(5000, size=20)] = -1.0
    rounding, num_bytes = np.full(5000, 1e-9), 8000
    certificate = Certificate.of(LeafBounds(lower, upper), rounding, Proof.CLASSES, rng.random(5000), num_bytes)
    below, above = certificate.bounds()
    assert (below <= lower - rounding).all() and (above >= upper + rounding).all()
    assert (above - below).mean() < 0.01 * 2 * certificate.max_error
    body = BitWriter()
    certificate.write(body)
    assert 32 < body.num_bits <= Proof.CLASSES.num_bits(5000, num_bytes) < 0.01 * Proof.LEAVES.num_bits(5000, 0)
    found = read_certificate(BitReader(body.to_bytes()), Proof.CLASSES, 5000)
    assert found is not None and found.proof is Proof.CLASSES and found.max_error == certificate.max_error
    np.testing.assert_array_equal(found.bounds(), certificate.bounds())


@pytest.mark.parametrize("seed", range(20))
def test_classes_stay_as_far_as_they_hold_and_what_is_enough_is_within_them(seed):
    """Most leaves are as before, some are new; now and then one is worse than all before."""
    rng = np.random.default_rng(seed)
    error, rounding = rng.uniform(1e-4, 2e-4, 5_000), np.full(5_000, 1e-9)
    error[:20] = rng.uniform(0.05, 0.1, 20)
    error[0] = 0.1
    before = Certificate.of(LeafBounds(-error, error), rounding, Proof.CLASSES, 1.0, 8_000)
    new = rng.permutation(5_000)[:300]
    error[new] = rng.uniform(1e-5, 2e-4, 300)
    error[:2] = 0.1, 0.01 if seed % 4 else 0.2
    after = Certificate.of(LeafBounds(-error, error), rounding, Proof.CLASSES, 1.0, 8_000, before)
    lower, upper = after.bounds()
    assert (lower <= -error - rounding).all() and (upper >= error + rounding).all()
    classes = {tuple(each) for each in before.bounds().T.tolist()}
    stay = {tuple(each) for each in after.bounds().T.tolist()} <= classes
    assert stay == (after.scale == before.scale) == (error.max() <= 0.1)
    if stay:
        low, high = before.enough(-error, error, rounding)
        spare = 1.01e-3 * before.scale
        assert ((low >= lower + rounding) | (low >= -error - spare)).all() and (low <= -error).all()
        assert ((high <= upper - rounding) | (high <= error + spare)).all() and (high >= error).all()
        assert np.mean(high > error + spare) > 0.001  # of leaves that need no better bound than their class has


def test_leaves_that_do_not_exist_and_data_that_end_are_refused():
    data = written(np.array([[0, 9, 9, 9], [3, 5, 5, 5]])).to_bytes()
    for cut, num_leaves, message in ((data, 0, "names"), (data[:-1], 4, "end too early")):
        with pytest.raises(ValueError, match=message):
            read_classes(BitReader(cut), num_leaves)
