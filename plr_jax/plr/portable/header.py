"""A PLR as a header of C99: its numbers and the code that they need, by the arithmetic of the format."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from plr_jax._arrays import shortened
from plr_jax.plr.leaves.base import SourcedLeafModel
from plr_jax.plr.portable.program import Program

# Operations that write a program: values are its expressions, and those that have a name are its statements.


_ATOM, _PRODUCT, _SUM, _COMPARISON, _CONDITION = range(5, 0, -1)  # how tightly each binds


@dataclass(frozen=True, eq=False)
class Text:
    """An expression. Operators join texts as they join numbers, with the parentheses that the order needs.

    Attributes:
        text: As it stands in the program.
        level: How tightly its outermost operator binds.
        type: What it is: ``float``, ``double``, ``int`` of conditions, or ``uint32_t``.
        language: That of the program.
    """

    text: str
    level: int
    type: str
    language: "Writer"

    __array_ufunc__ = None  # NumPy's scalars leave operators to this class

    def __str__(self) -> str:
        return self.text

    def at_least(self, level: int) -> str:
        """The text, in parentheses if it binds less tightly."""
        return self.text if self.level >= level else f"({self.text})"

    def _joined(self, symbol: str, left: "Text", right: "Text", level: int) -> "Text":
        of_type = "double" if "double" in (left.type, right.type) else "float"
        # Sums and products are from left to right.
        return Text(f"{left.at_least(level)} {symbol} {right.at_least(level + 1)}", level, of_type, self.language)

    def __add__(self, other: Any) -> "Text":
        return self._joined("+", self, self.language.constant(other), _SUM)

    def __radd__(self, other: Any) -> "Text":
        return self._joined("+", self.language.constant(other), self, _SUM)

    def __sub__(self, other: Any) -> "Text":
        if not isinstance(other, Text) and other == 0:
            return self
        if not isinstance(other, Text) and other < 0:
            return self + -other
        return self._joined("-", self, self.language.constant(other), _SUM)

    def __rsub__(self, other: Any) -> "Text":
        return self._joined("-", self.language.constant(other), self, _SUM)

    def __mul__(self, other: Any) -> "Text":
        if not isinstance(other, Text) and other == 1:
            return self
        return self._joined("*", self, self.language.constant(other), _PRODUCT)

    def __rmul__(self, other: Any) -> "Text":
        return self._joined("*", self.language.constant(other), self, _PRODUCT)

    def __neg__(self) -> "Text":
        return Text(f"-{self.at_least(_ATOM)}", _PRODUCT, self.type, self.language)

    def _compared(self, symbol: str, other: Any) -> "Text":
        left, right = self.at_least(_SUM), self.language.constant(other).at_least(_SUM)
        return Text(f"{left} {symbol} {right}", _COMPARISON, "int", self.language)

    def __lt__(self, other: Any) -> "Text":
        return self._compared("<", other)

    def __gt__(self, other: Any) -> "Text":
        return self._compared(">", other)

    def __le__(self, other: Any) -> "Text":
        return self._compared("<=", other)

    def __ge__(self, other: Any) -> "Text":
        return self._compared(">=", other)

    def __and__(self, other: "Text") -> "Text":
        text = f"{self.at_least(_CONDITION)} {self.language.conjunction} {other.at_least(_CONDITION)}"
        return Text(text, _CONDITION, "int", self.language)


class Writer(ABC):
    """Operations that write statements, one a name."""

    conjunction: str

    def __init__(self) -> None:
        self.statements: list[str] = []
        self._names: Counter[str] = Counter()

    def atom(self, text: str, of_type: str = "float") -> Text:
        """An expression that needs no parentheses."""
        return Text(text, _ATOM, of_type, self)

    def constant(self, value: Any) -> Text:
        """A number as it stands in the program; a text as it is."""
        if isinstance(value, Text):
            return value
        of_type = "double" if isinstance(value, np.float64) else "float"
        return Text(self.literal(value), _ATOM if value >= 0 else _PRODUCT, of_type, self)

    def let(self, name: str, value: Any) -> Text:
        """A new name, numbered, for an expression; a name stays what it is."""
        if value.text.isidentifier():
            return value
        unique = f"{name}_{self._names[name]}"
        self._names[name] += 1
        self.statements.append(self.definition(unique, value))
        return self.atom(unique, value.type)

    @abstractmethod
    def literal(self, value: Any) -> str:
        """A number."""

    @abstractmethod
    def definition(self, name: str, value: Text) -> str:
        """The statement that gives a value its name."""


class PythonWriter(Writer):
    """Of Python, where numbers are NumPy's scalars; ``constants`` are those that the program names."""

    conjunction = "and"

    def __init__(self) -> None:
        super().__init__()
        self.constants: dict[str, Any] = {}

    def literal(self, value: Any) -> str:
        """The name of a constant."""
        number = value if isinstance(value, np.floating) else np.float32(value)
        name = f"k{len(self.constants)}"
        self.constants[name] = number
        return name

    def definition(self, name: str, value: Text) -> str:
        """An assignment."""
        return f"{name} = {value}"

    def where(self, condition: Text, yes: Any, no: Any) -> Text:
        """A conditional expression."""
        yes, no = self.constant(yes), self.constant(no)
        return self.atom(f"({yes} if {condition} else {no})", no.type)

    def floor(self, x: Text) -> Text:
        """The floor as a scalar of the same type."""
        return self.atom(f"{'float64' if x.type == 'double' else 'float32'}(floor({x}))", x.type)

    def root(self, x: Text) -> Text:
        """Of a 32-bit float, the rounded root of 64 bits is that of 32."""
        return self.atom(f"float32(sqrt({x}))")

    def rounded(self, x: Text) -> Text:
        """In 32 bits."""
        return self.atom(f"float32({x})")

    def fraction(self, x: Text) -> Text:
        """The product is exact."""
        return self.atom(f"(int({x * np.float32(1 << 23)}) & {(1 << 23) - 1})", "uint32_t")


class CWriter(Writer):
    """Of C99."""

    conjunction = "&&"

    def __init__(self, name: str) -> None:
        """With a name with which those of its functions begin."""
        super().__init__()
        self.name = name
        self.floors: set[str] = set()

    def used_statements(self) -> list[str]:
        """All statements but constants that no later one reads."""
        kept: list[str] = []
        for statement in reversed(self.statements):
            name = re.match(r"const \w+ (\w+) = ", statement)
            if name is None or re.search(rf"\b{name[1]}\b", " ".join(kept)):
                kept.append(statement)
        return kept[::-1]

    def literal(self, value: Any) -> str:
        """The shortest decimal that is read as the same number."""
        number = value if isinstance(value, np.floating) else np.float32(value)
        if np.isinf(number):
            return "INFINITY" if number > 0 else "-INFINITY"
        return str(number) + ("f" if number.dtype == np.float32 else "")

    def definition(self, name: str, value: Text) -> str:
        """A constant."""
        return f"const {value.type} {name} = {value};"

    def where(self, condition: Text, yes: Any, no: Any) -> Text:
        """A conditional expression."""
        yes, no = self.constant(yes), self.constant(no)
        return self.atom(f"({condition} ? {yes} : {no})", no.type)

    def floor(self, x: Text) -> Text:
        """By a function of the program, there is one for each type."""
        self.floors.add(x.type)
        return self.atom(f"{self.name}_floor_of_{x.type}({x})", x.type)

    def root(self, x: Text) -> Text:
        """The only function of the mathematical library."""
        return self.atom(f"sqrtf({x})")

    def rounded(self, x: Text) -> Text:
        """A cast."""
        return self.atom(f"(float)({x})")

    def fraction(self, x: Text) -> Text:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"(uint32_t)({x * np.float32(1 << 23)}) << 9", "uint32_t")


_FLOORS = (("float", "int32_t", "8388608.0f", "1.0f"), ("double", "int64_t", "4503599627370496.0", "1.0"))
_WIDTH = 100  # of a line
_WHY = {
    "float": "double is for domains that reach farther from 0 than 4 times their width",
    "double": "this domain reaches farther from 0 than 4 times its width, where float is too coarse",
}


class CHeader:
    """The parts of a header of a PLR; ``ValueError`` if its name is no identifier of C."""

    def __init__(self, program: Program, name: str):
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise ValueError(f"The name must be an identifier of C, such as plr_maze, got {shortened(name)}.")
        self.program, self.name = program, name
        self.rows, row_of_leaf = program.rows
        self.tree = program.coded_tree(row_of_leaf)
        self.type = "float" if program.corner is None else "double"
        self.is_sourced = isinstance(program.leaf, SourcedLeafModel)
        self.helpers: set[str] = set()

    def text(self) -> str:
        """The header."""
        return "\n".join([*self.introduction(), *self.tables(), *self.functions(), *self.end()])

    @property
    def has_tree(self) -> bool:
        """Whether there is more than one leaf."""
        return len(self.tree.children) > 0

    @property
    def root(self) -> str:
        """The code of the tree's root."""
        return f"{self.tree.root}u"

    @property
    def code_type(self) -> str:
        """Of the codes in the tree."""
        return "uint16_t" if max(self.tree.root, self.tree.children.max(initial=0)) < 2**16 else "uint32_t"

    @property
    def table_bytes(self) -> int:
        """Of the program's constants: several times the file, whose integers have few bits."""
        return 4 * self.rows.size + (2 if self.code_type == "uint16_t" else 4) * self.tree.children.size

    def introduction(self) -> list[str]:
        """What the header is, and what it includes."""
        program, name = self.program, self.name
        domain, guard = program.domain, f"PLR_JAX_{name}_H"  # which names that differ in case alone do not share
        ends = [
            f"[{lo}, {hi}{')' if is_periodic else ']'}{' periodic' if is_periodic else ''}"
            for lo, hi, is_periodic in zip(domain.lo.tolist(), domain.hi.tolist(), domain.periodic, strict=True)
        ]
        waypoint = f"   {name}_waypoint: where to go straight to from a point; NaN outside the domain.\n"
        return [
            f"#ifndef {guard}",
            f"#define {guard}",
            f"/* The distance to a goal, by plr_jax: {self.leaves()} of kind {program.leaf.name!r}.",
            "",
            f"   {name}_distance: distance from a point {' x '.join(ends)};",
            "   INFINITY outside this closed domain, NAN where a coordinate is. It knows no obstacles.",
            *(waypoint.splitlines() if self.is_sourced else []),
            f"   Coordinates are {self.type}: {_WHY[self.type]}.",
            *self.about_tables(),
            "",
            "   Answers are those of plr.numpy(), bit for bit, where no operations are fused: compile with",
            "   -ffp-contract=off, as GCC else fuses some where a processor can. */",
            "",
            "#include <float.h>",
            "#include <math.h>",
            "#include <stdint.h>",
            "",
            "#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0",
            '#error "floats must be evaluated as floats: on 32-bit x86, compile with -msse2 -mfpmath=sse"',
            "#endif",
            "#if defined(__clang__)",
            "#pragma STDC FP_CONTRACT OFF",
            "#endif",
            "",
        ]

    def leaves(self) -> str:
        """Which leaves it has."""
        return f"{len(self.program.cells)} leaves"

    def about_tables(self) -> list[str]:
        """What is said of the tables."""
        return [f"   Compiled, its tables take {self.table_bytes:,} bytes, beside a few hundred of code."]

    def tables(self) -> list[str]:
        """The tree, and the numbers of the leaves."""
        name, tree, count = self.name, self.tree, self.rows.shape[1]
        lines = []
        if len(tree.children):
            lines += [
                "/* Both halves of every cell that is split, the lower first. Of one that is split again, its index",
                f"   here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {tree.dim}. */",
                f"static const {self.code_type} {name}_tree[{len(tree.children)}][2] = {{",
                *_filled(f"{{{lower}, {upper}}}" for lower, upper in tree.children.tolist()),
                "};",
                "",
            ]
        literal = CWriter(name).literal
        return [
            *lines,
            f"static const float {name}_numbers[{len(self.rows)}][{count}] = {{",
            *_filled("{" + ", ".join(map(literal, row)) + "}" for row in self.rows),
            "};",
            "",
        ]

    def functions(self) -> list[str]:
        """The functions."""
        distance = self._distance()
        waypoint = self._waypoint() if self.is_sourced else []
        return [*self._floors(), *self._descent(), *distance, *waypoint]  # which floors, their bodies say

    def end(self) -> list[str]:
        """What closes it."""
        return ["#endif", ""]

    def _descent(self) -> list[str]:
        """From places to the leaf's row."""
        tree, name, dim = self.tree, self.name, self.program.dim
        if not self.has_tree:
            return []
        of_cells = self.program.leaf.is_of_cells
        mask = (1 << tree.kind_bits) - 1
        return [
            "/* Down the tree: each split takes the next bit of the place along its axis. */",
            f"static inline uint32_t {name}_leaf(uint32_t place[{dim}]{f', uint32_t cell[{dim}][2]' * of_cells})",
            "{",
            f"    uint32_t code = {self.root};",
            f"    while ((code & {mask}u) != {dim}u) {{",
            f"        const uint32_t axis = code & {mask}u;",
            "        const uint32_t upper = place[axis] >> 31;",
            "        place[axis] <<= 1;",
            *(["        cell[axis][0] *= 2;", "        cell[axis][1] = 2 * cell[axis][1] + upper;"] * of_cells),
            f"        code = {name}_tree[code >> {tree.kind_bits}][upper];",
            "    }",
            f"    return code >> {tree.kind_bits};",
            "}",
            "",
        ]

    def _distance(self) -> list[str]:
        """The function that answers a distance."""
        program, do = self.program, CWriter(self.name)
        given = self._given(do)
        do.statements += self._unless_inside(do, given, [f"return {_any_nan(given)} ? NAN : INFINITY;"])
        x, above, numbers = self._found(do, given)
        cells: list[tuple[Text, Text]] = []
        if program.leaf.is_of_cells:
            is_split = self.has_tree
            for axis in range(program.dim):
                count, position = (f"(float)cell[{axis}][{i}]" if is_split else f"{1 - i}.0f" for i in range(2))
                cells.append((do.atom(count), do.atom(position)))
        do.statements.append(f"return {program.value(do, x, above, numbers, cells)};")
        return self._function(do, f"float {self.name}_distance(const {self.type} x[{program.dim}])")

    def _waypoint(self) -> list[str]:
        """The function that gives a waypoint."""
        program, dim, do = self.program, self.program.dim, CWriter(self.name)
        given = self._given(do)
        nowhere = [*(f"waypoint[{axis}] = NAN;" for axis in range(dim)), "return;"]
        do.statements += self._unless_inside(do, given, nowhere)
        *_, numbers = self._found(do, given)
        do.statements += [f"waypoint[{axis}] = {along};" for axis, along in enumerate(program.waypoint(numbers))]
        return self._function(
            do, f"void {self.name}_waypoint(const {self.type} x[{dim}], {self.type} waypoint[{dim}])"
        )

    def _given(self, do: CWriter) -> list[Text]:
        return [do.atom(f"x[{axis}]", self.type) for axis in range(self.program.dim)]

    def _unless_inside(self, do: CWriter, given: list[Text], outside: list[str]) -> list[str]:
        return [f"if (!({self.program.contains(do, given)})) {{", *_indented(outside), "}"]

    def _found(self, do: CWriter, given: list[Text]) -> tuple[list[Text], list[Text], list[Text]]:
        """A placed point, how far it is above the lower corner, and its leaf's numbers."""
        program, name, dim = self.program, self.name, self.program.dim
        x = program.counted(do, given if program.corner is None else program.wrapped_wide(do, given))
        x = program.placed(do, x)
        above, row = program.above(do, x), "0"
        if self.has_tree:
            places = ", ".join(map(str, program.places(do, above)))
            do.statements.append(f"uint32_t place[{dim}] = {{{places}}};")
            if program.leaf.is_of_cells:  # how many cells there are, and which it is
                do.statements.append(f"uint32_t cell[{dim}][2] = {{{', '.join(['{1, 0}'] * dim)}}};")
            row = f"{name}_leaf(place{', cell' * program.leaf.is_of_cells})"
        do.statements.append(f"const float *const n = {name}_numbers[{row}];")
        return x, above, [do.atom(f"n[{i}]") for i in range(self.rows.shape[1])]

    def _function(self, do: CWriter, signature: str) -> list[str]:
        self.helpers |= do.floors
        return [f"static inline {signature}", "{", *_indented(do.used_statements()), "}", ""]

    def _floors(self) -> list[str]:
        """The floor of each type that is needed: beyond the bits of a mantissa every number is whole."""
        lines = []
        for of_type, whole, digits, one in _FLOORS:
            if of_type in self.helpers:
                lines += [
                    f"static inline {of_type} {self.name}_floor_of_{of_type}({of_type} v)",
                    "{",
                    f"    if (v >= {digits} || v <= -{digits}) {{",
                    "        return v;",
                    "    }",
                    f"    const {of_type} toward_zero = ({of_type})({whole})v;",
                    f"    return toward_zero > v ? toward_zero - {one} : toward_zero;",
                    "}",
                    "",
                ]
        return lines


def _any_nan(x: Iterable[Text]) -> str:
    return " || ".join(f"{along} != {along}" for along in x)


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _filled(entries: Iterable[str]) -> list[str]:
    """Entries, separated by commas, in lines that are full."""
    lines, line = [], ""
    for entry in entries:
        if len(line) + len(entry) > _WIDTH:
            lines.append(line)
            line = ""
        line += f"{' ' if line else '    '}{entry},"
    return [*lines, line]
