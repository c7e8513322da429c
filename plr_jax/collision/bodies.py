"""Separation tests for convex bodies in straight motion, by bisection of the motions until a test is certain.

A motion takes one unit of time: the position moves at constant velocity, and the heading turns at a constant rate,
the shorter way. A *kernel* looks for an axis that separates two bodies during an interval of their motions. The axis
is fixed, or turns with one body. The gap along the axis deviates from its linear interpolation by at most an eighth
of its largest second derivative, called the *bulge*. So the smaller of the gaps at both ends of the interval, minus
the bulge, is a lower bound of the gap. Each bisection divides the bulge by four; the bulge is 0 if nothing turns.
Motions that stay uncertain count as collisions.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import ragged_indices, require_time, slices
from plr_jax.geometry.vectors import distance_to_segment, nearest_on_segment
from plr_jax.robots import Robot, shorter_turn

_MAX_BISECTIONS = 12  # of a motion, which divide the bulge by 4**12
_CORNERS = 1 << 16  # corners of bodies at a time, between two checks of the clock; bounds the temporary memory
_FEW = 24  # corners up to which the lowest one is searched exhaustively
Column: TypeAlias = Float[np.ndarray, " n"]
Columns: TypeAlias = tuple[Column, Column]
Kernel: TypeAlias = Callable[..., Columns]
Booleans: TypeAlias = Bool[np.ndarray, " n"]
Sides: TypeAlias = Float[np.ndarray, "sides n"]
Corners: TypeAlias = Float[np.ndarray, "2 _ n"]
# The corners of two bodies, at the begin of their motions and at the end.
Ends: TypeAlias = tuple[tuple[Corners, Corners], tuple[Corners, Corners]]


class MovingBodies(NamedTuple):
    """Convex bodies in straight motion during one unit of time; each array has one column per body.

    The pose at the begin is ``(x, y, theta)``; the change of the pose per unit of time is ``(dx, dy, turn)``.
    """

    size: Float[np.ndarray, "*size n"]  # half length and half width of boxes (2, n), or vertices (2, vertices, n)
    x: Column
    y: Column
    theta: Column
    dx: Column
    dy: Column
    turn: Column

    def take(self, columns: np.ndarray | slice) -> "MovingBodies":
        return MovingBodies(self.size[..., columns], *(column[columns] for column in self[1:]))

    def with_size(self, size: Float[np.ndarray, "*size"]) -> "MovingBodies":
        return self._replace(size=np.broadcast_to(size[..., None], (*size.shape, len(self.x))))

    def divided(self, count: Int[np.ndarray, " n"]) -> tuple["MovingBodies", Int[np.ndarray, " parts"]]:
        """Divide each motion into ``count`` equal parts; return the parts, and the index of each part's motion.

        The parts of a motion are in adjacent columns, and each is slowed down to take one unit of time.
        """
        motion, step = ragged_indices(count)
        whole, fraction = self.take(motion), 1 / count[motion]
        pose = [q + step / count[motion] * rate for q, rate in zip(whole[1:4], whole[4:], strict=True)]
        return MovingBodies(whole.size, *pose, *(rate * fraction for rate in whole[4:])), motion


def moving_bodies(robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]) -> MovingBodies:
    """Return a robot's straight motions from ``q0`` to ``q1``.

    The result has no shape yet (its ``size`` is empty): ``with_size`` adds the shape.
    """
    heading, turn = (q0[:, 2], shorter_turn(q0[:, 2], q1[:, 2])) if robot.dof == 3 else np.zeros((2, len(q0)))
    dx, dy = q1[:, 0] - q0[:, 0], q1[:, 1] - q0[:, 1]
    return MovingBodies(np.empty((0, len(q0))), q0[:, 0], q0[:, 1], heading, dx, dy, turn)


def bisect(kernel: Kernel, a: MovingBodies, b: MovingBodies, reach: float, deadline: float = np.inf) -> Booleans:
    """Return whether each body of ``a`` stays ``reach`` away from the body of ``b`` in the same column.

    The bodies move at the same time. A negative ``reach`` allows overlaps. ``kernel`` returns two gaps for each pair
    of bodies: a lower bound of the gap during the whole motion, which is tight if neither body turns, and the smaller
    of the gaps at both ends. Motions are bisected until these gaps decide. Pairs that are still uncertain after 12
    bisections count as too near. If the ``deadline``, a time of ``time.perf_counter``, passes, ``TimeoutError`` is
    raised.
    """
    num_a, num_b = a.size.shape[-2], b.size.shape[-2]  # corners
    size = max(1, _CORNERS // max(num_a + num_b, num_a * num_b if reach > 0 else 0))  # distances need all pairs
    apart = np.ones(len(a.x), dtype=bool)
    # Depth-first order in small batches bounds the memory. Entries of the stack: parts of the motions of both bodies,
    # the pair of bodies of each part, and the number of bisections.
    waiting = [(a, b, np.arange(len(a.x)), 0)]
    while waiting:
        a, b, pair, bisections = waiting.pop()
        if len(pair) > size:
            waiting += [(a.take(part), b.take(part), pair[part], bisections) for part in slices(len(pair), size)]
            continue
        require_time(deadline, "all motions were tested")
        gap, gap_at_ends = kernel(a, b, reach)
        clear = gap >= reach
        hit = (gap_at_ends < reach) | ((a.turn == 0) & (b.turn == 0) & ~clear)
        apart[pair[hit]] = False
        unsure = ~clear & apart[pair]  # nothing is left to decide for pairs that hit each other
        if bisections == _MAX_BISECTIONS:
            apart[pair[unsure]] = False
        elif unsure.any():
            two = np.full(np.count_nonzero(unsure), 2)
            (halves_a, index), (halves_b, _) = (body.take(unsure).divided(two) for body in (a, b))
            waiting.append((halves_a, halves_b, pair[unsure][index], bisections + 1))
    return apart


def rotation_bounds(a: MovingBodies, b: MovingBodies, radius_a: Column, radius_b: Column) -> Columns:
    # Bound how far the gap along an axis that turns with ``a``, or with ``b``, falls below its end values.
    # In a unit of time, a function f falls below the smaller of f(0) and f(1) by at most max |f''| / 8. Along an axis
    # that turns with a, the offset of b has |f''| <= far * turn_a**2 + 2 * speed * |turn_a|, and the extent of b,
    # which turns by turn_b - turn_a against the axis, radius_b * (turn_b - turn_a)**2. The extent of a is constant.
    # Here `far` is the largest distance of the reference points, and `speed` the speed of their relative motion.
    x, y, dx, dy = b.x - a.x, b.y - a.y, b.dx - a.dx, b.dy - a.dy
    far, speed = np.maximum(np.hypot(x, y), np.hypot(x + dx, y + dy)), np.hypot(dx, dy)
    relative = (b.turn - a.turn) ** 2
    turns = (a.turn, radius_b), (b.turn, radius_a)
    of_a, of_b = ((far * turn**2 + 2 * speed * np.abs(turn) + radius * relative) / 8 for turn, radius in turns)
    return of_a, of_b


def across_motion(a: MovingBodies, b: MovingBodies) -> Columns:
    """Return the unit vector normal to the velocity of each body of ``b`` relative to the body of ``a``.

    If this velocity is 0, return ``(0, 1)``.
    """
    x, y = _direction(b.dx - a.dx, b.dy - a.dy)
    return -y, x


def _direction(x: Column, y: Column) -> Columns:
    """Return the unit vector along each vector; ``(1, 0)`` for a vector of length 0."""
    length = np.hypot(x, y)
    unit_x = np.divide(x, length, out=np.ones_like(x), where=length > 0)
    return unit_x, np.divide(y, length, out=np.zeros_like(y), where=length > 0)


def convex_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Columns:
    """Return two gaps between convex bodies for :func:`bisect`: a bound for the whole motion, and one at its ends.

    The result is a pair of arrays, with one entry for each column of ``a`` and ``b``.
    """
    # The gap along a unit vector n is min(n . q over corners q of b) - max(n . p over corners p of a). `gap` is the
    # largest lower bound of the gap during the whole motion, over the axes below.
    ends = _corners_at(a, b, 0.0), _corners_at(a, b, 1.0)
    rim_a, rim_b = (np.hypot(*body.size).max(axis=0) for body in (a, b))
    # 1. Both normals of the relative motion: fixed axes, against which both bodies turn.
    bulge = (rim_a * a.turn**2 + rim_b * b.turn**2) / 8
    nx, ny = across_motion(a, b)
    gap = np.maximum(_smaller_gap(ends, nx, ny), _smaller_gap(ends, -nx, -ny)) - bulge
    # 2. The normals of all sides of a, then of b: axes that turn with the body.
    gaps = [[_side_gaps(p, q), _side_gaps(q, p)] for p, q in ends]
    for first, last, bulge_of_body in zip(*gaps, rotation_bounds(a, b, rim_a, rim_b), strict=True):
        gap = np.maximum(gap, np.minimum(first, last).max(axis=0, initial=-np.inf) - bulge_of_body)
    # 3. The separation at each end of the motion: the largest gap along the normals, which is exact if the bodies
    #    overlap (separating axis theorem). Else, for a positive reach, the distance. Two points have no normals.
    separation = [np.concatenate(side_gaps) for side_gaps in gaps]
    separation = [side_gaps.max(axis=0) if len(side_gaps) else np.zeros(len(a.x)) for side_gaps in separation]
    if reach > 0:
        # 4. The direction between the nearest points: a fixed axis.
        (nx, ny), distances = _nearest(ends)
        gap = np.maximum(gap, _smaller_gap(ends, nx, ny) - bulge)
        separation = [np.where(depth < 0, depth, d) for depth, d in zip(separation, distances, strict=True)]
    return gap, np.minimum(*separation)


def _corners_at(a: MovingBodies, b: MovingBodies, end: float) -> tuple[Corners, Corners]:
    """Return the corners of ``a`` and of ``b`` at one end of each motion, relative to the reference point of ``a``.

    ``end`` is 0 for the begin of the motion, 1 for its end.
    """
    turned = []
    for body in (a, b):
        (c, s), (x, y) = _heading(body, end), body.size
        turned.append(np.stack([c * x - s * y, s * x + c * y]))
    return turned[0], turned[1] + np.stack(_offset(a, b, end))[:, None]


def _heading(body: MovingBodies, end: float) -> Columns:
    theta = body.theta + end * body.turn
    return np.cos(theta), np.sin(theta)


def _offset(a: MovingBodies, b: MovingBodies, end: float) -> Columns:
    return b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)


def _side_gaps(p: Corners, q: Corners) -> Sides:
    """Return the gap between two bodies along the outward normal of each side of the first body.

    ``p`` are the corners of the first body, ``q`` the corners of the second. The gap is negative if the bodies
    overlap along this direction.
    """
    # Corners are in counterclockwise order. On a side's line, n . p is equal at both corners: take the first.
    sides = p.shape[1] if p.shape[1] > 1 else 0
    dx, dy = (np.roll(p, -1, axis=1) - p)[:, :sides]
    length = np.hypot(dx, dy)
    nx, ny = dy / length, -dx / length
    return _lowest(q, nx, ny) - nx * p[0, :sides] - ny * p[1, :sides]


def _lowest(q: Corners, nx: Sides, ny: Sides) -> Sides:
    """Return, for each direction ``(nx, ny)``, its least scalar product with the corners ``q`` of a convex body."""
    num_corners, n = q.shape[1:]
    stride = 1 << ((num_corners - 1) // _FEW).bit_length()
    heights = nx[:, None] * q[0, ::stride] + ny[:, None] * q[1, ::stride]
    if stride == 1:
        return heights.min(axis=1)
    # Heights fall and rise once around a convex body, so the lowest corner is within a stride of the lowest sample.
    # Halve the stride until it is 1.
    corner = stride * heights.argmin(axis=1)
    x, y = q.reshape(2, -1)  # corner i of body j is at the index i * n + j
    while stride > 1:
        stride //= 2
        near = np.stack([corner, corner - stride, corner + stride]) % num_corners
        at = near * n + np.arange(n)
        corner = np.take_along_axis(near, (nx * x[at] + ny * y[at]).argmin(axis=0)[None], axis=0)[0]
    at = corner * n + np.arange(n)
    return nx * x[at] + ny * y[at]


def _smaller_gap(ends: Ends, nx: Column, ny: Column) -> Column:
    """Return the smaller of the gaps between two bodies at begin and end of their motion, along ``(nx, ny)``."""
    return np.minimum(*((nx * q[0] + ny * q[1]).min(axis=0) - (nx * p[0] + ny * p[1]).max(axis=0) for p, q in ends))


def _nearest(ends: Ends) -> tuple[Columns, Columns]:
    """Return the direction from the first body to the second, as a unit vector, when they are nearest in the motion.

    Also return the distances of the two bodies at the begin and at the end of the motion. The bodies must not
    overlap.
    """
    # Find the point nearest to the origin in the swept Minkowski difference, the differences q - p of the corners of
    # both bodies. It is on a side of one body minus a corner of the other, at the begin or end, or on the path of a
    # difference from begin to end. Difference [:, i, j] is q[j] - p[i]: sides of p lead along axis 1, sides of q
    # along axis 2.
    first, last = (q[:, None] - p[:, :, None] for p, q in ends)
    at_ends = [[nearest_on_segment(*w, *(np.roll(w, -1, axis=axis) - w)) for axis in (1, 2)] for w in (first, last)]
    between = nearest_on_segment(*first, *(last - first))
    _, k, m, n = first.shape
    # In this order: k m points for sides of p, then of q, at the begin; as many at the end; k m on paths.
    points = np.array([*at_ends[0], *at_ends[1], between]).swapaxes(0, 1).reshape(2, 5 * k * m, n)
    squared = (points * points).sum(axis=0)
    x, y = np.take_along_axis(points, squared.argmin(axis=0)[None, None], axis=1)[:, 0]
    distances = [np.sqrt(part.min(axis=0)) for part in (squared[: 2 * k * m], squared[2 * k * m : 4 * k * m])]
    return _direction(x, y), (distances[0], distances[1])


def box_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Columns:
    # The gaps between pairs of boxes, for ``bisect``. ``reach`` is at most 0, since the distance of two boxes that do
    # not overlap may exceed the gaps tested here.
    # The gap along an axis is |u| - support: u is the offset of the centers along it, support the sum of half
    # extents.
    headings = [(_heading(a, end), _heading(b, end)) for end in (0.0, 1.0)]
    first, last = (_along_sides(a, b, end, *headings[int(end)]) for end in (0.0, 1.0))
    rim_a, rim_b = np.hypot(*a.size), np.hypot(*b.size)
    # 1. The normal of the relative motion, along which the offset is constant.
    nx, ny = across_motion(a, b)
    supports = [_support(a, at_a, nx, ny) + _support(b, at_b, nx, ny) for at_a, at_b in headings]
    bulge = (rim_a * a.turn**2 + rim_b * b.turn**2) / 8
    gap = np.abs(nx * (b.x - a.x) + ny * (b.y - a.y)) - np.maximum(*supports) - bulge
    # 2. The axes along the sides, which turn with their boxes.
    of_a, of_b = rotation_bounds(a, b, rim_a, rim_b)
    for (u0, support0), (u1, support1), bulge in zip(first, last, (of_a, of_a, of_b, of_b), strict=True):
        # The other body must be on the same side of the axis at both ends.
        gap = np.maximum(gap, np.minimum(np.abs(u0) - support0, np.where(u0 < 0, -u1, u1) - support1) - bulge)
    # 3. At each end, the axes along the sides decide (separating axis theorem).
    return gap, np.minimum(*(np.max([np.abs(u) - support for u, support in axes], axis=0) for axes in (first, last)))


def box_point_separation(a: MovingBodies, b: MovingBodies, reach: float) -> Columns:
    """Return two gaps between boxes ``a`` and points ``b``: a lower bound for the whole motion, and that at its ends.

    :func:`bisect` uses them, as those of :func:`convex_separation`.
    """
    # In coordinates (u, v) along the box, the point's path deviates from the chord of its ends by at most the bulge.
    ends, distances = [], []
    for end in (0.0, 1.0):
        (x, y), (c, s) = _offset(a, b, end), _heading(a, end)
        u, v = c * x + s * y, c * y - s * x
        ends += [u, v]
        beside, above = np.abs(u) - a.size[0], np.abs(v) - a.size[1]
        outside = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
        distances.append(outside + np.minimum(np.maximum(beside, above), 0))  # from the box, negative inside
    bulge, _ = rotation_bounds(a, b, *b.size)  # the point's radius is 0
    nearer = np.minimum(*distances)
    return np.minimum(nearer, _distance_of_chord(*ends, *a.size)) - bulge, nearer


def _along_sides(a: MovingBodies, b: MovingBodies, end: float, at_a: Columns, at_b: Columns) -> list[Columns]:
    # Offsets of the centers, and sums of half extents, along both axes of ``a``, then of ``b``.
    # ``at_a`` and ``at_b`` are cosine and sine of the headings. An axis at the angle t from the length of a box meets
    # the half extent length * |cos t| + width * |sin t| (half sides); c and s are these factors between the boxes.
    (ca, sa), (cb, sb) = at_a, at_b
    c, s = np.abs(ca * cb + sa * sb), np.abs(ca * sb - sa * cb)
    x, y = _offset(a, b, end)
    axes = []
    for (cos, sin), (length, width), (other_length, other_width) in ((at_a, a.size, b.size), (at_b, b.size, a.size)):
        axes.append((cos * x + sin * y, length + other_length * c + other_width * s))
        axes.append((cos * y - sin * x, width + other_length * s + other_width * c))
    return axes


def _support(body: MovingBodies, heading: Columns, nx: Column, ny: Column) -> Column:
    (c, s), (half_length, half_width) = heading, body.size
    return half_length * np.abs(c * nx + s * ny) + half_width * np.abs(c * ny - s * nx)


def _distance_of_chord(x0: Column, y0: Column, x1: Column, y1: Column, half_x: Column, half_y: Column) -> Column:
    """Return the distance from each segment to the nearest corner of a box around the origin.

    The segment leads from ``(x0, y0)`` to ``(x1, y1)``; the box has the half sides ``half_x`` and ``half_y``. If the
    segment and the box overlap, return minus the depth of the overlap.
    """
    # The distance to the box is the minimum of this and of the distances from the segment's ends to the box.
    dx, dy = x1 - x0, y1 - y0
    corners = [distance_to_segment(x0 - sx * half_x, y0 - sy * half_y, dx, dy) for sx in (-1, 1) for sy in (-1, 1)]
    length = np.hypot(dx, dy)
    # The gaps between segment and box along the segment's normal and along the box's axes (separating axis theorem).
    across = np.abs(x0 * dy - y0 * dx) - half_x * np.abs(dy) - half_y * np.abs(dx)
    across = np.divide(across, length, out=np.full_like(length, -np.inf), where=length > 0)
    beside_x = np.maximum(np.minimum(x0, x1), -np.maximum(x0, x1)) - half_x
    beside_y = np.maximum(np.minimum(y0, y1), -np.maximum(y0, y1)) - half_y
    separation = np.maximum(np.maximum(beside_x, beside_y), across)
    return np.where(separation > 0, np.min(corners, axis=0), separation)
