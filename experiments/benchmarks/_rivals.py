"""What every rival of a PLR has in common, and how a rival that is not installed is skipped."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator, RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from plr_jax import Box, Workspace
from plr_jax._types import DistanceFn


class Rival(NamedTuple):
    """An approximation of a distance function in the plane.

    Attributes:
        num_bytes: Bytes of the numbers it is made of.
        answer: Its fastest call for a batch of points ``(n, 2)``.
        on_device: Whether it takes and gives JAX arrays, of float32; else NumPy arrays.
        function: Its answer to one point or many as a function that JAX can differentiate, if it is one.
        chunk: How many points its compiled code takes at once; None for all.
    """

    num_bytes: int
    answer: Callable[[Any], Any]
    on_device: bool = False
    function: Callable[[Float[Array, "*batch 2"]], Float[Array, "*batch"]] | None = None
    chunk: int | None = None

    def on_host(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Answers as float64 NumPy numbers, to points of any precision."""
        return np.asarray(self.answer(jnp.asarray(x, jnp.float32) if self.on_device else x), np.float64)


def compiled(function: Callable[[Float[Array, "2"]], Any], chunk: int | None) -> Callable[[Any], Any]:
    """A function of one point, compiled for a batch of them: all at once or in chunks."""
    if chunk is None:
        return jax.jit(jax.vmap(function))
    return jax.jit(lambda x: jax.lax.map(function, x, batch_size=chunk))


def make_all(makers: dict[str, Callable[[], Any]]) -> tuple[dict[str, Any], dict[str, str]]:
    """What each maker makes; and for those whose package is absent, the reason why they are skipped."""
    made, skipped = {}, {}
    for name, make in makers.items():
        try:
            made[name] = make()
        except ModuleNotFoundError as error:
            skipped[name] = f"{error.name} is not installed: pip install '.[baselines]'"
    return made, skipped


# Rivals that interpolate nodes: regular grids read by several libraries, a travel-time field, and triangles.

_BYTES_A_FLOAT = 4
_BYTES_A_VERTEX = 12
_CHUNK = 10_000
_CANDIDATES = 20_000  # SciPy takes a second to find the triangles of 10^5 points
_GROWTH = 3  # vertices are added in rounds of a third


class Grid(NamedTuple):
    """Values at the nodes of a regular grid, and the bytes that these take."""

    axes: tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " columns"]]
    values: Float[np.ndarray, "rows columns"]
    num_bytes: int

    @property
    def spacing(self) -> Float[np.ndarray, "2"]:
        """Distance of neighbors along each axis."""
        return np.array([axis[1] - axis[0] for axis in self.axes])


def filled_grid(workspace: Workspace, exact: DistanceFn, num_bytes: int) -> Grid:
    """Float32 nodes that fill so many bytes; those in obstacles take the value of the nearest free node."""
    axes = _axes(workspace.bounds, num_bytes // _BYTES_A_FLOAT)
    return _filled(axes, _on_nodes(exact, axes))


def sixteen_bit_grid(workspace: Workspace, exact: DistanceFn, num_bytes: int) -> Grid:
    """The same with 16-bit integers between the smallest and the largest value, so with twice as many nodes."""
    axes, values, _ = filled_grid(workspace, exact, 2 * num_bytes)
    lo, step = values.min(), np.ptp(values) / (2**16 - 1)
    return Grid(axes, (lo + step * np.round((values - lo) / step)).astype(np.float32), 2 * values.size)


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
    """SciPy's linear interpolation of a grid; what rounding moves out of the grid is answered too."""
    extrapolate: Any = None
    interpolator = RegularGridInterpolator(grid.axes, grid.values, bounds_error=False, fill_value=extrapolate)
    return Rival(grid.num_bytes, interpolator)


def map_coordinates(grid: Grid) -> Rival:
    """``jax.scipy.ndimage.map_coordinates`` of first order; the nodes are a constant of the compiled code."""
    values = jnp.asarray(grid.values)
    lo = np.array([axis[0] for axis in grid.axes], np.float32)
    scale = (1 / grid.spacing).astype(np.float32)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        nodes = [(x[..., axis] - lo[axis]) * scale[axis] for axis in range(2)]
        return jax.scipy.ndimage.map_coordinates(values, nodes, order=1, mode="nearest")

    return Rival(grid.num_bytes, jax.jit(function), True, function)


def interpax_grid(grid: Grid, method: str) -> Rival:
    """Interpax's interpolation of a grid, in chunks of points, with which it is faster than all at once."""
    import interpax

    rows, columns = (jnp.asarray(axis, jnp.float32) for axis in grid.axes)
    values = jnp.asarray(grid.values)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        return interpax.interp2d(x[..., 0], x[..., 1], rows, columns, values, method=method, extrap=True)

    return Rival(grid.num_bytes, compiled(function, _CHUNK), True, function, _CHUNK)


def triangles(
    workspace: Workspace, num_bytes: int, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"]
) -> Rival:
    """SciPy's linear interpolation over Delaunay triangles, whose vertices are chosen among samples.

    A vertex takes 12 bytes, its coordinates and value as float32; the triangles follow from the vertices. The corners
    of the workspace are vertices, with the value of the nearest sample, so that every point is in a triangle. As with
    a PLR, further ones go where the error is: in rounds, to the worst sample of each of the worst triangles.
    """
    x, distance = x[:_CANDIDATES], distance[:_CANDIDATES]
    (x0, y0), (x1, y1) = workspace.bounds.lo, workspace.bounds.hi
    corners = np.array([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])
    at_corners = NearestNDInterpolator(x, distance)(corners)
    most = num_bytes // _BYTES_A_VERTEX
    begun = max(1, most // 10)
    vertices, values = np.r_[corners, x[:begun]], np.r_[at_corners, distance[:begun]]
    while True:
        interpolator = LinearNDInterpolator(vertices, values)
        room = min(most - len(vertices), len(vertices) // _GROWTH)
        if room <= 0:
            return Rival(_BYTES_A_VERTEX * len(vertices), interpolator)
        worst = _worst_in_triangles(interpolator, x, distance)[:room]
        vertices, values = np.r_[vertices, x[worst]], np.r_[values, distance[worst]]


def _worst_in_triangles(
    interpolator: LinearNDInterpolator, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"]
) -> Int[np.ndarray, "triangles"]:
    """The sample of the largest error in each triangle, the worst first."""
    order = np.argsort(-np.abs(interpolator(x) - distance))
    _, first = np.unique(interpolator.tri.find_simplex(x)[order], return_index=True)
    return order[np.sort(first)]


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
    _, nearest = cast(tuple, distance_transform_edt(~np.isfinite(values), grid.spacing, return_indices=True))
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
    about one. Another architecture, or longer training, may be more accurate for its bytes.

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
    trained = _train(first, units, jnp.asarray((distance - mean) / deviation, jnp.float32), num_steps, seed)
    kept = jax.tree_util.tree_map(lambda weights: weights.astype(dtype).astype(jnp.float32), trained)
    lo, width = lo.astype(np.float32), width.astype(np.float32)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        return _apply(kept, 2 * (x - lo) / width - 1) * deviation + mean

    num_weights = sum(leaf.size for leaf in jax.tree_util.tree_leaves(kept))
    return Rival(num_weights * jnp.dtype(dtype).itemsize, jax.jit(function), True, function)


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
