"""Times of contenders that take turns."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


class Seconds(NamedTuple):
    """Seconds of a call: the median over all timed calls, and the quartiles."""

    median: float
    lower_quartile: float
    upper_quartile: float


def interleaved(
    contenders: dict[str, Callable[[], Any]], num_turns: int = 15, seconds_a_turn: float = 0.02
) -> dict[str, Seconds]:
    """Seconds of a call of each contender.

    The contenders take turns, so that a machine that slows down does so for all. A turn is one call that is not
    timed, which wakes threads and fills caches, and then timed calls, at least one, for ``seconds_a_turn`` seconds.
    Results are waited for. Whatever is compiled, is so before the first turn.

    Args:
        contenders: A call of each, by name.
        num_turns: Turns of each.
        seconds_a_turn: How long a turn lasts at least, unless one call takes longer.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for call in contenders.values():
        jax.block_until_ready(call())
    for _ in range(num_turns):
        for name, call in contenders.items():
            seconds[name].append(_turn(call, seconds_a_turn))
    return {
        name: Seconds(*(float(q) for q in np.quantile(times, [0.5, 0.25, 0.75]))) for name, times in seconds.items()
    }


def _turn(call: Callable[[], Any], seconds_a_turn: float) -> float:
    """Median seconds of the timed calls of one turn."""
    _wait(call())
    times, begun = [], time.perf_counter()
    while not times or time.perf_counter() - begun < seconds_a_turn:
        start = time.perf_counter()
        _wait(call())
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _wait(result: Any) -> None:
    """Wait for a result; for a single array without the search for arrays in it, which takes microseconds."""
    if isinstance(result, jax.Array):
        result.block_until_ready()
    elif not isinstance(result, np.ndarray):
        jax.block_until_ready(result)
