"""Table II of the paper: BL under heuristics from none to the exact distances, over perturbed starts and goals.

A run is of one scene, one variant of its starts and goals, and one heuristic; it ends at the first path, shortened.
Under a heuristic, best-first search goes alone; "lattice" is ``bl_plan(problem)``, both of its searches by the costs
along the lattices. Before a scene's runs, another variant of it is planned under each heuristic, so that everything
is compiled, and the map is known; of each variant, "lattice" comes first, to which its starts and goals are new. The
heuristics get the first few variants. Nodes, costs and paths depend on the seeds alone, but for runs that a limit
ended; seconds do not. Every path is checked by ``validate``. The race with other planners is ``experiments.race``.
"""

from collections.abc import Sequence
from typing import Any

from tqdm import tqdm

from experiments._planning import (
    HEURISTICS,
    LATTICE,
    NONE,
    PLR_BYTES,
    SCENES,
    SMOKE_BYTES,
    Built,
    build,
    is_valid,
    lower_bound,
    plan,
)
from experiments._runner import run
from plr_jax import BLOptions, Problem, Solution, scenes

NUM_STARTS, NUM_STARTS_UNDER_HEURISTICS = 20, 5
TIME_LIMIT = 60.0
# Without a heuristic teams are out of reach: a few starts and seconds show it.
NUM_STARTS_NONE, TIME_LIMIT_NONE = 3, 20.0
SEARCHERS = (("bl",), ("lacam", "bl"))  # under a heuristic, and by the planner's own choice
PHASES = ("lattice", "heuristic", "search", "replan", "shorten")

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
        **{f"seconds_{phase}": round(solution.stats.seconds.get(phase, 0.0), 5) for phase in PHASES},
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


if __name__ == "__main__":
    run("table2", "Table II: BL under every heuristic: nodes, seconds, cost and success.", compute, renew=renew)
