"""The local planner of a roadmap: which configurations are free, which straight motions."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Int

from plr_jax._box import Box
from plr_jax._types import ArrayLike, Points

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
        step = _ranges(np.ones_like(rows), num_tests[rows] + 1)
        x = a[motion] + (step / num_steps[motion])[:, None] * (b - a)[motion]
        visible[motion[~is_free(x)]] = False
    return visible


def _ranges(begin: Int[np.ndarray, "r"], end: Int[np.ndarray, "r"]) -> Int[np.ndarray, "m"]:
    """The integers of several half-open ranges, one after the other."""
    count = end - begin
    offset = np.repeat(np.cumsum(count) - count, count)
    return np.repeat(begin, count) + np.arange(count.sum()) - offset


def first_visible(
    point: Int[np.ndarray, "p"],
    num_points: int,
    sees: Callable[[Int[np.ndarray, "p"]], Bool[np.ndarray, "p"]],
) -> Int[np.ndarray, "n"]:
    """Index of the first visible pair of each point, -1 where there is none.

    Tests 1, 2, 4, ... more pairs of each point that is still without one: what a test of all pairs
    would find, with few tests where the first pairs are visible.

    Args:
        point: The point of each pair, ascending, the pairs of one point best first.
        num_points: Number of points ``n``.
        sees: Visibility of the pairs at given indices.
    """
    first = np.full(num_points, -1)
    begin, end = (
        np.searchsorted(point, np.arange(num_points)),
        np.searchsorted(point, np.arange(num_points), "right"),
    )
    pending, width = np.flatnonzero(begin < end), 1
    while pending.size:
        stop = np.minimum(begin[pending] + width, end[pending])
        pair = _ranges(begin[pending], stop)
        visible = pair[sees(pair)]
        # Written last to first, so that the first visible pair of a point is the one that stays.
        first[point[visible[::-1]]] = visible[::-1]
        begin[pending] = stop
        pending = pending[(first[pending] < 0) & (stop < end[pending])]
        width *= 2
    return first
