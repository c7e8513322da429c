"""What a descent gives: paths from many starts to one goal, and how each of them ended."""

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped


class DescentStatus(enum.StrEnum):
    """How the descent from a start ended; the value is the message."""

    REACHED = "the path ends at the goal"
    STUCK = "neither the goal nor a place from which it can be reached is in sight"
    START_NOT_FREE = "the start lies in an obstacle or outside the bounds, or is not finite"


@dataclass(frozen=True, eq=False)
class Descent:
    """Paths from many starts to one goal.

    Attributes:
        status: How each descent ended, members of :class:`DescentStatus`, ``(n,)``.
        vertices: The paths, ``(n, longest, dim)``: from the start, along straight legs, to the goal, which is
            repeated up to the number of vertices of the longest path. Around periodic axes legs go the short way. NaN
            where there is no path.
        counts: Number of vertices of each path without the repetitions, ``(n,)``: 1 where the start is the goal, 0
            where there is no path.
        lengths: Length of each path, ``(n,)``, ``inf`` where there is none: in workspace units, or by the
            ``motion_cost`` of the space.
        costs: What each path costs, ``(n,)``, ``inf`` where there is none: the integral of the cost map along it, or
            its length where there is no cost map.
    """

    status: Shaped[np.ndarray, "n"]
    vertices: Float[np.ndarray, "n longest dim"]
    counts: Int[np.ndarray, "n"]
    lengths: Float[np.ndarray, "n"]
    costs: Float[np.ndarray, "n"]

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "n longest dim"],
        counts: Int[np.ndarray, "n"],
        lengths: Float[np.ndarray, "n"],
        costs: Float[np.ndarray, "n"],
        is_free: Bool[np.ndarray, "n"],
    ) -> "Descent":
        """Paths, of which those of no vertex are none, and whether the starts are free."""
        reached = counts > 0
        members = np.array([DescentStatus.REACHED, DescentStatus.STUCK, DescentStatus.START_NOT_FREE], dtype=object)
        status = members[np.where(reached, 0, np.where(is_free, 1, 2))]
        vertices = np.where(reached[:, None, None], vertices, np.nan)
        return cls(status, vertices, counts, np.where(reached, lengths, np.inf), np.where(reached, costs, np.inf))

    @property
    def reached(self) -> Bool[np.ndarray, "n"]:
        """Whether each path ends at the goal."""
        return self.counts > 0

    @cached_property
    def paths(self) -> list[Float[np.ndarray, "m dim"]]:
        """The paths one by one, without repetitions; no rows where there is none."""
        return [path[:count] for path, count in zip(self.vertices, self.counts.tolist(), strict=True)]

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        return f"Descent({int(self.reached.sum()):,} of {len(self):,} starts reach the goal)"
