"""The arithmetic coder: what is encoded is decoded, in about as few bits as there can be, and nothing else hangs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.plr.file.range_coder import RARE, RangeDecoder, RangeEncoder

FLOATS = st.floats(width=32, allow_nan=False)
CALLS = st.one_of(
    st.tuples(st.just("bit"), st.integers(0, 2), st.integers(0, 1)),
    st.tuples(st.just("number"), st.integers(0, 2**60 - 1), st.just(60)),
    st.tuples(st.just("symbol"), st.just("s"), st.integers(0, 4), st.just(5)),
    st.tuples(st.just("count"), st.just("c"), st.integers(0, 2**39)),
    st.tuples(st.just("float32"), FLOATS),
)


def called(coder, call, known):
    """One call of a coder, with its value or without."""
    match call:
        case "bit", context, value:
            return coder.bit(context, value if known else None)
        case "number", value, width:
            return coder.number(value if known else None, width)
        case "symbol", context, value, count:
            return coder.symbol(context, value if known else None, count)
        case "count", context, value:
            return coder.count(context, value if known else None)
        case _, value:
            return coder.float32(value if known else None)


def value_of(call):
    return {"bit": 2, "number": 1, "symbol": 2, "count": 2, "float32": 1}[call[0]]


@settings(max_examples=200)
@given(calls=st.lists(CALLS, max_size=40))
def test_what_is_encoded_is_decoded(calls):
    encoder = RangeEncoder()
    expected = [call[value_of(call)] for call in calls]
    assert [called(encoder, call, True) for call in calls] == expected
    decoder = RangeDecoder(encoder.to_bytes())
    assert [called(decoder, call, False) for call in calls] == expected


@pytest.mark.parametrize("share", [0.5, 0.1, 0.01, 0.0005])
def test_bits_take_what_they_are_surprising(share):
    rng = np.random.default_rng(0)
    bits, encoder = (rng.random(20_000) < share).astype(int).tolist(), RangeEncoder()
    for bit in bits:
        encoder.bit("bit", bit)
    p = np.mean(bits)
    entropy = -len(bits) * (p * np.log2(p) + (1 - p) * np.log2(1 - p))
    data = encoder.to_bytes()
    assert entropy / 8 - 2 < len(data) < 1.02 * entropy / 8 + 8
    decoder = RangeDecoder(data)
    assert [decoder.bit("bit", None) for _ in bits] == bits


def test_carries_run_through_many_bytes():
    """Numbers of ones alone, then a surprise: the low end is carried into bytes of 255."""
    for last in (0, 1):
        encoder = RangeEncoder()
        for _ in range(50):
            encoder.bit("rare", 0, (1 << 20, 1))
            encoder.number(2**40 - 1, 40)
        encoder.bit("last", last)
        decoder = RangeDecoder(encoder.to_bytes())
        for _ in range(50):
            assert decoder.bit("rare", None, (1 << 20, 1)) == 0
            assert decoder.number(None, 40) == 2**40 - 1
        assert decoder.bit("last", None) == last


def test_odds_to_begin_with():
    sizes = []
    for odds in ((1, 1), RARE):
        encoder = RangeEncoder()
        for context in range(200):
            encoder.bit(context, 0, odds)
        sizes.append(len(encoder.to_bytes()))
    assert sizes[0] == pytest.approx(25, abs=1) and sizes[1] < 4


def test_what_has_no_end_is_refused():
    with pytest.raises(ValueError, match="the data end too early"):
        decoder = RangeDecoder(b"\x12\x34")
        while True:
            decoder.number(None, 8)
    with pytest.raises(ValueError, match="number that is too large"):
        RangeDecoder(b"\xff" * 100).count("count", None)
    with pytest.raises(ValueError, match="names number 3 of 3"):
        RangeDecoder(b"\xff" * 100).symbol("symbol", None, 3)
