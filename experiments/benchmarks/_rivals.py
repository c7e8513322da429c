"""What every rival of a PLR has in common, and how a rival that is not installed is skipped."""

import lzma
from bisect import bisect_left
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int
from scipy import ndimage

from plr_jax import Box, Workspace
from plr_jax._types import DistanceFn


class Rival(NamedTuple):
    """An approximation of a distance function in the plane.

    Attributes:
        num_bytes: Bytes of the numbers it is made of.
        answer: Its fastest call for a batch of points ``(n, 2)``.
        on_device: Whether it takes and gives JAX arrays, of float32; else NumPy arrays.
    """

    num_bytes: int
    answer: Callable[[Any], Any]
    on_device: bool = False

    def on_host(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Answers as float64 NumPy numbers, to points of any precision."""
        return np.asarray(self.answer(jnp.asarray(x, jnp.float32) if self.on_device else x), np.float64)


def make_all(makers: dict[str, Callable[[], Any]]) -> tuple[dict[str, Any], dict[str, str]]:
    """What each maker makes; and for those whose package is absent, the reason why they are skipped."""
    made, skipped = {}, {}
    for name, make in makers.items():
        try:
            made[name] = make()
        except ModuleNotFoundError as error:
            skipped[name] = f"{error.name} is not installed: pip install '.[baselines]'"
    return made, skipped


# Rivals that interpolate the nodes of regular grids, and a travel-time field.

_BYTES_A_FLOAT = 4
_BYTES_OF_HEADER = 12  # of a coded grid: rows and columns as 16-bit numbers; least value and step as 32-bit floats
_NODES_A_BYTE = np.geomspace(1, 8, 22)  # of a coded grid; the best on four maps have 2.4 to 6
_NEAR_BEST = np.linspace(0.92, 1.1, 19)
_POWERS = np.arange(20, 0, -1 / 8)  # steps of a coded grid: the range of its values over 2**power, finest first
# LZMA without its own header. Values are bytes, so no position in a word is special; a large dictionary takes time.
_LZMA = [{"id": lzma.FILTER_LZMA2, "preset": 9, "dict_size": 2**20, "lc": 4, "lp": 0, "pb": 0}]


class Grid(NamedTuple):
    """Values at the nodes of a regular grid, and the bytes that these take."""

    axes: tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " columns"]]
    values: Float[np.ndarray, "rows columns"]
    num_bytes: int

    @property
    def corner(self) -> Float[np.ndarray, "2"]:
        """The first node."""
        return np.array([axis[0] for axis in self.axes])

    @property
    def spacing(self) -> Float[np.ndarray, "2"]:
        """Distance of neighbors along each axis."""
        return np.array([axis[1] - axis[0] for axis in self.axes])


def filled_grid(workspace: Workspace, exact: DistanceFn, num_bytes: int) -> Grid:
    """Float32 nodes that fill so many bytes; those in obstacles take the value of the nearest free node."""
    axes = _axes(workspace.bounds, num_bytes // _BYTES_A_FLOAT)
    return _filled(axes, _on_nodes(exact, axes))


def coded_grid(
    workspace: Workspace,
    exact: DistanceFn,
    num_bytes: int,
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, " n"],
) -> Grid:
    """Code a grid in so many bytes: values are multiples of a step, predicted from their neighbors and compressed.

    Each number of nodes takes the finest step that fits. Return the grid with the least mean error at the samples
    ``x``, among numbers of nodes over the whole range, then among numbers near the best of these.
    """

    def best(num_nodes: Float[np.ndarray, " numbers"]) -> Grid:
        sizes = _BYTES_A_FLOAT * num_nodes.astype(int)
        grids = [_finest(filled_grid(workspace, exact, size), num_bytes) for size in sizes]
        return min(grids, key=lambda grid: np.abs(scipy_grid(grid).on_host(x) - distance).mean())

    return best(best(num_bytes * _NODES_A_BYTE).values.size * _NEAR_BEST)


def _finest(grid: Grid, num_bytes: int) -> Grid:
    """Code a grid with the finest step that fits."""
    first = bisect_left(_POWERS, True, key=lambda power: _rounded(grid, power).num_bytes <= num_bytes)
    return _rounded(grid, _POWERS[first])


def _rounded(grid: Grid, power: float) -> Grid:
    """Round a grid's values to multiples of a step."""
    lo, step = float(grid.values.min()), float(np.ptp(grid.values)) / 2**power
    multiples = np.round((grid.values - lo) / step).astype(np.int64)
    size = _BYTES_OF_HEADER + _compressed_size(multiples)
    return Grid(grid.axes, (lo + step * multiples).astype(np.float32), size)


def _compressed_size(multiples: Int[np.ndarray, "rows columns"]) -> int:
    """Count the bytes that LZMA takes for the nodes' differences from the plane through three neighbors."""
    # Predicted: f[i, j] = f[i - 1, j] + f[i, j - 1] - f[i - 1, j - 1].
    differences = np.diff(np.diff(multiples, axis=0, prepend=0), axis=1, prepend=0).ravel()
    unsigned = np.where(differences < 0, -2 * differences - 1, 2 * differences)
    # The low bytes of all nodes come first, then their higher bytes, as far as any is not zero.
    low_to_high = unsigned.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return len(lzma.compress(low_to_high[low_to_high.any(axis=1)].tobytes(), lzma.FORMAT_RAW, filters=_LZMA))


def travel_time_grid(workspace: Workspace, goal: Float[np.ndarray, "2"], num_bytes: int) -> Grid:
    """The field of scikit-fmm on float32 nodes; those in obstacles are NaN, as the fast marching leaves them.

    A front cannot start at a point between nodes: it starts at a circle, large enough to hold one.
    """
    import skfmm

    axes = _axes(workspace.bounds, num_bytes // _BYTES_A_FLOAT)
    spacing = [float(axis[1] - axis[0]) for axis in axes]
    radius = float(np.linalg.norm(spacing))
    blocked = ~_on_nodes(workspace.is_free, axes).astype(bool)
    from_circle = _on_nodes(lambda x: np.linalg.norm(x - goal, axis=1), axes) - radius
    field = skfmm.distance(np.ma.MaskedArray(from_circle, blocked), dx=spacing)  # type: ignore[reportArgumentType]  # a list too
    values = np.ma.filled(field, np.nan).astype(np.float32) + np.float32(radius)
    return Grid(axes, values, values.nbytes)


def scipy_grid(grid: Grid) -> Rival:
    """``scipy.ndimage.map_coordinates`` of first order; beyond the grid, the nearest point on its border answers."""
    lo, scale = grid.corner, 1 / grid.spacing

    def answer(x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        return ndimage.map_coordinates(grid.values, ((x - lo) * scale).T, order=1, mode="nearest")

    return Rival(grid.num_bytes, answer)


def jax_grid(grid: Grid) -> Rival:
    """``jax.scipy.ndimage.map_coordinates`` of first order; the nodes are a constant of the compiled code."""
    values = jnp.asarray(grid.values)
    lo = grid.corner.astype(np.float32)
    scale = (1 / grid.spacing).astype(np.float32)

    def answer(x: Float[Array, "n 2"]) -> Float[Array, " n"]:
        return jax.scipy.ndimage.map_coordinates(values, list(((x - lo) * scale).T), order=1, mode="nearest")

    return Rival(grid.num_bytes, jax.jit(answer), True)


def _axes(bounds: Box, num_nodes: int) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " columns"]]:
    """Nodes spread in proportion to the sides of the map."""
    width, height = bounds.width
    rows = int(np.sqrt(num_nodes * width / height))
    return (
        np.linspace(bounds.lo[0], bounds.hi[0], rows),
        np.linspace(bounds.lo[1], bounds.hi[1], num_nodes // rows),
    )


def _on_nodes(
    function: Callable[[Any], Any], axes: tuple[np.ndarray, np.ndarray]
) -> Float[np.ndarray, "rows columns"]:
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(function(nodes.reshape(-1, 2)), np.float64).reshape(nodes.shape[:2])


def _filled(axes: tuple[np.ndarray, np.ndarray], values: Float[np.ndarray, "rows columns"]) -> Grid:
    grid = Grid(axes, values, _BYTES_A_FLOAT * values.size)
    _, nearest = cast(tuple, ndimage.distance_transform_edt(~np.isfinite(values), grid.spacing, return_indices=True))
    return grid._replace(values=values[tuple(nearest)].astype(np.float32))


# The rival nearest in kind: LightGBM's trees with a plane in every leaf.

_PACKED_BYTES_A_LEAF = 17  # axis, float32 threshold, three float32 coefficients
_PACKED_BYTES_OF_STUMP = 13
NUM_TREES = (1, 2, 4)
_NUM_THREADS = 2
_WORTH_A_THREAD = 10_000  # points; waking another thread costs more than it saves for fewer


def linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"], leaves: int, num_trees: int, seed: int
) -> Rival:
    """Trees with so many leaves each; bytes are counted as if packed, a fraction of the text that LightGBM saves."""
    trees = train_linear_trees(x, distance, leaves, num_trees, seed)

    def answer(x: Float[np.ndarray, "n 2"]) -> Any:
        return trees.predict(x, num_threads=_NUM_THREADS if len(x) >= _WORTH_A_THREAD else 1)

    return Rival(_PACKED_BYTES_OF_STUMP + _PACKED_BYTES_A_LEAF * leaves * num_trees, answer)


def train_linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"], leaves: int, num_trees: int, seed: int
) -> Any:
    """LightGBM's booster: a stump, then boosted trees with so many leaves each.

    LightGBM gives the leaves of its first tree no slope, so that tree is a stump, and all other leaves hold planes.
    """
    import lightgbm

    parameters = {
        "objective": "l2",
        "linear_tree": True,
        "learning_rate": 1.0,
        "min_data_in_leaf": 8,
        "max_bin": 1023,
        "linear_lambda": 1e-6,
        "seed": seed,
        "deterministic": True,
        "num_threads": _NUM_THREADS,
        "verbosity": -1,
    }
    data = lightgbm.Dataset(x, distance, free_raw_data=False)
    stump = lightgbm.train({**parameters, "num_leaves": 2}, data, num_boost_round=1)
    return lightgbm.train({**parameters, "num_leaves": leaves}, data, num_boost_round=num_trees, init_model=stump)


def leaves_that_fit(num_bytes: int, num_trees: int) -> int:
    """Leaves of each of so many trees that take so many packed bytes together."""
    return max(2, (num_bytes - _PACKED_BYTES_OF_STUMP) // _PACKED_BYTES_A_LEAF // num_trees)


def best_linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"], num_bytes: int, seed: int
) -> Rival:
    """One, two or four trees of so many packed bytes together, whichever are nearest to their own samples."""
    trees = [linear_trees(x, distance, leaves_that_fit(num_bytes, number), number, seed) for number in NUM_TREES]
    return min(trees, key=lambda rival: np.abs(rival.on_host(x) - distance).mean())


# The smooth rival: a small neural network, trained with optax.

_HIDDEN_LAYERS = 3
_BATCH = 2_048
_LEARNING_RATE = 1e-2
NUM_STEPS = 40_000  # 4,000 leave two to five times the mean error

Layers = list[tuple[Float[Array, "inputs outputs"], Float[Array, " outputs"]]]


def train_network(
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, " n"],
    num_bytes: int,
    num_steps: int,
    seed: int,
    dtype: Any = jnp.float32,
) -> Rival:
    """A network of rectified linear units whose weights fill so many bytes.

    Adam with a cosine schedule minimizes the mean error over batches of the samples, both scaled to a variance of
    about one. Another architecture may be more accurate for its bytes.

    Args:
        x: Samples.
        distance: Their distances.
        num_bytes: Bytes of all weights.
        num_steps: Batches to train on.
        seed: Seed of first weights and batches.
        dtype: Number type in which the weights are kept; they are trained, and used, as float32.
    """
    lo, width = x.min(axis=0), np.ptp(x, axis=0)
    mean, deviation = float(distance.mean()), float(distance.std())
    hidden = _width_of(num_bytes // jnp.dtype(dtype).itemsize)
    first = _initial([2, *[hidden] * _HIDDEN_LAYERS, 1], jax.random.key(seed))
    units = jnp.asarray(2 * (x - lo) / width - 1, jnp.float32)
    targets = jnp.asarray((distance - mean) / deviation, jnp.float32)
    trained = jax.block_until_ready(_train(first, units, targets, num_steps, seed))
    kept = jax.tree_util.tree_map(lambda weights: weights.astype(dtype).astype(jnp.float32), trained)
    lo, width = lo.astype(np.float32), width.astype(np.float32)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        return _apply(kept, 2 * (x - lo) / width - 1) * deviation + mean

    num_weights = sum(leaf.size for leaf in jax.tree_util.tree_leaves(kept))
    return Rival(num_weights * jnp.dtype(dtype).itemsize, jax.jit(function), True)


def _width_of(num_weights: int) -> int:
    """Width of the hidden layers: ``l`` of them, ``h`` wide, have ``(l - 1) h^2 + (l + 3) h + 1`` weights."""
    square, linear = _HIDDEN_LAYERS - 1, _HIDDEN_LAYERS + 3
    return int((-linear + np.sqrt(linear**2 + 4 * square * (num_weights - 1))) / (2 * square))


def _initial(widths: list[int], key: Array) -> Layers:
    keys = jax.random.split(key, len(widths) - 1)
    return [
        (jax.random.normal(key, (inputs, outputs)) * np.sqrt(2 / inputs), jnp.zeros(outputs))
        for key, inputs, outputs in zip(keys, widths[:-1], widths[1:], strict=True)
    ]


def _apply(layers: Layers, x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    *hidden, (weights, bias) = layers
    for inner, offset in hidden:
        x = jax.nn.relu(x @ inner + offset)
    # A product and a sum take a fraction of the time of a product of matrices with one column.
    return jnp.sum(x * weights[:, 0], axis=-1) + bias[0]


@partial(jax.jit, static_argnames="num_steps")
def _train(layers: Layers, x: Float[Array, "n 2"], distance: Float[Array, " n"], num_steps: int, seed: int) -> Layers:
    optimizer = optax.adam(optax.cosine_decay_schedule(_LEARNING_RATE, num_steps))

    def loss(layers: Layers, batch: Array) -> Array:
        return jnp.mean(jnp.abs(_apply(layers, x[batch]) - distance[batch]))

    def step(state: tuple[Layers, Any], key: Array) -> tuple[tuple[Layers, Any], None]:
        layers, moments = state
        slope = jax.grad(loss)(layers, jax.random.randint(key, (_BATCH,), 0, len(x)))
        change, moments = optimizer.update(slope, moments)
        return (optax.apply_updates(layers, change), moments), None  # type: ignore[reportReturnType]

    keys = jax.random.split(jax.random.key(seed + 1), num_steps)
    state, _ = jax.lax.scan(step, (layers, optimizer.init(layers)), keys)
    return state[0]
