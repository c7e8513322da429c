"""Cars, of Dubins and of Reeds and Shepp: words of turns as sharp as they can be and of straight lines.

Lengths are in turning radii, so that a turn is as long as its angle, and poses are relative: that of the goal is
``(0, 0, 0)``. A path to it from ``(x, y, heading)``, driven from its end to its beginning, leads from ``(0, 0, 0)``
to that pose in the other gears; and mirrored front to back, to ``(-x, y, -heading)`` in its own. Words are spelled
for this end, and read backward. So no pose's own sine is needed to turn the plane.

A turn goes around a circle on the left or right of the car. Words follow from the heading of the end, and from the
vectors between the circles of the beginning and those of the end.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points
from plr_jax._types import ArrayLike, Distances, RadialPart, Symmetry

Batch: TypeAlias = Float[np.ndarray, "n"]
Pose: TypeAlias = Float[np.ndarray, "3"]

_AT_ONCE = 4096  # poses, of which all that is computed stays in the cache
_MIRRORED = str.maketrans("LR", "RL")


class EndPoses(NamedTuple):
    """Poses where words end that begin at ``(0, 0, 0)``; ``versine`` is 1 - cosine, exact for small headings."""

    x: Batch
    y: Batch
    heading: Batch
    sine: Batch
    versine: Batch

    def mirrored(self) -> "EndPoses":
        """Where the same words end when left is right."""
        return self._replace(y=-self.y, heading=-self.heading, sine=-self.sine)

    def left_to_left(self) -> tuple[Batch, Batch]:
        """The vector from the beginning's left circle to the end's."""
        return self.x - self.sine, self.y - self.versine

    def left_to_right(self) -> tuple[Batch, Batch]:
        """The vector from the beginning's left circle to the end's right one, but for 2 to be taken off its ``y``."""
        return self.x + self.sine, self.y + self.versine


class Word(NamedTuple):
    """A path to each end: its turns (``L``, ``R``) and straight lines (``S``) in order.

    Their lengths are negative where the car reverses, and NaN where no such path leads to the end.
    """

    letters: str
    segments: tuple[Batch | float, ...]

    def mirrored(self) -> "Word":
        """The path to the mirrored end."""
        return Word(self.letters.translate(_MIRRORED), self.segments)

    @property
    def length(self) -> Batch:
        """Of the whole path."""
        return reduce(np.add, map(np.abs, self.segments))


Speller: TypeAlias = Callable[[EndPoses], Iterator[Word]]
"""Words that begin with a turn to the left. Of these and the mirrored ones the shortest is a shortest path."""


def wrapped(angle: Batch) -> Batch:
    """An angle as a turn of at most half a circle, to one side or the other."""
    return angle - 2 * np.pi * np.rint(angle * (0.5 / np.pi))


def shortest_lengths(spell: Speller, goal: Pose, radius: float, x: Float[np.ndarray, "n 3"]) -> Distances:
    """Length of the shortest word from each pose to the goal; ``inf`` where a coordinate is not finite."""
    lengths = np.empty(len(x))
    with np.errstate(all="ignore"):
        for begin in range(0, len(x), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            words = _words(spell, _ends(goal, radius, x[part]))
            lengths[part] = reduce(np.fmin, (word.length for word in words)) * radius
        rest = ~np.isfinite(lengths)
        lengths[rest] = _straight_lengths(goal, x[rest])
    return lengths


def shortest_path(spell: Speller, goal: Pose, radius: float, pose: Pose) -> list[tuple[str, float]]:
    """Segments of the shortest word from a pose to the goal, each a letter and a length; none of length 0."""
    with np.errstate(all="ignore"):
        words = list(_words(spell, _ends(goal, radius, pose[None])))
        lengths = np.array([word.length[0] for word in words])
    best = np.argmin(np.where(np.isnan(lengths), np.inf, lengths))
    if not np.isfinite(lengths[best] * radius):
        raise ValueError(f"The pose {pose.tolist()} must be nearer to the goal, of which it is 1e154 radii away.")
    letters, segments = words[best]
    in_order = zip(reversed(letters), reversed(segments), strict=True)
    return [(letter, radius * float(np.squeeze(length))) for letter, length in in_order if length != 0]


def reflection(goal: Pose, direction: float) -> Symmetry:
    """Of poses, in the line through the goal that has a direction; a goal along or across it stays as it is."""
    cosine, sine = np.cos(2 * direction), np.sin(2 * direction)
    return Symmetry.about(goal, np.array([[cosine, sine, 0], [sine, -cosine, 0], [0, 0, -1]]))


def _words(spell: Speller, ends: EndPoses) -> Iterator[Word]:
    yield from spell(ends)
    yield from (word.mirrored() for word in spell(ends.mirrored()))


def _ends(goal: Pose, radius: float, x: Float[np.ndarray, "n 3"]) -> EndPoses:
    """Where words end that, read backward, lead from poses to the goal."""
    cosine, sine = np.cos(goal[2]), np.sin(goal[2])
    dx, dy = (x[:, 0] - goal[0]) / radius, (x[:, 1] - goal[1]) / radius
    heading = wrapped(np.fmod(goal[2] - x[:, 2], 2 * np.pi))  # of many turns the remainder is exact, wrapping is not
    half = np.tan(heading / 2)
    sine_of_heading = 2 * half / (1 + half * half)
    return EndPoses(
        -cosine * dx - sine * dy, cosine * dy - sine * dx, heading, sine_of_heading, half * sine_of_heading
    )


def _straight_lengths(goal: Pose, x: Float[np.ndarray, "n 3"]) -> Distances:
    """Those of poses so far away that a square is infinite and turns add nothing."""
    lengths = np.hypot(x[:, 0] - goal[0], x[:, 1] - goal[1])
    return np.where(np.isfinite(x).all(axis=1), lengths, np.inf)


# Shortest paths of a car that drives both ways.


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
        return shortest_lengths(_words_reeds_shepp, self.goal, self.radius, as_points("x", x, self.dim))

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
        return shortest_path(
            _words_reeds_shepp, self.goal, self.radius, as_finite_point("The start pose", x, self.dim)
        )


def _words_reeds_shepp(ends: EndPoses) -> Iterator[Word]:
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


# Shortest paths of a car that drives forward only.


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
        return shortest_lengths(_words_dubins, self.goal, self.radius, as_points("x", x, self.dim))

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
        return shortest_path(_words_dubins, self.goal, self.radius, as_finite_point("The start pose", x, self.dim))


def _words_dubins(ends: EndPoses) -> Iterator[Word]:
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
