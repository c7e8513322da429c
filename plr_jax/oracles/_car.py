"""Cars, of Dubins and of Reeds and Shepp: words of turns as sharp as they can be and of straight lines.

Lengths are in turning radii, so that a turn is as long as its angle, and poses are relative: that of the goal is
``(0, 0, 0)``. A path to it from ``(x, y, heading)``, driven from its end to its beginning, leads from ``(0, 0, 0)``
to that pose in the other gears; and mirrored front to back, to ``(-x, y, -heading)`` in its own. Words are spelled
for this end, and read backward. So no pose's own sine is needed to turn the plane.

A turn goes around a circle on the left or right of the car. Words follow from the heading of the end, and from the
vectors between the circles of the beginning and those of the end.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points, set_fields
from plr_jax._types import ArrayLike, Distances, Symmetry

Batch: TypeAlias = Float[np.ndarray, "n"]
Vectors: TypeAlias = tuple[Batch, Batch]
Pose: TypeAlias = Float[np.ndarray, "3"]

_AT_ONCE = 4096  # poses, of which all that is computed stays in the cache
_MIRRORED = str.maketrans("LR", "RL")


class Word(NamedTuple):
    """A path to each end: its turns (``L``, ``R``) and straight lines (``S``) in order.

    Their lengths are negative where the car reverses, and NaN where no such path leads to the end.
    """

    letters: str
    segments: tuple[Batch | float, ...]

    @property
    def length(self) -> Batch:
        """Of the whole path."""
        return reduce(np.add, map(np.abs, self.segments))


def wrap_angle(angle: Batch) -> Batch:
    """An angle as a turn of at most half a circle, to one side or the other."""
    return angle - 2 * np.pi * np.rint(angle * (0.5 / np.pi))


@dataclass(frozen=True, eq=False, init=False)
class _Car(ABC):
    """What cars share: a goal, a turning radius, and that the shortest of some words is a shortest path."""

    goal: Pose
    radius: float
    is_lower_bound: ClassVar[bool] = True
    """True: obstacles make no path shorter."""
    dim: ClassVar[int] = 3
    """Number of coordinates of a pose: 3."""

    def __init__(self, goal: ArrayLike, radius: float | int):
        goal = as_finite_point("The goal pose", goal, 3)
        set_fields(self, goal=goal, radius=as_finite("radius", radius, positive=True))

    def __call__(self, x: ArrayLike) -> Distances:
        """Length of the shortest path from each pose to the goal.

        Args:
            x: Poses ``(x, y, theta)``, ``(n, 3)``; any number of whole turns may be part of a heading.

        Returns:
            Lengths in workspace units, ``(n,)``; ``inf`` for poses with a coordinate that is not finite.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_points("x", x, 3)
        lengths = np.empty(len(x))
        with np.errstate(all="ignore"):
            for begin in range(0, len(x), _AT_ONCE):
                part = slice(begin, begin + _AT_ONCE)
                lengths[part] = reduce(np.fmin, (word.length for word in self._words(x[part]))) * self.radius
            # Of poses so far away that a square is infinite turns add nothing to the straight line.
            rest = x[far := ~np.isfinite(lengths)]
            straight = np.hypot(rest[:, 0] - self.goal[0], rest[:, 1] - self.goal[1])
            lengths[far] = np.where(np.isfinite(rest).all(axis=1), straight, np.inf)
        return lengths

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
        pose = as_finite_point("The start pose", x, 3)
        with np.errstate(all="ignore"):
            words = list(self._words(pose[None]))
            lengths = np.array([word.length[0] for word in words])
        best = np.argmin(np.where(np.isnan(lengths), np.inf, lengths))
        if not np.isfinite(lengths[best] * self.radius):
            raise ValueError(f"The pose {pose.tolist()} must be nearer to the goal, of which it is 1e154 radii away.")
        in_order = zip(*(reversed(each) for each in words[best]), strict=True)
        return [(letter, self.radius * float(np.squeeze(length))) for letter, length in in_order if length != 0]

    @staticmethod
    @abstractmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        """Words that begin with a turn to the left; of these and the mirrored ones the shortest is a shortest path.

        Args:
            to_left: The vector from the beginning's left circle to the end's.
            to_right: That to the end's right one, but for 2 to be taken off its ``y``.
            heading: Of the end.
        """

    def _words(self, x: Float[np.ndarray, "n 3"]) -> Iterator[Word]:
        """Those that, read backward, lead from poses to the goal."""
        cosine, sine = np.cos(self.goal[2]), np.sin(self.goal[2])
        dx, dy = ((x[:, axis] - self.goal[axis]) / self.radius for axis in range(2))
        along, across = -cosine * dx - sine * dy, cosine * dy - sine * dx
        # Of many turns the remainder is exact, wrapping is not.
        heading = wrap_angle(np.fmod(self.goal[2] - x[:, 2], 2 * np.pi))
        half = np.tan(heading / 2)
        sine_of_heading = 2 * half / (1 + half * half)
        versine = half * sine_of_heading
        for side in (1.0, -1.0):  # and those that begin with a turn to the right: where left is right
            y, sine = side * across, side * sine_of_heading
            for letters, segments in self._canonical_words(
                (along - sine, y - versine), (along + sine, y + versine), side * heading
            ):
                yield Word(letters if side > 0 else letters.translate(_MIRRORED), segments)

    def _reflection(self, direction: float) -> Symmetry:
        """Of poses, in the line through the goal that has a direction; a goal along or across it stays as it is."""
        cosine, sine = np.cos(2 * direction), np.sin(2 * direction)
        return Symmetry.about(self.goal, np.array([[cosine, sine, 0], [sine, -cosine, 0], [0, 0, -1]]))


# Shortest paths of a car that drives both ways.


_QUARTER = np.pi / 2
_ROUNDING = 4 * np.finfo(np.float64).eps


@dataclass(frozen=True, eq=False, init=False)
class ReedsShepp(_Car):
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

    @property
    def symmetries(self) -> tuple[Symmetry, Symmetry]:
        """Reflections of poses in the line along the goal's heading, and in the one across it."""
        return self._reflection(self.goal[2]), self._reflection(self.goal[2] + _QUARTER)

    @staticmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        """The words of Reeds and Shepp, free of the rule in which gear a first or last turn is.

        Each is the shorter way around, in whichever gear: a path all the same, and one that the rule allows if it is
        shortest.
        """
        yield from _words_to_left(*to_left, heading)
        yield from _words_to_right(*to_right, heading)


def _word(letters: str, first: Batch, *middle_and_last: Batch | float) -> Word:
    *middle, last = middle_and_last
    return Word(letters, (wrap_angle(first), *middle, wrap_angle(np.asarray(last))))


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
    lean, straight = np.arctan(tangent / 2), _nan_if_negative(tangent - 2)
    yield _word("LRSL", angle + lean, q, straight, rest + q - lean)
    yield _word("LRSL", angle + np.pi - lean, -q, -straight, rest + q + lean)
    yield _word("LSRL", angle + q - lean, straight, q, rest + lean)
    yield _word("LSRL", angle + q + lean, -straight, -q, rest + np.pi - lean)


def _words_to_right(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    """Those that end with a turn to the right; ``(x, y - 2)`` leads from the first left circle to the last right one.

    Angles are of its normal, whose direction is exact where both circles touch in the goal.
    """
    q, square = _QUARTER, x * x + y * (y - 4)
    # Nothing, where it is no more than what rounding makes of its terms.
    square = np.where(np.abs(square) < _ROUNDING * (x * x + y * y + 4 * np.abs(y)), 0.0, square)
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

    straight = _nan_if_negative(square) / (distance + 2)  # distance - 2
    yield _word("LRSR", angle, q, straight, rest - q)
    yield _word("LRSR", angle, -q, -straight, rest + q)
    yield _word("LSLR", angle - q, straight, q, rest)
    yield _word("LSLR", angle + q, -straight, -q, rest)

    straight = _nan_if_negative(tangent - 4)
    yield _word("LRSLR", angle - q + lean, q, straight, q, rest - q + lean)
    yield _word("LRSLR", angle + q - lean, -q, -straight, -q, rest + q - lean)


def _nan_if_negative(length: Batch) -> Batch:
    """A length, NaN where it is negative."""
    return np.where(length >= 0, length, np.nan)


# Shortest paths of a car that drives forward only.


_SLACK = 1e-10  # turning radii by which a path may miss the goal
_CIRCLE = 2 * np.pi


@dataclass(frozen=True, eq=False, init=False)
class Dubins(_Car):
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

    @property
    def symmetries(self) -> tuple[Symmetry]:
        """The reflection of poses in the line along the goal's heading."""
        return (self._reflection(self.goal[2]),)

    @staticmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        x, y = to_left
        distance = np.sqrt(x * x + y * y)
        angle = np.where(distance > _SLACK, np.arctan2(y, x), 0.0)  # from a circle to itself: any
        yield Word("LSL", _lsl_segments(angle, distance, _forward_turn(heading, _SLACK)))

        # Half of the turn in the middle, of which the shorter one is never on a shortest path.
        half = np.pi - np.arcsin(distance / 4)
        yield Word("LRL", (_forward_turn(angle + half), 2 * half, _forward_turn(heading - angle + half)))

        x, y = to_right
        square = x * x + y * (y - 4)  # of the circles' distance, less 4
        tangent = np.sqrt(np.where(np.abs(square) > 4 * _SLACK, square, 0.0))
        angle = np.arctan2(x, 2 - y) - np.arctan(tangent / 2)
        yield Word("LSR", (_forward_turn(angle), tangent, _forward_turn(angle - heading)))


def _lsl_segments(angle: Batch, distance: Batch, turn: Batch) -> tuple[Batch, Batch, Batch]:
    """Of LSL: the first turn, the straight line at an angle, and the last turn, which together make a turn.

    Where one of them lacks next to nothing of a circle it is none: other words do not help there, as where a line or
    a single turn leads to the goal.
    """
    slack = _SLACK / np.maximum(distance, _SLACK)
    first = _forward_turn(angle, slack)
    first = np.where(first <= turn + slack, np.minimum(first, turn), first)
    last = turn - first
    return first, distance, np.where(last < 0, last + _CIRCLE, last)


def _forward_turn(angle: Batch, slack: Batch | float = 0.0) -> Batch:
    """An angle as a turn forward of less than a circle, or none if no more than the slack is wanting to one."""
    return np.maximum(angle - _CIRCLE * np.floor((angle + slack) / _CIRCLE), 0.0)
