"""Optimizing trajectories: what descent on the way points makes of BL's paths, and of random guesses in a maze.

Every scene of Table II is solved by BL under PLRs, its path already shortened, and then optimized twice in a row:
the second time is the warm one. Every path is checked by ``validate``. In the maze, a point robot has a batch of
guesses: random way points under the guide of a PLR, and shortest paths in sparse roadmaps, shaken.
"""

import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from experiments._planning import PLR, PLR_BYTES, SCENES, SMOKE_BYTES, lower_bound, solve
from experiments._results import run
from experiments._tables import aligned
from plr_jax import (
    OptimizedPaths,
    Problem,
    Roadmap,
    VisibilityGraph,
    construct,
    optimize_paths,
    plot,
    scenes,
    validate,
)

SHOWN = "four rooms 4"
NUM_GUESSES, NUM_WAY_POINTS, NUM_ROADMAP_SAMPLES, SHAKE = 64, 6, 300, 0.01


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names, plr_bytes = ([SHOWN], SMOKE_BYTES) if smoke else (list(SCENES), PLR_BYTES)
    return {
        "plr_bytes": plr_bytes,
        "rows": [scene_row(name, plr_bytes, seed, smoke) for name in names],
        "guesses": guess_rows(plr_bytes, seed, 2 if smoke else NUM_GUESSES, smoke),
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


def guess_rows(plr_bytes: int, seed: int, num_guesses: int, smoke: bool) -> list[dict[str, Any]]:
    """Batches of guesses in the maze: how many end valid, and how long they are."""
    problem, rng = scenes.maze(), np.random.default_rng(seed)
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(oracle, problem.workspace.bounds, max_bytes=plr_bytes)
    points = rng.uniform(0, 1, (num_guesses, NUM_WAY_POINTS, 1, 2))
    random = np.stack([np.concatenate([problem.starts[None], each, problem.goals[None]]) for each in points])
    exact = float(oracle(problem.starts)[0])
    rows = []
    for name, paths, fns in (
        ("random way points", random, None),
        ("random way points, guided by a PLR", random, [plr]),
        ("shortest paths of sparse roadmaps, shaken", roadmap_paths(problem, rng, num_guesses), None),
    ):
        optimized(problem, paths, seed, smoke, distance_fns=fns)
        result, seconds = optimized(problem, paths, seed, smoke, distance_fns=fns)
        rows.append({"guesses": name, "seconds": seconds, **summary(result, exact)})
    return rows


def roadmap_paths(problem: Problem, rng: np.random.Generator, num: int) -> Float[np.ndarray, "num steps 1 2"]:
    """Shortest paths in the first roadmaps that have one, as many steps each, the inner ones moved at random."""
    workspace, goal = problem.workspace, problem.goals[0]
    paths = []
    for seed in itertools.count():
        if len(paths) == num:
            break
        roadmap = Roadmap.from_workspace(workspace, goal, NUM_ROADMAP_SAMPLES, seed=seed)
        path = roadmap.shortest_path(problem.starts[0])
        if not len(path):
            continue
        paths.append(np.concatenate([path[:1], path[1:-1] + rng.normal(0, SHAKE, path[1:-1].shape), path[-1:]]))
    longest = max(map(len, paths))
    return np.stack([np.concatenate([path, path[-1:].repeat(longest - len(path), axis=0)]) for path in paths])[
        :, :, None
    ]


def summary(result: OptimizedPaths, exact: float) -> dict[str, Any]:
    ratios = np.sort(result.costs[result.valid]) / exact
    return {
        "num": len(result.valid),
        "num_valid": int(result.valid.sum()),
        "best_over_exact": float(ratios[0]) if len(ratios) else None,
        "median_over_exact": float(np.median(ratios)) if len(ratios) else None,
    }


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    text = output / "trajectory.txt"
    text.write_text(f"{scene_table(results['rows'])}\n{guess_table(results['guesses'])}", encoding="utf-8")
    figure = Figure(figsize=(10.4, 5.6), layout="constrained", facecolor="white")
    row = next(row for row in results["rows"] if row["scene"] == SHOWN)
    axes = figure.subplots(1, 2)
    for ax, name in zip(axes, ("before", "after"), strict=True):
        plot.plot_path(SCENES[SHOWN](), np.array(row[name]), ax)
        ax.set_title(f"{name}: {row['cost_over_bound'][name]:.4f} of the bound", fontsize=10)
    picture = output / "trajectory.png"
    plot.save(axes[0], picture)
    return [text, picture]


def scene_table(rows: list[dict[str, Any]]) -> str:
    head = ["scene", "before / bound", "after / bound", "valid", "clearance", "s", "s, first"]
    body = [
        [
            row["scene"],
            *(f"{row['cost_over_bound'][name]:.5f}" for name in ("before", "after")),
            "yes" if row["valid"] else "no",
            f"{row['clearance']['after']:.1e}",
            *(f"{row[name]:.2f}" for name in ("seconds", "seconds_first")),
        ]
        for row in rows
    ]
    return aligned([head, *body], 6)


def guess_table(rows: list[dict[str, Any]]) -> str:
    head = ["guesses in the maze", "valid", "best / exact", "median / exact", "s"]
    body = [
        [
            row["guesses"],
            f"{row['num_valid']}/{row['num']}",
            *("-" if row[name] is None else f"{row[name]:.5f}" for name in ("best_over_exact", "median_over_exact")),
            f"{row['seconds']:.2f}",
        ]
        for row in rows
    ]
    return aligned([head, *body], 4)


if __name__ == "__main__":
    run("trajectory", "Optimize BL's paths on the scenes of Table II, and random guesses in a maze.", compute, draw)
