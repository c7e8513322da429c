"""A PLR as a module of JavaScript, by the same arithmetic as the header of C."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.box import Box
from plr_jax.plr._file import Contents
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import as_sourced
from plr_jax.plr.portable.arithmetic import Operations, PartitionedAxis, Point, Program, Value, Window
from plr_jax.plr.portable.writers import BracedWriter, Code, Text, ends_of, filled_lines, indented
from plr_jax.plr.tree import Cells, levels_of


class JavaScriptWriter(BracedWriter):
    """Of JavaScript, whose numbers have 64 bits: ``f`` rounds each operation to 32."""

    root_of, cast = "f(Math.sqrt({}))", "f({})"

    def rounded_to_type(self, value: Text) -> Text:
        """In 32 bits, where it is of such a type."""
        return self.rounded(value) if value.type == "float" else value

    def literal(self, number: np.floating) -> str:
        """The shortest decimal of the number in 64 bits."""
        return _decimal(float(number))

    def definition(self, name: str, value: Text) -> str:
        """A constant."""
        return f"const {name} = {value};"

    def floor(self, x: Text) -> Text:
        """Exact in both precisions."""
        return self.atom(f"Math.floor({x})", x.type)

    def fraction(self, x: Text) -> Text:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"{x} * {1 << 23} << 9", "uint32_t")


_TABLE_BITS = 14  # of a table that fits a core's first-level cache, or nearly so
_FRAME = ("lo", "hi", "scale", "start", "top")
NAMED_NUMBERS = "const " + ", ".join(f"[{name}0, {name}1] = tables.{name}" for name in _FRAME) + ";"
"""The statement of JavaScript that names the numbers of a domain that ``frameOf`` of ``file.js`` gives."""


def tables_axes(do: JavaScriptWriter) -> list[PartitionedAxis]:
    """The axes of a domain in the plane whose numbers have the names that :data:`NAMED_NUMBERS` gives them."""
    names = ("lo", "scale", "start", "top")
    return [PartitionedAxis(*(do.atom(f"{name}{axis}") for name in names)) for axis in range(2)]


class _OfTables(Program):
    """A query of any cones in the plane: what it computes with has names, as ``readCones`` of ``file.js`` has it."""

    @cached_property
    def axes(self) -> list[PartitionedAxis]:
        return tables_axes(JavaScriptWriter())

    @cached_property
    def windows(self) -> list[Window]:
        do = JavaScriptWriter()
        return [Window(do.atom(f"lo{axis}"), do.atom(f"hi{axis}")) for axis in range(2)]

    def _counted(self, do: Operations, x: Point, axis: int) -> Value:
        return do.let("counted", do.rounded(x[axis] - _origin(axis)))

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        from_corner = zip(self.axes, as_sourced(self.leaf).source_of(numbers), strict=True)
        return [_origin(axis) + (grid.lo + along) for axis, (grid, along) in enumerate(from_corner)]


def _origin(axis: int) -> Text:
    return JavaScriptWriter().atom(f"origin{axis}", "double")


def js_file_reader() -> str:
    """Functions of JavaScript that read files, with those that they need."""
    return "\n".join([ROUNDED, BESIDE, Path(__file__).with_name("file.js").read_text(encoding="utf-8")])


def js_cone_reader() -> str:
    """A function of JavaScript that makes a reader of what ``readCones`` of ``file.js`` gives."""
    halves = Cells.root(2).split(np.zeros(1, int))  # any, of more than one leaf
    contents = Contents(Box((0, 0), (1, 1)), leaf_model("cone"), levels_of(halves)[0], halves, None)
    program = _OfTables(contents, contents.domain, np.zeros(2), contents.domain, np.zeros((2, 3), np.float32))
    lines = [
        NAMED_NUMBERS,
        "const { tree, root, numbers } = tables, [origin0, origin1] = tables.origin, place = new Uint32Array(2);",
        *(line.removeprefix("export ") for line in _Module(program, np.zeros((2, 1))).functions()),
        "return { distance, waypoint, bounds };",
    ]
    return "\n".join(function("function coneReader(tables)", lines))


def js_module(program: Program) -> str:
    """The module of a PLR: see :meth:`PLR.js_module`."""
    certificate = program.contents.certificate
    module = _Module(program, None if certificate is None else certificate.bounds())
    return "\n".join([*module.introduction(), *module.tables(), *module.functions()])


class _Module(Code[JavaScriptWriter]):
    """The parts of a module.

    Args:
        program: What a query computes.
        band: What is to be added to values for lower and upper bounds, of each leaf or of all; None if nothing is
            proven.
    """

    def __init__(self, program: Program, band: Float[np.ndarray, "2 _"] | None) -> None:
        columns = program.numbers_of_leaves
        if band is not None:
            both = np.broadcast_to(band.T.astype(np.float32), (len(columns), 2))
            columns = np.column_stack([columns, both])
        super().__init__(program, "double", columns)
        self.is_proven = band is not None

    def writer(self) -> JavaScriptWriter:
        """Of a function."""
        return JavaScriptWriter()

    def introduction(self) -> list[str]:
        """What the module is, in a comment."""
        program, names = self.program, "[" + ", ".join("xyz"[: self.program.dim]) + "]"
        if program.dim > 3:
            names = f"[{', '.join(f'x{axis}' for axis in range(program.dim))}]"
        waypoint = f"// waypoint({names}): where to go straight to from a point; NaN outside the domain."
        bounds = f"// bounds({names}): proven bounds of the distance where the goal can be reached, [lower, upper]."
        return [
            f"// The distance to a goal, by plr_jax: {len(program.cells)} leaves of kind {program.leaf.name!r}.",
            "//",
            f"// distance({names}): distance from a point {ends_of(program.domain)};",
            "// Infinity outside this closed domain, NaN where a coordinate is. It knows no obstacles.",
            *([waypoint] if self.is_sourced else []),
            *([bounds] if self.is_proven else []),
            "// Answers are those of plr.numpy() to points of 64 bits, bit for bit.",
            "",
        ]

    def tables(self) -> list[str]:
        """The tree, and the numbers of the leaves."""
        tree, dim = self.tree, self.program.dim
        lines = [ROUNDED, *([BESIDE] if self.is_proven else [])]
        if self.has_tree:
            lines += [
                "// Both halves of every cell that is split, the lower first. Of one that is split again, its index",
                f"// here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {tree.dim}.",
                f"const tree = new Uint{8 * tree.code_type.itemsize}Array([",
                *filled_lines(map(str, tree.children.ravel().tolist())),
                "]);",
                f"const root = {tree.root};",
                f"const place = new Uint32Array({dim});",
                *([f"const count = new Float64Array({dim}), cell = new Float64Array({dim});"] * self._counts_cells),
            ]
        return [
            *lines,
            f"const numbers = new Float32Array([ // {self.rows.shape[1]} each",
            *filled_lines(map(single, self.rows.ravel())),
            "]);",
            "",
        ]

    @property
    def _counts_cells(self) -> bool:
        return self.program.leaf.is_of_cells and self.has_tree

    def functions(self) -> list[str]:
        """The functions."""
        do, value = self.distance("NaN", "Infinity")
        do.statements.append(f"return {value};")
        lines = [*self._descent(), *function("export function distance(x)", do.used_statements())]
        if self.is_sourced:
            do, waypoint = self.waypoint([f"return [{', '.join(['NaN'] * self.program.dim)}];"])
            do.statements.append(f"return [{', '.join(map(str, waypoint))}];")
            lines += function("export function waypoint(x)", do.used_statements())
        if self.is_proven:
            do, value = self.distance("[NaN, NaN]", "[Infinity, Infinity]")
            below, above = (f"f(value + numbers[n + {self.rows.shape[1] + end}])" for end in (-2, -1))
            do.statements += [
                f"const value = {value};",
                "if (value === Infinity) return [value, value];",
                f"const lower = beside({below}, false);",
                f"return [lower > 0 ? lower : 0, beside({above}, true)];",
            ]
            lines += function("export function bounds(x)", do.used_statements())
        return lines

    def _descent(self) -> list[str]:
        """From places to the leaf's row: down the tree, or, where its cells are not counted, mostly by a table."""
        if not self.has_tree:
            return []
        tree, of_cells, mask = self.tree, self._counts_cells, (1 << self.tree.kind_bits) - 1
        statements = [
            *(["count.fill(1);", "cell.fill(0);"] * of_cells),
            "let code = root;",
            f"for (let axis = code & {mask}; axis !== {tree.dim}; axis = code & {mask}) {{",
            "    const upper = place[axis] >>> 31;",
            "    place[axis] <<= 1;",
            *(["    count[axis] *= 2;", "    cell[axis] = 2 * cell[axis] + upper;"] * of_cells),
            f"    code = tree[2 * (code >>> {tree.kind_bits}) + upper];",
            "}",
            f"return code >>> {tree.kind_bits};",
        ]
        comment = "// Down the tree: each split takes the next bit of the place along its axis."
        bits = _TABLE_BITS // tree.dim
        if of_cells or not bits:
            return [comment, *function("function leaf()", statements)]
        index = " | ".join(
            f"place[{axis}] >>> {32 - bits}" + (f" << {above}" if (above := bits * (tree.dim - 1 - axis)) else "")
            for axis in range(tree.dim)
        )
        return [
            comment,
            *function("function descend()", statements),
            f"// Of each cell of a grid, {1 << bits} an axis: one more than the row, or 0 for several leaves.",
            "// Behind the bits of its place one more is set, the last; none is left if that was taken.",
            f"const grid = new Uint32Array({1 << bits * tree.dim});",
            "for (let index = 0; index < grid.length; index++) {",
            *(
                f"    place[{axis}] = (index >>> {bits * (tree.dim - 1 - axis)}) << {32 - bits} | {1 << 31 - bits};"
                for axis in range(tree.dim)
            ),
            "    const row = descend();",
            "    grid[index] = place.every(left => left !== 0) ? row + 1 : 0;",
            "}",
            "",
            *function("function leaf()", [f"const row = grid[{index}];", "return row ? row - 1 : descend();"]),
        ]

    def read_leaf(self, do: JavaScriptWriter, places: list[Text]) -> list[Text]:
        """The first of the leaf's numbers, to which the places lead down the tree."""
        row, width = "0", self.rows.shape[1]
        if self.has_tree:
            do.statements += [f"place[{axis}] = {place};" for axis, place in enumerate(places)]
            row = "leaf()" if width == 1 else f"{width} * leaf()"
        do.statements.append(f"const n = {row};")
        return [do.atom(f"numbers[n + {i}]" if i else "numbers[n]") for i in range(width - 2 * self.is_proven)]

    def cells(self, do: JavaScriptWriter) -> list[tuple[Text, Text]]:
        """Counted on the way down the tree."""
        if not self._counts_cells:
            return [(do.atom("1"), do.atom("0"))] * self.program.dim
        return [(do.atom(f"count[{axis}]"), do.atom(f"f(cell[{axis}])")) for axis in range(self.program.dim)]


ROUNDED = "const f = Math.fround; // each operation is rounded to 32 bits"
BESIDE = """\
// The next 32-bit float above a number of 32 bits, or below it.
const bits = new Float32Array(1), whole = new Int32Array(bits.buffer);
function beside(x, isAbove) {
    if (x === 0) return isAbove ? 2 ** -149 : -(2 ** -149);
    if (x !== x || x === (isAbove ? Infinity : -Infinity)) return x;
    bits[0] = x;
    whole[0] += x > 0 === isAbove ? 1 : -1;
    return bits[0];
}"""


def single(number: np.float32) -> str:
    """The shortest decimal that JavaScript reads in 64 bits and rounds to this 32-bit float."""
    text = str(number)
    return _decimal(text if np.isinf(number) or np.float32(float(text)) == number else float(number))


def _decimal(number: Any) -> str:
    """A decimal as JavaScript spells it, without what it needs not."""
    text = str(number).removesuffix(".0")
    return text.replace("inf", "Infinity")


def function(signature: str, statements: list[str]) -> list[str]:
    """A function."""
    return [f"{signature} {{", *indented(statements), "}", ""]
