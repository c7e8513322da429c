"""The kernel for convex bodies of any number of vertices, whose distance is that of their Minkowski difference."""

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.collision.moving import Column, MovingBodies, across_motion, riding_bulges
from plr_jax.geometry.vectors import nearest_on_segment

Sides = Float[np.ndarray, "sides n"]
Corners = Float[np.ndarray, "2 _ n"]
Ends = tuple[tuple[Corners, Corners], tuple[Corners, Corners]]

_FEW = 24  # corners up to which the lowest is sought among all


def judge_convex(
    a: MovingBodies, b: MovingBodies, reach: float
) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
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
    for first, last, riding in zip(*gaps, riding_bulges(a, b, rim_a, rim_b), strict=True):
        gap = np.maximum(gap, np.minimum(first, last).max(axis=0, initial=-np.inf) - riding)
    separation = [np.concatenate(each) for each in gaps]
    separation = [each.max(axis=0) if len(each) else np.zeros(len(a.x)) for each in separation]
    if reach > 0:
        (nx, ny), distances = _nearest(ends)
        gap = np.maximum(gap, _smaller_gap(ends, nx, ny) - bulge)
        separation = [np.where(depth < 0, depth, d) for depth, d in zip(separation, distances, strict=True)]
    clear = gap >= reach
    exact = (a.turn == 0) & (b.turn == 0)
    return clear, (separation[0] < reach) | (separation[1] < reach) | (exact & ~clear)


def _corners_at(a: MovingBodies, b: MovingBodies, end: float) -> tuple[Corners, Corners]:
    """Corners of both at the first (0) or last (1) end of each motion, seen from the first's reference point."""
    placed = []
    for body in (a, b):
        c, s = np.cos(body.theta + end * body.turn), np.sin(body.theta + end * body.turn)
        x, y = body.size
        placed.append(np.stack([c * x - s * y, s * x + c * y]))
    placed[1] += np.stack([b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)])[:, None]
    return placed[0], placed[1]


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


def _nearest(ends: Ends) -> tuple[tuple[Column, Column], tuple[Column, Column]]:
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
