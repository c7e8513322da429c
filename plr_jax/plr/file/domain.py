"""The domain as a file keeps it: whole multiples of a power of ten, or 64-bit floats where those are longer.

Most maps have corners of few decimals. As bytes, with numbers as in ``fields.py``:

    of decimals  u8      how many: a number is an integer divided by 10 to their power, rounded as floats are
                 ...     signed numbers, those integers: the lower corner, one an axis, then the upper corner
    of floats    f64     the same corners, little-endian

Of each periodic axis the two ends are exchanged: the upper one comes first.
"""

from decimal import Context, Decimal

import numpy as np

from plr_jax.geometry.box import Box
from plr_jax.plr.file.fields import ByteReader, signed_varint

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
