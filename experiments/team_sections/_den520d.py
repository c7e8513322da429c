"""Teams of 5 to 25 discs on a large map, from the Continuous-CBS collection.

Every team has a map of its own, of which nothing is known: seconds are those of ``Problem`` and of ``bl_plan``.
Before them all, a small team is planned elsewhere, so that everything is imported. Ratios are over the shortest paths
of points: those of discs are longer.
"""

import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments.team_sections._collections import SKIPPED, collection
from experiments.team_sections._plans import planned, table_of
from plr_jax import DiscRobot, Problem, VisibilityGraph, bl_plan, scenes

RADIUS = np.sqrt(2) / 4
SIZES, INSTANCES = (5, 10, 15, 20, 25), (1, 2, 3, 4, 5)


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    instances, maps = collection("ccbs"), collection("movingai")
    if instances is None or maps is None:
        return {"rows": [], "skipped": SKIPPED}
    file, rows = maps / "dao" / "den520d.map", []
    bl_plan(scenes.four_rooms(2))
    # What the corners see is found once.
    workspace = scenes.read_map(file)
    graph = None if smoke else VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
    for instance, sizes in {1: (2,)}.items() if smoke else dict.fromkeys(INSTANCES, SIZES).items():
        starts, goals = agents_of(instances, instance)
        alone = distances(graph, starts[: max(sizes)], goals[: max(sizes)])
        for size in sizes:
            workspace = scenes.read_map(file)
            began = time.perf_counter()
            problem = Problem(workspace, [DiscRobot(RADIUS)] * size, starts[:size], goals[:size])
            before = time.perf_counter() - began
            measured = planned(problem, float(np.sum(alone[:size])))
            for key in ("seconds", "first"):
                if measured[key] is not None:
                    measured[key] = round(measured[key] + before, 4)
            rows.append({"scene": f"den520d {instance}", "problem_seconds": round(before, 4), **measured})
    return {"rows": rows}


def distances(
    graph: VisibilityGraph | None, starts: Float[np.ndarray, "n 2"], goals: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n"]:
    """How far each agent has to go, straight if there is no graph."""
    if graph is None:
        return np.linalg.norm(goals - starts, axis=1)
    return np.array([graph.with_goal(goal)(start[None])[0] for start, goal in zip(starts, goals, strict=True)])


def agents_of(instances: Path, instance: int) -> list[Float[np.ndarray, "agents 2"]]:
    """Starts and goals of an instance's agents: the middles of their cells."""
    agents = ElementTree.parse(instances / "den520d" / f"den520d-random-{instance}.xml").getroot()
    return [
        np.array([[float(agent.get(f"{end}_{axis}", "")) + 0.5 for axis in "ji"] for agent in agents])
        for end in ("start", "goal")
    ]


def table(results: dict[str, Any]) -> str:
    rows = results["rows"]
    solved = [row for row in rows if row["valid"]]
    worst = [f"{max((row[key] for row in solved), default=0.0):.4g}" for key in ("seconds", "ratio")]
    return (
        table_of(results) + f"{len(solved)} of {len(rows)} solved, in {worst[0]} s and at {worst[1]} at the most.\n"
    )
