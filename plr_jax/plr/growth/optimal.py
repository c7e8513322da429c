"""The best dyadic partition at a price a leaf, of all that there are.

Splitting best-first decides for an axis by what one split gains, and never takes it back. Here the best tree of all
boxes is found, whatever the splits that lead to them. The price falls, and more boxes are looked at, until the best
tree is beyond its limits; of the prices in between, the lowest within them is taken.

References:
    Donoho, "CART and best-ortho-basis: a connection", Annals of Statistics 1997.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Int

from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.levels import LEAST_SHARE, LEAST_SHARE_PROVEN, Boxes, BoxLevel, expand, prune
from plr_jax.plr.growth.limits import Limits, grow
from plr_jax.plr.partition.cells import Cells

_LARGEST_DROP, _SMALLEST_DROP = 0.005, 0.7  # to what share of the price before it may fall, and falls at the least
_RATE_STEP = 8.0  # times the price, to see how it falls as leaves get more
_MUCH_ROOM = 8.0  # times as large a tree may be yet, far from the limits
_BEYOND = 1.15  # times as large as they allow a tree should be, near them
_FIRST_RATE, _UNLIMITED = 2.2, 1e7  # a price falls about as the leaves to this power, if there is an end to them
_FIRST_SHARE = 0.25  # of what the limits allow, that the first tree should take: the power is but a guess yet
_BITS_A_LEAF, _BITS_A_SOURCE = 5.0, 56.0  # about as many as one more takes, and what it is the first to name
_ATTEMPTS, _FULL = 12, 0.997  # to find a price with which a tree takes this share of what the limits allow
_LAST = 1e-12  # of the last price, once all boxes were looked at: of trees that are as good, the smallest is taken

Leaves: TypeAlias = list[Int[np.ndarray, "_"]]
"""Which boxes of each level are leaves."""


@dataclass(frozen=True, eq=False)
class _Tree:
    """The leaves of the best tree at a price a leaf, and the bytes of their file."""

    leaves: Leaves
    price: float
    num_bytes: int
    is_final: bool

    def __len__(self) -> int:
        return sum(map(len, self.leaves))


def best_partition(
    root: Boxes, limits: Limits, size: Callable[[list[BoxLevel], Leaves], int], num_sources: int = 0
) -> tuple[list[BoxLevel], Leaves]:
    """The best tree within the limits.

    Args:
        root: The domain as a box.
        limits: The limits.
        size: Gives the bytes of a file of some leaves.
        num_sources: How many sources leaves may name; a file holds those that they do. Going by them the search goes
            less far beyond its limits.

    Returns:
        All boxes that were looked at, and which of them are its leaves.

    Raises:
        BudgetTooSmall: If the budget of bytes is too small for one leaf.
    """
    search = _Search(root, limits, size, num_sources)
    tree = search.tree(float(root.integral[0] + root.error[0]), 1.0)
    limits.require_room(tree.num_bytes)
    leaves = grow(tree, search.next, limits).leaves
    return search.levels[: len(leaves)], leaves  # the last ones looked at may have been beyond the limits


class _Search:
    """The search of a price, and the boxes that were looked at so far."""

    def __init__(self, root: Boxes, limits: Limits, size: Callable[..., int], num_sources: int) -> None:
        self.levels = [BoxLevel.of(root, Cells.root(2).hashes())]
        self._limits, self._size, self._num_sources = limits, size, num_sources

    def tree(self, price: float, least_share: float, is_final: bool = False) -> _Tree:
        """The best tree of what was looked at."""
        leaves = _best_leaves(self.levels, price, least_share)
        num_bytes = self._size(self.levels, leaves) if np.isfinite(self._limits.max_bytes) else 0
        return _Tree(leaves, price, num_bytes, is_final)

    def fits(self, tree: _Tree) -> bool:
        """Whether a tree is within the limits."""
        return len(tree) <= self._limits.max_leaves and tree.num_bytes <= self._limits.max_bytes

    def next(self, now: _Tree) -> _Tree | None:
        """A larger tree, after more boxes were looked at; None if there is none."""
        if now.is_final:
            return None
        # How many leaves the limits may allow, going by the bytes that a tree leaves.
        bits = (self._limits.max_bytes - now.num_bytes) * 8
        is_crowded = len(now) == 1 and self._num_sources * _BITS_A_SOURCE > bits
        more = bits / (_BITS_A_LEAF + _BITS_A_SOURCE * is_crowded)  # then each leaf brings a source along
        most = float(min(self._limits.max_leaves, len(now) + more))
        least = LEAST_SHARE if self._limits.proof is Proof.NONE else LEAST_SHARE_PROVEN
        least_share = least / (most if most < _UNLIMITED else len(now))
        price = self._next_price(now, most / len(now), least_share)
        is_final = not expand(self.levels, np.ones(1, bool), price, least_share, self._limits)
        larger = self.tree(_LAST * price if is_final else price, least_share, is_final)
        return larger if self.fits(larger) else self._largest(now, larger, least_share)

    def _share(self, tree: _Tree) -> float:
        """Of what the limits allow, how much a tree takes."""
        return max(len(tree) / self._limits.max_leaves, tree.num_bytes / self._limits.max_bytes)

    def _next_price(self, now: _Tree, room: float, least_share: float) -> float:
        """The price at which a tree is expected to be a little beyond the limits, or a good deal larger than now."""
        if len(now) == 1:
            room = max(_FIRST_SHARE * room, 2.0)
            return now.price * (room**-_FIRST_RATE if room < _UNLIMITED else _LARGEST_DROP)
        before = sum(map(len, _best_leaves(self.levels, _RATE_STEP * now.price, least_share)))
        if before == len(now) or room > _MUCH_ROOM:
            return _LARGEST_DROP * now.price
        rate = np.log(len(now) / before) / np.log(_RATE_STEP)
        return now.price * float(np.clip((_BEYOND * room) ** (-1 / rate), _LARGEST_DROP, _SMALLEST_DROP))

    def _largest(self, fits: _Tree, beyond: _Tree, least_share: float) -> _Tree:
        """The largest tree that fits, of prices between one that does and one that does not."""
        largest = fits
        for attempt in range(_ATTEMPTS):
            low, high = np.log(max(beyond.price, 1e-6 * fits.price)), np.log(fits.price)
            sizes = np.log([self._share(fits), self._share(beyond)])
            aim = sizes[0] / (sizes[0] - sizes[1]) if attempt % 2 == 0 else 0.5
            middle = self.tree(float(np.exp(high + np.clip(aim, 0.05, 0.95) * (low - high))), least_share)
            if self.fits(middle):
                fits = largest = middle
            else:
                beyond = middle
            if self._share(largest) > _FULL:
                break
        return replace(largest, is_final=True)


def _best_leaves(levels: list[BoxLevel], price: float, least_share: float) -> Leaves:
    """Leaves of the tree for which their costs and their prices together are least."""
    leaves, here = [], np.zeros(1, np.int64)
    for level, choices in zip(levels, prune(levels, np.array([price]), least_share).choice, strict=True):
        axis = choices[0, here]
        leaves.append(here[axis < 0])
        here = level.child[axis[axis >= 0], :, here[axis >= 0]].ravel()
    return leaves
