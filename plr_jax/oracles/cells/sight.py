"""What tells which sources convex pieces of free space may use: what these see, and which paths bend around them.

Sources have a viewpoint each, a turn, -1 for those that paths need not bend around, and a kind: of equals in a cell,
where no two are of one kind, the first kind is taken.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import mixed
from plr_jax._types import Sources
from plr_jax.geometry.convex_pieces import Pieces, highest
from plr_jax.geometry.corners import TurnPoints
from plr_jax.geometry.shadows import Shadows


@dataclass(frozen=True, eq=False)
class GoalCones:
    """Those of one goal: the goal first, then the corners, each a viewpoint."""

    sources: Sources
    turn: Int[np.ndarray, "sources"]

    @staticmethod
    def of(sources: Sources, turns: TurnPoints) -> "GoalCones":
        """Those of an oracle's sources; corners that no path bends around have the last turn, and are not asked."""
        turn = np.full(len(sources.points), len(turns.vertex) - 1)
        turn[0], turn[turns.vertex] = -1, np.arange(len(turns.vertex))
        return GoalCones(sources, turn)

    @property
    def view(self) -> Int[np.ndarray, "sources"]:
        """The viewpoint of each: itself."""
        return np.arange(len(self.turn))

    kind = view


class SharedCones:
    """Numbers for the sources of many goals, so that cells which differ by a constant between goals have the same.

    Which source is best in a piece, and how far others are from it, depends on the differences of the sources'
    distances alone. Behind a corner they are the same for all goals that are reached by way of it. So the sources of
    each cell are counted from the least of them, and a source and its distance from there are kept once, in the order
    in which they came. A *kind* is a corner and the side on which paths bend around it, ``2 * corner + side``, or
    ``2 * view`` for a goal; the first ``num_turns`` kinds are those of corners.

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
        hashes = mixed(kind) + mixed(steps ^ np.int64(1 << 62))
        keys, first, index = np.unique(hashes, return_index=True, return_inverse=True)
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
        return np.where(self.kind < self._num_turns, self.kind, -1)

    @property
    def sources(self) -> Sources:
        """Where they are, and their distances."""
        if self._sources is None:
            self._sources = Sources(self._points[self.view], self._steps * self._step, np.arange(len(self.kind)))
        return self._sources


@dataclass(frozen=True, eq=False)
class Sight:
    """What tells which sources a piece may use: where they are, what they see, which paths bend around them.

    Args:
        cones: The sources.
        shadows: What viewpoints see.
        turns: The points that come around corners.
        walls: The walls, as Shapely lines in a tree.
    """

    cones: GoalCones | SharedCones
    shadows: Shadows
    turns: TurnPoints
    walls: shapely.STRtree

    @property
    def tolerance(self) -> float:
        """How far behind a wall a point still counts as free."""
        return self.shadows.table.tolerance

    def may_bend(self, pieces: Pieces, source: Int[np.ndarray, "pieces"]) -> Bool[np.ndarray, "pieces"]:
        """Whether a shortest path from some point of each piece may turn at its source, for all it may see."""
        turn = self.cones.turn[source]
        may, corner = np.ones(len(source), bool), np.flatnonzero(turn >= 0)  # there may be none but the goal
        turn, (x, y) = turn[corner], pieces[:, corner]
        for normal in self.turns.normal[:, turn]:
            height = highest(x * normal[:, :1] + y * normal[:, 1:])
            may[corner] &= height >= (normal * self.turns.points[turn]).sum(axis=1) - self.turns.slack
        return may


def meet_walls(
    walls: shapely.STRtree, lo: Float[np.ndarray, "boxes 2"], hi: Float[np.ndarray, "boxes 2"]
) -> Bool[np.ndarray, "boxes"]:
    """Whether a wall reaches into each box."""
    boxes: Any = shapely.box(*lo.T, *hi.T)
    box, wall = walls.query(boxes, predicate="intersects")
    return np.isin(np.arange(len(lo)), box[~shapely.touches(boxes[box], walls.geometries[wall])])
