"""What a configuration space is: a domain, the cost of a motion in it, and what of it is proven free."""

from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import as_booleans, as_finite, as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box

Configurations = Float[np.ndarray, "n dof"]


class CellState(IntEnum):
    """What is known of a box of configurations.

    Attributes:
        BLOCKED: No path passes: no configuration in the interior of the box is free.
        FREE: Every configuration of the closed box is free, and through any of them the way into other such boxes.
        MIXED: Neither is proven.
    """

    BLOCKED = 0
    FREE = 1
    MIXED = 2


@dataclass(frozen=True, init=False)
class MotionCost:
    """Cost of motions: an infinitesimal one, ``dq``, costs the sum over blocks of ``weight * |dq[axes]|``.

    Length in the plane is ``(((0, 1), 1.0),)``; length and weighted turn of a rigid body are
    ``(((0, 1), 1.0), ((2,), rotation_weight))``. It is a norm of the motion, the same everywhere, so a straight
    motion is a cheapest one where nothing is in its way. There and back cost the same: time cannot be an axis.

    Args:
        blocks: Pairs of axes and a weight, positive: the cost of a motion of length 1 along these axes alone. Every
            axis is in one block.

    Raises:
        ValueError: If an axis is in no block or in several, or a weight is not positive and finite.
    """

    blocks: tuple[tuple[tuple[int, ...], float], ...]

    def __init__(self, blocks: Any):
        try:
            pairs = [(tuple(axes), weight) for axes, weight in blocks]
        except (TypeError, ValueError):
            pairs = [((), None)]
        given = [axis for axes, _ in pairs for axis in axes]
        are_integers = all(isinstance(axis, int | np.integer) and not isinstance(axis, bool) for axis in given)
        if not are_integers or not all(axes for axes, _ in pairs):
            expected = "pairs of axes and a weight, each of one or more axes, some integers, and a weight"
            raise ValueError(f"The blocks of a MotionCost must be {expected}, got {shortened(blocks)}.")
        if not given or sorted(given) != list(range(len(given))):
            raise ValueError(f"The blocks of a MotionCost must hold each axis from 0 on once, got {sorted(given)}.")
        weight_of = partial(as_finite, "The weight of a block", positive=True)
        kept = tuple((tuple(map(int, axes)), weight_of(weight)) for axes, weight in pairs)
        object.__setattr__(self, "blocks", kept)

    @property
    def dof(self) -> int:
        """Number of axes."""
        return sum(len(axes) for axes, _ in self.blocks)

    @property
    def scale(self) -> Float[np.ndarray, "dof"]:
        """What a motion of length 1 along each axis costs."""
        return self.norm(np.eye(self.dof))

    def lengths(self, q0: ArrayLike, q1: ArrayLike, domain: Box) -> Float[np.ndarray, "n"]:
        """Cost of straight motions, around periodic axes the short way.

        Args:
            q0: Where they begin, ``(n, dof)``.
            q1: Where they end, ``(n, dof)``.
            domain: The box that says which axes are periodic, and how wide.

        Returns:
            Their costs, ``(n,)``; NaN where a configuration is not finite. Obstacles make no difference.

        Raises:
            ValueError: If the shapes are others or differ, or the domain has another dimension.
        """
        if domain.dim != self.dof:
            raise ValueError(f"A cost of {self.dof} axes needs a domain of as many, got {domain}.")
        q0, q1 = as_motions(q0, q1, self.dof)
        return self.norm(domain.difference(q1, q0))

    def norm(self, change: Configurations) -> Float[np.ndarray, "n"]:
        """Cost of straight motions by what they change.

        Args:
            change: End less beginning, ``(n, dof)``.

        Returns:
            Their costs, ``(n,)``.
        """
        return np.sum([weight * np.linalg.norm(change[:, axes], axis=1) for axes, weight in self.blocks], axis=0)


@runtime_checkable
class FreeTest(Protocol):
    """The least that a configuration space says of itself: where one may be, and what motions cost.

    It suffices for estimates. What is to be proven needs a :class:`ConfigurationSpace`.
    """

    @property
    def domain(self) -> Box:
        """The box of all configurations; what lies outside, but around a periodic axis, is not free."""
        ...

    @property
    def motion_cost(self) -> MotionCost:
        """Cost of motions, of as many axes as the domain."""
        ...

    def is_free(self, q: ArrayLike, /) -> Bool[np.ndarray, "n"]:
        """Whether configurations ``(n, dof)`` are free; False for those that are not finite."""
        ...


@runtime_checkable
class ConfigurationSpace(FreeTest, Protocol):
    """A configuration space that proves of whole boxes and whole motions whether they are free.

    Both answers are conservative, errors of rounding included. The free configurations are a closed set: what only
    touches is free.
    """

    def classify(self, lo: ArrayLike, hi: ArrayLike, /) -> Int8[np.ndarray, "n"]:
        """What is proven of boxes of configurations with corners ``lo`` and ``hi``, each ``(n, dof)``.

        Returns:
            The :class:`CellState` of each, ``(n,)``: FREE only if every configuration of the closed box is free,
            BLOCKED only if no path of positive length passes through its interior, else MIXED.
        """
        ...

    def are_free(self, q0: ArrayLike, q1: ArrayLike, /) -> Bool[np.ndarray, "n"]:
        """Whether straight motions between configurations ``(n, dof)`` are proven free all along.

        All axes change in proportion, periodic ones the short way, of half a period upward.
        """
        ...


@runtime_checkable
class SeesBoxes(Protocol):
    """A configuration space that proves of boxes, which need not be free, that all free parts are seen from a point.

    With it, bounds from above hold beside walls, in boxes that are neither free nor blocked.
    """

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike, /) -> Bool[np.ndarray, "n"]:
        """Whether from every free configuration of each box ``lo`` to ``hi`` the straight motion to ``q`` is free."""
        ...


def as_motions(q0: ArrayLike, q1: ArrayLike, dof: int) -> tuple[Configurations, Configurations]:
    """Ends of motions as arrays of one shape; ``ValueError`` if they are none."""
    q0, q1 = as_points("q0", q0, dof), as_points("q1", q1, dof)
    if len(q0) != len(q1):
        raise ValueError(f"Motions need as many starts as ends, got {len(q0)} and {len(q1)}.")
    return q0, q1


def as_boxes(lo: ArrayLike, hi: ArrayLike, dof: int) -> tuple[Configurations, Configurations]:
    """Centers of boxes and half their widths; ``ValueError`` if the corners are not those of boxes."""
    lo, hi = as_points("lo", lo, dof), as_points("hi", hi, dof)
    if len(lo) != len(hi):
        raise ValueError(f"Boxes need as many lower corners as upper ones, got {len(lo)} and {len(hi)}.")
    fine = (np.isfinite(hi - lo) & (lo <= hi)).all(axis=1)
    if not fine.all():
        i = fine.argmin()
        got = f"{lo[i].tolist()} and {hi[i].tolist()} for box {i}"
        raise ValueError(f"Boxes must have finite corners, hi nowhere below lo, got {got}.")
    return lo + (hi - lo) / 2, (hi - lo) / 2


def as_states(states: ArrayLike, n: int) -> Int8[np.ndarray, "n"]:
    """What a space said of boxes, a :class:`CellState` each; ``ValueError`` if that is something else."""
    answer = np.asarray(states)
    if answer.shape != (n,) or not np.isin(answer, list(CellState)).all():
        raise ValueError(f"classify must return one CellState a box, shape ({n},), got {shortened(states)}.")
    return answer.astype(np.int8)


def precision_of(numbers: ArrayLike) -> float:
    """The relative precision of what a function returns, which may come in 32 bits, as from JAX, or in 16."""
    return {2: 2.0**-7, 4: 2.0**-23}.get(np.asarray(numbers).dtype.itemsize, 2.0**-52)


@dataclass(frozen=True, eq=False)
class CheckedSpace:
    """What a space that only tests configurations says, checked: the base of those that ask it about more."""

    space: FreeTest

    @property
    def domain(self) -> Box:
        return self.space.domain

    @property
    def motion_cost(self) -> MotionCost:
        return self.space.motion_cost

    def is_free(self, q: ArrayLike) -> Bool[np.ndarray, "n"]:
        return as_booleans("is_free", self.space.is_free(q), len(np.asarray(q)))


def require_space(space: object) -> None:
    """Raise ``ValueError`` if it is no configuration space, of at least :class:`FreeTest`."""
    if isinstance(space, type) or not isinstance(space, FreeTest):
        raise ValueError(
            "space must be a configuration space, such as PlaneSpace(workspace), with a domain, a motion_cost and "
            f"is_free, got {shortened(space)}."
        )
    domain, motion = space.domain, space.motion_cost
    if not isinstance(domain, Box):
        raise ValueError(f"The space's domain must be a Box, got {shortened(domain)}.")
    if not isinstance(motion, MotionCost) or sorted(axis for axes, _ in motion.blocks for axis in axes) != list(
        range(domain.dim)
    ):
        raise ValueError(
            f"The space's motion_cost must be a MotionCost of its {domain.dim} axes, got {shortened(motion)}."
        )
