"""The README's tables on PLRs without an oracle."""

from typing import Any

from experiments._tables import markdown, or_dash
from experiments.solving import _bodies, _cars, _nodes, _plane, _speed_map

_SECTIONS = {"speed_map": _speed_map, "cars": _cars, "nodes": _nodes}
_TESTED = ("configurations", "motions", "boxes")
_PLANE = {
    "mean": "mean error",
    "largest": "largest",
    "unanswered": "no answer",
    "below": "below truth",
    "gap": "upper - lower",
}
_BODIES = {"mean": "mean difference", "largest": "largest", "gap": "upper - lower", "with_upper": "upper bound"}


def section(name: str, results: dict[str, Any]) -> str:
    """The table of a section as it is, and its note."""
    rows, numbers, note = _SECTIONS[name].tabled(results[name])
    return markdown(rows, numbers) + f"\n{note}"


def plane(results: dict[str, Any]) -> str:
    """Sizes, seconds, tests, errors and gaps in the plane."""
    _, _, note = _plane.tabled(results["plane"])
    return _short("map", results["plane"]["rows"], _PLANE | {"without_upper": "no upper"}) + f"\n{note}"


def bodies(results: dict[str, Any]) -> str:
    """The same of the rectangle and the arm, beside their grids."""
    _, _, note = _bodies.tabled(results["bodies"])
    return _short("body", results["bodies"]["rows"], _BODIES) + f"\n{note}"


def _short(what: str, rows: list[dict[str, Any]], shares: dict[str, str]) -> str:
    """A row a method and size, its tests of all kinds together."""
    table = [[what, "method", "cells or samples", "bytes", "s", "tests", *shares.values()]]
    for row in rows:
        size = [f"{row['cells']:,}", f"{row['bytes']:,}", f"{row['seconds']:.2g}"]
        tests = f"{sum(row['tests'][kind] for kind in _TESTED):,}"
        table.append([row[what], row["method"], *size, tests, *(or_dash(row.get(name), ".2%") for name in shares)])
    return markdown(table, numbers=4 + len(shares))
