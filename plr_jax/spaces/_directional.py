"""Costs of motions that depend on the way they go: climbing, and currents."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_numbers, shortened
from plr_jax._types import ArrayLike

Vectors: TypeAlias = Float[np.ndarray, "n dof"]
Rates: TypeAlias = Float[np.ndarray, "n"]


@dataclass(frozen=True)
class Climbing:
    """Cost of motions over a ground of some height: length, and so much more a unit of climbing; descending is free.

    Args:
        gradient_fn: Gradient of the height at configurations ``(n, dof)``, ``(n, dof)``.
        rate: What a unit of height costs, at least 0.
        lipschitz: The most by which the gradient changes a unit of distance, at least 0.
        steepest: The largest norm of the gradient anywhere, at least 0.

    Raises:
        ValueError: If an argument is of another kind or out of its range.
    """

    gradient_fn: Callable[[np.ndarray], ArrayLike]
    rate: float
    lipschitz: float
    steepest: float

    def __post_init__(self):
        if not callable(self.gradient_fn):
            raise ValueError(f"gradient_fn must be a function of configurations, got {shortened(self.gradient_fn)}.")
        for name in ("rate", "lipschitz", "steepest"):
            vars(self)[name] = as_finite(name, getattr(self, name))

    def _gradients(self, q: Vectors) -> Vectors:
        return _vectors("gradient_fn", self.gradient_fn, q, self.steepest)

    def __call__(self, q: ArrayLike) -> Rates:
        """What a motion of length 1 straight uphill costs.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The costs, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a gradient above ``steepest``.
        """
        return 1 + self.rate * np.linalg.norm(self._gradients(np.asarray(q, np.float64)), axis=1)

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates]:
        """Bounds of the cost of a motion of length 1 over boxes: the least is that of going down.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            The bounds, ``(n,)`` each.
        """
        _, uphill, _, most = self.pulls(lo, hi)
        return np.ones(len(lo)), np.minimum(most + np.linalg.norm(uphill, axis=1), 1 + self.rate * self.steepest)

    def pulls(self, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors, Rates, Rates]:
        """As :meth:`DirectionalCost.pulls`: nothing, and the gradient at the center.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            Zeros, the gradients times the rate, and 1 less and more what that may change within the box.
        """
        uphill = self.rate * self._gradients((lo + hi) / 2)
        spread = self.rate * self.lipschitz * np.linalg.norm((hi - lo) / 2, axis=1)
        return np.zeros_like(uphill), uphill, 1 - spread, 1 + spread


@dataclass(frozen=True)
class Current:
    """Time of motions in a current: a vehicle of some speed in the water, or the air, is carried along (Zermelo).

    Bounds of it do not meet even at a point: with a current half as fast as the vehicle, those of a motion along it
    are 27 % of the upper one apart, and estimates up to 13 % off; with one a tenth as fast, half a percent. Above 0.7
    of the vehicle's speed they say little.

    Args:
        velocity_fn: Velocity of the current at configurations ``(n, dof)``, ``(n, dof)``.
        speed: Speed of the vehicle in still water, positive.
        lipschitz: The most by which the velocity changes a unit of distance, at least 0.
        fastest: The largest speed of the current, below that of the vehicle, which else could not go everywhere.

    Raises:
        ValueError: If an argument is of another kind or out of its range.

    References:
        Zermelo, 1931. Bao, Robles and Shen, "Zermelo navigation on Riemannian manifolds", 2004, for the metric.
    """

    velocity_fn: Callable[[np.ndarray], ArrayLike]
    speed: float
    lipschitz: float
    fastest: float

    def __post_init__(self):
        if not callable(self.velocity_fn):
            raise ValueError(f"velocity_fn must be a function of configurations, got {shortened(self.velocity_fn)}.")
        vars(self)["speed"] = as_finite("speed", self.speed, positive=True)
        for name in ("lipschitz", "fastest"):
            vars(self)[name] = as_finite(name, getattr(self, name))
        if self.fastest >= self.speed:
            raise ValueError(f"fastest must be below speed, {self.speed:g}, got {self.fastest:g}.")

    def _velocities(self, q: Vectors) -> Vectors:
        return _vectors("velocity_fn", self.velocity_fn, q, self.fastest)

    def __call__(self, q: ArrayLike) -> Rates:
        """The time of a motion of length 1 straight against the current.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The times, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a velocity above ``fastest``.
        """
        return 1 / (self.speed - np.linalg.norm(self._velocities(np.asarray(q, np.float64)), axis=1))

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates]:
        """Bounds of the time of a motion of length 1 over boxes: with the current, and against it.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            The bounds, ``(n,)`` each.
        """
        center, spread, _ = self._within(lo, hi)
        most = np.minimum(center + spread, self.fastest)
        return 1 / (self.speed + most), 1 / (self.speed - most)

    def pulls(self, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors, Rates, Rates]:
        """As :meth:`DirectionalCost.pulls`: twice what the current at the center adds.

        A motion ``v`` in a current ``w`` takes ``(sqrt((w v)^2 + a v^2) - w v) / a``, where ``a`` is the square of
        the speed less that of the current. The root is between ``sqrt(a)`` and the speed times ``|v|``.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            The current at the center over ``-a``, twice, and bounds of the rest within the box.
        """
        center, spread, velocity = self._within(lo, hi)
        fastest, slowest = np.minimum(center + spread, self.fastest), np.maximum(center - spread, 0.0)
        a, least, most = (self.speed**2 - of**2 for of in (center, fastest, slowest))
        change = spread / least + center * np.maximum(1 / least - 1 / a, 1 / a - 1 / most)
        pull = -velocity / a[:, None]
        return pull, pull, 1 / np.sqrt(most) - change, self.speed / least + change

    def _within(self, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates, Vectors]:
        """Speed of the current at centers of boxes, how far from its velocity there any is, and that velocity."""
        velocity = self._velocities((lo + hi) / 2)
        return np.linalg.norm(velocity, axis=1), self.lipschitz * np.linalg.norm((hi - lo) / 2, axis=1), velocity


def _vectors(name: str, vector_fn: Callable[[np.ndarray], ArrayLike], q: Vectors, longest: float) -> Vectors:
    """What a function of configurations returns: a vector each, none longer than was said."""
    vectors = as_numbers(f"{name}'s answer", vector_fn(q), f"real numbers of shape {q.shape}")
    if vectors.shape != q.shape:
        raise ValueError(f"{name} must return vectors of shape {q.shape}, got {vectors.shape}.")
    bad = np.flatnonzero(~(np.linalg.norm(vectors, axis=1) <= (1 + 1e-12) * longest))
    if bad.size:
        raise ValueError(
            f"{name} must return vectors of at most {longest:g}, got {vectors[bad[0]].tolist()} at "
            f"{q[bad[0]].tolist()}."
        )
    return vectors
