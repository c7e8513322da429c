"""Tests of which boxes hold points that reach a goal, and which hold *cut-off* points: free points that do not.

``Workspace.reach`` makes exact tests for polygons, ``reach_of_cells`` for the cells of a grid.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

# Cut-off points are *far* if they are farther than this from points that reach the goal, in widths of the domain.
FAR = 1 / 64
_GROWN = 2.0**-21  # share of the domain by which rounding may place points outside of their box in a query
_SHRUNK = 1e-9  # share of the domain by which boxes are shrunk, so that they do not meet what only touches them
_NUM_BOXES = 1024  # about so many equal boxes show which share of free space is cut off
Fractions: TypeAlias = Float[np.ndarray, "boxes dim"]
BoxTest: TypeAlias = Callable[[Fractions, Fractions], Bool[np.ndarray, " boxes"]]


@dataclass(frozen=True, eq=False)
class Reach:
    """Tests of boxes, given by their corners ``lo`` and ``hi``, from 0 to 1 along each axis of a domain.

    Attributes:
        reached: Whether boxes hold points that reach the goal.
        cut_off: Whether boxes hold cut-off points: free points that do not reach the goal.
        far: Whether boxes hold cut-off points that are farther than 1/64 of the domain from all that reach the goal.
    """

    reached: BoxTest
    cut_off: BoxTest
    far: BoxTest

    def is_cut_off(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether boxes hold cut-off points, and no point that reaches the goal, not even by rounding."""
        holds = self.cut_off(lo + _SHRUNK, hi - _SHRUNK)
        holds[holds] = ~self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def is_border(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether boxes hold points that reach the goal, and cut-off points far from all such points."""
        holds = self.far(lo + _SHRUNK, hi - _SHRUNK) & (np.linalg.norm(hi - lo, axis=1) > FAR)
        holds[holds] = self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def holds_reached(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether points inside of boxes reach the goal."""
        return self.reached(lo + _SHRUNK, hi - _SHRUNK)

    def cut_off_fraction(self, dim: int) -> float:
        """Return roughly which share of free space is cut off."""
        # Count the boxes of a lattice that hold reached points, and those that hold cut-off points.
        num = round(_NUM_BOXES ** (1 / dim))
        lo = np.array(list(product(range(num), repeat=dim))) / num
        reached = np.count_nonzero(self.reached(lo, lo + 1 / num))
        cut_off = np.count_nonzero(self.cut_off(lo, lo + 1 / num))
        return cut_off / max(reached + cut_off, 1)
