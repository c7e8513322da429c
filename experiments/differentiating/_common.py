"""What several sections share: the mean of distances, and timing."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Timing(NamedTuple):
    """The least time of several calls: wall and CPU seconds."""

    wall: float
    cpu: float


def mean_of_finite(distance: Any) -> Any:
    """Return the mean distance of the points that reach the goal."""
    is_finite = jnp.isfinite(distance)
    return jnp.where(is_finite, distance, 0).sum() / is_finite.sum()


def least(call: Callable[[], Any], turns: int) -> Timing:
    """Return the least wall time and the least CPU time of a call, both of ``turns`` calls."""
    walls, cpus = [], []
    for _ in range(turns):
        wall, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(call())
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return Timing(min(walls), min(cpus))


def compiled(function: Callable[..., Any], *arguments: Any) -> tuple[Callable[..., Any], float]:
    """Return a function compiled for these arguments, and the seconds that it took to compile."""
    began = time.perf_counter()
    return jax.jit(function).lower(*arguments).compile(), time.perf_counter() - began
