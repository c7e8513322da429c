"""Boxes of a domain, level by level of the number of splits, and the best trees of them at a price a leaf.

Every box that a tree may hold is looked at once, whichever splits lead to it, unless its cost is below some prices.
Then the best tree follows from the smallest boxes up: a box is a leaf, or cheaper halved along one of the axes.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax.plr.growth.limits import Limits, check_memory
from plr_jax.plr.partition.cells import Cells

MAX_ASPECT_BITS = 2  # the longest side of a box is at most 2**2 times its shortest, in fractions of the domain
LEAST_SHARE, LEAST_SHARE_PROVEN = 0.01, 0.05  # of a leaf's average share, that every box has besides its own
AT_ONCE = 1 << 14  # boxes
_UNKNOWN, _POOR = -1, -2


@runtime_checkable
class Boxes(Protocol):
    """Boxes in the plane, and what leaves there would be like."""

    @property
    def cells(self) -> Cells:
        """The boxes."""
        ...

    @property
    def error(self) -> Float[np.ndarray, "boxes"]:
        """The largest error of each as a leaf, 0 if it does not matter."""
        ...

    @property
    def integral(self) -> Float[np.ndarray, "boxes"]:
        """The integral of each one's error over its share of the domain."""
        ...

    def append(self, *others: Any) -> Any:
        """These boxes followed by others."""
        ...

    def new_halves(
        self,
        parent: Int[np.ndarray, "halves"],
        axis: Int[np.ndarray, "halves"],
        is_upper: Bool[np.ndarray, "halves"],
        known: UInt64[np.ndarray, "known"],
    ) -> tuple[Any, UInt64[np.ndarray, "new"], UInt64[np.ndarray, "halves"]]:
        """Those halves of some of the boxes whose keys are not known yet, each once; their keys; and all keys."""
        ...


@dataclass(eq=False)
class BoxLevel:
    """The distinct boxes of one number of splits that were looked at.

    ``child`` is where the halves of each stand in the next level, along each axis; -1 where they were not looked at,
    -2 where they are not worth it.
    """

    boxes: Any
    key: UInt64[np.ndarray, "boxes"]
    child: Int[np.ndarray, "2 2 boxes"]

    @staticmethod
    def of(boxes: Boxes, key: UInt64[np.ndarray, "boxes"]) -> "BoxLevel":
        """That of boxes that were not halved yet."""
        return BoxLevel(boxes, key, np.full((2, 2, len(key)), _UNKNOWN))

    def costs(self, least_share: float) -> Float[np.ndarray, "boxes"]:
        """What each box adds to the error of a tree, its largest error a little."""
        return self.boxes.integral + least_share * self.boxes.error

    def append(self, boxes: Boxes, key: UInt64[np.ndarray, "new"]) -> None:
        """Add new boxes behind those that there are."""
        self.boxes = self.boxes.append(boxes)
        self.key = np.concatenate([self.key, key])
        self.child = np.concatenate([self.child, np.full((2, 2, len(key)), _UNKNOWN)], axis=2)


@dataclass(frozen=True, eq=False)
class Prunings:
    """The best tree below every box, for several prices of a leaf, level by level.

    Attributes:
        price: The prices, falling.
        total: What the best tree below each box costs, in errors and leaves, one array a level.
        count: Its number of leaves.
        choice: The axis along which it halves the box, -1 where the box is a leaf.
    """

    price: Float[np.ndarray, "prices"]
    total: list[Float[np.ndarray, "prices _"]]
    count: list[Int[np.ndarray, "prices _"]]
    choice: list[Int[np.ndarray, "prices _"]]


def expand(
    levels: list[BoxLevel],
    reached: Bool[np.ndarray, "start"],
    price: float,
    least_share: float,
    limits: Limits,
    gain: float = 1.0,
    margin: float = np.inf,
) -> bool:
    """Look at the halves of boxes below some that cost more than a price, and at theirs; whether there are more.

    Args:
        levels: All that was looked at; what is found is added.
        reached: Below which boxes of the first level to look.
        price: Of a leaf.
        least_share: How much a box's largest error counts besides its integral.
        limits: The limits.
        gain: How many prices a box must cost to be halved; below 1 no tree gains by it.
        margin: Times as much as along the other axis halves may cost to be looked at further; without, the best tree
            is the best of all.
    """
    below, is_open = reached, False
    for depth in range(limits.max_depth):
        if depth == len(levels):
            break
        level = levels[depth]
        if len(below) < len(level.key):
            below = np.append(below, np.zeros(len(level.key) - len(below), bool))
        cost = level.costs(least_share)
        halvable = _may_expand(level, limits) & below
        axis, parent = np.nonzero(halvable & (cost > gain * price))
        is_open |= bool((halvable & (cost > 0) & (cost <= gain * price)).any())
        if len(parent):
            _add_halves(levels, depth, np.repeat(parent, 2), np.repeat(axis, 2))
            if margin < np.inf:
                _drop_poor_axes(level, np.unique(parent), levels[depth + 1].costs(least_share), margin)
        if depth + 1 < len(levels):
            children = level.child[:, :, below]
            below = np.zeros(len(levels[depth + 1].key), bool)
            below[children[children >= 0]] = True
    check_memory(float(sum(len(level.key) for level in levels)))
    return is_open


def prune(
    levels: list[BoxLevel], price: Float[np.ndarray, "prices"], least_share: float, gain: float = 1.0
) -> Prunings:
    """The best tree below every box, for several prices a leaf; boxes that cost less than ``gain`` are not halved."""
    totals, counts, choices = [], [], []
    for level in reversed(levels):
        cost = level.costs(least_share)
        total = cost + price[:, None]
        count, choice = np.ones(total.shape, np.int32), np.full(total.shape, -1, np.int8)
        for axis in range(2):
            lower, upper = level.child[axis]
            halved = np.flatnonzero(lower >= 0)
            lower, upper = lower[halved], upper[halved]
            if not len(halved):
                continue
            both = totals[-1][:, lower] + totals[-1][:, upper]
            worth = cost[halved] > gain * price[:, None]  # of other boxes halves may be known, for other members
            at, box = np.nonzero((both < total[:, halved]) & worth)
            here = halved[box]
            total[at, here], choice[at, here] = both[at, box], axis
            count[at, here] = counts[-1][at, lower[box]] + counts[-1][at, upper[box]]
        totals.append(total)
        counts.append(count)
        choices.append(choice)
    return Prunings(price, totals[::-1], counts[::-1], choices[::-1])


def _drop_poor_axes(
    level: BoxLevel, parent: Int[np.ndarray, "parents"], cost: Float[np.ndarray, "next"], margin: float
) -> None:
    """Leave out, of boxes that were halved along both axes, halves that cost more than those along the other."""
    child = level.child[:, :, parent]
    halves = np.where((child >= 0).all(axis=1), cost[child].sum(axis=1), np.inf)
    axis, which = np.nonzero((halves > margin * halves[::-1]) & (halves < np.inf))
    level.child[axis, :, parent[which]] = _POOR


def _may_expand(level: BoxLevel, limits: Limits) -> Bool[np.ndarray, "2 boxes"]:
    """Along which axes boxes may be halved that were not yet."""
    depth = level.boxes.cells.depth.T
    shallow = (depth < limits.max_axis_depth) & (depth.sum(axis=0) < limits.max_depth)
    return shallow & (depth - depth.min(axis=0) < MAX_ASPECT_BITS) & (level.child[:, 0] == _UNKNOWN)


def _add_halves(
    levels: list[BoxLevel], depth: int, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"]
) -> None:
    """Both halves of boxes of one level along the given axes, those that are alike once."""
    level = levels[depth]
    is_upper = np.arange(len(parent)) % 2 == 1
    order = np.argsort(level.boxes.cells[parent].halves(axis, is_upper).hashes(), kind="stable")
    parent, axis, is_upper = parent[order], axis[order], is_upper[order]
    for begin in range(0, len(parent), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
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
