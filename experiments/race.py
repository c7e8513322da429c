"""The race: how long the planners of OMPL take to paths as good as ours, on the scenes of Table II and in crowds.

For each variant of a scene's starts and goals, ``bl_plan(problem)`` plans once, and each planner of OMPL then gets
one trial that ends when its path costs no more, or at a limit: 2 s, or twice our seconds if that is more. OMPL plans
for the joint space, and for each robot in turn among those planned before (prioritised; discs only). A planner without
any path in the first variants of a scene is left out of the others.

Our seconds are those of one call, shortening included. The map is known: the team was planned from its goals to its
starts before. On a new map, they begin before the ``Workspace`` is made. OMPL's begin when its process has started and
compiled; it prepares nothing for a map. Its tests of motions, and BIT*'s costs, are calls of Python. The seconds
"without Python" leave out the share of the trial's time that C++ would save.

Every path counted is put through ``validate``, our first ones included. Three marks are compared: the first path; one
that costs at most 5 % more than ours in the end; and one that costs no more. In the first variants, ``bl_plan`` is then
asked to improve its path for a while, which draws its part of cost over time.
"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from tqdm import tqdm

from experiments._planning import SCENES, is_valid, lower_bound, plan, plan_and_check, reversed_team
from experiments._runner import run
from experiments.baselines.ompl import ompl_plan, ompl_prioritized
from plr_jax import BLOptions, Problem, Solution, Workspace, scenes

PRIORITIZED = "prioritized"
PLANNERS = ("RRTstar", "RRTConnect", "AORRTC", "BITstar", PRIORITIZED)
CROWDS: dict[str, Callable[[int], Problem]] = {
    "door 20": lambda seed: scenes.perturbed(scenes.door(20), seed),
    "crowd 25": lambda seed: scenes.crowd(25, seed),
    "crowd 50": lambda seed: scenes.crowd(50, seed),
}
NUM_STARTS = 20
NUM_FIRST = 3  # variants in which all planners run, and which are drawn
LEAST_LIMIT, LIMIT_FACTOR = 2.0, 2.0  # seconds of a trial at least, and in our seconds
IMPROVE_SECONDS = 2.0

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
_LEAST_EXCESS = 0.002  # where the panels begin
_ROUNDING = 1e-5  # of costs in a history


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names = ["single door"] if smoke else [*SCENES, *CROWDS]
    seeds = [seed] if smoke else list(range(seed, seed + NUM_STARTS))
    least, improve = (0.5, 0.2) if smoke else (LEAST_LIMIT, IMPROVE_SECONDS)
    trials: list[dict[str, Any]] = []
    for name in tqdm(names, desc="race", delay=3, disable=None):
        planners = PLANNERS
        for start in seeds:
            is_first = start < seed + NUM_FIRST
            trials.append(race(name, start, planners, least, improve if is_first else 0.0))
            if start == seed + NUM_FIRST - 1:
                tried = [entry["ompl"] for entry in trials if entry["scene"] == name]
                planners = tuple(each for each in tried[0] if any(one[each]["history_cost"] for one in tried))
    return {
        "seeds": seeds,
        "planners": list(PLANNERS),
        "limit": {"least": least, "factor": LIMIT_FACTOR},
        "improve_seconds": improve,
        "summary": [summary([entry for entry in trials if entry["scene"] == name]) for name in names],
        "trials": trials,
    }


def race(name: str, seed: int, planners: tuple[str, ...], least: float, improve: float) -> dict[str, Any]:
    """Run some planners on one variant of a scene."""
    problem = CROWDS[name](seed) if name in CROWDS else scenes.perturbed(SCENES[name](), seed)
    ours = ours_of(problem, improve)
    limit = max(least, LIMIT_FACTOR * ours["known_map"]["same_cost"])
    return {
        "scene": name,
        "seed": seed,
        "lower_bound": round(lower_bound(problem), 6),
        "limit": round(limit, 3),
        "ours": ours,
        "ompl": {
            planner: trial(problem, planner, seed, limit, ours["cost"])
            for planner in planners
            if planner != PRIORITIZED or problem.dof == 2
        },
    }


def ours_of(problem: Problem, improve: float) -> dict[str, Any]:
    """Our first path, shortened, on a known map and on a new one; then better paths."""
    plan(reversed_team(problem), None, BLOptions(time_limit=1.0))
    solution, seconds, valid = plan_and_check(problem, None, BLOptions())
    if not solution.solved:
        raise RuntimeError(f"We did not set a cost for the others to reach: {solution.status}.")
    began, old = perf_counter(), problem.workspace
    workspace = Workspace(old.bounds, old.obstacles, squeeze=old.squeeze)
    team = Problem(workspace, problem.robots, problem.starts, problem.goals, problem.rotation_weight)
    prepared = perf_counter() - began
    on_new_map, seconds_on_new_map = plan(team, None, BLOptions())
    result = {
        "known_map": seconds_to_marks(solution, seconds),
        "new_map": seconds_to_marks(on_new_map, seconds_on_new_map, prepared),
        "found_by": solution.stats.found_by,
        "cost": round(solution.cost, 9),
        "valid": valid,
        "new_map_valid": is_valid(team, on_new_map),
    }
    if improve:
        # No path costs as little as the bound of straight lines, so that this goes on until the time is over.
        improved, _ = plan(problem, None, BLOptions(cost_factor=1e-9, time_limit=improve))
        result |= {"improved_valid": is_valid(problem, improved), **history_of(improved)}
    return result


def seconds_to_marks(solution: Solution, seconds: float, prepared: float = 0.0) -> dict[str, float]:
    """Return our seconds to each of the marks, of which the last ends with the call."""
    within = [factor * solution.cost for factor in MARKS.values()]
    reached = [next(found for found, cost in solution.stats.history if cost <= most) for most in within[:-1]]
    return {mark: round(prepared + found, 5) for mark, found in zip(MARKS, [*reached, seconds], strict=True)}


def trial(problem: Problem, planner: str, seed: int, limit: float, target: float) -> dict[str, Any]:
    """One trial of one of OMPL's planners."""
    if planner == PRIORITIZED:
        solution = ompl_prioritized(problem, seed=seed, time_limit=limit, cost_target=target)
    else:
        solution = ompl_plan(problem, planner, seed=seed, time_limit=limit, cost_target=target)
    stats = solution.stats
    return {
        "valid": is_valid(problem, solution),
        "vertices": stats.num_nodes,
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


def best_of(entry: dict[str, Any], factor: float, without_python: float = 0.0) -> tuple[str, float]:
    """Return OMPL's first planner to a path of so many times our cost, and its seconds, maybe without Python's share."""
    seconds = {
        planner: reached_at(attempt, factor * entry["ours"]["cost"]) * (1 - without_python * attempt["python_share"])
        for planner, attempt in entry["ompl"].items()
    }
    winner = min(seconds, key=seconds.__getitem__)
    return winner, seconds[winner]


def summary(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians over the variants of one scene, for each mark, and in how many variants we came first.

    The best of OMPL's planners counts in each variant. Without a path in half of the variants, there is no median.
    """
    result: dict[str, Any] = {"scene": entries[0]["scene"], "variants": len(entries)}
    for mark, factor in MARKS.items():
        best, native = (np.array([best_of(entry, factor, share)[1] for entry in entries]) for share in (0.0, 1.0))
        winners = [best_of(entry, factor)[0] for entry in entries if np.isfinite(best_of(entry, factor)[1])]
        known, new = (np.array([entry["ours"][each][mark] for entry in entries]) for each in ("known_map", "new_map"))
        result[mark] = {
            "ours": float(np.median(known)),
            "new_map": float(np.median(new)),
            "best": finite_median(best),
            "without_python": finite_median(native),
            "reached": int(np.isfinite(best).sum()),
            "sooner": int((known < best).sum()),
            "sooner_on_new_map": int((new < best).sum()),
            "sooner_than_without_python": int((known < native).sum()),
            "winners": Counter(winners),
        }
    return result


def finite_median(seconds: Float[np.ndarray, "n"]) -> float | None:
    """Return the median, or None if it is infinite."""
    return float(np.median(seconds)) if 2 * np.isfinite(seconds).sum() > len(seconds) else None


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Cost over time, one panel a scene, one line a planner and variant."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for entry in results["trials"]:
        if "improved_valid" in entry["ours"]:
            groups.setdefault(entry["scene"], []).append(entry)
    columns = min(_COLUMNS, len(groups))
    rows = -(-len(groups) // columns)
    figure = Figure(figsize=(2.75 * columns + 0.4, 2.3 * rows + 0.9), layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax in axes.flat[len(groups) :]:
        ax.set_axis_off()
    for ax, (name, entries) in zip(axes.flat, groups.items(), strict=False):
        for entry in entries:
            add_lines(ax, entry, results["improve_seconds"])
        ax.set_title(name, fontsize=10)
        style_panel(ax)
    for ax in axes[:, 0]:
        ax.set_ylabel("cost over lower bound", fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("time", fontsize=9)
    handles = [Line2D([], [], color=color, lw=width) for color, _, width in _STYLES.values()]
    labels = [label for _, label, _ in _STYLES.values()]
    figure.legend(handles, labels, loc="outside lower center", ncols=columns + 1, frameon=False, fontsize=9)
    figure.savefig(output / "race.png", dpi=150)
    return [output / "race.png"]


def style_panel(ax: Axes) -> None:
    ticks = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
    ax.set(xscale="log", yscale="log", ylim=(_LEAST_EXCESS, 4.0))
    ax.set_xticks([0.001, 0.01, 0.1, 1, 10], ["1 ms", "10 ms", "0.1 s", "1 s", "10 s"])
    ax.set_yticks(ticks, [f"+{100 * tick:.3g} %" for tick in ticks])
    ax.tick_params(which="minor", left=False, bottom=False)
    ax.grid(True, which="major", color="#e4e4e4", lw=0.6)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)


def add_lines(ax: Axes, entry: dict[str, Any], improve_seconds: float) -> None:
    """Cost of each planner's best path so far, to the end of its trial; a dot where it reached our cost."""
    for planner, attempt in entry["ompl"].items():
        reached = reached_at(attempt, entry["ours"]["cost"])
        add_line(ax, planner, attempt, entry["lower_bound"], min(reached, entry["limit"]))
        if np.isfinite(reached):
            excess = excess_of(attempt["history_cost"][-1:], entry["lower_bound"])
            ax.plot([reached], excess, "o", color=_STYLES[planner][0], ms=3.5, zorder=5)
    add_line(ax, OURS, entry["ours"], entry["lower_bound"], improve_seconds)


def add_line(ax: Axes, name: str, attempt: dict[str, Any], bound: float, end: float) -> None:
    seconds, costs = attempt["history_seconds"], attempt["history_cost"]
    if costs:
        color, _, width = _STYLES[name]
        excess = excess_of([*costs, costs[-1]], bound)
        end = max(end, seconds[-1])
        ax.step([*seconds, end], excess, where="post", color=color, lw=width, zorder=4 if name == OURS else 3)


def excess_of(costs: list[float], bound: float) -> Float[np.ndarray, "n"]:
    return np.maximum(np.array(costs) / bound - 1, _LEAST_EXCESS)


if __name__ == "__main__":
    run("race", "The race: OMPL's planners to a path as good as ours, and cost over time.", compute, draw)
