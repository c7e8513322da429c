"""How late calls return whose time is over.

200 calls of ``bl_plan`` are at work that never ends before, on all scenes by turns. Every call has a workspace of its
own, of which nothing is known but what ``Problem`` looks at. In every second round the planner has the robots' exact
distances as its heuristic. Then 60 calls of ``robot_distance_fns``, which find these distances or raise
``TimeoutError``: one that ends before its limit is not late.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments._planning import SCENES as OF_TABLE_TWO
from experiments._planning import is_valid, plan
from experiments._tables import aligned
from experiments.team_sections._collections import collection
from experiments.team_sections._den520d import RADIUS, agents_of
from plr_jax import BLOptions, DiscRobot, Problem, robot_distance_fns, scenes, sum_of_distances

NUM_RUNS, NUM_OF_DISTANCES = 200, 60
SHORTEST, LONGEST = 0.1, 5.0
LATE, LATE_SHARE = 0.2, 0.1  # seconds, or share of the limit if that is more
SCENES: dict[str, Callable[[], Problem]] = {
    **OF_TABLE_TWO,
    **{f"door {size}": lambda size=size: scenes.door(size) for size in (20, 50)},
    **{f"crowd {size}": lambda size=size: scenes.crowd(size) for size in (25, 50, 100)},
}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rng, rows = np.random.default_rng(seed), []
    makers = dict(list(all_scenes().items())[: 2 if smoke else None])
    heuristics = {
        name: sum_of_distances(robot_distance_fns(maker())) for name, maker in makers.items() if name in SCENES
    }
    for run in tqdm(range(4 if smoke else NUM_RUNS), desc="time limits", delay=3, disable=None):
        name, problem, limit = drawn(makers, run, rng, smoke)
        heuristic = heuristics.get(name) if run // len(makers) % 2 else None
        # No path costs as little as that, so that improving goes on until the time is over.
        solution, seconds = plan(problem, heuristic, BLOptions(cost_factor=1e-9, time_limit=limit))
        row = {"call": "bl_plan", "scene": name, "limit": round(limit, 4), "late": round(seconds - limit, 4)}
        valid, status = is_valid(problem, solution), solution.status.name
        rows.append({**row, "valid": valid, "status": status, "given": heuristic is not None})
    for run in tqdm(range(2 if smoke else NUM_OF_DISTANCES), desc="distances", delay=3, disable=None):
        name, problem, limit = drawn(makers, run, rng, smoke)
        seconds = seconds_of_distances(problem, limit)
        row = {"call": "robot_distance_fns", "scene": name, "limit": round(limit, 4)}
        rows.append({**row, "late": round(seconds - limit, 4), "valid": None})
    return {"rows": rows}


def all_scenes() -> dict[str, Callable[[], Problem]]:
    """What makes a problem of each scene, maps of the published collections included where these are there."""
    instances, maps, dbcbs = collection("ccbs"), collection("movingai"), collection("dbcbs")
    makers = dict(SCENES)
    if instances is not None and maps is not None:
        file, (starts, goals) = maps / "dao" / "den520d.map", agents_of(instances, 1)
        discs = [DiscRobot(RADIUS)] * 5
        makers["den520d 5"] = lambda: Problem(scenes.read_map(file), discs, starts[:5], goals[:5])
    if dbcbs is not None:
        makers["gen_p10_n16_0"] = lambda: scenes.read_dbcbs(dbcbs / "gen_p10_n16_0_unicycle_sphere.yaml")
    return makers


def drawn(
    makers: dict[str, Callable[[], Problem]], run: int, rng: np.random.Generator, smoke: bool
) -> tuple[str, Problem, float]:
    """A scene, its problem, and a limit."""
    name = list(makers)[run % len(makers)]
    limit = 0.1 if smoke else float(np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST))))
    return name, makers[name](), limit


def seconds_of_distances(problem: Problem, limit: float) -> float:
    """Seconds until the distances of all robots are known, or the limit is reached."""
    began = time.perf_counter()
    with suppress(TimeoutError):
        robot_distance_fns(problem, time_limit=limit)
    return time.perf_counter() - began


def is_late(row: dict[str, Any]) -> bool:
    return row["late"] > max(LATE, LATE_SHARE * row["limit"])


def table(results: dict[str, Any]) -> str:
    rows = [["call", "scene", "runs", "worst s late", "too late", "paths", "not valid"]]
    keys = dict.fromkeys((row["call"], row["scene"]) for row in results["rows"])
    for call, name in keys:
        rows.append(
            [call, name, *_cells([row for row in results["rows"] if (row["call"], row["scene"]) == (call, name)])]
        )
    for call in dict.fromkeys(call for call, _ in keys):
        rows.append([call, "all", *_cells([row for row in results["rows"] if row["call"] == call])])
    return aligned(rows, 5)


def _cells(runs: list[dict[str, Any]]) -> list[str]:
    valid = [row["valid"] for row in runs]
    counts = sum(map(is_late, runs)), sum(v is not None for v in valid), sum(v is False for v in valid)
    return [str(len(runs)), f"{max(row['late'] for row in runs):.3f}", *map(str, counts)]
