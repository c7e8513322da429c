"""The straight-line distance to a goal, without obstacles: :class:`Euclidean`."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite_point, as_points
from plr_jax._types import ArrayLike, Distances, Symmetry


@dataclass(frozen=True, eq=False, init=False)
class Euclidean:
    """Straight-line distance to a goal, in any dimension, without obstacles.

    The goal is a vector of finite numbers, ``(dim,)``, else ``ValueError``.
    """

    goal: Float[np.ndarray, "dim"]
    is_lower_bound: ClassVar[bool] = True
    """True: no path of the robot's reference point is shorter."""

    def __init__(self, goal: ArrayLike):
        object.__setattr__(self, "goal", as_finite_point("The goal", goal))

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.goal.size

    @property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """One reflection for each axis, which mirrors this axis about the goal."""
        return tuple(Symmetry.about(self.goal, np.diag(signs)) for signs in 1 - 2 * np.eye(self.dim))

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance of points ``(n, dim)`` to the goal, ``inf`` if a coordinate is not finite."""
        distance = np.linalg.norm(as_points("x", x, self.goal.size) - self.goal, axis=1)
        return np.where(np.isnan(distance), np.inf, distance)
