"""Words: paths of a car that turns as sharply as it can or not at all, spelled in turns and straight lines.

Lengths are in turning radii, so that a turn is as long as its angle, and poses are relative: that of the goal is
``(0, 0, 0)``. A path to it from ``(x, y, heading)``, driven from its end to its beginning, leads from ``(0, 0, 0)``
to that pose in the other gears; and mirrored front to back, to ``(-x, y, -heading)`` in its own. Words are spelled
for this end, and read backward. So no pose's own sine is needed to turn the plane.

A turn goes around a circle on the left or right of the car. Words follow from the heading of the end, and from the
vectors between the circles of the beginning and those of the end.
"""

from collections.abc import Callable, Iterator
from functools import reduce
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._types import Distances, Symmetry

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
