"""Exact distances among boxes by brute force, which share no line with the package.

Every corner is tested against every other, and every point against every corner, box by box: a segment is blocked by
an open box if the stretches of it between the box's two pairs of sides overlap. Walls that touch must be given so
that they overlap, and those at the border so that they go beyond it: boxes are shrunk by a rounding error, so that a
path may follow their sides.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

_SHRUNK = 1e-12
_AT_ONCE = 1 << 19  # segments
_NEARLY_PARALLEL = 1e-300

MAZE = (
    (-1.0, 0.19, 0.71, 0.23),
    (0.27, 0.43, 2.0, 0.47),
    (-1.0, 0.68, 0.63, 0.72),
    (0.79, 0.45, 0.83, 0.83),
    (0.41, 0.21, 0.45, 0.36),
    (0.19, 0.79, 0.23, 2.0),
)
THIN_MAZE = (
    (-1.0, 0.205, 0.71, 0.215),
    (0.27, 0.445, 2.0, 0.455),
    (-1.0, 0.695, 0.63, 0.705),
    (0.805, 0.45, 0.815, 0.83),
    (0.425, 0.21, 0.435, 0.36),
    (0.205, 0.79, 0.215, 2.0),
)


class BruteDistance:
    """Exact distance to a goal in the unit square among boxes ``(x0, y0, x1, y1)``."""

    def __init__(self, walls: Sequence[tuple[float, float, float, float]], goal: Float[np.ndarray, "2"]) -> None:
        self._walls = np.array(walls)
        x0, y0, x1, y1 = self._walls.T
        corners = np.concatenate([np.column_stack(each) for each in ((x0, y0), (x0, y1), (x1, y0), (x1, y1))])
        free = ((corners >= 0) & (corners <= 1)).all(axis=1) & ~self._covered(corners)
        self._turns = np.concatenate([np.asarray(goal, float)[None], corners[free]])
        lengths = np.linalg.norm(self._turns[:, None] - self._turns, axis=2)
        sees = np.stack(
            [self._is_clear(np.broadcast_to(turn, self._turns.shape), self._turns) for turn in self._turns]
        )
        self._onward = dijkstra(csr_array(np.where(sees, lengths, 0.0)), indices=0)

    def __call__(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Distances; ``inf`` in a wall and outside the square."""
        distance = np.full(len(x), np.inf)
        for begin in range(0, len(x), _AT_ONCE):
            part = x[begin : begin + _AT_ONCE]
            for turn, onward in zip(self._turns, self._onward, strict=True):
                length = onward + np.sqrt(np.square(part - turn).sum(axis=1))
                nearer = np.flatnonzero(length < distance[begin : begin + len(part)])
                clear = nearer[self._is_clear(part[nearer], np.broadcast_to(turn, (len(nearer), 2)))]
                distance[begin + clear] = length[clear]
        distance[self._covered(x) | ((x < 0) | (x > 1)).any(axis=1)] = np.inf
        return distance

    def _covered(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        covered = np.zeros(len(x), bool)
        for x0, y0, x1, y1 in self._walls:
            covered |= (x[:, 0] > x0) & (x[:, 0] < x1) & (x[:, 1] > y0) & (x[:, 1] < y1)
        return covered

    def _is_clear(self, a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether segments from ``a`` to ``b`` keep out of all boxes."""
        step = b - a
        step = np.where(step == 0, _NEARLY_PARALLEL, step)
        clear = np.ones(len(a), bool)
        with np.errstate(over="ignore"):
            for x0, y0, x1, y1 in self._walls:
                enter, leave = np.zeros(len(a)), np.ones(len(a))
                for axis, (lo, hi) in enumerate(((x0, x1), (y0, y1))):
                    first = (lo + _SHRUNK - a[:, axis]) / step[:, axis]
                    last = (hi - _SHRUNK - a[:, axis]) / step[:, axis]
                    np.maximum(enter, np.minimum(first, last), out=enter)
                    np.minimum(leave, np.maximum(first, last), out=leave)
                clear &= enter >= leave
        return clear
