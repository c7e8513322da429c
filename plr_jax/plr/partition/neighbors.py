"""Which leaf of one set shares the largest face, edge or corner with each leaf of another."""

import numpy as np
from jaxtyping import Int

from plr_jax.plr.partition.cells import Cells

_PAIRS_AT_ONCE = 4_000_000


def neighbor_of_largest_contact(
    cells: Cells, unreachable: Int[np.ndarray, "unreachable"], reachable: Int[np.ndarray, "reachable"]
) -> Int[np.ndarray, "unreachable"]:
    """For each unreachable leaf the reachable one that shares the largest face, edge or corner, the first of several.

    -1 where it touches none.
    """
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
