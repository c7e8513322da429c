"""The parts of PRM*: the local planner, how far to connect, which configurations to draw, which pairs to join."""

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Int
from scipy.spatial import KDTree
from tqdm import tqdm

from plr_jax._arrays import as_booleans, as_finite, runs
from plr_jax._types import Points
from plr_jax.geometry.box import Box
from plr_jax.oracles._metric import Metric

IsFree: TypeAlias = Callable[[Points], Bool[np.ndarray, "n"]]
IsVisible: TypeAlias = Callable[[Points, Points], Bool[np.ndarray, "n"]]

_BATCH = 2**18  # configurations tested at a time: a few tens of megabytes
_EDGES_A_STEP = 2**15  # edges tested between two signs of life of the progress bar
_MIN_FREE_FRACTION = 1e-4
_DRAWS_BEFORE_GIVING_UP = 100_000


def prm_star_radius(num_vertices: int, dim: int, free_volume: float) -> float:
    """Connection radius of PRM*, ``gamma (log n / n)^(1/dim)``, for ``n`` vertices, at least 2.

    References:
        Karaman and Frazzoli, IJRR 2011, section 3.3: asymptotically optimal for any ``gamma`` above
        ``2 (1 + 1/dim)^(1/dim) (free_volume / unit_ball_volume)^(1/dim)``; this bound itself is taken.
    """
    unit_ball_volume = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1)
    gamma = 2 * ((1 + 1 / dim) * free_volume / unit_ball_volume) ** (1 / dim)
    return gamma * (math.log(num_vertices) / num_vertices) ** (1 / dim)


def sample_free(metric: Metric, is_free: IsFree, num_samples: int, seed: int) -> tuple[Points, float]:
    """The first free draws of a uniform sequence over the domain, and an estimate of the free volume."""
    domain = metric.domain
    rng = np.random.default_rng(seed)
    batch = max(num_samples, 1000)
    accepted, num_free, num_drawn = [], 0, 0
    while num_free < num_samples:
        draws = domain.lo + domain.width * rng.random((batch, domain.dim))
        accepted.append(draws[is_free(draws)])
        num_free += len(accepted[-1])
        num_drawn += batch
        if num_drawn >= _DRAWS_BEFORE_GIVING_UP and num_free < _MIN_FREE_FRACTION * num_drawn:
            raise ValueError(
                f"Only {num_free} of {num_drawn} configurations drawn from the domain {domain} are free; "
                f"tighten the domain around free space, or check is_free."
            )
    return np.concatenate(accepted)[:num_samples], metric.volume * num_free / num_drawn


def visible_edges(vertices: Points, tree: KDTree, radius: float, is_visible: IsVisible) -> Int[np.ndarray, "e 2"]:
    """Pairs of vertices within the radius that see each other."""
    pairs = tree.query_pairs(radius, output_type="ndarray")
    visible = np.zeros(len(pairs), dtype=bool)
    with tqdm(total=len(pairs), desc="Roadmap edges", unit="edge", delay=3, disable=None) as progress:
        for i in range(0, len(pairs), _EDGES_A_STEP):
            start, end = pairs[i : i + _EDGES_A_STEP].T
            visible[i : i + _EDGES_A_STEP] = is_visible(vertices[start], vertices[end])
            progress.update(len(start))
    return pairs[visible].astype(np.int32)


def checked_is_free(domain: Box, is_free: IsFree) -> IsFree:
    """The user's test, false outside the domain, its answers checked. It is asked for wrapped points."""
    return partial(_is_free, domain, is_free)  # which can be pickled if the test can, as what follows


def _is_free(domain: Box, is_free: IsFree, x: Points) -> Bool[np.ndarray, "n"]:
    inside = domain.contains(x)
    if inside.any():
        inside[inside] = as_booleans("is_free", is_free(domain.wrapped(x[inside])), int(inside.sum()))
    return inside


def checked_is_visible(
    metric: Metric, is_free: IsFree, is_visible: IsVisible | None, resolution: float | None
) -> IsVisible:
    """The user's test, its answers checked, or one that samples motions at a resolution.

    Of motions the short way around periodic axes: to the image of the end that is nearest to the start.
    """
    if is_visible is None and resolution is not None:
        return partial(_is_visible_sampled, metric, is_free, as_finite("resolution", resolution, positive=True))
    if is_visible is None or resolution is not None:
        raise ValueError(
            "Give either is_visible, an exact test of motions, or resolution, the step of a sampled one."
        )
    return partial(_is_visible, metric.domain, is_visible)


def _is_visible(domain: Box, is_visible: IsVisible, a: Points, b: Points) -> Bool[np.ndarray, "n"]:
    if len(a) == 0:
        return np.zeros(0, dtype=bool)
    return as_booleans("is_visible", is_visible(a, domain.image_near(b, a)), len(a))


def _is_visible_sampled(
    metric: Metric, is_free: IsFree, resolution: float, a: Points, b: Points
) -> Bool[np.ndarray, "n"]:
    """Whether each straight motion between free points is free wherever it is tested."""
    b = metric.domain.image_near(b, a)
    num_steps = np.ceil(metric.lengths(a, b) / resolution).astype(np.int64)
    num_tests = np.maximum(num_steps - 1, 0)
    visible = np.ones(len(a), dtype=bool)
    batch = np.cumsum(num_tests) // _BATCH
    for rows in np.split(np.arange(len(a)), np.flatnonzero(np.diff(batch)) + 1):
        row, step = runs(num_tests[rows])
        motion = rows[row]
        x = a[motion] + ((1 + step) / num_steps[motion])[:, None] * (b - a)[motion]
        visible[motion[~is_free(x)]] = False
    return visible
