"""PLRs of many goals of one workspace at once: a cell that is alike for several goals is looked at once for all.

Above some number of splits every box has sources of its own for every goal, and hardly one is a leaf of a good tree
but where one source serves all of it. So goals *start* at boxes of so many splits, and those above are leaves only
where all of the boxes that they hold have no error and one source. Where sources take most of the bytes, as of a
hundred corners in 1 KB, leaves are fewer than the start expects, and a good tree has larger ones: a single goal
starts at the whole domain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Int

from plr_jax._types import FamilyFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.levels import POOR, BoxLevel, may_halve
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.optimal import Thrift
from plr_jax.plr.leaves.base import MemberLeaves
from plr_jax.plr.leaves.cone.best import best_cones, run_through
from plr_jax.plr.leaves.cone.boxes import ConeBoxes, fitted_boxes, only_sources
from plr_jax.plr.partition.cells import Cells, grown_domain
from plr_jax.plr.sampling.cell_fit import Pattern

_MOST_SPLITS, _LEAVES_A_START = 9, 8.0
_BITS_A_LEAF, _BITS_OF_SOURCES = 4.4, 400  # about, before the first tree tells
_RESOLVED = float(np.finfo(np.float32).eps / 4)  # of a distance: what no query resolves
# Boxes are left out that seldom are leaves, for which the search is twice as quick.
_THRIFT = Thrift(1.0, 5, 0.99, is_walked=True)
_ANY, _NONE = -1, -2  # source of what does not reach the goal, and of what has several or an error


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """What all members of a family share; called with oracles of some of them, it finds their leaves.

    Attributes:
        shared: What the oracles share of the boxes that all start at.
        tops: The cells of each number of splits, those that all start at last.
        halves: Where the halves of each stand among those of one more split.
        domain: What the PLRs cover.
        limits: What the file of each is to keep within.
        pattern: Samples of a cell, by which sources in sight are chosen.
    """

    shared: Any
    tops: list[Cells]
    halves: list[Int[np.ndarray, "2 2 _"]]
    domain: Box
    limits: Limits
    pattern: Pattern

    def __call__(self, oracles: Sequence[FamilyFn]) -> list[MemberLeaves]:
        """The leaves of some members."""
        found, key, node_of = oracles[0].family_sources(self.shared, oracles)
        if (lost := np.flatnonzero((node_of < 0).all(axis=1))).size:
            raise ValueError(f"Nothing was found from where the goal of oracle {lost[0]} can be reached.")
        # Boxes of which nothing reaches a goal have no pieces; they stand behind the others.
        cells, limits = self.tops[-1], self.limits
        place, empty = np.zeros(found.num_cells, np.int64), np.unique(np.nonzero(node_of < 0)[1])
        place[node_of[node_of >= 0]] = np.nonzero(node_of >= 0)[1]
        node_of = np.where(node_of < 0, found.num_cells + np.searchsorted(empty, np.arange(len(cells))), node_of)
        lowest, found = cells[np.append(place, empty)], replace(found, num_cells=found.num_cells + len(empty))
        negligible = max(limits.tolerance, _RESOLVED * float(self.domain.width.max()))
        boxes = fitted_boxes(self.domain, negligible, lowest, found)
        key = np.append(key, cells[empty].hashes())
        levels = [*self._above(boxes, node_of), BoxLevel.of(boxes, key)]
        roots = np.arange(len(oracles)) if self.halves else node_of[:, 0]
        sources = [_corners_first(oracle.sources) for oracle in oracles]
        return best_cones(levels, roots, sources, self.domain, limits, self.pattern, run_through, _THRIFT)

    def _above(self, boxes: ConeBoxes, node_of: Int[np.ndarray, "goals lowest"]) -> list[BoxLevel]:
        """The boxes above the start, goal by goal: where one source serves all of it, each has no error."""
        levels, node = [], node_of
        nothing: Any = boxes.visible.of_cells(np.zeros(0, np.int64))
        is_alone = (boxes.source < 0) | (only_sources(boxes.visible) >= 0)
        source = np.where(is_alone, boxes.source, _NONE)[node_of]
        for cells, child in zip(reversed(self.tops[:-1]), reversed(self.halves), strict=True):
            common = np.full((len(source), len(cells)), _NONE)
            for lower, upper in child:
                some = np.flatnonzero(lower >= 0)
                both = np.stack([source[:, lower[some]], source[:, upper[some]]])
                least, most = both.min(axis=0), both.max(axis=0)
                alike = (least == most) | (least == _ANY)
                common[:, some] = np.maximum(common[:, some], np.where(alike, most, _NONE))
            source, count = common, common.size
            below = np.where(child >= 0, node[:, child], POOR).transpose(1, 2, 0, 3).reshape(2, 2, count)
            node = np.arange(count).reshape(common.shape)
            error = np.where(common == _NONE, np.inf, 0.0).ravel()
            cells, visible = cells[np.tile(np.arange(len(cells)), len(common))], replace(nothing, num_cells=count)
            above = ConeBoxes(
                boxes.domain, boxes.negligible, cells, visible, np.maximum(common.ravel(), -1), error, error
            )
            levels.insert(0, BoxLevel(above, np.arange(count, dtype=np.uint64), below))
        return levels


def family_task(first: FamilyFn, domain: Box, limits: Limits, pattern: Pattern) -> FamilyTask:
    """What all of the family of a distance function share."""
    # About as many leaves as the limits allow.
    room = limits.max_bytes - limits.file_size(2, 1, _BITS_OF_SOURCES)
    of_proof = limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
    num_leaves = max(1.0, min(limits.max_leaves, room * 8 / (_BITS_A_LEAF + of_proof)))
    splits = int(np.clip(np.log2(num_leaves / _LEAVES_A_START), 0, min(_MOST_SPLITS, limits.max_depth)))
    tops, halves = [Cells.root(2)], []
    for _ in range(splits):
        axis, parent = (np.repeat(each, 2) for each in np.nonzero(may_halve(tops[-1], limits)))
        is_upper = np.arange(len(parent)) % 2 == 1
        cells = tops[-1][parent].halves(axis, is_upper)
        _, first_half, index = np.unique(cells.hashes(), return_index=True, return_inverse=True)
        halves.append(np.full((2, 2, len(tops[-1])), POOR))
        halves[-1][axis, is_upper.astype(int), parent] = index
        tops.append(cells[first_half])
    shared = first.shared_cells(grown_domain(domain), *tops[-1].grown_boxes(domain))
    return FamilyTask(shared, tops, halves, domain, limits, pattern)


def _corners_first(sources: Sources) -> Sources:
    """Sources in the order of viewpoints, the goal last."""
    parents = np.roll(sources.parents - 1, -1) % len(sources.parents)
    return Sources(np.roll(sources.points, -1, axis=0), np.roll(sources.distances, -1), parents)
