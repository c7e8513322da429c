"""What motions cost in the cells of a mesh: bounds over each.

In a cell, a motion ``dq`` costs from ``lower |dq| + max(pulls . dq)`` to ``upper |dq| + max(pulls . dq)``. Here
``|dq|`` is what the space's ``motion_cost`` says, and the pulls are two vectors, 0 unless costs depend on which way a
motion goes.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from plr_jax.eikonal.mesh import Mesh
from plr_jax.spaces import ConfigurationSpace, CostMap, MotionCost, cost_bounds, pulled


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

    @property
    def midway(self) -> "CellCosts":
        """The same, with the middle of the bounds of the factor as its upper one: for estimates."""
        least = (
            self.lower
            if self.pulls is None
            else np.maximum(self.lower, np.linalg.norm(self.pulls, axis=2).max(axis=0))
        )
        return replace(self, upper=(least + self.upper) / 2)  # so that no motion costs less than nothing

    @property
    def least_rates(self) -> Float[np.ndarray, "cells"]:
        """What motions cost at the least over their lengths, whichever way they go."""
        if self.pulls is None:
            return self.lower
        return np.maximum(self.lower - np.linalg.norm(self.pulls, axis=2).min(axis=0), 0.0)

    def most(self, change: Float[np.ndarray, "n dim"], cell: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """What straight motions within cells cost at the most."""
        pulls = None if self.pulls is None else self.pulls[:, cell]
        return self.motion.norm(change) * self.upper[cell] + pulled(pulls, change)


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bounds of what motions cost in each cell of a mesh; ``ValueError`` if they are none."""
    motion = space.motion_cost
    if cost_map is None:
        return CellCosts(motion, None, np.ones(len(mesh.state)), np.ones(len(mesh.state)))
    lower, upper, pulls = cost_bounds(motion, cost_map, *mesh.grown_boxes)
    if pulls is None:
        lower, _, _ = cost_bounds(motion, cost_map, *mesh.boxes)
    return CellCosts(motion, cost_map, lower, upper, pulls)
