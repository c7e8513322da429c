"""Joint states that a search scores a second, and in one call of the heuristic.

Best-first search alone goes on to a limit, so that it is the search that is measured. Joint children are scored by
tables of a heuristic with terms; a plain function is called with arrays of joint configurations, whose rows are
counted. Lazy search scores no joint states, but every motion of every robot once a step. Before each team, another
one of its size is planned in the same workspace: the map is known, starts and goals are not.
"""

from typing import Any

import numpy as np

from experiments._planning import plan
from experiments._tables import aligned
from experiments.team_sections._plans import two_teams
from plr_jax import BLOptions, Problem, straight_line

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
    """Joint children scored a second of search, and in one expansion."""
    stats = plan(problem, None, options_of(seconds))[0].stats
    rate = stats.num_children_scored / stats.seconds["search"]
    return {"scored_a_second": round(rate), "scored_an_expansion": stats.num_children_scored // stats.num_expansions}


def with_a_function(problem: Problem, seconds: float) -> dict[str, Any]:
    """Joint configurations in the calls of a plain function."""
    sizes: list[int] = []
    lines = straight_line(problem)

    def plain(q: np.ndarray) -> np.ndarray:
        sizes.append(len(q))
        return np.asarray(lines(q))

    stats = plan(problem, plain, options_of(seconds))[0].stats
    return {"median_call": int(np.median(sizes)), "called_a_second": round(sum(sizes) / stats.seconds["search"])}


def table(results: dict[str, Any]) -> str:
    rows = [["scene", "scored a second", "in one expansion", "states in a median call", "states a second in calls"]]
    for row in results["rows"]:
        numbers = ("scored_a_second", "scored_an_expansion", "median_call", "called_a_second")
        rows.append([row["scene"], *(f"{row[key]:,}" for key in numbers)])
    return aligned(rows, 4)
