"""Domains and numbers of a header: read as they were written, bit for bit, in as few bytes as there is a way for."""

import decimal
import struct

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from plr_jax.geometry.box import Box
from plr_jax.plr.coding import ByteReader, signed_varint, varint
from plr_jax.plr.container import domain_to_bytes, frame_size, read_domain

DOUBLES = st.floats(allow_nan=False, allow_infinity=False)
DECIMALS = st.builds(lambda digits, places: digits / 10**places, st.integers(-(10**7), 10**7), st.integers(0, 6))
CORNERS = st.one_of(
    *(st.lists(numbers, min_size=2, max_size=2, unique=True).map(sorted) for numbers in (DOUBLES, DECIMALS))
)


def test_numbers_by_hand():
    """That of three bytes is the example of LEB128 in the DWARF standard's descriptions. Signs are the lowest bit."""
    ends = ((0, "00"), (127, "7f"), (128, "8001"), (300, "ac02"), (624485, "e58e26"), (2**56, "80" * 8 + "01"))
    for value, data in ends:
        assert varint(value) == bytes.fromhex(data)
    for value, code in ((0, 0), (-1, 1), (1, 2), (-2, 3), (63, 126), (-64, 127), (64, 128)):
        assert signed_varint(value) == varint(code)


@given(st.lists(st.integers(0, 2**70 - 1)), st.lists(st.integers(-(2**69), 2**69 - 1)), st.binary(max_size=3))
def test_numbers_are_read_as_they_were_written(numbers, signed, rest):
    reader = ByteReader(b"".join([b"!", *map(varint, numbers), *map(signed_varint, signed), rest]))
    assert reader.byte() == ord("!")
    for number in numbers:
        before = reader.at
        assert reader.varint() == number
        assert reader.at - before == max(1, -(-number.bit_length() // 7))
    assert [reader.signed_varint() for _ in signed] == signed
    assert reader.take(len(rest)) == rest


@pytest.mark.parametrize(
    ("data", "read", "message"),
    [
        (b"", ByteReader.byte, "end too early"),
        (b"\x80", ByteReader.varint, "end too early"),
        (b"\x80", lambda reader: reader.take(2**60), "end too early"),
        (b"\xff" * 1000, ByteReader.varint, "a number that is too large"),
    ],
)
def test_what_does_not_end_is_refused(data, read, message):
    reader = ByteReader(data)
    with pytest.raises(ValueError, match=message):
        read(reader)
    assert reader.at == 10 or len(data) < 10
    assert ByteReader(b"\xff" * 9 + b"\x7f").varint() == 2**70 - 1


@st.composite
def domains(draw):
    """What boxes are made of: any numbers, most of them of few decimals, some axes periodic."""
    dim = draw(st.integers(1, 20))
    corners = np.array([draw(CORNERS) for _ in range(dim)], np.float64)
    assume((corners[:, 0] < corners[:, 1]).all())
    return *corners.T, draw(st.lists(st.booleans(), min_size=dim, max_size=dim))


def read(data, dim, is_floats):
    reader = ByteReader(data)
    domain = read_domain(reader, dim, is_floats)
    assert reader.at == len(data)
    return domain


@given(domains(), st.text(max_size=100))
def test_a_domain_is_read_as_it_was_written_in_at_most_what_floats_take(box, label):
    """In the plane header, domain and checksum are 40 bytes or fewer."""
    domain = Box(*box)
    data, is_floats = domain_to_bytes(domain)
    assert read(data, domain.dim, is_floats) == domain
    assert len(data) <= 16 * domain.dim
    most = 8 + (domain.dim > 15) + 16 * domain.dim
    assert frame_size(domain) <= most
    with_label = 2 + len(label.encode()) if label else 0  # the label's length, and that there is one layer
    assert frame_size(domain, label=label) <= most + with_label + (with_label >= 130)


@pytest.mark.parametrize(
    ("domain", "data"),
    [
        (Box((0, 0), (1, 1)), [0, 0, 0, 2, 2]),
        (Box((-1, 0), (1, 3)), [0, 1, 0, 2, 6]),
        (Box((0, 0), (49.5, 20.25)), [2, 0, 0, *signed_varint(4950), *signed_varint(2025)]),
        (Box((0.3, -0.1), (0.7, 0.0)), [1, 6, 1, 14, 0]),  # 0.1 + 0.2 is another number than 0.3
        (Box((-0.0,), (1e15,)), [0, 0, *signed_varint(10**15)]),
        (Box((-1e-22,), (1e-22,)), [22, 1, 2]),
        (Box((-(2.0**53),), (0,)), [0, *signed_varint(-(2**53)), 0]),
        (Box((0,), (2.0**53 - 1,)), [0, 0, *signed_varint(2**53 - 1)]),  # in eight bytes
        (Box((0, -2), (10, 3), periodic=(False, True)), [0, 0, 6, 20, 3]),
    ],
)
def test_numbers_of_few_decimals_by_hand(domain, data):
    assert domain_to_bytes(domain) == (bytes(data), False)
    assert read(bytes(data), domain.dim, False) == domain


@pytest.mark.parametrize(
    "domain",
    [
        Box((-np.pi,), (np.pi,)),  # 16 digits
        Box((0.1 + 0.2,), (1,)),
        Box((0,), (2.0**53 + 2,)),
        Box((-1e-23,), (1e-23,)),
        Box((0, 0), (1, 1e-30)),  # of few digits each, but of no common unit
        Box((5e-324, -1e308), (1e-323, 1e308)),
        Box(
            (1 - 2.0**53,), (2.0**53 - 1,)
        ),  # two integers of eight bytes each, and the byte for decimals, are longer
    ],
)
def test_other_numbers_are_floats(domain):
    data, is_floats = domain_to_bytes(domain)
    assert is_floats and data == struct.pack(f"<{2 * domain.dim}d", *domain.lo, *domain.hi)
    assert read(data, domain.dim, True) == domain


def test_the_caller_s_decimals_change_nothing():
    domain = Box((-1234.5678,), (8765.4321,))
    expected = domain_to_bytes(domain)
    with decimal.localcontext(decimal.Context(prec=3, traps=[decimal.Inexact, decimal.Rounded])):
        assert domain_to_bytes(domain) == expected
    assert not expected[1]


@pytest.mark.parametrize(
    ("data", "is_floats", "message"),
    [
        (b"", False, "end too early"),
        (b"\x00\x00", False, "end too early"),
        (b"\x17\x00\x02", False, "numbers of 23 decimals, more than 22"),
        (b"\x00\x00" + signed_varint(2**53 + 1), False, "numbers that are too large"),
        (b"\x00" + signed_varint(-(2**60)) + b"\x00", False, "numbers that are too large"),
        (b"\x00\x02\x02", False, "positive width along every axis, got lo=1 and hi=1 on axis 0"),
        (bytes(15), True, "end too early"),
        (bytes(16), True, "positive width"),
        (struct.pack("<2d", 0, np.nan), True, "finite"),
        (struct.pack("<2d", np.inf, 0), True, "finite"),
    ],
)
def test_what_is_no_domain_is_refused(data, is_floats, message):
    with pytest.raises(ValueError, match=message):
        read_domain(ByteReader(data), 1, is_floats)
