"""The configuration space of a point or a disc: the plane."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.collision.walls import motion_test
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import cross_product, distance_to_segment
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.robots.robot import PointRobot, Robot
from plr_jax.spaces._space import CellState, MotionCost, as_boxes, as_motions

# What of a workspace's obstacles meets bodies: in motion, and where they are known to some distance only.


Positions: TypeAlias = Float[np.ndarray, "n 2"]
Links: TypeAlias = Float[np.ndarray, "n 2 2"]
Booleans: TypeAlias = Bool[np.ndarray, "n"]


def walls_within(workspace: Workspace, x: Positions, radius: Float[np.ndarray, "n"]) -> Booleans:
    """Whether the clearance of points is at most a radius, which may be negative."""
    # A point of free space whose radius is negative needs no distance, and most are.
    within = ~shapely.intersects_xy(workspace.free_space, *x.T) | (radius > 0)
    within[within] = workspace.clearance(x[within]) <= radius[within]
    return within


def crosses_walls(workspace: Workspace, links: Links, reaches: Positions) -> Booleans:
    """Whether segments certainly cross a wall, wherever within some reaches their ends are, the second the larger.

    The ends stay on the two sides of the wall's line, so the segment crosses it, and not beyond an end of the wall:
    it stays within the larger reach of where it is, and both ends of the wall are farther from there.
    """
    boundary = workspace.boundary
    link, edge = workspace.edge_tree.query(shapely.linestrings(links), predicate="intersects")
    of_link, reach = links[link], reaches[link]
    heights = (of_link * boundary.normal[edge, None]).sum(axis=2) - boundary.offset[edge, None]
    crosses = (heights[:, 0] * heights[:, 1] < 0) & (np.abs(heights) > reach).all(axis=1)
    change = of_link[:, 1] - of_link[:, 0]
    for end in boundary.segments[edge].transpose(1, 0, 2):
        crosses &= distance_to_segment(*(of_link[:, 0] - end).T, *change.T) > reach[:, 1]
    result = np.zeros(len(links), dtype=bool)
    result[link[crosses]] = True
    return result


def segment_distances(a: Links, b: Links) -> Float[np.ndarray, "n"]:
    """Distances of segments, zero where they cross."""
    of_a, of_b = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    pairs = [(a, of_a, b[:, 0]), (a, of_a, b[:, 1]), (b, of_b, a[:, 0]), (b, of_b, a[:, 1])]
    distances = [distance_to_segment(*(segment[:, 0] - end).T, *change.T) for segment, change, end in pairs]
    crosses = _are_on_two_sides(a, of_a, b) & _are_on_two_sides(b, of_b, a)
    return np.where(crosses, 0.0, np.min(distances, axis=0))


def _are_on_two_sides(segments: Links, change: Positions, others: Links) -> Booleans:
    """Whether the ends of other segments are strictly on the two sides of segments' lines."""
    return cross_product(change[:, None], others - segments[:, :1]).prod(axis=1) < 0


def near_walls(workspace: Workspace, shapes: Any, distance: float) -> Booleans:
    """Whether Shapely shapes are within a distance of walls, or touch them if it is 0."""
    if distance > 0:
        return shapely.dwithin(workspace.walls, shapes, distance)
    near = np.zeros(len(shapes), dtype=bool)
    near[workspace.edge_tree.query(shapes, predicate="intersects")[0]] = True
    return near


# Share of the tolerance up to which free space in a box is an error of rounding: walls touch at such distances.
_SLIVER = 0.01


@dataclass(frozen=True)
class BodySpace:
    """What the spaces of one robot in a workspace share: its motions, as its motion test judges them."""

    workspace: Workspace
    robot: Robot

    def __post_init__(self):
        require_workspace(self.workspace)

    def is_free(self, q: ArrayLike) -> Booleans:
        """Whether configurations are free.

        Args:
            q: Positions of a robot without a heading, ``(n, 2)``, or positions and headings, ``(n, 3)``, in workspace
                units and radians.

        Returns:
            True where the robot overlaps neither obstacles nor the outside of the bounds, to ``workspace.tolerance``;
            False for configurations that are not finite.

        Raises:
            ValueError: If ``q`` has another shape.
        """
        q = as_points("q", q, self.robot.dof)
        return self.are_free(q, q)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Booleans:
        """Whether straight motions, which turn the shorter way, are proven free all along.

        Args:
            q0: Where they begin, ``(n, 2)`` or ``(n, 3)``, as in :meth:`is_free`.
            q1: Where they end.

        Returns:
            True where the whole motion is free, as in :meth:`is_free`: exact for a point and a disc. False where an
            end is not finite, and for some turns within about 1e-7 of the robot's size from a wall.

        Raises:
            ValueError: If the shapes are others or differ.
        """
        q0, q1 = as_motions(q0, q1, self.robot.dof)
        free = np.isfinite(q0 + q1).all(axis=1)
        free[free] = motion_test(self.workspace, self.robot)(q0[free], q1[free])
        return free


@dataclass(frozen=True)
class PlaneSpace(BodySpace):
    """Positions of a point or of a disc in a workspace; the cost of a motion is its length.

    Free is what keeps the robot off obstacles and within the bounds, to ``workspace.tolerance``. Boxes are classified
    exactly, but for discs beside corners: there, boxes within the grown obstacle may be called MIXED up to 0.5 % of
    the radius below its rim.

    Args:
        workspace: Where the robot moves.
        robot: A PointRobot or a DiscRobot.

    Raises:
        ValueError: If the workspace is none, the robot is another, or nothing is free for it.
    """

    robot: Robot = field(default_factory=PointRobot)

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.robot, Robot) or self.robot.dof != 2 or len(self.robot.core) > 1:
            got = f"got {shortened(self.robot)}; use RigidBodySpace for one with a heading"
            raise ValueError(f"The robot of a PlaneSpace must be a point or a disc, {got}.")
        _ = self._passable  # refuses what leaves no free space

    @property
    def domain(self) -> Box:
        """The bounds of the workspace."""
        return self.workspace.bounds

    @property
    def motion_cost(self) -> MotionCost:
        """Length."""
        return MotionCost((((0, 1), 1.0),))

    def classify(self, lo: ArrayLike, hi: ArrayLike) -> Int8[np.ndarray, "n"]:
        """What is proven of boxes of positions.

        Args:
            lo: Lower corners, ``(n, 2)``, finite.
            hi: Upper corners, ``(n, 2)``, finite and nowhere below.

        Returns:
            The :class:`CellState` of each, ``(n,)``. A box in which free space is thinner than a hundredth of
            ``workspace.tolerance`` counts as BLOCKED, since walls touch that are no farther apart. One that touches
            a point in which obstacles touch is not FREE, as no path passes there from one side to the other.

        Raises:
            ValueError: If the shapes are others or differ, or corners are not those of boxes.
        """
        center, half = as_boxes(lo, hi, 2)
        # Shrunk by half the tolerance, so that what is nowhere nearer than the radius is free to the whole of it.
        boxes = _shrunk(center, half, self.workspace.tolerance / 2)
        near = np.flatnonzero(near_walls(self.workspace, boxes, self.robot.rounding))
        inside = shapely.intersects_xy(self.workspace.free_space, *center.T)
        state = np.where(inside, CellState.FREE, CellState.BLOCKED).astype(np.int8)
        boxes = _shrunk(center[near], half[near], _SLIVER * self.workspace.tolerance)
        passable = shapely.intersects(self._passable, boxes)
        state[near] = np.where(passable, CellState.MIXED, CellState.BLOCKED)
        free = np.flatnonzero(state == CellState.FREE)
        state[free[self._touch_contacts(_shrunk(center[free], half[free], 0.0))]] = CellState.MIXED
        return state

    def sees_boxes(self, q: ArrayLike, lo: ArrayLike, hi: ArrayLike) -> Booleans:
        """Whether positions are seen from everywhere in boxes that is free: proven for points, never for discs.

        Args:
            q: Positions, ``(n, 2)``, in or beside their boxes.
            lo: Lower corners of boxes, ``(n, 2)``, finite.
            hi: Upper corners, finite and nowhere below.

        Returns:
            True where the free part of the box is one polygon without holes, to every edge of which the position is
            on the inner side. False in a point in which obstacles touch.

        Raises:
            ValueError: If the shapes are others or differ, or corners are not those of boxes.
        """
        (q, _), (center, half) = as_motions(q, lo, 2), as_boxes(lo, hi, 2)
        sees = np.zeros(len(q), dtype=bool)
        if self.robot.circumscribed_radius > 0:
            return sees
        parts: Any = shapely.intersection(self.workspace.free_space, _shrunk(center, half, 0.0))
        whole = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
        whole &= shapely.get_num_interior_rings(parts) == 0
        rings: Any = shapely.get_exterior_ring(parts[whole])
        vertices, ring = shapely.get_coordinates(rings, return_index=True)
        edge = np.flatnonzero(ring[1:] == ring[:-1])
        along, to_q = vertices[edge + 1] - vertices[edge], q[whole][ring[edge]] - vertices[edge]
        inward = np.where(shapely.is_ccw(rings), 1.0, -1.0)[ring[edge]]
        depth = inward * cross_product(along, to_q)
        least = np.full(np.count_nonzero(whole), np.inf)
        np.minimum.at(least, ring[edge], depth / np.maximum(np.hypot(*along.T), np.finfo(float).tiny))
        sees[whole] = least >= -self.workspace.tolerance / 2
        return sees & ~self._touch_contacts(shapely.points(q))

    def _touch_contacts(self, shapes: Any) -> Booleans:
        """Whether Shapely shapes touch points in which obstacles touch, between which a point must not squeeze."""
        touch = np.zeros(len(shapes), dtype=bool)
        if self.robot.circumscribed_radius == 0 and not self.workspace.squeeze:
            touch[self._contacts.query(shapes, predicate="dwithin", distance=self.workspace.tolerance)[0]] = True
        return touch

    @cached_property
    def _contacts(self) -> shapely.STRtree:
        boundary = self.workspace.boundary
        contacts: Any = shapely.points(boundary.vertices[boundary.contacts])
        return shapely.STRtree(contacts)

    @cached_property
    def _passable(self) -> Any:
        """Where the robot can be at most, prepared for many queries; chords within the arcs around grown corners.

        Grown by less than the radius, so that passages exactly as wide as a disc stay open.
        """
        passable = self.workspace.inflate(max(0.0, self.robot.rounding - self.workspace.tolerance)).free_space
        shapely.prepare(passable)
        return passable


def _shrunk(center: Positions, half: Positions, margin: float) -> Any:
    """Boxes less a margin along each side, at most half of what they have, as Shapely polygons."""
    half = np.maximum(half - margin, half / 2)
    return shapely.box(*(center - half).T, *(center + half).T)
