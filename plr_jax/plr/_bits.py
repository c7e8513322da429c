"""Integers of any width, packed without gaps: the body of a PLR file."""

import numpy as np
from jaxtyping import Int


class BitWriter:
    """Collects unsigned integers, each with its width in bits, least significant bit first."""

    def __init__(self) -> None:
        self._bits: list[np.ndarray] = []

    def write(self, values: Int[np.ndarray, "n"], widths: Int[np.ndarray, "n"] | int) -> "BitWriter":
        """Append each value in as many bits as its width says."""
        field, within = _fields(np.broadcast_to(widths, values.shape))
        self._bits.append(((values[field] >> within) & 1).astype(np.uint8))
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
        """The next values; raises ``ValueError`` past the end."""
        field, within = _fields(widths)
        bits = self._bits[self._at : self._at + len(field)]
        if len(bits) < len(field):
            raise ValueError("the data end too early")
        self._at += len(field)
        values = np.zeros(len(widths), np.int64)
        np.add.at(values, field, bits.astype(np.int64) << within)
        return values

    def at_end(self) -> bool:
        """Whether nothing but the padding of the last byte is left."""
        return len(self._bits) - self._at < 8 and not self._bits[self._at :].any()


def _fields(widths: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "bits"], Int[np.ndarray, "bits"]]:
    """For every bit the index of its value and its place in it."""
    field = np.repeat(np.arange(len(widths)), widths)
    start = np.cumsum(widths) - widths
    return field, np.arange(len(field)) - start[field]
