"""Collision tests of a team along simultaneous straight motions: with the workspace, and between robots.

During a motion, a robot stays in a circle around the motion's midpoint. Only pairs of robots with overlapping circles
are tested exactly. The tolerance of the exact tests is larger than the rounding errors of the circles.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import IndexPairs, batches, require_time, slices
from plr_jax._types import JointConfigurations
from plr_jax.collision.bodies import bisect, box_point_separation, box_separation, convex_separation, moving_bodies
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry.vectors import distance_to_segment
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import Robot

_CHUNK = 1 << 13  # distances of circles at a time, so that temporaries stay in the processor's cache
_MOST = 1 << 18  # pairs of motions whose circles are compared at a time
_CHUNK_PAIRS = 1 << 13  # pairs of motions tested exactly at a time
OfA: TypeAlias = Float[np.ndarray, "*#batch dof_a"]
OfB: TypeAlias = Float[np.ndarray, "*#batch dof_b"]
Motions: TypeAlias = Float[np.ndarray, "m dof"]
Rows: TypeAlias = Int[np.ndarray, " m"]
Booleans: TypeAlias = Bool[np.ndarray, " m"]


class Circles(NamedTuple):
    """Circles in the plane: circle ``i`` has the center ``(x[i], y[i])`` and the radius ``radius[i]``."""

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]


class TeamTrajectory:
    """A copy of a team's path that can be changed, with a circle around each motion of each robot."""

    def __init__(self, robots: Sequence[Robot], path: Float[np.ndarray, "steps robots dof"]):
        self.path = path.copy()
        self._size = np.array([robot.circumscribed_radius for robot in robots])
        self._x, self._y, self._radius = np.empty((3, max(len(path) - 1, 0), len(robots)))
        for i in range(len(robots)):
            self.move(i, path[:, i])

    def move(self, i: int, q: Float[np.ndarray, "rows dof"], rows: slice = slice(None)) -> None:
        """Replace robot ``i``'s configurations by ``q``, in all rows of the path or only in the slice ``rows``.

        If ``rows`` is given, the first and the last configuration of ``q`` must equal the configurations that they
        replace, so that the motions before and after these rows do not change.
        """
        self.path[rows, i] = q
        motions = slice(rows.start, rows.stop - 1) if rows.stop else slice(None)
        x, y, radius = circles(q[:-1, None], q[1:, None])
        self._x[motions, i], self._y[motions, i], self._radius[motions, i] = x, y, radius + self._size[i]

    def robots_near(self, i: int, around: Circles, first_row: Rows, excluded: Sequence[int] = ()) -> IndexPairs:
        """Find the robots that robot ``i`` may meet while its reference point is in given circles.

        While robot ``j`` makes its motion from row ``first_row[k]`` of the path to the next row, the reference point
        of robot ``i`` is somewhere in circle ``k`` of ``around``. Robots ``excluded`` are left out.

        Returns:
            The indices ``k`` and ``j`` of all pairs that may meet, ordered by ``k``, then ``j``.
        """
        # Circles overlap if dx^2 + dy^2 < reach^2: compare blocks of circles with all robots.
        num_robots = len(self._size)
        near = []  # k * num_robots + j
        for block in slices(max(1, len(first_row)), max(1, _CHUNK // num_robots)):
            x, y, radius = (column[block, None] for column in around)
            row = first_row[block]
            dx, dy, reach = self._x[row] - x, self._y[row] - y, self._radius[row] + (radius + self._size[i])
            reach[:, [i, *excluded]] = 0.0
            near.append(block.start * num_robots + np.flatnonzero(dx * dx + dy * dy < reach * reach))
        return np.divmod(np.concatenate(near), num_robots)


def within_reach(robot_a: Robot, around_a: Circles, robot_b: Robot, around_b: Circles) -> Bool[np.ndarray, " n"]:
    """Return, for each ``i``, whether two robots may meet if each stays in its i-th circle.

    The reference point of ``robot_a`` stays in circles of ``around_a``, the reference point of ``robot_b`` in circles
    of ``around_b``.
    """
    reach = around_a.radius + around_b.radius + robot_a.circumscribed_radius + robot_b.circumscribed_radius
    return (around_b.x - around_a.x) ** 2 + (around_b.y - around_a.y) ** 2 < reach * reach


def circles(begin: Float[np.ndarray, "n k dof"], end: Float[np.ndarray, "n l dof"]) -> Circles:
    """Return ``n`` circles. Circle ``i`` contains all straight motions from positions ``begin[i]`` to ``end[i]``.

    A motion leads from any of the ``k`` positions ``begin[i]`` to any of the ``l`` positions ``end[i]``.
    """
    # The circle halfway between two circles that contains both: of the begins, and of the ends.
    a, b = _around(begin), _around(end)
    radius = np.hypot(b.x - a.x, b.y - a.y) / 2 + np.maximum(a.radius, b.radius)
    return Circles((a.x + b.x) / 2, (a.y + b.y) / 2, radius)


def _around(q: Float[np.ndarray, "n k dof"]) -> Circles:
    # The circles through the corners of the positions' bounding boxes. Headings do not matter.
    if q.shape[1] == 1:
        return Circles(q[:, 0, 0], q[:, 0, 1], np.zeros(len(q)))
    lo, hi = q[..., :2].min(axis=1), q[..., :2].max(axis=1)
    x, y = ((lo + hi) / 2).T
    return Circles(x, y, np.hypot(hi[:, 0] - x, hi[:, 1] - y))


def motions_apart(
    robot_a: Robot, a0: OfA, a1: OfA, robot_b: Robot, b0: OfB, b1: OfB, tolerance: float, deadline: float = np.inf
) -> Bool[np.ndarray, "*batch"]:
    """Return whether two robots stay apart while one moves from ``a0`` to ``a1`` and the other from ``b0`` to ``b1``.

    Configurations ``(..., dof)`` broadcast. Robots may overlap by up to ``tolerance``. The result is exact, with one
    exception: it may be False if a robot that is not round turns while its gap to the other robot falls below about
    1e-7 of its size.
    ``TimeoutError`` is raised if the ``deadline``, a time of ``time.perf_counter``, passes.
    """
    require_time(deadline, "all motions were tested")
    # 1. Divide large batches along their first axis.
    motions = a0, a1, b0, b1
    batch = np.broadcast(*(q[..., 0] for q in motions))
    if batch.size > _MOST and batch.shape[0] > 1:
        blocks = slices(batch.shape[0], max(1, _MOST * batch.shape[0] // batch.size))
        parts = ([q[rows] if q.ndim > batch.ndim and len(q) > 1 else q for q in motions] for rows in blocks)
        tests = (motions_apart(robot_a, a0, a1, robot_b, b0, b1, tolerance, deadline) for a0, a1, b0, b1 in parts)
        return np.concatenate([*tests])
    # 2. Compare the least distance of the reference points with the circumscribed and the inscribed radii.
    x, y = b0[..., 0] - a0[..., 0], b0[..., 1] - a0[..., 1]
    dx, dy = b1[..., 0] - a1[..., 0] - x, b1[..., 1] - a1[..., 1] - y
    distance = np.asarray(distance_to_segment(x, y, dx, dy))
    outer = robot_a.circumscribed_radius + robot_b.circumscribed_radius
    inner = robot_a.inscribed_radius + robot_b.inscribed_radius
    apart = distance >= outer - tolerance
    if inner == outer:  # two discs or points
        return apart
    where = np.nonzero(~apart & (distance >= inner - tolerance))
    # 3. Choose the fastest kernel that applies to both robots, and the sizes that it expects. Half sides are None if
    #    the robot's core is no box around its reference point, and 0 if the core is a point.
    reach = robot_a.rounding + robot_b.rounding - tolerance
    half_a, half_b = robot_a.half_sides, robot_b.half_sides
    kernel, size_a, size_b = convex_separation, robot_a.core.T, robot_b.core.T
    if half_a is not None and half_b is not None and (reach <= 0 or not (half_a.any() and half_b.any())):
        kernel = box_separation if half_a.any() and half_b.any() else box_point_separation
        size_a, size_b = half_a, half_b
    is_swapped = kernel is box_point_separation and not size_a.any()  # the box is first
    # 4. Test the undecided pairs exactly.
    for rows in zip(*(batches(index, _CHUNK_PAIRS) for index in where), strict=True):
        qa0, qa1, qb0, qb1 = (np.broadcast_to(q, (*apart.shape, q.shape[-1]))[rows] for q in (a0, a1, b0, b1))
        a, b = moving_bodies(robot_a, qa0, qa1).with_size(size_a), moving_bodies(robot_b, qb0, qb1).with_size(size_b)
        apart[rows] = bisect(kernel, *((b, a) if is_swapped else (a, b)), reach, deadline)
    return apart


class JointMotionTest:
    """A test, with a deadline, whether a whole team moves straight without hitting obstacles or one another."""

    def __init__(self, workspace: Workspace, robots: Sequence[Robot], deadline: float = np.inf):
        self.workspace, self.robots, self.deadline = workspace, robots, deadline

    @cached_property
    def wall_tests(self) -> tuple[MotionTest, ...]:
        return tuple(motion_test(self.workspace, robot, self.deadline) for robot in self.robots)

    @cached_property
    def first_equal(self) -> Int[np.ndarray, " robots"]:
        """For each robot, the lowest index of a robot of equal shape, which may be the robot's own index."""
        first: dict[Robot, int] = {}
        return np.array([first.setdefault(robot, i) for i, robot in enumerate(self.robots)])

    def __call__(self, q0: JointConfigurations, q1: JointConfigurations) -> Bool[np.ndarray, " n"]:
        free = np.ones(len(q0), dtype=bool)
        for i, test in enumerate(self.wall_tests):
            free[free] = test(q0[free, i], q1[free, i], self.deadline)
        for i, j in combinations(range(len(self.robots)), 2):
            free[free] = self.apart(i, q0[free, i], q1[free, i], j, q0[free, j], q1[free, j])
        return free

    def apart(self, i: int, a0: OfA, a1: OfA, j: int, b0: OfB, b1: OfB) -> Bool[np.ndarray, "*batch"]:
        return motions_apart(self.robots[i], a0, a1, self.robots[j], b0, b1, self.workspace.tolerance, self.deadline)

    def meet(self, i: int, begin: Motions, end: Motions, trajectory: TeamTrajectory, row: Rows, j: Rows) -> Booleans:
        """Return whether each of ``m`` motions of robot ``i`` hits another robot, which moves at the same time.

        Robot ``i`` moves from ``begin[k]`` to ``end[k]``; at the same time, robot ``j[k]`` moves from row
        ``row[k]`` of ``trajectory`` to the next row. ``result[k]`` says whether they hit each other.
        """
        others_begin, others_end = trajectory.path[row, j], trajectory.path[row + 1, j]
        result = np.empty(len(row), dtype=bool)
        for kind in set(self.first_equal[j].tolist()):
            rows = np.flatnonzero(self.first_equal[j] == kind)
            result[rows] = ~self.apart(i, begin[rows], end[rows], kind, others_begin[rows], others_end[rows])
        return result
