"""Costs of motions that differ from place to place or with the way they go, and how they are bounded over boxes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_finite, as_numbers, as_values, shortened
from plr_jax._types import ArrayLike
from plr_jax.spaces._space import MotionCost, precision_of

_ROUNDING = 16.0  # units in the last place, of what functions of configurations answer

Vectors: TypeAlias = Float[np.ndarray, "n dof"]
Pulls: TypeAlias = Float[np.ndarray, "2 n dof"]
Rates: TypeAlias = Float[np.ndarray, "n"]


def _require(fine: Bool[np.ndarray, "n"], expected: str, got: list[np.ndarray], at: list[np.ndarray]) -> None:
    """Raise ``ValueError`` with what was expected, and what came where in the first row that is not fine."""
    if not fine.all():
        i = int(fine.argmin())
        what = " and ".join(str(column[i].tolist()) for column in got)
        where = ("at " if len(at) == 1 else "over ") + " to ".join(str(column[i].tolist()) for column in at)
        raise ValueError(f"{expected}, got {what} {where}.")


_LEAST_SHARE = 0.25  # of the upper bound, below which pulls over a box say less than the bounds of the cost map
_LEAST_MARGIN = 0.02  # of the upper bound, which must be left of the least where pulls are against it


@runtime_checkable
class CostMap(Protocol):
    """A positive factor of the cost of a motion at each configuration, with bounds of it over boxes.

    A motion through ``q`` costs ``cost_map(q)`` times what the space's ``motion_cost`` says: with the reciprocal of a
    speed for a factor, costs are times.
    """

    def __call__(self, q: ArrayLike, /) -> Rates:
        """The factor at configurations ``(n, dof)``."""
        ...

    def bounds(self, lo: Vectors, hi: Vectors, /) -> tuple[Rates, Rates]:
        """A positive lower and a finite upper bound of the factor over each box ``lo`` to ``hi``.

        Around periodic axes boxes may leave the domain.
        """
        ...


@runtime_checkable
class DirectionalCost(CostMap, Protocol):
    """A cost of motions that depends on which way they go, as uphill or against a wind.

    A motion ``dq`` through ``q`` costs ``c(q) |dq| + max(a(q) . dq, b(q) . dq)``, positive whichever way it goes.
    As a :class:`CostMap`, it answers and bounds what a motion of length 1 costs the dearest way; its lower bound is
    that of the cheapest way. It is for spaces whose ``motion_cost`` is a length, one block of weight 1.

    Example:
        Length, and ``rate`` more for each unit of climbing, on ground whose height has a gradient that is at most
        ``steepest`` long and changes by at most ``lipschitz`` a unit of distance::

            class Climb:
                def __call__(self, q):
                    return 1 + rate * np.linalg.norm(gradient(q), axis=1)

                def bounds(self, lo, hi):
                    return np.ones(len(lo)), np.full(len(lo), 1 + rate * steepest)

                def pulls(self, lo, hi):
                    spread = rate * lipschitz * np.linalg.norm(hi - lo, axis=1) / 2
                    uphill = rate * gradient((lo + hi) / 2)
                    return np.zeros_like(uphill), uphill, 1 - spread, 1 + spread

        In a steady current ``w``, a vehicle of speed 1 needs the time ``(sqrt((w v)^2 + a |v|^2) - w v) / a`` for a
        motion ``v``, where ``a = 1 - |w|^2`` (Zermelo). The root is between ``sqrt(a) |v|`` and ``|v|``, so both
        pulls are ``-w / a``, ``least`` is ``1 / sqrt(a)`` and ``most`` is ``1 / a``.
    """

    def pulls(self, lo: Vectors, hi: Vectors, /) -> tuple[Vectors, Vectors, Rates, Rates]:
        """Vectors ``a`` and ``b`` for each box, and numbers ``least`` and ``most``.

        Any motion ``dq`` in the box costs between ``least`` and ``most`` times ``|dq|``, and ``max(a . dq, b . dq)``
        more. Where ``least`` is at most a quarter of ``most``, as over boxes within which costs vary much, or hardly
        more than all points between ``a`` and ``b`` are long, the bounds of the cost map are used instead.
        """
        ...


@dataclass(frozen=True)
class LipschitzCost:
    """A cost map of a function that changes by at most so much a unit of distance.

    What is proven with it holds if that is true; answers may be rounded, to the 32 bits of JAX for one, and are
    taken for off by 16 units in the last place. The reciprocal of a speed of at least ``v`` that changes by at most
    ``c`` a unit changes by at most ``c / v**2``.

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
        object.__setattr__(self, "lipschitz", as_finite("lipschitz", self.lipschitz))
        object.__setattr__(self, "least", as_finite("least", self.least, positive=True))

    def __call__(self, q: ArrayLike) -> Rates:
        """The factor at configurations.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The factors, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a number that is not finite or below ``least``.
        """
        return self._factors(np.asarray(q, np.float64))[0]

    def _factors(self, q: Vectors) -> tuple[Rates, float]:
        """The factors, and their precision."""
        answer = self.cost_fn(q)
        factor, rounding = as_values("cost_fn", answer, len(q)), _ROUNDING * precision_of(answer)
        expected = f"cost_fn must return finite numbers of at least {self.least:g}"
        _require((factor >= (1 - rounding) * self.least) & (factor < np.inf), expected, [factor], [q])
        return np.maximum(factor, self.least), rounding

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates]:
        """Bounds of the factor over boxes.

        Args:
            lo: Lower corners, ``(n, dof)``.
            hi: Upper corners.

        Returns:
            What the factor at the center, and the constant, allow.
        """
        middle, rounding = self._factors((lo + hi) / 2)
        # How far points of boxes are from their centers at most, if these are rounded.
        radius = np.linalg.norm((hi - lo) / 2, axis=1) + rounding * np.linalg.norm((lo + hi) / 2, axis=1)
        reach = self.lipschitz * radius
        return np.maximum((1 - rounding) * middle - reach, self.least), (1 + rounding) * middle + reach


def cost_bounds(motion: MotionCost, cost_map: CostMap, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates, Pulls | None]:
    """Bounds of what motions within boxes cost; ``ValueError`` if they are none.

    Returns:
        The least and the largest factor of what a motion ``dq`` costs elsewhere, and two vectors of which it costs
        the larger product with ``dq`` besides, None unless the cost is a :class:`DirectionalCost`.
    """
    bounds = cost_map.bounds(lo, hi)
    if not isinstance(bounds, Sequence | np.ndarray) or len(bounds) != 2:
        raise ValueError(f"A cost map's bounds must be two arrays of numbers, one a box, got {shortened(bounds)}.")
    lower, upper = (as_values("Each of a cost map's bounds", bound, len(lo)) for bound in bounds)
    expected = "A cost map's bounds must be positive and finite, lower nowhere above upper"
    _require((lower > 0) & (lower <= upper) & (upper < np.inf), expected, [lower, upper], [lo, hi])
    if not isinstance(cost_map, DirectionalCost):
        return lower, upper, None
    if [weight for _, weight in motion.blocks] != [1]:
        raise ValueError(f"A DirectionalCost needs a space whose cost is a length, got {motion}.")
    pulls = cost_map.pulls(lo, hi)
    if not isinstance(pulls, Sequence) or len(pulls) != 4:
        expected = "two arrays of vectors and two of numbers"
        raise ValueError(f"A DirectionalCost's pulls must be {expected}, got {shortened(pulls)}.")
    expected = f"finite vectors of shape {lo.shape}"
    first, second = (as_numbers("Each of a DirectionalCost's pulls", vectors, expected) for vectors in pulls[:2])
    least, most = (as_values("Each bound of a DirectionalCost's pulls", numbers, len(lo)) for numbers in pulls[2:])
    for vectors in (first, second):
        if vectors.shape != lo.shape or not np.isfinite(vectors).all():
            raise ValueError(f"Each of a DirectionalCost's pulls must be {expected}, got {shortened(vectors)}.")
    expected = "Bounds of a DirectionalCost's pulls must be finite, the least nowhere above the most"
    _require((least <= most) & np.isfinite(least) & np.isfinite(most), expected, [least, most], [lo, hi])
    # How far the segments between the two vectors are from 0.
    change = second - first
    square = np.sum(change * change, axis=1)
    share = np.divide(-np.sum(first * change, axis=1), square, out=np.zeros(len(first)), where=square > 0)
    size = np.linalg.norm(first + np.clip(share, 0.0, 1.0)[:, None] * change, axis=1)
    use = (least > _LEAST_SHARE * most) & (least - size > _LEAST_MARGIN * most)
    pulls = np.where(use[:, None], np.stack([first, second]), 0.0)
    return np.where(use, least, lower), np.where(use, most, upper), pulls


def point_costs(motion: MotionCost, cost_map: CostMap, q: Vectors) -> tuple[Rates, Pulls | None]:
    """What motions cost at configurations: as :func:`cost_bounds`, with one factor, which lies between the bounds."""
    if isinstance(cost_map, DirectionalCost):
        lower, upper, pulls = cost_bounds(motion, cost_map, q, q)
        return (lower + upper) / 2, pulls
    factors = as_values("The cost map", cost_map(q), len(q))
    expected = "A cost map's factors must be positive and finite"
    _require((factors > 0) & (factors < np.inf), expected, [factors], [q])
    return factors, None


def motion_rates(motion: MotionCost, cost_map: CostMap, q: Vectors, change: Vectors) -> Rates:
    """What motions by some changes would cost if the cost were everywhere what it is at configurations."""
    factors, pulls = point_costs(motion, cost_map, q)
    return factors * motion.norm(change) + pulled(pulls, change)


def pulled(pulls: Pulls | None, change: Vectors) -> Rates | float:
    """What pulls add to the costs of motions; 0 if there are none."""
    return 0.0 if pulls is None else np.einsum("kij,ij->ki", pulls, change).max(axis=0)
