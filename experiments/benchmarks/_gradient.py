"""Value and gradient together against value alone, for a PLR of the maze and the rivals of its bytes.

Those that JAX can differentiate are mapped over the points and compiled (``jax.vmap(jax.value_and_grad(...))``).
SciPy's grid stands for those that have no gradient: central differences, four further queries a point in the plane.
Errors of gradients are lengths of differences from the exact one, a unit vector.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments.benchmarks._query import LEAVES, POINT_SEED, SMOKE_LEAVES, makers, maze_plr
from experiments.benchmarks._rivals import Rival, compiled, make_all
from experiments.benchmarks._timing import interleaved
from plr_jax import scenes

_RIVALS = ("map_coordinates", "interpax, linear", "network", "SciPy RegularGridInterpolator")
_STEP_OF_GRID, _STEP_OF_ORACLE = 1e-3, 1e-6

ValueAndGradient = Callable[[Any], tuple[Any, Any]]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, turns, num_samples, num_steps = (1_000, 3, 2_000, 20) if smoke else (1_000_000, 15, 100_000, 4_000)
    plr, exact = maze_plr(SMOKE_LEAVES if smoke else LEAVES, seed)
    chosen = {
        name: make for name, make in makers(plr, exact, num_samples, num_steps, seed).items() if name in _RIVALS
    }
    rivals, skipped = make_all(chosen)
    contenders = {"PLR": Rival(plr.num_bytes, plr, True, plr), **rivals}
    values = {name: rival.answer for name, rival in contenders.items()}
    both = {name: value_and_gradient(rival) for name, rival in contenders.items()}
    x = np.random.default_rng(POINT_SEED + seed).random((num_points, 2)).astype(np.float32)
    calls = {"value": _calls(contenders, values, x), "both": _calls(contenders, both, x)}
    flat = {f"{name}, {what}": call for what, named in calls.items() for name, call in named.items()}
    seconds = interleaved(flat, turns)
    x_free = scenes.maze().workspace.sample_free(20_000, POINT_SEED + seed)
    distance, gradient = central_differences(exact, x_free, _STEP_OF_ORACLE)
    smooth = np.isfinite(gradient).all(axis=1)
    rows = {
        name: {
            "bytes": rival.num_bytes,
            **_errors(rival, both[name], x_free[smooth], distance[smooth], gradient[smooth]),
            **{what: [1e9 / num_points * s for s in seconds[f"{name}, {what}"]] for what in calls},
        }
        for name, rival in contenders.items()
    }
    return {"points": num_points, "rows": rows, "skipped": skipped}


def value_and_gradient(rival: Rival) -> ValueAndGradient:
    """The fastest call there is for values and gradients at a batch of points."""
    if rival.function is None:
        return partial(central_differences, rival.answer, step=_STEP_OF_GRID)
    return compiled(jax.value_and_grad(rival.function), rival.chunk)


def central_differences(
    function: Callable[[Any], Any], x: Float[np.ndarray, "n 2"], step: float
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]:
    """Values, and differences over twice the step along each axis."""
    steps = step * np.eye(2, dtype=x.dtype)
    with np.errstate(invalid="ignore"):  # both neighbors may be in an obstacle
        slopes = [(function(x + along) - function(x - along)) / (2 * step) for along in steps]
    return function(x), np.stack(slopes, axis=1)


def _calls(
    contenders: dict[str, Rival], answers: dict[str, Callable[[Any], Any]], x: Float[np.ndarray, "n 2"]
) -> dict[str, Callable[[], Any]]:
    on_device = jnp.asarray(x)
    return {name: partial(answers[name], on_device if rival.on_device else x) for name, rival in contenders.items()}


def _errors(
    rival: Rival,
    both: ValueAndGradient,
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, "n"],
    gradient: Float[np.ndarray, "n 2"],
) -> dict[str, float]:
    value, slope = both(jnp.asarray(x, jnp.float32) if rival.on_device else x)
    away = np.linalg.norm(np.asarray(slope) - gradient, axis=1)
    return {
        "mean": float(np.abs(np.asarray(value) - distance).mean()),
        "gradient_mean": float(away.mean()),
        "gradient_99": float(np.quantile(away, 0.99)),
    }
