"""Teams of 5 to 25 discs on a large map, from the Continuous-CBS collection.

Ratios are over the shortest paths of points: those of discs are longer.
"""

import time
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.planning._collections import SKIPPED, collections
from experiments.planning._plans import HEAD, alone, cells, planned
from plr_jax import DiscRobot, Problem, scenes
from plr_jax.planners._solution import straight_line_bound

RADIUS = np.sqrt(2) / 4
SIZES, INSTANCES = (5, 10, 15, 20, 25), (1, 2, 3, 4, 5)


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    folder = collections("ccbs")
    if folder is None:
        return {"rows": [], "skipped": SKIPPED}
    workspace, rows = scenes.read_map(folder / "movingai" / "dao" / "den520d.map"), []
    for instance, size in [(1, 2)] if smoke else [(i, k) for i in INSTANCES for k in SIZES]:
        root = ElementTree.parse(folder / "ccbs" / "den520d" / f"den520d-random-{instance}.xml").getroot()
        starts, goals = (
            np.array([[float(agent.get(f"{end}_{axis}", "")) + 0.5 for axis in "ji"] for agent in root])
            for end in ("start", "goal")
        )
        began = time.perf_counter()
        problem = Problem(workspace, [DiscRobot(RADIUS)] * size, starts[:size], goals[:size])
        prepared = time.perf_counter() - began
        bound = straight_line_bound(problem) if smoke else alone(problem, inflated=False)
        row = {"scene": f"den520d {instance}", "problem_seconds": round(prepared, 3), **planned(problem, bound)}
        rows.append(row)
    return {"rows": rows}


def table(results: dict[str, Any]) -> str:
    return aligned([HEAD, *map(cells, results["rows"])], 5) + results.get("skipped", "")
