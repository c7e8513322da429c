"""Find the best partitions into cone leaves for many goals of one workspace, from samples that all goals share.

These partitions have no proof; ``worst_first.py`` finds partitions with small proven errors.

1. Every box that halving the domain can give gets the cone ``offset + |x - source|`` of least mean error at the box's
   samples (``fit_boxes``).
2. Dynamic programming finds the tree of least error plus a price per leaf that fills the file (``largest_tree``).
3. Leaves change to sources (corners, or the goal) that they see, if errors hardly grow (``change_sources``).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import slices
from plr_jax._types import FamilyFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.best_partition import MAX_ASPECT_BITS, PEAK_WEIGHT
from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.cone.codec import ConeFiles, StoredCones
from plr_jax.plr.leaves.cone.search import ROOM, SHORTFALL, Indices, LeafOptions, change_sources, query_resolution
from plr_jax.plr.leaves.cone.worst_first import WorstFirst
from plr_jax.plr.tree import Cells, Tree, leaf_order, tree_of_axes

_LEAST_HALVINGS, _MOST_HALVINGS = 7, 9  # the grid of samples has 2**halvings samples along each axis
_SAMPLES_A_LEAF = 16  # least number of samples for each expected leaf, unless _MOST_HALVINGS forbids it
# The number of leaves that a file can hold is estimated from these.
_BITS_A_LEAF = 4.4  # bits of a leaf in the file
_BITS_A_SOURCE = 43  # bits of a source in the file
_MOST_OF_SOURCES = 0.85  # largest share of the file that is reserved for sources
_MOST_LEAVES = 8192  # for more expected leaves, the search for one goal finds cones with smaller errors
# Fits of cones to samples.
_SOME_SAMPLES = 64  # samples of a box in its first error estimate; once it becomes a leaf, all are used
_MOST_OPTIONS = 4  # candidates for a leaf's new source, besides its own: the most frequent ones at its samples
_AT_ONCE = 1 << 14  # pairs of a sample and a source whose arrays stay in a core's cache
Shape: TypeAlias = tuple[int, int]  # number of halvings of a box along each axis


@dataclass(frozen=True)
class Lattice:
    """The boxes that come from halving a domain up to ``halvings`` times along each axis, except narrow boxes.

    A box was halved at most ``MAX_ASPECT_BITS`` times more along one axis than along the other. Boxes are numbered
    shape by shape, from large to small, and row by row within a shape. Each smallest box has a sample.
    """

    # For example, the boxes of one halving along each axis, with the first axis downward and the second to the right:
    #
    #     shape (0, 0)   shape (0, 1)   shape (1, 0)   shape (1, 1)
    #      +-------+      +---+---+      +-------+      +---+---+
    #      |       |      |   |   |      |   3   |      | 5 | 6 |
    #      |   0   |      | 1 | 2 |      +-------+      +---+---+
    #      |       |      |   |   |      |   4   |      | 7 | 8 |
    #      +-------+      +---+---+      +-------+      +---+---+
    #
    # Arrays "of boxes" follow these numbers. The smallest boxes come last, in the order of the samples.

    halvings: int

    @cached_property
    def first(self) -> dict[Shape, int]:
        # For each shape, the lowest number of a box of this shape.
        depths = range(self.halvings + 1)
        shapes = sorted(((i, j) for i in depths for j in depths if abs(i - j) <= MAX_ASPECT_BITS), key=sum)
        return dict(zip(shapes, np.cumsum([0, *(1 << sum(s) for s in shapes[:-1])]).tolist(), strict=True))

    @property
    def num_boxes(self) -> int:
        return sum(1 << sum(shape) for shape in self.first)

    def of_shape(self, values: Any, shape: Shape) -> Any:
        # The values of all boxes of one shape, as a view with the axes of the domain: writing to it changes `values`.
        begin = self.first[shape]
        return values[begin : begin + (1 << sum(shape))].reshape(1 << shape[0], 1 << shape[1])

    def halves(self, values: Any, shape: Shape, axis: int) -> Any:
        # The values of the lower and of the upper halves of all boxes of one shape, as two views with an entry for
        # each box; None if the halves are too narrow or too small for the lattice.
        half = shape[0] + (axis == 0), shape[1] + (axis == 1)
        if half not in self.first:
            return None
        of_halves = self.of_shape(values, half)
        return (of_halves[::2], of_halves[1::2]) if axis == 0 else (of_halves[:, ::2], of_halves[:, 1::2])

    @cached_property
    def child(self) -> Int[np.ndarray, "2 boxes 2"]:
        # child[axis, box]: numbers of the lower and upper half of a box along an axis; -1 if the lattice lacks them.
        child = np.full((2, self.num_boxes, 2), -1, np.int32)
        box = np.arange(self.num_boxes, dtype=np.int32)
        for shape, axis in product(self.first, range(2)):
            if halves := self.halves(box, shape, axis):
                begin = self.first[shape]
                child[axis, begin : begin + (1 << sum(shape))] = np.stack(halves, axis=-1).reshape(-1, 2)
        return child

    @cached_property
    def samples(self) -> dict[Shape, tuple[Int[np.ndarray, " boxes"], Int[np.ndarray, " some"]]]:
        # For each shape: the index of the first sample of each box, and what to add to it for up to 64 samples of the
        # box. Sample (row, column) of the grid has the index `row * num_columns + column`.
        samples = {}
        num_columns = 1 << self.halvings
        for shape in self.first:
            size = np.array([1 << (self.halvings - along) for along in shape])  # rows and columns of a box's samples
            count = min(_SOME_SAMPLES, int(size.prod()))
            number = np.arange(count)
            row, column = np.divmod(number, size[1])
            if count < size.prod():
                # Spread samples evenly, as a Hammersley set of 64 points. Along the first axis, point i is the middle
                # of part i of 64; along the second axis, of part r(i), where r reverses the bits of i.
                bits = (number[:, None] >> np.arange(count.bit_length() - 1)) & 1
                reversed_bits = bits @ (count >> np.arange(1, count.bit_length()))
                row, column = ((np.stack([number, reversed_bits]) + 0.5) * (size[:, None] / count)).astype(int)
            first_row, first_column = np.stack(np.divmod(np.arange(1 << sum(shape)), 1 << shape[1])) * size[:, None]
            samples[shape] = first_row * num_columns + first_column, row * num_columns + column
        return samples

    def by_shape(self, box: Int[np.ndarray, " some"]) -> Iterator[tuple[Shape, Int[np.ndarray, " alike"], Any, Any]]:
        """Yield ``(shape, row, first_sample, offset)`` for each shape of the boxes with the indices ``box``.

        A shape is the number of halvings along each axis; the boxes ``box[row]`` have this shape. The samples in box
        ``box[row[i]]`` have the indices ``first_sample[i] + offset``, with one array ``offset`` for all these boxes.
        """
        shape_of_box = np.searchsorted(list(self.first.values()), box, side="right") - 1
        for index, shape in enumerate(self.first):
            if len(row := np.flatnonzero(shape_of_box == index)):
                first_sample = self.samples[shape][0][box[row] - self.first[shape]]
                rows, columns = (np.arange(1 << (self.halvings - along)) for along in shape)
                yield shape, row, first_sample, ((rows[:, None] << self.halvings) + columns).ravel()


class GoalSamples(NamedTuple):
    """The samples of a :class:`Lattice`, one in each of its smallest boxes, with their distances to one goal."""

    # Columns: two coordinates; distance to the goal; weight, the free share of the area of the sample's smallest box.
    # Distance and weight are 0 without a path to the goal.
    table: Float[np.ndarray, "samples 4"]
    source: Int[np.ndarray, " samples"]  # index in `sources` of each path's first turn; -1 without a path
    sources: Sources


def goal_samples(oracle: FamilyFn, shared: Any) -> GoalSamples:
    distance, source = oracle.first_turns(shared)
    has_path = source >= 0
    columns = [np.nan_to_num(shared.x), np.where(has_path, distance, 0.0), np.where(has_path, shared.weight, 0.0)]
    return GoalSamples(np.column_stack(columns), source.astype(np.int32), oracle.sources)


class BoxFits(NamedTuple):
    """The cone ``distance of source + |x - source|`` fitted to each box of a lattice, and its errors at samples.

    A source is a corner or the goal; see :class:`Lattice` for the boxes. The error at a sample is the absolute
    difference between the cone and the sample's distance to the goal.
    """

    goal: GoalSamples
    negligible: float  # largest error up to which a box counts as exact: its errors are then 0
    source: Int[np.ndarray, " boxes"]  # apex of each box's cone, a corner or the goal; -1 if no sample has a path
    integral: Float[np.ndarray, " boxes"]  # of the error over the free area of the box, divided by the domain's area
    largest: Float[np.ndarray, " boxes"]  # largest error at samples with a positive weight
    is_mixed: Bool[np.ndarray, " boxes"]  # whether the samples of a box use several sources
    is_estimated: Bool[np.ndarray, " boxes"]  # whether errors come from only some of the samples of a box

    def evaluate(self, lattice: Lattice, box: Int[np.ndarray, " some"]) -> None:
        # Replace estimated errors of boxes, in place, by the errors at all samples. With k samples in each of the
        # 2**sum(shape) boxes of a shape, a sample stands for 1 / (k * 2**sum(shape)) of the domain's area.
        for shape, row, first_sample, offset in lattice.by_shape(box):
            boxes = box[row]
            error_sum, largest, _ = option_errors(self.goal, first_sample, offset, self.source[boxes])
            counts = largest > self.negligible
            self.integral[boxes] = np.where(counts, error_sum, 0.0) / (len(offset) << sum(shape))
            self.largest[boxes] = np.where(counts, largest, 0.0)
        self.is_estimated[box] = False


def option_errors(
    goal: GoalSamples, start: Indices, offset: Int[np.ndarray, " k"], source: Indices, shortfall: float = np.inf
) -> Float[np.ndarray, "3 options"]:
    """Compute the errors of *options* at samples: an option is a box with the cone of a source.

    Option ``i`` has the samples ``start[i] + offset`` and the source ``source[i]`` (indices). The result has three
    rows: the weighted sum of errors; the largest error; and the weight of samples that a wall hides from the source.
    A sample counts as hidden if its distance to the goal is more than ``shortfall`` above the cone.
    """
    # With the sample x and the source s:  above = distance(x) - (distance(s) + |x - s|),    error = |above|.
    result = np.zeros((3, len(start)))
    for batch in slices(len(start), max(1, _AT_ONCE // len(offset))):
        x, y, distance, weight = np.moveaxis(goal.table[start[batch, None] + offset], 2, 0)
        apex = goal.sources.points[source[batch]]
        dx, dy = x - apex[:, :1], y - apex[:, 1:]
        above = distance - goal.sources.distances[source[batch], None] - np.sqrt(dx * dx + dy * dy)
        error = np.abs(above)
        result[0, batch] = (error * weight).sum(axis=1)
        result[1, batch] = np.max(error * (weight > 0), axis=1)
        if shortfall < np.inf:
            result[2, batch] = ((above > shortfall) * weight).sum(axis=1)
    return result


def fit_boxes(lattice: Lattice, goal: GoalSamples, negligible: float) -> BoxFits:
    """Find each box's best cone among the best cones of its halves; errors up to ``negligible`` count as 0.

    A *mixed* box has samples whose paths use different sources. Its errors are estimated from at most 64 of its
    samples. The cone of any other box is exact at all its samples.
    """
    # 1. The smallest boxes, which are the last ones, have one sample each, whose source they take.
    num, num_samples = lattice.num_boxes, len(goal.source)
    source, lowest, highest = (np.full(num, -1, np.int32) for _ in range(3))
    integral, largest, is_estimated = np.zeros(num), np.zeros(num), np.zeros(num, bool)
    source[-num_samples:] = highest[-num_samples:] = goal.source
    lowest[-num_samples:] = np.where(goal.source < 0, len(goal.sources.points), goal.source)
    for shape in list(lattice.first)[-2::-1]:  # from small to large boxes
        # 2. The lowest and highest index of a source that the samples of a box use follow from those of its halves,
        # along any axis. They differ in a mixed box; a box without a path has `lowest > highest`.
        axes = [axis for axis in range(2) if lattice.halves(source, shape, axis)]
        boxes = slice(lattice.first[shape], lattice.first[shape] + (1 << sum(shape)))
        lattice.of_shape(lowest, shape)[:] = np.minimum(*lattice.halves(lowest, shape, axes[0]))
        lattice.of_shape(highest, shape)[:] = np.maximum(*lattice.halves(highest, shape, axes[0]))
        source[boxes] = highest[boxes]
        # 3. A mixed box tries the sources of its halves along all axes: at most four, each source once.
        mixed = np.flatnonzero(lowest[boxes] < highest[boxes])
        tried = [half.ravel()[mixed] for axis in axes for half in lattice.halves(source, shape, axis)]
        tried = np.sort(np.stack(tried, axis=1), axis=1)
        is_new = tried >= 0
        is_new[:, 1:] &= tried[:, 1:] != tried[:, :-1]
        row, column = np.nonzero(is_new)
        first_sample, offset = lattice.samples[shape]
        errors = np.full((2, *tried.shape), np.inf)  # sum and maximum over samples, by box and source
        errors[:, row, column] = option_errors(goal, first_sample[mixed[row]], offset, tried[row, column])[:2]
        # 4. It takes the source with the least sum of errors.
        best = np.arange(len(mixed)), errors[0].argmin(axis=1)
        error_sum, peak = errors[:, *best]
        counts = peak > negligible
        box = mixed + boxes.start
        source[box] = tried[best]
        integral[box] = np.where(counts, error_sum, 0.0) / (len(offset) << sum(shape))
        largest[box] = np.where(counts, peak, 0.0)
        is_estimated[boxes] = len(offset) << sum(shape) < num_samples  # if not all samples were used
    is_mixed = lowest < highest
    return BoxFits(goal, negligible, source, integral, largest, is_mixed, is_mixed & is_estimated)


class SampledTree(NamedTuple):
    """A tree whose leaves are boxes of a :class:`Lattice`."""

    axes: list[Int[np.ndarray, " _"]]  # split axis of each node, level by level; -1 for a leaf
    box: Int[np.ndarray, " leaves"]  # number of each leaf's box in the lattice, in tree order


def best_tree(lattice: Lattice, costs: Float[np.ndarray, " boxes"], price: float, max_depth: int) -> SampledTree:
    """Return the tree of boxes whose leaves have the least sum of ``costs`` (one per box) plus ``price`` per leaf.

    No leaf comes from more than ``max_depth`` halvings.
    """
    # 1. Dynamic programming from the smallest boxes up: a box costs the least of its cost as a leaf and, for each
    # axis, the sum of the costs of its halves.
    leaf_costs = costs + price
    total = leaf_costs.copy()
    for shape in list(lattice.first)[::-1]:
        if sum(shape) < max_depth:
            least = lattice.of_shape(total, shape)  # a view
            for axis in range(2):
                if halves := lattice.halves(total, shape, axis):
                    np.minimum(least, halves[0] + halves[1], out=least)
    # 2. Walk down from the root, level by level. Of axes with equal costs, the first is halved.
    axes, leaves = [], []
    box = np.zeros(1, np.int64)
    while len(box):
        halves = lattice.child[:, box]  # by axis, box and half; -1 if the lattice lacks them
        split_costs = np.where(halves[:, :, 0] < 0, np.inf, total[halves].sum(axis=2))
        axis = np.where(total[box] < leaf_costs[box], split_costs.argmin(axis=0), -1)
        is_split = axis >= 0
        axes.append(axis)
        leaves.append(box[~is_split])
        box = halves[axis[is_split], is_split].ravel()
    return SampledTree(axes, np.concatenate(leaves)[leaf_order(axes)])


# The search for the price per leaf. Logarithms are natural; the *excess* is the logarithm of the used share of the
# limits, above 0 if a tree exceeds them.
_ATTEMPTS = 10  # prices to try for one goal
_FULL = 0.985  # used share of the limits at which a tree is large enough
# The price is taken to be proportional to share**-rate, with the used share of the limits.
_FIRST_RATE = 3.0
_LEAST_RATE, _MOST_RATE = 1.5, 25.0
_BEYOND = 0.1  # excess at which an extrapolated price aims, on the other side of the limits
_LARGEST_STEP = 8.0  # of the logarithm of an extrapolated price


def largest_tree(lattice: Lattice, fits: BoxFits, files: ConeFiles, limits: Limits, num_leaves: float) -> SampledTree:
    # Search the price per leaf at which the tree of least cost plus prices fills the limits. A lower price gives a
    # larger tree. Estimated errors in `fits` are replaced, in place, where a tree has leaves.
    peak_weight = PEAK_WEIGHT / num_leaves
    largest = SampledTree([np.full(1, -1)], np.zeros(1, np.int64))
    limits.require_room(files.num_bytes(fits.source[:1], limits))
    log_price = float(np.log(max(fits.integral[0] / num_leaves**2, np.finfo(float).tiny)))
    attempts = []  # pairs of the logarithm of the price and the excess
    for _ in range(_ATTEMPTS):
        # 1. Find the best tree for the price, until all errors of its leaves are those at all samples.
        while True:
            tree = best_tree(lattice, fits.integral + peak_weight * fits.largest, np.exp(log_price), limits.max_depth)
            if not len(estimated := tree.box[fits.is_estimated[tree.box]]):
                break
            fits.evaluate(lattice, estimated)
        # 2. Compare it with the limits. Stop if it nearly fills them, or has as many leaves as the largest before.
        num_bytes = files.num_bytes(fits.source[tree.box], limits) * (ROOM + 1) / ROOM
        excess = float(np.log(max(len(tree.box) / limits.max_leaves, num_bytes / limits.max_bytes)))
        is_final = excess <= 0 and len(tree.box) == len(largest.box) and len(attempts) > 1
        if excess <= 0 and len(tree.box) >= len(largest.box):
            largest = tree
        if is_final or np.log(_FULL) <= excess <= 0:
            break
        # 3. With attempts on both sides of the limits, take the excess as linear in log_price between the lowest
        # price that fits and the highest that does not (false position).
        attempts.append((log_price, excess))
        within, beyond = ([attempt for attempt in attempts if (attempt[1] > 0) == side] for side in (False, True))
        if within and beyond:
            (high, below), (low, above) = min(within), max(beyond)
            log_price = high + np.clip(below / (below - above), 0.1, 0.9) * (low - high)
            continue
        # 4. Else extrapolate, from the slope between the last two attempts, to an excess on the other side.
        rate = _FIRST_RATE
        if len(attempts) > 1 and attempts[-2][1] != excess:
            rate = (attempts[-2][0] - log_price) / (excess - attempts[-2][1])
            rate = float(np.clip(rate, _LEAST_RATE, _MOST_RATE))
        log_price += float(np.clip(rate * (excess + np.copysign(_BEYOND, excess)), -_LARGEST_STEP, _LARGEST_STEP))
    return largest


def _options(lattice: Lattice, fits: BoxFits, box: Int[np.ndarray, " leaves"], shortfall: float) -> LeafOptions:
    # Candidates for the source of each mixed leaf: the most frequent sources of its samples, and its present source.
    # Leaf i of a shape and source s have the key i * count + s.
    goal, options = fits.goal, []
    mixed = np.flatnonzero(fits.is_mixed[box])
    count = len(goal.sources.points)
    for shape, row, first_sample, offset in lattice.by_shape(box[mixed]):
        leaf = mixed[row]
        present = fits.source[box[leaf]]
        # 1. Sort the sources of the samples by leaf, then from the most frequent down; keep the first few.
        leaf_key = count * np.arange(len(leaf))
        used = goal.source[first_sample[:, None] + lattice.samples[shape][1]]
        key, frequency = np.unique((leaf_key[:, None] + used)[used >= 0], return_counts=True)
        key = key[np.lexsort((-frequency, key // count))]
        rank = np.arange(len(key)) - np.searchsorted(key // count, key // count)
        key = np.unique(np.append(key[rank < _MOST_OPTIONS], leaf_key + present))
        # 2. Compare each pair of a leaf and a source with the samples.
        index, source = np.divmod(key, count)
        error_sum, largest, hidden = option_errors(goal, first_sample[index], offset, source, shortfall)
        weight = np.maximum(goal.table[first_sample[:, None] + offset, 3].sum(axis=1), np.finfo(float).tiny)[index]
        errors = hidden == 0, error_sum / weight, hidden / weight, largest, error_sum
        options.append((leaf[index], source, *errors, weight / (len(offset) << sum(shape))))
    return LeafOptions(*map(np.concatenate, zip(*options, strict=True)))


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """A function that builds trees of cone leaves for distances to goals in one workspace, one goal at a time."""

    shared: Any
    lattice: Lattice
    domain: Box
    limits: Limits
    num_leaves: float
    goals_at_once: ClassVar[int] = 1

    def __call__(self, oracles: Sequence[FamilyFn]) -> tuple[list[tuple[Tree, StoredCones] | None], None]:
        """Return ``([(tree, leaves)], None)``, with the largest tree within the limits.

        ``oracles`` has one distance function. If no sample has a path to the goal, return ``([None], None)``. The
        last None stands where :class:`WorstFirst` returns the sources of all leaves.
        """
        (oracle,) = oracles
        goal = goal_samples(oracle, self.shared)
        if (goal.source < 0).all():
            return [None], None
        fits = fit_boxes(self.lattice, goal, query_resolution(goal.table[:, 2]))
        files = ConeFiles(oracle.sources, self.domain)
        tree = largest_tree(self.lattice, fits, files, self.limits, self.num_leaves)
        source = fits.source[tree.box]
        if fits.is_mixed[tree.box].any():
            options = _options(self.lattice, fits, tree.box, SHORTFALL * float(self.domain.width.max()))
            total, most = float(fits.integral[tree.box].sum()), float(fits.largest[tree.box].max())
            source = change_sources(source, options, total, most, partial(files.fit, self.limits))
        return [(tree_of_axes(tree.axes, 2), files.stored(source))], None


def family_task(first: FamilyFn, domain: Box, limits: Limits) -> FamilyTask | WorstFirst | None:
    """Return a builder of cone leaves for the goals of one family; None if the limits allow too many leaves.

    ``first`` is the distance function to one of the goals.
    """
    # 1. Estimate the number of leaves that the limits allow.
    bits = max(limits.max_bytes - limits.file_size(2, 1, 0), 0) * 8
    of_sources = min(_BITS_A_SOURCE * len(first.sources.points), _MOST_OF_SOURCES * bits)
    proof_bits_a_leaf = limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
    num_leaves = max(1.0, min(float(limits.max_leaves), (bits - of_sources) / (_BITS_A_LEAF + proof_bits_a_leaf)))
    if num_leaves > _MOST_LEAVES:
        return None
    if limits.proof is not Proof.NONE:
        return WorstFirst(domain, limits, num_leaves)
    # 2. Take a sample in each cell of a grid, numbered row by row as the smallest boxes of the lattice are.
    halvings = max(_LEAST_HALVINGS, int(np.ceil(np.log2(_SAMPLES_A_LEAF * num_leaves) / 2)))
    halvings = min(halvings, _MOST_HALVINGS, limits.max_axis_depth)
    position = np.stack(np.divmod(np.arange(1 << 2 * halvings), 1 << halvings), axis=1)
    cells = Cells(np.full(position.shape, halvings), position)
    return FamilyTask(first.shared_samples(*cells.boxes(domain)), Lattice(halvings), domain, limits, num_leaves)
