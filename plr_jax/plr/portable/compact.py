"""Compact bytes of a PLR, which the C decoder ``decoder.h`` queries without unpacking them.

The bytes hold the numbers of the file in parts that can be read at any position: fields of equal width replace entropy
codes, and combinations of many values are replaced by their results. All parts are sequences of bits, lowest first:

    words         16 integers of 32 bits: kind, sizes, and positions of parts in bits (``PLR_JAX_W_MAGIC`` and on)
    frame         nine 32-bit floats for each axis: the domain and its constants (see ``FORMAT.md``)
    exact         five 64-bit floats for each axis: only for planes, and in domains far from the origin
    folding       center and its rounding error; axes if turned; mirrors; corners of the folded box
    tree          a bit for each node, 1 if it is split; then the axis of each split
    levels        for each level of the tree: position and widths of its fields
    fields        integers of leaves or splits, below
    odd leaves    sorted numbers of leaves that are stored as floats although other leaves are integers
    rows          numbers of leaves as 32-bit floats
    CRC-32        of all bytes before it, little-endian

Nodes, splits and leaves are numbered in level order. So the children of split ``s`` are the nodes ``2 s + 1`` and
``2 s + 2``, and leaf numbers follow from counting splits. A *directory* stores the count before every 64 nodes.

- Planes have the integers of the file.
- Continuous leaves follow from the corners of the domain. Each split halves edges and stores the values in the *middle*
  of these edges, from which a query computes the corner values of one half. A middle has the mean of the ends of its
  edge, or the rounded mean plus a stored difference. At walls, each half has a middle of its own.
- Cones, smooth leaves and planes of floats have the index of a row.
"""

import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.coding import BitWriter
from plr_jax.plr.frame import Frame, table_corners
from plr_jax.plr.leaves import code_of_leaf
from plr_jax.plr.portable.arithmetic import Program, distinct_rows
from plr_jax.plr.tree import Tree, corner_bits

DECODER = Path(__file__).with_name("decoder.h")
"""The source of the decoder."""

_MAGIC = int.from_bytes(b"PLC1", "little")
_NUM_WORDS = 16
_RECORD = 64  # bits of digits in a record of a directory
_FAR, _FOLDED, _TURNED, _CODED = 1, 2, 4, 8  # flags
_UNITS = np.array([0, 1, 2, 4])  # units of the level's width that a middle takes, by its mark
_FLOAT_BITS = 32  # planes of so many bits are floats
_MOST_FRACTION_BITS, _LARGEST_VALUE = 16, 1 << 28


def compact_bytes(program: Program) -> bytes:
    """Return the bytes that the C decoder reads: of several encodings, the smallest."""
    choices, contents = [_Image(program).with_rows()], program.contents
    if program.leaf.name == "plane" and contents.stored.bits < _FLOAT_BITS:
        choices.append(_Image(program).with_planes())
    if program.leaf.name == "continuous":
        codes = contents.leaf.coefficients(contents.tree.leaves, contents.stored)
        codes = (codes - contents.stored.offset) / contents.stored.step
        largest = np.abs(codes[np.isfinite(codes)]).max(initial=1.0)
        for fraction_bits in range(_MOST_FRACTION_BITS):
            if largest * 2.0**fraction_bits < _LARGEST_VALUE:
                middles = _Middles(contents.tree, codes, fraction_bits)
                choices.append(_Image(program).with_values(middles))
    return min(choices, key=len)


class _Image:
    """The parts of compact bytes; one of the methods ``with_...`` completes and returns them."""

    def __init__(self, program: Program) -> None:
        self.program, self.dim = program, program.dim
        self.tree: Tree = program.contents.tree
        is_split, level = self.tree.child >= 0, self.tree.cells.depth.sum(axis=1)
        self.level_of_leaf, self.level_of_split = level[~is_split], level[is_split]
        self.num_levels = int(level.max()) + 1
        self.leaves = self.tree.leaf_of_node[~is_split]
        self.numbers = program.leaf_parameters[self.leaves]
        self.at_values, self.fraction_bits, self.offset, self.step = 0, 0, 0.0, 0.0
        self.body = BitWriter()
        self._write_domain()
        self.at_tree = self._at
        self._write_directory(is_split.astype(np.int64), 1, is_split.astype(np.int64))
        self.at_axes, self.axis_bits = self._at, (self.dim - 1).bit_length()
        self.body.write(self.tree.axis[is_split], self.axis_bits)

    @property
    def _at(self) -> int:
        """Position of the next part, in bits."""
        return 32 * _NUM_WORDS + self.body.num_bits

    def _write_floats(self, numbers: Float[np.ndarray, "..."]) -> None:
        self.body.write(np.ascontiguousarray(numbers, "<f4").view("<u4").ravel().astype(np.int64), 32)

    def _write_domain(self) -> None:
        program, contents = self.program, self.program.contents
        ends = np.zeros((3, self.dim))
        for axis, (lo, hi, _, tolerance) in program.periods.items():
            ends[:, axis] = lo, hi, tolerance
        rows = Frame.LO, Frame.SCALE, Frame.START, Frame.TOP
        largest = np.finfo(np.float32).max
        limits = np.clip(program.limits, -largest, largest)
        self._write_floats(np.stack([*limits, *(program.frame[row] for row in rows), *ends], axis=1))
        self.at_exact = self._at
        if program.corner is not None or program.leaf.name == "plane":
            box, origin = contents.domain, np.zeros(self.dim)
            if program.corner is not None and contents.folding is None:
                origin = program.corner
            corner = origin + table_corners(box.moved(-origin))[0]
            exact = np.stack([box.lo, box.hi, corner, program.domain.lo, program.domain.hi], axis=1)
            self.body.write(np.ascontiguousarray(exact, "<f8").view("<u4").ravel().astype(np.int64), 32)
        self.at_folding = self._at
        if program.folding_arrays is not None:
            center, rest, axes, mirrors, folded_ends = program.folding_arrays
            self._write_floats(np.stack([center, rest], axis=1))
            if axes is not None:
                self._write_floats(np.stack(axes))
            self.body.write(np.array([len(mirrors)]), 8)
            for pivot, reversed_axes in mirrors:
                self.body.write(np.array([pivot]), 8)
                self.body.write(np.isin(np.arange(self.dim), reversed_axes).astype(np.int64), 1)
            self._write_floats(folded_ends.T)

    def _write_directory(self, digits: Int[np.ndarray, "n"], width: int, weights: Int[np.ndarray, "n"]) -> None:
        """Append digits in records of 64 bits, each after the sum of the weights of all digits before it."""
        per_record = _RECORD // width
        bits = (digits[:, None] >> np.arange(width)) & 1
        bits = np.pad(bits.ravel(), (0, -bits.size % _RECORD)).reshape(-1, 2, 32)
        before = (np.cumsum(weights) - weights)[::per_record]
        self.body.write(np.column_stack([before, bits @ (1 << np.arange(32))]).ravel(), 32)

    def _write_levels(self, count: Int[np.ndarray, "levels"], widths: Int[np.ndarray, "levels fields"]) -> None:
        """Append the widths of the fields of each level, and where field 0 would be if all had the level's width.

        ``count`` is the number of fields of each level, or of groups of fields if a level has several widths.
        """
        self.at_levels, size = self._at, widths.sum(axis=1)
        start = self._at + self.num_levels * (40 + 8 * self.dim)
        first, before = np.cumsum(count * size) - count * size, np.cumsum(count) - count
        rows = np.zeros((self.num_levels, 2 + self.dim), np.int64)
        rows[:, 0] = (start + first - before * size) % (1 << 32)
        rows[:, 1 : 1 + widths.shape[1]] = widths
        self.body.write(rows.ravel(), np.tile([32, *[8] * (1 + self.dim)], self.num_levels))

    def _write_leaf_fields(
        self, fields: Int[np.ndarray, "leaves fields"], widths: Int[np.ndarray, "levels fields"]
    ) -> None:
        self._write_levels(np.bincount(self.level_of_leaf, minlength=self.num_levels), widths)
        of_leaf = widths[self.level_of_leaf]
        self.body.write((fields & ((1 << of_leaf) - 1)).ravel(), of_leaf.ravel())

    def _finish(self, rows: Float[np.ndarray, "rows terms"], odd: Int[np.ndarray, "odd"], flags: int) -> bytes:
        """Append odd leaves and rows; return all bytes."""
        program, folding = self.program, self.program.folding_arrays
        at_odd, index_bits = self._at, len(self.leaves).bit_length()
        self.body.write(odd, index_bits)
        at_rows = self._at
        self._write_floats(rows)
        flags |= _FAR * (program.corner is not None)
        if folding is not None:
            flags |= _FOLDED | _TURNED * (folding[2] is not None)
        kind = self.dim | code_of_leaf(program.leaf) << 8 | flags << 16 | self.num_levels << 24
        widths = self.axis_bits | self.fraction_bits << 8 | index_bits << 16
        scale = np.array([self.offset, self.step], np.float32).view(np.uint32).tolist()
        data = self.body.to_bytes()
        words = [_MAGIC, 4 * _NUM_WORDS + len(data) + 4, kind, widths, rows.shape[1], len(odd), *scale, at_odd]
        words += [self.at_tree, self.at_axes, self.at_levels, self.at_values, at_rows, self.at_folding, self.at_exact]
        data = np.array(words, "<u4").tobytes() + data
        return data + zlib.crc32(data).to_bytes(4, "little")

    def with_rows(self) -> bytes:
        rows, row_of_leaf = distinct_rows(self.numbers)
        self._write_leaf_fields(row_of_leaf[:, None], np.full((self.num_levels, 1), (len(rows) - 1).bit_length()))
        return self._finish(rows, np.zeros(0, np.int64), 0)

    def with_planes(self) -> bytes:
        planes = self.program.contents.stored
        self.offset, self.step = planes.offset, planes.step
        is_odd = planes.unreachable[self.leaves]  # such leaves continue another leaf's plane
        codes = np.column_stack([planes.center, planes.half])[self.leaves] * ~is_odd[:, None]
        is_signed = np.arange(1 + self.dim) > 0
        widths = np.zeros((self.num_levels, 1 + self.dim), np.int64)
        np.maximum.at(widths, self.level_of_leaf, np.frexp(np.abs(codes))[1] + (is_signed & (codes != 0)))
        self._write_leaf_fields(codes, widths)
        return self._finish(self.numbers[is_odd], np.flatnonzero(is_odd), _CODED)

    def with_values(self, middles: "_Middles") -> bytes:
        stored = self.program.contents.stored
        self.fraction_bits, self.offset = middles.fraction_bits, stored.offset
        self.step = float(np.ldexp(stored.step, -self.fraction_bits))
        # 1. Compute each leaf's numbers as a query does; store a leaf as floats if they are not those of the file.
        codes = middles.corners[self.tree.child < 0].reshape(-1, *[2] * self.dim)
        for axis in range(1, 1 + self.dim):
            codes = np.concatenate([codes.take([0], axis), np.diff(codes, axis=axis)], axis=axis)
        codes = codes.reshape(len(self.leaves), -1)
        numbers = np.float32(self.step) * codes.astype(np.float32)
        numbers[:, 0] = (self.offset + self.step * codes[:, 0]).astype(np.float32)
        is_odd = (numbers.view(np.uint32) != self.numbers.view(np.uint32)).any(axis=1)
        # 2. Append the values at the corners of the domain, marks, and values of middles.
        self.body.write(middles.corners[0] & 0xFFFFFFFF, 32)
        widths = middles.best_widths(self.level_of_split, self.num_levels)
        self.at_values, units = self._at, _UNITS[middles.mark]
        self._write_directory(middles.mark.ravel(), 2, units.ravel())
        count = np.bincount(self.level_of_split, units.sum(axis=1), self.num_levels).astype(np.int64)
        self._write_levels(count, widths[:, None])
        self.body.write(*middles.fields(widths[self.level_of_split]))
        return self._finish(self.numbers[is_odd], np.flatnonzero(is_odd), _CODED)


class _Middles:
    """Values in the middle of the edges that splits halve, and the corner values of all nodes that follow from them.

    Attributes:
        corners: Values at the corners of each node, in units of ``2**-fraction_bits`` steps.
        mark: For each split and middle, 0: both halves have the mean of the ends; 1: both have another value, stored
            as ``narrow``; 2: both have another value, stored as ``wide``; 3: each half has its ``wide``.
        narrow: The value minus the rounded mean, in steps.
        wide: For each half: twice the value minus the rounded mean, in steps; or 1 + twice the value minus the mean,
            in units of ``2**-fraction_bits`` steps.
    """

    def __init__(self, tree: Tree, codes: Float[np.ndarray, "leaves corners"], fraction_bits: int) -> None:
        self.fraction_bits, num_splits = fraction_bits, np.count_nonzero(tree.child >= 0)
        bits, each = corner_bits(tree.cells.dim), np.arange(codes.shape[1])
        # 1. The value wanted at each corner of a node is that of the leaf there; an unreachable leaf takes any.
        leaf_at = np.empty((len(tree.child), len(each)), np.int64)
        leaf_at[tree.node_of_leaf] = np.arange(len(codes))[:, None]
        for split in reversed(tree.splits):
            leaf_at[split] = leaf_at[tree.child[split][:, None] + bits[:, tree.axis[split]].T, each]
        is_free = np.isinf(codes[:, 0])[leaf_at]
        wanted = np.where(
            is_free, 0, np.rint(np.ldexp(np.where(np.isinf(codes), 0.0, codes), fraction_bits))[leaf_at, each]
        )
        wanted = wanted.astype(np.int64)
        # 2. From the root down, halve the edges.
        self.corners = np.empty_like(leaf_at)
        self.corners[0] = wanted[0]
        self.mark = np.zeros((num_splits, len(each) // 2), np.int64)
        self.narrow, self.wide = np.zeros_like(self.mark), np.zeros((*self.mark.shape, 2), np.int64)
        number = np.cumsum(tree.child >= 0) - 1
        for split in tree.splits:
            for axis, is_high in enumerate(bits.T == 1):
                nodes = split[tree.axis[split] == axis]
                ends, halves = self.corners[nodes], tree.child[nodes]
                mean = (ends[:, ~is_high] + ends[:, is_high]) >> 1
                rounded = (mean + ((1 << fraction_bits) >> 1)) >> fraction_bits
                want = np.stack([wanted[halves][:, is_high], wanted[halves + 1][:, ~is_high]], axis=2)
                free = np.stack([is_free[halves][:, is_high], is_free[halves + 1][:, ~is_high]], axis=2)
                want = np.where(free, np.where(free[:, :, ::-1], mean[:, :, None], want[:, :, ::-1]), want)
                from_mean = want - mean[:, :, None]
                is_whole = (want & ((1 << fraction_bits) - 1) == 0) & (from_mean != 0)
                here, from_whole = number[nodes], (want >> fraction_bits) - rounded[:, :, None]
                self.narrow[here] = from_whole[:, :, 0]
                self.wide[here] = 2 * np.where(is_whole, from_whole, from_mean) + ~is_whole
                is_shared = want[:, :, 0] == want[:, :, 1]
                self.mark[here] = np.where(is_shared, np.where(is_whole[:, :, 0], 1, 2), 3)
                self.mark[here] *= from_mean.any(axis=2)
                lower, upper = ends.copy(), ends.copy()
                lower[:, is_high], upper[:, ~is_high] = want[:, :, 0], want[:, :, 1]
                self.corners[halves], self.corners[halves + 1] = lower, upper

    def best_widths(self, level: Int[np.ndarray, "splits"], num_levels: int) -> Int[np.ndarray, "levels"]:
        """Choose the unit of each level for which its middles take the fewest bits, and set marks 1 and 2."""
        narrow = 1 + np.frexp(np.abs(self.narrow))[1]
        wide = 1 + np.frexp(np.abs(self.wide) + 1)[1].max(axis=2)
        widths = np.ones(num_levels, np.int64)
        for each in range(num_levels):
            here = level == each
            sizes = {}
            for width in range(1, 17):
                mark = self.mark[here] + ((self.mark[here] == 1) & (narrow[here] > width))
                if wide[here][mark > 1].max(initial=0) <= 2 * width:
                    sizes[width] = width * _UNITS[mark].sum()
            widths[each] = min(sizes, key=lambda width: sizes[width])
        self.mark += (self.mark == 1) & (narrow > widths[level][:, None])
        return widths

    def fields(self, unit: Int[np.ndarray, "splits"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Return the stored integers and their widths."""
        widths = unit[:, None, None] * np.array([[0, 0], [1, 0], [2, 0], [2, 2]])[self.mark]
        codes = np.where(self.mark[:, :, None] == 1, self.narrow[:, :, None], self.wide)
        return (codes & ((1 << widths) - 1)).ravel(), widths.ravel()
