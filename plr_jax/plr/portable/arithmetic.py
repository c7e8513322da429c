"""The arithmetic of a query, written once for arrays, for single numbers and for the text of a program.

Everything here takes *operations* and coordinates, one value an axis, and combines them as the format says (see the
package). A value is whatever the operations are for: an array of NumPy, one of its scalars, or a piece of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.box import Box
from plr_jax.plr._file import Contents, counted_from, decode
from plr_jax.plr.frame import Corner, Frame, corner_if_far, folding_numbers, frame_of, mirrored_axes, table_corners
from plr_jax.plr.leaves.base import LeafModel, as_sourced
from plr_jax.plr.tree import Cells, Level, tree_of_levels

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


def all_of(conditions: Sequence[Value]) -> Value:
    """Whether all of them hold."""
    holds, *others = conditions
    for other in others:
        holds = holds & other
    return holds


_TOLERANCE = 2.0**-44
_LARGEST_OF = {np.float32: np.finfo(np.float32).max, np.float64: np.finfo(np.float64).max}


@dataclass(frozen=True, eq=False)
class Program:
    """A query without its points: its steps (see the package), each with its numbers.

    Attributes:
        contents: What the file holds.
        domain: The domain of the points; that of ``contents`` is of folded ones.
        corner: That of a far domain, from which points are counted in 64 bits; else None.
        of_leaves: The domain that the leaves partition, as points come to it: counted, or folded.
        numbers: What the leaves compute with, in the order of the tree's traversal.
    """

    contents: Contents
    domain: Box
    corner: Corner | None
    of_leaves: Box
    numbers: Float[np.ndarray, "leaves count"]

    @staticmethod
    def of_file(data: bytes) -> "Program":
        """The program of a file; raises ``ValueError`` saying what is wrong with that."""
        contents = decode(data)
        domain = contents.domain if contents.folding is None else contents.folding.domain
        corner = corner_if_far(domain)
        of_leaves, numbers = counted_from(contents, np.zeros(domain.dim) if corner is None else corner)
        return Program(contents, domain, corner, of_leaves, numbers.astype(np.float32))

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.domain.dim

    @property
    def leaf(self) -> LeafModel:
        """The leaf model."""
        return self.contents.leaf

    @property
    def cells(self) -> Cells:
        """Cells of the leaves, in the order of the tree's traversal."""
        return self.contents.cells

    @property
    def precision(self) -> type[np.float32] | type[np.float64]:
        """Of the points that are asked for at the least: 64 bits in a far domain."""
        return np.float32 if self.corner is None else np.float64

    @property
    def origin(self) -> Corner:
        """From where points are counted: the corner, or 0."""
        return np.zeros(self.dim) if self.corner is None else self.corner

    @cached_property
    def frame(self) -> Float[np.ndarray, "7 dim"]:
        """That of the domain that the leaves partition."""
        return frame_of(self.of_leaves)

    @cached_property
    def axes(self) -> list[PartitionedAxis]:
        """The domain that the leaves partition, axis by axis."""
        return partitioned_axes(self.frame)

    @cached_property
    def windows(self) -> list[Window]:
        """Where counted points have an answer, axis by axis; along periodic axes, before they are counted."""
        corners = np.stack(table_corners(self.domain.moved(-self.origin)))
        windows = [Window(*corners[:, axis]) for axis in range(self.dim)]
        for axis in np.flatnonzero(self.domain.periodic):
            largest = self.precision(_LARGEST_OF[self.precision])
            windows[axis] = Window(-largest, largest)
        return windows

    @cached_property
    def periods(self) -> dict[int, Period]:
        """The ends of periodic axes, in 32 bits."""
        frame, periods = self.frame, {}
        for axis in np.flatnonzero(self.domain.periodic).tolist():
            lo = frame[Frame.LO, axis] + frame[Frame.LO_REST, axis]
            hi = frame[Frame.HI, axis] - frame[Frame.HI_REST, axis]
            tolerance = np.float32(_TOLERANCE) * max(abs(lo), abs(hi))
            periods[axis] = Period(lo, hi, frame[Frame.SCALE, axis], tolerance)
        return periods

    @cached_property
    def wide_periods(self) -> dict[int, Period]:
        """The ends of periodic axes of the domain, in 64 bits."""
        lo, hi, zero = self.domain.lo, self.domain.hi, np.float64(0)
        axes = np.flatnonzero(self.domain.periodic).tolist()
        return {axis: Period(lo[axis], hi[axis], 1 / (hi[axis] - lo[axis]), zero) for axis in axes}

    @cached_property
    def fold(self) -> Fold | None:
        """How counted points are folded; None if they are not."""
        folding = self.contents.folding
        if folding is None:
            return None
        (center, rest), (lo, hi) = folding_numbers(folding, self.origin)
        axes = list(folding.axes.astype(np.float32)) if folding.is_turned else None
        return Fold(list(center), list(rest), axes, mirrored_axes(folding), list(lo), list(hi))

    def contains(self, do: Operations, x: Point) -> Value:
        """Whether a point has an answer; its precision is :attr:`precision`."""
        tests = []
        for axis, window in enumerate(self.windows):
            along = x[axis] if self.domain.periodic[axis] else self._counted(do, x, axis)
            tests.append(window.contains(along))
        return all_of(tests)

    def wrapped_wide(self, do: Operations, x: Point) -> Point:
        """A point of 64 bits, finite along periodic axes, with those wrapped."""
        x = list(x)
        for axis, period in self.wide_periods.items():
            x[axis] = period.wrapped(do, x[axis])
        return x

    def counted(self, do: Operations, x: Point) -> Point:
        """A point in 32 bits, in a far domain counted from its corner."""
        return [self._counted(do, x, axis) for axis in range(self.dim)]

    def _counted(self, do: Operations, x: Point, axis: int) -> Value:
        return x[axis] if self.corner is None else do.let("counted", do.rounded(x[axis] - self.corner[axis]))

    def nearest(self, do: Operations, x: Point) -> Point:
        """The point of the domain that is nearest to a finite one; both are counted."""
        ends = zip(x, self.windows, self.domain.periodic, strict=True)
        return [along if is_periodic else window.limited(do, along) for along, window, is_periodic in ends]

    def placed(self, do: Operations, x: Point) -> Point:
        """A counted point of the domain, folded and wrapped."""
        x = list(x) if self.fold is None else self.fold.folded(do, x)
        for axis, period in self.periods.items():
            x[axis] = period.wrapped(do, x[axis])
        return x

    def above(self, do: Operations, x: Point) -> Point:
        """How far a placed point is from the domain's rounded lower corner."""
        return [do.let("above", grid.above(along)) for grid, along in zip(self.axes, x, strict=True)]

    def places(self, do: Operations, above: Point) -> list[Value]:
        """Place along each axis."""
        return [grid.place(do, along) for grid, along in zip(self.axes, above, strict=True)]

    def value(
        self, do: Operations, x: Point, above: Point, numbers: Sequence[Value], cell: Sequence[tuple[Value, Value]]
    ) -> Value:
        """The value at a placed point of a leaf of given numbers and, if it is of cells, how many and which it is."""
        place = above
        if self.leaf.is_of_cells:
            along = zip(self.axes, above, cell, strict=True)
            place = [grid.in_cell(do, a, count, position) for grid, a, (count, position) in along]
        return self.leaf.value(numbers, place, do.root)

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        """The source of a leaf of given numbers."""
        corner = self.frame[Frame.LO] if self.corner is None else self.corner
        return [lo + along for lo, along in zip(corner, as_sourced(self.leaf).source_of(numbers), strict=True)]

    @property
    def numbers_of_leaves(self) -> Float[np.ndarray, "leaves count"]:
        """The numbers without those of cells."""
        return self.numbers[:, self.dim * self.leaf.is_of_cells :]

    def coded_tree(self, row_of_leaf: Int[np.ndarray, "leaves"]) -> "CodedTree":
        """The tree, whose leaves are rows of a table."""
        return CodedTree.of(self.contents.levels, self.dim, row_of_leaf)


def distinct_rows(
    numbers: Float[np.ndarray, "leaves count"],
) -> tuple[Float[np.ndarray, "rows count"], Int[np.ndarray, "leaves"]]:
    """The different rows of 32-bit numbers, in the order in which they come first, and which is each one."""
    _, first, row = np.unique(numbers.view(np.uint32), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return numbers[np.sort(first)], rank[row.ravel()]


def partitioned_axes(frame: Float[np.ndarray, "7 dim"]) -> list[PartitionedAxis]:
    """The domain of a frame that leaves partition, axis by axis."""
    rows = [Frame.LO, Frame.SCALE, Frame.START, Frame.TOP]
    return [PartitionedAxis(*along) for along in frame[rows].T]


@dataclass(frozen=True, eq=False)
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
    """

    dim: int
    root: int
    children: Int[np.ndarray, "splits 2"]
    axis: Int[np.ndarray, "splits"]
    depth: Int[np.ndarray, "splits"]

    @staticmethod
    def of(levels: list[Level], dim: int, row_of_leaf: Int[np.ndarray, "leaves"]) -> "CodedTree":
        """That of levels, whose leaves are rows of a table."""
        tree = tree_of_levels(levels, dim)
        inner = np.flatnonzero(tree.child >= 0)
        index = np.full(len(tree.child), -1)
        index[inner] = np.arange(len(inner))
        index[tree.node_of_leaf] = row_of_leaf
        code = (index << dim.bit_length()) | np.where(tree.child >= 0, tree.axis, dim)
        children = code[tree.child[inner][:, None] + np.arange(2)]
        return CodedTree(dim, int(code[0]), children, tree.axis[inner], tree.cells.depth[inner, tree.axis[inner]])

    @property
    def kind_bits(self) -> int:
        """Bits of a kind."""
        return self.dim.bit_length()

    @property
    def code_type(self) -> np.dtype:
        """The smallest that holds all codes, of 16 or 32 bits."""
        return np.dtype(np.uint16 if max(self.root, self.children.max(initial=0)) < 2**16 else np.uint32)
