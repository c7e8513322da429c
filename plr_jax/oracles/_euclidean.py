"""Straight-line distance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._geometry import as_points
from plr_jax._types import ArrayLike, Distances


@dataclass(frozen=True, eq=False, init=False)
class Euclidean:
    """Straight-line distance to a goal, in any dimension, as if there were no obstacles.

    Args:
        goal: The goal, ``(dim,)``, finite.

    Raises:
        ValueError: If the goal is not a vector of finite numbers.
    """

    goal: Float[np.ndarray, "dim"]

    def __init__(self, goal: ArrayLike):
        object.__setattr__(self, "goal", as_goal(goal))

    def __call__(self, x: ArrayLike) -> Distances:
        """Distance of each point to the goal.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Distances, ``(n,)``; NaN for NaN points.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        return np.linalg.norm(as_points("x", x, self.goal.size) - self.goal, axis=1)


def as_goal(goal: ArrayLike) -> Float[np.ndarray, "dim"]:
    """A goal as a read-only vector of finite numbers, or a ValueError."""
    try:
        vector = np.array(goal, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"The goal must be a vector of finite numbers, got {goal!r}.") from None
    if vector.ndim != 1 or vector.size == 0 or not np.isfinite(vector).all():
        raise ValueError(f"The goal must be a vector of finite numbers, got {goal!r}.")
    vector.flags.writeable = False
    return vector
