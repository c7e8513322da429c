"""What experiments measure in the same way: seconds of all cores, errors beside a truth, the memory of a process."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def timed(call: Callable[[], T]) -> tuple[float, T]:
    """Seconds of all cores that a call takes, and what it returns."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """The mean error over the mean truth, where both are finite."""
    known = np.isfinite(truth) & np.isfinite(found)
    return float(np.abs(found - truth)[known].mean() / truth[known].mean())


def relative_errors(found: np.ndarray, truth: np.ndarray) -> dict[str, float | None]:
    """Mean and largest error over the mean truth, and the share of points that get no answer."""
    error = np.abs(found - truth) / truth.mean()
    known = np.isfinite(error)
    return {
        "mean": float(error[known].mean()) if known.any() else None,
        "largest": float(error[known].max()) if known.any() else None,
        "unanswered": float(1 - known.mean()),
    }


def peak_megabytes() -> float:
    """The most memory that this process had; ``getrusage`` counts what the one that started it had."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text("ascii").splitlines())
    return int(status["VmHWM"].split()[0]) * 1024 / 1e6
