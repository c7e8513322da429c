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

_CORNERS_OF_BOX = 4  # most pieces are boxes: those of more corners are apart
_AT_ONCE = 1 << 11  # pieces, whose numbers stay in a core's cache

Numbers: TypeAlias = Float[np.ndarray, "pieces"]
Vectors: TypeAlias = Float[np.ndarray, "pieces 2"]


def difference_of_cones(
    pieces: Pieces, apex: Vectors, offset: Numbers, other_apex: Vectors, other_offset: Numbers
) -> tuple[Numbers, Numbers]:
    """Smallest and largest value of the first cone minus the other one, over each piece.

    In double precision, to within its rounding: about 1e-15 of the coordinates.
    """
    lowest, highest = np.empty(len(offset)), np.empty(len(offset))
    is_box = (pieces[:, :, _CORNERS_OF_BOX - 1 :] == pieces[:, :, -1:]).all(axis=(0, 2))
    for count, group in ((_CORNERS_OF_BOX, np.flatnonzero(is_box)), (pieces.shape[2], np.flatnonzero(~is_box))):
        for begin in range(0, len(group), _AT_ONCE):
            some = group[begin : begin + _AT_ONCE]
            lowest[some], highest[some] = _extremes(pieces[:, some, :count], apex[some], other_apex[some])
    shift = offset - other_offset
    return lowest + shift, highest + shift


def _extremes(pieces: Pieces, apex: Vectors, other_apex: Vectors) -> tuple[Numbers, Numbers]:
    """Smallest and largest difference of the distances to two points, over each piece."""
    x, y, ex, ey, length = _corners_and_edges(pieces)
    ax, ay, bx, by = x - apex[:, 0], y - apex[:, 1], x - other_apex[:, 0], y - other_apex[:, 1]
    along_a, along_b = -(ax * ex + ay * ey), -(bx * ex + by * ey)
    beside_a, beside_b = np.abs(ax * ey - ay * ex), np.abs(bx * ey - by * ex)
    apart = beside_b - beside_a
    place = np.divide(beside_b * along_a - beside_a * along_b, apart, out=np.zeros_like(apart), where=apart != 0)
    place = np.minimum(np.maximum(place, 0), length)  # where it is an end, it is a corner
    to_a = np.sqrt((place - along_a) ** 2 + beside_a * beside_a)
    on_edges = to_a - np.sqrt((place - along_b) ** 2 + beside_b * beside_b)
    at_corners = np.sqrt(ax * ax + ay * ay) - np.sqrt(bx * bx + by * by)
    return np.minimum(at_corners, on_edges).min(axis=0), np.maximum(at_corners, on_edges).max(axis=0)


def cone_above_plane(
    pieces: Pieces, apex: Vectors, offset: Numbers, slope: Vectors, intercept: Numbers
) -> tuple[Numbers, Numbers]:
    """Smallest and largest value of a cone minus a plane ``slope . x + intercept``, over each piece.

    In double precision, to within its rounding.
    """
    x, y, ex, ey, length = _corners_and_edges(pieces)
    ax, ay, (sx, sy) = x - apex[:, 0], y - apex[:, 1], slope.T
    from_apex = offset - intercept - (slope * apex).sum(axis=1)
    at_corners = np.sqrt(ax * ax + ay * ay) - (sx * ax + sy * ay)
    along, beside = -(ax * ex + ay * ey), np.abs(ax * ey - ay * ex)
    rate = np.clip(sx * ex + sy * ey, -1, 1)  # of the plane on the edge; where it is steeper, an end is lowest
    steep = np.sqrt(1 - rate * rate)
    place = along + np.divide(rate * beside, steep, out=np.where(rate > 0, np.inf, -np.inf), where=steep > 0)
    np.clip(place, 0, length, out=place)
    px, py = ax + place * ex, ay + place * ey
    on_edges = np.sqrt(px * px + py * py) - (sx * px + sy * py)
    lowest = np.minimum(at_corners.min(axis=0), on_edges.min(axis=0))
    lowest = np.where(contain(pieces, apex[:, None], 0.0)[:, 0], np.minimum(lowest, 0.0), lowest)
    return lowest + from_apex, at_corners.max(axis=0) + from_apex


def _corners_and_edges(pieces: Pieces) -> tuple[Float[np.ndarray, "kept pieces"], ...]:
    """Corners, the unit vector along each edge, any where it has no length, and its length.

    Corner by corner, as NumPy is fast along pieces, of which there are many; what all of them repeat is left out.
    """
    x, y = pieces.transpose(0, 2, 1)
    new = ((x[1:] != x[:-1]) | (y[1:] != y[:-1])).any(axis=1)
    count = 1 + int(np.flatnonzero(new).max(initial=0)) + 1
    x, y = np.ascontiguousarray(x[:count]), np.ascontiguousarray(y[:count])
    ex, ey = np.concatenate([x[1:], x[:1]]) - x, np.concatenate([y[1:], y[:1]]) - y
    length = np.sqrt(ex * ex + ey * ey)
    some = length > 0
    ex, ey = np.divide(ex, length, out=np.ones_like(ex), where=some), np.divide(ey, length, out=ey, where=some)
    return x, y, ex, ey, length
