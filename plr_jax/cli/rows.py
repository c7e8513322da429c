"""Tables of points, read and answered block by block: any number of rows in little memory."""

import io
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.cli.app import numbers_of, warn

_BLOCK_BYTES = _MOST_LINE_BYTES = 1 << 20
_MOST_WARNINGS, _MOST_SHOWN = 10, 80
_OF_NUMBERS = b"0123456789+-.,eEiInNfFaAtTyY \t\r\n"  # NumPy takes b"\xa01" for a number, we do not


@dataclass
class PointTable:
    """Points as lines of text: ``dim`` comma-separated numbers in each line, after an optional header.

    Blank lines are skipped. A row of anything else becomes NaN, and is reported on standard error: the first few
    rows, and then their number.

    Attributes:
        name: The name of the table in errors.
        dim: Numbers in each line.
        strict: Whether such a row is an error, raised after the rows before it.
    """

    name: str
    dim: int
    strict: bool = False

    def chunks(self, file: io.BufferedIOBase) -> Iterator[Float[np.ndarray, "n dim"]]:
        """Yield the points, some at a time, as the lines come.

        Raises:
            ValueError: If the table is no text, has no points, or has a row that is no point and is ``strict``.
        """
        expected, num_lines, num_bad, is_empty = f"{self.dim} comma-separated numbers", 0, 0, True
        may_be_header = True
        for block in self._blocks(file):
            lines = block.removesuffix(b"\n").split(b"\n")
            rows = [(number, line) for number, line in enumerate(lines, num_lines + 1) if line.strip()]
            num_lines += len(lines)
            if may_be_header and rows:
                may_be_header = False
                rows = rows[_is_header(rows[0][1]) :]
            # 1. The usual block: NumPy reads all of it at once.
            block = b"\n".join(line for _, line in rows)
            points = np.full((len(rows), self.dim), np.nan)
            try:
                read = np.loadtxt(io.BytesIO(block), delimiter=",", comments=None, ndmin=2) if rows else points
                is_plain = read.shape == points.shape and not block.translate(None, _OF_NUMBERS)
            except ValueError:
                is_plain = False
            # 2. A block with a bad row: line by line.
            error = None
            points = read if is_plain else points
            for index, (number, line) in enumerate(() if is_plain else rows):
                text = line.rstrip(b"\r").decode(errors="replace")
                numbers = numbers_of(text)
                if len(numbers) == self.dim:
                    points[index] = numbers
                    continue
                num_bad += 1
                text = text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
                message = f"{self.name}, line {number}: expected {expected}, got {text!r}"
                if self.strict:
                    points, error = points[:index], message
                    break
                if num_bad <= _MOST_WARNINGS:
                    warn(f"{message}; the answer is nan.")
                if num_bad == _MOST_WARNINGS:
                    warn("further such rows are only counted.")
            if len(points):
                is_empty = False
                yield points
            if error is not None:
                raise ValueError(f"{error}.")
        if is_empty:
            raise ValueError(f"{self.name} has no points: expected {expected} in each line.")
        if num_bad > _MOST_WARNINGS:
            warn(f"{self.name} has {num_bad:,} rows that are no points.")

    def _blocks(self, file: io.BufferedIOBase) -> Iterator[bytes]:
        """Yield whole lines as they come, each block with its last newline."""
        rest, num_lines = b"", 0
        while data := file.read1(_BLOCK_BYTES):
            if not num_lines and not rest:
                data = data.removeprefix(b"\xef\xbb\xbf")  # the mark that spreadsheets write
            if b"\0" in data:
                raise ValueError(f"{self.name} is not a text file.")
            rest += data
            end = rest.rfind(b"\n") + 1
            if end:
                yield rest[:end]
                num_lines, rest = num_lines + rest.count(b"\n"), rest[end:]
            if len(rest) > _MOST_LINE_BYTES:
                raise ValueError(f"{self.name}, line {num_lines + 1}: longer than {_MOST_LINE_BYTES:,} bytes.")
        if rest:
            yield rest


def open_table(source: str) -> tuple[str, Any]:
    """Return the name and the bytes of a file, or of standard input for ``-``."""
    if source != "-":
        return source, open(source, "rb")
    if sys.stdin is None:
        raise ValueError("Standard input is closed: name a file of points.")
    return "stdin", sys.stdin.buffer


def print_answers(chunks: Iterable[Float[np.ndarray, "n columns"]]) -> None:
    """Print answers, one row in each line, chunk by chunk."""
    for answers in chunks:
        line = ",".join(["%.9g"] * answers.shape[1]) + "\n"
        sys.stdout.write(line * len(answers) % tuple(answers.ravel().tolist()))
        sys.stdout.flush()


def _is_header(line: bytes) -> bool:
    """Return whether a line is a header: each name begins with a letter, and none is a number, as ``nan`` is."""
    names = [name for name in re.split(r"[,;\s\"'#]+", line.decode(errors="replace")) if name]
    begin = all(name[0].isalpha() or name[0] == "_" for name in names)
    return bool(names) and begin and not any(map(numbers_of, names))
