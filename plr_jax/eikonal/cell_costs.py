"""What motions cost in the cells of a mesh: bounds over each.

In a cell, a motion ``dq`` costs from ``lower |dq| + max(pulls . dq)`` to ``upper |dq| + max(pulls . dq)``. Here
``|dq|`` is what the space's ``motion_cost`` says, and the pulls are two vectors, 0 unless costs depend on which way
a motion goes. Where they do not, the factor of ``|dq|`` is between two linear functions of the place as well, which
are the closer the smaller the cell, beside what the factor changes over it.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from plr_jax.eikonal.mesh import Mesh
from plr_jax.spaces import ConfigurationSpace, CostMap, DirectionalCost, MotionCost, cost_bounds, pulled

_PARTS = {1: 16, 2: 8, 3: 3, 4: 2}  # of a cell along each axis, in which the factor is bounded
_LEAST_SHARE = 0.5  # of the least factor, below which linear bounds fall nowhere in the cell


@dataclass(frozen=True, eq=False)
class CellCosts:
    """Bounds of the cost of motions in each cell; upper ones hold beside it where a query may place points in it.

    Attributes:
        motion: The cost of a motion, times a factor.
        cost_map: The factor, or None if it is 1 everywhere.
        lower: The least factor in each cell.
        upper: The largest.
        slope: How much linear bounds of the factor change from one side of the cell to the other, along each axis.
        least: The lower one of them in the middle of the cell.
        most: The upper one.
        pulls: Two vectors a cell, of which a motion costs the larger product besides; None for none.
    """

    motion: MotionCost
    cost_map: CostMap | None
    lower: Float[np.ndarray, "cells"]
    upper: Float[np.ndarray, "cells"]
    slope: Float[np.ndarray, "cells dim"]
    least: Float[np.ndarray, "cells"]
    most: Float[np.ndarray, "cells"]
    pulls: Float[np.ndarray, "2 cells dim"] | None = None

    @property
    def midway(self) -> "CellCosts":
        """The same, with the middle of the bounds of the factor as its upper one: for estimates."""
        lower, least = self.lower, self.least
        if self.pulls is not None:  # of which no motion may cost less than nothing
            longest = np.linalg.norm(self.pulls, axis=2).max(axis=0)
            lower, least = np.maximum(lower, longest), np.maximum(least, longest)
        return replace(self, upper=(lower + self.upper) / 2, most=(least + self.most) / 2)

    @property
    def least_rates(self) -> Float[np.ndarray, "cells"]:
        """What motions cost at the least over their lengths, whichever way they go."""
        if self.pulls is None:
            return self.lower
        return np.maximum(self.lower - np.linalg.norm(self.pulls, axis=2).min(axis=0), 0.0)

    def least_at(self, t: Float[np.ndarray, "k dim"], cell: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n k"]:
        """The lower linear bound at points, from 0 to 1, of each cell."""
        return self.least[cell, None] + self.slope[cell] @ (t - 0.5).T

    def most_at(self, t: Float[np.ndarray, "k dim"], cell: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n k"]:
        """The upper linear bound there."""
        return self.most[cell, None] + self.slope[cell] @ (t - 0.5).T

    def of_motions(self, change: Float[np.ndarray, "n dim"], cell: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """What straight motions cost at the most, wherever they are in their cells."""
        return self._with_pulls(self.upper[cell], change, cell)

    def of_placed_motions(
        self, change: Float[np.ndarray, "n dim"], cell: Int[np.ndarray, "n"], middle: Float[np.ndarray, "n dim"]
    ) -> Float[np.ndarray, "n"]:
        """What straight motions whose middles are known, from 0 to 1 in their cells, cost at the most."""
        factor = self.most[cell] + np.sum(self.slope[cell] * (middle - 0.5), axis=1)
        return self._with_pulls(np.minimum(factor, self.upper[cell]), change, cell)

    def _with_pulls(
        self, factor: Float[np.ndarray, "n"], change: Float[np.ndarray, "n dim"], cell: Int[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        pulls = None if self.pulls is None else self.pulls[:, cell]
        return self.motion.norm(change) * factor + pulled(pulls, change)


def cell_costs(space: ConfigurationSpace, cost_map: CostMap | None, mesh: Mesh) -> CellCosts:
    """Bounds of what motions cost in each cell of a mesh; ``ValueError`` if they are none."""
    motion, num = space.motion_cost, len(mesh.state)
    flat, ones = np.zeros((num, mesh.dim)), np.ones(num)
    if cost_map is None:
        return CellCosts(motion, None, ones, ones, flat, ones, ones)
    if isinstance(cost_map, DirectionalCost):
        lower, upper, pulls = cost_bounds(motion, cost_map, *mesh.grown_boxes)
        return CellCosts(motion, cost_map, lower, upper, flat, lower, upper, pulls)
    # Linear functions are bounds of the factor in a cell if they are so in each of its parts.
    parts = _PARTS.get(mesh.dim, 1)
    place = np.array(list(product(range(parts), repeat=mesh.dim)))

    def bounds_of_parts(lo, hi):
        ends = (lo[:, None] + (hi - lo)[:, None] * (place + end) / parts for end in (0, 1))
        bounds = cost_bounds(motion, cost_map, *(end.reshape(-1, mesh.dim) for end in ends))
        return (bound.reshape(num, -1) for bound in bounds[:2])

    lo, hi = mesh.grown_boxes
    (lower, _), (_, upper) = bounds_of_parts(*mesh.boxes), bounds_of_parts(lo, hi)
    at = (place + 0.5) / parts - 0.5
    slope = (lower + upper) / 2 @ at / np.maximum(np.sum(at**2, axis=0), np.finfo(float).tiny)
    # Parts of boxes that are a little larger than cells: what they are beyond their part of the cell counts.
    half = (hi - lo) / (2 * parts) + (hi - lo - mesh.widths)
    within, linear = np.sum(np.abs(slope) * half / mesh.widths, axis=1, keepdims=True), slope @ at.T
    least, most = np.min(lower - linear - within, axis=1), np.max(upper - linear + within, axis=1)
    lower, upper = lower.min(axis=1), upper.max(axis=1)
    # Where the factor jumps they say less than its least and its largest value.
    is_flat = (least - np.abs(slope).sum(axis=1) / 2 < _LEAST_SHARE * lower) | (least < lower) | (most > upper)
    slope[is_flat] = 0.0
    least, most = np.where(is_flat, lower, least), np.where(is_flat, upper, most)
    return CellCosts(motion, cost_map, lower, upper, slope, least, most)
