"""Which boxes of a domain hold points that reach a goal, and which hold *cut-off* points: free points that do not.

Tests of boxes are exact for free space of polygons, and for the cells of a grid.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float

from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import Sums
from plr_jax.geometry.workspace import Workspace

# Cut-off points are *far* if they are farther than this from points that reach the goal, in widths of the domain.
FAR = 1 / 64
_GROWN = 2.0**-21  # share of the domain by which rounding may place points outside of their box in a query
_SHRUNK = 1e-9  # share of the domain by which boxes are shrunk, so that they do not meet what only touches them
_NUM_BOXES = 1024  # about so many equal boxes show which share of free space is cut off
Fractions: TypeAlias = Float[np.ndarray, "boxes dim"]
BoxTest: TypeAlias = Callable[[Fractions, Fractions], Bool[np.ndarray, "boxes"]]


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

    def is_cut_off(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, "boxes"]:
        """Return whether boxes hold cut-off points, and no point that reaches the goal, not even by rounding."""
        found = self.cut_off(lo + _SHRUNK, hi - _SHRUNK)
        found[found] = ~self.reached(lo[found] - _GROWN, hi[found] + _GROWN)
        return found

    def is_border(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, "boxes"]:
        """Return whether boxes hold points that reach the goal, and cut-off points far from all such points."""
        found = self.far(lo + _SHRUNK, hi - _SHRUNK)
        found[found] = self.reached(lo[found] - _GROWN, hi[found] + _GROWN)
        return found

    def holds_reached(self, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, "boxes"]:
        """Return whether points inside of boxes reach the goal."""
        return self.reached(lo + _SHRUNK, hi - _SHRUNK)

    def share_cut_off(self, dim: int) -> float:
        """Return roughly which share of free space is cut off."""
        num = round(_NUM_BOXES ** (1 / dim))
        lo = np.array(list(product(range(num), repeat=dim))) / num
        reached = np.count_nonzero(self.reached(lo, lo + 1 / num))
        cut_off = np.count_nonzero(self.cut_off(lo, lo + 1 / num))
        return cut_off / max(reached + cut_off, 1)


def reach_of_parts(workspace: Workspace, goals: Float[np.ndarray, "goals 2"], domain: Box) -> Reach | None:
    """Return the reach of the nearest of several goals, or None if all of free space reaches one."""
    parts = shapely.get_parts(workspace.free_space)
    if len(parts) < 2:
        return None
    inside = shapely.get_coordinates(shapely.point_on_surface(parts))
    reaches = np.any([workspace.reachable(inside, goal) for goal in goals], axis=0)
    if reaches.all():
        return None
    parts = shapely.transform(parts, lambda x: (x - domain.lo) / domain.width)
    reached, cut_off = (shapely.multipolygons(parts[some]) for some in (reaches, ~reaches))
    x0, y0, x1, y1 = shapely.bounds(parts[~reaches]).T
    around = shapely.union_all(shapely.box(x0 - FAR, y0 - FAR, x1 + FAR, y1 + FAR))
    near = shapely.buffer(shapely.intersection(reached, around), FAR)
    return Reach(*map(_meeting, (reached, cut_off, shapely.difference(cut_off, near))))


def _meeting(polygons: Any) -> BoxTest:
    shapely.prepare(polygons)
    return lambda lo, hi: shapely.intersects(polygons, shapely.box(*lo.T, *hi.T))


def reach_of_cells(
    reached: Bool[np.ndarray, "..."], cut_off: Bool[np.ndarray, "..."], bounds: Box, domain: Box
) -> Reach:
    """Return the reach of a goal on a grid of cells that fill ``bounds``; array axes are coordinate axes."""
    from scipy import ndimage

    shape = np.array(reached.shape)
    far = np.zeros_like(cut_off)
    if cut_off.any() and reached.any():
        side = bounds.width / shape / domain.width
        away: Any = ndimage.distance_transform_edt(~reached, sampling=side)  # between centers of cells
        far = cut_off & (away > FAR - np.linalg.norm(side))

    def counting(cells: Bool[np.ndarray, "..."]) -> BoxTest:
        sums = Sums.of(np.ascontiguousarray(cells))

        def test(lo: Fractions, hi: Fractions) -> Bool[np.ndarray, "boxes"]:
            first, last = ((domain.lo + end * domain.width - bounds.lo) / bounds.width * shape for end in (lo, hi))
            first, last = np.maximum(np.floor(first), 0), np.minimum(np.ceil(last), shape) - 1
            return sums.within(first.astype(np.int64).T, last.astype(np.int64).T) > 0

        return test

    return Reach(*map(counting, (reached, cut_off, far)))
