"""What several sections share: the mean of distances, and timing."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Timing(NamedTuple):
    """Seconds of a call: the least wall time of several calls, and their mean CPU time."""

    wall: float
    cpu: float


def mean_of_finite(distance: Any) -> Any:
    """Return the mean distance of the points that reach the goal."""
    is_finite = jnp.isfinite(distance)
    return jnp.where(is_finite, distance, 0).sum() / is_finite.sum()


def least(call: Callable[[], Any], turns: int) -> Timing:
    """Return the least wall time and the mean CPU time of ``turns`` calls.

    Threads of the compiler's runtime may end their work after a call, so the CPU time of one call says little.
    """
    walls, cpu = [], time.process_time()
    for _ in range(turns):
        wall = time.perf_counter()
        jax.block_until_ready(call())
        walls.append(time.perf_counter() - wall)
    return Timing(min(walls), (time.process_time() - cpu) / turns)


def compiled(function: Callable[..., Any], *arguments: Any) -> tuple[Callable[..., Any], float]:
    """Return a function compiled for these arguments, and the seconds that it took to compile."""
    began = time.perf_counter()
    return jax.jit(function).lower(*arguments).compile(), time.perf_counter() - began
