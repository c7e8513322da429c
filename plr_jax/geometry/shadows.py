"""What viewpoints see of convex free pieces: all of a piece, none of it, or a part.

Inside a free piece, what a viewpoint sees and what it does not are parted by *shadows* alone: the rays from a corner
onward, between the nearer wall that ends there and the farther one behind. A piece that none of them crosses is seen
as its center is.

Directions have *keys*, counterclockwise from the *cut* of their viewpoint, 4 a full turn.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import runs
from plr_jax.geometry.convex_pieces import Pieces, contain, following, highest, lowest
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.geometry.visibility import VisibilityTable

_ROUNDING = 1e-3
"""Rounding of a direction or a point, in tolerances of the workspace."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """The shadows around viewpoints, each viewpoint's sorted by direction.

    Args:
        table: The viewpoints and what they see.
        key: Direction of a shadow, as in the table.
        unit: The same as a vector of length 1.
        start: Where it starts, as a distance from the viewpoint.
        end: Where it ends.
    """

    table: VisibilityTable
    key: Float[np.ndarray, "shadows"]
    unit: Float[np.ndarray, "shadows 2"]
    start: Float[np.ndarray, "shadows"]
    end: Float[np.ndarray, "shadows"]

    def see(
        self, view: Int[np.ndarray, "pieces"], pieces: Pieces, center: Float[np.ndarray, "pieces 2"]
    ) -> tuple[Bool[np.ndarray, "pieces"], Bool[np.ndarray, "pieces"]]:
        """Whether each viewpoint sees the center of its piece, and whether it sees all of the piece alike."""
        point, tolerance = self.table.points[view], self.table.tolerance
        seen = self.table.sees(view, center)
        first, last, wraps = self._directions(view, pieces)
        some = np.flatnonzero(~contain(pieces, point[:, None], tolerance)[:, 0])
        alike = np.ones(len(view), bool)
        base = 4.0 * view
        ends = np.where(wraps, 4.0, last)
        again = some[wraps[some]]
        pair = np.concatenate([some, again])
        begin = np.concatenate([base[some] + first[some], base[again]])
        end = np.concatenate([base[some] + ends[some], base[again] + last[again] - 4])
        low, high = np.searchsorted(self.key, begin, side="right"), np.searchsorted(self.key, end, side="left")
        run, place = runs(np.maximum(high - low, 0))
        shadow, owner = low[run] + place, pair[run]
        alike[owner[self._cross(shadow, pieces[:, owner], point[owner])]] = False
        return seen, alike

    def _directions(
        self, view: Int[np.ndarray, "pieces"], pieces: Pieces
    ) -> tuple[Float[np.ndarray, "pieces"], Float[np.ndarray, "pieces"], Bool[np.ndarray, "pieces"]]:
        """First and last direction strictly inside each piece, and whether the cut is between them."""
        dx = pieces[0] - self.table.points[view, 0, None]
        dy = pieces[1] - self.table.points[view, 1, None]
        cx, cy = self.table.cut[view].T[:, :, None]
        key = pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
        distance = np.sqrt(dx * dx + dy * dy)
        rounding = _ROUNDING * self.table.tolerance
        blur = rounding / np.maximum(distance, rounding)
        apart = distance > self.table.tolerance
        wraps = highest(np.where(apart, key, -np.inf)) - lowest(np.where(apart, key, np.inf)) > 2
        key += np.where(wraps[:, None] & (key < 2), 4.0, 0.0)
        first = lowest(np.where(apart, key + blur, np.inf))
        last = highest(np.where(apart, key - blur, -np.inf))
        beyond = np.where(first >= 4, 4.0, 0.0)
        return first - beyond, last - beyond, wraps & (first < 4)

    def _cross(
        self, shadow: Int[np.ndarray, "n"], pieces: Pieces, point: Float[np.ndarray, "n 2"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether shadows, whose directions are inside pieces, cross them: they hold the middle of a chord."""
        ux, uy = self.unit[shadow].T[:, :, None]
        dx, dy = pieces[0] - point[:, :1], pieces[1] - point[:, 1:]
        along, beside = ux * dx + uy * dy, ux * dy - uy * dx
        next_along, next_beside = following(along), following(beside)
        crosses = (beside >= 0) != (next_beside >= 0)
        share = np.divide(beside, beside - next_beside, out=np.zeros_like(beside), where=crosses)
        at = along + share * (next_along - along)
        near = lowest(np.where(crosses, at, np.inf))
        far = highest(np.where(crosses, at, -1.0))
        middle = np.where(far > 0, (near + far) / 2, np.inf)
        return (self.start[shadow] < middle) & (middle < self.end[shadow])


def shadows_of(table: VisibilityTable) -> Shadows:
    """The shadows of all viewpoints of a table."""
    view = np.repeat(np.arange(len(table.points)), np.diff(table.first))
    row = np.flatnonzero(np.append(True, view[1:] != view[:-1])[: len(view)] == 0)
    view = view[row]
    # Directions from their pseudo-angles, counted from the cut.
    angle, (cx, cy) = table.key[row] - 4.0 * view, table.cut[view].T
    x = np.where(angle <= 2, 1 - angle, angle - 3)
    y = np.where(angle <= 2, 1, -1) * (1 - np.abs(x))
    unit = np.stack([cx * x - cy * y, cx * y + cy * x], axis=1)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    before = _distance_along(table, view, unit, table.edge[row - 1])
    after = _distance_along(table, view, unit, table.edge[row])
    start, end = np.minimum(before, after), np.maximum(before, after)
    parts = np.flatnonzero(end - start > table.tolerance)
    return Shadows(table, table.key[row[parts]], unit[parts], start[parts], end[parts])


def _distance_along(
    table: VisibilityTable, view: Int[np.ndarray, "n"], unit: Float[np.ndarray, "n 2"], edge: Int[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Distance from each viewpoint to an edge's line along a direction; 0 where it does not look."""
    normal, offset = table.boundary.normal[edge], table.boundary.offset[edge]
    height = (normal * table.points[view]).sum(axis=1) - offset
    toward = -(normal * unit).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(edge < 0, 0.0, np.maximum(height, 0) / np.maximum(toward, 0))
