"""The best dyadic partitions at a price a leaf, of all that there are.

Splitting best-first decides for an axis by what one split gains, and never takes it back. Here the best tree of all
boxes is found, whatever the splits that lead to them: from the smallest boxes up, a box is a leaf, or cheaper halved
along one of the axes. The price falls, and more boxes are looked at, until the best tree is beyond its limits; of the
prices in between, the lowest within them is taken.

Trees of several members, as of the goals of one workspace, are sought in turns: boxes that are alike for several are
looked at once, and what one finds does not depend on who else is there.

References:
    Donoho, "CART and best-ortho-basis: a connection", Annals of Statistics 1997.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import BudgetTooSmall, Limits, check_memory
from plr_jax.plr.tree import MAX_DEPTH, Cells

MAX_ASPECT_BITS = 2  # the longest side of a box is at most 2**2 times its shortest, in fractions of the domain
LEAST_SHARE, LEAST_SHARE_PROVEN = 0.01, 0.05  # of a leaf's average share, that every box has besides its own
BOXES_PER_BATCH = 1 << 14  # boxes
UNKNOWN, PRUNED = -1, -2


@dataclass(eq=False)
class BoxLevel:
    """The distinct boxes of one number of splits that were looked at.

    Attributes:
        boxes: Any in the plane, and what leaves there would be like: ``cells``; the largest ``error`` of each as a
            leaf, 0 if it does not matter; the ``integral`` of its error over its share of the domain;
            ``append(others)``; and ``new_halves(parent, axis, is_upper, known)``, those halves of some of the boxes
            whose keys are not known yet, each once, their keys, and all keys.
        key: By which boxes are told apart.
        child: Where the halves of each stand in the next level, along each axis; -1 where they were not looked at, -2
            where they are not worth it.
    """

    boxes: Any
    key: UInt64[np.ndarray, "boxes"]
    child: Int[np.ndarray, "2 2 boxes"]

    @staticmethod
    def of(boxes: Any, key: UInt64[np.ndarray, "boxes"]) -> "BoxLevel":
        """That of boxes that were not halved yet."""
        return BoxLevel(boxes, key, np.full((2, 2, len(key)), UNKNOWN))

    def costs(self, least_share: float) -> Float[np.ndarray, "boxes"]:
        """What each box adds to the error of a tree, its largest error a little."""
        return self.boxes.integral + least_share * self.boxes.error

    def append(self, boxes: Any, key: UInt64[np.ndarray, "new"]) -> None:
        """Add new boxes behind those that there are."""
        self.boxes = self.boxes.append(boxes)
        self.key = np.concatenate([self.key, key])
        self.child = np.concatenate([self.child, np.full((2, 2, len(key)), UNKNOWN)], axis=2)


def expand(
    levels: list[BoxLevel],
    price: Float[np.ndarray, "first"],
    least_share: float,
    limits: Limits,
    margin: float = np.inf,
    share: float = 0.0,
) -> None:
    """Look at the halves of boxes that cost more than a price, and at theirs.

    Args:
        levels: All that was looked at; what is found is added.
        price: Of a leaf, for each box of the first level, below which all have the least that leads to them; ``inf``
            where nothing is to be looked at.
        least_share: How much a box's largest error counts besides its integral.
        limits: The limits.
        margin: Times as much as along the other axis halves may cost to be looked at further; without, the best tree
            is the best of all.
        share: How much largest errors count in that, whoever asks.
    """
    for depth in range(limits.max_depth):
        if depth == len(levels):
            break
        level = levels[depth]
        is_new = may_halve(level.boxes.cells, limits) & (level.child[:, 0] == UNKNOWN)
        axis, parent = np.nonzero(is_new & (level.costs(least_share) > price))
        if len(parent):
            _add_halves(levels, depth, np.repeat(parent, 2), np.repeat(axis, 2))
            if margin < np.inf:
                # Of boxes that were halved along both axes, those halves are left out that are the poorer by far.
                parent = np.unique(parent)
                child, cost = level.child[:, :, parent], levels[depth + 1].costs(share)
                halves = np.where((child >= 0).all(axis=1), cost[child].sum(axis=1), np.inf)
                axis, which = np.nonzero((halves > margin * halves[::-1]) & (halves < np.inf))
                level.child[axis, :, parent[which]] = PRUNED
        if depth + 1 < len(levels):
            box, halves = np.flatnonzero(price < np.inf), np.full(len(levels[depth + 1].key), np.inf)
            for child in level.child[:, :, box].reshape(4, -1):
                np.minimum.at(halves, child[child >= 0], price[box[child >= 0]])
            price = halves
    check_memory(float(sum(len(level.key) for level in levels)))


def may_halve(cells: Cells, limits: Limits) -> Bool[np.ndarray, "2 boxes"]:
    """Along which axes boxes may be halved."""
    depth = cells.depth.T
    shallow = (depth < limits.max_axis_depth) & (depth.sum(axis=0) < limits.max_depth)
    return shallow & (depth - depth.min(axis=0) < MAX_ASPECT_BITS)


def _add_halves(
    levels: list[BoxLevel], depth: int, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"]
) -> None:
    """Both halves of boxes of one level along the given axes, those that are alike once."""
    level = levels[depth]
    is_upper = np.arange(len(parent)) % 2 == 1
    order = np.argsort(level.boxes.cells[parent].halves(axis, is_upper).hashes(), kind="stable")
    parent, axis, is_upper = parent[order], axis[order], is_upper[order]
    for begin in range(0, len(parent), BOXES_PER_BATCH):
        some = slice(begin, begin + BOXES_PER_BATCH)
        known = levels[depth + 1].key if depth + 1 < len(levels) else np.zeros(0, np.uint64)
        boxes, key, of_half = level.boxes.new_halves(parent[some], axis[some], is_upper[some], known)
        if not len(known):
            levels.append(BoxLevel.of(boxes, key))
        elif len(key):
            levels[depth + 1].append(boxes, key)
        keys = levels[depth + 1].key
        by_key = np.argsort(keys)
        place = by_key[np.searchsorted(keys, of_half, sorter=by_key)]
        level.child[axis[some], is_upper[some].astype(int), parent[some]] = place


_LARGEST_DROP, _SMALLEST_DROP = 0.005, 0.7  # to what share of the price before it may fall, and falls at the least
_RATE_STEP = 8.0  # times the price, to see how it falls as leaves get more
_MUCH_ROOM = 8.0  # times as large a tree may be yet, far from the limits
_BEYOND = 1.15  # times as large as they allow a tree should be, near them
_FIRST_RATE, _UNLIMITED = 2.2, 1e7  # a price falls about as the leaves to this power, if there is an end to them
_FIRST_SHARE = 0.25  # of what the limits allow, that the first tree should take: the power is but a guess yet
_BITS_A_LEAF, _BITS_A_SOURCE = 5.0, 56.0  # about as many as one more takes, and what it is the first to name
_HIGH = 1e300  # a price at which no box is halved that may be a leaf
_LAST = 1e-12  # of the last price, once all boxes were looked at: of trees that are as good, the smallest is taken

Leaves: TypeAlias = list[Int[np.ndarray, "_"]]
"""Which boxes of each of the first levels are leaves."""


class SearchPruning(NamedTuple):
    """What a search leaves out for its speed.

    Attributes:
        margin: Times as much as along the other axis halves may cost to be looked at further.
        attempts: To find a price with which a tree is full.
        full: The share of what the limits allow with which it is.
        keeps_split_order: Whether a file holds a tree as it was found; else as :func:`tree_of` has it, which takes longer.
    """

    margin: float = np.inf
    attempts: int = 12
    full: float = 0.997
    keeps_split_order: bool = False


EXACT = SearchPruning()


@dataclass(frozen=True, eq=False)
class PricedTree:
    """A member's best tree at a price a leaf.

    Attributes:
        leaves: Which boxes of each level are leaves.
        axes: The axis along which each node is split, level by level; -1 for a leaf.
        order: The leaves, which stand level by level, in the order of the tree's traversal.
        price: The price.
        num_bytes: Of the file.
        is_final: Whether the search is over.
    """

    leaves: Leaves
    axes: list[Int[np.ndarray, "_"]]
    order: Int[np.ndarray, "leaves"]
    price: float
    num_bytes: int = 0
    is_final: bool = False

    def __len__(self) -> int:
        return len(self.order)


@dataclass(frozen=True, eq=False)
class Forest:
    """A tree of each member; as long as they have leaves."""

    trees: list[PricedTree]

    def __len__(self) -> int:
        return sum(map(len, self.trees))


class MemberBoxes(NamedTuple):
    """The boxes of one level that a member looked at, and where their halves stand among its own of the next."""

    box: Int[np.ndarray, "own"]
    child: Int[np.ndarray, "2 2 own"]


class PriceSearch:
    """The search of the largest best trees within the limits.

    Args:
        levels: Boxes to start with, to which those that are looked at are added.
        roots: The box of the first level that each member starts at.
        limits: The limits of each.
        size: Gives the bytes of the file of a member's tree.
        num_sources: How many sources leaves may name; a file holds those that they do. Going by them the search goes
            less far beyond its limits.
        pruning: What it leaves out.
    """

    def __init__(
        self,
        levels: list[BoxLevel],
        roots: Int[np.ndarray, "members"],
        limits: Limits,
        size: Callable[[int, PricedTree], int],
        num_sources: int = 0,
        pruning: SearchPruning = EXACT,
    ) -> None:
        self.levels, self._roots, self._limits, self._size = levels, roots, limits, size
        self._num_sources, self._pruning = num_sources, pruning
        self._least = LEAST_SHARE if limits.proof is Proof.NONE else LEAST_SHARE_PROVEN
        self._bits_a_leaf = _BITS_A_LEAF + limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
        self._own: list[list[MemberBoxes]] = [[]] * len(roots)

    def first(self) -> Forest:
        """The smallest trees.

        Raises:
            BudgetTooSmall: If the budget of bytes is too small for one of them.
        """
        trees = []
        for member in range(len(self._roots)):
            self._select_boxes(member, _HIGH, 1.0)
            tree = self._tree(member, _HIGH, 1.0)
            if tree.num_bytes > self._limits.max_bytes:
                what = "one leaf" if len(tree) == 1 else f"a tree of {len(tree)} leaves"
                raise BudgetTooSmall(self._limits.max_bytes, tree.num_bytes, what)
            boxes = [(level.boxes, box) for level, box in zip(self.levels, tree.leaves, strict=False)]
            cost = sum(float(np.sum(each.integral[box] + each.error[box] / len(tree))) for each, box in boxes)
            trees.append(replace(tree, price=cost / len(tree)))
        return Forest(trees)

    def next(self, now: Forest) -> Forest | None:
        """Larger trees, after more boxes were looked at; None if there are none."""
        trees = list(now.trees)
        aims = {i: self._next_price(i, tree) for i, tree in enumerate(trees) if not tree.is_final}
        if not aims:
            return None
        limits, price = self._limits, np.full(len(self.levels[0].key), np.inf)
        for member, (of_member, _) in aims.items():
            price[self._roots[member]] = min(price[self._roots[member]], of_member)
        # One look serves all: a member uses no box that it would not have looked at alone.
        least_share = max(share for _, share in aims.values())
        share = self._least / min(limits.max_leaves, limits.max_bytes * 8 / self._bits_a_leaf)
        expand(self.levels, price, least_share, limits, self._pruning.margin, share)
        for member, (of_member, least_share) in aims.items():
            is_final = self._select_boxes(member, of_member, least_share)
            larger = self._tree(member, _LAST * of_member if is_final else of_member, least_share, is_final)
            trees[member] = (
                larger if self._share(larger) <= 1 else self._largest(member, trees[member], larger, least_share)
            )
        return Forest(trees)

    def _next_price(self, member: int, now: PricedTree) -> tuple[float, float]:
        """The price at which a tree is expected to be a little beyond the limits, or a good deal larger than now.

        With it comes how much of a box's largest error counts.
        """
        # How many leaves the limits may allow, going by the bytes that a tree leaves.
        bits = (self._limits.max_bytes - now.num_bytes) * 8
        is_crowded = len(now) == 1 and self._num_sources * _BITS_A_SOURCE > bits
        more = bits / (self._bits_a_leaf + _BITS_A_SOURCE * is_crowded)  # then each leaf brings a source along
        most = float(min(self._limits.max_leaves, len(now) + more))
        least_share, room = self._least / (most if most < _UNLIMITED else len(now)), most / len(now)
        if len(now) == 1:
            room = max(_FIRST_SHARE * room, 2.0)
            return now.price * (room**-_FIRST_RATE if room < _UNLIMITED else _LARGEST_DROP), least_share
        before = len(self._best_tree(member, _RATE_STEP * now.price, least_share))
        if before == len(now) or room > _MUCH_ROOM:
            return _LARGEST_DROP * now.price, least_share
        rate = np.log(len(now) / before) / np.log(_RATE_STEP)
        drop = float(np.clip((_BEYOND * room) ** (-1 / rate), _LARGEST_DROP, _SMALLEST_DROP))
        return drop * now.price, least_share

    def _tree(self, member: int, price: float, least_share: float, is_final: bool = False) -> PricedTree:
        """The best tree of what was looked at."""
        tree = self._best_tree(member, price, least_share)
        num_bytes = self._size(member, tree) if np.isfinite(self._limits.max_bytes) else 0
        return replace(tree, num_bytes=num_bytes, is_final=is_final)

    def _share(self, tree: PricedTree) -> float:
        """Of what the limits allow, how much a tree takes."""
        return max(len(tree) / self._limits.max_leaves, tree.num_bytes / self._limits.max_bytes)

    def _largest(self, member: int, fits: PricedTree, beyond: PricedTree, least_share: float) -> PricedTree:
        """The largest tree that fits, of prices between one that does and one that does not."""
        largest = fits
        for attempt in range(self._pruning.attempts):
            low, high = np.log(max(beyond.price, 1e-6 * fits.price)), np.log(fits.price)
            sizes = np.log([self._share(fits), self._share(beyond)])
            aim = sizes[0] / (sizes[0] - sizes[1]) if attempt % 2 == 0 else 0.5
            price = float(np.exp(high + np.clip(aim, 0.05, 0.95) * (low - high)))
            middle = self._tree(member, price, least_share)
            if self._share(middle) <= 1:
                fits = largest = middle
            else:
                beyond = middle
            if self._share(largest) > self._pruning.full:
                break
        return replace(largest, is_final=True)

    def _select_boxes(self, member: int, price: float, least_share: float) -> bool:
        """Note which boxes a member looks at, at a price of a leaf; whether these are all that matter."""
        here, own, is_all = self._roots[member : member + 1], [], True
        for depth, level in enumerate(self.levels):
            if not len(here):
                break
            cost = level.boxes.integral[here] + least_share * level.boxes.error[here]
            is_worth, child = cost > price, level.child[:, :, here]
            rest = np.flatnonzero(~is_worth & (cost > 0) & (cost < np.inf))
            is_all &= not (len(rest) and may_halve(level.boxes.cells[here[rest]], self._limits).any())
            child[:, :, ~is_worth & (cost < np.inf)] = UNKNOWN
            own.append(MemberBoxes(here, child))
            if depth + 1 < len(self.levels):
                is_own = np.zeros(len(self.levels[depth + 1].key), bool)
                known = child >= 0
                halves = child[known]
                is_own[halves] = True
                here = np.flatnonzero(is_own)
                place = np.empty(len(is_own), np.int64)
                place[here] = np.arange(len(here))
                child[known] = place[halves]
        self._own[member] = own
        return is_all

    def _best_tree(self, member: int, price: float, least_share: float) -> PricedTree:
        """The member's tree for which costs of leaves and their prices together are least."""
        own = self._own[member]
        axes = best_axes(self.levels, own, price, least_share)
        leaves, walked, paths, here, path = [], [], [], np.zeros(1, np.int64), np.zeros(1, np.int64)
        for depth, ((box, child), choice) in enumerate(zip(own, axes, strict=True)):
            if not len(here):
                break
            axis = choice[here]
            is_inner = axis >= 0
            leaves.append(box[here[~is_inner]])
            paths.append(path[~is_inner])
            walked.append(axis)
            here = child[axis[is_inner], :, here[is_inner]].ravel()
            path = (path[is_inner, None] + np.array([0, 1 << (MAX_DEPTH - depth)])).ravel()
        return PricedTree(leaves, walked, np.argsort(np.concatenate(paths)), price)


def best_axes(
    levels: list[BoxLevel], own: list[MemberBoxes], price: float, least_share: float
) -> list[Int[np.ndarray, "own"]]:
    """Along which axis each box is halved, -1 for none, so that costs of leaves and their prices are least."""
    choices, below = [], np.zeros(0)
    for level, (box, child) in zip(reversed(levels[: len(own)]), reversed(own), strict=True):
        total, choice = level.costs(least_share)[box] + price, np.full(len(box), -1)
        for axis, (lower, upper) in enumerate(child):
            halved = np.flatnonzero(lower >= 0)
            both = below[lower[halved]] + below[upper[halved]]
            cheaper = both < total[halved]
            halved = halved[cheaper]
            total[halved], choice[halved] = both[cheaper], axis
        below = total
        choices.append(choice)
    return choices[::-1]
