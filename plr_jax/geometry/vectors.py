"""Vector operations in the plane on whole arrays: products, normals, directions, distances, segments, arcs."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float

_SPLIT = 2.0**27 + 1  # Dekker's constant, which splits a double into two halves of 26 bits
_DOUBT = 2.0**-50  # relative rounding error of a difference of two products, with a margin
Scalars: TypeAlias = Float[np.ndarray, "*#batch"]
Batch: TypeAlias = Float[np.ndarray, "*batch"]
Vectors: TypeAlias = Float[np.ndarray, "*batch 2"]
Vector: TypeAlias = Float[np.ndarray, "2"]


def cross_product(u: Float[np.ndarray, "*#batch 2"], v: Float[np.ndarray, "*#batch 2"]) -> Float[np.ndarray, "..."]:
    """Return the cross product of 2-D vectors: positive where ``v`` points to the left of ``u``."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def orientation(ux: Scalars, uy: Scalars, vx: Scalars, vy: Scalars) -> Batch:
    """Return the cross products ``ux * vy - uy * vx`` of vectors ``(ux, uy)`` and ``(vx, vy)``.

    The signs are exact if all coordinates are 45-bit integers times a common power of two.
    """
    # Rounding of the products p and q may change the sign of p - q if they are nearly equal. Then add their rounding
    # errors: the exact result is (p + error of p) - (q + error of q).
    # Dekker, "A floating-point technique for extending the available precision" (1971).
    p, q = ux * vy, uy * vx
    result = np.asarray(p - q)
    is_doubted = np.abs(result) <= _DOUBT * (np.abs(p) + np.abs(q))
    if is_doubted.any():
        a, b, c, d = (np.broadcast_to(factor, result.shape)[is_doubted] for factor in (ux, vy, uy, vx))
        result[is_doubted] += _product_error(a, b) - _product_error(c, d)
    return result


def _product_error(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the exact product of ``a`` and ``b`` minus its rounded value ``a * b``.

    Each factor is split into two halves of few bits, whose products have no rounding error.
    """
    high_a, high_b = (_SPLIT * factor - (_SPLIT * factor - factor) for factor in (a, b))
    low_a, low_b = a - high_a, b - high_b
    return low_a * low_b - (((a * b - high_a * high_b) - low_a * high_b) - high_a * low_b)


def turned_left(u: Vectors) -> Vectors:
    return np.stack([-u[..., 1], u[..., 0]], axis=-1)


def left_normal(u: Vectors) -> Vectors:
    return turned_left(u) / np.linalg.norm(u, axis=-1, keepdims=True)


def pseudo_angle(dx: Batch, dy: Batch) -> Batch:
    """Map directions ``(dx, dy)`` to numbers in [0, 4] that grow with the angle, but are faster to compute.

    The number is 0 along the x axis and 1 along the y axis; the zero vector has 0.
    """
    length = np.abs(dx) + np.abs(dy)
    # The slant falls from 1 at angle 0 to -1 at angle pi, and rises again.
    slant = np.divide(dx, length, out=np.ones_like(length), where=length > 0)
    return np.where(dy >= 0, 1.0 - slant, 3.0 + slant)


def distances_between(x: Float[np.ndarray, "n 2"], points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "n m"]:
    length = np.square(x[:, :1] - points[:, 0])
    length += np.square(x[:, 1:] - points[:, 1])
    return np.sqrt(length, out=length)


def distance_to_segment(x: Scalars, y: Scalars, dx: Scalars, dy: Scalars) -> Batch:
    """Return the distance from the origin to each segment from ``(x, y)`` to ``(x + dx, y + dy)``."""
    x, y = nearest_on_segment(x, y, dx, dy)
    return np.sqrt(x * x + y * y)


def nearest_on_segment(x: Scalars, y: Scalars, dx: Scalars, dy: Scalars) -> tuple[Batch, Batch]:
    """Return the point nearest to the origin on each segment from ``(x, y)`` to ``(x + dx, y + dy)``."""
    # The point (x, y) + t (dx, dy) is nearest for t = -(x, y) . (dx, dy) / |(dx, dy)|^2, cut off at the ends.
    squared = dx * dx + dy * dy
    t = np.clip(-(x * dx + y * dy) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    return x + t * dx, y + t * dy


def turn_between(u: Float[np.ndarray, "*#batch 2"], v: Float[np.ndarray, "*#batch 2"]) -> Float[np.ndarray, "..."]:
    """Return the counterclockwise angle from ``u`` to ``v``, in [0, 2 pi)."""
    return np.asarray(np.arctan2(cross_product(u, v), (u * v).sum(axis=-1)) % (2 * np.pi))


def arc(center: Vector, start: Vector, end: Vector, num_chords: int | np.integer, outside: bool = False) -> Vectors:
    """Divide an arc into equal chords, and return the points where they begin and end.

    The arc leads counterclockwise from ``center + start`` to ``center + end``. If ``outside``, return instead the
    vertices of a polyline outside the arc with the same ends. Its edges lie on the tangents of the arc at the ends of
    the chords.
    """
    # At angle a from `start`, the offset from the center is cos(a) start + sin(a) (start turned left).
    turn = turn_between(start, end)
    angle = np.linspace(0.0, turn, num_chords + 1)
    points = np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * turned_left(start)
    points[-1] = end
    if outside:
        # The tangents at the ends u, v of a chord of angle a meet at (u + v) / 2 / cos(a / 2)^2.
        corners = (points[:-1] + points[1:]) / (1 + np.cos(turn / num_chords))
        points = np.concatenate([start[None], corners, end[None]])
    return center + points
