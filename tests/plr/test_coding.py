"""Bits, numbers, sets, trees and domains: by hand, read as they were written, and nothing else read as one."""

import decimal
import struct

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from plr_helpers import random_partition

from plr_jax.geometry.box import Box
from plr_jax.plr.coding import (
    BitReader,
    BitWriter,
    ByteReader,
    body_size,
    read_tree,
    signed_varint,
    varint,
    write_tree,
)
from plr_jax.plr.container import domain_to_bytes, frame_size, read_domain
from plr_jax.plr.tree import tree_of

# Bits, numbers, sets and trees: by hand, read as they were written, and nothing else read as one.


FIELDS = st.lists(st.tuples(st.integers(0, 32), st.integers(0, 2**32 - 1)), max_size=20)


def bits_of(text):
    """Bytes of a stream of bits, the least significant first."""
    return np.packbits([int(bit) for bit in text.replace(" ", "")], bitorder="little").tobytes()


def written(cells):
    body = BitWriter()
    write_tree(body, tree_of(cells))
    return body


@given(
    rows=st.lists(FIELDS, min_size=1, max_size=4),
    unary=st.lists(st.integers(0, 40)),
    coded=st.lists(st.integers(0, 2**39)),
    member=st.lists(st.booleans()),
)
def test_what_is_written_is_read(rows, unary, coded, member):
    writer = BitWriter()
    rows = [np.array(row, np.int64).reshape(-1, 2).T for row in rows]
    rows = [(widths, values & ((1 << widths) - 1)) for widths, values in rows]
    for widths, values in rows:
        writer.write(values, widths)
    assert writer.num_bits == sum(int(widths.sum()) for widths, _ in rows)
    writer.write_unary(np.array(unary, np.int64)).write_coded(np.array(coded, np.int64))
    data = writer.write_set(np.array(member, bool)).write(np.array([1]), 1).to_bytes()
    assert len(data) == -(-writer.num_bits // 8)
    reader = BitReader(data)
    for widths, values in rows:
        np.testing.assert_array_equal(reader.read(widths), values)
    assert reader.read_unary(len(unary)).tolist() == unary
    assert reader.read_coded(len(coded)).tolist() == coded
    assert reader.read_set(len(member)).tolist() == member
    assert reader.read_alike(1, 1)[0] == 1 and reader.at_end()


@pytest.mark.filterwarnings("error")
def test_any_32_bits_are_read_as_a_float():
    patterns = np.array([0x7FA00000, 0xFF800001, 0x7F800000, 1])  # two signaling NaNs, infinity, the least number
    body = BitWriter().write(patterns, 32).write_floats(np.array([0.1, -3.0]))
    read = BitReader(body.to_bytes()).read_floats(6)
    np.testing.assert_array_equal(read, [np.nan, np.nan, np.inf, 2.0**-149, np.float32(0.1), -3])


def body_of_code(order, extra):
    body = BitWriter().write(np.array([order]), 5).write_unary(np.array([extra]))
    return body.write(np.zeros(order + extra, np.int64), 1)


def body_of_members(gaps):
    return BitWriter().write(np.array([len(gaps)]), 32).write_coded(np.array(gaps))


@pytest.mark.parametrize(
    ("body", "read", "message"),
    [
        (BitWriter().write(np.array([255]), 8), lambda body: body.read(np.array([5, 4])), "end too early"),
        (BitWriter().write(np.array([255]), 8), lambda body: body.read_alike(2**40, 1), "end too early"),
        (BitWriter().write(np.array([8]), 8), lambda body: body.read_unary(2), "end too early"),
        *(
            (body_of_code(order, extra), lambda body: body.read_coded(1), "a number that is too large")
            for order, extra in ((31, 100), (0, 63), (31, 31), (0, 41))
        ),
        (BitWriter().write_set(np.ones(5, bool)), lambda body: body.read_set(4), "it names 5 members of 4"),
        (body_of_members([9]), lambda body: body.read_set(9), "a member beyond the last of 9"),
        (
            BitWriter().write(np.array([2**32 - 1]), 32),
            lambda body: body.read_set(10),
            "names 4294967295 members of 10",
        ),
        (body_of_members([2**39, 0]), lambda body: body.read_set(5), "a member beyond the last of 5"),
        (body_of_members([2**39, 2**39]), lambda body: body.read_set(5), "a member beyond the last of 5"),
        (body_of_members([3, 3]), lambda body: body.read_set(5), "a member beyond the last of 5"),
    ],
)
def test_what_does_not_end_or_is_too_large_is_refused(body, read, message):
    reader = BitReader(body.to_bytes())
    assert not reader.at_end()
    with pytest.raises(ValueError, match=message):
        read(reader)


def test_numbers_that_are_too_large_are_not_written():
    with pytest.raises(ValueError, match="vary too much"):
        BitWriter().write_coded(np.array([2**40]))


@given(seed=st.integers(0, 1000), dim=st.integers(1, 20), num_splits=st.integers(0, 40))
def test_the_tree_that_is_read_is_what_was_written(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    data = written(cells).to_bytes()
    assert len(data) == body_size(dim, num_splits + 1, 0)
    reader = BitReader(data)
    found, expected = read_tree(reader, dim).leaves, tree_of(cells).leaves
    assert reader.at_end()
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_array_equal(found.position, expected.position)


@pytest.mark.parametrize(
    ("data", "dim", "message"),
    [
        (bits_of("1 11"), 3, "it splits axis 3 of 3"),
        (bits_of("1111"), 2, "end too early"),
        (b"", 2, "end too early"),
        (b"\xff" * 100, 1, "end too early"),
        (bits_of("1" + "10" * 60 + "00"), 1, "its tree is deeper than 60"),
    ],
)
def test_what_is_no_tree_is_refused(data, dim, message):
    with pytest.raises(ValueError, match=message):
        read_tree(BitReader(data), dim)


# Domains and numbers of a header: read as they were written, bit for bit, in as few bytes as there is a way for.


DOUBLES = st.floats(allow_nan=False, allow_infinity=False)
DECIMALS = st.builds(lambda digits, places: digits / 10**places, st.integers(-(10**7), 10**7), st.integers(0, 6))
PAIRS_OF_ENDS = st.one_of(
    *(st.lists(numbers, min_size=2, max_size=2, unique=True).map(sorted) for numbers in (DOUBLES, DECIMALS))
)


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


@st.composite
def domains(draw):
    """What boxes are made of: any numbers, most of them of few decimals, some axes periodic."""
    dim = draw(st.integers(1, 20))
    corners = np.array([draw(PAIRS_OF_ENDS) for _ in range(dim)], np.float64)
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
