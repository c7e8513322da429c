"""The first valid path through a door and among crowds, and the path that the call returns, shortened.

Before each team, another one of its size is planned in the same workspace: the map is known, starts and goals are
not.
"""

from typing import Any

from experiments._planning import lower_bound
from experiments.team_sections._plans import planned, table_of, two_teams
from plr_jax import bl_plan

TEAMS = {"door": (20, 50), "crowd": (25, 50, 100)}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, sizes in {"door": (4,), "crowd": (6,)}.items() if smoke else TEAMS.items():
        for size in sizes:
            known, problem = two_teams(name, size, seed)
            bl_plan(known)
            rows.append({"scene": name, **planned(problem, lower_bound(problem))})
    return {"rows": rows}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
