"""The nearest of several goals, by the least cost of a straight motion."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from plr_jax.geometry.box import Box
from plr_jax.spaces import MotionCost

Points = Float[np.ndarray, "n dim"]


def nearest_goals(
    goals: Float[np.ndarray, "goals dim"], domain: Box, motion: MotionCost, x: Points, count: int = 1
) -> tuple[Float[np.ndarray, "n count"], Int[np.ndarray, "n count"]]:
    """Return Euclidean distances to the nearest goals, nearest first, and the indices of these goals.

    Each axis is scaled by its cost per unit of length, so no motion costs less than the returned distance. If there
    are fewer than ``count`` goals, the other distances are ``inf`` and the other indices are the number of goals.
    """
    scale = motion.scale
    if len(goals) == 1:
        distance, index = np.full((len(x), count), np.inf), np.ones((len(x), count), np.int64)
        distance[:, 0], index[:, 0] = np.linalg.norm(scale * domain.difference(goals[0], x), axis=1), 0
        return distance, index
    period = np.where(domain.periodic, domain.width * scale, 0.0)

    def placed(points: Points) -> Points:
        q = (domain.wrapped(points) - domain.lo) * scale
        return np.where((period > 0) & (q >= period), 0.0, q)

    tree: Any = KDTree(placed(goals), boxsize=period)
    distance, index = tree.query(placed(x), list(range(1, count + 1)))
    return distance, index.astype(np.int64)
