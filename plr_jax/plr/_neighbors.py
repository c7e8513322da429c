"""Blocked leaves borrow the plane of a neighbor, so that a free point beside or in a wall has an answer."""

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr._cells import Cells

_PAIRS_AT_ONCE = 4_000_000


def fill_blocked(
    cells: Cells,
    blocked: Bool[np.ndarray, "leaves"],
    slope: Float[np.ndarray, "leaves dim"],
    intercept: Float[np.ndarray, "leaves"],
) -> tuple[Float[np.ndarray, "leaves dim"], Float[np.ndarray, "leaves"]]:
    """Give every blocked leaf that touches an unblocked one that neighbor's plane, all others slope 0 and ``inf``.

    Of several neighbors the one with the largest contact is taken, then the first.
    """
    donor = _neighbor_of_largest_contact(cells, np.flatnonzero(blocked), np.flatnonzero(~blocked))
    slope = np.where(blocked[:, None], 0.0, slope)
    intercept = np.where(blocked, np.inf, intercept)
    has_donor = donor >= 0
    leaf = np.flatnonzero(blocked)[has_donor]
    slope[leaf], intercept[leaf] = slope[donor[has_donor]], intercept[donor[has_donor]]
    return slope, intercept


def _neighbor_of_largest_contact(
    cells: Cells, blocked: Int[np.ndarray, "b"], open_: Int[np.ndarray, "o"]
) -> Int[np.ndarray, "b"]:
    """For each blocked leaf the unblocked leaf that shares the largest face (or edge, or corner); -1 for none."""
    finest = cells.depth.max(axis=0)
    lo = cells.position << (finest - cells.depth)
    hi = (cells.position + 1) << (finest - cells.depth)
    donor = np.full(len(blocked), -1)
    rows = max(1, _PAIRS_AT_ONCE // max(len(open_), 1))
    for start in range(0, len(blocked) if len(open_) else 0, rows):
        chunk = blocked[start : start + rows]
        contact = np.ones((len(chunk), len(open_)))
        for axis in range(cells.dim):
            low = np.maximum(lo[chunk, axis, None], lo[open_, axis])
            high = np.minimum(hi[chunk, axis, None], hi[open_, axis])
            # Touching in a point along this axis counts half a finest slot, far below any overlap.
            contact *= np.where(high == low, 2.0**-20, np.maximum(high - low, 0) / 2.0 ** finest[axis])
        best = np.argmax(contact, axis=1)
        found = contact[np.arange(len(chunk)), best] > 0
        donor[start : start + rows][found] = open_[best[found]]
    return donor
