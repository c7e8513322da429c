"""Where should machines stand? The mean distance from a shop floor to its exit, as 12 machines move.

The floor plan of the scenes has 289 vertices, more than ``polygon_distance`` takes; so this is a shop floor. Each
machine moves as a whole within a box of its own, which meets neither another box nor the exit. Points are drawn outside
these boxes, so that no machine covers one. Random search uses the same compiled distances, of many layouts at once if
that is faster, as long as the gradient's steps take. All means are those of ``VisibilityGraph``.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax

from experiments.differentiating._common import compiled, least, mean_of_finite
from plr_jax import Box, VisibilityGraph, Workspace, polygon_distance

STEPS, POINTS, FLOORS = 200, 2_000, 10
RATE = 0.08  # meters a step, at first
_FLOOR = Box((0.0, 0.0), (40.0, 24.0))  # meters
_BOUNDS = np.stack([_FLOOR.lo, _FLOOR.hi])
_EXIT = np.array([0.5, 12.0])
_COLUMNS, _ROWS = 4, 3
_AISLE = 0.6  # half of the least width between the boxes of two machines
_BATCH = 16  # layouts that random search tries at once
_DIFFERENCE = 1e-3  # meters, of finite differences
_MOST_MOVES = 0.3  # share of a box by which the step of the local search is drawn, at first


class Floor(NamedTuple):
    """Machines ``(12, 4, 2)`` in the middle of their boxes, how far each may move, and the points."""

    machines: np.ndarray
    limit: np.ndarray
    x: np.ndarray


Mean = Callable[[Any], Any]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = [_row(seed * 1_000 + i, smoke) for i in range(1 if smoke else FLOORS)]
    ways = rows[0]["gain"].keys()
    medians = {way: float(np.median([row["gain"][way] for row in rows])) for way in ways}
    ratios = [row["gain"]["gradient"] / row["gain"]["random search"] for row in rows]
    return {
        "points": POINTS,
        "machines": _COLUMNS * _ROWS,
        "steps": STEPS,
        "median_gain": medians,
        "gain_over_random_search": {"median": float(np.median(ratios)), "least": min(ratios), "largest": max(ratios)},
        "rows": rows,
    }


def _row(seed: int, smoke: bool) -> dict[str, Any]:
    floor = shop_floor(np.random.default_rng(seed), 100 if smoke else POINTS)
    steps = 3 if smoke else STEPS
    start = np.random.default_rng(seed + 500).uniform(-0.5, 0.5, (len(floor.machines), 2)).astype(np.float32)
    mean = partial(mean_distance, floor)
    descent, compile_seconds = compiled(partial(descend, mean, steps), start)
    seconds = least(lambda: descent(start), 1 if smoke else 3).wall
    rng = np.random.default_rng(seed + 900)
    best = {
        "gradient": np.asarray(descent(start)),
        "random search": random_search(mean, start, seconds, rng),
        "local random search": local_search(mean, start, seconds, rng),
        "finite differences": finite_differences(floor, start, seconds),
    }
    means = {way: exact_mean(floor, moves) for way, moves in best.items()}
    before = exact_mean(floor, start)
    gain = {way: before - after for way, after in means.items()}
    began = time.perf_counter()
    exact_mean(floor, start)
    exact_seconds = time.perf_counter() - began
    return {
        "seed": seed,
        "before": before,
        "after": means,
        "gain": gain,
        "seconds": seconds,
        "compile_seconds": compile_seconds,
        "finite_difference_steps_seconds": 2 * start.size * steps * exact_seconds,
        "largest_travel": float((np.abs(best["gradient"]) * floor.limit).max()),
    }


def shop_floor(rng: np.random.Generator, num_points: int) -> Floor:
    """Draw long machines, upright or level, whose boxes are the cells of a grid less aisles."""
    cell = _FLOOR.width / [_COLUMNS, _ROWS]
    index = np.stack(np.meshgrid(np.arange(_COLUMNS), np.arange(_ROWS)), axis=-1).reshape(-1, 2)
    centers, room = (index + 0.5) * cell, cell - 2 * _AISLE
    is_level = rng.random((len(index), 1)) < 0.5
    long, short = rng.uniform(0.55, 0.75, (len(index), 1)), rng.uniform(0.1, 0.2, (len(index), 1))
    size = np.where(is_level, np.concatenate([long, short], axis=1), np.concatenate([short, long], axis=1)) * room
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    machines = centers[:, None] + size[:, None] * corners
    lo, hi = centers - room / 2, centers + room / 2
    x = rng.uniform(_FLOOR.lo, _FLOOR.hi, (40 * num_points, 2))
    in_boxes = ((lo <= x[:, None]) & (x[:, None] <= hi)).all(axis=2).any(axis=1)
    return Floor(*(each.astype(np.float32) for each in (machines, (room - size) / 2, x[~in_boxes][:num_points])))


def mean_distance(floor: Floor, moves: Any) -> Any:
    """Return the mean distance of the points to the exit; ``moves``, from -1 to 1, are shares of the limits."""
    polygons = floor.machines + (moves * floor.limit)[:, None]
    return mean_of_finite(polygon_distance(polygons, _EXIT.astype(np.float32), bounds=_BOUNDS)(floor.x))


def exact_mean(floor: Floor, moves: np.ndarray) -> float:
    """Return the same mean by ``VisibilityGraph``; ``ValueError`` if a point does not reach the exit."""
    machines = floor.machines.astype(float) + (moves.astype(float) * floor.limit)[:, None]
    distance = VisibilityGraph(Workspace(_FLOOR, list(machines)), _EXIT)(floor.x.astype(float))
    if not np.isfinite(distance).all():
        raise ValueError("A point of the shop floor cannot reach the exit.")
    return float(distance.mean())


def descend(mean: Mean, steps: int, start: Any) -> Any:
    """Return the best moves of Adam's steps, each clipped to the limits."""
    optimizer = optax.adam(optax.cosine_decay_schedule(RATE, steps))

    def advance(state, _):
        moves, memory, least_mean, best = state
        value, slope = jax.value_and_grad(mean)(moves)
        best = jnp.where(value < least_mean, moves, best)
        change, memory = optimizer.update(slope, memory)
        moves = jnp.clip(optax.apply_updates(moves, change), -1, 1)
        return (moves, memory, jnp.minimum(value, least_mean), best), None

    first = start, optimizer.init(start), jnp.float32(jnp.inf), start
    return lax.scan(advance, first, None, steps)[0][3]


def random_search(mean: Mean, start: np.ndarray, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Return the best of layouts drawn from the limits, one at a time or a batch, whichever is faster."""
    layouts = rng.uniform(-1, 1, (_BATCH, *start.shape)).astype(np.float32)
    one, _ = compiled(mean, start)
    many, _ = compiled(jax.vmap(mean), layouts)
    number = _BATCH if least(lambda: many(layouts), 3).wall < _BATCH * least(lambda: one(start), 10).wall else 1
    best, least_mean, began = start, float(one(start)), time.perf_counter()
    while time.perf_counter() - began < seconds:
        layouts = rng.uniform(-1, 1, (number, *start.shape)).astype(np.float32)
        means = np.asarray(many(layouts)) if number > 1 else np.asarray(one(layouts[0]))[None]
        if means.min() < least_mean:
            best, least_mean = layouts[means.argmin()], means.min()
    return best


def local_search(mean: Mean, start: np.ndarray, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Return the result of an evolution strategy, (1+1) with the 1/5 success rule."""
    one, _ = compiled(mean, start)
    best, least_mean, step, began = start, float(one(start)), _MOST_MOVES, time.perf_counter()
    while time.perf_counter() - began < seconds:
        moves = np.clip(best + step * rng.standard_normal(start.shape), -1, 1).astype(np.float32)
        value = float(one(moves))
        is_better = value < least_mean
        best, least_mean = (moves, value) if is_better else (best, least_mean)
        step *= np.exp(0.8 if is_better else -0.2) ** (1 / 3)
    return best


def finite_differences(floor: Floor, start: np.ndarray, seconds: float) -> np.ndarray:
    """Return the moves of Adam's steps by central differences of ``VisibilityGraph``, at least one step."""
    optimizer = optax.adam(RATE)
    moves, memory, began = start, optimizer.init(start), time.perf_counter()
    while True:
        slope = np.zeros(start.shape, np.float32)
        for i in np.ndindex(start.shape):
            ends = []
            for side in (1, -1):
                shifted = moves.astype(float)
                shifted[i] += side * _DIFFERENCE / floor.limit[i]
                ends.append(exact_mean(floor, shifted))
            slope[i] = (ends[0] - ends[1]) / (2 * _DIFFERENCE / floor.limit[i])
        change, memory = optimizer.update(slope, memory)
        moves = np.clip(np.asarray(optax.apply_updates(moves, change)), -1, 1)
        if time.perf_counter() - began > seconds:
            return moves
