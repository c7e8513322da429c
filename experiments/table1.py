"""Table I of the paper: bytes and errors of PLRs of the exact distance (VG) and of PRM*, and of PRM* itself.

Beside the paper's planes stand cones. Every error is against the exact visibility graph, over the same random free
points. Seeds change the roadmap's samples and the pattern in which construction samples a cell.

The paper does not publish its maze. Three mazes here have the same six walls: 0.04 thick (``maze``), 0.01 thick
(``thin_maze``), and 0.01 thick around the nearest borders of the cells of depth 9, so that no cell has free points on
both sides of a wall. Other rows vary the goal, the samples of a cell, and the vertex that a query of a roadmap takes.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import shapely
from jaxtyping import Int

from experiments._nearest_vertex import NearestVertex
from experiments._runner import run
from plr_jax import BuildOptions, Roadmap, VisibilityGraph, Workspace, construct, metrics, scenes
from plr_jax.plr import CellFit, cyclic_axis, maximum_depth

NUM_POINTS = 250_000
NUM_ROADMAP_SAMPLES = 10_000
NUM_SEEDS = 5
# Far from the seeds of roadmaps and constructions, so that no error is measured where something was sampled.
POINT_SEED = 1_000
CELLS = 32, 16  # of depth 9, if the axes take turns
CLEARANCE = 0.0015  # from walls, in widths of the map: gives the paper's mean error
GOAL, OTHER_GOAL = (0.06, 0.07), (0.93, 0.95)
OWN_SCENES = "maze", "thin_maze"  # of Table I; others explain differences

PAPER = [
    {"method": "PLR (VG)", "bytes": 30_240, "max": 0.018, "mean": 0.007},
    {"method": "PLR (PRM*)", "bytes": 30_240, "max": 0.134, "mean": 0.016},
    {"method": "PRM*", "bytes": 4_412_000, "max": 1.472, "mean": 0.024},
]


def walls_between_cells() -> Workspace:
    """The walls of ``thin_maze``, moved to the nearest borders of cells."""
    walls = []
    for wall in scenes.thin_maze().workspace.obstacles:
        lo, hi = np.rint(np.reshape(wall.bounds, (2, 2)) * CELLS) / CELLS
        half = np.where(lo == hi, 0.005, 0.0)
        walls.append(shapely.box(*(lo - half), *(hi + half)))
    return Workspace(((0.0, 0.0), (1.0, 1.0)), walls)


SCENES: dict[str, tuple[Callable[[], Workspace], tuple[float, float]]] = {
    "maze": (lambda: scenes.maze().workspace, GOAL),
    "maze, another goal": (lambda: scenes.maze().workspace, OTHER_GOAL),
    "thin_maze": (lambda: scenes.thin_maze().workspace, GOAL),
    "walls between cells": (walls_between_cells, GOAL),
}


def cyclic_axis_from_y(fit: CellFit) -> Int[np.ndarray, " cells"]:
    """The axes in turn, the last one first: of an odd depth, ``y`` then gets the larger half."""
    return (fit.cells.depth.sum(axis=1) + 1) % fit.cells.dim


def papers_own(depth: int) -> dict[str, dict[str, Any]]:
    """The paper's configuration: either axis first, and fewer samples in a cell."""

    def options(split: Any = cyclic_axis, num_samples: int | None = None) -> dict[str, Any]:
        rules = BuildOptions(should_split=maximum_depth, split=split, num_samples=num_samples)
        return {"max_depth": depth, "options": rules}

    name = f"axes in turn, depth {depth}"
    few = {f"{name}, {number} samples a cell": options(num_samples=number) for number in (16, 4)}
    return {name: options(), f"axes in turn from y, depth {depth}": options(cyclic_axis_from_y), **few}


def ours(*budgets: int) -> dict[str, dict[str, Any]]:
    """The default rules under budgets of bytes."""
    return {f"best axis, {budget:,} bytes": {"max_bytes": budget} for budget in budgets}


def cones(*budgets: int) -> dict[str, dict[str, Any]]:
    """Leaves of another kind under budgets of bytes."""
    return {f"cones, {budget:,} bytes": {"leaf": "cone", "max_bytes": budget} for budget in budgets}


def smoothed(budget: int) -> dict[str, dict[str, Any]]:
    """For a noisy oracle: samples from a quarter of a cell's width around it average the noise of the roadmap."""
    return {f"best axis, margin 1/4, {budget:,} bytes": {"max_bytes": budget, "options": BuildOptions(margin=0.25)}}


class Scene:
    """A maze, and the rows of the table about it.

    Attributes:
        rows: By method and configuration: a function from a seed to an approximation of the distance.
    """

    def __init__(self, name: str, num_points: int, num_samples: int, depth: int = 9):
        make_workspace, goal = SCENES[name]
        workspace = make_workspace()
        exact, bounds = VisibilityGraph(workspace, goal), workspace.bounds
        self.points = workspace.sample_free(num_points, POINT_SEED)
        self.distance = exact(self.points)
        grown = [wall.buffer(CLEARANCE, join_style="mitre") for wall in workspace.obstacles]
        keeps_clear = VisibilityGraph(Workspace(bounds, grown), goal)
        roadmap = cache(lambda seed: Roadmap.from_workspace(workspace, goal, num_samples, seed=seed))
        own = papers_own(depth)
        in_turn = next(iter(own))
        self.rows: dict[tuple[str, str], Callable[[int], Any]] = {}

        def build(oracle: Callable[[int], Any], limits: dict[str, Any], seed: int) -> Any:
            return construct(oracle(seed), bounds, seed=seed, **limits)

        def add(method: str, oracle: Callable[[int], Any], configurations: dict[str, dict[str, Any]]) -> None:
            for configuration, limits in configurations.items():
                self.rows[f"PLR ({method})", configuration] = partial(build, oracle, limits)

        best = ours(1_024, 2_048, 6_144) | cones(256, 512, 1_024) if name in OWN_SCENES else {}
        add("VG", lambda seed: exact, own | best)
        if goal == OTHER_GOAL:
            return
        add(f"VG, {CLEARANCE} clear of walls", lambda seed: keeps_clear, {in_turn: own[in_turn]})
        for vertex, oracle in {
            "best visible vertex": roadmap,
            "nearest visible vertex": lambda seed: NearestVertex(roadmap(seed)),
            "nearest vertex": lambda seed: NearestVertex(roadmap(seed), sees=False),
        }.items():
            best = smoothed(1_536) | ours(2_048, 6_144) if oracle is roadmap and name == "maze" else {}
            add(f"PRM*, {vertex}", oracle, {each: own[each] for each in list(own)[: 2 if best else 1]} | best)
            self.rows[f"PRM*, {vertex}", f"{num_samples:,} samples"] = oracle

    def measure(self, method: str, configuration: str, seed: int) -> dict[str, Any]:
        """Return bytes and errors of one row for one seed."""
        approximation = self.rows[method, configuration](seed)
        report = metrics.error_map(approximation, lambda _: self.distance, self.points)
        entry = {"seed": seed, "bytes": approximation.num_bytes, "max": report.max, "mean": report.mean}
        return entry | {"unanswered": report.num_unanswered}


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_samples, num_seeds = (1_000, 100, 2) if smoke else (NUM_POINTS, NUM_ROADMAP_SAMPLES, NUM_SEEDS)
    seeds = list(range(seed, seed + num_seeds))
    rows = []
    for name in list(SCENES)[:1] if smoke else SCENES:
        scene = Scene(name, num_points, num_samples, 3 if smoke else 9)
        for method, configuration in list(scene.rows)[:: 8 if smoke else 1]:
            found = [scene.measure(method, configuration, each) for each in seeds]
            rows.append({"scene": name, "method": method, "configuration": configuration, "seeds": found})
            print(*rows[-1].values(), flush=True)
    return {"points": num_points, "roadmap_samples": num_samples, "seeds": seeds, "paper": PAPER, "rows": rows}


if __name__ == "__main__":
    run("table1", "Table I: bytes, max and mean error of PLRs and of the roadmap.", compute)
