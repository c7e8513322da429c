"""Generate JavaScript: a module from a PLR (:func:`js_module`), and functions that read PLR files in a web page."""

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
from plr_jax.plr.portable.writers import Emitter, Expression, format_domain, indent, wrap_entries
from plr_jax.plr.tree import Cells, tree_of

_TABLE_BITS = 14  # a grid of that many entries nearly fits a core's first-level cache
FROUND = "const f = Math.fround; // rounds each operation to 32 bits"
NEXT_FLOAT = """\
// Returns the next 32-bit float above or below a 32-bit float.
const bits = new Float32Array(1), whole = new Int32Array(bits.buffer);
function beside(x, isAbove) {
    if (x === 0) return isAbove ? 2 ** -149 : -(2 ** -149);
    if (x !== x || x === (isAbove ? Infinity : -Infinity)) return x;
    bits[0] = x;
    whole[0] += x > 0 === isAbove ? 1 : -1;
    return bits[0];
}"""


class JavaScriptEmitter(Emitter):
    """A generator of JavaScript code, in which ``f = Math.fround`` rounds the result of each 32-bit operation."""

    root_of, cast, is_rounded = "f(Math.sqrt({}))", "f({})", False
    definition = "const {name} = {value};"

    def literal(self, number: np.floating) -> str:
        return _decimal(float(number))

    def floor(self, x: Expression) -> Expression:
        return self.atom(f"Math.floor({x})", x.type)

    def fraction(self, x: Expression) -> Expression:
        # The 23 mantissa bits of a float in [1, 2), as the highest bits of a word; the shift drops the leading one.
        return self.atom(f"({x} * {1 << 23} << 9)", "uint32_t")


class _ConesFromTables(Program):
    """The query of any PLR file of cones in the plane, for JavaScript that reads the file at run time.

    In place of the file's constants, the generated code has variables such as ``scale0``. A test of a variable in
    Python, such as ``start < 1``, always holds, so the code has the steps that only some files need.

    All other attributes describe a placeholder, a file of two leaves. Of these, use only what all such files share:
    the leaf model, the dimension, that no axis is periodic, and how nodes of the tree are coded.
    """

    def __init__(self) -> None:
        # 1. The placeholder: the leaves are the halves of the unit square, and the goal is its lower corner.
        domain, halves = Box((0, 0), (1, 1)), tree_of(Cells.root(2).split(np.zeros(1, int)))
        stored = ConeFiles(Sources(np.zeros((1, 2)), np.zeros(1), np.zeros(1, int)), domain).stored(np.zeros(2, int))
        super().__init__(DecodedFile(domain, Cone(), halves, stored))

        def named(name: str, of_type: str = "float") -> list[Expression]:
            return [JavaScriptEmitter().atom(f"{name}{axis}", of_type) for axis in range(2)]

        # 2. Variables in place of its constants.
        self.frame = [named(row.name.lower()) for row in Frame]
        self.limits = [self.frame[Frame.LO], self.frame[Frame.HI]]
        self.corner = named("origin", "double")

    def waypoint(self, numbers: Sequence[Value]) -> list[Value]:
        source, corner = as_sourced(self.leaf).source_of(numbers), self.frame[Frame.LO]
        return [origin + (lo + along) for origin, lo, along in zip(self.corner, corner, source, strict=True)]


def js_file_reader() -> str:
    """Return the JavaScript source of functions that read PLR files (``file.js`` and the helpers it needs)."""
    return "\n".join([FROUND, NEXT_FLOAT, Path(__file__).with_name("file.js").read_text(encoding="utf-8")])


def js_cone_reader() -> str:
    """Return the source of the JavaScript function ``coneReader(tables)``.

    That function takes the tables of a file of cones, as the JavaScript function ``readCones`` in ``file.js`` returns
    them. It returns the functions ``distance``, ``waypoint`` and ``bounds``.
    """
    names = ", ".join(f"[{name}0, {name}1] = tables.{name}" for name in ("lo", "hi", "scale", "start", "top"))
    program = _ConesFromTables()
    tree = CodedTree(program.contents.tree, np.zeros(2, int))
    width = 5  # numbers of a leaf: offset, source, two error bounds
    lines = [
        f"const {names};",
        "const { tree, root, numbers } = tables, [origin0, origin1] = tables.origin, place = new Uint32Array(2);",
        *(line.removeprefix("export ") for line in _functions(program, tree, width, is_proven=True)),
        "return { distance, waypoint, bounds };",
    ]
    return "\n".join(js_function("function coneReader(tables)", lines))


def js_module(program: Program) -> str:
    """Return a JavaScript module with the tables of a PLR and the functions that answer queries."""
    dim, leaf, certificate = program.dim, program.leaf, program.contents.certificate
    numbers = program.leaf_parameters
    if certificate is not None:  # append the bounds of distance minus value
        leaf_bounds = np.broadcast_to(certificate.bounds().T.astype(np.float32), (len(numbers), 2))
        numbers = np.column_stack([numbers, leaf_bounds])
    rows, row_of_leaf = distinct_rows(numbers)
    tree = CodedTree(program.contents.tree, row_of_leaf)
    # 1. Description.
    names = f"[{', '.join(f'x{axis}' if dim > 3 else 'xyz'[axis] for axis in range(dim))}]"
    waypoint = f"// waypoint({names}): next waypoint on the way to the goal; NaN outside the domain."
    bounds = f"// bounds({names}): proven bounds of the distance where the goal can be reached, [lower, upper]."
    lines = [
        f"// Distance to a goal, generated by plr_jax: {len(row_of_leaf)} leaves of type {leaf.name!r}.",
        "//",
        f"// distance({names}): distance to the goal from a point of the domain {format_domain(program.domain)};",
        "// Infinity outside the closed domain, NaN for NaN. It does not test for obstacles.",
        *[waypoint] * isinstance(leaf, Cone),
        *[bounds] * (certificate is not None),
        "// Results equal those of plr.numpy() for 64-bit points, bit for bit.",
        "",
    ]
    # 2. Tables: the tree and the leaf parameters.
    lines += [FROUND, *[NEXT_FLOAT] * (certificate is not None)]
    if len(tree.children):
        lines += [
            f"// Children of every split node, the lower one first, as {1 << tree.kind_bits} * row + kind. Of a",
            f"// split child: its row in this table, its axis. Of a leaf: its row in numbers, {dim}.",
            f"const tree = new Uint{8 * tree.code_type.itemsize}Array([",
            *wrap_entries(map(str, tree.children.ravel().tolist())),
            "]);",
            f"const root = {tree.root};",
            f"const place = new Uint32Array({dim});",
            *[f"const count = new Float64Array({dim}), cell = new Float64Array({dim});"] * leaf.is_cell_relative,
        ]
    lines += [
        f"const numbers = new Float32Array([ // {rows.shape[1]} each",
        *wrap_entries(map(float32_literal, rows.ravel())),
        "]);",
        "",
    ]
    return "\n".join([*lines, *_functions(program, tree, rows.shape[1], certificate is not None)])


def _functions(program: Program, tree: CodedTree, width: int, is_proven: bool) -> list[str]:
    """Return the lines of the JavaScript functions that answer queries.

    These are ``distance``, for cones ``waypoint``, and if ``is_proven``, ``bounds``. The code reads ``width`` numbers
    for each leaf from an array ``numbers``. If ``is_proven``, the last two numbers are lower and upper bounds of
    distance minus PLR value. The variables that the code reads are declared by :func:`js_module` and
    :func:`js_cone_reader`.
    """
    dim, has_tree = program.dim, len(tree.children) > 0

    def read_leaf(do: JavaScriptEmitter, fractions: list[Expression]) -> list[Expression]:
        row, cell = "0", ["1", "0"] * dim  # for each axis: number of cells along the domain, index of the leaf's cell
        if has_tree:
            do.statements += [f"place[{axis}] = {place};" for axis, place in enumerate(fractions)]
            row = "leaf()" if width == 1 else f"{width} * leaf()"
            cell = [text for axis in range(dim) for text in (f"count[{axis}]", f"f(cell[{axis}])")]
        do.statements.append(f"const n = {row};")
        numbers = [f"numbers[n + {i}]" if i else "numbers[n]" for i in range(width - 2 if is_proven else width)]
        return [do.atom(text) for text in (cell + numbers if program.leaf.is_cell_relative else numbers)]

    def value(if_nan: str, if_outside: str) -> tuple[JavaScriptEmitter, Expression, list[Expression]]:
        # Return an emitter with the code that computes the value, the expression of the value, and the expressions of
        # the point minus the domain's corner.
        do = JavaScriptEmitter()
        outside = [f"return {do.nan_condition(dim)} ? {if_nan} : {if_outside};"]
        offsets, numbers = do.write_lookup(program, "double", read_leaf, outside)
        return do, program.value(do, offsets, numbers), offsets

    do, answer, _ = value("NaN", "Infinity")
    do.statements.append(f"return {answer};")
    lines = _descent(tree, program.leaf.is_cell_relative) if has_tree else []
    lines += js_function("export function distance(x)", do.used_statements())
    if isinstance(program.leaf, Cone):
        do = JavaScriptEmitter()
        _, numbers = do.write_lookup(program, "double", read_leaf, [f"return [{', '.join(['NaN'] * dim)}];"])
        do.statements.append(f"return [{', '.join(map(str, program.waypoint(numbers)))}];")
        lines += js_function("export function waypoint(x)", do.used_statements())
    if is_proven:
        do, answer, offsets = value("[NaN, NaN]", "[Infinity, Infinity]")
        straight = program.straight_bound(do, offsets)
        least = "lower > 0 ? lower : 0" if straight is None else f"Math.max(lower, {straight}, 0)"
        below, above = (f"f(value + numbers[n + {width + end}])" for end in (-2, -1))
        do.statements += [
            f"const value = {answer};",
            "if (value === Infinity) return [value, value];",
            f"const lower = beside({below}, false);",
            f"return [{least}, beside({above}, true)];",
        ]
        lines += js_function("export function bounds(x)", do.used_statements())
    return lines


def _descent(tree: CodedTree, of_cells: bool) -> list[str]:
    """Return the lines of the JavaScript function ``leaf``, which returns the row of parameters of a point's leaf.

    The function reads the point's position from the array ``place``. If ``of_cells``, it also finds the leaf's cell.
    Then, for each axis, ``count`` is the number of cells of this size along the domain, and ``cell`` the index of
    this cell. :func:`js_module` and :func:`js_cone_reader` declare these variables, ``tree`` and ``root``.
    """
    # At each node, `place` has the next bit of the position along each axis as its highest bit. For `of_cells`,
    # `count` and `cell` are about cells like the node's.
    mask = (1 << tree.kind_bits) - 1
    bits = _TABLE_BITS // tree.dim  # of a grid cell's index along an axis
    statements = [
        *["count.fill(1);", "cell.fill(0);"] * of_cells,
        "let code = root;",
        f"for (let axis = code & {mask}; axis !== {tree.dim}; axis = code & {mask}) {{",
        "    const upper = place[axis] >>> 31;",
        "    place[axis] <<= 1;",
        *["    count[axis] *= 2;", "    cell[axis] = 2 * cell[axis] + upper;"] * of_cells,
        f"    code = tree[2 * (code >>> {tree.kind_bits}) + upper];",
        "}",
        f"return code >>> {tree.kind_bits};",
    ]
    comment = "// Descends the tree: each split takes the next bit of the position along its axis."
    if of_cells or not bits:
        return [comment, *js_function("function leaf()", statements)]
    shifts = [bits * (tree.dim - 1 - axis) for axis in range(tree.dim)]  # of each axis in the index of a grid cell
    places = (f"place[{axis}] >>> {32 - bits} << {shift}".removesuffix(" << 0") for axis, shift in enumerate(shifts))
    index = " | ".join(places)
    return [
        comment,
        *js_function("function descend()", statements),
        f"// For each cell of a grid, {1 << bits} per axis: its leaf's row plus one, or 0 if it has several.",
        "// A marker bit follows the bits of the position: if the descent shifts it out, there are several.",
        f"const grid = new Uint32Array({1 << bits * tree.dim});",
        "for (let index = 0; index < grid.length; index++) {",
        *(
            f"    place[{axis}] = (index >>> {shift}) << {32 - bits} | {1 << 31 - bits};"
            for axis, shift in enumerate(shifts)
        ),
        "    const row = descend();",
        "    grid[index] = place.every(left => left !== 0) ? row + 1 : 0;",
        "}",
        "",
        *js_function("function leaf()", [f"const row = grid[{index}];", "return row ? row - 1 : descend();"]),
    ]


def float32_literal(number: np.float32) -> str:
    """Return a short decimal that JavaScript reads as a 64-bit float which rounds to ``number``."""
    text = str(number)
    return _decimal(text if np.isinf(number) or np.float32(float(text)) == number else float(number))


def _decimal(number: Any) -> str:
    return str(number).removesuffix(".0").replace("inf", "Infinity")


def js_function(signature: str, statements: list[str]) -> list[str]:
    return [f"{signature} {{", *indent(statements), "}", ""]
