"""Bodies in straight motion, and the bisection of their motions until what a kernel says of them is certain.

A motion goes from one configuration to another in one unit of time: the position at constant velocity, the
heading at a constant rate along the shorter turn. Touching is no collision.

Over a piece of a motion, a body is shut off from another by an axis that stands still or rides with one of the
two: the gap along it deviates from its linear interpolation by at most an eighth of its largest second derivative,
so the smaller of the gaps at the piece's two ends, less that *bulge*, holds throughout. Bulges fall fourfold at
each bisection, and vanish for bodies that only translate, whose answer is therefore exact. A piece that is still
uncertain at the last bisection counts as a collision.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import require_time
from plr_jax.geometry.vectors import distance_to_segment, nearest_on_segment
from plr_jax.robots.robot import Robot, shorter_turn

_MAX_BISECTIONS = 12
_CORNERS = 1 << 16  # of bodies at a time, between two looks at the clock, which bounds the temporaries as well

Column: TypeAlias = Float[np.ndarray, "n"]
Columns: TypeAlias = tuple[Column, Column]


class MovingBodies(NamedTuple):
    """Bodies in straight motion, one a column. What their size holds is between a kernel and its caller."""

    size: Float[np.ndarray, "*size n"]
    x: Column
    y: Column
    theta: Column
    dx: Column
    dy: Column
    turn: Column

    @property
    def num_corners(self) -> int:
        """Corners of each, or the numbers that its size holds."""
        return len(self.size) if self.size.ndim == 2 else self.size.shape[1]

    def take(self, columns: np.ndarray | slice) -> "MovingBodies":
        """The bodies of some columns, by index, mask or slice."""
        return MovingBodies(self.size[..., columns], *(column[columns] for column in self[1:]))

    def with_size(self, size: Float[np.ndarray, "*size"]) -> "MovingBodies":
        """The same motions of bodies that all have one size."""
        return self._replace(size=np.broadcast_to(size[..., None], (*size.shape, len(self.x))))

    def bisected(self) -> "MovingBodies":
        """The first and the second half of each motion, side by side."""
        half = [0.5 * rate for rate in self[4:]]
        pose = [np.stack([q, q + rate], axis=1).ravel() for q, rate in zip(self[1:4], half, strict=True)]
        return MovingBodies(np.repeat(self.size, 2, axis=-1), *pose, *(np.repeat(rate, 2) for rate in half))


def moving_bodies(robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]) -> MovingBodies:
    """A robot's motions, their size left open; one without a heading keeps 0."""
    heading, turn = np.zeros(len(q0)), np.zeros(len(q0))
    if robot.dof == 3:
        heading, turn = q0[:, 2], shorter_turn(q0[:, 2], q1[:, 2])
    dx, dy = q1[:, 0] - q0[:, 0], q1[:, 1] - q0[:, 1]
    return MovingBodies(np.empty((0, len(q0))), q0[:, 0], q0[:, 1], heading, dx, dy, turn)


# What a kernel says: which motions certainly keep a distance, below 0 a depth of overlap, and which certainly do not.
Booleans: TypeAlias = Bool[np.ndarray, "n"]
Verdict: TypeAlias = tuple[Booleans, Booleans]
SeparationKernel: TypeAlias = Callable[[MovingBodies, MovingBodies, float], Verdict]


def bisect(
    kernel: SeparationKernel, a: MovingBodies, b: MovingBodies, reach: float, deadline: float = math.inf
) -> Booleans:
    """Whether bodies certainly keep a distance, their motions bisected until the kernel is certain.

    Below 0, ``reach`` is a depth to which they may overlap. A few are judged at a time, their halves before the
    others, so that memory stays small however many corners they have and however long they are in doubt.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    k, m = a.num_corners, b.num_corners
    # Where a distance is to be kept, every corner meets every other.
    size = max(1, _CORNERS // max(k + m, k * m if reach > 0 else 0))
    apart = np.ones(len(a.x), dtype=bool)
    waiting = [(a, b, np.arange(len(a.x)), 0)]
    while waiting:
        a, b, owner, bisections = waiting.pop()
        if len(owner) > size:
            for part in (slice(begin, begin + size) for begin in range(0, len(owner), size)):
                waiting.append((a.take(part), b.take(part), owner[part], bisections))
            continue
        require_time(deadline, "all motions were tested")
        clear, hit = kernel(a, b, reach)
        apart[owner[hit]] = False
        unsure = ~clear & apart[owner]
        if bisections == _MAX_BISECTIONS:
            apart[owner[unsure]] = False
        elif unsure.any():
            halves = a.take(unsure).bisected(), b.take(unsure).bisected()
            waiting.append((*halves, np.repeat(owner[unsure], 2), bisections + 1))
    return apart


def rotation_bounds(a: MovingBodies, b: MovingBodies, rim_a: Column, rim_b: Column) -> Columns:
    """How far below its chord a gap along an axis can be that rides with ``a``, and with ``b``.

    These are the bulges of the offset between the two and of the other body's turn, as seen from the one. Their
    rims say how far the bodies reach from their reference points.
    """
    x, y, dx, dy = b.x - a.x, b.y - a.y, b.dx - a.dx, b.dy - a.dy
    far, speed = np.maximum(np.hypot(x, y), np.hypot(x + dx, y + dy)), np.hypot(dx, dy)
    relative = (b.turn - a.turn) ** 2
    turns = (a.turn, rim_b), (b.turn, rim_a)
    of_a, of_b = ((far * turn**2 + 2 * speed * np.abs(turn) + rim * relative) / 8 for turn, rim in turns)
    return of_a, of_b


def across_motion(a: MovingBodies, b: MovingBodies) -> Columns:
    """The unit normal of the relative motion, the y axis where there is none."""
    dx, dy = b.dx - a.dx, b.dy - a.dy
    speed = np.hypot(dx, dy)
    nx = np.divide(-dy, speed, out=np.zeros_like(dx), where=speed > 0)
    return nx, np.divide(dx, speed, out=np.ones_like(dx), where=speed > 0)


# The kernels that kernel whether bodies are apart: boxes, boxes and points, and convex bodies of any kind.


# The kernel for convex bodies of any number of vertices, whose distance is that of their Minkowski difference.


Sides = Float[np.ndarray, "sides n"]
Corners = Float[np.ndarray, "2 _ n"]
Ends = tuple[tuple[Corners, Corners], tuple[Corners, Corners]]

_FEW = 24  # corners up to which the lowest is sought among all


def convex_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Verdict:
    """Two convex bodies, given by their vertices ``(2, vertices)`` in their own frames, counterclockwise.

    The axes: normal to the sides of both, which ride with them; across the relative motion; and, where a distance is
    to be kept, through the two points at which they are nearest to one another. The last one is what keeps corners
    apart from corners, and makes the answer exact where nothing turns.
    """
    ends = _corners_at(a, b, 0.0), _corners_at(a, b, 1.0)
    gaps = [[_side_gaps(p, q), _side_gaps(q, p)] for p, q in ends]
    rim_a, rim_b = (np.hypot(*body.size).max(axis=0) for body in (a, b))
    bulge = (rim_a * a.turn**2 + rim_b * b.turn**2) / 8
    nx, ny = across_motion(a, b)
    gap = np.maximum(_smaller_gap(ends, nx, ny), _smaller_gap(ends, -nx, -ny)) - bulge
    for first, last, riding in zip(*gaps, rotation_bounds(a, b, rim_a, rim_b), strict=True):
        gap = np.maximum(gap, np.minimum(first, last).max(axis=0, initial=-np.inf) - riding)
    separation = [np.concatenate(each) for each in gaps]
    separation = [each.max(axis=0) if len(each) else np.zeros(len(a.x)) for each in separation]
    if reach > 0:
        (nx, ny), distances = _nearest(ends)
        gap = np.maximum(gap, _smaller_gap(ends, nx, ny) - bulge)
        separation = [np.where(depth < 0, depth, d) for depth, d in zip(separation, distances, strict=True)]
    clear = gap >= reach
    return clear, (np.minimum(*separation) < reach) | ((a.turn == 0) & (b.turn == 0) & ~clear)


def _corners_at(a: MovingBodies, b: MovingBodies, end: float) -> tuple[Corners, Corners]:
    """Corners of both at one end of each motion, seen from the first's reference point."""
    turned = []
    for body in (a, b):
        (c, s), (x, y) = _heading(body, end), body.size
        turned.append(np.stack([c * x - s * y, s * x + c * y]))
    return turned[0], turned[1] + np.stack(_offset(a, b, end))[:, None]


def _heading(body: MovingBodies, end: float) -> Columns:
    """Cosine and sine of the heading at the first (0) or last (1) end of each motion."""
    theta = body.theta + end * body.turn
    return np.cos(theta), np.sin(theta)


def _offset(a: MovingBodies, b: MovingBodies, end: float) -> Columns:
    """Where the second's reference point is, seen from the first's, at one end of each motion."""
    return b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)


def _side_gaps(p: Corners, q: Corners) -> Sides:
    """Gap between two bodies along the normal of each side of the first; a single corner has no sides."""
    sides = p.shape[1] if p.shape[1] > 1 else 0
    dx, dy = (np.roll(p, -1, axis=1) - p)[:, :sides]
    length = np.hypot(dx, dy)
    nx, ny = dy / length, -dx / length
    return _lowest(q, nx, ny) - nx * p[0, :sides] - ny * p[1, :sides]


def _lowest(q: Corners, nx: Sides, ny: Sides) -> Sides:
    """How far the corners of a body reach down along some directions: the least of their products with each."""
    num_corners, n = q.shape[1:]
    stride = 1 << ((num_corners - 1) // _FEW).bit_length()
    heights = nx[:, None] * q[0, ::stride] + ny[:, None] * q[1, ::stride]
    if stride == 1:
        return heights.min(axis=1)
    # Around a convex body heights fall and rise once: the lowest is less than a stride from the lowest of every few.
    corner, (x, y) = stride * heights.argmin(axis=1), q.reshape(2, -1)
    while stride > 1:
        stride //= 2
        near = np.stack([corner, corner - stride, corner + stride]) % num_corners
        at = near * n + np.arange(n)
        best = (nx * x[at] + ny * y[at]).argmin(axis=0)[None]
        corner = np.take_along_axis(near, best, axis=0)[0]
    at = corner * n + np.arange(n)
    return nx * x[at] + ny * y[at]


def _smaller_gap(ends: Ends, nx: Column, ny: Column) -> Column:
    """The smaller of the gaps at both ends along a direction from the first body to the second."""
    gaps = [(nx * q[0] + ny * q[1]).min(axis=0) - (nx * p[0] + ny * p[1]).max(axis=0) for p, q in ends]
    return np.minimum(*gaps)


def _nearest(ends: Ends) -> tuple[Columns, Columns]:
    """The direction in which bodies come nearest to one another, and their distances at both ends.

    The Minkowski difference of bodies that are apart, swept by a translation, is nearest to the origin on an edge: a
    side of the one less a corner of the other, at either end, or the way of a corner less a corner.
    """
    first, last = (q[:, None] - p[:, :, None] for p, q in ends)
    at_ends = [[nearest_on_segment(*w, *(np.roll(w, -1, axis=axis) - w)) for axis in (1, 2)] for w in (first, last)]
    between = nearest_on_segment(*first, *(last - first))
    _, k, m, n = first.shape
    points = np.array([*at_ends[0], *at_ends[1], between]).swapaxes(0, 1).reshape(2, 5 * k * m, n)
    squared = (points * points).sum(axis=0)
    x, y = np.take_along_axis(points, squared.argmin(axis=0)[None, None], axis=1)[:, 0]
    distances = [np.sqrt(part.min(axis=0)) for part in (squared[: 2 * k * m], squared[2 * k * m : 4 * k * m])]
    length = np.hypot(x, y)
    nx = np.divide(x, length, out=np.ones_like(x), where=length > 0)
    return (nx, np.divide(y, length, out=np.zeros_like(y), where=length > 0)), (distances[0], distances[1])


def box_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Verdict:
    """Two boxes and a depth of overlap: axes along the sides of both, and across their relative motion."""
    headings = [(_heading(a, end), _heading(b, end)) for end in (0.0, 1.0)]
    first, last = (_along_sides(a, b, end, *headings[int(end)]) for end in (0.0, 1.0))
    rim_a, rim_b = np.hypot(*a.size), np.hypot(*b.size)
    of_a, of_b = rotation_bounds(a, b, rim_a, rim_b)
    nx, ny = across_motion(a, b)
    supports = [_support(a, at_a, nx, ny) + _support(b, at_b, nx, ny) for at_a, at_b in headings]
    bulge = (rim_a * a.turn**2 + rim_b * b.turn**2) / 8
    gap = np.abs(nx * (b.x - a.x) + ny * (b.y - a.y)) - np.maximum(*supports) - bulge
    for (u0, support0), (u1, support1), bulge in zip(first, last, (of_a, of_a, of_b, of_b), strict=True):
        # The same side at both ends: the axis does not change its sense within the piece.
        along = np.minimum(np.abs(u0) - support0, np.where(u0 < 0, -u1, u1) - support1)
        gap = np.maximum(gap, along - bulge)
    clear = gap >= reach
    # At a single time, the sides' axes decide.
    separation = np.minimum(*(np.max([np.abs(u) - support for u, support in axes], axis=0) for axes in (first, last)))
    return clear, (separation < reach) | ((a.turn == 0) & (b.turn == 0) & ~clear)


def box_point_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Verdict:
    """A box and a point, seen from the box: that is at rest, and the point's curve is near a segment."""
    ends, distances = [], []
    for end in (0.0, 1.0):
        (x, y), (c, s) = _offset(a, b, end), _heading(a, end)
        u, v = c * x + s * y, c * y - s * x
        ends += [u, v]
        # Signed distance of the point to the box, negative inside.
        beside, above = np.abs(u) - a.size[0], np.abs(v) - a.size[1]
        distances.append(
            np.hypot(np.maximum(beside, 0), np.maximum(above, 0)) + np.minimum(np.maximum(beside, above), 0)
        )
    bulge, _ = rotation_bounds(a, b, *b.size)  # a point has no rim
    nearer = np.minimum(*distances)
    clear = np.minimum(nearer, _distance_of_chord(*ends, *a.size)) >= reach + bulge
    return clear, (nearer < reach) | ((a.turn == 0) & ~clear)


def _along_sides(a: MovingBodies, b: MovingBodies, end: float, at_a: Columns, at_b: Columns) -> list[Columns]:
    """Offset of the centers, and what the bodies fill of it, along two sides of ``a`` and two of ``b``."""
    (ca, sa), (cb, sb), (length_a, width_a), (length_b, width_b) = at_a, at_b, a.size, b.size
    c, s = np.abs(ca * cb + sa * sb), np.abs(ca * sb - sa * cb)
    x, y = _offset(a, b, end)
    return [
        (ca * x + sa * y, length_a + length_b * c + width_b * s),
        (ca * y - sa * x, width_a + length_b * s + width_b * c),
        (cb * x + sb * y, length_b + length_a * c + width_a * s),
        (cb * y - sb * x, width_b + length_a * s + width_a * c),
    ]


def _support(body: MovingBodies, heading: Columns, nx: Column, ny: Column) -> Column:
    """How far a box reaches from its center along a direction."""
    (c, s), (half_length, half_width) = heading, body.size
    return half_length * np.abs(c * nx + s * ny) + half_width * np.abs(c * ny - s * nx)


def _distance_of_chord(x0: Column, y0: Column, x1: Column, y1: Column, half_x: Column, half_y: Column) -> Column:
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
