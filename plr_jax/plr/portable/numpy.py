"""A PLR in NumPy alone, which answers by the arithmetic of the format."""

import os
from collections.abc import Callable
from functools import cached_property, reduce
from math import floor, sqrt
from operator import add
from typing import Any

import numpy as np
from jaxtyping import Float, Integer, UInt32

from plr_jax._arrays import as_queries, shortened
from plr_jax._files import file_path
from plr_jax._types import ArrayLike
from plr_jax.plr._file import decode
from plr_jax.plr.container import read_bytes
from plr_jax.plr.frame import FRACTION_BITS, Outside, as_outside, spread_bits
from plr_jax.plr.leaves import as_sourced
from plr_jax.plr.portable.arithmetic import ARRAYS, CodedTree, Program, clamp
from plr_jax.plr.portable.c import c_header
from plr_jax.plr.portable.javascript import js_module
from plr_jax.plr.portable.writers import Emitter, Expression


class PythonEmitter(Emitter):
    """Of Python, where numbers are NumPy's scalars; ``constants`` are those that the program names."""

    conjunction, conditional = "and", "({1} if {0} else {2})"
    root_of, cast, definition = "float32(sqrt({}))", "float32({})", "{name} = {value}"

    def __init__(self) -> None:
        super().__init__()
        self.constants: dict[str, Any] = {}

    def literal(self, number: np.floating) -> str:
        """The name of a constant."""
        name = f"k{len(self.constants)}"
        self.constants[name] = number
        return name

    def floor(self, x: Expression) -> Expression:
        """The floor as a scalar of the same type."""
        return self.atom(f"{'float64' if x.type == 'double' else 'float32'}(floor({x}))", x.type)

    def fraction(self, x: Expression) -> Expression:
        """The product is exact."""
        return self.atom(f"(int({x * np.float32(1 << 23)}) & {(1 << 23) - 1})", "uint32_t")


_MOST_BITS = 16  # of the table, which then fits a core's second-level cache


class LeafTable:
    """A table of nodes, one for each cell of a grid, and the tree below them.

    Attributes:
        tree: The tree.
        bits: Of a place along each axis, that tell cells of the grid apart.
        table: Code of the node that holds each cell, the deepest one.
        children: Of the tree's split nodes, side by side, in the type of the table.
        kind: The bits of a code that are its kind.
        is_flat: Whether the table knows every leaf.
    """

    def __init__(self, tree: CodedTree) -> None:
        """Of a tree."""
        self.tree, self.kind = tree, (1 << tree.kind_bits) - 1
        deepest = np.zeros(tree.dim, np.int64)
        np.maximum.at(deepest, tree.axis, tree.depth + 1)
        bits = spread_bits(deepest, _MOST_BITS)
        cell = np.indices((1 << bits).tolist()).reshape(tree.dim, -1)
        code = np.full(cell.shape[1], tree.root)
        moving = np.arange(len(code))
        while len(moving):
            node = code[moving] >> tree.kind_bits
            is_split = code[moving] & self.kind < tree.dim
            below = np.zeros(len(moving), np.int64)
            below[is_split] = (bits[tree.axis] - 1 - tree.depth)[node[is_split]]
            moves = is_split & (below >= 0)
            moving, node, below = moving[moves], node[moves], below[moves]
            code[moving] = tree.children[node, (cell[tree.axis[node], moving] >> below) & 1]
        self.bits, self.is_flat = tuple(bits.tolist()), bool((code & self.kind == tree.dim).all())
        self.table, self.children = (codes.astype(tree.code_type) for codes in (code, tree.children.ravel()))

    def rows(self, fractions: list[UInt32[np.ndarray, "n"]]) -> Integer[np.ndarray, "n"]:
        """The row of numbers for each place."""
        index = fractions[0] >> (FRACTION_BITS - self.bits[0])
        for place, bits in zip(fractions[1:], self.bits[1:], strict=True):
            index = (index << bits) | (place >> (FRACTION_BITS - bits))
        code = self.table[index]
        moving = np.flatnonzero(code & self.kind != self.tree.dim)
        while len(moving):
            node = code[moving] >> self.tree.kind_bits
            axis = self.tree.axis[node]
            place = np.choose(axis, [along[moving] for along in fractions])
            bit = (place >> (FRACTION_BITS - 1 - self.tree.depth[node])) & 1
            code[moving] = self.children[2 * node + bit]
            moving = moving[code[moving] & self.kind != self.tree.dim]
        return code >> self.tree.kind_bits


# A query of a single point in Python: the arithmetic of the format, written out for one PLR.
#
# What the steps are is known beforehand, and so is every number but the leaf's; what is left takes a few
# microseconds.


_UNWRAPPED = 1 - 2.0**-48  # of the width, up to where wrapping leaves coordinates as they are, however it rounds
_LARGEST = float(np.finfo(np.float64).max)


class _Rows(dict):
    """Rows of a table as tuples of scalars, each made when it is first read."""

    def __init__(self, table: Float[np.ndarray, "rows count"]):
        self._table = table

    def __missing__(self, row: int) -> tuple[np.float32, ...]:
        self[row] = numbers = tuple(self._table[row])
        return numbers


def point_query(
    program: Program, table: LeafTable, numbers: Float[np.ndarray, "leaves count"]
) -> Callable[..., np.float32 | None]:
    """The value at a point, given by its coordinates; None unless it is plainly inside or outside the domain.

    Outside it is ``inf``, or NaN where a coordinate is. ``numbers`` are those of the leaves, cells first.
    """
    do, domain, tree = PythonEmitter(), program.domain, table.tree
    children, depth = table.children.data, tree.depth.data  # whose entries are integers of Python

    def descend(code: int, fractions: tuple[int, ...]) -> int:
        """The row of numbers for one place, below the node of that code."""
        while (axis := code & table.kind) != tree.dim:
            node = code >> tree.kind_bits
            code = children[2 * node + ((fractions[axis] >> (FRACTION_BITS - 1 - depth[node])) & 1)]
        return code >> tree.kind_bits

    # 1. Outside, beyond which numbers points are however they round, and inside.
    given = [f"x{axis}" for axis in range(program.dim)]
    # Beside the upper end of a periodic axis, wrapping in 64 bits may lead to the lower one.
    unwrapped = np.minimum(domain.lo + domain.width * _UNWRAPPED, np.nextafter(domain.hi, -np.inf))
    last = np.where(domain.periodic, unwrapped, domain.hi)
    ends = zip(given, domain.lo.tolist(), last.tolist(), strict=True)
    inside = [f"{lo!r} <= {name} <= {hi!r}" for name, lo, hi in ends]
    origin, beyond = (np.zeros(program.dim) if program.corner is None else domain.lo).tolist(), []
    for axis, (lo, hi) in enumerate(zip(*program.limits, strict=True)):
        if domain.periodic[axis]:
            beyond.append((-_LARGEST, _LARGEST))
            continue
        below, above = np.nextafter(lo, np.float32(-np.inf)), np.nextafter(hi, np.float32(np.inf))
        beyond.append((origin[axis] + float(below), origin[axis] + float(above)))
    outside = [
        f"({name} < {least!r}) | ({name} > {most!r})" for name, (least, most) in zip(given, beyond, strict=True)
    ]
    is_nan = " or ".join(f"{name} != {name}" for name in given)
    # 2. Its leaf.
    precision = np.dtype(program.precision).name
    of_type = "float" if precision == "float32" else "double"
    x = [do.let("x", do.atom(f"{precision}({name})", of_type)) for name in given]
    x = program.fold_and_wrap(do, program.relative(do, x))
    offsets = program.offsets(do, x)
    fractions = [str(do.let("place", place)) for place in program.fractions(do, offsets)]
    shifted = [f"{place} >> {FRACTION_BITS - bits}" for place, bits in zip(fractions, table.bits, strict=True)]
    index = shifted[0]
    for along, bits in zip(shifted[1:], table.bits[1:], strict=True):
        index = f"({index}) << {bits} | {along}"
    row = (
        f"codes[{index}] >> {tree.kind_bits}"
        if table.is_flat
        else f"descend(codes[{index}], ({', '.join(fractions)},))"
    )
    # 3. The leaf's value.
    names = [f"n{i}" for i in range(numbers.shape[1])]
    do.statements += [f"leaf = {row}", f"{', '.join(names)}, = rows[leaf]"]
    value = program.value(do, offsets, [do.atom(name) for name in names])
    lines = [
        f"if not ({' and '.join(inside)}):",
        f"    if {' | '.join(outside)}: return nan if {is_nan} else inf",  # which compares all coordinates
        "    return None",
        *do.statements,
        f"return {value}",
    ]
    source = "\n    ".join([f"def query({', '.join(given)}):", *lines])
    names_in_source: dict[str, Any] = {
        **do.constants,
        "rows": _Rows(numbers),
        "descend": descend,
        "codes": table.table.data,
        "floor": floor,
        "sqrt": sqrt,
        "inf": np.float32(np.inf),
        "nan": np.float32(np.nan),
        "float32": np.float32,
        "float64": np.float64,
    }
    exec(source, names_in_source)
    return names_in_source["query"]


_CHUNK = 1 << 14  # points whose intermediate values fit a core's second-level cache
_PLAIN = (float, int, np.float64, np.float32)


class NumpyPLR:
    """A PLR that is queried in NumPy, without JAX: by :func:`load_numpy`, or ``plr.numpy()``.

    ``f(x)`` is the distance at points ``(..., dim)``, in 32-bit floats by the arithmetic that is part of the format
    (see ``plr_jax/plr/portable``): bit for bit what a header of :meth:`PLR.c_header` answers. It is NaN where a
    coordinate is, and outside the closed domain ``inf``, or what is asked for. So are those of ``plr(x)`` on a CPU,
    but for numbers below 1e-38.

    The distance at a single point, as a tuple, a list or an array, takes a few microseconds, a batch some nanoseconds
    a point. All else takes 50 to 250 microseconds, however few the points: waypoints, bounds, a single point around a
    periodic axis, or one outside for which another answer than ``inf`` is asked.
    Coordinates are rounded to 32 bits, but those of 64 bits after they are placed where that matters: in a domain far
    from the origin, and around periodic axes.

    Attributes:
        dim: Number of axes.
        domain: The closed box that the PLR covers.
        num_leaves: Number of leaves of the partition.
        max_error: Proven bound of the largest error anywhere, in units of distance; None if there is none.
    """

    def __init__(self, data: bytes):
        """Of the bytes of a file; raises ``ValueError`` saying what is wrong with them."""
        if not isinstance(data, bytes | bytearray | memoryview):
            raise ValueError(
                f"data must be the bytes of a PLR file, got {shortened(data)}; of a file's name use load_numpy, of a "
                "PLR plr.numpy()."
            )
        self._data = bytes(data)
        self._program = program = Program(decode(self._data))
        cells, self.dim, self.domain = program.contents.tree.leaves, program.dim, program.domain
        self.num_leaves = len(cells)
        self._table = LeafTable(CodedTree(program.contents.tree, np.arange(self.num_leaves)))
        numbers = program.leaf_parameters
        if program.leaf.is_cell_relative:  # how many cells span the domain along each axis, and which it is
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

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        return self._data

    def c_header(self, name: str) -> str:
        """The same as one header of C99: see :meth:`PLR.c_header`."""
        return c_header(self._program, name)

    def js_module(self) -> str:
        """The same as one module of JavaScript: see :meth:`PLR.js_module`."""
        return js_module(self._program)

    def __call__(self, x: ArrayLike, *, outside: Outside = "inf") -> Any:
        """Distance at each point.

        Args:
            x: Points, ``(..., dim)``.
            outside: What points outside the domain get, as for :func:`evaluate`: ``"inf"``; ``"clamp"``, the value at
                the nearest point of the domain plus the straight-line distance to it, ``inf`` if a coordinate is
                infinite in 32 bits; or ``"nan"``. It changes no answer inside.

        Returns:
            Distances, ``(...)``, float32; of a single point, a scalar.

        Raises:
            ValueError: If the points are not numbers of that shape, or ``outside`` is none of the three.
        """
        if outside != "inf":
            outside = as_outside(outside)
        answer = self._at_point(x)
        if answer is None or (outside != "inf" and np.isinf(answer)):
            return self._evaluate(x, self._values, (), outside)
        return answer

    def waypoint(self, x: ArrayLike) -> Any:
        """Where to go straight to from each point: the source of the leaf that holds it.

        Args:
            x: Points, ``(..., dim)``.

        Returns:
            Points, ``(..., dim)``, float32, in a domain far from the origin float64; NaN outside the domain and for
            NaN.

        Raises:
            ValueError: If leaves have no sources, as only those of cones do, or as for a query.
        """
        as_sourced(self._program.leaf)
        return self._evaluate(x, self._waypoints, (self.dim,))

    def bounds(self, x: ArrayLike) -> tuple[Any, Any]:
        """Proven bounds of the distance at each point from which the goal can be reached, as :meth:`PLR.bounds`.

        Args:
            x: Points, ``(..., dim)``.

        Returns:
            Lower bounds, at least 0, and upper bounds, ``(...)`` each, float32. Both are ``inf`` outside the domain,
            NaN where a coordinate is.

        Raises:
            ValueError: If nothing is proven of the PLR, or as for a query.
        """
        if self._band is None:
            raise ValueError("Nothing is proven of this PLR: construct it with certified=True, or use certify.")
        answers = self._evaluate(x, self._bounds, (2,))
        return answers[..., 0], answers[..., 1]

    @cached_property
    def _point_query(self) -> Callable[..., np.float32 | None]:
        return point_query(self._program, self._table, self._columns.T)

    def _at_point(self, x: ArrayLike) -> np.float32 | None:
        """The value at a single point, ``inf`` outside; None of what is none, or not plainly in or out."""
        if type(x) is np.ndarray:
            if x.ndim != 1:
                return None
            x = x.tolist()
        elif type(x) is not tuple and type(x) is not list:
            return None
        if len(x) != self.dim or type(x[0]) not in _PLAIN:
            return None
        try:
            return self._point_query(*x)
        except (TypeError, ValueError):  # of coordinates that are no numbers
            return None

    def _evaluate(
        self, x: ArrayLike, answer: Callable[..., Any], shape: tuple[int, ...], outside: Outside = "inf"
    ) -> Any:
        """Answers of that shape to points, chunk by chunk."""
        x, program = as_queries(x, self.dim), self._program
        flat = x.reshape(-1, self.dim)
        of_type = np.float64 if answer == self._waypoints and program.corner is not None else np.float32
        answers = np.empty((len(flat), *shape), of_type)
        with np.errstate(all="ignore"):
            for start in range(0, len(flat), _CHUNK):
                points, part = flat[start : start + _CHUNK], answers[start : start + _CHUNK]
                if program.corner is not None:
                    points = points.astype(np.float64)
                given = list(np.ascontiguousarray(points.T))
                if points.dtype == np.float64:
                    given = program.wrap_in_double(ARRAYS, given)
                given = [along.astype(program.precision, copy=False) for along in given]
                if (inside := program.contains(ARRAYS, given)).all():
                    part[...] = self._evaluate_inside(program.relative(ARRAYS, given), answer)
                    continue
                lo = self.domain.lo.astype(program.precision)
                moved = [np.where(inside, along, least) for along, least in zip(given, lo, strict=True)]
                part[...] = self._evaluate_inside(program.relative(ARRAYS, moved), answer)
                is_nan, others = np.isnan(points[~inside]).any(axis=1), np.inf
                if outside == "clamp":
                    others = self._evaluate_clamped(
                        program.relative(ARRAYS, [along[~inside] for along in given]), answer
                    )
                elif outside == "nan" or answer == self._waypoints:
                    others = np.nan
                part[~inside] = np.reshape(np.where(is_nan, np.nan, others), (-1, *[1] * len(shape)))
        return answers.reshape((*x.shape[:-1], *shape))[()]

    def _evaluate_inside(self, relative: list[np.ndarray], answer: Callable[..., Any]) -> np.ndarray:
        """Answers to points of the domain, by columns."""
        offsets = self._program.offsets(ARRAYS, self._program.fold_and_wrap(ARRAYS, relative))
        return answer(offsets, self._table.rows(self._program.fractions(ARRAYS, offsets)))

    def _evaluate_clamped(self, relative: list[np.ndarray], answer: Callable[..., Any]) -> np.ndarray:
        """Answers at the nearest points of the domain, and how far those are; ``inf`` where that is without end."""
        is_finite = np.isfinite(relative).all(axis=0)
        relative = [np.where(is_finite, along, np.float32(0)) for along in relative]
        ends = zip(relative, *self._program.limits, self.domain.periodic, strict=True)
        nearest = [along if is_periodic else clamp(ARRAYS, along, lo, hi) for along, lo, hi, is_periodic in ends]
        moved = [along - to for along, to in zip(relative, nearest, strict=True)]
        scale = np.abs(moved).max(axis=0)
        scale = np.where(scale > 0, scale, np.float32(1))
        way = scale * np.sqrt(reduce(add, [np.square(along / scale) for along in moved]))
        return np.where(is_finite, self._evaluate_inside(nearest, answer) + way, np.float32(np.inf))

    def _values(self, offsets: list[np.ndarray], leaf: np.ndarray) -> np.ndarray:
        return self._program.value(ARRAYS, offsets, [column[leaf] for column in self._columns])

    def _waypoints(self, _: list[np.ndarray], leaf: np.ndarray) -> np.ndarray:
        return np.stack(self._program.waypoint([column[leaf] for column in self._columns]), axis=1)

    def _bounds(self, offsets: list[np.ndarray], leaf: np.ndarray) -> np.ndarray:
        assert self._band is not None, "bounds are asked for where there is a proof"
        value, band = self._values(offsets, leaf), self._band if self._band.shape[1] == 1 else self._band[:, leaf]
        lower = np.nextafter(value + band[0], np.float32(-np.inf))
        if (straight := self._program.straight_bound(ARRAYS, offsets)) is not None:
            lower = np.maximum(lower, np.minimum(straight, value))
        upper = np.nextafter(value + band[1], np.float32(np.inf))
        finite = value < np.inf
        return np.stack([np.where(finite, np.maximum(lower, 0), value), np.where(finite, upper, value)], axis=1)


def load_numpy(path: str | os.PathLike) -> NumpyPLR:
    """Read a PLR that :func:`save` wrote, to query it in NumPy: JAX is not imported.

    Args:
        path: The file.

    Returns:
        What answers points, by the arithmetic that is part of the format.

    Raises:
        ValueError: If the file is truncated, corrupt, no PLR file, of pairs, or of another version of the format.
        OSError: If the file cannot be read.
    """
    path = file_path(path)
    try:
        return NumpyPLR(read_bytes(path))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR: {error}.") from error
