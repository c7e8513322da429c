"""Arrays of convex polygons (*pieces*): clipping, areas, and extremes of differences of distance functions on them.

Coordinates are stored as ``(2, pieces, corners)``, corners counterclockwise; shorter pieces repeat their last corner.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

Pieces: TypeAlias = Float[np.ndarray, "2 pieces corners"]
Numbers: TypeAlias = Float[np.ndarray, " pieces"]
Vectors: TypeAlias = Float[np.ndarray, "pieces 2"]
Extremes: TypeAlias = tuple[Numbers, Numbers]
Values: TypeAlias = Float[np.ndarray, "pieces corners"]
Corners: TypeAlias = Float[np.ndarray, "n 2"]
Some: TypeAlias = Int[np.ndarray, " some"]
_BOXES_AND_PIECES = 1 << 22  # pairs of a box and a piece that are compared at a time
_CORNERS_OF_BOX = 4  # most pieces are boxes, which are processed apart from pieces with more corners
_AT_ONCE = 1 << 11  # pieces processed at a time, so that their arrays stay in a core's cache
ROOM = 8  # corners per piece: a triangle cut by a box has at most 7, and clipping needs one more


def clip(pieces: Pieces, height: Values) -> Float[np.ndarray, "2 pieces room"]:
    """Return where in each convex polygon a linear function, with values ``height`` at its corners, is at least 0."""
    inside = height >= 0  # somewhere in each piece, by assumption
    after = next_corner(height)
    crosses = inside != (after >= 0)
    fraction = np.divide(height, height - after, out=np.zeros_like(height), where=crosses)
    repeats = np.zeros(inside.shape, bool)
    repeats[:, 1:] = (pieces[0, :, 1:] == pieces[0, :, :-1]) & (pieces[1, :, 1:] == pieces[1, :, :-1])
    is_kept = np.stack([inside & ~repeats, crosses], axis=2).reshape(len(height), 2 * height.shape[1])
    row, column = np.nonzero(is_kept)
    count = is_kept.sum(axis=1)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    last = np.minimum(np.arange(ROOM), np.maximum(count - 1, 0)[:, None])
    result = np.empty((2, len(height), ROOM))
    for along, clipped in zip(pieces, result, strict=True):
        met = along + fraction * (next_corner(along) - along)
        points = np.stack([along, met], axis=2).reshape(len(height), 2 * height.shape[1])
        clipped[row, place] = points[row, column]
        clipped[:] = np.take_along_axis(clipped, last, axis=1)
    return result


def centers(pieces: Pieces) -> Vectors:
    new = np.ones(pieces.shape[1:], bool)
    new[:, 1:] = (pieces[:, :, 1:] != pieces[:, :, :-1]).any(axis=0)
    new[:, 0] = (pieces[:, :, 0] != pieces[:, :, -1]).any(axis=0)
    new[~new.any(axis=1)] = True
    return ((pieces * new).sum(axis=2) / new.sum(axis=1)).T


def areas(pieces: Pieces) -> Numbers:
    x, y = pieces - pieces[:, :, :1]
    return (x[:, :-1] * y[:, 1:] - x[:, 1:] * y[:, :-1]).sum(axis=1) / 2


def boxes_as_pieces(lo: Corners, hi: Corners) -> Float[np.ndarray, "2 n room"]:
    corner = np.minimum(np.arange(ROOM), 3)
    x = np.stack([lo[:, 0], hi[:, 0], hi[:, 0], lo[:, 0]], axis=1)[:, corner]
    y = np.stack([lo[:, 1], lo[:, 1], hi[:, 1], hi[:, 1]], axis=1)[:, corner]
    return np.stack([x, y])


def contain(pieces: Pieces, x: Float[np.ndarray, "pieces k 2"], tolerance: float) -> Bool[np.ndarray, "pieces k"]:
    """Return whether convex polygon ``i`` contains each of the points ``x[i]``, or is within ``tolerance`` of it."""
    near = np.ones(x.shape[:2], bool)
    for along, at in zip(pieces, np.moveaxis(x, 2, 0), strict=True):
        near &= at >= lowest(along)[:, None] - tolerance
        near &= at <= highest(along)[:, None] + tolerance
    piece, place = np.nonzero(near)
    (corner_x, corner_y), (px, py) = pieces[:, piece], x[piece, place].T
    inside = np.ones(len(piece), bool)
    for corner in range(corner_x.shape[1]):  # NumPy is slow along a short last axis
        start_x, start_y = corner_x[:, corner - 1], corner_y[:, corner - 1]
        ex, ey = corner_x[:, corner] - start_x, corner_y[:, corner] - start_y
        inside &= ex * (py - start_y) - ey * (px - start_x) >= -tolerance * np.sqrt(ex * ex + ey * ey)
    near[piece, place] = inside
    return near


def clip_to_boxes(pieces: Pieces, lo: Corners, hi: Corners) -> tuple[Float[np.ndarray, "2 some room"], Some, Some]:
    """Intersect all polygons with all boxes; return parts of positive area, and the box and polygon of each."""
    (x0, y0), (x1, y1) = pieces.min(axis=2), pieces.max(axis=2)
    at_once, pairs = max(1, _BOXES_AND_PIECES // max(1, len(x0))), [np.zeros((2, 0), np.int64)]
    for begin in range(0, len(lo), at_once):
        (left, low), (right, high) = (corner[begin : begin + at_once].T[:, :, None] for corner in (lo, hi))
        box, rows = np.nonzero((x0 < right) & (x1 > left) & (y0 < high) & (y1 > low))
        pairs.append(np.stack([begin + box, rows]))
    box, rows = np.concatenate(pairs, axis=1)
    pieces = pieces[:, rows][:, :, np.minimum(np.arange(ROOM), pieces.shape[2] - 1)]
    is_cut = np.zeros(len(rows), bool)
    for axis in range(2):
        for sign, limit in ((1.0, lo[:, axis]), (-1.0, hi[:, axis])):
            height = sign * (pieces[axis] - limit[box, None])
            reaches = highest(height) > 0
            box, rows, pieces, height = box[reaches], rows[reaches], pieces[:, reaches], height[reaches]
            is_cut = is_cut[reaches] | (lowest(height) < 0)  # clipping again drops corners that clipping repeated
            pieces[:, is_cut] = clip(pieces[:, is_cut], height[is_cut])
    some = areas(pieces) > 0
    return pieces[:, some], box[some], rows[some]


def next_corner(values: Values) -> Values:
    return np.concatenate([values[:, 1:], values[:, :1]], axis=1)


def lowest(values: Values) -> Numbers:
    """Return the least value of each row; faster than ``values.min(axis=1)`` if rows are short."""
    return np.ascontiguousarray(values.T).min(axis=0)


def highest(values: Values) -> Numbers:
    return np.ascontiguousarray(values.T).max(axis=0)


def difference_of_cones(
    pieces: Pieces, apex: Vectors, offset: Numbers, other_apex: Vectors, other_offset: Numbers
) -> Extremes:
    """Return the extremes over a piece's ``x`` of ``offset + |x - apex| - other_offset - |x - other_apex|``."""
    lowest, highest = np.empty(len(offset)), np.empty(len(offset))
    is_box = (pieces[:, :, _CORNERS_OF_BOX - 1 :] == pieces[:, :, -1:]).all(axis=(0, 2))
    for count, group in ((_CORNERS_OF_BOX, np.flatnonzero(is_box)), (pieces.shape[2], np.flatnonzero(~is_box))):
        for begin in range(0, len(group), _AT_ONCE):
            some = group[begin : begin + _AT_ONCE]
            lowest[some], highest[some] = _extremes(pieces[:, some, :count], apex[some], other_apex[some])
    shift = offset - other_offset
    return lowest + shift, highest + shift


def _extremes(pieces: Pieces, apex: Vectors, other_apex: Vectors) -> Extremes:
    # The extremes lie on the boundary. The gradient, a difference of unit vectors, vanishes only on the line through
    # both apexes outside of their segment, where the difference is constant. On an edge the difference is stationary
    # where both apexes appear at the same angle to the edge:
    #   (place - along_a) / beside_a = (place - along_b) / beside_b,
    # where `along` is the foot of an apex on the edge's line, and `beside` its distance from the line.
    x, y, ex, ey, length = _corners_and_edges(pieces)
    ax, ay, bx, by = x - apex[:, 0], y - apex[:, 1], x - other_apex[:, 0], y - other_apex[:, 1]
    along_a, along_b = -(ax * ex + ay * ey), -(bx * ex + by * ey)
    beside_a, beside_b = np.abs(ax * ey - ay * ex), np.abs(bx * ey - by * ex)
    apart = beside_b - beside_a
    place = np.divide(beside_b * along_a - beside_a * along_b, apart, out=np.zeros_like(apart), where=apart != 0)
    place = np.minimum(np.maximum(place, 0), length)
    to_a = np.sqrt((place - along_a) ** 2 + beside_a * beside_a)
    on_edges = to_a - np.sqrt((place - along_b) ** 2 + beside_b * beside_b)
    at_corners = np.sqrt(ax * ax + ay * ay) - np.sqrt(bx * bx + by * by)
    return np.minimum(at_corners, on_edges).min(axis=0), np.maximum(at_corners, on_edges).max(axis=0)


def cone_above_plane(pieces: Pieces, apex: Vectors, offset: Numbers, slope: Vectors, intercept: Numbers) -> Extremes:
    """Return the extremes over a piece's ``x`` of ``offset + |x - apex| - (slope . x + intercept)``."""
    # The difference is convex, so largest at a corner, and smallest on an edge or at the apex. On an edge, it is
    # smallest where the distance to the apex rises as the plane does: (place - along) / distance = rate.
    x, y, ex, ey, length = _corners_and_edges(pieces)
    ax, ay, (sx, sy) = x - apex[:, 0], y - apex[:, 1], slope.T
    from_apex = offset - intercept - (slope * apex).sum(axis=1)
    at_corners = np.sqrt(ax * ax + ay * ay) - (sx * ax + sy * ay)
    along, beside = -(ax * ex + ay * ey), np.abs(ax * ey - ay * ex)
    rate = np.clip(sx * ex + sy * ey, -1, 1)  # slope along the edge; if it is steeper, the minimum is at an end
    steep = np.sqrt(1 - rate * rate)
    place = along + np.divide(rate * beside, steep, out=np.where(rate > 0, np.inf, -np.inf), where=steep > 0)
    np.clip(place, 0, length, out=place)
    px, py = ax + place * ex, ay + place * ey
    on_edges = np.sqrt(px * px + py * py) - (sx * px + sy * py)
    lowest = np.minimum(at_corners.min(axis=0), on_edges.min(axis=0))
    lowest = np.where(contain(pieces, apex[:, None], 0.0)[:, 0], np.minimum(lowest, 0.0), lowest)
    return lowest + from_apex, at_corners.max(axis=0) + from_apex


def _corners_and_edges(pieces: Pieces) -> tuple[Float[np.ndarray, "kept pieces"], ...]:
    """Return x and y of corners, x and y of unit edge vectors, and edge lengths, as arrays ``(corners, pieces)``."""
    x, y = pieces.transpose(0, 2, 1)
    new = ((x[1:] != x[:-1]) | (y[1:] != y[:-1])).any(axis=1)
    count = 1 + int(np.flatnonzero(new).max(initial=0)) + 1
    x, y = np.ascontiguousarray(x[:count]), np.ascontiguousarray(y[:count])
    ex, ey = np.concatenate([x[1:], x[:1]]) - x, np.concatenate([y[1:], y[:1]]) - y
    length = np.sqrt(ex * ex + ey * ey)
    some = length > 0
    ex, ey = np.divide(ex, length, out=np.ones_like(ex), where=some), np.divide(ey, length, out=ey, where=some)
    return x, y, ex, ey, length
