"""A PLR as a module of JavaScript, by the same arithmetic as the header of C."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr._file import DecodedFile
from plr_jax.plr.frame import Frame
from plr_jax.plr.leaves import Cone, ConeFiles, as_sourced
from plr_jax.plr.portable.arithmetic import CodedTree, Program, Value, distinct_rows
from plr_jax.plr.portable.writers import (
    Emitter,
    Expression,
    ends_of,
    filled_lines,
    indented,
    is_nan,
    write_lookup,
)
from plr_jax.plr.tree import Cells, tree_of


class JavaScriptWriter(Emitter):
    """Of JavaScript, whose numbers have 64 bits: ``f`` rounds each operation to 32."""

    root_of, cast, is_rounded = "f(Math.sqrt({}))", "f({})", False
    definition = "const {name} = {value};"

    def literal(self, number: np.floating) -> str:
        """The shortest decimal of the number in 64 bits."""
        return _decimal(float(number))

    def floor(self, x: Expression) -> Expression:
        """Exact in both precisions."""
        return self.atom(f"Math.floor({x})", x.type)

    def fraction(self, x: Expression) -> Expression:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"{x} * {1 << 23} << 9", "uint32_t")


_TABLE_BITS = 14  # of a table that fits a core's first-level cache, or nearly so


class _OfTables(Program):
    """A query of any cones in the plane: what it computes with has names, as ``readCones`` of ``file.js`` has it."""

    def __init__(self) -> None:
        domain, halves = Box((0, 0), (1, 1)), tree_of(Cells.root(2).split(np.zeros(1, int)))
        goal = Sources(np.zeros((1, 2)), np.zeros(1), np.zeros(1, int))
        stored = ConeFiles(goal, domain).stored(np.zeros(2, int))  # any, of more than one leaf
        super().__init__(DecodedFile(domain, Cone(), halves, stored))

        def named(name: str, of_type: str = "float") -> list[Expression]:
            return [JavaScriptWriter().atom(f"{name}{axis}", of_type) for axis in range(2)]

        self.frame = [named(row.name.lower()) for row in Frame]
        self.window = [self.frame[Frame.LO], self.frame[Frame.HI]]
        self.corner = named("origin", "double")

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        source, corner = as_sourced(self.leaf).source_of(numbers), self.frame[Frame.LO]
        return [origin + (lo + along) for origin, lo, along in zip(self.corner, corner, source, strict=True)]


def js_file_reader() -> str:
    """Functions of JavaScript that read files, with those that they need."""
    return "\n".join([ROUNDED, BESIDE, Path(__file__).with_name("file.js").read_text(encoding="utf-8")])


def js_cone_reader() -> str:
    """A function of JavaScript that makes a reader of what ``readCones`` of ``file.js`` gives."""
    names = ", ".join(f"[{name}0, {name}1] = tables.{name}" for name in ("lo", "hi", "scale", "start", "top"))
    program, rows = _OfTables(), np.zeros((2, 5), np.float32)
    tree = CodedTree(program.contents.tree, np.zeros(2, int))
    lines = [
        f"const {names};",
        "const { tree, root, numbers } = tables, [origin0, origin1] = tables.origin, place = new Uint32Array(2);",
        *(line.removeprefix("export ") for line in _functions(program, tree, rows.shape[1], True)),
        "return { distance, waypoint, bounds };",
    ]
    return "\n".join(function("function coneReader(tables)", lines))


def js_module(program: Program) -> str:
    """The module of a PLR: see :meth:`PLR.js_module`."""
    dim, leaf, certificate, columns = program.dim, program.leaf, program.contents.certificate, program.numbers
    if certificate is not None:  # what is to be added to values for lower and upper bounds
        both = np.broadcast_to(certificate.bounds().T.astype(np.float32), (len(columns), 2))
        columns = np.column_stack([columns, both])
    rows, row_of_leaf = distinct_rows(columns)
    tree = CodedTree(program.contents.tree, row_of_leaf)

    # 1. What the module is, in a comment.
    names = f"[{', '.join(f'x{axis}' if dim > 3 else 'xyz'[axis] for axis in range(dim))}]"
    waypoint = f"// waypoint({names}): where to go straight to from a point; NaN outside the domain."
    bounds = f"// bounds({names}): proven bounds of the distance where the goal can be reached, [lower, upper]."
    lines = [
        f"// The distance to a goal, by plr_jax: {len(row_of_leaf)} leaves of kind {leaf.name!r}.",
        "//",
        f"// distance({names}): distance from a point {ends_of(program.domain)};",
        "// Infinity outside this closed domain, NaN where a coordinate is. It knows no obstacles.",
        *([waypoint] * isinstance(leaf, Cone)),
        *([bounds] * (certificate is not None)),
        "// Answers are those of plr.numpy() to points of 64 bits, bit for bit.",
        "",
    ]
    # 2. The tree, and the numbers of the leaves.
    lines += [ROUNDED, *([BESIDE] * (certificate is not None))]
    if len(tree.children):
        lines += [
            "// Both halves of every cell that is split, the lower first. Of one that is split again, its index",
            f"// here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {dim}.",
            f"const tree = new Uint{8 * tree.code_type.itemsize}Array([",
            *filled_lines(map(str, tree.children.ravel().tolist())),
            "]);",
            f"const root = {tree.root};",
            f"const place = new Uint32Array({dim});",
            *([f"const count = new Float64Array({dim}), cell = new Float64Array({dim});"] * leaf.is_of_cells),
        ]
    lines += [
        f"const numbers = new Float32Array([ // {rows.shape[1]} each",
        *filled_lines(map(single, rows.ravel())),
        "]);",
        "",
    ]
    return "\n".join([*lines, *_functions(program, tree, rows.shape[1], certificate is not None)])


def _functions(program: Program, tree: CodedTree, width: int, is_proven: bool) -> list[str]:
    """The functions of a program.

    Args:
        program: What a query computes.
        tree: The tree, whose leaves are rows of numbers.
        width: Numbers in a row.
        is_proven: Whether the last two of them are what is to be added to values for lower and upper bounds.
    """
    dim, has_tree = program.dim, len(tree.children) > 0

    def read_leaf(do: JavaScriptWriter, places: list[Expression]) -> list[Expression]:
        """Write how the leaf is found, and return its numbers, first those of its cell, counted on the way."""
        row, counts = "0", ["1", "0"] * dim
        if has_tree:
            do.statements += [f"place[{axis}] = {place};" for axis, place in enumerate(places)]
            row = "leaf()" if width == 1 else f"{width} * leaf()"
            counts = [text for axis in range(dim) for text in (f"count[{axis}]", f"f(cell[{axis}])")]
        do.statements.append(f"const n = {row};")
        numbers = [f"numbers[n + {i}]" if i else "numbers[n]" for i in range(width - 2 * is_proven)]
        return [do.atom(text) for text in [*counts * program.leaf.is_of_cells, *numbers]]

    def value(of_nan: str, others: str) -> tuple[JavaScriptWriter, Expression, list[Expression]]:
        """A function as far as its value, given what it answers for NaN, and else outside; and its placed point."""
        do = JavaScriptWriter()
        outside = [f"return {is_nan(dim)} ? {of_nan} : {others};"]
        above, numbers = write_lookup(do, program, "double", read_leaf, outside)
        return do, program.value(do, above, numbers), above

    do, answer, _ = value("NaN", "Infinity")
    do.statements.append(f"return {answer};")
    lines = _descent(tree, program.leaf.is_of_cells) if has_tree else []
    lines += function("export function distance(x)", do.used_statements())
    if isinstance(program.leaf, Cone):
        do, nowhere = JavaScriptWriter(), [f"return [{', '.join(['NaN'] * dim)}];"]
        _, numbers = write_lookup(do, program, "double", read_leaf, nowhere)
        do.statements.append(f"return [{', '.join(map(str, program.waypoint(numbers)))}];")
        lines += function("export function waypoint(x)", do.used_statements())
    if is_proven:
        do, answer, above_corner = value("[NaN, NaN]", "[Infinity, Infinity]")
        straight = program.straight_bound(do, above_corner)
        least = "lower > 0 ? lower : 0"
        if straight is not None:
            least = f"Math.max(lower, Math.min({straight}, value), 0)"
        below, above = (f"f(value + numbers[n + {width + end}])" for end in (-2, -1))
        do.statements += [
            f"const value = {answer};",
            "if (value === Infinity) return [value, value];",
            f"const lower = beside({below}, false);",
            f"return [{least}, beside({above}, true)];",
        ]
        lines += function("export function bounds(x)", do.used_statements())
    return lines


def _descent(tree: CodedTree, of_cells: bool) -> list[str]:
    """From places to the leaf's row: down the tree, or, where its cells are not counted, mostly by a table."""
    mask, bits = (1 << tree.kind_bits) - 1, _TABLE_BITS // tree.dim
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
