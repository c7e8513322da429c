"""Certificates in files, and classes of leaves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.bound_classes import classify_bounds, read_classes, write_classes
from plr_jax.plr.certificate import Certificate, Proof, StraightBound, read_proof, write_proof
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.tree import Cells

# Certificates in files.


PROOFS = st.sampled_from([Proof.CLASSES, Proof.LEAVES, Proof.OPEN_LEAVES])


def cells_of(number):
    return Cells.root(2)[np.zeros(number, np.int64)]


def written(certificate, straight=None):
    body = BitWriter()
    write_proof(body, certificate, straight)
    return body


@given(st.integers(0, 1000), st.floats(-12, 6), PROOFS)
def test_stored_bounds_are_rounded_outward_and_read_as_written(seed, scale, proof):
    """The largest error is a float above all bounds. Open leaves have no upper bound."""
    rng = np.random.default_rng(seed)
    below, above = -(10.0 ** (scale - 8 * rng.random(50))), 10.0 ** (scale - 8 * rng.random(50))
    below[:5], above[3:9] = 0.0, 0.0
    rounding = 10.0 ** (scale - 7) * rng.random(50)
    is_open = (rng.random(50) < 0.3) & (proof is Proof.OPEN_LEAVES)
    certificate = Certificate.of(below, np.where(is_open, np.inf, above), rounding, proof)
    lower, upper = certificate.bounds()
    least, most = below - rounding, above + rounding
    largest = max(-least.min(), most[~is_open].max())
    if proof is Proof.CLASSES:
        np.testing.assert_array_equal([lower, upper], [[-certificate.max_error], [certificate.max_error]])
    else:
        assert (np.isinf(upper) == is_open).all()
        assert (lower <= least).all() and (lower >= 1.0601 * least - 6e-7 * largest).all()
        assert (upper >= most).all() and (upper <= 1.0601 * most + 6e-7 * largest)[~is_open].all()
    np.testing.assert_array_equal(np.float32([lower, upper]), [lower, upper])
    found, spare = (certificate.scale, 1.07) if proof is Proof.OPEN_LEAVES else (certificate.max_error, 1 + 1e-6)
    assert largest <= found <= largest * spare and np.float32(found) == found
    assert certificate.max_error == (np.inf if is_open.any() else found)
    body = written(certificate)
    assert body.num_bits == proof.num_bits(50, 0)
    again, _ = read_proof(BitReader(body.to_bytes()), proof, cells_of(50))
    assert again is not None and again.proof is proof is certificate.proof
    assert again.max_error == certificate.max_error
    np.testing.assert_array_equal(again.bounds(), certificate.bounds())


def test_straight_lower_bounds_are_read_as_written_and_checked():
    goals, groups = np.array([[0.5, 0.25], [1.0, 0.0]]), np.eye(2)
    straight = StraightBound(goals, groups, np.array([1.0, 0.5]), 2.0**-20, False)
    certificate = Certificate(1.0, np.zeros((2, 3), np.uint8), Proof.OPEN_LEAVES)
    for proven, proof in ((certificate, Proof.OPEN_LEAVES), (None, Proof.CLASSES)):
        body = written(proven, straight)
        again, bound = read_proof(BitReader(body.to_bytes()), proof, cells_of(3))
        assert again is None if proven is None else again.scale == 1.0
        for mine, theirs in zip(bound.arrays, straight.arrays, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    for change, message in (
        *(({"margin": wrong}, "to the goal with numbers that are none") for wrong in (np.nan, np.inf, -1.0)),
        ({"goals": np.zeros((65, 2))}, "to a wrong number of goals"),
        ({"groups": 3 * np.eye(4)[:, ::2]}, "to a wrong number of goals, or with wrong groups of axes"),
    ):
        body = written(certificate, replace(straight, **change))
        with pytest.raises(ValueError, match=message):
            read_proof(BitReader(body.to_bytes()), Proof.OPEN_LEAVES, cells_of(3))


@pytest.mark.parametrize(("upper", "proof"), [(0.0, Proof.LEAVES), (np.inf, Proof.OPEN_LEAVES)])
def test_bounds_of_zero_and_infinity_can_be_stored(upper, proof):
    certificate = Certificate.of(np.zeros(3), np.full(3, upper), np.zeros(3), proof)
    lower, stored = certificate.bounds()
    assert (lower <= 0).all() and (lower > -1e-37).all() and (stored >= upper).all()
    assert certificate.max_error > 0 and (certificate.max_error < 1e-37) == (upper == 0)


@pytest.mark.parametrize(
    ("proof", "value"),
    [(Proof.LEAVES, -1.0), *((Proof.CLASSES, value) for value in (0.0, -0.0, np.nan, -np.inf, 3.4e38))],
)
def test_invalid_max_error_in_file_raises(proof, value):
    with pytest.raises(ValueError, match="states a largest error of"):
        read_proof(BitReader(BitWriter().write_floats(np.array([value])).to_bytes()), proof, cells_of(0))


def test_certificates_cut_short_raise():
    body = BitWriter().write_floats(np.array([0.5])).write(np.arange(5), 8)
    with pytest.raises(ValueError, match="end too early"):
        read_proof(BitReader(body.to_bytes()), Proof.LEAVES, cells_of(3))


# Classes of leaves.


FACTOR = 2.0 ** ((np.arange(256) - 255) / 12)


def written_classes(codes):
    body = BitWriter()
    write_classes(body, codes)
    return body


@given(st.integers(0, 10_000), st.integers(1, 400), st.integers(0, 3000))
def test_classes_contain_their_codes_and_fit_their_room(seed, num_leaves, room):
    """Most codes are small, some large."""
    rng = np.random.default_rng(seed)
    codes = rng.geometric(0.03, (2, num_leaves)) + 150 * (rng.random((2, num_leaves)) < 0.02)
    codes = np.clip(codes, 0, 255)
    found = classify_bounds(codes, rng.random(num_leaves), room)
    assert (found >= codes).all()
    np.testing.assert_array_equal(found.max(axis=1), codes.max(axis=1))
    assert written_classes(found).num_bits <= room or (found == found[:, :1]).all()
    assert np.unique(found, axis=1).shape[1] <= 16
    count = 1 + seed % 16
    for some in (found, rng.integers(256, size=(2, count))[:, rng.integers(count, size=num_leaves) ** 2 // count]):
        np.testing.assert_array_equal(read_classes(BitReader(written_classes(some).to_bytes()), num_leaves), some)


@pytest.mark.parametrize("seed", range(3))
def test_two_classes_have_the_least_mean_width(seed):
    """Among all cuts of the range of codes, with room for two classes."""
    rng = np.random.default_rng(seed)
    codes, volume = np.where(rng.random(200) < 0.03, 255, rng.integers(20, 40, (2, 200))), rng.random(200)
    found = classify_bounds(codes, volume, 130)
    assert np.unique(found, axis=1).shape[1] == 2
    key = codes.max(axis=0)
    for _, cut in pairwise(np.unique(key)):
        upper = key >= cut
        classes = np.where(upper, codes[:, upper].max(axis=1)[:, None], codes[:, ~upper].max(axis=1)[:, None])
        widths = [volume @ FACTOR[each].sum(axis=0) for each in (found, classes)]
        assert written_classes(classes).num_bits > 130 or widths[0] <= widths[1]


@pytest.mark.parametrize("seed", range(4))
def test_classes_stay_where_they_hold_after_some_leaves_change(seed):
    """With seed 0, a changed leaf exceeds the largest error before, so classes must change."""
    rng = np.random.default_rng(seed)
    error, rounding = rng.uniform(1e-4, 2e-4, 5_000), np.full(5_000, 1e-9)
    error[:20] = rng.uniform(0.05, 0.1, 20)
    error[0] = 0.1
    before = Certificate.of(-error, error, rounding, Proof.CLASSES, 1.0, 8_000)
    new = rng.permutation(5_000)[:300]
    error[new] = rng.uniform(1e-5, 2e-4, 300)
    error[:2] = 0.1, 0.01 if seed % 4 else 0.2
    after = Certificate.of(-error, error, rounding, Proof.CLASSES, 1.0, 8_000, before)
    lower, upper = after.bounds()
    assert (lower <= -error - rounding).all() and (upper >= error + rounding).all()
    classes = {tuple(each) for each in before.bounds().T.tolist()}
    stay = {tuple(each) for each in after.bounds().T.tolist()} <= classes
    assert stay == (after.scale == before.scale) == (error.max() <= 0.1)
    if stay:
        low, high = before.sufficient_bounds(-error, error, rounding)
        spare = 1.01e-3 * before.scale
        assert ((low >= lower + rounding) | (low >= -error - spare)).all() and (low <= -error).all()
        assert ((high <= upper - rounding) | (high <= error + spare)).all() and (high >= error).all()
        assert np.mean(high > error + spare) > 0.001  # of leaves that need no better bound than their class has


def test_invalid_classes_raise():
    data = written_classes(np.array([[0, 9, 9, 9], [3, 5, 5, 5]])).to_bytes()
    for cut, num_leaves, message in ((data, 0, "names"), (data[:-1], 4, "end too early")):
        with pytest.raises(ValueError, match=message):
            read_classes(BitReader(cut), num_leaves)
