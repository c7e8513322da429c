"""Starts and goals that no call has seen: from call to path, heuristics and all, medians of ten problems.

Before that, another problem of the same map was planned, so that nothing is imported on the way.
"""

from typing import Any

from experiments._tables import aligned
from experiments.planning._plans import HEAD, alone, cells, middle, planned
from plr_jax import bl_plan, scenes

NUM_PROBLEMS = 10


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for size in (2,) if smoke else (2, 3, 4):
        scene = scenes.four_rooms(size)
        bl_plan(scenes.perturbed(scene, 1000 + seed))
        problems = [scenes.perturbed(scene, seed + k) for k in range(1 if smoke else NUM_PROBLEMS)]
        rows.append({"scene": "four rooms", **middle([planned(problem, alone(problem)) for problem in problems])})
    return {"rows": rows, "problems": NUM_PROBLEMS}


def table(results: dict[str, Any]) -> str:
    return aligned([HEAD, *map(cells, results["rows"])], 5)
