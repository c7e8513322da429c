"""Protocols of configuration spaces: the domain, the cost of a motion, and tests of which configurations are free."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from plr_jax._arrays import as_booleans, as_finite, as_points, batches, require_type, set_fields, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box

Configurations = Float[np.ndarray, "n dof"]


class CellState(IntEnum):
    """The state of a box of configurations, as far as it is proven.

    BLOCKED: no path passes through the interior of the box. FREE: every configuration of the closed box is free, and
    a path may cross to an adjacent FREE box anywhere. MIXED: neither BLOCKED nor FREE is proven.
    """

    BLOCKED = 0
    FREE = 1
    MIXED = 2


@dataclass(frozen=True, init=False)
class MotionCost:
    """The cost of motions ``dq``: the sum of ``weight * |dq[axes]|`` over groups of axes, called blocks.

    Blocks are pairs ``(axes, weight)``. Length in the plane is ``(((0, 1), 1.0),)``; length plus weighted rotation of
    a rigid body is ``(((0, 1), 1.0), ((2,), rotation_weight))``. The cost is a norm: an unobstructed straight motion
    is optimal, and a motion costs the same in reverse, so time cannot be an axis. ``ValueError`` unless every axis is
    in exactly one block, and weights are positive and finite.
    """

    blocks: tuple[tuple[tuple[int, ...], float], ...]

    def __init__(self, blocks: Any):
        # 1. Read the pairs of axes and a weight.
        expected = "pairs (axes, weight), such as ((0, 1), 1.0), with one or more integer axes each"
        no_pairs = ValueError(f"The blocks of a MotionCost must be {expected}, got {shortened(blocks)}.")
        try:
            pairs = [(tuple(axes), weight) for axes, weight in blocks]
        except (TypeError, ValueError):
            raise no_pairs from None
        listed = [axis for axes, _ in pairs for axis in axes]
        are_integers = all(isinstance(axis, int | np.integer) and not isinstance(axis, bool) for axis in listed)
        if not are_integers or not all(axes for axes, _ in pairs):
            raise no_pairs
        # 2. Check that each axis occurs once, and that weights are positive.
        if not listed or sorted(listed) != list(range(len(listed))):
            raise ValueError(f"The blocks of a MotionCost must hold each axis from 0 on once, got {sorted(listed)}.")
        weights = [as_finite("The weight of a block", weight, positive=True) for _, weight in pairs]
        blocks = [tuple(map(int, axes)) for axes, _ in pairs]
        set_fields(self, blocks=tuple(zip(blocks, weights, strict=True)))

    @property
    def dof(self) -> int:
        """Number of axes."""
        return sum(len(axes) for axes, _ in self.blocks)

    @property
    def scale(self) -> Float[np.ndarray, "dof"]:
        """Cost of a motion of length 1 along each axis, ``(dof,)``."""
        return self.norm(np.eye(self.dof))

    def lengths(self, q0: ArrayLike, q1: ArrayLike, domain: Box) -> Float[np.ndarray, " n"]:
        """Return the costs of straight motions, ``(n,)``; NaN or ``inf`` where a coordinate is NaN or infinite.

        Motions from ``q0`` to ``q1``, both ``(n, dof)``, cross periodic axes of the domain the short way, and ignore
        obstacles. Wrong shapes, or a domain of another dimension, raise ``ValueError``.
        """
        if domain.dim != self.dof:
            raise ValueError(f"A cost of {self.dof} axes needs a domain of {self.dof} axes, got {domain}.")
        q0, q1 = as_motions(q0, q1, self.dof)
        is_finite = (np.isfinite(q0) & np.isfinite(q1)).all(axis=1)
        costs = np.where((np.isnan(q0) | np.isnan(q1)).any(axis=1), np.nan, np.inf)
        costs[is_finite] = self.norm(domain.difference(q1[is_finite], q0[is_finite]))
        return costs

    def norm(self, change: Configurations) -> Float[np.ndarray, " n"]:
        """Return the costs, ``(n,)``, of straight motions given as end minus start, ``(n, dof)``."""
        return np.sum([weight * np.linalg.norm(change[:, axes], axis=1) for axes, weight in self.blocks], axis=0)


@runtime_checkable
class FreeTest(Protocol):
    """The minimal configuration space: which configurations are free, and what motions cost.

    A :class:`FreeTest` suffices for estimates of distances; proven bounds need a :class:`ConfigurationSpace`. Methods
    raise ``ValueError`` if arrays have a wrong shape or different lengths.
    """

    @property
    def domain(self) -> Box:
        """The box of all configurations; outside it nothing is free. Periodic axes wrap around."""
        ...

    @property
    def motion_cost(self) -> MotionCost:
        """Cost of a motion as a function of its change along each axis of the domain."""
        ...

    def is_free(self, q: ArrayLike, /) -> Bool[np.ndarray, " n"]:
        """Return whether configurations ``(n, dof)`` are free; False for configurations that are not finite."""
        ...


@runtime_checkable
class ConfigurationSpace(FreeTest, Protocol):
    """A configuration space that can prove that whole boxes and straight motions are free.

    The answers FREE, BLOCKED and True are proven, also against rounding errors. The free configurations form a closed
    set: touching an obstacle is free. Methods raise ``ValueError`` if a box has corners that are not finite, or has
    ``hi`` below ``lo``.
    """

    def classify(self, lo: ArrayLike, hi: ArrayLike, /) -> Int8[np.ndarray, " n"]:
        """Return the :class:`CellState` of each box, ``(n,)``.

        ``lo`` and ``hi`` are the boxes' corners, ``(n, dof)``. Boxes may extend beyond the domain.
        """
        ...

    def are_free(self, q0: ArrayLike, q1: ArrayLike, /) -> Bool[np.ndarray, " n"]:
        """Return whether straight motions from ``q0`` to ``q1``, ``(n, dof)``, are proven free all the way.

        All axes change in proportion. Periodic axes take the short way; at exactly half a period, the space chooses
        one of the two ways. The result is False where an end is not finite.
        """
        ...


@runtime_checkable
class Separable(Protocol):
    """A configuration space that can tell which configurations are disconnected from given configurations.

    Solvers use this to treat rooms that are cut off from the goal as obstacles.
    """

    def separated(self, q: ArrayLike, /) -> tuple[ConfigurationSpace, ConfigurationSpace | None]:
        """Divide the space into a part that may be connected to a configuration of ``q``, and a disconnected part.

        Each part is a space of its own, in which configurations of the other part count as BLOCKED. The second part
        is None if it is empty.
        """
        ...


@runtime_checkable
class SeesBoxes(Protocol):
    """A configuration space that can prove that a point sees every free configuration of a box.

    Solvers use it to prove upper bounds of distances in MIXED boxes next to walls.
    """

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike, /) -> Bool[np.ndarray, " n"]:
        """Return whether the configuration ``q[i]`` is proven to see every free configuration of box ``i``.

        Box ``i`` reaches from ``lo[i]`` to ``hi[i]``. To see a configuration means that the straight motion from it
        to ``q[i]`` is free.
        """
        ...


def as_motions(q0: ArrayLike, q1: ArrayLike, dof: int) -> tuple[Configurations, Configurations]:
    """Check the starts and ends of motions and return them as arrays, ``(n, dof)`` each."""
    q0, q1 = as_points("q0", q0, dof), as_points("q1", q1, dof)
    if len(q0) != len(q1):
        raise ValueError(f"Motions need as many starts as ends, got {len(q0)} and {len(q1)}.")
    return q0, q1


def as_boxes(lo: ArrayLike, hi: ArrayLike, dof: int) -> tuple[Configurations, Configurations]:
    """Check the lower and upper corners of boxes, and return their centers and half widths, ``(n, dof)`` each."""
    lo, hi = as_points("lo", lo, dof), as_points("hi", hi, dof)
    if len(lo) != len(hi):
        raise ValueError(f"Boxes need as many lower corners as upper ones, got {len(lo)} and {len(hi)}.")
    is_fine = (np.isfinite(hi - lo) & (lo <= hi)).all(axis=1)
    if not is_fine.all():
        i = is_fine.argmin()
        got = f"{lo[i].tolist()} and {hi[i].tolist()} for box {i}"
        raise ValueError(f"Boxes must have finite corners with hi nowhere below lo, got {got}.")
    return lo + (hi - lo) / 2, (hi - lo) / 2


def as_states(states: ArrayLike, n: int) -> Int8[np.ndarray, " n"]:
    """Check the states of ``n`` boxes that a space's ``classify`` returned, and return them as an array."""
    answer = np.asarray(states)
    if answer.shape != (n,) or not np.isin(answer, list(CellState)).all():
        raise ValueError(f"classify must return one CellState per box, shape ({n},), got {shortened(states)}.")
    return answer.astype(np.int8)


def states_of_boxes(
    space: Any, center: Configurations, half: Configurations, unsure: Int[np.ndarray, " m"], at_once: int
) -> Int8[np.ndarray, " n"]:
    """Return the states of boxes from ``center - half`` to ``center + half``, as far as a space can prove them.

    Boxes that are not ``unsure`` (indices) are known to be FREE. ``at_once`` boxes are tested together, which bounds
    the memory.
    """
    state = np.full(len(center), CellState.FREE, np.int8)
    for part in batches(unsure, at_once):
        state[part[~space._boxes_are_free(center[part], half[part])]] = CellState.MIXED
    # Of the boxes that are not proven free, those whose center is not free may be blocked.
    rows = np.flatnonzero(state == CellState.MIXED)
    rows = rows[~space.is_free(center[rows])]
    state[rows[space._boxes_are_blocked(center[rows], half[rows])]] = CellState.BLOCKED
    return state


def precision_of(numbers: ArrayLike) -> float:
    """Return the relative precision of an array's type: 2**-23 for 4-byte numbers, 2**-7 for 2-byte, else 2**-52.

    Of the 2-byte types, bfloat16 is the least precise.
    """
    return {2: 2.0**-7, 4: 2.0**-23}.get(np.asarray(numbers).dtype.itemsize, 2.0**-52)


@dataclass(frozen=True, eq=False)
class CheckedFreeTest:
    """A base class of spaces that wrap a :class:`FreeTest`; it checks the answers of the wrapped ``is_free``."""

    space: FreeTest

    @property
    def domain(self) -> Box:
        return self.space.domain

    @property
    def motion_cost(self) -> MotionCost:
        return self.space.motion_cost

    def is_free(self, q: ArrayLike) -> Bool[np.ndarray, " n"]:
        return as_booleans("is_free", self.space.is_free(q), len(np.asarray(q)))


def require_space(space: object) -> None:
    """Raise ``ValueError`` unless ``space`` is at least a :class:`FreeTest` whose motion cost fits its domain."""
    if isinstance(space, type) or not isinstance(space, FreeTest):
        expected = "a configuration space with a domain, a motion_cost and is_free, such as PlaneSpace(workspace)"
        raise ValueError(f"space must be {expected}, got {shortened(space)}.")
    domain, cost = space.domain, space.motion_cost
    require_type("The space's domain", domain, Box, "a Box")
    if not isinstance(cost, MotionCost) or cost.dof != domain.dim:
        raise ValueError(f"A space's motion_cost must be a MotionCost of {domain.dim} axes, got {shortened(cost)}.")
