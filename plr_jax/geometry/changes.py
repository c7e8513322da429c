"""Updates of a triangulation and of corner visibility after a local change of free space.

Triangles are kept unless a changed edge meets them, and the gap is triangulated. Corners keep what they see unless
they may see a changed edge. So the cost follows the size of the change, except for a few passes over all edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plr_jax._arrays import ragged_indices, take_ragged
from plr_jax.geometry.boundary import Boundary, boxes_near, match_boundary
from plr_jax.geometry.corners import CornerVisibility, corner_of_vertex, find_corners, mutually_visible_pairs
from plr_jax.geometry.triangulation import Triangulation, next_half_edge, triangulation_of
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, visibility_of
from plr_jax.geometry.workspace import Workspace

_TURN = 4.0  # a full turn as a pseudo-angle
Indices: TypeAlias = Int[np.ndarray, " _"]
GoalView: TypeAlias = tuple[VisibilityTable, Indices]  # visibility polygon of a goal, and corners that it may see


@dataclass(frozen=True, eq=False)
class Change:
    """A change of the boundary of free space, and which vertices and edges stay."""

    old: Boundary
    new: Boundary
    vertex: Int[np.ndarray, " old_vertices"]  # new index of each old vertex; -1 if it is gone
    edge: Int[np.ndarray, " old_edges"]  # new index of each old edge; -1 if it is gone

    @staticmethod
    def between(old: Boundary, new: Boundary) -> "Change":
        return Change(old, new, *match_boundary(new.vertices, new.edges, old))

    @cached_property
    def is_new(self) -> Bool[np.ndarray, " new_edges"]:
        is_new = np.ones(len(self.new.edges), bool)
        is_new[self.edge[self.edge >= 0]] = False
        return is_new

    def boxes(self, margin: float) -> list[Float[np.ndarray, "corners 2"]]:
        """Return the bounding box of each connected group of changed edges, grown by ``margin``, as four corners."""
        segments = np.concatenate([self.old.segments[self.edge < 0], self.new.segments[self.is_new]])
        points, index = np.unique(segments.reshape(-1, 2), axis=0, return_inverse=True)
        start, end = index.reshape(-1, 2).T
        graph = coo_array((np.ones(len(start)), (start, end)), (len(points),) * 2)
        num, part = connected_components(graph, directed=False)
        lo, hi = np.full((num, 2), np.inf), np.full((num, 2), -np.inf)
        np.minimum.at(lo, part, points)
        np.maximum.at(hi, part, points)
        ends = zip(lo - margin, hi + margin, strict=True)
        return [np.array([(a, c), (b, c), (b, d), (a, d)]) for (a, c), (b, d) in ends]


def changed_triangulation(old: Triangulation, change: Change) -> Triangulation | None:
    """Return the triangulation after a change of walls; None if rounding prevents this and it must be rebuilt."""
    # 1. Keep triangles unless they have a wall that is gone or meet a new edge.
    is_gone = ((old.wall >= 0) & (change.edge[old.wall] < 0)) | (change.vertex[old.origin] < 0)
    is_kept = ~np.asarray(is_gone.reshape(-1, 3).any(axis=1))
    segments = change.new.segments[change.is_new]
    if len(segments):
        near = np.flatnonzero(boxes_near(old.triangles, segments, old.tolerance) & is_kept)
        polygons = shapely.polygons(old.triangles[near])
        tree = shapely.STRtree(np.asarray(shapely.linestrings(segments)))
        is_kept[near[tree.query(polygons, predicate="dwithin", distance=old.tolerance)[0]]] = False
    half_kept = np.repeat(is_kept, 3)
    wall = np.where(old.wall >= 0, change.edge[old.wall], -1)
    has_triangle = np.zeros(len(change.new.edges), bool)
    has_triangle[wall[half_kept & (wall >= 0)]] = True
    # 2. Triangulate the gap. It is bounded by walls without a kept triangle, and by sides of kept triangles.
    vertex = change.vertex[old.origin]
    rims = np.flatnonzero(~half_kept & (old.twin >= 0) & half_kept[old.twin])
    walls = np.flatnonzero(~has_triangle)
    edges = np.concatenate([change.new.edges[walls], np.stack([vertex[rims], vertex[next_half_edge(rims)]], axis=1)])
    if (edges < 0).any():
        return None
    local, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    gap = Boundary(change.new.vertices[local], ends, np.zeros(len(ends), int))
    try:
        fill = triangulation_of(gap, old.tolerance)
    except ValueError:
        return None
    if len(np.unique(fill.wall[fill.wall >= 0])) < len(edges):
        return None
    # 3. Concatenate kept half-edges and those of the gap, and link them along the rims.
    kept_half = np.flatnonzero(half_kept)
    new_index = np.full(len(half_kept), -1)
    new_index[kept_half] = np.arange(len(kept_half))
    origin = np.concatenate([vertex[kept_half], local[fill.origin]])
    kept_twin = np.where(old.twin[kept_half] >= 0, new_index[old.twin[kept_half]], -1)
    twin = np.concatenate([kept_twin, np.where(fill.twin >= 0, fill.twin + len(kept_half), -1)])
    names = np.append(walls, np.full(len(rims), -1))
    walls_of_fill = np.where(fill.wall >= 0, names[fill.wall], -1)
    is_rim = np.flatnonzero(fill.wall >= len(walls))
    beyond = new_index[old.twin[rims[fill.wall[is_rim] - len(walls)]]]
    twin[len(kept_half) + is_rim], twin[beyond] = beyond, len(kept_half) + is_rim
    wall = np.concatenate([wall[kept_half], walls_of_fill])
    return Triangulation(change.new, old.tolerance, *(column.astype(np.int32) for column in (origin, twin, wall)))


def changed_visibility(
    old: CornerVisibility, of_goal: GoalView, goal: Viewpoints, workspace: Workspace, change: Change
) -> tuple[CornerVisibility, GoalView]:
    """Return what all corners and the goal see after a change, computed again only where it may differ."""
    corners, views = find_corners(workspace)
    # 1. Match each new corner with an old one between the same walls.
    boundary = change.new
    of_vertex, is_kept = np.full(len(boundary.vertices), -1), change.vertex >= 0
    of_vertex[change.vertex[is_kept]] = old.of_vertex[is_kept]
    before = np.full(len(views.points), -1)
    before[views.owner] = of_vertex[boundary.edges[views.edge, 0]]
    # All sectors of both must open and close at equal edges.
    is_same = np.zeros(len(boundary.edges), bool)
    old_edge = np.flatnonzero(change.edge >= 0)
    end = change.vertex[change.old.sector_end[old_edge]]
    is_same[change.edge[old_edge]] = boundary.sector_end[change.edge[old_edge]] == end
    differs = np.zeros(len(views.points), bool)
    differs[views.owner[~is_same[views.edge]]] = True
    counts = np.bincount(views.owner, minlength=len(views.points))
    old_counts = np.bincount(old.views.owner, minlength=len(old.views.points))
    differs |= counts != np.append(old_counts, 0)[before]
    same = np.where(differs, -1, before)
    # 2. Recompute what corners see that may see a change, and what the goal sees if it may.
    before = np.where(np.append(_may_see_change(old.table, change), True)[same], -1, same)
    goal_changed = bool(_may_see_change(of_goal[0], change)[0])
    unchanged, changed = np.flatnonzero(before >= 0), np.flatnonzero(before < 0)
    viewpoints = views[changed]
    if goal_changed:
        points, owner = np.concatenate([viewpoints.points, goal.points]), goal.owner + len(changed)
        viewpoints = Viewpoints(points, np.append(viewpoints.owner, owner), np.append(viewpoints.edge, goal.edge))
    fresh, (view, vertex) = visibility_of(workspace.triangulation, viewpoints)
    table = _splice([(old.table, before[unchanged], unchanged), (fresh, np.arange(len(changed)), changed)], change)
    seen = corner_of_vertex(workspace.boundary, views)[vertex]
    goal_table, goal_row = (fresh, len(changed)) if goal_changed else (of_goal[0], 0)
    now = np.full(len(old.corners.points), -1)
    now[same[same >= 0]] = np.flatnonzero(same >= 0)
    goal_corners = seen[view == len(changed)] if goal_changed else now[of_goal[1]]
    new = _splice([(goal_table, np.array([goal_row]), np.zeros(1, int))], change), goal_corners
    # 3. Keep the edges between unchanged corners; the others involve a recomputed corner.
    new_index = np.full(len(old.corners.points), -1)
    new_index[before[unchanged]] = unchanged
    edges = new_index[old.edges]
    edges = edges[(edges >= 0).all(axis=1)]
    is_pair = (view < len(changed)) & (seen >= 0)
    view, seen = changed[view[is_pair]], seen[is_pair]
    view, seen = view[view != seen], seen[view != seen]
    back = np.flatnonzero(before[seen] >= 0)
    back = back[table.sees(seen[back], corners.points[view[back]])]
    view, seen = np.append(view, seen[back]), np.append(seen, view[back])
    edges = np.concatenate([edges, mutually_visible_pairs(corners, view, seen)])
    size = np.int64(max(1, len(corners.points)))
    keys = np.sort(edges.min(axis=1) * size + edges.max(axis=1))
    return CornerVisibility(corners, views, table, np.stack(np.divmod(keys, size), axis=1)), new


def _may_see_change(table: VisibilityTable, change: Change) -> Bool[np.ndarray, " views"]:
    """Return which viewpoints may see a change: they saw a wall that is gone, or may see a changed part."""
    sees = np.zeros(len(table.points), bool)
    gone = np.flatnonzero((table.edge >= 0) & (change.edge[table.edge] < 0))
    sees[np.searchsorted(table.first, gone, side="right") - 1] = True
    for box in change.boxes(table.tolerance):
        pending = np.flatnonzero(~sees)
        sees[pending[may_see_polygons(table, pending, box)]] = True
    return sees


def may_see_polygons(
    table: VisibilityTable, view: Int[np.ndarray, " n"], hull: Float[np.ndarray, "*n k 2"]
) -> Bool[np.ndarray, " n"]:
    """Return whether viewpoint ``view[i]`` may see convex polygon ``hull[i]``; False only if closer walls hide it."""
    hull = np.broadcast_to(hull, (len(view), *hull.shape[-2:]))
    away = hull - table.points[view, None]
    (dx, dy), (cx, cy) = np.moveaxis(away, -1, 0), table.cut[view].T[:, :, None]
    angle = np.sort(pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx), axis=1)
    # The polygon spans all directions but the widest gap between its corners. The gap is at least half a turn, unless
    # the viewpoint is inside.
    gap = np.diff(angle, axis=1, append=angle[:, :1] + _TURN)
    rows, widest = np.arange(len(view)), gap.argmax(axis=1)
    first, last = angle[rows, (widest + 1) % angle.shape[1]], angle[rows, widest]
    is_around, wraps = gap[rows, widest] < _TURN / 2, first > last
    polygon = np.append(rows, rows[wraps])
    low = np.append(np.where(wraps, 0.0, first), first[wraps])
    high = np.append(last, np.full(np.count_nonzero(wraps), _TURN))
    viewpoint = view[polygon]
    begin = np.searchsorted(table.key, _TURN * viewpoint + low - table.blur, side="right") - 1
    end = np.searchsorted(table.key, _TURN * viewpoint + high + table.blur, side="right")
    begin, end = np.maximum(begin, table.first[viewpoint]), np.minimum(end, table.first[viewpoint + 1])
    run, place = ragged_indices(np.maximum(end - begin, 0))
    edge, polygon = table.edge[begin[run] + place], polygon[run]
    normal, offset = table.boundary.normal[edge].T, table.boundary.offset[edge] - table.tolerance
    height = normal[0][:, None] * hull[polygon, :, 0] + normal[1][:, None] * hull[polygon, :, 1]
    # The polygon may be visible if one of its corners lies in front of a wall in its direction.
    is_around[polygon[(edge >= 0) & (height.max(axis=1) >= offset)]] = True
    return is_around


def _splice(parts: Sequence[tuple[VisibilityTable, Indices, Indices]], change: Change) -> VisibilityTable:
    # Each part is a table, the viewpoints to take from it, and their indices in the result.
    num = sum(len(views) for _, views, _ in parts)
    points, cut, counts = np.empty((num, 2)), np.empty((num, 2)), np.empty(num, int)
    for table, views, place in parts:
        points[place], cut[place] = table.points[views], table.cut[views]
        counts[place] = np.diff(table.first)[views]
    first = np.append(0, np.cumsum(counts))
    key, edge, vertex = np.empty(first[-1]), *np.empty((2, first[-1]), parts[-1][0].edge.dtype)
    for table, views, place in parts:
        target, _ = take_ragged(first, place)
        row, run = take_ragged(table.first, views)
        key[target] = table.key[row] - _TURN * (views - place)[run]
        is_old = table.boundary is change.old
        edge[target] = np.append(change.edge, -1)[table.edge[row]] if is_old else table.edge[row]
        vertex[target] = np.append(change.vertex, -1)[table.vertex[row]] if is_old else table.vertex[row]
    return VisibilityTable(change.new, parts[0][0].tolerance, points, cut, first, key, edge, vertex)
