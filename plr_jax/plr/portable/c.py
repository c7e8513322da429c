"""Generate a C99 header from a PLR: :func:`c_header` with plain tables, :func:`compact_header` with compact bytes."""

from collections.abc import Iterable

import numpy as np

from plr_jax.plr._file import decode
from plr_jax.plr.leaves import Cone, code_of_leaf
from plr_jax.plr.portable.arithmetic import CodedTree, LeafRows, Program, distinct_rows
from plr_jax.plr.portable.compact import DECODER, compact_bytes
from plr_jax.plr.portable.writers import Emitter, Expression, format_domain, indent, require_identifier, wrap_entries

# For each floor function: type, integer type, bound beyond which all numbers are whole, and the number 1.
_FLOORS = (("float", "int32_t", "8388608.0f", "1.0f"), ("double", "int64_t", "4503599627370496.0", "1.0"))
_WHY = {
    "float": "only domains farther from 0 than 4 times their width need double",
    "double": "this domain is farther from 0 than 4 times its width, where float is too coarse",
}
# Bytes of code and of stack: upper limits of what GCC 12 gave with -Os -fno-math-errno for a Cortex-M4. Its doubles
# are computed by library functions, which are counted. For compact headers, LeafModel.decoder_cost has these bytes.
_TABLES_COST = (600, 100)  # with tables, in the plane
_GENERAL_COST = (
    3_000,
    250,
)  # added for 3 or, twice, more axes; periodic axes, mirrored points, buildings, far domains
_FLOOR_BYTES = 32  # of tables, for each floor of a building
# Estimates for cones, measured on four maps with files of 0.5 to 4 KB. Errors of cones were compared with errors of
# other leaves in files of the same size, and with errors of planes in files of twice the size.
_CONE_RATIO = {False: 7.4, True: 2.5}  # bytes of tables (False: plain, True: compact) a byte of a file of cones
_CONE_ERROR = "Its mean error is smaller if the file has room for all corners; a tolerance limits its largest error."
_WAYPOINT_ADVICE = "; a waypoint needs leaf 'cone', for maps of polygons"


class CEmitter(Emitter):
    """A generator of C99 code.

    ``name`` is the prefix of the functions that the code calls.
    """

    root_of, cast = "sqrtf({})", "(float)({})"
    definition = "const {type} {name} = {value};"

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name

    def literal(self, number: np.floating) -> str:
        """Return the shortest decimal that C reads as the same number; ``INFINITY`` or ``-INFINITY`` if infinite."""
        if np.isinf(number):
            return "INFINITY" if number > 0 else "-INFINITY"
        return str(number) + ("f" if number.dtype == np.float32 else "")

    def floor(self, x: Expression) -> Expression:
        return self.atom(f"{self.name}_floor_of_{x.type}({x})", x.type)

    def fraction(self, x: Expression) -> Expression:
        # The 23 mantissa bits of a float in [1, 2), as the highest bits of a word; the shift drops the leading one.
        return self.atom(f"(uint32_t)({x * np.float32(1 << 23)}) << 9", "uint32_t")


def c_table(declaration: str, entries: Iterable[str]) -> list[str]:
    return [f"static const {declaration} = {{", *wrap_entries(entries), "};"]


def c_function(signature: str, statements: list[str]) -> list[str]:
    return [signature, "{", *indent(statements), "}", ""]


def cost_in_c(data: bytes, compact: bool = False, num_floors: int = 0) -> list[str]:
    """Return lines that state the memory of a PLR file's C header, and estimate the memory with cone leaves instead.

    ``data`` has the bytes of the file. If the file is part of a building's file, ``num_floors`` is the number of
    floors.
    """
    program = Program(decode(data))
    num_bytes = len(compact_bytes(program)) if compact else _tables(program)[2]
    lines = _cost_lines(program, num_bytes + _FLOOR_BYTES * num_floors, compact, num_floors > 0)
    if isinstance(program.leaf, Cone) or program.dim != 2 or program.domain.is_periodic:
        return lines
    cone_file = len(data) if program.leaf.num_powers else len(data) // 2
    estimate = f"in a file of {cone_file:,} bytes takes about {round(_CONE_RATIO[compact] * cone_file, -2):,.0f}"
    return [*lines, f"Estimate: on maps of polygons, leaf 'cone' {estimate} bytes of tables.", _CONE_ERROR]


def _cost_lines(program: Program, tables: int, compact: bool, is_building: bool = False) -> list[str]:
    """Return lines that state the memory of a header with ``tables`` bytes of tables, and the header's functions."""
    is_cone, is_far = isinstance(program.leaf, Cone), program.corner is not None
    is_special = is_far or is_building or program.domain.is_periodic or program.folding_arrays or program.straight
    added = np.multiply(_GENERAL_COST, 0 if program.dim <= 2 and not is_special else 1 + (program.dim > 3))
    code, stack = np.add(program.leaf.decoder_cost if compact else _TABLES_COST, added)
    kinds = "float and double" if is_far or is_building or (compact and not is_cone) else "float"
    return [
        f"On a Cortex-M4: {tables:,} bytes of tables, at most {code:,} of code, {stack:,} of stack; {kinds} numbers.",
        f"Functions: distance{'' if is_building else ', waypoint' if is_cone else _WAYPOINT_ADVICE}.",
    ]


def _tables(program: Program) -> tuple[LeafRows, CodedTree, int]:
    """Return the tables of a header, distinct rows of leaf parameters and the tree, and the bytes that they take."""
    rows, row_of_leaf = distinct_rows(program.leaf_parameters)
    tree = CodedTree(program.contents.tree, row_of_leaf)
    return rows, tree, 4 * rows.size + tree.code_type.itemsize * tree.children.size


def c_header(program: Program, name: str) -> str:
    """Return a C header with the tables of a PLR and the functions that answer queries; see :meth:`PLR.c_header`.

    ``name`` is the prefix of the header's functions and tables. ``ValueError`` if it is no C identifier.
    """
    require_identifier(name)
    dim, leaf = program.dim, program.leaf
    of_type = "float" if program.corner is None else "double"  # of coordinates
    rows, tree, table_bytes = _tables(program)
    has_tree, is_sourced, of_cells = len(tree.children) > 0, isinstance(leaf, Cone), leaf.is_cell_relative
    # 1. Description and includes.
    guard = f"PLR_JAX_{name}_H"  # not in upper case: names may differ only in case
    introduction = [
        f"#ifndef {guard}",
        f"#define {guard}",
        f"/* Distance to a goal, generated by plr_jax: {len(program.leaf_parameters)} leaves of type {leaf.name!r}.",
        "",
        f"   {name}_distance: distance to the goal from a point of the domain {format_domain(program.domain)};",
        "   INFINITY outside the closed domain, NAN for NAN. It does not test for obstacles.",
        *[f"   {name}_waypoint: next corner or goal; on a corner, maybe this corner. NaN outside."] * is_sourced,
        f"   Coordinates are {of_type}: {_WHY[of_type]}.",
        *(f"   {line}" for line in _cost_lines(program, table_bytes, compact=False)),
        "",
        "   Results equal those of plr.numpy() bit for bit if compiled with -ffp-contract=off: GCC otherwise fuses",
        "   operations on some processors. With -fno-math-errno, GCC may need no library for sqrtf. */",
        "",
        "#include <float.h>",
        "#include <math.h>",
        "#include <stdint.h>",
        "",
        "#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0",
        '#error "floats must be evaluated as floats: on 32-bit x86, compile with -msse2 -mfpmath=sse"',
        "#endif",
        *["#if DBL_MANT_DIG != 53", '#error "doubles must have 64 bits"', "#endif"] * (of_type == "double"),
        "#if defined(__clang__)",
        "#pragma STDC FP_CONTRACT OFF",
        "#endif",
        "",
    ]
    # 2. Tables: the tree and the leaf parameters.
    tables, literal = [], CEmitter(name).literal
    if has_tree:
        entries = (f"{{{lower}, {upper}}}" for lower, upper in tree.children.tolist())
        tables += [
            f"/* Children of every split node, the lower one first, as {1 << tree.kind_bits} * row + kind. Of a",
            f"   split child: its row in this table, its axis. Of a leaf: its row in {name}_numbers, {dim}. */",
            *c_table(f"{tree.code_type}_t {name}_tree[{len(tree.children)}][2]", entries),
            "",
        ]
    entries = ("{" + ", ".join(map(literal, row)) + "}" for row in rows)
    tables += [*c_table(f"float {name}_numbers[{len(rows)}][{rows.shape[1]}]", entries), ""]
    # 3. Descent from fraction bits to the row of the leaf. `place` has the next bit along each axis as its highest.
    # For polynomials, `cell` has for each axis the number of cells like the current one that the domain has, and the
    # index of the current one.
    mask = (1 << tree.kind_bits) - 1
    statements = [
        f"uint32_t code = {tree.root}u;",
        f"while ((code & {mask}u) != {dim}u) {{",
        f"    const uint32_t axis = code & {mask}u;",
        "    const uint32_t upper = place[axis] >> 31;",
        "    place[axis] <<= 1;",
        *["    cell[axis][0] *= 2;", "    cell[axis][1] = 2 * cell[axis][1] + upper;"] * of_cells,
        f"    code = {name}_tree[code >> {tree.kind_bits}][upper];",
        "}",
        f"return code >> {tree.kind_bits};",
    ]
    signature = f"static inline uint32_t {name}_leaf(uint32_t place[{dim}]{f', uint32_t cell[{dim}][2]' * of_cells})"
    comment = "/* Descends the tree: each split takes the next bit of the position along its axis. */"
    descent = [comment, *c_function(signature, statements)]

    def read_leaf(do: CEmitter, fractions: list[Expression]) -> list[Expression]:
        row, counts = "0", ["1.0f", "0.0f"] * dim
        if has_tree:
            do.statements.append(f"uint32_t place[{dim}] = {{{', '.join(map(str, fractions))}}};")
            if of_cells:  # number of cells along each axis, position of this one
                do.statements.append(f"uint32_t cell[{dim}][2] = {{{', '.join(['{1, 0}'] * dim)}}};")
            row = f"{name}_leaf(place{', cell' * of_cells})"
            counts = [f"(float)cell[{axis}][{i}]" for axis in range(dim) for i in range(2)]
        do.statements.append(f"const float *const n = {name}_numbers[{row}];")
        return [do.atom(text) for text in [*counts * of_cells, *(f"n[{i}]" for i in range(rows.shape[1]))]]

    # 4. The functions.
    do = CEmitter(name)
    outside = [f"return {do.nan_condition(dim)} ? NAN : INFINITY;"]
    offsets, numbers = do.write_lookup(program, of_type, read_leaf, outside)
    do.statements.append(f"return {program.value(do, offsets, numbers)};")
    functions = c_function(f"static inline float {name}_distance(const {of_type} x[{dim}])", do.used_statements())
    if is_sourced:
        do = CEmitter(name)
        outside = [*(f"waypoint[{axis}] = NAN;" for axis in range(dim)), "return;"]
        _, numbers = do.write_lookup(program, of_type, read_leaf, outside)
        numbers = [do.atom(f"(double){n}", of_type) for n in numbers] if of_type == "double" else numbers
        do.statements += [f"waypoint[{axis}] = {along};" for axis, along in enumerate(program.waypoint(numbers))]
        signature = f"static inline void {name}_waypoint(const {of_type} x[{dim}], {of_type} waypoint[{dim}])"
        functions += c_function(signature, do.used_statements())
    # 5. Floors of the types in use; NaN and numbers too large to have a fraction are returned unchanged.
    helpers = []
    for of_type, whole, digits, one in _FLOORS:
        if any(f"{name}_floor_of_{of_type}" in line for line in functions):
            statements = [
                f"if (!(v < {digits} && v > -{digits})) {{",
                "    return v;",
                "}",
                f"const {of_type} toward_zero = ({of_type})({whole})v;",
                f"return toward_zero > v ? toward_zero - {one} : toward_zero;",
            ]
            helpers += c_function(f"static inline {of_type} {name}_floor_of_{of_type}({of_type} v)", statements)
    return "\n".join([*introduction, *tables, *helpers, *descent * has_tree, *functions, "#endif", ""])


def compact_header(program: Program, name: str) -> str:
    """Return a C header with the compact bytes of a PLR and the decoder that queries them; see :meth:`PLR.c_header`.

    ``name`` is the prefix of the functions and bytes of this PLR. ``ValueError`` if it is no C identifier.
    """
    require_identifier(name)
    data, dim = compact_bytes(program), program.dim
    of_type, far = ("float", "") if program.corner is None else ("double", "_far")  # of coordinates; of functions
    signature = f"static inline void {name}_waypoint(const {of_type} x[{dim}], {of_type} waypoint[{dim}])"
    comment = "/* The next corner or goal; on a corner, maybe this corner. NaN outside the domain. */"
    waypoint = ["", comment, *c_function(signature, [f"plr_jax_waypoint{far}(&{name}_plr, x, waypoint);"])[:-1]]
    guard = f"PLR_JAX_{name}_H"  # not in upper case: names may differ only in case
    # The features of this PLR, a constant, so that the compiler leaves out code for others.
    features = [f"1u << {code_of_leaf(program.leaf)}u", *["PLR_JAX_WRAPS"] * program.domain.is_periodic]
    features += ["PLR_JAX_FOLDS"] * (program.folding_arrays is not None)
    features += ["PLR_JAX_LINES"] * (program.straight is not None)
    lines = [
        f"#ifndef {guard}",
        f"#define {guard}",
        f"#if !defined(PLR_JAX_MAX_DIM) && {dim} > 6",
        f"#define PLR_JAX_MAX_DIM {dim}",
        "#endif",
        DECODER.read_text(),
        f"#if PLR_JAX_MAX_DIM < {dim}",
        f'#error "define PLR_JAX_MAX_DIM as {dim} before the first header"',
        "#endif",
        *c_table(f"unsigned char {name}_bytes[{len(data)}]", map(str, data)),
        f"static const struct plr_jax {name}_plr = {{{name}_bytes, {len(data)}}};",
        "",
        f"/* Distance to a goal, generated by plr_jax: {len(program.leaf_parameters)} leaves of type"
        f" {program.leaf.name!r}, from a point",
        f"   of the domain {format_domain(program.domain)};",
        "   INFINITY outside the closed domain, NAN for NAN. It does not test for obstacles.",
        *(f"   {line}" for line in _cost_lines(program, len(data), compact=True)),
        f"   Coordinates are {of_type}: {_WHY[of_type]}. */",
        f"static inline float {name}_distance(const {of_type} x[{dim}])",
        "{",
        f"    return plr_jax_distance{far}_of(&{name}_plr, x, {' | '.join(features)});",
        "}",
        *waypoint * isinstance(program.leaf, Cone),
        "#endif",
        "",
    ]
    return "\n".join(lines)
