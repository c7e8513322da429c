"""The arithmetic of a query, written once for arrays, for single numbers and for the text of a program.

Everything here takes *operations* and coordinates, one value an axis, and combines them as the format says (see the
package). A value is whatever the operations are for: an array of NumPy, one of its scalars, or a piece of C.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add, and_
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr._file import DecodedFile, relative_to_origin
from plr_jax.plr.frame import (
    FRACTION_BITS,
    Frame,
    corner_if_far,
    folding_numbers,
    frame_of,
    mirrored_axes,
    table_corners,
)
from plr_jax.plr.leaves import as_sourced
from plr_jax.plr.tree import Tree

Value: TypeAlias = Any
"""Numbers that add, multiply and compare, or the text of such."""

Point: TypeAlias = list[Value]
"""A point, one value an axis."""


class Operations:
    """What is done with values other than to add, multiply and compare them: of arrays of NumPy.

    Writers of programs do the same with text.
    """

    def let(self, name: str, value: Value) -> Value:
        """The same value, which a program gives a name."""
        return value

    def where(self, condition: Value, yes: Value, no: Value) -> Value:
        """One of two values."""
        return np.where(condition, yes, no)

    def floor(self, x: Value) -> Value:
        """The largest integer that is not offsets, in the precision of the value."""
        return np.floor(x)

    def root(self, x: Value) -> Value:
        """The square root."""
        return np.sqrt(x)

    def rounded(self, x: Value) -> Value:
        """The value in 32 bits."""
        return x.astype(np.float32)

    def fraction(self, x: Value) -> Value:
        """The 23 bits behind the point of a value from 1 to below 2, as an integer."""
        return x.view(np.uint32) & np.uint32((1 << FRACTION_BITS) - 1)


ARRAYS = Operations()


def wrap(do: Operations, x: Value, lo: Value, hi: Value, scale: Value, tolerance: Value) -> Value:
    """A finite coordinate, moved by whole periods to between the ends, the upper of which becomes the lower."""
    turns = do.floor((x - lo) * scale)
    moved = clamp(do, do.let("moved", x - turns * (hi - lo)), lo, hi)
    from_end = x - hi
    is_end = (from_end <= tolerance) & (from_end >= -tolerance)
    return do.let("wrapped", do.where(is_end, lo, moved))


def clamp(do: Operations, x: Value, lo: Value, hi: Value) -> Value:
    """The number between two others that is nearest."""
    return do.where(x < lo, lo, do.where(x > hi, hi, x))


def fraction_along(do: Operations, offset: Value, frame: Value) -> Value:
    """The place along an axis, an integer of 23 bits, so far offsets the lower corner of a frame's column."""
    start, top = frame[Frame.START], frame[Frame.TOP]
    share = do.let("share", offset * frame[Frame.SCALE])
    placed = do.where(share < top, share, top) + start
    if start < 1:
        placed = do.let("placed", placed)
        placed = do.where(placed < 1, np.float32(1), placed)
    return do.fraction(placed)


_TOLERANCE = 2.0**-44


class Program:
    """A query without its points: its steps (see the package), each with its numbers or their names.

    Attributes:
        contents: What the file holds.
        leaf: Its leaf model.
        domain: The domain of the points; that of ``contents`` is of folded ones.
        corner: That of a far domain, from which points are counted in 64 bits; else None.
        precision: Of the points that are asked for at the least: 64 bits in a far domain.
        numbers: What the leaves compute with, in the order of the tree's traversal, without those of cells.
        frame: That of the domain that the leaves partition, as points come to it: counted, or folded.
        window: Least and largest counted coordinates that have an answer; along periodic axes, before they are
            counted.
        periods: Ends of periodic axes, one over the width and a tolerance, in 32 bits.
        double_periods: The same of the domain in 64 bits.
        fold: How counted points are folded: center, and what it leaves; axes, None if they are the domain's; mirrors;
            least and largest coordinates. None if they are not.
    """

    def __init__(self, contents: DecodedFile) -> None:
        """Of a file; raises ``ValueError`` if 32-bit floats cannot hold its numbers."""
        self.contents, self.leaf = contents, contents.leaf
        self.domain = domain = contents.domain if contents.folding is None else contents.folding.domain
        self.dim = domain.dim
        self.corner: Value = corner_if_far(domain)
        self.precision = np.float32 if self.corner is None else np.float64
        origin = np.zeros(self.dim) if self.corner is None else domain.lo
        of_leaves, numbers = relative_to_origin(contents, origin)
        self.leaf_parameters = numbers.astype(np.float32)[:, self.dim * self.leaf.is_cell_relative :]
        self.frame: Value = frame_of(of_leaves)
        self.limits: list[list[Value]] = list(map(list, table_corners(domain.moved(-origin))))
        self.periods, self.double_periods = {}, {}
        for axis in np.flatnonzero(domain.periodic).tolist():
            largest = self.precision(np.finfo(self.precision).max)
            self.limits[0][axis], self.limits[1][axis] = -largest, largest
            column = self.frame[:, axis]
            lo, hi = column[Frame.LO] + column[Frame.LO_REST], column[Frame.HI] - column[Frame.HI_REST]
            self.periods[axis] = lo, hi, column[Frame.SCALE], np.float32(_TOLERANCE) * max(abs(lo), abs(hi))
            lo, hi = domain.lo[axis], domain.hi[axis]
            self.double_periods[axis] = lo, hi, 1 / (hi - lo), np.float64(0)
        self.folding_arrays = None
        if (folding := contents.folding) is not None:
            (center, rest), ends = folding_numbers(folding, origin)
            axes = list(folding.axes.astype(np.float32)) if folding.is_turned else None
            self.folding_arrays = center, rest, axes, mirrored_axes(folding), ends

    def contains(self, do: Operations, x: Point) -> Value:
        """Whether a point has an answer; its precision is :attr:`precision`."""
        tests = []
        for axis, (lo, hi) in enumerate(zip(*self.limits, strict=True)):
            along = x[axis] if self.domain.periodic[axis] else self._relative(do, x, axis)
            tests.append((along >= lo) & (along <= hi))
        return reduce(and_, tests)

    def wrap_in_double(self, do: Operations, x: Point) -> Point:
        """A point of 64 bits, finite along periodic axes, with those wrapped."""
        x = list(x)
        for axis, period in self.double_periods.items():
            x[axis] = wrap(do, x[axis], *period)
        return x

    def relative(self, do: Operations, x: Point) -> Point:
        """A point in 32 bits, in a far domain counted from its corner."""
        return [self._relative(do, x, axis) for axis in range(self.dim)]

    def _relative(self, do: Operations, x: Point, axis: int) -> Value:
        return x[axis] if self.corner is None else do.let("relative", do.rounded(x[axis] - self.corner[axis]))

    def fold_and_wrap(self, do: Operations, x: Point) -> Point:
        """A counted point of the domain, folded and wrapped."""
        x = list(x)
        if self.folding_arrays is not None:
            center, rest, axes, mirrors, ends = self.folding_arrays
            x = [do.let("seen", along - c - r) for along, c, r in zip(x, center, rest, strict=True)]
            if axes is not None:
                x = [do.let("turned", reduce(add, [a * b for a, b in zip(row, x, strict=True)])) for row in axes]
            for pivot, reversed_axes in mirrors:
                is_behind = do.let("is_behind", x[pivot] < 0)
                for axis in reversed_axes:
                    x[axis] = do.let("mirrored", do.where(is_behind, -x[axis], x[axis]))
            for axis, (lo, hi) in enumerate(ends.T):
                if np.isfinite(hi):  # along a periodic axis nothing is clamp
                    x[axis] = do.let("folded", clamp(do, x[axis], lo, hi))
        for axis, period in self.periods.items():
            x[axis] = wrap(do, x[axis], *period)
        return x

    def offsets(self, do: Operations, x: Point) -> Point:
        """How far a placed point is from the domain's rounded lower corner."""
        return [do.let("offset", along - lo) for along, lo in zip(x, self.frame[Frame.LO], strict=True)]

    def fractions(self, do: Operations, offsets: Point) -> list[Value]:
        """Place along each axis."""
        columns = zip(*self.frame, strict=True)
        return [fraction_along(do, offset, column) for offset, column in zip(offsets, columns, strict=True)]

    def value(self, do: Operations, offsets: Point, numbers: Sequence[Value]) -> Value:
        """The value at a placed point of a leaf of given numbers.

        If it is of cells, how many there are along each axis, and which it is, come first.
        """
        if not self.leaf.is_cell_relative:
            return self.leaf.value(numbers, offsets, do.root)
        in_cell = []
        for axis, along in enumerate(offsets):
            share, start = along * self.frame[Frame.SCALE][axis], self.frame[Frame.START][axis]
            if start < 1:
                share = share + (start - np.float32(1))
            in_cell.append(do.let("t", share * numbers[2 * axis] - numbers[2 * axis + 1]))
        return self.leaf.value(numbers[2 * self.dim :], in_cell, do.root)

    def straight_bound(self, do: Operations, above: Point) -> Value | None:
        """The lower bound by the straight line from a placed point to the goal; None if the file has none."""
        certificate = self.contents.certificate
        if certificate is None or certificate.straight is None:
            return None
        *goal, rate, margin = certificate.straight.astype(np.float32)
        changes = [do.let("change", along - to) for along, to in zip(above, goal, strict=True)]
        return do.root(reduce(add, [change * change for change in changes])) * rate - margin

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        """The source of a leaf of given numbers."""
        corner = self.frame[Frame.LO] if self.corner is None else self.corner
        return [lo + along for lo, along in zip(corner, as_sourced(self.leaf).source_of(numbers), strict=True)]


class CodedTree:
    """The nodes of a tree as codes: ``index << bits | kind``, of ``kind_bits`` bits.

    A split node's kind is the axis of its split and its index one of ``children``; a leaf's kind is the number of
    axes, and its index a row of numbers.

    Attributes:
        dim: Number of axes.
        root: Code of the root.
        children: Codes of the lower and upper child of each split node, in the order of levels.
        axis: Along which each is split.
        depth: How often its cell was along that axis before.
        code_type: The smallest type that holds all codes, of 16 or 32 bits.
    """

    def __init__(self, tree: Tree, row_of_leaf: Int[np.ndarray, "leaves"]) -> None:
        """Of a tree whose leaves are rows of a table."""
        dim = tree.cells.dim
        inner = np.flatnonzero(tree.child >= 0)
        index = np.full(len(tree.child), -1)
        index[inner] = np.arange(len(inner))
        index[tree.node_of_leaf] = row_of_leaf
        self.dim, self.kind_bits = dim, dim.bit_length()
        code = (index << self.kind_bits) | np.where(tree.child >= 0, tree.axis, dim)
        self.root, self.children = int(code[0]), code[tree.child[inner][:, None] + np.arange(2)]
        self.axis = tree.axis[inner]
        self.depth = tree.cells.depth[inner, self.axis]
        self.code_type = np.dtype(np.uint16 if code.max() < 2**16 else np.uint32)


def distinct_rows(
    numbers: Float[np.ndarray, "leaves count"],
) -> tuple[Float[np.ndarray, "rows count"], Int[np.ndarray, "leaves"]]:
    """The different rows of 32-bit numbers, in the order in which they come first, and which is each one."""
    _, first, row = np.unique(numbers.view(np.uint32), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return numbers[np.sort(first)], rank[row.ravel()]
