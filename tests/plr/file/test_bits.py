import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.file.bits import BitReader, BitWriter


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
    assert len(data) == -(-sum(width for row in rows for width, _ in row) // 8)
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


def test_unary_numbers_stand_between_others():
    body = BitWriter().write_unary(np.array([3, 0, 5])).write(np.array([6]), 3).write_unary(np.array([], np.int64))
    reader = BitReader(body.to_bytes())
    assert reader.read_unary(3).tolist() == [3, 0, 5]
    assert reader.read_unary(0).tolist() == []
    assert reader.read_alike(1, 3).tolist() == [6]
    with pytest.raises(ValueError, match="too early"):
        reader.read_unary(1)
