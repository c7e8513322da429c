"""Harder maps by gradients: obstacles move so that a start gets farther from a goal, on many maps under ``vmap``.

Each map has 8 obstacles. Gradient ascent moves each as a whole, by at most a radius from where it was. The result of
a map is the best of its steps. A step that covers the start or the goal, or nearly, or closes all paths, leads back
to the best. ``VisibilityGraph`` checks every result.
"""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from experiments.differentiating._common import compiled
from experiments.differentiating._speed import boxes
from plr_jax import VisibilityGraph, Workspace, polygon_distance

MAPS, OBSTACLES, STEPS = 1_000, 8, 100
RADIUS = 0.15  # of travel, in the unit square
STEP = 0.02  # length of the first step of the obstacle that moves most; later steps are shorter
ALLOWED = 1e-5
_BOUNDS = ((0.0, 0.0), (1.0, 1.0))
_START, _GOAL = (0.05, 0.05), (0.95, 0.95)
_CLEAR = 0.02  # around start and goal of the first maps
# Points around start and goal that stay free, so that walls do not touch start or goal.
_ANGLES = np.arange(8) * np.pi / 4
_PROBES = np.concatenate([end + 1e-3 * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1) for end in (_START, _GOAL)])


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    number, steps = (4, 3) if smoke else (MAPS, STEPS)
    polygons = first_maps(np.random.default_rng(seed), number)

    def run(polygons):
        return jax.vmap(lambda each: ascend(each, steps))(polygons)

    call, compile_seconds = compiled(run, polygons)
    began = time.perf_counter()
    first, longest, moves = map(np.asarray, jax.block_until_ready(call(polygons)))
    seconds = time.perf_counter() - began
    truth = np.array([_exact(each) for each in polygons + moves[:, :, None]])
    travel = np.linalg.norm(moves, axis=2)
    is_right = np.isfinite(truth) & (np.abs(truth - longest) <= ALLOWED) & (travel <= RADIUS + 1e-6).all(axis=1)
    ratio = truth / np.array([_exact(each) for each in polygons])
    return {
        "maps": number,
        "obstacles": OBSTACLES,
        "steps": steps,
        "radius": RADIUS,
        "seconds": seconds,
        "compile_seconds": compile_seconds,
        "steps_a_second": number * steps / seconds,
        "right": int(is_right.sum()),
        "largest_error": float(np.abs(truth - longest).max()),
        "largest_travel": float(travel.max()),
        "ratio": {"median": float(np.median(ratio)), "least": float(ratio.min()), "largest": float(ratio.max())},
        "first_error": float(np.abs(first * ratio - truth).max()),
    }


def first_maps(rng: np.random.Generator, number: int) -> np.ndarray:
    """Return maps ``(number, 8, 4, 2)`` whose starts reach their goals."""
    maps: list[np.ndarray] = []
    while len(maps) < number:
        polygons = boxes(rng, OBSTACLES)
        ends = Workspace(_BOUNDS, list(polygons.astype(float))).clearance(np.array([_START, _GOAL]))
        if (ends > _CLEAR).all():
            maps.append(polygons)
    return np.stack(maps)


def ascend(polygons: Any, steps: int) -> tuple[Any, Any, Any]:
    """Return the first distance, the longest one, and the moves of obstacles ``(8, 2)`` that lead to it."""

    def distance(moves):
        field = polygon_distance(polygons + moves[:, None], jnp.array(_GOAL), bounds=_BOUNDS)
        return field(jnp.array(_START)), jnp.isfinite(field(jnp.array(_PROBES, jnp.float32))).all()

    def advance(state, step):
        (_, moves, slope), (longest, *_) = state
        moves = moves + step * slope / jnp.maximum(jnp.linalg.norm(slope, axis=1).max(), 1e-9)
        length = jnp.linalg.norm(moves, axis=1, keepdims=True)
        moves = moves * jnp.minimum(1, RADIUS / jnp.maximum(length, 1e-9))
        (value, is_allowed), slope = jax.value_and_grad(distance, has_aux=True)(moves)
        is_allowed &= jnp.isfinite(value)
        # The shorter of two paths changes from step to step. So a step may shorten the distance.
        best = _choose(is_allowed & (value > longest), (value, moves, slope), state[1])
        return (_choose(is_allowed, (value, moves, slope), best), best), None

    start = jnp.zeros((polygons.shape[0], 2))
    (first, _), slope = jax.value_and_grad(distance, has_aux=True)(start)
    at_first = first, start, slope
    (_, (longest, moves, _)), _ = lax.scan(advance, (at_first, at_first), STEP * (1 - jnp.arange(steps) / steps))
    return first, longest, moves


def _choose(condition: Any, first: Any, second: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), first, second)


def _exact(polygons: np.ndarray) -> float:
    return float(VisibilityGraph(Workspace(_BOUNDS, list(polygons.astype(float))), _GOAL)(np.array([_START]))[0])
