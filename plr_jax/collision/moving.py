"""Bodies in straight motion, and the bisection of their motions until what a kernel says of them is certain.

A motion goes from one configuration to another in one unit of time: the position at constant velocity, the
heading at a constant rate along the shorter turn. Touching is no collision.

Over a piece of a motion, a body is shut off from another by an axis that stands still or rides with one of the
two: the gap along it deviates from its linear interpolation by at most an eighth of its largest second derivative,
so the smaller of the gaps at the piece's two ends, less that *bulge*, holds throughout. Bulges fall fourfold at
each bisection, and vanish for bodies that only translate, whose answer is therefore exact. A piece that is still
uncertain at the last bisection counts as a collision.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._deadline import require_time
from plr_jax.robots.robot import Robot, shorter_turn

_MAX_BISECTIONS = 12
_CORNERS = 1 << 16  # of bodies at a time, between two looks at the clock, which bounds the temporaries as well

Column: TypeAlias = Float[np.ndarray, "n"]
Columns: TypeAlias = tuple[Column, Column]


class MovingBodies(NamedTuple):
    """Bodies in straight motion, one a column. What their size holds is between a kernel and its caller."""

    size: Float[np.ndarray, "*size n"]
    x: Column
    y: Column
    theta: Column
    dx: Column
    dy: Column
    turn: Column

    @property
    def num_corners(self) -> int:
        """Corners of each, or the numbers that its size holds."""
        return len(self.size) if self.size.ndim == 2 else self.size.shape[1]

    def take(self, columns: np.ndarray | slice) -> "MovingBodies":
        """The bodies of some columns, by index, mask or slice."""
        return MovingBodies(self.size[..., columns], *(column[columns] for column in self[1:]))

    def sized(self, size: Float[np.ndarray, "*size"]) -> "MovingBodies":
        """The same motions of bodies that all have one size."""
        return self._replace(size=np.broadcast_to(size[..., None], (*size.shape, len(self.x))))

    def bisected(self) -> "MovingBodies":
        """The first and the second half of each motion, side by side."""
        half = [0.5 * rate for rate in self[4:]]
        pose = [np.stack([q, q + rate], axis=1).ravel() for q, rate in zip(self[1:4], half, strict=True)]
        return MovingBodies(np.repeat(self.size, 2, axis=-1), *pose, *(np.repeat(rate, 2) for rate in half))


def moving(robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]) -> MovingBodies:
    """A robot's motions, their size left open; one without a heading keeps 0."""
    heading, turn = np.zeros(len(q0)), np.zeros(len(q0))
    if robot.dof == 3:
        heading, turn = q0[:, 2], shorter_turn(q0[:, 2], q1[:, 2])
    dx, dy = q1[:, 0] - q0[:, 0], q1[:, 1] - q0[:, 1]
    return MovingBodies(np.empty((0, len(q0))), q0[:, 0], q0[:, 1], heading, dx, dy, turn)


# What a kernel says: which motions certainly keep a distance, below 0 a depth of overlap, and which certainly do not.
Booleans: TypeAlias = Bool[np.ndarray, "n"]
Verdict: TypeAlias = tuple[Booleans, Booleans]
Judge: TypeAlias = Callable[[MovingBodies, MovingBodies, float], Verdict]


def bisect(judge: Judge, a: MovingBodies, b: MovingBodies, reach: float, deadline: float = math.inf) -> Booleans:
    """Whether bodies certainly keep a distance, their motions bisected until the kernel is certain.

    Below 0, ``reach`` is a depth to which they may overlap. A few are judged at a time, their halves before the
    others, so that memory stays small however many corners they have and however long they are in doubt.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    k, m = a.num_corners, b.num_corners
    # Where a distance is to be kept, every corner meets every other.
    size = max(1, _CORNERS // max(k + m, k * m if reach > 0 else 0))
    apart = np.ones(len(a.x), dtype=bool)
    waiting = [(a, b, np.arange(len(a.x)), 0)]
    while waiting:
        a, b, owner, bisections = waiting.pop()
        if len(owner) > size:
            for part in (slice(begin, begin + size) for begin in range(0, len(owner), size)):
                waiting.append((a.take(part), b.take(part), owner[part], bisections))
            continue
        require_time(deadline, "all motions were tested")
        clear, hit = judge(a, b, reach)
        apart[owner[hit]] = False
        unsure = ~clear & apart[owner]
        if bisections == _MAX_BISECTIONS:
            apart[owner[unsure]] = False
        elif unsure.any():
            halves = a.take(unsure).bisected(), b.take(unsure).bisected()
            waiting.append((*halves, np.repeat(owner[unsure], 2), bisections + 1))
    return apart


def riding_bulges(a: MovingBodies, b: MovingBodies, rim_a: Column, rim_b: Column) -> Columns:
    """How far below its chord a gap along an axis can be that rides with ``a``, and with ``b``.

    These are the bulges of the offset between the two and of the other body's turn, as seen from the one. Their
    rims say how far the bodies reach from their reference points.
    """
    x, y, dx, dy = b.x - a.x, b.y - a.y, b.dx - a.dx, b.dy - a.dy
    far, speed = np.maximum(np.hypot(x, y), np.hypot(x + dx, y + dy)), np.hypot(dx, dy)
    relative = (b.turn - a.turn) ** 2
    turns = (a.turn, rim_b), (b.turn, rim_a)
    of_a, of_b = ((far * turn**2 + 2 * speed * np.abs(turn) + rim * relative) / 8 for turn, rim in turns)
    return of_a, of_b


def across_motion(a: MovingBodies, b: MovingBodies) -> Columns:
    """The unit normal of the relative motion, the y axis where there is none."""
    dx, dy = b.dx - a.dx, b.dy - a.dy
    speed = np.hypot(dx, dy)
    nx = np.divide(-dy, speed, out=np.zeros_like(dx), where=speed > 0)
    return nx, np.divide(dx, speed, out=np.ones_like(dx), where=speed > 0)
