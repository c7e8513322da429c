"""How the distances to a goal have changed with a map: triangle by triangle, and source by source.

From a point of a triangle a path sets out for the goal, or for a turn point that sees some of the triangle. Such a
pair of a triangle and a source is *intact* if the source sees no changed wall, or none on the way to the triangle,
and if paths bend around it as before. Where all pairs of a triangle are intact, and the distances of their sources
have changed by one number, so have those of all points in it.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

Triangles = Float[np.ndarray, "triangles 3 2"]
Corners = Float[np.ndarray, "4 2"]


@dataclass(frozen=True, eq=False)
class TriangleSources:
    """Pairs of a triangle and a source that some point of it may see.

    Attributes:
        triangle: The triangle.
        source: The source, before or after.
        change: By how much its distance is more after than before; NaN if it is not the same one.
        is_doubted: Whether it may see a changed wall.
    """

    triangle: Int[np.ndarray, "pairs"]
    source: Int[np.ndarray, "pairs"]
    change: Float[np.ndarray, "pairs"]
    is_doubted: Bool[np.ndarray, "pairs"]

    def __getitem__(self, rows: Int[np.ndarray, "some"]) -> "TriangleSources":
        """Some of them."""
        return TriangleSources(self.triangle[rows], self.source[rows], self.change[rows], self.is_doubted[rows])

    def of_triangles(self, is_wanted: Bool[np.ndarray, "triangles"]) -> "TriangleSources":
        """Those of some triangles, in their order."""
        rows = np.flatnonzero(is_wanted[self.triangle])
        return self[rows[np.argsort(self.triangle[rows], kind="stable")]]


@dataclass(frozen=True, eq=False)
class ChangedDistances:
    """How distances to a goal have changed.

    Attributes:
        boxes: Corners of boxes around all walls that are not the same.
        source: The source afterwards that each was before; -1 for none.
        source_change: By how much the distance of each is more; NaN for none.
        triangles: Of free space before and after, those that have not changed once.
        change: By how much the distance is more everywhere in each; NaN where pairs have to say.
        was_cut_off: Which of these are of free space before from which no path led to the goal.
        before: The pairs of these, before.
        after: The pairs of these, after.
        rounding: By how much changes may differ and are one.
        slack: How much distances before may err, as free space was known to a tolerance.
    """

    boxes: list[Corners]
    source: Int[np.ndarray, "sources"]
    source_change: Float[np.ndarray, "sources"]
    triangles: Triangles
    change: Float[np.ndarray, "triangles"]
    was_cut_off: Bool[np.ndarray, "triangles"]
    before: TriangleSources
    after: TriangleSources
    rounding: float
    slack: float


def hulls_meet_boxes(hulls: Float[np.ndarray, "n k 2"], boxes: list[Corners]) -> Bool[np.ndarray, "n"]:
    """Whether the convex hulls of some points each meet a box: neither a side of it nor a line by two parts them."""
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
