"""A query of a single point in Python: the arithmetic of the format, written out for one PLR.

What the steps are is known beforehand, and so is every number but the leaf's; what is left takes a few microseconds.
"""

from collections.abc import Callable
from math import floor, sqrt
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.plr.portable.leaf_table import LeafTable
from plr_jax.plr.portable.program import Program
from plr_jax.plr.portable.text import PythonWriter

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

    Outside it is ``inf``, or NaN where a coordinate is.

    ``numbers`` are those of the leaves; of such as are of cells, how many cells there are along each axis and which
    it is come first.
    """
    do, domain = PythonWriter(), program.domain
    given = [f"x{axis}" for axis in range(program.dim)]
    # Beside the upper end of a periodic axis, wrapping in 64 bits may lead to the lower one.
    unwrapped = np.minimum(domain.lo + domain.width * _UNWRAPPED, np.nextafter(domain.hi, -np.inf))
    last = np.where(domain.periodic, unwrapped, domain.hi)
    ends = zip(given, domain.lo.tolist(), last.tolist(), strict=True)
    inside = [f"{lo!r} <= {name} <= {hi!r}" for name, lo, hi in ends]
    beyond = zip(given, _beyond(program), strict=True)
    outside = [f"({name} < {below!r}) | ({name} > {above!r})" for name, (below, above) in beyond]
    is_nan = " or ".join(f"{name} != {name}" for name in given)
    precision = np.dtype(program.precision).name
    of_type = "float" if precision == "float32" else "double"
    x = [do.let("x", do.atom(f"{precision}({name})", of_type)) for name in given]
    x = program.placed(do, program.counted(do, x))
    above = program.above(do, x)
    index = table.index_text([str(do.let("place", place)) for place in program.places(do, above)])
    do.statements.append(f"leaf = {index}")
    names = [f"n{i}" for i in range(numbers.shape[1])]
    do.statements.append(f"{', '.join(names)}, = rows[leaf]")
    read = [do.atom(name) for name in names]
    num_of_cell = 2 * program.dim * program.leaf.is_of_cells
    cell = list(zip(read[:num_of_cell:2], read[1:num_of_cell:2], strict=True))
    value = program.value(do, x, above, read[num_of_cell:], cell)
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
        "descend": table.row,
        "codes": table.codes,
        "floor": floor,
        "sqrt": sqrt,
        "inf": np.float32(np.inf),
        "nan": np.float32(np.nan),
        "float32": np.float32,
        "float64": np.float64,
    }
    exec(source, names_in_source)
    return names_in_source["query"]


def _beyond(program: Program) -> list[tuple[float, float]]:
    """Along each axis the numbers below and above which coordinates are outside the domain, however they round."""
    corner = np.zeros(program.dim) if program.corner is None else program.corner
    beyond = []
    for window, is_periodic, origin in zip(program.windows, program.domain.periodic, corner.tolist(), strict=True):
        if is_periodic:
            beyond.append((-_LARGEST, _LARGEST))
        else:
            below, above = np.nextafter(window.lo, np.float32(-np.inf)), np.nextafter(window.hi, np.float32(np.inf))
            beyond.append((origin + float(below), origin + float(above)))
    return beyond
