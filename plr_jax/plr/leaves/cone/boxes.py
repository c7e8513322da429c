"""Boxes and the cones that fit them best, from what an oracle proves of the sources that their points use."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import run_members
from plr_jax._types import CellSources, FamilyCellSources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas, difference_of_cones
from plr_jax.plr.certificate import bounds_of_pieces
from plr_jax.plr.partition.cells import Cells

_MOST_OPTIONS = 4
"""Sources tried for a leaf: those to which most of it goes, judged by the centers of its pieces."""


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

    def new_halves(
        self,
        parent: Int[np.ndarray, "halves"],
        axis: Int[np.ndarray, "halves"],
        is_upper: Bool[np.ndarray, "halves"],
        known: UInt64[np.ndarray, "known"],
    ) -> tuple["ConeBoxes", UInt64[np.ndarray, "new"], UInt64[np.ndarray, "halves"]]:
        """Those halves of some of the boxes whose keys are not known yet, each once; their keys; and all keys.

        Of one goal the box is the key. Of a family it tells apart what goals make of the box too, which is known only
        once the sources of the halves are.
        """
        cells, visible = self.cells[parent].halves(axis, is_upper), self.visible
        lo, hi = cells.grown_boxes(self.domain)
        if isinstance(visible, FamilyCellSources):
            found, key, first, index = visible.distinct_parts(parent, axis, is_upper, lo, hi, cells.hashes())
            new = _first_of_new(key, known)
            rows, found, of_half = first[new], found.of_cells(new), key[index]
        else:
            key = of_half = cells.hashes()
            new = rows = _first_of_new(key, known)
            found = visible.parts(parent[rows], axis[rows], is_upper[rows], lo[rows], hi[rows])
        return fitted_boxes(self.domain, self.negligible, cells[rows], found), key[new], of_half


def _first_of_new(key: UInt64[np.ndarray, "n"], known: UInt64[np.ndarray, "known"]) -> Int[np.ndarray, "new"]:
    """Where each distinct key that is not known stands first, in this order."""
    distinct, first = np.unique(key, return_index=True)
    return np.sort(first[~np.isin(distinct, known)])


def views_of(visible: CellSources, source: Int[np.ndarray, "some"]) -> Int[np.ndarray, "some"]:
    """Viewpoints of sources, of which those of a single goal are one each."""
    return visible.views(source) if isinstance(visible, FamilyCellSources) else source


def root_box(visible: CellSources, domain: Box, tolerance: float) -> ConeBoxes:
    """The domain as one box; errors up to the tolerance do not count, nor do those that no query resolves."""
    negligible = max(tolerance, resolved_error(visible.distance))
    return fitted_boxes(domain, negligible, Cells.root(domain.dim), visible)


def resolved_error(distances: Float[np.ndarray, "n"]) -> float:
    """The least error that a query resolves of distances, some of which may be ``inf``."""
    return float(np.finfo(np.float32).eps / 4 * distances[np.isfinite(distances)].max(initial=0.0))


def fitted_boxes(domain: Box, negligible: float, cells: Cells, visible: CellSources) -> ConeBoxes:
    """Boxes with the cone for each whose proven error has the least integral over its free part.

    Errors up to what is negligible do not count.
    """
    best, error, integral = only_sources(visible), np.zeros(len(cells)), np.zeros(len(cells))
    several = np.flatnonzero((best < 0) & (np.diff(visible.first_piece) > 0))
    if len(several):
        some = visible.of_cells(several)
        # Sources tried for each: those that the centers of its pieces use, of the largest pieces first.
        count, area = len(visible.sources.points), areas(some.pieces)
        key, index = np.unique(some.cell * np.int64(count) + some.best, return_inverse=True)
        box, source = np.divmod(key, count)
        order = np.lexsort((some.rank(source), -np.bincount(index, area, len(key)), box))
        box, source = box[order], source[order]
        is_tried = np.arange(len(box)) - np.searchsorted(box, box) < _MOST_OPTIONS
        box, source = box[is_tried], source[is_tried]
        largest, of_option = errors_of_options(some, box, source)
        order = np.lexsort((some.rank(source), largest, of_option, box))
        order = order[np.append(True, box[order[1:]] != box[order[:-1]])]
        best[several], error[several], integral[several] = source[order], largest[order], of_option[order]
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


def errors_of_options(
    visible: CellSources, box: Int[np.ndarray, "options"], source: Int[np.ndarray, "options"]
) -> tuple[Float[np.ndarray, "options"], Float[np.ndarray, "options"]]:
    """Proven bounds of the largest error of a source's cone in a box, and of its integral over the free part."""
    piece, option = run_members(visible.first_piece, box)
    points, distances = visible.sources.points[source], visible.sources.distances[source]

    def above_options(pieces: Any, apex: Any, offset: Any, row: Any) -> Any:
        """Cones minus those of the sources that are tried."""
        return difference_of_cones(pieces, apex, offset, points[option[row]], distances[option[row]])

    lower, upper = bounds_of_pieces(visible, piece, above_options)
    error = np.maximum(-lower, upper)
    if not len(option):
        return np.zeros(0), np.zeros(0)
    largest = np.maximum.reduceat(error, np.flatnonzero(np.append(True, option[1:] != option[:-1])))
    return largest, np.bincount(option, error * areas(visible.pieces)[piece], len(box))
