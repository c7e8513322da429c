"""Tables of runs as text: medians with their worst cases, and columns that line up, as text or in Markdown."""

import math
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
    return f"{'> ' if total['at_least'] else ''}{rounded_down(total[key])}"


def rounded_down(value: float) -> str:
    """Two digits, rounded down, as lower bounds stay true then."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / scale + 1e-9) * scale:.6g}"


def aligned(rows: list[list[str]], numbers: int) -> str:
    """A table as text, with a line under its head; its last columns hold numbers."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    words = len(widths) - numbers
    lines = [
        "  ".join(cell.ljust(width) if at < words else cell.rjust(width) for at, (cell, width) in enumerate(pairs))
        for pairs in (list(zip(row, widths, strict=True)) for row in rows)
    ]
    return "\n".join(line.rstrip() for line in [lines[0], "-" * len(lines[0]), *lines[1:]]) + "\n"


def markdown(rows: list[list[str]], numbers: int) -> str:
    """A table in Markdown whose last columns hold numbers."""
    rule = ["---"] * (len(rows[0]) - numbers) + ["--:"] * numbers
    return "".join("| " + " | ".join(row) + " |\n" for row in [rows[0], rule, *rows[1:]])
