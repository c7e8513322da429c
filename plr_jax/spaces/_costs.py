"""Costs of motions that differ from place to place or with the way they go, and how they are bounded over boxes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_finite, as_numbers, as_values, shortened
from plr_jax._types import ArrayLike
from plr_jax.spaces._space import MotionCost, precision_of

_ROUNDING = 16.0  # units in the last place, of what functions of configurations answer

Vectors: TypeAlias = Float[np.ndarray, "n dof"]
Pulls: TypeAlias = Float[np.ndarray, "2 n dof"]
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
        _check_numbers(self, "gradient_fn", "rate", "lipschitz", "steepest")

    def __call__(self, q: ArrayLike) -> Rates:
        """What a motion of length 1 straight uphill costs.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The costs, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a gradient above ``steepest``.
        """
        gradient, _ = _vectors("gradient_fn", self.gradient_fn, self.steepest, np.asarray(q, np.float64))
        return 1 + self.rate * np.linalg.norm(gradient, axis=1)

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
        gradient, rounding = _vectors("gradient_fn", self.gradient_fn, self.steepest, (lo + hi) / 2)
        uphill = self.rate * gradient
        spread = self.rate * (self.lipschitz * _radii(lo, hi, rounding) + rounding * self.steepest)
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
        _check_numbers(self, "velocity_fn", "speed", "lipschitz", "fastest", positive="speed")
        if self.fastest >= self.speed:
            raise ValueError(f"fastest must be below speed, {self.speed:g}, got {self.fastest:g}.")

    def __call__(self, q: ArrayLike) -> Rates:
        """The time of a motion of length 1 straight against the current.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            The times, ``(n,)``.

        Raises:
            ValueError: If the function returns another shape, or a velocity above ``fastest``.
        """
        velocity, _ = _vectors("velocity_fn", self.velocity_fn, self.fastest, np.asarray(q, np.float64))
        return 1 / (self.speed - np.linalg.norm(velocity, axis=1))

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
        velocity, rounding = _vectors("velocity_fn", self.velocity_fn, self.fastest, (lo + hi) / 2)
        spread = self.lipschitz * _radii(lo, hi, rounding) + rounding * self.fastest
        return np.linalg.norm(velocity, axis=1), spread, velocity


def _vectors(
    name: str, vector_fn: Callable[[np.ndarray], ArrayLike], longest: float, q: Vectors
) -> tuple[Vectors, float]:
    """What a function of configurations returns, a vector each, none longer than was said, and their precision.

    One that is longer by no more than that is made as long as was said.
    """
    answer = vector_fn(q)
    vectors = as_numbers(f"{name}'s answer", answer, f"real numbers of shape {q.shape}")
    if vectors.shape != q.shape:
        raise ValueError(f"{name} must return vectors of shape {q.shape}, got {vectors.shape}.")
    expected = f"{name} must return vectors of at most {longest:g}"
    rounding, length = _ROUNDING * precision_of(answer), np.linalg.norm(vectors, axis=1)
    _require(length <= (1 + rounding) * longest, expected, [vectors], [q])
    return vectors * np.minimum(1, longest / np.maximum(length, longest or 1.0))[:, None], rounding


def _check_numbers(cost: Any, fn: str, *numbers: str, positive: str = "") -> None:
    """Refuse a cost whose ``fn`` is no function, or one of whose numbers is negative, or the positive one 0.

    The numbers are kept as floats.
    """
    if not callable(getattr(cost, fn)):
        raise ValueError(f"{fn} must be a function of configurations, got {shortened(getattr(cost, fn))}.")
    for name in numbers:
        vars(cost)[name] = as_finite(name, getattr(cost, name), positive=name == positive)


def _require(fine: Bool[np.ndarray, "n"], expected: str, got: list[np.ndarray], at: list[np.ndarray]) -> None:
    """Raise ``ValueError`` with what was expected, and what came where in the first row that is not fine."""
    if not fine.all():
        i = int(fine.argmin())
        what = " and ".join(str(column[i].tolist()) for column in got)
        where = ("at " if len(at) == 1 else "over ") + " to ".join(str(column[i].tolist()) for column in at)
        raise ValueError(f"{expected}, got {what} {where}.")


def _radii(lo: Vectors, hi: Vectors, rounding: float) -> Rates:
    """How far points of boxes are from their centers at most, if these are rounded to some precision."""
    return np.linalg.norm((hi - lo) / 2, axis=1) + rounding * np.linalg.norm((lo + hi) / 2, axis=1)


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
        _check_numbers(self, "cost_fn", "lipschitz", "least", positive="least")

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
        reach = self.lipschitz * _radii(lo, hi, rounding)
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
    first, second, least, most = _checked_pulls(cost_map.pulls(lo, hi), lo, hi)
    use = (least > _LEAST_SHARE * most) & (least - _distance_to_segments(first, second) > _LEAST_MARGIN * most)
    pulls = np.where(use[:, None], np.stack([first, second]), 0.0)
    return np.where(use, least, lower), np.where(use, most, upper), pulls


def _distance_to_segments(first: Vectors, second: Vectors) -> Rates:
    """How far the segments between vectors are from 0."""
    change = second - first
    square = np.sum(change * change, axis=1)
    share = np.divide(-np.sum(first * change, axis=1), square, out=np.zeros(len(first)), where=square > 0)
    return np.linalg.norm(first + np.clip(share, 0.0, 1.0)[:, None] * change, axis=1)


def _checked_pulls(pulls: object, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors, Rates, Rates]:
    """Pulls over boxes as arrays; ``ValueError`` if they are none."""
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
    return first, second, least, most


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
