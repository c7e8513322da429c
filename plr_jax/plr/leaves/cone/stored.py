"""From leaves and the sources that they chose to what a file keeps of them, and its size."""

import numpy as np
from jaxtyping import Int

from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.leaves.cone.codec import StoredCones, cones_bits, store_sources
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import levels_of


def stored_cones(
    cells: Cells, source: Int[np.ndarray, "leaves"], sources: Sources, domain: Box
) -> tuple[Cells, StoredCones]:
    """Leaves in the order of the tree's traversal, and what a file keeps of them.

    Where a leaf has no source, -1, it takes that of the leaf before.
    """
    order = levels_of(cells)[1]
    return cells[order], cones_in_order(source[order], sources, domain)


def cones_in_order(source: Int[np.ndarray, "leaves"], sources: Sources, domain: Box) -> StoredCones:
    """What a file keeps of leaves in the order of the tree's traversal."""
    leaf = np.flatnonzero(source >= 0)
    before = np.searchsorted(leaf, np.arange(len(source)), side="right") - 1
    source = source[leaf[np.maximum(before, 0)]]
    kept = _with_parents(np.unique(source), sources.parents)
    place = np.searchsorted(kept, np.arange(len(sources.parents)))
    stored, index = store_sources(sources.points[kept], sources.distances[kept], place[sources.parents[kept]], domain)
    return StoredCones(stored, index[place[source]])


def num_bytes_of(cells: Cells, cones: StoredCones, domain: Box, limits: Limits) -> int:
    """Bytes of the file of some leaves, and of a proof if there is to be one."""
    return limits.file_size(cells.dim, len(cells), cones_bits(domain, cones))


def _with_parents(used: Int[np.ndarray, "used"], parents: Int[np.ndarray, "sources"]) -> Int[np.ndarray, "kept"]:
    """Indices of some sources, of their parents, and so on, ascending."""
    kept = np.zeros(len(parents), bool)
    while len(used):
        kept[used] = True
        used = np.unique(parents[used])
        used = used[~kept[used]]
    return np.flatnonzero(kept)
