"""Bits, numbers, sets and trees: by hand, read as they were written, and nothing else read as one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, random_partition, three_leaves

from plr_jax.plr.coding import BitReader, BitWriter, body_size, read_tree, write_tree
from plr_jax.plr.tree import levels_of, tree_of_levels

QUICK = settings(max_examples=30)
FIELDS = st.lists(st.tuples(st.integers(0, 32), st.integers(0, 2**32 - 1)), max_size=20)


def bits_of(text):
    """Bytes of a stream of bits, the least significant first."""
    return np.packbits([int(bit) for bit in text.replace(" ", "")], bitorder="little").tobytes()


def written(cells):
    body = BitWriter()
    write_tree(body, levels_of(cells)[0], cells.dim)
    return body


@QUICK
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


def test_by_hand():
    """Coded numbers of order 0: the order in 5 bits, in unary the bits of n + 1 beyond the first, then those bits."""
    assert BitWriter().write(np.array([1, 2]), 2).to_bytes() == bytes([0b1001])
    coded = bits_of("00000" + "1" + "01" + "001" + "0" + "10")  # 0, 1 (binary 10) and 4 (101, the lowest bit first)
    assert BitReader(coded).read_coded(3).tolist() == [0, 1, 4]


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


def test_a_tree_of_three_leaves_by_hand():
    body = written(three_leaves())
    # The root is split along axis 0; its lower half is a leaf, its upper half is split along axis 1 into two.
    assert body.to_bytes() == bits_of("1 0  01 1  00")
    assert body.num_bits == 7
    assert [body_size(2, leaves, bits) for leaves, bits in ((3, 1), (3, 2), (1, 31), (1, 24))] == [1, 2, 4, 4]


@QUICK
@given(seed=st.integers(0, 1000), dim=st.integers(1, 20), num_splits=st.integers(0, 40))
def test_the_tree_that_is_read_is_what_was_written(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    data = written(cells).to_bytes()
    assert len(data) == body_size(dim, num_splits + 1, 0)
    reader = BitReader(data)
    found = tree_of_levels(read_tree(reader, dim), dim).leaves
    assert reader.at_end()
    order = levels_of(cells)[1]
    np.testing.assert_array_equal(found.depth, cells.depth[order])
    np.testing.assert_array_equal(found.position, cells.position[order])


@pytest.mark.parametrize(
    ("data", "dim", "message"),
    [
        (bits_of("1 11"), 3, "it splits axis 3 of 3"),
        (bits_of("1111"), 2, "end too early"),
        (b"", 2, "end too early"),
        (b"\xff" * 100, 1, "end too early"),
        (written(chain([0] * 61)).to_bytes(), 1, "its tree is deeper than 60"),
    ],
)
def test_what_is_no_tree_is_refused(data, dim, message):
    with pytest.raises(ValueError, match=message):
        read_tree(BitReader(data), dim)
