"""What of the distances to a goal has changed from one visibility graph of it to another."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import found
from plr_jax.geometry.changed_distances import ChangedDistances, Corners, TriangleSources, are_met
from plr_jax.geometry.changes import Change, may_see
from plr_jax.geometry.triangulation import Triangulation

if TYPE_CHECKING:
    from plr_jax.oracles import VisibilityGraph

_ROUNDING = 1e-12  # of the largest distance, by which changes may differ and are one


def changed_distances(before: "VisibilityGraph", after: "VisibilityGraph") -> ChangedDistances:
    """Those of two oracles of one goal."""
    change = Change.between(before.workspace.boundary, after.workspace.boundary)
    old, new = before.workspace.triangulation, after.workspace.triangulation
    boxes = change.boxes(4 * old.tolerance)
    rounding = _ROUNDING * float(before.distances[np.isfinite(before.distances)].max(initial=0.0))
    source, source_change = _sources(before, after, change)
    source_change[np.abs(source_change) <= rounding] = 0.0
    of_turns, is_known = _alike_turns(before, after, source)
    pairs_before = _pairs(before, np.where(of_turns, source_change[before._turns.vertex], np.nan), boxes)
    change_after = np.full(len(after.distances), np.nan)
    change_after[source[source >= 0]] = source_change[source >= 0]
    pairs_after = _pairs(after, np.where(is_known, change_after[after._turns.vertex], np.nan), boxes)
    same = _same_triangles(old, new, change)
    kept, num_old, num_new = np.flatnonzero(same >= 0), len(same), len(new.origin) // 3
    number = np.full(num_new, -1)  # of new triangles: old ones first
    number[same[kept]] = kept
    number[number < 0] = num_old + np.arange(np.count_nonzero(number < 0))
    triangles = np.concatenate([old.triangles, new.triangles[number >= num_old]])
    pairs_after = replace(pairs_after, triangle=number[pairs_after.triangle])
    # In doubt only where the way from the source to the triangle may meet what changed.
    shift = np.zeros(len(triangles))
    least, most = np.full(len(triangles), np.inf), np.full(len(triangles), -np.inf)
    for oracle, pairs in ((before, pairs_before), (after, pairs_after)):
        rows = np.flatnonzero(pairs.is_doubted)
        points = oracle.sources.points[pairs.source[rows], None]
        pairs.is_doubted[rows] = are_met(np.concatenate([points, triangles[pairs.triangle[rows]]], axis=1), boxes)
        shift[pairs.triangle[pairs.is_doubted | np.isnan(pairs.change)]] = np.nan
        known = ~np.isnan(pairs.change)
        np.minimum.at(least, pairs.triangle[known], pairs.change[known])
        np.maximum.at(most, pairs.triangle[known], pairs.change[known])
    has_pairs = least <= most
    shift[has_pairs & ~(most - least <= rounding)] = np.nan
    shift[has_pairs & ~np.isnan(shift)] = least[has_pairs & ~np.isnan(shift)]
    shift[:num_old][same < 0] = shift[num_old:] = np.nan
    shift[np.abs(shift) <= rounding] = 0.0
    open_ = np.isnan(shift)
    was_cut_off = np.arange(len(triangles)) < num_old
    was_cut_off[pairs_before.triangle] = False
    pairs = pairs_before.of(open_), pairs_after.of(open_)
    slack = 4 * before.workspace.tolerance
    return ChangedDistances(boxes, source, source_change, triangles, shift, was_cut_off, *pairs, rounding, slack)


def _sources(
    before: "VisibilityGraph", after: "VisibilityGraph", change: Change
) -> tuple[Int[np.ndarray, "sources"], Float[np.ndarray, "sources"]]:
    """Of the goal and the corners before, which they are after, and by how much their distances changed."""
    vertex = np.empty(len(before.family.corners.points), int)
    vertex[before.family.views.owner] = change.old.edges[before.family.views.edge, 0]
    corner = np.append(after.family.of_vertex, -1)[change.vertex[vertex]]
    source = np.append(0, np.where(corner >= 0, 1 + corner, -1))
    with np.errstate(invalid="ignore"):
        return source, np.where(source >= 0, after.distances[source] - before.distances, np.nan)


def _alike_turns(
    before: "VisibilityGraph", after: "VisibilityGraph", source: Int[np.ndarray, "sources"]
) -> tuple[Bool[np.ndarray, "turns"], Bool[np.ndarray, "turns_after"]]:
    """Which turn points before are some after around which paths come alike, and which after are such ones."""
    turn_of = np.full(len(after.distances) + 1, -1)
    turn_of[after._turns.vertex] = np.arange(len(after._turns.vertex))
    now = turn_of[source[before._turns.vertex]]
    alike, is_known = now >= 0, np.zeros(len(after._turns.vertex), bool)
    alike[alike] = (after._turns.normal[:, now[alike]] == before._turns.normal[:, alike]).all(axis=(0, 2))
    is_known[now[alike]] = True
    return alike, is_known


def _pairs(oracle: "VisibilityGraph", change: Float[np.ndarray, "turns"], boxes: list[Corners]) -> TriangleSources:
    """The pairs of an oracle; the goal is one wherever it may see some of a triangle, which has not changed."""
    regions, triangles = oracle.regions, oracle.workspace.triangulation.triangles
    seen = np.flatnonzero(may_see(oracle._goal_table, np.zeros(len(triangles), int), triangles))
    triangle = np.append(np.repeat(np.arange(len(triangles)), np.diff(regions.first)), seen)
    source = np.append(oracle._turns.vertex[regions.turn], 0 * seen)
    is_doubted = np.zeros(len(oracle.distances), bool)
    for first, table in ((0, oracle._goal_table), (1, oracle.family.table)):
        view = np.arange(len(table.points))
        for box in boxes:
            is_doubted[first + view] |= may_see(table, view, box)
    return TriangleSources(triangle, source, np.append(change[regions.turn], 0.0 * seen), is_doubted[source])


def _same_triangles(old: Triangulation, new: Triangulation, change: Change) -> Int[np.ndarray, "old_triangles"]:
    """The new triangle that each old one is; -1 for none."""
    size = np.int64(len(change.new.vertices))

    def keys(corners: Int[np.ndarray, "triangles 3"]) -> Int[np.ndarray, "triangles"]:
        a, b, c = np.sort(corners, axis=1).astype(np.int64).T
        return np.where(a < 0, -1, (a * size + b) * size + c)

    return found(keys(new.origin.reshape(-1, 3)), keys(change.vertex[old.origin].reshape(-1, 3)))
