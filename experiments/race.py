"""The race: how long the planners of OMPL take to paths as good as ours, on the scenes of Table II and in crowds.

For each variant of a scene's starts and goals, ``bl_plan(problem)`` plans once, and each planner of OMPL then gets
one trial that ends when its path costs no more, or at a limit: a hundred times our seconds, but no less than 4 s and
no more than 8 s, or four times our seconds if that is more. For slow scenes the limit, not a planner, sets the ratio.
A trial that ends there stays in the results as "not within" it. OMPL plans for the joint space, and for each robot in
turn among those planned before (prioritised; discs only).

Our seconds are those of one call, shortening included; the team was planned from its goals to its starts before, so
that everything is compiled and the map is known, but no starts and goals. OMPL's begin when its process has started
and compiled. Every path counted is put through ``validate``, our first ones included. Three marks are compared: the
first path; one that costs at most 5 % more than ours in the end; and one that costs no more. ``bl_plan`` is then
asked to improve its path for a while, which draws its part of cost over time.
"""

from collections.abc import Callable
from pathlib import Path
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
from plr_jax import BLOptions, Problem, Solution, scenes

PRIORITIZED = "prioritized"
PLANNERS = ("RRTstar", "RRTConnect", "AORRTC", "BITstar", PRIORITIZED)
CROWDS: dict[str, Callable[[int], Problem]] = {
    "door 20": lambda seed: scenes.perturbed(scenes.door(20), seed),
    "crowd 25": lambda seed: scenes.crowd(25, seed),
    "crowd 50": lambda seed: scenes.crowd(50, seed),
}
NUM_STARTS = 3
LIMIT_FACTOR, LEAST_LIMIT, LARGEST_LIMIT, LEAST_FACTOR = 100.0, 4.0, 8.0, 4.0
IMPROVE_SECONDS = 2.0

OURS = "bl_plan"
MARKS = ("first_path", "cost_5_percent_more", "same_cost")
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
    largest, improve = (0.5, 0.2) if smoke else (LARGEST_LIMIT, IMPROVE_SECONDS)
    variants = [(name, start) for name in names for start in seeds]
    trials = [race(*variant, largest, improve) for variant in tqdm(variants, desc="race", delay=3, disable=None)]
    return {
        "seeds": seeds,
        "planners": list(PLANNERS),
        "limit": {
            "factor": LIMIT_FACTOR,
            "least": min(LEAST_LIMIT, largest),
            "largest": largest,
            "ours": LEAST_FACTOR,
        },
        "improve_seconds": improve,
        "summary": [summary([entry for entry in trials if entry["scene"] == name]) for name in names],
        "trials": trials,
    }


def race(name: str, seed: int, largest_limit: float, improve_seconds: float) -> dict[str, Any]:
    """All planners on one variant of a scene."""
    problem = CROWDS[name](seed) if name in CROWDS else scenes.perturbed(SCENES[name](), seed)
    bound = lower_bound(problem)
    ours = ours_of(problem, improve_seconds)
    limit = float(np.clip(LIMIT_FACTOR * ours["seconds"], min(LEAST_LIMIT, largest_limit), largest_limit))
    limit = max(limit, LEAST_FACTOR * ours["seconds"])
    planners = PLANNERS if problem.dof == 2 else PLANNERS[:-1]
    return {
        "scene": name,
        "seed": seed,
        "lower_bound": round(bound, 6),
        "limit": round(limit, 3),
        "ours": ours,
        "ompl": {planner: trial(problem, planner, seed, limit, ours["cost"]) for planner in planners},
    }


def ours_of(problem: Problem, improve_seconds: float) -> dict[str, Any]:
    """Our first path, shortened, after a plan for the team on its way back; then better ones."""
    plan(reversed_team(problem), None, BLOptions())
    solution, seconds, valid = plan_and_check(problem, None, BLOptions())
    if not solution.solved:
        raise RuntimeError(f"We did not set a cost for the others to reach: {solution.status}.")
    history = solution.stats.history
    # No path costs as little as the bound of straight lines, so that this goes on until the time is over.
    improved, _ = plan(problem, None, BLOptions(cost_factor=1e-9, time_limit=improve_seconds))
    return {
        "seconds": round(seconds, 5),
        "near_seconds": round(next(found for found, cost in history if cost <= 1.05 * solution.cost), 5),
        "first_path_seconds": round(history[0][0], 5),
        "found_by": solution.stats.found_by,
        "cost": round(solution.cost, 9),
        "valid": valid,
        "improved_cost": round(improved.cost, 9) if improved.solved else None,
        "improved_valid": is_valid(problem, improved),
        **history_of(improved),
    }


def trial(problem: Problem, planner: str, seed: int, limit: float, target: float) -> dict[str, Any]:
    """One trial of one of OMPL's planners."""
    if planner == PRIORITIZED:
        solution = ompl_prioritized(problem, seed=seed, time_limit=limit, cost_target=target)
    else:
        solution = ompl_plan(problem, planner, seed=seed, time_limit=limit, cost_target=target)
    reached = [seconds for seconds, cost in solution.stats.history if cost <= target]
    return {
        "seconds": round(reached[0], 5) if reached else None,
        "first_path_seconds": round(solution.stats.history[0][0], 5) if solution.solved else None,
        "cost": round(solution.cost, 9) if solution.solved else None,
        "valid": is_valid(problem, solution),
        "seconds_compile": round(solution.stats.seconds["compile"], 3),
        "vertices": solution.stats.num_nodes,
        **history_of(solution),
    }


def history_of(solution: Solution) -> dict[str, list[float]]:
    history = solution.stats.history
    return {
        "history_seconds": [round(seconds, 5) for seconds, _ in history],
        "history_cost": [round(cost, 5) for _, cost in history],
    }


def best_of(entry: dict[str, Any], factor: float) -> tuple[str | None, float]:
    """OMPL's first planner to a path of so many times our cost at most, and when; None and the limit if none."""
    times = {}
    for planner, attempt in entry["ompl"].items():
        history = zip(attempt["history_seconds"], attempt["history_cost"], strict=True)
        reached = [seconds for seconds, cost in history if cost <= factor * entry["ours"]["cost"] + _ROUNDING]
        if reached:
            times[planner] = reached[0]
    winner = min(times, key=times.__getitem__, default=None)
    return winner, entry["limit"] if winner is None else times[winner]


def summary(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the variants of one scene; where no planner was within the limit, the limit counts."""
    result: dict[str, Any] = {"scene": entries[0]["scene"], "variants": len(entries)}
    keys = ("first_path_seconds", "near_seconds", "seconds")
    for name, key, factor in zip(MARKS, keys, (np.inf, 1.05, 1.0), strict=True):
        ours = np.array([entry["ours"][key] for entry in entries])
        best = [best_of(entry, factor) for entry in entries]
        winners = [winner for winner, _ in best if winner]
        times = np.array([seconds for _, seconds in best])
        result[name] = {
            "ours": float(np.median(ours)),
            "best": float(np.median(times)),
            "winners": winners,
            "at_least": 2 * len(winners) <= len(entries),
            "ratio": float(np.median(times / ours)),
        }
    return result


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Cost over time, one panel a scene, one line a planner and variant."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for entry in results["trials"]:
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
        reached = attempt["seconds"]
        add_line(ax, planner, attempt, entry["lower_bound"], entry["limit"] if reached is None else reached)
        if reached is not None:
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


def excess_of(costs: list[float], bound: float) -> Float[np.ndarray, " n"]:
    return np.maximum(np.array(costs) / bound - 1, _LEAST_EXCESS)


if __name__ == "__main__":
    run("race", "The race: OMPL's planners to a path as good as ours, and cost over time.", compute, draw)
