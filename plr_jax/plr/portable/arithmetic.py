"""The arithmetic of a PLR query, written once for NumPy and for generated code in other languages.

Functions take the operations as an argument ``do``. :class:`Operations` computes with NumPy arrays and scalars; an
emitter (``writers.py``) returns expressions of another language. ``FORMAT.md`` prescribes the order of operations.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add, and_, mul
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr._file import DecodedFile, relative_to_origin
from plr_jax.plr.frame import FRACTION_BITS, Frame, corner_if_far, folding_numbers, frame_of, table_corners
from plr_jax.plr.leaves import as_sourced
from plr_jax.plr.tree import Tree

Value: TypeAlias = Any  # a number, an array, or an expression
Point: TypeAlias = list[Value]  # coordinates of points, one value per axis
LeafRows: TypeAlias = Float[np.ndarray, "rows count"]  # distinct parameters of leaves
_TOLERANCE = 2.0**-44  # tolerance of wrapping, relative to the ends of the domain


class Operations:
    """The operations of a query other than arithmetic and comparisons, on NumPy values.

    Code generators override all methods.
    """

    def let(self, name: str, value: Value) -> Value:
        """Return ``value``.

        A code generator instead assigns the value to a new variable, called ``name`` with a number, and returns the
        variable.
        """
        return value

    def where(self, condition: Value, yes: Value, no: Value) -> Value:
        return np.where(condition, yes, no)

    def floor(self, x: Value) -> Value:
        return np.floor(x)

    def root(self, x: Value) -> Value:
        return np.sqrt(x)

    def rounded(self, x: Value) -> Value:
        return x.astype(np.float32)

    def fraction(self, x: Value) -> Value:
        """Return the 23 mantissa bits of a 32-bit float in [1, 2) as an integer.

        In C and JavaScript, the mantissa bits are the highest bits of a 32-bit integer.
        """
        return x.view(np.uint32) & np.uint32((1 << FRACTION_BITS) - 1)


ARRAYS = Operations()


def wrap(do: Operations, x: Value, lo: Value, hi: Value, scale: Value, tolerance: Value) -> Value:
    """Move ``x`` by whole periods (``hi - lo``) into ``[lo, hi]``; ``scale`` is 1 / period.

    If ``x``, before it is moved, is within ``tolerance`` of ``hi``, return ``lo``.
    """
    # x - floor((x - lo) * scale) * (hi - lo), clamped, since rounding may lead beyond an end.
    turns = do.floor((x - lo) * scale)
    moved = clamp(do, do.let("moved", x - turns * (hi - lo)), lo, hi)
    from_end = x - hi
    is_end = (from_end <= tolerance) & (from_end >= -tolerance)
    return do.let("wrapped", do.where(is_end, lo, moved))


def clamp(do: Operations, x: Value, lo: Value, hi: Value) -> Value:
    return do.where(x < lo, lo, do.where(x > hi, hi, x))


def fraction_along(do: Operations, offset: Value, frame: Value) -> Value:
    """Convert an ``offset`` from the domain's lower end along an axis to an integer, in units of ``2**-23`` widths.

    If ``do`` generates C or JavaScript, the unit is ``2**-32`` widths: the integer's low 9 bits are 0. ``frame`` has
    the constants of this axis, in the order of :class:`Frame`.
    """
    # The mantissa bits of max(min(share, top) + start, 1), a float from 1 to below 2; share is at least 0, so the
    # maximum is needed only if start < 1.
    start, top = frame[Frame.START], frame[Frame.TOP]
    share = do.let("share", offset * frame[Frame.SCALE])
    placed = do.where(share < top, share, top) + start
    if start < 1:  # known when code is generated
        placed = do.let("placed", placed)
        placed = do.where(placed < 1, np.float32(1), placed)
    return do.fraction(placed)


class Program:
    """The query of one PLR file: the constants of the file, and a method for each step of a query (``FORMAT.md``)."""

    def __init__(self, contents: DecodedFile) -> None:
        self.contents, self.leaf, self.straight = contents, contents.leaf, contents.straight
        self.domain = domain = contents.domain if contents.folding is None else contents.folding.domain
        self.dim = domain.dim
        # 1. Points are taken relative to the lower corner of a domain far from 0, given in at least this precision.
        self.corner: Value = corner_if_far(domain)
        self.precision = np.float32 if self.corner is None else np.float64
        origin = np.zeros(self.dim) if self.corner is None else domain.lo
        # 2. Parameters of leaves. Those of polynomials begin with a number of the leaf's cell for each axis, which
        #    readers leave out, and replace by two numbers for each axis: see :meth:`value`.
        domain_of_leaves, numbers = relative_to_origin(contents, origin)
        self.leaf_parameters = numbers.astype(np.float32)[:, self.dim * self.leaf.is_cell_relative :]
        self.frame: Value = frame_of(domain_of_leaves)
        self.folding_arrays = None if contents.folding is None else folding_numbers(contents.folding, origin)
        # 3. Least and largest coordinates inside, and ends, inverse width and tolerance of each periodic axis.
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

    def contains(self, do: Operations, x: Point) -> Value:
        """Return whether each point is in the closed domain; False for NaN, and for infinity along a periodic axis.

        Points of 64 bits must be prepared: moved by :meth:`wrap_in_double`, then rounded to 32 bits unless the domain
        is far from 0 (:func:`~plr_jax.plr.frame.is_far`).
        """
        place = [x[axis] if wraps else self._relative(do, x, axis) for axis, wraps in enumerate(self.domain.periodic)]
        return reduce(and_, [(at >= lo) & (at <= hi) for at, lo, hi in zip(place, *self.limits, strict=True)])

    def wrap_in_double(self, do: Operations, x: Point) -> Point:
        """Move 64-bit points by whole periods into the domain; coordinates along periodic axes must be finite."""
        x = list(x)
        for axis, period in self.double_periods.items():
            x[axis] = wrap(do, x[axis], *period)
        return x

    def relative(self, do: Operations, x: Point) -> Point:
        """Return points ``x`` as the query computes with them.

        In a domain far from 0, they are relative to the domain's lower corner, and rounded to 32 bits. In any other
        domain, they are unchanged.
        """
        return [self._relative(do, x, axis) for axis in range(self.dim)]

    def _relative(self, do: Operations, x: Point, axis: int) -> Value:
        return x[axis] if self.corner is None else do.let("relative", do.rounded(x[axis] - self.corner[axis]))

    def offsets(self, do: Operations, x: Point) -> Point:
        """Return points minus the lower corner of the leaves' domain, after mirroring and wrapping.

        ``x`` has the points that :meth:`relative` returns. If the file has mirror symmetries, points are first
        mirrored into the leaves' domain. Along periodic axes, points are then moved by whole periods into the domain.
        """
        x = list(x)
        if self.folding_arrays is not None:
            # 1. Center, rotate, mirror behind each pivot, clip.
            (center, rest), ends, axes, mirrors = self.folding_arrays
            x = [do.let("seen", along - c - r) for along, c, r in zip(x, center, rest, strict=True)]
            if axes is not None:
                x = [do.let("turned", reduce(add, [a * b for a, b in zip(row, x, strict=True)])) for row in axes]
            for pivot, reversed_axes in mirrors:
                is_behind = do.let("is_behind", x[pivot] < 0)
                for axis in reversed_axes:
                    x[axis] = do.let("mirrored", do.where(is_behind, -x[axis], x[axis]))
            for axis, (lo, hi) in enumerate(ends.T):
                if np.isfinite(hi):  # periodic axes are not clipped
                    x[axis] = do.let("folded", clamp(do, x[axis], lo, hi))
        # 2. Wrap, and subtract the corner.
        for axis, period in self.periods.items():
            x[axis] = wrap(do, x[axis], *period)
        return [do.let("offset", along - lo) for along, lo in zip(x, self.frame[Frame.LO], strict=True)]

    def fractions(self, do: Operations, offsets: Point) -> list[Value]:
        """Return the position of points along each axis of the domain as integers, in units of ``2**-23`` widths.

        ``offsets`` is the result of the method :meth:`offsets`. If ``do`` generates C or JavaScript, the unit is
        ``2**-32`` widths: the low 9 bits of the integers are 0.
        """
        columns = zip(*self.frame, strict=True)
        return [fraction_along(do, offset, column) for offset, column in zip(offsets, columns, strict=True)]

    def value(self, do: Operations, offsets: Point, numbers: Sequence[Value]) -> Value:
        """Return the distance at each point, with the parameters ``numbers`` of the point's leaf.

        ``offsets`` is the result of the method :meth:`offsets`. ``numbers`` has one value or array per parameter; for
        several points, an array has one entry per point. The distance is at least :meth:`straight_bound`.
        """
        # 1. For polynomials, two numbers for each axis come before the leaf's parameters: how many cells as long as
        # the leaf's cell the domain has along the axis, and the index of the leaf's cell. In the cell, the coordinate
        # is t = (share of the domain's width) * number - index, from 0 to 1.
        place = list(offsets)
        if self.leaf.is_cell_relative:
            for axis, along in enumerate(offsets):
                share = along * self.frame[Frame.SCALE][axis]
                start = self.frame[Frame.START][axis]
                if start < 1:
                    share = share + (start - np.float32(1))
                place[axis] = do.let("t", share * numbers[2 * axis] - numbers[2 * axis + 1])
            numbers = numbers[2 * self.dim :]
        # 2. The answer is max(value, straight).
        value = self.leaf.value(numbers, place, do.root)
        straight = self.straight_bound(do, offsets)
        if straight is None:
            return value
        value, straight = do.let("value", value), do.let("straight", straight)
        return do.where(straight > value, straight, value)

    def straight_bound(self, do: Operations, offsets: Point) -> Value | None:
        """Return a lower bound of the distance, from straight lines to the goals; None if the file stores no bound.

        ``offsets`` is the result of the method :meth:`offsets`.
        """
        # max(least cost of a goal - margin, 0); a goal's cost is the sum over groups of axes of
        #   rate * sqrt(sum of squared changes of the group's coordinates).
        if self.straight is None:
            return None
        goals, groups, rates, margin = self.straight.arrays
        least = None
        for goal in goals:
            changes = [do.let("change", along - to) for along, to in zip(offsets, goal, strict=True)]
            for axis, (lo, hi, *_) in self.periods.items():  # the short way around
                length = do.let("length", do.where(changes[axis] < 0, -changes[axis], changes[axis]))
                other = do.let("other", -length + (hi - lo))
                changes[axis] = do.let("change", do.where(other < length, other, length))
            squares = [change * change for change in changes]
            lengths = [do.root(reduce(add, [squares[axis] for axis in np.flatnonzero(group)])) for group in groups]
            cost = do.let("cost", reduce(add, map(mul, lengths, rates)))
            least = cost if least is None else do.let("least", do.where(cost < least, cost, least))
        least = do.let("least", least - margin)
        return do.where(least > 0, least, np.float32(0))

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        corner = self.frame[Frame.LO] if self.corner is None else self.corner
        return [lo + along for lo, along in zip(corner, as_sourced(self.leaf).source_of(numbers), strict=True)]


class CodedTree:
    """A binary tree of cells in which each node is an integer ``index << kind_bits | kind``.

    - Split node: the kind is the axis along which the cell is halved, the index is the node's row in ``children``.
      This row has the integers of the lower and the upper half.
    - Leaf: the kind is ``dim``, the index is the leaf's entry in ``row_of_leaf``, a row of leaf parameters.

    Rows of ``children`` go through the tree level by level.
    """

    def __init__(self, tree: Tree, row_of_leaf: Int[np.ndarray, " leaves"]) -> None:
        dim, is_split = tree.cells.dim, tree.child >= 0
        self.dim, self.kind_bits = dim, dim.bit_length()
        splits = np.flatnonzero(is_split)
        index = np.empty(len(is_split), np.int64)
        index[splits] = np.arange(len(splits))
        index[tree.node_of_leaf] = row_of_leaf
        code = (index << self.kind_bits) | np.where(is_split, tree.axis, dim)
        self.root = int(code[0])
        self.children = code[tree.child[splits][:, None] + np.arange(2)]
        self.axis = tree.axis[splits]
        self.depth = tree.cells.depth[splits, self.axis]  # how often the cell was split along this axis before
        self.code_type = np.dtype(np.uint16 if code.max() < 2**16 else np.uint32)


def distinct_rows(numbers: Float[np.ndarray, "leaves count"]) -> tuple[LeafRows, Int[np.ndarray, " leaves"]]:
    """Return the distinct rows of ``numbers`` in order of first appearance, and the index of each leaf's row.

    ``numbers`` has 32-bit floats; rows are equal if all their bits are.
    """
    # NumPy sorts distinct rows; `rank` is the place of each in the order of first leaves.
    _, first_leaf, row = np.unique(numbers.view(np.uint32), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first_leaf))
    return numbers[np.sort(first_leaf)], rank[row.ravel()]
