"""Collision of one robot with a workspace along straight motions.

A grid over the bounds holds the clearance of each cell's center and the walls near it. The clearance decides
most motions at once: it changes by at most as much as one moves. The others are tested against the walls of
their cell.
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, run_members, runs
from plr_jax._deadline import require_time
from plr_jax.collision.kernels import judge_boxes, judge_convex
from plr_jax.collision.moving import MovingBodies, bisect, moving
from plr_jax.geometry.vectors import distance_to_segment
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot

# At a time, between two looks at the clock: motions; pieces of them and edges near; cells of the grid.
_CHUNK, _PAIRS, _CENTERS = 1 << 14, 1 << 17, 1 << 13
_OF_POINT = 128  # edges that count for a point, which is tested against all
_CELLS = (64, 256)  # fewest and most cells along the longer side
_POINT_CELLS = 128
_PURPOSE = "all motions were tested"


@dataclass(frozen=True, eq=False, init=False)
class MotionTest:
    """Whether straight motions of a robot are free of obstacles and within the bounds.

    The robot goes from one configuration to another at constant velocity, turning at a constant rate by
    the shorter turn. Touching is free. Configurations of a wrong shape, or not finite, raise ``ValueError``.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """

    workspace: Workspace
    robot: Robot
    _cell: float
    _shape: tuple[int, int]
    _clearance: Float[np.ndarray, "cells"]
    _first: Int[np.ndarray, "cells_and_1"]
    _edge: Int[np.ndarray, "m"]
    _longest: float

    def __init__(self, workspace: Workspace, robot: Robot, deadline: float = math.inf):
        cell, shape, centers = _grid(workspace, robot)
        # A point's walls are looked up by the workspace, whatever the length of its motion.
        size = robot.circumscribed_radius
        longest = max(2 * cell, size) if size > 0 else np.inf
        reach = size + longest / 2 + cell if size > 0 else 0.0
        first, edge = _edges_near(workspace, centers, reach, deadline)
        clearance = np.empty(len(centers))
        for begin in range(0, len(centers), _CENTERS):
            require_time(deadline, _PURPOSE)
            clearance[begin : begin + _CENTERS] = workspace.clearance(centers[begin : begin + _CENTERS])
        vars(self).update(workspace=workspace, robot=robot, _cell=cell, _shape=shape, _longest=longest)
        vars(self).update(_clearance=clearance, _first=first, _edge=edge)

    def __call__(
        self, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"], deadline: float = math.inf
    ) -> Bool[np.ndarray, "n"]:
        """Whether motions from ``q0`` to ``q1`` are free all along, to ``workspace.tolerance``.

        The heading of a robot that has none may be there or not. Exact for points and discs, and where nothing turns;
        a robot that turns may be refused within about 1e-7 of its size from a wall, and is never passed through one.

        Raises:
            TimeoutError: If the deadline passes first.
        """
        dof = (2, 3)[self.robot.dof - 2 :]
        for name, q in (("q0", q0), ("q1", q1)):
            if np.ndim(q) != 2 or np.shape(q)[1] not in dof:
                raise ValueError(f"{name} must have shape (n, {dof[0]}), got {np.shape(q)}.")
            if not np.isfinite(q).all():
                raise ValueError(f"{name} must be finite.")
        if len(q0) != len(q1):
            raise ValueError(f"Motions need as many starts as ends, got {len(q0)} and {len(q1)}.")
        free = np.empty(len(q0), dtype=bool)
        for begin in range(0, len(q0), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            free[rows] = self._test(q0[rows], q1[rows], deadline)
        return free

    def has_room(
        self, x: Float[np.ndarray, "n"], y: Float[np.ndarray, "n"], radius: Float[np.ndarray, "n"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether the robot is certainly free wherever its reference point is within circles."""
        cell, away = self._locate(x, y)
        return self._clearance[cell] - away > radius + self.robot.circumscribed_radius

    def _test(
        self, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"], deadline: float
    ) -> Bool[np.ndarray, "n"]:
        pieces, owner = _pieces(self.robot, q0, q1, self._longest)
        x, y = pieces.x + 0.5 * pieces.dx, pieces.y + 0.5 * pieces.dy
        half = 0.5 * np.sqrt(pieces.dx * pieces.dx + pieces.dy * pieces.dy)  # hypot is slow
        cell, away = self._locate(x, y)
        clearance = self._clearance[cell]
        clear = clearance - away - half >= self.robot.circumscribed_radius
        unsure = ~clear & (clearance + away >= self.robot.inscribed_radius - self.workspace.tolerance)
        unsure = np.flatnonzero(unsure)
        clear[unsure] = self._test_walls(pieces.take(unsure), cell[unsure], deadline)
        # Bodies that no wall cuts are wholly within free space or wholly outside: look where one of their points is,
        # not the reference point, which may touch a wall from either side.
        lost = unsure[clear[unsure] & (clearance[unsure] <= away[unsure])]
        (u, v), heading = self.robot.core.mean(axis=0), pieces.theta[lost] + 0.5 * pieces.turn[lost]
        c, s = np.cos(heading), np.sin(heading)
        inside = np.stack([x[lost] + c * u - s * v, y[lost] + s * u + c * v], axis=1)
        clear[lost] = self.workspace.is_free(inside)
        if owner is None:
            return clear
        free = np.ones(len(q0), dtype=bool)
        free[owner[~clear]] = False
        return free

    def _locate(
        self, x: Float[np.ndarray, "n"], y: Float[np.ndarray, "n"]
    ) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The cell of each point, the nearest one outside the grid, and the distance to its center."""
        lo, (columns, rows) = self.workspace.bounds.lo, self._shape
        column = np.clip((x - lo[0]) / self._cell, 0, columns - 1).astype(np.intp)
        row = np.clip((y - lo[1]) / self._cell, 0, rows - 1).astype(np.intp)
        dx, dy = x - lo[0] - (column + 0.5) * self._cell, y - lo[1] - (row + 0.5) * self._cell
        return row * columns + column, np.sqrt(dx * dx + dy * dy)

    def _test_walls(self, pieces: MovingBodies, cell: Int[np.ndarray, "n"], deadline: float) -> Bool[np.ndarray, "n"]:
        """Whether pieces of motions keep off the walls near their cells."""
        is_point = self.robot.circumscribed_radius == 0
        work = np.full(len(cell), _OF_POINT) if is_point else self._first[cell + 1] - self._first[cell]
        clear = np.empty(len(cell), dtype=bool)
        for part in parts(work, _PAIRS):
            require_time(deadline, _PURPOSE)
            some = pieces.take(part)
            clear[part] = self._sees(some) if is_point else self._test_edges(some, cell[part], deadline)
        return clear

    def _sees(self, pieces: MovingBodies) -> Bool[np.ndarray, "n"]:
        """Whether the ends of a point's motions see one another."""
        a = np.stack([pieces.x, pieces.y], axis=1)
        return self.workspace.is_visible(a, a + np.stack([pieces.dx, pieces.dy], axis=1))

    def _test_edges(self, pieces: MovingBodies, cell: Int[np.ndarray, "n"], deadline: float) -> Bool[np.ndarray, "n"]:
        """Whether pieces of motions keep off the edges near their cells."""
        index, piece = run_members(self._first, cell)
        edge = self._edge[index]
        distance = _distance_to_edges(pieces.take(piece), self.workspace.boundary.segments[edge])
        clear = np.ones(len(cell), dtype=bool)
        clear[piece[distance < self.robot.inscribed_radius - self.workspace.tolerance]] = False
        if self.robot.inscribed_radius < self.robot.circumscribed_radius:
            near = np.flatnonzero((distance < self.robot.circumscribed_radius) & clear[piece])
            segments = self.workspace.boundary.segments[edge[near]]
            keeps_off = self._keep_off(pieces.take(piece[near]), segments, deadline)
            clear[piece[near][~keeps_off]] = False
        return clear

    def _keep_off(
        self, pieces: MovingBodies, edges: Float[np.ndarray, "n 2 2"], deadline: float
    ) -> Bool[np.ndarray, "n"]:
        """Whether pieces of motions keep off one edge each."""
        reach, half = self.robot.rounding - self.workspace.tolerance, self.robot.half_sides
        if half is not None and reach <= 0:
            return bisect(judge_boxes, pieces.sized(half), _flat_boxes(edges), reach, deadline)
        return bisect(judge_convex, pieces.sized(self.robot.core.T), _flat_bodies(edges), reach, deadline)


@dataclass(frozen=True)
class _Key:
    """What a motion test is kept under; when to give up makes no difference to it."""

    workspace: Workspace
    robot: Robot
    deadline: float = field(compare=False)


def motion_test(workspace: Workspace, robot: Robot, deadline: float = math.inf) -> MotionTest:
    """The motion test of a robot in a workspace, kept for the next call; ``TimeoutError`` as for the class."""
    return _kept(_Key(workspace, robot, deadline))


@lru_cache(maxsize=16)
def _kept(key: _Key) -> MotionTest:
    return MotionTest(key.workspace, key.robot, key.deadline)


def _grid(workspace: Workspace, robot: Robot) -> tuple[float, tuple[int, int], Float[np.ndarray, "cells 2"]]:
    """Size of a cell, numbers of columns and rows, and the cells' centers, row by row."""
    width = workspace.bounds.width
    size = robot.circumscribed_radius / 2 or width.max() / _POINT_CELLS
    cell = float(np.clip(size, width.max() / _CELLS[1], width.max() / _CELLS[0]))
    columns, rows = np.ceil(width / cell).astype(int).tolist()
    x = workspace.bounds.lo[0] + (np.arange(columns) + 0.5) * cell
    y = workspace.bounds.lo[1] + (np.arange(rows) + 0.5) * cell
    return cell, (columns, rows), np.stack([np.tile(x, rows), np.repeat(y, columns)], axis=1)


def _edges_near(
    workspace: Workspace, centers: Float[np.ndarray, "cells 2"], reach: float, deadline: float
) -> tuple[Int[np.ndarray, "cells_and_1"], Int[np.ndarray, "m"]]:
    """Edges within reach of each center: those of cell ``i`` are ``edge[first[i]:first[i + 1]]``."""
    segments: Any = shapely.linestrings(workspace.boundary.segments)
    tree = shapely.STRtree(segments)
    counts, edges = [], []
    for begin in range(0, len(centers), _CENTERS):
        require_time(deadline, _PURPOSE)
        some: Any = shapely.points(centers[begin : begin + _CENTERS])
        cell, edge = tree.query(some, predicate="dwithin", distance=reach)
        edges.append(edge[np.argsort(cell, kind="stable")].astype(np.int32))
        counts.append(np.bincount(cell, minlength=len(some)))
    return np.append(0, np.cumsum(np.concatenate(counts))), np.concatenate(edges)


def _pieces(
    robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"], longest: float
) -> tuple[MovingBodies, Int[np.ndarray, "m"] | None]:
    """Motions cut into equal pieces no longer than ``longest``, and their motions if any was cut."""
    whole = moving(robot, q0, q1)
    count = np.ceil(np.hypot(whole.dx, whole.dy) / longest).astype(np.intp)
    if not (count > 1).any():
        return whole, None
    count = np.maximum(count, 1)
    owner, step = runs(count)
    t, share = step / count[owner], 1 / count[owner]
    whole = whole.take(owner)
    pose = [q + t * rate for q, rate in zip(whole[1:4], whole[4:], strict=True)]
    return MovingBodies(whole.size, *pose, *(rate * share for rate in whole[4:])), owner


def _distance_to_edges(pieces: MovingBodies, edges: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """Distance of the segment that each piece's center runs along to an edge, zero where they cross."""
    tangent = edges[:, 1] - edges[:, 0]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    c, s = tangent[:, 0] / length, tangent[:, 1] / length
    x, y = pieces.x - edges[:, 0, 0], pieces.y - edges[:, 0, 1]
    u, v = c * x + s * y, c * y - s * x
    du, dv = c * pieces.dx + s * pieces.dy, c * pieces.dy - s * pieces.dx
    ends = [np.hypot(w - np.clip(w, 0.0, length), z) for w, z in ((u, v), (u + du, v + dv))]
    corners = [distance_to_segment(w, v, du, dv) for w in (u, u - length)]
    crossing = u - v * np.divide(du, dv, out=np.zeros_like(du), where=dv != 0)
    crosses = (v * (v + dv) < 0) & (crossing >= 0) & (crossing <= length)
    return np.where(crosses, 0.0, np.min([*ends, *corners], axis=0))


def _flat_boxes(edges: Float[np.ndarray, "n 2 2"]) -> MovingBodies:
    """Edges at rest as boxes of no width."""
    (x, y), tangent, rest = edges.mean(axis=1).T, edges[:, 1] - edges[:, 0], np.zeros(len(edges))
    half_sides = np.stack([np.hypot(tangent[:, 0], tangent[:, 1]) / 2, rest])
    return MovingBodies(half_sides, x, y, np.arctan2(tangent[:, 1], tangent[:, 0]), rest, rest, rest)


def _flat_bodies(edges: Float[np.ndarray, "n 2 2"]) -> MovingBodies:
    """Edges at rest as bodies of two vertices."""
    center, rest = edges.mean(axis=1), np.zeros(len(edges))
    size = (edges - center[:, None]).transpose(2, 1, 0)
    return MovingBodies(size, center[:, 0], center[:, 1], rest, rest, rest, rest)
