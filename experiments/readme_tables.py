"""Renders the README's tables from the results files, between ``<!-- table:NAME -->`` and ``<!-- /table -->``.

python -m experiments.readme_tables [--check]
"""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from experiments._results import RESULTS, read

README = Path(__file__).parent.parent / "README.md"
_TABLE = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- /table -->)", re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.readme_tables", description="Render the README's tables."
    )
    # Every experiment has a --smoke; here it means the same as --check.
    parser.add_argument(
        "--check", "--smoke", action="store_true", help="change nothing; fail if a table is out of date"
    )
    arguments = parser.parse_args()
    text = README.read_text(encoding="utf-8")
    rendered = render(text)
    if arguments.check and rendered != text:
        sys.exit("README.md is out of date: run python -m experiments.readme_tables")
    if rendered != text:
        README.write_text(rendered, encoding="utf-8")


def render(text: str) -> str:
    """The text with every table made anew."""
    return _TABLE.sub(lambda match: match[1] + TABLES[match[2]](read(RESULTS, match[2])["results"]) + match[3], text)


def table1(results: dict[str, Any]) -> str:
    """Every row of Table I, ours with the worst of several seeds in brackets."""
    rows = [["scene", "method", "configuration", "bytes", "max error", "mean error"]]
    for paper in results["paper"]:
        rows.append(
            [
                "the paper's maze",
                paper["method"],
                "paper",
                f"{paper['bytes']:,}",
                f"{paper['max']}",
                f"{paper['mean']}",
            ]
        )
    for row in results["rows"]:
        cells = [row["scene"], row["method"], row["configuration"], f"{row['seeds'][0]['bytes']:,}"]
        for error in ("max", "mean"):
            values = [entry[error] for entry in row["seeds"]]
            cells.append(f"{values[0]:.4f} ({max(values):.4f})")
        rows.append(cells)
    note = f"\nOf seed {results['seeds'][0]}; in brackets the worst of {len(results['seeds'])} seeds.\n"
    return markdown(rows, numbers=3) + note


def error_curve(results: dict[str, Any]) -> str:
    """Mean (and largest) error at three budgets."""
    budgets = [budget for budget in (2048, 8192, 32768) if budget in results["budgets"]]
    rows = [["map", "approximation", *(f"{budget:,} bytes" for budget in budgets)]]
    for name, contenders in results["curves"].items():
        for contender, entries in contenders.items():
            at = [entries[results["budgets"].index(budget)] for budget in budgets]
            rows.append([name, contender, *(f"{entry['mean']:.2g} ({entry['max']:.2g})" for entry in at)])
    return markdown(rows, numbers=len(budgets)) + "\nMean error, and in brackets the largest, in workspace units.\n"


def query(results: dict[str, Any]) -> str:
    """Nanoseconds a point."""
    rows = [["", "leaves", "bytes in the file", "bytes in memory", "ns a point"]]
    for name, title in (("plane", "2-D"), ("joint", "4-D")):
        row = results[name]
        for contender, nanoseconds in row["nanoseconds_a_point"].items():
            sizes = (
                [f"{row[key]:,}" for key in ("leaves", "bytes", "resident_bytes")] if contender == "PLR" else [""] * 3
            )
            rows.append([f"{title}: {contender}", *sizes, f"{nanoseconds:.1f}"])
    return markdown(rows, numbers=4)


def markdown(rows: list[list[str]], numbers: int) -> str:
    """A table whose last columns hold numbers."""
    rule = ["---"] * (len(rows[0]) - numbers) + ["--:"] * numbers
    return "".join("| " + " | ".join(row) + " |\n" for row in [rows[0], rule, *rows[1:]])


TABLES = {"table1": table1, "error_curve": error_curve, "query": query}


if __name__ == "__main__":
    main()
