"""From places to leaves in NumPy: a table of the first bits of places, and down the tree from there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Integer, UInt32

from plr_jax.plr.portable.program import CodedTree
from plr_jax.plr.query.grid import FRACTION_BITS, spread_bits

_MOST_BITS = 16  # of the table, which then fits a core's second-level cache


@dataclass(frozen=True, eq=False)
class LeafTable:
    """A table of nodes, one for each cell of a grid, and the tree below them.

    Attributes:
        tree: The tree.
        bits: Of a place along each axis, that tell cells of the grid apart.
        table: Code of the node that holds each cell, the deepest one.
        children: Of the tree's split nodes, side by side, in the type of the table.
    """

    tree: CodedTree
    bits: tuple[int, ...]
    table: Integer[np.ndarray, "cells"]
    children: Integer[np.ndarray, "children"]

    @staticmethod
    def of(tree: CodedTree) -> "LeafTable":
        """Of a tree."""
        deepest = np.zeros(tree.dim, np.int64)
        np.maximum.at(deepest, tree.axis, tree.depth + 1)
        bits = spread_bits(deepest, _MOST_BITS)
        cell = np.indices((1 << bits).tolist()).reshape(tree.dim, -1)
        code = np.full(cell.shape[1], tree.root)
        moving = np.arange(len(code))
        while len(moving):
            node = code[moving] >> tree.kind_bits
            is_split = code[moving] & ((1 << tree.kind_bits) - 1) < tree.dim
            below = np.zeros(len(moving), np.int64)
            below[is_split] = (bits[tree.axis] - 1 - tree.depth)[node[is_split]]
            moves = is_split & (below >= 0)
            moving, node, below = moving[moves], node[moves], below[moves]
            code[moving] = tree.children[node, (cell[tree.axis[node], moving] >> below) & 1]
        table, children = (codes.astype(tree.code_type) for codes in (code, tree.children.ravel()))
        return LeafTable(tree, tuple(bits.tolist()), table, children)

    @property
    def _kind(self) -> int:
        return (1 << self.tree.kind_bits) - 1

    @property
    def is_flat(self) -> bool:
        """Whether the table knows every leaf."""
        return bool((self.table & self._kind == self.tree.dim).all())

    @cached_property
    def codes(self) -> memoryview:
        """The table, whose entries are then integers of Python."""
        return self.table.data

    @cached_property
    def _child_codes(self) -> memoryview:
        return self.children.data

    @cached_property
    def _depth(self) -> memoryview:
        return self.tree.depth.data

    def index_text(self, places: list[str]) -> str:
        """The row of numbers for places, of 23 bits each, as text of Python."""
        shifted = [f"{place} >> {FRACTION_BITS - bits}" for place, bits in zip(places, self.bits, strict=True)]
        index = shifted[0]
        for along, bits in zip(shifted[1:], self.bits[1:], strict=True):
            index = f"({index}) << {bits} | {along}"
        if self.is_flat:
            return f"codes[{index}] >> {self.tree.kind_bits}"
        return f"descend(codes[{index}], ({', '.join(places)},))"

    def row(self, code: int, places: tuple[int, ...]) -> int:
        """The row of numbers for one place, below the node of that code."""
        kind_bits = self.tree.kind_bits
        while (axis := code & self._kind) != self.tree.dim:
            node = code >> kind_bits
            code = self._child_codes[2 * node + ((places[axis] >> (FRACTION_BITS - 1 - self._depth[node])) & 1)]
        return code >> kind_bits

    def rows(self, places: list[UInt32[np.ndarray, "n"]]) -> Integer[np.ndarray, "n"]:
        """The row of numbers for each place."""
        index = places[0] >> (FRACTION_BITS - self.bits[0])
        for place, bits in zip(places[1:], self.bits[1:], strict=True):
            index = (index << bits) | (place >> (FRACTION_BITS - bits))
        code = self.table[index]
        moving = np.flatnonzero(code & self._kind != self.tree.dim)
        while len(moving):
            node = code[moving] >> self.tree.kind_bits
            axis = self.tree.axis[node]
            place = np.choose(axis, [along[moving] for along in places])
            bit = (place >> (FRACTION_BITS - 1 - self.tree.depth[node])) & 1
            code[moving] = self.children[2 * node + bit]
            moving = moving[code[moving] & self._kind != self.tree.dim]
        return code >> self.tree.kind_bits
