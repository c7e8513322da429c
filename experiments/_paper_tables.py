"""Tables of experiments/paper.md: query time, Table I, and the threshold rule."""

import re
from typing import Any

from experiments._tables import formatted, markdown
from experiments.table1 import OWN_SCENES


def _queries(results: dict[str, Any], part: str) -> str:
    """Bytes, errors and microseconds of each contender."""
    batches = [str(n) for n in results["batches"]]
    heads = ["us alone", *(f"us in {int(n):,}" for n in batches[1:])]
    rows = [["distance", "query", "bytes in memory", "mean error", "largest", *heads]]
    for row in results[part]:
        times = row["microseconds"] | ({"1": row["microseconds"][batches[1]]} if row["query"] == "C" else {})
        cells = [f"{row['bytes']:,}", f"{row['mean']:.2g}", f"{row['max']:.2g}"]
        cells += [f"{times[n]:{',.0f' if times[n] >= 100 else '.3g'}}" if n in times else "-" for n in batches]
        rows.append([row["method"], row["query"], *cells])
    return markdown(rows, numbers=3 + len(heads))


def one_goal(results: dict[str, Any]) -> str:
    """Queries of distances to one goal, and how many times faster PLRs answer than roadmaps."""
    planes = {row["query"]: row["microseconds"] for row in results["goal"] if row["method"].endswith("planes")}
    roadmap = {row["query"]: row for row in results["goal"] if row["method"] == "PRM*, 10,000 vertices, nearest"}
    alone, batch = ("1", str(results["batches"][-1]))
    times = [f"{row['microseconds'][alone] / planes['NumPy'][alone]:,.0f} times {by}" for by, row in roadmap.items()]
    tree = next(row["microseconds"] for by, row in roadmap.items() if by.startswith("tree"))
    return _queries(results, "goal") + (
        f"\nTimes are medians; errors are of {results['points']:,} free points. C answers point after point, so its "
        "batches are loops. "
        "With 10,000 vertices and the nearest vertex, a query alone takes, beside the planes in NumPy: "
        f"{', '.join(times)}. In batches of {int(batch):,}, the tree takes {tree[batch] / planes['JAX'][batch]:,.0f} "
        f"times the planes in JAX. A tree's bytes are vertices and distances, without its k-d tree.\n"
    )


def all_pairs(results: dict[str, Any]) -> str:
    """Queries of distances between two points."""
    note = f"\nErrors of A\\* are of {results['searched']} pairs, others of {results['points']:,}.\n"
    return _queries(results, "pairs") + note


def _is_own(row: dict[str, Any]) -> bool:
    """Whether a row is one of Table I, and not a variant that explains a difference."""
    name = f"{row['method']}, {row['configuration']}"
    return row["scene"] in OWN_SCENES and not re.search("nearest|clear|samples a cell", name)


def _errors(results: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    table = [
        {"scene": "the paper's maze", "configuration": "paper", **paper, "bytes": f"{paper['bytes']:,}"}
        for paper in results["paper"]
    ]
    for row in rows:
        errors = {error: [entry[error] for entry in row["seeds"]] for error in ("max", "mean")}
        cells = {error: f"{values[0]:.2g} ({max(values):.2g})" for error, values in errors.items()}
        table.append({**row, "bytes": f"{row['seeds'][0]['bytes']:,}", **cells})
    columns = [(name, f"{{{name}}}") for name in ("scene", "method", "configuration", "bytes")]
    num_points, seeds = results["points"], results["seeds"]
    note = f"\n{num_points:,} points. Results of seed {seeds[0]}, and in brackets the worst of {len(seeds)} seeds.\n"
    return formatted(table, *columns, ("max error", "{max}"), ("mean error", "{mean}"), words=3) + note


def table1(results: dict[str, Any]) -> str:
    """The paper's rows of Table I, then ours with the worst of several seeds in brackets."""
    return _errors(results, [row for row in results["rows"] if _is_own(row)])


def differences(results: dict[str, Any]) -> str:
    """The rows of the paper's own configuration under other walls, goals, samples and queries, by method."""
    rows = [row for row in results["rows"] if row["configuration"].startswith(("axes in turn, ", "10,000"))]
    return _errors(results, sorted(rows, key=lambda row: (row["method"].startswith("PRM"), "PRM" in row["method"])))


def threshold(results: dict[str, Any]) -> str:
    """Errors, oracle calls and seconds of the threshold rule and of best-first growth, at equal bytes."""
    return formatted(
        results["rows"],
        *(("map", "{map}"), ("threshold / mean distance", "{threshold:.1%}"), ("split next", "{rule}")),
        *(("bytes", "{bytes:,}"), ("leaves", "{leaves:,}"), ("largest error", "{max:.2g}")),
        *(("mean error", "{mean:.2g}"), ("oracle calls", "{calls:,}"), ("CPU s", "{seconds:.2g}")),
        words=3,
    )
