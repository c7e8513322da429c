"""Sixteen discs of the db-CBS collection, their motions holonomic, medians of five calls.

Before these, the team is planned from its goals to its starts: the map is known, starts and goals are not.
"""

from typing import Any

from experiments._planning import lower_bound
from experiments.team_sections._collections import SKIPPED, collection
from experiments.team_sections._plans import middle, planned, table_of
from plr_jax import Problem, bl_plan, scenes

NUM_RUNS = 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    folder, name = collection("dbcbs"), f"gen_p10_n{4 if smoke else 16}_0"
    if folder is None:
        return {"rows": [], "skipped": SKIPPED}
    problem = scenes.read_dbcbs(folder / f"{name}_unicycle_sphere.yaml")
    bl_plan(Problem(problem.workspace, problem.robots, problem.goals, problem.starts))
    bound = lower_bound(problem)
    runs = [planned(problem, bound) for _ in range(1 if smoke else NUM_RUNS)]
    return {"rows": [{"scene": name, **middle(runs)}]}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
