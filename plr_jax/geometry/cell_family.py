"""Sample points and convex pieces of boxes, and the corners that each sees, computed once for many goals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import concatenated, parts, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.cell_sight import CellSources, Shadows, Sight, corner_sight, turns_by_triangle
from plr_jax.geometry.convex_pieces import Pieces, areas, boxes_as_pieces, centers, clip_to_boxes, highest, lowest
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints
from plr_jax.geometry.triangulation import TriangleLists, Triangulation
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import VisibilityTable, joined_tables

_PAIRS, _WALL_BOXES = 1 << 18, 1 << 11  # pairs of a sample and a corner, and boxes at walls, in memory at a time
_CANDIDATES = 1 << 14  # pairs of a piece and a source whose arrays stay in a core's cache
_LEAST_FREE_AREA = 1e-9  # free share of a box's area below which the box counts as an obstacle
Corners: TypeAlias = Float[np.ndarray, "boxes 2"]
Indices: TypeAlias = Int[np.ndarray, " cells"]


@dataclass(frozen=True, eq=False)
class FamilySamples:
    """A sample point of each box that is not blocked, and the corners where paths from the sample may turn first."""

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
        # 1. Choose the samples.
        x, weight, area = (lo + hi) / 2, np.ones(len(lo)), np.prod(hi[0] - lo[0])
        at_wall = triangulation.boundary.tree.query(shapely.box(*lo.T, *hi.T), predicate="intersects")[0]
        at_wall = np.unique(at_wall)
        elsewhere = np.setdiff1d(np.arange(len(lo)), at_wall)
        weight[elsewhere] = triangulation.locator.find(x[elsewhere])[1] >= -triangulation.tolerance
        weight[at_wall] = 0.0
        triangles = np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1))
        for begin in range(0, len(at_wall), _WALL_BOXES):
            batch = at_wall[begin : begin + _WALL_BOXES]
            pieces, box, _ = clip_to_boxes(triangles, lo[batch], hi[batch])
            size = areas(pieces)
            order = np.lexsort((-size, box))
            largest = order[np.append(True, box[order[1:]] != box[order[:-1]])] if len(order) else order
            x[batch[box[largest]]] = centers(pieces[:, largest])
            weight[batch] = np.bincount(box, size, len(batch)) / area
        weight[weight < _LEAST_FREE_AREA] = 0.0
        sampled = np.flatnonzero(weight)
        x[weight == 0] = np.nan
        # 2. Test the corners that see a part of each sample's triangle.
        places, corners = triangulation.place(x[sampled]), visibility.corners
        first, turns = turns_by_triangle(visibility, triangulation)
        count = np.int64(len(corners.points))
        key = np.unique(np.repeat(np.arange(len(first) - 1), np.diff(first)) * count + (turns >> 1))
        triangle, of_triangle = np.divmod(key, count)
        first = np.searchsorted(triangle, np.arange(len(first)))
        pairs = [np.zeros((2, 0), np.int64)]
        for part in parts(np.diff(first)[places.triangle], _PAIRS):
            entry, sample = take_ragged(first, places.triangle[part])
            corner, sample = of_triangle[entry], sample + part.start
            turns_there = corners.is_tangent_to(corner, places.x[sample])
            corner, sample = corner[turns_there], sample[turns_there]
            seen = visibility.table.sees(corner, places.x[sample])
            pairs.append(np.stack([sample[seen], corner[seen]]))
        sample, corner = np.concatenate(pairs, axis=1)
        first = np.flatnonzero(np.append(True, sample[1:] != sample[:-1])[: len(sample)])
        length = np.linalg.norm(x[sampled[sample]] - corners.points[corner], axis=1)
        box = sampled[sample[first]]
        return FamilySamples(x, weight, sampled, places.x, box, first, corner.astype(np.int32), length)

    def first_turns(
        self, goal: Float[np.ndarray, "2"], view: VisibilityTable, corner_distances: Float[np.ndarray, " corners"]
    ) -> tuple[Float[np.ndarray, " boxes"], Int[np.ndarray, " boxes"]]:
        # ``vertex``: 1 + the index of the corner where the path turns first; 0: straight; -1: no path.
        distance, vertex = np.full(len(self.x), np.inf), np.full(len(self.x), -1)
        if len(self.first):
            length = corner_distances[self.corner] + self.length
            distance[self.box] = np.minimum.reduceat(length, self.first)
            counts = np.diff(self.first, append=len(length))
            shortest = np.flatnonzero((length == np.repeat(distance[self.box], counts)) & np.isfinite(length))[::-1]
            vertex[np.repeat(self.box, counts)[shortest]] = self.corner[shortest] + 1
        lo, hi = _view_box(view)
        near = np.flatnonzero(((self.placed >= lo) & (self.placed <= hi)).all(axis=1))
        direct = self.sampled[near[view.sees(np.zeros(len(near), int), self.placed[near])]]
        distance[direct], vertex[direct] = np.linalg.norm(self.x[direct] - goal, axis=1), 0
        return distance, vertex


def _view_box(view: VisibilityTable) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    ends = np.append(view.boundary.segments[view.edge[view.edge >= 0]].reshape(-1, 2), view.points, axis=0)
    return ends.min(axis=0) - view.tolerance, ends.max(axis=0) + view.tolerance


@dataclass(frozen=True, eq=False)
class FamilyCells:
    """The free parts of boxes as convex pieces, for oracles of any goal on one map."""

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
        """Cut free space into convex pieces, box by box; a box that no wall reaches into is one piece."""
        triangles = np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1))
        pieces, box, part = clip_to_boxes(triangles, lo, hi)
        at_wall = triangulation.boundary.tree.query(shapely.box(*lo.T, *hi.T), predicate="intersects")[0]
        is_free = ~np.isin(np.arange(len(lo)), at_wall)[box]
        first_part = np.flatnonzero(~is_free | np.append(True, box[1:] != box[:-1])[: len(box)])
        pieces, triangle, is_free = pieces[:, first_part], part[first_part], is_free[first_part]
        box = box[first_part]
        pieces[:, is_free], triangle[is_free] = boxes_as_pieces(lo[box[is_free]], hi[box[is_free]]), -1
        sight, lists = corner_sight(visibility, triangulation), turns_by_triangle(visibility, triangulation)
        first_piece, first_part = np.searchsorted(box, np.arange(len(lo) + 1)), np.append(first_part, len(part))
        return FamilyCells(sight, lists, first_piece, pieces, triangle, centers(pieces), first_part, part)


class FamilyGoal(NamedTuple):
    """The sources, turn points and visibility polygon of one goal, as cells of a family need them."""

    sources: Sources  # the goal, then all corners
    turns: TurnPoints  # where paths to the goal turn
    view: VisibilityTable  # the visibility polygon of the goal


def cells_of_goals(
    shared: FamilyCells, corners: ReflexCorners, goals: Sequence[FamilyGoal], box: Indices, goal_of: Indices
) -> CellSources:
    # Cell ``i`` is box ``box[i]``, for paths to goal ``goal_of[i]``.
    sight, count = _sight_of_goals(shared.sight, corners, goals), 1 + len(corners.points)
    sources, table = sight.sources, sight.shadows.table
    rows, cell = take_ragged(shared.first_piece, box)
    goal, pieces = goal_of[cell], shared.pieces[:, rows]
    # 1. List, for each triangle and goal, the corners where paths to the goal turn, around the side in the list.
    first, turns = shared.lists
    firsts, vertices = [np.zeros(1, np.int64)], []
    for of_goal in goals:
        vertex, turns_here = of_goal.turns.vertex - 1, np.zeros(2 * len(corners.points), bool)
        side = (of_goal.turns.normal[1] == turned_left(corners.walls[0, vertex])).all(axis=1)
        turns_here[2 * vertex + side] = True
        is_turn = turns_here[turns]
        firsts.append(firsts[-1][-1] + np.append(0, np.cumsum(is_turn))[first[1:]])
        vertices.append(1 + (turns[is_turn] >> 1))
    first, vertex = np.concatenate(firsts), np.concatenate(vertices)
    # 2. Pair pieces with the goal if it may see them, and with the corners in the lists of their triangles around
    #    which paths from the piece may bend.
    lo, hi = np.stack([_view_box(of_goal.view) for of_goal in goals], axis=1)[:, goal]
    near_goal = [(highest(x) >= lo[:, i]) & (lowest(x) <= hi[:, i]) for i, x in enumerate(pieces)]
    is_near = near_goal[0] & near_goal[1]
    part, piece = take_ragged(shared.first_part, rows)
    part = goal[piece] * (len(shared.lists[0]) - 1) + shared.part[part]
    keys = [np.zeros(0, np.int64)]
    for some in parts(first[part + 1] - first[part], _CANDIDATES):
        entry, run = take_ragged(first, part[some])
        near = piece[some][is_near[piece[some]]]
        owner, source = np.append(near, piece[some][run]), np.append(0 * near, vertex[entry])
        source += goal[owner] * count
        pairs = np.flatnonzero(sight.may_bend(pieces[:, owner], source))
        keys.append(owner[pairs] * np.int64(len(sources.points)) + source[pairs])
    key = np.sort(np.concatenate(keys))  # a source may be in the lists of several triangles of a piece
    piece, source = np.divmod(key[np.append(True, key[1:] != key[:-1])[: len(key)]], len(sources.points))
    # 3. Test what the sources see, once for all goals.
    view, num_views = sight.view[source], len(table.points)
    key, index = np.unique(rows[piece] * num_views + view, return_inverse=True)
    row, view = np.divmod(key, num_views)
    seen, is_whole = (flags[index] for flags in sight.shadows.see(view, shared.pieces[:, row], shared.center[row]))
    keep, triangle = seen | ~is_whole, shared.triangle[rows]
    piece, source, by_all, by_center = piece[keep], source[keep], (seen & is_whole)[keep], seen[keep]
    unknown = np.full(len(cell), np.inf), 0 * cell
    cells = CellSources(sight, len(box), cell, pieces, triangle, shared.center[rows], *unknown, piece, source, by_all)
    return cells.prune_dominated(np.ones(len(cell), bool), by_center)


def _sight_of_goals(sight: Sight, corners: ReflexCorners, goals: Sequence[FamilyGoal]) -> Sight:
    """Join the sources and turns of several goals, one goal after the other, with what corners see."""
    num, count = len(goals), 1 + len(corners.points)
    tables, shadows = joined_tables([goal.view for goal in goals]), sight.shadows
    table, of_goals = joined_tables([tables, shadows.table]), Shadows.of(tables)
    key, unit, start, end = concatenated((of_goals, shadows), "key", "unit", "start", "end")
    key[len(of_goals.key) :] += 4.0 * num
    # Views are those of the goals, then those of the corners.
    view = np.tile(num - 1 + np.arange(count), (num, 1))
    view[:, 0] = np.arange(num)
    first = np.cumsum([0, *(len(goal.turns.vertex) for goal in goals)])
    turn = np.full((num, count), first[-1] - 1)  # also of corners that no path turns at, which are never tested
    turn[:, 0] = -1
    for i, goal in enumerate(goals):
        turn[i, goal.turns.vertex] = first[i] + np.arange(len(goal.turns.vertex))
    vertex, at, distance = concatenated([goal.turns for goal in goals], "vertex", "points", "distance")
    normal = np.concatenate([goal.turns.normal for goal in goals], axis=1)
    turns = TurnPoints(vertex, at, distance, normal, goals[0].turns.slack)
    points, distances, parents = concatenated([goal.sources for goal in goals], "points", "distances", "parents")
    parents += np.repeat(count * np.arange(num), count)
    sources, shadows = Sources(points, distances, parents), Shadows(table, key, unit, start, end)
    return Sight(sources, view.ravel(), turn.ravel(), shadows, turns, sight.triangulation, True)
