"""Optimizing trajectories: what descent on the way points makes of BL's paths.

Every scene of Table II is solved by BL under PLRs, its path already shortened, and then optimized twice in a row:
the second time is the warm one. Every path is checked by ``validate``.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments._planning import PLR, PLR_BYTES, SCENES, SMOKE_BYTES, lower_bound, solve
from experiments._runner import run
from plr_jax import (
    OptimizedPaths,
    Problem,
    optimize_paths,
    plot,
    validate,
)

SHOWN = "four rooms 4"


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names, plr_bytes = ([SHOWN], SMOKE_BYTES) if smoke else (list(SCENES), PLR_BYTES)
    return {
        "plr_bytes": plr_bytes,
        "rows": [scene_row(name, plr_bytes, seed, smoke) for name in names],
    }


def scene_row(name: str, plr_bytes: int, seed: int, smoke: bool) -> dict[str, Any]:
    """A scene as published: BL's path, and the optimized one."""
    problem = SCENES[name]()
    bound = lower_bound(problem)
    if not smoke:
        solve(problem, PLR)  # compiles
    solution, path = solve(problem, PLR, plr_bytes)
    path[[0, -1]] = problem.starts, problem.goals
    result, first = optimized(problem, path, seed, smoke)
    result, warm = optimized(problem, path, seed, smoke)
    before, after = validate(problem, path), validate(problem, result.paths[0])
    return {
        "scene": name,
        "bound": bound,
        "cost_over_bound": {"before": before.cost / bound, "after": after.cost / bound},
        "valid": after.valid,
        "ends_exact": bool((result.paths[0][[0, -1]] == [problem.starts, problem.goals]).all()),
        "clearance": {"before": before.clearance, "after": after.clearance},
        "seconds_plan": sum(solution.stats.seconds.values()),
        "seconds_first": first,
        "seconds": warm,
        **({"before": path.tolist(), "after": result.paths[0].tolist()} if name == SHOWN else {}),
    }


def optimized(
    problem: Problem, paths: Float[np.ndarray, "..."], seed: int, smoke: bool, **options: Any
) -> tuple[OptimizedPaths, float]:
    """The result, and its seconds."""
    if smoke:
        options |= {"num_retimings": 0, "num_iterations": 50}
    began = time.perf_counter()
    result = optimize_paths(problem, paths, seed=seed, **options)
    return result, time.perf_counter() - began


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    figure = Figure(figsize=(10.4, 5.6), layout="constrained", facecolor="white")
    row = next(row for row in results["rows"] if row["scene"] == SHOWN)
    axes = figure.subplots(1, 2)
    for ax, name in zip(axes, ("before", "after"), strict=True):
        plot.plot_path(SCENES[SHOWN](), np.array(row[name]), ax)
        ax.set_title(f"{name}: {row['cost_over_bound'][name]:.4f} of the bound", fontsize=10)
    picture = output / "trajectory.png"
    plot.save(axes[0], picture)
    return [picture]


if __name__ == "__main__":
    run("trajectory", "Optimize BL's paths on the scenes of Table II.", compute, draw)
