"""Numbers for the sources of many goals, so that cells which differ between goals by a constant have the same ones.

Which source is best in a piece, and how far others are from it, depends on the differences of the sources' distances
alone. Behind a corner they are the same for all goals that are reached by way of it. So the sources of each cell are
counted from the least of them, and a source and its distance from there are known by one number.
"""

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import mixed
from plr_jax._types import Sources

_NO_TURN = -1


class SharedCones:
    """Sources with their distances beyond the least of a cell, each kept once, in the order in which they came.

    A *kind* is a corner and the side on which paths bend around it, ``2 * corner + side``, or ``2 * view`` for a
    goal; the first ``num_turns`` kinds are those of corners.

    Args:
        points: The viewpoints, ``(views, 2)``: the corners, then the goals.
        num_turns: Twice the number of corners.
        step: Distances are kept as multiples of it, so that what differs by rounding is the same.
    """

    def __init__(self, points: Float[np.ndarray, "views 2"], num_turns: int, step: float) -> None:
        self._points, self._num_turns, self._step = points, num_turns, step
        self.kind, self._steps = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._sorted, self._place = np.zeros(0, np.uint64), np.zeros(0, np.int64)
        self._sources: Sources | None = None

    def numbers(self, kind: Int[np.ndarray, "n"], distance: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """The number of each of some sources; of new ones, new numbers."""
        steps = np.rint(distance / self._step).astype(np.int64)
        keys, first, index = np.unique(
            mixed(kind) + mixed(steps ^ np.int64(1 << 62)), return_index=True, return_inverse=True
        )
        at = np.searchsorted(self._sorted, keys)
        known = at < len(self._sorted)
        known[known] = self._sorted[at[known]] == keys[known]
        place = np.empty(len(keys), np.int64)
        place[known] = self._place[at[known]]
        new = np.flatnonzero(~known)
        if len(new):
            order = np.argsort(first[new])
            place[new[order]] = len(self.kind) + np.arange(len(new))
            self.kind = np.concatenate([self.kind, kind[first[new[order]]]])
            self._steps = np.concatenate([self._steps, steps[first[new[order]]]])
            self._sorted = np.insert(self._sorted, at[new], keys[new])
            self._place = np.insert(self._place, at[new], place[new])
            self._sources = None
        return place[index]

    @property
    def view(self) -> Int[np.ndarray, "sources"]:
        """The viewpoint of each."""
        return self.kind >> 1

    @property
    def turn(self) -> Int[np.ndarray, "sources"]:
        """The turn of each, -1 of goals."""
        return np.where(self.kind < self._num_turns, self.kind, _NO_TURN)

    @property
    def sources(self) -> Sources:
        """Where they are, and their distances."""
        if self._sources is None:
            self._sources = Sources(self._points[self.view], self._steps * self._step, np.arange(len(self.kind)))
        return self._sources
