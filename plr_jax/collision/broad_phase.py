"""Circles around the motions of a team along a path, which tell most robots that cannot meet.

A robot sweeps no more, in one motion, than a circle about the motion's middle whose radius is half the motion's
length and the robot's own. Where two such circles are apart, so are the robots; what a rounding error adds to that is
well within the tolerance of exact tests.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from plr_jax.robots.robot import Robot

_CHUNK = 1 << 13  # distances at a time, whose temporaries stay in cache


class Circles(NamedTuple):
    """Circles, by centers and radii."""

    x: Float[np.ndarray, "n"]
    y: Float[np.ndarray, "n"]
    radius: Float[np.ndarray, "n"]


class Traffic:
    """A path of a team, whose robots can be given other motions, and a circle around each of its motions.

    Attributes:
        path: The joint configurations ``(steps, robots, dof)``, a copy of those given; :meth:`move` changes them.
    """

    path: Float[np.ndarray, "steps robots dof"]
    _size: Float[np.ndarray, "robots"]
    _x: Float[np.ndarray, "motions robots"]
    _y: Float[np.ndarray, "motions robots"]
    _radius: Float[np.ndarray, "motions robots"]

    def __init__(self, robots: Sequence[Robot], path: Float[np.ndarray, "steps robots dof"]):
        self.path = path.copy()
        self._size = np.array([robot.circumscribed_radius for robot in robots])
        self._x, self._y, self._radius = np.empty((3, max(len(path) - 1, 0), len(robots)))
        for i in range(len(robots)):
            self.move(i, path[:, i])

    def move(self, i: int, q: Float[np.ndarray, "rows dof"], rows: slice = slice(None)) -> None:
        """Have robot ``i`` go other motions, in some rows of the path that begin and end as they did."""
        self.path[rows, i] = q
        motions = slice(rows.start, rows.stop - 1) if rows.stop else slice(None)
        x, y, radius = circles_along(q[:, None])
        self._x[motions, i], self._y[motions, i], self._radius[motions, i] = x, y, radius + self._size[i]

    def near(
        self,
        i: int,
        around: Circles,
        motion: Int[np.ndarray, "n"],
        excluded: Sequence[int] = (),
    ) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Whom robot ``i`` may meet of the others, but those ``excluded``, while these make a motion of the path.

        In each of ``n`` rows its position stays within a circle.

        Returns:
            Rows, and the other robots that may come within reach in them, row by row.
        """
        x, y, radius = around
        radius, apart, num_robots = radius + self._size[i], [i, *excluded], len(self._size)
        found, size = [], max(1, _CHUNK // num_robots)
        for first in range(0, max(1, len(motion)), size):
            rows = slice(first, first + size)
            squared, along_y, reach = (of[motion[rows]] for of in (self._x, self._y, self._radius))
            for difference, own in ((squared, x), (along_y, y)):
                difference -= own[rows, None]
                difference *= difference
            squared += along_y
            reach += radius[rows, None]
            reach[:, apart] = 0.0
            reach *= reach
            found.append(first * num_robots + np.flatnonzero(squared < reach))
        row, other = np.divmod(np.concatenate(found), num_robots)
        return row, other


def within_reach(robot_a: Robot, around_a: Circles, robot_b: Robot, around_b: Circles) -> Int[np.ndarray, "m"]:
    """Rows in which two robots may meet whose positions stay within circles."""
    reach = around_a.radius + around_b.radius + robot_a.circumscribed_radius + robot_b.circumscribed_radius
    return np.flatnonzero((around_b.x - around_a.x) ** 2 + (around_b.y - around_a.y) ** 2 < reach * reach)


def circles(begin: Float[np.ndarray, "n k dof"], end: Float[np.ndarray, "n l dof"]) -> Circles:
    """Circles around the ways from any of ``k`` positions to any of ``l``, in each row."""
    return _between(_around(begin), _around(end))


def circles_along(q: Float[np.ndarray, "steps k dof"]) -> Circles:
    """Circles around the ways from any of the positions in a row to any in the next."""
    around = _around(q)
    return _between(Circles(*(column[:-1] for column in around)), Circles(*(column[1:] for column in around)))


def _between(begin: Circles, end: Circles) -> Circles:
    """Circles around the ways from anywhere within some circles to anywhere within others."""
    half = np.hypot(end.x - begin.x, end.y - begin.y) / 2
    return Circles((begin.x + end.x) / 2, (begin.y + end.y) / 2, half + np.maximum(begin.radius, end.radius))


def _around(q: Float[np.ndarray, "n k dof"]) -> Circles:
    """Circles around the positions in each row."""
    if q.shape[1] == 1:
        return Circles(q[:, 0, 0], q[:, 0, 1], np.zeros(len(q)))
    lo, hi = q[..., :2].min(axis=1), q[..., :2].max(axis=1)
    x, y = ((lo + hi) / 2).T
    return Circles(x, y, np.hypot(hi[:, 0] - x, hi[:, 1] - y))
