"""The fast kernels: for boxes about their reference points, given by half their sides, and for boxes and points."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool

from plr_jax.collision.moving import Column, MovingBodies, across_motion, riding_bulges
from plr_jax.geometry.vectors import distance_to_segment

Heading: TypeAlias = tuple[Column, Column]  # cosine and sine


def judge_boxes(
    a: MovingBodies, b: MovingBodies, reach: float
) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Two boxes and a depth of overlap: axes along the sides of both, and across their relative motion."""
    headings = [(_heading(a, end), _heading(b, end)) for end in (0.0, 1.0)]
    first, last = (_along_sides(a, b, end, *headings[int(end)]) for end in (0.0, 1.0))
    of_a, of_b = riding_bulges(a, b, np.hypot(*a.size), np.hypot(*b.size))
    gap = _gap_across(a, b, headings)
    for (u0, support0), (u1, support1), bulge in zip(first, last, (of_a, of_a, of_b, of_b), strict=True):
        # The same side at both ends: the axis does not change its sense within the piece.
        along = np.minimum(np.abs(u0) - support0, np.where(u0 < 0, -u1, u1) - support1)
        gap = np.maximum(gap, along - bulge)
    clear = gap >= reach
    # At a single time, the sides' axes decide.
    overlap = [np.max([np.abs(u) - support for u, support in axes], axis=0) < reach for axes in (first, last)]
    exact = (a.turn == 0) & (b.turn == 0)
    return clear, overlap[0] | overlap[1] | (exact & ~clear)


def judge_box_and_point(
    a: MovingBodies, b: MovingBodies, reach: float
) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """A box and a point, seen from the box: that is at rest, and the point's curve is near a segment."""
    ends, distances = [], []
    for end in (0.0, 1.0):
        x, y = b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)
        c, s = _heading(a, end)
        u, v = c * x + s * y, c * y - s * x
        ends += [u, v]
        distances.append(_distance_to_box(u, v, *a.size))
    bulge, _ = riding_bulges(a, b, *b.size)  # a point has no rim
    distance = np.minimum(np.minimum(distances[0], distances[1]), _distance_of_chord(*ends, *a.size))
    clear = distance >= reach + bulge
    overlap = (distances[0] < reach) | (distances[1] < reach)
    return clear, overlap | ((a.turn == 0) & ~clear)


def judge_point_and_box(
    a: MovingBodies, b: MovingBodies, reach: float
) -> tuple[Bool[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """A point and a box."""
    return judge_box_and_point(b, a, reach)


def _heading(body: MovingBodies, end: float) -> Heading:
    """The heading at the first (0) or last (1) end of each motion."""
    theta = body.theta + end * body.turn
    return np.cos(theta), np.sin(theta)


def _along_sides(
    a: MovingBodies, b: MovingBodies, end: float, heading_a: Heading, heading_b: Heading
) -> list[tuple[Column, Column]]:
    """Offset of the centers, and what the bodies fill of it, along two sides of ``a`` and two of ``b``."""
    (ca, sa), (cb, sb), (length_a, width_a), (length_b, width_b) = heading_a, heading_b, a.size, b.size
    c, s = np.abs(ca * cb + sa * sb), np.abs(ca * sb - sa * cb)
    x, y = b.x - a.x + end * (b.dx - a.dx), b.y - a.y + end * (b.dy - a.dy)
    return [
        (ca * x + sa * y, length_a + length_b * c + width_b * s),
        (ca * y - sa * x, width_a + length_b * s + width_b * c),
        (cb * x + sb * y, length_b + length_a * c + width_a * s),
        (cb * y - sb * x, width_b + length_a * s + width_a * c),
    ]


def _gap_across(a: MovingBodies, b: MovingBodies, headings: list[tuple[Heading, Heading]]) -> Column:
    """Gap along the normal of the relative motion; a lower bound."""
    nx, ny = across_motion(a, b)
    supports = [_support(a, of_a, nx, ny) + _support(b, of_b, nx, ny) for of_a, of_b in headings]
    bulge = (np.hypot(*a.size) * a.turn**2 + np.hypot(*b.size) * b.turn**2) / 8
    return np.abs(nx * (b.x - a.x) + ny * (b.y - a.y)) - np.maximum(supports[0], supports[1]) - bulge


def _support(body: MovingBodies, heading: Heading, nx: Column, ny: Column) -> Column:
    """How far a box reaches from its center along a direction."""
    (c, s), (half_length, half_width) = heading, body.size
    return half_length * np.abs(c * nx + s * ny) + half_width * np.abs(c * ny - s * nx)


def _distance_to_box(x: Column, y: Column, half_x: Column, half_y: Column) -> Column:
    """Signed distance of points to boxes about the origin, negative inside."""
    x, y = np.abs(x) - half_x, np.abs(y) - half_y
    return np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0)


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
