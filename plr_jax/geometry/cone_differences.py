"""Extremes of the difference of two cones, or of a cone and a plane, over convex pieces of the plane.

A cone is ``offset + |x - apex|``. The difference of two has its extremes over a piece on the piece's boundary:
inside, its gradient, a difference of unit vectors, vanishes only on the line through both apexes beyond them, along
which the difference does not change. On an edge it is stationary where both apexes are seen at one angle. A cone
minus a plane is convex: it is largest at a corner, and smallest on an edge or at the apex.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.convex_pieces import Pieces, contain

Numbers: TypeAlias = Float[np.ndarray, "pieces"]
Vectors: TypeAlias = Float[np.ndarray, "pieces 2"]


def difference_of_cones(
    pieces: Pieces, apex: Vectors, offset: Numbers, other_apex: Vectors, other_offset: Numbers
) -> tuple[Numbers, Numbers]:
    """Smallest and largest value of the first cone minus the other one, over each piece.

    In double precision, to within its rounding: about 1e-15 of the coordinates.
    """
    ex, ey, length = _edges(pieces)
    ax, ay = pieces[0] - apex[:, :1], pieces[1] - apex[:, 1:]
    bx, by = pieces[0] - other_apex[:, :1], pieces[1] - other_apex[:, 1:]
    along_a, along_b = -(ax * ex + ay * ey), -(bx * ex + by * ey)
    beside_a, beside_b = np.abs(ax * ey - ay * ex), np.abs(bx * ey - by * ex)
    apart = beside_b - beside_a
    place = np.divide(beside_b * along_a - beside_a * along_b, apart, out=np.zeros_like(apart), where=apart != 0)
    np.clip(place, 0, length, out=place)  # where it is an end, it is a corner
    to_a = np.sqrt((place - along_a) ** 2 + beside_a * beside_a)
    on_edges = to_a - np.sqrt((place - along_b) ** 2 + beside_b * beside_b)
    at_corners = np.sqrt(ax * ax + ay * ay) - np.sqrt(bx * bx + by * by)
    shift = offset - other_offset
    lowest = np.minimum(at_corners.min(axis=1), on_edges.min(axis=1))
    return lowest + shift, np.maximum(at_corners.max(axis=1), on_edges.max(axis=1)) + shift


def cone_above_plane(
    pieces: Pieces, apex: Vectors, offset: Numbers, slope: Vectors, intercept: Numbers
) -> tuple[Numbers, Numbers]:
    """Smallest and largest value of a cone minus a plane ``slope . x + intercept``, over each piece.

    In double precision, to within its rounding.
    """
    ex, ey, length = _edges(pieces)
    ax, ay = pieces[0] - apex[:, :1], pieces[1] - apex[:, 1:]
    sx, sy = slope[:, :1], slope[:, 1:]
    from_apex = offset - intercept - (slope * apex).sum(axis=1)
    at_corners = np.sqrt(ax * ax + ay * ay) - (sx * ax + sy * ay)
    along, beside = -(ax * ex + ay * ey), np.abs(ax * ey - ay * ex)
    rate = np.clip(sx * ex + sy * ey, -1, 1)  # of the plane on the edge; where it is steeper, an end is lowest
    steep = np.sqrt(1 - rate * rate)
    place = along + np.divide(rate * beside, steep, out=np.where(rate > 0, np.inf, -np.inf), where=steep > 0)
    np.clip(place, 0, length, out=place)
    x, y = ax + place * ex, ay + place * ey
    on_edges = np.sqrt(x * x + y * y) - (sx * x + sy * y)
    lowest = np.minimum(at_corners.min(axis=1), on_edges.min(axis=1))
    lowest = np.where(contain(pieces, apex, 0.0), np.minimum(lowest, 0.0), lowest)
    return lowest + from_apex, at_corners.max(axis=1) + from_apex


def _edges(pieces: Pieces) -> tuple[Float[np.ndarray, "pieces corners"], ...]:
    """Unit vector along each edge, any where it has no length, and its length."""
    x, y = np.concatenate([pieces[:, :, 1:], pieces[:, :, :1]], axis=2) - pieces
    length = np.sqrt(x * x + y * y)
    some = length > 0
    return np.divide(x, length, out=np.ones_like(x), where=some), np.divide(y, length, out=y, where=some), length
