"""The first valid path through a door and among crowds, and the path that the call returns, shortened.

Medians of five teams of each size, each planned once, and the largest. Before each, it is planned from its goals to
its starts: the map is known, starts and goals are not.
"""

from typing import Any

from experiments._planning import lower_bound
from experiments.team_sections._plans import middle, planned, table_of, two_teams
from plr_jax import bl_plan

NUM_TEAMS = 5
TEAMS = {"door": (20, 50), "crowd": (25, 50, 100)}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, sizes in {"door": (4,), "crowd": (6,)}.items() if smoke else TEAMS.items():
        for size in sizes:
            runs = []
            for variant in range(1 if smoke else NUM_TEAMS):
                known, problem = two_teams(name, size, seed, variant)
                bl_plan(known)
                runs.append(planned(problem, lower_bound(problem)))
            rows.append({"scene": name, **middle(runs)})
    return {"rows": rows}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
