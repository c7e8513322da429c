"""Reading tables of points and printing answers block by block, so that tables may have any length."""

import io
import re
import sys
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.cli.app import numbers_of, warn

_BLOCK_BYTES = _MOST_LINE_BYTES = 1 << 20
_MOST_WARNINGS, _MOST_SHOWN = 10, 80
_OF_NUMBERS = b"0123456789+-.,eEiInNfFaAtTyY \t\r\n"  # NumPy also parses b"\xa01" as a number


def read_points(
    file: io.BufferedIOBase, name: str, dim: int, strict: bool = False
) -> Iterator[Float[np.ndarray, "n dim"]]:
    """Yield the points of a table block by block: ``dim`` comma-separated numbers per line, after an optional header.

    Blank lines are skipped. Rows that are not points become NaN, with warnings. If ``strict``, the first such row
    raises an error, after the rows before it are yielded.
    """
    expected, num_lines, num_bad, is_empty = f"{dim} comma-separated numbers", 0, 0, True
    may_be_header = True
    for block in _blocks(file, name):
        lines = block.removesuffix(b"\n").split(b"\n")
        rows = [(number, line) for number, line in enumerate(lines, num_lines + 1) if line.strip()]
        num_lines += len(lines)
        if may_be_header and rows:
            may_be_header = False
            rows = rows[_is_header(rows[0][1]) :]
        # 1. Let NumPy parse the whole block.
        block = b"\n".join(line for _, line in rows)
        points = np.full((len(rows), dim), np.nan)
        try:
            read = np.loadtxt(io.BytesIO(block), delimiter=",", comments=None, ndmin=2) if rows else points
            is_plain = read.shape == points.shape and not block.translate(None, _OF_NUMBERS)
        except ValueError:
            is_plain = False
        # 2. If a row is invalid, parse line by line.
        error = None
        points = read if is_plain else points
        for index, (number, line) in enumerate(() if is_plain else rows):
            text = line.rstrip(b"\r").decode(errors="replace")
            numbers = numbers_of(text)
            if len(numbers) == dim:
                points[index] = numbers
                continue
            num_bad += 1
            text = text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
            message = f"{name}, line {number}: expected {expected}, got {text!r}"
            if strict:
                points, error = points[:index], message
                break
            if num_bad <= _MOST_WARNINGS:
                warn(f"{message}; the answer is nan.")
            if num_bad == _MOST_WARNINGS:
                warn("further invalid rows are only counted.")
        if len(points):
            is_empty = False
            yield points
        if error is not None:
            raise ValueError(f"{error}.")
    if is_empty:
        raise ValueError(f"{name} has no points: expected {expected} in each line.")
    if num_bad > _MOST_WARNINGS:
        warn(f"{name} has {num_bad:,} rows that are not points.")


def _blocks(file: io.BufferedIOBase, name: str) -> Iterator[bytes]:
    rest, num_lines = b"", 0
    while data := file.read1(_BLOCK_BYTES):
        if not num_lines and not rest:
            data = data.removeprefix(b"\xef\xbb\xbf")  # the byte-order mark that spreadsheets write
        if b"\0" in data:
            raise ValueError(f"{name} must be a text file, got a zero byte.")
        rest += data
        end = rest.rfind(b"\n") + 1
        if end:
            yield rest[:end]
            num_lines, rest = num_lines + rest.count(b"\n"), rest[end:]
        if len(rest) > _MOST_LINE_BYTES:
            raise ValueError(f"{name}, line {num_lines + 1}: expected at most {_MOST_LINE_BYTES:,} bytes, got more.")
    if rest:
        yield rest


def open_table(source: str) -> tuple[str, Any]:
    if source != "-":
        return source, open(source, "rb")
    if sys.stdin is None:
        raise ValueError("Standard input is closed: name a file of points.")
    return "stdin", sys.stdin.buffer


def print_answers(chunks: Iterable[Float[np.ndarray, "n columns"]]) -> None:
    for answers in chunks:
        line = ",".join(["%.9g"] * answers.shape[1]) + "\n"
        sys.stdout.write(line * len(answers) % tuple(answers.ravel().tolist()))
        sys.stdout.flush()


def _is_header(line: bytes) -> bool:
    """Return whether a line is a header: each name begins with a letter or ``_`` and is not ``nan`` or ``inf``."""
    names = [name for name in re.split(r"[,;\s\"'#]+", line.decode(errors="replace")) if name]
    begin = all(name[0].isalpha() or name[0] == "_" for name in names)
    return bool(names) and begin and not any(map(numbers_of, names))
