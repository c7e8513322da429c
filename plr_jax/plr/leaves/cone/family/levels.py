"""The boxes of a family, level by level of the number of splits: each looked at once for all that are alike."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._types import FamilyCellSources
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.limits import Limits, check_memory
from plr_jax.plr.growth.optimal import AT_ONCE, MAX_ASPECT_BITS
from plr_jax.plr.leaves.cone.boxes import ConeBoxes
from plr_jax.plr.partition.cells import Cells

# The cells at which a family starts, and the tree above them, which is the same for all members.
#
# Above the start every box has sources of its own for every goal, and hardly one is a leaf of a good tree but where
# one
# source serves all of it. So boxes are looked at from some number of splits on, and those above are leaves only where
# all of the boxes that they hold have no error and one source.


_MOST_SPLITS = 9
_LEAVES_A_START = 8.0
_ANY, NONE = -1, -2  # source of what does not reach the goal, and of what has several or an error


@dataclass(frozen=True, eq=False)
class Start:
    """All boxes of up to so many splits, in the order of their number of splits.

    Attributes:
        splits: How many splits those have that the family starts at.
        cells: The boxes, the whole first.
        first: Where those of each number of splits begin, and their number.
        child: The halves of each along each axis, -1 where there are none.
    """

    splits: int
    cells: Cells
    first: Int[np.ndarray, "splits_plus_two"]
    child: Int[np.ndarray, "2 2 boxes"]

    @staticmethod
    def of(num_leaves: float, max_axis_depth: int, max_depth: int) -> "Start":
        """That for PLRs of about so many leaves."""
        splits = int(np.clip(np.log2(max(num_leaves, 1.0) / _LEAVES_A_START), 0, min(_MOST_SPLITS, max_depth)))
        depths = [
            (i, n - i)
            for n in range(splits + 1)
            for i in range(n + 1)
            if abs(n - 2 * i) <= MAX_ASPECT_BITS and max(i, n - i) <= max_axis_depth
        ]
        begin = dict(zip(depths, np.cumsum([0] + [1 << sum(d) for d in depths]).tolist(), strict=False))
        parts, child = [], []
        for d in depths:
            x, y = (each.ravel() for each in np.indices((1 << d[0], 1 << d[1])))
            parts.append(Cells(np.tile(np.array(d), (len(x), 1)), np.stack([x, y], axis=1)))
            halves = np.full((2, 2, len(x)), -1)
            if (d[0] + 1, d[1]) in begin:
                halves[0] = begin[d[0] + 1, d[1]] + ((2 * x + np.arange(2)[:, None]) << d[1]) + y
            if (d[0], d[1] + 1) in begin:
                halves[1] = begin[d[0], d[1] + 1] + (x << (d[1] + 1)) + 2 * y + np.arange(2)[:, None]
            child.append(halves)
        cells = parts[0].append(*parts[1:])
        first = np.searchsorted(cells.depth.sum(axis=1), np.arange(splits + 2))
        return Start(splits, cells, first, np.concatenate(child, axis=2))

    @cached_property
    def lowest(self) -> Cells:
        """The boxes that the family starts at."""
        return self.cells[self.first[self.splits] :]

    def best(
        self,
        total: Float[np.ndarray, "prices goals lowest"],
        count: Int[np.ndarray, "prices goals lowest"],
        source: Int[np.ndarray, "goals lowest"],
        price: Float[np.ndarray, "prices"],
    ) -> "Top":
        """The best trees above the lowest boxes, of which the totals and leaves of the best trees there are given.

        ``source`` is that of boxes without an error, -1 of those that do not reach the goal, -2 of others.
        """
        shape = (len(price), len(source), len(self.cells))
        totals, counts, choice = np.full(shape, np.inf), np.ones(shape, np.int64), np.full(shape, -1, np.int8)
        sources = np.full(shape[1:], NONE)
        totals[:, :, self.first[self.splits] :], counts[:, :, self.first[self.splits] :] = total, count
        sources[:, self.first[self.splits] :] = source
        for splits in range(self.splits - 1, -1, -1):
            here = np.arange(self.first[splits], self.first[splits + 1])
            for axis in range(2):
                lower, upper = self.child[axis][:, here]
                some = lower >= 0
                at, lower, upper = here[some], lower[some], upper[some]
                both = totals[:, :, lower] + totals[:, :, upper]
                cheaper = both < totals[:, :, at]
                totals[:, :, at] = np.where(cheaper, both, totals[:, :, at])
                counts[:, :, at] = np.where(cheaper, counts[:, :, lower] + counts[:, :, upper], counts[:, :, at])
                choice[:, :, at] = np.where(cheaper, axis, choice[:, :, at])
                sources[:, at] = np.maximum(sources[:, at], _common(sources[:, lower], sources[:, upper]))
            alone = sources[:, here] != NONE
            for place in np.flatnonzero(alone.any(axis=0)):
                goal = np.flatnonzero(alone[:, place])
                totals[:, goal, here[place]] = price[:, None]
                counts[:, goal, here[place]], choice[:, goal, here[place]] = 1, -1
        return Top(totals, counts, choice, sources)


@dataclass(frozen=True, eq=False)
class Top:
    """The best trees of all boxes of a start, for several prices and goals.

    Attributes:
        total: What each costs, in errors and leaves.
        count: Its number of leaves.
        choice: The axis along which it halves the box, -1 where the box is a leaf.
        source: The source that serves all of the box without an error, whatever the price; -1 where nothing reaches
            the goal, and -2 where there is no such source.
    """

    total: Float[np.ndarray, "prices goals boxes"]
    count: Int[np.ndarray, "prices goals boxes"]
    choice: Int[np.ndarray, "prices goals boxes"]
    source: Int[np.ndarray, "goals boxes"]


def _common(lower: Int[np.ndarray, "goals boxes"], upper: Int[np.ndarray, "goals boxes"]) -> Int[np.ndarray, "..."]:
    """The source of two halves, if they have one."""
    alike: Bool[np.ndarray, "goals boxes"] = (lower == upper) | (np.minimum(lower, upper) == _ANY)
    return np.where(alike & (np.minimum(lower, upper) > NONE), np.maximum(lower, upper), NONE)


_UNKNOWN, _POOR = -1, -2
_MARGIN_PROVEN = 1.2
"""Times as much as along the other axis halves may cost to be looked at further, where largest errors count."""
_GAIN = 4.0
"""Prices that a box must cost to be halved: below, it seldom gains one."""


@dataclass(eq=False)
class BoxLevel:
    """The distinct boxes of one number of splits that were looked at.

    ``child`` is where the halves of each stand in the next level, along each axis; -1 where they were not looked at,
    -2 where they are not worth it.
    """

    boxes: ConeBoxes
    key: UInt64[np.ndarray, "boxes"]
    child: Int[np.ndarray, "2 2 boxes"]

    @staticmethod
    def of(boxes: ConeBoxes, key: UInt64[np.ndarray, "boxes"]) -> "BoxLevel":
        """That of boxes that were not halved yet."""
        return BoxLevel(boxes, key, np.full((2, 2, len(key)), _UNKNOWN))

    def costs(self, least_share: float) -> Float[np.ndarray, "boxes"]:
        """What each box adds to the error of a tree, its largest error a little."""
        return self.boxes.integral + least_share * self.boxes.error

    def views(self, box: Int[np.ndarray, "some"]) -> Int[np.ndarray, "some"]:
        """Viewpoint of the best source of each of some boxes, -1 where nothing reaches the goal."""
        source = self.boxes.source[box]
        view = np.full(len(box), -1)
        view[source >= 0] = self.views_of(source[source >= 0])
        return view

    def views_of(self, source: Int[np.ndarray, "some"]) -> Int[np.ndarray, "some"]:
        """Viewpoints of sources."""
        assert isinstance(self.boxes.visible, FamilyCellSources)
        return self.boxes.visible.views(source)

    def append(self, boxes: ConeBoxes, key: UInt64[np.ndarray, "new"]) -> None:
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
    levels: list[BoxLevel], reached: Bool[np.ndarray, "start"], price: float, least_share: float, limits: Limits
) -> bool:
    """Look at the halves of boxes below some that cost more than a price, and at theirs; whether there are more."""
    below, is_open = reached, False
    for depth in range(limits.max_depth):
        if depth == len(levels):
            break
        level = levels[depth]
        if len(below) < len(level.key):
            below = np.append(below, np.zeros(len(level.key) - len(below), bool))
        cost = level.costs(least_share)
        halvable = _may_expand(level, limits) & below
        axis, parent = np.nonzero(halvable & (cost > _GAIN * price))
        is_open |= bool((halvable & (cost > 0) & (cost <= _GAIN * price)).any())
        if len(parent):
            _add_halves(levels, depth, np.repeat(parent, 2), np.repeat(axis, 2))
            margin = 1.0 if limits.proof is Proof.NONE else _MARGIN_PROVEN
            _drop_poor_axes(level, np.unique(parent), levels[depth + 1].costs(least_share), margin)
        if depth + 1 < len(levels):
            children = level.child[:, :, below]
            below = np.zeros(len(levels[depth + 1].key), bool)
            below[children[children >= 0]] = True
    check_memory(float(sum(len(level.key) for level in levels)))
    return is_open


def prune(levels: list[BoxLevel], price: Float[np.ndarray, "prices"], least_share: float) -> Prunings:
    """The best tree below every box, for several prices a leaf."""
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
            worth = cost[halved] > _GAIN * price[:, None]  # of other boxes halves may be known, for other members
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
        boxes, key, index = level.boxes.distinct_halves(parent[some], axis[some], is_upper[some])
        place = _places(levels, depth + 1, boxes, key)
        level.child[axis[some], is_upper[some].astype(int), parent[some]] = place[index]


def _places(levels: list[BoxLevel], depth: int, boxes: ConeBoxes, key: UInt64[np.ndarray, "new"]) -> Any:
    """Where boxes stand in a level, to which those that are not there yet are added."""
    known = levels[depth].key if depth < len(levels) else np.zeros(0, np.uint64)
    _, first, index = np.unique(np.concatenate([known, key]), return_index=True, return_inverse=True)
    new = np.sort(first[first >= len(known)]) - len(known)
    place = np.where(first < len(known), first, len(known) + np.searchsorted(new, first - len(known)))
    if not len(known):
        levels.append(BoxLevel.of(boxes[new], key[new]))
    elif len(new):
        levels[depth].append(boxes[new], key[new])
    return place[index[len(known) :]]
