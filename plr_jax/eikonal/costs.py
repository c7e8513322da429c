"""What motions cost in the cells of a mesh: bounds over each.

In a cell, a motion ``dq`` costs from ``lower |dq| + max(pulls . dq)`` to ``upper |dq| + max(pulls . dq)``. Here
``|dq|`` is what the space's ``motion_cost`` says, and the pulls are two vectors, 0 unless costs depend on which way a
motion goes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax.eikonal.mesh import Mesh
from plr_jax.spaces import ConfigurationSpace, CostMap, DirectionalCost, MotionCost, cost_bounds

_LEAST_SHARE = 0.25  # of the upper bound, below which pulls over a box say less than the bounds of the cost map


@dataclass(frozen=True, eq=False)
class CellCosts:
    """Bounds of the cost of motions in each cell.

    Attributes:
        motion: The cost of a motion, times a factor.
        cost_map: The factor, or None if it is 1 everywhere.
        lower: The least factor in each cell.
        upper: The largest in each cell, and beside it where a query may place points in it.
        pulls: Two vectors a cell, of which a motion costs the larger product besides; None for none.
    """

    motion: MotionCost
    cost_map: CostMap | None
    lower: Float[np.ndarray, "cells"]
    upper: Float[np.ndarray, "cells"]
    pulls: Float[np.ndarray, "2 cells dim"] | None = None

    def lengths(self, change: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Costs of straight motions where the factor is 1 and nothing pulls."""
        return self.motion.norm(change)

    def most(self, change: Float[np.ndarray, "n dim"], cell: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """What straight motions within cells cost at the most."""
        cost = self.lengths(change) * self.upper[cell]
        if self.pulls is None:
            return cost
        return cost + np.einsum("kij,ij->ki", self.pulls[:, cell], change).max(axis=0)


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bounds of what motions cost in each cell of a mesh; ``ValueError`` if they are none."""
    lower, _ = bounds_of(cost_map, *mesh.boxes)
    _, upper = bounds_of(cost_map, *mesh.grown_boxes)
    motion = space.motion_cost
    if not isinstance(cost_map, DirectionalCost):
        return CellCosts(motion, cost_map, lower, upper)
    if [weight for _, weight in motion.blocks] != [1]:
        raise ValueError(f"A DirectionalCost needs a space whose cost is a length, got {motion}.")
    first, second, least, most = (np.asarray(bound, np.float64) for bound in cost_map.pulls(*mesh.grown_boxes))
    use = least > _LEAST_SHARE * most
    pulls = np.where(use[:, None], np.stack([first, second]), 0.0)
    return CellCosts(motion, cost_map, np.where(use, least, lower), np.where(use, most, upper), pulls)


def bounds_of(
    cost_map: CostMap | None, lo: Float[np.ndarray, "n dim"], hi: Float[np.ndarray, "n dim"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Bounds of the factor over boxes, 1 without a map; ``ValueError`` if they are none."""
    if cost_map is None:
        return np.ones(len(lo)), np.ones(len(lo))
    return cost_bounds(cost_map, lo, hi)


def axis_scale(motion: MotionCost) -> Float[np.ndarray, "dim"]:
    """What a step of length 1 along each axis costs."""
    scale = np.empty(motion.dof)
    for axes, weight in motion.blocks:
        scale[list(axes)] = weight
    return scale
