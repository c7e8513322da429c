"""A reader of PLR files that needs only NumPy and follows the arithmetic of the format (``FORMAT.md``)."""

from collections.abc import Callable
from functools import cache, cached_property, reduce
from math import floor, sqrt
from operator import add
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Integer, UInt32

from plr_jax._arrays import as_queries, shortened
from plr_jax._types import ArrayLike
from plr_jax.plr._file import decode
from plr_jax.plr.frame import FRACTION_BITS, Outside, as_outside
from plr_jax.plr.leaves import goal_of_leaves, require_goals
from plr_jax.plr.portable.arithmetic import ARRAYS, CodedTree, Program, clamp
from plr_jax.plr.portable.c import c_header, compact_header
from plr_jax.plr.portable.compact import compact_bytes
from plr_jax.plr.portable.javascript import js_module
from plr_jax.plr.portable.writers import Emitter, Expression
from plr_jax.plr.tree import spread_bits

_MOST_BITS = 16  # log2 of the most entries of a lookup table, which then fits a core's second-level cache
_UNWRAPPED = 1 - 2.0**-48  # fraction of the width up to which wrapping changes no coordinate, despite rounding
_CHUNK = 1 << 14  # points; their intermediate values fit a core's second-level cache
_FEW = 8  # most points of a batch that are answered one by one, where a batch takes as long as 16
_PLAIN = (float, int, np.float64, np.float32)
Integers = Integer[np.ndarray, " n"]


class PythonEmitter(Emitter):
    """A generator of Python code for NumPy scalars; ``constants`` maps names in that code to their values."""

    conjunction, conditional = "and", "({1} if {0} else {2})"
    root_of, cast, definition = "float32(sqrt({}))", "float32({})", "{name} = {value}"

    def __init__(self) -> None:
        super().__init__()
        self.constants: dict[str, Any] = {}

    def literal(self, number: np.floating) -> str:
        name = f"k{len(self.constants)}"
        self.constants[name] = number
        return name

    def floor(self, x: Expression) -> Expression:
        return self.atom(f"{'float64' if x.type == 'double' else 'float32'}(floor({x}))", x.type)

    def fraction(self, x: Expression) -> Expression:
        # The 23 mantissa bits of a float in [1, 2), as an integer without the leading one.
        return self.atom(f"(int({x * np.float32(1 << 23)}) & {(1 << 23) - 1})", "uint32_t")


class LeafTable:
    """A lookup table: for each cell of a regular grid, the deepest node of the tree that contains this grid cell."""

    def __init__(self, tree: CodedTree) -> None:
        self.tree = tree
        self.kind_mask = (1 << tree.kind_bits) - 1
        self.children = tree.children.ravel().astype(tree.code_type)  # of split s: entries 2 s and 2 s + 1
        # 1. The grid has 2**bits cells along each axis; `place` is the lower corner of each cell.
        deepest = np.zeros(tree.dim, np.int64)
        np.maximum.at(deepest, tree.axis, tree.depth + 1)
        bits = spread_bits(deepest, _MOST_BITS)
        place = np.indices((1 << bits).tolist()).reshape(tree.dim, -1) << (FRACTION_BITS - bits)[:, None]
        # 2. The table has the deepest node that contains each cell of the grid; it is flat if all nodes are leaves.
        self.table = np.full(place.shape[1], tree.root, tree.code_type)
        self._descend(self.table, list(place), bits)
        self.bits, self.is_flat = tuple(bits.tolist()), bool((self.table & self.kind_mask == tree.dim).all())

    def rows(self, fractions: list[UInt32[np.ndarray, " n"]]) -> Integers:
        """Return the index of each point's leaf.

        ``fractions`` has an array for each axis: the points' coordinates from the domain's lower end, in units of
        ``2**-23`` of its width.
        """
        # The row-major index of a grid cell consists of the highest bits of the point's fraction along each axis.
        index = fractions[0] >> (FRACTION_BITS - self.bits[0])
        for place, bits in zip(fractions[1:], self.bits[1:], strict=True):
            index = (index << bits) | (place >> (FRACTION_BITS - bits))
        code = self.table[index]
        self._descend(code, fractions, np.full(self.tree.dim, FRACTION_BITS))
        return code >> self.tree.kind_bits

    def _descend(self, code: Integers, fractions: list[Integers], bits: Int[np.ndarray, " d"]) -> None:
        """Descend the tree from the node ``code[i]`` toward the leaf that contains point ``i``.

        ``code`` is changed in place; nodes are coded as in :class:`CodedTree`. ``fractions`` has the points'
        coordinates, an array for each axis. The descent stops at leaves, and at nodes split along an axis that was
        already halved ``bits[axis]`` times.
        """
        # A split of depth d along its axis leads to the child given by bit d of the fraction, the highest bit first.
        moving = np.flatnonzero(code & self.kind_mask != self.tree.dim)
        while len(moving):
            split = code[moving] >> self.tree.kind_bits
            axis, depth = self.tree.axis[split], self.tree.depth[split]
            place = np.choose(axis, [along[moving] for along in fractions])
            child = self.children[2 * split + (place >> (FRACTION_BITS - 1 - depth) & 1)]
            is_within = depth < bits[axis]
            moving, child = moving[is_within], child[is_within]
            code[moving] = child
            moving = moving[child & self.kind_mask != self.tree.dim]


def point_query(
    program: Program, table: LeafTable, numbers: Float[np.ndarray, "leaves count"], *, of_leaf: bool = False
) -> Callable[..., Any]:
    """Generate a Python function of the coordinates of a single point, fast because all constants are in its code.

    ``numbers`` are the parameters of all leaves. The function returns the distance (``inf`` outside the domain), or
    with ``of_leaf`` the leaf's index (-1 outside). It returns None if only a query of arrays can answer:

    - The point must be moved along a periodic axis.
    - A coordinate is NaN, and no other coordinate is outside the domain.
    - Rounding decides whether the point is inside the domain.
    """
    # For example, for planes in the unit square:
    #
    #     def query(x0, x1):
    #         if not (0.0 <= x0 <= 1.0 and 0.0 <= x1 <= 1.0):
    #             if (x0 < -1.4e-45) | (x0 > 1.0000001) | ...: return nan if x0 != x0 or x1 != x1 else inf
    #             return None
    #         x_0 = float32(x0)
    #         ...
    #         leaf = codes[(place_4 >> 15) << 8 | place_5 >> 15] >> 2
    #         n0, n1, n2, = row_of(leaf)
    #         return n0 + n1 * x_0 + n2 * x_1
    #
    do, domain, tree = PythonEmitter(), program.domain, table.tree
    children, depth = table.children.data, tree.depth.data  # memoryviews, which return Python integers

    def descend(code: int, fractions: tuple[int, ...]) -> int:
        while (axis := code & table.kind_mask) != tree.dim:
            node = code >> tree.kind_bits
            code = children[2 * node + ((fractions[axis] >> (FRACTION_BITS - 1 - depth[node])) & 1)]
        return code >> tree.kind_bits

    # 1. Conditions for points that are outside, or inside, however they are rounded.
    given = [f"x{axis}" for axis in range(program.dim)]
    # Close to the upper end of a periodic axis, wrapping in 64 bits may lead to the lower end.
    unwrapped = np.minimum(domain.lo + domain.width * _UNWRAPPED, np.nextafter(domain.hi, -np.inf))
    ends = zip(given, domain.lo.tolist(), np.where(domain.periodic, unwrapped, domain.hi).tolist(), strict=True)
    inside = [f"{lo!r} <= {name} <= {hi!r}" for name, lo, hi in ends]
    origin = (np.zeros(program.dim) if program.corner is None else domain.lo).tolist()
    outside = []
    for name, corner, lo, hi in zip(given, origin, *program.limits, strict=True):
        with np.errstate(over="ignore"):  # limits of periodic axes are the largest numbers
            below, above = np.nextafter(lo, np.float32(-np.inf)), np.nextafter(hi, np.float32(np.inf))
        outside.append(f"({name} < {corner + float(below)!r}) | ({name} > {corner + float(above)!r})")
    is_nan = " or ".join(f"{name} != {name}" for name in given)
    # 2. Search of the leaf.
    precision, of_type = ("float32", "float") if program.corner is None else ("float64", "double")
    x = [do.let("x", do.atom(f"{precision}({name})", of_type)) for name in given]
    offsets = program.offsets(do, program.relative(do, x))
    fractions = [str(do.let("place", place)) for place in program.fractions(do, offsets)]
    shifted = [f"{place} >> {FRACTION_BITS - bits}" for place, bits in zip(fractions, table.bits, strict=True)]
    index = shifted[0]
    for along, bits in zip(shifted[1:], table.bits[1:], strict=True):
        index = f"({index}) << {bits} | {along}"
    row = f"codes[{index}] >> {tree.kind_bits}"
    if not table.is_flat:
        row = f"descend(codes[{index}], ({', '.join(fractions)},))"
    # 3. Value of the leaf.
    elsewhere = "-1" if of_leaf else f"nan if {is_nan} else inf"
    if not of_leaf:
        parameters = [f"n{i}" for i in range(numbers.shape[1])]
        do.statements += [f"leaf = {row}", f"{', '.join(parameters)}, = row_of(leaf)"]
        row = program.value(do, offsets, [do.atom(name) for name in parameters])
    lines = [
        f"if not ({' and '.join(inside)}):",
        f"    if {' | '.join(outside)}: return {elsewhere}",  # `|` compares all coordinates, also NaN
        "    return None",
        *do.statements,
        f"return {row}",
    ]
    source = "\n    ".join([f"def query({', '.join(given)}):", *lines])
    names: dict[str, Any] = {"descend": descend, "codes": table.table.data, **do.constants}
    names |= {"inf": np.float32(np.inf), "nan": np.float32(np.nan), "floor": floor, "sqrt": sqrt}
    names |= {"row_of": cache(lambda row: tuple(numbers[row])), "float32": np.float32, "float64": np.float64}
    exec(source, names)
    return names["query"]


class NumpyPLR:
    """A PLR that is queried without JAX; made by :func:`load_numpy` or :meth:`PLR.numpy`.

    ``f(x)`` is the distance at points ``(..., dim)``. Points are rounded to 32 bits. Before that, 64-bit points are
    moved into the domain along periodic axes. In a domain far from the origin, points are also made relative to its
    lower corner.

    Answers equal the answers of C headers (:meth:`PLR.c_header`) bit for bit. On a CPU, they equal ``plr(x)`` bit for
    bit, except for numbers below 1e-38. With ``jax_enable_x64``, ``plr(x)`` computes in 64 bits for 64-bit points, so
    that answers differ by the rounding of this class.

    A single point, as a tuple, list or array, takes a few microseconds, and so does each point of an array of at most
    eight points. A larger batch takes up to about 0.1 ms plus 10 to 130 nanoseconds per point. Some queries take up
    to a few hundred microseconds per call: bounds, points that must be moved along periodic axes, and points outside
    the domain with ``outside`` other than ``"inf"``.

    ``dim``, ``domain``, ``num_leaves`` and ``max_error`` equal the attributes of the :class:`PLR`. Answers are
    float32, except that waypoints in a domain far from the origin are float64, and :meth:`which` and :meth:`leaf`
    return integers.
    """

    def __init__(self, data: bytes):
        """Decode the bytes of a PLR file; raises ``ValueError`` if they are invalid."""
        if not isinstance(data, bytes | bytearray | memoryview):
            advice = "for a path use load_numpy, for a PLR call plr.numpy()"
            raise ValueError(f"data must be the bytes of a PLR file, got {shortened(data)}; {advice}.")
        self._data = bytes(data)
        self._program = program = Program(decode(self._data))
        cells, self.dim, self.domain = program.contents.tree.leaves, program.dim, program.domain
        self.num_leaves = len(cells)
        self._table = LeafTable(CodedTree(program.contents.tree, np.arange(self.num_leaves)))
        numbers = program.leaf_parameters
        if program.leaf.is_cell_relative:  # add the number of cells along each axis, and the leaf's position
            of_cells = np.stack([np.ldexp(1.0, cells.depth), cells.position], axis=2).astype(np.float32)
            numbers = np.concatenate([of_cells.reshape(self.num_leaves, -1), numbers], axis=1)
        self._columns = np.ascontiguousarray(numbers.T)
        certificate = program.contents.certificate
        self.max_error = None if certificate is None else certificate.max_error
        self._band = None if certificate is None else certificate.bounds().astype(np.float32)

    def __repr__(self) -> str:
        proof = "" if self.max_error is None else f", max_error={self.max_error:.3g}"
        size = f"dim={self.dim}, num_leaves={self.num_leaves}"
        return f"NumpyPLR({self._program.leaf.name!r}, {size}{proof}, {self.domain})"

    def __reduce__(self) -> Any:  # generated functions cannot be pickled
        return NumpyPLR, (self._data,)

    def to_bytes(self) -> bytes:
        """Return the PLR as the bytes of a file."""
        return self._data

    def c_header(self, name: str, compact: bool = False) -> str:
        """Return the PLR as a C99 header; see :meth:`PLR.c_header`."""
        return (compact_header if compact else c_header)(self._program, name)

    def c_bytes(self) -> bytes:
        """Return the bytes that the decoder in compact C headers reads; see :meth:`PLR.c_bytes`."""
        return compact_bytes(self._program)

    def js_module(self) -> str:
        """Return the PLR as a JavaScript module; see :meth:`PLR.js_module`."""
        return js_module(self._program)

    def __call__(self, x: ArrayLike, *, outside: Outside = "inf") -> Any:
        """Return the distance at each point ``(..., dim)``, float32 ``(...)``; a scalar for a single point.

        ``outside`` is the answer outside the domain: ``"inf"``, ``"clamp"`` or ``"nan"``; see :func:`evaluate`. For
        ``"clamp"``, coordinates must be finite in 32 bits: infinite ones give ``inf``, NaN gives NaN. ``ValueError``
        if the points are not numbers of that shape, or ``outside`` is invalid.
        """
        if outside != "inf":
            outside = as_outside(outside)
        answer = self._at_few_points(x, self._distance_query)
        if answer is None or (outside != "inf" and np.isinf(answer).any()):
            return self._evaluate(x, self._values, outside)
        return np.array(answer) if type(answer) is list else answer

    def waypoint(self, x: ArrayLike) -> Any:
        """Return the next waypoint from each point ``(..., dim)``, for PLRs of cones; see :meth:`PLR.waypoint`."""
        return self._of_leaves(x, self._waypoint_rows)

    def which(self, x: ArrayLike) -> Any:
        """Return the index of the goal nearest to each point ``(..., dim)``, or -1; see :meth:`PLR.which`."""
        return _as_indices(self._of_leaves(x, self._goal_rows))

    def leaf(self, x: ArrayLike) -> Any:
        """Return the index of the leaf that contains each point ``(..., dim)``; -1 outside the domain and for NaN."""
        return _as_indices(self._of_leaves(x, np.append(np.arange(self.num_leaves), np.nan)))

    def bounds(self, x: ArrayLike) -> tuple[Any, Any]:
        """Return proven lower and upper bounds of the distance at points ``(..., dim)``; see :meth:`PLR.bounds`."""
        if self._band is None:
            raise ValueError("Nothing is proven of this PLR: construct it with certified=True, or call certify.")
        answers = self._evaluate(x, self._bounds)
        return answers[..., 0], answers[..., 1]

    @cached_property
    def _distance_query(self) -> Callable[..., np.float32 | None]:
        return point_query(self._program, self._table, self._columns.T)

    @cached_property
    def _leaf_query(self) -> Callable[..., int | None]:
        return point_query(self._program, self._table, self._columns.T, of_leaf=True)

    @cached_property
    def _waypoint_rows(self) -> Float[np.ndarray, "leaves_and_outside dim"]:
        waypoints = np.stack(self._program.waypoint(list(self._columns)), axis=1)
        return np.pad(waypoints, ((0, 1), (0, 0)), constant_values=np.nan)

    @cached_property
    def _goal_rows(self) -> Float[np.ndarray, " leaves_and_outside"]:
        goals = require_goals(goal_of_leaves(self._program.leaf, self._program.contents.stored))
        return np.append(np.where(np.isinf(self._columns[0]), np.nan, goals), np.nan)  # inf: a leaf without a path

    def _of_leaves(self, x: ArrayLike, rows: Float[np.ndarray, " leaves_and_outside *row"]) -> Any:
        """Return ``rows[leaf]`` for the leaf of each point ``x``, ``(..., dim)``.

        ``rows`` has a row for each leaf, then a row of NaN. Points outside the domain or with a NaN coordinate get
        this last row.
        """
        leaf = self._at_few_points(x, self._leaf_query)  # -1, the last row, outside
        return self._evaluate(x, lambda _, leaf: rows.take(leaf, 0), "nan") if leaf is None else rows.take(leaf, 0)

    def _at_few_points(self, x: ArrayLike, query: Callable[..., Any]) -> Any:
        """Return ``query(*x)`` for a single point ``x``, or the list of these results for an array of 1 to 8 points.

        Return None for any other input, and if ``query`` returns None at a point.
        """
        if type(x) is np.ndarray:
            if x.ndim == 2 and 0 < len(x) <= _FEW:
                answers = [self._at_few_points(point, query) for point in x.tolist()]
                return None if any(answer is None for answer in answers) else answers
            if x.ndim != 1:
                return None
            x = x.tolist()
        elif type(x) is not tuple and type(x) is not list:
            return None
        if len(x) != self.dim or type(x[0]) not in _PLAIN:
            return None
        try:
            return query(*x)
        except (TypeError, ValueError):  # coordinates that are no numbers
            return None

    def _evaluate(self, x: ArrayLike, answer: Callable[..., Any], outside: Outside = "inf") -> Any:
        """Return ``answer(offsets, leaf)`` for all points ``x``, ``(..., dim)``, computed in chunks.

        ``offsets`` has an array for each axis: points minus the domain's lower corner. ``leaf`` has the indices of
        the points' leaves. ``outside`` is the answer at points outside the domain: ``"inf"``, ``"clamp"`` or
        ``"nan"``.
        """
        x, program = as_queries(x, self.dim), self._program
        flat, parts = x.reshape(-1, self.dim), []
        with np.errstate(all="ignore"):
            for start in range(0, max(1, len(flat)), _CHUNK):
                # 1. Wrap 64-bit points; round coordinates to 32 bits, unless the domain is far from 0.
                points = flat[start : start + _CHUNK]
                if program.corner is not None:
                    points = points.astype(np.float64)
                given = list(np.ascontiguousarray(points.T))
                if points.dtype == np.float64:
                    given = program.wrap_in_double(ARRAYS, given)
                given = [along.astype(program.precision, copy=False) for along in given]
                # 2. Answer as if points outside were at the lower corner, then replace their answers.
                is_outside = ~program.contains(ARRAYS, given)
                if not is_outside.any():
                    parts.append(self._evaluate_inside(program.relative(ARRAYS, given), answer))
                    continue
                lo = self.domain.lo.astype(program.precision)
                moved = [np.where(is_outside, least, along) for along, least in zip(given, lo, strict=True)]
                parts.append(self._evaluate_inside(program.relative(ARRAYS, moved), answer))
                others = np.nan if outside == "nan" else np.inf
                if outside == "clamp":
                    beyond = [along[is_outside] for along in given]
                    others = self._evaluate_clamped(program.relative(ARRAYS, beyond), answer)
                others = np.where(np.isnan(points[is_outside]).any(axis=1), np.nan, others)
                parts[-1][is_outside] = others.reshape(-1, *[1] * (parts[-1].ndim - 1))
        answers = np.concatenate(parts)
        return answers.reshape((*x.shape[:-1], *answers.shape[1:]))[()]

    def _evaluate_inside(self, relative: list[np.ndarray], answer: Callable[..., Any]) -> np.ndarray:
        offsets = self._program.offsets(ARRAYS, relative)
        return answer(offsets, self._table.rows(self._program.fractions(ARRAYS, offsets)))

    def _evaluate_clamped(self, relative: list[np.ndarray], answer: Callable[..., Any]) -> np.ndarray:
        """Return, for points outside the domain, the answer at the domain's nearest point plus the distance to it.

        ``relative`` has the points as :meth:`Program.relative` returns them. The result is ``inf`` if a coordinate is
        not finite.
        """
        is_finite = np.isfinite(relative).all(axis=0)
        relative = [np.where(is_finite, along, np.float32(0)) for along in relative]
        ends = zip(relative, *self._program.limits, self.domain.periodic, strict=True)
        nearest = [along if is_periodic else clamp(ARRAYS, along, lo, hi) for along, lo, hi, is_periodic in ends]
        move = [along - to for along, to in zip(relative, nearest, strict=True)]
        # |move| = scale * |move / scale|, since squares of large or small coordinates would overflow or vanish.
        scale = np.abs(move).max(axis=0)
        scale = np.where(scale > 0, scale, np.float32(1))
        length = scale * np.sqrt(reduce(add, [np.square(along / scale) for along in move]))
        return np.where(is_finite, self._evaluate_inside(nearest, answer) + length, np.float32(np.inf))

    def _values(self, offsets: list[np.ndarray], leaf: np.ndarray) -> np.ndarray:
        return self._program.value(ARRAYS, offsets, [column[leaf] for column in self._columns])

    def _bounds(self, offsets: list[np.ndarray], leaf: np.ndarray) -> np.ndarray:
        """Return proven lower bounds (at least 0) and upper bounds of the distance at points, ``(n, 2)``.

        All bounds are rounded outward. Where the PLR is not finite, both bounds equal the PLR's value.
        """
        assert self._band is not None, "bounds are called only with a proof"
        value = self._values(offsets, leaf)
        band = self._band if self._band.shape[1] == 1 else self._band[:, leaf]  # one for all leaves, or one for each
        lower = np.nextafter(value + band[0], np.float32(-np.inf))
        if (straight := self._program.straight_bound(ARRAYS, offsets)) is not None:
            lower = np.maximum(lower, straight)
        upper = np.nextafter(value + band[1], np.float32(np.inf))
        is_finite = value < np.inf
        return np.stack([np.where(is_finite, np.maximum(lower, 0), value), np.where(is_finite, upper, value)], axis=1)


def _as_indices(numbers: np.ndarray) -> Any:
    return np.where(numbers >= 0, numbers, -1).astype(np.int64)[()]
