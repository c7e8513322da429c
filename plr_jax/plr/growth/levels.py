"""Boxes of a domain, level by level of the number of splits.

Every box that a tree may hold is looked at once, whichever splits lead to it, unless its cost is below some prices.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax.plr.growth.limits import Limits, check_memory
from plr_jax.plr.partition.cells import Cells

MAX_ASPECT_BITS = 2  # the longest side of a box is at most 2**2 times its shortest, in fractions of the domain
LEAST_SHARE, LEAST_SHARE_PROVEN = 0.01, 0.05  # of a leaf's average share, that every box has besides its own
AT_ONCE = 1 << 14  # boxes
UNKNOWN, POOR = -1, -2


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
                level.child[axis, :, parent[which]] = POOR
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
