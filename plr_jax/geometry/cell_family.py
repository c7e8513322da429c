"""Sample points of boxes, and sources of cells, for many goals of one map: what all goals share is computed once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import concatenated, parts, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.cell_sight import CellSources, Shadows, Sight, turns_by_triangle
from plr_jax.geometry.convex_pieces import areas, centers, clip_to_boxes
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints, views_by_triangle
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import VisibilityTable, joined_tables

_PAIRS = 1 << 18  # pairs of a sample and a corner in memory at a time
_WALL_BOXES = 1 << 11  # boxes at walls in memory at a time
_LEAST_FREE_AREA = 1e-9  # free share of a box's area below which the box counts as an obstacle
Corners: TypeAlias = Float[np.ndarray, "boxes 2"]
Indices: TypeAlias = Int[np.ndarray, " cells"]


@dataclass(frozen=True, eq=False)
class FamilySamples:
    """A sample point in each box that is not blocked, and the corners where paths from the sample may turn first."""

    x: Corners  # center of each box, or of its largest free convex piece if a wall meets it; NaN if nothing is free
    weight: Float[np.ndarray, " boxes"]  # free share of each box's area; 0 without a sample
    sampled: Int[np.ndarray, " sampled"]  # boxes that have a sample
    placed: Float[np.ndarray, "sampled 2"]  # samples of these boxes, rounded and moved out of walls
    box: Int[np.ndarray, " seeing"]  # boxes whose samples see corners
    first: Int[np.ndarray, " seeing"]  # the corners of box[i] begin at corner[first[i]]
    corner: Int[np.ndarray, " pairs"]
    length: Float[np.ndarray, " pairs"]  # distance from the sample to each of these corners

    @staticmethod
    def of(visibility: CornerVisibility, triangulation: Triangulation, lo: Corners, hi: Corners) -> "FamilySamples":
        """Choose a sample point in each box ``lo[i]`` to ``hi[i]``, and find where paths from it may turn first.

        All boxes have the same size.
        """
        # 1. Sample boxes without walls at their centers: the box is free or blocked as a whole.
        x, weight = (lo + hi) / 2, np.ones(len(lo))
        at_wall = np.unique(triangulation.boundary.tree.query(shapely.box(*lo.T, *hi.T), predicate="intersects")[0])
        elsewhere = np.setdiff1d(np.arange(len(lo)), at_wall)
        weight[elsewhere] = triangulation.locator.find(x[elsewhere])[1] >= -triangulation.tolerance
        # 2. Sample boxes at walls at the center of their largest free piece.
        triangles = np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1))
        for begin in range(0, len(at_wall), _WALL_BOXES):
            batch = at_wall[begin : begin + _WALL_BOXES]
            pieces, box, _ = clip_to_boxes(triangles, lo[batch], hi[batch])
            area = areas(pieces)
            order = np.lexsort((-area, box))
            largest = order[np.append(True, box[order[1:]] != box[order[:-1]])[: len(order)]]
            x[batch[box[largest]]] = centers(pieces[:, largest])
            weight[batch] = np.bincount(box, area, len(batch)) / np.prod(hi[0] - lo[0])
        weight[weight < _LEAST_FREE_AREA] = 0.0
        sampled = np.flatnonzero(weight)
        x[weight == 0] = np.nan
        # 3. List, for each triangle, the corners that see a part of it; both ways to bend around a corner are one.
        corners = visibility.corners
        first, turns = turns_by_triangle(visibility, triangulation)
        triangle = np.repeat(np.arange(len(first) - 1), np.diff(first))
        first, corner_of_entry = views_by_triangle(triangulation, np.stack([turns >> 1, triangle]))
        # 4. Pair each sample with the corners of its triangle that it sees and at which a path from it may turn.
        places = triangulation.place(x[sampled])
        pairs = [np.zeros((2, 0), np.int64)]
        for part in parts(np.diff(first)[places.triangle], _PAIRS):
            entry, sample = take_ragged(first, places.triangle[part])
            pair = np.stack([sample + part.start, corner_of_entry[entry]])
            pair = pair[:, corners.is_tangent_to(pair[1], places.x[pair[0]])]
            pairs.append(pair[:, visibility.table.sees(pair[1], places.x[pair[0]])])
        sample, corner = np.concatenate(pairs, axis=1)
        first = np.flatnonzero(np.append(True, sample[1:] != sample[:-1])[: len(sample)])
        length = np.linalg.norm(x[sampled[sample]] - corners.points[corner], axis=1)
        box = sampled[sample[first]]
        return FamilySamples(x, weight, sampled, places.x, box, first, corner.astype(np.int32), length)

    def first_turns(
        self, goal: Float[np.ndarray, "2"], view: VisibilityTable, corner_distances: Float[np.ndarray, " corners"]
    ) -> tuple[Float[np.ndarray, " boxes"], Int[np.ndarray, " boxes"]]:
        """Return the distance from each box's sample to a goal, and the point where the shortest path turns first.

        Args:
            goal: The goal.
            view: The goal's visibility polygon.
            corner_distances: The distance of each corner to the goal.

        Returns:
            The distance for each box (``inf`` without a path or sample), and an index for each box: 1 + the index of
            the corner where the path turns first; 0 if the path is straight; -1 without a path or sample.
        """
        distance, vertex = np.full(len(self.x), np.inf), np.full(len(self.x), -1)
        # 1. Paths by corners. Of equally short ones, the first corner of the list is assigned last, and stays.
        if len(self.first):
            length = corner_distances[self.corner] + self.length
            distance[self.box] = np.minimum.reduceat(length, self.first)
            counts = np.diff(self.first, append=len(length))
            shortest = np.flatnonzero((length == np.repeat(distance[self.box], counts)) & np.isfinite(length))[::-1]
            vertex[np.repeat(self.box, counts)[shortest]] = self.corner[shortest] + 1
        # 2. Straight paths, which are shorter, replace them. The goal sees nothing beyond a box around the edges that
        #    it sees.
        ends = np.append(view.boundary.segments[view.edge[view.edge >= 0]].reshape(-1, 2), view.points, axis=0)
        lo, hi = ends.min(axis=0) - view.tolerance, ends.max(axis=0) + view.tolerance
        near = np.flatnonzero(((self.placed >= lo) & (self.placed <= hi)).all(axis=1))
        direct = self.sampled[near[view.sees(np.zeros(len(near), int), self.placed[near])]]
        distance[direct], vertex[direct] = np.linalg.norm(self.x[direct] - goal, axis=1), 0
        return distance, vertex


class FamilyGoal(NamedTuple):
    """The data of one goal that :func:`cells_of_goals` needs."""

    sources: Sources  # the goal, then all corners
    turns: TurnPoints  # where paths to the goal turn
    view: VisibilityTable  # the visibility polygon of the goal


def cells_of_goals(
    shared: CellSources, corners: ReflexCorners, goals: Sequence[FamilyGoal], box: Indices, goal_of: Indices
) -> CellSources:
    """Return pieces of boxes with their sources: cell ``i`` is box ``box[i]``, for paths to ``goals[goal_of[i]]``.

    ``shared`` has the boxes, and the corners that their pieces may see. Source ``g * count`` of the result is goal
    ``g``, and source ``g * count + 1 + c`` is corner ``c`` on paths to goal ``g``, with ``count`` 1 more than the
    number of corners.
    """
    sight, cells = _sight_of_goals(shared.sight, corners, goals), shared.of_cells(box)
    goal = goal_of[cells.cell]  # of each piece
    # 1. Find the corners where paths to each goal turn. `shared` has two sources of corner c, 2 c + side, and paths
    #    to one goal turn around the corner to one side: side 1 if they pass the opening wall. Then the second normal
    #    of the turn point's cone is the left normal of that wall.
    is_turn = np.zeros((len(goals), 2 * len(corners.points)), bool)
    for row, of_goal in zip(is_turn, goals, strict=True):
        corner = of_goal.turns.vertex - 1
        side = (of_goal.turns.normal[1] == turned_left(corners.walls[0, corner])).all(axis=1)
        row[2 * corner + side] = True
    pairs = np.flatnonzero(is_turn[goal[cells.piece], cells.source])
    # 2. Pair all pieces with the goal, and with the corners around which paths from the piece may bend.
    piece = np.append(np.arange(len(goal)), cells.piece[pairs])
    source = np.append(0 * goal, 1 + (cells.source[pairs] >> 1)) + goal[piece] * (1 + len(corners.points))
    by_all = np.append(np.zeros(len(goal), bool), cells.by_all[pairs])
    kept = np.flatnonzero(sight.may_bend(cells.pieces[:, piece], source))
    kept = kept[np.argsort(piece[kept], kind="stable")]
    # 3. Test what viewpoints see, unless it is known. Drop sources through which no path is shorter.
    cells = replace(cells, sight=sight, piece=piece[kept], source=source[kept], by_all=by_all[kept])
    return cells.prune_sources(np.ones(len(goal), bool))


def _sight_of_goals(sight: Sight, corners: ReflexCorners, goals: Sequence[FamilyGoal]) -> Sight:
    """Join the sources of several goals, one goal after the other, into one :class:`Sight`."""
    num, count = len(goals), 1 + len(corners.points)
    # 1. Viewpoints are all goals, then all corners.
    shadows = Shadows.of(joined_tables([*(goal.view for goal in goals), sight.shadows.table]))
    # 2. Each goal has a row of sources, the goal and all corners. Find their viewpoints.
    view = np.tile(num - 1 + np.arange(count), (num, 1))
    view[:, 0] = np.arange(num)
    points, distances, parents = concatenated([goal.sources for goal in goals], "points", "distances", "parents")
    parents += np.repeat(count * np.arange(num), count)
    sources = Sources(points, distances, parents)
    # 3. Find the turn points of sources, which lie goal by goal.
    first = np.cumsum([0, *(len(goal.turns.vertex) for goal in goals)])
    turn = np.full((num, count), first[-1] - 1)  # also of corners that no path turns at, which are never tested
    turn[:, 0] = -1
    for i, goal in enumerate(goals):
        turn[i, goal.turns.vertex] = first[i] + np.arange(len(goal.turns.vertex))
    vertex, at, distance = concatenated([goal.turns for goal in goals], "vertex", "points", "distance")
    normal = np.concatenate([goal.turns.normal for goal in goals], axis=1)
    turns = TurnPoints(vertex, at, distance, normal, goals[0].turns.slack)
    return Sight(sources, view.ravel(), turn.ravel(), shadows, turns, sight.triangulation)
