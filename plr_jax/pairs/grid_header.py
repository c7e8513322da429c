"""Pairs of a grid in C99: a header with the code of a query, and a file of its tables that a program maps.

A query is that of ``grid_query.py`` in integers. All that depends on the grid but for its tables is written into the
header as constants; tables stand one after the other in the file, each at a multiple of 64 bytes.
"""

import re
import zlib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from plr_jax.pairs.grid_corners import FAR, CornerTable, open_length, units
from plr_jax.pairs.grid_query import BLOCK, GROUP, GridTables
from plr_jax.plr.portable.writers import require_identifier

_ALIGNED = 64
_TEMPLATE = Path(__file__).with_name("grid_pairs.h")
_MAGIC = b"plr_jax grid 1\n\0"


@dataclass(frozen=True, eq=False)
class GridHeader:
    """A header and the file that it reads.

    Attributes:
        text: The header.
        table: The bytes of the file.
    """

    text: str
    table: bytes


def grid_header(tables: GridTables, name: str) -> GridHeader:
    """Write the header of a grid, whose definitions all begin with ``name``, and the file of tables that it reads.

    Raises:
        ValueError: If the name is no identifier of C.
    """
    require_identifier(name)
    distances = tables.distances
    is_table = isinstance(distances, CornerTable)
    arrays = {"free": tables.sight.free, "sums": tables.sight.sums}
    arrays |= {each: getattr(tables, each) for each in ("group_block", "cell_block", "blocks", "row", "column")}
    arrays |= {each.name: getattr(distances, each.name) for each in fields(distances)}
    # 1. The file of tables, and a function of C that reads each table.
    table, accessors = _MAGIC, []
    for of, array in arrays.items():
        data = np.ascontiguousarray(np.asarray(array)).astype(array.dtype.newbyteorder("<"))
        table += bytes(-len(table) % _ALIGNED)
        of_type = f"{'u' if data.dtype.kind == 'u' else ''}int{8 * data.dtype.itemsize}_t"
        accessors.append(
            f"static inline int32_t {name}_{of}(uint32_t i)\n"
            f"{{ return (int32_t)((const {of_type} *)(const void *)({name}_data + {len(table)}u))[i]; }}"
        )
        table += data.tobytes()
    table += zlib.crc32(table).to_bytes(4, "little")
    # 2. The text: sections of the template, whose marks are replaced by what is known of the grid.
    sections = dict(re.findall(r"^@@ ([\w ]+)\n(.*?)(?=^@@|\Z)", _TEMPLATE.read_text(encoding="utf-8"), re.M | re.S))
    first = np.asarray(tables.group_block)[np.arange(len(tables.cell_block)) // GROUP] + np.asarray(tables.cell_block)
    rows, columns = tables.shape
    marks = {
        "SIGHT": sections[f"sight {tables.connectivity}"],
        "DISTANCES": sections["distances by table" if is_table else "distances by labels"],
        "ARRAYS": "\n".join(accessors),
        "ROWS": rows,
        "COLUMNS": columns,
        "CELLS": rows * columns,
        "CONNECTIVITY": tables.connectivity,
        "SIZE": f"{len(table):,}",
        "BYTES": len(table),
        "CRC": int.from_bytes(table[-4:], "little"),
        "CENTERS": len(distances.between_centers) if isinstance(distances, CornerTable) else 0,
        "MOST": BLOCK * max(int(np.diff(first).max()), 1),
        "FAR": FAR,
        "UNIT": units(tables.connectivity),
        "DIAGONAL": int(open_length(tables.connectivity, 1, 1)),
        "BLOCK": BLOCK,
        "GROUP": GROUP,
        "NAME": name,
    }
    text = sections["header"]
    for mark, value in marks.items():
        text = text.replace(f"@{mark}@", str(value))
    return GridHeader(text, table)
