"""Conversion of the free pixels of an image to polygons with holes: outlines are traced exactly, then simplified."""

import math
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import (
    as_cells,
    as_finite,
    as_numbers,
    ragged_indices,
    require_choice,
    require_integer,
    shortened,
)
from plr_jax._types import ArrayLike, Points
from plr_jax.geometry.boundary import LARGEST_COORDINATE, advice_on_cells, rounding_at
from plr_jax.geometry.vectors import cross_product, distance_to_segment

# Pixel ``(row, column)`` is the square ``[column, column + 1] x [row, row + 1]``. Free pixels are 4-connected, others
# 8-connected, and everything outside the grid is blocked.
_MOST_CORNERS = 2**18  # largest outline, so that noisy pictures fail at once
_LEAST_PIXEL = 8e3  # rounding errors per pixel: tolerance is 1e3 of them, and walls are at least 1/4 pixel thick
CLEARANCE = 0.25  # pixels: least distance between two segments of simplified outlines that share no end
Numbers: TypeAlias = Int[np.ndarray, " n"]
Indices: TypeAlias = Int[np.ndarray, " m"]
Mask: TypeAlias = Bool[np.ndarray, "rows columns"]


def _free_polygons(free: Mask) -> tuple[Any, Bool[np.ndarray, "_ _"]]:
    """Return the free pixels as Shapely polygons, and where two free pixels touch only diagonally.

    Polygons have coordinates ``(row, column)``, and rings that begin at the least corner, shells clockwise. The
    second result, booleans ``(rows + 1, columns + 1)``, has an entry for each corner of pixels.
    """
    # 1. Find the corners: lattice points at which an odd number of the four pixels is free, or two opposite ones are.
    padded = np.pad(free, 1)
    lower_left, lower_right = padded[:-1, :-1], padded[:-1, 1:]
    upper_left, upper_right = padded[1:, :-1], padded[1:, 1:]
    touches = (lower_left == upper_right) & (upper_left == lower_right) & (lower_left != lower_right)
    is_corner = touches | (lower_left ^ lower_right ^ upper_left ^ upper_right)
    if (count := np.count_nonzero(is_corner)) > _MOST_CORNERS:
        got = f"{count:,}: smooth the picture, or drop its specks"
        raise ValueError(f"The outline of the pixels may have at most {_MOST_CORNERS:,} corners, got {got}.")
    # 2. In row order, corners 0 and 1, 2 and 3, ... are the ends of horizontal runs of the outlines. In column order,
    #    they are the ends of vertical runs. A contact counts twice: it ends one run and starts the next.
    corner = np.repeat(np.argwhere(is_corner), 1 + touches[is_corner], axis=0)  # (row, column)
    by_column = corner[np.argsort(corner[:, 1], kind="stable")]
    runs: Any = shapely.linestrings(np.concatenate([corner, by_column]).reshape(-1, 2, 2))
    # 3. Keep the faces between the runs whose first pixel is free: the pixel [row, column] of the least corner
    #    (row, column), since corner (r, c) is the corner of pixel [r, c] with the least row and column.
    faces: Any = shapely.normalize(shapely.get_parts(shapely.polygonize(runs)))
    least = shapely.get_coordinates(shapely.get_point(shapely.get_exterior_ring(faces), 0)).astype(int)
    return faces[free[tuple(least.T)]], touches


class _Stations(NamedTuple):
    """The *stations*: points of exact outlines of pixels at which simplified outlines may bend."""

    points: Points  # corners and some middles of edges of outlines
    ring: Numbers  # the outline of each point; its first corner is repeated as its last point
    is_corner: Bool[np.ndarray, " n"]
    end: Numbers  # the next point that a segment must not pass: a contact, or the last one of the ring


def _simplified(
    points: Points, ring: Numbers, is_contact: Bool[np.ndarray, " n"], tolerance: float | int
) -> tuple[Float[np.ndarray, "m 2"], Indices]:
    """Simplify outlines of areas of free pixels: replace parts of them by straight segments.

    A replaced part is within ``tolerance`` pixels of its segment. Outlines are simple rings of corners with the free
    pixels on the left; each ring ends at its first corner.

    Args:
        points: The corners of all outlines.
        ring: The number of the outline to which each corner belongs.
        is_contact: Whether two rings meet at a corner, between free pixels.
        tolerance: Largest distance of a replaced part from its segment, in pixels.

    Returns:
        The points of the simplified outlines, and the number of the outline to which each point belongs.
    """
    # A simplified outline is a chain of *links*, segments between *stations* of the exact outline: its corners, and
    # the middles of the steps of staircases, through which inclined walls are drawn. The longest possible links are
    # taken greedily (Imai and Iri, "Polygonal approximations of a curve", 1988). Links that come near others or
    # surround another ring are undone, so connectivity is preserved.
    if tolerance == 0 or not len(points):
        return points, ring
    stations = _stations_of(points, ring, is_contact)
    # 1. Take the longest links, one after the other from the first station of each ring to its last one, where
    #    `onward` is the station itself. The first station of the next ring follows.
    onward = _farthest(stations, tolerance * (1 - 1e-9)).tolist()
    chain = [0]
    while chain[-1] + 1 < len(onward):
        chain.append(max(onward[chain[-1]], chain[-1] + 1))
    # 2. Replace unwanted links by the exact outline. This ends since exact links are never unwanted.
    is_kept = np.isin(np.arange(len(onward)), chain)
    while links := _unwanted_links(stations, is_kept, tolerance):
        for begin, end in links:
            is_kept[begin:end] |= stations.is_corner[begin:end]
    return stations.points[is_kept], stations.ring[is_kept]


def _stations_of(points: Points, ring: Numbers, is_contact: Bool[np.ndarray, " n"]) -> _Stations:
    """Return the points of outlines at which simplified outlines may bend, called *stations*.

    Arguments are those of :func:`_simplified`.
    """
    # A ring of k corners has 2 k + 1 stations before middles are dropped: its first corner comes again at the end.
    #
    #      corner   middle of its run   corner   middle   ...   corner   middle   first corner again
    #      first                                                                  last
    #
    # 1. Let each ring begin at its first contact, if it has any.
    count = np.bincount(ring)
    _, place = ragged_indices(count)
    shift = np.zeros(len(count), dtype=int)
    contacts = np.flatnonzero(is_contact)[::-1]  # reversed, so that the first contact of a ring is kept
    shift[ring[contacts]] = place[contacts]
    size = count[ring] - 1
    row = np.arange(len(ring))
    corner = row - place + (place + shift[ring]) % size
    points, is_contact = points[corner], is_contact[corner]
    is_last = place == size
    # 2. Keep the middles of staircase steps, whose ends turn opposite ways; other runs are ends of walls or bays.
    ahead = np.roll(points, -1, axis=0)
    along = ahead - points  # the run after each corner; of no meaning after the last one of a ring
    run_before = np.where(place > 0, row - 1, row + size - 1)
    turn = np.sign(cross_product(along[run_before], along))
    turn[is_contact] = 1.0  # at a contact the ring may go on along either run: both turn left there
    turn[is_last] = turn[place == 0]
    is_kept = np.ones((len(ring), 2), dtype=bool)  # of each corner, and of the middle of the run after it
    is_kept[:, 1] = ~is_last & (turn != np.roll(turn, -1))
    # 3. Find the end of each station: the next contact, or else the last station of the ring, which is its own end.
    ends = np.flatnonzero((is_contact & (place > 0)) | is_last)
    end = np.where(is_last, row, ends[np.minimum(np.searchsorted(ends, row, side="right"), len(ends) - 1)])
    # 4. Join corners and middles.
    index = np.cumsum(is_kept) - 1
    row, is_middle = np.nonzero(is_kept)
    stations = np.stack([points, (points + ahead) / 2], axis=1)[row, is_middle]
    return _Stations(stations, ring[row], is_middle == 0, index[2 * end[row]])


def _farthest(stations: _Stations, tolerance: float) -> Numbers:
    """Return, for each station, the index of the farthest later station to which a straight link is allowed.

    Stations are the points of the exact outlines at which simplified outlines may bend. A link is a segment that
    replaces the outline between two stations. A link is allowed if all corners of the outline between the two
    stations are within ``tolerance`` pixels of the link, and none is a contact (where diagonal free pixels touch).
    """
    # All corners between must be near the segment: they narrow its directions to a wedge, and the segment must be at
    # least as long as their distances from its start (Sklansky and Gonzalez, Pattern Recognition 12, 1980).
    # A corner at distance d allows directions up to arcsin(tolerance / d) from its own, or all if d is within the
    # tolerance. The wedge, from `least` to `most`, is relative to `axis`, the direction of the first corner that
    # limits it. In each round, all links advance by one station.
    points = stations.points
    farthest = np.minimum(np.arange(len(points)) + 1, stations.end)
    begin = np.flatnonzero(stations.end > np.arange(len(points)))
    axis, least, most, length = np.zeros((4, len(begin)))
    least, most = least - np.inf, most + np.inf
    step = 0
    while len(begin):
        # 1. Does the link from `begin` to `end` fit?
        step += 1
        end = begin + step
        x, y = (points[end] - points[begin]).T
        distance, angle = np.hypot(x, y), np.arctan2(y, x)
        is_open = np.isinf(least)
        turn = (angle - axis + np.pi) % (2 * np.pi) - np.pi  # from the axis, in [-pi, pi)
        fits = (is_open | ((least <= turn) & (turn <= most))) & (length <= distance)
        farthest[begin[fits]] = end[fits]
        # 2. Longer links must pass near `end` if it is a corner.
        is_corner = stations.is_corner[end]
        narrows = is_corner & (distance > tolerance)
        axis = np.where(narrows & is_open, angle, axis)
        turn = np.where(is_open, 0.0, turn)
        spread = np.arcsin(tolerance / np.maximum(distance, tolerance))
        least = np.where(narrows, np.maximum(least, turn - spread), least)
        most = np.where(narrows, np.minimum(most, turn + spread), most)
        length = np.where(is_corner, np.maximum(length, distance), length)
        # 3. Go on unless the wedge is empty or the link must not pass its end.
        goes_on = (least <= most) & (end < stations.end[begin])
        begin, axis, least, most, length = (column[goes_on] for column in (begin, axis, least, most, length))
    return farthest


def _unwanted_links(stations: _Stations, is_kept: Bool[np.ndarray, " n"], tolerance: float | int) -> list[list[int]]:
    """Return the links that come too near to other links, or cut off another ring, as pairs of station indices.

    Stations are points of the exact outline. A link is the segment between two consecutive stations of a ring for
    which ``is_kept`` is True. Links along the exact outline are never returned.
    """
    kept = np.flatnonzero(is_kept)
    links = np.stack([kept[:-1], kept[1:]], axis=1)
    links = links[stations.ring[kept[1:]] == stations.ring[kept[:-1]]]
    first, last = links.T
    num_corners = np.append(0, np.cumsum(stations.is_corner))  # before each station
    is_inexact = num_corners[last] > num_corners[first + 1]  # a corner lies between
    is_unwanted = is_inexact & _near(stations.points[links])
    if tolerance > 0.5:  # with less, no link can pass to the other side of a ring
        is_unwanted[is_inexact] |= _surrounding(stations, first[is_inexact], last[is_inexact])
    return links[is_unwanted].tolist()


def _near(links: Float[np.ndarray, "m 2 2"]) -> Bool[np.ndarray, " m"]:
    """Return which segments come within ``CLEARANCE`` pixels of another segment.

    Segments with a common end are near if the other end of one is within ``CLEARANCE`` of the other segment.
    """
    lines: Any = shapely.linestrings(links)
    a, b = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE)
    a, b = a[a < b], b[a < b]
    # Segments that share an end are folded if the other end of one comes near the other segment.
    is_joined, is_folded = np.zeros((2, len(a)), dtype=bool)
    for a_end, b_end in product((0, 1), repeat=2):
        is_shared = (links[a, a_end] == links[b, b_end]).all(axis=1)
        is_joined |= is_shared
        for segments, points in ((links[a], links[b, 1 - b_end]), (links[b], links[a, 1 - a_end])):
            to_start, along = segments[:, 0] - points, segments[:, 1] - segments[:, 0]
            is_folded |= is_shared & (distance_to_segment(*to_start.T, *along.T) < CLEARANCE)
    is_bad = is_folded | ~is_joined
    return np.isin(np.arange(len(links)), [a[is_bad], b[is_bad]])


def _surrounding(stations: _Stations, first: Indices, last: Indices) -> Bool[np.ndarray, " m"]:
    """Return whether each link, together with the part of the outline that it replaces, encloses another outline.

    Link ``i`` is the segment from station ``first[i]`` to station ``last[i]`` of one outline.
    """
    owner, place = ragged_indices(last - first + 1)
    between: Any = shapely.polygons(shapely.linearrings(stations.points[first[owner] + place], indices=owner))
    ring_start = np.flatnonzero(np.append(True, stations.ring[1:] != stations.ring[:-1]))
    point, link = shapely.STRtree(between).query(shapely.points(stations.points[ring_start]), predicate="within")
    is_other = stations.ring[ring_start[point]] != stations.ring[first[link]]
    return np.isin(np.arange(len(first)), link[is_other])


def placed_region(
    free: ArrayLike, resolution: float | int, origin: ArrayLike, row0: str, tolerance: float | int, drop_specks: int
) -> Any:
    """Check a mask and the options of ``Workspace.from_mask``, and return the free pixels as a Shapely MultiPolygon.

    The result is in workspace units. Its outlines are simplified to ``tolerance`` pixels, and components of at most
    ``drop_specks`` pixels are removed.
    """
    # 1. Check the arguments.
    free = as_mask(free)
    require_choice("row0", row0, ("bottom", "top"))
    require_integer("drop_specks", drop_specks, 0)
    tolerance, resolution = as_finite("tolerance", tolerance), as_finite("resolution", resolution, positive=True)
    pose = as_numbers("origin", origin, "(x, y) or (x, y, yaw)")
    if pose.shape not in ((2,), (3,)) or not np.isfinite(pose).all():
        raise ValueError(f"origin must be finite numbers (x, y) or (x, y, yaw), got {shortened(origin)}.")
    require_resolved_pixels(free.shape, resolution, np.abs(pose[:2]).max())
    # 2. Turn the rows so that the lowest is first, and drop specks.
    free = free if row0 == "bottom" else free[::-1]
    free = without_specks(free, drop_specks) if drop_specks else free
    if not free.any():
        raise ValueError(f"No pixel of {free.shape[0]} x {free.shape[1]} is free.")
    # 3. Scale, turn and move the region.
    yaw = pose[2] if len(pose) == 3 else 0.0
    cosine, sine = math.cos(yaw), math.sin(yaw)

    def placed(points: Points) -> Points:
        # Not a matrix product, which may round equal points differently: both corners of a contact must stay equal.
        x, y = resolution * points.T
        return pose[:2] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)

    return shapely.transform(region_of_mask(free, tolerance), placed)


def rounded_one_by_one(region: Any, grid: float) -> Any:
    """Round each vertex of a Shapely region made of pixels to a multiple of ``grid``, much smaller than a pixel."""
    # Rounding makes no two edges meet, since they are a quarter of a pixel apart.
    return shapely.transform(region, lambda points: np.floor(points / grid + 0.5) * grid)


def require_resolved_pixels(shape: tuple[int, ...], resolution: float, origin: float) -> None:
    """Raise a ``ValueError`` if coordinates of pixels are too large, or pixels too small for the rounding errors.

    ``shape`` is the number of rows and columns, ``resolution`` the side of a pixel, and ``origin`` the largest
    absolute coordinate of the origin.
    """
    size = resolution * math.hypot(*shape)
    reach = float(origin) + size
    if not reach <= LARGEST_COORDINATE:
        got = f"pixels of side {resolution:g} as far out as {reach:g}: choose a larger unit"
        raise ValueError(f"A workspace must have coordinates up to {LARGEST_COORDINATE:g}, got {got}.")
    least = _LEAST_PIXEL * rounding_at(size, reach)
    if resolution < least:
        got = f"{resolution:g}: choose an origin nearer to zero, or check the units of both"
        raise ValueError(f"resolution must be at least {least:.2g} at coordinates up to {reach:g}, got {got}.")


def as_mask(free: ArrayLike) -> Mask:
    expected = "free[row, column], rows along y, must be booleans of shape (rows, columns), such as image > 127"
    hint = advice_on_cells(free) if getattr(free, "ndim", 0) == 3 else ""
    return as_cells(expected, free, lambda shape: len(shape) == 2, hint)


def region_of_mask(free: Mask, tolerance: float | int) -> Any:
    """Return the free pixels as a Shapely MultiPolygon in pixel units, simplified to ``tolerance`` pixels."""
    # 1. Split the polygons into rings of points (x, y).
    polygons, touches = _free_polygons(free)
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    # 2. Simplify the rings, and join them to polygons again. The first ring of each polygon is its shell.
    points, ring = _simplified(points[:, ::-1], ring, touches[tuple(points.astype(int).T)], tolerance)
    loops: Any = shapely.linearrings(points, indices=ring)
    joined: Any = shapely.polygons(loops, indices=polygon)
    return shapely.multipolygons(joined)


def without_specks(free: Mask, num_pixels: int) -> Mask:
    """Remove small components, of at most ``num_pixels`` pixels: first blocked components, then free components.

    Blocked pixels are 8-connected, free pixels 4-connected.
    """
    import scipy.ndimage  # slow to import, and most workspaces do not need it

    for value, structure in ((False, np.ones((3, 3), bool)), (True, None)):
        labeling: Any = scipy.ndimage.label(free == value, structure)
        label = labeling[0]
        is_small = np.bincount(label.ravel()) <= num_pixels
        is_small[0] = False
        free = free ^ is_small[label]
    return free
