"""Distances to a goal without obstacles: along straight lines, or along shortest paths of cars.

Cars are Dubins cars (forward only) and Reeds-Shepp cars (forward and backward). A shortest path of a car is a
sequence of sharpest turns and straight lines, called a *word*, such as LSR for left, straight, right. Lengths are in
turning radii, so the length of a turn is its angle. A word is computed from the heading at its end, and from the
vector from the center of the first turn to the center of the last turn.

At heading h, let e(h) be the direction of travel and n(h) = e(h + pi/2) the direction to the left. The car is at
O - n(h) on a left circle with center O, and at O + n(h) on a right circle. So the vector between the centers is the
sum of::

     s e(h)     for each straight segment of length s at heading h
    -2 n(h)     for each change from a left to a right circle at heading h
     2 n(h)     for each change from a right to a left circle at heading h

The sum's length and direction give the segments of a word. Let O, M and P be the centers of the first, the middle and
the last turn, and d the length of the vector from O to P::

    LRL   O               The sides OM and MP are 2 long. The middle turn goes by the angle at M, 2 * half,
          | `.            so d = 4 sin(half).
        2 |   `.  d
          |     `.
          M------P
             2

    LSR   O               From O to P, the way along the straight line is `tangent`, and across it 2. So
          | `.            tangent = sqrt(d^2 - 4), and tan(lean) = tangent / 2, with `lean` the angle at O.
        2 |   `.  d
          |     `.
          '-------P
           tangent
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import chain
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_finite_point, as_points, set_fields, slices
from plr_jax._types import ArrayLike, Distances, Symmetry

Batch: TypeAlias = Float[np.ndarray, " n"]
Vectors: TypeAlias = tuple[Batch, Batch]
_QUARTER = np.pi / 2
_CIRCLE = 2 * np.pi
_MIRRORED = str.maketrans("LR", "RL")
_AT_ONCE = 4096  # poses processed at a time, so that their arrays stay in the cache
_ROUNDING = 4 * np.finfo(np.float64).eps  # relative rounding error of a few operations
_SLACK = 1e-10  # turning radii by which a Dubins path may miss the goal: well above rounding errors


@dataclass(frozen=True, eq=False, init=False)
class Euclidean:
    """Straight-line distance to a goal, in any dimension, without obstacles.

    The goal is a vector of finite numbers, ``(dim,)``, else ``ValueError``.
    """

    goal: Float[np.ndarray, "dim"]
    is_lower_bound: ClassVar[bool] = True
    """True: no path of the robot's reference point is shorter."""

    def __init__(self, goal: ArrayLike):
        object.__setattr__(self, "goal", as_finite_point("The goal", goal))

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.goal.size

    @property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """Reflections about the goal: for each axis, a reflection that mirrors this axis."""
        return tuple(Symmetry.about(self.goal, np.diag(signs)) for signs in 1 - 2 * np.eye(self.dim))

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance of points ``(n, dim)`` to the goal, ``inf`` if a coordinate is not finite."""
        distance = np.linalg.norm(as_points("x", x, self.goal.size) - self.goal, axis=1)
        return np.where(np.isnan(distance), np.inf, distance)


class Word(NamedTuple):
    """Paths to many poses, one per pose, that all follow the same sequence of turns and straight lines.

    Lengths of segments are in turning radii, negative where the car reverses. They are NaN for a pose to which no
    path of this sequence leads.
    """

    letters: str  # L and R for turns, S for straight
    segments: tuple[Any, ...]  # lengths, each an array with one number per pose, or one number for all

    @property
    def length(self) -> Batch:
        return reduce(np.add, map(np.abs, self.segments))


def wrap_angle(angle: Batch) -> Batch:
    return angle - 2 * np.pi * np.rint(angle * (0.5 / np.pi))


@dataclass(frozen=True, eq=False, init=False)
class _Car(ABC):
    """The base class of distance functions of cars to a goal pose, for a given turning radius."""

    goal: Float[np.ndarray, "3"]
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
            for part in slices(len(x), _AT_ONCE):
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

        ``to_left`` is the vector from the center of the left turning circle at the start, (0, 1), to the center of
        the left turning circle at the end. ``to_right`` is this vector for the right turning circles, from (0, -1).
        Lengths are in turning radii, headings in radians, with one entry per path.
        """

    def _words(self, x: Float[np.ndarray, "n 3"]) -> Iterator[Word]:
        # In the goal's frame, let a pose be (X, Y, phi). Mirror the car in the Y axis, and call its front its back:
        # the pose becomes (-X, Y, -phi), left stays left, and gears swap. Gears swap again if the path is driven
        # backward in time. So a word from (0, 0, 0) to (-X, Y, -phi), its segments in reverse order, leads from the
        # pose to the goal.
        cosine, sine = np.cos(self.goal[2]), np.sin(self.goal[2])
        dx, dy = ((x[:, axis] - self.goal[axis]) / self.radius for axis in range(2))
        mirrored_x = -cosine * dx - sine * dy
        y = cosine * dy - sine * dx
        # ``fmod`` is exact for many turns, ``wrap_angle`` is not.
        heading = wrap_angle(np.fmod(self.goal[2] - x[:, 2], _CIRCLE))
        tan_half = np.tan(heading / 2)
        sin_heading = 2 * tan_half / (1 + tan_half * tan_half)
        versine = tan_half * sin_heading  # 1 - cos(heading), without cancellation
        for side in (1.0, -1.0):  # words that start with a right turn are mirror images
            # From the left circle at the start, (0, 1), to the left circle at the end,
            # (mirrored_x - sin(heading), y + cos(heading)); and likewise between the right circles.
            to_left = mirrored_x - side * sin_heading, side * y - versine
            to_right = mirrored_x + side * sin_heading, side * y + versine
            for letters, segments in self._canonical_words(to_left, to_right, side * heading):
                yield Word(letters if side > 0 else letters.translate(_MIRRORED), segments)

    def _reflection(self, direction: float) -> Symmetry:
        """Return the reflection of poses in a line through the goal.

        ``direction`` is the angle from the x axis to the line, in radians.
        """
        cosine, sine = np.cos(2 * direction), np.sin(2 * direction)
        return Symmetry.about(self.goal, np.array([[cosine, sine, 0], [sine, -cosine, 0], [0, 0, -1]]))


@dataclass(frozen=True, eq=False, init=False)
class ReedsShepp(_Car):
    """Length of the shortest path of a car that drives forward and backward, without obstacles.

    The car moves along its heading and turns no sharper than its minimum turning ``radius``, positive, in workspace
    units. The ``goal`` is a pose ``(x, y, theta)``, theta in radians. Both must be finite, else ``ValueError``.

    A shortest path is one of 48 words of at most five turns and straight lines: Reeds and Shepp, "Optimal paths for a
    car that goes both forwards and backwards", Pacific Journal of Mathematics 145, 1990. The distance is continuous,
    and the same in both directions. For small sideways offsets from the goal, it grows like the square root of the
    offset.
    """

    @property
    def symmetries(self) -> tuple[Symmetry, Symmetry]:
        """Reflections of poses in two lines through the goal: along its heading, and at a right angle to it.

        The second reflection also swaps the car's front and back, which a car with two gears does not notice.
        """
        return self._reflection(self.goal[2]), self._reflection(self.goal[2] + _QUARTER)

    @staticmethod
    def _canonical_words(to_left: Vectors, to_right: Vectors, heading: Batch) -> Iterator[Word]:
        # Reeds and Shepp prescribe the gear of each turn. Here the first and last turns go the shorter way, in either
        # gear: each word is a valid path, and the prescribed gears are the shorter way where the word is shortest.
        words = chain(_words_to_left(*to_left, heading), _words_to_right(*to_right, heading))
        for letters, (first, *middle, last) in words:
            yield Word(letters, (wrap_angle(first), *middle, wrap_angle(last)))


def _words_to_left(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    # Paths from a left to a left turn. `(x, y)` leads from the center of the first turn to that of the last; its
    # length is d. The car turns by `angle` to head along this vector, and by `rest` from there to the last heading.
    #
    # A comment gives the vector as a sum (see the module's docstring) for the first word below it, and the number of
    # the equation of Reeds and Shepp. The second word drives the middle segments in the other gear. q is `_QUARTER`.
    square = x * x + y * y
    distance = np.sqrt(square)
    angle = np.where(distance > _ROUNDING * np.abs(heading), np.arctan2(y, x), 0.0)  # any angle for equal circles
    rest = heading - angle

    # d e(h), h: heading on the line (8.1)
    yield Word("LSL", (angle, distance, rest))
    yield Word("LSL", (angle + np.pi, -distance, rest - np.pi))

    # -2 n(h + half) + 2 n(h - half) = 4 sin(half) e(h), h: heading amid the right turn (8.3, 8.4)
    half = np.arcsin(distance / 4)
    yield Word("LRL", (angle + half, 2 * half, rest + half))
    yield Word("LRL", (angle + np.pi - half, -2 * half, rest - np.pi - half))

    # LRSL: -2 n(h + q) + straight e(h) + 2 n(h) = (straight + 2) e(h) + 2 n(h), h: heading on the line (8.9)
    # LSRL: straight e(h) - 2 n(h) + 2 n(h - q) = (straight + 2) e(h) - 2 n(h)
    tangent = np.sqrt(square - 4)
    lean = np.arctan(tangent / 2)
    straight = _nan_if_negative(tangent - 2)
    yield Word("LRSL", (angle + lean, _QUARTER, straight, rest + _QUARTER - lean))
    yield Word("LRSL", (angle + np.pi - lean, -_QUARTER, -straight, rest + _QUARTER + lean))
    yield Word("LSRL", (angle + _QUARTER - lean, straight, _QUARTER, rest + lean))
    yield Word("LSRL", (angle + _QUARTER + lean, -straight, -_QUARTER, rest + np.pi - lean))


def _words_to_right(x: Batch, y: Batch, heading: Batch) -> Iterator[Word]:
    # Paths from a left to a right turn. `(x, y)` leads from the right circle at the start to that at the end, so
    # `(x, y - 2)` from the left circle at the start; its length is d, and square = d^2 - 4. Comments are as above.
    square = x * x + y * (y - 4)
    # Set differences to 0 that are within the rounding error of their terms.
    square = np.where(np.abs(square) < _ROUNDING * (x * x + y * y + 4 * np.abs(y)), 0.0, square)
    distance = np.sqrt(4 + square)
    tangent = np.sqrt(square)
    lean = np.arctan(tangent / 2)
    # The direction of `(x, y - 2)`, plus a quarter turn. It is exact where both circles touch at the goal.
    angle = np.arctan2(x, 2 - y)
    rest = angle - heading  # the right turn from there to the last heading

    # tangent e(h) - 2 n(h), h: heading on the line (8.2)
    yield Word("LSR", (angle - lean, tangent, rest - lean))
    yield Word("LSR", (angle + lean, -tangent, rest + lean))

    # -2 n(h + turn) + 2 n(h) - 2 n(h - turn) = -(4 cos(turn) - 2) n(h), h: heading between the inner turns, which
    # have opposite gears. So d = 4 cos(turn) - 2, and sin^2(turn / 2) = (2 - d) / 8, here without cancellation (8.7)
    turn = 2 * np.arcsin(np.sqrt(-square / (8 * (2 + distance))))
    yield Word("LRLR", (angle + turn, turn, -turn, rest - turn))
    yield Word("LRLR", (angle - turn, -turn, turn, rest + turn))

    # -2 n(h) + 2 n(h - turn) - 2 n(h) = 2 sin(turn) e(h) - (4 - 2 cos(turn)) n(h), h: heading before and after the
    # inner turns, which have the same gear. So d^2 = 20 - 16 cos(turn), and sin^2(turn / 2) = (d^2 - 4) / 32 (8.8)
    turn = 2 * np.arcsin(np.sqrt(square / 32))
    aside = np.arctan2(np.sin(turn), 2 - np.cos(turn))  # between the vector and -n(h)
    yield Word("LRLR", (angle - aside, turn, turn, rest - aside))
    yield Word("LRLR", (angle + aside, -turn, -turn, rest + aside))

    # LRSR: -2 n(h + q) + straight e(h) = (straight + 2) e(h), h: heading on the line (8.10)
    # LSLR: straight e(h) - 2 n(h + q) = (straight + 2) e(h)
    straight = _nan_if_negative(square) / (distance + 2)  # equals distance - 2, without cancellation
    yield Word("LRSR", (angle, _QUARTER, straight, rest - _QUARTER))
    yield Word("LRSR", (angle, -_QUARTER, -straight, rest + _QUARTER))
    yield Word("LSLR", (angle - _QUARTER, straight, _QUARTER, rest))
    yield Word("LSLR", (angle + _QUARTER, -straight, -_QUARTER, rest))

    # -2 n(h + q) + straight e(h) + 2 n(h) - 2 n(h + q) = (straight + 4) e(h) + 2 n(h), h: heading on the line (8.11)
    straight = _nan_if_negative(tangent - 4)
    yield Word("LRSLR", (angle - _QUARTER + lean, _QUARTER, straight, _QUARTER, rest - _QUARTER + lean))
    yield Word("LRSLR", (angle + _QUARTER - lean, -_QUARTER, -straight, -_QUARTER, rest + _QUARTER - lean))


def _nan_if_negative(length: Batch) -> Batch:
    return np.where(length >= 0, length, np.nan)


@dataclass(frozen=True, eq=False, init=False)
class Dubins(_Car):
    """Length of the shortest path of a car that only drives forward, without obstacles.

    The car moves along its heading and turns no sharper than its minimum turning ``radius``, positive, in workspace
    units. The ``goal`` is a pose ``(x, y, theta)``, theta in radians. Both must be finite, else ``ValueError``.

    A shortest path is one of six words, LSL, RSR, LSR, RSL, RLR, LRL: Dubins, "On curves of minimal length with a
    constraint on average curvature", American J. of Mathematics 79, 1957. The distance from a to b differs from the
    distance from b to a. The distance jumps, by up to a full circle, at poses from which a single turn, or one turn
    to each side, leads to the goal. At such poses the shorter path counts, which may miss the goal by 1e-10 turning
    radii.
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

        # Both turns sum to `turn`, up to a full circle. A turn by nearly a full circle counts as none.
        turn = _forward_turn(heading, _SLACK)
        slack = _SLACK / np.maximum(distance, _SLACK)  # error of the vector's direction, if its end is off by _SLACK
        first = _forward_turn(angle, slack)
        # A first turn that exceeds `turn` by no more than this error counts as `turn`; the last turn is then 0.
        first = np.where(first <= turn + slack, np.minimum(first, turn), first)
        last = turn - first
        yield Word("LSL", (first, distance, np.where(last < 0, last + _CIRCLE, last)))

        # Of both middle turns, the one below half a circle is never on a shortest path: take the other, by 2 * half.
        half = np.pi - np.arcsin(distance / 4)
        yield Word("LRL", (_forward_turn(angle + half), 2 * half, _forward_turn(heading - angle + half)))

        x, y = to_right
        square = x * x + y * (y - 4)  # squared distance of the circles, minus 4
        tangent = np.sqrt(np.where(np.abs(square) > 4 * _SLACK, square, 0.0))
        first = np.arctan2(x, 2 - y) - np.arctan(tangent / 2)  # see `_words_to_right`
        yield Word("LSR", (_forward_turn(first), tangent, _forward_turn(first - heading)))


def _forward_turn(angle: Batch, slack: Batch | float = 0.0) -> Batch:
    """Reduce an angle to [0, 2 pi), or to 0 if it is less than ``slack`` radians below a full circle."""
    return np.maximum(angle - _CIRCLE * np.floor((angle + slack) / _CIRCLE), 0.0)
