"""Teams large and small, planned by ``bl_plan`` without a heuristic: how soon, how well, within what limits.

Costs are over the sum of what each robot's shortest path costs if it is alone, as exact oracles say. Before a team is
timed, the team is planned on its way back, so that nothing is imported or compiled on the way, and the map is known;
a section that does otherwise says so. Every section is written as soon as it is measured; ``--only SECTION`` measures
sections again and keeps the others as they are.
"""

import os
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments import _dbcbs
from experiments._planning import plan_and_check, reversed_team
from experiments._runner import Section, run
from plr_jax import BLOptions, DiscRobot, Problem, VisibilityGraph, bl_plan, exact_lower_bound, scenes

# Where the published collections are.

SKIPPED = "skipped: PLR_JAX_DATA names no folder with this collection\n"


def collection(name: str) -> Path | None:
    """The folder of a collection, by its name; None where it is not there."""
    folder = os.environ.get("PLR_JAX_DATA")
    return Path(folder, name) if folder and Path(folder, name).is_dir() else None


# What the sections on teams share: two teams of a kind, a plan that is timed and checked, medians, and a table.

NUMBERS = ("first", "first_ratio", "seconds", "ratio")


def two_teams(scene: str, size: int, seed: int, variant: int = 0) -> tuple[Problem, Problem]:
    """A team to plan before another, and that other one: of one scene and size, in the same workspace.

    Variants of a crowd have starts and goals of their own; those of another scene are perturbed, but for the first.
    The team before goes from the other's goals to its starts.
    """
    if scene == "crowd":
        problem = scenes.crowd(size, seed + variant)
    else:
        problem = getattr(scenes, scene)(size)
        problem = scenes.perturbed(problem, seed + variant) if variant else problem
    return reversed_team(problem), problem


def planned(problem: Problem, bound: float, options: BLOptions | None = None) -> dict[str, Any]:
    """A plan, timed from call to return; its first path and its last are checked. Costs are over a bound."""
    solution, seconds, valid = plan_and_check(problem, None, options or BLOptions())
    history = solution.stats.history
    return {
        "robots": len(problem.robots),
        "runs": 1,
        "failures": int(not solution.solved),
        "seconds": round(seconds, 4),
        "first": round(history[0][0], 4) if history else None,
        "first_ratio": round(history[0][1] / bound, 5) if history else None,
        "ratio": round(solution.cost / bound, 5) if history else None,
        "valid": valid,
        "status": solution.status.name,
        "found_by": solution.stats.found_by,
        "phases": {name: round(seconds, 4) for name, seconds in solution.stats.seconds.items()},
    }


def middle(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of some plans, and the largest: seconds of all, the rest of those with a path; how many have none."""
    checks = [run["valid"] for run in runs if run["valid"] is not None]
    return {
        "robots": runs[0]["robots"],
        "runs": len(runs),
        "failures": sum(run["failures"] for run in runs),
        **{key: _median([run[key] for run in runs]) for key in NUMBERS},
        "largest": {key: max((run[key] for run in runs if run[key] is not None), default=None) for key in NUMBERS},
        "valid": all(checks) if checks else None,
        "status": ", ".join(dict.fromkeys(run["status"] for run in runs)),
    }


def _median(values: list[float | None]) -> float | None:
    """The median of the values there are."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 5) if known else None


# The first valid path through a door and among crowds, and the path that the call returns, shortened.
#
# Medians of five teams of each size, each planned once, and the largest. Before each, it is planned from its goals to
# its starts: the map is known, starts and goals are not.

NUM_TEAMS = 5
FIRST_TEAMS = {"door": (20, 50), "crowd": (25, 50, 100)}


def first(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, sizes in {"door": (4,), "crowd": (6,)}.items() if smoke else FIRST_TEAMS.items():
        for size in sizes:
            runs = []
            for variant in range(1 if smoke else NUM_TEAMS):
                known, problem = two_teams(name, size, seed, variant)
                bl_plan(known)
                runs.append(planned(problem, exact_lower_bound(problem)))
            rows.append({"scene": name, **middle(runs)})
    return {"rows": rows}


# The first valid path of crowds that are larger, one team of each size, and what the rest of a minute makes of it.
#
# Before each, it is planned from its goals to its starts, to the same limit: the map is known, starts and goals are
# not.

CROWDS = (200, 300, 500)
CROWD_LIMIT = 60.0


def crowds(seed: int, smoke: bool) -> dict[str, Any]:
    rows, options = [], BLOptions(time_limit=1.0 if smoke else CROWD_LIMIT)
    for size in (6,) if smoke else CROWDS:
        known, problem = two_teams("crowd", size, seed)
        bl_plan(known, options=options)
        rows.append({"scene": "crowd", **planned(problem, exact_lower_bound(problem), options)})
    return {"rows": rows, "time_limit": options.time_limit}


# What half a minute makes of the paths of large teams.
#
# Before each team, it is planned from its goals to its starts, to the first path: the motions of the map are known on
# the lattices of that plan, and built on finer ones; starts and goals are not known.

LARGE_TEAMS = {"crowd": (50,), "door": (20, 50)}
TIME_LIMIT = 30.0


def half_a_minute(seed: int, smoke: bool) -> dict[str, Any]:
    rows, limit = [], 0.5 if smoke else TIME_LIMIT
    for name, sizes in {"crowd": (6,)}.items() if smoke else LARGE_TEAMS.items():
        for size in sizes:
            known, problem = two_teams(name, size, seed)
            bl_plan(known)
            bound = exact_lower_bound(problem)
            options = BLOptions(cost_factor=1.0, lower_bound=bound * (1 - 1e-6), time_limit=limit)
            rows.append({"scene": name, **planned(problem, bound, options)})
    return {"rows": rows, "time_limit": limit}


# Teams of 5 to 25 discs on a large map, from the Continuous-CBS collection.
#
# Every team has a map of its own, of which nothing is known: seconds are those of ``Problem`` and of ``bl_plan``.
# Before them all, a small team is planned elsewhere, so that everything is imported. Ratios are over the shortest
# paths of points: those of discs are longer.

RADIUS = np.sqrt(2) / 4
SIZES, INSTANCES = (5, 10, 15, 20, 25), (1, 2, 3, 4, 5)


def den520d(seed: int, smoke: bool) -> dict[str, Any]:
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
        alone = [
            np.linalg.norm(goal - start) if graph is None else graph.with_goal(goal)(start[None])[0]
            for start, goal in zip(starts[: max(sizes)], goals[: max(sizes)], strict=True)
        ]
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


def agents_of(instances: Path, instance: int) -> list[Float[np.ndarray, "agents 2"]]:
    """Starts and goals of an instance's agents: the middles of their cells."""
    agents = ElementTree.parse(instances / "den520d" / f"den520d-random-{instance}.xml").getroot()
    return [
        np.array([[float(agent.get(f"{end}_{axis}", "")) + 0.5 for axis in "ji"] for agent in agents])
        for end in ("start", "goal")
    ]


# Sixteen discs of the db-CBS collection, their motions holonomic: as published, and with their ends perturbed.
#
# Before each call, the team is planned from its goals to its starts: the map is known, starts and goals are not.

NUM_PERTURBED = 5


def dbcbs_16(seed: int, smoke: bool) -> dict[str, Any]:
    folder, name = collection("dbcbs"), f"gen_p10_n{4 if smoke else 16}_0"
    if folder is None:
        return {"rows": [], "skipped": SKIPPED}
    problem = _dbcbs.read_problem(folder / f"{name}_unicycle_sphere.yaml")
    variants = [problem, *(scenes.perturbed(problem, seed + k) for k in range(1 if smoke else NUM_PERTURBED))]
    runs = []
    for variant in variants:
        bl_plan(reversed_team(variant))
        runs.append(planned(variant, exact_lower_bound(variant)))
    return {"rows": [{"scene": name, **runs[0]}, {"scene": f"{name}, perturbed", **middle(runs[1:])}]}


# Starts and goals that no call has seen: from call to path, heuristics and all, medians and worst of ten.
#
# Before them, the team is planned on its way back: the map is known, starts and goals are not.

NUM_PROBLEMS = 10


def unseen(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for size in (2,) if smoke else (2, 3, 4):
        known, scene = two_teams("four_rooms", size, seed)
        bl_plan(known)
        problems = [scenes.perturbed(scene, seed + k) for k in range(1 if smoke else NUM_PROBLEMS)]
        runs = [planned(problem, exact_lower_bound(problem)) for problem in problems]
        rows.append({"scene": "four rooms", **middle(runs)})
    return {"rows": rows}


SECTIONS = {
    "first": Section(first),
    "crowds": Section(crowds),
    "half_a_minute": Section(half_a_minute),
    "den520d": Section(den520d),
    "dbcbs_16": Section(dbcbs_16),
    "unseen": Section(unseen),
}

if __name__ == "__main__":
    run("teams", __doc__, SECTIONS)
