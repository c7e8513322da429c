"""A PLR as a header of C99: its numbers and the code that they need, by the arithmetic of the format."""

import numpy as np

from plr_jax.plr.leaves import Cone
from plr_jax.plr.portable.arithmetic import CodedTree, Program, distinct_rows
from plr_jax.plr.portable.writers import (
    Emitter,
    Expression,
    format_domain,
    indent,
    nan_condition,
    require_identifier,
    wrap_entries,
    write_lookup,
)


class CEmitter(Emitter):
    """Of C99."""

    root_of, cast = "sqrtf({})", "(float)({})"
    definition = "const {type} {name} = {value};"

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

    def floor(self, x: Expression) -> Expression:
        """By a function of the program, there is one for each type."""
        self.floors.add(x.type)
        return self.atom(f"{self.name}_floor_of_{x.type}({x})", x.type)

    def fraction(self, x: Expression) -> Expression:
        """The bits at the upper end of a word, from where they are taken."""
        return self.atom(f"(uint32_t)({x * np.float32(1 << 23)}) << 9", "uint32_t")


_FLOORS = (("float", "int32_t", "8388608.0f", "1.0f"), ("double", "int64_t", "4503599627370496.0", "1.0"))
_WHY = {
    "float": "double is for domains that reach farther from 0 than 4 times their width",
    "double": "this domain reaches farther from 0 than 4 times its width, where float is too coarse",
}


def c_header(program: Program, name: str) -> str:
    """The header of a PLR: see :meth:`PLR.c_header`; ``ValueError`` if its name is no identifier of C."""
    require_identifier(name)
    dim, leaf, of_type = program.dim, program.leaf, "float" if program.corner is None else "double"
    rows, row_of_leaf = distinct_rows(program.leaf_parameters)
    tree = CodedTree(program.contents.tree, row_of_leaf)
    has_tree, is_sourced, of_cells = len(tree.children) > 0, isinstance(leaf, Cone), leaf.is_cell_relative

    # 1. What the header is, and what it includes.
    guard = f"PLR_JAX_{name}_H"  # which names that differ in case alone do not share
    # Several times the file, whose integers have few bits.
    table_bytes = 4 * rows.size + tree.code_type.itemsize * tree.children.size
    waypoint = f"   {name}_waypoint: where to go straight to from a point; NaN outside the domain."
    introduction = [
        f"#ifndef {guard}",
        f"#define {guard}",
        f"/* The distance to a goal, by plr_jax: {len(row_of_leaf)} leaves of kind {leaf.name!r}.",
        "",
        f"   {name}_distance: distance from a point {format_domain(program.domain)};",
        "   INFINITY outside this closed domain, NAN where a coordinate is. It knows no obstacles.",
        *([waypoint] * is_sourced),
        f"   Coordinates are {of_type}: {_WHY[of_type]}.",
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

    # 2. The tree, and the numbers of the leaves.
    tables, literal = [], CEmitter(name).literal
    if has_tree:
        tables += [
            "/* Both halves of every cell that is split, the lower first. Of one that is split again, its index",
            f"   here times {1 << tree.kind_bits} plus its axis; of a leaf, of its numbers plus {dim}. */",
            f"static const {tree.code_type}_t {name}_tree[{len(tree.children)}][2] = {{",
            *wrap_entries(f"{{{lower}, {upper}}}" for lower, upper in tree.children.tolist()),
            "};",
            "",
        ]
    tables += [
        f"static const float {name}_numbers[{len(rows)}][{rows.shape[1]}] = {{",
        *wrap_entries("{" + ", ".join(map(literal, row)) + "}" for row in rows),
        "};",
        "",
    ]

    # 3. From fractions to the leaf's row.
    mask = (1 << tree.kind_bits) - 1
    descent = [
        "/* Down the tree: each split takes the next bit of the place along its axis. */",
        f"static inline uint32_t {name}_leaf(uint32_t place[{dim}]{f', uint32_t cell[{dim}][2]' * of_cells})",
        "{",
        f"    uint32_t code = {tree.root}u;",
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

    def read_leaf(do: CEmitter, fractions: list[Expression]) -> list[Expression]:
        """Write how the leaf is found, and return its numbers, first those of its cell, counted on the way."""
        row, counts = "0", ["1.0f", "0.0f"] * dim
        if has_tree:
            do.statements.append(f"uint32_t place[{dim}] = {{{', '.join(map(str, fractions))}}};")
            if of_cells:  # how many cells there are, and which it is
                do.statements.append(f"uint32_t cell[{dim}][2] = {{{', '.join(['{1, 0}'] * dim)}}};")
            row = f"{name}_leaf(place{', cell' * of_cells})"
            counts = [f"(float)cell[{axis}][{i}]" for axis in range(dim) for i in range(2)]
        do.statements.append(f"const float *const n = {name}_numbers[{row}];")
        return [do.atom(text) for text in [*counts * of_cells, *(f"n[{i}]" for i in range(rows.shape[1]))]]

    # 4. The functions.
    do = CEmitter(name)
    outside = [f"return {nan_condition(dim)} ? NAN : INFINITY;"]
    offsets, numbers = write_lookup(do, program, of_type, read_leaf, outside)
    do.statements.append(f"return {program.value(do, offsets, numbers)};")
    functions = [f"static inline float {name}_distance(const {of_type} x[{dim}])"]
    functions += ["{", *indent(do.used_statements()), "}", ""]
    floors = do.floors
    if is_sourced:
        do = CEmitter(name)
        outside = [*(f"waypoint[{axis}] = NAN;" for axis in range(dim)), "return;"]
        _, numbers = write_lookup(do, program, of_type, read_leaf, outside)
        do.statements += [f"waypoint[{axis}] = {along};" for axis, along in enumerate(program.waypoint(numbers))]
        functions.append(f"static inline void {name}_waypoint(const {of_type} x[{dim}], {of_type} waypoint[{dim}])")
        functions += ["{", *indent(do.used_statements()), "}", ""]

    # 5. The floor of each type that they need: NaN, and whole numbers beyond the bits of a mantissa, stay.
    helpers = []
    for of_type, whole, digits, one in _FLOORS:
        if of_type in floors | do.floors:
            helpers += [
                f"static inline {of_type} {name}_floor_of_{of_type}({of_type} v)",
                "{",
                f"    if (!(v < {digits} && v > -{digits})) {{",
                "        return v;",
                "    }",
                f"    const {of_type} toward_zero = ({of_type})({whole})v;",
                f"    return toward_zero > v ? toward_zero - {one} : toward_zero;",
                "}",
                "",
            ]
    return "\n".join([*introduction, *tables, *helpers, *descent * has_tree, *functions, "#endif", ""])
