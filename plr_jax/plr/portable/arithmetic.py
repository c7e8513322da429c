"""The arithmetic of a query, written once for arrays, for single numbers and for the text of a program.

Everything here takes *operations* and coordinates, one value an axis, and combines them as the format says (see the
package). A value is whatever the operations are for: an array of NumPy, one of its scalars, or a piece of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float

Value: TypeAlias = Any
"""Numbers that add, multiply and compare, or the text of such."""

Point: TypeAlias = list[Value]
"""A point, one value an axis."""


@runtime_checkable
class Operations(Protocol):
    """What is done with values other than to add, multiply and compare them."""

    def let(self, name: str, value: Value) -> Value:
        """The same value, which a program gives a name."""
        ...

    def where(self, condition: Value, yes: Value, no: Value) -> Value:
        """One of two values."""
        ...

    def floor(self, x: Value) -> Value:
        """The largest integer that is not above, in the precision of the value."""
        ...

    def root(self, x: Value) -> Value:
        """The square root."""
        ...

    def rounded(self, x: Value) -> Value:
        """The value in 32 bits."""
        ...

    def fraction(self, x: Value) -> Value:
        """The 23 bits behind the point of a value from 1 to below 2, as an integer."""
        ...


@dataclass(frozen=True)
class Period:
    """The ends of a periodic axis, as 32-bit or 64-bit numbers."""

    lo: Any
    hi: Any
    scale: Any
    tolerance: Any

    def wrapped(self, do: Operations, x: Value) -> Value:
        """A finite coordinate, moved by whole periods to between the ends, the upper of which becomes the lower."""
        turns = do.floor((x - self.lo) * self.scale)
        moved = do.let("moved", x - turns * (self.hi - self.lo))
        moved = do.where(moved < self.lo, self.lo, do.where(moved > self.hi, self.hi, moved))
        from_end = x - self.hi
        is_end = (from_end <= self.tolerance) & (from_end >= -self.tolerance)
        return do.let("wrapped", do.where(is_end, self.lo, moved))


@dataclass(frozen=True)
class Fold:
    """How points are folded, as 32-bit numbers.

    Attributes:
        center: From where points are seen, one number an axis.
        rest: What that leaves of the center.
        axes: The axes of folded coordinates, one a row; None if they are those of the domain.
        mirrors: For each mirror its pivot, and the axes that it reverses.
        lo: The least folded coordinates; infinite along periodic axes.
        hi: The largest.
    """

    center: Sequence[Any]
    rest: Sequence[Any]
    axes: list[Float[np.ndarray, "dim"]] | None
    mirrors: tuple[tuple[int, tuple[int, ...]], ...]
    lo: Sequence[Any]
    hi: Sequence[Any]

    def folded(self, do: Operations, x: Point) -> Point:
        """The folded point."""
        z = [do.let("seen", along - c - rest) for along, c, rest in zip(x, self.center, self.rest, strict=True)]
        if self.axes is not None:
            z = [do.let("turned", total([a * b for a, b in zip(row, z, strict=True)])) for row in self.axes]
        for pivot, reversed_axes in self.mirrors:
            is_behind = do.let("is_behind", z[pivot] < 0)
            for axis in reversed_axes:
                z[axis] = do.let("mirrored", do.where(is_behind, -z[axis], z[axis]))
        for axis, (lo, hi) in enumerate(zip(self.lo, self.hi, strict=True)):
            if np.isfinite(hi):
                z[axis] = do.let("folded", do.where(z[axis] < lo, lo, do.where(z[axis] > hi, hi, z[axis])))
        return z


@dataclass(frozen=True)
class PartitionedAxis:
    """The domain that leaves partition, along one axis, in 32-bit numbers, or their names: see :class:`Frame`."""

    lo: Any
    scale: Any
    start: Any
    top: Any

    def above(self, x: Value) -> Value:
        """How far a coordinate is from the domain's rounded lower corner."""
        return x - self.lo

    def place(self, do: Operations, above: Value) -> Value:
        """The place of that, as an integer of 23 bits."""
        share = do.let("share", above * self.scale)
        placed = do.where(share < self.top, share, self.top) + self.start
        if self.start < 1:
            placed = do.let("placed", placed)
            placed = do.where(placed < 1, np.float32(1), placed)
        return do.fraction(placed)

    def in_cell(self, do: Operations, above: Value, count: Value, position: Value) -> Value:
        """Coordinate, from 0 to 1, in the cell of that position among so many."""
        share = above * self.scale
        if self.start < 1:
            share = share + (self.start - np.float32(1))
        return do.let("t", share * count - position)


@dataclass(frozen=True)
class Window:
    """The closed domain, along one axis: which coordinates have an answer, in the precision of points."""

    lo: Any
    hi: Any

    def contains(self, x: Value) -> Value:
        """Whether a coordinate, which is NaN or not, is inside."""
        return (x >= self.lo) & (x <= self.hi)

    def limited(self, do: Operations, x: Value) -> Value:
        """The coordinate of the domain that is nearest."""
        return do.where(x < self.lo, self.lo, do.where(x > self.hi, self.hi, x))


def total(terms: Sequence[Value]) -> Value:
    """Their sum from left to right."""
    value, *others = terms
    for other in others:
        value = value + other
    return value


def length(do: Operations, z: Point, axes: Sequence[int]) -> Value:
    """The root of the sum of some coordinates' squares."""
    return do.root(total([z[axis] * z[axis] for axis in axes]))


def all_of(conditions: Sequence[Value]) -> Value:
    """Whether all of them hold."""
    holds, *others = conditions
    for other in others:
        holds = holds & other
    return holds
