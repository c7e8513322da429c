"""The leaves of best trees of several members at once, walked down level by level."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.leaves.cone.boxes import PRICE, errors_and_shares_hidden, errors_of_options, pairs_of_boxes
from plr_jax.plr.leaves.cone.family.levels import BoxLevel, Prunings, Start, Top
from plr_jax.plr.partition.cells import MAX_DEPTH, Cells
from plr_jax.plr.partition.cells import Level as Splits
from plr_jax.plr.sampling.cell_fit import Pattern
from plr_jax.plr.sampling.cell_memory import distances_in_cells


@dataclass(frozen=True, eq=False)
class MemberTree:
    """The tree of one member: its levels, and its leaves in the order of its traversal.

    Attributes:
        levels: As a file stores them.
        cells: The leaves.
        source: Viewpoint of each leaf's source, -1 where nothing reaches the goal.
        depth: The family's level that each leaf is a box of; -1 of none, above the start or where nothing is.
        box: The box there.
    """

    levels: list[Splits]
    cells: Cells
    source: Int[np.ndarray, "leaves"]
    depth: Int[np.ndarray, "leaves"]
    box: Int[np.ndarray, "leaves"]


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
        source[some] = level.views(node[some])
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


# Sources in sight for the leaves of a family: what each box could have instead is asked once for all members.


@dataclass(frozen=True, eq=False)
class Options:
    """The sources that boxes of one level could have that do not all see their best one, box by box.

    Attributes:
        first: Where the options of each box of the level begin, and their number; of most boxes there are none.
        view: Viewpoint of the source.
        is_own: Whether it is the best one.
        by_all: Whether all of the box sees it.
        error: Mean error over the box, at samples.
        hidden: Share of the box from where a wall is in the way.
        largest: Proven largest error.
        integral: Proven integral of the error, as a share of the domain.
        area: Free area of the box.
    """

    first: Int[np.ndarray, "boxes_plus_one"]
    view: Int[np.ndarray, "options"]
    is_own: Bool[np.ndarray, "options"]
    by_all: Bool[np.ndarray, "options"]
    error: Float[np.ndarray, "options"]
    hidden: Float[np.ndarray, "options"]
    largest: Float[np.ndarray, "options"]
    integral: Float[np.ndarray, "options"]
    area: Float[np.ndarray, "options"]


def options_of_levels(levels: list[BoxLevel], trees: list[MemberTree], pattern: Pattern) -> list[Options]:
    """The options of all boxes that are leaves of some tree, level by level."""
    depth = np.concatenate([tree.depth for tree in trees])
    box = np.concatenate([tree.box for tree in trees])
    return [_options(level, np.unique(box[depth == i]), pattern) for i, level in enumerate(levels)]


def _options(level: BoxLevel, used: Int[np.ndarray, "used"], pattern: Pattern) -> Options:
    used = used[level.boxes.source[used] >= 0]
    boxes = level.boxes[used]
    box, source, by_all = pairs_of_boxes(boxes)
    is_doubted = np.ones(len(used), bool)
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    box, source, by_all = (column[is_doubted[box]] for column in (box, source, by_all))
    doubted = np.flatnonzero(is_doubted)
    some, place = boxes[doubted], np.searchsorted(doubted, box)
    x = some.cells.points(pattern.u, boxes.domain)
    distance = distances_in_cells(some.visible, x)
    error, hidden = errors_and_shares_hidden(some, pattern, x, distance, place, source)
    largest, integral = errors_of_options(some.visible, place, source)
    area = np.bincount(some.visible.cell, areas(some.visible.pieces), len(doubted)).astype(np.float64)
    first = np.searchsorted(used[box], np.arange(len(level.key) + 1))
    view, is_own = level.views_of(source), source == boxes.source[box]
    return Options(first, view, is_own, by_all, error, hidden, largest, integral, area[place])


def changes_of_tree(
    tree: MemberTree, levels: list[BoxLevel], options: list[Options]
) -> tuple[Int[np.ndarray, "changes"], Int[np.ndarray, "changes"]]:
    """Leaves that are better off with another source, and which; those that gain most, over all their area, first.

    As of a PLR that is built alone: no leaf's proven error rises above the largest of all.
    """
    leaf, columns = [], []
    total = largest = negligible = 0.0
    for depth, (level, of_level) in enumerate(zip(levels, options, strict=True)):
        here = np.flatnonzero(tree.depth == depth)
        box = tree.box[here]
        total += float(level.boxes.integral[box].sum())
        largest, negligible = max(largest, float(level.boxes.error[box].max(initial=0.0))), level.boxes.negligible
        row, run = run_members(of_level.first, box)
        leaf.append(here[run])
        names = ("view", "is_own", "by_all", "error", "hidden", "largest", "integral", "area")
        columns.append(np.stack([getattr(of_level, name)[row].astype(np.float64) for name in names]))
    which = np.concatenate(leaf)
    view, is_own, by_all, error, hidden, most, integral, area = np.concatenate(columns, axis=1)
    if not len(which):
        return which, which
    cost = error + PRICE * total * hidden
    is_barred = (is_own == 0) & (most > max(largest, negligible))
    order = np.lexsort((view, integral, is_own == 0, by_all == 0, cost, is_barred, which))
    best = order[np.append(True, which[order[1:]] != which[order[:-1]])]
    own_cost = np.zeros(len(tree.source))
    own_cost[which[is_own > 0]] = cost[is_own > 0]
    gain = (own_cost[which[best]] - cost[best]) * area[best]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[is_own[best] == 0]
    return which[best], view[best].astype(np.int64)
