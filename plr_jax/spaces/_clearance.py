"""The configuration space of any robot with a clearance: a signed distance that changes at most so fast."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import as_finite, as_finite_point, as_points, as_values, format_numbers, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.spaces._space import CellState, MotionCost, as_boxes, as_motions, precision_of

_BATCH, _MOTIONS = 1 << 14, 1 << 10  # at a time, which bounds the memory
_MOST_BISECTIONS = 10
_ROUNDING = 16.0  # in units of the last place of what the clearance is computed from
_LIPSCHITZ_SLACK = 1 + 1e-6  # times what constants allow, up to which a clearance contradicts none
_AXIS_TOLERANCE = 1e-9  # of the way, along which two configurations count as beside one another along one axis

Configurations: TypeAlias = Float[np.ndarray, "n dof"]
Numbers: TypeAlias = Float[np.ndarray, "n"]


@dataclass(frozen=True, eq=False, init=False)
class ClearanceSpace:
    """Configurations of any robot that are free by a signed distance: an arm of many joints, a drone, several bodies.

    Over a box of configurations, the clearance differs from that at its center by at most the sum over all axes of
    ``lipschitz`` times half the box's width. So one number proves a box free or blocked, and two an interval of a
    motion. What is proven holds if the constants do. Boxes and motions of which clearances contradict them are
    refused, with an error that tells what constants would do; that none comes proves nothing.

    Constants come from geometry: a distance changes no faster than points of the robot move, and a joint that turns
    moves none faster than that is far from it. The least of several clearances has the largest of their constants
    along each axis. The smaller they are, the larger the boxes that are proven: give one an axis, as small as is
    true. Errors of rounding are allowed for in proportion to clearances and configurations, by the precision of the
    numbers that come; a clearance that errs by more is to be lowered by that.

    Args:
        domain: The box of all configurations, or its corners; what lies outside, but around a periodic axis, is not
            free.
        clearance: Signed distance of configurations ``(n, dof)``, ``(n,)``, finite, in any unit: at least 0 where the
            configuration is free, below where it is not, by the more the deeper the robot is in an obstacle. It is
            asked within the domain alone, in batches of many sizes. A distance that is 0 within obstacles does not
            serve: lower it by a margin. No box is proven blocked where there is no depth.
        lipschitz: How fast the clearance changes at most along each axis, in its units over those of the axis, at
            least 0: ``(dof,)``, or a number for all axes.
        motion_cost: Cost of motions; None: their length over all axes.

    Attributes:
        domain: The box.
        clearance: As given.
        lipschitz: Of each axis, ``(dof,)``.
        motion_cost: Cost of motions.

    Raises:
        ValueError: If the domain is no box, the clearance no function, or there are other numbers of constants or
            axes of the cost than the domain has axes, or a constant is negative or not finite.

    Example:
        A ball of radius 0.2 among spheres::

            def clearance(q):
                return np.min(np.linalg.norm(q[:, None] - centers, axis=2) - radii, axis=1) - 0.2

            space = ClearanceSpace(((0, 0, 0), (4, 4, 4)), clearance, lipschitz=1)
    """

    domain: Box
    clearance: Callable[[np.ndarray], ArrayLike]
    lipschitz: Float[np.ndarray, "dof"]
    motion_cost: MotionCost

    def __init__(
        self,
        domain: Any,
        clearance: Callable[[np.ndarray], ArrayLike],
        lipschitz: ArrayLike,
        motion_cost: MotionCost | None = None,
    ):
        domain = Box.of(domain, "domain")
        if not callable(clearance):
            raise ValueError(f"clearance must be a function of configurations (n, dof), got {shortened(clearance)}.")
        if np.ndim(lipschitz) == 0:
            lipschitz = [as_finite("lipschitz", lipschitz)] * domain.dim
        lipschitz = as_finite_point("lipschitz", lipschitz, domain.dim)
        if (lipschitz < 0).any():
            raise ValueError(f"lipschitz must be at least 0 along each axis, got {lipschitz.tolist()}.")
        motion_cost = MotionCost(((range(domain.dim), 1.0),)) if motion_cost is None else motion_cost
        if not isinstance(motion_cost, MotionCost) or motion_cost.dof != domain.dim:
            raise ValueError(
                f"motion_cost must be a MotionCost of {domain.dim} axes, as the domain has, got "
                f"{shortened(motion_cost)}."
            )
        object.__setattr__(self, "domain", domain)
        object.__setattr__(self, "clearance", clearance)
        object.__setattr__(self, "lipschitz", lipschitz)
        object.__setattr__(self, "motion_cost", motion_cost)
        self._clearances(domain.lo[None])  # so that a function of something else is refused at once

    def is_free(self, q: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether configurations are free.

        Args:
            q: Configurations, ``(n, dof)``.

        Returns:
            True where the clearance is at least 0; False outside the domain and for those that are not finite.

        Raises:
            ValueError: If ``q`` has another shape, or a clearance is not finite.
        """
        q = as_points("q", q, self.domain.dim)
        free = self.domain.contains(q)
        free[free] = self._clearances(q[free]) >= 0
        return free

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether straight motions, around periodic axes the short way, are proven free all along.

        Args:
            q0: Where they begin, ``(n, dof)``.
            q1: Where they end, ``(n, dof)``.

        Returns:
            True where the whole motion is free, as in :meth:`is_free`; False where an end is not finite, and for
            motions along which the clearance comes to less than about a thousandth of what the constants let it
            change along all of the motion, such as those that slide along an obstacle.

        Raises:
            ValueError: If the shapes are others or differ, a clearance is not finite, or clearances contradict
                ``lipschitz``.
        """
        q0, q1 = as_motions(q0, q1, self.domain.dim)
        free = self.domain.contains(q0) & self.domain.contains(q1)
        rows = np.flatnonzero(free)
        for begin in range(0, len(rows), _MOTIONS):
            part = rows[begin : begin + _MOTIONS]
            free[part] = self._are_free(q0[part], self.domain.difference(q1[part], q0[part]))
        return free

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, "n"]:
        """What is proven of boxes of configurations.

        Args:
            lo: Lower corners, ``(n, dof)``, finite.
            hi: Upper corners, ``(n, dof)``, finite and nowhere below; boxes may leave the domain.

        Returns:
            The :class:`CellState` of each, ``(n,)``.

        Raises:
            ValueError: If the shapes are others or differ, corners are not those of boxes, a clearance is not finite,
                or clearances contradict ``lipschitz``.
        """
        center, half = as_boxes(lo, hi, self.domain.dim)
        lo, hi = center - half, center + half
        outside = ~np.array(self.domain.periodic) & ((hi < self.domain.lo) | (lo > self.domain.hi))
        state = np.where(outside.any(axis=1), CellState.BLOCKED, CellState.MIXED).astype(np.int8)
        rows = np.flatnonzero(state == CellState.MIXED)
        for begin in range(0, len(rows), _BATCH):
            part = rows[begin : begin + _BATCH]
            state[part] = self._classify(lo[part], hi[part])
        return state

    def _classify(self, lo: Configurations, hi: Configurations) -> Int8[np.ndarray, "n"]:
        """What is proven of boxes that meet the domain, by what of them is within it."""
        inner_lo, inner_hi = self._clipped(lo), self._clipped(hi)
        beside = 4 * np.spacing(np.maximum(np.abs(self.domain.lo), np.abs(self.domain.hi)))  # corners are rounded
        leaves = ((inner_lo - lo > beside) | (hi - inner_hi > beside)).any(axis=1)
        center, half = (inner_lo + inner_hi) / 2, (inner_hi - inner_lo) / 2
        clearance = self._clearances(center)
        # Compare it with that at the middle of a face, of each axis in turn.
        row = np.arange(len(center))
        axis, side = row % self.domain.dim, 1 - 2 * (row // self.domain.dim % 2)
        face = center.copy()
        face[row, axis] += side * half[row, axis]
        self._require_consistent(center, clearance, face, self._clearances(face))
        reach, rounding = half @ self.lipschitz, self._rounding(clearance, center)
        state = np.where((clearance - reach >= rounding) & ~leaves, CellState.FREE, CellState.MIXED)
        return np.where(clearance + reach < -rounding, CellState.BLOCKED, state).astype(np.int8)

    def _are_free(self, q0: Configurations, change: Configurations) -> Bool[np.ndarray, "n"]:
        """Whether motions are proven free, in intervals that are bisected until each is, or is too short.

        With clearances ``a`` and ``b`` at its ends, that within an interval is at least ``(a + b - reach) / 2``.
        """
        before, after = self._clearances(q0), self._clearances(q0 + change)
        self._require_consistent(q0, before, q0 + change, after)
        free = (before >= 0) & (after >= 0)
        reach = np.abs(change) @ self.lipschitz
        rounding = self._rounding(np.maximum(before, after), np.abs(q0) + np.abs(change))
        least = np.maximum(2.0**-_MOST_BISECTIONS * reach, rounding)
        owner, at, width = np.arange(len(q0)), np.zeros(len(q0)), 1.0
        for bisections in range(_MOST_BISECTIONS + 1):
            unsure = free[owner] & (before + after - width * reach[owner] < 2 * rounding[owner])
            owner, at, before, after = owner[unsure], at[unsure], before[unsure], after[unsure]
            if not len(owner) or bisections == _MOST_BISECTIONS:
                break
            width /= 2
            begin, middle = (q0[owner] + share[:, None] * change[owner] for share in (at, at + width))
            between = self._clearances(middle)
            self._require_consistent(begin, before, middle, between)
            free[owner[between < least[owner]]] = False
            owner, at = np.tile(owner, 2), np.append(at, at + width)
            before, after = np.append(before, between), np.append(between, after)
        free[owner] = False
        return free

    def _clipped(self, q: Configurations) -> Configurations:
        """The nearest configurations in the domain; along periodic axes all are."""
        return np.where(self.domain.periodic, q, np.clip(q, self.domain.lo, self.domain.hi))

    def _clearances(self, q: Configurations) -> Numbers:
        """Clearances of configurations in the domain, but for rounding; ``ValueError`` if one is not finite."""
        q = self.domain.wrapped(self._clipped(q))
        clearance = np.empty(len(q))
        for begin in range(0, len(q), _BATCH):
            part = slice(begin, begin + _BATCH)
            clearance[part] = as_values("clearance", self.clearance(q[part]), len(q[part]))
        if not np.isfinite(clearance).all():
            i = np.isfinite(clearance).argmin()
            raise ValueError(f"clearance must give finite numbers, got {clearance[i]} at {q[i].tolist()}.")
        return clearance

    def _rounding(self, clearance: Numbers, q: Configurations) -> Numbers:
        """What clearances of configurations of some size may err by in the precision in which they come."""
        return _ROUNDING * self._unit * (np.abs(clearance) + np.abs(q) @ self.lipschitz)

    @cached_property
    def _unit(self) -> float:
        return precision_of(self.clearance(self.domain.lo[None]))

    def _require_consistent(self, q0: Configurations, a: Numbers, q1: Configurations, b: Numbers) -> None:
        """Raise ``ValueError`` if clearances ``a`` and ``b`` of pairs of configurations contradict the constants."""
        change, difference = np.abs(self.domain.difference(q1, q0)), np.abs(b - a)
        allowed = _LIPSCHITZ_SLACK * (change @ self.lipschitz)
        rounding = self._rounding(np.maximum(np.abs(a), np.abs(b)), np.maximum(np.abs(q0), np.abs(q1)))
        over = difference - allowed - rounding
        if (over > 0).any():
            i = over.argmax()
            where = f"{a[i]:.6g} at {format_numbers(q0[i])} and {b[i]:.6g} at {format_numbers(q1[i])}"
            raise ValueError(
                f"lipschitz must bound how fast the clearance changes, but that is {where}: they differ by "
                f"{difference[i]:.6g}, where {format_numbers(self.lipschitz)} allows {allowed[i]:.6g}. "
                + _least_constants(self.lipschitz, change[i], difference[i])
            )


def _least_constants(lipschitz: Float[np.ndarray, "dof"], change: Float[np.ndarray, "dof"], difference: float) -> str:
    """What constants would explain how the clearances of two configurations differ."""
    (axes,) = np.nonzero(change > _AXIS_TOLERANCE * change.max())
    if not len(axes):
        return "None does: one configuration must have one clearance."
    least = [(difference - np.delete(change * lipschitz, axis).sum()) / change[axis] for axis in axes]
    if len(axes) == 1:
        return f"Axis {axes[0]} needs at least {least[0]:.6g}."
    each = ", or ".join(f"axis {axis} {of_axis:.6g}" for axis, of_axis in zip(axes, least, strict=True))
    return f"One axis needs at least, if it is alone to blame: {each}; else all need {difference / change.sum():.6g}."
