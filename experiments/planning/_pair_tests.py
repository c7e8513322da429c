"""29 discs in the open: the share of a plan's time that goes into tests of pairs, near pairs found included."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any
from unittest import mock

from experiments._tables import aligned
from experiments.planning._plans import timed
from plr_jax import BLOptions, scenes
from plr_jax.collision import joint_motion
from plr_jax.collision.broad_phase import Traffic
from plr_jax.planners.lacam import conflicts, moves
from plr_jax.planners.lacam.moves import TeamMoves
from plr_jax.planners.smoothing import corridor

NUM_ROBOTS = 29
SEARCHERS = {"both": ("lacam", "bl"), "best-first": ("bl",)}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem, rows = scenes.crowd(6 if smoke else NUM_ROBOTS, seed), []
    for name, searchers in SEARCHERS.items():
        options = BLOptions(searchers=searchers, time_limit=20.0)
        timed(scenes.crowd(len(problem.robots), 1000 + seed), options)
        spent = [0.0]
        with ExitStack() as patches:
            for owner, function in (
                (moves, "motions_apart"),
                (conflicts, "motions_apart"),
                (joint_motion, "motions_apart"),
                (corridor, "within_reach"),
                (Traffic, "near"),
                (TeamMoves, "_near"),
            ):
                patches.enter_context(mock.patch.object(owner, function, counted(getattr(owner, function), spent)))
            solution, seconds = timed(problem, options)
        rows.append({"searches": name, "seconds": round(seconds, 4), "share": round(spent[0] / seconds, 4)})
        rows[-1]["status"] = solution.status.name
    return {"robots": len(problem.robots), "rows": rows}


def counted(function: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """A function that adds the seconds of its calls to a sum."""

    def call(*arguments: Any, **named: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            spent[0] += time.perf_counter() - began

    return call


def table(results: dict[str, Any]) -> str:
    rows = [["searches", "status", "s", "share of pair tests"]]
    for row in results["rows"]:
        rows.append([row["searches"], row["status"], f"{row['seconds']:.3f}", f"{row['share']:.1%}"])
    return f"{results['robots']} discs\n" + aligned(rows, 2)
