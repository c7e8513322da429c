"""Measurements that experiments share: CPU seconds, errors, peak memory of a process."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def timed(call: Callable[[], T]) -> tuple[float, T]:
    """Return the CPU seconds of a call, summed over threads, and its result."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def ratios_in_turns(ours: Callable[[], float], rival: Callable[[], float], turns: int) -> list[float]:
    """Return the ratio of our seconds to a rival's in each turn, after one call of each that does not count."""
    for call in (ours, rival):
        call()
    return [ours() / rival() for _ in range(turns)]


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean error divided by the mean truth, both over the points where truth and answer are finite."""
    known = np.isfinite(truth) & np.isfinite(found)
    return float(np.abs(found - truth)[known].mean() / truth[known].mean())


def relative_errors(found: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """Return mean and largest error, and the share of points without a finite answer.

    The truth is finite at all points; errors are divided by its mean over all of them.
    """
    error = np.abs(found - truth) / truth.mean()
    known = np.isfinite(error)
    return {
        "mean": float(error[known].mean()) if known.any() else None,
        "largest": float(error[known].max()) if known.any() else None,
        "unanswered": float(1 - known.mean()),
    }


def columns(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return for each key the list of its values in ``rows``, which all have the same keys."""
    return {key: [row[key] for row in rows] for key in rows[0]}


def peak_megabytes() -> float:
    """Return this process's peak memory. Linux only: ``getrusage`` would include the peak of the parent process."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text("ascii").splitlines())
    return int(status["VmHWM"].split()[0]) * 1024 / 1e6
