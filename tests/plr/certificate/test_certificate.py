import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.certificate.certificate import Certificate, Proof, read_certificate
from plr_jax.plr.file.bits import BitReader, BitWriter

SIZES = st.floats(-12, 6)


def random_bounds(seed, scale):
    rng = np.random.default_rng(seed)
    lower, upper = -(10.0 ** (scale - 8 * rng.random(50))), 10.0 ** (scale - 8 * rng.random(50))
    lower[:5], upper[3:9] = 0.0, 0.0
    return LeafBounds(lower, upper), 10.0 ** (scale - 7) * rng.random(50)


@given(st.integers(0, 1000), SIZES)
def test_codes_are_rounded_outward_by_little(seed, scale):
    bounds, rounding = random_bounds(seed, scale)
    certificate = Certificate.of(bounds, rounding, Proof.LEAVES)
    lower, upper = certificate.bounds()
    largest = max(-bounds.lower.min(), bounds.upper.max()) + rounding.max()
    assert (lower <= bounds.lower - rounding).all() and (upper >= bounds.upper + rounding).all()
    assert (lower >= 1.0601 * (bounds.lower - rounding) - 5e-7 * largest).all()
    assert (upper <= 1.0601 * (bounds.upper + rounding) + 5e-7 * largest).all()
    np.testing.assert_array_equal(np.float32([lower, upper]), [lower, upper])


@given(st.integers(0, 1000), SIZES)
def test_the_largest_error_is_a_float_above_all_bounds(seed, scale):
    bounds, rounding = random_bounds(seed, scale)
    for proof in (Proof.CLASSES, Proof.LEAVES):
        found = Certificate.of(bounds, rounding, proof).max_error
        least = max((rounding - bounds.lower).max(), (rounding + bounds.upper).max())
        assert least <= found <= least * (1 + 1e-6)
        assert np.float32(found) == found
    np.testing.assert_array_equal(Certificate.of(bounds, rounding, Proof.CLASSES).bounds(), [[-found], [found]])


def test_nothing_above_zero_is_a_proof_too():
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.zeros(3)), np.zeros(3), Proof.LEAVES)
    assert 0 < certificate.max_error < 1e-37
    assert (certificate.bounds()[1] >= 0).all()


@given(st.integers(0, 1000), st.sampled_from([Proof.CLASSES, Proof.LEAVES]))
def test_what_is_written_is_read(seed, proof):
    certificate = Certificate.of(*random_bounds(seed, -2), proof)
    body = BitWriter()
    certificate.write(body)
    assert body.num_bits == proof.num_bits(50, 0)
    found = read_certificate(BitReader(body.to_bytes()), proof, 50)
    assert found is not None and found.proof == proof == certificate.proof
    assert found.max_error == certificate.max_error
    np.testing.assert_array_equal(found.bounds(), certificate.bounds())


def test_no_proof_takes_no_bits():
    assert Proof.NONE.num_bits(1000, 1000) == 0
    assert read_certificate(BitReader(b""), Proof.NONE, 1000) is None


@pytest.mark.parametrize("value", [0.0, -0.0, np.nan, np.inf, -np.inf, 3.4e38])
def test_a_largest_error_that_makes_no_sense_is_refused(value):
    body = BitWriter().write_floats(np.array([value]))
    with pytest.raises(ValueError, match="states a largest error of"):
        read_certificate(BitReader(body.to_bytes()), Proof.CLASSES, 3)


def test_a_proof_that_is_cut_short_is_refused():
    body = BitWriter().write_floats(np.array([0.5])).write(np.arange(5), 8)
    with pytest.raises(ValueError, match="end too early"):
        read_certificate(BitReader(body.to_bytes()), Proof.LEAVES, 3)


@given(st.integers(0, 1000), SIZES)
def test_open_leaves_have_no_upper_bound_and_others_theirs(seed, scale):
    bounds, rounding = random_bounds(seed, scale)
    is_open = np.random.default_rng(seed).random(50) < 0.3
    opened = LeafBounds(bounds.lower, np.where(is_open, np.inf, bounds.upper))
    certificate = Certificate.of(opened, rounding, Proof.OPEN_LEAVES)
    lower, upper = certificate.bounds()
    assert (np.isinf(upper) == is_open).all() and np.isfinite(lower).all()
    largest = max((rounding - bounds.lower).max(), (rounding + bounds.upper)[~is_open].max())
    assert (lower <= bounds.lower - rounding).all() and (upper >= opened.upper + rounding).all()
    assert (lower >= 1.0601 * (bounds.lower - rounding) - 6e-7 * largest).all()
    known = upper[~is_open]
    assert (known <= 1.0601 * (bounds.upper + rounding)[~is_open] + 6e-7 * largest).all()
    assert largest <= certificate.scale <= 1.07 * largest
    assert certificate.max_error == (np.inf if is_open.any() else certificate.scale)
    body = BitWriter()
    certificate.write(body)
    assert body.num_bits == Proof.OPEN_LEAVES.num_bits(50, 0) == Proof.LEAVES.num_bits(50, 0)
    found = read_certificate(BitReader(body.to_bytes()), Proof.OPEN_LEAVES, 50)
    assert found is not None and found.proof is Proof.OPEN_LEAVES and found.max_error == certificate.max_error
    np.testing.assert_array_equal(found.bounds(), certificate.bounds())


def test_leaves_that_are_all_open_are_a_proof_too():
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.full(3, np.inf)), np.zeros(3), Proof.OPEN_LEAVES)
    lower, upper = certificate.bounds()
    assert (upper == np.inf).all() and (lower <= 0).all() and (lower > -1e-37).all()
    assert certificate.max_error == np.inf


def test_the_largest_code_is_a_bound_unless_leaves_may_be_open():
    """Of any codes there are in a file."""
    codes = np.array([0, 254, 255])
    body = BitWriter().write_floats(np.array([2.0])).write(codes, 8).write(codes, 8)
    expected = np.array([2.0 * 2 ** (-255 / 12), 2.0 * 2 ** (-1 / 12), 2.0])
    for proof in (Proof.LEAVES, Proof.OPEN_LEAVES):
        certificate = read_certificate(BitReader(body.to_bytes()), proof, 3)
        assert certificate is not None
        lower, upper = certificate.bounds()
        np.testing.assert_allclose(-lower, expected, rtol=1e-6)
        is_open = proof is Proof.OPEN_LEAVES
        np.testing.assert_allclose(upper, [*expected[:2], np.inf if is_open else 2.0], rtol=1e-6)
        assert certificate.max_error == (np.inf if is_open else 2.0)
