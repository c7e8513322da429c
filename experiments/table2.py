"""Table II of the paper: BL under heuristics from none to the exact distances, over perturbed starts and goals.

A run is of one scene, one variant of its starts and goals, and one heuristic; it ends at the first path, shortened.
Under a heuristic, best-first search goes alone; "lattice" is ``bl_plan(problem)``, both of its searches by the costs
along the lattices. Before a scene's runs, another variant of it is planned under each heuristic, so that everything
is compiled, and the map is known; of each variant, "lattice" comes first, to which its starts and goals are new. The
heuristics get the first few variants. Nodes, costs and paths depend on the seeds alone, but for runs that a limit
ended; seconds do not. Every path is checked by ``validate``. The race with other planners is ``experiments.race``.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments._cold import cold_seconds
from experiments._planning import (
    EXACT,
    HEURISTICS,
    LATTICE,
    NONE,
    PLR,
    PLR_BYTES,
    SCENES,
    SMOKE_BYTES,
    Built,
    build,
    is_valid,
    lower_bound,
    plan,
)
from experiments._results import run
from experiments._tables import aligned, nodes_of, num_solved, spread
from plr_jax import BLOptions, Problem, Solution, scenes

NUM_STARTS, NUM_STARTS_UNDER_HEURISTICS = 20, 5
TIME_LIMIT = 60.0
# Without a heuristic teams are out of reach: a few starts and seconds show it.
NUM_STARTS_NONE, TIME_LIMIT_NONE = 3, 20.0
SEARCHERS = (("bl",), ("lacam", "bl"))  # under a heuristic, and by the planner's own choice
PHASES = ("lattice", "heuristic", "search", "replan", "shorten")
RATE_EXPANSIONS, RATE_RUNS, JOINT_CHILDREN = 2_000, 5, 9**4

PAPER: dict[str, dict[str, Any]] = {
    "single door": {"none": 1.46, "plr": 0.08, "rrt_star": 0.08, "nodes_none": 24_864, "nodes_plr": 3_800},
    "four rooms 2": {"none": None, "plr": 1.08, "rrt_star": 1.63, "nodes_none": None, "nodes_plr": 991},
    "four rooms 3": {"none": None, "plr": 26.23, "rrt_star": 41.02, "nodes_none": None, "nodes_plr": 4_514},
    "four rooms 4": {"none": None, "plr": 83.26, "rrt_star": 2762.38, "nodes_none": None, "nodes_plr": 9_407},
    "cross 2": {"none": None, "plr": 6.75, "rrt_star": 0.52, "nodes_none": None, "nodes_plr": 936},
    "cross 3": {"none": None, "plr": 29.96, "rrt_star": 94.71, "nodes_none": None, "nodes_plr": 2_868},
    "tangle": {"none": None, "plr": 745.99, "rrt_star": None, "nodes_none": None, "nodes_plr": 19_959},
}


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names = ["single door", "four rooms 2"] if smoke else list(SCENES)
    seeds = list(range(seed, seed + (1 if smoke else NUM_STARTS)))
    seeds_none, limit_none = (seeds[:1], 0.3) if smoke else (seeds[:NUM_STARTS_NONE], TIME_LIMIT_NONE)
    plr_bytes = SMOKE_BYTES if smoke else PLR_BYTES
    return {
        "plr_bytes": plr_bytes,
        "seeds": seeds,
        "starts_under_heuristics": min(len(seeds), NUM_STARTS_UNDER_HEURISTICS),
        "teams_without_heuristic": {"starts": len(seeds_none), "seconds": limit_none},
        "paper": PAPER,
        "rows": [row for name in names for row in measure_scene(name, seeds, seeds_none, limit_none, plr_bytes)],
        "cold": [
            {"scene": name, "heuristic": heuristic, **cold_seconds(name, heuristic)}
            for name in tqdm(names[:1] if smoke else names, desc="cold", delay=3, disable=None)
            for heuristic in ((LATTICE,) if smoke else (LATTICE, PLR, EXACT))
        ],
        "children_rate": children_rates(20 if smoke else RATE_EXPANSIONS, 1 if smoke else RATE_RUNS, plr_bytes),
        "dbcbs": dbcbs(smoke),
    }


def renew(results: dict[str, Any], name: str) -> dict[str, Any]:
    """The rows of one scene measured again."""
    if name not in SCENES:
        raise SystemExit(f"--only must be one of {', '.join(SCENES)}, got {name!r}.")
    none = results["teams_without_heuristic"]
    fresh = measure_scene(name, results["seeds"], results["seeds"][: none["starts"]], none["seconds"], PLR_BYTES)
    rows = {(row["scene"], row["heuristic"]): row for row in [*results["rows"], *fresh]}
    return {**results, "rows": list(rows.values())}


def measure_scene(
    name: str, seeds: Sequence[int], seeds_none: Sequence[int], limit_none: float, plr_bytes: int
) -> list[dict[str, Any]]:
    """One row a heuristic: what is common to its runs, and a list over the seeds of everything measured."""
    runs: dict[str, list[dict[str, Any]]] = {heuristic: [] for heuristic in (LATTICE, *HEURISTICS)}
    scene = SCENES[name]()
    alone = len(scene.robots) == 1
    limits = {heuristic: limit_none if heuristic == NONE and not alone else TIME_LIMIT for heuristic in runs}
    known = scenes.perturbed(scene, 1000 + seeds[0])
    for heuristic in runs:
        options = BLOptions(searchers=SEARCHERS[heuristic == LATTICE], time_limit=1.0)
        plan(known, build(known, heuristic, plr_bytes).heuristic, options)
    for seed in tqdm(seeds, desc=name, delay=3, disable=None):
        problem = scenes.perturbed(scene, seed)
        bound = lower_bound(problem)
        for heuristic in runs if seed in seeds[:NUM_STARTS_UNDER_HEURISTICS] else (LATTICE,):
            if heuristic != NONE or alone or seed in seeds_none:
                options = BLOptions(searchers=SEARCHERS[heuristic == LATTICE], time_limit=limits[heuristic])
                measured = measure(problem, build(problem, heuristic, plr_bytes), bound, options)
                runs[heuristic].append({"seed": seed, **measured})
    return [
        {
            "scene": name,
            "heuristic": heuristic,
            "time_limit": limits[heuristic],
            **{key: [entry[key] for entry in entries] for key in entries[0]},
        }
        for heuristic, entries in runs.items()
    ]


def measure(problem: Problem, built: Built, bound: float, options: BLOptions) -> dict[str, Any]:
    """A run."""
    solution, seconds = plan(problem, built.heuristic, options)
    return {
        **outcome(problem, solution, bound),
        "seconds": round(seconds, 5),
        "seconds_oracle": round(built.oracle_seconds, 4),
        "seconds_plr": round(built.plr_seconds, 4),
        **{f"seconds_{phase}": round(value, 5) for phase, value in with_phases(solution).items()},
    }


def outcome(problem: Problem, solution: Solution, bound: float) -> dict[str, Any]:
    """What a run found, and how much it did for it."""
    stats = solution.stats
    first_seconds, first_cost = stats.history[0] if stats.history else (None, None)
    return {
        "status": solution.status.name,
        "found_by": stats.found_by,
        "valid": is_valid(problem, solution),
        "nodes": stats.num_nodes,
        "expansions": stats.num_expansions,
        "children_scored": stats.num_children_scored,
        "children_valid": stats.num_children_valid,
        "lower_bound": round(bound, 6),
        "cost": round(solution.cost, 6) if solution.solved else None,
        "cost_over_bound": round(solution.cost / bound, 5) if solution.solved else None,
        "first_path_seconds": None if first_seconds is None else round(first_seconds, 5),
        "first_path_cost": None if first_cost is None else round(first_cost, 6),
    }


def with_phases(solution: Solution) -> dict[str, float]:
    """Seconds of every phase of BL, 0 of one that was not reached."""
    return {phase: solution.stats.seconds.get(phase, 0.0) for phase in PHASES}


def children_rates(num_expansions: int, num_runs: int, plr_bytes: int) -> list[dict[str, Any]]:
    """Joint children a second of the search's own seconds: 4 discs of 9 primitives, ``9**4`` joint children a node.

    Children grow robot by robot: 9, 81, 729 and 6,561 of them get a score and are tested against the robots before.
    All four numbers are counted as scored; beside them stand those of all four robots alone. Valid are those of all
    four robots that collide with nothing, counted before the best are kept. A node whose kept children are used up
    is expanded again, and its children then count again. Choosing nodes and children, claiming cells and all else
    that a search does is in its seconds; building lattices and shortening the path is not.
    """
    problem = SCENES["four rooms 4"]()
    heuristic = build(problem, PLR, plr_bytes).heuristic
    # Weight 1 searches longer; it ends at a path or at the limit.
    longer = BLOptions(searchers=("bl",), heuristic_weight=1.0, max_expansions=num_expansions)
    searches = {
        "to the first path": BLOptions(searchers=("bl",)),
        "weight 1": longer,
    }
    rows = []
    for name, options in searches.items():
        plan(problem, heuristic, options)
        all_stats = [plan(problem, heuristic, options)[0].stats for _ in range(num_runs)]
        seconds, stats = float(np.median([each.seconds["search"] for each in all_stats])), all_stats[0]
        rows.append(
            {
                "search": name,
                "expansions": stats.num_expansions,
                "children_scored": stats.num_children_scored,
                "whole_children_scored": stats.num_expansions * JOINT_CHILDREN,
                "children_valid": stats.num_children_valid,
                "seconds_search": round(seconds, 5),
                "scored_a_second": round(stats.num_children_scored / seconds),
                "whole_scored_a_second": round(stats.num_expansions * JOINT_CHILDREN / seconds),
                "valid_a_second": round(stats.num_children_valid / seconds),
            }
        )
    return rows


def dbcbs(smoke: bool) -> list[dict[str, Any]] | None:
    """The problems of db-CBS, their robots holonomic; None where their folder is not there."""
    folder = os.environ.get("PLR_JAX_DATA")
    files = sorted((Path(folder) / "dbcbs").glob("*.yaml")) if folder else []
    if not files:
        print("The problems of db-CBS are left out: PLR_JAX_DATA names no folder that holds them.")
        return None
    return [dbcbs_row(file) for file in tqdm(files[:1] if smoke else files, desc="db-CBS", delay=3, disable=None)]


def dbcbs_row(file: Path) -> dict[str, Any]:
    """One problem of db-CBS as the planner takes it, or why it is refused."""
    try:
        problem = scenes.read_dbcbs(file)
    except ValueError as refusal:
        return {"problem": file.stem, "refused": str(refusal).removeprefix(f"{file}: ")}
    measured = measure(problem, build(problem, LATTICE), lower_bound(problem), BLOptions(time_limit=TIME_LIMIT))
    return {"problem": file.stem, "robots": len(problem.robots), **measured}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """The tables as text."""
    tables = {
        "BL over perturbed starts and goals: medians (worst)": main_table(results),
        "Nodes: medians over perturbed starts and goals": nodes_table(results),
        "Seconds of the first plan in a new process": cold_table(results["cold"]),
        "Joint children of 4 discs in four rooms, millions a second of search": rate_table(results["children_rate"]),
        "Problems of db-CBS, holonomic": dbcbs_table(results["dbcbs"]) if results["dbcbs"] else "left out\n",
    }
    text = "\n".join(f"{title}\n\n{table}" for title, table in tables.items())
    num_paths, num_invalid = count_paths(results)
    text += f"\n{num_paths} paths put through validate, {num_invalid} of them not valid.\n"
    path = output / "table2.txt"
    path.write_text(text, encoding="utf-8")
    print(text)
    return [path]


def main_table(results: dict[str, Any]) -> str:
    head = ["scene", "heuristic", "solved", "nodes", "s", "first path s", "cost / bound", "PLR s", "paper s"]
    rows = [head]
    for row in results["rows"]:
        paper = results["paper"].get(row["scene"], {})
        published = paper.get({NONE: "none", PLR: "plr"}.get(row["heuristic"], ""))
        rows.append(
            [
                row["scene"],
                row["heuristic"],
                f"{num_solved(row)}/{len(row['seed'])}",
                spread(row["nodes"], ",.0f"),
                spread(row["seconds"], ".3f"),
                spread(row["first_path_seconds"], ".3f"),
                spread(row["cost_over_bound"], ".3f"),
                spread(row["seconds_plr"], ".2f"),
                f"{published}" if published else "-",
            ]
        )
    return aligned(rows, numbers=7)


def nodes_table(results: dict[str, Any]) -> str:
    """Nodes of each heuristic; ``>`` where most runs ended without a path."""
    rows = [["scene", *HEURISTICS]]
    for name in dict.fromkeys(row["scene"] for row in results["rows"]):
        found = {row["heuristic"]: nodes_of(row) for row in results["rows"] if row["scene"] == name}
        rows.append([name, *(found[heuristic] for heuristic in HEURISTICS)])
    return aligned(rows, numbers=len(HEURISTICS))


def cold_table(entries: list[dict[str, Any]]) -> str:
    phases = ["import", "oracle", "plr", "plan", "process"]
    rows = [["scene", "heuristic", *phases]]
    rows += [[entry["scene"], entry["heuristic"], *(f"{entry[phase]:.2f}" for phase in phases)] for entry in entries]
    return aligned(rows, numbers=len(phases))


def rate_table(entries: list[dict[str, Any]]) -> str:
    rates = {"scored": "scored_a_second", "of all 4 robots": "whole_scored_a_second", "found valid": "valid_a_second"}
    rows = [["search", "expansions", *rates]]
    for entry in entries:
        cells = [f"{entry[key] / 1e6:.1f}" for key in rates.values()]
        rows.append([entry["search"], f"{entry['expansions']:,}", *cells])
    return aligned(rows, numbers=4)


def dbcbs_table(entries: list[dict[str, Any]]) -> str:
    rows = [["problem", "robots", "nodes", "s", "cost / bound", "found by", "path"]]
    for entry in entries:
        if "refused" in entry:
            rows.append([entry["problem"], *["-"] * 5, "refused"])
            continue
        path = {None: entry["status"], True: "valid", False: "NOT VALID"}[entry["valid"]]
        ratio = f"{entry['cost_over_bound']:.3f}" if entry["cost_over_bound"] else "-"
        numbers = [f"{entry['nodes']:,}", f"{entry['seconds']:.3f}", ratio]
        rows.append([entry["problem"], f"{entry['robots']}", *numbers, entry["found_by"], path])
    refusals = "".join(f"{entry['problem']}: {entry['refused']}\n" for entry in entries if "refused" in entry)
    return aligned([[*row[:1], *row[5:], *row[1:5]] for row in rows], numbers=4) + refusals


def count_paths(results: dict[str, Any]) -> tuple[int, int]:
    """Paths that were checked, and those that were not valid."""
    checks = [valid for row in results["rows"] for valid in row["valid"]]
    checks += [entry["valid"] for entry in [*results["cold"], *(results["dbcbs"] or [])] if "valid" in entry]
    return sum(valid is not None for valid in checks), sum(valid is False for valid in checks)


if __name__ == "__main__":
    run("table2", "Table II: BL under every heuristic: nodes, seconds, cost and success.", compute, draw, renew)
