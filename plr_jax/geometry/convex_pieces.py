"""Convex pieces of a region in the plane, many at once: cut by lines along the axes, measured.

All of them stand in one array, coordinate by coordinate, a piece a row, its corners counterclockwise. A piece of
fewer corners than rows have room for repeats its last one.
"""

from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.vectors import cross_product

Pieces: TypeAlias = Float[np.ndarray, "2 pieces corners"]
ROOM = 8
"""Corners of a triangle cut by a box, at most 7, and one more."""


def convex_pieces(region: Any) -> Float[np.ndarray, "2 pieces 3"]:
    """Triangles that fill a region of polygons, counterclockwise."""
    from plr_jax.geometry.polygons import triangulate  # needs Shapely, which a query does not

    triangles = triangulate(region)
    clockwise = cross_product(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) < 0
    triangles[clockwise] = triangles[clockwise, ::-1]
    return triangles.transpose(2, 0, 1)


def clip(pieces: Pieces, height: Float[np.ndarray, "pieces corners"]) -> Float[np.ndarray, "2 pieces room"]:
    """What of each piece lies where a linear function, given at its corners, is not below zero.

    Pieces must reach above zero; what touches it alone becomes a piece without area.
    """
    inside = height >= 0
    after = following(height)
    crosses = inside != (after >= 0)
    share = np.divide(height, height - after, out=np.zeros_like(height), where=crosses)
    repeats = np.zeros(inside.shape, bool)
    repeats[:, 1:] = (pieces[0, :, 1:] == pieces[0, :, :-1]) & (pieces[1, :, 1:] == pieces[1, :, :-1])
    kept = np.stack([inside & ~repeats, crosses], axis=2).reshape(len(height), 2 * height.shape[1])
    row, column = np.nonzero(kept)
    count = kept.sum(axis=1)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    last = np.minimum(np.arange(ROOM), np.maximum(count - 1, 0)[:, None])
    result = np.empty((2, len(height), ROOM))
    for along, clipped in zip(pieces, result, strict=True):
        met = along + share * (following(along) - along)
        points = np.stack([along, met], axis=2).reshape(len(height), 2 * height.shape[1])
        clipped[row, place] = points[row, column]
        clipped[:] = np.take_along_axis(clipped, last, axis=1)
    return result


def centers(pieces: Pieces) -> Float[np.ndarray, "pieces 2"]:
    """A point inside each piece: the mean of its corners, wherever they begin and however often one is repeated."""
    new = np.ones(pieces.shape[1:], bool)
    new[:, 1:] = (pieces[:, :, 1:] != pieces[:, :, :-1]).any(axis=0)
    new[:, 0] = (pieces[:, :, 0] != pieces[:, :, -1]).any(axis=0)
    new[~new.any(axis=1)] = True
    return ((pieces * new).sum(axis=2) / new.sum(axis=1)).T


def areas(pieces: Pieces) -> Float[np.ndarray, "pieces"]:
    """Area of each piece."""
    x, y = pieces - pieces[:, :, :1]
    return (x[:, :-1] * y[:, 1:] - x[:, 1:] * y[:, :-1]).sum(axis=1) / 2


def boxes_as_pieces(lo: Float[np.ndarray, "n 2"], hi: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 n room"]:
    """Boxes as pieces."""
    corner = np.minimum(np.arange(ROOM), 3)
    x = np.stack([lo[:, 0], hi[:, 0], hi[:, 0], lo[:, 0]], axis=1)[:, corner]
    y = np.stack([lo[:, 1], lo[:, 1], hi[:, 1], hi[:, 1]], axis=1)[:, corner]
    return np.stack([x, y])


def contain(
    pieces: Pieces, points: Float[np.ndarray, "pieces k 2"], tolerance: float
) -> Bool[np.ndarray, "pieces k"]:
    """Whether each piece holds its points, ``k`` each, to the tolerance."""
    near = np.ones(points.shape[:2], bool)
    for along, at in zip(pieces, np.moveaxis(points, 2, 0), strict=True):
        near &= at >= lowest(along)[:, None] - tolerance
        near &= at <= highest(along)[:, None] + tolerance
    piece, place = np.nonzero(near)
    (x, y), (px, py) = pieces[:, piece], points[piece, place].T
    inside = np.ones(len(piece), bool)
    for corner in range(x.shape[1]):  # NumPy is slow where the last axis is short
        start_x, start_y = x[:, corner - 1], y[:, corner - 1]
        ex, ey = x[:, corner] - start_x, y[:, corner] - start_y
        inside &= ex * (py - start_y) - ey * (px - start_x) >= -tolerance * np.sqrt(ex * ex + ey * ey)
    near[piece, place] = inside
    return near


def cut_parts(
    pieces: Pieces,
    first_piece: Int[np.ndarray, "cells_plus_one"],
    parent: Int[np.ndarray, "parts"],
    axis: Int[np.ndarray, "parts"],
    is_upper: Bool[np.ndarray, "parts"],
    lo: Float[np.ndarray, "parts 2"],
    hi: Float[np.ndarray, "parts 2"],
) -> tuple[
    Float[np.ndarray, "2 some room"], Int[np.ndarray, "some"], Int[np.ndarray, "some"], Bool[np.ndarray, "some"]
]:
    """What of cells' pieces lies in parts of the cells: in boxes, each cut from a cell along one axis.

    Args:
        pieces: Pieces of cells, cell by cell.
        first_piece: First piece of each cell, and their number.
        parent: The cell that each part is cut from.
        axis: The axis along which it is.
        is_upper: Whether it is the upper part of the cell along this axis, or the lower one.
        lo: Lower corners of the parts.
        hi: Upper corners.

    Returns:
        The pieces, part by part, those that a cut leaves no area of perhaps among them; the part of each; the piece
        that it was; and whether it was cut.
    """
    rows, part = run_members(first_piece, parent)
    along, upper = axis[part], is_upper[part]
    bound = np.where(upper, lo[part, along], hi[part, along])
    height = (pieces[along, rows] - bound[:, None]) * np.where(upper, 1.0, -1.0)[:, None]
    reaches = np.flatnonzero(highest(height) > 0)
    rows, part, height = rows[reaches], part[reaches], height[reaches]
    is_cut = lowest(height) < 0
    result = pieces[:, rows]
    result[:, is_cut] = clip(result[:, is_cut], height[is_cut])
    return result, part, rows, is_cut


def clip_to_box(
    pieces: Pieces, lo: Float[np.ndarray, "2"], hi: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "2 kept room"], Int[np.ndarray, "kept"]]:
    """What of the pieces lies in a box, in their order, but nothing without area; and which pieces these are."""
    rows = np.arange(pieces.shape[1])
    for axis in range(2):
        for sign, bound in ((1, lo[axis]), (-1, hi[axis])):
            reaches = (sign * (pieces[axis] - bound) > 0).any(axis=1)
            pieces, rows = pieces[:, reaches], rows[reaches]
            pieces = clip(pieces, sign * (pieces[axis] - bound))
    some = areas(pieces) > 0
    return pieces[:, some], rows[some]


def following(values: Float[np.ndarray, "pieces corners"]) -> Float[np.ndarray, "pieces corners"]:
    """What belongs to the next corner."""
    return np.concatenate([values[:, 1:], values[:, :1]], axis=1)


def lowest(values: Float[np.ndarray, "pieces corners"]) -> Float[np.ndarray, "pieces"]:
    """The least value of each piece, found corner by corner: NumPy is slow where the last axis is short."""
    return np.ascontiguousarray(values.T).min(axis=0)


def highest(values: Float[np.ndarray, "pieces corners"]) -> Float[np.ndarray, "pieces"]:
    """The largest value of each piece, as :func:`lowest`."""
    return np.ascontiguousarray(values.T).max(axis=0)
