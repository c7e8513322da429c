"""Shortest paths of a car that drives forward only."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points
from plr_jax._types import ArrayLike, Distances, RadialPart, Symmetry
from plr_jax.oracles.car.words import Batch, EndPoses, Word, reflection, shortest_lengths, shortest_path

_SLACK = 1e-10  # turning radii by which a path may miss the goal
_CIRCLE = 2 * np.pi


@dataclass(frozen=True, eq=False, init=False)
class Dubins:
    """Length of the shortest path of a car that only drives forward, as if there were no obstacles.

    The car follows its heading and turns no sharper than its turning radius. The shortest path is one of six words:
    LSL, RSR, LSR, RSL, RLR, LRL. The distance is not the same there and back, and it jumps, by as much as a circle,
    at poses from which a single turn leads to the goal, or a turn to each side. There the shorter path counts, which
    may miss the goal by 1e-10 turning radii.

    Args:
        goal: The goal pose ``(x, y, theta)``, in workspace units and radians, finite.
        radius: The minimum turning radius, in workspace units, positive.

    Raises:
        ValueError: If the goal is not a vector of three finite numbers, or the radius is not positive and finite.

    References:
        Dubins, "On curves of minimal length with a constraint on average curvature, and with prescribed initial and
        terminal positions and tangents", American Journal of Mathematics 79, 1957.
    """

    goal: Float[np.ndarray, "3"]
    radius: float

    def __init__(self, goal: ArrayLike, radius: float | int):
        goal = as_finite_point("The goal pose", goal, 3)
        vars(self).update(goal=goal, radius=as_finite("radius", radius, positive=True))

    @property
    def is_lower_bound(self) -> bool:
        """True: obstacles make no path shorter."""
        return True

    @property
    def dim(self) -> int:
        """Number of coordinates of a pose: 3."""
        return 3

    @property
    def symmetries(self) -> tuple[Symmetry]:
        """The reflection of poses in the line along the goal's heading."""
        return (reflection(self.goal, self.goal[2]),)

    @property
    def radial_part(self) -> RadialPart:
        """The straight line to the goal, than which no path is shorter."""
        return RadialPart(self.goal, (True, True, False))

    def __call__(self, x: ArrayLike) -> Distances:
        """Length of the shortest path from each pose to the goal.

        Args:
            x: Poses ``(x, y, theta)``, ``(n, 3)``; any number of whole turns may be part of a heading.

        Returns:
            Lengths in workspace units, ``(n,)``; ``inf`` for poses with a coordinate that is not finite.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        return shortest_lengths(_words, self.goal, self.radius, as_points("x", x, self.dim))

    def shortest_path(self, x: ArrayLike) -> list[tuple[str, float]]:
        """The path whose length the query answers.

        Args:
            x: A pose ``(x, y, theta)``, ``(3,)``, finite.

        Returns:
            Its segments in order, each a letter, ``"L"`` (a turn to the left), ``"R"`` (to the right) or ``"S"``
            (straight), and a length in workspace units along the path. None if ``x`` is the goal.

        Raises:
            ValueError: If ``x`` is no finite pose, or 1e154 turning radii away.
        """
        return shortest_path(_words, self.goal, self.radius, as_finite_point("The start pose", x, self.dim))


def _words(ends: EndPoses) -> Iterator[Word]:
    x, y = ends.left_to_left()
    distance = np.sqrt(x * x + y * y)
    angle = np.where(distance > _SLACK, np.arctan2(y, x), 0.0)  # from a circle to itself: any
    yield Word("LSL", _turns_around(angle, distance, _forward(ends.heading, _SLACK)))

    half = np.pi - np.arcsin(distance / 4)  # of the turn in the middle: the shorter one is never on a shortest path
    yield Word("LRL", (_forward(angle + half), 2 * half, _forward(ends.heading - angle + half)))

    x, y = ends.left_to_right()
    square = x * x + y * (y - 4)  # of the circles' distance, less 4
    tangent = np.sqrt(np.where(np.abs(square) > 4 * _SLACK, square, 0.0))
    angle = np.arctan2(x, 2 - y) - np.arctan(tangent / 2)
    yield Word("LSR", (_forward(angle), tangent, _forward(angle - ends.heading)))


def _turns_around(angle: Batch, distance: Batch, turn: Batch) -> tuple[Batch, Batch, Batch]:
    """Of LSL: the first turn, the straight line at an angle, and the last turn, which together make a turn.

    Where one of them lacks next to nothing of a circle it is none: other words do not help there, as where a line or
    a single turn leads to the goal.
    """
    slack = _SLACK / np.maximum(distance, _SLACK)
    first = _forward(angle, slack)
    first = np.where(first <= turn + slack, np.minimum(first, turn), first)
    last = turn - first
    return first, distance, np.where(last < 0, last + _CIRCLE, last)


def _forward(angle: Batch, slack: Batch | float = 0.0) -> Batch:
    """An angle as a turn forward of less than a circle, or none if no more than the slack is wanting to one."""
    return np.maximum(angle - _CIRCLE * np.floor((angle + slack) / _CIRCLE), 0.0)
