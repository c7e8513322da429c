"""Factors of the cost of motions that differ from place to place: the slowness of a ground, a risk."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, shortened
from plr_jax._types import ArrayLike


@runtime_checkable
class CostMap(Protocol):
    """A positive factor of the cost of a motion at each configuration, with bounds of it over boxes.

    A motion through ``q`` costs ``cost_map(q)`` times what the space's ``motion_cost`` says: with the reciprocal of a
    speed for a factor, costs are times.
    """

    def __call__(self, q: ArrayLike, /) -> Float[np.ndarray, "n"]:
        """The factor at configurations ``(n, dof)``."""
        ...

    def bounds(
        self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"], /
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """A positive lower and a finite upper bound of the factor over each box ``lo`` to ``hi``.

        Around periodic axes boxes may leave the domain.
        """
        ...


@dataclass(frozen=True)
class LipschitzCost:
    """A cost map of a function that changes by at most so much a unit of distance.

    Args:
        cost_fn: The factor at configurations ``(n, dof)``, positive.
        lipschitz: The most by which it changes along a unit of Euclidean distance in configurations, at least 0.
        least: A positive number that the factor is nowhere below, for boxes so large that nothing else is known.

    Raises:
        ValueError: If an argument is of another kind or out of its range.
    """

    cost_fn: Callable[[np.ndarray], ArrayLike]
    lipschitz: float
    least: float

    def __post_init__(self):
        if not callable(self.cost_fn):
            raise ValueError(f"cost_fn must be a function of configurations, got {shortened(self.cost_fn)}.")
        vars(self).update(
            lipschitz=as_finite("lipschitz", self.lipschitz), least=as_finite("least", self.least, positive=True)
        )

    def __call__(self, q: ArrayLike) -> Float[np.ndarray, "n"]:
        """The factor at configurations.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The factors, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a number that is not finite or below ``least``.
        """
        q = np.asarray(q, np.float64)
        factor = np.asarray(self.cost_fn(q), np.float64)
        if factor.shape != q.shape[:1]:
            raise ValueError(f"cost_fn must return one number a configuration, ({len(q)},), got {factor.shape}.")
        bad = np.flatnonzero(~((factor >= self.least) & (factor < np.inf)))
        if bad.size:
            raise ValueError(
                f"cost_fn must return finite numbers of at least {self.least:g}, got {factor[bad[0]]} at "
                f"{q[bad[0]].tolist()}."
            )
        return factor

    def bounds(
        self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Bounds of the factor over boxes.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            What the factor at the center, and the constant, allow.
        """
        middle, reach = self((lo + hi) / 2), self.lipschitz * np.linalg.norm((hi - lo) / 2, axis=1)
        return np.maximum(middle - reach, self.least), middle + reach
