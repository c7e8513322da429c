"""Table I of the paper: bytes and error of PLRs built from the exact distance and from PRM*, and of PRM* itself.

Beside the paper's planes stand cones. Every error is against the exact visibility graph, over the same random free
points. Seeds change the roadmap's samples and the pattern in which construction samples a cell.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Int
from tqdm import tqdm

from experiments._runner import run
from plr_jax import (
    BuildOptions,
    CellFit,
    Problem,
    Roadmap,
    VisibilityGraph,
    construct,
    cyclic_axis,
    maximum_depth,
    metrics,
    scenes,
)

NUM_POINTS = 1_000_000
NUM_ROADMAP_SAMPLES = 10_000
NUM_SEEDS = 5
# Far from the seeds of roadmaps and constructions, so that no error is measured where something was sampled.
POINT_SEED = 1_000

PAPER = [
    {"method": "PLR (VG)", "bytes": 30_240, "max": 0.018, "mean": 0.007},
    {"method": "PLR (PRM*)", "bytes": 30_240, "max": 0.134, "mean": 0.016},
    {"method": "PRM*", "bytes": 4_412_000, "max": 1.472, "mean": 0.024},
]


def cyclic_axis_from_y(fit: CellFit) -> Int[np.ndarray, " cells"]:
    """The axes in turn, the last one first: of an odd depth, ``y`` then gets the larger half."""
    return (fit.cells.depth.sum(axis=1) + 1) % fit.cells.dim


def papers_own(depth: int) -> dict[str, dict[str, Any]]:
    """The paper's configuration, with either axis first."""
    in_turn, from_y = (
        {"max_depth": depth, "options": BuildOptions(should_split=maximum_depth, split=split)}
        for split in (cyclic_axis, cyclic_axis_from_y)
    )
    return {f"axes in turn, depth {depth}": in_turn, f"axes in turn from y, depth {depth}": from_y}


def ours(*budgets: int) -> dict[str, dict[str, Any]]:
    """The default rules under budgets of bytes."""
    return {f"best axis, {budget:,} bytes": {"max_bytes": budget} for budget in budgets}


def cones(*budgets: int) -> dict[str, dict[str, Any]]:
    """Leaves of another kind under budgets of bytes."""
    return {f"cones, {budget:,} bytes": {"leaf": "cone", "max_bytes": budget} for budget in budgets}


def smoothed(budget: int) -> dict[str, dict[str, Any]]:
    """For a noisy oracle: samples from a quarter of a cell's width around it average the noise of the roadmap."""
    return {f"best axis, margin 1/4, {budget:,} bytes": {"max_bytes": budget, "options": BuildOptions(margin=0.25)}}


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_samples, num_seeds = (1_000, 100, 2) if smoke else (NUM_POINTS, NUM_ROADMAP_SAMPLES, NUM_SEEDS)
    seeds = list(range(seed, seed + num_seeds))
    rows = []
    for name, problem, from_roadmap in (("maze", scenes.maze(), True), ("thin_maze", scenes.thin_maze(), False)):
        measured = _measure_scene(problem, seeds, num_points, num_samples if from_roadmap else 0, smoke)
        rows += [{"scene": name, **row} for row in measured]
    return {
        "points": num_points,
        "roadmap_samples": num_samples,
        "seeds": seeds,
        "paper": PAPER,
        "rows": rows,
    }


def _measure_scene(
    problem: Problem, seeds: list[int], num_points: int, num_samples: int, smoke: bool
) -> list[dict[str, Any]]:
    """Rows of one scene; those that need a roadmap only if it gets samples."""
    workspace, goal = problem.workspace, problem.goals[0]
    exact = VisibilityGraph(workspace, goal)
    points = workspace.sample_free(num_points, POINT_SEED + seeds[0])
    distance = exact(points)
    fixed, budgets = (papers_own(3), (128,)) if smoke else (papers_own(9), (1_024, 2_048, 6_144))
    cone_budgets = (128,) if smoke else (256, 512, 1_024)
    table: dict[tuple[str, str], list[dict[str, Any]]] = {}

    def measure(method: str, configuration: str, seed: int, build: Callable[[], Any]) -> None:
        began = time.perf_counter()
        approximation = build()
        seconds = time.perf_counter() - began
        report = metrics.error_map(approximation, lambda _: distance, points)
        entry = {
            "seed": seed,
            "bytes": approximation.num_bytes,
            "max": report.max,
            "mean": report.mean,
            "quantile_99": report.quantiles[0.99],
            "max_at": list(report.max_at),
            "unanswered": report.num_unanswered,
            "build_seconds_indicative": round(seconds, 2),
        }
        table.setdefault((method, configuration), []).append(entry)

    for seed in tqdm(seeds, desc="seeds", delay=3, disable=None):
        for name, options in {**fixed, **ours(*budgets), **cones(*cone_budgets)}.items():
            measure("PLR (VG)", name, seed, partial(construct, exact, workspace.bounds, seed=seed, **options))
        if num_samples:
            make_roadmap = partial(Roadmap.from_workspace, workspace, goal, num_samples, seed=seed)
            roadmap = make_roadmap()
            of_roadmap = {**fixed, **smoothed(128 if smoke else 1_536), **ours(*budgets[-2:])}
            for name, options in of_roadmap.items():
                measure("PLR (PRM*)", name, seed, partial(construct, roadmap, workspace.bounds, seed=seed, **options))
            measure("PRM*", f"{num_samples:,} samples", seed, make_roadmap)
    return [{"method": method, "configuration": name, "seeds": entry} for (method, name), entry in table.items()]


if __name__ == "__main__":
    run("table1", "Table I: bytes, max and mean error of PLRs and of the roadmap.", compute)
