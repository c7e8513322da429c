"""Find the best partition into cone leaves, functions ``offset + |x - source|``, for one goal and a file's limits.

1. Each box gets the cone with the smallest integral of its proven error (``ConeBoxes``).
2. A search finds the price per leaf at which the tree of least error plus prices fills the file (``PriceSearch``).
3. Leaves change to sources (corners, or the goal) that they see, if errors hardly grow (``prefer_visible_sources``).
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import take_ragged
from plr_jax._types import CellSources, Reach
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas, difference_of_cones
from plr_jax.plr.best_partition import BoxLevel, Halves, PricedTree, PriceSearch
from plr_jax.plr.certificate import Bounds, Proof, bounds_of_pieces
from plr_jax.plr.growth import Limits, grow
from plr_jax.plr.leaves.cone.codec import CUT_OFF, ConeFiles, StoredCones
from plr_jax.plr.sampling import Pattern, Sampler
from plr_jax.plr.source_cache import distances_in_cells
from plr_jax.plr.tree import Cells, Rows, Tree, tree_of, tree_of_axes

_MOST_TRIED = 4  # sources to try for a box: those that the centers of its largest convex pieces of free space use
# An index for each option, a pair of a box and a source: of the box (or its first sample), or of the source.
Indices: TypeAlias = Int[np.ndarray, " options"]
# The index of the apex of each leaf's cone, a corner or the goal; negative if nothing in the leaf has a path.
LeafSources: TypeAlias = Int[np.ndarray, " leaves"]
FitsFn: TypeAlias = Callable[[LeafSources], bool]


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
    most: int = _MOST_TRIED  # sources that a half tries

    @property
    def peak(self) -> Float[np.ndarray, " boxes"]:
        """The largest error of each cone in its box, to which :meth:`BoxLevel.costs` gives a weight.

        If ``by_side``, the error is multiplied by the square root of (box's area / domain's area).
        """
        # With this factor, boxes along a wall cost the same however often they are halved, so they are halved until
        # thin. Proven PLRs go without this factor, since they need few leaves of large error.
        return self.error * 2.0 ** (-self.cells.depth.sum(axis=1) / 2) if self.by_side else self.error

    def halves(self, parent: Halves, axis: Halves, is_upper: Bool[np.ndarray, " halves"]) -> "ConeBoxes":
        """Return halves of boxes: half ``i`` is the lower or upper half of box ``parent[i]`` along ``axis[i]``."""
        cells = self.cells[parent].halves(axis, is_upper)
        visible = self.visible.parts(parent, axis, is_upper, *cells.grown_boxes(self.domain))
        boxes = fit_boxes(self.domain, self.negligible, cells, visible, self.reach, self.most)
        return replace(boxes, by_side=self.by_side)


def query_resolution(distances: Float[np.ndarray, " n"]) -> float:
    """Return the error up to which a cone counts as exact, because 32-bit queries may round by more.

    The error is a quarter of the machine epsilon of 32-bit floats, times the largest finite entry of ``distances``:
    distances to the goal from points in the domain.
    """
    return float(np.finfo(np.float32).eps / 4 * distances[np.isfinite(distances)].max(initial=0.0))


def fit_boxes(
    domain: Box, negligible: float, cells: Cells, visible: CellSources, reach: Reach | None, most: int = _MOST_TRIED
) -> ConeBoxes:
    """Choose the cone of each box that has the least integral of proven error, after trying a few sources.

    A box tries at most ``most`` sources. ``negligible`` is the largest error that counts as 0. ``cells`` are the
    boxes, and the cells of ``visible``. See :class:`ConeBoxes` for the other arguments.
    """
    # 1. If all paths from a box go straight to one source, its cone is exact.
    best, error, integral = sole_sources(visible), np.zeros(len(cells)), np.zeros(len(cells))
    if len(mixed := np.flatnonzero((best < 0) & (np.diff(visible.first_piece) > 0))):
        # 2. A mixed box tries the sources that the centers of its convex pieces use (keys: box * count + source).
        # Sources of the largest area come first; the first `most` of each box stay.
        visible_of_mixed = visible.of_cells(mixed)
        count, area = len(visible.sources.points), areas(visible_of_mixed.pieces)
        key, index = np.unique(visible_of_mixed.cell * np.int64(count) + visible_of_mixed.best, return_inverse=True)
        box, source = np.divmod(key, count)
        order = np.lexsort((source, -np.bincount(index, area, len(key)), box))
        box, source = box[order], source[order]
        is_tried = np.arange(len(box)) - np.searchsorted(box, box) < most
        box, source = box[is_tried], source[is_tried]
        # 3. It takes the source with the least integral of the error, of equal ones the least largest error.
        option_error, option_integral = option_errors(visible_of_mixed, box, source)
        order = np.lexsort((source, option_error, option_integral, box))
        order = order[np.append(True, box[order[1:]] != box[order[:-1]])]  # the first option of each box
        best[mixed] = source[order]
        error[mixed] = option_error[order]
        integral[mixed] = option_integral[order]
    counts = error > negligible
    integral = np.where(counts, integral, 0.0) / np.prod(domain.width)
    error = np.where(counts, error, 0.0)
    # 4. Mark boxes whose free points cannot reach the goal. If some of a box's free points can, and others are far
    # from these, all of the box counts as if it erred by about the largest distance, so that halving it pays.
    if reach is not None:
        best[(best < 0) & reach.is_cut_off(*cells.fractions)] = CUT_OFF
        is_border, distances = reach.is_border(*cells.fractions), visible.sources.distances
        largest_distance = distances[np.isfinite(distances)].max() + float(np.linalg.norm(domain.width))
        integral[is_border] += largest_distance * np.ldexp(1.0, -cells.depth[is_border].sum(axis=1))
    return ConeBoxes(domain, negligible, cells, visible, best, error, integral, reach=reach, most=most)


def sole_sources(visible: CellSources) -> Int[np.ndarray, " boxes"]:
    """Return, for each box, the corner (or goal) to which all shortest paths from the box go straight; else -1."""
    # Box b has the pieces first_piece[b] up to first_piece[b + 1], and the pairs of a piece and a source
    # first_pair[b] up to first_pair[b + 1]. Its source is sole if it has as many pairs as pieces, and all pairs have
    # the source of the first pair, which all of their piece sees.
    first_pair = visible.first_pair[visible.first_piece]
    num_pairs = np.diff(first_pair)
    first_source = np.append(visible.source, -1)[first_pair[:-1]]
    agrees = visible.by_all & (visible.source == np.repeat(first_source, num_pairs))
    num_agreeing = np.diff(np.append(0, np.cumsum(agrees))[first_pair])
    is_sole = (num_pairs > 0) & (num_pairs == np.diff(visible.first_piece)) & (num_pairs == num_agreeing)
    return np.where(is_sole, first_source, -1)


def option_errors(visible: CellSources, box: Indices, source: Indices) -> Bounds:
    """Return bounds of the largest error, and of the error's integral, of cone ``source[i]`` in box ``box[i]``.

    The boxes are the cells of ``visible``. Integrals are over the free space of the box, in workspace units cubed.
    """
    # Row r is piece `piece[r]` in the box of option `option[r]`, with the cone of this option.
    piece, option = take_ragged(visible.first_piece, box)
    points, distances = visible.sources.points[source], visible.sources.distances[source]

    def above_options(pieces: Any, apex: Any, offset: Any, row: Any) -> Any:
        return difference_of_cones(pieces, apex, offset, points[option[row]], distances[option[row]])

    lower, upper = bounds_of_pieces(visible, piece, above_options)
    error = np.maximum(-lower, upper)
    largest = np.maximum.reduceat(error, np.searchsorted(option, np.arange(len(box))))
    integral = np.bincount(option, error * areas(visible.pieces)[piece], len(box))
    return largest, integral.astype(np.float64)  # as `bincount` returns integers if there are no options


# If a wall hides a leaf's source from a point, the distance there is larger than the cone. So samples above the cone
# show where the source is hidden.
_PRICE = 30.0  # cost of a hidden source, in units of the proven mean error of all boxes
SHORTFALL = 1e-9  # a sample this far above the cone, in widths of the domain, does not see the source
ROOM = 64  # one byte in this many of a file is reserved for changes to visible sources
_MOST_OPTIONS = 64  # boxes with more sources are left alone: no source is visible from much of such a box


class LeafOptions(NamedTuple):
    """Candidate sources for leaves; entry ``i`` of each array is for one pair of a leaf and a candidate.

    A leaf has candidates if a wall may hide its present source (a corner or the goal) from a part of the leaf.
    """

    leaf: Indices
    source: Indices
    by_all: Bool[np.ndarray, " options"]  # whether all of the leaf sees the source
    error: Float[np.ndarray, " options"]  # mean error over the leaf, at samples
    hidden: Float[np.ndarray, " options"]  # share of the leaf from which a wall hides the source
    largest: Float[np.ndarray, " options"]  # largest error: a proven bound, or, from ``family.py``, at samples
    integral: Float[np.ndarray, " options"]  # of the error over the leaf's free space; a proven bound, or at samples
    area: Float[np.ndarray, " options"]  # of the leaf's free space


def boxes_of_levels(levels: Sequence[ConeBoxes], number: Int[np.ndarray, " selected"]) -> ConeBoxes:
    """Return the boxes with the given numbers, in the given order.

    Boxes are numbered from 0: first all boxes of the first level, then all boxes of the second level, and so on.
    """
    first_number = np.cumsum([0, *(len(boxes_of_level.source) for boxes_of_level in levels)])
    level = np.searchsorted(first_number, number, side="right") - 1
    used_levels = np.unique(level) if len(level) else [0]
    boxes, *others = (levels[used][number[level == used] - first_number[used]] for used in used_levels)
    boxes = boxes.append(*others) if others else boxes
    # Boxes are now sorted by level. The inverse of this stable sort restores the given order.
    return boxes if (np.diff(level) >= 0).all() else boxes[np.argsort(np.argsort(level, kind="stable"))]


def source_options(boxes: ConeBoxes, pattern: Pattern) -> LeafOptions:
    """Pair each box with all sources that paths from some of its points may use.

    Boxes are left out if all of their free space sees their present source, or if they have more than 64 sources.
    ``pattern`` has the positions in a box of the samples that estimate errors.
    """
    # 1. List the pairs of a box and a source (keys: box * count + source). A source is visible from all of a box if
    # it is visible from all of each of its pieces.
    visible, count = boxes.visible, len(boxes.visible.sources.points)
    key, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(key, count)
    num_pieces = np.diff(visible.first_piece)
    by_all = np.bincount(index, visible.by_all, len(key)) == num_pieces[box]
    # 2. Choose the boxes with candidates: "leaves" of the result.
    is_chosen = num_pieces > 0
    is_chosen[box[by_all & (source == boxes.source[box])]] = False
    is_chosen &= np.bincount(box, minlength=len(is_chosen)) <= _MOST_OPTIONS
    box, source, by_all = (column[is_chosen[box]] for column in (box, source, by_all))
    # 3. At samples: mean error of each source in its box, and share of the box from which a wall hides the source.
    # Samples are weighted so that those with a path to the goal sum to 1 in each box.
    chosen = np.flatnonzero(is_chosen)
    chosen_boxes, row = boxes[chosen], np.searchsorted(chosen, box)
    visible, sources = chosen_boxes.visible, chosen_boxes.visible.sources
    x = chosen_boxes.cells.points(pattern.u, boxes.domain)
    distance = distances_in_cells(visible, x)
    weight = pattern.weight * np.isfinite(distance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), pattern.weight.min())
    cone = sources.distances[source, None] + np.linalg.norm(x[row] - sources.points[source, None], axis=2)
    above = np.where(np.isfinite(distance), distance, 0.0)[row] - cone
    error = np.sum(weight[row] * np.abs(above), axis=1)
    hidden = np.sum(weight[row] * (above > SHORTFALL * float(boxes.domain.width.max())), axis=1)
    # 4. Proven bounds of the errors, and free area.
    largest, integral = option_errors(visible, row, source)
    area = np.bincount(visible.cell, areas(visible.pieces), len(chosen)).astype(np.float64)[row]
    return LeafOptions(box, source, by_all, error, hidden, largest, integral, area)


def prefer_visible_sources(boxes: ConeBoxes, pattern: Pattern, fits: FitsFn) -> LeafSources:
    """Choose a source for each leaf: where possible, a source that all of the leaf sees.

    ``boxes`` are the leaves with their present sources. The largest proven error of all leaves does not rise.
    ``fits(sources)`` tells whether the file of leaves with these sources is within its limits. ``pattern`` has the
    positions of samples in a leaf.
    """
    most = max(float(boxes.error.max()), boxes.negligible)
    return change_sources(boxes.source, source_options(boxes, pattern), float(boxes.integral.sum()), most, fits)


def change_sources(source: LeafSources, options: LeafOptions, total: float, most: float, fits: FitsFn) -> LeafSources:
    """Replace the ``source`` of some leaves by a source that walls hide from less of the leaf; return all sources.

    ``fits(sources)`` tells whether the file of leaves with these sources is within its limits; if not all changes
    fit, the most useful changes are made. The largest error of a new cone is at most ``most``. ``total`` is the mean
    error over the domain with the present sources.
    """
    leaf = options.leaf
    if not len(leaf):
        return source
    is_own = options.source == source[leaf]
    # 1. Each leaf prefers the option of least cost whose largest error is allowed; ties go to sources that all of the
    # leaf sees, then to its present source.
    cost = options.error + _PRICE * total * options.hidden
    is_barred = ~is_own & (options.largest > most)
    order = np.lexsort((options.source, options.integral, ~is_own, ~options.by_all, cost, is_barred, leaf))
    best = order[np.append(True, leaf[order[1:]] != leaf[order[:-1]])]
    # 2. Changes are made in the order of their gain.
    own_cost = np.zeros(len(source))
    own_cost[leaf[is_own]] = cost[is_own]
    gain = (own_cost[leaf[best]] - cost[best]) * options.area[best]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]

    def changed(count: int) -> LeafSources:
        sources = source.copy()
        sources[leaf[best[:count]]] = options.source[best[:count]]
        return sources

    # 3. Make all changes, or else as many as fit. The first count that does not fit is the index that `bisect_left`
    # returns plus 1, as the range begins at 1: so the index is the largest count that fits.
    if fits(changed(len(best))):
        return changed(len(best))
    return changed(bisect_left(range(1, len(best)), True, key=lambda count: not fits(changed(count))))


def best_cones(visible: CellSources, sampler: Sampler, limits: Limits) -> tuple[Tree, StoredCones, CellSources]:
    """Find the partition into cone leaves that fills a file's ``limits`` with the least error, for one goal.

    ``visible`` has the whole domain as its only cell. Samples of ``sampler.pattern`` in a leaf show from where walls
    hide its source. Return the tree, its leaves as in a file, and the sources to which paths from each leaf may
    go first.
    """
    # 1. Start from the domain as the only box.
    negligible = max(limits.tolerance, query_resolution(visible.distance))
    root = fit_boxes(sampler.domain, negligible, Cells.root(2), visible, sampler.reach)
    root = replace(root, by_side=limits.proof is Proof.NONE)
    files = ConeFiles(visible.sources, sampler.domain)

    def in_order(levels: list[BoxLevel], priced: PricedTree) -> tuple[Tree, Int[np.ndarray, " leaves"]]:
        # The tree, in the canonical form of files, and the number of each leaf's box, as in `boxes_of_levels`.
        tree = tree_of(tree_of_axes(priced.axes, 2).leaves)
        first_number = np.cumsum([0, *(len(level.key) for level in levels)])
        number = np.concatenate([first + leaf for first, leaf in zip(first_number, priced.leaves, strict=False)])
        return tree, number[priced.order][tree.order]

    def size(levels: list[BoxLevel], priced: PricedTree) -> int:
        source = np.concatenate([level.boxes.source for level in levels])[in_order(levels, priced)[1]]
        return files.num_bytes(source, limits) * (ROOM + 1) // ROOM

    # 2. Search the price at which the tree fills the file.
    search = PriceSearch(root, limits, size, len(np.unique(visible.source)))
    tree, number = in_order(search.levels, grow(search.first(), search.next, limits))
    # 3. Change sources of leaves.
    boxes = boxes_of_levels([level.boxes for level in search.levels], number)
    source = prefer_visible_sources(boxes, sampler.pattern, partial(files.fit, limits))
    return tree, files.stored(source), boxes.visible
