"""Teams of 5 to 25 discs on a large map, from the Continuous-CBS collection.

Before them all, a small team of others of the collection's agents is planned: the map is known, starts and goals are
not. Ratios are over the shortest paths of points: those of discs are longer.
"""

import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._planning import lower_bound
from experiments.team_sections._collections import SKIPPED, collection
from experiments.team_sections._plans import planned, table_of
from plr_jax import DiscRobot, Problem, bl_plan, scenes, straight_line

RADIUS = np.sqrt(2) / 4
SIZES, INSTANCES = (5, 10, 15, 20, 25), (1, 2, 3, 4, 5)
KNOWN_SIZE = 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    instances, maps = collection("ccbs"), collection("movingai")
    if instances is None or maps is None:
        return {"rows": [], "skipped": SKIPPED}
    workspace, rows = scenes.read_map(maps / "dao" / "den520d.map"), []
    for instance, sizes in {1: (2,)}.items() if smoke else dict.fromkeys(INSTANCES, SIZES).items():
        starts, goals = ends_in(instances / "den520d" / f"den520d-random-{instance}.xml")
        if not rows:
            size = KNOWN_SIZE
            bl_plan(Problem(workspace, [DiscRobot(RADIUS)] * size, starts[-size:], goals[-size:]))
        for size in sizes:
            began = time.perf_counter()
            problem = Problem(workspace, [DiscRobot(RADIUS)] * size, starts[:size], goals[:size])
            prepared = round(time.perf_counter() - began, 3)
            straight = float(straight_line(problem)(problem.starts[None])[0])
            bound = straight if smoke else lower_bound(problem, inflated=False)
            row = {"scene": f"den520d {instance}", "problem_seconds": prepared, **planned(problem, bound)}
            rows.append(row)
    return {"rows": rows}


def ends_in(file: Path) -> list[Float[np.ndarray, "agents 2"]]:
    """Starts and goals of an instance's agents: the middles of their cells."""
    agents = ElementTree.parse(file).getroot()
    return [
        np.array([[float(agent.get(f"{end}_{axis}", "")) + 0.5 for axis in "ji"] for agent in agents])
        for end in ("start", "goal")
    ]


def table(results: dict[str, Any]) -> str:
    return table_of(results)
