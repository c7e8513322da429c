"""Sixteen discs of the db-CBS collection, their motions holonomic: as published, and with their ends perturbed.

Before each call, the team is planned from its goals to its starts: the map is known, starts and goals are not.
"""

from typing import Any

from experiments._planning import lower_bound, reversed_team
from experiments.team_sections._collections import SKIPPED, collection
from experiments.team_sections._plans import middle, planned, table_of
from plr_jax import bl_plan, scenes

NUM_PERTURBED = 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    folder, name = collection("dbcbs"), f"gen_p10_n{4 if smoke else 16}_0"
    if folder is None:
        return {"rows": [], "skipped": SKIPPED}
    problem = scenes.read_dbcbs(folder / f"{name}_unicycle_sphere.yaml")
    variants = [problem, *(scenes.perturbed(problem, seed + k) for k in range(1 if smoke else NUM_PERTURBED))]
    runs = []
    for variant in variants:
        bl_plan(reversed_team(variant))
        runs.append(planned(variant, lower_bound(variant)))
    return {"rows": [{"scene": name, **runs[0]}, {"scene": f"{name}, perturbed", **middle(runs[1:])}]}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
