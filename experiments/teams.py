"""Teams large and small, planned by ``bl_plan`` without a heuristic: how soon, and how much longer than alone.

- first: the first valid path through a door and among crowds, and the path that the call returns, shortened.
- longer: what a longer search makes of them.
- den520d: teams of 5 to 25 discs on a large map, from the Continuous-CBS collection.
- unseen: starts and goals that no call has seen, heuristics and all, from call to path.

Costs are over the sum of what each robot's shortest path costs if it is alone, as exact oracles say (on den520d, of
points: those of discs are longer). Before a team is timed, another one of its kind is planned, so that nothing is
compiled or imported on the way, and nothing of the team is known.
"""

import os
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from experiments._sections import Section, run_sections
from experiments._tables import aligned
from plr_jax import BLOptions, DiscRobot, Problem, Solution, bl_plan, robot_distance_fns, scenes, validate
from plr_jax.planners._solution import straight_line_bound

_TEAMS = {"door": (20, 50), "crowd": (25, 50, 100)}
_LONG_TEAMS = {"crowd": (50,), "door": (20, 50)}
_LONG = 30.0
_RADIUS = np.sqrt(2) / 4
_SIZES, _INSTANCES = (5, 10, 15, 20, 25), (1, 2, 3, 4, 5)
_UNSEEN = 10


def alone(problem: Problem, inflated: bool = True) -> float:
    """What the robots' shortest paths cost if each is alone."""
    fns = robot_distance_fns(problem, inflated=inflated)
    starts = problem.starts[:, None, :2]
    return float(sum(fn(start)[0] for fn, start in zip(fns, starts, strict=True)))


def planned(problem: Problem, bound: float, options: BLOptions | None = None) -> dict[str, Any]:
    """A plan, timed from call to return and checked."""
    began = time.perf_counter()
    solution = bl_plan(problem, options=options or BLOptions())
    seconds = time.perf_counter() - began
    return {"seconds": round(seconds, 4), **row_of(problem, solution, bound)}


def row_of(problem: Problem, solution: Solution, bound: float) -> dict[str, Any]:
    history = solution.stats.history
    return {
        "robots": len(problem.robots),
        "first": round(history[0][0], 4) if history else None,
        "first_ratio": round(history[0][1] / bound, 5) if history else None,
        "ratio": round(solution.cost / bound, 5) if history else None,
        "valid": validate(problem, solution.path).valid if history else None,
        "status": solution.status.name,
        "found_by": solution.stats.found_by,
        "phases": {name: round(seconds, 4) for name, seconds in solution.stats.seconds.items()},
    }


def first(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, sizes in {"door": (4,), "crowd": (6,)}.items() if smoke else _TEAMS.items():
        for size in sizes:
            problem = getattr(scenes, name)(size)
            bl_plan(scenes.perturbed(problem, 1000 + seed) if name == "door" else scenes.crowd(size, 1000 + seed))
            rows.append({"scene": name, **planned(problem, alone(problem))})
            print(line(rows[-1]), flush=True)
    return {"rows": rows}


def longer(seed: int, smoke: bool) -> dict[str, Any]:
    rows, limit = [], 0.5 if smoke else _LONG
    for name, sizes in {"crowd": (6,)}.items() if smoke else _LONG_TEAMS.items():
        for size in sizes:
            problem = getattr(scenes, name)(size)
            bound = alone(problem)
            options = BLOptions(cost_factor=1.0, lower_bound=bound * (1 - 1e-6), time_limit=limit)
            rows.append({"scene": name, **planned(problem, bound, options)})
            print(line(rows[-1]), flush=True)
    return {"rows": rows, "time_limit": limit}


def den520d(seed: int, smoke: bool) -> dict[str, Any]:
    folder = Path(os.environ.get("PLR_JAX_DATA", ""))
    if "PLR_JAX_DATA" not in os.environ or not (folder / "ccbs").is_dir():
        return {"rows": [], "skipped": "skipped: PLR_JAX_DATA names no folder with ccbs"}
    workspace, rows = scenes.read_map(folder / "movingai" / "dao" / "den520d.map"), []
    for instance, size in [(1, 2)] if smoke else [(i, k) for i in _INSTANCES for k in _SIZES]:
        root = ElementTree.parse(folder / "ccbs" / "den520d" / f"den520d-random-{instance}.xml").getroot()
        ends = np.array(
            [
                [[float(agent.get(f"{end}_{axis}", "")) + 0.5 for axis in "ji"] for agent in root]
                for end in ("start", "goal")
            ]
        )
        began = time.perf_counter()
        problem = Problem(workspace, [DiscRobot(_RADIUS)] * size, ends[0, :size], ends[1, :size])
        prepared = time.perf_counter() - began
        bound = straight_line_bound(problem) if smoke else alone(problem, inflated=False)
        row = {"scene": f"den520d {instance}", "problem_seconds": round(prepared, 3), **planned(problem, bound)}
        rows.append(row)
        print(line(row), flush=True)
    return {"rows": rows}


def unseen(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for size in (2,) if smoke else (2, 3, 4):
        scene = scenes.four_rooms(size)
        bl_plan(scenes.perturbed(scene, 1000 + seed))
        problems = [scenes.perturbed(scene, seed + k) for k in range(1 if smoke else _UNSEEN)]
        runs = [planned(problem, alone(problem)) for problem in problems]
        middle = {
            key: float(np.median([run[key] for run in runs])) for key in ("seconds", "first", "first_ratio", "ratio")
        }
        valid = all(run["valid"] for run in runs)
        rows.append({"scene": "four rooms", "robots": size, **middle, "valid": valid, "found_by": "", "status": ""})
        print(line(rows[-1]), flush=True)
    return {"rows": rows, "problems": _UNSEEN}


def line(row: dict[str, Any]) -> str:
    return "  ".join(cells(row))


def cells(row: dict[str, Any]) -> list[str]:
    if row["first"] is None:
        return [row["scene"], row["status"], str(row["robots"]), "-", "-", f"{row['seconds']:.3f}", "-"]
    valid = {True: "valid", False: "INVALID"}[row["valid"]]
    numbers = f"{row['first']:.3f}", f"{row['first_ratio']:.3f}", f"{row['seconds']:.3f}", f"{row['ratio']:.4f}"
    return [row["scene"], valid, str(row["robots"]), *numbers]


def table(results: dict[str, Any]) -> str:
    head = ["scene", "path", "robots", "s to the first", "its ratio", "s in all", "ratio"]
    return aligned([head, *map(cells, results["rows"])], 5) + results.get("skipped", "")


class _Section:
    """A section of this file: they differ in what they measure alone."""

    def __init__(self, measured: Callable[[int, bool], dict[str, Any]]):
        self.measured = measured

    def measure(self, seed: int, smoke: bool, /) -> dict[str, Any]:
        return self.measured(seed, smoke)

    def table(self, results: dict[str, Any], /) -> str:
        return table(results)

    def draw(self, results: dict[str, Any], output: Path, /) -> list[Path]:
        return []


SECTIONS: dict[str, Section] = {measure.__name__: _Section(measure) for measure in (first, longer, den520d, unseen)}


if __name__ == "__main__":
    run_sections("teams", __doc__, SECTIONS)
