"""The parts of PRM*: how far to connect, which configurations to draw, which pairs to join."""

import math

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree
from tqdm import tqdm

from plr_jax._types import Points
from plr_jax.geometry.box import Box
from plr_jax.oracles._local_planner import IsFree, IsVisible

_EDGES_A_STEP = 2**15  # edges tested between two signs of life of the progress bar
_MIN_FREE_FRACTION = 1e-4
_DRAWS_BEFORE_GIVING_UP = 100_000


def prm_star_radius(num_vertices: int, dim: int, free_volume: float) -> float:
    """Connection radius of PRM*, ``gamma (log n / n)^(1/dim)``.

    Args:
        num_vertices: Number of vertices ``n``, at least 2.
        dim: Dimension of the space.
        free_volume: Volume of free space.

    References:
        Karaman and Frazzoli, IJRR 2011, section 3.3: asymptotically optimal for any ``gamma`` above
        ``2 (1 + 1/dim)^(1/dim) (free_volume / unit_ball_volume)^(1/dim)``; this bound itself is taken.
    """
    gamma = 2 * ((1 + 1 / dim) * free_volume / unit_ball_volume(dim)) ** (1 / dim)
    return gamma * (math.log(num_vertices) / num_vertices) ** (1 / dim)


def unit_ball_volume(dim: int) -> float:
    """Volume of the Euclidean ball of radius 1."""
    return math.pi ** (dim / 2) / math.gamma(dim / 2 + 1)


def sample_free(domain: Box, is_free: IsFree, num_samples: int, seed: int) -> tuple[Points, float]:
    """The first free draws of a uniform sequence over the domain, and an estimate of the free volume."""
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
    return np.concatenate(accepted)[:num_samples], float(np.prod(domain.width)) * num_free / num_drawn


def visible_edges(tree: KDTree, radius: float, is_visible: IsVisible) -> Int[np.ndarray, "e 2"]:
    """Pairs of vertices within the radius that see each other."""
    pairs = tree.query_pairs(radius, output_type="ndarray")
    visible = np.zeros(len(pairs), dtype=bool)
    with tqdm(total=len(pairs), desc="Roadmap edges", unit="edge", delay=3, disable=None) as progress:
        for i in range(0, len(pairs), _EDGES_A_STEP):
            start, end = pairs[i : i + _EDGES_A_STEP].T
            visible[i : i + _EDGES_A_STEP] = is_visible(tree.data[start], tree.data[end])
            progress.update(len(start))
    return pairs[visible].astype(np.int32)
