"""Unreachable leaves borrow the plane of a neighbor, so that a free point beside or in a wall has an answer."""

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.partition.cells import Cells

_PAIRS_AT_ONCE = 4_000_000


def fill_unreachable(
    cells: Cells,
    unreachable: Bool[np.ndarray, "leaves"],
    slope: Float[np.ndarray, "leaves dim"],
    intercept: Float[np.ndarray, "leaves"],
) -> tuple[Float[np.ndarray, "leaves dim"], Float[np.ndarray, "leaves"]]:
    """Give every unreachable leaf that touches a reachable one that one's plane, the others slope 0 and ``inf``.

    Of several neighbors the one with the largest contact is taken, then the first.
    """
    donor = _neighbor_of_largest_contact(cells, np.flatnonzero(unreachable), np.flatnonzero(~unreachable))
    slope = np.where(unreachable[:, None], 0.0, slope)
    intercept = np.where(unreachable, np.inf, intercept)
    has_donor = donor >= 0
    leaf = np.flatnonzero(unreachable)[has_donor]
    slope[leaf], intercept[leaf] = slope[donor[has_donor]], intercept[donor[has_donor]]
    return slope, intercept


def _neighbor_of_largest_contact(
    cells: Cells, unreachable: Int[np.ndarray, "unreachable"], reachable: Int[np.ndarray, "reachable"]
) -> Int[np.ndarray, "unreachable"]:
    """For each unreachable leaf the reachable leaf that shares the largest face (or edge, or corner); -1 for none."""
    finest = cells.depth.max(axis=0)
    lo = cells.position << (finest - cells.depth)
    hi = (cells.position + 1) << (finest - cells.depth)
    donor = np.full(len(unreachable), -1)
    rows = max(1, _PAIRS_AT_ONCE // max(len(reachable), 1))
    for start in range(0, len(unreachable) if len(reachable) else 0, rows):
        chunk = unreachable[start : start + rows]
        contact = np.ones((len(chunk), len(reachable)))
        for axis in range(cells.dim):
            low = np.maximum(lo[chunk, axis, None], lo[reachable, axis])
            high = np.minimum(hi[chunk, axis, None], hi[reachable, axis])
            # Touching in a point along this axis counts far less than an overlap of the finest slot.
            overlap = np.where(high == low, 2.0**-20, np.maximum(high - low, 0))
            contact *= overlap / 2.0 ** finest[axis]
        best = np.argmax(contact, axis=1)
        found = contact[np.arange(len(chunk)), best] > 0
        donor[start : start + rows][found] = reachable[best[found]]
    return donor
