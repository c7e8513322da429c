"""PixelRings with fewer corners, none of which has moved by more than a tolerance, and nothing of which has met.

A simplified outline is a chain of links between points of the exact one: its corners, and the middles of the steps of
staircases, through which an inclined wall is drawn. A link replaces a stretch of outline, all of which is within the
tolerance of it, and it of that stretch. The longest are taken, one after the other. Links that would meet others, or
come near them, or go around another outline, are undone: there the outline is exact, so that what is connected stays
so, and what is apart.

References:
    H. Imai, M. Iri, "Polygonal approximations of a curve: formulations and algorithms", 1988; the longest link from a
    point, by wedges of directions: J. Sklansky, V. Gonzalez, Pattern Recognition 12, 1980.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.masks.tracing import PixelRings
from plr_jax.geometry.vectors import cross_product, distance_to_segment

CLEARANCE = 0.25
"""Pixels that links keep from one another, where they do not share an end."""


@dataclass(frozen=True, eq=False)
class _Stations:
    """Where links may begin and end, ring after ring: corners, middles of steps, and the first corner again.

    Attributes:
        points: The stations, ``(n, 2)``.
        ring: Ring of each station, ``(n,)``.
        is_corner: Which are corners, ``(n,)``.
        end: Of each station the next one that a link cannot go beyond: a contact, or the last of its ring, ``(n,)``.
    """

    points: Float[np.ndarray, "n 2"]
    ring: Int[np.ndarray, "n"]
    is_corner: Bool[np.ndarray, "n"]
    end: Int[np.ndarray, "n"]


def simplified(outlines: PixelRings, tolerance: float | int) -> PixelRings:
    """The outlines with links that differ by less than a tolerance, in pixels, from what they replace."""
    if tolerance == 0 or not len(outlines.points):
        return outlines
    stations, is_contact = _stations_of(outlines)
    farthest = _farthest(stations, tolerance * (1 - 1e-9))
    is_kept = _greedy(stations, farthest)
    while (undone := _unwanted(stations, is_kept, tolerance)).any():
        first, last = _links(stations, is_kept)
        for begin, end in zip(first[undone].tolist(), last[undone].tolist(), strict=True):
            is_kept[begin:end] |= stations.is_corner[begin:end]
    is_last = np.append(stations.ring[1:] != stations.ring[:-1], True)
    index = np.flatnonzero(is_kept & ~is_last)
    count = np.bincount(stations.ring[index], minlength=len(outlines.start) - 1)
    return PixelRings(stations.points[index], np.append(0, np.cumsum(count)), is_contact[index])


def _stations_of(outlines: PixelRings) -> tuple[_Stations, Bool[np.ndarray, "n"]]:
    """The stations of outlines, each ring from a contact on if it has one; and which stations are contacts."""
    size, num_rings = np.diff(outlines.start), len(outlines.start) - 1
    ring = np.repeat(np.arange(num_rings), size)
    place = np.arange(len(ring)) - outlines.start[ring]
    shift = np.zeros(num_rings, dtype=int)
    contacts = np.flatnonzero(outlines.is_contact)[::-1]  # the first of a ring is written last
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
    # An inclined wall is a staircase; a run that turns the same way at both ends is the end of a wall, or a bay.
    along = outlines.points[following] - outlines.points[corner]
    ahead = np.where(place + 1 < size[ring], np.arange(len(ring)) + 1, outlines.start[ring])
    turn = np.empty(len(ring))
    turn[ahead] = np.sign(cross_product(along, along[ahead]))  # at the end of each run
    kept = np.ones(len(source), dtype=bool)
    kept[at + 1] = turn != turn[ahead]
    number = np.cumsum(kept) - 1
    ring_of = np.repeat(np.arange(num_rings), 2 * size + 1)
    return _Stations(points[kept], ring_of[kept], is_corner[kept], number[end[kept]]), is_contact[kept]


def _farthest(stations: _Stations, tolerance: float) -> Int[np.ndarray, "n"]:
    """Of each station the farthest one along its ring that a link may go to: all corners between are near the link.

    All stations look ahead at once, one more step each time. The corners passed narrow the directions that a link may
    have to a wedge, of angles about that of the first corner beyond the tolerance; and a link is at least as long as
    the farthest of them is away.
    """
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
        begin, axis, least, most, length = (each[goes_on] for each in (begin, axis, least, most, length))
    return farthest


def _greedy(stations: _Stations, farthest: Int[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Which stations the longest links join, one after the other from the first of each ring."""
    onward, is_kept = farthest.tolist(), np.zeros(len(farthest), dtype=bool)
    firsts = np.flatnonzero(np.append(True, stations.ring[1:] != stations.ring[:-1]))
    kept = []
    for at in firsts.tolist():
        kept.append(at)
        while onward[at] != at:
            at = onward[at]
            kept.append(at)
    is_kept[kept] = True
    return is_kept


def _links(stations: _Stations, is_kept: Bool[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """First and last station of each link."""
    kept = np.flatnonzero(is_kept)
    joined = stations.ring[kept[1:]] == stations.ring[kept[:-1]]
    return kept[:-1][joined], kept[1:][joined]


def _unwanted(stations: _Stations, is_kept: Bool[np.ndarray, "n"], tolerance: float | int) -> Bool[np.ndarray, "m"]:
    """Which links are no stretch of the exact outline, and meet or come near another one or surround a ring."""
    first, last = _links(stations, is_kept)
    num_corners = np.append(0, np.cumsum(stations.is_corner))
    is_inexact = num_corners[last] > num_corners[first + 1]
    near = _near(stations.points[np.stack([first, last], axis=1)])
    if tolerance > 0.5:  # below, what is apart by a pixel cannot change sides
        near |= _surrounding(stations, first, last, is_inexact)
    return is_inexact & near


def _near(links: Float[np.ndarray, "m 2 2"]) -> Bool[np.ndarray, "m"]:
    """Which links come nearer than the clearance to another, or do so beyond an end that they have in common."""
    lines: Any = shapely.linestrings(links)
    a, b = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE)
    a, b = a[a < b], b[a < b]
    is_near, is_joined = np.zeros(len(links), dtype=bool), np.zeros(len(a), dtype=bool)
    folded = np.zeros(len(a), dtype=bool)
    for end in (0, 1):
        for other in (0, 1):
            shared = (links[a, end] == links[b, other]).all(axis=1)
            is_joined |= shared
            to_a = _distance(links[b, 1 - other], links[a])
            to_b = _distance(links[a, 1 - end], links[b])
            folded |= shared & (np.minimum(to_a, to_b) < CLEARANCE)
    is_bad = folded | ~is_joined
    is_near[a[is_bad]] = is_near[b[is_bad]] = True
    return is_near


def _distance(points: Float[np.ndarray, "n 2"], segments: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    start, end = segments[:, 0], segments[:, 1]
    return distance_to_segment(*(start - points).T, *(end - start).T)


def _surrounding(
    stations: _Stations, first: Int[np.ndarray, "m"], last: Int[np.ndarray, "m"], is_inexact: Bool[np.ndarray, "m"]
) -> Bool[np.ndarray, "m"]:
    """Which links have another ring between them and the outline that they replace."""
    links = np.flatnonzero(is_inexact)
    size = last[links] - first[links] + 1
    owner = np.repeat(np.arange(len(links)), size)
    at = first[links][owner] + np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    between: Any = shapely.polygons(shapely.linearrings(stations.points[at], indices=owner))
    firsts = np.flatnonzero(np.append(True, stations.ring[1:] != stations.ring[:-1]))
    points = shapely.points(stations.points[firsts])
    point, polygon = shapely.STRtree(between).query(points, predicate="within")
    other = stations.ring[firsts[point]] != stations.ring[first[links[polygon]]]
    result = np.zeros(len(first), dtype=bool)
    result[links[polygon[other]]] = True
    return result
