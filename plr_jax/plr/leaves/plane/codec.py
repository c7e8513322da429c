"""Planes as they are stored: 32-bit floats, or integers of one step and no more bits than they need.

In the local coordinates of its cell (``[-1, 1]`` along every axis) a plane is its value at the center and its
half-differences, ``L(u) = center + half . u``. As integers, all are multiples of one ``step``. A half-difference
shrinks with its cell, so one at depth ``d`` along an axis needs ``d`` bits fewer: the file keeps a width for each
axis and depth. Rounding moves a plane by at most ``(1 + dim) * step / 2`` anywhere in its cell.

What a file keeps of the leaves, as bits:

    bits of a center value, in 6 bits; 32 means 32-bit floats
    offset and step as 32-bit floats; nothing where the centers are floats
    for every axis, for every depth from 0 to the deepest of the leaves along it: the width of a half-difference in 6
      bits
    center of every leaf; all bits set (floats: inf) mark a leaf without a reachable sample
    for every axis, the half-difference of every other leaf: a two's-complement number (or a float's bit pattern) of
      the width that belongs to the leaf's depth along the axis

A plane is ``offset + step * center + step * half . u``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.file.bits import BitReader, BitWriter, floats_of_bits
from plr_jax.plr.query.frame import LARGEST

FLOAT_BITS = 32
MIN_BITS, MAX_BITS = 4, 20
_FLOAT_INF = 0x7F800000
_BITS_BITS, _WIDTH_BITS = 6, 6


@dataclass(frozen=True, eq=False)
class StoredPlanes:
    """Planes exactly as in the file; a query's tables are derived from nothing else.

    Center and half-differences are codes of so many bits, the latter with a sign; of floats the bit patterns, with
    offset 0 and step 1. ``unreachable_code`` marks a leaf none of whose samples reaches the goal.
    """

    bits: int
    offset: float
    step: float
    center: Int[np.ndarray, "leaves"]
    half: Int[np.ndarray, "leaves dim"]

    @property
    def unreachable(self) -> Bool[np.ndarray, "leaves"]:
        """Which leaves have no sample that reaches the goal."""
        return self.center == unreachable_code(self.bits)

    def widths(self, depth: Int[np.ndarray, "leaves dim"]) -> list[Int[np.ndarray, "levels"]]:
        """Bits of a half-difference, its sign included, by axis and depth; 0 where all are zero."""
        widths = []
        for axis, deepest in enumerate(depth.max(axis=0)):
            largest = np.zeros(deepest + 1, np.int64)
            np.maximum.at(largest, depth[:, axis], np.abs(self.half[:, axis]))
            bits = np.frexp(largest)[1] + (largest > 0)
            widths.append(np.full_like(largest, FLOAT_BITS) if self.bits == FLOAT_BITS else bits.astype(np.int64))
        return widths

    def decode(self) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        """Center values (``inf`` for unreachable leaves) and half-differences, in the unit of distance."""
        if self.bits == FLOAT_BITS:
            return floats_of_bits(self.center), floats_of_bits(self.half)
        center = np.where(self.unreachable, np.inf, self.offset + self.step * self.center)
        return center, self.step * self.half

    def __getitem__(self, index) -> "StoredPlanes":
        return StoredPlanes(self.bits, self.offset, self.step, self.center[index], self.half[index])


def unreachable_code(bits: int) -> int:
    """The center that marks an unreachable leaf: for floats the bit pattern of ``inf``."""
    return _FLOAT_INF if bits == FLOAT_BITS else (1 << bits) - 1


def encode_planes(
    center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"], bits: int
) -> StoredPlanes:
    """Round planes to what a file holds; a center of ``inf`` marks an unreachable leaf."""
    reachable = np.isfinite(center)
    if max(np.abs(center[reachable]).max(initial=0.0), np.abs(half[reachable]).max(initial=0.0)) > LARGEST:
        raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
    half = np.where(reachable[:, None], half, 0.0)
    if bits == FLOAT_BITS:
        return StoredPlanes(bits, 0.0, 1.0, _bits_of_float(center) & 0xFFFFFFFF, _bits_of_float(half))
    offset, step = _offset_and_step(center[reachable], half, bits)
    code = np.rint((np.where(reachable, center, offset) - offset) / step)
    code = np.where(reachable, np.clip(code, 0, unreachable_code(bits) - 1), unreachable_code(bits))
    return StoredPlanes(bits, offset, step, code.astype(np.int64), np.rint(half / step).astype(np.int64))


def _offset_and_step(
    center: Float[np.ndarray, "reachable"], half: Float[np.ndarray, "leaves dim"], bits: int
) -> tuple[float, float]:
    """Smallest center and the step that spans the largest, both exact in float32 so that a file holds them.

    A step is not so small that a half-difference would need more than ``bits + 9`` bits.
    """
    offset = np.nextafter(np.float32(center.min()), np.float32(-np.inf))
    spread = max(center.max() - float(offset), np.abs(half).max(initial=0.0) * 2**-8)
    step = np.nextafter(np.float32(spread / (unreachable_code(bits) - 1)), np.float32(np.inf))
    return float(offset), float(step)


def _bits_of_float(values: Float[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    return values.astype(np.float32).view(np.int32).astype(np.int64)


def write_planes(body: BitWriter, depth: Int[np.ndarray, "leaves dim"], planes: StoredPlanes) -> None:
    """Append planes of leaves of the given depths."""
    widths, stored = planes.widths(depth), ~planes.unreachable
    body.write(np.array([planes.bits]), _BITS_BITS)
    if planes.bits != FLOAT_BITS:
        body.write_floats(np.array([planes.offset, planes.step]))
    for axis_widths in widths:
        body.write(axis_widths, _WIDTH_BITS)
    body.write(planes.center, planes.bits)
    for axis, axis_widths in enumerate(widths):
        width = axis_widths[depth[stored, axis]]
        body.write(planes.half[stored, axis] & ((1 << width) - 1), width)


def read_planes(body: BitReader, depth: Int[np.ndarray, "leaves dim"]) -> StoredPlanes:
    """The next planes, of leaves of the given depths; raises ``ValueError`` saying what is wrong with them."""
    bits, offset, step = int(body.read_alike(1, _BITS_BITS)[0]), 0.0, 1.0
    if not (bits == FLOAT_BITS or MIN_BITS <= bits <= MAX_BITS):
        raise ValueError(f"it states {bits}-bit values")
    if bits != FLOAT_BITS:
        offset, step = body.read_floats(2).tolist()
        if not (np.isfinite(offset) and 0 < step < np.inf):
            raise ValueError(f"it states a step of {step} from {offset}")
    widths = [body.read_alike(int(deepest) + 1, _WIDTH_BITS) for deepest in depth.max(axis=0)]
    if max(axis_widths.max() for axis_widths in widths) > FLOAT_BITS:
        raise ValueError(f"it states numbers of more than {FLOAT_BITS} bits")
    center = body.read_alike(len(depth), bits)
    half = np.zeros(depth.shape, np.int64)
    stored = center != unreachable_code(bits)
    for axis, axis_widths in enumerate(widths):
        width = axis_widths[depth[stored, axis]]
        code = body.read(width)
        half[stored, axis] = code - np.where(code >= (1 << width) / 2, 1 << width, 0)
    return StoredPlanes(bits, offset, step, center, half)


def planes_bits(depth: Int[np.ndarray, "leaves dim"], planes: StoredPlanes) -> int:
    """How many bits ``write_planes`` appends."""
    stored = ~planes.unreachable
    bits = _BITS_BITS + (0 if planes.bits == FLOAT_BITS else 64) + len(depth) * planes.bits
    for axis, widths in enumerate(planes.widths(depth)):
        bits += _WIDTH_BITS * len(widths) + widths[depth[stored, axis]].sum()
    return int(bits)
