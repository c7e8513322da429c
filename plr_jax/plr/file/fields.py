"""Integers of whole bytes, which the header of a PLR file is made of."""

_BITS, _MOST_BYTES = 7, 10


def varint(value: int) -> bytes:
    """A number of at least 0, seven bits a byte, the lowest first; all bytes but the last have their highest bit set.

    This is what others call LEB128.
    """
    more, last = [], value
    while last >> _BITS:
        more.append(1 << _BITS | last & (1 << _BITS) - 1)
        last >>= _BITS
    return bytes([*more, last])


def signed_varint(value: int) -> bytes:
    """A number of either sign: twice the absolute value, minus one if it is negative."""
    return varint(2 * abs(value) - (value < 0))


class ByteReader:
    """Reads the fields of a header in the order in which they were written."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def take(self, count: int) -> bytes:
        """The next bytes; raises ``ValueError`` past the end."""
        self.at += count
        if self.at > len(self._data):
            raise ValueError("the data end too early")
        return self._data[self.at - count : self.at]

    def byte(self) -> int:
        """The next byte as a number."""
        return self.take(1)[0]

    def varint(self) -> int:
        """The next number that :func:`varint` wrote; raises ``ValueError`` if it has more than ten bytes."""
        value = 0
        for place in range(_MOST_BYTES):
            byte = self.byte()
            value |= (byte & (1 << _BITS) - 1) << _BITS * place
            if byte < 1 << _BITS:
                return value
        raise ValueError("its header holds a number that is too large")

    def signed_varint(self) -> int:
        """The next number that :func:`signed_varint` wrote."""
        code = self.varint()
        return -(code // 2) - 1 if code % 2 else code // 2
