"""The cells at which a family starts, and the tree above them, which is the same for all members.

Above the start every box has sources of its own for every goal, and hardly one is a leaf of a good tree but where one
source serves all of it. So boxes are looked at from some number of splits on, and those above are leaves only where
all of the boxes that they hold have no error and one source. Where sources take most of the bytes, as of a hundred
corners in 1 KB, leaves are fewer than the start expects, and a good tree has larger ones: a single goal starts at the
whole domain.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.growth.levels import MAX_ASPECT_BITS
from plr_jax.plr.partition.cells import Cells

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
