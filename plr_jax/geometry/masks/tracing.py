"""The outline of the free pixels of a grid, exactly: rings of corners along the edges of pixels.

Pixel ``(row, column)`` is the square ``[column, column + 1] x [row, row + 1]``. Free pixels are joined along edges
(4-connected), blocked ones at corners too (8-connected). Rings have free space on their left; what is beyond the grid
is blocked. Along a ring runs in ``x`` and in ``y`` take turns, so every vertex is a corner.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

_MOST_CORNERS = 2**18


@dataclass(frozen=True, eq=False)
class PixelRings:
    """Closed rings of corners, one after another, each without its first corner again at its end.

    Attributes:
        points: Corners ``(x, y)``, ``(n, 2)``.
        start: Index of the first corner of each ring, and ``n`` at the end, ``(rings + 1,)``.
        is_contact: Which corners are points in which free pixels touch, two rings or one ring twice, ``(n,)``.
    """

    points: Float[np.ndarray, "n 2"]
    start: Int[np.ndarray, "rings_and_1"]
    is_contact: Bool[np.ndarray, "n"]


def pixel_rings(free: Bool[np.ndarray, "rows columns"]) -> PixelRings:
    """The outlines of the free pixels of a grid; ``ValueError`` if they have too many corners."""
    padded = np.pad(free, 1)
    (lower_left, lower_right), (upper_left, upper_right) = (
        (rows[:, :-1], rows[:, 1:]) for rows in (padded[:-1], padded[1:])
    )
    touches = (lower_left == upper_right) & (upper_left == lower_right) & (lower_left != lower_right)
    is_corner = touches | (lower_left ^ lower_right ^ upper_left ^ upper_right)
    if (count := np.count_nonzero(is_corner)) > _MOST_CORNERS:
        raise ValueError(
            f"The outline of the pixels has {count:,} corners, at most {_MOST_CORNERS:,} are read: smooth the "
            "picture, or drop its specks."
        )
    y, x = np.nonzero(is_corner)
    # A contact is a corner twice: the run along x that ends there has the first, the one that begins the second.
    twice = np.where(touches[y, x], 2, 1)
    is_contact = np.repeat(twice == 2, twice)
    is_second = np.append(False, is_contact[1:] & (np.diff(np.repeat(np.arange(len(x)), twice)) == 0))
    x, y = np.repeat(x, twice), np.repeat(y, twice)
    # In the order of rows corners 0 and 1, 2 and 3, ... are the ends of runs along x; likewise of columns along y.
    along_x = np.arange(len(x)) ^ 1
    # A run that arrives from the left goes on around its pixel, which is free below it or above: down, or up.
    goes_down = padded[y, x]
    columns = np.lexsort((is_second == goes_down, y, x))
    along_y = np.empty_like(columns)
    along_y[columns] = columns[np.arange(len(x)) ^ 1]
    # Free space on the left: to the right along runs with free pixels above them.
    is_left_end = np.arange(len(x)) % 2 == 0
    right_of = x + np.where(is_left_end, 0, -1)
    free_above = padded[y + 1, right_of + 1]
    leaves_along_x = is_left_end == free_above
    follower = np.where(leaves_along_x, along_x, along_y)
    order, start = _cycles(follower)
    return PixelRings(np.stack([x, y], axis=1)[order].astype(float), start, is_contact[order])


def _cycles(follower: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "cycles_and_1"]]:
    """The cycles of a permutation one after another, each from its least element; and where each begins."""
    onward, order, start = follower.tolist(), [], []
    for first in range(len(onward)):
        if onward[first] < 0:
            continue
        start.append(len(order))
        at = first
        while onward[at] >= 0:
            order.append(at)
            onward[at], at = -1, onward[at]
    return np.array(order, dtype=np.int64), np.array([*start, len(order)], dtype=np.int64)
