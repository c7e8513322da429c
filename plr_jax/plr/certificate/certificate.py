"""A proof as a file keeps it: the largest error, and bounds of leaves.

As bits, after the leaves:

    largest error, a 32-bit float, negative where classes of leaves have bounds, which then follow (``classes.py``)
    where each leaf has bounds: codes of all lower ones, then of all upper ones, 8 bits each

A bound is ``scale * 2**((code - 255) / 12)``, below or above what the leaf holds: a code more is 6 % more, and
the smallest is 4e-7 of the largest. All of them are rounded away from zero.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Float, Integer, UInt8

from plr_jax.plr.certificate.bounds import LEAST_OF_LARGEST, LeafBounds
from plr_jax.plr.certificate.classes import distinct, in_classes, in_these_classes, read_classes, write_classes
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.query.frame import LARGEST

_CODE_BITS, _MOST, _CODES_A_DOUBLING = 8, 255, 12
_A_CODE = 2.0 ** (1 / _CODES_A_DOUBLING)
_MAX_ERROR_BITS = 32
_BYTES_A_BIT, _LEAST_BITS = 16, 80  # of leaves, for each bit of classes: a 128th; with fewer bits there are none


class Proof(IntEnum):
    """What a file keeps of a proof; the numbers are those in files."""

    NONE = 0
    CLASSES = 1
    """Of classes of leaves; of all of them, the largest error alone, where there is no room for more."""
    LEAVES = 2
    OPEN_LEAVES = 3
    """Of leaves, some of which have no upper bound."""

    def num_bits(self, num_leaves: int, num_bytes: int) -> int:
        """Most bits that it takes, of leaves that take so many bytes."""
        of_leaves = _MAX_ERROR_BITS + 2 * _CODE_BITS * num_leaves
        return (0, _MAX_ERROR_BITS + _room_for_classes(num_bytes), of_leaves, of_leaves)[self]


def _room_for_classes(num_bytes: int) -> int:
    return bits if (bits := num_bytes // _BYTES_A_BIT) >= _LEAST_BITS else 0


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds of the distance minus what a PLR answers.

    Attributes:
        scale: Of the codes: the largest bound there is; exact in 32 bits.
        codes: How far below each leaf's function the distance may be, and above; None if only the scale is kept.
        proof: What of it is kept. Of open leaves the largest code of an upper bound says that there is none.
    """

    scale: float
    codes: UInt8[np.ndarray, "2 leaves"] | None
    proof: Proof

    @staticmethod
    def of(
        bounds: LeafBounds,
        rounding: Float[np.ndarray, "leaves"],
        proof: Proof,
        volume: Float[np.ndarray, "leaves"] | float = 1.0,
        num_bytes: int = 0,
        before: "Certificate | None" = None,
    ) -> "Certificate":
        """The certificate of bounds, and of what queries round; upper ones may be ``inf`` for open leaves.

        Classes are those of a certificate before, if these will do; else they are chosen for a small mean width over
        leaves of such volumes, which take so many bytes.
        """
        lower, upper = np.maximum(rounding - bounds.lower, 0.0), np.maximum(rounding + bounds.upper, 0.0)
        is_open = np.isinf(upper)
        largest = max(lower.max(), upper[~is_open].max(initial=0.0), np.finfo(np.float32).tiny)
        if proof is Proof.OPEN_LEAVES:
            largest *= 2.0 ** (1.1 / _CODES_A_DOUBLING)  # so that no bound has the largest code
        scale = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
        codes = np.stack([_codes(lower, scale), _codes(np.where(is_open, scale, upper), scale)])
        if proof is Proof.CLASSES:
            room, factor = _room_for_classes(num_bytes), _of_codes(np.arange(_MOST + 1), 1.0)
            found = None
            if before is not None and before.codes is not None and largest <= before.scale < largest * _A_CODE:
                of_scale = np.stack([_codes(lower, before.scale), _codes(upper, before.scale)])
                found = in_these_classes(of_scale, distinct(before.codes), factor, room)
                scale = scale if found is None else before.scale
            if found is None:
                found = in_classes(codes, factor, np.broadcast_to(volume, lower.shape), room)
            codes = None if (found == found[:, :1]).all() else found
        return Certificate(scale, codes, proof)

    @property
    def max_error(self) -> float:
        """Of the largest error anywhere; ``inf`` if a leaf has no upper bound."""
        return float("inf") if np.isinf(self.bounds()).any() else self.scale

    def bounds(self) -> Float[np.ndarray, "2 leaves_or_one"]:
        """What is to be added to answers for lower and upper bounds, exact in 32 bits: of each leaf, or of all."""
        if self.codes is None:
            return np.array([[-self.scale], [self.scale]])
        lower, upper = _of_codes(self.codes, self.scale)
        if self.proof is Proof.OPEN_LEAVES:
            upper[self.codes[1] == _MOST] = np.inf
        return np.stack([-lower, upper])

    @cached_property
    def _classes(self) -> Float[np.ndarray, "2 classes"]:
        """Bounds of all classes, the narrowest first."""
        bounds = self.bounds() if self.codes is None else replace(self, codes=distinct(self.codes)).bounds()
        return bounds[:, np.argsort(bounds[1] - bounds[0], kind="stable")]

    def enough(
        self,
        least: Float[np.ndarray, "leaves"],
        most: Float[np.ndarray, "leaves"],
        rounding: Float[np.ndarray, "leaves"],
    ) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves"]]:
        """Bounds of leaves than which better ones are not needed, given errors that are met.

        Those of the narrowest class that holds these, less what queries round; or such as are off by little of the
        largest error of all.
        """
        spare = LEAST_OF_LARGEST * self.scale
        least, most = least - spare, most + spare
        if self.proof is not Proof.CLASSES:
            return least, most
        lower, upper = self._classes
        holds = (least + spare - rounding >= lower[:, None]) & (most - spare + rounding <= upper[:, None])
        place, is_held = holds.argmax(axis=0), holds.any(axis=0)
        low, high = (np.where(is_held, each[place], 0.0) for each in (lower, upper))
        return np.minimum(least, low + rounding), np.maximum(most, high - rounding)

    def write(self, body: BitWriter) -> None:
        """Append it to a file."""
        classes = self.codes if self.proof is Proof.CLASSES else None
        body.write_floats(np.array([self.scale if classes is None else -self.scale]))
        if classes is not None:
            write_classes(body, classes)
        elif self.codes is not None:
            body.write(self.codes.ravel().astype(np.int64), _CODE_BITS)


def read_certificate(body: BitReader, proof: Proof, num_leaves: int) -> Certificate | None:
    """What :meth:`Certificate.write` appended; raises ``ValueError`` saying what is wrong with it."""
    if proof is Proof.NONE:
        return None
    scale, codes = float(body.read_floats(1)[0]), None
    if not 0 < (abs(scale) if proof is Proof.CLASSES else scale) < LARGEST:
        raise ValueError(f"it states a largest error of {scale}")
    if scale < 0:
        codes = read_classes(body, num_leaves)
    elif proof is not Proof.CLASSES:
        codes = body.read_alike(2 * num_leaves, _CODE_BITS).reshape(2, num_leaves)
    return Certificate(abs(scale), None if codes is None else codes.astype(np.uint8), proof)


def _of_codes(code: Integer[np.ndarray, "*n"], scale: float) -> Float[np.ndarray, "*n"]:
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
