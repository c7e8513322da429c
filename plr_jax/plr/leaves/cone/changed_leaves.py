"""Find the cone leaves to keep after a change of the map: leaves in which all distances changed by the same number.

The cone of a source (a corner, or the goal) is the straight distance to the source plus the source's distance to the
goal. A shortest path from a leaf can go to a source first only if, at some point of the leaf, the source's cone does
not exceed the proven upper bound of the distance. If the distances of all such sources rose by one number, and no
change blocks the way to them, no distance in the leaf rose more. If no source of the new map gives shorter paths, no
distance rose less.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.changed_distances import ChangedDistances, TriangleSources, hulls_meet_boxes
from plr_jax.geometry.convex_pieces import boxes_as_pieces, difference_of_cones
from plr_jax.plr.certificate import LeafBounds
from plr_jax.plr.leaves.cone.codec import StoredCones
from plr_jax.plr.tree import Tree

_FINE = 2.0**-24  # rounding of stored sources, in units of the domain's width
Indices = Int[np.ndarray, "pairs"]


@dataclass(frozen=True, eq=False)
class ConeLeaves:
    """A tree whose leaves hold the functions ``offset + |x - apex|``, with proven bounds of their errors."""

    domain: Box
    tree: Tree
    stored: StoredCones
    bounds: LeafBounds  # proven bounds of the distance to the goal minus the leaf's function
    slack: float  # uncertainty of distances

    @cached_property
    def offset(self) -> Float[np.ndarray, "leaves"]:
        return self.stored.sources.offsets[self.stored.source]

    @cached_property
    def apex(self) -> Float[np.ndarray, "leaves 2"]:
        return self.stored.sources.points[self.stored.source]

    @cached_property
    def _boxes(self) -> tuple[Float[np.ndarray, "leaves 2"], Float[np.ndarray, "leaves 2"]]:
        return self.tree.leaves.grown_boxes(self.domain)

    def distance_changes(
        self, changed: ChangedDistances, before: Sources, after: Sources
    ) -> tuple[Float[np.ndarray, "leaves"], Int[np.ndarray, "leaves"]]:
        # The change of all distances in each leaf (NaN if they differ), and its apex in ``after`` or -1.
        from scipy.spatial import KDTree  # which no query needs

        apart, nearest = KDTree(before.points).query(self.stored.sources.points)
        number = np.where(apart <= _FINE * self.domain.width.max(), nearest, len(changed.source))[self.stored.source]
        source, of_source = np.append(changed.source, -1)[number], np.append(changed.source_change, np.nan)[number]
        least, most = np.full(len(source), np.inf), np.full(len(source), -np.inf)
        (lo, hi), differ, is_uniform = self._boxes, np.zeros(len(source), bool), ~np.isnan(changed.change)

        def take(leaf: Indices, change: Float[np.ndarray, "pairs"]) -> None:
            np.minimum.at(least, leaf, change)
            np.maximum.at(most, leaf, change)

        # 1. Leaves where points may be newly free, or may newly reach the goal, do not hold.
        for box in changed.boxes:
            differ[((lo <= box[2]) & (hi >= box[0])).all(axis=1)] = True
        leaf, triangle = self._leaves_meeting(changed.triangles, np.flatnonzero(~is_uniform))
        differ[leaf[changed.was_cut_off[triangle]]] = True
        # 2. Collect changes: of triangles that changed by one number; elsewhere, of the old sources that paths may go
        # to first.
        of_uniform = self._leaves_meeting(changed.triangles, np.flatnonzero(is_uniform & (changed.change != 0)))
        take(of_uniform[0], changed.change[of_uniform[1]])
        of, pairs = self._competing_sources(differ, leaf, triangle, changed.before, before, np.zeros(len(source)))
        differ[of[self._may_cross_changes(of, pairs, before, changed) | np.isnan(pairs.change)]] = True
        take(of, np.where(np.isnan(pairs.change), 0.0, pairs.change))
        if (np.maximum(np.abs(least), np.abs(most))[least <= most] > changed.rounding).any():
            # If other triangles changed, triangles without a change (0) matter as well.
            still, _ = self._leaves_meeting(changed.triangles, np.flatnonzero(changed.change == 0))
            take(still, np.zeros(len(still)))
        # 3. All changes must be one number (0 if there are none), and equal the change of the leaf's own source.
        change = np.where(least <= most, most, 0.0)
        differ[(least <= most) & ~(most - least <= changed.rounding)] = True
        differ[~(np.abs(of_source - change) <= 2 * changed.rounding)] = True
        # 4. No source after the change may give a shorter path.
        of, pairs = self._competing_sources(differ, leaf, triangle, changed.after, after, change)
        grows_less = np.isnan(pairs.change) | (pairs.change < change[of] - changed.rounding)
        differ[of[grows_less | self._may_cross_changes(of, pairs, after, changed)]] = True
        return np.where(differ, np.nan, change), source

    def _competing_sources(
        self,
        differ: Bool[np.ndarray, "leaves"],
        leaf: Indices,
        triangle: Indices,
        pairs: TriangleSources,
        sources: Sources,
        grown: Float[np.ndarray, "leaves"],
    ) -> tuple[Int[np.ndarray, "low"], TriangleSources]:
        # Pairs of a leaf and a corner (or the goal) to which a shortest path from the leaf may go first.
        first = np.searchsorted(pairs.triangle, np.arange(triangle.max(initial=-1) + 2))  # of each triangle
        rows, met = take_ragged(first, triangle)
        of, is_open = leaf[met], ~differ[leaf[met]]
        of, rows = of[is_open], rows[is_open]
        (lo, hi), source = self._boxes, pairs.source[rows]
        apex, offset = sources.points[source], sources.distances[source]
        center, half = (lo + hi) / 2, np.linalg.norm(hi - lo, axis=1) / 2
        own = self.offset + np.linalg.norm(center - self.apex, axis=1) + 2 * half
        limit = self.bounds.upper[of] + grown[of] + self.slack
        near = np.flatnonzero(offset + np.linalg.norm(center[of] - apex, axis=1) - own[of] <= limit)
        of, rows = of[near], rows[near]
        pieces = boxes_as_pieces(lo[of], hi[of])
        lowest, _ = difference_of_cones(pieces, apex[near], offset[near], self.apex[of], self.offset[of])
        low = lowest <= limit[near]
        return of[low], pairs[rows[low]]

    def _may_cross_changes(
        self, leaf: Indices, pairs: TriangleSources, sources: Sources, changed: ChangedDistances
    ) -> Bool[np.ndarray, "n"]:
        (lo, hi), rows = self._boxes, np.flatnonzero(pairs.is_doubted)
        corners = [np.stack([x[leaf[rows], 0], y[leaf[rows], 1]], axis=1) for x in (lo, hi) for y in (lo, hi)]
        cut = np.zeros(len(leaf), bool)
        cut[rows] = hulls_meet_boxes(np.stack([sources.points[pairs.source[rows]], *corners], axis=1), changed.boxes)
        return cut

    def _leaves_meeting(
        self, triangles: Float[np.ndarray, "n 3 2"], which: Int[np.ndarray, "some"]
    ) -> tuple[Indices, Indices]:
        """Return all pairs of indices of a leaf and a triangle that intersect; ``which`` selects the triangles."""
        tree, (lo, hi) = self.tree, self.tree.cells.grown_boxes(self.domain)
        sides = np.roll(triangles, -1, axis=1) - triangles
        normal = np.stack([-sides[..., 1], sides[..., 0]], axis=-1)
        offset, least, most = (normal * triangles).sum(axis=2), triangles.min(axis=1), triangles.max(axis=1)
        node, triangle, found = np.zeros(len(which), int), which, [np.empty((2, 0), int)]
        while len(node):
            meets = ((lo[node] <= most[triangle]) & (hi[node] >= least[triangle])).all(axis=1)
            node, triangle = node[meets], triangle[meets]
            # A box is outside of a side of a triangle if its innermost corner is.
            inward = np.where(normal[triangle] >= 0, hi[node, None], lo[node, None])
            meets = ((inward * normal[triangle]).sum(axis=2) >= offset[triangle]).all(axis=1)
            node, triangle = node[meets], triangle[meets]
            is_leaf = tree.child[node] < 0
            found.append(np.stack([tree.leaf_of_node[node[is_leaf]], triangle[is_leaf]]))
            node = tree.halves(node[~is_leaf])
            triangle = np.repeat(triangle[~is_leaf], 2)
        leaf, triangle = np.concatenate(found, axis=1)
        return leaf, triangle
