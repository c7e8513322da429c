"""Compiled collision tests of one robot's motions in space and time, among robots that move along known tracks.

A state is a position and a time, a motion a straight line between two, and a track the rows ``(x, y, t)`` of a whole
path, which all end at the same time. Positions are in workspace units, and times in those in which a robot moves by
one at most.

Numba is imported with this module, which only a worker process and tests import.
"""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from numba import njit
from numba.np.numpy_support import carray

from experiments.baselines.ompl_motions import count_motion, is_motion_free, parts_of, point_distance, pointer, word

Track: TypeAlias = Float[np.ndarray, "rows 3"]

_ROUNDING = 1e-9  # by which a motion may seem faster than it is


class Traffic:
    """What a robot has to keep away from but walls, in one block of numbers whose address the kernels take.

    Args:
        tracks: Of the others, times rising.
        reaches: Distances to keep from them.
    """

    def __init__(self, tracks: Sequence[Track], reaches: Sequence[float]):
        heads = [(len(track), reach) for track, reach in zip(tracks, reaches, strict=True)]
        self._block = np.concatenate([[len(tracks)], np.ravel(heads), *map(np.ravel, tracks)])

    @property
    def address(self) -> int:
        """Where the block lies; it lives as long as the traffic."""
        return self._block.ctypes.data


def row_of(state: Any) -> Float[np.ndarray, "3"]:
    """The position and the time in an OMPL state of a compound space of a plane and a time."""
    return _row(id(state))


@njit(cache=True)
def is_free(first: int, last: int, scene: int, traffic: int) -> bool:
    """Whether a motion is possible and free; a state is a motion from itself to itself.

    Args:
        first: ``id`` of the state at its start.
        last: ``id`` of the state at its end.
        scene: Address of a scene of the robot alone, which is round.
        traffic: Address of the others' tracks.

    Returns:
        True if it does not lead back in time, is not too fast, and stays clear of walls and of the others.
    """
    free = is_motion_free_among(_row(first), _row(last), scene, traffic)
    count_motion(free, scene)
    return free


@njit(cache=True)
def is_motion_free_among(a, b, scene: int, traffic: int) -> bool:
    """Whether a motion is possible and free, given as rows.

    Args:
        a: Its start, ``(x, y, t)``.
        b: Its end.
        scene: As of :func:`is_free`.
        traffic: As of :func:`is_free`.

    Returns:
        As :func:`is_free`.
    """
    if math.hypot(b[0] - a[0], b[1] - a[1]) > (b[2] - a[2]) * (1 + _ROUNDING):
        return False
    if not is_motion_free(a.reshape(1, 3), b.reshape(1, 3), scene):  # a round robot's heading is not looked at
        return False
    num_tracks = int(carray(pointer(traffic), (1,), np.float64)[0])
    heads = carray(pointer(traffic + 8), (num_tracks, 2), np.float64)
    address = traffic + 8 + 16 * num_tracks
    for k in range(num_tracks):
        num_rows = int(heads[k, 0])
        if not _keeps_away(a, b, carray(pointer(address), (num_rows, 3), np.float64), heads[k, 1]):
            return False
        address += 24 * num_rows
    return True


@njit(cache=True)
def _keeps_away(a, b, track, reach):
    """Whether a motion stays at a distance from what moves along a track."""
    span = b[2] - a[2]
    vx, vy = ((b[0] - a[0]) / span, (b[1] - a[1]) / span) if span > 0 else (0.0, 0.0)
    for i in range(_last_row_before(track, a[2]), len(track) - 1):
        begin, end = max(a[2], track[i, 2]), min(b[2], track[i + 1, 2])
        if begin > end:
            return True
        duration = track[i + 1, 2] - track[i, 2]
        ux, uy = (track[i + 1, 0] - track[i, 0]) / duration, (track[i + 1, 1] - track[i, 1]) / duration
        x = track[i, 0] + (begin - track[i, 2]) * ux - a[0] - (begin - a[2]) * vx
        y = track[i, 1] + (begin - track[i, 2]) * uy - a[1] - (begin - a[2]) * vy
        if point_distance(x, y, (end - begin) * (vx - ux), (end - begin) * (vy - uy)) < reach:
            return False
    return True


@njit(cache=True)
def _last_row_before(track, time):
    """The last row from which a motion begins at a time or before."""
    low, high = 0, len(track) - 2
    while low < high:
        middle = (low + high + 1) // 2
        if track[middle, 2] <= time:
            low = middle
        else:
            high = middle - 1
    return low


@njit(cache=True)
def _row(state):
    parts = parts_of(state, 2)
    row = np.empty(3)
    row[:2] = carray(pointer(word(parts[0] + 8)), (2,), np.float64)
    row[2] = carray(pointer(parts[1] + 8), (1,), np.float64)[0]
    return row
