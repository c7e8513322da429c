"""Cells and tables: medians with their worst cases, Markdown, and rows of results as text that lines up."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from scipy.stats import binomtest


def spread(values: list[float | None], form: str) -> str:
    """The median of the values there are, and in brackets the largest."""
    known = [value for value in values if value is not None]
    return f"{np.median(known):{form}} ({max(known):{form}})" if known else "-"


def or_dash(value: float | None, form: str) -> str:
    """A number, or a dash if there is none."""
    return "-" if value is None else f"{value:{form}}"


def nodes_of(row: dict[str, Any]) -> str:
    """Median nodes of the runs of a row; ``>`` where most of them ended without a path."""
    more = "> " if 2 * sum(map(bool, row["valid"])) < len(row["seed"]) else ""
    return f"{more}{np.median(row['nodes']):,.0f}"


def mean_and_largest(errors: dict[str, Any] | None) -> str:
    """Mean error, and in brackets the largest; ``*`` where some points got no answer."""
    if errors is None or errors["mean"] is None:
        return "-"
    return f"{errors['mean']:.2g} ({errors['max']:.2g}){'*' if errors['unanswered'] else ''}"


def two_digits(value: float) -> str:
    """Return the value rounded down to two significant digits, so that a claim stays true."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / scale + 1e-9) * scale:,.6g}"


def in_time(seconds: list[float | None]) -> str:
    """The median over runs, with the number that found a path if not all did; only this number if half did not."""
    known = [each for each in seconds if each is not None]
    count = f"{len(known)} of {len(seconds)}"
    if 2 * len(known) <= len(seconds):
        return count
    middle = np.median([np.inf if each is None else each for each in seconds])
    return f"{middle:.2g}" + ("" if len(known) == len(seconds) else f" ({count})")


def scenes_by_winner(summaries: list[dict[str, Any]], mark: str, key: str = "sooner") -> dict[str, list[str]]:
    """The scenes of a race in which we, OMPL, or neither was sooner to a mark, by a sign test of the runs at 5 %."""
    scenes: dict[str, list[str]] = {"ours": [], "OMPL": [], "tie": []}
    for total in summaries:
        count, runs = total[mark][key], total["variants"]
        winner = "tie" if binomtest(count, runs).pvalue >= 0.05 else "ours" if 2 * count > runs else "OMPL"
        scenes[winner].append(total["scene"])
    return scenes


def verdict(summaries: list[dict[str, Any]], mark: str, key: str = "sooner") -> str:
    """In how many scenes we were sooner, and the names of the scenes in which we were not."""
    ours, ompl, ties = scenes_by_winner(summaries, mark, key).values()
    parts = [f"ours in {len(ours)} of {len(summaries)} scenes"]
    for who, names in (("OMPL's", ompl), ("neither", ties)):
        parts += [f"{who} in {', '.join(names)}"] if names else []
    return "; ".join(parts)


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
