"""What straight motions of a configuration space cost where that differs from place to place, and which to try."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri
from scipy.stats import qmc

from plr_jax.spaces import ConfigurationSpace, CostMap, MotionCost, cost_bounds, motion_rates, pulled

# Directions of motions, spread evenly.


_CIRCLE, _PER_AXIS = 64, 32  # directions in a plane, and an axis in more dimensions


def unit_motions(motion: MotionCost) -> Float[np.ndarray, "n dof"]:
    """Motions of cost 1 in many directions: those of all axes, and those of each block alone."""
    everything = tuple(range(motion.dof))
    parts = {everything, *(axes for axes, _ in motion.blocks)}
    scale = motion.scale
    changes = []
    for axes in sorted(parts):
        change = np.zeros((len(directions := _directions(len(axes))), motion.dof))
        change[:, axes] = directions / scale[list(axes)]
        changes.append(change / motion.norm(change)[:, None])
    return np.concatenate(changes)


def _directions(dim: int) -> Float[np.ndarray, "n dim"]:
    """Directions that are spread evenly, of each its opposite as well."""
    axes = np.eye(dim)
    if dim == 2:
        angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if dim > 2:
        num = 2 ** math.ceil(math.log2(_PER_AXIS * dim / 2))
        share = qmc.Sobol(dim, scramble=False).random(2 * num)[num:]  # the first points include 0
        axes = np.concatenate([axes, ndtri(share)])
        axes = axes[np.linalg.norm(axes, axis=1) > 1e-9]
    directions = np.concatenate([axes, -axes])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


STEP_TOLERANCE = 0.01
"""Share by which the cost of a step may err."""

_SAMPLES = 8  # of a motion whose cost is estimated
_LEAST_SHARE = 1 / 16  # of a motion: shorter pieces may err by as much as one of it
_MOST_HALVINGS = 40

Motions = Float[np.ndarray, "n dof"]
Costs = Float[np.ndarray, "n"]
Changes = Float[np.ndarray, "n k dof"]


@dataclass(frozen=True, eq=False)
class PathCosts:
    """Lengths and costs of straight motions, around periodic axes the short way.

    Attributes:
        space: The configuration space.
        cost_map: The factor of the cost of motions; None: 1 everywhere.
    """

    space: ConfigurationSpace
    cost_map: CostMap | None

    def lengths(self, q0: Motions, q1: Motions) -> Costs:
        """What motions cost where the factor is 1."""
        return self.space.motion_cost.lengths(q0, q1, self.space.domain)

    def estimates(self, q0: Motions, changes: Changes) -> Float[np.ndarray, "n k"]:
        """About what motions from each configuration by some changes cost, by a few samples of each."""
        n, k, dof = changes.shape
        motion, domain = self.space.motion_cost, self.space.domain
        if self.cost_map is None:
            return motion.norm(changes.reshape(-1, dof)).reshape(n, k)
        share = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        q = q0[:, None, None] + share[:, None] * changes[:, :, None]
        # Motions that leave the domain are not free, but have to cost something.
        q = domain.wrapped(np.where(domain.periodic, q, np.clip(q, domain.lo, domain.hi))).reshape(-1, dof)
        rates = motion_rates(motion, self.cost_map, q, np.repeat(changes.reshape(-1, dof), _SAMPLES, axis=0))
        return rates.reshape(n, k, _SAMPLES).mean(axis=2)

    def integrals(self, q0: Motions, q1: Motions, tolerance: float) -> Costs:
        """What motions cost, by the midpoint rule on pieces that are halved until bounds say that they err little.

        A jump of the factor within a motion may let it err by a sixteenth of the tolerance besides.

        Args:
            q0: Where motions begin.
            q1: Where they end.
            tolerance: The largest error, as a share of the cost.
        """
        if self.cost_map is None:
            return self.lengths(q0, q1)
        cost, change = np.zeros(len(q0)), self.space.domain.difference(q1, q0)
        motion, begin, end = self._within_periods(q0, change)
        for halvings in range(_MOST_HALVINGS + 1):
            middle = (begin + end) / 2
            q = self.space.domain.wrapped(q0[motion] + middle[:, None] * change[motion])
            part = (end - begin)[:, None] * change[motion]
            lower, upper = self._bounds(q, part)
            share = np.maximum(end - begin, _LEAST_SHARE) / (end - begin)
            done = (upper - lower <= tolerance * lower * share) | (halvings == _MOST_HALVINGS)
            np.add.at(cost, motion[done], motion_rates(self.space.motion_cost, self.cost_map, q[done], part[done]))
            motion, begin, middle, end = motion[~done], begin[~done], middle[~done], end[~done]
            motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
            if not len(motion):
                break
        return cost

    def _bounds(self, center: Motions, change: Motions) -> tuple[Costs, Costs]:
        """Bounds of what motions about centers cost, which do not cross a seam."""
        assert self.cost_map is not None
        domain, norm = self.space.domain, self.space.motion_cost.norm(change)
        # But for rounding, boxes about motions are in the domain.
        lo = np.maximum(center - np.abs(change) / 2, domain.lo)
        hi = np.minimum(center + np.abs(change) / 2, domain.hi)
        lower, upper, pulls = cost_bounds(self.space.motion_cost, self.cost_map, lo, hi)
        more = pulled(pulls, change)
        return lower * norm + more, upper * norm + more

    def _within_periods(
        self, q0: Motions, change: Motions
    ) -> tuple[Int[np.ndarray, "pieces"], Float[np.ndarray, "pieces"], Float[np.ndarray, "pieces"]]:
        """Motions cut where they cross the seams of periodic axes: which, and from what share of it to what share."""
        domain = self.space.domain
        seam = np.where(change < 0, domain.lo, domain.hi)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(domain.periodic, (seam - domain.wrapped(q0)) / change, 0.0)
        cuts = np.sort(np.where((share > 0) & (share < 1), share, 0.0), axis=1)
        ends = np.concatenate([np.zeros((len(q0), 1)), cuts, np.ones((len(q0), 1))], axis=1)
        moves = np.any(change != 0, axis=1)
        motion, place = np.nonzero((np.diff(ends, axis=1) > 0) & moves[:, None])
        return motion, ends[motion, place], ends[motion, place + 1]
