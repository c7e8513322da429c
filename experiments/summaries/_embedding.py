"""A Euclidean embedding of the least stress: nodes of a grid placed so that pairs of points are as far as they are.

It begins with the coordinates of FastMap. Adam then lowers the mean error over exact pairs, through the very
interpolation that reads the coordinates.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from experiments.summaries._fastmap import BITS, Coordinates, embedded, fastmap, grid_for
from experiments.summaries._node_grid import NodeGrid
from experiments.summaries._summary import Candidates, Given, straight

_AXES = (3, 8, 24)
_STEPS, _SMOKE_STEPS, _BATCH = 3_000, 20, 8_192
_RATE = 3e-3  # of the mean distance a step, at first


def candidates(given: Given) -> Candidates:
    """All numbers of axes, with the finest grids that the bytes allow."""
    for bits in BITS:
        for axes in _AXES[:1] if given.smoke else _AXES:
            if (grid := grid_for(given, axes, bits)) is not None:
                placed = _least_stress(grid, fastmap(given, grid.free, axes), given)
                yield f"{axes} axes of {bits} bits, {len(grid.free):,} nodes", embedded(grid, placed, bits)


def _least_stress(grid: NodeGrid, coordinates: Coordinates, given: Given) -> Coordinates:
    pairs = tuple(jnp.asarray(column, jnp.float32) for column in given.training)
    steps = _SMOKE_STEPS if given.smoke else _STEPS
    optimizer = optax.adam(optax.cosine_decay_schedule(_RATE * float(given.training.distance.mean()), steps))
    nearest = jnp.asarray(grid.nearest)

    def error(table: Array, x: Array, y: Array, distance: Array) -> Array:
        place = partial(_place, grid, table, nearest)
        apart = place(x) - place(y)
        far = jnp.sqrt((apart**2).sum() + 1e-12)
        return jnp.abs(jnp.maximum(far, straight(x, y)) - distance)

    def loss(table: Array, batch: Array) -> Array:
        return jax.vmap(partial(error, table))(*(column[batch] for column in pairs)).mean()

    def step(state: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], None]:
        table, moments = state
        slope = jax.grad(loss)(table, jax.random.randint(key, (_BATCH,), 0, len(pairs[0])))
        change, moments = optimizer.update(slope, moments)
        return (optax.apply_updates(table, change), moments), None

    first = jnp.asarray(coordinates, jnp.float32)
    keys = jax.random.split(jax.random.key(given.seed), steps)
    (table, _), _ = jax.jit(lambda state, keys: jax.lax.scan(step, state, keys))((first, optimizer.init(first)), keys)
    return np.asarray(table, float)


def _place(grid: NodeGrid, table: Array, nearest: Array, x: Array) -> Float[Array, "axes"]:
    node, weight = grid.around(x)
    return weight @ table[nearest[node]]
