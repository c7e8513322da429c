"""The configuration space of a rigid body in the plane, SE(2): positions and headings."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int8

from plr_jax._arrays import as_finite, shortened
from plr_jax._types import ArrayLike
from plr_jax.collision.walls import motion_test
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import Robot, check_body, side_offsets
from plr_jax.spaces._plane import BodySpace, Booleans, PlaneSpace, near_walls, walls_within
from plr_jax.spaces._space import MotionCost, as_boxes, states_of_boxes

# Radians. If the headings of a box differ by less than this from the middle heading, a polygon encloses the body at
# all headings, else its circumscribed circle does.
_WIDEST_ARC = np.pi / 3
_POINTS = 1 << 19  # corners of hulls in a batch, which bounds the memory
Boxes: TypeAlias = Float[np.ndarray, "n 3"]
Points: TypeAlias = Float[np.ndarray, "*#n k 2"]


@dataclass(frozen=True)
class RigidBodySpace(BodySpace):
    """The configuration space of a rigid body in a workspace; a motion costs its length plus its weighted turn.

    A configuration is free if the body overlaps neither obstacles nor the outside of the bounds, up to
    ``workspace.tolerance``. Headings count modulo a full turn. Classification of boxes is conservative (MIXED if in
    doubt), and tighter for smaller boxes. The robot must have a heading, as a RectangleRobot or a PolygonRobot, else
    ``ValueError``. A turn by one radian costs ``rotation_weight`` workspace units, positive, by default the robot's
    circumscribed radius.
    """

    rotation_weight: float | int | None = None

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.robot, Robot) or self.robot.dof != 3:
            got = f"got {shortened(self.robot)}; use PlaneSpace for a point or a disc"
            raise ValueError(f"The robot of a RigidBodySpace must have a heading, such as a RectangleRobot, {got}.")
        check_body("The robot of a RigidBodySpace", self.robot)
        if self.rotation_weight is not None:
            as_finite("rotation_weight", self.rotation_weight, positive=True)

    @property
    def domain(self) -> Box:
        """The bounds of the workspace, and headings from ``-pi`` to ``pi``, which are periodic."""
        bounds = self.workspace.bounds
        return Box((*bounds.lo, -np.pi), (*bounds.hi, np.pi), periodic=(False, False, True))

    @property
    def motion_cost(self) -> MotionCost:
        """Length of a motion, plus its turn in radians times the rotation weight."""
        weight = self.robot.circumscribed_radius if self.rotation_weight is None else self.rotation_weight
        return MotionCost((((0, 1), 1.0), ((2,), weight)))

    def separated(self, q: ArrayLike) -> "tuple[RigidBodySpace, RigidBodySpace | None]":
        """Divide the space in two by the polygons of free space.

        The first part has the polygons that contain the body at a configuration in ``q``, the second part has all
        other polygons. Return each part as a space of its own. If one part has no polygon, or the body might pass
        between obstacles that touch, return the space itself and None.
        """
        plane, other_plane = PlaneSpace(self.workspace).separated(np.asarray(q)[:, :2])
        # A segment may pass lengthwise where obstacles touch. A reference point that is outside the body, by
        # rounding, does not tell in which polygon the body is.
        if other_plane is None or self.robot.breadth == 0 or self.robot.inscribed_radius < 0:
            return self, None
        bounds, squeeze = self.workspace.bounds, self.workspace.squeeze
        part, rest = (Workspace._from_free_space(bounds, each._passable, squeeze) for each in (plane, other_plane))
        return replace(self, workspace=part), replace(self, workspace=rest)

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, " n"]:
        """Tell whether boxes of positions and headings (radians) are FREE, BLOCKED or MIXED (:class:`CellState`)."""
        center, half = as_boxes(lo, hi, 3)
        # 1. A body far from all walls is free. This test is fast.
        reach = _motion_bounds(half, 0.0)  # of the reference point; `has_room` allows any heading
        has_room = motion_test(self.workspace, self.robot).has_room(center[:, 0], center[:, 1], reach)
        # 2. Enclose what the body covers in the other boxes, batch by batch. A core of k vertices leads to hulls
        #    of 4 * (2 * k + 1) points.
        at_once = max(1, _POINTS // (8 * len(self.robot.core) + 4))
        return states_of_boxes(self, center, half, np.flatnonzero(~has_room), at_once)

    def _boxes_are_free(self, center: Boxes, half: Boxes) -> Booleans:
        """Return whether each box of positions and headings is proven free.

        The boxes reach from ``center - half`` to ``center + half``.
        """
        # 1. A box is free if its center is in free space, and no wall meets a connected set that contains the center
        #    and all that the body covers. Where headings change much, this set has all points within the
        #    circumscribed radius of a position.
        free = shapely.intersects_xy(self.workspace.free_space, *center[:, :2].T)
        narrow = np.flatnonzero(free & (half[:, 2] < _WIDEST_ARC))
        wide = np.flatnonzero(free & (half[:, 2] >= _WIDEST_ARC))
        positions = shapely.box(*(center - half)[wide, :2].T, *(center + half)[wide, :2].T)
        free[wide] = ~near_walls(self.workspace, positions, self.robot.circumscribed_radius)
        # 2. Else enclose all that the core covers by a convex polygon, the hull of triangles, moved by all positions.
        #    A vertex v that turns by up to h to both sides stays in the triangle of the reference point r and both
        #    ends of its arc, moved out by 1 / cos(h): the chord of these tips is then tangent to the arc at v.
        #        tip ---- v ---- tip
        #           \           /
        #            \  h | h  /
        #             \   |   /
        #               \ r /
        #    For n boxes and a core of k vertices, r and the 2 * k tips are copied to the 4 corners of the box of
        #    positions: points (n, 2 * k + 1, 4, 2).
        q, turn = center[narrow], half[narrow, 2]
        reference = q[:, None, :2]
        ends = np.concatenate([_placed(self.robot.core, q, sign * turn) for sign in (-1, 1)], axis=1)
        tips = reference + (ends - reference) / np.cos(turn)[:, None, None]
        offsets = half[narrow, None, :2] * [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        points = np.concatenate([reference, tips], axis=1)[:, :, None] + offsets[:, None]
        hulls: Any = shapely.convex_hull(shapely.linestrings(points.reshape(len(points), 4 * points.shape[1], 2)))
        free[narrow] = ~near_walls(self.workspace, hulls, self.robot.rounding)
        return free

    def _boxes_are_blocked(self, center: Boxes, half: Boxes) -> Booleans:
        """Return whether each box of positions and headings is proven to hold no free configuration.

        The boxes reach from ``center - half`` to ``center + half``. Their centers are not free.
        """
        # 1. Scale a convex body about one of its points by 1 - m / depth of that point: the result lies within the
        #    body eroded by m. If no point of the body moves farther than m, the moved body still covers the eroded
        #    body. So if the eroded body at the center of a box is not all in free space, neither is the body at any
        #    configuration of the box. The core, which the body contains, serves as the convex body here. As a
        #    configuration with an overlap of up to the tolerance is free, the proofs ask for twice the tolerance.
        middle, depth = self._deepest_point
        erosion = _motion_bounds(half, float(np.hypot(*self.robot.core.T).max())) + 2 * self.workspace.tolerance
        is_small = erosion < depth
        scale = (1 - erosion[is_small] / depth)[:, None, None]
        eroded = _placed(middle + scale * (self.robot.core - middle), center[is_small])
        is_blocked = np.zeros(len(center), bool)
        is_blocked[is_small] = ~shapely.covers(self.workspace.free_space, shapely.polygons(eroded))
        # 2. A wall may be so near to a point of the body that the disc around the point, which moves with it, always
        #    covers it.
        for point, radius in zip(*self._probes, strict=True):
            pending = np.flatnonzero(~is_blocked)
            spare = radius - _motion_bounds(half[pending], np.hypot(*point)) - 2 * self.workspace.tolerance
            is_blocked[pending] = walls_within(self.workspace, _placed(point[None], center[pending])[:, 0], spare)
        return is_blocked

    @cached_property
    def _deepest_point(self) -> tuple[Float[np.ndarray, "2"], float]:
        """A point deep inside the polygon ``robot.core``, and its distance to the nearest side of the polygon.

        If the core is a point or a segment, the point is the core's middle, and the distance is 0.
        """
        core = self.robot.core
        if len(core) < 3:
            return core.mean(axis=0), 0.0
        # Shapely returns a segment from the center to the circle.
        middle = shapely.get_coordinates(shapely.maximum_inscribed_circle(shapely.Polygon(core)))[0]
        return middle, max(0.0, side_offsets(core, middle[None]).min())

    @cached_property
    def _probes(self) -> tuple[Float[np.ndarray, "probes 2"], Float[np.ndarray, " probes"]]:
        """Points of the body, relative to its reference point at heading 0, and for each the radius of a disc.

        The disc around the point lies in the body.
        """
        core, rounding = self.robot.core, self.robot.rounding
        # Walls beyond the disc around the deepest point may still meet the body near its corners and sides. So there
        # are discs around the core's vertices and the middles of its sides, with the radius of the rounding, and
        # larger ones halfway to these points, as the core is convex.
        middle, _ = self._deepest_point
        rim = np.concatenate([core, (core + np.roll(core, -1, axis=0)) / 2])
        points = np.concatenate([middle[None], (middle + rim) / 2, rim])
        inside = side_offsets(core, points).min(axis=0) if len(core) > 2 else np.zeros(len(points))
        depths = np.maximum(0.0, inside) + rounding
        return np.vstack([np.zeros((1, 2)), points]), np.append(self.robot.inscribed_radius, depths)


def _motion_bounds(half: Boxes, radius: float) -> Float[np.ndarray, " n"]:
    """Return how far a point of a body moves at most, ``(n,)``, while the configuration stays in a box.

    Motion is measured from the point's workspace position when the configuration is the box's center. The point is at
    distance ``radius`` from the body's reference point. ``half`` has the half widths of the boxes.
    """
    # The reference point moves by at most half a diagonal, and a turn by h moves the point by the chord
    # 2 * radius * sin(h / 2).
    return np.hypot(half[:, 0], half[:, 1]) + 2 * radius * np.sin(np.minimum(half[:, 2], np.pi) / 2)


def _placed(points: Points, q: Boxes, turn: Float[np.ndarray, " n"] | float = 0.0) -> Float[np.ndarray, "n k 2"]:
    """Return the workspace positions of a body's ``points`` at configurations ``q`` whose headings grow by ``turn``.

    ``points`` are relative to the reference point at heading 0; ``turn`` is in radians.
    """
    c, s = np.cos(q[:, 2] + turn)[:, None], np.sin(q[:, 2] + turn)[:, None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([q[:, :1] + c * x - s * y, q[:, 1:2] + s * x + c * y], axis=-1)
