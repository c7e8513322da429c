"""Collision of two robots along simultaneous straight motions, by the kernel that fits what both are."""

import math

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._deadline import require_time
from plr_jax.collision.boxes import judge_box_and_point, judge_boxes, judge_point_and_box
from plr_jax.collision.convex import judge_convex
from plr_jax.collision.moving import Judge, bisect, moving
from plr_jax.geometry.vectors import distance_to_segment
from plr_jax.robots.robot import Robot

_MOST, _CHUNK = 1 << 18, 1 << 13  # pairs of motions at a time: whose circles are compared, that are gathered


def motions_apart(
    robot_a: Robot,
    a0: Float[np.ndarray, "*#batch dof_a"],
    a1: Float[np.ndarray, "*#batch dof_a"],
    robot_b: Robot,
    b0: Float[np.ndarray, "*#batch dof_b"],
    b1: Float[np.ndarray, "*#batch dof_b"],
    tolerance: float,
    deadline: float = math.inf,
) -> Bool[np.ndarray, "*batch"]:
    """Whether two robots stay clear of one another while both move, from ``a0`` to ``a1`` and from ``b0`` to ``b1``.

    The batch shapes broadcast, so that every motion of one robot can be tested against every motion of the
    other without copies of either. An overlap as deep as the tolerance, ``Workspace.tolerance``, is touching.

    Returns:
        True where they at most touch. Exact for two round robots, and where nothing turns; else a motion that
        comes within about 1e-7 of a turning robot's size to a collision may be refused, and one that collides
        never passes.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    require_time(deadline, "all motions were tested")
    motions = a0, a1, b0, b1
    batch = np.broadcast(*(q[..., 0] for q in motions))
    if batch.size > _MOST and batch.shape[0] > 1:
        size, apart = max(1, _MOST * batch.shape[0] // batch.size), np.empty(batch.shape, dtype=bool)
        for begin in range(0, batch.shape[0], size):
            rows = slice(begin, begin + size)
            a0, a1, b0, b1 = (q[rows] if q.ndim > batch.ndim and len(q) > 1 else q for q in motions)
            apart[rows] = motions_apart(robot_a, a0, a1, robot_b, b0, b1, tolerance, deadline)
        return apart
    x, y = b0[..., 0] - a0[..., 0], b0[..., 1] - a0[..., 1]
    dx, dy = b1[..., 0] - a1[..., 0] - x, b1[..., 1] - a1[..., 1] - y
    distance = np.asarray(distance_to_segment(x, y, dx, dy))  # of the reference points, where it is least
    outer = robot_a.circumscribed_radius + robot_b.circumscribed_radius
    inner = robot_a.inscribed_radius + robot_b.inscribed_radius
    apart = distance >= outer - tolerance
    if inner == outer:  # both are round
        return apart
    where = np.nonzero(~apart & (distance >= inner - tolerance))
    reach = robot_a.rounding + robot_b.rounding - tolerance
    judge, size_a, size_b = _kernel(robot_a, robot_b, reach)
    for begin in range(0, len(where[0]), _CHUNK):
        rows = tuple(index[begin : begin + _CHUNK] for index in where)
        qa0, qa1, qb0, qb1 = (np.broadcast_to(q, (*apart.shape, q.shape[-1]))[rows] for q in (a0, a1, b0, b1))
        a, b = moving(robot_a, qa0, qa1).sized(size_a), moving(robot_b, qb0, qb1).sized(size_b)
        apart[rows] = bisect(judge, a, b, reach, deadline)
    return apart


def _kernel(robot_a: Robot, robot_b: Robot, reach: float) -> tuple[Judge, np.ndarray, np.ndarray]:
    """The fastest kernel that answers for two robots, and their sizes as it takes them."""
    half_a, half_b = robot_a.half_sides, robot_b.half_sides
    if half_a is None or half_b is None:
        return judge_convex, robot_a.core.T, robot_b.core.T
    if not half_b.any():
        return judge_box_and_point, half_a, half_b
    if not half_a.any():
        return judge_point_and_box, half_a, half_b
    if reach <= 0:
        return judge_boxes, half_a, half_b
    return judge_convex, robot_a.core.T, robot_b.core.T
