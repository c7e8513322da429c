"""The local planner of a roadmap: which configurations are free, which straight motions."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool

from plr_jax._types import ArrayLike, Points
from plr_jax.geometry.box import Box

IsFree: TypeAlias = Callable[[Points], Bool[np.ndarray, "n"]]
IsVisible: TypeAlias = Callable[[Points, Points], Bool[np.ndarray, "n"]]

_BATCH = 2**18  # configurations tested at a time: a few tens of megabytes


def checked_is_free(domain: Box, is_free: IsFree) -> IsFree:
    """The user's test, false outside the domain, its answers checked."""

    def checked(x: Points) -> Bool[np.ndarray, "n"]:
        inside = domain.contains(x)
        if inside.any():
            inside[inside] = _booleans("is_free", is_free(x[inside]), int(inside.sum()))
        return inside

    return checked


def checked_is_visible(is_free: IsFree, is_visible: IsVisible | None, resolution: float | None) -> IsVisible:
    """The user's test, its answers checked, or one that samples motions at a resolution."""
    if is_visible is None and resolution is not None:
        if not (resolution > 0 and math.isfinite(resolution)):
            raise ValueError(f"resolution must be a positive length, got {resolution}.")
        return lambda a, b: _is_visible_sampled(is_free, resolution, a, b)
    if is_visible is None or resolution is not None:
        raise ValueError(
            "Give either is_visible, an exact test of motions, or resolution, the step of a sampled one."
        )

    def checked(a: Points, b: Points) -> Bool[np.ndarray, "n"]:
        return _booleans("is_visible", is_visible(a, b), len(a)) if len(a) else np.zeros(0, dtype=bool)

    return checked


def _booleans(name: str, answer: ArrayLike, num_points: int) -> Bool[np.ndarray, "n"]:
    answer = np.asarray(answer)
    if answer.shape != (num_points,) or answer.dtype != bool:
        raise ValueError(
            f"{name} must return one boolean for each of {num_points} rows, shape ({num_points},); "
            f"got {answer.dtype} of shape {answer.shape}."
        )
    return answer


def _is_visible_sampled(is_free: IsFree, resolution: float, a: Points, b: Points) -> Bool[np.ndarray, "n"]:
    """Whether each straight motion between free points is free wherever it is tested."""
    num_steps = np.ceil(np.linalg.norm(b - a, axis=1) / resolution).astype(np.int64)
    num_tests = np.maximum(num_steps - 1, 0)
    visible = np.ones(len(a), dtype=bool)
    batch = np.cumsum(num_tests) // _BATCH
    for rows in np.split(np.arange(len(a)), np.flatnonzero(np.diff(batch)) + 1):
        motion = np.repeat(rows, num_tests[rows])
        # 1, 2, ..., num_tests of each motion, one after the other.
        step = 1 + np.arange(len(motion)) - np.repeat(np.cumsum(num_tests[rows]) - num_tests[rows], num_tests[rows])
        x = a[motion] + (step / num_steps[motion])[:, None] * (b - a)[motion]
        visible[motion[~is_free(x)]] = False
    return visible
