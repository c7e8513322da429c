"""Find the partition into cone leaves with the least error whose file is within limits, such as a number of bytes.

A partition is a tree of boxes: a box is halved or is a leaf. A leaf costs its error plus a price. For a given price,
dynamic programming finds the tree of least cost, from the smallest boxes up to the domain. The search lowers the
price (the Lagrange multiplier of the limits), and computes more boxes, until the best tree exceeds the limits. Then
it finds, by interpolation, the lowest price at which the tree is within the limits. Reference: Donoho, "CART and
best-ortho-basis: a connection", Annals of Statistics 1997.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import batches, index_of
from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import Limits, check_memory
from plr_jax.plr.tree import leaf_order

# The longest side of a box is at most 2**MAX_ASPECT_BITS times its shortest, in fractions of the domain. Without a
# proof, a box whose largest error costs over _PEAKED of its integral may be longer, as only long boxes beside walls
# have small errors: at 8 KB, the largest falls from 7.0 to 0.9 cm on the map arena. Proven errors would be larger.
MAX_ASPECT_BITS = 2
_MAX_ASPECT_BITS_OF_PEAKS = 4
_PEAKED = 0.1
# Weight of a box's largest error (its peak) beside the integral of its error, in volumes of an average leaf.
PEAK_WEIGHT = 0.01
PEAK_WEIGHT_PROVEN = 0.05
# One more leaf is expected to divide a box's peak by this factor at most. Measured for certified cones: without this
# assumption, a quarter more boxes are computed for errors as small; with a factor of 2, some bounds are less narrow.
_MOST_DROP = 3.0
BOXES_PER_BATCH = 1 << 14
UNKNOWN = -1  # instead of the index of a half that is not computed yet


class BoxLevel:
    """The boxes computed so far on one level, that is, after a certain number of halvings of the domain.

    ``child[axis, half, i]`` is the index, in the next level, of the lower (0) or upper (1) half of box ``i``.
    """

    def __init__(self, boxes: Any) -> None:
        self.boxes = boxes  # boxes in the plane with the errors that they would have as leaves, such as ConeBoxes
        self.key = boxes.cells.hashes()  # of each box
        self.child = np.full((2, 2, len(self.key)), UNKNOWN)  # halves in the next level by axis, half and box

    def costs(self, weight: float) -> Float[np.ndarray, " boxes"]:
        """Return each box's cost as a leaf: the integral of its error plus ``weight`` times its largest error."""
        return self.boxes.integral + weight * self.boxes.peak

    def is_open(self, limits: Limits, weight: float) -> Bool[np.ndarray, "2 boxes"]:
        """Return, for each axis and box, whether the box may be halved along the axis but has not been so far.

        ``weight`` multiplies the largest error of a leaf in the leaf's cost. Without a proof, a box may become more
        slender if its largest error makes up a large part of this cost.
        """
        depth = self.boxes.cells.depth.T
        shallow = (depth < limits.max_axis_depth) & (depth.sum(axis=0) < limits.max_depth)
        is_peaked = (limits.proof is Proof.NONE) & (weight * self.boxes.peak > _PEAKED * self.boxes.integral)
        most = np.where(is_peaked, _MAX_ASPECT_BITS_OF_PEAKS, MAX_ASPECT_BITS)
        return shallow & (depth - depth.min(axis=0) < most) & (self.child[:, 0] == UNKNOWN)

    def append(self, boxes: Any) -> None:
        new = BoxLevel(boxes)
        self.boxes = self.boxes.append(boxes)
        self.key = np.append(self.key, new.key)
        self.child = np.append(self.child, new.child, axis=2)


class TreeCosts(NamedTuple):
    """For each box of a level, the least cost of a tree that has the box as its root.

    The cost of a tree is the sum of the costs of its leaves (:meth:`BoxLevel.costs`) plus a price per leaf.
    """

    best: Float[np.ndarray, " boxes"]  # of each box's best tree of computed boxes, possibly the box alone
    least: Float[np.ndarray, " boxes"]  # none of the box's trees is expected to cost less


def cost_if_halved(peak: Float[np.ndarray, " boxes"], price: float) -> Float[np.ndarray, " boxes"]:
    """Return, for each box, the least cost that is expected of a tree that halves the box.

    ``peak`` is each box's largest error, times the weight of this error in the cost of a leaf. ``price`` is added for
    each leaf.
    """
    # The integral of the error may vanish, and m >= 1 more leaves divide the peak by D**m at best, with D =
    # _MOST_DROP. So trees cost at least the least (1 + m) price + peak D**-m. Leaf m + 1 is worth its price if
    #   peak D**-m (1 - 1/D) > price,
    # so the best m is the logarithm of peak / price * (1 - 1/D) to the base D, rounded up.
    lowest = _MOST_DROP / (_MOST_DROP - 1)  # a peak of fewer prices is not worth another leaf
    more = np.ceil(np.log(np.maximum(peak / price / lowest, _MOST_DROP)) / np.log(_MOST_DROP))
    return (1 + more) * price + peak * _MOST_DROP**-more


def expand(levels: list[BoxLevel], price: float, weight: float, limits: Limits) -> None:
    """Halve all boxes that the tree of least cost might split, and add the halves to ``levels``.

    The cost of a tree is the sum over its leaves of: ``price``, the integral of the leaf's error, and ``weight``
    times the leaf's largest error.
    """
    # Branch and bound, first up and then down the levels. A box b, with `best` and `least` of `TreeCosts`, is halved
    # along all its open axes if
    #   least(b) < min(best(b), most(b)).
    # A tree of b that costs at least most(b) improves no tree that contains it. The root has no such limit. Along an
    # axis, the two halves of b share what b may cost:
    #   most(half) = max over all boxes b with this half of min(best(b), most(b)) - least(other half of b).
    # 1. Upward: costs of the boxes of every level. For a box b, over all axes along which its halves l, u are known:
    #   best(b)  = min(cost(b) + price, best(l) + best(u))
    #   least(b) = min(cost(b) + price, least(l) + least(u), and cost_if_halved(b) if b is open along an axis)
    costs: dict[int, TreeCosts] = {}

    def update_costs(depth: int) -> None:
        level, below = levels[depth], costs.get(depth + 1, TreeCosts(np.zeros(0), np.zeros(0)))
        best = level.costs(weight) + price
        halved = cost_if_halved(weight * level.boxes.peak, price)
        least = np.where(level.is_open(limits, weight).any(axis=0), np.minimum(best, halved), best)
        for lower, upper in level.child:
            known = np.flatnonzero(lower >= 0)
            for total, of_halves in ((best, below.best), (least, below.least)):
                total[known] = np.minimum(total[known], of_halves[lower[known]] + of_halves[upper[known]])
        costs[depth] = TreeCosts(best, least)

    for depth in reversed(range(len(levels))):
        update_costs(depth)
    # 2. Downward: halve boxes, then limit the costs of the next level.
    most = np.full(len(levels[0].key), np.inf)
    for depth, level in enumerate(levels):  # including the levels that are added meanwhile
        may_improve = np.minimum(costs[depth].best, most) > costs[depth].least
        axis, parent = np.nonzero(level.is_open(limits, weight) & may_improve)
        if len(parent):
            _add_halves(levels, depth, np.repeat(parent, 2), np.repeat(axis, 2))
            update_costs(depth + 1)
            update_costs(depth)
        if depth + 1 < len(levels):
            allowed = np.minimum(costs[depth].best, most)
            least_below = costs[depth + 1].least
            most = np.full(len(least_below), -np.inf)
            for lower, upper in level.child:
                known = np.flatnonzero(lower >= 0)
                for half, other in ((lower[known], upper[known]), (upper[known], lower[known])):
                    np.maximum.at(most, half, allowed[known] - least_below[other])
    check_memory(float(sum(len(level.key) for level in levels)))


Halves: TypeAlias = Int[np.ndarray, " halves"]


def _add_halves(levels: list[BoxLevel], depth: int, parent: Halves, axis: Halves) -> None:
    """Halve boxes ``parent`` of level ``depth`` along ``axis``, and enter the halves in ``child`` of this level.

    Halves that the next level lacks are added to that level. ``parent`` and ``axis`` have two adjacent equal entries
    for each halving: the first for the lower half, the second for the upper half.
    """
    level = levels[depth]
    if depth + 1 == len(levels):
        levels.append(BoxLevel(level.boxes[np.zeros(0, np.int64)]))
    below, is_upper = levels[depth + 1], np.arange(len(parent)) % 2 == 1
    # Two boxes may share a half: the upper half of a left half is the left half of an upper half. Compute the new
    # halves once, in the order of their hashes.
    of_half = level.boxes.cells[parent].halves(axis, is_upper).hashes()
    key, first_with_key = np.unique(of_half, return_index=True)
    for new in batches(first_with_key[~np.isin(key, below.key)], BOXES_PER_BATCH):
        below.append(level.boxes.halves(parent[new], axis[new], is_upper[new]))
    # Let the parents refer to their halves, which the next level now has.
    level.child[axis, is_upper.astype(int), parent] = index_of(below.key, of_half)


# How prices are chosen. A round multiplies the price by a factor from _LARGEST_DROP to _SMALLEST_DROP.
_LARGEST_DROP = 0.005
_SMALLEST_DROP = 0.7
_RATE_STEP = 8.0  # trees at two prices of this ratio show how the number of leaves depends on the price
_MUCH_ROOM = 8.0  # if the limits allow this many times more leaves, the price falls by the largest drop
_BEYOND = 1.15  # near the limits, the next tree should exceed them by this factor
_FIRST_RATE = 2.2  # guess: price ~ leaves**-2.2
_FIRST_FILL = 0.25  # the first price aims at this share of the limits, since the guess is rough
_UNLIMITED = 1e7  # this many leaves or more count as unlimited
_BITS_A_LEAF = 5.0  # estimated bits of one more leaf
_BITS_A_SOURCE = 56.0  # estimated bits of a source that a leaf needs
_ATTEMPTS = 12  # most prices to try between a tree that fits and a tree that is too large
_AIM = 0.9985  # share of the limits that such a price aims at
_FULL = 0.997  # the search stops at a tree that fills this share of the limits
_LAST = 1e-4  # factor of the price once no box is left to halve; not 0, so that the smaller of equal trees is chosen


@dataclass(frozen=True, eq=False)
class PricedTree:
    """The tree with the least sum of its leaves' costs and a ``price`` per leaf, stored level by level."""

    leaves: list[Int[np.ndarray, " _"]]  # indices of each level's boxes that are leaves
    axes: list[Int[np.ndarray, " _"]]  # split axis of each node; -1 for a leaf
    order: Int[np.ndarray, " leaves"]  # permutation of the leaves into the order of the tree's traversal
    price: float
    num_bytes: int = 0
    is_final: bool = False  # whether the search for a larger tree is over

    def __len__(self) -> int:
        return len(self.order)


def peak_weight(num_leaves: float, is_proven: bool) -> float:
    """Return the weight of a leaf's largest error in the leaf's cost; the integral of the error has the weight 1.

    The weight depends on the expected number of leaves of the tree, and on whether errors are proven.
    """
    return PEAK_WEIGHT_PROVEN / num_leaves if is_proven else PEAK_WEIGHT / float(np.sqrt(num_leaves))


class PriceSearch:
    """A search for the tree of least error whose file is within limits, such as a number of bytes.

    It finds trees of least error plus a price per leaf, and lowers the price. ``root`` is the whole domain as the
    only box, and ``levels`` has all boxes found so far. ``size(levels, tree)`` returns the bytes of a file.
    ``num_sources``, the number of possible apexes of cones, only affects the first price.
    """

    def __init__(self, root: Any, limits: Limits, size: Callable[..., int], num_sources: int = 0) -> None:
        self._limits, self._size, self._num_sources = limits, size, num_sources
        self.levels = [BoxLevel(root)]
        self._bits_a_leaf = _BITS_A_LEAF + limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)

    def first(self) -> PricedTree:
        """Return the tree whose only leaf is the root; raise :class:`BudgetTooSmall` if its file is too large."""
        tree = self._tree(float(self.levels[0].costs(1.0)[0]), 1.0)
        self._limits.require_room(tree.num_bytes)
        return replace(tree, is_final=self._is_finest(tree, 1.0))

    def next(self, now: PricedTree) -> PricedTree | None:
        """Return the best tree at a lower price per leaf than the tree ``now``; None if ``now`` ends the search.

        If the tree at the lower price exceeds the limits, return the largest tree found that is within the limits.
        """
        if now.is_final:
            return None
        price, weight = self._next_price(now)
        num_boxes = self._num_boxes()
        expand(self.levels, price, weight, self._limits)
        larger = self._tree(price, weight)
        if self._num_boxes() == num_boxes and self._is_finest(larger, weight):
            larger = replace(self._tree(_LAST * price, weight), is_final=True)
        return larger if self._fill(larger) <= 1 else self._largest(now, larger, weight)

    def _num_boxes(self) -> int:
        return sum(len(level.key) for level in self.levels)

    def _is_finest(self, tree: PricedTree, weight: float) -> bool:
        """Return whether no leaf of positive cost may still be halved, so that more boxes cannot improve the tree.

        ``weight`` multiplies the largest error of a leaf in the leaf's cost.
        """
        for level, boxes in zip(self.levels, tree.leaves, strict=False):
            if (level.is_open(self._limits, weight).any(axis=0) & (level.costs(weight) > 0))[boxes].any():
                return False
        return True

    def _next_price(self, now: PricedTree) -> tuple[float, float]:
        """Return a lower price, for a larger tree, and the weight of a leaf's largest error in the leaf's cost."""
        # 1. Estimate the largest number of leaves from the bytes that are left.
        bits = (self._limits.max_bytes - now.num_bytes) * 8
        is_crowded = len(now) == 1 and self._num_sources * _BITS_A_SOURCE > bits
        more = bits / (self._bits_a_leaf + _BITS_A_SOURCE * is_crowded)  # each new leaf brings its source
        most = float(min(self._limits.max_leaves, len(now) + more))
        weight = peak_weight(most if most < _UNLIMITED else len(now), self._limits.proof is not Proof.NONE)
        growth = most / len(now)  # by which factor the number of leaves may grow
        # 2. After the root, guess. Far from the limits, drop the price as far as possible.
        if len(now) == 1:
            growth = max(_FIRST_FILL * growth, 2.0)
            return now.price * (growth**-_FIRST_RATE if growth < _UNLIMITED else _LARGEST_DROP), weight
        before = len(self._best_tree(_RATE_STEP * now.price, weight))
        if before == len(now) or growth > _MUCH_ROOM:
            return _LARGEST_DROP * now.price, weight
        # 3. Assume leaves ~ price**-rate, with the rate between the last price and a higher one.
        rate = np.log(len(now) / before) / np.log(_RATE_STEP)
        drop = float(np.clip((_BEYOND * growth) ** (-1 / rate), _LARGEST_DROP, _SMALLEST_DROP))
        return drop * now.price, weight

    def _tree(self, price: float, weight: float) -> PricedTree:
        """Return the tree of least cost plus ``price`` per leaf; compute its file's size only if bytes are limited.

        ``weight`` multiplies the largest error of a leaf in the leaf's cost.
        """
        tree = self._best_tree(price, weight)
        return replace(tree, num_bytes=self._size(self.levels, tree) if np.isfinite(self._limits.max_bytes) else 0)

    def _fill(self, tree: PricedTree) -> float:
        """Return the share of the allowed leaves or bytes that a tree uses, whichever is larger; may exceed 1."""
        return max(len(tree) / self._limits.max_leaves, tree.num_bytes / self._limits.max_bytes)

    def _largest(self, fits: PricedTree, beyond: PricedTree, weight: float) -> PricedTree:
        """Try prices between the prices of two trees, and return the largest tree found that is within the limits.

        The tree ``fits`` is within the limits. The tree ``beyond``, at a lower price, exceeds the limits. ``weight``
        multiplies the largest error of a leaf in the leaf's cost.
        """
        # Regula falsi: between the prices of a tree that fits and of a tree that is too large, the logarithm of the
        # used share of the limits counts as linear in the logarithm of the price. Every fourth attempt bisects.
        for attempt in range(_ATTEMPTS):
            low, high = np.log(max(beyond.price, 1e-6 * fits.price)), np.log(fits.price)
            sizes = np.log([self._fill(fits), self._fill(beyond)])
            aim = (sizes[0] - np.log(_AIM)) / (sizes[0] - sizes[1]) if attempt % 4 < 3 else 0.5
            price = float(np.exp(high + np.clip(aim, 0.01, 0.99) * (low - high)))
            if self._fill(middle := self._tree(price, weight)) <= 1:
                fits = middle
            else:
                beyond = middle
            if self._fill(fits) > _FULL:
                break
        return replace(fits, is_final=True)

    def _best_tree(self, price: float, weight: float) -> PricedTree:
        """Return the tree, of boxes computed so far, with the least sum of its leaves' costs plus ``price`` per leaf.

        ``weight`` multiplies the largest error of a leaf in the leaf's cost.
        """
        # 1. Upward, by dynamic programming from the smallest boxes: the cost of a box is the least of its cost as a
        #    leaf, including the price, and for each axis the sum of the costs of its halves. `choice` is the best
        #    axis, or -1 for a leaf; of equal costs, a leaf and the first axis win. Unknown halves (-1) cost inf.
        choices, below = [], np.full(1, np.inf)
        for level in reversed(self.levels):
            halved = (below[lower] + below[upper] for lower, upper in level.child)
            options = np.stack([level.costs(weight) + price, *halved])
            choices.append(options.argmin(axis=0) - 1)
            below = np.append(options.min(axis=0), np.inf)
        # 2. Downward from the root, collect the tree's nodes and leaves.
        leaves, walked, nodes = [], [], np.zeros(1, np.int64)
        for level, choice in zip(self.levels, reversed(choices), strict=True):
            if not len(nodes):
                break
            axis = choice[nodes]
            is_inner = axis >= 0
            leaves.append(nodes[~is_inner])
            walked.append(axis)
            nodes = level.child[axis[is_inner], :, nodes[is_inner]].ravel()
        return PricedTree(leaves, walked, leaf_order(walked), price)
