"""The first valid path through a door and among crowds, and the path that the call returns, shortened."""

from typing import Any

from experiments._tables import aligned
from experiments.planning._plans import HEAD, alone, cells, planned
from plr_jax import bl_plan, scenes

TEAMS = {"door": (20, 50), "crowd": (25, 50, 100)}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, sizes in {"door": (4,), "crowd": (6,)}.items() if smoke else TEAMS.items():
        for size in sizes:
            problem = getattr(scenes, name)(size)
            bl_plan(scenes.perturbed(problem, 1000 + seed) if name == "door" else scenes.crowd(size, 1000 + seed))
            rows.append({"scene": name, **planned(problem, alone(problem))})
    return {"rows": rows}


def table(results: dict[str, Any]) -> str:
    return aligned([HEAD, *map(cells, results["rows"])], 5)
