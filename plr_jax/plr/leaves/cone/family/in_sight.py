"""Sources in sight for the leaves of a family: what each box could have instead is asked once for all members."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.leaves.cone.boxes import errors_of_options
from plr_jax.plr.leaves.cone.family.levels import BoxLevel
from plr_jax.plr.leaves.cone.family.trees import MemberTree
from plr_jax.plr.leaves.cone.sight import PRICE, errors_and_shares_hidden, pairs_of_boxes
from plr_jax.plr.sampling.cell_memory import distances_in_cells
from plr_jax.plr.sampling.pattern import Pattern


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
