import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.certificate import Certificate, LeafBounds, Proof, read_certificate
from plr_jax.plr.coding import BitReader, BitWriter

PROOFS = st.sampled_from([Proof.CLASSES, Proof.LEAVES, Proof.OPEN_LEAVES])


def written(certificate):
    body = BitWriter()
    certificate.write(body)
    return body


@given(st.integers(0, 1000), st.floats(-12, 6), PROOFS)
def test_codes_are_rounded_outward_by_little_and_read_as_they_were_written(seed, scale, proof):
    """The largest error is a float above all bounds. Open leaves have no upper bound, the others theirs."""
    rng = np.random.default_rng(seed)
    below, above = -(10.0 ** (scale - 8 * rng.random(50))), 10.0 ** (scale - 8 * rng.random(50))
    below[:5], above[3:9] = 0.0, 0.0
    rounding = 10.0 ** (scale - 7) * rng.random(50)
    is_open = (rng.random(50) < 0.3) & (proof is Proof.OPEN_LEAVES)
    certificate = Certificate.of(LeafBounds(below, np.where(is_open, np.inf, above)), rounding, proof)
    lower, upper = certificate.bounds()
    largest = max((rounding - below).max(), (rounding + above)[~is_open].max())
    if proof is Proof.CLASSES:
        np.testing.assert_array_equal([lower, upper], [[-certificate.max_error], [certificate.max_error]])
    else:
        assert (np.isinf(upper) == is_open).all()
        assert (lower <= below - rounding).all() and (upper >= above + rounding).all()
        assert (lower >= 1.0601 * (below - rounding) - 6e-7 * largest).all()
        assert (upper <= 1.0601 * (above + rounding) + 6e-7 * largest)[~is_open].all()
    np.testing.assert_array_equal(np.float32([lower, upper]), [lower, upper])
    found = certificate.max_error if proof is not Proof.OPEN_LEAVES else certificate.scale
    assert (
        largest <= found <= largest * (1.07 if proof is Proof.OPEN_LEAVES else 1 + 1e-6)
        and np.float32(found) == found
    )
    assert certificate.max_error == (np.inf if is_open.any() else found)
    body = written(certificate)
    assert body.num_bits == proof.num_bits(50, 0)
    again = read_certificate(BitReader(body.to_bytes()), proof, 50)
    assert again is not None and again.proof is proof is certificate.proof
    assert again.max_error == certificate.max_error
    np.testing.assert_array_equal(again.bounds(), certificate.bounds())


def test_nothing_above_zero_and_leaves_that_are_all_open_are_a_proof_too():
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.zeros(3)), np.zeros(3), Proof.LEAVES)
    assert 0 < certificate.max_error < 1e-37
    assert (certificate.bounds()[1] >= 0).all()
    certificate = Certificate.of(LeafBounds(np.zeros(3), np.full(3, np.inf)), np.zeros(3), Proof.OPEN_LEAVES)
    lower, upper = certificate.bounds()
    assert (upper == np.inf).all() and (lower <= 0).all() and (lower > -1e-37).all()
    assert certificate.max_error == np.inf


def test_no_proof_takes_no_bits():
    assert Proof.NONE.num_bits(1000, 1000) == 0
    assert read_certificate(BitReader(b""), Proof.NONE, 1000) is None


@pytest.mark.parametrize(
    ("proof", "value"),
    [(Proof.LEAVES, -1.0), *((Proof.CLASSES, value) for value in (0.0, -0.0, np.nan, np.inf, -np.inf, 3.4e38))],
)
def test_a_largest_error_that_makes_no_sense_or_is_cut_short_is_refused(proof, value):
    with pytest.raises(ValueError, match="states a largest error of"):
        read_certificate(BitReader(BitWriter().write_floats(np.array([value])).to_bytes()), proof, 0)
    body = BitWriter().write_floats(np.array([0.5])).write(np.arange(5), 8)
    with pytest.raises(ValueError, match="end too early"):
        read_certificate(BitReader(body.to_bytes()), Proof.LEAVES, 3)


@pytest.mark.parametrize(("proof", "last"), [(Proof.LEAVES, 2.0), (Proof.OPEN_LEAVES, np.inf)])
def test_the_largest_code_is_a_bound_unless_leaves_may_be_open(proof, last):
    """Of any codes there are in a file."""
    codes = np.array([0, 254, 255])
    body = BitWriter().write_floats(np.array([2.0])).write(codes, 8).write(codes, 8)
    certificate = read_certificate(BitReader(body.to_bytes()), proof, 3)
    assert certificate is not None and certificate.max_error == last
    lower, upper = certificate.bounds()
    expected = [2.0 * 2 ** (-255 / 12), 2.0 * 2 ** (-1 / 12)]
    np.testing.assert_allclose(-lower, [*expected, 2.0], rtol=1e-6)
    np.testing.assert_allclose(upper, [*expected, last], rtol=1e-6)
