"""Cost maps: motion costs that depend on the place or the direction, with bounds over boxes of configurations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_finite, as_numbers, as_values, require_type, set_fields, shortened
from plr_jax._types import ArrayLike, Numbers
from plr_jax.spaces._space import MotionCost, precision_of

_ROUNDING = 16.0  # error of a user's function that is allowed for, in units in the last place
Vectors: TypeAlias = Float[np.ndarray, "n dof"]
# *Pulls* are two vectors for each box or configuration. They are the part of a cost that depends on the direction: a
# motion ``dq`` costs the larger of the scalar products of ``dq`` with the two vectors more than without pulls.
Pulls: TypeAlias = Float[np.ndarray, "2 n dof"]
# Pulls of a box are used only if they are tight enough:
_LEAST_RATIO = 0.25  # ``least`` (see `DirectionalCost.pulls`) must exceed this share of ``most``
_LEAST_MARGIN = 0.02  # the cost that pulls save must be below ``least`` by more than this share of ``most``


def _require(fine: Bool[np.ndarray, " n"], expected: str, got: list[np.ndarray], at: list[np.ndarray]) -> None:
    """Raise a ``ValueError`` about the first index at which ``fine`` is False; do nothing if there is none.

    The message says what was ``expected``. At this index, it shows the values of all arrays ``got``, and the
    configurations of all arrays ``at``: a point, or both corners of a box.
    """
    if not fine.all():
        i = int(fine.argmin())
        values = " and ".join(str(column[i].tolist()) for column in got)
        place = ("at " if len(at) == 1 else "over ") + " to ".join(str(column[i].tolist()) for column in at)
        raise ValueError(f"{expected}, got {values} {place}.")


@runtime_checkable
class CostMap(Protocol):
    """A positive factor of the motion cost at each configuration, with bounds over boxes.

    A motion at ``q`` costs ``cost_map(q)`` times the space's ``motion_cost``. If the motion cost is a length, the
    factor is a cost per unit of length. For travel times, use the reciprocal of the speed.
    """

    def __call__(self, q: ArrayLike, /) -> Numbers:
        """Return the factor of the motion cost, ``(n,)``, at configurations ``(n, dof)``."""
        ...

    def bounds(self, lo: Vectors, hi: Vectors, /) -> tuple[Numbers, Numbers]:
        """Return positive lower and finite upper bounds of the factor, ``(n,)``, over boxes from ``lo`` to ``hi``.

        Boxes may extend beyond the domain along periodic axes.
        """
        ...


@runtime_checkable
class DirectionalCost(CostMap, Protocol):
    """A cost of motions that depends on their direction, such as going uphill or against the wind.

    A motion ``dq`` at ``q`` costs ``c(q) |dq| + max(a(q) . dq, b(q) . dq)``, positive in every direction. For each
    box, :meth:`pulls` returns constant vectors ``a`` and ``b``, and bounds of the remaining cost per unit of length.
    As for every :class:`CostMap`, a call and :meth:`bounds` are about the whole cost per unit of length. A call
    returns this cost in the most expensive direction, and :meth:`bounds` hold for all directions. The space's
    ``motion_cost`` must be the Euclidean length over all axes.

    Example:
        Length plus ``rate`` times the climb, on terrain whose height has a gradient of length at most ``steepest``
        and Lipschitz constant ``lipschitz``::

            class Climb:
                def __call__(self, q):
                    return 1 + rate * np.linalg.norm(gradient(q), axis=1)

                def bounds(self, lo, hi):
                    return np.ones(len(lo)), np.full(len(lo), 1 + rate * steepest)

                def pulls(self, lo, hi):
                    spread = rate * lipschitz * np.linalg.norm(hi - lo, axis=1) / 2
                    uphill = rate * gradient((lo + hi) / 2)
                    return np.zeros_like(uphill), uphill, 1 - spread, 1 + spread

        For the travel time of a vehicle of speed 1 in a steady current ``w``, let ``s = 1 - |w|^2`` (Zermelo). Then
        ``pulls`` returns ``-w / s`` twice, ``1 / sqrt(s)`` and ``1 / s``, each for every box.
    """

    def pulls(self, lo: Vectors, hi: Vectors, /) -> tuple[Vectors, Vectors, Numbers, Numbers]:
        """Bound the cost of all motions in each box, by constants for the box.

        A motion ``dq`` in the box costs at least ``least * |dq| + max(a . dq, b . dq)``, and at most
        ``most * |dq| + max(a . dq, b . dq)``. Boxes have corners ``lo`` and ``hi``, ``(n, dof)``, and may extend
        beyond the domain along periodic axes.

        If ``least <= most / 4`` or ``least - d <= most / 50``, the pulls are too loose, and :meth:`bounds` is used in
        this box instead. Here ``d`` is the distance of the origin from the segment from ``a`` to ``b``.

        Returns:
            The vectors ``a`` and ``b``, ``(n, dof)``, and the numbers ``least`` and ``most``, ``(n,)``.
        """
        ...


@dataclass(frozen=True)
class LipschitzCost:
    """A cost map from a function with a known Lipschitz constant.

    Proven results hold only if the constant is right. Rounding errors of up to 16 units in the last place of the
    answers, in float32 or float64, are allowed for. The reciprocal of a speed that is at least ``v`` and has
    Lipschitz constant ``c`` has the Lipschitz constant ``c / v**2``.

    Args:
        cost_fn: Function from configurations ``(n, dof)`` to the positive factor of the motion cost, ``(n,)``.
        lipschitz: Largest change of the factor per unit of Euclidean distance between configurations, at least 0.
        least: Positive lower bound of the factor everywhere. In a box where the Lipschitz constant gives no better
            bound, this bound is used.
    """

    cost_fn: Callable[[np.ndarray], ArrayLike]
    lipschitz: float
    least: float

    def __post_init__(self):
        require_type("cost_fn", self.cost_fn, Callable, "a function of configurations (n, dof)")
        lipschitz, least = as_finite("lipschitz", self.lipschitz), as_finite("least", self.least, positive=True)
        set_fields(self, lipschitz=lipschitz, least=least)

    def __call__(self, q: ArrayLike) -> Numbers:
        """Return the factor of the motion cost, ``(n,)``; ``ValueError`` if it is below ``least`` or not finite."""
        return self._factors(np.asarray(q, np.float64))[0]

    def _factors(self, q: Vectors) -> tuple[Numbers, float]:
        """Return the factors of the motion cost, and the relative rounding error of ``cost_fn``."""
        answer = self.cost_fn(q)
        factor, rounding = as_values("cost_fn", answer, len(q)), _ROUNDING * precision_of(answer)
        expected = f"cost_fn must return finite numbers of at least {self.least:g}"
        _require((factor >= (1 - rounding) * self.least) & (factor < np.inf), expected, [factor], [q])
        return np.maximum(factor, self.least), rounding

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Numbers, Numbers]:
        """Return bounds of the factor of the motion cost over boxes, from its values at centers and ``lipschitz``."""
        middle, rounding = self._factors((lo + hi) / 2)
        # `cost_fn` may round configurations to the precision of its answers. It then evaluates a point that is up to
        # rounding * |center| away from the center. In the box, the factor differs from the factor at this point by
        # at most lipschitz * radius, where radius bounds the distance of this point from the points of the box.
        radius = np.linalg.norm((hi - lo) / 2, axis=1) + rounding * np.linalg.norm((lo + hi) / 2, axis=1)
        reach = self.lipschitz * radius
        return np.maximum((1 - rounding) * middle - reach, self.least), (1 + rounding) * middle + reach


def cost_bounds(
    motion_cost: MotionCost, cost_map: CostMap | None, lo: Vectors, hi: Vectors
) -> tuple[Numbers, Numbers, Pulls | None]:
    """Return lower and upper bounds of the cost factor over boxes, and pulls for a ``DirectionalCost`` (else None).

    The boxes have corners ``lo`` and ``hi``. *Pulls* are two vectors per box, ``(2, n, dof)``. The cost of a motion
    ``dq`` in a box is a sum. The first term is its ``motion_cost`` times a factor within the bounds. The second term
    is the larger of the scalar products of ``dq`` with the box's two pulls. Pulls are 0 where those of
    :meth:`DirectionalCost.pulls` are too loose. Without a cost map, the factor is 1.
    """
    if cost_map is None:
        return np.ones(len(lo)), np.ones(len(lo)), None
    # 1. Bounds that hold in all directions.
    bounds = cost_map.bounds(lo, hi)
    if not isinstance(bounds, Sequence | np.ndarray) or len(bounds) != 2:
        raise ValueError(f"A cost map's bounds must be two arrays with one number per box, got {shortened(bounds)}.")
    lower, upper = (as_values("Each of a cost map's bounds", bound, len(lo)) for bound in bounds)
    expected = "A cost map's bounds must be positive and finite with lower nowhere above upper"
    _require((lower > 0) & (lower <= upper) & (upper < np.inf), expected, [lower, upper], [lo, hi])
    if not isinstance(cost_map, DirectionalCost):
        return lower, upper, None
    # 2. Pulls, and bounds of the rest of the cost. One block of weight 1 is the Euclidean length over all axes.
    if [weight for _, weight in motion_cost.blocks] != [1]:
        raise ValueError(f"A DirectionalCost needs a space whose motion_cost is a length, got {motion_cost}.")
    first, second, least, most = _checked_pulls(cost_map, lo, hi)
    # 3. Use pulls a and b if they are tight enough. In the direction of a unit vector d, they cost the maximum of
    #    p . d over points p of the segment from a to b. Let p* be the segment's point nearest to 0. The maximum is at
    #    least p* . d >= -|p*|, so the pulls save at most |p*| per unit of length. The point is p* = a + t * (b - a),
    #    with t = -a . (b - a) / |b - a|**2 clipped to [0, 1].
    change = second - first
    square = np.sum(change * change, axis=1)
    t = np.divide(-np.sum(first * change, axis=1), square, out=np.zeros(len(first)), where=square > 0)
    saved = np.linalg.norm(first + np.clip(t, 0.0, 1.0)[:, None] * change, axis=1)
    is_used = (least > _LEAST_RATIO * most) & (least - saved > _LEAST_MARGIN * most)
    pulls = np.where(is_used[:, None], np.stack([first, second]), 0.0)
    return np.where(is_used, least, lower), np.where(is_used, most, upper), pulls


def _checked_pulls(cost_map: DirectionalCost, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors, Numbers, Numbers]:
    """Call ``cost_map.pulls`` for boxes, check its result, and return it: see :meth:`DirectionalCost.pulls`.

    ``ValueError`` if a shape is wrong, a number is not finite, or ``least`` exceeds ``most``.
    """
    pull_bounds = cost_map.pulls(lo, hi)
    if not isinstance(pull_bounds, Sequence) or len(pull_bounds) != 4:
        expected = "two arrays of vectors and two of numbers"
        raise ValueError(f"A DirectionalCost's pulls must be {expected}, got {shortened(pull_bounds)}.")
    # 1. The two vectors of each box.
    expected = f"finite vectors of shape {lo.shape}"
    first, second = (as_numbers("Each of a DirectionalCost's pulls", pull, expected) for pull in pull_bounds[:2])
    for pull in (first, second):
        if pull.shape != lo.shape or not np.isfinite(pull).all():
            raise ValueError(f"Each of a DirectionalCost's pulls must be {expected}, got {shortened(pull)}.")
    # 2. Bounds of the rest of the cost.
    least, most = (as_values("Each bound of a DirectionalCost's pulls", each, len(lo)) for each in pull_bounds[2:])
    expected = "Bounds of a DirectionalCost's pulls must be finite with least nowhere above most"
    _require((least <= most) & np.isfinite(least) & np.isfinite(most), expected, [least, most], [lo, hi])
    return first, second, least, most


def point_costs(motion_cost: MotionCost, cost_map: CostMap | None, q: Vectors) -> tuple[Numbers, Pulls | None]:
    """Return the cost factor at each configuration, ``(n,)``, and the pulls of a ``DirectionalCost`` (else None).

    *Pulls* are two vectors per configuration, ``(2, n, dof)``. A motion ``dq`` costs its ``motion_cost`` times the
    factor, plus the larger of the scalar products of ``dq`` with the two pulls. Without a cost map, the factor is 1.
    """
    if isinstance(cost_map, DirectionalCost):
        lower, upper, pulls = cost_bounds(motion_cost, cost_map, q, q)
        return (lower + upper) / 2, pulls
    factors = np.ones(len(q)) if cost_map is None else as_values("The cost map", cost_map(q), len(q))
    _require((factors > 0) & (factors < np.inf), "A cost map's factors must be positive and finite", [factors], [q])
    return factors, None


def motion_costs(motion_cost: MotionCost, cost_map: CostMap, q: Vectors, change: Vectors) -> Numbers:
    """Return the costs of straight motions from ``q`` to ``q + change``, as if the cost map were constant.

    The cost factor and pulls at ``q`` are used for the whole motion; see :func:`point_costs`.
    """
    factors, pulls = point_costs(motion_cost, cost_map, q)
    return factors * motion_cost.norm(change) + pulled(pulls, change)


def pulled(pulls: Pulls | None, change: Vectors) -> Numbers | float:
    # The cost of each motion that its pulls add, which may be negative: the larger of the two scalar products.
    return 0.0 if pulls is None else np.einsum("kij,ij->ki", pulls, change).max(axis=0)
