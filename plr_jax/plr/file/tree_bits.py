"""The tree over a PLR's leaves as bits.

Level by level from the root: for every node 1 bit (is it split?), then for every split node its axis in
``ceil(log2(dim))`` bits. The leaves' boxes follow from the splits.
"""

import numpy as np

from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import MAX_DEPTH, Level, cells_of


def write_tree(body: BitWriter, levels: list[Level], dim: int) -> None:
    """Append a tree."""
    for level in levels:
        body.write(level.inner.astype(np.int64), 1)
        body.write(level.axis, _axis_bits(dim))


def read_leaves(body: BitReader, dim: int, num_leaves: int) -> Cells:
    """The leaves of the tree that comes next; raises ``ValueError`` if it is none with so many."""
    cells = cells_of(_read_tree(body, dim), dim)
    if len(cells) != num_leaves:
        raise ValueError(f"its tree has {len(cells)} leaves, its header states {num_leaves}")
    return cells


def tree_bits(num_leaves: int, dim: int) -> int:
    """Bits of a tree of so many leaves."""
    return 2 * num_leaves - 1 + (num_leaves - 1) * _axis_bits(dim)


def _read_tree(body: BitReader, dim: int) -> list[Level]:
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
