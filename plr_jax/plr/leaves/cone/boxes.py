"""Boxes and the cones that fit them best, from what an oracle proves of the sources that their points use."""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import run_members
from plr_jax._types import CellSources, FamilyCellSources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas, difference_of_cones
from plr_jax.plr.certificate.bounds import bounds_of_pieces
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Pattern, Sampler, call_oracle

_MOST_OPTIONS = 4
"""Sources tried for a leaf: those to which most of it goes, judged by the centers of its pieces."""


@dataclass(frozen=True, eq=False)
class ConeLeaves:
    """Leaves and the indices of their sources, -1 where nothing reaches the goal; and the boxes that they are."""

    cells: Cells
    source: Int[np.ndarray, "leaves"]
    parts: list[tuple["ConeBoxes", Int[np.ndarray, "_"]]]

    def append(self, *others: "ConeLeaves") -> "ConeLeaves":
        """These leaves followed by others."""
        source = np.concatenate([self.source, *(other.source for other in others)])
        parts = [part for leaves in (self, *others) for part in leaves.parts]
        return ConeLeaves(self.cells.append(*(other.cells for other in others)), source, parts)

    def boxes(self) -> "ConeBoxes":
        """The leaves as boxes, with all that is known of them."""
        first, *others = (boxes[index] for boxes, index in self.parts)
        return first.append(*others)


@dataclass(frozen=True, eq=False)
class ConeBoxes:
    """Boxes and the source of the best cone for each.

    Attributes:
        cells: The boxes.
        source: Index of the best source, -1 where nothing of the box reaches the goal.
        error: Proven bound of the cone's largest error in the box, 0 if it is negligible.
        integral: Proven bound of the integral of its error over the box, as a share of the domain's area.
    """

    domain: Box
    negligible: float
    cells: Cells
    visible: CellSources
    source: Int[np.ndarray, "boxes"]
    error: Float[np.ndarray, "boxes"]
    integral: Float[np.ndarray, "boxes"]

    def leaves(self, index: Int[np.ndarray, "some"]) -> "ConeLeaves":
        """Some of the boxes as leaves."""
        return ConeLeaves(self.cells[index], self.source[index], [(self, index)])

    def __getitem__(self, index: Int[np.ndarray, "some"]) -> "ConeBoxes":
        columns = (getattr(self, name)[index] for name in ("source", "error", "integral"))
        return ConeBoxes(self.domain, self.negligible, self.cells[index], self.visible.of_cells(index), *columns)

    def append(self, *others: "ConeBoxes") -> "ConeBoxes":
        """These boxes followed by others."""
        parts = (self, *others)
        columns = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("source", "error", "integral")
        )
        return ConeBoxes(
            self.domain,
            self.negligible,
            self.cells.append(*(other.cells for other in others)),
            self.visible.append(*(other.visible for other in others)),
            *columns,
        )

    def halves(
        self, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"], is_upper: Bool[np.ndarray, "new"]
    ) -> "ConeBoxes":
        """A half of each of some of the boxes."""
        cells = self.cells[parent].halves(axis, is_upper)
        visible = self.visible.parts(parent, axis, is_upper, *cells.grown_boxes(self.domain))
        return fitted_boxes(self.domain, self.negligible, cells, visible)

    def distinct_halves(
        self, parent: Int[np.ndarray, "new"], axis: Int[np.ndarray, "new"], is_upper: Bool[np.ndarray, "new"]
    ) -> tuple["ConeBoxes", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "new"]]:
        """The distinct ones of such halves, their keys, and which of them each half is; of cells of a family."""
        assert isinstance(self.visible, FamilyCellSources)
        cells = self.cells[parent].halves(axis, is_upper)
        visible, key, first, index = self.visible.distinct_parts(
            parent, axis, is_upper, *cells.grown_boxes(self.domain), cells.hashes()
        )
        return fitted_boxes(self.domain, self.negligible, cells[first], visible), key, index


def root_box(visible: CellSources, domain: Box, tolerance: float) -> ConeBoxes:
    """The domain as one box; errors up to the tolerance do not count, nor do those that no query resolves."""
    resolved = float(np.finfo(np.float32).eps / 4 * visible.distance.max(initial=0.0))
    return fitted_boxes(domain, max(tolerance, resolved), Cells.root(domain.dim), visible)


def fitted_boxes(domain: Box, negligible: float, cells: Cells, visible: CellSources) -> ConeBoxes:
    """Boxes with the cone for each whose proven error has the least integral over its free part.

    Errors up to what is negligible do not count.
    """
    best, error, integral = only_sources(visible), np.zeros(len(cells)), np.zeros(len(cells))
    several = np.flatnonzero((best < 0) & (np.diff(visible.first_piece) > 0))
    best[several], error[several], integral[several] = _best_cones(visible.of_cells(several))
    counts = error > negligible
    integral = np.where(counts, integral, 0.0) / np.prod(domain.width)
    return ConeBoxes(domain, negligible, cells, visible, best, np.where(counts, error, 0.0), integral)


def only_sources(visible: CellSources) -> Int[np.ndarray, "boxes"]:
    """The source of boxes that all of each sees and no other is better for anywhere; -1 for other boxes."""
    only, first = np.full(visible.num_cells, -1), visible.first_pair[visible.first_piece]
    is_box = np.flatnonzero(np.diff(first) == np.diff(visible.first_piece))  # a pair a piece, or none at all
    is_box = is_box[np.diff(first)[is_box] > 0]
    if not len(is_box):
        return only
    of_pairs = np.stack([visible.source, -visible.source, visible.by_all])
    smallest, largest, by_all = np.minimum.reduceat(of_pairs, first[:-1][np.diff(first) > 0], axis=1)
    row = (np.cumsum(np.diff(first) > 0) - 1)[is_box]
    alone = (smallest == -largest)[row] & (by_all[row] > 0)
    only[is_box[alone]] = smallest[row[alone]]
    return only


def _best_cones(
    visible: CellSources,
) -> tuple[Int[np.ndarray, "boxes"], Float[np.ndarray, "boxes"], Float[np.ndarray, "boxes"]]:
    """Of boxes that have pieces: the best source, its largest error, and the integral of its error."""
    if not visible.num_cells:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    box, source = _options(visible, areas(visible.pieces))
    largest, integral = errors_of_options(visible, box, source)
    order = np.lexsort((visible.rank(source), largest, integral, box))
    order = order[np.append(True, box[order[1:]] != box[order[:-1]])]
    return source[order], largest[order], integral[order]


def errors_of_options(
    visible: CellSources, box: Int[np.ndarray, "options"], source: Int[np.ndarray, "options"]
) -> tuple[Float[np.ndarray, "options"], Float[np.ndarray, "options"]]:
    """Proven bounds of the largest error of a source's cone in a box, and of its integral over the free part."""
    piece, option = run_members(visible.first_piece, box)
    lower, upper = bounds_of_pieces(visible, piece, _ConesAboveOptions(visible, source, option))
    error = np.maximum(-lower, upper)
    if not len(option):
        return np.zeros(0), np.zeros(0)
    largest = np.maximum.reduceat(error, np.flatnonzero(np.append(True, option[1:] != option[:-1])))
    return largest, np.bincount(option, error * areas(visible.pieces)[piece], len(box))


def _options(
    visible: CellSources, area: Float[np.ndarray, "pieces"]
) -> tuple[Int[np.ndarray, "options"], Int[np.ndarray, "options"]]:
    """Boxes and the sources tried for each: those that the centers of its pieces use, of the largest pieces first."""
    count = len(visible.sources.points)
    key, index = np.unique(visible.cell * np.int64(count) + visible.best, return_inverse=True)
    box, source = np.divmod(key, count)
    order = np.lexsort((visible.rank(source), -np.bincount(index, area, len(key)), box))
    box, source = box[order], source[order]
    rank = np.arange(len(box)) - np.searchsorted(box, box)
    return box[rank < _MOST_OPTIONS], source[rank < _MOST_OPTIONS]


@dataclass(frozen=True, eq=False)
class _ConesAboveOptions:
    """Cones minus those of the sources that are tried."""

    visible: CellSources
    source: Int[np.ndarray, "options"]
    option: Int[np.ndarray, "rows"]

    def __call__(
        self, pieces: Any, apex: Float[np.ndarray, "n 2"], offset: Float[np.ndarray, "n"], row: Int[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        own, sources = self.source[self.option[row]], self.visible.sources
        return difference_of_cones(pieces, apex, offset, sources.points[own], sources.distances[own])


# Choosing sources in sight: of those that serve a box about as well, one that most of it sees.
#
# Who goes straight from a point to its leaf's source meets a wall where the source is out of sight. There the
# distance
# is larger than the cone says, for if it were in sight, the way by it would be as short. So samples tell.


PRICE = 30.0
"""Error that counts as much as a way that meets a wall, in proven mean errors of all boxes."""
_LEAST_SHORTFALL = 1e-9
"""Widths of the domain by which a distance is above a cone for certain."""

BoxSources: TypeAlias = Int[np.ndarray, "boxes"]
Pairs: TypeAlias = tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"], Bool[np.ndarray, "pairs"]]


def sources_in_sight(boxes: ConeBoxes, sampler: Sampler, fits: Callable[[BoxSources], bool]) -> BoxSources:
    """The source of every box, another one where a part of it does not see the best one and that one is worth it.

    No box's proven error rises above the largest of all: what is proven of all of them holds as before. Of the
    changes, the most useful first, as many are made as fit.
    """
    box, source = _changes(boxes, sampler)

    def changed(count: int) -> BoxSources:
        result = boxes.source.copy()
        result[box[:count]] = source[:count]
        return result

    if fits(changed(len(box))):
        return changed(len(box))
    return changed(bisect_left(range(1, len(box)), True, key=lambda count: not fits(changed(count))))


def _changes(boxes: ConeBoxes, sampler: Sampler) -> tuple[Int[np.ndarray, "changes"], Int[np.ndarray, "changes"]]:
    """Boxes that are better off with another source, and which; those that gain most, over all their area, first."""
    box, source, by_all = pairs_of_boxes(boxes)
    is_doubted = boxes.source >= 0
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    box, source, by_all = (column[is_doubted[box]] for column in (box, source, by_all))
    if not len(box):
        return box, source
    doubted, count = np.flatnonzero(is_doubted), len(boxes.source)
    price = PRICE * float(boxes.integral.sum())
    some, option_box = boxes[doubted], np.searchsorted(doubted, box)
    x = some.cells.points(sampler.pattern.u, boxes.domain)
    distance = call_oracle(sampler.distance_fn, x.reshape(-1, x.shape[-1])).reshape(x.shape[:-1])
    error, hidden = errors_and_shares_hidden(some, sampler.pattern, x, distance, option_box, source)
    cost = error + price * hidden
    largest, integral = errors_of_options(boxes.visible, box, source)
    is_own = source == boxes.source[box]
    is_barred = ~is_own & (largest > max(boxes.error.max(), boxes.negligible))
    order = np.lexsort((integral, ~is_own, ~by_all, cost, is_barred, box))
    best = order[np.append(True, box[order[1:]] != box[order[:-1]])]
    gain = np.bincount(box[is_own], cost[is_own], count)[box[best]] - cost[best]
    gain *= np.bincount(boxes.visible.cell, areas(boxes.visible.pieces), count)[box[best]]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]
    return box[best], source[best]


def pairs_of_boxes(boxes: ConeBoxes) -> Pairs:
    """Pairs of a box and a source that some point of it may use, box by box, and whether all of it sees it."""
    visible = boxes.visible
    count = len(visible.sources.points)
    key, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(key, count)
    return box, source, np.bincount(index, visible.by_all, len(key)) == np.diff(visible.first_piece)[box]


def errors_and_shares_hidden(
    boxes: ConeBoxes,
    pattern: Pattern,
    x: Float[np.ndarray, "boxes k 2"],
    distance: Float[np.ndarray, "boxes k"],
    box: Int[np.ndarray, "options"],
    source: Int[np.ndarray, "options"],
) -> tuple[Float[np.ndarray, "options"], Float[np.ndarray, "options"]]:
    """Mean error of each source in its box, and the share of it from where a wall is in the way."""
    sources, width = boxes.visible.sources, float(boxes.domain.width.max())
    weight = pattern.weight * np.isfinite(distance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), pattern.weight.min())
    cone = sources.distances[source, None] + np.linalg.norm(x[box] - sources.points[source, None], axis=2)
    above = np.where(np.isfinite(distance), distance, 0.0)[box] - cone
    is_hidden = above > _LEAST_SHORTFALL * width
    return np.sum(weight[box] * np.abs(above), axis=1), np.sum(weight[box] * is_hidden, axis=1)
