"""SBA* with each heuristic: whether a better heuristic helps it, which the paper found it does not (Section V).

Every run is of one scene, one heuristic and one seed, ends at its first path or at a number of nodes, and has its
path checked. Numbers of nodes depend on the seed alone; seconds do not.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments._runner import run
from plr_jax import Problem, construct, robot_distance_fns, scenes, validate
from plr_jax._types import HeuristicFn
from plr_jax.planners._heuristics import straight_line, sum_of_distances, zero
from plr_jax.planners._sba_star import sba_star_plan

NUM_SEEDS = 10
MAX_NODES = 20_000
PLR_BYTES = 2_048

SCENES: dict[str, Callable[[], Problem]] = {
    "single_door": scenes.single_door,
    "four_rooms 2": lambda: scenes.four_rooms(2),
    "cross 2": lambda: scenes.cross(2),
}


def heuristics_of(problem: Problem, plr_bytes: int) -> dict[str, HeuristicFn]:
    """The heuristics to compare, from the one that knows nothing to the exact distances of single robots."""
    exact, points = (robot_distance_fns(problem, inflated=inflated) for inflated in (True, False))
    bounds = problem.workspace.bounds

    def plrs(oracles: list[Any]) -> HeuristicFn:
        return sum_of_distances([construct(oracle, bounds, max_bytes=plr_bytes) for oracle in oracles])

    return {
        "zero": zero(),
        "straight line": straight_line(problem),
        "PLR, point robots": plrs(points),
        "PLR": plrs(exact),
        "exact": sum_of_distances(exact),
    }


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_seeds, max_nodes, plr_bytes = (1, 60, 512) if smoke else (NUM_SEEDS, MAX_NODES, PLR_BYTES)
    names = list(SCENES)[:2] if smoke else list(SCENES)
    seeds = range(seed, seed + num_seeds)
    rows = []
    for scene in names:
        problem = SCENES[scene]()
        bound = float(sum_of_distances(robot_distance_fns(problem))(problem.starts[None])[0])
        for name, heuristic in tqdm(heuristics_of(problem, plr_bytes).items(), desc=scene, delay=3, disable=None):
            sba_star_plan(
                problem, heuristic, seed=seed, max_nodes=min(max_nodes, 200)
            )  # compiles what there is to compile
            runs = [solve(problem, heuristic, trial, max_nodes) for trial in seeds]
            rows.append({"scene": scene, "heuristic": name, "lower_bound": bound, "runs": runs})
    return {"max_nodes": max_nodes, "plr_bytes": plr_bytes, "rows": rows}


def solve(problem: Problem, heuristic: HeuristicFn, seed: int, max_nodes: int) -> dict[str, Any]:
    """One run. A path that is not valid is an error of the planner, and ends the experiment."""
    began = time.perf_counter()
    solution = sba_star_plan(problem, heuristic, seed=seed, max_nodes=max_nodes, time_limit=np.inf)
    seconds = time.perf_counter() - began
    if solution.solved and not (report := validate(problem, solution.path)).valid:
        raise RuntimeError(f"SBA* returned a path that is not valid: {report.message}")
    stats = solution.stats
    return {
        "seed": seed,
        "solved": solution.solved,
        "nodes": stats.num_nodes,
        "samples": stats.num_children_scored,
        "cost": solution.cost if solution.solved else None,
        "seconds_indicative": round(seconds, 3),
        "seconds_of_heuristic_indicative": round(stats.seconds["heuristic"], 3),
    }


if __name__ == "__main__":
    run("sba_star", "SBA* with each heuristic: nodes, seconds, cost and success.", compute)
