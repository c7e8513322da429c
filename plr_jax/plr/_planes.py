"""Planes as they are stored: 32-bit floats, or integers of one step and no more bits than they need.

In the local coordinates of its cell (``[-1, 1]`` along every axis) a plane is its value at the center and its
half-differences, ``L(u) = center + half . u``. As integers, all are multiples of one ``step``. A half-difference
shrinks with its cell, so one at depth ``d`` along an axis needs ``d`` bits fewer: the file keeps a width for each
axis and depth. Rounding moves a plane by at most ``(1 + dim) * step / 2`` anywhere in its cell.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Num

FLOAT_BITS = 32
MIN_BITS, MAX_BITS = 4, 20


@dataclass(frozen=True, eq=False)
class StoredPlanes:
    """Planes exactly as in the file; a query's tables are derived from nothing else.

    Attributes:
        bits: Width of a center value: ``FLOAT_BITS`` for floats, else ``MIN_BITS`` to ``MAX_BITS``.
        offset: Value of center 0 (0 for floats).
        step: Value of one unit (1 for floats).
        center: Center values; ``blocked_code`` marks a leaf none of whose samples reaches the goal.
        half: Half-differences along each axis.
    """

    bits: int
    offset: float
    step: float
    center: Num[np.ndarray, "leaves"]
    half: Num[np.ndarray, "leaves dim"]

    @property
    def blocked(self) -> Bool[np.ndarray, "leaves"]:
        """Which leaves have no sample that reaches the goal."""
        return self.center == blocked_code(self.bits)

    def decode(self) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        """Center values (``inf`` for blocked leaves) and half-differences, in the unit of distance."""
        center = np.where(self.blocked, np.inf, self.offset + self.step * self.center.astype(np.float64))
        return center, self.step * self.half.astype(np.float64)

    def __getitem__(self, index) -> "StoredPlanes":
        return StoredPlanes(self.bits, self.offset, self.step, self.center[index], self.half[index])


def blocked_code(bits: int) -> int | float:
    """The center value that marks a blocked leaf."""
    return np.inf if bits == FLOAT_BITS else (1 << bits) - 1


def encode_planes(
    center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"], bits: int
) -> StoredPlanes:
    """Round planes to what a file holds; a center of ``inf`` marks a blocked leaf."""
    blocked = ~np.isfinite(center)
    half = np.where(blocked[:, None], 0.0, half)
    if bits == FLOAT_BITS:
        return StoredPlanes(bits, 0.0, 1.0, center.astype(np.float32), half.astype(np.float32))
    offset, step = _offset_and_step(center[~blocked], half[~blocked], bits)
    code = np.rint((np.where(blocked, offset, center) - offset) / step)
    code = np.where(blocked, blocked_code(bits), np.clip(code, 0, blocked_code(bits) - 1))
    return StoredPlanes(bits, offset, step, code.astype(np.int32), np.rint(half / step).astype(np.int32))


def half_widths(half: Int[np.ndarray, "leaves dim"], depth: Int[np.ndarray, "leaves dim"]) -> list[list[int]]:
    """Bits of a signed half-difference, by axis and depth; 0 where all are zero."""
    widths = []
    for axis in range(half.shape[1]):
        largest = np.zeros(depth[:, axis].max() + 1, np.int64)
        np.maximum.at(largest, depth[:, axis], np.abs(half[:, axis].astype(np.int64)))
        widths.append([int(value).bit_length() + 1 if value else 0 for value in largest])
    return widths


def _offset_and_step(
    center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"], bits: int
) -> tuple[float, float]:
    """Smallest center and the step that spans the largest, both exact in float32 so that a file holds them."""
    offset = np.nextafter(np.float32(center.min()), np.float32(-np.inf))
    spread = max(center.max() - float(offset), np.abs(half).max(initial=0.0) * 2**-8)
    step = np.nextafter(np.float32(spread / (blocked_code(bits) - 1)), np.float32(np.inf))
    return float(offset), float(step)
