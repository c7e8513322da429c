"""The best dyadic partition at a price a leaf, of all that there are.

Splitting best-first decides for an axis by what one split gains, and never takes it back. Here every box that a tree
may hold is judged once, whichever splits lead to it, unless its cost is below the price of a leaf. Then the best tree
follows from the smallest boxes up: a box is a leaf, or cheaper halved along one of the axes. The price falls, and
more boxes are looked at, until the best tree is beyond its limits; of the prices in between, the lowest within them
is taken.

References:
    Donoho, "CART and best-ortho-basis: a connection", Annals of Statistics 1997.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.limits import Limits, check_memory, grow
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
MAX_ASPECT_BITS = 2  # the longest side of a box is at most 2**2 times its shortest, in fractions of the domain
LEAST_SHARE, LEAST_SHARE_PROVEN = 0.01, 0.05  # of a leaf's average share, that every box has besides its own
AT_ONCE = 1 << 14  # boxes
_KEY_BITS = 63  # of a box, for all axes


@runtime_checkable
class Leaves(Protocol):
    """Some boxes as leaves: all that a file keeps of them follows."""

    @property
    def cells(self) -> Cells:
        """The boxes."""
        ...

    def append(self, *others: Any) -> Any:
        """These leaves followed by others."""
        ...


@runtime_checkable
class Boxes(Protocol):
    """Boxes of a domain, and what leaves there would be like."""

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

    def leaves(self, index: Int[np.ndarray, "some"]) -> Leaves:
        """Some of the boxes as leaves."""
        ...

    def append(self, *others: Any) -> Any:
        """These boxes followed by others."""
        ...

    def halves(
        self, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"], is_upper: Bool[np.ndarray, "new"]
    ) -> Any:
        """A half of each of some of the boxes."""
        ...


@dataclass(frozen=True, eq=False)
class _Tree:
    """The leaves of the best tree at a price a leaf, and the bytes of their file."""

    leaves: Leaves
    price: float
    num_bytes: int
    is_final: bool

    def __len__(self) -> int:
        return len(self.leaves.cells)


def best_partition(root: Boxes, limits: Limits, size: Callable[[Any], int], num_sources: int = 0) -> Any:
    """The leaves of the best tree within the limits.

    Args:
        root: The domain as a box.
        limits: The limits.
        size: Gives the bytes of a file of some leaves.
        num_sources: How many sources leaves may name; a file holds those that they do. Going by them the search goes
            less far beyond its limits.

    Raises:
        BudgetTooSmall: If the budget of bytes is too small for one leaf.
    """
    search = _Search(root, limits, size, num_sources)
    tree = search.tree(float(root.integral[0] + root.error[0]), 1.0)
    limits.require_room(tree.num_bytes)
    return grow(tree, search.next, limits).leaves


class _Search:
    """The search of a price, and the boxes that were looked at so far."""

    def __init__(self, root: Boxes, limits: Limits, size: Callable[[Any], int], num_sources: int) -> None:
        self._levels, self._limits, self._size, self._num_sources = [_level_of(root)], limits, size, num_sources

    def tree(self, price: float, least_share: float, is_final: bool = False) -> _Tree:
        """The best tree of what was looked at."""
        leaves = _best_leaves(self._levels, price, least_share)
        num_bytes = self._size(leaves) if np.isfinite(self._limits.max_bytes) else 0
        return _Tree(leaves, price, num_bytes, is_final)

    def fits(self, tree: _Tree) -> bool:
        """Whether a tree is within the limits."""
        return len(tree) <= self._limits.max_leaves and tree.num_bytes <= self._limits.max_bytes

    def next(self, now: _Tree) -> _Tree | None:
        """A larger tree, after more boxes were looked at; None if there is none."""
        if now.is_final:
            return None
        most = self._expected_leaves(now)
        least = LEAST_SHARE if self._limits.proof is Proof.NONE else LEAST_SHARE_PROVEN
        least_share = least / (most if most < _UNLIMITED else len(now))
        price = self._next_price(now, most / len(now), least_share)
        _expand(self._levels, price, least_share, self._limits)
        is_final = not any(
            (_may_expand(level, self._limits).any(axis=0) & (_costs(level, least_share) > 0)).any()
            for level in self._levels
        )
        larger = self.tree(_LAST * price if is_final else price, least_share, is_final)
        return larger if self.fits(larger) else self._largest(now, larger, least_share)

    def _share(self, tree: _Tree) -> float:
        """Of what the limits allow, how much a tree takes."""
        return max(len(tree) / self._limits.max_leaves, tree.num_bytes / self._limits.max_bytes)

    def _expected_leaves(self, tree: _Tree) -> float:
        """How many leaves the limits may allow, going by the bytes that a tree leaves."""
        bits = (self._limits.max_bytes - tree.num_bytes) * 8
        is_crowded = len(tree) == 1 and self._num_sources * _BITS_A_SOURCE > bits
        more = bits / (_BITS_A_LEAF + _BITS_A_SOURCE * is_crowded)  # then each leaf brings a source along
        return float(min(self._limits.max_leaves, len(tree) + more))

    def _next_price(self, now: _Tree, room: float, least_share: float) -> float:
        """The price at which a tree is expected to be a little beyond the limits, or a good deal larger than now."""
        if len(now) == 1:
            room = max(_FIRST_SHARE * room, 2.0)
            return now.price * (room**-_FIRST_RATE if room < _UNLIMITED else _LARGEST_DROP)
        before = len(_best_leaves(self._levels, _RATE_STEP * now.price, least_share).cells)
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


@dataclass(eq=False)
class _Level:
    """The boxes of one number of splits that were looked at.

    ``child`` is where the halves of each stand in the next level, along each axis, -1 where they do not.
    """

    boxes: Any
    number: Int[np.ndarray, "boxes dim"]
    child: Int[np.ndarray, "dim 2 boxes"]


def _level_of(boxes: Boxes) -> _Level:
    cells = boxes.cells
    number = (np.int64(1) << cells.depth) + cells.position
    return _Level(boxes, number, np.full((cells.dim, 2, len(cells)), -1))


def _may_expand(level: _Level, limits: Limits) -> Bool[np.ndarray, "dim boxes"]:
    """Along which axes boxes may be halved that were not yet."""
    depth = level.boxes.cells.depth.T
    shallow = (depth < limits.max_axis_depth) & (depth.sum(axis=0) < limits.max_depth)
    return shallow & (depth - depth.min(axis=0) < MAX_ASPECT_BITS) & (level.child[:, 0] < 0).all(axis=0)


def _costs(level: _Level, least_share: float) -> Float[np.ndarray, "boxes"]:
    """What each box adds to the error of a tree: however small it is, it counts as if it were not."""
    return level.boxes.integral + least_share * level.boxes.error


def _expand(levels: list[_Level], price: float, least_share: float, limits: Limits) -> None:
    """Look at the halves of all boxes that cost more than the price of a leaf, and at theirs, and so on."""
    for depth in range(limits.max_depth):
        if depth == len(levels):
            return
        level = levels[depth]
        axis, parent = np.nonzero(_may_expand(level, limits) & (_costs(level, least_share) > price))
        if len(parent):
            _add_halves(levels, depth, np.repeat(parent, 2), np.repeat(axis, 2))
    check_memory(float(sum(len(level.number) for level in levels)))


def _add_halves(
    levels: list[_Level], depth: int, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"]
) -> None:
    """Both halves of boxes of one level along the given axes, each looked at once."""
    level, dim = levels[depth], levels[depth].number.shape[1]
    is_upper = np.arange(len(parent)) % 2 == 1
    number = level.number[parent]
    each = np.arange(len(parent))
    number[each, axis] = 2 * number[each, axis] + is_upper
    known = levels[depth + 1].number if depth + 1 < len(levels) else np.zeros((0, dim), np.int64)
    keys = np.concatenate([known, number]) @ (np.int64(1) << (_KEY_BITS // dim * np.arange(dim)))
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    is_new = first >= len(known)
    found = np.sort(first[is_new]) - len(known)
    place = first.copy()  # of each distinct box in the next level
    place[is_new] = len(known) + np.searchsorted(found, first[is_new] - len(known))
    parts = [
        level.boxes.halves(parent[some], axis[some], is_upper[some])
        for some in np.split(found, range(AT_ONCE, len(found), AT_ONCE))
        if len(some)
    ]
    if len(known):
        old = levels[depth + 1]
        boxes = old.boxes.append(*parts)
        child = np.concatenate([old.child, np.full((dim, 2, len(found)), -1)], axis=2)
        levels[depth + 1] = _Level(boxes, np.concatenate([known, number[found]]), child)
    elif parts:
        levels.append(_level_of(parts[0].append(*parts[1:])))
    level.child[axis, is_upper.astype(int), parent] = place[index[len(known) :]]


def _best_leaves(levels: list[_Level], price: float, least_share: float) -> Any:
    """Leaves of the tree for which their costs and their prices together are least."""
    below: Float[np.ndarray, boxes] = np.zeros(0)
    choices = []
    for level in reversed(levels):
        dim, _, num_boxes = level.child.shape
        total, choice = _costs(level, least_share) + price, np.full(num_boxes, -1)
        for axis in range(dim):
            lower, upper = level.child[axis]
            halved = np.flatnonzero(lower >= 0)
            both = below[lower[halved]] + below[upper[halved]]
            cheaper = halved[both < total[halved]]
            total[cheaper], choice[cheaper] = both[both < total[halved]], axis
        below = total
        choices.append(choice)
    parts, here = [], np.zeros(1, np.int64)
    for level, choice in zip(levels, reversed(choices), strict=True):
        axis = choice[here]
        parts.append(level.boxes.leaves(here[axis < 0]))
        here, axis = here[axis >= 0], axis[axis >= 0]
        here = level.child[axis, :, here].ravel()
    return parts[0].append(*parts[1:])
