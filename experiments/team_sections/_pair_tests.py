"""29 discs in the open, three teams: the share of a plan's time that goes into tests of pairs of robots.

Counted are the exact tests, how near pairs are found for them, and what whole functions do around both, so that the
share errs on the high side; a function that another counted one calls counts once. Before each plan, the team is
planned from its goals to its starts: the map is known, starts and goals are not.
"""

import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from itertools import product
from typing import Any
from unittest import mock

from experiments._planning import plan
from experiments._tables import aligned
from experiments.team_sections._plans import two_teams
from plr_jax import BLOptions
from plr_jax.collision.team import JointMotionTest, Traffic
from plr_jax.planners import lacam as moves
from plr_jax.planners import smoothing as corridor
from plr_jax.planners import smoothing as shortcuts
from plr_jax.planners.lacam import TeamMoves
from plr_jax.planners.lattice.joint import JointLattice
from plr_jax.planners.replanning import Conflicts

NUM_ROBOTS, NUM_TEAMS = 29, 3
SEARCHERS = {"both": ("lacam", "bl"), "best-first": ("bl",)}
COUNTED: tuple[tuple[Any, str], ...] = (
    *((JointLattice, "collisions"), (JointMotionTest, "apart"), (JointMotionTest, "meet"), (Traffic, "near")),
    *((TeamMoves, "_near"), (moves, "motions_apart"), (moves, "_bits"), (Conflicts, "_find")),
    *((Traffic, "move"), (corridor, "within_reach"), (corridor, "circles_along"), (shortcuts, "circles")),
    (corridor, "_touching"),
)


class Stopwatch:
    """Seconds within some functions, calls of one from another counted once."""

    def __init__(self) -> None:
        self.seconds, self.runs = 0.0, False

    def counted(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its calls counted."""

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if self.runs:
                return function(*arguments, **named)
            began, self.runs = time.perf_counter(), True
            try:
                return function(*arguments, **named)
            finally:
                self.seconds, self.runs = self.seconds + time.perf_counter() - began, False

        return call


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    size, teams = (6, 1) if smoke else (NUM_ROBOTS, NUM_TEAMS)
    rows = []
    for variant, (name, searchers) in product(range(teams), SEARCHERS.items()):
        known, problem = two_teams("crowd", size, seed, variant)
        options, watch = BLOptions(searchers=searchers, time_limit=20.0), Stopwatch()
        plan(known, None, options)
        with ExitStack() as patches:
            for owner, function in COUNTED:
                patches.enter_context(mock.patch.object(owner, function, watch.counted(getattr(owner, function))))
            solution, seconds = plan(problem, None, options)
        share = round(watch.seconds / seconds, 4)
        rows.append({"searches": name, "status": solution.status.name, "seconds": round(seconds, 4), "share": share})
    return {"robots": size, "rows": rows}


def table(results: dict[str, Any]) -> str:
    rows = [["searches", "status", "s", "share of pair tests"]]
    for row in results["rows"]:
        rows.append([row["searches"], row["status"], f"{row['seconds']:.3f}", f"{row['share']:.1%}"])
    return f"{results['robots']} discs\n" + aligned(rows, 2)
