"""The full table: the distance of every pair of free nodes of a grid, once for both directions.

Stored are distances, or by how much they exceed the straight line; read at the nearest nodes, or interpolated between
the four nodes around each point.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments.summaries._node_grid import NodeGrid, finest_grid, rounded
from experiments.summaries._summary import Candidates, CompiledSummary, Given, compiled, straight

_BITS = (8, 16)


def candidates(given: Given) -> Candidates:
    """Distances or detours of 8 or 16 bits, nearest nodes or interpolation."""
    for bits in _BITS:
        grid = finest_grid(given.workspace, partial(_num_bytes, bits=bits), given.max_bytes)
        if grid is None:
            continue
        distance = given.fields(grid.free)(grid.free)
        length = np.linalg.norm(grid.free[:, None] - grid.free, axis=2)
        for what, values in {"distances": distance, "detours": np.maximum(distance - length, 0)}.items():
            for reading in ("interpolated", "nearest"):
                summary = _summary(grid, values, bits, what == "detours", reading == "nearest")
                yield f"{len(grid.free):,} nodes, {what} of {bits} bits, {reading}", summary


def _num_bytes(grid: NodeGrid, bits: int) -> int:
    count = len(grid.free)
    return grid.frame_bytes + 8 + -(-bits * (count * (count - 1) // 2) // 8)


def _summary(
    grid: NodeGrid, values: Float[np.ndarray, "free free"], bits: int, of_detours: bool, nearest: bool
) -> CompiledSummary:
    stored = jnp.asarray(rounded(values.reshape(-1, 1), bits).reshape(values.shape))
    index = jnp.asarray(grid.nearest)

    def of_pair(x: Array, y: Array) -> Array:
        (i, at_x), (j, at_y) = grid.around(x), grid.around(y)
        if nearest:
            value = stored[index[i[at_x.argmax()]], index[j[at_y.argmax()]]]
        else:
            value = at_x @ stored[index[i][:, None], index[j]] @ at_y
        return straight(x, y) + value if of_detours else jnp.maximum(straight(x, y), value)

    return compiled(_num_bytes(grid, bits), of_pair)
