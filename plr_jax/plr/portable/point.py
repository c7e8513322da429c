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
    """The value at a point, given by its coordinates; None unless it is plainly inside the domain.

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
    lines = [f"if not ({' and '.join(inside)}): return None", *do.statements, f"return {value}"]
    source = "\n    ".join([f"def query({', '.join(given)}):", *lines])
    names_in_source: dict[str, Any] = {
        **do.constants,
        "rows": _Rows(numbers),
        "descend": table.row,
        "codes": table.codes,
        "floor": floor,
        "sqrt": sqrt,
        "float32": np.float32,
        "float64": np.float64,
    }
    exec(source, names_in_source)
    return names_in_source["query"]
