"""Configuration spaces of robots in a planar workspace.

``PlaneSpace`` is the space of a point or disc. ``BodySpace`` is the base class of spaces of one robot. The functions
test points, segments and Shapely shapes against the walls of a workspace.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int8

from plr_jax._arrays import as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.collision.walls import Booleans, motion_test
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import cross_product, distance_to_segment
from plr_jax.geometry.workspace import Workspace, joined_parts, require_workspace
from plr_jax.robots import PointRobot, Points, Robot
from plr_jax.spaces._space import CellState, MotionCost, as_boxes, as_motions

Links: TypeAlias = Float[np.ndarray, "n 2 2"]


def walls_within(workspace: Workspace, x: Points, radius: Float[np.ndarray, " n"]) -> Booleans:
    """Return whether the clearance of each point is at most the point's radius.

    Clearance is the signed distance to walls, negative in obstacles. For radii of at most 0, points of free space
    count as farther than the radius, even if they are on a wall.
    """
    # Most points are in free space and have a negative radius. For these, no distance is computed.
    within = ~shapely.intersects_xy(workspace.free_space, *x.T) | (radius > 0)
    within[within] = workspace.clearance(x[within]) <= radius[within]
    return within


def crosses_walls(workspace: Workspace, links: Links, reaches: Float[np.ndarray, "n 2"]) -> Booleans:
    """Return whether the segments ``links`` are proven to cross a wall, however their ends move within ``reaches``.

    ``reaches[i, k]`` is the largest distance by which end ``k`` of segment ``i`` may move. This distance must not be
    less for end 1 than for end 0.
    """
    #         a
    #          \                  The link a b still crosses the wall p q if
    #   p ------\------- q        1. a and b are on opposite sides of the wall's line, farther from it than they move;
    #            \                2. p and q are farther from the link than any of its points moves: b moves most.
    #             b
    boundary = workspace.boundary
    link, edge = workspace.edge_tree.query(shapely.linestrings(links), predicate="intersects")
    of_link, reach = links[link], reaches[link]
    heights = (of_link * boundary.normal[edge, None]).sum(axis=2) - boundary.offset[edge, None]
    crosses = (heights[:, 0] * heights[:, 1] < 0) & (np.abs(heights) > reach).all(axis=1)
    change = of_link[:, 1] - of_link[:, 0]
    for end in boundary.segments[edge].transpose(1, 0, 2):
        crosses &= distance_to_segment(*(of_link[:, 0] - end).T, *change.T) > reach[:, 1]
    return np.isin(np.arange(len(links)), link[crosses])


def segment_distances(a: Links, b: Links) -> Float[np.ndarray, " n"]:
    """Return the distance between segments ``a[i]`` and ``b[i]``; 0 if they cross."""
    # If segments do not cross, the distance is that of one of the four ends from the other segment.
    distances = []
    crosses = np.ones(len(a), dtype=bool)
    for segments, others in ((a, b), (b, a)):
        along = segments[:, 1] - segments[:, 0]
        from_ends = segments[:, :1] - others  # from both ends of the other segment to the begin of this one
        distances += [distance_to_segment(*from_end.T, *along.T) for from_end in from_ends.transpose(1, 0, 2)]
        crosses &= cross_product(along[:, None], from_ends).prod(axis=1) < 0  # the ends are on opposite sides
    return np.where(crosses, 0.0, np.min(distances, axis=0))


def near_walls(workspace: Workspace, shapes: Any, distance: float) -> Booleans:
    """Return whether Shapely shapes are at most ``distance`` from a wall; for 0, whether they touch a wall."""
    if distance > 0:
        return shapely.dwithin(workspace.walls, shapes, distance)
    return np.isin(np.arange(len(shapes)), workspace.edge_tree.query(shapes, predicate="intersects")[0])


# Share of the tolerance. Walls closer to one another than this touch: free space between them is a rounding error.
_SLIVER = 0.01


@dataclass(frozen=True)
class BodySpace:
    """The base class of the configuration spaces of one robot in a workspace.

    It tests whether configurations and motions are free.
    """

    workspace: Workspace
    robot: Robot

    def __post_init__(self):
        require_workspace(self.workspace)

    def is_free(self, q: ArrayLike) -> Booleans:
        """Return whether positions ``(n, 2)``, or poses ``(n, 3)`` with headings in radians, are free."""
        q = as_points("q", q, self.robot.dof)
        return self.are_free(q, q)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Booleans:
        """Return whether straight motions from ``q0`` to ``q1`` are proven free all the way.

        Headings turn the shorter way. The answer is exact for a point or disc. For other bodies, a turn may not be
        proven free if it comes nearer to a wall than about 1e-7 of the robot's size.
        """
        q0, q1 = as_motions(q0, q1, self.robot.dof)
        free = np.isfinite(q0 + q1).all(axis=1)
        free[free] = motion_test(self.workspace, self.robot)(q0[free], q1[free])
        return free


@dataclass(frozen=True)
class PlaneSpace(BodySpace):
    """The configuration space of a point or disc in a workspace; the cost of a motion is its length.

    The robot is a PointRobot, the default, or a DiscRobot; another robot, or one that fits nowhere, raises
    ``ValueError``. A position is free if the robot overlaps neither obstacles nor the outside of the bounds, up to
    ``workspace.tolerance``.

    The state of boxes is exact for a point. For a disc of radius ``r``, chords replace arcs around corners of
    obstacles. So near a corner, a blocked box may be MIXED if a slightly smaller disc fits at a position in the box.
    The smaller disc has the radius ``r`` minus at most the sum of two terms. One is the tolerance. The other is the
    larger of ``0.005 * r`` and ``0.0008 * (r * side**2) ** (1 / 3)``, where ``side`` is the longer side of the free
    space.
    """

    robot: Robot = field(default_factory=PointRobot)

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.robot, Robot) or self.robot.dof != 2 or len(self.robot.core) > 1:
            got = f"got {shortened(self.robot)}; use RigidBodySpace for a robot with a heading"
            raise ValueError(f"The robot of a PlaneSpace must be a point or a disc, {got}.")
        _ = self._passable  # raises if nothing is free

    @property
    def domain(self) -> Box:
        """The bounds of the workspace."""
        return self.workspace.bounds

    @property
    def motion_cost(self) -> MotionCost:
        """Euclidean length of a motion."""
        return MotionCost((((0, 1), 1.0),))

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, " n"]:
        """Tell whether boxes of positions are FREE, BLOCKED or MIXED; see :class:`CellState`.

        A box whose free part is thinner than a hundredth of ``workspace.tolerance`` is BLOCKED. For a point robot
        without ``workspace.squeeze``, no path passes between obstacles that touch in a point. Then a box that touches
        such a point is not FREE.
        """
        center, half = as_boxes(lo, hi, 2)
        # 1. If no wall is within the radius of a box, the box is all free or all blocked, as its center is. Boxes are
        #    shrunk by half the tolerance, so that a box that only touches a wall, or nearly so, may be FREE.
        boxes = _shrunk(center, half, self.workspace.tolerance / 2)
        near = np.flatnonzero(near_walls(self.workspace, boxes, self.robot.rounding))
        is_free = shapely.intersects_xy(self._passable, *center.T)
        state = np.where(is_free, CellState.FREE, CellState.BLOCKED).astype(np.int8)
        # 2. Other boxes are MIXED if they meet passable space. Boxes are shrunk, so that slivers do not count.
        boxes = _shrunk(center[near], half[near], _SLIVER * self.workspace.tolerance)
        state[near] = np.where(shapely.intersects(self._passable, boxes), CellState.MIXED, CellState.BLOCKED)
        # 3. FREE boxes that touch a contact are MIXED, since no path passes the contact.
        free = np.flatnonzero(state == CellState.FREE)
        state[free[self._touch_contacts(_shrunk(center[free], half[free], 0.0))]] = CellState.MIXED
        return state

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike) -> Booleans:
        """Return whether a point robot at ``q[i]`` is proven to see every free position of box ``i``.

        Box ``i`` reaches from ``lo[i]`` to ``hi[i]``. Its free part must be one polygon without holes, with ``q[i]``
        on the inner side of every edge. The result is False if obstacles touch at ``q[i]``, and for a disc robot.
        """
        q, _ = as_motions(q, lo, 2)
        center, half = as_boxes(lo, hi, 2)
        sees = np.zeros(len(q), dtype=bool)
        if self.robot.circumscribed_radius > 0:
            return sees
        # 1. Find the boxes whose free part is one polygon without holes.
        parts: Any = shapely.intersection(self.workspace.free_space, _shrunk(center, half, 0.0))
        whole = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
        whole &= shapely.get_num_interior_rings(parts) == 0
        # 2. Measure the height of q over the line of each edge, positive on the polygon's side, and the least height.
        rings: Any = shapely.get_exterior_ring(parts[whole])
        vertices, ring = shapely.get_coordinates(rings, return_index=True)
        edge = np.flatnonzero(ring[1:] == ring[:-1])
        along = vertices[edge + 1] - vertices[edge]
        to_q = q[whole][ring[edge]] - vertices[edge]
        inward = np.where(shapely.is_ccw(rings), 1.0, -1.0)[ring[edge]]
        height = inward * cross_product(along, to_q) / np.maximum(np.hypot(*along.T), np.finfo(float).tiny)
        least = np.full(np.count_nonzero(whole), np.inf)
        np.minimum.at(least, ring[edge], height)
        sees[whole] = least >= -self.workspace.tolerance / 2
        return sees & ~self._touch_contacts(shapely.points(q))

    def separated(self, q: ArrayLike) -> "tuple[PlaneSpace, PlaneSpace | None]":
        """Divide the space in two parts, each a space of its own: polygons of free space near ``q``, and all others.

        ``q`` has positions ``(n, 2)``. The first part has the polygons within twice ``workspace.tolerance`` of a
        position. For a point robot with ``workspace.squeeze``, it also has all polygons that a chain of touching
        polygons joins to them. If one part has no polygon, return the space itself and None.
        """
        polygons = shapely.get_parts(self._passable)
        may_squeeze = self.robot.circumscribed_radius == 0 and self.workspace.squeeze
        holds = joined_parts(polygons, as_points("q", q, 2), 2 * self.workspace.tolerance, may_squeeze)
        if holds.all() or not holds.any():
            return self, None
        holding, rest = (shapely.MultiPolygon(polygons[some].tolist()) for some in (holds, ~holds))
        return _PlanePart(self.workspace, self.robot, holding), _PlanePart(self.workspace, self.robot, rest)

    def _touch_contacts(self, shapes: Any) -> Booleans:
        """Return whether each shape touches a *contact*, a point where obstacles touch.

        If the robot may pass between touching obstacles, or is a disc, the result is False.
        """
        if self.robot.circumscribed_radius > 0 or self.workspace.squeeze:
            return np.zeros(len(shapes), dtype=bool)
        return self.workspace.boundary.touches_contact(shapes, self.workspace.tolerance)

    @cached_property
    def _passable(self) -> Any:
        # Inflate by less than the radius, so that passages exactly as wide as a disc stay open.
        passable = self.workspace.inflate(max(0.0, self.robot.rounding - self.workspace.tolerance)).free_space
        shapely.prepare(passable)
        return passable


@dataclass(frozen=True)
class _PlanePart(PlaneSpace):
    """A part of a :class:`PlaneSpace`, with only the polygons ``region`` of its free space."""

    region: Any = None

    @cached_property
    def _passable(self) -> Any:
        shapely.prepare(self.region)
        return self.region

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Booleans:
        free = super().are_free(q0, q1)
        # A free motion stays in the polygon in which it begins.
        points: Any = shapely.points(np.asarray(q0, np.float64)[free])
        free[free] = shapely.dwithin(self._passable, points, 2 * self.workspace.tolerance)
        return free


def _shrunk(center: Points, half: Points, margin: float) -> Any:
    # Shrink by the margin on each side, but at most to half the width, so that thin boxes keep an inside.
    half = np.maximum(half - margin, half / 2)
    return shapely.box(*(center - half).T, *(center + half).T)
