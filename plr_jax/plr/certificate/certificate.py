"""A proof as a file keeps it: the largest error, and bounds of every leaf in 8 bits each.

As bits, after the leaves:

    largest error, a 32-bit float
    where each leaf has bounds: codes of all lower ones, then of all upper ones, 8 bits each

A bound is ``max_error * 2**((code - 255) / 12)``, below or above what the leaf holds: a code more is 6 % more, and
the smallest is 4e-7 of the largest. All of them are rounded away from zero.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, UInt8

from plr_jax.plr.certificate.branch_and_bound import LeafBounds
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.query.tables import LARGEST

_CODE_BITS, _MOST, _CODES_A_DOUBLING = 8, 255, 12
_MAX_ERROR_BITS = 32


class Proof(IntEnum):
    """What a file keeps of a proof; the numbers are those in files."""

    NONE = 0
    LARGEST = 1
    LEAVES = 2

    def num_bits(self, num_leaves: int) -> int:
        """Bits that it takes."""
        return (0, _MAX_ERROR_BITS, _MAX_ERROR_BITS + 2 * _CODE_BITS * num_leaves)[self]


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds of the distance minus what a PLR answers.

    Attributes:
        max_error: Of the largest error anywhere; exact in 32 bits.
        lower: Codes of how far below each leaf's function the distance may be; None if they are not kept.
        upper: The same above.
    """

    max_error: float
    lower: UInt8[np.ndarray, "leaves"] | None
    upper: UInt8[np.ndarray, "leaves"] | None

    @staticmethod
    def of(bounds: LeafBounds, rounding: Float[np.ndarray, "leaves"], proof: Proof) -> "Certificate":
        """The certificate of bounds, and of what queries round."""
        lower, upper = np.maximum(rounding - bounds.lower, 0.0), np.maximum(rounding + bounds.upper, 0.0)
        largest = max(lower.max(), upper.max(), np.finfo(np.float32).tiny)
        max_error = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
        if proof is Proof.LARGEST:
            return Certificate(max_error, None, None)
        return Certificate(max_error, _codes(lower, max_error), _codes(upper, max_error))

    @property
    def proof(self) -> Proof:
        """What of it is kept."""
        return Proof.LARGEST if self.lower is None else Proof.LEAVES

    def bounds(self) -> Float[np.ndarray, "2 leaves_or_one"]:
        """What is to be added to answers for lower and upper bounds, exact in 32 bits: of each leaf, or of all."""
        if self.lower is None or self.upper is None:
            return np.array([[-self.max_error], [self.max_error]])
        return np.stack([-_of_codes(self.lower, self.max_error), _of_codes(self.upper, self.max_error)])

    def write(self, body: BitWriter) -> None:
        """Append it to a file."""
        body.write_floats(np.array([self.max_error]))
        for codes in (self.lower, self.upper):
            if codes is not None:
                body.write(codes.astype(np.int64), _CODE_BITS)


def read_certificate(body: BitReader, proof: Proof, num_leaves: int) -> Certificate | None:
    """What :meth:`Certificate.write` appended; raises ``ValueError`` saying what is wrong with it."""
    if proof is Proof.NONE:
        return None
    max_error = float(body.read_floats(1)[0])
    if not 0 < max_error < LARGEST:
        raise ValueError(f"it states a largest error of {max_error}")
    if proof is Proof.LARGEST:
        return Certificate(max_error, None, None)
    lower, upper = (body.read_alike(num_leaves, _CODE_BITS).astype(np.uint8) for _ in range(2))
    return Certificate(max_error, lower, upper)


def _of_codes(code: UInt8[np.ndarray, "leaves"], max_error: float) -> Float[np.ndarray, "leaves"]:
    """Bounds of codes, as 32-bit floats that are not below them."""
    exact = max_error * 2.0 ** ((code.astype(np.float64) - _MOST) / _CODES_A_DOUBLING)
    return np.nextafter(exact.astype(np.float32), np.float32(np.inf)).astype(np.float64)


def _codes(bound: Float[np.ndarray, "leaves"], max_error: float) -> UInt8[np.ndarray, "leaves"]:
    """The smallest codes whose bounds are not below."""
    with np.errstate(divide="ignore"):
        code = np.ceil(_MOST + _CODES_A_DOUBLING * np.log2(bound / max_error))
    code = np.clip(code, 0, _MOST).astype(np.uint8)
    short = (_of_codes(code, max_error) < bound) & (code < _MOST)  # by rounding of the logarithm
    return code + short.astype(np.uint8)
