import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.plr.file.bits import BitReader, BitWriter

QUICK = settings(max_examples=30, deadline=None)


@QUICK
@given(
    st.lists(st.lists(st.tuples(st.integers(0, 32), st.integers(0, 2**32 - 1)), max_size=20), min_size=1, max_size=4)
)
def test_what_is_written_is_read(rows):
    rows = [[(width, value & ((1 << width) - 1)) for width, value in row] for row in rows]
    writer = BitWriter()
    for row in rows:
        widths, values = np.array(row, np.int64).reshape(-1, 2).T
        writer.write(values, widths)
    data = writer.to_bytes()
    assert writer.num_bits == sum(width for row in rows for width, _ in row)
    assert len(data) == -(-writer.num_bits // 8)
    reader = BitReader(data)
    for row in rows:
        widths, values = np.array(row, np.int64).reshape(-1, 2).T
        np.testing.assert_array_equal(reader.read(widths), values)
    assert reader.at_end()


def test_least_significant_bit_comes_first():
    assert BitWriter().write(np.array([1, 2]), 2).to_bytes() == bytes([0b1001])


def test_reading_past_the_end_is_an_error():
    reader = BitReader(b"\xff")
    reader.read(np.array([5]))
    assert not reader.at_end()
    with pytest.raises(ValueError, match="end too early"):
        reader.read(np.array([4]))
    with pytest.raises(ValueError, match="end too early"):
        reader.read_alike(2**40, 1)


def test_unary_numbers_stand_between_others():
    body = BitWriter().write_unary(np.array([3, 0, 5])).write(np.array([6]), 3).write_unary(np.array([], np.int64))
    reader = BitReader(body.to_bytes())
    assert reader.read_unary(3).tolist() == [3, 0, 5]
    assert reader.read_unary(0).tolist() == []
    assert reader.read_alike(1, 3).tolist() == [6]
    with pytest.raises(ValueError, match="too early"):
        reader.read_unary(1)


def test_floats_are_kept_to_32_bits():
    values = np.array([0.1, -3.0, np.inf])
    read = BitReader(BitWriter().write_floats(values).to_bytes()).read_floats(3)
    np.testing.assert_array_equal(read, values.astype(np.float32))


@pytest.mark.filterwarnings("error")
def test_any_32_bits_are_read_as_a_float():
    patterns = np.array([0x7FA00000, 0xFF800001, 0x7F800000, 1])  # two signaling NaNs, infinity, the least number
    read = BitReader(BitWriter().write(patterns, 32).to_bytes()).read_floats(4)
    np.testing.assert_array_equal(read, [np.nan, np.nan, np.inf, 2.0**-149])


@QUICK
@given(values=st.lists(st.integers(0, 2**39)))
def test_coded_numbers_of_any_size(values):
    body = BitWriter().write_coded(np.array(values, np.int64)).write(np.array([1]), 1)
    reader = BitReader(body.to_bytes())
    assert reader.read_coded(len(values)).tolist() == values
    assert reader.read_alike(1, 1)[0] == 1


def test_coded_numbers_by_hand():
    """Of order 0: the order in 5 bits, in unary the bits of n + 1 beyond the first, then those bits."""
    bits = "00000" + "1" + "01" + "001" + "0" + "10"  # 0, 1 (binary 10) and 4 (binary 101, the lowest bit first)
    data = bytes([int(bits[:8][::-1], 2), int(bits[8:][::-1], 2)])
    assert BitReader(data).read_coded(3).tolist() == [0, 1, 4]


def test_coded_numbers_that_are_too_large_are_refused():
    with pytest.raises(ValueError, match="vary too much"):
        BitWriter().write_coded(np.array([2**40]))
    for order, extra in ((31, 100), (0, 63), (31, 31), (0, 41)):
        body = BitWriter().write(np.array([order]), 5).write_unary(np.array([extra]))
        body.write(np.zeros(order + extra, np.int64), 1)
        with pytest.raises(ValueError, match="a number that is too large"):
            BitReader(body.to_bytes()).read_coded(1)


@QUICK
@given(member=st.lists(st.booleans()))
def test_sets(member):
    body = BitWriter().write_set(np.array(member, bool))
    assert BitReader(body.to_bytes()).read_set(len(member)).tolist() == member


def test_sets_beyond_their_size_are_refused():
    five = BitWriter().write_set(np.ones(5, bool)).to_bytes()
    with pytest.raises(ValueError, match="it names 5 members of 4"):
        BitReader(five).read_set(4)
    late = BitWriter().write_set(np.array([False] * 9 + [True])).to_bytes()
    with pytest.raises(ValueError, match="a member beyond the last of 9"):
        BitReader(late).read_set(9)
    many = BitWriter().write(np.array([2**32 - 1]), 32).to_bytes()
    with pytest.raises(ValueError, match="it names 4294967295 members of 10"):
        BitReader(many).read_set(10)


@pytest.mark.parametrize("gaps", [[2**39, 0], [2**39, 2**39], [3, 3]])
def test_sets_whose_members_lie_anywhere_are_refused(gaps):
    body = BitWriter().write(np.array([len(gaps)]), 32).write_coded(np.array(gaps))
    with pytest.raises(ValueError, match="a member beyond the last of 5"):
        BitReader(body.to_bytes()).read_set(5)
