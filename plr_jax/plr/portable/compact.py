"""Compact bytes of a PLR, which the C decoder ``decoder.h`` queries without unpacking them.

``FORMAT.md`` describes the bytes, whose parts are::

    | words | domain | tree | fields of leaves or splits | planes | exceptions | rows | CRC-32 |

:func:`compact_bytes` tries up to three encodings of the leaves, and returns the smallest::

    with_rows      fields: the index of each leaf's row of parameters; equal rows are stored once
    with_planes    fields: the integers of the PLR file
    with_values    fields: values at the middles of edges, coded by _Middles as differences from predictions

The decoder computes leaf parameters from the fields, and rounding may make some differ from those that a query of the
PLR file uses. The writer computes them as the decoder does (:func:`_smooth_parameters` for smooth leaves), and stores
parameters that differ as exceptions. So all answers are equal, bit for bit.
"""

import math
import zlib
from collections.abc import Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int, Shaped

from plr_jax.plr._file import DecodedFile
from plr_jax.plr.coding import BitWriter, bits_of_floats
from plr_jax.plr.frame import FRACTION_BITS, Frame, table_corners
from plr_jax.plr.leaf_faces import leaves_at_corners
from plr_jax.plr.leaves import Plane, code_of_leaf
from plr_jax.plr.portable.arithmetic import Program, distinct_rows
from plr_jax.plr.tree import Tree, corner_bits

DECODER = Path(__file__).with_name("decoder.h")  # the source of the decoder

# The bytes, as in ``decoder.h``.
_MAGIC = int.from_bytes(b"PLC1", "little")
_NUM_WORDS = 18  # words of 32 bits at the start
_RECORD = 16  # splits in a record of the tree
# Flags: the domain is far from the origin; points are folded; along turned axes; leaves have fields to compute from;
# these are values at corners; there is a straight-line bound.
_FAR, _FOLDED, _TURNED, _CODED, _VALUES, _STRAIGHT = 1, 2, 4, 8, 16, 32
_MOST_UNIT = 16  # bits of the largest unit of a record, which its numbers of middles take
_UNITS = np.array([[0, 0], [1, 0], [2, 0], [2, 2]])  # widths of a middle's two fields by its mark, in units
_LONGEST_CHAIN = 8  # most hanging corners of smooth leaves, each inside an edge that ends at the next
_EXACT = 2**53  # doubles hold all integers up to here
# Leaves of PLR files:
_FLOAT_BITS = 32  # files whose planes have so many bits store floats
# In a polynomial close to a plane, Horner's rule adds all other coefficients to a slope. If their sum is less than
# this share of each slope, rounding removes them (a slope has 24 bits; two more cover rounding and ``t`` beyond 1).
_NEGLIGIBLE = 2.0**-27
# Values at corners are integers, in units of 2**-fraction_bits steps of the file.
_MOST_FRACTION_BITS = 16  # more than the largest number of these bits
_LARGEST_VALUE = 1 << 28
_ROUNDING = 1e-6  # largest distance from a multiple of a unit that counts as rounding, in units
Ints: TypeAlias = Int[np.ndarray, "..."]
Corner: TypeAlias = tuple[list[float], int]  # see :meth:`_SmoothCorners._numbers_at`


def compact_bytes(program: Program) -> bytes:
    """Return the bytes that the C decoder reads, in the smallest of the encodings for the PLR's leaf model.

    ``ValueError`` if the decoder does not support the leaf model.
    """
    leaf, contents = program.leaf, program.contents
    if not leaf.decoder_cost[0]:
        raise ValueError(f"The compact decoder does not know leaves of kind {leaf.name!r}: use compact=False.")
    choices = [_CompactWriter(program).with_rows()]
    if isinstance(leaf, Plane) and contents.stored.bits < _FLOAT_BITS:
        choices.append(_CompactWriter(program).with_planes())
    is_smooth = leaf.num_powers == 4
    if leaf.num_powers == 2 or (is_smooth and program.dim == 2):
        choices.append(_CompactWriter(program).with_values(_Middles(contents, is_smooth)))
    return min(choices, key=len)


class _CompactWriter:
    """A writer of one PLR's bytes for the C decoder.

    Call one of the methods ``with_...``, once. Each method encodes the leaves in another way.
    """

    def __init__(self, program: Program) -> None:
        self.program, self.dim = program, program.dim
        self.tree: Tree = program.contents.tree
        is_leaf, level = self.tree.child < 0, self.tree.cells.depth.sum(axis=1)
        # Leaves are numbered in level order. `leaves` has their indices in traversal order, as in the PLR.
        self.leaves = self.tree.leaf_of_node[is_leaf]
        self.level_of_leaf = level[is_leaf]
        self.num_levels = int(level.max()) + 1
        self.parameters = program.leaf_parameters[self.leaves]
        # Constants and widths of the encoding, which it sets, and positions of parts (`at_...`). All are in bits, but
        # the size of a record and the position of the tree, which are in bytes.
        self.fraction_bits, self.offset, self.step = 0, 0.0, 0.0
        self.position_bits = self.record_bytes = self.at_tree = self.at_levels = self.at_fields = 0
        self.axis_bits, self.leaf_bits = (self.dim - 1).bit_length(), len(self.leaves).bit_length()
        self.body = BitWriter()
        self._write_domain()

    def with_rows(self) -> bytes:
        """Return the bytes with each leaf's parameters as a row of 32-bit floats; equal rows are stored once."""
        rows, row_of_leaf = distinct_rows(self.parameters)
        self._write_tree()
        self.at_fields, self.at_levels = self._at, (len(rows) - 1).bit_length()  # not a position: the width of fields
        self.body.write(row_of_leaf, self.at_levels)
        return self._finish(0, self.parameters, rows.ravel())

    def with_planes(self) -> bytes:
        """Return the bytes with planes as the integers of the PLR file.

        Each level of the tree has its own bit widths, as small as its integers allow.
        """
        planes = self.program.contents.stored
        self.offset, self.step = planes.offset, planes.step
        # 1. Find the widths, by level and field: the center value is unsigned, half-differences have a sign bit.
        is_own = ~planes.unreachable[self.leaves, None]  # other leaves continue another leaf's plane
        codes = np.column_stack([planes.center, planes.others])[self.leaves] * is_own
        widths = np.zeros((self.num_levels, 1 + self.dim), np.int64)
        is_signed = np.arange(1 + self.dim) > 0
        np.maximum.at(widths, self.level_of_leaf, np.frexp(np.abs(codes))[1] + (is_signed & (codes != 0)))
        self._write_tree()
        # 2. For each level, write the position that leaf 0 would have if all leaves had the level's widths, and these
        #    widths. With `size`, the sum of the widths, leaf i of the level then begins at
        #        start + i * size = (begin of the level's fields) + (i - number of the level's first leaf) * size.
        size = widths.sum(axis=1)
        self.at_levels = self._at
        self.at_fields = self._at + self.num_levels * (40 + 8 * self.dim)
        count = np.bincount(self.level_of_leaf, minlength=self.num_levels)
        start = self.at_fields + np.cumsum(count * size) - count * size - (np.cumsum(count) - count) * size
        self._write_rows((start[:, None] % (1 << 32), 32), (widths, 8))
        # 3. Write the fields, in two's complement.
        width = widths[self.level_of_leaf]
        self.body.write((codes & ((1 << width) - 1)).ravel(), width.ravel())
        return self._finish(_CODED, np.where(is_own, self.parameters, np.float32(0)), np.zeros(0))

    def with_values(self, middles: "_Middles") -> bytes:
        """Return the bytes of continuous or smooth leaves, with the function's values at cell corners.

        Values are stored as differences from predictions by coarser cells (``middles``).
        """
        stored = self.program.contents.stored
        self.fraction_bits, self.offset = middles.fraction_bits, stored.offset
        self.step = float(np.ldexp(stored.step, -self.fraction_bits))
        # 1. Compute the leaf parameters as the decoder does. The coefficients of a multilinear function follow from
        #    corner values by differences along each axis in turn: (lower, upper) becomes (lower, upper - lower).
        if self.program.leaf.num_powers == 4:
            codes = _smooth_parameters(self.tree, middles.corners, self.program.contents.domain.periodic)
            parameters = (self.step * codes + np.where(np.arange(16), 0.0, self.offset)).astype(np.float32)
        else:
            codes = middles.corners[self.tree.child < 0].reshape(-1, *[2] * self.dim)
            for axis in range(1, 1 + self.dim):
                codes = np.concatenate([codes.take([0], axis), np.diff(codes, axis=axis)], axis=axis)
            codes = codes.reshape(len(self.leaves), -1)
            parameters = np.float32(self.step) * codes.astype(np.float32)
            parameters[:, 0] = (self.offset + self.step * codes[:, 0]).astype(np.float32)
        # 2. Append the values at the corners of the domain, the tree with marks, and values of middles.
        self.body.write(middles.corners[0] & 0xFFFFFFFF, 32)
        mark, unit, fields, widths = middles.encoded()
        num_bits = _by_record(widths.reshape(len(mark), 2 * mark.shape[1])).sum(axis=1)
        self.position_bits = int(num_bits.sum()).bit_length()
        start = np.cumsum(num_bits) - num_bits  # of each record's fields
        self._write_tree([(_by_record(mark), 2)], [(unit[:, None], 5), (start[:, None], self.position_bits)])
        self.at_fields = self._at
        self.body.write(fields.ravel(), widths.ravel())
        return self._finish(_CODED | _VALUES, parameters, np.zeros(0))

    def _write_domain(self) -> None:
        """Write the domain as 32-bit floats, and also in 64 bits for planes and for domains far from 0.

        Then write the file's mirror symmetries or lower bound by straight lines, if any.
        """
        program, contents = self.program, self.program.contents
        # 1. Nine floats for each axis: limits of points inside; rows of the frame; ends and tolerance if periodic.
        ends = np.zeros((3, self.dim))
        for axis, (lo, hi, _, tolerance) in program.periods.items():
            ends[:, axis] = lo, hi, tolerance
        rows = Frame.LO, Frame.SCALE, Frame.START, Frame.TOP
        largest = np.finfo(np.float32).max
        limits = np.clip(program.limits, -largest, largest)
        self.body.write_floats(np.stack([*limits, *(program.frame[row] for row in rows), *ends], axis=1).ravel())
        # 2. For planes and far domains, five doubles for each axis: ends of the leaves' domain, corner of the query's
        #    coordinates, ends of the query's domain. Each is two words, the lower one first.
        self.at_exact = self._at
        if program.corner is not None or isinstance(contents.leaf, Plane):
            box = contents.domain
            origin = np.zeros(self.dim) if program.corner is None or contents.folding is not None else program.corner
            corner = origin + table_corners(box.moved(-origin))[0]
            exact = np.stack([box.lo, box.hi, corner, program.domain.lo, program.domain.hi], axis=1)
            self.body.write_doubles(exact.ravel())
        # 3. Mirrors, or straight lines; then zeros up to a whole byte.
        self.at_folding = self._at
        if program.folding_arrays is not None:
            center, folded_ends, axes, mirrors = program.folding_arrays
            self.body.write_floats(center.T.ravel())
            if axes is not None:
                self.body.write_floats(axes.ravel())
            self.body.write(np.array([len(mirrors)]), 8)
            for pivot, reversed_axes in mirrors:
                self.body.write(np.array([pivot]), 8)
                self.body.write(np.isin(np.arange(self.dim), reversed_axes).astype(np.int64), 1)
            self.body.write_floats(folded_ends.T.ravel())
        elif (straight := program.straight) is not None:
            self.body.write(np.array([len(straight.goals), len(straight.rates)]), 8)
            self.body.write_floats(np.array([straight.margin]))
            self.body.write(straight.groups.argmax(axis=0), 8)
            self.body.write_floats(np.append(straight.rates, straight.goals))
        self.body.write(np.zeros(1, np.int64), -self.body.num_bits % 8)

    def _write_tree(self, marks: Sequence[tuple[Any, int]] = (), places: Sequence[tuple[Any, int]] = ()) -> None:
        # A record for every 16 splits of the tree:
        #   marks | is each child split? (32 bits) | axes | number of split children in earlier records | places
        splits = np.flatnonzero(self.tree.child >= 0)
        is_split = _by_record((self.tree.child[self.tree.halves(splits)] >= 0).astype(np.int64).reshape(-1, 2))
        num_before = np.cumsum(is_split.sum(axis=1)) - is_split.sum(axis=1)
        axes = _by_record(self.tree.axis[splits][:, None])
        parts = [*marks, (is_split, 1), (axes, self.axis_bits), (num_before[:, None], self.leaf_bits), *places]
        num_bits = sum(columns.shape[1] * width for columns, width in parts)
        self.at_tree, self.record_bytes = self._at // 8, -(-num_bits // 8)
        self._write_rows(*parts, (np.zeros((len(is_split), 1), np.int64), -num_bits % 8))

    def _write_rows(self, *parts: tuple[Shaped[np.ndarray, "rows _"], int]) -> None:
        """Append a table of integers, row by row.

        Each of ``parts`` has some columns of the table, and the number of bits of each integer in these columns.
        """
        widths = np.concatenate([np.full(columns.shape[1], width) for columns, width in parts])
        rows = np.concatenate([columns for columns, _ in parts], axis=1)
        self.body.write(rows.ravel(), np.tile(widths, len(rows)))

    @property
    def _at(self) -> int:
        """The position at which the next number will be written, in bits from the start of the result."""
        return 32 * _NUM_WORDS + self.body.num_bits

    def _finish(self, flags: int, decoded: Float[np.ndarray, "leaves terms"], rows: Float[np.ndarray, " _"]) -> bytes:
        """Append planes and exceptions (parameters of some leaves), then ``rows``; return all bytes of the PLR.

        ``decoded`` are the leaf parameters that the decoder computes. Where a query of the PLR file uses other
        numbers, these are stored as exceptions with their positions, or as the plane of a nearly plane leaf.
        """
        # 1. Choose the leaves that are stored as planes: their other parameters change no answer, and a plane takes
        #    fewer bits than exceptions. Of a polynomial, the coefficient of t[axis] has the index
        #    num_powers**(dim - 1 - axis).
        num_powers, axes = self.program.leaf.num_powers, np.arange(self.dim)
        of_plane = np.concatenate([[0], num_powers ** (self.dim - 1 - axes) if num_powers else 1 + axes])
        sum_of_others = np.abs(np.delete(self.parameters, of_plane, axis=1).astype(np.float64)).sum(axis=1)
        is_plane = sum_of_others <= _NEGLIGIBLE * np.abs(self.parameters[:, of_plane[1:]]).min(axis=1)
        is_exception = self.parameters.view(np.uint32) != decoded.view(np.uint32)
        bits_of_plane = self.leaf_bits + 32 * (1 + self.dim)
        bits_of_exceptions = is_exception.sum(axis=1) * (self.leaf_bits + 8 + 32)
        is_plane &= (self.parameters[:, 0] != 0) & (bits_of_exceptions > bits_of_plane)
        # 2. Append planes, exceptions and rows.
        planes = np.flatnonzero(is_plane)
        at_planes = self._at
        value = bits_of_floats(self.parameters[planes][:, of_plane])
        self._write_rows((planes[:, None], self.leaf_bits), (value, 32))
        leaf, term = np.nonzero(is_exception & ~is_plane[:, None])
        at_exceptions = self._at
        value = bits_of_floats(self.parameters[leaf, term])
        self._write_rows((leaf[:, None], self.leaf_bits), (term[:, None], 8), (value[:, None], 32))
        at_rows = self._at
        self.body.write_floats(rows)
        self.body.write(np.zeros(3, np.int64), 8)  # a query reads 8 bytes at once
        # 3. Put the words at the start, in the order of `PLR_JAX_W_MAGIC` and on, and a checksum at the end.
        flags |= _FAR * (self.program.corner is not None)
        if (folding := self.program.folding_arrays) is not None:
            flags |= _FOLDED | _TURNED * (folding[2] is not None)
        flags |= _STRAIGHT * (self.program.straight is not None)
        data = self.body.to_bytes()
        kind = self.dim | code_of_leaf(self.program.leaf) << 8 | flags << 16 | self.num_levels << 24
        widths = self.axis_bits | self.fraction_bits << 8 | self.leaf_bits << 16 | self.position_bits << 24
        words = [_MAGIC, 4 * _NUM_WORDS + len(data) + 4, kind, widths, self.parameters.shape[1], self.record_bytes]
        words += [*bits_of_floats(np.array([self.offset, self.step], np.float32)), len(planes), len(leaf)]
        words += [self.at_tree, self.at_fields, self.at_levels]
        words += [at_planes, at_exceptions, at_rows, self.at_folding, self.at_exact]
        data = np.array(words, "<u4").tobytes() + data
        return data + zlib.crc32(data).to_bytes(4, "little")


def _by_record(of_splits: Shaped[np.ndarray, "splits fields"]) -> Shaped[np.ndarray, "records fields_of_record"]:
    """Join the rows of each 16 successive splits into one row, a record of the file; zeros pad the last record."""
    return np.pad(of_splits, ((0, -len(of_splits) % _RECORD), (0, 0))).reshape(-1, _RECORD * of_splits.shape[1])


class _Middles:
    """Values at the midpoints of cell edges, coded as differences from the mean of the values at the edge's ends.

    Each split halves edges of its cell: from the domain's corners down, midpoints become corners of smaller cells.
    Values are integers, in units of ``2**-fraction_bits`` steps of the file. The middle of a halved edge from a to b
    may have the value m in the lower half, and m' in the upper half::

        a ------------- m  m' ------------- b        mean = floor((a + b) / 2)
                                                     rounded = mean, rounded to whole steps of the file

    The values m and m' are stored by *mark*::

        0: m = m' = mean
        1: m = m' = rounded + narrow, in whole steps
        2: m = m', which follows from the first ``wide``
        3: each follows from its own ``wide``, as at walls

    An even ``wide`` is 2 * (m - rounded), in whole steps; an odd one is 2 * (m - mean) + 1.
    """

    def __init__(self, contents: DecodedFile, is_smooth: bool) -> None:
        # 1. Choose the fraction bits for which the fewest values at corners must be rounded, or are too large.
        tree, partition = contents.tree, contents.stored.partition
        codes = (partition.space.values @ contents.stored.code.astype(np.float64)).reshape(len(tree.leaves), -1)
        scaled = codes * 2.0 ** np.arange(_MOST_FRACTION_BITS)[:, None, None]
        is_inexact = (np.abs(scaled - np.rint(scaled)) > _ROUNDING) | (np.abs(scaled) > _LARGEST_VALUE)
        self.fraction_bits = int(np.argmin(np.count_nonzero(is_inexact, axis=(1, 2))))
        # 2. The wanted value at a corner of a node is the value of the leaf there. Unreachable leaves may have any
        #    value; near smooth leaves, it must differ from theirs, and one above the mean usually does.
        bits, leaf_at = corner_bits(tree.cells.dim), leaves_at_corners(tree)
        is_free = partition.unreachable[leaf_at]
        codes = np.rint(np.ldexp(codes, self.fraction_bits)).astype(np.int64)
        wanted = codes[leaf_at, np.arange(len(bits))] * ~is_free
        # 3. Halve the edges, level by level from the root down, along each axis.
        number = np.cumsum(tree.child >= 0) - 1  # of each split
        self.corners = np.empty_like(leaf_at)  # values by node and corner
        self.corners[0] = wanted[0]
        self.mark = np.zeros((number[-1] + 1, len(bits) // 2), np.int64)  # by split and edge
        self.narrow, self.wide = np.zeros_like(self.mark), np.zeros((*self.mark.shape, 2), np.int64)
        for split, axis in product(tree.splits, range(tree.cells.dim)):
            low, high = (np.flatnonzero(bits[:, axis] == side) for side in range(2))  # corners: ends of edges
            nodes = split[tree.axis[split] == axis]
            ends, lower = self.corners[nodes], tree.child[nodes]
            mean = (ends[:, low] + ends[:, high]) >> 1
            # The values m and m'. A free one of continuous leaves takes the other one, unless both are free.
            middle = np.stack([wanted[lower][:, high], wanted[lower + 1][:, low]], axis=2)
            may_vary = np.stack([is_free[lower][:, high], is_free[lower + 1][:, low]], axis=2)
            any_value = mean[:, :, None] + is_smooth
            if not is_smooth:
                any_value = np.where(may_vary[:, :, ::-1], any_value, middle[:, :, ::-1])
            middle = np.where(may_vary, any_value, middle)
            row = number[nodes]
            self.mark[row], self.narrow[row], self.wide[row] = self._code(mean, middle)
            # The corners of the halves.
            self.corners[lower] = self.corners[lower + 1] = ends
            self.corners[lower[:, None], high] = middle[:, :, 0]
            self.corners[lower[:, None] + 1, low] = middle[:, :, 1]

    def _code(self, mean: Ints, middle: Ints) -> tuple[Ints, Ints, Ints]:
        """Return ``mark``, ``narrow`` and ``wide`` (see the class) of edges; the last axis of ``middle`` is m, m'."""
        whole_step = 1 << self.fraction_bits
        rounded = (mean + (whole_step >> 1)) >> self.fraction_bits
        from_mean = middle - mean[:, :, None]
        from_rounded = (middle >> self.fraction_bits) - rounded[:, :, None]
        # The mean itself, beside another value, is an odd ``wide``.
        is_whole = (middle & (whole_step - 1) == 0) & (from_mean != 0)
        is_shared = middle[:, :, 0] == middle[:, :, 1]
        mark = np.where(is_shared, np.where(is_whole[:, :, 0], 1, 2), 3) * from_mean.any(axis=2)
        return mark, from_rounded[:, :, 0], 2 * np.where(is_whole, from_rounded, from_mean) + ~is_whole

    def encoded(self) -> tuple[Ints, Ints, Ints, Ints]:
        """Return what the file stores: marks, a *unit* for each 16 splits, and two integers per edge with bit widths.

        The integers are ``narrow`` or ``wide`` numbers (see the class). The unit is the bit width of a ``narrow``
        number. A ``wide`` number takes twice as many bits.
        """
        # 1. Choose the units for which the records are smallest. Edges whose ``narrow`` number does not fit are
        #    stored wide: their mark changes from 1 to 2.
        narrow_bits = 1 + np.frexp(np.abs(self.narrow))[1]
        wide_bits = 1 + np.frexp(np.abs(self.wide) + 1)[1].max(axis=2)
        sizes = []
        for unit in range(1, 1 + _MOST_UNIT):
            mark = self.mark + ((self.mark == 1) & (narrow_bits > unit))
            does_not_fit = _by_record((mark > 1) & (wide_bits > 2 * unit)).any(axis=1)
            sizes.append(np.where(does_not_fit, np.inf, unit * _by_record(_UNITS[mark].sum(axis=2)).sum(axis=1)))
        units = 1 + np.argmin(sizes, axis=0)
        # 2. Write all numbers in two's complement.
        of_split = np.repeat(units, _RECORD)[: len(self.mark), None]
        mark = self.mark + ((self.mark == 1) & (narrow_bits > of_split))
        widths = of_split[:, :, None] * _UNITS[mark]
        codes = np.where(mark[:, :, None] == 1, self.narrow[:, :, None], self.wide)
        return mark, units, codes & ((1 << widths) - 1), widths


def _smooth_parameters(tree: Tree, corners: Ints, periodic: tuple[bool, ...]) -> Float[np.ndarray, "leaves terms"]:
    """Return the polynomial coefficients of smooth leaves, rounded as in the C decoder, level by level of the tree.

    Coefficients are NaN where this rounding cannot be predicted. ``corners`` has the function's values at the corners
    of each node, ``(nodes, 4)``.
    """
    at_corner = _SmoothCorners(tree, corners.tolist(), periodic).numbers_at
    leaves = np.flatnonzero(tree.child < 0)
    depth, position = tree.cells.depth[leaves], tree.cells.position[leaves]
    # 1. Value, derivative by y, by x, and by both, at each corner; by fractions of the domain, then of the leaf.
    numbers = np.zeros((len(leaves), 4, 4))
    for corner, ends in enumerate(corner_bits(2)):
        points = (position + ends) << (FRACTION_BITS - depth)
        of_points = zip(map(tuple, points.tolist()), corners[leaves, corner].tolist(), strict=True)
        numbers[:, corner] = [at_corner(point, value)[0] for point, value in of_points]
    numbers /= np.ldexp(1.0, depth @ corner_bits(2).T)[:, None]
    # 2. From axes (corner along x, along y, derivative by x, by y) to (power of x, power of y): along either axis,
    #    (lower corner, upper corner) times (value, derivative) become the four coefficients of a cubic.
    numbers = numbers.reshape(-1, 2, 2, 2, 2).transpose(0, 1, 3, 2, 4).reshape(-1, 4, 4)
    for axis in (2, 1):
        numbers = np.stack(_cubic(*np.moveaxis(numbers, axis, 0)), axis=axis)
    return numbers.reshape(len(leaves), -1)


def _cubic(v0: Any, d0: Any, v1: Any, d1: Any) -> tuple[Any, Any, Any, Any]:
    """Return the coefficients of a cubic, powers 0 to 3, from its values ``v`` and derivatives ``d`` at 0 and 1."""
    return v0, d0, 3 * (v1 - v0) - 2 * d0 - d1, 2 * (v0 - v1) + d0 + d1


class _SmoothCorners:
    """Values and derivatives at corners of smooth leaves in the plane, as the C decoder computes them.

    Numbers whose rounding by the decoder cannot be predicted are NaN. Coordinates of points are integers, in units of
    ``2**-23`` of the domain's width. The four corners of a leaf have the indices ``2 * x_bit + y_bit``, where a bit
    is 1 at the upper end of its axis. The four numbers at a corner are value, derivative by y, by x, and by both.
    """

    def __init__(self, tree: Tree, corners: list[list[int]], periodic: tuple[bool, ...]) -> None:
        self.child, self.axis, self.depth = tree.child.tolist(), tree.axis.tolist(), tree.cells.depth.tolist()
        self.corners, self.periodic = corners, periodic
        self.numbers_at = cache(self._numbers_at)

    def _numbers_at(self, point: tuple[int, ...], value: int) -> Corner:
        """Return the numbers at a corner where leaves have ``value``, and the length of a chain.

        The numbers are means over the leaves around the corner, or follow from the edge of a larger leaf, the *host*.
        The chain counts corners inside edges of hosts, each computed from the ends of its edge.
        """
        # Up to four leaves meet at a point. The host has it inside an edge, not at a corner:
        #
        #     +-----------+              edge: axis of the host's edge
        #     |   host    |              index: corner of a leaf at the point; of the host, the lower end of the edge
        #     +-----*-----+
        #     |     |     |
        #     +-----+-----+
        #
        weights, terms, hosts = [], [], {}
        for quadrant in ((0, 0), (1, 0), (0, 1), (1, 1)):
            # 1. Find the leaf that contains the smallest cell in a quadrant around the point. A quadrant is, for each
            #    axis, 1 if it is below the point.
            place = [along - below for along, below in zip(point, quadrant, strict=True)]
            is_outside = (not 0 <= along < 1 << FRACTION_BITS for along in place)
            if any(out and not wraps for out, wraps in zip(is_outside, self.periodic, strict=True)):
                continue
            place = [along % (1 << FRACTION_BITS) for along in place]
            node = 0
            while (child := self.child[node]) >= 0:
                axis = self.axis[node]
                node = child + (place[axis] >> (FRACTION_BITS - 1 - self.depth[node][axis]) & 1)
            # 2. Find where the point is in the leaf.
            corner, depth = self.corners[node], self.depth[node]
            size = [1 << (FRACTION_BITS - k) for k in depth]
            start = [along & -width for along, width in zip(place, size, strict=True)]
            from_start = [a - lo + below for a, lo, below in zip(place, start, quadrant, strict=True)]
            index = 2 * (from_start[0] == size[0]) + (from_start[1] == size[1])
            edge = next((axis for axis in (0, 1) if 0 < from_start[axis] < size[axis]), None)
            # 3. The leaf counts if its own value at the point is `value`; values are linear along an edge.
            if edge is not None:
                ends, along = (corner[index], corner[index | 2 >> edge]), from_start[edge]
                if ends[0] * (size[edge] - along) + ends[1] * along == value * size[edge]:
                    hosts[node] = edge, start[edge], size[edge], ends
            elif corner[index] == value:
                # A derivative is the change times w, the inverse of the leaf's widths; its weight is w.
                by_y, by_x = corner[1 | index] - corner[index & 2], corner[2 | index] - corner[index & 1]
                by_both = corner[3] - corner[2] - (corner[1] - corner[0])
                weights.append([1 << depth[1], 1 << depth[0], 1 << depth[0] + depth[1]])
                terms.append([w * w * change for w, change in zip(weights[-1], (by_y, by_x, by_both), strict=True)])
        # 4. The host's edge gives all numbers. Without a host, derivatives are weighted means. Sums of doubles are
        #    exact in any order if all terms are multiples of a power of two, and their absolute sum is less than
        #    2**53 times this power.
        if hosts:
            return self._on_edge(point, *hosts.popitem()[1]) if len(hosts) == 1 else ([np.nan] * 4, 0)
        numbers = [float(value)]
        for of_kind, weight in zip(zip(*terms, strict=True), map(sum, zip(*weights, strict=True)), strict=True):
            lowest_bit = math.gcd(*of_kind) & -math.gcd(*of_kind) or 1
            is_exact = sum(map(abs, of_kind)) // lowest_bit < _EXACT
            numbers.append(sum(of_kind) / weight if is_exact else np.nan)
        return numbers, 0

    def _on_edge(self, point: tuple[int, ...], edge: int, start: int, size: int, ends: tuple[int, int]) -> Corner:
        """Compute value, derivatives and chain length of a corner inside an edge of a larger leaf.

        Value and derivatives come from cubics along the edge. The edge is parallel to the axis ``edge``, and runs
        from the coordinate ``start`` to ``start + size``. The function's integer values at its two ends are ``ends``.
        For the chain length, see :meth:`_numbers_at`.
        """
        # Number i at the ends p and q, with its derivatives along the edge (numbers i | along), gives a cubic: for
        # the value (i = 0), and for the derivative across the edge (i = 3 - along).
        along = 2 >> edge
        t = (point[edge] - start) / size
        scale = float((1 << FRACTION_BITS) // size)  # inverse length of the edge, in fractions of the domain
        places = [tuple(at if axis == edge else x for axis, x in enumerate(point)) for at in (start, start + size)]
        (p, chain_of_p), (q, chain_of_q) = map(self.numbers_at, places, ends)
        numbers = [0.0] * 4
        for i in (0, 3 - along):
            a, b, c, d = _cubic(p[i], p[i | along] / scale, q[i], q[i | along] / scale)
            numbers[i] = ((d * t + c) * t + b) * t + a
            numbers[i | along] = ((3 * d * t + 2 * c) * t + b) * scale
        chain = 1 + max(chain_of_p, chain_of_q)
        return numbers if chain <= _LONGEST_CHAIN else [np.nan] * 4, chain
