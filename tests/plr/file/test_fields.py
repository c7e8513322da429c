"""Numbers of the header: by hand, read as they were written, and refused where they do not end."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.plr.file.domain import ByteReader, signed_varint, varint


@pytest.mark.parametrize(
    ("value", "data"),
    [(0, "00"), (1, "01"), (127, "7f"), (128, "8001"), (300, "ac02"), (624485, "e58e26"), (2**56, "80" * 8 + "01")],
)
def test_numbers_by_hand(value, data):
    """The one of three bytes is the example of LEB128 in the DWARF standard's descriptions."""
    assert varint(value) == bytes.fromhex(data)


@pytest.mark.parametrize(("value", "code"), [(0, 0), (-1, 1), (1, 2), (-2, 3), (63, 126), (-64, 127), (64, 128)])
def test_signs_are_the_lowest_bit(value, code):
    assert signed_varint(value) == varint(code)


@given(st.lists(st.integers(0, 2**70 - 1)), st.lists(st.integers(-(2**69), 2**69 - 1)), st.binary(max_size=3))
def test_what_is_written_is_read(numbers, signed, rest):
    data = b"".join([*map(varint, numbers), *map(signed_varint, signed), rest])
    reader = ByteReader(data)
    assert [reader.varint() for _ in numbers] == numbers
    assert [reader.signed_varint() for _ in signed] == signed
    assert reader.at == len(data) - len(rest)
    assert reader.take(len(rest)) == rest


@given(st.integers(0, 2**70 - 1))
def test_a_number_takes_a_byte_for_each_seven_bits_begun(value):
    assert len(varint(value)) == max(1, -(-value.bit_length() // 7))


def test_bytes_are_taken_in_their_order():
    reader = ByteReader(b"abcd")
    assert (reader.take(2), reader.byte(), reader.take(0), reader.at) == (b"ab", ord("c"), b"", 3)


@pytest.mark.parametrize("read", [ByteReader.byte, ByteReader.varint, lambda reader: reader.take(2**60)])
@pytest.mark.parametrize("data", [b"", b"\x80"])
def test_reading_past_the_end_is_refused(read, data):
    reader = ByteReader(data)
    reader.take(len(data) if read is ByteReader.byte else 0)
    with pytest.raises(ValueError, match="the data end too early"):
        read(reader)


def test_a_number_that_does_not_end_is_refused_after_ten_bytes():
    assert ByteReader(b"\xff" * 9 + b"\x7f").varint() == 2**70 - 1
    reader = ByteReader(b"\xff" * 1000)
    with pytest.raises(ValueError, match="a number that is too large"):
        reader.varint()
    assert reader.at == 10
