"""Why errors of Table I differ from the paper's: other walls, samples, goals, and vertices that queries take.

Partitions of depth 9 whose axes take turns have 32 x 16 cells. Three mazes have the same six walls: 0.04 thick
(``maze``), 0.01 thick (``thin_maze``), and 0.01 thick around the nearest borders of cells, so that no cell has free
points on both sides of a wall. Errors are against the exact distance.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from experiments._nearest_vertex import NearestVertex
from experiments._runner import run
from experiments.table1 import NUM_ROADMAP_SAMPLES, NUM_SEEDS, POINT_SEED
from plr_jax import BuildOptions, DistanceFn, Roadmap, VisibilityGraph, Workspace, construct, metrics, scenes
from plr_jax.plr import cyclic_axis, least_squares, maximum_depth
from plr_jax.plr.sampling import FitRule, OfSamples, Pattern, Planes

NUM_POINTS = 200_000
CELLS = 32, 16
ALL_SAMPLES = 192  # of a cell, the default
CLEARANCE = 0.0015  # of the width of the map
GOAL, OTHER_GOAL = (0.06, 0.07), (0.93, 0.95)


def walls_between_cells() -> Workspace:
    """The walls of ``thin_maze``, moved to the nearest borders of cells."""
    walls = []
    for wall in scenes.thin_maze().workspace.obstacles:
        lo, hi = np.rint(np.reshape(wall.bounds, (2, 2)) * CELLS) / CELLS
        half = np.where(lo == hi, 0.005, 0.0)
        walls.append(shapely.box(*(lo - half), *(hi + half)))
    return Workspace(((0.0, 0.0), (1.0, 1.0)), walls)


MAZES: dict[str, Callable[[], Workspace]] = {
    "0.04": lambda: scenes.maze().workspace,
    "0.01": lambda: scenes.thin_maze().workspace,
    "0.01, between cells": walls_between_cells,
}
EXACT, CLEAR = "exact", f"exact, {CLEARANCE} clear of walls"
BEST, NEAREST_VISIBLE, NEAREST = (
    f"PRM*, {vertex} vertex" for vertex in ("best visible", "nearest visible", "nearest")
)


class Setting(NamedTuple):
    """A row of the table: walls and distance by name, samples of a cell that the fit uses, and the goal."""

    walls: str
    distance: str
    samples: int = ALL_SAMPLES
    goal: tuple[float, float] = GOAL


THICK, THIN, BETWEEN = MAZES
SETTINGS = [
    *(Setting(walls, EXACT) for walls in MAZES),
    Setting(THICK, EXACT, goal=OTHER_GOAL),
    *(Setting(walls, EXACT, samples) for walls in (THICK, BETWEEN) for samples in (16, 4)),
    Setting(BETWEEN, CLEAR),
    *(Setting(walls, distance) for walls in MAZES for distance in (BEST, NEAREST_VISIBLE, NEAREST)),
]


def few_samples(number: int, seed: int) -> FitRule:
    """Fit each cell's plane to a few of its samples, chosen at random."""
    rng = np.random.default_rng(seed)

    def fit(pattern: Pattern, value: OfSamples, weight: OfSamples) -> Planes:
        order = np.where(weight > 0, rng.random(weight.shape), np.inf)
        last = np.sort(order, axis=1)[:, number - 1 : number]
        return least_squares(pattern, value, weight * (order <= last))

    return fit


@cache
def exact_distance(walls: str, goal: tuple[float, float], margin: float = 0.0) -> VisibilityGraph:
    """The exact distance in a maze whose walls are grown by a margin."""
    workspace = MAZES[walls]()
    grown = [wall.buffer(margin, join_style="mitre") for wall in workspace.obstacles]
    return VisibilityGraph(Workspace(workspace.bounds, grown), goal)


@cache
def roadmap_of(walls: str, goal: tuple[float, float], num_vertices: int, seed: int) -> Roadmap:
    return Roadmap.from_workspace(MAZES[walls](), goal, num_vertices, seed=seed)


@cache
def free_points(walls: str, num_points: int) -> Float[np.ndarray, "n 2"]:
    return MAZES[walls]().sample_free(num_points, POINT_SEED)


def measure(setting: Setting, seed: int, num_points: int, num_vertices: int) -> dict[str, Any]:
    """Return the errors of a distance, and of its PLR of depth 9."""
    walls, distance, samples, goal = setting
    if distance in (EXACT, CLEAR):
        oracle: DistanceFn = exact_distance(walls, goal, 0.0 if distance == EXACT else CLEARANCE)
    else:
        oracle = roadmap_of(walls, goal, num_vertices, seed)
        oracle = oracle if distance == BEST else NearestVertex(oracle, sees=distance == NEAREST_VISIBLE)
    rule = least_squares if samples == ALL_SAMPLES else few_samples(samples, seed)
    options = BuildOptions(should_split=maximum_depth, split=cyclic_axis, compute_coefficients=rule)
    plr = construct(oracle, ((0.0, 0.0), (1.0, 1.0)), max_depth=9, seed=seed, options=options)
    x = free_points(walls, num_points)
    truth = exact_distance(walls, goal)(x)
    own, of_plr = (metrics.error_map(each, lambda _: truth, x) for each in (oracle, plr))
    return {"max": own.max, "mean": own.mean, "plr_max": of_plr.max, "plr_mean": of_plr.mean}


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_vertices, num_seeds = (1_000, 100, 1) if smoke else (NUM_POINTS, NUM_ROADMAP_SAMPLES, NUM_SEEDS)
    seeds = range(seed, seed + num_seeds)
    rows = []
    for setting in SETTINGS[-1:] if smoke else SETTINGS:
        rows.append({**setting._asdict(), "seeds": [measure(setting, s, num_points, num_vertices) for s in seeds]})
        print(rows[-1], flush=True)
    return {"points": num_points, "vertices": num_vertices, "rows": rows}


if __name__ == "__main__":
    run("differences", __doc__, compute)
