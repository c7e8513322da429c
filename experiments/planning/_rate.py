"""Joint states that a search scores a second, and in one call of the heuristic.

Best-first search alone goes on to a limit, so that it is the search that is measured. Joint children are scored by
tables of a heuristic with terms; a plain function is called with arrays of joint configurations, whose rows are
counted. Lazy search scores no joint states, but every motion of every robot once a step.
"""

from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.planning._plans import timed
from plr_jax import BLOptions, Problem, scenes, straight_line

SECONDS = 5.0
SCENES = {"four rooms 4": lambda: scenes.four_rooms(4), "crowd 50": lambda: scenes.crowd(50)}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    seconds, rows = 0.2 if smoke else SECONDS, []
    for name, scene in list(SCENES.items())[: 1 if smoke else None]:
        problem = scene()
        rows.append({"scene": name, **with_terms(problem, seconds), **with_a_function(problem, seconds)})
    return {"rows": rows, "seconds": seconds}


def with_terms(problem: Problem, seconds: float) -> dict[str, Any]:
    """Joint children scored a second of search, and in one expansion."""
    options = BLOptions(searchers=("bl",), heuristic_weight=1.0, time_limit=seconds)
    stats = timed(problem, options)[0].stats
    rate = stats.num_children_scored / stats.seconds["search"]
    return {"scored_a_second": round(rate), "scored_an_expansion": stats.num_children_scored // stats.num_expansions}


def with_a_function(problem: Problem, seconds: float) -> dict[str, Any]:
    """Joint configurations in the calls of a plain function."""
    sizes: list[int] = []
    lines = straight_line(problem)

    def plain(q: np.ndarray) -> np.ndarray:
        sizes.append(len(q))
        return np.asarray(lines(q))

    options = BLOptions(searchers=("bl",), heuristic_weight=1.0, time_limit=seconds)
    stats = timed(problem, options, plain)[0].stats
    return {"median_call": int(np.median(sizes)), "called_a_second": round(sum(sizes) / stats.seconds["search"])}


def table(results: dict[str, Any]) -> str:
    rows = [["scene", "scored a second", "in one expansion", "states in a median call", "states a second in calls"]]
    for row in results["rows"]:
        numbers = ("scored_a_second", "scored_an_expansion", "median_call", "called_a_second")
        rows.append([row["scene"], *(f"{row[key]:,}" for key in numbers)])
    return aligned(rows, 4)
