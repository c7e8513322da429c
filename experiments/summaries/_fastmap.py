"""FastMap: nodes of a grid placed in Euclidean space, axis after axis, by their distances from two far pivots.

The pivots of an axis are far from each other in what the axes before leave of the distances. These are the oracle's,
of any two nodes, so no roadmap is needed. Coordinates are interpolated between nodes; no answer is less than the
straight line.

C. Faloutsos, K. Lin, "FastMap", SIGMOD 1995; J. Li et al., "Using FastMap to solve graph problems in a Euclidean
space", ICAPS 2019.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments.summaries._given import Candidates, CompiledSummary, Given, Points, compiled, straight
from experiments.summaries._node_tables import NodeGrid, finest_grid, rounded

AXES, BITS = (2, 3, 4, 6, 8, 12, 16, 24, 32), (8, 16)
_TURNS = 3  # of the search for two far pivots

Coordinates = Float[np.ndarray, "free axes"]


def candidates(given: Given) -> Candidates:
    """Yield an embedding for each number of axes and bits, with the finest grid that the bytes allow."""
    for bits in BITS:
        for axes in AXES[:2] if given.smoke else AXES:
            bytes_of = partial(NodeGrid.table_bytes, channels=axes, bits=bits)
            if (grid := finest_grid(given.workspace, bytes_of, given.max_bytes)) is not None:
                summary = embedded(grid, fastmap(given, grid.free, axes), bits)
                yield f"{axes} axes of {bits} bits, {len(grid.free):,} nodes", summary


def fastmap(given: Given, points: Points, axes: int) -> Coordinates:
    """Coordinates of points, an axis after the other."""
    rng = np.random.default_rng(given.seed)
    coordinates = np.empty((len(points), 0))

    def left(of: int) -> Float[np.ndarray, " free"]:
        """Squares of the distances from a point that the axes so far leave."""
        square = given.fields(points[[of]], points)[0] ** 2
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
