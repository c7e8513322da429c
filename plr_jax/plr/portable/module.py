"""A PLR as a module of JavaScript, by the same arithmetic as the header of C."""

from typing import Any

import numpy as np

from plr_jax.geometry.box import Box
from plr_jax.plr.portable.code import Code, filled_lines, indented
from plr_jax.plr.portable.program import Program
from plr_jax.plr.portable.text import BracedWriter, Text


class JavaScriptWriter(BracedWriter):
    """Of JavaScript, whose numbers have 64 bits: ``f`` rounds each operation to 32."""

    def rounded_to_type(self, value: Text) -> Text:
        """In 32 bits, where it is of such a type."""
        return self.rounded(value) if value.type == "float" else value

    def literal(self, value: Any) -> str:
        """The shortest decimal of the number in 64 bits."""
        number = float(value if isinstance(value, np.floating) else np.float32(value))
        return _decimal(number)

    def definition(self, name: str, value: Text) -> str:
        """A constant."""
        return f"const {name} = {value};"

    def floor(self, x: Text) -> Text:
        """Exact in both precisions."""
        return self.atom(f"Math.floor({x})", x.type)

    def root(self, x: Text) -> Text:
        """Of a 32-bit float, the rounded root of 64 bits is that of 32."""
        return self.atom(f"f(Math.sqrt({x}))")

    def rounded(self, x: Text) -> Text:
        """In 32 bits."""
        return self.atom(f"f({x})")

    def fraction(self, x: Text) -> Text:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"{x} * {1 << 23} << 9", "uint32_t")


def js_module(program: Program) -> str:
    """The module of a PLR: see :meth:`PLR.js_module`."""
    module = _Module(program)
    return "\n".join([*module.introduction(), *module.tables(), *module.functions()])


class _Module(Code[JavaScriptWriter]):
    """The parts of a module."""

    def __init__(self, program: Program) -> None:
        super().__init__(program, "double")

    def writer(self) -> JavaScriptWriter:
        """Of a function."""
        return JavaScriptWriter()

    def introduction(self) -> list[str]:
        """What the module is, in a comment."""
        program, names = self.program, "[" + ", ".join("xyz"[: self.program.dim]) + "]"
        if program.dim > 3:
            names = f"[{', '.join(f'x{axis}' for axis in range(program.dim))}]"
        waypoint = f"// waypoint({names}): where to go straight to from a point; NaN outside the domain."
        return [
            f"// The distance to a goal, by plr_jax: {len(program.cells)} leaves of kind {program.leaf.name!r}.",
            "//",
            f"// distance({names}): distance from a point {ends_of(program.domain)};",
            "// Infinity outside this closed domain, NaN where a coordinate is. It knows no obstacles.",
            *([waypoint] if self.is_sourced else []),
            "// Answers are those of plr.numpy() to points of 64 bits, bit for bit.",
            "",
        ]

    def tables(self) -> list[str]:
        """The tree, and the numbers of the leaves."""
        tree, dim = self.tree, self.program.dim
        lines = [ROUNDED]
        if len(tree.children):
            largest = max(tree.root, int(tree.children.max()))
            lines += [
                "// Both halves of every cell that is split, the lower first. Of one that is split again, its index",
                f"// here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {tree.dim}.",
                f"const tree = new Uint{16 if largest < 2**16 else 32}Array([",
                *filled_lines(map(str, tree.children.ravel().tolist())),
                "]);",
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
        return self.program.leaf.is_of_cells and len(self.tree.children) > 0

    def functions(self) -> list[str]:
        """The functions."""
        do, value = self.distance("NaN", "Infinity")
        do.statements.append(f"return {value};")
        lines = [*self._descent(), *function("export function distance(x)", do.used_statements())]
        if self.is_sourced:
            do, waypoint = self.waypoint([f"return [{', '.join(['NaN'] * self.program.dim)}];"])
            do.statements.append(f"return [{', '.join(map(str, waypoint))}];")
            lines += function("export function waypoint(x)", do.used_statements())
        return lines

    def _descent(self) -> list[str]:
        """From places to the leaf's row."""
        tree, of_cells = self.tree, self._counts_cells
        if not len(tree.children):
            return []
        mask = (1 << tree.kind_bits) - 1
        return [
            "// Down the tree: each split takes the next bit of the place along its axis.",
            *function(
                "function leaf()",
                [
                    *(["count.fill(1);", "cell.fill(0);"] * of_cells),
                    f"let code = {tree.root};",
                    f"for (let axis = code & {mask}; axis !== {tree.dim}; axis = code & {mask}) {{",
                    "    const upper = place[axis] >>> 31;",
                    "    place[axis] <<= 1;",
                    *(["    count[axis] *= 2;", "    cell[axis] = 2 * cell[axis] + upper;"] * of_cells),
                    f"    code = tree[2 * (code >>> {tree.kind_bits}) + upper];",
                    "}",
                    f"return code >>> {tree.kind_bits};",
                ],
            ),
        ]

    def read_leaf(self, do: JavaScriptWriter, places: list[Text]) -> list[Text]:
        """The first of the leaf's numbers, to which the places lead down the tree."""
        row, width = "0", self.rows.shape[1]
        if len(self.tree.children):
            do.statements += [f"place[{axis}] = {place};" for axis, place in enumerate(places)]
            row = "leaf()" if width == 1 else f"{width} * leaf()"
        do.statements.append(f"const n = {row};")
        return [do.atom(f"numbers[n + {i}]" if i else "numbers[n]") for i in range(width)]

    def cells(self, do: JavaScriptWriter) -> list[tuple[Text, Text]]:
        """Counted on the way down the tree."""
        if not self._counts_cells:
            return [(do.atom("1"), do.atom("0"))] * self.program.dim
        return [(do.atom(f"count[{axis}]"), do.atom(f"f(cell[{axis}])")) for axis in range(self.program.dim)]


ROUNDED = "const f = Math.fround; // each operation is rounded to 32 bits"


def ends_of(domain: Box) -> str:
    """A domain as readers of code know it."""
    return " x ".join(
        f"[{lo}, {hi}{')' if is_periodic else ']'}{' periodic' if is_periodic else ''}"
        for lo, hi, is_periodic in zip(domain.lo.tolist(), domain.hi.tolist(), domain.periodic, strict=True)
    )


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
