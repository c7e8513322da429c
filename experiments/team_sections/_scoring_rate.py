"""Joint states that a search scores a second, and in one call of the heuristic.

Best-first search alone goes on to a limit, so that it is the search that is measured. Children are scored by tables
of a heuristic with terms while they grow, robot by robot, each product cut to the best ``BLOptions.width``: those of
part of the team count as scored, and those of all robots are also counted alone. A plain function is called with
arrays of joint configurations, whose rows are counted without the copies that fill them up. Lazy search scores no
joint states, but every motion of every robot once a step. Before each team, it is planned from its goals to its
starts: the map is known, starts and goals are not.
"""

import math
from typing import Any
from unittest import mock

import numpy as np

from experiments._planning import plan
from experiments._tables import aligned
from experiments.team_sections._plans import two_teams
from plr_jax import BLOptions, Problem, straight_line
from plr_jax.planners.bl import search
from plr_jax.planners.bl.search import Successors, best_successors
from plr_jax.planners.lattice.joint import JointLattice, State

SECONDS = 5.0
TEAMS = {"four_rooms": 4, "crowd": 50}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    seconds, rows = 0.2 if smoke else SECONDS, []
    for scene, size in list(TEAMS.items())[: 1 if smoke else None]:
        known, problem = two_teams(scene, size, seed)
        plan(known, None, options_of(seconds))
        name = f"{scene.replace('_', ' ')} {size}"
        rows.append({"scene": name, **with_terms(problem, seconds), **with_a_function(problem, seconds)})
    return {"rows": rows, "seconds": seconds}


def options_of(seconds: float) -> BLOptions:
    """Best-first search alone, for so many seconds unless it finds a path."""
    return BLOptions(searchers=("bl",), heuristic_weight=1.0, time_limit=seconds)


def with_terms(problem: Problem, seconds: float) -> dict[str, Any]:
    """Children scored a second of search, and those of all robots among them."""
    num_joint = 0

    def counted(joint: JointLattice, terms: Any, state: State, width: int) -> Successors:
        nonlocal num_joint
        sizes = [term.shape[1] for term in terms]
        num_joint += len(state) * min(width, math.prod(sizes[:-1])) * sizes[-1]
        return best_successors(joint, terms, state, width)

    with mock.patch.object(search, "best_successors", counted):
        stats = plan(problem, None, options_of(seconds))[0].stats
    return {
        "scored_a_second": round(stats.num_children_scored / stats.seconds["search"]),
        "joint_a_second": round(num_joint / stats.seconds["search"]),
    }


def with_a_function(problem: Problem, seconds: float) -> dict[str, Any]:
    """Joint configurations in the calls of a plain function."""
    sizes: list[int] = []
    lines = straight_line(problem)

    def plain(q: np.ndarray) -> np.ndarray:
        others = np.flatnonzero((q != q[-1]).any(axis=(1, 2)))  # copies of the last row fill the array up
        sizes.append(2 + int(others[-1]) if len(others) else 1)
        return np.asarray(lines(q))

    stats = plan(problem, plain, options_of(seconds))[0].stats
    rate = round(sum(sizes) / stats.seconds["search"])
    return {"calls": len(sizes), "median_call": int(np.median(sizes)), "called_a_second": rate}


def table(results: dict[str, Any]) -> str:
    rows = [["scene", "scored a second", "of all robots", "calls of a function", "median states", "states a second"]]
    for row in results["rows"]:
        numbers = ("scored_a_second", "joint_a_second", "calls", "median_call", "called_a_second")
        rows.append([row["scene"], *(f"{row[key]:,}" for key in numbers)])
    return aligned(rows, 5)
