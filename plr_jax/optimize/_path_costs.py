"""What straight motions of a configuration space cost where the cost differs from place to place."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.box import Box
from plr_jax.spaces import ConfigurationSpace, CostMap, cost_bounds, cost_factors

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
        lengths = self.space.motion_cost.norm(changes.reshape(-1, dof)).reshape(n, k)
        if self.cost_map is None:
            return lengths
        share = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        q = q0[:, None, None] + share[:, None] * changes[:, :, None]
        domain = self.space.domain  # motions that leave it are not free, but have to cost something
        q = np.where(domain.periodic, q, np.clip(q, domain.lo, domain.hi)).reshape(-1, dof)
        return lengths * cost_factors(self.cost_map, domain.wrapped(q)).reshape(n, k, -1).mean(axis=2)

    def integrals(self, q0: Motions, q1: Motions, tolerance: float) -> Costs:
        """What motions cost, by the midpoint rule on pieces that are halved until bounds say that they err little.

        A jump of the factor within a motion may let it err by a sixteenth of the tolerance besides.

        Args:
            q0: Where motions begin.
            q1: Where they end.
            tolerance: The largest error, as a share of the cost.
        """
        lengths = self.lengths(q0, q1)
        if self.cost_map is None:
            return lengths
        domain, mean = self.space.domain, np.zeros(len(q0))
        change = domain.difference(q1, q0)
        motion, begin, end = self._within_periods(q0, change)
        for halvings in range(_MOST_HALVINGS + 1):
            middle, half = (begin + end) / 2, (end - begin) / 2
            center = domain.wrapped(q0[motion] + middle[:, None] * change[motion])
            extent = np.abs(half[:, None] * change[motion])
            lower, upper = cost_bounds(self.cost_map, *_clipped(center, extent, domain))
            share = np.maximum(2 * half, _LEAST_SHARE)
            done = ((upper - lower) * 2 * half <= tolerance * lower * share) | (halvings == _MOST_HALVINGS)
            factor = cost_factors(self.cost_map, center[done])
            np.add.at(mean, motion[done], 2 * half[done] * factor)
            motion, begin, middle, end = (of[~done] for of in (motion, begin, middle, end))
            motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
            if not len(motion):
                break
        return lengths * mean

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
        motion, place = np.nonzero(np.diff(ends, axis=1) > 0)
        return motion, ends[motion, place], ends[motion, place + 1]


def _clipped(center: Motions, extent: Motions, domain: Box) -> tuple[Motions, Motions]:
    """Boxes about centers in a domain, less what rounding lets stick out of it."""
    return np.maximum(center - extent, domain.lo), np.minimum(center + extent, domain.hi)
