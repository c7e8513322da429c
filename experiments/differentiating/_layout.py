"""Where should machines stand? The mean distance from a shop floor to its exits, as 12 machines move and turn.

The floor plan of the scenes has 289 vertices, more than ``polygon_distance`` takes; so this is a shop floor. Each
machine moves and turns within limits. The box that it may cover meets neither another box nor an exit, and points are
drawn outside these boxes, so that no machine covers one.

Rivals take as long as the gradient's steps. Random search uses the same compiled distances, of many layouts at once
if that is faster. All means are those of ``VisibilityGraph``.
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

STEPS, POINTS, FLOORS = 200, 2_000, 3
RATE = 0.08  # of the first step, as a share of the limits
SHIFT, TURN = 0.75, np.radians(15)  # limits, from the first layout: meters along each axis, and radians
EXITS = {
    "one exit": np.array([(0.1, 12.0)]),
    "four exits": np.array([(0.1, 12.0), (39.9, 12.0), (20.0, 0.1), (20.0, 23.9)]),
}
_FLOOR = Box((0.0, 0.0), (40.0, 24.0))  # meters
_BOUNDS = np.stack([_FLOOR.lo, _FLOOR.hi])
_COLUMNS, _ROWS = 4, 3
_LONG, _SHORT = (4.5, 6.0), (0.4, 2.5)  # meters: least and largest sides of machines
_BATCH = 16  # layouts that random search tries at once
_DIFFERENCE = 1e-3  # of finite differences, as a share of the limits
_FIRST_SPREAD = 0.3  # of local random search, as a share of the limits


class Floor(NamedTuple):
    """Centers and half sides ``(12, 2)`` and angles ``(12,)`` of machines; points and exits ``(n, 2)``."""

    centers: Any
    half_sides: Any
    angles: Any
    x: Any
    exits: Any


Mean = Callable[[Floor, Any], Any]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    steps = 3 if smoke else STEPS
    search = _Search.compiled(shop_floor(seed, "one exit", smoke), steps)
    rows = [
        _row(search, seed * 1_000 + i, exits, steps, smoke)
        for exits in (list(EXITS)[:1] if smoke else EXITS)
        for i in range(1 if smoke else FLOORS)
    ]
    summary = []
    for exits in dict.fromkeys(row["exits"] for row in rows):
        some = [row for row in rows if row["exits"] == exits]
        ratios = [row["gain"]["gradient"] / row["gain"]["random search"] for row in some]
        gains = {way: float(np.median([row["gain"][way] / row["before"] for row in some])) for way in some[0]["gain"]}
        ratio = {"median": float(np.median(ratios)), "least": min(ratios), "largest": max(ratios)}
        summary.append({"exits": exits, "median_relative_gain": gains, "over_random_search": ratio})
    shape = {"points": POINTS, "machines": _COLUMNS * _ROWS, "steps": steps, "floors": FLOORS}
    limits = {"shift": SHIFT, "turn_degrees": float(np.degrees(TURN))}
    return shape | limits | {"compile_seconds": search.compile_seconds, "summary": summary, "rows": rows}


class _Search(NamedTuple):
    """Compiled functions of a floor and moves: the mean, means of a batch, and the result of the gradient's steps."""

    one: Mean
    many: Mean
    descent: Mean
    compile_seconds: float

    @classmethod
    def compiled(cls, floor: Floor, steps: int) -> "_Search":
        moves = np.zeros((_BATCH, len(floor.centers), 3), np.float32)
        one, _ = compiled(mean_distance, floor, moves[0])
        many, _ = compiled(jax.vmap(mean_distance, (None, 0)), floor, moves)
        descent, seconds = compiled(partial(descend, steps), floor, moves[0])
        return cls(one, many, descent, seconds)


def _row(search: _Search, seed: int, exits: str, steps: int, smoke: bool) -> dict[str, Any]:
    floor, rng = shop_floor(seed, exits, smoke), np.random.default_rng(seed + 500)
    start = np.zeros((len(floor.centers), 3), np.float32)
    seconds = least(lambda: search.descent(floor, start), 1 if smoke else 3).wall
    found = {"gradient": np.asarray(search.descent(floor, start))}
    found["random search"], tried = random_search(search, floor, start, seconds, rng)
    found["local random search"] = local_search(search, floor, start, seconds, rng)
    found["finite differences"], num_steps = finite_differences(floor, start, seconds)
    before, began = exact_mean(floor, start), time.perf_counter()
    after = {way: exact_mean(floor, moves) for way, moves in found.items()}
    exact_seconds = (time.perf_counter() - began) / len(found)
    return {
        "exits": exits,
        "seed": seed,
        "before": before,
        "after": after,
        "gain": {way: before - mean for way, mean in after.items()},
        "seconds": seconds,
        "random_layouts": tried,
        "finite_difference_steps": num_steps,
        "all_finite_difference_steps_seconds": 2 * start.size * steps * exact_seconds,
        "largest_move": float(np.abs(found["gradient"]).max()),
    }


def shop_floor(seed: int, exits: str, smoke: bool) -> Floor:
    """Draw machines, each in a cell of a grid, and points."""
    rng = np.random.default_rng(seed)
    cell = _FLOOR.width / [_COLUMNS, _ROWS]
    index = np.stack(np.meshgrid(np.arange(_COLUMNS), np.arange(_ROWS)), axis=-1).reshape(-1, 2)
    half_sides = np.stack([rng.uniform(*sides, len(index)) for sides in (_LONG, _SHORT)], axis=1) / 2
    angles = rng.choice([0, np.pi / 2], len(index))
    turned = [np.abs(_corners(half_sides, angles + share * TURN)).max(axis=1) for share in np.linspace(-1, 1, 31)]
    half_box = np.max(turned, axis=0) + SHIFT  # of what a machine may cover
    centers = (index + 0.5) * cell + rng.uniform(-1, 1, index.shape) * np.maximum(cell / 2 - half_box, 0)
    if (half_box > cell / 2).any():
        raise ValueError("Limits let machines leave their cells.")
    x = rng.uniform(_FLOOR.lo, _FLOOR.hi, (10 * POINTS, 2))
    in_boxes = (np.abs(x[:, None] - centers) <= half_box).all(axis=2).any(axis=1)
    x = x[~in_boxes][: 100 if smoke else POINTS]
    ends = np.resize(EXITS[exits], EXITS["four exits"].shape)  # repeated, so that all floors have the same shapes
    return Floor(*(each.astype(np.float32) for each in (centers, half_sides, angles, x, ends)))


def _corners(half_sides: Any, angles: Any) -> Any:
    """Return the corners ``(machines, 4, 2)`` of machines around the origin."""
    numpy = np if isinstance(angles, np.ndarray) else jnp
    x, y = (half_sides[:, None] * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float32)).transpose(2, 0, 1)
    cos, sin = numpy.cos(angles)[:, None], numpy.sin(angles)[:, None]
    return numpy.stack([cos * x - sin * y, sin * x + cos * y], axis=2)


def polygons_of(floor: Floor, moves: Any) -> Any:
    """Return machines after moves ``(12, 3)``: shifts and turns, each from -1 to 1, as shares of the limits."""
    centers = floor.centers + SHIFT * moves[:, :2]
    return centers[:, None] + _corners(floor.half_sides, floor.angles + np.float32(TURN) * moves[:, 2])


def mean_distance(floor: Floor, moves: Any) -> Any:
    """Return the mean distance of the points to the nearest exit."""
    return mean_of_finite(polygon_distance(polygons_of(floor, moves), floor.exits, bounds=_BOUNDS)(floor.x))


def exact_mean(floor: Floor, moves: np.ndarray) -> float:
    """Return the same mean by ``VisibilityGraph``; ``ValueError`` if a point does not reach an exit."""
    machines = polygons_of(Floor(*(each.astype(float) for each in floor)), moves.astype(float))
    workspace = Workspace(_FLOOR, list(machines))
    exits, x = np.unique(floor.exits.astype(float), axis=0), floor.x.astype(float)
    distance = np.min([VisibilityGraph(workspace, each)(x) for each in exits], axis=0)
    if not np.isfinite(distance).all():
        raise ValueError("A point of the shop floor cannot reach an exit.")
    return float(distance.mean())


def descend(steps: int, floor: Floor, start: Any) -> Any:
    """Return the best moves of Adam's steps, each clipped to the limits."""
    optimizer = optax.adam(optax.cosine_decay_schedule(RATE, steps))

    def advance(state, _):
        moves, memory, least_mean, best = state
        value, slope = jax.value_and_grad(mean_distance, 1)(floor, moves)
        best = jnp.where(value < least_mean, moves, best)
        change, memory = optimizer.update(slope, memory)
        moves = jnp.clip(moves + change, -1, 1)
        return (moves, memory, jnp.minimum(value, least_mean), best), None

    first = start, optimizer.init(start), jnp.float32(jnp.inf), start
    return lax.scan(advance, first, None, steps)[0][3]


def random_search(
    search: _Search, floor: Floor, start: np.ndarray, seconds: float, rng: np.random.Generator
) -> tuple[np.ndarray, int]:
    """Return the best layout drawn from the limits, and the number tried, one at a time or in batches."""
    layouts = rng.uniform(-1, 1, (_BATCH, *start.shape)).astype(np.float32)
    batch, single = (least(lambda: search.many(floor, layouts), 3), least(lambda: search.one(floor, start), 10))
    number = _BATCH if batch.wall < _BATCH * single.wall else 1
    best, least_mean, tried = start, float(search.one(floor, start)), 0
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        layouts = rng.uniform(-1, 1, (number, *start.shape)).astype(np.float32)
        means = np.atleast_1d(search.many(floor, layouts) if number > 1 else search.one(floor, layouts[0]))
        tried += number
        if means.min() < least_mean:
            best, least_mean = layouts[means.argmin()], means.min()
    return best, tried


def local_search(
    search: _Search, floor: Floor, start: np.ndarray, seconds: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the result of an evolution strategy, (1+1) with the 1/5 success rule."""
    best, least_mean, spread = start, float(search.one(floor, start)), _FIRST_SPREAD
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        moves = np.clip(best + spread * rng.standard_normal(start.shape), -1, 1).astype(np.float32)
        value = float(search.one(floor, moves))
        is_better = value < least_mean
        best, least_mean = (moves, value) if is_better else (best, least_mean)
        spread *= np.exp(0.8 if is_better else -0.2) ** (1 / 3)
    return best


def finite_differences(floor: Floor, start: np.ndarray, seconds: float) -> tuple[np.ndarray, int]:
    """Return the moves of Adam's steps by central differences of ``VisibilityGraph``, and the number of steps."""
    optimizer = optax.adam(RATE)
    moves, memory, number, began = start, optimizer.init(start), 0, time.perf_counter()
    while number == 0 or time.perf_counter() - began < seconds:
        slope = np.zeros(start.shape, np.float32)
        for i in np.ndindex(start.shape):
            step = np.zeros(start.shape)
            step[i] = _DIFFERENCE
            slope[i] = (exact_mean(floor, moves + step) - exact_mean(floor, moves - step)) / (2 * _DIFFERENCE)
        change, memory = optimizer.update(slope, memory)
        moves, number = np.clip(moves + np.asarray(change), -1, 1), number + 1
    return moves, number
