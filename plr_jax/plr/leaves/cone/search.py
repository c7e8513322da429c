"""Find the best partitions into cone leaves within the limits of a file, for one goal or for many of a workspace.

1. Each box gets the cone with the smallest integral of its proven error (``ConeBoxes``).
2. A search over all dyadic boxes finds the largest best trees within the limits (``best_cones``).
3. Leaves change to sources (corners, or the goal) that they see, if errors hardly grow (``prefer_visible_sources``).
4. For many goals, boxes that are equal for several goals are computed once (``FamilyTask``).
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import take_ragged
from plr_jax._types import CellSources, FamilyFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas, difference_of_cones
from plr_jax.plr.best_partition import (
    EXACT,
    PRUNED,
    BoxLevel,
    Forest,
    PricedTree,
    PriceSearch,
    SearchPruning,
    may_halve,
)
from plr_jax.plr.cell_memory import distances_in_cells
from plr_jax.plr.certificate import bounds_of_pieces
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.cone.codec import ConeFiles, StoredCones
from plr_jax.plr.sampling import Pattern
from plr_jax.plr.tree import Cells, Rows, Tree, grown_domain, tree_of, tree_of_axes

# 1. Boxes and their best cones.

_MOST_TRIED = 4
"""Number of sources to try for a box: those that the centers of its largest convex pieces of free space use."""


@dataclass(frozen=True, eq=False)
class ConeBoxes(Rows):
    """Boxes, and the best cone ``distance of source + |x - source|`` for each.

    Attributes:
        negligible: Error up to which a box counts as exact.
        visible: Sources of the boxes: the goal, and corners where paths from them may turn first.
        source: Index of the best source; -1 if nothing in the box reaches the goal.
        error: Proven bound of the cone's largest error in the box; 0 if negligible.
        integral: Proven bound of the integral of this error over the box, as a share of the domain's area.
    """

    domain: Box
    negligible: float
    cells: Cells
    visible: CellSources
    source: Int[np.ndarray, "boxes"]
    error: Float[np.ndarray, "boxes"]
    integral: Float[np.ndarray, "boxes"]

    def __getitem__(self, index: Int[np.ndarray, "some"]) -> Self:
        return replace(super().__getitem__(index), visible=self.visible.of_cells(index))

    def append(self, *others: Self) -> Self:
        return replace(super().append(*others), visible=self.visible.append(*(other.visible for other in others)))

    def new_halves(
        self,
        parent: Int[np.ndarray, "halves"],
        axis: Int[np.ndarray, "halves"],
        is_upper: Bool[np.ndarray, "halves"],
        known: UInt64[np.ndarray, "known"],
    ) -> tuple["ConeBoxes", UInt64[np.ndarray, "new"], UInt64[np.ndarray, "halves"]]:
        """Halve boxes; return the distinct halves with keys not ``known``, their keys, and the keys of all halves.

        For one goal, a key identifies the box; in a search for many goals, also its convex pieces and sources.
        """
        cells, visible = self.cells[parent].halves(axis, is_upper), self.visible
        lo, hi = cells.grown_boxes(self.domain)
        if visible.is_family:
            found, key, first, index = visible.distinct_parts(parent, axis, is_upper, lo, hi, cells.hashes())
            new = _first_of_new(key, known)
            rows, found, of_half = first[new], found.of_cells(new), key[index]
        else:
            key = of_half = cells.hashes()
            new = rows = _first_of_new(key, known)
            found = visible.parts(parent[rows], axis[rows], is_upper[rows], lo[rows], hi[rows])
        return fit_boxes(self.domain, self.negligible, cells[rows], found), key[new], of_half


def _first_of_new(key: UInt64[np.ndarray, "n"], known: UInt64[np.ndarray, "known"]) -> Int[np.ndarray, "new"]:
    distinct, first = np.unique(key, return_index=True)
    return np.sort(first[~np.isin(distinct, known)])


def query_resolution(distances: Float[np.ndarray, "n"]) -> float:
    """Return the smallest error that a 32-bit query resolves at the largest finite distance."""
    return float(np.finfo(np.float32).eps / 4 * distances[np.isfinite(distances)].max(initial=0.0))


def fit_boxes(domain: Box, negligible: float, cells: Cells, visible: CellSources) -> ConeBoxes:
    """Find each box's best cone, of at most 4 tried, by the integral of its proven error (0 if ``negligible``)."""
    best, error, integral = sole_sources(visible), np.zeros(len(cells)), np.zeros(len(cells))
    several = np.flatnonzero((best < 0) & (np.diff(visible.first_piece) > 0))
    if len(several):
        some = visible.of_cells(several)
        # Try the sources that the centers of a box's pieces use; sources of the largest pieces come first.
        count, area = len(visible.sources.points), areas(some.pieces)
        key, index = np.unique(some.cell * np.int64(count) + some.best, return_inverse=True)
        box, source = np.divmod(key, count)
        order = np.lexsort((some.rank(source), -np.bincount(index, area, len(key)), box))
        box, source = box[order], source[order]
        is_tried = np.arange(len(box)) - np.searchsorted(box, box) < _MOST_TRIED
        box, source = box[is_tried], source[is_tried]
        largest, of_option = option_errors(some, box, source)
        order = np.lexsort((some.rank(source), largest, of_option, box))
        order = order[np.append(True, box[order[1:]] != box[order[:-1]])]
        best[several], error[several], integral[several] = source[order], largest[order], of_option[order]
    counts = error > negligible
    integral = np.where(counts, integral, 0.0) / np.prod(domain.width)
    return ConeBoxes(domain, negligible, cells, visible, best, np.where(counts, error, 0.0), integral)


def sole_sources(visible: CellSources) -> Int[np.ndarray, "boxes"]:
    """Return each box's source if all of the box sees it and uses no other source, so the cone is exact; else -1."""
    only, first = np.full(visible.num_cells, -1), visible.first_pair[visible.first_piece]
    is_box = np.flatnonzero(np.diff(first) == np.diff(visible.first_piece))  # one pair for each piece, or none
    is_box = is_box[np.diff(first)[is_box] > 0]
    if not len(is_box):
        return only
    of_pairs = np.stack([visible.source, -visible.source, visible.by_all])
    smallest, largest, by_all = np.minimum.reduceat(of_pairs, first[:-1][np.diff(first) > 0], axis=1)
    row = (np.cumsum(np.diff(first) > 0) - 1)[is_box]
    alone = (smallest == -largest)[row] & (by_all[row] > 0)
    only[is_box[alone]] = smallest[row[alone]]
    return only


def option_errors(
    visible: CellSources, box: Int[np.ndarray, "options"], source: Int[np.ndarray, "options"]
) -> tuple[Float[np.ndarray, "options"], Float[np.ndarray, "options"]]:
    """Bound the largest error of 'distance by way of the source' in a box, and its integral over free space."""
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


# 3. Visible sources: among the sources that serve a box about as well, choose one that most of the box sees.
#
# If a wall hides a leaf's source from a point, the distance there is larger than the cone: were the source visible,
# the path by it would be as short as the cone. So samples above the cone show where the source is hidden. The
# alternatives of each box are computed once for all trees that have the box as a leaf.

_PRICE = 30.0  # cost of a hidden source, in units of the proven mean error of all boxes
_LEAST_SHORTFALL = 1e-9  # a sample this far above the cone, in widths of the domain, does not see the source
_MOST_OPTIONS = 64  # boxes with more sources are left alone: no source is visible from much of such a box
_KEY_BITS = 40  # bits for the index of a box in its level


@dataclass(frozen=True, eq=False)
class LeafBoxes:
    """The leaves of one goal's tree, in tree order, as boxes: the level (``depth``) of each, and its index there.

    ``source`` is the number of each leaf's source among all corners and goals (*viewpoints*), -1 for none.
    """

    source: Int[np.ndarray, "leaves"]
    depth: Int[np.ndarray, "leaves"]
    box: Int[np.ndarray, "leaves"]


def tree_of_leaves(levels: list[BoxLevel], tree: PricedTree, keeps_split_order: bool) -> tuple[Tree, LeafBoxes]:
    """Return a tree as files store it (as it was split, or in canonical form), and its leaves in that order."""
    found, order = tree_of_axes(tree.axes, 2), tree.order
    if not keeps_split_order:
        found = tree_of(found.leaves)
        order = order[found.order]
    depth, box = np.repeat(np.arange(len(tree.leaves)), list(map(len, tree.leaves))), np.concatenate(tree.leaves)
    return found, LeafBoxes(leaf_views(levels, tree)[order], depth[order], box[order])


def leaf_views(levels: list[BoxLevel], tree: PricedTree) -> Int[np.ndarray, "leaves"]:
    """Return the numbers of the leaves' best sources among all corners and goals, by level; -1 if there is none."""
    source = np.concatenate([level.boxes.source[box] for level, box in zip(levels, tree.leaves, strict=False)])
    source[source >= 0] = levels[0].boxes.visible.views(source[source >= 0])
    return source


@dataclass(frozen=True, eq=False)
class SourceOptions:
    """Leaf boxes, and alternative sources for boxes that do not entirely see their best source.

    Attributes:
        key: Level and index of each box, combined.
        first: Index of each box's first option; most boxes have none.
        view: Number of the option's source among all corners and goals; ``is_own`` if it is the box's best source,
            ``by_all`` if all of the box sees it.
        error: Mean error over the box, at samples.
        hidden: Share of the box from which a wall hides the source.
        largest, integral: Proven largest error, and proven integral of the error over the box's free space.
        area: Area of the box's free space.
    """

    key: Int[np.ndarray, "boxes"]
    boxes: ConeBoxes
    first: Int[np.ndarray, "boxes_plus_one"]
    view: Int[np.ndarray, "options"]
    is_own: Bool[np.ndarray, "options"]
    by_all: Bool[np.ndarray, "options"]
    error: Float[np.ndarray, "options"]
    hidden: Float[np.ndarray, "options"]
    largest: Float[np.ndarray, "options"]
    integral: Float[np.ndarray, "options"]
    area: Float[np.ndarray, "options"]


def source_options(levels: list[BoxLevel], trees: list[LeafBoxes], pattern: Pattern) -> SourceOptions:
    """Find alternative sources for leaf boxes that do not entirely see theirs; boxes of over 64 sources get none."""
    key = np.unique(np.concatenate([_keys(tree) for tree in trees]))
    first, *others = (level.boxes[key[key >> _KEY_BITS == i] - (i << _KEY_BITS)] for i, level in enumerate(levels))
    boxes = first.append(*others)
    # Pairs of a box and a source that some of its points use, and whether all of the box sees the source.
    visible, count = boxes.visible, len(boxes.visible.sources.points)
    pair, index = np.unique(visible.cell[visible.piece] * np.int64(count) + visible.source, return_inverse=True)
    box, source = np.divmod(pair, count)
    by_all = np.bincount(index, visible.by_all, len(pair)) == np.diff(visible.first_piece)[box]
    is_doubted = np.diff(boxes.visible.first_piece) > 0
    is_doubted[box[by_all & (source == boxes.source[box])]] = False
    is_doubted &= np.bincount(box, minlength=len(key)) <= _MOST_OPTIONS
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
    is_hidden = above > _LEAST_SHORTFALL * width
    error, hidden = np.sum(weight[place] * np.abs(above), axis=1), np.sum(weight[place] * is_hidden, axis=1)
    largest, integral = option_errors(some.visible, place, source)
    area = np.bincount(some.visible.cell, areas(some.visible.pieces), len(doubted)).astype(np.float64)
    view, is_own = boxes.visible.views(source), source == boxes.source[box]
    first = np.searchsorted(box, np.arange(len(key) + 1))
    return SourceOptions(key, boxes, first, view, is_own, by_all, error, hidden, largest, integral, area[place])


def _keys(tree: LeafBoxes) -> Int[np.ndarray, "leaves"]:
    return (tree.depth << _KEY_BITS) + tree.box


def prefer_visible_sources(
    tree: LeafBoxes, options: SourceOptions, fits: Callable[[Int[np.ndarray, "leaves"]], bool]
) -> Int[np.ndarray, "leaves"]:
    """Return each leaf's source, as its number among corners and goals; prefer sources that the leaf sees.

    No proven error rises above the largest one of all leaves. The most useful changes come first, as many as fit.
    """
    leaf, view = _changes(tree, options)

    def changed(count: int) -> Int[np.ndarray, "leaves"]:
        views = tree.source.copy()
        views[leaf[:count]] = view[:count]
        return views

    if fits(changed(len(leaf))):
        return changed(len(leaf))
    return changed(bisect_left(range(1, len(leaf)), True, key=lambda count: not fits(changed(count))))


def _changes(
    tree: LeafBoxes, options: SourceOptions
) -> tuple[Int[np.ndarray, "changes"], Int[np.ndarray, "changes"]]:
    """Return the leaves that gain by another source, and its number, sorted by falling gain in error times area."""
    boxes, box = options.boxes, np.searchsorted(options.key, _keys(tree))
    option, leaf = take_ragged(options.first, box)
    if not len(leaf):
        return leaf, leaf
    is_own = options.is_own[option]
    cost = options.error[option] + _PRICE * float(boxes.integral[box].sum()) * options.hidden[option]
    is_barred = ~is_own & (options.largest[option] > max(float(boxes.error[box].max()), boxes.negligible))
    order = np.lexsort(
        (options.view[option], options.integral[option], ~is_own, ~options.by_all[option], cost, is_barred, leaf)
    )
    best = order[np.append(True, leaf[order[1:]] != leaf[order[:-1]])]
    own_cost = np.zeros(len(tree.source))
    own_cost[leaf[is_own]] = cost[is_own]
    gain = (own_cost[leaf[best]] - cost[best]) * options.area[option[best]]
    best = best[np.argsort(-gain, kind="stable")]
    best = best[~is_own[best]]
    return leaf[best], options.view[option[best]]


# 2. The best trees.

_ROOM = 64  # one byte in this many is reserved for changes to visible sources


class ConeTree(NamedTuple):
    """A tree, and its leaves in the order of its traversal: their file form, box among ``boxes``, and cone's source.

    ``boxes`` are the leaf boxes of all trees. Sources are numbered among all corners and goals, -1 for none.
    """

    tree: Tree
    stored: StoredCones
    boxes: ConeBoxes
    box: Int[np.ndarray, "leaves"]
    source: Int[np.ndarray, "leaves"]


Run: TypeAlias = Callable[[Forest, Callable[[Forest], Forest | None]], Forest]
"""Function that repeats a step on trees until the step returns None, and returns the last trees."""


def run_quietly(forest: Forest, step: Callable[[Forest], Forest | None]) -> Forest:
    """Repeat a step until it returns None, without a progress bar; interrupts (Ctrl-C) pass through."""
    while (larger := step(forest)) is not None:
        forest = larger
    return forest


def best_cones_of_goal(visible: CellSources, domain: Box, limits: Limits, pattern: Pattern, run: Run) -> ConeTree:
    """Find the best cone leaves for one goal; ``visible``: the sources of the domain, slightly enlarged."""
    negligible = max(limits.tolerance, query_resolution(visible.distance))
    box = fit_boxes(domain, negligible, Cells.root(2), visible)
    levels = [BoxLevel.of(box, box.cells.hashes())]
    root = np.zeros(1, np.int64)
    return best_cones(levels, root, [visible.sources], domain, limits, pattern, run)[0]


def best_cones(
    levels: list[BoxLevel],
    roots: Int[np.ndarray, "members"],
    sources: Sequence[Sources],
    domain: Box,
    limits: Limits,
    pattern: Pattern,
    run: Run,
    pruning: SearchPruning = EXACT,
) -> list[ConeTree]:
    """Find the best leaves for each member (goal), and change their sources to visible ones.

    A member's tree starts at its box in ``roots``, of the first level. Its ``sources`` are corners and its goal: for
    one goal the goal comes first, in a family last. ``run`` is :func:`grow` or :func:`run_quietly`.
    """
    files = [ConeFiles(each, domain) for each in sources]

    def views(member: int, view: Int[np.ndarray, "leaves"]) -> Int[np.ndarray, "leaves"]:
        # A family numbers all goals after the corners, but a member's table has only its own goal, at the end.
        return np.minimum(view, len(sources[member].points) - 1)

    def size(member: int, tree: PricedTree) -> int:
        if pruning.keeps_split_order:
            view = leaf_views(levels, tree)[tree.order]
        else:
            view = tree_of_leaves(levels, tree, keeps_split_order=False)[1].source
        return files[member].num_bytes(views(member, view), limits) * (_ROOM + 1) // _ROOM

    num_sources = len(np.unique(levels[0].boxes.visible.source)) or len(sources[0].points)
    search = PriceSearch(levels, roots, limits, size, num_sources, pruning)
    trees = [
        tree_of_leaves(levels, tree, pruning.keeps_split_order) for tree in run(search.first(), search.next).trees
    ]
    options, members = source_options(levels, [leaves for _, leaves in trees], pattern), []
    for member, (tree, leaves) in enumerate(trees):

        def fits(view: Int[np.ndarray, "leaves"], member: int = member) -> bool:
            return files[member].num_bytes(views(member, view), limits) <= limits.max_bytes

        view = prefer_visible_sources(leaves, options, fits)
        box = np.searchsorted(options.key, _keys(leaves))
        members.append(ConeTree(tree, files[member].stored(views(member, view)), options.boxes, box, view))
    return members


# 4. Many goals of one workspace: a box that is equal for several goals is computed once for all of them.
#
# Boxes of few splits have different sources for every goal, and are hardly ever leaves of a good tree unless one
# source serves all of the box. So all goals *start* at boxes with a fixed number of splits. A larger box becomes a
# leaf only if all start boxes in it have no error and the same source. If sources take most of the bytes (such as 100
# corners in 1 KB), good trees have fewer and larger leaves; so a single goal starts at the whole domain.

_MOST_SPLITS, _LEAVES_A_START = 9, 8.0  # splits of start boxes; expected leaves in each
_BITS_A_LEAF, _BITS_OF_SOURCES = 4.4, 400  # estimates for the number of leaves
_RESOLVED = float(np.finfo(np.float32).eps / 4)  # relative error below the resolution of queries
# Pruning of boxes that are seldom leaves halves the time of the search.
_FAMILY_PRUNING = SearchPruning(1.0, 5, 0.99, keeps_split_order=True)
_ANY, _NONE = -1, -2  # in place of a source: nothing reaches the goal; several sources or an error


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """A builder of cone leaves for oracles of one family (goals of one workspace); call it with some of them.

    Searches begin at start boxes; ``shared`` has their data that all oracles share. ``upper_cells`` are the cells of
    each number of splits, up to the start boxes; ``halves`` has each cell's halves as indices into the next cells.
    """

    shared: Any
    upper_cells: list[Cells]
    halves: list[Int[np.ndarray, "2 2 _"]]
    domain: Box
    limits: Limits
    pattern: Pattern

    def __call__(self, oracles: Sequence[FamilyFn]) -> list[ConeTree]:
        found, key, node_of = oracles[0].family_sources(self.shared, oracles)
        if (lost := np.flatnonzero((node_of < 0).all(axis=1))).size:
            raise ValueError(
                f"The goal of oracle {lost[0]} must be reachable from somewhere in the domain. Check that it is free."
            )
        # Boxes from which nothing reaches a goal have no pieces; add them after the others.
        cells, limits = self.upper_cells[-1], self.limits
        place, empty = np.zeros(found.num_cells, np.int64), np.unique(np.nonzero(node_of < 0)[1])
        place[node_of[node_of >= 0]] = np.nonzero(node_of >= 0)[1]
        node_of = np.where(node_of < 0, found.num_cells + np.searchsorted(empty, np.arange(len(cells))), node_of)
        lowest, found = cells[np.append(place, empty)], replace(found, num_cells=found.num_cells + len(empty))
        negligible = max(limits.tolerance, _RESOLVED * float(self.domain.width.max()))
        boxes = fit_boxes(self.domain, negligible, lowest, found)
        key = np.append(key, cells[empty].hashes())
        levels = [*self._upper_levels(boxes, node_of), BoxLevel.of(boxes, key)]
        roots = np.arange(len(oracles)) if self.halves else node_of[:, 0]
        sources = [_corners_first(oracle.sources) for oracle in oracles]
        return best_cones(levels, roots, sources, self.domain, limits, self.pattern, run_quietly, _FAMILY_PRUNING)

    def _upper_levels(self, boxes: ConeBoxes, node_of: Int[np.ndarray, "goals lowest"]) -> list[BoxLevel]:
        """Make the boxes above start boxes, for each goal; the error is 0 if one source is exact, else ``inf``."""
        levels, node = [], node_of
        nothing: Any = boxes.visible.of_cells(np.zeros(0, np.int64))
        is_alone = (boxes.source < 0) | (sole_sources(boxes.visible) >= 0)
        source = np.where(is_alone, boxes.source, _NONE)[node_of]
        for cells, child in zip(reversed(self.upper_cells[:-1]), reversed(self.halves), strict=True):
            common = np.full((len(source), len(cells)), _NONE)
            for lower, upper in child:
                some = np.flatnonzero(lower >= 0)
                both = np.stack([source[:, lower[some]], source[:, upper[some]]])
                least, most = both.min(axis=0), both.max(axis=0)
                alike = (least == most) | (least == _ANY)
                common[:, some] = np.maximum(common[:, some], np.where(alike, most, _NONE))
            source, count = common, common.size
            below = np.where(child >= 0, node[:, child], PRUNED).transpose(1, 2, 0, 3).reshape(2, 2, count)
            node = np.arange(count).reshape(common.shape)
            error = np.where(common == _NONE, np.inf, 0.0).ravel()
            cells, visible = cells[np.tile(np.arange(len(cells)), len(common))], replace(nothing, num_cells=count)
            above = ConeBoxes(
                boxes.domain, boxes.negligible, cells, visible, np.maximum(common.ravel(), -1), error, error
            )
            levels.insert(0, BoxLevel(above, np.arange(count, dtype=np.uint64), below))
        return levels


def family_task(first: FamilyFn, domain: Box, limits: Limits, pattern: Pattern) -> FamilyTask:
    """Make the builder for the family to which the oracle ``first`` belongs."""
    # Estimate the number of leaves that the limits allow.
    room = limits.max_bytes - limits.file_size(2, 1, _BITS_OF_SOURCES)
    of_proof = limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
    num_leaves = max(1.0, min(limits.max_leaves, room * 8 / (_BITS_A_LEAF + of_proof)))
    splits = int(np.clip(np.log2(num_leaves / _LEAVES_A_START), 0, min(_MOST_SPLITS, limits.max_depth)))
    upper_cells, halves = [Cells.root(2)], []
    for _ in range(splits):
        axis, parent = (np.repeat(each, 2) for each in np.nonzero(may_halve(upper_cells[-1], limits)))
        is_upper = np.arange(len(parent)) % 2 == 1
        cells = upper_cells[-1][parent].halves(axis, is_upper)
        _, first_half, index = np.unique(cells.hashes(), return_index=True, return_inverse=True)
        halves.append(np.full((2, 2, len(upper_cells[-1])), PRUNED))
        halves[-1][axis, is_upper.astype(int), parent] = index
        upper_cells.append(cells[first_half])
    shared = first.shared_cells(grown_domain(domain), *upper_cells[-1].grown_boxes(domain))
    return FamilyTask(shared, upper_cells, halves, domain, limits, pattern)


def _corners_first(sources: Sources) -> Sources:
    """Return sources in the order of a family's numbers: corners first, the goal last."""
    parents = np.roll(sources.parents - 1, -1) % len(sources.parents)
    return Sources(np.roll(sources.points, -1, axis=0), np.roll(sources.distances, -1), parents)
