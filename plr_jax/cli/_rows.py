"""Tables of points, read and answered chunk by chunk: any number of rows in little memory."""

import io
import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.cli._app import warn
from plr_jax.cli._inputs import numbers_of

_CHUNK_BYTES = _MOST_LINE_BYTES = 1 << 20
_MOST_WARNINGS, _MOST_SHOWN = 10, 80
_OF_NUMBERS = b"0123456789+-.,eEiInNfFaAtTyY \t\r\n"  # else NumPy takes what is no number for one, such as b"\xa01"


@dataclass
class PointTable:
    """Points as lines of text: ``dim`` numbers a line, separated by commas, after an optional header of names.

    A row that is not so many numbers, as a blank line, is NaN throughout, and is told on standard error; of many such
    rows the first few, and how many there were. Blank lines at the end are no rows.

    Attributes:
        name: What errors call the table.
        dim: Numbers a line.
        strict: Whether such a row is an error, after the rows before it.
    """

    name: str
    dim: int
    strict: bool = False
    num_lines: int = field(default=0, init=False)
    num_bad: int = field(default=0, init=False)
    _error: str | None = field(default=None, init=False)

    def chunks(self, file: io.BufferedIOBase) -> Iterator[Float[np.ndarray, "n dim"]]:
        """The points, some at a time.

        Raises:
            ValueError: If it is no text, has no points, or has a row that is none and is to be ``strict``.
        """
        is_empty = True
        for block in self._blocks(file):
            num_lines = block.count(b"\n")
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # that lines are blank, which are told below
                    points = np.loadtxt(io.BytesIO(block), delimiter=",", comments=None, ndmin=2)
                is_plain = points.shape == (num_lines, self.dim) and not block.translate(None, _OF_NUMBERS)
            except ValueError:
                is_plain = False
            if not is_plain:
                points = self._parsed_line_by_line(block.removesuffix(b"\n").split(b"\n"))
            self.num_lines += num_lines
            if len(points):
                is_empty = False
                yield points
            if self._error is not None:
                raise ValueError(self._error)
        if is_empty:
            raise ValueError(f"{self.name} has no points: expected {self._expected} a line.")
        if self.num_bad > _MOST_WARNINGS:
            warn(f"{self.name} has {self.num_bad:,} rows that are no points.")

    @property
    def _expected(self) -> str:
        return f"{self.dim} comma-separated numbers"

    def _blocks(self, file: io.BufferedIOBase) -> Iterator[bytes]:
        """Whole lines, without the header and blank lines at the end, as they come.

        Of blank lines only the number is kept, until there is a line behind them.
        """
        rest, is_start, num_blank = b"", True, 0
        while data := file.read1(_CHUNK_BYTES):
            rest += data
            if is_start and b"\n" in rest:
                is_start, rest = False, self._without_header(self._without_mark(rest))
            filled = len(rest.rstrip())
            end = rest.find(b"\n", filled) + 1 or rest.rfind(b"\n", 0, filled) + 1
            if filled and end and not is_start:
                yield from _blank_lines(num_blank)
                yield rest[:end]
                rest, num_blank = rest[end:], 0
            if not (is_start or rest.strip()):
                num_blank += rest.count(b"\n")
                rest = rest[rest.rfind(b"\n") + 1 :]
            if len(rest) > _MOST_LINE_BYTES:
                raise ValueError(
                    f"{self.name}, line {self.num_lines + num_blank + 1}: longer than {_MOST_LINE_BYTES:,} bytes."
                )
        if is_start:
            rest = self._without_header(self._without_mark(rest))
        if rest.strip():
            yield from _blank_lines(num_blank)
            yield rest.rstrip() + b"\n"

    def _without_mark(self, start: bytes) -> bytes:
        """A file's start without the mark that spreadsheets write."""
        if b"\0" in start:
            raise ValueError(f"{self.name} is not a text file.")
        return start.removeprefix(b"\xef\xbb\xbf")

    def _without_header(self, start: bytes) -> bytes:
        line, newline, others = start.partition(b"\n")
        if not _is_header(line):
            return start
        self.num_lines += len(newline)
        return others

    def _parsed_line_by_line(self, lines: list[bytes]) -> Float[np.ndarray, "n dim"]:
        points = np.full((len(lines), self.dim), np.nan)
        for index, line in enumerate(lines):
            numbers = numbers_of(line.decode(errors="replace"))
            if len(numbers) == self.dim:
                points[index] = numbers
                continue
            self.num_bad += 1
            if not self.strict and self.num_bad > _MOST_WARNINGS:
                continue
            text = line.rstrip(b"\r").decode(errors="replace")
            text = text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
            message = f"{self.name}, line {self.num_lines + index + 1}: expected {self._expected}, got {text!r}"
            if self.strict:
                self._error = message + "."
                return points[:index]
            warn(f"{message}; the answer is nan.")
            if self.num_bad == _MOST_WARNINGS:
                warn("of further such rows only their number is told.")
        return points


def open_table(source: str) -> tuple[str, Any]:
    """Name and bytes of a file, or of standard input for ``-``."""
    if source != "-":
        return source, open(source, "rb")
    if sys.stdin is None:
        raise ValueError("Standard input is closed: name a file of points.")
    return "stdin", sys.stdin.buffer


def require_standard_output() -> None:
    """Refuse to work where nobody could read the answers."""
    if sys.stdout is None:
        raise ValueError("Standard output is closed: there is nowhere to print answers.")


def print_answers(chunks: Iterable[Float[np.ndarray, "n columns"]]) -> None:
    """Print answers, one row a line, chunk by chunk."""
    for answers in chunks:
        line = ",".join(["%.9g"] * answers.shape[1]) + "\n"
        sys.stdout.write(line * len(answers) % tuple(answers.ravel().tolist()))
        sys.stdout.flush()


def _blank_lines(count: int) -> Iterator[bytes]:
    """So many blank lines, in blocks."""
    for start in range(0, count, _CHUNK_BYTES):
        yield b"\n" * min(_CHUNK_BYTES, count - start)


def _is_header(line: bytes) -> bool:
    """Whether a line is one of names: each begins with a letter, and none is a number, as ``nan`` is."""
    names = [name for name in re.split(r"[,;\s\"'#]+", line.decode(errors="replace")) if name]
    begin = all(name[0].isalpha() or name[0] == "_" for name in names)
    return bool(names) and begin and not any(map(numbers_of, names))
