"""What motions cost in the cells of a mesh: bounds over each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax.eikonal.mesh import Mesh
from plr_jax.spaces import ConfigurationSpace, CostMap, MotionCost, cost_bounds


@dataclass(frozen=True, eq=False)
class CellCosts:
    """The cost of motions, times bounds of a factor over each cell.

    Attributes:
        motion: The cost of a motion where the factor is 1.
        lower: The least factor in each cell.
        upper: The largest.
    """

    motion: MotionCost
    lower: Float[np.ndarray, "cells"]
    upper: Float[np.ndarray, "cells"]

    def lengths(self, change: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Costs of straight motions where the factor is 1."""
        return self.motion.norm(change)


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bounds of what motions cost in each cell of a mesh; ``ValueError`` if they are none."""
    if cost_map is None:
        return CellCosts(space.motion_cost, np.ones(len(mesh.state)), np.ones(len(mesh.state)))
    return CellCosts(space.motion_cost, *cost_bounds(cost_map, *mesh.boxes))


def axis_scale(motion: MotionCost) -> Float[np.ndarray, "dim"]:
    """What a step of length 1 along each axis costs."""
    scale = np.empty(motion.dof)
    for axes, weight in motion.blocks:
        scale[list(axes)] = weight
    return scale
