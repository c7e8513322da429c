"""Walks along the raw gradient alone: what a field gives without lookahead."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Array, Bool, Float

from plr_jax import Workspace

STEPS_ACROSS = 500  # the longer side of the domain is so many steps long
LONGEST = 4  # times the exact distance, after which a walk is given up
_GRAZE = 0.1  # of a step, by which a walk may cut a corner: steps that turn beside one do not end on it exactly
_STEPS_AT_ONCE = 64  # before those that have ended are left out
_WALKING, _REACHED, _LEFT = range(3)

Directions = Callable[[Any], Any]


def measure_walks(
    directions: Directions,
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    goal: Float[np.ndarray, "2"],
    distance: Float[np.ndarray, "n"],
) -> dict[str, Any]:
    """Shares of the starts whose walk reaches the goal, leaves free space, or runs out of steps.

    Args:
        directions: The way to go from points ``(n, 2)``; only its direction matters, and where it is zero or not
            finite, a walk stays.
        workspace: The free space.
        starts: Where the walks begin, all at once.
        goal: Where they end, once it is within a step.
        distance: The exact distance of the starts.
    """
    step = float(workspace.bounds.width.max()) / STEPS_ACROSS
    walls, target = _walls(workspace, _GRAZE * step), jnp.asarray(goal, jnp.float32)
    most = np.where(np.isfinite(distance), LONGEST * distance / step, 0.0)
    x, status, taken = np.array(starts, np.float32), np.full(len(starts), _WALKING), np.zeros(len(starts))
    count = 0
    while len(pending := np.flatnonzero((status == _WALKING) & (count < most))):
        rows = np.resize(pending, 1 << (len(pending) - 1).bit_length())  # padded: few sizes are compiled
        now, state, steps = jnp.asarray(x[rows]), jnp.full(len(rows), _WALKING), jnp.zeros(len(rows))
        for _ in range(_STEPS_AT_ONCE):
            now, state, steps = _advance(now, directions(now), state, steps, walls, target, step)
        x[rows], status[rows] = now, state
        taken[rows] += np.asarray(steps)
        count += _STEPS_AT_ONCE
    reached = (status == _REACHED) & (taken <= most)
    left = (status == _LEFT) & (taken <= most)
    ratio = (taken * step)[reached] / distance[reached]
    return {
        "reached": float(reached.mean()),
        "left_free_space": float(left.mean()),
        "out_of_steps": float(1 - reached.mean() - left.mean()),
        "median_ratio": float(np.median(ratio)) if reached.any() else None,
    }


def downhill(field: Callable[[Any], Any]) -> Directions:
    """The negative gradient of a field, compiled."""
    return jax.jit(lambda x: -jax.grad(lambda x: field(x).sum())(x))


@partial(jax.jit, static_argnames="step")
def _advance(
    x: Float[Array, "n 2"],
    direction: Float[Array, "n 2"],
    state: Any,
    steps: Float[Array, "n"],
    walls: Float[Array, "edges 2 2"],
    goal: Float[Array, "2"],
    step: float,
) -> tuple[Any, Any, Any]:
    """One step of every walk, or the whole way to the goal within a step."""
    direction = jnp.asarray(direction, x.dtype)
    size = jnp.linalg.norm(direction, axis=1, keepdims=True)
    moves = jnp.isfinite(size) & (size > 0)
    unit = jnp.where(moves, direction, 0.0) / jnp.where(moves, size, 1.0)
    near = jnp.linalg.norm(goal - x, axis=1) <= step
    there = jnp.where(near[:, None], goal, x + step * unit)
    after = jnp.where(_crosses(x, there, walls), _LEFT, jnp.where(near, _REACHED, _WALKING))
    walking = state == _WALKING
    return (
        jnp.where(walking[:, None], there, x),
        jnp.where(walking, after, state),
        steps + walking,
    )


def _crosses(a: Float[Array, "n 2"], b: Float[Array, "n 2"], walls: Float[Array, "edges 2 2"]) -> Bool[Array, "n"]:
    """Whether each segment crosses an edge."""
    c, d = walls[:, 0], walls[:, 1]

    def side(p: Any, q: Any, r: Any) -> Any:
        (px, py), (qx, qy), (rx, ry) = (jnp.moveaxis(each, -1, 0) for each in (p, q, r))
        return (qx - px) * (ry - py) > (qy - py) * (rx - px)

    a, b = a[:, None], b[:, None]
    return ((side(a, b, c) != side(a, b, d)) & (side(c, d, a) != side(c, d, b))).any(axis=1)


def _walls(workspace: Workspace, graze: float) -> Float[Array, "edges 2 2"]:
    """The edges around free space, moved outward a little."""
    grown = shapely.buffer(workspace.free_space, graze, join_style="mitre")
    rings = [ring for part in np.atleast_1d(shapely.get_parts(grown)) for ring in (part.exterior, *part.interiors)]
    edges = [np.stack([points[:-1], points[1:]], axis=1) for points in map(shapely.get_coordinates, rings)]
    return jnp.asarray(np.concatenate(edges), jnp.float32)
