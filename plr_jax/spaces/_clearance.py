"""The configuration space of any robot given by a clearance: a signed distance with known Lipschitz constants."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import as_finite, as_finite_point, as_points, as_values, format_numbers, set_fields, shortened
from plr_jax._types import ArrayLike, Numbers
from plr_jax.geometry.box import Box
from plr_jax.spaces._space import CellState, Configurations, MotionCost, as_boxes, as_motions, batches, precision_of

_BATCH = 1 << 14  # configurations or boxes handled together, which bounds the memory
_MOTIONS = 1 << 10  # motions handled together
_MOST_BISECTIONS = 10  # largest number of times that a motion is halved; `are_free` states 2**-10 as 1 / 1000
_ROUNDING = 16.0  # error of a clearance that is allowed for, in units in the last place
# Clearances contradict the constants only if they differ by more than this factor times the bound.
_LIPSCHITZ_SLACK = 1 + 1e-6
_AXIS_TOLERANCE = 1e-9  # an axis that changes by less than this share of the largest change counts as constant
ClearanceFn: TypeAlias = Callable[[np.ndarray], ArrayLike]


@dataclass(frozen=True, eq=False, init=False)
class ClearanceSpace:
    """The configuration space of any robot whose clearance, its signed distance to obstacles, is a known function.

    The robot may be an arm, a drone, or several bodies. In a box of configurations, the clearance differs from the
    clearance at the center by at most the sum over axes of ``lipschitz`` times the half width. So one evaluation can
    prove a box free or blocked. Proofs hold only if the constants ``lipschitz`` are right. If clearances contradict
    the constants, an error names constants that would fit. Invalid arguments raise ``ValueError``.

    Constants follow from geometry. A distance changes no faster than the points of the robot move. A turn of a joint
    by one radian moves a point by at most the point's distance from the joint. For the minimum of several clearances,
    take the largest of their constants along each axis. Smaller constants prove larger boxes. Rounding errors of
    float32 or float64 are allowed for. If ``clearance`` has larger errors, subtract their bound from its answers.

    Args:
        domain: The box of all configurations, or its corners. Outside it nothing is free; periodic axes wrap around.
        clearance: Function of configurations ``(n, dof)`` that returns signed distances ``(n,)``, finite, in any
            unit: at least 0 where free, else minus the depth in an obstacle. It is called only within the domain,
            with batches of varying size. If your distance is 0 inside obstacles, subtract a margin. Then a box is
            proven blocked only if, in this box, ``lipschitz`` lets the clearance change by less than the margin.
        lipschitz: Largest change of the clearance per unit along each axis, at least 0: ``(dof,)``, or one for all.
        motion_cost: Cost of motions; by default their Euclidean length over all axes.

    Example:
        A ball of radius 0.2 among spheres::

            def clearance(q):
                return np.min(np.linalg.norm(q[:, None] - centers, axis=2) - radii, axis=1) - 0.2

            space = ClearanceSpace(((0, 0, 0), (4, 4, 4)), clearance, lipschitz=1)
    """

    domain: Box
    clearance: ClearanceFn
    lipschitz: Float[np.ndarray, " dof"]
    motion_cost: MotionCost

    def __init__(self, domain: Any, clearance: ClearanceFn, lipschitz: Any, motion_cost: MotionCost | None = None):
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
            expected = f"a MotionCost of {domain.dim} axes, as the domain has"
            raise ValueError(f"motion_cost must be {expected}, got {shortened(motion_cost)}.")
        set_fields(self, domain=domain, clearance=clearance, lipschitz=lipschitz, motion_cost=motion_cost)
        self._clearances(domain.lo[None])  # to reject a function with a wrong answer at once

    def is_free(self, q: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether configurations ``(n, dof)`` are in the domain and have a clearance of at least 0."""
        q = as_points("q", q, self.domain.dim)
        free = self.domain.contains(q)
        free[free] = self._clearances(q[free]) >= 0
        return free

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether straight motions from ``q0`` to ``q1`` are proven free all the way.

        Along periodic axes, motions go the short way. The proof needs a clearance above about ``c / 1000`` all along
        the motion. Here, ``c`` is the largest change of the clearance along the motion that ``lipschitz`` allows.
        Clearances that contradict ``lipschitz`` raise ``ValueError``.
        """
        q0, q1 = as_motions(q0, q1, self.domain.dim)
        free = self.domain.contains(q0) & self.domain.contains(q1)
        for part in batches(np.flatnonzero(free), _MOTIONS):
            free[part] = self._are_free(q0[part], self.domain.difference(q1[part], q0[part]))
        return free

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, " n"]:
        """Tell whether boxes of configurations are FREE, BLOCKED or MIXED; see :class:`CellState`.

        ``ValueError`` if clearances contradict ``lipschitz``.
        """
        center, half = as_boxes(lo, hi, self.domain.dim)
        lo, hi = center - half, center + half
        outside = ~np.array(self.domain.periodic) & ((hi < self.domain.lo) | (lo > self.domain.hi))
        state = np.where(outside.any(axis=1), CellState.BLOCKED, CellState.MIXED).astype(np.int8)
        for part in batches(np.flatnonzero(state == CellState.MIXED), _BATCH):
            state[part] = self._classify(lo[part], hi[part])
        return state

    def _classify(self, lo: Configurations, hi: Configurations) -> Int8[np.ndarray, " n"]:
        # 1. Find the part of each box in the domain. A box that leaves the domain by more than rounding is not free.
        inner_lo, inner_hi = self._clipped(lo), self._clipped(hi)
        corner_error = 4 * np.spacing(np.maximum(np.abs(self.domain.lo), np.abs(self.domain.hi)))
        leaves = ((inner_lo - lo > corner_error) | (hi - inner_hi > corner_error)).any(axis=1)
        center, half = (inner_lo + inner_hi) / 2, (inner_hi - inner_lo) / 2
        clearance = self._clearances(center)
        # 2. Check the constants against the clearance at the middle of one face per box. The face's axis changes from
        #    box to box, and its side after each cycle of axes.
        row = np.arange(len(center))
        axis, side = row % self.domain.dim, 1 - 2 * (row // self.domain.dim % 2)
        face = center.copy()
        face[row, axis] += side * half[row, axis]
        self._require_consistent(center, clearance, face, self._clearances(face))
        # 3. In the box, the clearance differs from that of the center by at most `reach`.
        reach = half @ self.lipschitz
        rounding = self._rounding(clearance, center)
        state = np.where((clearance - reach >= rounding) & ~leaves, CellState.FREE, CellState.MIXED)
        return np.where(clearance + reach < -rounding, CellState.BLOCKED, state).astype(np.int8)

    def _are_free(self, q0: Configurations, change: Configurations) -> Bool[np.ndarray, " n"]:
        # Bisect motions. An interval of a motion, [begin, begin + width] in shares of the motion, has the clearances
        # `before` and `after` at its ends. If the clearance can change by r in it, then at its share t
        #   clearance >= max(before - t * r, after - (1 - t) * r) >= (before + after - r) / 2.
        # Intervals are halved until this bound proves them free. `is_free` is False for motions that are given up: a
        # middle has less clearance than intervals of the last bisection may need, or such intervals are not proven.
        before, after = self._clearances(q0), self._clearances(q0 + change)
        self._require_consistent(q0, before, q0 + change, after)
        is_free = (before >= 0) & (after >= 0)
        reach = np.abs(change) @ self.lipschitz
        rounding = self._rounding(np.maximum(before, after), np.abs(q0) + np.abs(change))
        least = np.maximum(2.0**-_MOST_BISECTIONS * reach, rounding)
        motion = np.arange(len(q0))  # of each interval
        begin, width = np.zeros(len(q0)), 1.0
        for bisections in range(_MOST_BISECTIONS + 1):
            is_unsure = is_free[motion] & (before + after - width * reach[motion] < 2 * rounding[motion])
            motion, begin = motion[is_unsure], begin[is_unsure]
            before, after = before[is_unsure], after[is_unsure]
            if not len(motion) or bisections == _MOST_BISECTIONS:
                break
            width /= 2
            start, middle = (q0[motion] + t[:, None] * change[motion] for t in (begin, begin + width))
            between = self._clearances(middle)
            self._require_consistent(start, before, middle, between)
            is_free[motion[between < least[motion]]] = False
            motion, begin = np.tile(motion, 2), np.append(begin, begin + width)
            before, after = np.append(before, between), np.append(between, after)
        is_free[motion] = False
        return is_free

    def _clipped(self, q: Configurations) -> Configurations:
        return np.where(self.domain.periodic, q, np.clip(q, self.domain.lo, self.domain.hi))

    def _clearances(self, q: Configurations) -> Numbers:
        """Return the clearances at configurations.

        The configurations are first clipped to the domain, and wrapped along periodic axes. ``ValueError`` if a
        clearance is not finite.
        """
        q = self.domain.wrapped(self._clipped(q))
        clearance = np.empty(len(q))
        for part in batches(np.arange(len(q)), _BATCH):
            clearance[part] = as_values("clearance", self.clearance(q[part]), len(q[part]))
        if not np.isfinite(clearance).all():
            i = np.isfinite(clearance).argmin()
            raise ValueError(f"clearance must return finite numbers, got {clearance[i]} at {q[i].tolist()}.")
        return clearance

    def _rounding(self, clearance: Numbers, q: Configurations) -> Numbers:
        # Return a bound of the rounding error of clearances: from their computation, and from rounded configurations.
        return _ROUNDING * self._unit * (np.abs(clearance) + np.abs(q) @ self.lipschitz)

    @cached_property
    def _unit(self) -> float:
        return precision_of(self.clearance(self.domain.lo[None]))

    def _require_consistent(self, q0: Configurations, a: Numbers, q1: Configurations, b: Numbers) -> None:
        """Raise ``ValueError`` if clearances ``a`` at ``q0`` and ``b`` at ``q1`` contradict ``lipschitz``."""
        change, difference = np.abs(self.domain.difference(q1, q0)), np.abs(b - a)
        allowed = _LIPSCHITZ_SLACK * (change @ self.lipschitz)
        rounding = self._rounding(np.maximum(np.abs(a), np.abs(b)), np.maximum(np.abs(q0), np.abs(q1)))
        excess = difference - allowed - rounding
        if (excess > 0).any():
            i = excess.argmax()
            got = f"{a[i]:.6g} at {format_numbers(q0[i])} and {b[i]:.6g} at {format_numbers(q1[i])}"
            allows = f"{format_numbers(self.lipschitz)} allows {allowed[i]:.6g}"
            expected = f"lipschitz must bound how fast the clearance changes, but the clearance is {got}"
            advice = _advice(self.lipschitz, change[i], difference[i])
            raise ValueError(f"{expected}: they differ by {difference[i]:.6g}, where {allows}. {advice}")


def _advice(lipschitz: Float[np.ndarray, " dof"], change: Float[np.ndarray, " dof"], difference: float) -> str:
    """Return advice on larger Lipschitz constants, which allow the clearance to change by ``difference``.

    ``change`` is the absolute change of the configuration along each axis.
    """
    # The constants L explain the difference if sum over axes of L * change >= difference.
    (axes,) = np.nonzero(change > _AXIS_TOLERANCE * change.max())
    if not len(axes):
        return "No constant explains it: the clearance must be a function of the configuration."
    least = [(difference - np.delete(change * lipschitz, axis).sum()) / change[axis] for axis in axes]
    if len(axes) == 1:
        return f"Axis {axes[0]} needs at least {least[0]:.6g}."
    single = ", or ".join(f"axis {axis} {of_axis:.6g}" for axis, of_axis in zip(axes, least, strict=True))
    joint = f"of all axes to {difference / change.sum():.6g}"
    return f"Raise the constant of one axis to at least: {single}; or those {joint}."
