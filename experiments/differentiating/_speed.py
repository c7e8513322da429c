"""Seconds of distances among traced polygons and of their gradients, beside ``VisibilityGraph`` of the same maps.

Times are the least of many calls, CPU times their mean. Finite differences are the number of distances that they
take, times the seconds that a new oracle and its distances take.
"""

from typing import Any

import jax
import numpy as np

from experiments.differentiating._common import compiled, least, mean_of_finite
from plr_jax import VisibilityGraph, Workspace, polygon_distance

CORNERS, POINTS = (32, 64, 128), 1_000
MAPS, POINTS_A_MAP = 1_000, 10
_BOUNDS = ((0.0, 0.0), (1.0, 1.0))
_SIDES = 4  # corners of a polygon


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    turns = 2 if smoke else 100
    rows = [_row(corners, seed, turns) for corners in ((16,) if smoke else CORNERS)]
    maps = 4 if smoke else MAPS
    rng = np.random.default_rng(seed)
    polygons = np.stack([boxes(rng, 2 if smoke else 8) for _ in range(maps)])
    goals, x = np.full((maps, 2), 0.01, np.float32), rng.random((maps, POINTS_A_MAP, 2), np.float32)
    call, seconds = compiled(jax.vmap(_distances), polygons, goals, x)
    wall, cpu = least(lambda: call(polygons, goals, x), max(turns // 10, 1))
    shape = {"maps": maps, "corners": polygons.shape[1] * _SIDES, "points a map": POINTS_A_MAP}
    return {"rows": rows, "vmap": shape | {"seconds": wall, "cpu_seconds": cpu, "compile_seconds": seconds}}


def _row(corners: int, seed: int, turns: int) -> dict[str, Any]:
    polygons = boxes(np.random.default_rng(seed), corners // _SIDES)
    workspace = Workspace(_BOUNDS, list(polygons.astype(float)))
    goal, *x = workspace.sample_free(POINTS + 1, seed=seed).astype(np.float32)
    arguments = polygons, goal, np.array(x)
    forward, forward_compile = compiled(_distances, *arguments)
    both, both_compile = compiled(jax.value_and_grad(_mean, (0, 1, 2)), *arguments)
    times = {"forward": least(lambda: forward(*arguments), turns), "both": least(lambda: both(*arguments), turns)}
    oracle, few = VisibilityGraph(workspace, goal), max(turns // 10, 1)
    x = np.array(x, float)
    new = least(lambda: VisibilityGraph(Workspace(_BOUNDS, list(polygons.astype(float))), goal)(x), few)
    query, derivatives = least(lambda: oracle(x), few), least(lambda: oracle.vertex_gradient(x), few)
    num_distances = 2 * (polygons.size + 2)  # central differences by vertices and goal
    return {
        "corners": corners,
        "forward_ms": 1e3 * times["forward"].wall,
        "forward_cpu_ms": 1e3 * times["forward"].cpu,
        "both_ms": 1e3 * times["both"].wall,
        "both_cpu_ms": 1e3 * times["both"].cpu,
        "forward_compile_seconds": forward_compile,
        "both_compile_seconds": both_compile,
        "oracle_ms": 1e3 * new.wall,
        "oracle_query_ms": 1e3 * query.wall,
        "oracle_vertex_gradient_ms": 1e3 * derivatives.wall,
        "oracle_finite_differences_ms": 1e3 * num_distances * new.wall,
    }


def _distances(polygons: Any, goal: Any, x: Any) -> Any:
    return polygon_distance(polygons, goal, bounds=_BOUNDS)(x)


def _mean(polygons: Any, goal: Any, x: Any) -> Any:
    return mean_of_finite(_distances(polygons, goal, x))


def boxes(rng: np.random.Generator, number: int) -> np.ndarray:
    """Return turned boxes ``(number, 4, 2)``, one in each of some cells of a grid in the unit square."""
    side = int(np.ceil(np.sqrt(number)))
    cells = rng.permutation(side**2)[:number]
    centers = (np.stack([cells % side, cells // side], axis=1) + rng.uniform(0.4, 0.6, (number, 2))) / side
    angle = rng.uniform(0, 2 * np.pi, (number, 1)) + np.array([0, 1.2, np.pi, np.pi + 1.2])
    around = np.stack([np.cos(angle), np.sin(angle)], axis=2)
    return (centers[:, None] + 0.39 / side * around).astype(np.float32)
