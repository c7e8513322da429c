"""Tables over the free nodes of a regular grid, read with bilinear interpolation.

What is stored are the free nodes' numbers, of a few bits each, and which nodes are free, a bit each. The nearest free
node stands for any other.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from experiments.summaries._given import Candidates, CompiledSummary, Given, compiled, straight
from plr_jax import Workspace

_FRAME = 16  # bytes that tell where a grid lies: two corners as float32
_FEWEST_NODES = 8
_MOST_FREE = 40_000  # of maps whose walls are a unit apart, and whose sides are 250 units, finer grids gain nothing
_RANGE = 8  # bytes that tell what the integers of a channel stand for


class NodeGrid(NamedTuple):
    """Nodes of a grid over a map.

    Attributes:
        lo: The first node.
        spacing: Distance of neighbors along each axis.
        shape: Nodes along each axis.
        free: The free nodes' places.
        nearest: For each node, row by row, the free node that stands for it.
    """

    lo: Float[np.ndarray, "2"]
    spacing: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    free: Float[np.ndarray, "free 2"]
    nearest: Int[np.ndarray, " nodes"]

    @property
    def frame_bytes(self) -> int:
        """Bytes of the grid itself: where it lies, and which nodes are free."""
        return _FRAME + -(-len(self.nearest) // 8)

    def table_bytes(self, channels: int, bits: int) -> int:
        """Bytes of so many integers a free node, with their grid."""
        return self.frame_bytes + channels * (_RANGE + -(-len(self.free) * bits // 8))

    def around(self, x: Float[Array, "2"]) -> tuple[Int[Array, "4"], Float[Array, "4"]]:
        """The four nodes around a point, row by row, and their weights."""
        most = np.array(self.shape, np.float32) - 1
        place = jnp.clip((x - self.lo.astype(np.float32)) * (1 / self.spacing).astype(np.float32), 0, most)
        first = jnp.minimum(place.astype(jnp.int32), np.array(self.shape) - 2)
        share = place - first
        (i, j), (u, v) = first, share
        node = i * self.shape[1] + j + np.array([0, 1, self.shape[1], self.shape[1] + 1])
        return node, jnp.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])

    def read(self, table: Float[Array, "nodes channels"], x: Float[Array, "2"]) -> Float[Array, " channels"]:
        """Interpolated numbers at a point, of a table of all nodes."""
        node, weight = self.around(x)
        return weight @ table[node]


def grid_of(workspace: Workspace, num_nodes: int) -> NodeGrid:
    """A grid of about so many nodes, at least two along each axis, spread in proportion to the sides of the map."""
    bounds = workspace.bounds
    rows = max(2, int(np.sqrt(num_nodes * bounds.width[0] / bounds.width[1])))
    shape = np.array([rows, max(2, num_nodes // rows)])
    spacing = bounds.width / (shape - 1)
    axes = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    nodes = np.minimum(bounds.lo + np.stack(axes, axis=-1) * spacing, bounds.hi)
    is_free = workspace.is_free(nodes.reshape(-1, 2)).reshape(shape)
    nearest = _nearest(is_free, spacing) if is_free.any() else np.zeros(is_free.size, int)  # too coarse to be of use
    return NodeGrid(bounds.lo, spacing, (int(shape[0]), int(shape[1])), nodes[is_free], nearest)


def _nearest(is_free: Bool[np.ndarray, "rows columns"], spacing: Float[np.ndarray, "2"]) -> Int[np.ndarray, " nodes"]:
    """For each node the nearest free one, by its place among the free ones."""
    _, at = cast(Any, distance_transform_edt(~is_free, spacing, return_indices=True))
    number = np.cumsum(is_free.ravel()) - 1
    return number[np.ravel_multi_index(tuple(at.reshape(2, -1)), is_free.shape)]


def finest_grid(workspace: Workspace, bytes_of: Callable[[NodeGrid], int], max_bytes: int) -> NodeGrid | None:
    """The finest grid that takes no more bytes, and has not more nodes than are of use; none if the coarsest does."""

    def fits(num_nodes: int) -> bool:
        grid = grid_of(workspace, num_nodes)
        return len(grid.free) <= _MOST_FREE and bytes_of(grid) <= max_bytes

    too_many = _FEWEST_NODES
    while fits(too_many):
        too_many *= 2
    if too_many == _FEWEST_NODES:
        return None
    few = too_many // 2
    while too_many - few > 1:
        middle = (few + too_many) // 2
        few, too_many = (middle, too_many) if fits(middle) else (few, middle)
    return grid_of(workspace, few)


def rounded(values: Float[np.ndarray, "n channels"], bits: int) -> Float[np.ndarray, "n channels"]:
    """Values as integers of so many bits tell them, between the least and the largest of their channel."""
    lo = values.min(axis=0)
    step = np.maximum(np.ptp(values, axis=0), 1e-30) / (2**bits - 1)
    return (lo + step * np.rint((values - lo) / step)).astype(np.float32)


# The full table: the distance of every pair of free nodes of a grid, once for both directions.
#
# Stored are distances, or by how much they exceed the straight line; read at the nearest nodes, or interpolated
# between the four nodes around each point.

_BITS = (8, 16)


def full_table(given: Given) -> Candidates:
    """Distances or detours of 8 or 16 bits, nearest nodes or interpolation."""
    for bits in _BITS:
        grid = finest_grid(given.workspace, partial(_num_bytes, bits=bits), given.max_bytes)
        if grid is None:
            continue
        distance = given.fields(grid.free, grid.free)
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
