"""The domain and its folding as a file keeps them: multiples of a power of ten, or 64-bit floats.

Most maps have corners of few decimals. As bytes, with numbers as :func:`varint` and :func:`signed_varint` write them:

    of decimals  u8      how many: a number is an integer divided by 10 to their power, rounded as floats are
                 ...     signed numbers, those integers: the lower corner, one an axis, then the upper corner
    of floats    f64     the same corners, little-endian

Of each periodic axis the two ends are exchanged: the upper one comes first.
"""

from decimal import Context, Decimal

import numpy as np
from jaxtyping import Bool

from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding

# Integers of whole bytes, which the header of a PLR file is made of.


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


# What a file keeps of a folding, after the domain: floats little-endian.
#
# f64     the center, one number an axis
# u8      1 if folded coordinates run along axes of their own, else 0
# f64     of such the axes, row by row
# u8      number of mirrors
# u8      for each mirror one number an axis, 1 if it is reversed, else 0; then zeros, one an axis


_ORTHOGONAL = 1e-9


def folding_to_bytes(folding: Folding) -> bytes:
    """What the file keeps."""
    marks = np.array([*folding.mirrors, (0,) * folding.domain.dim], np.uint8)
    axes = folding.axes.astype("<f8").tobytes() if folding.is_turned else b""
    return b"".join(
        [
            folding.center.astype("<f8").tobytes(),
            bytes([folding.is_turned]),
            axes,
            bytes([len(folding.mirrors)]),
            marks.tobytes(),
        ]
    )


def read_folding(reader: ByteReader, domain: Box) -> Folding:
    """The next folding; raises ``ValueError`` saying what is wrong with it."""
    dim = domain.dim
    center = np.frombuffer(reader.take(8 * dim), "<f8").astype(np.float64)
    axes = np.eye(dim)
    if _flags(reader.take(1))[0]:
        axes = np.frombuffer(reader.take(8 * dim * dim), "<f8").astype(np.float64).reshape(dim, dim)
    marks = _flags(reader.take(dim * (reader.byte() + 1))).reshape(-1, dim)
    mirrors = tuple(tuple(map(bool, row)) for row in marks[:-1])
    if marks[-1].any():
        raise ValueError(
            "it stores what a distance is more than a straight line, which plr_jax 0.1 reads; build it again"
        )
    folding = Folding(domain, center, axes, mirrors)
    _check(folding)
    return folding


def _flags(data: bytes) -> Bool[np.ndarray, "n"]:
    numbers = np.frombuffer(data, np.uint8)
    if (numbers > 1).any():
        raise ValueError(f"its folding has a mark of {numbers.max()}, which is 0 or 1")
    return numbers == 1


def _check(folding: Folding) -> None:
    axes, periodic = folding.axes, np.array(folding.domain.periodic)
    if not (np.isfinite(folding.center).all() and np.isfinite(axes).all()):
        raise ValueError("its folding has numbers that are not finite")
    unit = np.eye(len(axes))
    if np.abs(axes).max() > 2 or np.abs(axes @ axes.T - unit).max() > _ORTHOGONAL or (axes != unit)[periodic].any():
        raise ValueError("the axes of its folding are not orthogonal, or turn a periodic one")
    if not folding.mirrors:
        raise ValueError("its folding folds nothing")
    if folding.cutting != folding.mirrors:
        raise ValueError("its folding has a mirror that does not cut the domain")


_MOST_DECIMALS = 22  # powers of ten up to this one, and integers below the next, are exact in 64 bits
_LARGEST = 2**53
_EXACT = Context(prec=40, traps=[])  # whatever the caller has set: numbers have at most 17 digits


def domain_to_bytes(domain: Box) -> tuple[bytes, bool]:
    """What the file keeps, and whether that is floats."""
    first, second = np.where(domain.periodic, (domain.hi, domain.lo), (domain.lo, domain.hi))
    numbers = np.concatenate([first, second])
    floats, decimals = numbers.astype("<f8").tobytes(), _decimals(numbers.tolist())
    return (floats, True) if decimals is None or len(decimals) > len(floats) else (decimals, False)


def read_domain(reader: ByteReader, dim: int, is_floats: bool) -> Box:
    """The next domain; raises ``ValueError`` saying what is wrong with it."""
    if is_floats:
        numbers = np.frombuffer(reader.take(16 * dim), "<f8").astype(np.float64)
    else:
        if (decimals := reader.byte()) > _MOST_DECIMALS:
            raise ValueError(f"its domain has numbers of {decimals} decimals, more than {_MOST_DECIMALS}")
        integers = [reader.signed_varint() for _ in range(2 * dim)]
        if max(map(abs, integers)) > _LARGEST:
            raise ValueError("its domain has numbers that are too large")
        numbers = np.array(integers, np.float64) / float(10**decimals)
    corners = numbers.reshape(2, dim)
    periodic = corners[0] > corners[1]
    lo, hi = np.where(periodic, corners[::-1], corners)
    return Box(lo, hi, tuple(map(bool, periodic)))


def _decimals(numbers: list[float]) -> bytes | None:
    """The numbers as integers over one power of ten; None where that is not exact."""
    shortest = [Decimal(repr(number)) for number in numbers]
    decimals = max(0, *(-int(number.normalize(_EXACT).as_tuple().exponent) for number in shortest))
    integers = [int(number.scaleb(decimals, _EXACT)) for number in shortest]
    if decimals > _MOST_DECIMALS or max(map(abs, integers)) > _LARGEST:
        return None
    # A zero may be negative, which no integer is; a box does not tell them apart.
    if [integer / float(10**decimals) for integer in integers] != numbers:
        return None
    return bytes([decimals]) + b"".join(map(signed_varint, integers))
