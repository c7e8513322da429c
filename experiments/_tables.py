"""Cells and tables: medians with their worst cases, Markdown, and rows of results as text that lines up."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np


def spread(values: list[float | None], form: str) -> str:
    """The median of the values there are, and in brackets the largest."""
    known = [value for value in values if value is not None]
    return f"{np.median(known):{form}} ({max(known):{form}})" if known else "-"


def or_dash(value: float | None, form: str) -> str:
    """A number, or a dash if there is none."""
    return "-" if value is None else f"{value:{form}}"


def num_solved(row: dict[str, Any]) -> int:
    """How many runs of a row of Table II found a path."""
    return sum(cost is not None for cost in row["cost"])


def nodes_of(row: dict[str, Any]) -> str:
    """Median nodes of the runs of a row; ``>`` where most of them ended without a path."""
    more = "> " if 2 * num_solved(row) < len(row["seed"]) else ""
    return f"{more}{np.median(row['nodes']):,.0f}"


def mean_and_largest(errors: dict[str, Any] | None) -> str:
    """Mean error, and in brackets the largest; ``*`` where some points got no answer."""
    if errors is None or errors["mean"] is None:
        return "-"
    return f"{errors['mean']:.2g} ({errors['max']:.2g}){'*' if errors['unanswered'] else ''}"


def at_least(total: dict[str, Any], key: str) -> str:
    """A number of a race's summary; ``>`` where it is that of the limit."""
    return f"{'> ' if total['at_least'] else ''}{two_digits(total[key])}"


def two_digits(value: float) -> str:
    """Return the value rounded down to two significant digits, so that a claim stays true."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / scale + 1e-9) * scale:,.6g}"


def as_text(results: Any, name: str) -> str:
    """All lists of rows among results as tables that line up; what rows hold beyond numbers and words is left out."""
    if isinstance(results, dict):
        return "".join(as_text(part, f"{name}, {key}") for key, part in results.items())
    if not isinstance(results, list) or not all(isinstance(row, dict) for row in results):
        return ""
    rows = [dict(_cells(row)) for row in results]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [columns, *([row.get(key, "-") for key in columns] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ("  ".join(map(str.rjust, line, widths)) for line in lines)
    return "\n".join([f"\n{name}\n", *text, ""])


def _cells(row: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in row.items():
        if isinstance(value, dict):
            yield from _cells(value, f"{prefix}{key}.")
        elif isinstance(value, int | float | str):
            yield f"{prefix}{key}", f"{value:.4g}" if isinstance(value, float) else f"{value}"


def markdown(rows: list[list[str]], numbers: int) -> str:
    """A table in Markdown whose last columns hold numbers."""
    rule = ["---"] * (len(rows[0]) - numbers) + ["--:"] * numbers
    return "".join("| " + " | ".join(row) + " |\n" for row in [rows[0], rule, *rows[1:]])


def formatted(rows: Iterable[dict[str, Any]], *columns: tuple[str, str], words: int = 1) -> str:
    """A table in Markdown: of each column its head and the form of a row's cell; the first columns hold words."""
    cells = [[form.format_map(row) for _, form in columns] for row in rows]
    return markdown([[head for head, _ in columns], *cells], numbers=len(columns) - words)
