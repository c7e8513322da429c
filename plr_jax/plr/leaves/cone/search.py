"""Find the best partition into cone leaves, functions ``offset + |x - source|``, for one goal and a file's limits.

1. Each box gets the cone with the smallest integral of its proven error (``ConeBoxes``).
2. The price per leaf is found at which the tree of least error plus prices fills the file (``best_cones_of_goal``).
3. Leaves change to sources (corners, or the goal) that they see, if errors hardly grow (``prefer_visible_sources``).
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import take_ragged
from plr_jax._types import CellSources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas, difference_of_cones
from plr_jax.geometry.reach import Reach
from plr_jax.plr.best_partition import BoxLevel, PricedTree, PriceSearch
from plr_jax.plr.certificate import Proof, bounds_of_pieces
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.cone.codec import CUT_OFF, ConeFiles, StoredCones
from plr_jax.plr.sampling import Pattern
from plr_jax.plr.source_cache import distances_in_cells
from plr_jax.plr.tree import Cells, Rows, Tree, tree_of, tree_of_axes

_MOST_TRIED = 4
"""Number of sources to try for a box: sources that the centers of its largest convex pieces of free space use."""


@dataclass(frozen=True, eq=False)
class ConeBoxes(Rows):
    """Boxes, each with the best cone ``distance of source + |x - source|`` of a few sources (corners or the goal)."""

    domain: Box
    negligible: float  # error up to which a box counts as exact
    cells: Cells
    visible: CellSources  # sources of the boxes: the goal, and corners where paths from them may turn first
    source: Int[np.ndarray, " boxes"]  # index of the best source; -1 or CUT_OFF if nothing reaches the goal
    error: Float[np.ndarray, " boxes"]  # proven bound of the cone's largest error in the box; 0 if negligible
    integral: Float[np.ndarray, " boxes"]  # proven bound of the error's integral, as a share of the domain's area
    by_side: bool = False  # whether ``peak`` weights largest errors by the sides of boxes
    reach: Reach | None = None  # if known, and some free points cannot reach the goal

    def __getitem__(self, index: Int[np.ndarray, " some"]) -> Self:
        return replace(super().__getitem__(index), visible=self.visible.of_cells(index))

    def append(self, *others: Self) -> Self:
        return replace(super().append(*others), visible=self.visible.append(*(other.visible for other in others)))

    @property
    def peak(self) -> Float[np.ndarray, " boxes"]:
        """The largest error of each cone; if ``by_side``, times the square root of box area / domain area."""
        # With this factor, boxes along a wall cost the same however often they are halved, so they are halved until
        # thin. Proven PLRs go without this factor, since they need few leaves of large error.
        return self.error * 2.0 ** (-self.cells.depth.sum(axis=1) / 2) if self.by_side else self.error

    def new_halves(
        self,
        parent: Int[np.ndarray, " halves"],
        axis: Int[np.ndarray, " halves"],
        is_upper: Bool[np.ndarray, " halves"],
        known_keys: UInt64[np.ndarray, " known"],
    ) -> tuple["ConeBoxes", UInt64[np.ndarray, " new"], UInt64[np.ndarray, " halves"]]:
        # Returns the halves that are not known, their hashes, and the hashes of all halves.
        cells = self.cells[parent].halves(axis, is_upper)
        lo, hi = cells.grown_boxes(self.domain)
        key = cells.hashes()
        _, first = np.unique(key, return_index=True)
        new = np.sort(first[~np.isin(key[first], known_keys)])
        visible = self.visible.parts(parent[new], axis[new], is_upper[new], lo[new], hi[new])
        return fit_boxes(self.domain, self.negligible, cells[new], visible, self.by_side, self.reach), key[new], key


def query_resolution(distances: Float[np.ndarray, " n"]) -> float:
    """Return a quarter of the machine epsilon of 32-bit floats, times the largest finite distance."""
    return float(np.finfo(np.float32).eps / 4 * distances[np.isfinite(distances)].max(initial=0.0))


def fit_boxes(
    domain: Box,
    negligible: float,
    cells: Cells,
    visible: CellSources,
    by_side: bool = False,
    reach: Reach | None = None,
    most_options: int = _MOST_TRIED,
) -> ConeBoxes:
    """Choose each box's cone, of a few sources, by the least integral of proven error; see :class:`ConeBoxes`."""
    best, error, integral = sole_sources(visible), np.zeros(len(cells)), np.zeros(len(cells))
    several = np.flatnonzero((best < 0) & (np.diff(visible.first_piece) > 0))
    if len(several):
        mixed = visible.of_cells(several)
        # Try the sources that the centers of a box's pieces use; sources of the largest pieces come first.
        count, area = len(visible.sources.points), areas(mixed.pieces)
        key, index = np.unique(mixed.cell * np.int64(count) + mixed.best, return_inverse=True)
        box, source = np.divmod(key, count)
        order = np.lexsort((source, -np.bincount(index, area, len(key)), box))
        box, source = box[order], source[order]
        is_tried = np.arange(len(box)) - np.searchsorted(box, box) < most_options
        box, source = box[is_tried], source[is_tried]
        largest, of_option = option_errors(mixed, box, source)
        order = np.lexsort((source, largest, of_option, box))
        order = order[np.append(True, box[order[1:]] != box[order[:-1]])]
        best[several], error[several], integral[several] = source[order], largest[order], of_option[order]
    counts = error > negligible
    integral = np.where(counts, integral, 0.0) / np.prod(domain.width)
    error = np.where(counts, error, 0.0)
    if reach is not None:  # free points that cannot reach the goal err by the largest distance, if far from others
        best[(best < 0) & reach.is_cut_off(*cells.fractions)] = CUT_OFF
        is_border, distances = reach.is_border(*cells.fractions), visible.sources.distances
        largest = distances[np.isfinite(distances)].max() + float(np.linalg.norm(domain.width))
        integral[is_border] += largest * np.ldexp(1.0, -cells.depth[is_border].sum(axis=1))
    return ConeBoxes(domain, negligible, cells, visible, best, error, integral, by_side, reach)


def sole_sources(visible: CellSources) -> Int[np.ndarray, " boxes"]:
    """Return, for each box, the corner (or goal) to which all shortest paths from the box go straight; else -1."""
    first = visible.first_pair[visible.first_piece]
    count, first_source = np.diff(first), np.append(visible.source, -1)[first[:-1]]
    agrees = visible.by_all & (visible.source == np.repeat(first_source, count))
    num_agreeing = np.diff(np.append(0, np.cumsum(agrees))[first])
    is_sole = (count > 0) & (count == np.diff(visible.first_piece)) & (count == num_agreeing)
    return np.where(is_sole, first_source, -1)


def option_errors(
    visible: CellSources, box: Int[np.ndarray, " options"], source: Int[np.ndarray, " options"]
) -> tuple[Float[np.ndarray, " options"], Float[np.ndarray, " options"]]:
    # Bounds of the largest error, and of its integral, if all paths from ``box[i]`` go first to ``source[i]``.
    piece, option = take_ragged(visible.first_piece, box)
    points, distances = visible.sources.points[source], visible.sources.distances[source]

    def above_options(pieces: Any, apex: Any, offset: Any, row: Any) -> Any:
        return difference_of_cones(pieces, apex, offset, points[option[row]], distances[option[row]])

    lower, upper = bounds_of_pieces(visible, piece, above_options)
    error = np.maximum(-lower, upper)
    if not len(option):
        return np.zeros(0), np.zeros(0)
    largest = np.maximum.reduceat(error, np.flatnonzero(np.append(True, option[1:] != option[:-1])))
    return largest, np.bincount(option, error * areas(visible.pieces)[piece], len(box))


# If a wall hides a leaf's source from a point, the distance there is larger than the cone. So samples above the cone
# show where the source is hidden.
_PRICE = 30.0  # cost of a hidden source, in units of the proven mean error of all boxes
LEAST_SHORTFALL = 1e-9  # a sample this far above the cone, in widths of the domain, does not see the source
_MOST_OPTIONS = 64  # boxes with more sources are left alone: no source is visible from much of such a box


class LeafOptions(NamedTuple):
    """Leaves that walls may hide from their source (a corner or the goal), paired with sources that they may get."""

    leaf: Int[np.ndarray, " options"]
    source: Int[np.ndarray, " options"]
    is_own: Bool[np.ndarray, " options"]  # whether the source is the leaf's present source
    by_all: Bool[np.ndarray, " options"]  # whether all of the leaf sees the source
    error: Float[np.ndarray, " options"]  # mean error over the leaf, at samples
    hidden: Float[np.ndarray, " options"]  # share of the leaf from which a wall hides the source
    largest: Float[np.ndarray, " options"]  # largest error: a proven bound, or, from ``family.py``, at samples
    integral: Float[np.ndarray, " options"]  # of the error over the leaf's free space; a proven bound, or at samples
    area: Float[np.ndarray, " options"]  # of the leaf's free space


def boxes_of_levels(levels: Sequence[ConeBoxes], number: Int[np.ndarray, " some"]) -> ConeBoxes:
    # Numbers count the boxes of the first level, then of the second, and so on.
    first = np.cumsum([0, *(len(boxes_of_level.source) for boxes_of_level in levels)])
    depth = np.searchsorted(first, number, side="right") - 1
    used = np.unique(depth) if len(depth) else [0]
    boxes, *others = (levels[level][number[depth == level] - first[level]] for level in used)
    boxes = boxes.append(*others) if others else boxes
    return boxes if (np.diff(depth) >= 0).all() else boxes[np.argsort(np.argsort(depth, kind="stable"))]


def source_options(boxes: ConeBoxes, pattern: Pattern) -> LeafOptions:
    # Pairs of a box and a source that some of its points use, and whether all of the box sees the source.
    visible, count = boxes.visible, len(boxes.visible.sources.points)
    pair, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(pair, count)
    by_all = np.bincount(index, visible.by_all, len(pair)) == np.diff(visible.first_piece)[box]
    is_doubted = np.diff(visible.first_piece) > 0
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    is_doubted &= np.bincount(box, minlength=len(is_doubted)) <= _MOST_OPTIONS
    box, source, by_all = (column[is_doubted[box]] for column in (box, source, by_all))
    doubted = np.flatnonzero(is_doubted)
    some, place = boxes[doubted], np.searchsorted(doubted, box)
    x = some.cells.points(pattern.u, boxes.domain)
    distance = distances_in_cells(some.visible, x)
    # Mean error of each source in its box, and share of the box from which a wall hides it.
    sources, width = some.visible.sources, float(some.domain.width.max())
    weight = pattern.weight * np.isfinite(distance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), pattern.weight.min())
    cone = sources.distances[source, None] + np.linalg.norm(x[place] - sources.points[source, None], axis=2)
    above = np.where(np.isfinite(distance), distance, 0.0)[place] - cone
    is_hidden = above > LEAST_SHORTFALL * width
    error, hidden = np.sum(weight[place] * np.abs(above), axis=1), np.sum(weight[place] * is_hidden, axis=1)
    largest, integral = option_errors(some.visible, place, source)
    area = np.bincount(some.visible.cell, areas(some.visible.pieces), len(doubted)).astype(np.float64)[place]
    return LeafOptions(box, source, source == boxes.source[box], by_all, error, hidden, largest, integral, area)


def prefer_visible_sources(
    boxes: ConeBoxes, pattern: Pattern, fits: Callable[[Int[np.ndarray, " leaves"]], bool]
) -> Int[np.ndarray, " leaves"]:
    # The apex (corner or goal) of each leaf's cone: where possible, an apex that all of the leaf sees.
    # The largest proven error does not rise.
    most = max(float(boxes.error.max()), boxes.negligible)
    return change_sources(boxes.source, source_options(boxes, pattern), float(boxes.integral.sum()), most, fits)


def change_sources(
    source: Int[np.ndarray, " leaves"],
    options: LeafOptions,
    total: float,
    most: float,
    fits: Callable[[Int[np.ndarray, " leaves"]], bool],
) -> Int[np.ndarray, " leaves"]:
    # Walls hide parts of some leaves from their source, so other sources are tried, as far as the file fits. Proven
    # errors of new cones are at most ``most``; ``total`` is the mean error of all leaves before.
    leaf, is_own = options.leaf, options.is_own
    if not len(leaf):
        return source
    cost = options.error + _PRICE * total * options.hidden
    is_barred = ~is_own & (options.largest > most)
    order = np.lexsort((options.source, options.integral, ~is_own, ~options.by_all, cost, is_barred, leaf))
    best = order[np.append(True, leaf[order[1:]] != leaf[order[:-1]])]
    own_cost = np.zeros(len(source))
    own_cost[leaf[is_own]] = cost[is_own]
    gain = (own_cost[leaf[best]] - cost[best]) * options.area[best]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]

    def changed(count: int) -> Int[np.ndarray, " leaves"]:
        sources = source.copy()
        sources[leaf[best[:count]]] = options.source[best[:count]]
        return sources

    if fits(changed(len(best))):
        return changed(len(best))
    return changed(bisect_left(range(1, len(best)), True, key=lambda count: not fits(changed(count))))


_ROOM = 64  # one byte in this many is reserved for changes to visible sources


def best_cones_of_goal(
    visible: CellSources,
    domain: Box,
    limits: Limits,
    pattern: Pattern,
    run: Callable[..., PricedTree],
    reach: Reach | None,
) -> tuple[Tree, StoredCones, ConeBoxes]:
    """Find the partition into cone leaves that fills a file's ``limits`` with the least error, for one goal.

    ``visible`` has the whole domain as its only cell. ``pattern`` places the samples in a leaf that show from where
    walls hide its source. ``run(tree, step)`` replaces ``tree`` by ``step(tree)`` until that is None, and returns the
    last tree. Return the tree, its leaves as in a file, and the leaves' boxes with the sources before step 3 of this
    module.
    """
    negligible = max(limits.tolerance, query_resolution(visible.distance))
    box = fit_boxes(domain, negligible, Cells.root(2), visible, limits.proof is Proof.NONE, reach)
    levels = [BoxLevel.of(box, box.cells.hashes())]
    files = ConeFiles(visible.sources, domain)

    def in_order(priced: PricedTree) -> tuple[Tree, Int[np.ndarray, " leaves"]]:
        tree = tree_of(tree_of_axes(priced.axes, 2).leaves)  # in the canonical form of files
        first = np.cumsum([0, *(len(level.key) for level in levels)])
        numbers = np.concatenate([begin + leaf for begin, leaf in zip(first, priced.leaves, strict=False)])
        return tree, numbers[priced.order][tree.order]

    def size(priced: PricedTree) -> int:
        source = np.concatenate([level.boxes.source for level in levels])[in_order(priced)[1]]
        return files.num_bytes(source, limits) * (_ROOM + 1) // _ROOM

    search = PriceSearch(levels, limits, size, len(np.unique(visible.source)))
    tree, numbers = in_order(run(search.first(), search.next))
    boxes = boxes_of_levels([level.boxes for level in levels], numbers)
    source = prefer_visible_sources(boxes, pattern, partial(files.fit, limits))
    return tree, files.stored(source), boxes
