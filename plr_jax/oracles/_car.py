"""Shortest paths of cars without obstacles: Dubins (forward only) and Reeds-Shepp (forward and backward).

A shortest path is a sequence of sharpest turns and straight lines, called a *word*, such as LSR for left, straight,
right. Lengths are in turning radii, so the length of a turn is its angle. A word is computed from the heading at its
end, and from the vector from the center of the first turn to the center of the last turn.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import chain
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points, set_fields
from plr_jax._types import ArrayLike, Distances, Symmetry

Batch: TypeAlias = Float[np.ndarray, " n"]
Vectors: TypeAlias = tuple[Batch, Batch]
Pose: TypeAlias = Float[np.ndarray, "3"]
_AT_ONCE = 4096  # poses processed at a time, so that their arrays stay in the cache
_MIRRORED = str.maketrans("LR", "RL")


class Word(NamedTuple):
    """Paths to many poses by one sequence of turns; lengths are negative where the car reverses, NaN for no path."""

    letters: str  # L and R for turns, S for straight
    segments: tuple[Any, ...]  # lengths, each an array with one number per pose, or one number for all

    @property
    def length(self) -> Batch:
        return reduce(np.add, map(np.abs, self.segments))


def wrap_angle(angle: Batch) -> Batch:
    return angle - 2 * np.pi * np.rint(angle * (0.5 / np.pi))


@dataclass(frozen=True, eq=False, init=False)
class _Car(ABC):
    """A base of distances of cars to a goal pose, for a given turning radius."""

    goal: Pose
    radius: float
    is_lower_bound: ClassVar[bool] = True
    """True: obstacles can only make paths longer."""
    dim: ClassVar[int] = 3
    """Number of coordinates of a pose."""

    def __init__(self, goal: ArrayLike, radius: float | int):
        goal = as_finite_point("The goal pose", goal, 3)
        set_fields(self, goal=goal, radius=as_finite("radius", radius, positive=True))

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the length of the shortest path from each pose to the goal, ``(n,)`` in workspace units.

        Poses ``(x, y, theta)``, ``(n, 3)``, have headings in radians; whole turns do not matter. The length is
        ``inf`` for poses with a coordinate that is not finite.
        """
        x = as_points("x", x, 3)
        lengths = np.empty(len(x))
        with np.errstate(all="ignore"):
            for begin in range(0, len(x), _AT_ONCE):
                part = slice(begin, begin + _AT_ONCE)
                lengths[part] = reduce(np.fmin, (word.length for word in self._words(x[part]))) * self.radius
            # If squares overflow, the pose is so far away that turns add nothing to the straight line.
            poses = x[far := ~np.isfinite(lengths)]
            straight = np.hypot(poses[:, 0] - self.goal[0], poses[:, 1] - self.goal[1])
            lengths[far] = np.where(np.isfinite(poses).all(axis=1), straight, np.inf)
        return lengths

    def shortest_path(self, x: ArrayLike) -> list[tuple[str, float]]:
        """Return the segments of a shortest path from a finite pose ``(x, y, theta)`` to the goal, in order.

        A segment is a letter, ``"L"`` (left turn), ``"R"`` (right turn) or ``"S"`` (straight), and a length in
        workspace units, negative where the car reverses. The list is empty if the pose is the goal. ``ValueError`` if
        the pose is not finite, or 1e154 turning radii or more away.
        """
        pose = as_finite_point("The start pose", x, 3)
        with np.errstate(all="ignore"):
            words = list(self._words(pose[None]))
            lengths = np.array([word.length[0] for word in words])
        best = np.argmin(np.where(np.isnan(lengths), np.inf, lengths))
        if not np.isfinite(lengths[best] * self.radius):
            raise ValueError(f"The pose {pose.tolist()} must be nearer to the goal than 1e154 turning radii.")
        in_order = zip(*(reversed(column) for column in words[best]), strict=True)
        return [(letter, self.radius * float(np.squeeze(length))) for letter, length in in_order if length != 0]

    @staticmethod
    @abstractmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        """Yield possible shortest paths from the pose (0, 0, 0) that start with a left turn and end at ``heading``.

        ``to_left`` and ``to_right`` lead, in turning radii, from the centers of the left and right turning circles at
        the start, (0, 1) and (0, -1), to those at the end.
        """

    def _words(self, x: Float[np.ndarray, "n 3"]) -> Iterator[Word]:
        # Mirror poses front to back, in the frame of the goal. This swaps gears, so that a word from the goal to the
        # mirrored pose, with its segments in reverse order, leads from the pose to the goal.
        cosine, sine = np.cos(self.goal[2]), np.sin(self.goal[2])
        dx, dy = ((x[:, axis] - self.goal[axis]) / self.radius for axis in range(2))
        along, across = -cosine * dx - sine * dy, cosine * dy - sine * dx
        # ``fmod`` is exact for many turns, ``wrap_angle`` is not.
        heading = wrap_angle(np.fmod(self.goal[2] - x[:, 2], 2 * np.pi))
        half = np.tan(heading / 2)
        sine_of_heading = 2 * half / (1 + half * half)
        versine = half * sine_of_heading
        for side in (1.0, -1.0):  # words that start with a right turn are mirror images
            y, sine = side * across, side * sine_of_heading
            circles = (along - sine, y - versine), (along + sine, y + versine)
            for letters, segments in self._canonical_words(*circles, side * heading):
                yield Word(letters if side > 0 else letters.translate(_MIRRORED), segments)

    def _reflection(self, direction: float) -> Symmetry:
        """Return the reflection of poses in the line through the goal at an angle, ``direction``, to the x axis."""
        cosine, sine = np.cos(2 * direction), np.sin(2 * direction)
        return Symmetry.about(self.goal, np.array([[cosine, sine, 0], [sine, -cosine, 0], [0, 0, -1]]))


_QUARTER = np.pi / 2
_ROUNDING = 4 * np.finfo(np.float64).eps


@dataclass(frozen=True, eq=False, init=False)
class ReedsShepp(_Car):
    """Length of the shortest path of a car that drives forward and backward, without obstacles.

    The car moves along its heading and turns no sharper than its minimum turning ``radius``, positive, in workspace
    units. The ``goal`` is a pose ``(x, y, theta)``, theta in radians. Both must be finite, else ``ValueError``.

    A shortest path is one of 48 words of at most five turns and straight lines: Reeds and Shepp, "Optimal paths for a
    car that goes both forwards and backwards", Pacific Journal of Mathematics 145, 1990. The distance is continuous,
    and the same in both directions. Sideways from the goal it grows like a square root.
    """

    @property
    def symmetries(self) -> tuple[Symmetry, Symmetry]:
        """Reflections of poses in two lines through the goal: along its heading, and at a right angle to it."""
        return self._reflection(self.goal[2]), self._reflection(self.goal[2] + _QUARTER)

    @staticmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        # Reeds and Shepp prescribe the gear of each turn. Here the first and last turns go the shorter way, in either
        # gear: each word is a valid path, and the prescribed gears are the shorter way where the word is shortest.
        words = chain(_words_to_left(*to_left, heading), _words_to_right(*to_right, heading))
        for letters, (first, *middle, last) in words:
            yield Word(letters, (wrap_angle(first), *middle, wrap_angle(last)))


def _words_to_left(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    # Paths from a left to a left turn, whose centers are `(x, y)` turning radii apart.
    q, square = _QUARTER, x * x + y * y
    distance = np.sqrt(square)
    angle = np.where(distance > _ROUNDING * np.abs(heading), np.arctan2(y, x), 0.0)  # any angle for equal circles
    rest = heading - angle
    yield Word("LSL", (angle, distance, rest))
    yield Word("LSL", (angle + np.pi, -distance, rest - np.pi))
    half = np.arcsin(distance / 4)
    yield Word("LRL", (angle + half, 2 * half, rest + half))
    yield Word("LRL", (angle + np.pi - half, -2 * half, rest - np.pi - half))
    tangent = np.sqrt(square - 4)  # length of the inner tangent of two circles
    lean, straight = np.arctan(tangent / 2), _nan_if_negative(tangent - 2)
    yield Word("LRSL", (angle + lean, q, straight, rest + q - lean))
    yield Word("LRSL", (angle + np.pi - lean, -q, -straight, rest + q + lean))
    yield Word("LSRL", (angle + q - lean, straight, q, rest + lean))
    yield Word("LSRL", (angle + q + lean, -straight, -q, rest + np.pi - lean))


def _words_to_right(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    # Paths from a left to a right turn, whose centers are `(x, y - 2)` turning radii apart.
    q, square = _QUARTER, x * x + y * (y - 4)
    # Set differences to 0 that are within the rounding error of their terms.
    square = np.where(np.abs(square) < _ROUNDING * (x * x + y * y + 4 * np.abs(y)), 0.0, square)
    # Use angles of the vector's normal: its direction is exact where both circles touch at the goal.
    distance, tangent = np.sqrt(4 + square), np.sqrt(square)
    angle, lean = np.arctan2(x, 2 - y), np.arctan(tangent / 2)
    rest = angle - heading
    yield Word("LSR", (angle - lean, tangent, rest - lean))
    yield Word("LSR", (angle + lean, -tangent, rest + lean))
    turn = 2 * np.arcsin(np.sqrt(-square / (8 * (2 + distance))))
    yield Word("LRLR", (angle + turn, turn, -turn, rest - turn))
    yield Word("LRLR", (angle - turn, -turn, turn, rest + turn))
    turn = 2 * np.arcsin(np.sqrt(square / 32))
    aside = np.arctan2(np.sin(turn), 2 - np.cos(turn))
    yield Word("LRLR", (angle - aside, turn, turn, rest - aside))
    yield Word("LRLR", (angle + aside, -turn, -turn, rest + aside))
    straight = _nan_if_negative(square) / (distance + 2)  # equals distance - 2, without cancellation
    yield Word("LRSR", (angle, q, straight, rest - q))
    yield Word("LRSR", (angle, -q, -straight, rest + q))
    yield Word("LSLR", (angle - q, straight, q, rest))
    yield Word("LSLR", (angle + q, -straight, -q, rest))
    straight = _nan_if_negative(tangent - 4)
    yield Word("LRSLR", (angle - q + lean, q, straight, q, rest - q + lean))
    yield Word("LRSLR", (angle + q - lean, -q, -straight, -q, rest + q - lean))


def _nan_if_negative(length: Batch) -> Batch:
    return np.where(length >= 0, length, np.nan)


_SLACK = 1e-10  # turning radii by which a path may miss the goal
_CIRCLE = 2 * np.pi


@dataclass(frozen=True, eq=False, init=False)
class Dubins(_Car):
    """Length of the shortest path of a car that only drives forward, without obstacles.

    The car moves along its heading and turns no sharper than its minimum turning ``radius``, positive, in workspace
    units. The ``goal`` is a pose ``(x, y, theta)``, theta in radians. Both must be finite, else ``ValueError``.

    A shortest path is one of six words, LSL, RSR, LSR, RSL, RLR, LRL: Dubins, "On curves of minimal length with a
    constraint on average curvature", American J. of Mathematics 79, 1957. The distance depends on the direction of
    travel. It jumps, by up to a full circle, at poses from which a single turn, or one turn to each side, leads to
    the goal. There the shorter path counts, which may miss the goal by 1e-10 turning radii.
    """

    @property
    def symmetries(self) -> tuple[Symmetry]:
        """The reflection of poses in the line through the goal along its heading."""
        return (self._reflection(self.goal[2]),)

    @staticmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        x, y = to_left
        distance = np.sqrt(x * x + y * y)
        angle = np.where(distance > _SLACK, np.arctan2(y, x), 0.0)  # any angle for equal circles
        yield Word("LSL", _lsl_segments(angle, distance, _forward_turn(heading, _SLACK)))
        # Half of the middle turn. There are two such turns, and the shorter one is never on a shortest path.
        half = np.pi - np.arcsin(distance / 4)
        yield Word("LRL", (_forward_turn(angle + half), 2 * half, _forward_turn(heading - angle + half)))
        x, y = to_right
        square = x * x + y * (y - 4)  # squared distance of the circles, minus 4
        tangent = np.sqrt(np.where(np.abs(square) > 4 * _SLACK, square, 0.0))
        angle = np.arctan2(x, 2 - y) - np.arctan(tangent / 2)
        yield Word("LSR", (_forward_turn(angle), tangent, _forward_turn(angle - heading)))


def _lsl_segments(angle: Batch, distance: Batch, turn: Batch) -> tuple[Batch, Batch, Batch]:
    # Turns sum to `turn`. A turn by nearly a full circle counts as none.
    slack = _SLACK / np.maximum(distance, _SLACK)
    first = _forward_turn(angle, slack)
    first = np.where(first <= turn + slack, np.minimum(first, turn), first)
    last = turn - first
    return first, distance, np.where(last < 0, last + _CIRCLE, last)


def _forward_turn(angle: Batch, slack: Batch | float = 0.0) -> Batch:
    """Reduce an angle to [0, 2 pi), and to 0 if it is less than ``slack`` below a full circle."""
    return np.maximum(angle - _CIRCLE * np.floor((angle + slack) / _CIRCLE), 0.0)
