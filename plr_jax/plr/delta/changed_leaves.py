"""Leaves that name sources, told by what has changed since other ones.

Both trees are walked together, from the root down. With every node of the new one goes the smallest node of the old
one that holds it. Where both are the same cell, a bit says whether all below it is as before. If it is not, or the
cell is none of the old ones, there follows its kind, and then of a leaf the source and the bounds, of another node
its halves. Bits are expected by what the old node is, and what the lower half of the same parent was found to be.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from plr_jax.plr.file.range_coder import RARE, Coder
from plr_jax.plr.partition.cells import MAX_DEPTH, Level, levels_of_preorder, preorder_of_levels

Halves = tuple[tuple[int, ...], ...]
"""Along each axis, in which halves of halves of an old node's cell a new node's cell lies."""
_MOST_SIZE, _RANKS = 4, 4  # bits of a tree's size, and ranks of sources, that are expected each for itself
# What the lower half of the same parent is: as before, so that this half is not, where the parent is not; none; ...
_AS_BEFORE, _NO_HALF, _SPLIT, _LEAF, _LEAF_AS_BEFORE = range(5)


@dataclass(frozen=True, eq=False)
class NamedLeaves:
    """A tree in preorder, and what its leaves name.

    Attributes:
        kind: Of every node, 0 for a leaf, else 1 more than the axis of its split.
        below: How many nodes there are from each one down.
        first: How many leaves are before each node, and last how many there are.
        source: The source of every leaf; -1 if it is gone.
        pair: The pair of bounds of every leaf.
    """

    kind: bytes
    below: list[int]
    first: list[int]
    source: list[int]
    pair: list[int]

    @classmethod
    def of(
        cls, levels: list[Level], source: Int[np.ndarray, "leaves"], pair: Int[np.ndarray, "leaves"]
    ) -> "NamedLeaves":
        """Of a tree's levels."""
        kind, below = preorder_of_levels(levels)
        first = np.append(0, np.cumsum(kind == 0))
        return cls(kind.tobytes(), below.tolist(), first.tolist(), source.tolist(), pair.tolist())

    def leaves_below(self, node: int) -> slice:
        """The leaves of a node."""
        return slice(self.first[node], self.first[node + self.below[node]])


@dataclass(frozen=True)
class Counts:
    """How many axes, sources and pairs of bounds there are, and leaves at the most."""

    dim: int
    num_sources: int
    num_pairs: int
    most_leaves: int


def coded_leaves(
    coder: Coder, before: NamedLeaves, after: NamedLeaves | None, counts: Counts
) -> tuple[list[Level], Int[np.ndarray, "leaves"], Int[np.ndarray, "leaves"]]:
    """Levels of the tree after a change, and its leaves' sources and pairs of bounds.

    They are encoded if they are given, else decoded; raises ``ValueError`` saying what is wrong with them.
    """
    walk = _Walk(coder, before, after, counts)
    walk.visit(0, ((),) * counts.dim)
    levels = levels_of_preorder(np.frombuffer(bytes(walk.kind), np.uint8))
    return levels, np.array(walk.source), np.array(walk.pair)


class _Walk:
    """The walk through both trees, in which the new one is put together; a node's index is how many are before it."""

    def __init__(self, coder: Coder, before: NamedLeaves, after: NamedLeaves | None, counts: Counts) -> None:
        self.coder, self.before, self.after, self.counts = coder, before, after, counts
        self.kind, self.source, self.pair = bytearray(), list[int](), list[int]()
        self.recent = list(range(counts.num_sources))  # sources, the last one named first

    def visit(self, old: int, within: Halves, above: int = 0, lower: int = _NO_HALF, depth: int = 0) -> bool:
        """Code the next node and all below it.

        Args:
            old: The smallest old node that holds it.
            within: Where in that one it lies.
            above: The kind of its parent.
            lower: What the lower half of the same parent is.
            depth: How many nodes are above it.

        Returns:
            Whether it is as before.
        """
        before, node, is_cell = self.before, len(self.kind), not any(within)
        size = min(before.below[old].bit_length(), _MOST_SIZE)
        if is_cell and lower != _AS_BEFORE and self.coder.bit(("as before", size, lower), self._is_as_before(old)):
            self._copy(old)
            return True
        odds = RARE[::-1] if is_cell and size == _MOST_SIZE else (1, 1)  # of a large tree something is kept
        is_split = self.coder.bit(
            ("split", is_cell, size, lower), self.after and int(self.after.kind[node] > 0), odds
        )
        if not is_split:
            self.kind.append(0)
            self._add_leaf(old, is_cell)
            return False
        if depth == MAX_DEPTH:
            raise ValueError(f"its tree is deeper than {MAX_DEPTH}")
        context = "axis", is_cell, before.kind[old], above
        axis = self.coder.symbol(context, self.after and self.after.kind[node] - 1, self.counts.dim)
        self.kind.append(axis + 1)
        is_as_before = self.visit(*self._half(old, within, axis, 0), axis + 1, _NO_HALF, depth + 1)
        upper, within_upper = self._half(old, within, axis, 1)
        if is_as_before and is_cell and before.kind[old] == axis + 1:
            lower = _AS_BEFORE
        elif self.kind[node + 1]:
            lower = _SPLIT
        else:
            lower = _LEAF_AS_BEFORE if self.source[-1] == before.source[before.first[upper]] else _LEAF
        self.visit(upper, within_upper, axis + 1, lower, depth + 1)
        return False

    def _half(self, old: int, within: Halves, axis: int, half: int) -> tuple[int, Halves]:
        """The smallest old node that holds a half of a cell, and where in that it lies."""
        before, halves = self.before, [list(along) for along in within]
        halves[axis].append(half)
        while (kind := before.kind[old]) and halves[kind - 1]:
            is_upper = halves[kind - 1].pop(0)
            old += 1 + is_upper * before.below[old + 1]
        return old, tuple(map(tuple, halves))

    def _is_as_before(self, old: int) -> int | None:
        before, after = self.before, self.after
        if after is None:
            return None
        of, node, leaf, size = before.leaves_below(old), len(self.kind), len(self.source), before.below[old]
        here = slice(leaf, leaf + of.stop - of.start)
        return int(
            after.kind[node : node + size] == before.kind[old : old + size]
            and after.source[here] == before.source[of]
            and after.pair[here] == before.pair[of]
        )

    def _copy(self, old: int) -> None:
        before, of = self.before, self.before.leaves_below(old)
        self._require_room(of.stop - of.start)
        if min(before.source[of]) < 0:
            raise ValueError("it keeps leaves whose sources are gone")
        self.kind += before.kind[old : old + before.below[old]]
        self.source += before.source[of]
        self.pair += before.pair[of]
        self._name(self.source[-1])

    def _add_leaf(self, old: int, is_cell: bool) -> None:
        before, after, leaf = self.before, self.after, len(self.source)
        self._require_room(1)
        is_split, first = before.kind[old] > 0, before.first[old]
        source = self._coded_source(before.source[first], after and after.source[leaf], (is_cell, is_split))
        self.source.append(source)
        self._name(source)
        context = "pair", is_cell, -1 if is_split else before.pair[first]
        self.pair.append(self.coder.symbol(context, after and after.pair[leaf], max(self.counts.num_pairs, 1)))

    def _coded_source(self, expected: int, source: int | None, context: tuple[bool, bool]) -> int:
        """A source: the expected one, or one of those lately named."""
        coder = self.coder
        is_expected = None if source is None else int(source == expected)
        if expected >= 0 and coder.bit(("source as before", *context), is_expected):
            return expected
        others = [each for each in self.recent if each != expected]
        rank = None if source is None else others.index(source)
        for each in range(_RANKS):
            if coder.bit(("rank of source", each), None if rank is None else int(rank == each)):
                rank = each
                break
        else:
            rank = _RANKS + coder.count("rank of source", None if rank is None else rank - _RANKS)
        if rank >= len(others):
            raise ValueError(f"it names source {rank} of {len(others)}")
        return others[rank]

    def _name(self, source: int) -> None:
        self.recent.remove(source)
        self.recent.insert(0, source)

    def _require_room(self, num_leaves: int) -> None:
        if len(self.source) + num_leaves > self.counts.most_leaves:
            raise ValueError(f"it has more leaves than the {self.counts.most_leaves:,} that it states")
