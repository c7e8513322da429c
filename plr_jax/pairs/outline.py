"""The outline of free space on a lattice: what a file keeps of a workspace, and the walls that bound sight.

An outline is made of rings of points with free space on their left. Where free space touches itself in one point a
ring stays on its side of it, or, if paths may squeeze through, goes on around the same wall.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.vectors import left_normal
from plr_jax.plr.coding import BitReader, BitWriter

_MITRE = 4.0  # times as far as a wall recedes does a tip at the most
_OF_CONTACTS = 1 / 16  # times as far do contacts move back
_SHARP = -0.5  # cosine of the turn at an end of an obstacle, at the most
_COUNT_BITS = 32
_AT_ONCE = 2**5  # walls of which it is found what they cross


@dataclass(frozen=True, eq=False)
class Outline:
    """Rings of points with integer coordinates.

    Attributes:
        origin: Where both coordinates are 0.
        step: Width of the lattice.
        points: Points of all rings, ring by ring, in steps from the origin.
        first: First point of each ring, and the number of points.
        may_squeeze: Whether a path may pass between walls that touch in one point.
    """

    origin: Float[np.ndarray, "2"]
    step: float
    points: Int[np.ndarray, "points 2"]
    first: Int[np.ndarray, "rings_plus_one"]
    may_squeeze: bool

    @cached_property
    def positions(self) -> Float[np.ndarray, "points 2"]:
        """Where the points are."""
        return self.origin + self.step * self.points

    @cached_property
    def _following(self) -> Int[np.ndarray, "points"]:
        """The next point of each point's ring."""
        following = np.arange(1, len(self.points) + 1)
        following[self.first[1:] - 1] = self.first[:-1]
        return following

    @cached_property
    def _is_contact(self) -> Bool[np.ndarray, "points"]:
        """Points at which free space touches itself."""
        _, index, count = np.unique(self.points, axis=0, return_inverse=True, return_counts=True)
        return count[index] > 1

    @cached_property
    def stays(self) -> Bool[np.ndarray, "points"]:
        """Points that hardly move when walls move back: contacts that no path may squeeze through."""
        return self._is_contact & (not self.may_squeeze)

    @cached_property
    def is_reflex(self) -> Bool[np.ndarray, "points"]:
        """Points that stand out into the free space on their side."""
        before, after = (
            self.points - self.points[np.argsort(self._following)],
            self.points[self._following] - self.points,
        )
        return before[:, 0] * after[:, 1] < before[:, 1] * after[:, 0]

    def contains(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether points are in free space."""
        import shapely  # which to load a file does not need

        shapely.prepare(self.region)
        return shapely.intersects_xy(self.region, *x.T)

    @cached_property
    def region(self) -> Any:
        """Free space: of the faces between the walls those from which a ray crosses an odd number of walls.

        Rings may touch one another and themselves, so they are no polygons. Raises ``ValueError`` if they cross more
        often than details narrower than the lattice make them.
        """
        import shapely

        ends = self.moved_walls(0.0).reshape(-1, 2, 2)
        _require_few_crossings(ends)
        walls: Any = shapely.union_all(shapely.linestrings(ends))
        faces: Any = shapely.get_parts(shapely.polygonize(shapely.get_parts(walls)))
        px, py = shapely.get_coordinates(shapely.point_on_surface(faces)).T[:, :, None]
        (ax, ay), (bx, by) = ends.transpose(1, 2, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            is_left = (ay > py) != (by > py)
            is_left &= ax + (py - ay) / (by - ay) * (bx - ax) < px
        return shapely.union_all(faces[is_left.sum(axis=1) % 2 == 1])

    def moved_walls(self, distance: float) -> Float[np.ndarray, "walls 4"]:
        """Ends of the walls after all of them have moved so far back, out of free space, or into it if negative."""
        moved = self.moved_points(distance)
        return np.concatenate([moved, moved[self._following]], axis=1)

    def is_turned_around(self, distance: float, vertices: Float[np.ndarray, "points 2"]) -> bool:
        """Whether a wall points the other way after all have moved so far back: an obstacle is too thin for that.

        Walls point as they do between the vertices. One that the lattice has made a point does no harm but at a sharp
        end, where those beside it point against one another.
        """
        moved, following = self.moved_points(distance), self._following
        walls, moved_walls = vertices[following] - vertices, moved[following] - moved
        is_turned = (walls * moved_walls).sum(axis=1) < 0
        is_point = (self.points[following] == self.points).all(axis=1)
        before, after = walls[np.argsort(following)], walls[following]
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        return bool((is_turned & (~is_point | ((before * after).sum(axis=1) < _SHARP * lengths))).any())

    def moved_points(self, distance: float) -> Float[np.ndarray, "points 2"]:
        """The points after all walls have moved so far back, out of free space, or into it if negative.

        Points at which free space touches itself move a sixteenth as far back if no path may squeeze through: what
        is beside them is then on both sides. A wall that the lattice has made a point moves with those beside it.
        """
        following, points = self._following, self.positions
        onward = points[following] - points
        has_length = (self.points[following] != self.points).any(axis=1, keepdims=True)
        normal = np.where(has_length, left_normal(np.where(has_length, onward, 1.0)), 0.0)
        before = np.empty_like(normal)
        before[following] = normal
        mitre = (normal + before) / np.maximum(1 + (normal * before).sum(axis=1), 1e-12)[:, None]
        length = np.linalg.norm(mitre, axis=1, keepdims=True)
        mitre *= np.minimum(1, _MITRE / np.maximum(length, 1e-12))
        if distance > 0:
            mitre[self.stays] *= _OF_CONTACTS
        return points - distance * mitre

    def write(self, body: BitWriter) -> None:
        """Append the outline to a file's body."""
        body.write(np.frombuffer(np.float64(self.step).tobytes(), "<u4").astype(np.int64), 32)
        body.write(np.array([self.may_squeeze], np.int64), 1)
        sizes = np.diff(self.first)
        body.write(np.array([len(sizes)]), _COUNT_BITS).write_coded(sizes)
        for along in self.points.T:
            body.write_signed(np.diff(along, prepend=0))


def _require_few_crossings(ends: Float[np.ndarray, "walls 2 2"]) -> None:
    """Raise ``ValueError`` where walls meet beside their ends more often than there are walls."""
    import shapely

    walls: Any = shapely.linestrings(ends)
    tree: Any = shapely.STRtree(walls)
    of_ends: Any = shapely.points(np.unique(ends.reshape(-1, 2), axis=0))
    for each, predicate, most in ((walls, "crosses", 2 * len(walls)), (of_ends, "intersects", 3 * len(walls))):
        meetings = 0
        for begin in range(0, len(each), _AT_ONCE):
            meetings += tree.query(each[begin : begin + _AT_ONCE], predicate=predicate).shape[1]
            if meetings > most:
                raise ValueError(f"the {len(walls):,} walls of its outline cross one another too often")


def read_outline(body: BitReader, origin: Float[np.ndarray, "2"]) -> Outline:
    """The outline that comes next; raises ``ValueError`` if it is none."""
    step = np.frombuffer(body.read_alike(2, 32).astype("<u4").tobytes(), "<f8")[0]
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"its points are {step} apart")
    may_squeeze = bool(body.read_alike(1, 1)[0])
    num_rings = int(body.read_alike(1, _COUNT_BITS)[0])
    sizes = body.read_coded(num_rings)
    if not num_rings or sizes.min() < 3:
        raise ValueError("it has no ring of points, or one of fewer than three")
    first = np.concatenate([[0], np.cumsum(sizes)])
    points = np.stack([np.cumsum(body.read_signed(int(first[-1]))) for _ in range(2)], axis=1)
    return Outline(origin, float(step), points, first, may_squeeze)
