"""Grow trees of cone leaves with small proven errors, for many goals of one workspace at once.

1. Cut the domain into equal boxes, far fewer than the expected leaves.
2. Halve all boxes whose proven error exceeds a threshold. Each goal has its own threshold, which falls until the
   goal's file exceeds its limits (``_Search``).
3. Sort each goal's splits by falling error. The goal's tree has the first of these splits, as many as the limits
   allow (``_GoalTree``).

The boxes of all goals are processed together, since NumPy is slow for short arrays. The tree of a goal does not
depend on the other goals.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import CellSources, FamilyFn
from plr_jax.geometry.box import Box
from plr_jax.plr.best_partition import MAX_ASPECT_BITS
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.cone.codec import ConeFiles, StoredCones
from plr_jax.plr.leaves.cone.search import ConeBoxes, boxes_of_levels, fit_boxes, query_resolution
from plr_jax.plr.tree import MAX_DEPTH, Cells, Rows, Tree, tree_of_axes

_LEAVES_A_BOX = 16  # least number of expected leaves for each of the equal boxes of step 1
_LEAVES_AT_ONCE = 1 << 15  # expected leaves of all goals that are processed together
_BOXES_AT_ONCE = 1 << 12  # boxes halved together, so that their arrays stay in a core's cache
_MOST_TRIED = 2  # sources to try for a box; more take longer, and errors hardly fall
# Step 2: thresholds of a goal.
_FIRST_DROP = 0.3  # first threshold / largest error of the equal boxes
_RATE = 2.0  # the threshold is taken to be proportional to leaves**-rate
_GROWTH = 2.0  # the next tree should have this many times as many leaves, ...
_BEYOND = 1.03  # ... but not exceed the limits by more than this factor
# Step 3: the search for the largest tree.
_ATTEMPTS = 8  # most trees to try
_FULL = 0.99  # used share of the limits at which a tree is large enough


@dataclass(frozen=True, eq=False)
class _Nodes(Rows):
    """Table of the nodes of several goals' trees; each field has one entry per node.

    A node is a box: one of the equal boxes into which the domain is cut first, or half of another node.
    """

    goal: Int[np.ndarray, " nodes"]
    parent: Int[np.ndarray, " nodes"]  # number of the node of which this one is a half; -1 for the boxes of step 1
    level: Int[np.ndarray, " nodes"]  # number of halvings of the domain
    # A bit for each halving, 1 for the upper half; the halving of a node of level l has bit MAX_DEPTH - l. So the
    # paths of a tree's leaves ascend from left to right.
    path: Int[np.ndarray, " nodes"]
    key: Float[np.ndarray, " nodes"]  # proven error, at most the parent's key; 0 if the node may not be halved
    axis: Int[np.ndarray, " nodes"]  # along which the node is halved; -1 before that
    source: Int[np.ndarray, " nodes"]  # apex of the node's cone, an index in the goal's sources; -1 without a path


class _GoalTree:
    """The nodes of one goal's tree, with its splits sorted by falling key (proven error).

    For any ``n``, the first ``n`` splits make a tree: no split comes before the split of its parent node. The reason
    is that no key is larger than the parent's key, and among equal keys, parents come first.
    """

    def __init__(self, nodes: _Nodes, goal: int, files: ConeFiles, limits: Limits) -> None:
        self.number = np.flatnonzero(nodes.goal == goal)  # of the goal's nodes among all nodes, ascending
        self.nodes, self._files, self._limits = nodes[self.number], files, limits
        splits = np.flatnonzero(self.nodes.axis >= 0)
        self.num_splits = len(splits)
        # With the first n splits, a node exists if made_by < n, and is a leaf if also n <= split_rank.
        # split_rank: place of the node's split in the order of keys; for a node without one, larger than any n.
        # made_by: split_rank of the parent; -1 for the boxes of step 1, which always exist.
        self._split_rank = np.full(len(self.number), len(self.number))
        self._split_rank[splits[np.argsort(-self.nodes.key[splits], kind="stable")]] = np.arange(len(splits))
        parent = np.searchsorted(self.number, self.nodes.parent)
        self._made_by = np.where(self.nodes.parent < 0, -1, self._split_rank[parent])

    def leaves(self, num_splits: int) -> Int[np.ndarray, "leaves"]:
        """Return the leaves of the tree that has only the first ``num_splits`` splits.

        Splits are sorted by falling key (proven error). Leaves are indices of ``nodes``, from left to right.
        """
        leaf = np.flatnonzero((self._split_rank >= num_splits) & (self._made_by < num_splits))
        return leaf[np.argsort(self.nodes.path[leaf])]

    def used_share(self, num_splits: int) -> float:
        """Return the used share of the limits for the tree that has only the first ``num_splits`` splits.

        The share is number of leaves / ``max_leaves`` or file size / ``max_bytes``, whichever is larger. It is above
        1 if the tree exceeds the limits.
        """
        source, limits = self.nodes.source[self.leaves(num_splits)], self._limits
        num_bytes = self._files.num_bytes(source, limits) if np.isfinite(limits.max_bytes) else 0
        return max(len(source) / limits.max_leaves, num_bytes / limits.max_bytes)

    def tree(self, num_splits: int, axes_above: list[int]) -> Tree:
        """Return the complete tree: the equal cut of the domain, then the first ``num_splits`` splits.

        The equal cut halves the domain along ``axes_above[0]``, then all halves along ``axes_above[1]``, and so on.
        Splits are sorted by falling key (proven error).
        """
        axis = np.where(self._split_rank < num_splits, self.nodes.axis, -1)
        order = np.lexsort((self.nodes.path, self.nodes.level))  # level by level, from left to right
        order = order[self._made_by[order] < num_splits]
        ends = np.flatnonzero(np.diff(self.nodes.level[order])) + 1
        above = [np.full(1 << level, axis) for level, axis in enumerate(axes_above)]
        return tree_of_axes([*above, *np.split(axis[order], ends)], 2)


class _Search:
    """State of the search for one goal's error threshold, and for its largest tree within the limits."""

    def __init__(self, files: ConeFiles, largest_error: float) -> None:
        self.files = files
        self.threshold = _FIRST_DROP * largest_error
        self._fits, self._share_of_fits = 0, 0.0  # number of splits of the last tree within the limits; used share

    def num_splits(self, tree: _GoalTree) -> int | None:
        """Return the number of splits of the goal's final tree, or None if the search must go on.

        The search goes on if ``tree`` with all its splits is within the limits and some nodes may still be halved.
        Then the attribute ``threshold``, the error above which nodes are halved, is lowered. Else the final tree is
        the largest tree within the limits, or nearly the largest.
        """
        beyond, share_of_beyond = tree.num_splits, tree.used_share(tree.num_splits)
        if share_of_beyond <= 1:
            # Nodes that may still be halved have positive keys (proven errors).
            if not (largest_key := tree.nodes.key[tree.nodes.axis < 0].max(initial=0.0)):
                return beyond
            self._fits, self._share_of_fits = beyond, share_of_beyond
            growth = min(_GROWTH, _BEYOND / share_of_beyond)  # wanted number of leaves / number of leaves now
            self.threshold = min(self.threshold, largest_key) * growth**-_RATE
            return None
        # False position: the used share counts as linear between a number of splits that fits and one beyond.
        fits, share_of_fits = self._fits, self._share_of_fits
        for _ in range(_ATTEMPTS):
            if beyond - fits <= 1 or share_of_fits > _FULL:
                break
            aim = np.clip(((1 + _FULL) / 2 - share_of_fits) / (share_of_beyond - share_of_fits), 0.1, 0.9)
            middle = min(max(fits + int(aim * (beyond - fits)), fits + 1), beyond - 1)
            if (share := tree.used_share(middle)) <= 1:
                fits, share_of_fits = middle, share
            else:
                beyond, share_of_beyond = middle, share
        return fits


class WorstFirst(NamedTuple):
    """A function that builds trees of cone leaves with small proven errors, for several goals of one workspace."""

    domain: Box
    limits: Limits
    num_leaves: float  # rough number of leaves that the limits allow

    @property
    def goals_at_once(self) -> int:
        return max(1, int(_LEAVES_AT_ONCE / self.num_leaves))

    def __call__(self, oracles: Sequence[FamilyFn]) -> tuple[list[tuple[Tree, StoredCones] | None], CellSources]:
        """Return the tree and the stored cones of each goal, and the *sources* of all leaves.

        ``oracles`` has one distance function per goal; all are of one workspace. The sources of a leaf are the
        corners (or the goal) to which shortest paths from the leaf may go first. They are listed for the leaves of
        the first goal, then of the second goal, and so on.

        In two cases, a goal gets None instead of a tree and cones. Either no path leads to the goal. Or the limits
        are too narrow for the equal boxes into which the domain is cut first.
        """
        # 1. Cut the domain into equal boxes, along x and y in turn. Each box is a node of each goal's tree. Sources
        # of all goals are numbered one goal after the other, `num_sources` for each goal.
        limits = self.limits
        cells, axes = Cells.root(2), []
        most_axes = min(limits.max_depth, 2 * limits.max_axis_depth)
        while 2 ** len(axes) * _LEAVES_A_BOX <= self.num_leaves and len(axes) < most_axes:
            axes.append(len(axes) % 2)
            cells = cells.split(np.full(len(cells), axes[-1]))
        goal, box = (index.ravel() for index in np.indices((len(oracles), len(cells))))
        shared = oracles[0].shared_cells(*cells.grown_boxes(self.domain))
        visible = oracles[0].cells_of_members(shared, oracles, box, goal)
        distances = [visible.distance[goal[visible.cell] == i] for i in range(len(oracles))]
        negligible = np.array(list(map(query_resolution, distances)))
        num_sources = np.int64(len(oracles[0].sources.points))

        def nodes_of(boxes: ConeBoxes, goal: Any, parent: Any, path: Any, parent_key: Any) -> _Nodes:
            key = np.where(boxes.error > negligible[goal], np.minimum(boxes.error, parent_key), 0.0)
            source = np.where(boxes.source < 0, -1, boxes.source - goal * num_sources)
            return _Nodes(goal, parent, boxes.cells.depth.sum(axis=1), path, key, np.full(len(goal), -1), source)

        # The boxes of all nodes, in the order of the nodes.
        rounds = [fit_boxes(self.domain, 0.0, cells[box], visible, None, _MOST_TRIED)]
        nodes = nodes_of(rounds[0], goal, 0 * box - 1, box << (MAX_DEPTH + 1 - len(axes)), np.inf)
        largest_error = nodes.key.reshape(len(oracles), -1).max(axis=1)
        searches = {}
        for i, oracle in enumerate(oracles):
            if len(distances[i]):  # else no path leads to the goal
                searches[i] = _Search(ConeFiles(oracle.sources, self.domain), float(largest_error[i]))
        trees: list[tuple[Tree, StoredCones] | None] = [None] * len(oracles)
        leaves = [np.zeros(0, np.int64)] * len(oracles)
        while searches:
            # 2. Halve the boxes whose errors exceed the thresholds, and such halves of them in turn, until there are
            # none. A box that the limits do not allow to halve gets the key 0.
            threshold = np.full(len(oracles), np.inf)
            threshold[list(searches)] = [search.threshold for search in searches.values()]
            while len(worst := np.flatnonzero((nodes.axis < 0) & (nodes.key > threshold[nodes.goal]))):
                for batch in np.split(worst, range(_BOXES_AT_ONCE, len(worst), _BOXES_AT_ONCE)):
                    boxes = boxes_of_levels(rounds, batch)
                    nodes.axis[batch] = axis = _best_cuts(boxes, limits)
                    nodes.key[batch[axis < 0]] = 0.0
                    row = np.repeat(np.flatnonzero(axis >= 0), 2)  # in the batch, of each half's parent
                    parent, is_upper = batch[row], np.arange(len(row)) % 2 == 1
                    rounds.append(boxes.halves(row, axis[row], is_upper))
                    path = nodes.path[parent] + (is_upper.astype(np.int64) << (MAX_DEPTH - nodes.level[parent]))
                    nodes = nodes.append(nodes_of(rounds[-1], nodes.goal[parent], parent, path, nodes.key[parent]))
            # 3. Compare the trees with the limits: lower the threshold of a goal, or end its search.
            for i, search in list(searches.items()):
                tree = _GoalTree(nodes, i, search.files, limits)
                if (num_splits := search.num_splits(tree)) is not None:
                    del searches[i]
                    if num_splits or tree.used_share(0) <= 1:
                        leaf = tree.leaves(num_splits)
                        trees[i] = tree.tree(num_splits, axes), search.files.stored(tree.nodes.source[leaf])
                        leaves[i] = tree.number[leaf]
        return trees, boxes_of_levels(rounds, np.concatenate(leaves)).visible


def _best_cuts(boxes: ConeBoxes, limits: Limits) -> Int[np.ndarray, " boxes"]:
    """Return the axis along which to halve each box, so that the sum of the halves' largest errors is least.

    The axis is -1 if the limits allow no halving. Both halves are judged by the box's present cone. Errors are
    measured at the corners of the convex pieces of free space in the box.
    """
    # 1. Errors, by corner and piece: |min over the piece's sources s of (d[s] + |x - s|)  -  the box's cone at x|.
    visible, depth, sources = boxes.visible, boxes.cells.depth, boxes.visible.sources
    x, y = np.ascontiguousarray(visible.pieces.transpose(0, 2, 1))

    def path_lengths(x: Any, y: Any, source: Any) -> Any:
        dx, dy = x - sources.points[source, 0], y - sources.points[source, 1]
        return sources.distances[source] + np.sqrt(dx * dx + dy * dy)

    lengths = path_lengths(x[:, visible.piece], y[:, visible.piece], visible.source)
    distance = np.minimum.reduceat(lengths, visible.first_pair[:-1], axis=1)
    error = np.abs(distance - path_lengths(x, y, boxes.source[visible.cell]))
    # 2. A cut costs the largest error at corners on its lower side, plus that on its upper side.
    lo, hi = boxes.cells.boxes(boxes.domain)
    middle, cost = ((lo + hi) / 2)[visible.cell], np.zeros(depth.shape)
    for axis, along in enumerate((x, y)):
        for is_on_side in (along <= middle[:, axis], along >= middle[:, axis]):
            largest_of_piece = np.where(is_on_side, error, 0.0).max(axis=0)
            cost[:, axis] += np.maximum.reduceat(largest_of_piece, visible.first_piece[:-1])
    # 3. Some axes are closed: by the depth limits, or since the halves would be too narrow.
    is_closed = (depth >= limits.max_axis_depth) | (depth - depth.min(axis=1, keepdims=True) >= MAX_ASPECT_BITS)
    is_closed |= depth.sum(axis=1, keepdims=True) >= limits.max_depth
    return np.where(is_closed.all(axis=1), -1, np.argmin(np.where(is_closed, np.inf, cost), axis=1))
