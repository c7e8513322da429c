"""How far configurations are apart: weighted differences, the short way around periodic axes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from plr_jax._arrays import as_finite_point
from plr_jax._types import ArrayLike, Points
from plr_jax.geometry.box import Box


@dataclass(frozen=True, eq=False)
class Metric:
    """The Euclidean norm of weighted differences of configurations of a domain.

    Attributes:
        domain: The domain, which says which axes are periodic.
        weights: What a unit along each axis counts, such as a radian in units of length; positive.
    """

    domain: Box
    weights: Float[np.ndarray, "dim"]

    @property
    def is_euclidean(self) -> bool:
        """Whether it is the Euclidean distance."""
        return not self.domain.is_periodic and bool((self.weights == 1).all())

    @property
    def widths(self) -> Float[np.ndarray, "dim"]:
        """Weighted widths of the domain: of a periodic axis its period."""
        return self.weights * self.domain.width

    def lengths(self, a: Float[np.ndarray, "#n dim"], b: Points) -> Float[np.ndarray, "n"]:
        """Lengths of the motions from some configurations to others."""
        return np.linalg.norm(self.weights * self.domain.difference(b, a), axis=1)

    def tree(self, vertices: Points) -> KDTree:
        """A k-d tree of configurations, to be asked for :meth:`places`; its distances are those of the metric."""
        periods = np.where(self.domain.periodic, self.widths, 0.0) if self.domain.is_periodic else None
        return KDTree(self.places(vertices), boxsize=periods)

    def places(self, x: Points) -> Points:
        """Coordinates in the k-d tree, where periodic axes run from 0 to below their weighted period."""
        around = self.weights * (self.domain.wrapped(x) - self.domain.lo)
        around = np.where(around < self.widths, around, 0.0)  # rounding may close the circle
        return np.where(self.domain.periodic, around, self.weights * x)


def metric_of(domain: Box, weights: ArrayLike | None) -> Metric:
    """The metric of given weights, 1 each if there are none; raises ``ValueError`` if one is not positive."""
    if weights is None:
        return Metric(domain, np.ones(domain.dim))
    weights = as_finite_point("weights", weights, domain.dim)
    if (weights <= 0).any():
        raise ValueError(f"weights must be positive, one an axis, got {weights.tolist()}.")
    return Metric(domain, weights)
