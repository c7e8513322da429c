"""The race of Table II: how long the planners of OMPL take to a path that costs no more than BL's.

For each variant of a scene's starts and goals, BL with PLRs plans once, and each planner of OMPL then gets one trial
that ends when its path costs no more, or at a limit of a hundred times BL's seconds, but no less than 4 s and no more
than 8 s: for slow scenes the limit, not a planner, sets the ratio. A trial that ends there stays in the results as
"not within" it. BL's seconds are from call to return, warm (compiled, and with the lattices of an earlier run),
shortening included; building the PLRs is counted apart and beside it. OMPL's begin when its process has started and
compiled. BL is then asked to improve its path for a while, which draws its part of cost over time.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from tqdm import tqdm

from experiments._planning import PLR, PLR_BYTES, SCENES, build, is_valid, lower_bound, plan
from experiments._results import run
from experiments._tables import aligned
from experiments.baselines.ompl import ompl_plan
from plr_jax import BLOptions, HeuristicFn, Problem, Solution, scenes

PLANNERS = ("RRTstar", "RRTConnect", "AORRTC", "BITstar")
NUM_STARTS, NUM_RUNS = 3, 5
LIMIT_FACTOR, LEAST_LIMIT, LARGEST_LIMIT = 100.0, 4.0, 8.0
IMPROVE_SECONDS = 2.0

OURS = "BL with PLRs"
_STYLES = {
    OURS: ("#D55E00", OURS, 2.2),
    "RRTConnect": ("#0072B2", "RRT-Connect, simplified, restarted", 1.1),
    "AORRTC": ("#009E73", "AORRTC", 1.1),
    "RRTstar": ("#7A7A7A", "RRT*", 1.1),
    "BITstar": ("#CC79A7", "BIT*", 1.1),
}
_COLUMNS = 4
_LEAST_EXCESS = 0.002  # where the panels begin
_ROUNDING = 1e-5  # of costs in a history


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names = ["single door"] if smoke else list(SCENES)
    seeds = [seed] if smoke else list(range(seed, seed + NUM_STARTS))
    largest, improve = (0.5, 0.2) if smoke else (LARGEST_LIMIT, IMPROVE_SECONDS)
    variants = [(name, start) for name in names for start in seeds]
    trials = [race(*variant, largest, improve) for variant in tqdm(variants, desc="race", delay=3, disable=None)]
    return {
        "plr_bytes": PLR_BYTES,
        "seeds": seeds,
        "planners": list(PLANNERS),
        "limit": {"factor": LIMIT_FACTOR, "least": min(LEAST_LIMIT, largest), "largest": largest},
        "improve_seconds": improve,
        "summary": [summary([entry for entry in trials if entry["scene"] == name]) for name in names],
        "trials": trials,
    }


def race(name: str, seed: int, largest_limit: float, improve_seconds: float) -> dict[str, Any]:
    """All planners on one variant of a scene."""
    problem = scenes.perturbed(SCENES[name](), seed)
    bound = lower_bound(problem)
    built = build(problem, PLR)
    ours = ours_of(problem, built.heuristic, improve_seconds)
    limit = float(np.clip(LIMIT_FACTOR * ours["seconds"], min(LEAST_LIMIT, largest_limit), largest_limit))
    build_seconds = {"seconds_oracle": round(built.oracle_seconds, 4), "seconds_plr": round(built.plr_seconds, 4)}
    return {
        "scene": name,
        "seed": seed,
        "lower_bound": round(bound, 6),
        "limit": round(limit, 3),
        "ours": {**build_seconds, **ours},
        "ompl": {planner: trial(problem, planner, seed, limit, ours["cost"]) for planner in PLANNERS},
    }


def ours_of(problem: Problem, heuristic: HeuristicFn | None, improve_seconds: float) -> dict[str, Any]:
    """BL's first path, shortened, in median seconds of several runs after one to warm up; then better ones."""
    plan(problem, heuristic, BLOptions())
    runs = [plan(problem, heuristic, BLOptions()) for _ in range(NUM_RUNS)]
    solution = runs[0][0]
    if not solution.solved:
        raise RuntimeError(f"BL did not set a cost for the others to reach: {solution.status}.")
    # No path costs as little as the bound of straight lines, so that this goes on until the time is over.
    improved, _ = plan(problem, heuristic, BLOptions(cost_factor=1e-9, time_limit=improve_seconds))
    return {
        "seconds": round(float(np.median([seconds for _, seconds in runs])), 5),
        "nodes": solution.stats.num_nodes,
        "cost": round(solution.cost, 9),
        "valid": is_valid(problem, solution),
        "improved_cost": round(improved.cost, 9) if improved.solved else None,
        "improved_valid": is_valid(problem, improved),
        **history_of(improved),
    }


def trial(problem: Problem, planner: str, seed: int, limit: float, target: float) -> dict[str, Any]:
    """One trial of one of OMPL's planners."""
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


def best_of(entry: dict[str, Any], factor: float = 1.0) -> tuple[str | None, float]:
    """OMPL's first planner to a path of so many times BL's cost at most, and when; None and the limit if none."""
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
    ours = np.array([entry["ours"]["seconds"] for entry in entries])
    built = np.array([entry["ours"]["seconds_oracle"] + entry["ours"]["seconds_plr"] for entry in entries])
    result = {"scene": entries[0]["scene"], "variants": len(entries), "ours": float(np.median(ours))}
    for name, factor in (("same_cost", 1.0), ("cost_5_percent_more", 1.05)):
        best = [best_of(entry, factor) for entry in entries]
        winners = [winner for winner, _ in best if winner]
        times = np.array([seconds for _, seconds in best])
        result[name] = {
            "best": float(np.median(times)),
            "winners": winners,
            "at_least": 2 * len(winners) <= len(entries),
            "ratio": float(np.median(times / ours)),
            "ratio_with_plr": float(np.median(times / (ours + built))),
        }
    return result


def by_scene(results: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    names = dict.fromkeys(entry["scene"] for entry in results["trials"])
    return {name: [entry for entry in results["trials"] if entry["scene"] == name] for name in names}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """The table as text, and cost over time."""
    tables = {
        "Seconds to a path that costs no more than BL's": race_table(results),
        "Medians over the variants of a scene": summary_table(results),
        "Seconds to any path": first_paths_table(results),
    }
    text = "\n".join(f"{title}\n\n{table}" for title, table in tables.items())
    num_paths, num_invalid = count_paths(results)
    text += f"\n{num_paths} paths put through validate, {num_invalid} of them not valid.\n"
    (output / "race.txt").write_text(text, encoding="utf-8")
    print(text)
    figure = draw_figure(results)
    figure.savefig(output / "race.png", dpi=150)
    return [output / "race.txt", output / "race.png"]


def race_table(results: dict[str, Any]) -> str:
    """Seconds to BL's cost, variant by variant."""
    rows = [["scene", "start", "BL s", "cost / bound", "PLR s", *results["planners"]]]
    for entry in results["trials"]:
        ours = entry["ours"]
        times = [entry["ompl"][planner]["seconds"] for planner in results["planners"]]
        rows.append(
            [
                entry["scene"],
                f"{entry['seed']}",
                f"{ours['seconds']:.3f}",
                f"{ours['cost'] / entry['lower_bound']:.3f}",
                f"{ours['seconds_plr']:.2f}",
                *(f"> {entry['limit']:.1f}" if seconds is None else f"{seconds:.3f}" for seconds in times),
            ]
        )
    return aligned(rows, numbers=len(rows[0]) - 2)


def summary_table(results: dict[str, Any]) -> str:
    """Medians a scene: seconds of OMPL's best planner over BL's, to the same cost and to 5 % more."""
    head = ["scene", "BL s", "best s", "best / BL", "with PLR build", "best s to 5 % more", "best / BL"]
    rows = [[*head, "first at the same cost"]]
    for total in results["summary"]:
        same, near = total["same_cost"], total["cost_5_percent_more"]
        more, more_near = ("> " if each["at_least"] else "" for each in (same, near))
        rows.append(
            [
                total["scene"],
                f"{total['ours']:.3f}",
                f"{more}{same['best']:.3f}",
                f"{more}{same['ratio']:.3g}",
                f"{more}{same['ratio_with_plr']:.3g}",
                f"{more_near}{near['best']:.3f}",
                f"{more_near}{near['ratio']:.3g}",
                ", ".join(dict.fromkeys(same["winners"])) or "none",
            ]
        )
    return aligned(rows, numbers=len(rows[0]) - 1)


def first_paths_table(results: dict[str, Any]) -> str:
    """Median seconds to any path at all, and how often there was one."""
    rows = [["scene", *results["planners"]]]
    for name, entries in by_scene(results).items():
        cells = []
        for planner in results["planners"]:
            times = [entry["ompl"][planner]["first_path_seconds"] for entry in entries]
            found = [seconds for seconds in times if seconds is not None]
            median = f"{np.median(found):.3f}" if found else "-"
            cells.append(f"{median} ({len(found)}/{len(times)})")
        rows.append([name, *cells])
    return aligned(rows, numbers=len(results["planners"]))


def count_paths(results: dict[str, Any]) -> tuple[int, int]:
    """Paths that were checked, and those that were not valid."""
    checks = []
    for entry in results["trials"]:
        checks += [entry["ours"]["valid"], entry["ours"]["improved_valid"]]
        checks += [attempt["valid"] for attempt in entry["ompl"].values()]
    return sum(valid is not None for valid in checks), sum(valid is False for valid in checks)


def draw_figure(results: dict[str, Any]) -> Figure:
    """Cost over time, one panel a scene, one line a planner and variant."""
    groups = by_scene(results)
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
    return figure


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
    """Cost of each planner's best path so far, to the end of its trial; a dot where it reached BL's cost."""
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


def excess_of(costs: list[float], bound: float) -> Float[np.ndarray, "n"]:
    return np.maximum(np.array(costs) / bound - 1, _LEAST_EXCESS)


if __name__ == "__main__":
    run("race", "The race of Table II: OMPL's planners to a path as good as BL's, and cost over time.", compute, draw)
