"""Data of boxes, computed once for many goals on a map: sample points, convex pieces, and the corners that see them.

Shortest paths from a sample point, or from a point of a piece, may turn first at a corner that sees it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import batches, concatenated, parts, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.cell_sight import CellSources, Corners, Rows, Shadows, Sight, corner_sight, turns_by_triangle
from plr_jax.geometry.convex_pieces import Pieces, areas, boxes_as_pieces, centers, clip_to_boxes, highest, lowest
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints, corners_by_triangle, sorted_unique
from plr_jax.geometry.triangulation import TriangleLists, Triangulation
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import VisibilityTable

_PAIRS = 1 << 18  # pairs of a sample and a corner in memory at a time
_WALL_BOXES = 1 << 11  # boxes at walls in memory at a time
_CANDIDATES = 1 << 14  # pairs of a piece and a source whose arrays stay in a core's cache
_LEAST_FREE_AREA = 1e-9  # free share of a box's area below which the box counts as an obstacle


class FamilySamples(NamedTuple):
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
        for batch in batches(at_wall, _WALL_BOXES):
            pieces, box, _ = clip_to_boxes(triangles, lo[batch], hi[batch])
            area = areas(pieces)
            order = np.lexsort((-area, box))
            largest = order[np.append(True, box[order[1:]] != box[order[:-1]])[: len(order)]]
            x[batch[box[largest]]] = centers(pieces[:, largest])
            weight[batch] = np.bincount(box, area, len(batch)) / np.prod(hi[0] - lo[0])
        weight[weight < _LEAST_FREE_AREA] = 0.0
        sampled = np.flatnonzero(weight)
        x[weight == 0] = np.nan
        # 3. List, for each triangle, the corners that see a part of it.
        corners = visibility.corners
        first, corner_of_entry = corners_by_triangle(visibility, triangulation)
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
        length = corner_distances[self.corner] + self.length
        distance[self.box] = np.minimum.reduceat(length, self.first)
        counts = np.diff(self.first, append=len(length))
        shortest = np.flatnonzero((length == np.repeat(distance[self.box], counts)) & np.isfinite(length))[::-1]
        vertex[np.repeat(self.box, counts)[shortest]] = self.corner[shortest] + 1
        # 2. Straight paths, which are shorter, replace them.
        lo, hi = _view_box(view)
        near = np.flatnonzero(((self.placed >= lo) & (self.placed <= hi)).all(axis=1))
        direct = self.sampled[near[view.sees(np.zeros(len(near), int), self.placed[near])]]
        distance[direct], vertex[direct] = np.linalg.norm(self.x[direct] - goal, axis=1), 0
        return distance, vertex


def _view_box(view: VisibilityTable) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return the lower and upper corner of a box that contains a viewpoint and all edges that the viewpoint sees.

    ``view`` is the visibility polygon of this one viewpoint.
    """
    ends = np.append(view.boundary.segments[view.edge[view.edge >= 0]].reshape(-1, 2), view.points, axis=0)
    return ends.min(axis=0) - view.tolerance, ends.max(axis=0) + view.tolerance


class FamilyCells(NamedTuple):
    """The free space in boxes as convex pieces, and the corners that see them; built once for all goals on a map."""

    sight: Sight  # for any goal
    lists: TriangleLists  # corners that see a part of each triangle of free space, from `turns_by_triangle`
    first_piece: Int[np.ndarray, " boxes_plus_one"]
    pieces: Pieces  # the convex parts of the free space in each box
    triangle: Int[np.ndarray, " pieces"]  # that contains each piece; -1 for a box that no wall reaches into
    center: Float[np.ndarray, "pieces 2"]  # a point inside each piece
    first_part: Int[np.ndarray, " pieces_plus_one"]
    part: Int[np.ndarray, "parts"]  # the triangles part[first_part[i] : first_part[i + 1]] cover piece i

    @staticmethod
    def of(visibility: CornerVisibility, triangulation: Triangulation, lo: Corners, hi: Corners) -> "FamilyCells":
        """Cut the free space in each box from ``lo[i]`` to ``hi[i]`` into convex pieces.

        A box that no wall reaches into is one piece.
        """
        # 1. Cut all triangles into parts, sorted by box: the triangle of part ``i`` is ``part[i]``.
        pieces, box, part = clip_to_boxes(np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1)), lo, hi)
        # 2. Make one piece of all parts of a free box, and a piece of each part of any other box.
        at_wall = triangulation.boundary.tree.query(shapely.box(*lo.T, *hi.T), predicate="intersects")[0]
        is_free = ~np.isin(np.arange(len(lo)), at_wall)[box]
        first_part = np.flatnonzero(~is_free | np.append(True, box[1:] != box[:-1])[: len(box)])
        pieces, triangle, is_free, box = pieces[:, first_part], part[first_part], is_free[first_part], box[first_part]
        pieces[:, is_free], triangle[is_free] = boxes_as_pieces(lo[box[is_free]], hi[box[is_free]]), -1
        first_piece = np.searchsorted(box, np.arange(len(lo) + 1))
        # 3. List what corners see.
        sight, lists = corner_sight(visibility, triangulation), turns_by_triangle(visibility, triangulation)
        rows = first_piece, pieces, triangle, centers(pieces), np.append(first_part, len(part)), part
        return FamilyCells(sight, lists, *rows)


class FamilyGoal(NamedTuple):
    """A goal with its sources, turn points and visibility polygon, as :func:`cells_of_goals` takes it."""

    sources: Sources  # the goal, then all corners
    turns: TurnPoints  # where paths to the goal turn
    view: VisibilityTable  # the visibility polygon of the goal


def cells_of_goals(
    shared: FamilyCells, corners: ReflexCorners, goals: Sequence[FamilyGoal], box: Rows, goal_of: Rows
) -> CellSources:
    """Return cells with their convex pieces and *sources*: points to which shortest paths from a piece may go first.

    Cell ``i`` is the free space in the box of index ``box[i]``, with the sources of paths to ``goals[goal_of[i]]``.
    Let ``count`` be 1 more than the number of corners. Source ``g * count`` is goal ``g``, and source
    ``g * count + 1 + c`` is corner ``c`` on paths to goal ``g``.
    """
    sight = _sight_of_goals(shared.sight, corners, goals)
    count, num_sources = 1 + len(corners.points), len(sight.sources.points)
    rows, cell = take_ragged(shared.first_piece, box)
    goal, pieces = goal_of[cell], shared.pieces[:, rows]
    # 1. List, for each goal and triangle, the corners where paths to the goal turn. `shared.lists` has turn points
    #    2 c + side, and paths to one goal turn around corner c to one side: side 1 if they pass the opening wall.
    #    Then the second normal of the turn point's cone is the left normal of that wall. Triangle t of goal g has the
    #    corners vertex[first[g * num_triangles + t] : first[g * num_triangles + t + 1]] - 1.
    first, turns = shared.lists
    num_triangles = len(first) - 1
    firsts, vertices = [np.zeros(1, np.int64)], []
    for of_goal in goals:
        corner = of_goal.turns.vertex - 1
        side = (of_goal.turns.normal[1] == turned_left(corners.walls[0, corner])).all(axis=1)
        is_turn_point = np.zeros(2 * len(corners.points), bool)
        is_turn_point[2 * corner + side] = True
        is_turn = is_turn_point[turns]
        firsts.append(firsts[-1][-1] + np.append(0, np.cumsum(is_turn))[first[1:]])
        vertices.append(1 + (turns[is_turn] >> 1))
    first, vertex = np.concatenate(firsts), np.concatenate(vertices)
    # 2. Pair pieces with the goal if it may see them, and with the corners in the lists of their triangles around
    #    which paths from the piece may bend. A source may be in the lists of several triangles of a piece.
    lo, hi = np.stack([_view_box(of_goal.view) for of_goal in goals], axis=1)[:, goal]
    is_near = np.logical_and(*((highest(x) >= lo[:, i]) & (lowest(x) <= hi[:, i]) for i, x in enumerate(pieces)))
    part, piece = take_ragged(shared.first_part, rows)
    list_of_part = goal[piece] * num_triangles + shared.part[part]
    keys = [np.zeros(0, np.int64)]
    for batch in parts(first[list_of_part + 1] - first[list_of_part], _CANDIDATES):
        entry, run = take_ragged(first, list_of_part[batch])
        near = piece[batch][is_near[piece[batch]]]
        owner = np.append(near, piece[batch][run])
        source = np.append(0 * near, vertex[entry]) + goal[owner] * count
        pairs = np.flatnonzero(sight.may_bend(pieces[:, owner], source))
        keys.append(owner[pairs] * np.int64(num_sources) + source[pairs])
    piece, source = np.divmod(sorted_unique(np.concatenate(keys)), num_sources)
    # 3. Test what viewpoints see, once for all goals: what a corner sees of a piece does not depend on the goal.
    num_views = len(sight.shadows.table.points)
    key, index = np.unique(rows[piece] * num_views + sight.view[source], return_inverse=True)
    row, view = np.divmod(key, num_views)
    seen, is_whole = (flags[index] for flags in sight.shadows.see(view, shared.pieces[:, row], shared.center[row]))
    # 4. Keep pairs unless the source sees nothing of the piece. Drop sources through which no path is shorter.
    keep = seen | ~is_whole
    pairs = piece[keep], source[keep], (seen & is_whole)[keep]
    of_pieces = pieces, shared.triangle[rows], shared.center[rows], np.full(len(cell), np.inf), 0 * cell
    cells = CellSources(sight, len(box), cell, *of_pieces, *pairs)
    return cells.prune_dominated(np.ones(len(cell), bool), seen[keep])


def _sight_of_goals(sight: Sight, corners: ReflexCorners, goals: Sequence[FamilyGoal]) -> Sight:
    """Join the sources of several goals, one goal after the other, into one :class:`Sight`."""
    num, count = len(goals), 1 + len(corners.points)
    # 1. Viewpoints are all goals, then all corners. Keys begin with 4 times the viewpoint's index.
    goal_table = VisibilityTable.joined([goal.view for goal in goals])
    of_goals, of_corners = Shadows.of(goal_table), sight.shadows
    key, unit, start, end = concatenated((of_goals, of_corners), "key", "unit", "start", "end")
    key[len(of_goals.key) :] += 4.0 * num
    shadows = Shadows(VisibilityTable.joined([goal_table, of_corners.table]), key, unit, start, end)
    # 2. Each goal has a row of sources, the goal and all corners. Find their viewpoints.
    view = np.tile(num - 1 + np.arange(count), (num, 1))
    view[:, 0] = np.arange(num)
    points, distances, parents = concatenated([goal.sources for goal in goals], "points", "distances", "parents")
    parents += np.repeat(count * np.arange(num), count)
    # 3. Find the turn points of sources, which lie goal by goal.
    vertex, at, distance = concatenated([goal.turns for goal in goals], "vertex", "points", "distance")
    turn = np.full((num, count), len(vertex) - 1)  # also of corners that no path turns at, which are never tested
    turn[:, 0] = -1
    turn[np.repeat(np.arange(num), [len(goal.turns.vertex) for goal in goals]), vertex] = np.arange(len(vertex))
    normal = np.concatenate([goal.turns.normal for goal in goals], axis=1)
    turns = TurnPoints(vertex, at, distance, normal, goals[0].turns.slack)
    return Sight(Sources(points, distances, parents), view.ravel(), turn.ravel(), shadows, turns, sight.triangulation)
