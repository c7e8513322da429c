"""Differences between the distances to a goal before and after a change of the map, for whole triangles.

A path from a triangle goes straight to a *source*: the goal, or a corner that sees a part of the triangle. Suppose
that no changed wall lies between a triangle and its sources. If the distances of all its sources to the goal have
changed by the same amount, then the distances of all its points have changed by this amount.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

Corners = Float[np.ndarray, "4 2"]


@dataclass(frozen=True, eq=False)
class TriangleSources:
    """Pairs of a triangle and a point (goal or corner where a path may turn) that may see a part of it."""

    triangle: Int[np.ndarray, "pairs"]
    source: Int[np.ndarray, "pairs"]
    change: Float[np.ndarray, "pairs"]  # new minus old distance of the source, NaN if it is not the same source
    is_doubted: Bool[np.ndarray, "pairs"]  # whether the source may see a changed wall

    def __getitem__(self, rows: Int[np.ndarray, "some"]) -> "TriangleSources":
        return TriangleSources(self.triangle[rows], self.source[rows], self.change[rows], self.is_doubted[rows])

    def of_triangles(self, is_wanted: Bool[np.ndarray, "triangles"]) -> "TriangleSources":
        rows = np.flatnonzero(is_wanted[self.triangle])
        return self[rows[np.argsort(self.triangle[rows], kind="stable")]]


@dataclass(frozen=True, eq=False)
class ChangedDistances:
    boxes: list[Corners]  # around all walls that have changed
    source: Int[np.ndarray, "sources"]  # new index of each old source (the goal, then corners); -1 if it is gone
    source_change: Float[np.ndarray, "sources"]  # new minus old distance of each old source; NaN if it is gone
    triangles: Float[np.ndarray, "triangles 3 2"]  # of free space before and after; those in both appear once
    change: Float[np.ndarray, "triangles"]  # new minus old distance, if it is the same all over a triangle; else NaN
    was_cut_off: Bool[np.ndarray, "triangles"]  # whether a triangle was free before, without a path to the goal
    before: TriangleSources  # of triangles whose change is NaN
    after: TriangleSources
    rounding: float  # changes that differ by less count as equal
    slack: float  # error of the old distances, since free space is known to a tolerance


def hulls_meet_boxes(hulls: Float[np.ndarray, "n k 2"], boxes: list[Corners]) -> Bool[np.ndarray, "n"]:
    met = np.zeros(len(hulls), bool)
    x, y = np.ascontiguousarray(hulls.transpose(2, 1, 0))  # NumPy is slow where the last axis is short
    lo, hi = (np.stack([end(x, axis=0), end(y, axis=0)], axis=1) for end in (np.min, np.max))
    for box in boxes:
        rows = np.flatnonzero(~met & ((lo <= box[2]) & (hi >= box[0])).all(axis=1))
        for i, j in combinations(range(len(x)), 2):
            dx, dy = x[j, rows] - x[i, rows], y[j, rows] - y[i, rows]
            own, other = dx * y[:, rows] - dy * x[:, rows], dx * box[:, 1:] - dy * box[:, :1]
            rows = rows[(own.max(axis=0) >= other.min(axis=0)) & (other.max(axis=0) >= own.min(axis=0))]
        met[rows] = True
    return met
