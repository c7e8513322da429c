"""The tree that a bit stream begins with.

Level by level from the root, for every node 1 bit (is it split?), then for every split node its axis in
``ceil(log2(dim))`` bits.
"""

import numpy as np

from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.partition.tree import MAX_DEPTH, Level


def body_size(dim: int, num_leaves: int, num_bits: int) -> int:
    """Bytes of the bit stream of so many leaves, of which the model and the proof keep so many bits."""
    tree_bits = 2 * num_leaves - 1 + (num_leaves - 1) * _axis_bits(dim)
    return int(-(-(tree_bits + num_bits) // 8))


def write_tree(body: BitWriter, levels: list[Level], dim: int) -> None:
    """Append a tree."""
    for level in levels:
        body.write(level.inner.astype(np.int64), 1)
        body.write(level.axis, _axis_bits(dim))


def read_tree(body: BitReader, dim: int) -> list[Level]:
    """The tree that comes next; raises ``ValueError`` if it is none."""
    levels, num_nodes = [], 1
    while num_nodes:
        if len(levels) > MAX_DEPTH:
            raise ValueError(f"its tree is deeper than {MAX_DEPTH}")
        inner = body.read_alike(num_nodes, 1) == 1
        axis = body.read_alike(int(np.count_nonzero(inner)), _axis_bits(dim))
        if (axis >= dim).any():
            raise ValueError(f"it splits axis {axis.max()} of {dim}")
        levels.append(Level(inner, axis))
        num_nodes = 2 * len(axis)
    return levels


def _axis_bits(dim: int) -> int:
    return (dim - 1).bit_length()
