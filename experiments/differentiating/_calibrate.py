"""Fit a file of distances to measured travel times: 4 KB of exact distances, and 2,000 noisy times.

A region of the office floor, which the file does not know, is slow. ``TunablePLR`` starts from the exact distances.
Its loss is the mean square of relative errors at the samples, plus a weight times the bend of the change: how much
the slope of the change differs, on average, between pairs of points about a meter apart. A tenth of the samples
is held out: it chooses the weight, and when training stops. Nothing is tuned on the unseen points. Truth is
``cost_distance`` on a fine raster; all points are centers of its cells.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from experiments._measures import relative_error
from plr_jax import PLR, VisibilityGraph, construct, cost_distance, scenes

MAX_BYTES = 4_096
SAMPLES, UNSEEN, NOISE = 2_000, 20_000, 0.05
_CELL = 0.05  # meters
_SLOW = np.array([(6.0, 4.0), (14.0, 10.0)])  # lower and upper corner of the slow region
_FACTOR = 3.0
_NEAR = 2.0  # meters: errors near the goal, of paths much shorter than this, count by their absolute size
_ROUND = 50  # steps between two looks at the held-out samples
_STEPS, _RATE = 2_000, 0.1  # of the PLR; the rate in meters
_WEIGHTS = (1e-3, 2e-3, 3e-3, 5e-3, 1e-2)  # of the bend
_BEND_POINTS, _APART = 4_000, 0.8  # number of pairs of points, and the standard deviation of their offsets in meters
_SMALL_BEND = 0.03  # below this, bends count by their square
# Networks: hidden layers, octaves of sines and cosines of the coordinates, rates, weight decays; 16-bit weights.
_NETWORK_STEPS = 5_000
_LAYERS, _OCTAVES, _RATES, _DECAYS = (1, 2, 3), (0, 3), (1e-2, 3e-3), (0.0,)


class Samples(NamedTuple):
    x: Any
    time: Any


class Fit(NamedTuple):
    """What training chose: parameters of the least error at held-out samples, and that error."""

    parameters: Any
    held_out: float
    about: dict[str, Any]


Predict = Callable[[Any, Any], Any]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem, rng = scenes.floor_plan(), np.random.default_rng(seed)
    workspace, goal = problem.workspace, problem.goals[0]
    exact = construct(VisibilityGraph(workspace, goal), workspace.bounds, leaf="continuous", max_bytes=MAX_BYTES)
    x, truth = travel_times(workspace, goal, 0.5 if smoke else _CELL)
    known = np.isfinite(truth) & np.isfinite(exact(x)) & (truth > 0)
    drawn = rng.permutation(np.flatnonzero(known))[: SAMPLES + UNSEEN]
    number = SAMPLES if not smoke else len(drawn) // 2
    x, truth = x[drawn], truth[drawn]
    times = truth[:number] * (1 + NOISE * rng.standard_normal(number))
    samples, held_out = (
        Samples(x[part].astype(np.float32), times[part].astype(np.float32))
        for part in (slice(number // 10, number), slice(number // 10))
    )
    x_samples, x, truth = x[:number], x[number:], truth[number:]
    began = time.perf_counter()
    ours = fitted_plr(exact, workspace, samples, held_out, rng, smoke)
    seconds = {"fitted": time.perf_counter() - began}
    began = time.perf_counter()
    predict, network, num_weights = fitted_network(samples, held_out, seed, smoke)
    seconds["network"] = time.perf_counter() - began
    fit = ours.parameters.to_plr(max_bytes=MAX_BYTES)
    predictions = {
        "start": exact(x),
        "fitted, before rounding": ours.parameters(x),
        "fitted": fit(x),
        "network": predict(network.parameters, x.astype(np.float32)),
    }
    for name, interpolant in interpolants(Samples(x_samples, times)).items():
        plr = construct(interpolant, workspace.bounds, leaf="continuous", max_bytes=MAX_BYTES)
        predictions |= {name: interpolant(x), f"construct, {name}": plr(x)}
    errors = {name: relative_error(np.asarray(found, float), truth) for name, found in predictions.items()}
    alone = {name: error for name, error in errors.items() if "interpolation" in name or "nearest" in name}
    best_alone = min(alone, key=lambda name: alone[name])
    return {
        "samples": number,
        "unseen": len(x),
        "noise": NOISE,
        "slow_factor": _FACTOR,
        "slower_by": float(truth.mean() / np.asarray(exact(x), float).mean()),
        "bytes": {"fitted": fit.num_bytes, "network": 2 * num_weights},
        "values": int(np.size(ours.parameters.values)),
        "errors": errors,
        "seconds": seconds,
        "fitted": ours.about | {"held_out": ours.held_out},
        "network": network.about | {"held_out": network.held_out},
        "network_settings": len(list(_settings())),
        "samples_alone": best_alone,
        "network_over_fitted": errors["network"] / errors["fitted"],
        "samples_alone_over_fitted": alone[best_alone] / errors["fitted"],
    }


def travel_times(workspace: Any, goal: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers of cells ``(n, 2)`` and their travel times to the goal at speed 1, slower in the region."""
    width, height = workspace.bounds.width
    columns, rows = round(width / cell), round(height / cell)
    x = (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5) * cell
    is_slow = ((_SLOW[0] <= x) & (x <= _SLOW[1])).all(axis=2)
    is_free = workspace.is_free(x.reshape(-1, 2)).reshape(rows, columns)
    costs = np.where(is_free, np.where(is_slow, _FACTOR, 1.0), np.inf)
    times = cost_distance(costs, goal[None], cell_size=cell).distance
    return x.reshape(-1, 2), np.asarray(times).ravel()


def squared_error(found: Any, samples: Samples) -> Any:
    return jnp.mean(((found - samples.time) / (_NEAR + samples.time)) ** 2)


def train(
    predict: Predict, loss: Callable[..., Any], first: Any, optimizer: Any, steps: int, held_out: Samples
) -> Any:
    """Return the parameters of the least held-out error, looked at every few steps, and this error."""

    def step(state, key):
        parameters, memory = state
        slope = jax.grad(loss)(parameters, key)
        change, memory = optimizer.update(slope, memory, parameters)
        return (optax.apply_updates(parameters, change), memory), None

    def look(state, keys):
        trained, best, least = state
        trained, _ = lax.scan(step, trained, keys)
        error = squared_error(predict(trained[0], held_out.x), held_out)
        best = jax.tree.map(lambda a, b: jnp.where(error < least, a, b), trained[0], best)
        return (trained, best, jnp.minimum(error, least)), None

    least = squared_error(predict(first, held_out.x), held_out)
    keys = jax.random.split(jax.random.key(0), (max(steps // _ROUND, 1), min(steps, _ROUND)))
    (_, best, least), _ = lax.scan(look, ((first, optimizer.init(first)), first, least), keys)
    return best, least


def fitted_plr(plr: PLR, workspace: Any, samples: Samples, held_out: Samples, rng: Any, smoke: bool) -> Fit:
    """Fit the values of a PLR; ``Fit.parameters`` is a ``TunablePLR``."""
    first = plr.tunable()
    lo, hi = plr.domain.lo, plr.domain.hi
    x = rng.uniform(lo, hi, (20 * _BEND_POINTS, 2))
    beside = np.clip(x + _APART * rng.standard_normal(x.shape), lo, hi)
    pairs = np.stack([x, beside], axis=1).astype(np.float32)
    is_free = workspace.is_free(x) & np.isfinite(plr(pairs)).all(axis=1)
    pairs = pairs[is_free][:_BEND_POINTS].reshape(-1, 2)

    def slopes(tunable):
        return jax.vmap(jax.grad(tunable.__call__))(pairs)

    @jax.jit
    def fit(weight):
        def loss(tunable, key):
            change = (slopes(tunable) - slopes(first)).reshape(-1, 2, 2)
            bend = jnp.sqrt(((change[:, 1] - change[:, 0]) ** 2).sum(axis=1) + _SMALL_BEND**2)
            return squared_error(tunable(samples.x), samples) + weight * bend.mean()

        steps = 2 if smoke else _STEPS
        optimizer = optax.adam(optax.cosine_decay_schedule(_RATE, steps))
        return train(lambda tunable, x: tunable(x), loss, first, optimizer, steps, held_out)

    fits = []
    for weight in _WEIGHTS[2:3] if smoke else _WEIGHTS:
        values, error = fit(weight)
        fits.append(Fit(values, float(error) ** 0.5, {"weight": weight}))
    return min(fits, key=lambda each: each.held_out)


def fitted_network(samples: Samples, held_out: Samples, seed: int, smoke: bool) -> tuple[Predict, Fit, int]:
    """Train networks of all settings; return the best function, its weights in 16 bits, and their number."""
    scale, mean = np.abs(samples.x).max(axis=0), samples.time.mean()
    found = []
    for setting in list(_settings())[: 1 if smoke else None]:
        hidden, octaves, rate, decay = setting
        widths = _widths(hidden, 2 + 4 * octaves)

        def predict(layers, x, octaves=octaves):
            return mean * _forward(layers, _features(2 * x / scale - 1, octaves))

        steps = 2 if smoke else _NETWORK_STEPS
        optimizer = optax.adamw(optax.cosine_decay_schedule(rate, steps), weight_decay=decay)
        loss = partial(_loss, predict, samples)
        first = _initial(widths, jax.random.key(seed))
        layers, _ = jax.jit(lambda first: train(predict, loss, first, optimizer, steps, held_out))(first)  # noqa: B023
        layers = jax.tree.map(lambda each: each.astype(jnp.float16).astype(jnp.float32), layers)
        error = float(squared_error(predict(layers, held_out.x), held_out)) ** 0.5
        about: dict[str, Any] = dict(zip(("hidden layers", "octaves", "rate", "weight decay"), setting, strict=True))
        found.append((predict, Fit(layers, error, about), sum((n + 1) * m for n, m in itertools.pairwise(widths))))
    return min(found, key=lambda each: each[1].held_out)


def _settings() -> Iterator[tuple[int, int, float, float]]:
    return itertools.product(_LAYERS, _OCTAVES, _RATES, _DECAYS)


def _widths(hidden: int, inputs: int) -> list[int]:
    """Return the widths of the largest network of 16-bit weights that fits."""

    def widths(width: int) -> list[int]:
        return [inputs, *[width] * hidden, 1]

    fits = [w for w in range(1, 2_000) if 2 * sum((n + 1) * m for n, m in itertools.pairwise(widths(w))) <= MAX_BYTES]
    return widths(fits[-1])


def _initial(widths: list[int], key: Any) -> list[tuple[Any, Any]]:
    keys = jax.random.split(key, len(widths) - 1)
    return [
        (jax.random.normal(key, shape) * np.sqrt(2 / shape[0]), jnp.zeros(shape[1]))
        for key, shape in zip(keys, itertools.pairwise(widths), strict=True)
    ]


def _features(x: Any, octaves: int) -> Any:
    angles = (x[..., None] * np.pi / 2 * 2.0 ** np.arange(octaves, dtype=np.float32)).reshape(len(x), -1)
    return jnp.concatenate([x, jnp.sin(angles), jnp.cos(angles)], axis=1)


def _forward(layers: list[tuple[Any, Any]], x: Any) -> Any:
    for weights, offset in layers[:-1]:
        x = jax.nn.silu(x @ weights + offset)
    return (x @ layers[-1][0] + layers[-1][1])[:, 0] + 1


def _loss(predict: Predict, samples: Samples, layers: Any, key: Any) -> Any:
    return squared_error(predict(layers, samples.x), samples)


def interpolants(samples: Samples) -> dict[str, Callable[[Any], np.ndarray]]:
    """Return interpolants of the samples: that of the nearest sample, and the linear one of Delaunay triangles."""
    x, times = (np.asarray(each, float) for each in samples)
    nearest, linear = NearestNDInterpolator(x, times), LinearNDInterpolator(x, times)

    def linear_or_nearest(x):
        found = linear(x)
        return np.where(np.isnan(found), nearest(x), found)

    return {"nearest": nearest, "linear interpolation": linear_or_nearest}
