"""What motions cost in the cells of a mesh: bounds over each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax.eikonal.mesh import Mesh
from plr_jax.spaces import ConfigurationSpace, CostMap, MotionCost


@dataclass(frozen=True, eq=False)
class CellCosts:
    """The cost of motions, times bounds of a factor over each cell.

    Attributes:
        motion: The cost of a motion where the factor is 1.
        cost_map: The factor, or None if it is 1 everywhere.
        lower: The least factor in each cell.
        upper: The largest in each cell, and beside it where a query may place points in it.
    """

    motion: MotionCost
    cost_map: CostMap | None
    lower: Float[np.ndarray, "cells"]
    upper: Float[np.ndarray, "cells"]

    def lengths(self, change: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Costs of straight motions where the factor is 1."""
        return np.sum(
            [weight * np.sqrt(np.sum(change[:, axes] ** 2, axis=1)) for axes, weight in self.motion.blocks], axis=0
        )


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bounds of what motions cost in each cell of a mesh; ``ValueError`` if they are none."""
    lower, _ = bounds_of(cost_map, *mesh.boxes)
    _, upper = bounds_of(cost_map, *mesh.grown_boxes)
    return CellCosts(space.motion_cost, cost_map, lower, upper)


def bounds_of(
    cost_map: CostMap | None, lo: Float[np.ndarray, "n dim"], hi: Float[np.ndarray, "n dim"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Bounds of the factor over boxes, 1 without a map; ``ValueError`` if they are none."""
    if cost_map is None:
        return np.ones(len(lo)), np.ones(len(lo))
    bounds = cost_map.bounds(lo, hi)
    try:
        lower, upper = np.asarray(bounds, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"A cost map's bounds must be two arrays of numbers, one a box, got {shortened(bounds)}."
        ) from None
    if lower.shape != lo.shape[:1]:
        raise ValueError(
            f"A cost map's bounds must be two arrays of {len(lo)} numbers, one a box, got {lower.shape}."
        )
    bad = np.flatnonzero(~((lower > 0) & (lower <= upper) & (upper < np.inf)))
    if bad.size:
        raise ValueError(
            f"A cost map's bounds must be positive and finite, lower nowhere above upper, got {lower[bad[0]]} and "
            f"{upper[bad[0]]} over {lo[bad[0]].tolist()} to {hi[bad[0]].tolist()}."
        )
    return lower, upper


def axis_scale(motion: MotionCost) -> Float[np.ndarray, "dim"]:
    """What a step of length 1 along each axis costs."""
    scale = np.empty(motion.dof)
    for axes, weight in motion.blocks:
        scale[list(axes)] = weight
    return scale
