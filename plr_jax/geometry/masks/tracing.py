"""The outline of the free pixels of a grid, exactly: rings of corners along the edges of pixels.

Pixel ``(row, column)`` is the square ``[column, column + 1] x [row, row + 1]``. Free pixels are joined along edges
(4-connected), blocked ones at corners too (8-connected). Rings have free space on their left; what is beyond the grid
is blocked. Along a ring runs in ``x`` and in ``y`` take turns, so every vertex is a corner.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

RISING, FALLING = 9, 6  # free pixels that touch in a corner only: lower left and upper right, or the other two


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
    """The outlines of the free pixels of a grid."""
    padded = np.pad(free, 1)
    # Which of the four pixels at a lattice point are free: 1 lower left, 2 lower right, 4 upper left, 8 upper right.
    around = padded[:-1, :-1] + 2 * padded[:-1, 1:] + 4 * padded[1:, :-1] + 8 * padded[1:, 1:].astype(np.uint8)
    y, x = np.nonzero(_CORNER[around])
    code = around[y, x]
    # A contact is a corner twice: the run along x that ends there has the first, the one that begins the second.
    twice = np.where((code == RISING) | (code == FALLING), 2, 1)
    x, y, code = np.repeat(x, twice), np.repeat(y, twice), np.repeat(code, twice)
    is_contact = (code == RISING) | (code == FALLING)
    is_second = np.append(False, is_contact[1:] & is_contact[:-1] & (x[1:] == x[:-1]) & (y[1:] == y[:-1]))
    # In the order of rows corners 0 and 1, 2 and 3, ... are the ends of runs along x; likewise of columns along y.
    along_x = np.arange(len(x)) ^ 1
    # Of a rising contact, the run that arrives from the left goes on downward, so that its pixel stays apart.
    columns = np.lexsort((is_second ^ (code == FALLING), y, x))
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


_CORNER = np.array([bin(code).count("1") % 2 == 1 or code in (RISING, FALLING) for code in range(16)])


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
