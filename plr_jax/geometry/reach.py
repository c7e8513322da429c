"""Tests whether boxes contain points that *reach* a goal, or *cut-off* points.

A point reaches the goal if a free path leads from the point to the goal. A free point without such a path is cut off.
``Workspace.reach`` makes exact tests for polygons, ``reach_of_cells`` makes tests for the cells of a grid.
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
    """Tests of boxes in a domain. Each test returns a bool for each box.

    Boxes are given by their lower corners ``lo`` and upper corners ``hi``, ``(boxes, dim)``, as fractions of the
    domain: from 0 to 1 along each axis.

    Attributes:
        reached: Whether each box holds a point that reaches the goal.
        cut_off: Whether each box holds a cut-off point: a free point from which no free path leads to the goal.
        far: Whether each box holds a cut-off point farther than 1/64 from all points that reach the goal, where 1 is
            the width of the domain along each axis. For a grid of cells: whether the box may hold such a point.
    """

    reached: BoxTest
    cut_off: BoxTest
    far: BoxTest

    def is_cut_off(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether each box holds a cut-off point, but no point that reaches the goal.

        The second test takes a slightly larger box, because a query rounds points.
        """
        # Rounding may place points just outside of a box inside.
        holds = self.cut_off(lo + _SHRUNK, hi - _SHRUNK)
        holds[holds] = ~self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def is_border(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether each box holds a point that reaches the goal, and also passes the test ``far``.

        The result is False for boxes with a diagonal of at most 1/64, in fractions of the domain.
        """
        holds = self.far(lo + _SHRUNK, hi - _SHRUNK) & (np.linalg.norm(hi - lo, axis=1) > FAR)
        holds[holds] = self.reached(lo[holds] - _GROWN, hi[holds] + _GROWN)
        return holds

    def holds_reached(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        """Return whether the interior of each box holds a point that reaches the goal."""
        return self.reached(lo + _SHRUNK, hi - _SHRUNK)

    def cut_off_fraction(self, dim: int) -> float:
        """Estimate the share of free space that is cut off, from 0 to 1, in a domain of ``dim`` dimensions."""
        # Count the boxes of a lattice that hold reached points, and the boxes that hold cut-off points.
        num = round(_NUM_BOXES ** (1 / dim))
        lo = np.array(list(product(range(num), repeat=dim))) / num
        reached = np.count_nonzero(self.reached(lo, lo + 1 / num))
        cut_off = np.count_nonzero(self.cut_off(lo, lo + 1 / num))
        return cut_off / max(reached + cut_off, 1)
