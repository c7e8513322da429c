"""Conversion of the free pixels of a grid to polygons with holes: exact tracing of outlines, then simplification."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry import MultiPolygon, Polygon

from plr_jax._arrays import (
    as_cells,
    as_finite,
    as_numbers,
    product_in_order,
    ragged_indices,
    require_integer,
    shortened,
)
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import LARGEST_COORDINATE, advice_on_cells, rounding_at
from plr_jax.geometry.vectors import cross_product, distance_to_segment

# Pixel ``(row, column)`` is the square ``[column, column + 1] x [row, row + 1]``. Free pixels are 4-connected, others
# 8-connected, and everything outside the grid is blocked.
_MOST_CORNERS = 2**18  # largest outline, so that noisy pictures fail at once
_LEAST_PIXEL = 8e3  # rounding errors per pixel: tolerance is 1e3 of them, and walls are at least 1/4 pixel thick
_ALL_AROUND = np.ones((3, 3), dtype=bool)
CLEARANCE = 0.25  # pixels that links without a common end keep from one another
Indices: TypeAlias = Int[np.ndarray, " m"]
Mask: TypeAlias = Bool[np.ndarray, "rows columns"]


@dataclass(frozen=True, eq=False)
class PixelRings:
    """Outlines of areas of free pixels, as closed rings of corners with the free pixels on the left."""

    points: Float[np.ndarray, "n 2"]  # corners of ring r: points[start[r] : start[r + 1]]
    start: Int[np.ndarray, " rings_and_1"]
    is_contact: Bool[np.ndarray, " n"]  # whether two rings meet at a corner, or one ring twice, between free pixels


def pixel_rings(free: Mask) -> PixelRings:
    """Return the outlines of the free pixels, in units of pixels."""
    padded = np.pad(free, 1)
    lower_left, lower_right = padded[:-1, :-1], padded[:-1, 1:]
    upper_left, upper_right = padded[1:, :-1], padded[1:, 1:]
    touches = (lower_left == upper_right) & (upper_left == lower_right) & (lower_left != lower_right)
    is_corner = touches | (lower_left ^ lower_right ^ upper_left ^ upper_right)
    if (count := np.count_nonzero(is_corner)) > _MOST_CORNERS:
        raise ValueError(
            f"The outline of the pixels may have at most {_MOST_CORNERS:,} corners, got {count:,}: smooth the "
            "picture, or drop its specks."
        )
    y, x = np.nonzero(is_corner)
    # A contact is two corners: the end of one horizontal run, then the start of the next.
    twice = np.where(touches[y, x], 2, 1)
    is_contact = np.repeat(twice == 2, twice)
    is_second = np.append(False, is_contact[1:] & (np.diff(np.repeat(np.arange(len(x)), twice)) == 0))
    x, y = np.repeat(x, twice), np.repeat(y, twice)
    # In row order, corners 0 and 1, 2 and 3, ... are the ends of horizontal runs; in column order, of vertical runs.
    along_x = np.arange(len(x)) ^ 1
    # A ring turns around its free pixel: a run that arrives from the left goes down if the pixel is below, else up.
    goes_down = padded[y, x]
    columns = np.lexsort((is_second == goes_down, y, x))
    along_y = np.empty_like(columns)
    along_y[columns] = columns[np.arange(len(x)) ^ 1]
    # Free space is on the left, so rings go right along runs with free pixels above them.
    is_left_end = np.arange(len(x)) % 2 == 0
    right_of = x + np.where(is_left_end, 0, -1)
    free_above = padded[y + 1, right_of + 1]
    leaves_along_x = is_left_end == free_above
    follower = np.where(leaves_along_x, along_x, along_y)
    # Collect the cycles of followers, each from its smallest corner on.
    onward, order, start = follower.tolist(), [], []
    for first in range(len(onward)):
        if onward[first] < 0:
            continue
        start.append(len(order))
        at = first
        while onward[at] >= 0:
            order.append(at)
            onward[at], at = -1, onward[at]
    order, start = np.array(order, dtype=np.int64), np.array([*start, len(order)], dtype=np.int64)
    return PixelRings(np.stack([x, y], axis=1)[order].astype(float), start, is_contact[order])


@dataclass(frozen=True, eq=False)
class _Stations:
    """The points of exact outlines of pixels at which simplified outlines may bend."""

    points: Float[np.ndarray, "n 2"]  # corners and some middles of edges of outlines
    ring: Int[np.ndarray, " n"]  # the outline of each point; its first corner is repeated as its last point
    is_corner: Bool[np.ndarray, " n"]
    end: Int[np.ndarray, " n"]  # the next point that a segment must not pass: a contact, or the last one of the ring


def simplified(outlines: PixelRings, tolerance: float | int) -> PixelRings:
    """Replace stretches of outlines by straight segments that stay within ``tolerance`` pixels of them."""
    # A simplified outline is a chain of *links*, segments between *stations* of the exact outline: its corners, and
    # the middles of the steps of staircases, through which inclined walls are drawn. The longest possible links are
    # taken greedily (Imai and Iri, "Polygonal approximations of a curve", 1988). Links that come near others or
    # surround another ring are undone, so connectivity is preserved.
    if tolerance == 0 or not len(outlines.points):
        return outlines
    stations, is_contact = _stations_of(outlines)
    # Take the longest links, one after the other from the first station of each ring.
    onward, chain = _farthest(stations, tolerance * (1 - 1e-9)).tolist(), []
    for at in np.flatnonzero(np.append(True, stations.ring[1:] != stations.ring[:-1])).tolist():
        chain.append(at)
        while onward[chain[-1]] != chain[-1]:
            chain.append(onward[chain[-1]])
    is_kept = np.isin(np.arange(len(onward)), chain)
    while (undone := _unwanted(stations, is_kept, tolerance)).any():
        first, last = _links(stations, is_kept)
        for begin, end in zip(first[undone].tolist(), last[undone].tolist(), strict=True):
            is_kept[begin:end] |= stations.is_corner[begin:end]
    is_last = np.append(stations.ring[1:] != stations.ring[:-1], True)
    index = np.flatnonzero(is_kept & ~is_last)
    count = np.bincount(stations.ring[index], minlength=len(outlines.start) - 1)
    return PixelRings(stations.points[index], np.append(0, np.cumsum(count)), is_contact[index])


def _stations_of(outlines: PixelRings) -> tuple[_Stations, Bool[np.ndarray, " n"]]:
    # The second result says whether two outlines, or one twice, meet at a station. A ring of k corners, which begins
    # at its first contact if it has any, has 2 k + 1 stations before middles are dropped: a corner, the middle of its
    # run, the next corner, ..., and the first corner again.
    size, num_rings = np.diff(outlines.start), len(outlines.start) - 1
    ring, place = ragged_indices(size)
    shift = np.zeros(num_rings, dtype=int)
    contacts = np.flatnonzero(outlines.is_contact)[::-1]  # reversed, so that the first contact of a ring is kept
    shift[ring[contacts]] = place[contacts]
    corner = outlines.start[ring] + (place + shift[ring]) % size[ring]
    following = outlines.start[ring] + (place + 1 + shift[ring]) % size[ring]
    at = 2 * np.arange(len(ring)) + ring
    first, last = at[outlines.start[:-1]], at[outlines.start[1:] - 1] + 2
    source = np.empty(2 * len(ring) + num_rings, dtype=int)
    source[at], source[at + 1], source[last] = corner, corner, corner[outlines.start[:-1]]
    points = outlines.points[source]
    points[at + 1] = (outlines.points[corner] + outlines.points[following]) / 2
    is_corner = np.ones(len(source), dtype=bool)
    is_corner[at + 1] = False
    is_contact = outlines.is_contact[source] & is_corner
    is_end = is_contact.copy()
    is_end[first], is_end[last] = False, True
    ends = np.flatnonzero(is_end)
    end = ends[np.minimum(np.searchsorted(ends, np.arange(len(source)), side="right"), len(ends) - 1)]
    end[last] = last
    # Keep the middles of staircase steps, whose ends turn opposite ways; other runs are ends of walls or bays.
    along = outlines.points[following] - outlines.points[corner]
    ahead = np.where(place + 1 < size[ring], np.arange(len(ring)) + 1, outlines.start[ring])
    turn = np.empty(len(ring))
    turn[ahead] = np.sign(cross_product(along, along[ahead]))  # turn at the end of each run
    is_kept = np.ones(len(source), dtype=bool)
    is_kept[at + 1] = turn != turn[ahead]
    index = np.cumsum(is_kept) - 1
    ring_of = np.repeat(np.arange(num_rings), 2 * size + 1)
    return _Stations(points[is_kept], ring_of[is_kept], is_corner[is_kept], index[end[is_kept]]), is_contact[is_kept]


def _farthest(stations: _Stations, tolerance: float) -> Int[np.ndarray, " n"]:
    # The result is the farthest later station to which a link from each station may go.
    # All corners between must be near the segment: they narrow its directions to a wedge, and the segment must be at
    # least as long as their distances from its start (Sklansky and Gonzalez, Pattern Recognition 12, 1980).
    # A corner at distance d allows directions up to arcsin(tolerance / d) from its own, or all if d is within the
    # tolerance. The wedge, from `least` to `most`, is relative to `axis`, the direction of the first corner that
    # limits it.
    points, farthest = stations.points, np.minimum(np.arange(len(stations.points)) + 1, stations.end)
    begin = np.flatnonzero(stations.end > np.arange(len(points)))
    axis, least, most, length = np.zeros((4, len(begin)))
    least, most = least - np.inf, most + np.inf
    step = 0
    while len(begin):
        step += 1
        at = begin + step
        x, y = (points[at] - points[begin]).T
        distance, angle = np.hypot(x, y), np.arctan2(y, x)
        is_open = np.isinf(least)
        turn = (angle - axis + np.pi) % (2 * np.pi) - np.pi
        fits = (is_open | ((least <= turn) & (turn <= most))) & (length <= distance)
        farthest[begin[fits]] = at[fits]
        is_corner = stations.is_corner[at]
        narrows = is_corner & (distance > tolerance)
        axis = np.where(narrows & is_open, angle, axis)
        turn = np.where(is_open, 0.0, turn)
        spread = np.arcsin(tolerance / np.maximum(distance, tolerance))
        least = np.where(narrows, np.maximum(least, turn - spread), least)
        most = np.where(narrows, np.minimum(most, turn + spread), most)
        length = np.where(is_corner, np.maximum(length, distance), length)
        goes_on = (least <= most) & (at < stations.end[begin])
        begin, axis, least, most, length = (column[goes_on] for column in (begin, axis, least, most, length))
    return farthest


def _links(stations: _Stations, is_kept: Bool[np.ndarray, " n"]) -> tuple[Indices, Indices]:
    kept = np.flatnonzero(is_kept)
    joined = stations.ring[kept[1:]] == stations.ring[kept[:-1]]
    return kept[:-1][joined], kept[1:][joined]


def _unwanted(stations: _Stations, is_kept: Bool[np.ndarray, " n"], tolerance: float | int) -> Bool[np.ndarray, " m"]:
    first, last = _links(stations, is_kept)
    num_corners = np.append(0, np.cumsum(stations.is_corner))
    is_inexact = num_corners[last] > num_corners[first + 1]
    near = _near(stations.points[np.stack([first, last], axis=1)])
    if tolerance > 0.5:  # with less, no link can pass to the other side of a ring
        near[is_inexact] |= _surrounding(stations, first[is_inexact], last[is_inexact])
    return is_inexact & near


def _near(links: Float[np.ndarray, "m 2 2"]) -> Bool[np.ndarray, " m"]:
    """Return which segments come within ``CLEARANCE`` pixels of another segment, elsewhere than at a common end."""
    lines: Any = shapely.linestrings(links)
    a, b = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE)
    a, b = a[a < b], b[a < b]
    is_joined, folded = np.zeros((2, len(a)), dtype=bool)
    for end, other in product((0, 1), repeat=2):
        shared = (links[a, end] == links[b, other]).all(axis=1)
        is_joined |= shared
        for segments, points in ((links[a], links[b, 1 - other]), (links[b], links[a, 1 - end])):
            to_start, along = segments[:, 0] - points, segments[:, 1] - segments[:, 0]
            folded |= shared & (distance_to_segment(*to_start.T, *along.T) < CLEARANCE)
    is_bad = folded | ~is_joined
    return np.isin(np.arange(len(links)), [a[is_bad], b[is_bad]])


def _surrounding(stations: _Stations, first: Indices, last: Indices) -> Bool[np.ndarray, " m"]:
    """Return which segments enclose another outline, together with the part of their outline that they replace."""
    owner, place = ragged_indices(last - first + 1)
    between: Any = shapely.polygons(shapely.linearrings(stations.points[first[owner] + place], indices=owner))
    firsts = np.flatnonzero(np.append(True, stations.ring[1:] != stations.ring[:-1]))
    points = shapely.points(stations.points[firsts])
    point, link = shapely.STRtree(between).query(points, predicate="within")
    is_other = stations.ring[firsts[point]] != stations.ring[first[link]]
    return np.isin(np.arange(len(first)), link[is_other])


def placed_region(
    free: ArrayLike, resolution: float | int, origin: ArrayLike, row0: str, tolerance: float | int, drop_specks: int
) -> Any:
    """Check a mask, and return its free pixels as a simplified Shapely region in workspace units, without specks."""
    free = as_mask(free)
    if row0 not in ("bottom", "top"):
        raise ValueError(f"row0 must be 'bottom' or 'top', got {shortened(row0)}.")
    require_integer("drop_specks", drop_specks, 0)
    tolerance, resolution = as_finite("tolerance", tolerance), as_finite("resolution", resolution, positive=True)
    pose = as_numbers("origin", origin, "(x, y) or (x, y, yaw)")
    if pose.shape not in ((2,), (3,)) or not np.isfinite(pose).all():
        raise ValueError(f"origin must be finite numbers (x, y) or (x, y, yaw), got {shortened(origin)}.")
    require_resolved_pixels(free.shape, resolution, np.abs(pose[:2]).max())
    free = free if row0 == "bottom" else free[::-1]
    free = without_specks(free, drop_specks) if drop_specks else free
    if not free.any():
        raise ValueError(f"No pixel of {free.shape[0]} x {free.shape[1]} is free.")
    yaw = pose[2] if len(pose) == 3 else 0.0
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    # The product is computed in a fixed order, so that both corners of a contact get the same place.
    region = region_of_mask(free, tolerance)
    return shapely.transform(region, lambda points: pose[:2] + product_in_order(resolution * points, turn))


def rounded_one_by_one(region: Any, grid: float) -> Any:
    """Round each vertex of a region of pixels to a multiple of ``grid``, much smaller than a pixel."""
    # No edges meet, since they are a quarter of a pixel apart.
    return shapely.transform(region, lambda points: np.floor(points / grid + 0.5) * grid)


def require_resolved_pixels(shape: tuple[int, ...], resolution: float, origin: float) -> None:
    """Raise a ``ValueError`` if coordinates of pixels overflow, or a pixel is not much larger than their rounding."""
    size = resolution * math.hypot(*shape)
    reach = float(origin) + size
    if not reach <= LARGEST_COORDINATE:
        raise ValueError(
            f"A workspace must have coordinates up to {LARGEST_COORDINATE:g}, got pixels of side {resolution:g} as "
            f"far out as {reach:g}: choose a larger unit."
        )
    least = _LEAST_PIXEL * rounding_at(size, reach)
    if resolution < least:
        raise ValueError(
            f"resolution must be at least {least:.2g} at coordinates up to {reach:g}, got {resolution:g}: choose an "
            "origin nearer to zero, or check the units of both."
        )


def as_mask(free: ArrayLike) -> Mask:
    expected = "free[row, column], rows along y, must be booleans of shape (rows, columns), such as image > 127"
    hint = advice_on_cells(free) if getattr(free, "ndim", 0) == 3 else ""
    return as_cells(expected, free, lambda shape: len(shape) == 2, hint)


def region_of_mask(free: Mask, tolerance: float | int) -> Any:
    """Return the free pixels as a Shapely MultiPolygon in pixel units, simplified to ``tolerance`` pixels."""
    outlines = pixel_rings(free)
    # Find the component of free pixels on the left of each ring.
    begin = outlines.points[outlines.start[:-1]].astype(int)
    ahead = np.sign(outlines.points[outlines.start[:-1] + 1].astype(int) - begin)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    column, row = (begin + (ahead + left - 1) // 2).T
    component = _labels(free)[row, column]
    rings = simplified(outlines, tolerance)
    loops, ring = _simple_loops(rings)
    component = component[ring]
    # The one counterclockwise loop of a component is its shell; its other loops are holes.
    is_outer = shapely.is_ccw(loops)
    shells = loops[is_outer][np.argsort(component[is_outer])]
    holes, part = loops[~is_outer], component[~is_outer]
    order = np.argsort(part, kind="stable")
    holes = np.split(holes[order], np.searchsorted(part[order], np.arange(2, len(shells) + 1)))
    return MultiPolygon([Polygon(shell, rings) for shell, rings in zip(shells, holes, strict=True)])


def without_specks(free: Mask, num_pixels: int) -> Mask:
    """Remove components of at most ``num_pixels`` pixels, blocked, then free."""
    for value, structure in ((False, _ALL_AROUND), (True, None)):
        label = _labels(free == value, structure)
        is_small = np.bincount(label.ravel()) <= num_pixels
        is_small[0] = False
        free = free ^ is_small[label]
    return free


def _labels(pixels: Mask, structure: Bool[np.ndarray, "3 3"] | None = None) -> Int[np.ndarray, "rows columns"]:
    import scipy.ndimage  # slow to import, and most workspaces do not need it

    labeling: Any = scipy.ndimage.label(pixels, structure)
    return labeling[0]


def _simple_loops(rings: PixelRings) -> tuple[Any, Int[np.ndarray, " loops"]]:
    """Split rings where they touch themselves; return Shapely rings, and for each the index of its original."""
    order, ring = np.arange(len(rings.points)), np.repeat(np.arange(len(rings.start) - 1), np.diff(rings.start))
    loop = ring.copy()
    num_loops = len(rings.start) - 1
    for meets in np.unique(ring[rings.is_contact]).tolist():
        begin, end = rings.start[meets], rings.start[meets + 1]
        parts = _loops_of(rings.points[begin:end], rings.is_contact[begin:end])
        order[begin:end] = begin + np.concatenate(parts)
        loop[begin:end] = np.repeat([meets, *range(num_loops, num_loops + len(parts) - 1)], [len(p) for p in parts])
        num_loops += len(parts) - 1
    sorted_by_loop = np.argsort(loop, kind="stable")
    loops: Any = shapely.linearrings(rings.points[order][sorted_by_loop], indices=loop[sorted_by_loop])
    ring_of = np.empty(num_loops, dtype=int)
    ring_of[loop] = ring
    return loops, ring_of


def _loops_of(points: Float[np.ndarray, "n 2"], is_contact: Bool[np.ndarray, " n"]) -> list[list[int]]:
    """Split a ring at corners that it passes twice, where free pixels touch; return each loop's point indices."""
    loops, path, place = [], [], {}
    for i, (point, meets) in enumerate(zip(map(tuple, points.tolist()), is_contact.tolist(), strict=True)):
        if meets and point in place:
            loops.append(path[place[point] :])
            for j in loops[-1]:
                place.pop(tuple(points[j].tolist()), None)
            path = path[: -len(loops[-1])]
        if meets:
            place[point] = len(path)
        path.append(i)
    return [*loops, path]
