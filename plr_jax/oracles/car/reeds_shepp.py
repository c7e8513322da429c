"""Shortest paths of a car that drives both ways."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points
from plr_jax._types import ArrayLike, Distances, RadialPart, Symmetry
from plr_jax.oracles.car.words import Batch, EndPoses, Word, reflection, shortest_lengths, shortest_path, wrapped

_QUARTER = np.pi / 2
_ROUNDING = 4 * np.finfo(np.float64).eps


@dataclass(frozen=True, eq=False, init=False)
class ReedsShepp:
    """Length of the shortest path of a car that drives forward and backward, as if there were no obstacles.

    The car follows its heading and turns no sharper than its turning radius. The shortest path is one of 48 words of
    at most five turns and straight lines. The distance is continuous, the same there and back, and grows like a
    square root sideways from the goal.

    Args:
        goal: The goal pose ``(x, y, theta)``, in workspace units and radians, finite.
        radius: The minimum turning radius, in workspace units, positive.

    Raises:
        ValueError: If the goal is not a vector of three finite numbers, or the radius is not positive and finite.

    References:
        Reeds and Shepp, "Optimal paths for a car that goes both forwards and backwards", Pacific Journal of
        Mathematics 145, 1990: their words and their three symmetries, which drive a path in the other gears (time
        flip), in a mirror (reflect) and from its end to its beginning (backwards).
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
    def symmetries(self) -> tuple[Symmetry, Symmetry]:
        """Reflections of poses in the line along the goal's heading, and in the one across it."""
        return reflection(self.goal, self.goal[2]), reflection(self.goal, self.goal[2] + _QUARTER)

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
            (straight), and a length in workspace units along the path, negative where the car reverses. None if
            ``x`` is the goal.

        Raises:
            ValueError: If ``x`` is no finite pose, or 1e154 turning radii away.
        """
        return shortest_path(_words, self.goal, self.radius, as_finite_point("The start pose", x, self.dim))


def _words(ends: EndPoses) -> Iterator[Word]:
    """The words of Reeds and Shepp, free of the rule in which gear a first or last turn is.

    Each is the shorter way around, in whichever gear: a path all the same, and one that the rule allows if shortest.
    """
    yield from _words_to_left(*ends.left_to_left(), ends.heading)
    yield from _words_to_right(*ends.left_to_right(), ends.heading)


def _word(letters: str, first: Batch, *middle_and_last: Batch | float) -> Word:
    *middle, last = middle_and_last
    return Word(letters, (wrapped(first), *middle, wrapped(np.asarray(last))))


def _words_to_left(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    """Those that end with a turn to the left; ``(x, y)`` leads from the first left circle to the last."""
    q, square = _QUARTER, x * x + y * y
    distance = np.sqrt(square)
    angle = np.where(distance > _ROUNDING * np.abs(heading), np.arctan2(y, x), 0.0)  # from a circle to itself: any
    rest = heading - angle

    yield _word("LSL", angle, distance, rest)
    yield _word("LSL", angle + np.pi, -distance, rest - np.pi)

    half = np.arcsin(distance / 4)
    yield _word("LRL", angle + half, 2 * half, rest + half)
    yield _word("LRL", angle + np.pi - half, -2 * half, rest - np.pi - half)

    tangent = np.sqrt(square - 4)  # of the two circles, from side to side
    lean, straight = np.arctan(tangent / 2), _existing(tangent - 2)
    yield _word("LRSL", angle + lean, q, straight, rest + q - lean)
    yield _word("LRSL", angle + np.pi - lean, -q, -straight, rest + q + lean)
    yield _word("LSRL", angle + q - lean, straight, q, rest + lean)
    yield _word("LSRL", angle + q + lean, -straight, -q, rest + np.pi - lean)


def _words_to_right(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    """Those that end with a turn to the right; ``(x, y - 2)`` leads from the first left circle to the last right one.

    Angles are of its normal, whose direction is exact where both circles touch in the goal.
    """
    q, square = _QUARTER, _rounded_to_0(x * x + y * (y - 4), x * x + y * y + 4 * np.abs(y))
    distance, tangent = np.sqrt(4 + square), np.sqrt(square)
    angle, lean = np.arctan2(x, 2 - y), np.arctan(tangent / 2)
    rest = angle - heading

    yield _word("LSR", angle - lean, tangent, rest - lean)
    yield _word("LSR", angle + lean, -tangent, rest + lean)

    turn = 2 * np.arcsin(np.sqrt(-square / (8 * (2 + distance))))
    yield _word("LRLR", angle + turn, turn, -turn, rest - turn)
    yield _word("LRLR", angle - turn, -turn, turn, rest + turn)

    turn = 2 * np.arcsin(np.sqrt(square / 32))
    aside = np.arctan2(np.sin(turn), 2 - np.cos(turn))
    yield _word("LRLR", angle - aside, turn, turn, rest - aside)
    yield _word("LRLR", angle + aside, -turn, -turn, rest + aside)

    straight = _existing(square) / (distance + 2)  # distance - 2
    yield _word("LRSR", angle, q, straight, rest - q)
    yield _word("LRSR", angle, -q, -straight, rest + q)
    yield _word("LSLR", angle - q, straight, q, rest)
    yield _word("LSLR", angle + q, -straight, -q, rest)

    straight = _existing(tangent - 4)
    yield _word("LRSLR", angle - q + lean, q, straight, q, rest - q + lean)
    yield _word("LRSLR", angle + q - lean, -q, -straight, -q, rest + q - lean)


def _existing(length: Batch) -> Batch:
    """A length, NaN where it is negative."""
    return np.where(length >= 0, length, np.nan)


def _rounded_to_0(difference: Batch, total: Batch) -> Batch:
    """A difference, 0 where it is no more than what rounding makes of its terms."""
    return np.where(np.abs(difference) < _ROUNDING * total, 0.0, difference)
