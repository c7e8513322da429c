"""Pairs of points of a map, and their exact distances; and the published ones of the arena.

For the test, each of 5,000 goals has 200 points of its own: goals and points are independent and uniform in free
space, no point is in two pairs but the goals, and the pairs come in random order. The exact oracle of each goal tells
the distances. Other goals and points, likewise drawn, are for training and for the choice of settings.
"""

import csv
import os
from functools import cache
from pathlib import Path

import numpy as np

from experiments.benchmarks._maps import load_map
from experiments.summaries._summary import Pairs
from plr_jax import VisibilityGraph

_SMOKE_GOALS, _SMOKE_POINTS = 20, 50
_COUNTS = {"training": (5_000, 200), "choice": (2_000, 10), "test": (5_000, 200)}  # goals, and points of each
_PUBLISHED = "polyanya_arena/arena_euclid.csv"
_SEEDS = {"training": 10_000, "choice": 20_000, "test": 30_000}


@cache
def exact_of(name: str) -> VisibilityGraph | None:
    """The exact oracle of a map; None where its data are absent."""
    found = load_map(name)
    return None if found is None else VisibilityGraph(*found)


@cache
def pairs_of(name: str, use: str, seed: int, smoke: bool) -> Pairs:
    """Pairs of a map for training, for the choice of settings, or for the test."""
    goals, points = (_SMOKE_GOALS, _SMOKE_POINTS) if smoke else _COUNTS[use]
    exact = exact_of(name)
    assert exact is not None
    return draw_pairs(exact, goals, points, _SEEDS[use] + seed)


def draw_pairs(exact: VisibilityGraph, goals: int, points: int, seed: int) -> Pairs:
    """Random free pairs, some path between which there is."""
    first, second, order = (int(s) for s in np.random.SeedSequence(seed).generate_state(3))
    y = exact.workspace.sample_free(goals, first)
    x = exact.workspace.sample_free(goals * points, second).reshape(goals, points, 2)
    distance = np.stack([exact.with_goal(goal)(own) for goal, own in zip(y, x, strict=True)]).ravel()
    pairs = Pairs(x.reshape(-1, 2), np.repeat(y, points, axis=0), distance)
    joined = np.random.default_rng(order).permutation(np.flatnonzero(np.isfinite(distance)))
    return Pairs(*(column[joined] for column in pairs))


def published(name: str) -> Pairs | None:
    """The published lengths of a map; None where there are none."""
    if name != "arena":
        return None
    with open(Path(os.environ["PLR_JAX_DATA"]) / _PUBLISHED, encoding="utf-8") as file:
        columns = ("start_x", "start_y", "goal_x", "goal_y", "euclid_length")
        rows = np.array([[float(row[name]) for name in columns] for row in csv.DictReader(file)])
    return Pairs(rows[:, :2], rows[:, 2:4], rows[:, 4])
