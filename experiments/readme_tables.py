"""Renders the tables of README.md and experiments/README.md from the results files.

A table stands between ``<!-- table:NAME -->`` and ``<!-- /table -->``.

python -m experiments.readme_tables [--check]
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments import _gradient_tables as gradients
from experiments import _other_end_tables as other_end
from experiments import _proof_tables as proof_tables
from experiments import _scale_table as scale_table
from experiments import _short_tables as short
from experiments import _solve_tables as solve_tables
from experiments import _summary_tables as summary_tables
from experiments import families, pair_bounds
from experiments._results import RESULTS, read
from experiments._tables import at_least, markdown, mean_and_largest, nodes_of, num_solved, spread
from experiments.team_sections._plans import FORMS, cell

README = Path(__file__).parent.parent / "README.md"
ALL_RESULTS = Path(__file__).parent / "README.md"
_TABLE = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- /table -->)", re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.readme_tables", description="Render the tables of both README files."
    )
    # Every experiment has a --smoke; here it means the same as --check.
    parser.add_argument(
        "--check", "--smoke", action="store_true", help="change nothing; fail if a table is out of date"
    )
    arguments = parser.parse_args()
    for page in (README, ALL_RESULTS):
        text = page.read_text(encoding="utf-8")
        rendered = render(text)
        if arguments.check and rendered != text:
            sys.exit(f"{page} is out of date: run python -m experiments.readme_tables")
        if rendered != text:
            page.write_text(rendered, encoding="utf-8")


def render(text: str) -> str:
    """The text with every table made anew."""
    return _TABLE.sub(lambda match: match[1] + TABLES[match[2]]() + match[3], text)


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
            cells.append(f"{values[0]:.2g} ({max(values):.2g})")
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
    """Bytes, error and nanoseconds a point of every contender in the maze, and of the joint distance."""
    plane, joint = results["plane"], results["joint"]
    sizes = [str(n) for n in plane["points"] if n > 1]
    rows = [["", "bytes", "mean error", *(f"ns a point of {int(n):,}" for n in sizes)]]
    for contender, times in plane["nanoseconds"].items():
        size = plane["rows"].get(contender)
        cells = [f"{size['bytes']:,}", f"{size['mean']:.2g}"] if size else ["", ""]
        rows.append([contender, *cells, *(f"{times[n][0]:.3g}" for n in sizes)])
    fastest = joint["nanoseconds"]["PLR"][0]
    return markdown(rows, numbers=len(rows[0]) - 1) + (
        f"\nMedians of calls that take turns in one process, {plane['leaves']} leaves; errors over free points. "
        f"In 4-D, {joint['leaves']:,} leaves of the joint distance of two robots: {fastest:.1f} ns a point of "
        f"{int(sizes[-1]):,}.\n"
    )


def accuracy(results: dict[str, Any]) -> str:
    """Mean errors at equal bytes, one row a map and a contender."""
    maps = results["maps"]
    budgets = list(dict.fromkeys(row["budget"] for rows in maps.values() for row in rows))
    table = [["map", "", *(f"{budget:,} bytes" for budget in budgets)]]
    for name, rows in maps.items():
        for contender in dict.fromkeys(row["contender"] for row in rows):
            errors = {row["budget"]: row["free"] for row in rows if row["contender"] == contender}
            table.append([name, contender, *(mean_and_largest(errors.get(budget)) for budget in budgets)])
    note = "Mean error, and in brackets the largest, over the free points that it answers; *: not all of them."
    return markdown(table, numbers=len(budgets)) + f"\n{note}\n"


def oracle(results: dict[str, Any]) -> str:
    """Preparation and queries of the exact oracle beside two libraries."""
    rivals = list(dict.fromkeys(name for each in results["maps"].values() for name in each.get("rivals", ())))
    rows = [
        [
            "map",
            "vertices",
            "prepare s",
            "us a point",
            *(f"{name}: {what}" for name in rivals for what in ("s", "us")),
        ]
    ]
    for name, each in results["maps"].items():
        if "skipped" in each:
            continue
        batched = each["microseconds_a_point"][max(each["microseconds_a_point"], key=int)]
        cells = [
            f"{each['vertices']:,}",
            f"{each['seconds_workspace'] + each['seconds_prepare']:.2g}",
            f"{batched:.2g}",
        ]
        for rival in rivals:
            cells += _rival_cells(results, each["rivals"][rival])
        rows.append([name, *cells])
    return markdown(rows, numbers=len(rows[0]) - 1) + (
        "\nOurs in a batch, theirs one point a call, as they offer it; preparing includes the workspace.\n"
    )


def _rival_cells(results: dict[str, Any], rival: dict[str, Any]) -> list[str]:
    if "skipped" in rival:
        return [f"> {results['rival_limit']:g}" if rival.get("over_limit") else "-", "-"]
    return [f"{rival['prepare']:.2g}", f"{1e6 * rival['query']:,.0f}"]


def table2(results: dict[str, Any], race: dict[str, Any]) -> str:
    """Table II, one row a scene: the paper's seconds, ours, nodes under PLRs and under less, and the best of OMPL."""
    head = ["scene", "paper s", "s", "first path s", "cost / bound", "under PLRs: s", "cost / bound", "nodes"]
    rows = [[*head, "best of OMPL s", "times ours"]]
    runs = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    summaries = {total["scene"]: total["same_cost"] for total in race["summary"]}
    for name in dict.fromkeys(row["scene"] for row in results["rows"]):
        ours, of_plrs = runs[name, "lattice"], runs[name, "PLR"]
        cells = [
            f"{results['paper'].get(name, {}).get('plr', '-')}",
            spread(ours["seconds"], ".3f"),
            spread(ours["first_path_seconds"], ".3f"),
            spread(ours["cost_over_bound"], ".3f"),
            spread(of_plrs["seconds"], ".3f"),
            spread(of_plrs["cost_over_bound"], ".3f"),
            spread(of_plrs["nodes"], ",.0f"),
        ]
        best = summaries.get(name)
        cells += [at_least(best, "best"), at_least(best, "ratio")] if best else ["-", "-"]
        rows.append([name, *cells])
    rows_of_ours, none = (
        [row for row in results["rows"] if row["heuristic"] == "lattice"],
        results["teams_without_heuristic"],
    )
    note = (
        f"\nMedians, and in brackets the worst, of {len(results['seeds'])} perturbed starts and goals; "
        f"{sum(map(num_solved, rows_of_ours))} of {sum(len(row['seed']) for row in rows_of_ours)} were solved. PLRs "
        f"of {results['plr_bytes']:,} bytes a robot, built before the clock starts; under heuristics "
        f"{results['starts_under_heuristics']} of the starts. Without one teams get {none['seconds']:g} s and "
        f"{none['starts']} of the starts. Best of OMPL: seconds to a path that costs no "
        f"more than ours, medians over {len(race['seeds'])} of the starts; >: mostly none within the limit. "
        "Bound: the sum of the robots' exact distances, each alone, without turns.\n"
    )
    return markdown(rows, numbers=len(rows[0]) - 1) + note


def heuristics(results: dict[str, Any]) -> str:
    """Nodes under every heuristic, scene by scene."""
    names = list(dict.fromkeys(row["heuristic"] for row in results["rows"]))
    rows = [["nodes", *names]]
    for scene in dict.fromkeys(row["scene"] for row in results["rows"]):
        rows.append([scene, *(nodes_of(row) for row in results["rows"] if row["scene"] == scene)])
    return markdown(rows, numbers=len(names))


def race(results: dict[str, Any]) -> str:
    """Our seconds and those of OMPL's best planner, to any path, to 5 % more than ours in the end, and to no more."""
    marks = {"first_path": "first path", "cost_5_percent_more": "5 % more", "same_cost": "same cost"}
    rows = [["scene", *(f"{name}: {who}" for name in marks.values() for who in ("ours s", "best s", "times ours"))]]
    for total in results["summary"]:
        parts = [total[mark] for mark in marks]
        cells = [(f"{part['ours']:.3f}", at_least(part, "best"), at_least(part, "ratio")) for part in parts]
        rows.append([total["scene"], *(text for three in cells for text in three)])
    limit = results["limit"]
    return markdown(rows, numbers=9) + (
        f"\nMedians over {len(results['seeds'])} starts, one trial a planner, limits of {limit['least']:g} to "
        f"{limit['largest']:g} s, or {limit['ours']:g} times our seconds if that is more. >: mostly none within the "
        "limit, and the ratio is that of the limit. Same cost: ours to the end of the call.\n"
    )


def teams(results: dict[str, Any]) -> str:
    """Teams: the first path, what the call returns, and what half a minute makes of it."""
    rows = [["team", "robots", "no path", "first path s", "its cost / bound", "s", "cost / bound"]]
    for section in ("first", "half_a_minute", "den520d", "dbcbs_16", "unseen"):
        limit = results[section].get("time_limit")
        for row in results[section]["rows"]:
            name = f"{row['scene']}, improved for {limit:g} s" if limit else row["scene"]
            numbers = [cell(row, key, form) for key, form in FORMS.items()]
            rows.append([name, f"{row['robots']}", f"{row['failures']}/{row['runs']}", *numbers])
    return markdown(rows, numbers=6) + (
        "\nMedians where there are several teams, and in brackets the largest; no path: calls that found none. "
        "Bound: the sum of the robots' exact distances, each alone; of den520d those of points.\n"
    )


def results_of(name: str) -> dict[str, Any]:
    """The results of an experiment; ``ValueError`` if a path among them is not valid."""
    results = read(RESULTS, name)["results"]
    if name in ("table2", "race", "teams", "solve"):
        require_valid(name, results)
    return results


def require_valid(where: str, results: Any) -> None:
    """Refuse results that say of any path that it is not valid."""
    if isinstance(results, dict):
        for key, part in results.items():
            checks = part if isinstance(part, list) else [part]
            if key.endswith("valid") and any(check is False for check in checks):
                raise ValueError(f"{where}.{key}: a path is not valid.")
            require_valid(f"{where}.{key}", part)
    elif isinstance(results, list):
        for i, part in enumerate(results):
            require_valid(f"{where}.{i}", part)


TABLES: dict[str, Callable[[], str]] = {
    "rivals": lambda: short.rivals(results_of("benchmark")["accuracy"]),
    "speed": lambda: short.speed(results_of("benchmark")["query"]),
    "planning": lambda: short.planning(results_of("table2"), results_of("race")),
    "table1": lambda: table1(results_of("table1")),
    "error_curve": lambda: error_curve(results_of("error_curve")),
    "query": lambda: query(results_of("benchmark")["query"]),
    "accuracy": lambda: accuracy(results_of("benchmark")["accuracy"]),
    "oracle": lambda: oracle(results_of("benchmark")["oracle"]),
    "table2": lambda: table2(results_of("table2"), results_of("race")),
    "heuristics": lambda: heuristics(results_of("table2")),
    "race": lambda: race(results_of("race")),
    "teams": lambda: teams(results_of("teams")),
    "continuity": lambda: gradients.continuity(results_of("continuity")),
    "descent": lambda: gradients.descent(results_of("descent")),
    "trajectory": lambda: gradients.trajectory(results_of("trajectory")),
    "placement": lambda: gradients.placement(results_of("placement")),
    "refinement": lambda: gradients.refinement(results_of("refinement")),
    "proofs": lambda: proof_tables.proofs(results_of("proofs"), results_of("benchmark")["oracle"]),
    "proof_speed": lambda: proof_tables.proof_speed(results_of("proofs")),
    "trace": lambda: proof_tables.trace(results_of("trace")),
    "proof_checks": lambda: proof_tables.proof_checks(results_of("proofs")),
    "solve_plane": lambda: solve_tables.plane(results_of("solve")),
    "solve_speed": lambda: solve_tables.section("speed_map", results_of("solve")),
    "solve_bodies": lambda: solve_tables.bodies(results_of("solve")),
    "solve_cars": lambda: solve_tables.section("cars", results_of("solve")),
    "solve_nodes": lambda: solve_tables.section("nodes", results_of("solve")),
    "scale": lambda: scale_table.table(results_of("scale")),
    "families": lambda: families.table(results_of("families")) + "\n",
    "pair_bounds": lambda: markdown(pair_bounds.table(results_of("pair_bounds")), numbers=12) + "\n",
    "summaries": lambda: summary_tables.summaries(results_of("compare_summaries")),
    "pictures": lambda: other_end.pictures(results_of("maps")),
    "wire": lambda: other_end.wire(results_of("wire")),
    "readers": lambda: other_end.readers(results_of("portable")),
    "car": lambda: other_end.car(results_of("portable")),
    "edges": lambda: other_end.edges(results_of("edges")),
}


if __name__ == "__main__":
    main()
