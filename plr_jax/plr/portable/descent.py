"""From places to leaves in NumPy: a table of the first bits of places, and down the tree from there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Integer, UInt32

from plr_jax.plr.portable.program import Nodes
from plr_jax.plr.query.grid import FRACTION_BITS, spread_bits

_MOST_BITS = 16  # of the table, which then fits a core's second-level cache


@dataclass(frozen=True, eq=False)
class Descent:
    """A table of nodes, one for each cell of a grid, and the tree below them.

    Attributes:
        nodes: The tree.
        bits: Of a place along each axis, that tell cells of the grid apart.
        table: Code of the node that holds each cell, the deepest one.
        children: Of the tree's split nodes, side by side, in the type of the table.
    """

    nodes: Nodes
    bits: tuple[int, ...]
    table: Integer[np.ndarray, "cells"]
    children: Integer[np.ndarray, "children"]

    @staticmethod
    def of(nodes: Nodes) -> "Descent":
        """Of a tree."""
        deepest = np.zeros(nodes.dim, np.int64)
        np.maximum.at(deepest, nodes.axis, nodes.depth + 1)
        bits = spread_bits(deepest, _MOST_BITS)
        cell = np.indices(1 << bits).reshape(nodes.dim, -1)
        code = np.full(cell.shape[1], nodes.root)
        moving = np.arange(len(code))
        while len(moving):
            node = code[moving] >> nodes.kind_bits
            is_split = code[moving] & ((1 << nodes.kind_bits) - 1) < nodes.dim
            below = np.zeros(len(moving), np.int64)
            below[is_split] = (bits[nodes.axis] - 1 - nodes.depth)[node[is_split]]
            moves = is_split & (below >= 0)
            moving, node, below = moving[moves], node[moves], below[moves]
            code[moving] = nodes.children[node, (cell[nodes.axis[node], moving] >> below) & 1]
        largest = max(nodes.root, nodes.children.max(initial=0))
        code_type = np.uint16 if largest < 2**16 else np.uint32
        return Descent(nodes, tuple(bits.tolist()), code.astype(code_type), nodes.children.astype(code_type).ravel())

    @property
    def _kind(self) -> int:
        return (1 << self.nodes.kind_bits) - 1

    @property
    def is_flat(self) -> bool:
        """Whether the table knows every leaf."""
        return bool((self.table & self._kind == self.nodes.dim).all())

    @cached_property
    def codes(self) -> memoryview:
        """The table, whose entries are then integers of Python."""
        return memoryview(self.table)

    @cached_property
    def _child_codes(self) -> memoryview:
        return memoryview(self.children)

    @cached_property
    def _depth(self) -> memoryview:
        return memoryview(self.nodes.depth)

    def index_text(self, places: list[str]) -> str:
        """The row of numbers for places, of 23 bits each, as text of Python."""
        shifted = [f"{place} >> {FRACTION_BITS - bits}" for place, bits in zip(places, self.bits, strict=True)]
        index = shifted[0]
        for along, bits in zip(shifted[1:], self.bits[1:], strict=True):
            index = f"({index}) << {bits} | {along}"
        if self.is_flat:
            return f"codes[{index}] >> {self.nodes.kind_bits}"
        return f"descend(codes[{index}], ({', '.join(places)},))"

    def row(self, code: int, places: tuple[int, ...]) -> int:
        """The row of numbers for one place, below the node of that code."""
        kind_bits = self.nodes.kind_bits
        while (axis := code & self._kind) != self.nodes.dim:
            node = code >> kind_bits
            code = self._child_codes[2 * node + ((places[axis] >> (FRACTION_BITS - 1 - self._depth[node])) & 1)]
        return code >> kind_bits

    def rows(self, places: list[UInt32[np.ndarray, "n"]]) -> Integer[np.ndarray, "n"]:
        """The row of numbers for each place."""
        index = places[0] >> (FRACTION_BITS - self.bits[0])
        for place, bits in zip(places[1:], self.bits[1:], strict=True):
            index = (index << bits) | (place >> (FRACTION_BITS - bits))
        code = self.table[index]
        moving = np.flatnonzero(code & self._kind != self.nodes.dim)
        while len(moving):
            node = code[moving] >> self.nodes.kind_bits
            axis = self.nodes.axis[node]
            place = np.choose(axis, [along[moving] for along in places])
            bit = (place >> (FRACTION_BITS - 1 - self.nodes.depth[node])) & 1
            code[moving] = self.children[2 * node + bit]
            moving = moving[code[moving] & self._kind != self.nodes.dim]
        return code >> self.nodes.kind_bits
