"""The leaves of best trees of several members at once, walked down level by level."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from plr_jax.plr.growth.levels import BoxLevel, Prunings
from plr_jax.plr.leaves.cone.family.start import Start, Top
from plr_jax.plr.leaves.cone.sight import MemberTree
from plr_jax.plr.partition.cells import MAX_DEPTH, Cells
from plr_jax.plr.partition.cells import Level as Splits


@dataclass(frozen=True, eq=False)
class Cut:
    """Which tree of each member: the best at one price, and at the next lower one in some boxes of the start.

    Attributes:
        goal: The members.
        price: Index of the price of each.
        num_lower: In how many of the boxes of the start, in the order of the traversal, the next price counts.
    """

    goal: Int[np.ndarray, "members"]
    price: Int[np.ndarray, "members"]
    num_lower: Int[np.ndarray, "members"]


class _Walk:
    """Nodes of one depth of several trees, member by member, each member's from left to right, and leaves so far."""

    def __init__(self, num_members: int) -> None:
        self.member = np.arange(num_members)
        self.node, self.path = np.zeros(num_members, np.int64), np.zeros(num_members, np.int64)
        self.price = np.zeros(num_members, np.int64)
        self.num_members, self.depth = num_members, 0
        self.levels: list[list[Splits]] = [[] for _ in range(num_members)]
        self.leaves: list[tuple[np.ndarray, ...]] = []

    def descend(
        self, axis: Int[np.ndarray, "nodes"], child: Int[np.ndarray, "2 2 _"], leaves: tuple[np.ndarray, ...]
    ) -> None:
        """Take nodes whose axis is -1 as leaves, of which this is known, and go on to the halves of the rest."""
        inner = axis >= 0
        counts = np.searchsorted(self.member, np.arange(self.num_members + 1))
        for member in np.flatnonzero(np.diff(counts)):
            some = slice(counts[member], counts[member + 1])
            is_inner = inner[some]
            self.levels[member].append(Splits(is_inner, axis[some][is_inner].astype(np.int64)))
        ends = ~inner
        self.leaves.append((self.member[ends], self.path[ends], *(column[ends] for column in leaves)))
        upper = np.tile(np.array([0, 1]), np.count_nonzero(inner))
        self.node = child[axis[inner], :, self.node[inner]].ravel()
        self.path = np.repeat(self.path[inner], 2) | (upper << (MAX_DEPTH - self.depth))
        self.member, self.price = np.repeat(self.member[inner], 2), np.repeat(self.price[inner], 2)
        self.depth += 1


def member_trees(
    start: Start,
    top: Top,
    levels: list[BoxLevel],
    prunings: Prunings,
    node_of: Int[np.ndarray, "goals lowest"],
    cut: Cut,
) -> list[MemberTree]:
    """The trees of some members."""
    walk = _Walk(len(cut.goal))
    for _ in range(start.splits):
        goal, node = cut.goal[walk.member], walk.node
        none = np.full(len(node), -1)
        axis = top.choice[cut.price[walk.member], goal, node].astype(np.int64)
        walk.descend(
            axis,
            start.child,
            (top.source[goal, node], none, none, start.cells.depth[node], start.cells.position[node]),
        )
    first = np.searchsorted(walk.member, np.arange(walk.num_members))
    rank = np.arange(len(walk.member)) - first[walk.member]
    walk.price = cut.price[walk.member] + (rank < cut.num_lower[walk.member])
    lowest = walk.node - start.first[start.splits]
    walk.node = node_of[cut.goal[walk.member], lowest]
    cells = start.lowest[lowest]
    for depth, level in enumerate(levels):
        if not len(walk.node):
            break
        node, some = walk.node, walk.node >= 0  # below the start all are
        axis, source = np.full(len(node), -1), np.full(len(node), -1)
        axis[some] = prunings.choice[depth][walk.price[some], node[some]]
        source[some] = level.boxes.views(node[some])
        if depth:
            cells = level.boxes.cells[node]
        at = np.where(some, depth, -1)
        walk.descend(axis, level.child, (source, at, node, cells.depth, cells.position))
    return _gathered(walk)


def _gathered(walk: _Walk) -> list[MemberTree]:
    """The leaves of each member in the order of its traversal."""
    member, path, source, depth, box, *place = (np.concatenate(column) for column in zip(*walk.leaves, strict=True))
    order = np.lexsort((path, member))
    bounds = np.searchsorted(member[order], np.arange(walk.num_members + 1))
    trees = []
    for number, levels in enumerate(walk.levels):
        some = order[bounds[number] : bounds[number + 1]]
        cells = Cells(place[0][some], place[1][some])
        trees.append(MemberTree(levels, cells, np.maximum(source[some], -1), depth[some], box[some]))
    return trees
