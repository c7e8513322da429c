"""Renders the tables of README.md, experiments/README.md and experiments/paper.md from the results files.

A table stands between ``<!-- table:NAME -->`` and ``<!-- /table -->``.

python -m experiments.readme_tables [--check]
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments import _distance_tables as distances
from experiments import _first_tables as first
from experiments import _gradient_tables as slopes
from experiments import _overview_table as winners
from experiments import _paper_tables as paper
from experiments import _use_tables as uses
from experiments._runner import RESULTS, read

README = Path(__file__).parent.parent / "README.md"
ALL_RESULTS = Path(__file__).parent / "README.md"
PAPER = Path(__file__).parent / "paper.md"
_TABLE = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- /table -->)", re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.readme_tables", description="Render the tables of all pages."
    )
    # Every experiment has a --smoke; here it means the same as --check.
    parser.add_argument(
        "--check", "--smoke", action="store_true", help="change nothing; fail if a table is out of date"
    )
    arguments = parser.parse_args()
    for page in (README, ALL_RESULTS, PAPER):
        text = page.read_text(encoding="utf-8")
        rendered = render(text)
        if arguments.check and rendered != text:
            sys.exit(f"{page} is out of date: run python -m experiments.readme_tables")
        if rendered != text:
            page.write_text(rendered, encoding="utf-8")


def render(text: str) -> str:
    """The text with every table made anew."""
    return _TABLE.sub(lambda match: match[1] + _table(match[2]) + match[3], text)


def _table(name: str) -> str:
    renderer, *sources = TABLES[name]
    table = renderer(*(results_of(*source.split(".")) for source in sources))
    when = min((about["date"], about["commit"]) for source in sources for about in parts_of(*source.split(".")))
    separator = "\n" if table.splitlines()[-1].startswith("|") else ""
    return f"{table}{separator}Measured {when[0]} ({when[1]}).\n"


def parts_of(name: str, section: str | None = None) -> list[dict[str, str]]:
    """When, and at which commit, each part of an experiment was measured that its table is made of."""
    measured = read(RESULTS, name)["measured"]
    return [measured[section]] if section in measured else list(measured.values())


def results_of(name: str, section: str | None = None) -> dict[str, Any]:
    """The results of an experiment, or a section of them; ``ValueError`` if a path among them is not valid."""
    results = read(RESULTS, name)["results"]
    require_valid(name, results)
    return results if section is None else results[section]


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


# Of each table what renders it, and the results that it is made of: a file, or a section of one.
TABLES: dict[str, tuple[Callable[..., str], *tuple[str, ...]]] = {
    "leaves": (distances.leaves, "portable.leaves"),
    "rivals": (distances.rivals, "benchmark.accuracy", "benchmark.query"),
    "planning": (uses.planning, "table2", "race"),
    "overview": (*(winners.overview, "benchmark", "compare_summaries", "costs", "living", "grid_distance", "race"),),
    "paper_goal": (paper.one_goal, "paper_query"),
    "paper_pairs": (paper.all_pairs, "paper_query"),
    "table1": (paper.table1, "table1"),
    "differences": (paper.differences, "table1"),
    "threshold": (paper.threshold, "threshold"),
    "accuracy": (distances.accuracy, "benchmark.accuracy"),
    "memory": (distances.memory, "benchmark.accuracy"),
    "proofs": (distances.proofs, "proofs", "benchmark.oracle"),
    "proof_speed": (distances.proof_speed, "proofs"),
    "proof_checks": (distances.proof_checks, "proofs"),
    "trace": (distances.trace, "trace"),
    "solve_plane": (distances.solve_plane, "solve.plane"),
    "solve_speed": (distances.solve_speed, "solve.speed_map"),
    "volumes": (distances.volumes, "volumes.volumes"),
    "solve_bodies": (distances.solve_bodies, "solve.bodies"),
    "solve_cars": (distances.solve_cars, "solve.cars"),
    "solve_nodes": (distances.solve_nodes, "solve.nodes"),
    "cost_distance": (
        first.cost_distance,
        *(f"cost_distance.{part}" for part in ("errors", "bounds", "mountain", "large")),
    ),
    "rasters": (first.rasters, *(f"rasters.{part}" for part in ("slopes", "degrees", "rivals", "classes"))),
    "summaries": (distances.summaries, "compare_summaries"),
    "pair_bounds": (distances.pair_bounds, "pair_bounds"),
    "fleets": (distances.fleets, "fleets"),
    "shaping": (uses.shaping, "shaping.learning", "shaping.speed"),
    "families": (distances.families, "families"),
    "buildings": (uses.buildings, *(f"buildings.{part}" for part in ("exact", "costs", "bounds", "random"))),
    "building_speed": (uses.building_speed, "buildings.speed"),
    "query": (distances.query, "benchmark.query"),
    "first_answers": (first.fresh, "first_answers.fresh"),
    "small_costs": (
        *(first.small_costs, "first_answers.certified", "first_answers.one_query", "first_answers.pair_queries"),
    ),
    "oracle": (distances.oracle, "benchmark.oracle"),
    "pictures": (uses.pictures, "maps"),
    "readers": (uses.readers, "portable"),
    "small_machines": (uses.small_machines, "portable.small"),
    "modules": (uses.modules, "page"),
    "pages": (uses.pages, "page"),
    "car": (uses.car, "portable"),
    "descent": (uses.descent, "descent"),
    "traced_polygons": (
        slopes.traced_polygons,
        *(f"gradients.{part}" for part in ("exact", "differences", "speed")),
    ),
    "camar_distances": (slopes.camar_distances, "gradients.camar"),
    "gradient_uses": (
        slopes.gradient_uses,
        *(f"gradients.{part}" for part in ("layout", "calibrate", "generate")),
    ),
    "table2": (uses.table2, "table2"),
    "heuristics": (uses.heuristics, "table2"),
    "race": (uses.race, "race"),
    "sba_star": (uses.sba_star, "sba_star"),
    "teams": (uses.teams, "teams"),
    "pedestrians": (uses.pedestrians, "pedestrians", "hard_points"),
    "history": (first.history, "history"),
    "scale": (uses.scale, "scale"),
}


if __name__ == "__main__":
    main()
