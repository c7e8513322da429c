"""Compiled collision tests of OMPL's states and motions, so that Python does not decide the race.

OMPL hands a motion to Python as two objects of its nanobind bindings. The kernels take the addresses of these
objects, follow them to the numbers in OMPL's memory, and test the whole motion, all in one call: reading the
numbers through the bindings would cost more than testing them.

Round robots are decided by closed forms. A motion that may bring a rectangle near something is bisected: bodies
whose gap is as large as what they move in half a piece stay clear throughout the piece.

Numba is imported with this module, which only a worker process, a benchmark and tests import.
"""

import inspect
import math
from typing import Any

import numpy as np
from jaxtyping import Float
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from plr_jax.robots import shorter_turn

# Share of a rectangle's half diagonal: a motion that turns one may be refused if it comes this near to contact.
_FINEST = 1e-4
_HEADER = 6
_ROBOTS, _WALLS, _SLACK, _PIECE, _CHECKED, _FREE = range(_HEADER)


class Scene:
    """What the kernels need to know, in one block of numbers whose address they take.

    Args:
        sizes: Half length, half width and radius of each robot, 0 for what a shape lacks.
        walls: Edges of the boundary of free space, free space on their left.
        tolerance: Depth of overlap that still counts as touching.
    """

    def __init__(self, sizes: Float[np.ndarray, "robots 3"], walls: Float[np.ndarray, "walls 2 2"], tolerance: float):
        piece = _FINEST * min((math.hypot(*size[:2]) for size in sizes if size[0] > 0), default=1.0)
        header = [len(sizes), len(walls), tolerance, piece, 0, 0]
        middle, tangent = walls.mean(axis=1), walls[:, 1] - walls[:, 0]
        half, heading = np.hypot(*tangent.T) / 2, np.arctan2(tangent[:, 1], tangent[:, 0])
        table = np.column_stack([walls.reshape(-1, 4), middle, half, heading])
        self._block = np.concatenate([header, sizes.ravel(), table.ravel()])

    @property
    def address(self) -> int:
        """Where the block lies; it lives as long as the scene."""
        return self._block.ctypes.data

    @property
    def num_checked(self) -> int:
        """Motions tested so far, states included."""
        return int(self._block[_CHECKED])

    @property
    def num_free(self) -> int:
        """Those that were free."""
        return int(self._block[_FREE])


def configurations_of(state: Any, scene: Scene) -> Float[np.ndarray, "robots 3"]:
    """The configurations in an OMPL state, headings of round robots 0.

    Args:
        state: A state of the compound space of a position for each robot, then a heading for each rectangle.
        scene: The robots.

    Returns:
        A copy.
    """
    return _configurations(id(state), scene.address)


@njit(cache=True)
def is_free(first: int, last: int, scene: int) -> bool:
    """Whether a joint motion is free; a state is a motion from itself to itself.

    Args:
        first: ``id`` of the state at its start.
        last: ``id`` of the state at its end.
        scene: Address of the scene.

    Returns:
        True if all robots stay clear of walls and of one another along the whole motion. Touching is clear.
    """
    free = is_motion_free(_configurations(first, scene), _configurations(last, scene), scene)
    count_motion(free, scene)
    return free


@njit(cache=True)
def is_always_free(first: int, last: int, *addresses: int) -> bool:
    """Test nothing, so that the call itself can be timed."""
    return True


@njit(cache=True)
def count_motion(free: bool, scene: int):
    """Count a motion, and whether it was free."""
    header = carray(pointer(scene), (_HEADER,), np.float64)
    header[_CHECKED] += 1
    header[_FREE] += free


@njit(cache=True)
def is_motion_free(q0, q1, scene: int) -> bool:
    """Whether a joint motion is free, given as configurations.

    Args:
        q0: Configurations at its start, ``(robots, 3)``.
        q1: Configurations at its end.
        scene: Address of the scene.

    Returns:
        As :func:`is_free`.
    """
    header = carray(pointer(scene), (_HEADER,), np.float64)
    robots, walls, slack, piece = int(header[_ROBOTS]), int(header[_WALLS]), header[_SLACK], header[_PIECE]
    sizes = carray(pointer(scene + 8 * _HEADER), (robots, 3), np.float64)
    table = carray(pointer(scene + 8 * (_HEADER + 3 * robots)), (walls, 8), np.float64)
    for i in range(robots):
        if not _clear_of_walls(q0[i], q1[i], sizes[i], table, slack, piece):
            return False
    for i in range(robots):
        for j in range(i):
            if not _apart(q0[i], q1[i], sizes[i], q0[j], q1[j], sizes[j], slack, piece):
                return False
    return True


@njit(cache=True)
def _clear_of_walls(q0, q1, size, walls, slack, piece):
    inner, outer, boxy = _inner(size), _outer(size), size[0] > 0
    x0, y0, x1, y1 = q0[0], q0[1], q1[0], q1[1]
    left, right, low, high = min(x0, x1) - outer, max(x0, x1) + outer, min(y0, y1) - outer, max(y0, y1) + outer
    inside, on_wall = False, False
    for k in range(len(walls)):
        ax, ay, bx, by = walls[k, 0], walls[k, 1], walls[k, 2], walls[k, 3]
        # A ray from the last position to the right meets the boundary an odd number of times.
        if (ay > y1) != (by > y1) and x1 < ax + (y1 - ay) / (by - ay) * (bx - ax):
            inside = not inside
        if max(ax, bx) < left or min(ax, bx) > right or max(ay, by) < low or min(ay, by) > high:
            continue
        if _crosses(x0, y0, x1, y1, ax, ay, bx, by):
            return False
        distance = _segment_distance(x0, y0, x1, y1, ax, ay, bx, by)
        if distance < inner - slack:
            return False
        on_wall = on_wall or point_distance(x1 - ax, y1 - ay, bx - ax, by - ay) <= slack
        if boxy and distance < outer:
            wall = np.array([walls[k, 4], walls[k, 5], walls[k, 7]])
            if not _stay_apart(q0, q1, size, wall, wall, np.array([walls[k, 6], 0.0, 0.0]), slack, piece):
                return False
    return inside or on_wall


@njit(cache=True)
def _apart(a0, a1, size_a, b0, b1, size_b, slack, piece):
    """Whether two robots stay apart."""
    x, y = b0[0] - a0[0], b0[1] - a0[1]
    distance = point_distance(-x, -y, b1[0] - a1[0] - x, b1[1] - a1[1] - y)
    if distance >= _outer(size_a) + _outer(size_b) - slack:
        return True
    if (size_a[0] == 0 and size_b[0] == 0) or distance < _inner(size_a) + _inner(size_b) - slack:
        return False
    return _stay_apart(a0, a1, size_a, b0, b1, size_b, slack, piece)


@njit(cache=True)
def _stay_apart(a0, a1, size_a, b0, b1, size_b, slack, piece):
    """Whether two bodies, one a box, stay apart, by bisection: piece ``k`` of ``2**level`` after another."""
    turn_a, turn_b = _turn(a0[2], a1[2]), _turn(b0[2], b1[2])
    dx, dy = a1[0] - a0[0] - b1[0] + b0[0], a1[1] - a0[1] - b1[1] + b0[1]
    moved = math.hypot(dx, dy) + _outer(size_a) * abs(turn_a) + _outer(size_b) * abs(turn_b)
    k, count = 0, 1
    while True:
        t, reach = (k + 0.5) / count, 0.5 * moved / count
        x, y = b0[0] - a0[0] - t * dx, b0[1] - a0[1] - t * dy
        gap = _gap(x, y, a0[2] + t * turn_a, size_a, b0[2] + t * turn_b, size_b)
        if gap < -slack:
            return False
        if gap >= reach - slack:
            k += 1
            while k % 2 == 0 and count > 1:
                k, count = k // 2, count // 2
            if k == count:
                return True
        elif reach <= piece:
            return False
        else:
            k, count = 2 * k, 2 * count


@njit(cache=True)
def _gap(x, y, theta_a, size_a, theta_b, size_b):
    """A bound on the distance of two bodies, ``b`` at ``(x, y)`` from ``a``; negative where they overlap."""
    if size_b[0] == 0:
        return _gap_to_round(x, y, theta_a, size_a) - size_b[2]
    if size_a[0] == 0:
        return _gap_to_round(-x, -y, theta_b, size_b) - size_a[2]
    ca, sa, cb, sb = math.cos(theta_a), math.sin(theta_a), math.cos(theta_b), math.sin(theta_b)
    c, s = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    # Separating axes: along and across each body.
    along_a = abs(ca * x + sa * y) - size_a[0] - size_b[0] * c - size_b[1] * s
    across_a = abs(ca * y - sa * x) - size_a[1] - size_b[0] * s - size_b[1] * c
    along_b = abs(cb * x + sb * y) - size_b[0] - size_a[0] * c - size_a[1] * s
    across_b = abs(cb * y - sb * x) - size_b[1] - size_a[0] * s - size_a[1] * c
    return max(along_a, across_a, along_b, across_b)


@njit(cache=True)
def _gap_to_round(x, y, theta, size):
    """Signed distance of a point to a box about the origin."""
    c, s = math.cos(theta), math.sin(theta)
    along, across = abs(c * x + s * y) - size[0], abs(c * y - s * x) - size[1]
    return math.hypot(max(along, 0.0), max(across, 0.0)) + min(max(along, across), 0.0)


_turn = njit(cache=True)(inspect.unwrap(shorter_turn))  # without the checks of shapes that tests put around it


@njit(cache=True)
def _inner(size):
    return size[2] if size[0] == 0 else min(size[0], size[1])


@njit(cache=True)
def _outer(size):
    return size[2] if size[0] == 0 else math.hypot(size[0], size[1])


@njit(cache=True)
def _crosses(x0, y0, x1, y1, ax, ay, bx, by):
    """Whether a motion goes from one side of a wall to the other."""
    v0 = (bx - ax) * (y0 - ay) - (by - ay) * (x0 - ax)
    v1 = (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
    wa = (x1 - x0) * (ay - y0) - (y1 - y0) * (ax - x0)
    wb = (x1 - x0) * (by - y0) - (y1 - y0) * (bx - x0)
    return v0 * v1 < 0 and wa * wb <= 0


@njit(cache=True)
def _segment_distance(x0, y0, x1, y1, ax, ay, bx, by):
    """Distance of two segments that do not cross."""
    return min(
        point_distance(x0 - ax, y0 - ay, bx - ax, by - ay),
        point_distance(x1 - ax, y1 - ay, bx - ax, by - ay),
        point_distance(ax - x0, ay - y0, x1 - x0, y1 - y0),
        point_distance(bx - x0, by - y0, x1 - x0, y1 - y0),
    )


@njit(cache=True)
def point_distance(x, y, dx, dy):
    """Distance of a point to a segment from the origin to ``(dx, dy)``."""
    squared = dx * dx + dy * dy
    t = min(max((x * dx + y * dy) / squared, 0.0), 1.0) if squared > 0 else 0.0
    x, y = x - t * dx, y - t * dy
    return math.sqrt(x * x + y * y)  # hypot is slow


@njit(cache=True)
def _configurations(state, scene):
    robots = int(carray(pointer(scene), (_HEADER,), np.float64)[_ROBOTS])
    sizes = carray(pointer(scene + 8 * _HEADER), (robots, 3), np.float64)
    parts = parts_of(state, 2 * robots)
    q = np.zeros((robots, 3))
    rectangles = 0
    for i in range(robots):
        q[i, :2] = carray(pointer(word(parts[i] + 8)), (2,), np.float64)
        if sizes[i, 0] > 0:
            q[i, 2] = carray(pointer(parts[robots + rectangles] + 8), (1,), np.float64)[0]
            rectangles += 1
    return q


@njit(cache=True)
def parts_of(state: int, num_parts: int):
    """Addresses of the parts of a compound state, given its ``id`` and how many to read."""
    # A nanobind instance holds, after its 16-byte Python header, where its C++ object is, as a distance to it or
    # to a pointer to it; bit 2 of the flags that follow says which. An OMPL state has its data after one
    # pointer: the parts of a compound state, the values of a real vector, the value of an angle or a time.
    offset, flags = carray(pointer(state + 16), (2,), np.int32)
    parts = state + offset
    if not flags & 4:
        parts = word(parts)
    return carray(pointer(word(parts + 8)), (num_parts,), np.int64)


@njit(cache=True)
def word(address):
    """The eight bytes at an address, as an integer."""
    return carray(pointer(address), (1,), np.int64)[0]


def _pointer(typing_context, address):
    """A number as a pointer."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), generate


pointer: Any = intrinsic(_pointer)  # of one argument, the number: Numba adds the context
