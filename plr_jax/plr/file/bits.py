"""Integers of any width, packed without gaps: the body of a PLR file."""

import numpy as np
from jaxtyping import Int


class BitWriter:
    """Collects unsigned integers, each with its width in bits, least significant bit first."""

    def __init__(self) -> None:
        self._bits: list[np.ndarray] = []

    def write(self, values: Int[np.ndarray, "n"], widths: Int[np.ndarray, "n"] | int) -> "BitWriter":
        """Append each value in as many bits as its width says."""
        if isinstance(widths, int):
            bits = (values[:, None] >> np.arange(widths)) & 1
        else:
            field, within = _fields(widths)
            bits = (values[field] >> within) & 1
        self._bits.append(bits.astype(np.uint8).ravel())
        return self

    def write_unary(self, values: Int[np.ndarray, "n"]) -> "BitWriter":
        """Append each value as so many zeros and a one."""
        bits = np.zeros(int(values.sum()) + len(values), np.uint8)
        bits[np.cumsum(values + 1) - 1] = 1
        self._bits.append(bits)
        return self

    def to_bytes(self) -> bytes:
        """All bits so far, the last byte filled up with zeros."""
        return np.packbits(np.concatenate(self._bits), bitorder="little").tobytes()


class BitReader:
    """Reads integers back in the order in which they were written."""

    def __init__(self, data: bytes) -> None:
        self._bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
        self._at = 0

    def read(self, widths: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """The next values, each of as many bits as its width says; raises ``ValueError`` past the end."""
        bits = self._take(int(widths.sum()))
        field, within = _fields(widths)
        values = np.zeros(len(widths), np.int64)
        np.add.at(values, field, bits << within)
        return values

    def read_alike(self, num_values: int, width: int) -> Int[np.ndarray, "n"]:
        """The next values, all of one width; raises ``ValueError`` past the end."""
        return self._take(num_values * width).reshape(num_values, width) @ (1 << np.arange(width))

    def read_unary(self, num_values: int) -> Int[np.ndarray, "n"]:
        """The next values, each as many zeros as it counts and a one; raises ``ValueError`` past the end."""
        ends = np.flatnonzero(self._bits[self._at :])[:num_values]
        if len(ends) < num_values:
            raise ValueError("the data end too early")
        self._at += int(ends[-1]) + 1 if num_values else 0
        return np.diff(ends, prepend=-1) - 1

    def _take(self, num_bits: int) -> Int[np.ndarray, "bits"]:
        bits = self._bits[self._at : self._at + num_bits]
        if len(bits) < num_bits:
            raise ValueError("the data end too early")
        self._at += num_bits
        return bits.astype(np.int64)

    def at_end(self) -> bool:
        """Whether nothing but the padding of the last byte is left."""
        return len(self._bits) - self._at < 8 and not self._bits[self._at :].any()


def _fields(widths: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "bits"], Int[np.ndarray, "bits"]]:
    """For every bit the index of its value and its place in it."""
    field = np.repeat(np.arange(len(widths)), widths)
    start = np.cumsum(widths) - widths
    return field, np.arange(len(field)) - start[field]
