"""A PLR as a header of C99: its numbers and the code that they need, by the arithmetic of the format."""

import numpy as np

from plr_jax.plr.portable.arithmetic import Program
from plr_jax.plr.portable.writers import BracedWriter, Code, Text, ends_of, filled_lines, indented, require_identifier


class CWriter(BracedWriter):
    """Of C99."""

    root_of, cast = "sqrtf({})", "(float)({})"

    def __init__(self, name: str) -> None:
        """With a name with which those of its functions begin."""
        super().__init__()
        self.name = name
        self.floors: set[str] = set()

    def literal(self, number: np.floating) -> str:
        """The shortest decimal that is read as the same number."""
        if np.isinf(number):
            return "INFINITY" if number > 0 else "-INFINITY"
        return str(number) + ("f" if number.dtype == np.float32 else "")

    def definition(self, name: str, value: Text) -> str:
        """A constant."""
        return f"const {value.type} {name} = {value};"

    def floor(self, x: Text) -> Text:
        """By a function of the program, there is one for each type."""
        self.floors.add(x.type)
        return self.atom(f"{self.name}_floor_of_{x.type}({x})", x.type)

    def fraction(self, x: Text) -> Text:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"(uint32_t)({x * np.float32(1 << 23)}) << 9", "uint32_t")


_FLOORS = (("float", "int32_t", "8388608.0f", "1.0f"), ("double", "int64_t", "4503599627370496.0", "1.0"))
_WHY = {
    "float": "double is for domains that reach farther from 0 than 4 times their width",
    "double": "this domain reaches farther from 0 than 4 times its width, where float is too coarse",
}


class CHeader(Code[CWriter]):
    """The parts of a header of a PLR; ``ValueError`` if its name is no identifier of C."""

    def __init__(self, program: Program, name: str):
        require_identifier(name)
        super().__init__(program, "float" if program.corner is None else "double", program.numbers_of_leaves)
        self.name = name
        self.helpers: set[str] = set()

    def writer(self) -> CWriter:
        """One whose functions' names begin with that of the header."""
        return CWriter(self.name)

    def text(self) -> str:
        """The header."""
        return "\n".join([*self.introduction(), *self.tables(), *self.functions(), "#endif", ""])

    def introduction(self) -> list[str]:
        """What the header is, and what it includes."""
        program, name = self.program, self.name
        guard = f"PLR_JAX_{name}_H"  # which names that differ in case alone do not share
        # Several times the file, whose integers have few bits.
        table_bytes = 4 * self.rows.size + self.tree.code_type.itemsize * self.tree.children.size
        waypoint = f"   {name}_waypoint: where to go straight to from a point; NaN outside the domain.\n"
        return [
            f"#ifndef {guard}",
            f"#define {guard}",
            f"/* The distance to a goal, by plr_jax: {len(program.cells)} leaves of kind {program.leaf.name!r}.",
            "",
            f"   {name}_distance: distance from a point {ends_of(program.domain)};",
            "   INFINITY outside this closed domain, NAN where a coordinate is. It knows no obstacles.",
            *(waypoint.splitlines() if self.is_sourced else []),
            f"   Coordinates are {self.type}: {_WHY[self.type]}.",
            f"   Compiled, its tables take {table_bytes:,} bytes, beside a few hundred of code.",
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

    def tables(self) -> list[str]:
        """The tree, and the numbers of the leaves."""
        name, tree, count = self.name, self.tree, self.rows.shape[1]
        lines = []
        if self.has_tree:
            lines += [
                "/* Both halves of every cell that is split, the lower first. Of one that is split again, its index",
                f"   here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {tree.dim}. */",
                f"static const {tree.code_type}_t {name}_tree[{len(tree.children)}][2] = {{",
                *filled_lines(f"{{{lower}, {upper}}}" for lower, upper in tree.children.tolist()),
                "};",
                "",
            ]
        literal = CWriter(name).literal
        return [
            *lines,
            f"static const float {name}_numbers[{len(self.rows)}][{count}] = {{",
            *filled_lines("{" + ", ".join(map(literal, row)) + "}" for row in self.rows),
            "};",
            "",
        ]

    def functions(self) -> list[str]:
        """The functions."""
        distance = self._distance()
        waypoint = self._waypoint() if self.is_sourced else []
        return [*self._floors(), *self._descent(), *distance, *waypoint]  # which floors, their bodies say

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
            f"    uint32_t code = {self.tree.root}u;",
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
        do, value = self.distance("NAN", "INFINITY")
        do.statements.append(f"return {value};")
        return self._function(do, f"float {self.name}_distance(const {self.type} x[{self.program.dim}])")

    def _waypoint(self) -> list[str]:
        """The function that gives a waypoint."""
        dim = self.program.dim
        nowhere = [*(f"waypoint[{axis}] = NAN;" for axis in range(dim)), "return;"]
        do, waypoint = self.waypoint(nowhere)
        do.statements += [f"waypoint[{axis}] = {along};" for axis, along in enumerate(waypoint)]
        return self._function(
            do, f"void {self.name}_waypoint(const {self.type} x[{dim}], {self.type} waypoint[{dim}])"
        )

    def read_leaf(self, do: CWriter, places: list[Text]) -> list[Text]:
        """The row of the leaf's numbers, to which the places lead down the tree."""
        name, dim, row = self.name, self.program.dim, "0"
        if self.has_tree:
            do.statements.append(f"uint32_t place[{dim}] = {{{', '.join(map(str, places))}}};")
            if self.program.leaf.is_of_cells:  # how many cells there are, and which it is
                do.statements.append(f"uint32_t cell[{dim}][2] = {{{', '.join(['{1, 0}'] * dim)}}};")
            row = f"{name}_leaf(place{', cell' * self.program.leaf.is_of_cells})"
        do.statements.append(f"const float *const n = {name}_numbers[{row}];")
        return [do.atom(f"n[{i}]") for i in range(self.rows.shape[1])]

    def cells(self, do: CWriter) -> list[tuple[Text, Text]]:
        """Counted on the way down the tree."""
        is_split = self.has_tree
        return [
            (do.atom(count), do.atom(position))
            for count, position in (
                (f"(float)cell[{axis}][{i}]" if is_split else f"{1 - i}.0f" for i in range(2))
                for axis in range(self.program.dim)
            )
        ]

    def _function(self, do: CWriter, signature: str) -> list[str]:
        self.helpers |= do.floors
        return [f"static inline {signature}", "{", *indented(do.used_statements()), "}", ""]

    def _floors(self) -> list[str]:
        """The floor of each type that is needed: NaN, and whole numbers beyond the bits of a mantissa, stay."""
        lines = []
        for of_type, whole, digits, one in _FLOORS:
            if of_type in self.helpers:
                lines += [
                    f"static inline {of_type} {self.name}_floor_of_{of_type}({of_type} v)",
                    "{",
                    f"    if (!(v < {digits} && v > -{digits})) {{",
                    "        return v;",
                    "    }",
                    f"    const {of_type} toward_zero = ({of_type})({whole})v;",
                    f"    return toward_zero > v ? toward_zero - {one} : toward_zero;",
                    "}",
                    "",
                ]
        return lines
