"""A proof as a file keeps it: the largest error, and bounds of every leaf in 8 bits each.

As bits, after the leaves:

    largest error, a 32-bit float
    where each leaf has bounds: codes of all lower ones, then of all upper ones, 8 bits each

A bound is ``scale * 2**((code - 255) / 12)``, below or above what the leaf holds: a code more is 6 % more, and
the smallest is 4e-7 of the largest. All of them are rounded away from zero.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, UInt8

from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.query.frame import LARGEST

_CODE_BITS, _MOST, _CODES_A_DOUBLING = 8, 255, 12
_MAX_ERROR_BITS = 32


class Proof(IntEnum):
    """What a file keeps of a proof; the numbers are those in files."""

    NONE = 0
    LARGEST = 1
    LEAVES = 2
    OPEN_LEAVES = 3
    """Of leaves, some of which have no upper bound."""

    def num_bits(self, num_leaves: int) -> int:
        """Bits that it takes."""
        of_leaves = _MAX_ERROR_BITS + 2 * _CODE_BITS * num_leaves
        return (0, _MAX_ERROR_BITS, of_leaves, of_leaves)[self]


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds of the distance minus what a PLR answers.

    Attributes:
        scale: Of the codes: the largest bound there is; exact in 32 bits.
        lower: Codes of how far below each leaf's function the distance may be; None if they are not kept.
        upper: The same above.
        is_open: Whether the largest code of an upper bound says that there is none.
    """

    scale: float
    lower: UInt8[np.ndarray, "leaves"] | None
    upper: UInt8[np.ndarray, "leaves"] | None
    is_open: bool = False

    @staticmethod
    def of(bounds: LeafBounds, rounding: Float[np.ndarray, "leaves"], proof: Proof) -> "Certificate":
        """The certificate of bounds, and of what queries round; upper ones may be ``inf`` for open leaves."""
        lower, upper = np.maximum(rounding - bounds.lower, 0.0), np.maximum(rounding + bounds.upper, 0.0)
        is_open = np.isinf(upper)
        largest = max(lower.max(), upper[~is_open].max(initial=0.0), np.finfo(np.float32).tiny)
        if proof is Proof.OPEN_LEAVES:
            largest *= 2.0 ** (1.1 / _CODES_A_DOUBLING)  # so that no bound has the largest code
        scale = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
        if proof is Proof.LARGEST:
            return Certificate(scale, None, None)
        codes = _codes(np.where(is_open, scale, upper), scale)
        return Certificate(scale, _codes(lower, scale), codes, proof is Proof.OPEN_LEAVES)

    @property
    def max_error(self) -> float:
        """Of the largest error anywhere; ``inf`` if a leaf has no upper bound."""
        return float("inf") if self.is_open and self.upper is not None and _MOST in self.upper else self.scale

    @property
    def proof(self) -> Proof:
        """What of it is kept."""
        if self.lower is None:
            return Proof.LARGEST
        return Proof.OPEN_LEAVES if self.is_open else Proof.LEAVES

    def bounds(self) -> Float[np.ndarray, "2 leaves_or_one"]:
        """What is to be added to answers for lower and upper bounds, exact in 32 bits: of each leaf, or of all."""
        if self.lower is None or self.upper is None:
            return np.array([[-self.scale], [self.scale]])
        lower, upper = _of_codes(self.lower, self.scale), _of_codes(self.upper, self.scale)
        if self.is_open:
            upper[self.upper == _MOST] = np.inf
        return np.stack([-lower, upper])

    def write(self, body: BitWriter) -> None:
        """Append it to a file."""
        body.write_floats(np.array([self.scale]))
        for codes in (self.lower, self.upper):
            if codes is not None:
                body.write(codes.astype(np.int64), _CODE_BITS)


def read_certificate(body: BitReader, proof: Proof, num_leaves: int) -> Certificate | None:
    """What :meth:`Certificate.write` appended; raises ``ValueError`` saying what is wrong with it."""
    if proof is Proof.NONE:
        return None
    scale = float(body.read_floats(1)[0])
    if not 0 < scale < LARGEST:
        raise ValueError(f"it states a largest error of {scale}")
    if proof is Proof.LARGEST:
        return Certificate(scale, None, None)
    lower, upper = (body.read_alike(num_leaves, _CODE_BITS).astype(np.uint8) for _ in range(2))
    return Certificate(scale, lower, upper, proof is Proof.OPEN_LEAVES)


def _of_codes(code: UInt8[np.ndarray, "leaves"], scale: float) -> Float[np.ndarray, "leaves"]:
    """Bounds of codes, as 32-bit floats that are not below them."""
    exact = scale * 2.0 ** ((code.astype(np.float64) - _MOST) / _CODES_A_DOUBLING)
    return np.nextafter(exact.astype(np.float32), np.float32(np.inf)).astype(np.float64)


def _codes(bound: Float[np.ndarray, "leaves"], scale: float) -> UInt8[np.ndarray, "leaves"]:
    """The smallest codes whose bounds are not below."""
    with np.errstate(divide="ignore"):
        code = np.ceil(_MOST + _CODES_A_DOUBLING * np.log2(bound / scale))
    code = np.clip(code, 0, _MOST).astype(np.uint8)
    short = (_of_codes(code, scale) < bound) & (code < _MOST)  # by rounding of the logarithm
    return code + short.astype(np.uint8)
