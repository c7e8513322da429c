"""Table II of the paper: BL under heuristics from none to the exact distances, and RRT*, over perturbed variants.

A run has one scene, one variant of its starts and goals, and one heuristic; it ends at the first path, shortened.
Under a heuristic, only best-first search runs, as in the paper. "lattice" is ``bl_plan(problem)`` with all of its
searches and the costs along its lattices. RRT* is OMPL's. It ends at a path that costs no more than BL's first path,
before shortening, under PLRs of points, or at the limit. Before a scene's runs, another variant of it is planned
under each heuristic, so that everything is compiled, and the map is known. "lattice" is the first to plan each
variant, so that nothing is cached for its starts and goals. Heuristics plan the first five variants, RRT* and
searches without a heuristic the first three. BL's nodes, costs and paths depend on the seeds alone, except in runs
that a limit ended; seconds, and all of RRT*, do not. Every path is checked by ``validate``. The race with other
planners is ``experiments.race``.
"""

from typing import Any

from tqdm import tqdm

from experiments._measures import columns
from experiments._planning import (
    BL_ALONE,
    HEURISTICS,
    NONE,
    PLR_BYTES,
    POINT_PLR,
    SCENES,
    SMOKE_BYTES,
    build,
    is_valid,
    plan,
)
from experiments._runner import run
from experiments.baselines.ompl import ompl_plan
from plr_jax import BLOptions, Problem, Solution, exact_lower_bound, scenes

NUM_STARTS = 20  # of bl_plan, "lattice"
NUM_STARTS_UNDER_HEURISTICS = 5
TIME_LIMIT = 60.0  # seconds
NUM_STARTS_FEW = 3  # without a heuristic and by RRT*, which solve few teams: few variants show it
TIME_LIMIT_NONE = 20.0  # without a heuristic
_WARM_UP = 1.0  # seconds of each run before those of a scene
LATTICE, RRT_STAR = "lattice", "RRT*"  # rows that are not of BL under a heuristic

# Seconds and samples; None where the paper has none.
PAPER: dict[str, dict[str, tuple[float, int] | None]] = {
    "single door": {"none": (1.46, 24_864), "plr": (0.08, 3_800), "rrt_star": (0.08, 2_200)},
    "four rooms 2": {"none": None, "plr": (1.08, 991), "rrt_star": (1.63, 1_800)},
    "four rooms 3": {"none": None, "plr": (26.23, 4_514), "rrt_star": (41.02, 17_632)},
    "four rooms 4": {"none": None, "plr": (83.26, 9_407), "rrt_star": (2762.38, 167_216)},
    "cross 2": {"none": None, "plr": (6.75, 936), "rrt_star": (0.52, 402)},
    "cross 3": {"none": None, "plr": (29.96, 2_868), "rrt_star": (94.71, 382)},
    "tangle": {"none": None, "plr": (745.99, 19_959), "rrt_star": None},
}


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names = ["single door", "four rooms 2"] if smoke else list(SCENES)
    results = {
        "plr_bytes": SMOKE_BYTES if smoke else PLR_BYTES,
        "seeds": list(range(seed, seed + (1 if smoke else NUM_STARTS))),
        "starts_under_heuristics": 1 if smoke else NUM_STARTS_UNDER_HEURISTICS,
        "starts_few": 1 if smoke else NUM_STARTS_FEW,
        "seconds_none": 0.3 if smoke else TIME_LIMIT_NONE,
        "seconds_rrt_star": 0.3 if smoke else TIME_LIMIT,
        "paper": PAPER,
    }
    return results | {"rows": [row for name in names for row in measure_scene(name, results)]}


def measure_scene(name: str, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each heuristic; its lists run over the seeds."""
    runs: dict[str, list[dict[str, Any]]] = {heuristic: [] for heuristic in (LATTICE, *HEURISTICS, RRT_STAR)}
    scene, seeds, plr_bytes = SCENES[name](), settings["seeds"], settings["plr_bytes"]
    limits = dict.fromkeys(runs, TIME_LIMIT)
    limits |= {NONE: settings["seconds_none"], RRT_STAR: settings["seconds_rrt_star"]}
    num_runs = {heuristic: int(settings["starts_under_heuristics"]) for heuristic in runs}
    num_runs |= {LATTICE: len(seeds), NONE: settings["starts_few"], RRT_STAR: settings["starts_few"]}
    known = scenes.perturbed(scene, 1000 + seeds[0])
    for heuristic in (LATTICE, *HEURISTICS):
        run_of(known, heuristic, plr_bytes, _WARM_UP)
    for i, seed in enumerate(tqdm(seeds, desc=name, delay=3, disable=None)):
        problem = scenes.perturbed(scene, seed)
        bound = exact_lower_bound(problem)
        for heuristic in (LATTICE, *HEURISTICS):
            if i < num_runs[heuristic]:
                solution, seconds = run_of(problem, heuristic, plr_bytes, limits[heuristic])
                found = {"seed": seed, "seconds": round(seconds, 5), **outcome(problem, solution, bound)}
                runs[heuristic].append(found)
        if i < num_runs[RRT_STAR]:
            target = runs[POINT_PLR][-1]["first_path_cost"]
            runs[RRT_STAR].append({"seed": seed, **rrt_star(problem, bound, seed, limits[RRT_STAR], target)})
    return [
        {"scene": name, "heuristic": heuristic, "time_limit": limits[heuristic], **columns(entries)}
        for heuristic, entries in runs.items()
    ]


def run_of(problem: Problem, heuristic: str, plr_bytes: int, limit: float) -> tuple[Solution, float]:
    """Plan by BL alone under a heuristic, or by ``bl_plan`` with its default options; return solution and seconds."""
    if heuristic == LATTICE:
        return plan(problem, None, BLOptions(time_limit=limit))
    return plan(problem, build(problem, heuristic, plr_bytes), BLOptions(searchers=BL_ALONE, time_limit=limit))


def rrt_star(problem: Problem, bound: float, seed: int, limit: float, target: float | None) -> dict[str, Any]:
    """Plan by RRT*; ``seconds`` is the time to a path of at most the target's cost, or None."""
    solution = ompl_plan(problem, "RRTstar", seed=seed, time_limit=limit, cost_target=target)
    stats, phases = solution.stats, solution.stats.seconds
    is_reached = target is not None and solution.solved and solution.cost <= target
    return {
        **outcome(problem, solution, bound),
        "seconds": round(stats.history[-1][0], 5) if is_reached else None,
        "python_share": round(phases["python"] / phases["plan"], 4),
    }


def outcome(problem: Problem, solution: Solution, bound: float) -> dict[str, Any]:
    """Return whether the path is valid, its costs, and the number of nodes."""
    first_seconds, first_cost = solution.stats.history[0] if solution.solved else (None, None)
    return {
        "valid": is_valid(problem, solution),
        "nodes": solution.stats.num_nodes,
        "lower_bound": round(bound, 6),
        "cost": round(solution.cost, 6) if solution.solved else None,
        "cost_over_bound": round(solution.cost / bound, 5) if solution.solved else None,
        "first_path_seconds": None if first_seconds is None else round(first_seconds, 5),
        "first_path_cost": None if first_cost is None else round(first_cost, 6),
    }


if __name__ == "__main__":
    run("table2", "Table II: BL under every heuristic: nodes, seconds, cost and success.", compute)
