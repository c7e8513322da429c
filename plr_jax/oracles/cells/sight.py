"""What tells which sources convex pieces of free space may use: what these see, and which paths bend around them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import Sources
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.convex_pieces import Pieces, highest
from plr_jax.geometry.corners import TurnPoints
from plr_jax.geometry.shadows import Shadows


@runtime_checkable
class SightSources(Protocol):
    """Sources, the viewpoint of each, its turn, -1 for those that paths need not bend around, and its kind.

    Of equals in a cell, where no two are of one kind, the first kind is taken.
    """

    @property
    def sources(self) -> Sources:
        """All of them."""
        ...

    @property
    def view(self) -> Int[np.ndarray, "sources"]:
        """The viewpoint of each."""
        ...

    @property
    def turn(self) -> Int[np.ndarray, "sources"]:
        """The turn of each, -1 for those that paths need not bend around."""
        ...

    @property
    def kind(self) -> Int[np.ndarray, "sources"]:
        """The kind of each."""
        ...


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

    @property
    def kind(self) -> Int[np.ndarray, "sources"]:
        """The kind of each: itself."""
        return self.view


@dataclass(frozen=True, eq=False)
class Walls:
    """The walls of a workspace, to be asked for those that meet boxes."""

    boundary: Boundary

    @cached_property
    def _tree(self) -> Any:
        import shapely  # which a query does not need

        walls: Any = shapely.linestrings(self.boundary.segments)
        return shapely.STRtree(walls)

    def meet(self, lo: Float[np.ndarray, "boxes 2"], hi: Float[np.ndarray, "boxes 2"]) -> Bool[np.ndarray, "boxes"]:
        """Whether a wall reaches into each box."""
        import shapely

        boxes: Any = shapely.box(*lo.T, *hi.T)
        box, wall = self._tree.query(boxes, predicate="intersects")
        met = np.zeros(len(lo), bool)
        met[box[~shapely.touches(boxes[box], self._tree.geometries[wall])]] = True
        return met


@dataclass(frozen=True, eq=False)
class Sight:
    """What tells which sources a piece may use: where they are, what they see, which paths bend around them.

    Args:
        cones: The sources.
        shadows: What viewpoints see.
        turns: The points that come around corners.
        walls: The walls.
    """

    cones: SightSources
    shadows: Shadows
    turns: TurnPoints
    walls: Walls

    @property
    def sources(self) -> Sources:
        """The sources."""
        return self.cones.sources

    @property
    def tolerance(self) -> float:
        """How far behind a wall a point still counts as free."""
        return self.shadows.table.tolerance

    def see(
        self, source: Int[np.ndarray, "pieces"], pieces: Pieces, center: Float[np.ndarray, "pieces 2"]
    ) -> tuple[Bool[np.ndarray, "pieces"], Bool[np.ndarray, "pieces"]]:
        """Whether each source sees the center of its piece, and whether it sees all of the piece alike."""
        return self.shadows.see(self.cones.view[source], pieces, center)

    def see_points(self, source: Int[np.ndarray, "n"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether sources see free points."""
        return self.shadows.table.sees(self.cones.view[source], points)

    def may_bend(self, pieces: Pieces, source: Int[np.ndarray, "pieces"]) -> Bool[np.ndarray, "pieces"]:
        """Whether a shortest path from some point of each piece may turn at its source, for all it may see."""
        turn = self.cones.turn[source]
        may, corner = np.ones(len(source), bool), np.flatnonzero(turn >= 0)  # there may be none but the goal
        turn, (x, y) = turn[corner], pieces[:, corner]
        for normal in self.turns.normal[:, turn]:
            height = highest(x * normal[:, :1] + y * normal[:, 1:])
            may[corner] &= height >= (normal * self.turns.points[turn]).sum(axis=1) - self.turns.slack
        return may
