"""The race: how long the planners of OMPL take to paths as good as ours, on the scenes of Table II and in crowds.

For each variant of a scene's starts and goals, ``bl_plan(problem)`` plans once, and each planner of OMPL then gets
one trial that ends when its path costs no more, or at a limit: 2 s, or twice our seconds if that is more. OMPL plans
for the joint space, and for each robot in turn among those planned before (prioritized; discs only). If a planner
finds no path in the first variants of a scene, it is left out of the others.

Our seconds are those of one call, shortening included. On a known map, the reversed problem was planned before, so
the map's tables exist. On a new map, our seconds begin before the ``Workspace`` is made. OMPL's begin when its
process has started and compiled; OMPL prepares nothing for a map. OMPL calls Python for motion tests and for BIT*'s
costs. The seconds "without Python" leave out the share of the trial's time that C++ would save.

Every path counted is put through ``validate``, our first ones included. Three marks are compared: the first path; the
first path that costs at most 5 % more than our last path; and the first that costs no more than our last path.
"""

import itertools
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from tqdm import tqdm

from experiments._planning import SCENES, is_valid, plan, plan_and_check, reversed_team
from experiments._runner import run
from experiments.baselines.ompl import PRIORITIZED, ompl_plan
from plr_jax import BLOptions, Problem, Solution, Workspace, exact_lower_bound, scenes

PLANNERS = ("RRTstar", "RRTConnect", "AORRTC", "BITstar", PRIORITIZED)
CROWDS: dict[str, Callable[[int], Problem]] = {
    "door 20": lambda seed: scenes.perturbed(scenes.door(20), seed),
    "crowd 25": lambda seed: scenes.crowd(25, seed),
    "crowd 50": lambda seed: scenes.crowd(50, seed),
}
NUM_STARTS = 20
NUM_FIRST = 3  # variants in which all planners run, and which are drawn
# A trial of OMPL ends after LIMIT_FACTOR times our seconds, but not before LEAST_LIMIT.
LEAST_LIMIT = 2.0  # seconds
LIMIT_FACTOR = 2.0

OURS = "bl_plan"
MARKS = {"first_path": np.inf, "cost_5_percent_more": 1.05, "same_cost": 1.0}  # costs, over our cost
_STYLES = {
    OURS: ("#D55E00", OURS, 2.2),
    "RRTConnect": ("#0072B2", "RRT-Connect, simplified, restarted", 1.1),
    "AORRTC": ("#009E73", "AORRTC", 1.1),
    "RRTstar": ("#7A7A7A", "RRT*", 1.1),
    "BITstar": ("#CC79A7", "BIT*", 1.1),
    PRIORITIZED: ("#E69F00", "one robot after the other", 1.1),
}
_COLUMNS = 4
_LEAST_EXCESS = 0.002  # smallest excess cost that is drawn
_ROUNDING = 1e-5  # histories store costs to five decimals


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names = ["single door"] if smoke else [*SCENES, *CROWDS]
    seeds = [seed] if smoke else list(range(seed, seed + NUM_STARTS))
    least = 0.5 if smoke else LEAST_LIMIT
    trials = []
    for name in tqdm(names, desc="race", delay=3, disable=None):
        probes = [race(name, start, PLANNERS, least) for start in seeds[:NUM_FIRST]]
        # Solvers found a path in some probe.
        solvers = tuple(each for each in PLANNERS if any(entry["ompl"][each]["history_cost"] for entry in probes))
        trials.append([*probes, *(race(name, start, solvers, least) for start in seeds[NUM_FIRST:])])
    return {
        "seeds": seeds,
        "limit": {"least": least, "factor": LIMIT_FACTOR},
        "summary": [summary(entries) for entries in trials],
        "trials": [entry for entries in trials for entry in entries],
    }


def race(name: str, seed: int, planners: tuple[str, ...], least: float) -> dict[str, Any]:
    """Run some planners on one variant of a scene."""
    problem = CROWDS[name](seed) if name in CROWDS else scenes.perturbed(SCENES[name](), seed)
    ours = ours_of(problem)
    limit = max(least, LIMIT_FACTOR * ours["known_map"]["same_cost"])
    return {
        "scene": name,
        "seed": seed,
        "lower_bound": round(exact_lower_bound(problem), 6),
        "limit": round(limit, 3),
        "ours": ours,
        "ompl": {planner: trial(problem, planner, seed, limit, ours["cost"]) for planner in planners},
    }


def ours_of(problem: Problem) -> dict[str, Any]:
    """Plan with ``bl_plan`` on a known and on a new map; return seconds to each mark, cost and history."""
    plan(reversed_team(problem), None, BLOptions(time_limit=1.0))  # makes the map's tables
    solution, seconds, valid = plan_and_check(problem, None, BLOptions())
    if not solution.solved:
        raise RuntimeError(f"bl_plan found no path, so OMPL has no target cost: {solution.status}.")
    began, old = perf_counter(), problem.workspace
    workspace = Workspace(old.bounds, old.obstacles, squeeze=old.squeeze)
    team = Problem(workspace, problem.robots, problem.starts, problem.goals, problem.rotation_weight)
    prepared = perf_counter() - began
    on_new_map, seconds_on_new_map = plan(team, None, BLOptions())
    return {
        "known_map": seconds_to_marks(solution, seconds),
        "new_map": seconds_to_marks(on_new_map, seconds_on_new_map, prepared),
        "cost": round(solution.cost, 9),
        "valid": valid,
        "new_map_valid": is_valid(team, on_new_map),
        **history_of(solution),
    }


def seconds_to_marks(solution: Solution, seconds: float, prepared: float = 0.0) -> dict[str, float]:
    """Return our seconds to each mark. The last mark is the end of the call."""
    within = [factor * solution.cost for factor in MARKS.values()]
    reached = [next(found for found, cost in solution.stats.history if cost <= most) for most in within[:-1]]
    return {mark: round(prepared + found, 5) for mark, found in zip(MARKS, [*reached, seconds], strict=True)}


def trial(problem: Problem, planner: str, seed: int, limit: float, target: float) -> dict[str, Any]:
    """Run one of OMPL's planners on a problem until its path costs at most ``target``, or until the limit."""
    if planner == PRIORITIZED and problem.dof == 3:  # the prioritized planner takes only points and discs
        return {"valid": None, "tests": 0, "python_share": 0.0, "history_seconds": [], "history_cost": []}
    solution = ompl_plan(problem, planner, seed=seed, time_limit=limit, cost_target=target)
    stats = solution.stats
    return {
        "valid": is_valid(problem, solution),
        "tests": stats.num_children_scored,
        "python_share": round(stats.seconds["python"] / stats.seconds["plan"], 4),
        **history_of(solution),
    }


def history_of(solution: Solution) -> dict[str, list[float]]:
    history = solution.stats.history
    return {
        "history_seconds": [round(seconds, 5) for seconds, _ in history],
        "history_cost": [round(cost, 5) for _, cost in history],
    }


def reached_at(attempt: dict[str, Any], cost: float) -> float:
    """Return the seconds of a trial to a path of at most this cost, ``inf`` without one."""
    reached = (np.array(attempt["history_cost"]) <= cost + _ROUNDING).nonzero()[0]
    return attempt["history_seconds"][reached[0]] if len(reached) else np.inf


def best_of(entry: dict[str, Any], factor: float, is_native: bool = False) -> tuple[str, float]:
    """Return the OMPL planner that first reaches ``factor`` times our cost, and its seconds.

    ``is_native`` counts seconds without Python.
    """
    seconds = {
        planner: reached_at(attempt, factor * entry["ours"]["cost"]) * (1 - is_native * attempt["python_share"])
        for planner, attempt in entry["ompl"].items()
    }
    winner = min(seconds, key=seconds.__getitem__)
    return winner, seconds[winner]


def summary(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return, for one scene and each mark, our median seconds, OMPL's best seconds, and how often we were sooner.

    OMPL's best seconds are a list over the variants, each of the planner that was first.
    """
    result: dict[str, Any] = {"scene": entries[0]["scene"], "variants": len(entries)}
    for mark, factor in MARKS.items():
        winners = [best_of(entry, factor) for entry in entries]
        best = np.array([seconds for _, seconds in winners])
        native = np.array([best_of(entry, factor, is_native=True)[1] for entry in entries])
        known, new = (np.array([entry["ours"][each][mark] for entry in entries]) for each in ("known_map", "new_map"))
        result[mark] = {
            "ours": float(np.median(known)),
            "new_map": float(np.median(new)),
            "best": [each if np.isfinite(each) else None for each in best.tolist()],
            "without_python": [each if np.isfinite(each) else None for each in native.tolist()],
            "sooner": int((known < best).sum()),
            "sooner_on_new_map": int((new < best).sum()),
            "sooner_than_without_python": int((known < native).sum()),
            "winners": Counter(winner for winner, seconds in winners if seconds < np.inf),
        }
    return result


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Draw cost over time in the first variants, one panel a scene, one line a planner and variant."""
    drawn = [entry for entry in results["trials"] if entry["seed"] in results["seeds"][:NUM_FIRST]]
    names = list(dict.fromkeys(entry["scene"] for entry in drawn))
    columns = min(_COLUMNS, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(2.75 * columns + 0.4, 2.3 * rows + 0.9), layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax, name in itertools.zip_longest(axes.flat, names):
        ax.set(xscale="log", yscale="log", ylim=(_LEAST_EXCESS, 4.0), title=name, visible=name is not None)
        ax.grid(True, color="#e4e4e4", lw=0.6)
    for entry, (planner, (color, _, width)) in itertools.product(drawn, _STYLES.items()):
        attempt = entry["ours"] if planner == OURS else entry["ompl"][planner]
        if costs := attempt["history_cost"]:
            seconds = attempt["history_seconds"]
            is_over = costs[-1] <= entry["ours"]["cost"] + _ROUNDING  # else the trial went on to the limit
            end = seconds[-1] if is_over else entry["limit"]
            excess = np.maximum(np.array([*costs, costs[-1]]) / entry["lower_bound"] - 1, _LEAST_EXCESS)
            ax = axes.flat[names.index(entry["scene"])]
            ax.step([*seconds, end], excess, where="post", color=color, lw=width)
    figure.supxlabel("seconds")
    figure.supylabel("cost over lower bound, less 1")
    handles = [Line2D([], [], color=color, lw=width, label=label) for color, label, width in _STYLES.values()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns + 1, frameon=False)
    figure.savefig(output / "race.png", dpi=150)
    return [output / "race.png"]


if __name__ == "__main__":
    run("race", "The race: OMPL's planners to a path as good as ours, and cost over time.", compute, draw)
