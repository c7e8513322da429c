"""Updates of a triangulation and of corner visibility after a local change of free space.

Triangles are kept unless a changed edge touches them; the gap between kept triangles is triangulated again. What a
corner sees is computed again only if it may see a changed edge. So the time is about proportional to the size of the
change, except for a few passes over all edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import ragged_indices, take_ragged
from plr_jax.geometry.boundary import Boundary, Indices, boxes_near, match_boundary
from plr_jax.geometry.corners import CornerVisibility, corner_of_vertex, find_corners, mutually_visible_pairs
from plr_jax.geometry.graph import connected_groups
from plr_jax.geometry.triangulation import Triangulation, next_half_edge, triangulation_of
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, visibility_of
from plr_jax.geometry.workspace import Workspace

_TURN = 4.0  # a full turn as a pseudo-angle
# Visibility polygon of a goal, and the corners that it sees; -1 for other vertices and for corners that are gone.
GoalView: TypeAlias = tuple[VisibilityTable, Indices]


@dataclass(frozen=True, eq=False)
class Change:
    """A change of the boundary of free space, and the new indices of the vertices and edges that stay."""

    old: Boundary
    new: Boundary
    vertex: Int[np.ndarray, " old_vertices"]  # new index of each old vertex; -1 if it is gone
    edge: Int[np.ndarray, " old_edges"]  # new index of each old edge; -1 if it is gone

    @staticmethod
    def between(old: Boundary, new: Boundary) -> "Change":
        return Change(old, new, *match_boundary(new.vertices, new.edges, old))

    @cached_property
    def is_new(self) -> Bool[np.ndarray, " new_edges"]:
        """For each edge of the boundary after the change, whether the boundary before the change lacks this edge."""
        return np.isin(np.arange(len(self.new.edges)), self.edge, invert=True)

    def boxes(self, margin: float) -> list[Float[np.ndarray, "corners 2"]]:
        """Return the bounding box of each connected group of changed edges, as four corners ``(4, 2)``.

        Changed edges are edges of ``old`` that are gone and new edges of ``new``. Boxes are grown by ``margin``.
        """
        # 1. Group the ends of edges that are gone or new.
        segments = np.concatenate([self.old.segments[self.edge < 0], self.new.segments[self.is_new]])
        points, index = np.unique(segments.reshape(-1, 2), axis=0, return_inverse=True)
        group = connected_groups(len(points), index.reshape(-1, 2).T)
        # 2. Find the bounding box of each group.
        order = np.argsort(group, kind="stable")
        boxes = shapely.bounds(shapely.multipoints(points[order], indices=group[order]))
        grown = boxes + margin * np.array([-1, -1, 1, 1])
        return [np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) for x0, y0, x1, y1 in grown]


def changed_triangulation(old: Triangulation, change: Change) -> Triangulation | None:
    """Return the triangulation of free space after a change of walls, from the ``old`` triangulation.

    The result is None if rounding errors prevent the update; the triangulation must then be computed from scratch.
    """
    # Dropped triangles leave a gap. It is bounded by walls without a triangle, and by *rims*: half-edges of dropped
    # triangles whose twins belong to kept ones.
    # 1. Keep triangles unless they have a wall or a vertex that is gone, or meet a new edge.
    is_gone = ((old.wall >= 0) & (change.edge[old.wall] < 0)) | (change.vertex[old.origin] < 0)
    is_kept = ~np.asarray(is_gone.reshape(-1, 3).any(axis=1))
    if len(segments := change.new.segments[change.is_new]):
        near = np.flatnonzero(boxes_near(old.triangles, segments, old.tolerance) & is_kept)
        polygons = shapely.polygons(old.triangles[near])
        tree = shapely.STRtree(np.asarray(shapely.linestrings(segments)))
        is_kept[near[tree.query(polygons, predicate="dwithin", distance=old.tolerance)[0]]] = False
    is_half_kept = np.repeat(is_kept, 3)
    # 2. Find the walls and rims around the gap, and triangulate it: walls are its first edges, then rims.
    vertex = change.vertex[old.origin]
    wall = np.where(old.wall >= 0, change.edge[old.wall], -1)
    walls = np.flatnonzero(np.isin(np.arange(len(change.new.edges)), wall[is_half_kept], invert=True))
    rims = np.flatnonzero(~is_half_kept & (old.twin >= 0) & is_half_kept[old.twin])
    edges = np.concatenate([change.new.edges[walls], np.stack([vertex[rims], vertex[next_half_edge(rims)]], axis=1)])
    if (edges < 0).any():
        return None
    vertex_of_gap, ends = np.unique(edges, return_inverse=True)
    # A triangulation does not use the sectors of its boundary, so zeros will do. The result has the boundary
    # `change.new`.
    gap = Boundary(change.new.vertices[vertex_of_gap], ends, np.zeros(len(ends), int))
    try:
        fill = triangulation_of(gap, old.tolerance)
    except ValueError:
        return None
    if len(np.unique(fill.wall[fill.wall >= 0])) < len(edges):  # an edge has no triangle
        return None
    # 3. Number the kept half-edges, then the half-edges of the gap.
    kept = np.flatnonzero(is_half_kept)
    new_index = np.where(is_half_kept, np.cumsum(is_half_kept) - 1, -1)
    origin = np.concatenate([vertex[kept], vertex_of_gap[fill.origin]])
    # Edges of the gap along rims are no walls, and neither is edge -1 of half-edges inside the gap.
    wall = np.concatenate([wall[kept], np.append(walls, np.full(len(rims) + 1, -1))[fill.wall]])
    fill_twin = np.where(fill.twin >= 0, fill.twin + len(kept), -1)
    twin = np.concatenate([np.append(new_index, -1)[old.twin[kept]], fill_twin])
    # 4. Link the half-edges of the gap along the rims with the kept ones beyond.
    along_rim = np.flatnonzero(fill.wall >= len(walls))
    beyond = new_index[old.twin[rims[fill.wall[along_rim] - len(walls)]]]
    twin[len(kept) + along_rim], twin[beyond] = beyond, len(kept) + along_rim
    return Triangulation(change.new, old.tolerance, *(column.astype(np.int32) for column in (origin, twin, wall)))


def changed_visibility(
    old: CornerVisibility, of_goal: GoalView, goal: Viewpoints, workspace: Workspace, change: Change
) -> tuple[CornerVisibility, GoalView]:
    """Return what all corners and the goal see after a change; recompute only what the change may affect.

    ``old`` is what the corners saw before the change. ``of_goal`` is what the goal saw: its visibility polygon, and
    the corners that it saw. ``goal`` is the goal as a viewpoint, and ``workspace`` the workspace after the change.
    """
    #    at_vertex[c]   old corner at the vertex of new corner c; -1 if there is none
    #    matched[c]     at_vertex[c] if both have equal sectors, else -1
    #    reused[c]      matched[c] if what the corner sees has not changed either, else -1
    # In these arrays, -1 means no corner; `np.append(values, default)[index]` reads `default` at index -1.
    #
    # 1. Match each new corner with the old one at its vertex, if all sectors of both open and close at equal edges.
    corners, views = find_corners(workspace)
    boundary = change.new
    is_kept = change.vertex >= 0
    old_of_vertex = np.full(len(boundary.vertices), -1)
    old_of_vertex[change.vertex[is_kept]] = old.of_vertex[is_kept]
    at_vertex = np.full(len(views.points), -1)
    at_vertex[views.owner] = old_of_vertex[boundary.edges[views.edge, 0]]
    old_edge = np.flatnonzero(change.edge >= 0)
    new_edge = change.edge[old_edge]
    is_same_sector = np.zeros(len(boundary.edges), bool)
    is_same_sector[new_edge] = boundary.sector_end[new_edge] == change.vertex[change.old.sector_end[old_edge]]
    num_old_sectors = np.bincount(old.views.owner, minlength=len(old.views.points))
    differs = np.bincount(views.owner, minlength=len(views.points)) != np.append(num_old_sectors, 0)[at_vertex]
    differs[views.owner[~is_same_sector[views.edge]]] = True
    matched = np.where(differs, -1, at_vertex)
    # 2. Compute visibility again for corners without a match, corners that may see a changed edge, and the goal, if
    #    it may see one. The goal is the last of the viewpoints, after the corners `changed`.
    reused = np.where(np.append(_may_see_change(old.table, change), True)[matched], -1, matched)
    is_goal_changed = bool(_may_see_change(of_goal[0], change)[0])
    unchanged, changed = np.flatnonzero(reused >= 0), np.flatnonzero(reused < 0)
    viewpoints = views[changed].append(goal) if is_goal_changed else views[changed]
    fresh, (view, vertex) = visibility_of(workspace.triangulation, viewpoints)
    seen = corner_of_vertex(workspace.boundary, views)[vertex]
    # 3. Join what stays and what is recomputed.
    table = _splice([(old.table, reused[unchanged], unchanged), (fresh, np.arange(len(changed)), changed)], change)
    goal_table, goal_row = (fresh, len(changed)) if is_goal_changed else (of_goal[0], 0)
    new_of_matched = np.full(len(old.corners.points), -1)
    new_of_matched[matched[matched >= 0]] = np.flatnonzero(matched >= 0)
    goal_corners = seen[view == len(changed)] if is_goal_changed else new_of_matched[of_goal[1]]
    new_view = _splice([(goal_table, np.array([goal_row]), np.zeros(1, int))], change), goal_corners
    # 4. Keep the edges between unchanged corners.
    edges = new_of_matched[old.edges]
    edges = edges[(np.append(reused, -1)[edges] >= 0).all(axis=1)]
    # 5. Add the edges of recomputed corners. An edge joins corners that see one another. A pair (view, seen) shows
    #    one direction. If `seen` was recomputed too, its own pairs show the other direction; if it is unchanged, look
    #    up in the table whether it sees `view`.
    is_pair = (view < len(changed)) & (seen >= 0)
    view, seen = changed[view[is_pair]], seen[is_pair]
    view, seen = view[view != seen], seen[view != seen]
    back = np.flatnonzero(reused[seen] >= 0)
    back = back[table.sees(seen[back], corners.points[view[back]])]
    view, seen = np.append(view, seen[back]), np.append(seen, view[back])
    edges = np.concatenate([edges, mutually_visible_pairs(corners, view, seen)])
    # 6. Sort the edges, as if all had been computed again.
    size = np.int64(max(1, len(corners.points)))
    keys = np.sort(edges.min(axis=1) * size + edges.max(axis=1))
    return CornerVisibility(corners, views, table, np.stack(np.divmod(keys, size), axis=1).astype(np.int32)), new_view


def _may_see_change(table: VisibilityTable, change: Change) -> Bool[np.ndarray, " views"]:
    """Return whether each viewpoint may see a change: it saw an edge that is gone, or may see where edges changed."""
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
    """Return whether viewpoint ``view[i]`` may see the convex polygon ``hull[i]``.

    The result is False only if walls closer to the viewpoint hide the polygon. A ``hull`` of shape ``(k, 2)`` is the
    polygon for all viewpoints.
    """
    # 1. Find the range of pseudo-angles of each polygon: all directions but the widest gap between its corners. The
    #    gap is at least half a turn, unless the viewpoint is inside. Pseudo-angles, from 0 to 4, begin at the cut of
    #    the viewpoint: the corners' offsets are rotated by minus the cut's angle.
    #      0 ----- first ===== last ----- 4      the cut is outside of the range
    #      0 ===== last ------ first ==== 4      `wraps`: the range from `first` through the cut to `last`
    hull = np.broadcast_to(hull, (len(view), *hull.shape[-2:]))
    dx, dy = np.moveaxis(hull - table.points[view, None], -1, 0)
    cx, cy = table.cut[view].T[:, :, None]
    angle = np.sort(pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx), axis=1)
    gap = np.diff(angle, axis=1, append=angle[:, :1] + _TURN)
    rows = np.arange(len(view))
    widest = gap.argmax(axis=1)
    first, last = angle[rows, (widest + 1) % angle.shape[1]], angle[rows, widest]
    may_see = gap[rows, widest] < _TURN / 2
    # 2. Look up the intervals that meet the range, in two parts if it wraps. In the table, the key of an interval is
    #    4 * viewpoint + pseudo-angle of its start.
    wraps = first > last
    polygon_of_range = np.append(rows, rows[wraps])
    low = np.append(np.where(wraps, 0.0, first), first[wraps])
    high = np.append(last, np.full(np.count_nonzero(wraps), _TURN))
    viewpoint = view[polygon_of_range]
    begin = np.searchsorted(table.key, _TURN * viewpoint + low - table.blur, side="right") - 1
    end = np.searchsorted(table.key, _TURN * viewpoint + high + table.blur, side="right")
    begin, end = np.maximum(begin, table.first[viewpoint]), np.minimum(end, table.first[viewpoint + 1])
    range_index, place = ragged_indices(np.maximum(end - begin, 0))
    # 3. The polygon may be visible if one of its corners lies in front of the nearest wall of such an interval.
    edge = table.edge[begin[range_index] + place]
    polygon = polygon_of_range[range_index]
    nx, ny = table.boundary.normal[edge].T[:, :, None]
    height = nx * hull[polygon, :, 0] + ny * hull[polygon, :, 1]
    may_see[polygon[(edge >= 0) & (height.max(axis=1) >= table.boundary.offset[edge] - table.tolerance)]] = True
    return may_see


def _splice(parts: Sequence[tuple[VisibilityTable, Indices, Indices]], change: Change) -> VisibilityTable:
    """Assemble, from viewpoints of several tables, the visibility table that holds after a change.

    Each entry of ``parts`` has three items: a table from before or after the change, the indices of the viewpoints to
    take from this table, and the indices that these viewpoints get in the result.
    """
    # 1. Copy the viewpoints, and find the rows of their intervals in the result.
    num_views = sum(len(views) for _, views, _ in parts)
    points, cut = np.empty((2, num_views, 2))
    counts = np.empty(num_views, int)
    for table, views, place in parts:
        points[place], cut[place] = table.points[views], table.cut[views]
        counts[place] = np.diff(table.first)[views]
    first = np.append(0, np.cumsum(counts))
    # 2. Copy the intervals. Keys begin with the index of the viewpoint; edges and vertices before the change (-1:
    #    none) are numbered as after it.
    key = np.empty(first[-1])
    edge, vertex = np.empty((2, first[-1]), np.min_scalar_type(-len(change.new.edges)))
    for table, views, place in parts:
        target, _ = take_ragged(first, place)
        row, run = take_ragged(table.first, views)
        key[target] = table.key[row] - _TURN * (views - place)[run]
        is_old = table.boundary is change.old
        edge[target] = np.append(change.edge, -1)[table.edge[row]] if is_old else table.edge[row]
        vertex[target] = np.append(change.vertex, -1)[table.vertex[row]] if is_old else table.vertex[row]
    return VisibilityTable(change.new, parts[0][0].tolerance, points, cut, first, key, edge, vertex)
