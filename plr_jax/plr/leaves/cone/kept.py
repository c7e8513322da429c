"""Which leaves of cones hold as they are after a map has changed: where distances have changed by one number.

What a leaf proves of the distance before tells which sources any shortest path from there can set out for: those
whose cones come as low as that somewhere in the leaf. If these are intact, and farther by one number, no distance has
grown by more. If besides no other source afterwards comes as low as that, none has grown by less.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.changed_distances import ChangedDistances, TriangleSources, are_met
from plr_jax.geometry.convex_pieces import boxes_as_pieces, difference_of_cones
from plr_jax.plr.certificate import LeafBounds
from plr_jax.plr.leaves.cone.codec import StoredCones
from plr_jax.plr.partition.cells import Tree

_FINE = 2.0**-24  # of the domain's width, by which stored sources may be off

Leaf = Int[np.ndarray, "pairs"]


@dataclass(frozen=True, eq=False)
class ConeLeaves:
    """Leaves of cones, and what is proven of them.

    Attributes:
        domain: What they fill.
        tree: Their tree, in the order of whose traversal they stand.
        stored: What is kept of them.
        bounds: Of the distance minus what each holds.
        slack: By how much any of that may be off.
    """

    domain: Box
    tree: Tree
    stored: StoredCones
    bounds: LeafBounds
    slack: float

    @cached_property
    def offset(self) -> Float[np.ndarray, "leaves"]:
        """What each adds to the distance to its source."""
        return self.stored.sources.offsets[self.stored.source]

    @cached_property
    def apex(self) -> Float[np.ndarray, "leaves 2"]:
        """The source of each."""
        return self.stored.sources.points[self.stored.source]

    @cached_property
    def _boxes(self) -> tuple[Float[np.ndarray, "leaves 2"], Float[np.ndarray, "leaves 2"]]:
        return self.tree.leaves.grown_boxes(self.domain)

    def kept(
        self, changed: ChangedDistances, before: Sources, after: Sources
    ) -> tuple[Float[np.ndarray, "leaves"], Int[np.ndarray, "leaves"]]:
        """By how much distances have changed everywhere in each leaf, and to its source.

        Args:
            changed: How distances have changed.
            before: All sources before.
            after: All sources afterwards.

        Returns:
            The changes, NaN for leaves that do not hold, and the source afterwards that each leaf's own is, -1 for
            none.
        """
        from scipy.spatial import KDTree  # which no query needs

        apart, nearest = KDTree(before.points).query(self.stored.sources.points)
        number = np.where(apart <= _FINE * self.domain.width.max(), nearest, len(changed.source))[self.stored.source]
        source, of_source = np.append(changed.source, -1)[number], np.append(changed.source_change, np.nan)[number]
        changes = _Changes.of(len(source))
        (lo, hi), is_uniform = self._boxes, ~np.isnan(changed.change)
        for box in changed.boxes:  # where points may be free that were not
            changes.differ[((lo <= box[2]) & (hi >= box[0])).all(axis=1)] = True
        leaf, triangle = self._meeting(changed.triangles, np.flatnonzero(is_uniform & (changed.change != 0)))
        changes.take(leaf, changed.change[triangle])
        leaf, triangle = self._meeting(changed.triangles, np.flatnonzero(~is_uniform))
        changes.differ[leaf[changed.was_cut_off[triangle]]] = True
        of, pairs = self._as_low(changes, leaf, triangle, changed.before, before, np.zeros(len(source)))
        changes.differ[of[self._are_cut(of, pairs, before, changed) | np.isnan(pairs.change)]] = True
        changes.take(of, np.where(np.isnan(pairs.change), 0.0, pairs.change))
        if (np.maximum(np.abs(changes.least), np.abs(changes.most))[changes.are_known] > changed.rounding).any():
            # Triangles in which distances have not changed tell as well.
            still, _ = self._meeting(changed.triangles, np.flatnonzero(changed.change == 0))
            changes.take(still, np.zeros(len(still)))
        changes.differ[changes.are_known & ~(changes.most - changes.least <= changed.rounding)] = True
        changes.differ[~(np.abs(of_source - changes.change) <= 2 * changed.rounding)] = True
        of, pairs = self._as_low(changes, leaf, triangle, changed.after, after, changes.change)
        grows_less = np.isnan(pairs.change) | (pairs.change < changes.change[of] - changed.rounding)
        changes.differ[of[grows_less | self._are_cut(of, pairs, after, changed)]] = True
        return np.where(changes.differ, np.nan, changes.change), source

    def _as_low(
        self,
        changes: "_Changes",
        leaf: Leaf,
        triangle: Leaf,
        pairs: TriangleSources,
        sources: Sources,
        grown: Float[np.ndarray, "leaves"],
    ) -> tuple[Int[np.ndarray, "low"], TriangleSources]:
        """Leaves, and pairs of triangles that they meet of which cones come as low as distances there may be.

        At most these are what was proven of the leaf, and by how much they have grown.
        """
        rows, met = run_members(pairs.first(int(triangle.max(initial=-1)) + 1), triangle)
        of, is_open = leaf[met], ~changes.differ[leaf[met]]
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

    def _are_cut(
        self, leaf: Leaf, pairs: TriangleSources, sources: Sources, changed: ChangedDistances
    ) -> Bool[np.ndarray, "n"]:
        """Whether ways from leaves to sources may meet what changed."""
        (lo, hi), rows = self._boxes, np.flatnonzero(pairs.is_doubted)
        corners = [np.stack([x[leaf[rows], 0], y[leaf[rows], 1]], axis=1) for x in (lo, hi) for y in (lo, hi)]
        cut = np.zeros(len(leaf), bool)
        cut[rows] = are_met(np.stack([sources.points[pairs.source[rows]], *corners], axis=1), changed.boxes)
        return cut

    def _meeting(self, triangles: Float[np.ndarray, "n 3 2"], which: Int[np.ndarray, "some"]) -> tuple[Leaf, Leaf]:
        """Leaves, and those of some triangles that they meet, down the tree."""
        tree, (lo, hi) = self.tree, self.tree.cells.grown_boxes(self.domain)
        sides = np.roll(triangles, -1, axis=1) - triangles
        normal = np.stack([-sides[..., 1], sides[..., 0]], axis=-1)
        offset, least, most = (normal * triangles).sum(axis=2), triangles.min(axis=1), triangles.max(axis=1)
        node, triangle, found = np.zeros(len(which), int), which, [np.empty((2, 0), int)]
        while len(node):
            meets = ((lo[node] <= most[triangle]) & (hi[node] >= least[triangle])).all(axis=1)
            node, triangle = node[meets], triangle[meets]
            # A box is outside of a side if its corner farthest inward is.
            inward = np.where(normal[triangle] >= 0, hi[node, None], lo[node, None])
            meets = ((inward * normal[triangle]).sum(axis=2) >= offset[triangle]).all(axis=1)
            node, triangle = node[meets], triangle[meets]
            is_leaf = tree.child[node] < 0
            found.append(np.stack([tree.leaf_of_node[node[is_leaf]], triangle[is_leaf]]))
            node = tree.halves(node[~is_leaf])
            triangle = np.repeat(triangle[~is_leaf], 2)
        leaf, triangle = np.concatenate(found, axis=1)
        return leaf, triangle


@dataclass(frozen=True, eq=False)
class _Changes:
    """By how much distances in leaves have changed, at least and at most, and where that is not one number."""

    least: Float[np.ndarray, "leaves"]
    most: Float[np.ndarray, "leaves"]
    differ: Bool[np.ndarray, "leaves"]

    @staticmethod
    def of(num: int) -> "_Changes":
        return _Changes(np.full(num, np.inf), np.full(num, -np.inf), np.zeros(num, bool))

    def take(self, leaf: Leaf, change: Float[np.ndarray, "pairs"]) -> None:
        np.minimum.at(self.least, leaf, change)
        np.maximum.at(self.most, leaf, change)

    @property
    def are_known(self) -> Bool[np.ndarray, "leaves"]:
        return self.least <= self.most

    @property
    def change(self) -> Float[np.ndarray, "leaves"]:
        """One number for each; 0 where nothing is known."""
        return np.where(self.are_known, self.most, 0.0)
