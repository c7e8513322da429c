"""Where shortest paths to one goal turn first, triangle by triangle: the turn points that see some of each.

A path that turns at a corner comes from a cone there, so expansion inside of these cones finds the triangles.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import parts, run_members
from plr_jax.geometry.corners import TurnPoints
from plr_jax.geometry.first_visible import Sees, first_visible_of_some
from plr_jax.geometry.visibility import Triangulation, Viewpoints, triangles_within

_PAIRS = 1 << 18  # of a point and a turn point, held at a time
_NEAR = 4.0  # tolerances from a side of a triangle, within which a point counts as on it


@dataclass(frozen=True, eq=False)
class TurnRegions:
    """The turn points that see some of each triangle of free space, where paths come around them.

    Args:
        turns: The turn points.
        triangulation: Of free space.
        first: First entry of each triangle, and the number of entries, ``(triangles + 1,)``.
        turn: Turn points by triangle, ``(entries,)``.
    """

    turns: TurnPoints
    triangulation: Triangulation
    first: Int[np.ndarray, "triangles_plus_one"]
    turn: Int[np.ndarray, "entries"]

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays, and of the triangles."""
        return self.first.nbytes + self.turn.nbytes + self.triangulation.num_bytes

    def first_visible(
        self, x: Float[np.ndarray, "n 2"], sees: Sees
    ) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The vertex that the shortest path from each point goes to first, and the length of this path.

        Points at vertices of the triangulation, where any number of triangles meet, try all turn points.

        Args:
            x: Points of free space, ``(n, 2)``.
            sees: Whether points, by their numbers, see vertices.

        Returns:
            The vertices, -1 for points that see none, and the lengths, ``inf`` for these; ``(n,)`` each.
        """
        vertex, length = np.full(len(x), -1), np.full(len(x), np.inf)
        point, first, triangle = triangles_at(self.triangulation, x)
        entries = np.append(0, np.cumsum(self.first[triangle + 1] - self.first[triangle]))[first]
        counts = np.diff(entries)
        for part in parts(counts, _PAIRS):
            turn = self.turn[run_members(self.first, triangle[first[part.start] : first[part.stop]])[0]]
            rows = point[part]
            way, length[rows] = self._first_visible(x, rows, counts[part], turn, sees)
            vertex[rows] = np.append(self.turns.vertex, -1)[way]
        rest = np.setdiff1d(np.arange(len(x)), point, assume_unique=True)
        vertex[rest], length[rest] = self.turns.first_visible(
            x[rest], lambda point, vertex: sees(rest[point], vertex)
        )
        return vertex, length

    def _first_visible(
        self,
        x: Float[np.ndarray, "n 2"],
        rows: Int[np.ndarray, "rows"],
        counts: Int[np.ndarray, "rows"],
        turn: Int[np.ndarray, "pairs"],
        sees: Sees,
    ) -> tuple[Int[np.ndarray, "rows"], Float[np.ndarray, "rows"]]:
        """The best turn in sight of some points, each with its own candidates one after the other, and the length."""
        dx, dy = (np.repeat(x[rows], counts, axis=0) - self.turns.points[turn]).T
        lengths = np.sqrt(dx * dx + dy * dy) + self.turns.distance[turn]
        found, length = first_visible_of_some(
            lengths, counts, lambda point, pair: sees(rows[point], self.turns.vertex[turn[pair]])
        )
        return np.append(turn, -1)[found], length


def turn_regions(turns: TurnPoints, triangulation: Triangulation, views: Viewpoints) -> TurnRegions:
    """Those of the turn points, which are viewpoints one after the other."""
    visits = triangles_within(triangulation, views, *turns.bounds)
    return TurnRegions(turns, triangulation, *views_by_triangle(triangulation, visits))


def views_by_triangle(
    triangulation: Triangulation, visits: Int[np.ndarray, "2 visits"]
) -> tuple[Int[np.ndarray, "triangles_plus_one"], Int[np.ndarray, "entries"]]:
    """Where the viewpoints of each triangle begin, and these, of pairs of both of which some are repeated."""
    view, triangle = visits
    count = int(view.max(initial=0)) + 1
    key = np.sort(triangle * np.int64(count) + view)
    key = key[np.append(True, key[1:] != key[:-1])[: len(key)]]
    triangle, view = np.divmod(key, count)
    return np.searchsorted(triangle, np.arange(len(triangulation.origin) // 3 + 1)), view


def triangles_at(
    triangulation: Triangulation, x: Float[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, "points"], Int[np.ndarray, "points_plus_one"], Int[np.ndarray, "pairs"]]:
    """Points, the first of each one's triangles and the number of these, and the one or two that hold each.

    Points at vertices are left out.
    """
    locator, near = triangulation.locator, _NEAR * triangulation.tolerance
    triangle = locator.find(x)
    point = np.flatnonzero(triangle >= 0)
    on_side = locator.heights(triangle[point], x[point]) < near
    num_sides, side = on_side.sum(axis=1), on_side.argmax(axis=1)
    beyond = triangulation.twin[3 * triangle[point] + side] // 3
    crossed = (num_sides == 1) & (beyond >= 0)
    # Where the triangle beyond is thinner than that, there may be more.
    crossed[crossed] = (locator.heights(beyond[crossed], x[point[crossed]]) < near).sum(axis=1) == 1
    held = (num_sides == 0) | ((num_sides == 1) & (beyond < 0)) | crossed
    counts = np.where(crossed, 2, 1)[held]
    both = np.stack([triangle[point], beyond], axis=1)[held]
    return point[held], np.append(0, np.cumsum(counts)), both[np.arange(2) < counts[:, None]]
