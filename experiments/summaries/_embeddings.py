"""FastMap: nodes of a grid placed in Euclidean space, axis after axis, by their distances from two far pivots.

The pivots of an axis are far from each other in what the axes before leave of the distances. These are the oracle's,
of any two nodes, so no roadmap is needed. Coordinates are interpolated between nodes; no answer is less than the
straight line.

C. Faloutsos, K. Lin, "FastMap", SIGMOD 1995; J. Li et al., "Using FastMap to solve graph problems in a Euclidean
space", ICAPS 2019.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from experiments.summaries._given import Candidates, CompiledSummary, Given, Points, compiled, straight
from experiments.summaries._node_tables import NodeGrid, finest_grid, rounded

AXES, BITS = (2, 3, 4, 6, 8, 12, 16, 24, 32), (8, 16)
_TURNS = 3  # of the search for two far pivots

Coordinates = Float[np.ndarray, "free axes"]


def fastmap_candidates(given: Given) -> Candidates:
    """All numbers of axes, with the finest grids that the bytes allow."""
    for bits in BITS:
        for axes in AXES[:2] if given.smoke else AXES:
            if (grid := grid_for(given, axes, bits)) is not None:
                summary = embedded(grid, fastmap(given, grid.free, axes), bits)
                yield f"{axes} axes of {bits} bits, {len(grid.free):,} nodes", summary


def grid_for(given: Given, axes: int, bits: int) -> NodeGrid | None:
    """The finest grid that so many numbers a node leave room for."""
    return finest_grid(given.workspace, partial(NodeGrid.table_bytes, channels=axes, bits=bits), given.max_bytes)


def fastmap(given: Given, points: Points, axes: int) -> Coordinates:
    """Coordinates of points, an axis after the other."""
    rng = np.random.default_rng(given.seed)
    coordinates, fields = np.empty((len(points), 0)), given.fields(points)

    def left(of: int) -> Float[np.ndarray, "free"]:
        """Squares of the distances from a point that the axes so far leave."""
        square = fields(points[[of]])[0] ** 2
        return np.maximum(square - ((coordinates - coordinates[of]) ** 2).sum(axis=1), 0)

    for _ in range(axes):
        from_first = left(first := int(rng.integers(len(points))))
        for _ in range(_TURNS):
            second = int(from_first.argmax())
            from_second = left(second)
            first, second, from_first, from_second = second, first, from_second, from_first
        # The last turn went on from `second` to `first`, the farther end.
        between = from_second[first]
        if between <= 0:
            column = np.zeros(len(points))
        else:
            column = (from_second + between - from_first) / (2 * np.sqrt(between))
        coordinates = np.column_stack([coordinates, column])
    return coordinates


def embedded(grid: NodeGrid, coordinates: Coordinates, bits: int) -> CompiledSummary:
    """The summary that reads rounded coordinates of the free nodes."""
    table = jnp.asarray(rounded(coordinates, bits)[grid.nearest])

    def of_pair(x: Array, y: Array) -> Array:
        apart = grid.read(table, x) - grid.read(table, y)
        return jnp.maximum(straight(x, y), jnp.sqrt((apart**2).sum()))

    return compiled(grid.table_bytes(coordinates.shape[1], bits), of_pair)


# A Euclidean embedding of the least stress: nodes of a grid placed so that pairs of points are as far as they are.
#
# It begins with the coordinates of FastMap. Adam then lowers the mean error over exact pairs, through the very
# interpolation that reads the coordinates.

_AXES = (3, 8, 24)
_STEPS, _SMOKE_STEPS, _BATCH = 3_000, 20, 8_192
_RATE = 3e-3  # of the mean distance a step, at first


def least_stress(given: Given) -> Candidates:
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
