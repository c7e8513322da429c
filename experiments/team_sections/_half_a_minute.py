"""What half a minute makes of the paths of large teams.

Before each team, it is planned from its goals to its starts, to the first path: the motions of the map are known on
the lattices of that plan, and built on finer ones; starts and goals are not known.
"""

from typing import Any

from experiments._planning import lower_bound
from experiments.team_sections._plans import planned, table_of, two_teams
from plr_jax import BLOptions, bl_plan

TEAMS = {"crowd": (50,), "door": (20, 50)}
TIME_LIMIT = 30.0


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows, limit = [], 0.5 if smoke else TIME_LIMIT
    for name, sizes in {"crowd": (6,)}.items() if smoke else TEAMS.items():
        for size in sizes:
            known, problem = two_teams(name, size, seed)
            bl_plan(known)
            bound = lower_bound(problem)
            options = BLOptions(cost_factor=1.0, lower_bound=bound * (1 - 1e-6), time_limit=limit)
            rows.append({"scene": name, **planned(problem, bound, options)})
    return {"rows": rows, "time_limit": limit}


def table(results: dict[str, Any]) -> str:
    return table_of(results)
