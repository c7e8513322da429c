"""The smooth rival: a small neural network, trained with optax."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from experiments.benchmarks._rivals import Rival

_HIDDEN_LAYERS = 3
_BATCH = 2_048
_LEARNING_RATE = 1e-2

Layers = list[tuple[Float[Array, "inputs outputs"], Float[Array, "outputs"]]]


def train_network(
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, "n"],
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
def _train(layers: Layers, x: Float[Array, "n 2"], distance: Float[Array, "n"], num_steps: int, seed: int) -> Layers:
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
