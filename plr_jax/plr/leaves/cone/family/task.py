"""The leaves of all members of a family, from their distance functions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plr_jax._types import FamilyFn
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.leaves.base import MemberLeaves
from plr_jax.plr.leaves.cone.codec import StoredCones
from plr_jax.plr.leaves.cone.family.in_sight import Options, changes_of_tree, options_of_levels
from plr_jax.plr.leaves.cone.family.levels import BoxLevel
from plr_jax.plr.leaves.cone.family.members import Member, expected_leaves, grow_family, stored_cones_of
from plr_jax.plr.leaves.cone.family.start import Start
from plr_jax.plr.leaves.cone.stored import num_bytes_of
from plr_jax.plr.partition.cells import grown_domain
from plr_jax.plr.sampling.pattern import Pattern

_RESOLVED = float(np.finfo(np.float32).eps / 4)  # of a distance: what no query resolves


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """What all members of a family share; called with oracles of some of them, it finds their leaves.

    Attributes:
        shared: What the oracles share of the boxes of the start.
        start: The boxes at which all members start.
        domain: What the PLRs cover.
        limits: What the file of each is to keep within.
        pattern: Samples of a cell, by which sources in sight are chosen.
    """

    shared: Any
    start: Start
    domain: Box
    limits: Limits
    pattern: Pattern

    def __call__(self, oracles: Sequence[FamilyFn]) -> list[MemberLeaves]:
        """The leaves of some members."""
        found, key, node_of = oracles[0].family_sources(self.shared, oracles)
        if (lost := np.flatnonzero((node_of < 0).all(axis=1))).size:
            raise ValueError(f"Nothing was found from where the goal of oracle {lost[0]} can be reached.")
        negligible = max(self.limits.tolerance, _RESOLVED * float(self.domain.width.max()))
        sources = [oracle.sources for oracle in oracles]
        family = grow_family(found, key, node_of, sources, self.start, self.domain, self.limits, negligible)
        trees = [member.tree for member in family.members if member.tree is not None]
        options = options_of_levels(family.levels, trees, self.pattern)
        return [self._leaves(member, family.levels, options) for member in family.members]

    def _leaves(self, member: Member, levels: list[BoxLevel], options: list[Options]) -> MemberLeaves:
        """Those of one member, some of which have sources that are in sight instead of the best ones."""
        tree = member.tree
        assert tree is not None
        leaf, view = changes_of_tree(tree, levels, options)

        def changed(count: int) -> StoredCones:
            views = tree.source.copy()
            views[leaf[:count]] = view[:count]
            return stored_cones_of(tree, views, member.sources, self.domain)

        count = len(leaf)
        stored = changed(count)
        while count and num_bytes_of(tree.cells, stored, self.domain, self.limits) > self.limits.max_bytes:
            count = count * 3 // 4
            stored = changed(count)
        return tree.levels, tree.cells, stored


def family_task(first: FamilyFn, domain: Box, limits: Limits, pattern: Pattern) -> FamilyTask:
    """What all of the family of a distance function share."""
    start = Start.of(expected_leaves(limits), limits.max_axis_depth, limits.max_depth)
    shared = first.shared_cells(grown_domain(domain), *start.lowest.grown_boxes(domain))
    return FamilyTask(shared, start, domain, limits, pattern)
