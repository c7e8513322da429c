"""Collision tests of one robot with a workspace along straight motions.

A grid over the bounds stores the clearance at each cell's center, and the walls near the center. Clearance is
1-Lipschitz in the position, so clearances at centers decide most motions. The other motions are tested against the
walls near their cells or, for point robots, against all walls by ``Workspace.is_visible``.
"""

from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import batches, parts, require_time, slices, take_ragged
from plr_jax.collision.bodies import Column, MovingBodies, bisect, box_separation, convex_separation, moving_bodies
from plr_jax.geometry.vectors import distance_to_segment
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import Robot

# Batches:
_CHUNK = 1 << 14  # motions at a time, which bounds the memory
_PAIRS = 1 << 17  # pairs of pieces and edges at a time, between two checks of the clock
_CENTERS = 1 << 13  # cells at a time while the grid is built, between two checks of the clock
_EDGES_PER_POINT = 128  # estimated work for a point, in pairs; its visibility is tested among all edges
# The grid:
_CELLS = (64, 256)  # fewest and most cells along the longer side
_POINT_CELLS = 128  # cells along the longer side for a point
_PURPOSE = "all motions were tested"
Configurations: TypeAlias = Float[np.ndarray, "n dof"]
Booleans: TypeAlias = Bool[np.ndarray, " n"]


class MotionTest:
    """A test, with a deadline, whether straight motions keep a robot off obstacles and within the bounds.

    ``cells`` are the fewest and the most cells of the grid along the longer side.
    """

    def __init__(self, workspace: Workspace, robot: Robot, deadline: float = np.inf, cells: tuple[int, int] = _CELLS):
        self.workspace, self.robot = workspace, robot
        # 1. Choose cells about half as large as the robot. A robot no larger than the tolerance counts as a point.
        width = workspace.bounds.width
        self._is_point = robot.circumscribed_radius <= workspace.tolerance
        size = 0.0 if self._is_point else robot.circumscribed_radius
        cell = size / 2 or width.max() / _POINT_CELLS
        self._cell = cell = float(np.clip(cell, width.max() / cells[1], width.max() / cells[0]))
        self._shape = columns, rows = tuple(np.ceil(width / cell).astype(int).tolist())
        x, y = (lo + (np.arange(num) + 0.5) * cell for lo, num in zip(workspace.bounds.lo, self._shape, strict=True))
        centers = np.stack([np.tile(x, rows), np.repeat(y, columns)], axis=1)
        # 2. Motions are cut into pieces up to `_longest`. Within `reach` of a center are all edges that the robot can
        #    hit on a piece whose middle is in the cell: the middle is less than a cell away, the piece extends half
        #    its length from there, and the robot `size` from the piece. A point is tested by `is_visible` instead.
        self._longest = max(2 * cell, size) if size > 0 else np.inf
        reach = size + self._longest / 2 + cell if size > 0 else 0.0
        # 3. Compute the clearance at each center, and the edges within reach: cell i has the edges
        #    _edge[_first[i] : _first[i + 1]].
        counts, edges, clearance = [], [], []
        for part in batches(centers, _CENTERS):
            require_time(deadline, _PURPOSE)
            points = np.asarray(shapely.points(part))
            near, edge = workspace.edge_tree.query(points, predicate="dwithin", distance=reach)
            edges.append(edge[np.argsort(near, kind="stable")].astype(np.int32))
            counts.append(np.bincount(near, minlength=len(part)))
            clearance.append(workspace.clearance(part))
        self._first, self._edge = np.append(0, np.cumsum(np.concatenate(counts))), np.concatenate(edges)
        self._clearance = np.concatenate(clearance)

    def __call__(self, q0: Configurations, q1: Configurations, deadline: float = np.inf) -> Booleans:
        """Return whether motions between finite configurations are collision-free, up to ``workspace.tolerance``.

        The result is exact, with one exception: it may be False if a robot turns while its gap to a wall falls below
        about 1e-7 of its size. ``TimeoutError`` if the deadline passes before all motions are tested.
        """
        if len(q0) > _CHUNK:
            return np.concatenate([self(q0[rows], q1[rows], deadline) for rows in slices(len(q0), _CHUNK)])
        # Clearances at the centers of grid cells decide most motions. The other motions are tested against walls.
        # 1. Cut each motion into equal pieces no longer than `_longest`. Bound the clearance from below on each piece
        #    and, in its middle (x, y), from above.
        whole = moving_bodies(self.robot, q0, q1)
        num_pieces = np.ceil(np.hypot(whole.dx, whole.dy) / self._longest)
        pieces, motion = whole.divided(np.maximum(num_pieces, 1).astype(np.intp))
        x, y = pieces.x + 0.5 * pieces.dx, pieces.y + 0.5 * pieces.dy
        half = 0.5 * np.sqrt(pieces.dx * pieces.dx + pieces.dy * pieces.dy)  # hypot is slow
        cell, from_center = self._locate(x, y)
        clearance = self._clearance[cell]
        clear = clearance - from_center - half >= self.robot.circumscribed_radius
        may_fit = clearance + from_center >= self.robot.inscribed_radius - self.workspace.tolerance
        # 2. Test the undecided pieces against walls, in batches of about equal work.
        unsure = np.flatnonzero(~clear & may_fit)
        num_edges = self._first[cell[unsure] + 1] - self._first[cell[unsure]]
        for part in parts(np.full(len(unsure), _EDGES_PER_POINT) if self._is_point else num_edges, _PAIRS):
            require_time(deadline, _PURPOSE)
            clear[unsure[part]] = self._test_walls(pieces.take(unsure[part]), cell[unsure[part]], deadline)
        # 3. A body that no wall cuts is inside or outside. If the middle may be outside, test the center of the body
        #    there: the reference point may touch a wall.
        doubtful = unsure[clear[unsure] & (clearance[unsure] <= from_center[unsure])]
        u, v = self.robot.core.mean(axis=0)
        heading = pieces.theta[doubtful] + 0.5 * pieces.turn[doubtful]
        c, s = np.cos(heading), np.sin(heading)
        center = np.stack([x[doubtful] + c * u - s * v, y[doubtful] + s * u + c * v], axis=1)
        clear[doubtful] = self.workspace.is_free_to_tolerance(center)
        # 4. A motion is free if all its pieces are.
        free = np.ones(len(q0), dtype=bool)
        free[motion[~clear]] = False
        return free

    def is_at_contact(self, q: Float[np.ndarray, "*batch dof"]) -> Bool[np.ndarray, "*batch"]:
        """Return whether a point robot is at a contact: a point where obstacles touch, which paths may not cross.

        The result is False for robots that are larger than a point, and if ``workspace.squeeze`` lets paths lead
        through contacts.
        """
        if not self._is_point or self.workspace.squeeze:
            return np.zeros(q.shape[:-1], dtype=bool)
        points: Any = shapely.points(q[..., :2].reshape(-1, 2))
        return self.workspace.boundary.touches_contact(points, self.workspace.tolerance).reshape(q.shape[:-1])

    def has_room(self, x: Column, y: Column, radius: Column) -> Booleans:
        """Return whether the robot is certainly free for all reference points in each circle, at any heading.

        The circles have centers ``(x, y)`` and the given radii. If unsure, return False.
        """
        cell, from_center = self._locate(x, y)
        return self._clearance[cell] - from_center > radius + self.robot.circumscribed_radius

    def _locate(self, x: Column, y: Column) -> tuple[Int[np.ndarray, " n"], Column]:
        """Return the index of the grid cell of each point, and the distance from the point to the cell's center.

        Points outside the grid get a cell at its edge.
        """
        lo, (columns, rows) = self.workspace.bounds.lo, self._shape
        column = np.clip((x - lo[0]) / self._cell, 0, columns - 1).astype(np.intp)
        row = np.clip((y - lo[1]) / self._cell, 0, rows - 1).astype(np.intp)
        dx, dy = x - lo[0] - (column + 0.5) * self._cell, y - lo[1] - (row + 0.5) * self._cell
        return row * columns + column, np.sqrt(dx * dx + dy * dy)

    def _test_walls(self, pieces: MovingBodies, cell: Int[np.ndarray, " n"], deadline: float) -> Booleans:
        """Return which pieces of motions hit no wall.

        For a point robot, all walls are tested, for other robots the walls near each piece's cell.
        """
        if self._is_point:
            begin = np.stack([pieces.x, pieces.y], axis=1)
            return self.workspace.is_visible(begin, begin + np.stack([pieces.dx, pieces.dy], axis=1))
        robot, tolerance = self.robot, self.workspace.tolerance
        clear = np.ones(len(cell), dtype=bool)
        # 1. List the pairs of a piece and an edge near its cell, and compute the distance from the path of the
        #    reference point to the edge. It is 0 if they cross, else the least distance from an end of the path to
        #    the edge, or from an end of the edge to the path.
        #
        #        v
        #        |     (u + du, v + dv)       u: along the edge, from its first end
        #        |    /                       v: across the edge
        #        o===/==========o---> u
        #           (u, v)      length
        index, piece = take_ragged(self._first, cell)
        edges = self.workspace.boundary.segments[self._edge[index]]
        near = pieces.take(piece)
        tangent = edges[:, 1] - edges[:, 0]
        length = np.hypot(tangent[:, 0], tangent[:, 1])
        c, s = tangent[:, 0] / length, tangent[:, 1] / length
        x, y = near.x - edges[:, 0, 0], near.y - edges[:, 0, 1]
        u, v = c * x + s * y, c * y - s * x
        du, dv = c * near.dx + s * near.dy, c * near.dy - s * near.dx
        ends = [np.hypot(w - np.clip(w, 0.0, length), z) for w, z in ((u, v), (u + du, v + dv))]
        corners = [distance_to_segment(w, v, du, dv) for w in (u, u - length)]
        crossing = u - v * np.divide(du, dv, out=np.zeros_like(du), where=dv != 0)
        crosses = (v * (v + dv) < 0) & (crossing >= 0) & (crossing <= length)
        distance = np.where(crosses, 0.0, np.min([*ends, *corners], axis=0))
        # 2. The inscribed disc hits the edge, or the circumscribed disc misses it, or the pair is undecided.
        clear[piece[distance < robot.inscribed_radius - tolerance]] = False
        if robot.inscribed_radius == robot.circumscribed_radius:
            return clear
        # 3. Test the undecided pairs exactly. An edge is a body at rest: a flat box, or a body with two vertices.
        doubtful = np.flatnonzero((distance < robot.circumscribed_radius) & clear[piece])
        edges, tangent = edges[doubtful], tangent[doubtful]
        center, zeros = edges.mean(axis=1), np.zeros(len(doubtful))
        reach, half = robot.rounding - tolerance, robot.half_sides
        if half is not None and reach <= 0:
            kernel, size = box_separation, half
            edge_size, edge_heading = np.stack([length[doubtful] / 2, zeros]), np.arctan2(*tangent.T[::-1])
        else:
            kernel, size = convex_separation, robot.core.T
            edge_size, edge_heading = (edges - center[:, None]).transpose(2, 1, 0), zeros
        at_rest = MovingBodies(edge_size, center[:, 0], center[:, 1], edge_heading, zeros, zeros, zeros)
        keeps_off = bisect(kernel, near.take(doubtful).with_size(size), at_rest, reach, deadline)
        clear[piece[doubtful[~keeps_off]]] = False
        return clear


class IgnoredByCache(float):
    """A deadline that compares equal to every object, so that ``lru_cache`` ignores it in its keys."""

    def __eq__(self, other: object) -> bool:
        return True

    def __hash__(self) -> int:
        return 0


_cached_motion_test = lru_cache(maxsize=16)(MotionTest)


def motion_test(workspace: Workspace, robot: Robot, deadline: float = np.inf) -> MotionTest:
    return _cached_motion_test(workspace, robot, IgnoredByCache(deadline))
