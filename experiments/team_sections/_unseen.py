"""Starts and goals that no call has seen: from call to path, heuristics and all, medians and worst of ten.

Before them, the team is planned on its way back: the map is known, starts and goals are not.
"""

from typing import Any

from experiments._planning import lower_bound
from experiments.team_sections._plans import middle, planned, table_of, two_teams
from plr_jax import bl_plan, scenes

NUM_PROBLEMS = 10


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for size in (2,) if smoke else (2, 3, 4):
        known, scene = two_teams("four_rooms", size, seed)
        bl_plan(known)
        problems = [scenes.perturbed(scene, seed + k) for k in range(1 if smoke else NUM_PROBLEMS)]
        runs = [planned(problem, lower_bound(problem)) for problem in problems]
        rows.append({"scene": "four rooms", **middle(runs)})
    return {"rows": rows}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
