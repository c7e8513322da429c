"""A neural network of two points, the same in both orders, whose answer is the straight line or more.

Both points, as coordinates and as sines and cosines of four octaves, go through one encoder; from the sum and the
difference of what comes out, and the straight line, a second part tells the detour. Weights are kept as 16-bit
floats. Adam with a cosine schedule minimizes Huber's loss over the training pairs.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from experiments.summaries._given import Candidates, Given, compiled, straight

_OCTAVES = 4
_BATCH = 1_024
_RATES = (1e-2, 2e-3)  # the former for few weights
_FEW = 5_000
_DELTA = 1.0  # mean detours, below which an error counts by its square
_WORK, _FEWEST_STEPS, _MOST_STEPS, _SMOKE_STEPS = 1_000_000_000, 3_000, 20_000, 20  # weights times steps

Layers = list[tuple[Float[Array, "inputs outputs"], Float[Array, " outputs"]]]


def candidates(given: Given) -> Candidates:
    """The widest network that the bytes allow."""
    inputs = 2 + 4 * _OCTAVES
    # Weights of the layers below: 3 h^2 + (inputs + 6) h + 1.
    linear, count = inputs + 6, given.max_bytes // 2 - 10  # the map's frame, and the mean detour
    hidden = int((-linear + np.sqrt(linear**2 + 12 * (count - 1))) / 6)
    widths = [(inputs, hidden), (hidden, hidden), (2 * hidden + 1, hidden), (hidden, 1)]
    num_weights = sum((n + 1) * m for n, m in widths)
    steps = _SMOKE_STEPS if given.smoke else int(np.clip(_WORK // num_weights, _FEWEST_STEPS, _MOST_STEPS))
    lo, width = given.workspace.bounds.lo.astype(np.float32), np.float32(given.workspace.bounds.width.max())
    pairs = tuple(jnp.asarray(column, jnp.float32) for column in given.training)
    length = np.linalg.norm(given.training.x - given.training.y, axis=1)
    detour = np.float32(max((given.training.distance - length).mean(), 1e-6 * width))

    def of_pair(layers: Layers, x: Array, y: Array) -> Array:
        length = straight(x, y)
        return length + detour * _detours(layers, (x - lo) / width, (y - lo) / width, length / width)

    layers = _trained(of_pair, detour, _initial(widths, given.seed), pairs, steps, given.seed)
    kept = jax.tree_util.tree_map(lambda weights: weights.astype(jnp.float16).astype(jnp.float32), layers)
    summary = compiled(2 * num_weights + 20, lambda x, y: of_pair(kept, x, y))
    yield f"{num_weights:,} weights, {steps:,} steps of {_BATCH:,} pairs", summary


def _initial(widths: list[tuple[int, int]], seed: int) -> Layers:
    keys = jax.random.split(jax.random.key(seed), len(widths))
    return [
        (jax.random.normal(key, shape) * np.sqrt(2 / shape[0]), jnp.zeros(shape[1]))
        for key, shape in zip(keys, widths, strict=True)
    ]


def _features(x: Float[Array, "2"]) -> Float[Array, " inputs"]:
    angles = (x[:, None] * np.pi * 2.0 ** np.arange(_OCTAVES, dtype=np.float32)).ravel()
    return jnp.concatenate([2 * x - 1, jnp.sin(angles), jnp.cos(angles)])


def _detours(layers: Layers, x: Array, y: Array, length: Array) -> Float[Array, ""]:
    """By how many mean detours the path is longer than the straight line, of the map as the unit square."""
    outer, inner, joint, last = layers
    codes = jnp.stack([_features(x), _features(y)])
    for weights, offset in (outer, inner):
        codes = jax.nn.silu(codes @ weights + offset)
    both = jnp.concatenate([codes.sum(axis=0), jnp.abs(codes[0] - codes[1]), length[None]])
    return jax.nn.softplus(jax.nn.silu(both @ joint[0] + joint[1]) @ last[0][:, 0] + last[1][0])


def _trained(
    of_pair: Any, detour: np.float32, layers: Layers, pairs: tuple[Array, ...], steps: int, seed: int
) -> Layers:
    num_weights = sum(leaf.size for leaf in jax.tree_util.tree_leaves(layers))
    rate = _RATES[0] if num_weights < _FEW else _RATES[1]
    optimizer = optax.adam(optax.cosine_decay_schedule(rate, steps))

    def loss(layers: Layers, batch: Array) -> Array:
        x, y, distance = (column[batch] for column in pairs)
        error = jax.vmap(of_pair, (None, 0, 0))(layers, x, y) - distance
        return optax.huber_loss(error / detour, delta=_DELTA).mean()

    def step(state: tuple[Layers, Any], key: Array) -> tuple[tuple[Layers, Any], None]:
        layers, moments = state
        slope = jax.grad(loss)(layers, jax.random.randint(key, (_BATCH,), 0, len(pairs[0])))
        change, moments = optimizer.update(slope, moments)
        return (optax.apply_updates(layers, change), moments), None  # type: ignore[reportReturnType]

    keys = jax.random.split(jax.random.key(seed + 1), steps)
    (layers, _), _ = jax.jit(lambda state, keys: jax.lax.scan(step, state, keys))(
        (layers, optimizer.init(layers)), keys
    )
    return layers
