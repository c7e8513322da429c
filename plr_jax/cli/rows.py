"""Read the points of a CSV table block by block, so that tables of any length fit into memory."""

import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.cli.app import warn

_BLOCK_BYTES = 1 << 20  # bytes read at a time, which bounds the memory
_MOST_SHOWN = 80  # most characters of a bad row in a warning
_HEADER = re.compile(r"""([\s"'#]*[^\W\d][^,]*(,|$))+""")  # each field begins with a letter or _


def read_points(file: Any, name: str, dim: int) -> Iterator[Float[np.ndarray, "n dim"]]:
    """Yield the points of a table block by block: ``dim`` comma-separated numbers per line, after an optional header.

    ``file`` is a binary file, called ``name`` in messages. Blank lines are skipped. Rows that are not points become
    NaN; for each block, a warning names the first such row. ``ValueError`` is raised if the table has no rows.
    """
    expected = f"{dim} comma-separated numbers"
    may_be_header = is_empty = True
    num_lines = 0  # number of lines in earlier blocks
    for block in _blocks(file):
        # 1. Number the lines of the block from 1, and drop blank ones, and the header if this is the first row.
        lines = block.split("\n")
        numbers = [number for number, line in enumerate(lines, 1) if line.strip()]
        rows = [lines[number - 1].strip() for number in numbers]
        if rows and may_be_header:
            may_be_header = False
            # A header looks like names, and cannot be read as numbers, as nan,inf can.
            if _HEADER.fullmatch(rows[0]) and _parse(rows[:1], np.empty((1, dim))):
                del rows[0], numbers[0]
        # 2. Read the numbers.
        if rows:
            is_empty = False
            points = np.full((len(rows), dim), np.nan)
            if bad := _parse(rows, points):
                where = f"{name}, line {num_lines + numbers[bad[0]]}"
                more = f", as for {len(bad) - 1:,} more rows" if len(bad) > 1 else ""
                warn(f"{where}: expected {expected}, got {rows[bad[0]][:_MOST_SHOWN]!r}; the answer is nan{more}.")
            yield points
        num_lines += len(lines)
    if is_empty:
        raise ValueError(f"{name} has no points: expected {expected} in each line.")


def _blocks(file: Any) -> Iterator[str]:
    """Yield the text of a binary file in blocks of whole lines.

    A block is yielded as soon as its lines arrive, so that rows typed into a pipe are answered at once.
    """
    rest = b""
    while data := file.read1(_BLOCK_BYTES):
        block, newline, rest = (rest + data).rpartition(b"\n")
        if newline:
            yield block.decode("utf-8-sig", "replace")
    yield rest.decode("utf-8-sig", "replace")


def _parse(rows: list[str], points: Float[np.ndarray, "n dim"]) -> list[int]:
    """Write the numbers of text rows into the array ``points``, and return the indices of bad rows.

    ``np.loadtxt`` is fast for many rows, but fails if a row is bad. If it fails, each half of the rows is parsed
    separately. Bad rows of ``points`` stay unchanged.
    """
    with suppress(ValueError):
        read = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
        if read.shape == points.shape:
            points[:] = read
            return []
    if len(rows) == 1:
        return [0]
    half = len(rows) // 2
    return _parse(rows[:half], points[:half]) + [half + bad for bad in _parse(rows[half:], points[half:])]
