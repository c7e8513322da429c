"""Collision of two robots along simultaneous straight motions, one kernel for each pair of shapes.

A motion goes from one configuration to another in one unit of time: the position at constant velocity, the
heading at a constant rate along the shorter turn. Touching is no collision.

Two round robots are decided by a closed form. With a rectangle, a motion is bisected until each piece is
certain. Over a piece, a body is shut off from the other by an axis that rides with one of the two: the gap
along it deviates from its linear interpolation by at most an eighth of its largest second derivative, so the
smaller of the gaps at the piece's two ends, less that *bulge*, holds throughout. Bulges fall fourfold at each
bisection, and vanish for bodies that only translate, whose answer is therefore exact. A piece that is still
uncertain at the last bisection counts as a collision.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.robots.robot import DiscRobot, PointRobot, RectangleRobot, Robot, shorter_turn

_MAX_BISECTIONS = 12
_CHUNK = 1 << 13  # pairs of motions at a time, whose temporaries stay in cache


Column: TypeAlias = Float[np.ndarray, "n"]


class Bodies(NamedTuple):
    """Rectangles in straight motion, one a row; flat ones are segments, those of no size are points."""

    half_length: Column
    half_width: Column
    x: Column
    y: Column
    theta: Column
    dx: Column
    dy: Column
    turn: Column

    def take(self, rows: np.ndarray) -> "Bodies":
        """The bodies of some rows, by index or mask."""
        return Bodies(*(column[rows] for column in self))

    def bisected(self) -> "Bodies":
        """The first and the second half of each motion, side by side."""
        half = [0.5 * rate for rate in (self.dx, self.dy, self.turn)]
        sizes = [np.repeat(size, 2) for size in self[:2]]
        pose = [np.stack([q, q + rate], axis=1).ravel() for q, rate in zip(self[2:5], half, strict=True)]
        return Bodies(*sizes, *pose, *(np.repeat(rate, 2) for rate in half))


def bodies_of(robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]) -> Bodies:
    """The rectangles of motions; a round robot's is its center."""
    n = len(q0)
    length, width = (robot.length, robot.width) if isinstance(robot, RectangleRobot) else (0.0, 0.0)
    heading, turn = np.zeros(n), np.zeros(n)
    if isinstance(robot, RectangleRobot):
        heading, turn = q0[:, 2], shorter_turn(q0[:, 2], q1[:, 2])
    dx, dy = q1[:, 0] - q0[:, 0], q1[:, 1] - q0[:, 1]
    return Bodies(np.full(n, length / 2), np.full(n, width / 2), q0[:, 0], q0[:, 1], heading, dx, dy, turn)


def motions_apart(
    robot_a: Robot,
    a0: Float[np.ndarray, "*#batch dof_a"],
    a1: Float[np.ndarray, "*#batch dof_a"],
    robot_b: Robot,
    b0: Float[np.ndarray, "*#batch dof_b"],
    b1: Float[np.ndarray, "*#batch dof_b"],
    tolerance: float,
) -> Bool[np.ndarray, "*batch"]:
    """Whether two robots stay clear of one another while both move.

    The batch shapes broadcast, so that every motion of one robot can be tested against every motion of the
    other without copies of either.

    Args:
        robot_a: One robot.
        a0: Its configurations at the start of the motions, finite.
        a1: Its configurations at the end.
        robot_b: The other robot.
        b0: Its configurations at the start.
        b1: Its configurations at the end.
        tolerance: Depth of overlap that still counts as touching, ``Workspace.tolerance``.

    Returns:
        True where they at most touch. Exact for two round robots, and where no rectangle turns; else a
        motion that comes within about 1e-7 of a turning rectangle's size to a collision may be refused,
        and one that collides never passes.
    """
    distance = _closest_approach(a0, a1, b0, b1)
    apart = distance >= robot_a.circumscribed_radius + robot_b.circumscribed_radius - tolerance
    judge = _PAIRS[type(robot_a), type(robot_b)]
    if judge is None:
        return apart
    unsure = ~apart & (distance >= robot_a.inscribed_radius + robot_b.inscribed_radius - tolerance)
    where = np.nonzero(unsure)
    for begin in range(0, len(where[0]), _CHUNK):
        rows = tuple(index[begin : begin + _CHUNK] for index in where)
        chosen = (np.broadcast_to(q, (*apart.shape, q.shape[-1]))[rows] for q in (a0, a1, b0, b1))
        qa0, qa1, qb0, qb1 = chosen
        a, b = bodies_of(robot_a, qa0, qa1), bodies_of(robot_b, qb0, qb1)
        apart[rows] = bisect(judge, a, b, _roundness(robot_a) + _roundness(robot_b) - tolerance)
    return apart


Judge: TypeAlias = Callable[[Bodies, Bodies, float], tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]]
"""Which motions certainly keep a distance and which certainly do not."""


def bisect(judge: Judge, a: Bodies, b: Bodies, reach: float) -> Bool[np.ndarray, "n"]:
    """Whether bodies keep a distance, their motions bisected until that is certain.

    Args:
        judge: The kernel.
        a: Bodies of the kind that the kernel takes first.
        b: The others, as many.
        reach: The distance; below 0 a depth to which they may overlap.

    Returns:
        True where they certainly do.
    """
    apart, owner = np.ones(len(a.x), dtype=bool), np.arange(len(a.x))
    for bisections in range(_MAX_BISECTIONS + 1):
        clear, hit = judge(a, b, reach)
        apart[owner[hit]] = False
        unsure = ~clear & apart[owner]
        if not unsure.any():
            break
        if bisections == _MAX_BISECTIONS:
            apart[owner[unsure]] = False
            break
        a, b, owner = a.take(unsure).bisected(), b.take(unsure).bisected(), np.repeat(owner[unsure], 2)
    return apart


def judge_boxes(a: Bodies, b: Bodies, reach: float) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Two rectangles: separating axes along the sides of both, and across their relative motion."""
    headings = [(_heading(a, end), _heading(b, end)) for end in (0.0, 1.0)]
    first, last = (_along_sides(a, b, end, *headings[int(end)]) for end in (0.0, 1.0))
    gap = _gap_across(a, b, headings)
    for (u0, support0), (u1, support1), bulge in zip(first, last, _side_bulges(a, b), strict=True):
        # The same side at both ends: the axis does not change its sense within the piece.
        along = np.minimum(np.abs(u0) - support0, np.where(u0 < 0, -u1, u1) - support1)
        gap = np.maximum(gap, along - bulge)
    clear = gap >= reach
    # At a single time, the sides' axes decide.
    overlap = [np.max([np.abs(u) - support for u, support in axes], axis=0) < reach for axes in (first, last)]
    exact = (a.turn == 0) & (b.turn == 0)
    return clear, overlap[0] | overlap[1] | (exact & ~clear)


def _heading(body: Bodies, end: float) -> tuple[Column, Column]:
    """Cosine and sine of the heading at the first (0) or last (1) end of each motion."""
    theta = body.theta + end * body.turn
    return np.cos(theta), np.sin(theta)


def _along_sides(
    a: Bodies, b: Bodies, end: float, heading_a: tuple[Column, Column], heading_b: tuple[Column, Column]
) -> list[tuple[Column, Column]]:
    """Offset of the centers, and what the bodies fill of it, along two sides of ``a`` and two of ``b``."""
    (ca, sa), (cb, sb) = heading_a, heading_b
    c, s = np.abs(ca * cb + sa * sb), np.abs(ca * sb - sa * cb)
    x, y = b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)
    return [
        (ca * x + sa * y, a.half_length + b.half_length * c + b.half_width * s),
        (ca * y - sa * x, a.half_width + b.half_length * s + b.half_width * c),
        (cb * x + sb * y, b.half_length + a.half_length * c + a.half_width * s),
        (cb * y - sb * x, b.half_width + a.half_length * s + a.half_width * c),
    ]


def _side_bulges(a: Bodies, b: Bodies) -> list[Column]:
    """How far below its chord the gap along each side's axis can be: of the offset, and of the other body."""
    x, y, dx, dy = b.x - a.x, b.y - a.y, b.dx - a.dx, b.dy - a.dy
    far, speed = np.maximum(np.hypot(x, y), np.hypot(x + dx, y + dy)), np.hypot(dx, dy)
    relative = (b.turn - a.turn) ** 2
    of_a, of_b = (
        (far * body.turn**2 + 2 * speed * np.abs(body.turn) + _rim(other) * relative) / 8
        for body, other in ((a, b), (b, a))
    )
    return [of_a, of_a, of_b, of_b]


def _gap_across(a: Bodies, b: Bodies, headings: list[tuple[tuple[Column, Column], tuple[Column, Column]]]) -> Column:
    """Gap along the normal of the relative motion, the x axis where there is none; a lower bound."""
    x, y, dx, dy = b.x - a.x, b.y - a.y, b.dx - a.dx, b.dy - a.dy
    speed = np.hypot(dx, dy)
    nx = np.divide(-dy, speed, out=np.ones_like(dx), where=speed > 0)
    ny = np.divide(dx, speed, out=np.zeros_like(dx), where=speed > 0)
    supports = [_support(a, of_a, nx, ny) + _support(b, of_b, nx, ny) for of_a, of_b in headings]
    bulge = (_rim(a) * a.turn**2 + _rim(b) * b.turn**2) / 8
    return np.abs(nx * x + ny * y) - np.maximum(supports[0], supports[1]) - bulge


def _support(body: Bodies, heading: tuple[Column, Column], nx: Column, ny: Column) -> Column:
    """How far a rectangle reaches from its center along a direction."""
    c, s = heading
    return body.half_length * np.abs(c * nx + s * ny) + body.half_width * np.abs(c * ny - s * nx)


def _rim(body: Bodies) -> Column:
    """Half the diagonal."""
    return np.hypot(body.half_length, body.half_width)


def judge_box_and_round(a: Bodies, b: Bodies, reach: float) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """A rectangle and a disc's center, seen from the rectangle: a box at rest and a curve near a segment."""
    dx, dy = b.dx - a.dx, b.dy - a.dy
    ends, distances, far = [], [], np.zeros(len(dx))
    for end in (0.0, 1.0):
        x, y = b.x - a.x + end * dx, b.y - a.y + end * dy
        c, s = np.cos(a.theta + end * a.turn), np.sin(a.theta + end * a.turn)
        u, v = c * x + s * y, c * y - s * x
        ends += [u, v]
        distances.append(_distance_to_box(u, v, a.half_length, a.half_width))
        far = np.maximum(far, np.hypot(x, y))
    bulge = (far * a.turn**2 + 2 * np.hypot(dx, dy) * np.abs(a.turn)) / 8
    u0, v0, u1, v1 = ends
    chord = _distance_of_chord(u0, v0, u1, v1, a.half_length, a.half_width)
    distance = np.minimum(np.minimum(distances[0], distances[1]), chord)
    clear = distance >= reach + bulge
    overlap = (distances[0] < reach) | (distances[1] < reach)
    return clear, overlap | ((a.turn == 0) & ~clear)


def judge_round_and_box(a: Bodies, b: Bodies, reach: float) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """A disc's center and a rectangle."""
    return judge_box_and_round(b, a, reach)


_PAIRS: dict[tuple[type, type], Judge | None] = {  # None: the closest approach of the centers decides
    (PointRobot, PointRobot): None,
    (PointRobot, DiscRobot): None,
    (PointRobot, RectangleRobot): judge_round_and_box,
    (DiscRobot, PointRobot): None,
    (DiscRobot, DiscRobot): None,
    (DiscRobot, RectangleRobot): judge_round_and_box,
    (RectangleRobot, PointRobot): judge_box_and_round,
    (RectangleRobot, DiscRobot): judge_box_and_round,
    (RectangleRobot, RectangleRobot): judge_boxes,
}


def _roundness(robot: Robot) -> float:
    """Radius by which a body of no corners is rounded."""
    return robot.radius if isinstance(robot, DiscRobot) else 0.0


def _closest_approach(
    a0: Float[np.ndarray, "*#batch dof_a"],
    a1: Float[np.ndarray, "*#batch dof_a"],
    b0: Float[np.ndarray, "*#batch dof_b"],
    b1: Float[np.ndarray, "*#batch dof_b"],
) -> Float[np.ndarray, "*batch"]:
    """Smallest distance of two centers that move at the same time."""
    x, y = b0[..., 0] - a0[..., 0], b0[..., 1] - a0[..., 1]
    dx, dy = b1[..., 0] - a1[..., 0] - x, b1[..., 1] - a1[..., 1] - y
    return np.asarray(distance_to_segment(x, y, dx, dy))


def distance_to_segment(
    x: Float[np.ndarray, "*#batch"],
    y: Float[np.ndarray, "*#batch"],
    dx: Float[np.ndarray, "*#batch"],
    dy: Float[np.ndarray, "*#batch"],
) -> Float[np.ndarray, "*batch"]:
    """Distance of the origin to segments that start at ``(x, y)`` and are as long as ``(dx, dy)``."""
    squared = dx * dx + dy * dy
    t = np.clip(-(x * dx + y * dy) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    x, y = x + t * dx, y + t * dy
    return np.sqrt(x * x + y * y)


def _distance_to_box(
    x: Column,
    y: Column,
    half_x: Column,
    half_y: Column,
) -> Column:
    """Signed distance of points to boxes about the origin, negative inside."""
    x, y = np.abs(x) - half_x, np.abs(y) - half_y
    return np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0)


def _distance_of_chord(
    x0: Column,
    y0: Column,
    x1: Column,
    y1: Column,
    half_x: Column,
    half_y: Column,
) -> Column:
    """Distance of the inner part of segments to boxes about the origin; a depth, negative, where they cross."""
    dx, dy = x1 - x0, y1 - y0
    corners = [distance_to_segment(x0 - sx * half_x, y0 - sy * half_y, dx, dy) for sx in (-1, 1) for sy in (-1, 1)]
    length = np.hypot(dx, dy)
    across = np.abs(x0 * dy - y0 * dx) - half_x * np.abs(dy) - half_y * np.abs(dx)
    across = np.divide(across, length, out=np.full_like(length, -np.inf), where=length > 0)
    beside_x = np.maximum(np.minimum(x0, x1), -np.maximum(x0, x1)) - half_x
    beside_y = np.maximum(np.minimum(y0, y1), -np.maximum(y0, y1)) - half_y
    separation = np.maximum(np.maximum(beside_x, beside_y), across)
    return np.where(separation > 0, np.min(corners, axis=0), separation)
