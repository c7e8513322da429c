"""Which leaves share faces, and between which corners a split put another."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.pairs import Pairs, leaf_pairs, overlap
from plr_jax.plr.partition.tree import Tree, corner_bits

_MOST_FACES, _MOST_FACES_OF_LEAF = 2**18, 2**7  # in all, or for every leaf where that is more


@dataclass(frozen=True, eq=False)
class SharedFaces:
    """Pieces of faces across an axis that two leaves share: what one below it and one above it have in common.

    Across the seam of a periodic axis the lower leaf is at the upper end of the domain. A leaf that spans such an
    axis shares a face with itself.
    """

    lower: Int[np.ndarray, "faces"]
    upper: Int[np.ndarray, "faces"]
    axis: Int[np.ndarray, "faces"]

    def __len__(self) -> int:
        return len(self.axis)

    def __getitem__(self, index) -> "SharedFaces":
        return SharedFaces(self.lower[index], self.upper[index], self.axis[index])


def shared_faces(tree: Tree, periodic: tuple[bool, ...] = ()) -> SharedFaces:
    """All pairs of leaves that share a piece of a face, sorted by the lower leaf, then the upper, then the axis.

    The halves of a split share a face, and the root one with itself across the seam of each ``periodic`` axis. A pair
    of nodes that do is replaced by pairs of a node and a child that do, until both are leaves.

    Raises:
        ValueError: If they are too many to be listed, as where many slabs meet many that lie across them.
    """
    most = max(_MOST_FACES, _MOST_FACES_OF_LEAF * len(tree.node_of_leaf))
    split = np.flatnonzero(tree.child >= 0)
    pairs = np.stack([tree.child[split], tree.child[split] + 1, tree.axis[split]])
    seams = np.flatnonzero(periodic)
    pairs = np.concatenate([pairs, np.stack([0 * seams, 0 * seams, seams])], axis=1)

    def keep(pairs: Pairs, side: int, half: int, axis: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        if pairs.shape[1] > most:
            raise ValueError(f"its {len(tree.node_of_leaf)} leaves share more than {most} faces; build it of fewer")
        # Of halves along the face's own axis, the one beyond the other's reach of the face does not touch it.
        return np.where(axis == pairs[2], half != side, overlap(tree.cells, pairs[0], tree.cells, pairs[1], axis))

    lower, upper, axis = leaf_pairs(tree, tree, pairs, keep)
    order = np.lexsort((axis, upper, lower))
    return SharedFaces(lower[order], upper[order], axis[order])


def face_points(cells: Cells, faces: SharedFaces, w: Float[np.ndarray, "k dim"]) -> Float[np.ndarray, "faces k dim"]:
    """Points of pieces of faces as fractions of the domain; ``w`` from 0 to 1 spans a piece, along its axes.

    A seam is at 1, where its lower leaf is.
    """
    size = np.ldexp(1.0, -cells.depth)
    lo, hi = cells.position * size, (cells.position + 1) * size
    low = np.maximum(lo[faces.lower], lo[faces.upper])
    high = np.minimum(hi[faces.lower], hi[faces.upper])
    each = np.arange(len(faces))
    low[each, faces.axis] = high[each, faces.axis] = hi[faces.lower, faces.axis]
    return low[:, None] + (high - low)[:, None] * w


def parents_of_corners(tree: Tree) -> tuple[Int[np.ndarray, "leaves corners 2"], Bool[np.ndarray, "leaves corners"]]:
    """For every corner of every leaf the two between which a split put it, and whether one did.

    The youngest split that made a corner halved an edge of the split cell: the corner is the middle of that edge.
    Its ends are corners of leaves inside the split cell, numbered ``leaf * 2**dim + corner``.
    """
    bits = corner_bits(tree.cells.dim)
    weight = 1 << np.arange(tree.cells.dim)[::-1]
    origin = np.full((len(tree.child), len(bits)), -1)
    for split in tree.splits:
        for half in range(2):
            stays = (bits == half)[:, tree.axis[split]].T
            origin[tree.child[split] + half] = np.where(stays, origin[split], split[:, None])
    leaf_at = np.empty_like(origin)
    leaf_at[tree.node_of_leaf] = np.arange(len(tree.node_of_leaf))[:, None]
    corners = np.arange(len(bits))
    for split in reversed(tree.splits):
        leaf_at[split] = leaf_at[tree.child[split][:, None] + bits[:, tree.axis[split]].T, corners]
    made_by = origin[tree.node_of_leaf]
    across = weight[tree.axis[made_by]]
    ends = np.stack([corners & ~across, corners | across], axis=-1)
    return leaf_at[made_by[..., None], ends] * len(bits) + ends, made_by >= 0
