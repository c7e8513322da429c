"""Arrays of convex polygons (*pieces*): clipping, areas, and extremes of differences of distance functions on them.

Coordinates are stored as ``(2, pieces, corners)``, with corners counterclockwise. Pieces with fewer corners repeat
their last corner. A *cone* is the function ``offset + |x - apex|``: the length of a path from ``x`` straight to
``apex``, and on from there by a path of length ``offset``.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import slices

Pieces: TypeAlias = Float[np.ndarray, "2 pieces corners"]
Numbers: TypeAlias = Float[np.ndarray, " pieces"]
Vectors: TypeAlias = Float[np.ndarray, "pieces 2"]
Extremes: TypeAlias = tuple[Numbers, Numbers]
Values: TypeAlias = Float[np.ndarray, "pieces corners"]
Corners: TypeAlias = Float[np.ndarray, "n 2"]
Some: TypeAlias = Int[np.ndarray, " some"]
_BOXES_AND_PIECES = 1 << 22  # pairs of a box and a piece that are compared at a time
_AT_ONCE = 1 << 11  # pieces processed at a time, so that their arrays stay in a core's cache
ROOM = 8  # corners per piece: a triangle cut by a box has at most 7, and clipping needs one more


def clip(pieces: Pieces, height: Values) -> Float[np.ndarray, "2 pieces room"]:
    """Return the part of each convex polygon where a linear function is at least 0.

    The function's values at the corners are ``height``; for each polygon, the largest value must be at least 0.
    """
    # 1. Column 2 k of a row stands for corner k, and column 2 k + 1 for the point where the function is 0 on the edge
    #    from corner k to the next one. Keep corners inside, but no repeated ones, and the points on edges that cross.
    is_inside = height >= 0
    next_height = next_corner(height)
    crosses = is_inside != (next_height >= 0)
    fraction = np.divide(height, height - next_height, out=np.zeros_like(height), where=crosses)
    is_repeated = np.zeros(is_inside.shape, bool)
    is_repeated[:, 1:] = (pieces[0, :, 1:] == pieces[0, :, :-1]) & (pieces[1, :, 1:] == pieces[1, :, :-1])
    is_kept = np.stack([is_inside & ~is_repeated, crosses], axis=2).reshape(len(height), 2 * height.shape[1])
    # 2. Move the kept points of each row to its front, and repeat the last one.
    row, column = np.nonzero(is_kept)
    count = is_kept.sum(axis=1)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    kept_or_last = np.minimum(np.arange(ROOM), np.maximum(count - 1, 0)[:, None])
    result = np.empty((2, len(height), ROOM))
    for along, clipped in zip(pieces, result, strict=True):
        met = along + fraction * (next_corner(along) - along)
        points = np.stack([along, met], axis=2).reshape(len(height), 2 * height.shape[1])
        clipped[row, place] = points[row, column]
        clipped[:] = np.take_along_axis(clipped, kept_or_last, axis=1)
    return result


def centers(pieces: Pieces) -> Vectors:
    """Return the mean of the distinct corners of each convex polygon, a point inside the polygon."""
    differs = (pieces != np.roll(pieces, 1, axis=2)).any(axis=0)  # each corner from the one before
    differs[~differs.any(axis=1)] = True  # a single point: all corners are equal
    return ((pieces * differs).sum(axis=2) / differs.sum(axis=1)).T


def areas(pieces: Pieces) -> Numbers:
    # Shoelace formula, with corners relative to the first corner: the terms of the two edges at this corner are 0.
    x, y = pieces - pieces[:, :, :1]
    return (x[:, :-1] * y[:, 1:] - x[:, 1:] * y[:, :-1]).sum(axis=1) / 2


def boxes_as_pieces(lo: Corners, hi: Corners) -> Float[np.ndarray, "2 n room"]:
    # Counterclockwise from the lower left corner; the last corner, 3, is repeated.
    (x0, y0), (x1, y1) = lo.T, hi.T
    corners = np.array([[x0, x1, x1, x0], [y0, y0, y1, y1]]).transpose(0, 2, 1)
    return corners.take(np.minimum(np.arange(ROOM), 3), axis=2)


def contain(pieces: Pieces, x: Float[np.ndarray, "pieces k 2"], tolerance: float) -> Bool[np.ndarray, "pieces k"]:
    """Return whether convex polygon ``i`` contains each of the points ``x[i]``, or is within ``tolerance`` of it."""
    # 1. Find the points in the bounding boxes of their pieces.
    result = np.ones(x.shape[:2], bool)
    for along, at in zip(pieces, np.moveaxis(x, 2, 0), strict=True):
        result &= at >= lowest(along)[:, None] - tolerance
        result &= at <= highest(along)[:, None] + tolerance
    # 2. Test whether these are on the left of all edges. Edge vector e and the point's offset d from the edge's start
    #    have the cross product |e| * distance from the edge's line.
    piece, place = np.nonzero(result)
    (corner_x, corner_y), (px, py) = pieces[:, piece], x[piece, place].T
    is_inside = np.ones(len(piece), bool)
    for corner in range(corner_x.shape[1]):  # NumPy is slow along a short last axis
        start_x, start_y = corner_x[:, corner - 1], corner_y[:, corner - 1]
        ex, ey = corner_x[:, corner] - start_x, corner_y[:, corner] - start_y
        is_inside &= ex * (py - start_y) - ey * (px - start_x) >= -tolerance * np.sqrt(ex * ex + ey * ey)
    result[piece, place] = is_inside
    return result


def clip_to_boxes(pieces: Pieces, lo: Corners, hi: Corners) -> tuple[Float[np.ndarray, "2 some room"], Some, Some]:
    """Intersect all convex polygons with all boxes, and return the intersections of positive area.

    Also return, for each intersection, the index of its box and the index of its polygon. The intersections are
    sorted by box, then by polygon.
    """
    # 1. Find the pairs of a box and a polygon whose bounding box overlaps the box.
    (x0, y0), (x1, y1) = pieces.min(axis=2), pieces.max(axis=2)
    at_once = max(1, _BOXES_AND_PIECES // max(1, len(x0)))
    pairs = [np.zeros((2, 0), np.int64)]
    for begin in range(0, len(lo), at_once):
        (left, low), (right, high) = (corner[begin : begin + at_once].T[:, :, None] for corner in (lo, hi))
        box, polygon = np.nonzero((x0 < right) & (x1 > left) & (y0 < high) & (y1 > low))
        pairs.append(np.stack([begin + box, polygon]))
    box, polygon = np.concatenate(pairs, axis=1)
    # 2. Clip a copy of the polygon of each pair, with its last corner repeated up to `ROOM` corners, at all four
    #    sides of the box. A corner on a side comes out twice: as a corner, and as the crossing of the edge beside it.
    #    As clipping drops repeated corners, clip parts that have been cut at all further sides.
    parts = pieces[:, polygon][:, :, np.minimum(np.arange(ROOM), pieces.shape[2] - 1)]
    is_cut = np.zeros(len(polygon), bool)
    for axis in range(2):
        for sign, limit in ((1.0, lo[:, axis]), (-1.0, hi[:, axis])):
            height = sign * (parts[axis] - limit[box, None])
            reaches = highest(height) > 0
            box, polygon, parts, height = box[reaches], polygon[reaches], parts[:, reaches], height[reaches]
            is_cut = is_cut[reaches] | (lowest(height) < 0)
            parts[:, is_cut] = clip(parts[:, is_cut], height[is_cut])
    has_area = areas(parts) > 0
    return parts[:, has_area], box[has_area], polygon[has_area]


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
    """Return the minimum and maximum of the difference of two cones over the points ``x`` of each convex polygon.

    The difference is ``offset + |x - apex| - other_offset - |x - other_apex|``.
    """
    least, most = np.empty((2, len(offset)))
    for rows in slices(len(offset), _AT_ONCE):
        least[rows], most[rows] = _extremes(pieces[:, rows], apex[rows], other_apex[rows])
    shift = offset - other_offset
    return least + shift, most + shift


def _extremes(pieces: Pieces, apex: Vectors, other_apex: Vectors) -> Extremes:
    """Return minimum and maximum of ``|x - apex| - |x - other_apex|`` over points ``x`` of each convex polygon."""
    # The extremes lie on the boundary. Inside, the gradient, a difference of unit vectors, vanishes only on the line
    # through both apexes, on the rays that lead from one apex away from the other. On such a ray the difference is
    # constant, from the apex (a kink) to the boundary, which so has the same value. On an edge the difference is
    # stationary where both apexes appear at the same angle to the edge:
    #   (place - along_a) / beside_a = (place - along_b) / beside_b,
    # where `place` and `along`, the foot of an apex on the edge's line, are distances from the edge's start, and
    # `beside` is the apex's distance from the line.
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
    """Return the minimum and maximum of a cone minus a plane over the points ``x`` of each convex polygon.

    The difference is ``offset + |x - apex| - (slope . x + intercept)``.
    """
    # The difference is convex, so largest at a corner, and smallest on an edge or at the apex. With u = x - apex, it
    # is |u| - slope . u + at_apex. On an edge, it is smallest where the distance to the apex rises as the plane does.
    # With `along`, the foot of the apex on the edge's line, and `beside`, its distance from the line, this is where
    #   (place - along) / sqrt((place - along)^2 + beside^2) = rate,  so  place = along + rate * beside / root.
    x, y, ex, ey, length = _corners_and_edges(pieces)
    ax, ay, (sx, sy) = x - apex[:, 0], y - apex[:, 1], slope.T
    at_apex = offset - intercept - (slope * apex).sum(axis=1)
    at_corners = np.sqrt(ax * ax + ay * ay) - (sx * ax + sy * ay)
    along, beside = -(ax * ex + ay * ey), np.abs(ax * ey - ay * ex)
    rate = np.clip(sx * ex + sy * ey, -1, 1)  # slope along the edge; if it is steeper, the minimum is at an end
    root = np.sqrt(1 - rate * rate)
    place = along + np.divide(rate * beside, root, out=np.where(rate > 0, np.inf, -np.inf), where=root > 0)
    np.clip(place, 0, length, out=place)
    px, py = ax + place * ex, ay + place * ey
    on_edges = np.sqrt(px * px + py * py) - (sx * px + sy * py)
    least = np.minimum(at_corners.min(axis=0), on_edges.min(axis=0))
    least = np.where(contain(pieces, apex[:, None], 0.0)[:, 0], np.minimum(least, 0.0), least)
    return least + at_apex, at_corners.max(axis=0) + at_apex


def _corners_and_edges(pieces: Pieces) -> tuple[Float[np.ndarray, "kept pieces"], ...]:
    """Return, for convex polygons, x and y of corners, x and y of unit edge vectors, and edge lengths.

    Each of the five arrays has shape ``(corners, polygons)``. Edge ``k`` leads from corner ``k`` to the next corner.
    """
    # 1. Drop the last corners that all pieces repeat.
    x, y = pieces.transpose(0, 2, 1)
    differs = ((x[1:] != x[:-1]) | (y[1:] != y[:-1])).any(axis=1)
    count = 2 + int(np.flatnonzero(differs).max(initial=0))
    x, y = np.ascontiguousarray(x[:count]), np.ascontiguousarray(y[:count])
    # 2. Find the edges to the next corners. An edge of length 0 gets the direction (1, 0).
    ex, ey = np.concatenate([x[1:], x[:1]]) - x, np.concatenate([y[1:], y[:1]]) - y
    length = np.sqrt(ex * ex + ey * ey)
    is_edge = length > 0
    ex = np.divide(ex, length, out=np.ones_like(ex), where=is_edge)
    ey = np.divide(ey, length, out=ey, where=is_edge)
    return x, y, ex, ey, length
