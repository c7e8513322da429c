"""Compact bytes of a PLR, which the C decoder ``decoder.h`` queries without unpacking them.

The bytes hold the numbers of the file in parts that can be read at any position. Fields of equal width replace
entropy codes, and results replace combinations of many values. All parts are sequences of bits, lowest first:

    words         18 integers of 32 bits: kind, sizes, and positions of parts in bits (``PLR_JAX_W_MAGIC`` and on)
    frame         nine 32-bit floats for each axis: the domain and its constants (see ``FORMAT.md``)
    exact         five 64-bit floats for each axis: only for planes, and in domains far from the origin
    folding       center and its rounding error; axes if turned; mirrors; corners of the folded box
    tree          a bit for each node, 1 if it is split; then the axis of each split
    levels        for each level of the tree: position and widths of its fields
    fields        integers of leaves or splits, below
    exceptions    leaf and index of numbers that a query does not compute from the fields, sorted
    planes        smooth leaves that continue a plane: leaf, value at the center and half of the rise along each axis
    floats        rows of numbers of leaves, or the exceptions, as 32-bit floats
    CRC-32        of all bytes before it, little-endian

Nodes, splits and leaves are numbered in level order. So the children of split ``s`` are the nodes ``2 s + 1`` and
``2 s + 2``, and leaf numbers follow from counting splits. A *directory* stores the count before every 64 nodes.

- Cones and planes of floats have the index of a row. Other planes have the integers of the file.
- Continuous leaves follow from the values at the corners of the domain. Each split halves edges and stores the values
  in the *middle* of these edges, from which a query computes the corner values of one half. A middle has the mean of
  the ends of its edge, or the rounded mean plus a stored difference. At walls, each half has a middle of its own.
- Smooth leaves have such values too. A query computes the derivatives at the corners of its leaf from the leaves
  around them. It takes leaves as continuous if their values agree; wrong guesses are stored as exceptions.

Exceptions make all answers equal to those of the file, bit for bit: this module computes numbers as a query does,
and stores all that differ, if only by rounding.
"""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import product_in_order
from plr_jax.plr._file import DecodedFile, filled_coefficients
from plr_jax.plr.coding import BitWriter
from plr_jax.plr.finite_elements import monomials, plane_coefficients
from plr_jax.plr.frame import FRACTION_BITS, Frame, table_corners
from plr_jax.plr.leaves import code_of_leaf
from plr_jax.plr.portable.arithmetic import Program, distinct_rows
from plr_jax.plr.tree import Tree, corner_bits

DECODER = Path(__file__).with_name("decoder.h")
"""The source of the decoder."""

_MAGIC = int.from_bytes(b"PLC1", "little")
_NUM_WORDS = 18
_RECORD = 64  # bits of digits in a record of a directory
_FAR, _FOLDED, _TURNED, _CODED, _VALUES = 1, 2, 4, 8, 16  # flags
_UNITS = np.array([0, 1, 2, 4])  # width of a middle's field by its mark, in multiples of the width of its level
_FLOAT_BITS = 32  # planes of so many bits are floats
_MOST_FRACTION_BITS, _LARGEST_VALUE = 16, 1 << 28
_ROUNDING = 1e-6  # largest distance from a multiple of a power of two that counts as rounding


def compact_bytes(program: Program) -> bytes:
    """Return the bytes that the C decoder reads: of several encodings, the smallest."""
    choices, contents = [_Image(program).with_rows()], program.contents
    if program.leaf.name == "plane" and contents.stored.bits < _FLOAT_BITS:
        choices.append(_Image(program).with_planes())
    is_smooth = program.leaf.name == "smooth" and program.dim == 2
    if program.leaf.name == "continuous" or is_smooth:
        choices.append(_Image(program).with_values(_Middles(contents, is_smooth)))
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
        self.planes, self.plane_numbers = np.zeros(0, np.int64), np.zeros((0, 3))
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

    def _finish_codes(self, numbers: Float[np.ndarray, "leaves terms"], flags: int) -> bytes:
        """Append the numbers that differ from those that a query computes (``numbers``), and return all bytes.

        If it takes less, all numbers of a leaf that are not 0 are stored, and a flag in the first of them.
        """
        bits, given = self.numbers.view(np.uint32), numbers.view(np.uint32)
        is_cleared = np.count_nonzero(bits, axis=1) < np.count_nonzero(bits != given, axis=1)
        leaf, term = np.nonzero(bits != np.where(is_cleared[:, None], 0, given))
        is_first = np.diff(leaf, prepend=-1) > 0
        return self._finish(
            self.numbers[leaf, term], np.stack([leaf, term | (is_first & is_cleared[leaf]) << 8]), flags
        )

    def _finish(self, floats: Float[np.ndarray, "floats"], odd: Int[np.ndarray, "2 odd"], flags: int) -> bytes:
        """Append floats and the leaf and term of each exception; return all bytes."""
        program, folding = self.program, self.program.folding_arrays
        at_odd, index_bits = self._at, len(self.leaves).bit_length()
        self.body.write(odd.T.ravel(), np.tile([index_bits, 9], odd.shape[1]))
        at_planes = self._at
        words = np.ascontiguousarray(self.plane_numbers, "<f8").view("<u4").astype(np.int64)
        fields = np.column_stack([self.planes, words])
        self.body.write(fields.ravel(), np.tile([index_bits, *[32] * 6], len(fields)))
        at_rows = self._at
        self._write_floats(floats)
        flags |= _FAR * (program.corner is not None)
        if folding is not None:
            flags |= _FOLDED | _TURNED * (folding[2] is not None)
        kind = self.dim | code_of_leaf(program.leaf) << 8 | flags << 16 | self.num_levels << 24
        widths = self.axis_bits | self.fraction_bits << 8 | index_bits << 16
        scale = np.array([self.offset, self.step], np.float32).view(np.uint32).tolist()
        data = self.body.to_bytes()
        words = [
            _MAGIC,
            4 * _NUM_WORDS + len(data) + 4,
            kind,
            widths,
            self.numbers.shape[1],
            odd.shape[1],
            len(self.planes),
            *scale,
            at_odd,
        ]
        words += [
            at_planes,
            self.at_tree,
            self.at_axes,
            self.at_levels,
            self.at_values,
            at_rows,
            self.at_folding,
            self.at_exact,
        ]
        data = np.array(words, "<u4").tobytes() + data
        return data + zlib.crc32(data).to_bytes(4, "little")

    def with_rows(self) -> bytes:
        rows, row_of_leaf = distinct_rows(self.numbers)
        self._write_leaf_fields(row_of_leaf[:, None], np.full((self.num_levels, 1), (len(rows) - 1).bit_length()))
        return self._finish(rows.ravel(), np.zeros((2, 0), np.int64), 0)

    def with_planes(self) -> bytes:
        planes = self.program.contents.stored
        self.offset, self.step = planes.offset, planes.step
        is_odd = planes.unreachable[self.leaves]  # such leaves continue another leaf's plane
        codes = np.column_stack([planes.center, planes.half])[self.leaves] * ~is_odd[:, None]
        is_signed = np.arange(1 + self.dim) > 0
        widths = np.zeros((self.num_levels, 1 + self.dim), np.int64)
        np.maximum.at(widths, self.level_of_leaf, np.frexp(np.abs(codes))[1] + (is_signed & (codes != 0)))
        self._write_leaf_fields(codes, widths)
        return self._finish_codes(np.where(is_odd[:, None], np.float32(0), self.numbers), _CODED)

    def with_values(self, middles: "_Middles") -> bytes:
        stored = self.program.contents.stored
        self.fraction_bits, self.offset = middles.fraction_bits, stored.offset
        self.step = float(np.ldexp(stored.step, -self.fraction_bits))
        # 1. Compute each leaf's numbers as a query does.
        corners = middles.corners[self.tree.child < 0]
        if self.program.leaf.name == "smooth":
            coefficients = self.step * _smooth_numbers(
                self.tree, middles.corners, self.program.contents.domain.periodic
            )
            coefficients[:, ::4] += self.offset
            self.planes = np.flatnonzero(self.program.contents.stored.partition.unreachable[self.leaves])
            filled = filled_coefficients(self.program.contents)[self.leaves[self.planes]]
            self.planes, filled = self.planes[filled[:, 0] < np.inf], filled[filled[:, 0] < np.inf]
            half = filled[:, [2, 1]] / 2
            self.plane_numbers = np.column_stack([_plane_centers(filled[:, ::4], half), half])
            if len(self.planes):
                coefficients[self.planes] = plane_coefficients(1, self.plane_numbers[:, 0], half)
            numbers = product_in_order(coefficients, monomials(1, 2)).astype(np.float32)
        else:
            codes = corners.reshape(-1, *[2] * self.dim)
            for axis in range(1, 1 + self.dim):
                codes = np.concatenate([codes.take([0], axis), np.diff(codes, axis=axis)], axis=axis)
            codes = codes.reshape(len(self.leaves), -1)
            numbers = np.float32(self.step) * codes.astype(np.float32)
            numbers[:, 0] = (self.offset + self.step * codes[:, 0]).astype(np.float32)
        # 2. Append the values at the corners of the domain, marks, and values of middles.
        self.body.write(middles.corners[0] & 0xFFFFFFFF, 32)
        widths = middles.best_widths(self.level_of_split, self.num_levels)
        self.at_values, units = self._at, _UNITS[middles.mark]
        self._write_directory(middles.mark.ravel(), 2, units.ravel())
        count = np.bincount(self.level_of_split, units.sum(axis=1), self.num_levels).astype(np.int64)
        self._write_levels(count, widths[:, None])
        self.body.write(*middles.fields(widths[self.level_of_split]))
        return self._finish_codes(numbers, _CODED | _VALUES)


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

    def __init__(self, contents: DecodedFile, is_smooth: bool) -> None:
        tree, partition = contents.tree, contents.stored.partition
        codes = (partition.space.values @ contents.stored.code.astype(np.float64)).reshape(len(tree.leaves), -1)
        scaled = codes * 2.0 ** np.arange(_MOST_FRACTION_BITS)[:, None, None]
        is_rounded = np.abs(scaled - np.rint(scaled)) > _ROUNDING
        is_rounded |= np.abs(scaled) > _LARGEST_VALUE
        self.fraction_bits = fraction_bits = int(np.argmin(np.count_nonzero(is_rounded, axis=(1, 2))))
        num_splits = np.count_nonzero(tree.child >= 0)
        bits, each = corner_bits(tree.cells.dim), np.arange(codes.shape[1])
        # 1. The value wanted at each corner of a node is that of the leaf there; an unreachable leaf takes any, but
        # smooth leaves around it must not take its value for theirs.
        leaf_at = np.empty((len(tree.child), len(each)), np.int64)
        leaf_at[tree.node_of_leaf] = np.arange(len(codes))[:, None]
        for split in reversed(tree.splits):
            leaf_at[split] = leaf_at[tree.child[split][:, None] + bits[:, tree.axis[split]].T, each]
        is_free = partition.unreachable[leaf_at]
        wanted = np.rint(np.ldexp(codes, fraction_bits)).astype(np.int64)[leaf_at, each] * ~is_free
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
                any_value = np.where(free[:, :, ::-1], mean[:, :, None], want[:, :, ::-1] + is_smooth)
                want = np.where(free, any_value, want)
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


_MOST_EDGES = 8  # longest chain of hanging corners of smooth leaves


def _smooth_numbers(
    tree: Tree, corners: Int[np.ndarray, "nodes corners"], periodic: tuple[bool, ...]
) -> Float[np.ndarray, "leaves terms"]:
    """Return value and derivatives at the corners of smooth leaves, in level order, in units of a stored integer."""
    at_corner = _SmoothCorners(tree, corners.tolist(), periodic)
    leaves = np.flatnonzero(tree.child < 0)
    depth, position = tree.cells.depth[leaves], tree.cells.position[leaves]
    coefficients = np.zeros((len(leaves), 4, 4))
    for corner, ends in enumerate(corner_bits(2)):
        points = (position + ends) << (FRACTION_BITS - depth)
        of_points = zip(map(tuple, points.tolist()), corners[leaves, corner].tolist(), strict=True)
        coefficients[:, corner] = [at_corner(point, value, _MOST_EDGES) for point, value in of_points]
    return (coefficients / np.ldexp(1.0, depth @ corner_bits(2).T)[:, None]).reshape(len(leaves), -1)


def _plane_centers(values: Float[np.ndarray, "n 4"], half: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    """Return the centers of planes with given corner values, if possible those that round to these values."""
    center = middle = (values[:, 0] + values[:, 3]) / 2
    for ulps in (1, -1, 2, -2):
        is_same = (plane_coefficients(0, center, half) == values).all(axis=1)
        center = np.where(is_same, center, middle + ulps * np.spacing(middle))
    return center


def _cubic(v0: Any, d0: Any, v1: Any, d1: Any) -> tuple[Any, Any, Any, Any]:
    """Return the coefficients of a cubic, from values and derivatives at both ends of [0, 1]."""
    return v0, d0, 3 * (v1 - v0) - 2 * d0 - d1, 2 * (v0 - v1) + d0 + d1


class _SmoothCorners:
    """Value and derivatives of smooth leaves at corners, by the operations of ``plr_jax_smooth``."""

    def __init__(self, tree: Tree, corners: list[list[int]], periodic: tuple[bool, ...]) -> None:
        self.child, self.axis, self.corners, self.periodic = (
            tree.child.tolist(),
            tree.axis.tolist(),
            corners,
            periodic,
        )
        self.depth, self.position = tree.cells.depth.tolist(), tree.cells.position.tolist()
        self.known: dict[tuple[tuple[int, ...], int], list[float]] = {}

    def __call__(self, point: tuple[int, ...], value: int, edges: int) -> list[float]:
        if (point, value) not in self.known:
            self.known[point, value] = self._numbers(point, value, edges)
        return self.known[point, value]

    def _numbers(self, point: tuple[int, ...], value: int, edges: int) -> list[float]:
        out, weight = [float(value), 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        for quadrant in ((0, 0), (1, 0), (0, 1), (1, 1)):
            place = [along - below for along, below in zip(point, quadrant, strict=True)]
            outside = (not 0 <= along < 1 << FRACTION_BITS for along in place)
            if any(out and not wraps for out, wraps in zip(outside, self.periodic, strict=True)):
                continue
            place = [along % (1 << FRACTION_BITS) for along in place]
            node = 0
            while (child := self.child[node]) >= 0:
                axis = self.axis[node]
                node = child + (place[axis] >> (FRACTION_BITS - 1 - self.depth[node][axis]) & 1)
            corner, depth = self.corners[node], self.depth[node]
            size = [1 << (FRACTION_BITS - k) for k in depth]
            cell = [p * width for p, width in zip(self.position[node], size, strict=True)]
            from_lower = [a - lo + below for a, lo, below in zip(place, cell, quadrant, strict=True)]
            index = 2 * (from_lower[0] == size[0]) + (from_lower[1] == size[1])
            edge = next((axis for axis in (0, 1) if 0 < from_lower[axis] < size[axis]), None)
            if edge is not None:
                across, along, t = 2 >> edge, size[edge], from_lower[edge] / size[edge]
                ends = corner[index], corner[index | across]
                if ends[0] * (along - from_lower[edge]) + ends[1] * from_lower[edge] != value * along or not edges:
                    continue
                scale = float(1 << depth[edge])
                first, second = (list(point) for _ in range(2))
                first[edge], second[edge] = cell[edge], cell[edge] + along
                p, q = self(tuple(first), ends[0], edges - 1), self(tuple(second), ends[1], edges - 1)
                for i in (i for i in range(4) if not i & across):
                    a, b, c, d = _cubic(p[i], p[i | across] / scale, q[i], q[i | across] / scale)
                    out[i] = ((d * t + c) * t + b) * t + a
                    out[i | across] = ((3 * d * t + 2 * c) * t + b) * scale
                return out
            if corner[index] == value:
                values = list(map(float, corner))
                differences = values[1 | index] - values[index & 2], values[2 | index] - values[index & 1]
                both = (values[3] - values[2]) - (values[1] - values[0])
                widths = float(1 << depth[1]), float(1 << depth[0]), float(1 << depth[0]) * float(1 << depth[1])
                for kind, (w, difference) in enumerate(zip(widths, (*differences, both), strict=True), 1):
                    weight[kind] += w
                    out[kind] += w * w * difference
        return [number / of_all if of_all else np.nan for number, of_all in zip(out, weight, strict=True)]
