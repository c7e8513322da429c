"""Bits in about as many bits as they are surprising: a binary arithmetic coder that learns its odds on the way.

Every bit has a *context*, in which it is expected to be 1 as often as it was before. A range of 32 bits is cut in two
by these odds, and the bit names its part; a number in what is left of the range at last is the code. There is one
program both ways: it says which bits there are, of which the encoder knows the values and the decoder finds them.

See Witten, Neal and Cleary, "Arithmetic coding for data compression" (1987), and for the odds Krichevsky and
Trofimov, "The performance of universal encoding" (1981).
"""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence

import numpy as np

from plr_jax.plr.file.bits import floats_of_bits

_TOP, _WHOLE = 24, 32  # bits below which a range is widened, and that it then has at the most
_COUNTED, _MOST = 2, 1 << 12  # what a bit adds to a count, and of both counts before they are halved
_MOST_EXTRA = 40  # bits of a number beyond its leading one
RARE = 20, 1
"""Odds of what seldom changes, to begin with."""


class Coder(ABC):
    """What codes bits and numbers; values are what is to be encoded, and None where they are to be found."""

    def __init__(self) -> None:
        self._range = (1 << _WHOLE) - 1
        self._counts: dict[Hashable, list[int]] = {}

    @abstractmethod
    def _placed(self, value: int | None, below: int) -> int:
        """A bit, which is 0 in the part of the range below a number; the range then begins where its part does."""

    @abstractmethod
    def _shift(self) -> None:
        """Go on to the following byte."""

    def _coded(self, value: int | None, below: int) -> int:
        """A bit, whose part of the range is all that is left of it."""
        bit = self._placed(value, below)
        self._range = self._range - below if bit else below
        while self._range >> _TOP == 0:
            self._shift()
            self._range <<= 8
        return bit

    def bit(self, context: Hashable, value: int | None, odds: Sequence[int] = (1, 1)) -> int:
        """A bit in a context, whose odds to be 0 and to be 1 are at first those given."""
        counts = self._counts.get(context)
        if counts is None:
            counts = self._counts[context] = list(odds)
        bit = self._coded(value, self._range * counts[0] // (counts[0] + counts[1]))
        counts[bit] += _COUNTED
        if counts[0] + counts[1] > _MOST:
            counts[:] = (counts[0] + 1) // 2, (counts[1] + 1) // 2
        return bit

    def number(self, value: int | None, width: int) -> int:
        """A number of so many bits, all of them as likely 0 as 1."""
        found = 0
        for place in reversed(range(width)):
            bit = self._coded(None if value is None else value >> place & 1, self._range >> 1)
            found |= bit << place
        return found

    def float32(self, value: float | None) -> float:
        """A number that is exact in 32 bits."""
        bits = self.number(None if value is None else int(np.float32(value).view(np.uint32)), 32)
        return float(floats_of_bits(np.array(bits)))

    def symbol(self, context: Hashable, value: int | None, count: int) -> int:
        """One of so many, 0 and on, bit by bit in contexts of those before; ``ValueError`` if it is none of them."""
        width, node = (count - 1).bit_length(), 1
        for place in reversed(range(width)):
            node = 2 * node + self.bit((context, node), None if value is None else value >> place & 1)
        if (found := node - (1 << width)) >= count:
            raise ValueError(f"it names number {found} of {count}")
        return found

    def count(self, context: Hashable, value: int | None) -> int:
        """A number of at least 0, small ones in fewer bits: an Exp-Golomb code whose length is learnt."""
        extra = 0
        while self.bit((context, extra), None if value is None else int((value + 1) >> extra > 1)):
            extra += 1
            if extra > _MOST_EXTRA:
                raise ValueError("it holds a number that is too large")
        rest = self.number(None if value is None else value + 1 - (1 << extra), extra)
        return rest + (1 << extra) - 1


class RangeEncoder(Coder):
    """Codes values as bytes."""

    def __init__(self) -> None:
        super().__init__()
        self._low, self._data = 0, bytearray()

    def _placed(self, value: int | None, below: int) -> int:
        assert value is not None, "an encoder knows what it encodes"
        self._low += below if value else 0
        return value

    def _shift(self) -> None:
        """Append the highest byte of the low end; what is carried over goes to the bytes before."""
        if self._low >> _WHOLE:
            place = len(self._data) - 1
            while self._data[place] == 255:
                self._data[place] = 0
                place -= 1
            self._data[place] += 1
        self._data.append(self._low >> _TOP & 255)
        self._low = (self._low << 8) & ((1 << _WHOLE) - 1)

    def to_bytes(self) -> bytes:
        """All that was coded, in the fewest bytes whose continuation by zeros is in the range."""
        for zeros in (24, 16, 8, 0):
            end = -(-self._low >> zeros) << zeros
            if end < self._low + self._range:
                break
        self._low = end
        for _ in range((_WHOLE - zeros) // 8):
            self._shift()
        return bytes(self._data)


class RangeDecoder(Coder):
    """Finds the values again; raises ``ValueError`` where data have ended long before."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self._data, self._at, self._code = data, 0, 0
        for _ in range(_WHOLE // 8):
            self._shift()

    def _placed(self, value: int | None, below: int) -> int:
        bit = int(self._code >= below)
        self._code -= below if bit else 0
        return bit

    def _shift(self) -> None:
        if self._at > len(self._data) + _WHOLE // 8:
            raise ValueError("the data end too early")
        following = self._data[self._at] if self._at < len(self._data) else 0
        self._code, self._at = self._code << 8 | following, self._at + 1
