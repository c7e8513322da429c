"""The README's table of files that hold all distances of a map."""

from typing import Any

from experiments._tables import markdown, or_dash
from experiments.summaries._rows import MAX_BYTES, TOLERANCE

_NAMES = {
    "ours": "construct_pairs",
    "product_plr": "PLR over pairs",
    "straight_line": "straight line",
    "full_table": "full table",
    "landmark_tables": "landmarks, tables",
    "landmark_plrs": "landmarks, PLRs",
    "fastmap": "FastMap",
    "embedding": "least stress",
    "network": "network, 16-bit",
    "spanner": "polygon, spanner",
    "polygon": "polygon, exact oracle",
}


def summaries(results: dict[str, Any]) -> str:
    """Bytes, errors and nanoseconds of every rival on every map."""
    head = ["map", "rival", "setting", "bytes", "mean error", "largest", "below", "above", "ns a pair", "s"]
    table = [[*head, "published: mean", "largest"]]
    for part in results.values():
        mark = "" if part["compiled"] else "*"
        for row in part["rows"]:
            table.append([part["map"], _NAMES[part["rival"]], row["setting"], *_cells(row, mark)])
    return markdown(table, numbers=9) + f"\n{_note(results)}\n"


def _cells(row: dict[str, Any], mark: str) -> list[str]:
    scale = row["mean"] / row["share"]
    listed = row.get("published", {})
    return [
        f"{row['bytes']:,}",
        *(f"{row[error] / scale:.2g}" for error in ("mean", "largest")),
        *(f"{row[side]:.1%}" for side in ("below", "above")),
        f"{row['nanoseconds']:,.0f}{mark}",
        f"{row['build']:,.2g}" if row["build"] < 10 else f"{row['build']:,.0f}",
        *(or_dash(listed.get(which), ".2%") for which in ("mean", "max")),
    ]


def _note(results: dict[str, Any]) -> str:
    rows = [row for part in results.values() for row in part["rows"]]
    maps = {part["map"] for part in results.values()}
    limits = ", ".join(f"{name} {count:,}" for name, count in MAX_BYTES.items() if name in maps)
    pairs, slow = (f({row["pairs"] for row in rows}) for f in (max, min))
    return (
        f"At most so many bytes: {limits}. Errors over the mean distance of the same {pairs:,} random free pairs; "
        f"below and above: pairs whose answer is wrong by more than {TOLERANCE:.0e} of it. ns a pair: warm, all "
        f"in one call; *: not compiled as a whole, and judged by the first {slow:,} pairs. s: from workspace to "
        "file, of all settings that were tried. "
        "Published: relative errors of the 160 lengths of the arena."
    )
