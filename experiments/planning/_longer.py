"""What half a minute makes of the paths of large teams."""

from typing import Any

from experiments._tables import aligned
from experiments.planning._plans import HEAD, alone, cells, planned
from plr_jax import BLOptions, scenes

TEAMS = {"crowd": (50,), "door": (20, 50)}
TIME_LIMIT = 30.0


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows, limit = [], 0.5 if smoke else TIME_LIMIT
    for name, sizes in {"crowd": (6,)}.items() if smoke else TEAMS.items():
        for size in sizes:
            problem = getattr(scenes, name)(size)
            bound = alone(problem)
            options = BLOptions(cost_factor=1.0, lower_bound=bound * (1 - 1e-6), time_limit=limit)
            rows.append({"scene": name, **planned(problem, bound, options)})
    return {"rows": rows, "time_limit": limit}


def table(results: dict[str, Any]) -> str:
    return aligned([HEAD, *map(cells, results["rows"])], 5)
