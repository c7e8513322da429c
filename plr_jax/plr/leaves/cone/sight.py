"""Choosing sources in sight: of those that serve a box about as well, one that most of it sees.

Who goes straight from a point to its leaf's source meets a wall where the source is out of sight. There the distance
is larger than the cone says, for if it were in sight, the way by it would be as short. So samples tell. What each box
could have instead is asked once for all trees that have it as a leaf.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.growth.levels import BoxLevel
from plr_jax.plr.growth.optimal import PricedTree
from plr_jax.plr.leaves.cone.boxes import ConeBoxes, errors_of_options, views_of
from plr_jax.plr.partition.cells import Cells, Level, levels_of
from plr_jax.plr.sampling.cell_fit import Pattern
from plr_jax.plr.sampling.cell_memory import distances_in_cells

_PRICE = 30.0
"""Error that counts as much as a way that meets a wall, in proven mean errors of all boxes."""
_LEAST_SHORTFALL = 1e-9
"""Widths of the domain by which a distance is above a cone for certain."""
_MOST_OPTIONS = 64
"""Sources of a box that are compared: of more, as of a large box among clutter, none is in sight of much of it."""
_KEY_BITS = 40  # for the place of a box in its level


@dataclass(frozen=True, eq=False)
class MemberTree:
    """The tree of one goal: its levels, and its leaves in the order of its traversal.

    Attributes:
        levels: As a file stores them.
        cells: The leaves.
        source: Viewpoint of each leaf's source, -1 where nothing reaches the goal.
        depth: The level of boxes that each leaf is one of.
        box: The box there.
    """

    levels: list[Level]
    cells: Cells
    source: Int[np.ndarray, "leaves"]
    depth: Int[np.ndarray, "leaves"]
    box: Int[np.ndarray, "leaves"]


def tree_of_leaves(levels: list[BoxLevel], tree: PricedTree, is_walked: bool) -> MemberTree:
    """A tree as its file holds it: as it was walked, or as a tree of its leaves is told from these alone."""
    parts = [(level.boxes, box) for level, box in zip(levels, tree.leaves, strict=False)]
    first, *others = (boxes.cells[box] for boxes, box in parts)
    cells = first.append(*others)
    splits, order = (tree.splits, tree.order) if is_walked else levels_of(cells)
    depth, box = np.repeat(np.arange(len(parts)), [len(box) for _, box in parts]), np.concatenate(tree.leaves)
    return MemberTree(splits, cells[order], views_of_leaves(levels, tree)[order], depth[order], box[order])


def views_of_leaves(levels: list[BoxLevel], tree: PricedTree) -> Int[np.ndarray, "leaves"]:
    """Viewpoints of the best sources of leaves, level by level; -1 where nothing reaches the goal."""
    source = np.concatenate([level.boxes.source[box] for level, box in zip(levels, tree.leaves, strict=False)])
    source[source >= 0] = views_of(levels[0].boxes.visible, source[source >= 0])
    return source


@dataclass(frozen=True, eq=False)
class Options:
    """Boxes that are leaves, and the sources that those could have that do not all see their best one, box by box.

    Attributes:
        key: Of each box: its level and its place there.
        boxes: The boxes.
        first: Where the options of each box begin, and their number; of most boxes there are none.
        view: Viewpoint of the source.
        is_own: Whether it is the best one.
        by_all: Whether all of the box sees it.
        error: Mean error over the box, at samples.
        hidden: Share of the box from where a wall is in the way.
        largest: Proven largest error.
        integral: Proven integral of the error, as a share of the domain.
        area: Free area of the box.
    """

    key: Int[np.ndarray, "boxes"]
    boxes: ConeBoxes
    first: Int[np.ndarray, "boxes_plus_one"]
    view: Int[np.ndarray, "options"]
    is_own: Bool[np.ndarray, "options"]
    by_all: Bool[np.ndarray, "options"]
    error: Float[np.ndarray, "options"]
    hidden: Float[np.ndarray, "options"]
    largest: Float[np.ndarray, "options"]
    integral: Float[np.ndarray, "options"]
    area: Float[np.ndarray, "options"]


def options_of_trees(levels: list[BoxLevel], trees: list[MemberTree], pattern: Pattern) -> Options:
    """The options of all boxes that are leaves of some tree."""
    key = np.unique(np.concatenate([_keys(tree) for tree in trees]))
    first, *others = (level.boxes[key[key >> _KEY_BITS == i] - (i << _KEY_BITS)] for i, level in enumerate(levels))
    boxes = first.append(*others)
    # Pairs of a box and a source that some point of it may use, box by box, and whether all of it sees it.
    visible, count = boxes.visible, len(boxes.visible.sources.points)
    pair, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(pair, count)
    by_all = np.bincount(index, visible.by_all, len(pair)) == np.diff(visible.first_piece)[box]
    is_doubted = np.diff(boxes.visible.first_piece) > 0
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    is_doubted &= np.bincount(box, minlength=len(key)) <= _MOST_OPTIONS
    box, source, by_all = (column[is_doubted[box]] for column in (box, source, by_all))
    doubted = np.flatnonzero(is_doubted)
    some, place = boxes[doubted], np.searchsorted(doubted, box)
    x = some.cells.points(pattern.u, boxes.domain)
    distance = distances_in_cells(some.visible, x)
    # Mean error of each source in its box, and the share of it from where a wall is in the way.
    sources, width = some.visible.sources, float(some.domain.width.max())
    weight = pattern.weight * np.isfinite(distance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), pattern.weight.min())
    cone = sources.distances[source, None] + np.linalg.norm(x[place] - sources.points[source, None], axis=2)
    above = np.where(np.isfinite(distance), distance, 0.0)[place] - cone
    is_hidden = above > _LEAST_SHORTFALL * width
    error, hidden = np.sum(weight[place] * np.abs(above), axis=1), np.sum(weight[place] * is_hidden, axis=1)
    largest, integral = errors_of_options(some.visible, place, source)
    area = np.bincount(some.visible.cell, areas(some.visible.pieces), len(doubted)).astype(np.float64)
    view, is_own = views_of(boxes.visible, source), source == boxes.source[box]
    first = np.searchsorted(box, np.arange(len(key) + 1))
    return Options(key, boxes, first, view, is_own, by_all, error, hidden, largest, integral, area[place])


def _keys(tree: MemberTree) -> Int[np.ndarray, "leaves"]:
    return (tree.depth << _KEY_BITS) + tree.box


def sources_in_sight(
    tree: MemberTree, options: Options, fits: Callable[[Int[np.ndarray, "leaves"]], bool]
) -> Int[np.ndarray, "leaves"]:
    """Viewpoints for the leaves of a tree, another one where a part does not see the best one and that is worth it.

    No leaf's proven error rises above the largest of all: what is proven of all of them holds as before. Of the
    changes, the most useful first, as many are made as fit.
    """
    leaf, view = _changes(tree, options)

    def changed(count: int) -> Int[np.ndarray, "leaves"]:
        views = tree.source.copy()
        views[leaf[:count]] = view[:count]
        return views

    if fits(changed(len(leaf))):
        return changed(len(leaf))
    return changed(bisect_left(range(1, len(leaf)), True, key=lambda count: not fits(changed(count))))


def _changes(tree: MemberTree, options: Options) -> tuple[Int[np.ndarray, "changes"], Int[np.ndarray, "changes"]]:
    """Leaves that are better off with another source, and which; those that gain most, over all their area, first."""
    boxes, box = options.boxes, np.searchsorted(options.key, _keys(tree))
    option, leaf = run_members(options.first, box)
    if not len(leaf):
        return leaf, leaf
    is_own = options.is_own[option]
    cost = options.error[option] + _PRICE * float(boxes.integral[box].sum()) * options.hidden[option]
    is_barred = ~is_own & (options.largest[option] > max(float(boxes.error[box].max()), boxes.negligible))
    order = np.lexsort(
        (options.view[option], options.integral[option], ~is_own, ~options.by_all[option], cost, is_barred, leaf)
    )
    best = order[np.append(True, leaf[order[1:]] != leaf[order[:-1]])]
    own_cost = np.zeros(len(tree.source))
    own_cost[leaf[is_own]] = cost[is_own]
    gain = (own_cost[leaf[best]] - cost[best]) * options.area[option[best]]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]
    return leaf[best], options.view[option[best]]
