"""Find the best partitions into cone leaves for many goals of one workspace, from samples that all goals share.

These partitions have no proof; ``worst_first.py`` finds partitions with small proven errors.

1. Every dyadic box gets the cone ``offset + |x - source|`` of least mean error at its samples (``fit_boxes``).
2. Dynamic programming finds the tree of least error plus a price per leaf that fills the file (``_largest_tree``).
3. Leaves change to sources (corners, or the goal) that they see, if errors hardly grow (``change_sources``).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import FamilyFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.best_partition import MAX_ASPECT_BITS, PEAK_WEIGHT
from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.cone.codec import ConeFiles, StoredCones
from plr_jax.plr.leaves.cone.search import LEAST_SHORTFALL, LeafOptions, change_sources, query_resolution
from plr_jax.plr.leaves.cone.worst_first import WorstFirst
from plr_jax.plr.tree import Cells, Tree, leaf_order, tree_of_axes

_LEAST_HALVINGS, _MOST_HALVINGS = 7, 9  # of the grid of samples, along each axis
_SAMPLES_A_LEAF = 16  # least number of samples for each expected leaf
_MOST_LEAVES = 8192  # for more leaves, the search for one goal finds cones with smaller errors
_BITS_A_LEAF, _BITS_A_SOURCE = 4.4, 43  # estimates, from which the number of leaves follows
_MOST_OF_SOURCES = 0.85  # largest share of the file that this estimate leaves to sources
_SOME_SAMPLES = 64  # samples of a box in its first error estimate; once it becomes a leaf, all are used
_MOST_OPTIONS = 4  # candidates for a leaf's new source, besides its own: the most frequent ones at its samples
_AT_ONCE = 1 << 14  # pairs of a sample and a source whose arrays stay in a core's cache
Shape: TypeAlias = tuple[int, int]
"""Number of halvings of a box along each axis."""


@dataclass(frozen=True)
class Lattice:
    """The boxes that come from halving a domain up to ``halvings`` times along each axis, except narrow boxes.

    A box was halved at most ``MAX_ASPECT_BITS`` times more along one axis than along the other. Boxes are numbered
    from large to small, and row by row if their shapes are equal. Each smallest box has a sample.
    """

    halvings: int

    @cached_property
    def first(self) -> dict[Shape, int]:
        # For each shape, the lowest number of a box of this shape.
        depths = range(self.halvings + 1)
        shapes = [(i, j) for i in depths for j in depths if abs(i - j) <= MAX_ASPECT_BITS]
        shapes.sort(key=sum)
        return dict(zip(shapes, np.cumsum([0, *(1 << sum(s) for s in shapes[:-1])]).tolist(), strict=True))

    @property
    def num_boxes(self) -> int:
        return sum(1 << sum(shape) for shape in self.first)

    def of_shape(self, values: Any, shape: Shape) -> Any:
        # The values of all boxes of one shape, as a view with the axes of the domain.
        begin = self.first[shape]
        return values[begin : begin + (1 << sum(shape))].reshape(1 << shape[0], 1 << shape[1])

    def halves(self, values: Any, shape: Shape, axis: int) -> Any:
        # The values of the lower and upper halves of all boxes of one shape; None if these are too narrow.
        half = shape[0] + (axis == 0), shape[1] + (axis == 1)
        if half not in self.first:
            return None
        of_halves = self.of_shape(values, half)
        return (of_halves[::2], of_halves[1::2]) if axis == 0 else (of_halves[:, ::2], of_halves[:, 1::2])

    @cached_property
    def child(self) -> Int[np.ndarray, "2 boxes 2"]:
        # The lower and upper half of each box along each axis; -1 if the lattice does not have them.
        child, box = np.full((2, self.num_boxes, 2), -1, np.int32), np.arange(self.num_boxes, dtype=np.int32)
        for shape, axis in product(self.first, range(2)):
            if halves := self.halves(box, shape, axis):
                begin = self.first[shape]
                child[axis, begin : begin + (1 << sum(shape))] = np.stack(halves, axis=-1).reshape(-1, 2)
        return child

    @cached_property
    def samples(self) -> dict[Shape, tuple[Int[np.ndarray, " boxes"], Int[np.ndarray, " some"]]]:
        # For each shape: the index of the first sample of each box, and what to add for up to 64 of its samples.
        samples, row = {}, 1 << self.halvings
        for shape in self.first:
            size = np.array([1 << (self.halvings - along) for along in shape])
            count = min(_SOME_SAMPLES, int(size.prod()))
            place = np.stack(np.divmod(np.arange(count), size[1]))
            if count < size.prod():
                bits = (np.arange(count)[:, None] >> np.arange(count.bit_length() - 1)) & 1
                reversed_bits = bits @ (count >> np.arange(1, count.bit_length()))
                place = ((np.stack([np.arange(count), reversed_bits]) + 0.5) * (size[:, None] / count)).astype(int)
            box = np.stack(np.divmod(np.arange(1 << sum(shape)), 1 << shape[1])) * size[:, None]
            samples[shape] = box[0] * row + box[1], place[0] * row + place[1]
        return samples

    def by_shape(self, box: Int[np.ndarray, " some"]) -> Iterator[tuple[Shape, Int[np.ndarray, " alike"], Any, Any]]:
        """Group boxes by shape: yield a shape, the rows of ``box`` of this shape, and the indices of their samples.

        These indices are the sum of each box's first sample and of offsets that all boxes of a shape share.
        """
        starts, shapes = np.array(list(self.first.values())), list(self.first)
        of_shape = np.searchsorted(starts, box, side="right") - 1
        for index in np.unique(of_shape):
            place, shape = np.flatnonzero(of_shape == index), shapes[index]
            first_sample = self.samples[shape][0][box[place] - starts[index]]
            rows, columns = (np.arange(1 << (self.halvings - along)) for along in shape)
            offsets_of_samples = ((rows[:, None] << self.halvings) + columns).ravel()
            yield shape, place, first_sample, offsets_of_samples


class GoalSamples(NamedTuple):
    """The samples of a lattice with their distances to one goal."""

    table: Float[np.ndarray, "samples 4"]  # two coordinates, distance to the goal, and weight
    source: Int[np.ndarray, " samples"]  # index in `sources` of each path's first turn; -1 without a path
    sources: Sources


def goal_samples(oracle: FamilyFn, shared: Any) -> GoalSamples:
    distance, source = oracle.first_turns(shared)
    reached = source >= 0
    columns = [np.nan_to_num(shared.x), np.where(reached, distance, 0.0), np.where(reached, shared.weight, 0.0)]
    return GoalSamples(np.column_stack(columns), source.astype(np.int32), oracle.sources)


@dataclass(frozen=True, eq=False)
class BoxFits:
    """The cone ``distance of source + |x - source|`` fitted to each box of a lattice, and its errors at samples."""

    goal: GoalSamples
    negligible: float  # largest error up to which a box counts as exact
    source: Int[np.ndarray, " boxes"]  # apex of each box's cone, a corner or the goal; -1 if no sample has a path
    integral: Float[np.ndarray, " boxes"]  # of the error over the box, divided by the area of the domain
    largest: Float[np.ndarray, " boxes"]
    is_mixed: Bool[np.ndarray, " boxes"]  # whether the samples of a box use several sources
    is_estimated: Bool[np.ndarray, " boxes"]  # whether errors come from only some of the samples of a box

    def evaluate(self, lattice: Lattice, box: Int[np.ndarray, " some"]) -> None:
        # Replace estimated errors of boxes by the errors at all samples.
        for shape, place, first, offset in lattice.by_shape(box):
            boxes = box[place]
            total, largest, _ = option_errors(self.goal, first, offset, self.source[boxes])
            counts = largest > self.negligible
            self.integral[boxes] = np.where(counts, total, 0.0) / (len(offset) << sum(shape))
            self.largest[boxes] = np.where(counts, largest, 0.0)
        self.is_estimated[box] = False


def option_errors(
    goal: GoalSamples,
    first: Int[np.ndarray, " options"],
    offset: Int[np.ndarray, " k"],
    source: Int[np.ndarray, " options"],
    shortfall: float = np.inf,
) -> Float[np.ndarray, "3 options"]:
    # Compare distances at samples ``first[i] + offset`` with the way straight to ``source[i]`` and on to the goal.
    # Rows: weighted sums and maxima of errors, and the weight of samples whose distance is ``shortfall`` longer.
    result, at_once = np.zeros((3, len(first))), max(1, _AT_ONCE // len(offset))
    for begin in range(0, len(first), at_once):
        batch = slice(begin, begin + at_once)
        x, y, distance, weight = np.moveaxis(goal.table[first[batch, None] + offset], 2, 0)
        point = goal.sources.points[source[batch]]
        dx, dy = x - point[:, :1], y - point[:, 1:]
        above = distance - goal.sources.distances[source[batch], None] - np.sqrt(dx * dx + dy * dy)
        error = np.abs(above)
        result[0, batch], result[1, batch] = (error * weight).sum(axis=1), np.max(error * (weight > 0), axis=1)
        if shortfall < np.inf:
            result[2, batch] = ((above > shortfall) * weight).sum(axis=1)
    return result


def fit_boxes(lattice: Lattice, goal: GoalSamples, negligible: float) -> BoxFits:
    """Find each box's best cone among the best cones of its halves; errors up to ``negligible`` count as 0."""
    num = lattice.num_boxes
    # The least and the most index of a source that the samples of each box use: they differ in a mixed box.
    source, least, most = (np.full(num, -1, np.int32) for _ in range(3))
    integral, largest, is_estimated = np.zeros(num), np.zeros(num), np.zeros(num, bool)
    source[-len(goal.source) :] = most[-len(goal.source) :] = goal.source  # the smallest boxes are the last
    least[-len(goal.source) :] = np.where(goal.source < 0, len(goal.sources.points), goal.source)
    for shape in list(lattice.first)[-2::-1]:
        halves = [axis for axis in range(2) if lattice.halves(source, shape, axis)]
        boxes = slice(lattice.first[shape], lattice.first[shape] + (1 << sum(shape)))
        lattice.of_shape(least, shape)[:] = np.minimum(*lattice.halves(least, shape, halves[0]))
        lattice.of_shape(most, shape)[:] = source_here = np.maximum(*lattice.halves(most, shape, halves[0]))
        lattice.of_shape(source, shape)[:] = source_here
        mixed = np.flatnonzero(least[boxes] < most[boxes])
        tried = [half.ravel()[mixed] for axis in halves for half in lattice.halves(source, shape, axis)]
        tried = np.sort(np.stack(tried, axis=1), axis=1)
        is_new = tried >= 0
        is_new[:, 1:] &= tried[:, 1:] != tried[:, :-1]
        box, column = np.nonzero(is_new)
        first, offset = lattice.samples[shape]
        of_option = np.full((2, *tried.shape), np.inf)
        of_option[:, box, column] = option_errors(goal, first[mixed[box]], offset, tried[box, column])[:2]
        best = of_option[0].argmin(axis=1)
        row, place = np.arange(len(mixed)), mixed + boxes.start
        source[place] = tried[row, best]
        mean, worst = of_option[:, row, best]
        counts = worst > negligible
        integral[place] = np.where(counts, mean, 0.0) / (len(offset) << sum(shape))
        largest[place] = np.where(counts, worst, 0.0)
        is_estimated[boxes] = len(offset) << sum(shape) < len(goal.source)
    is_mixed = least < most
    return BoxFits(goal, negligible, source, integral, largest, is_mixed, is_mixed & is_estimated)


class SampledTree(NamedTuple):
    """A tree whose leaves are boxes of a :class:`Lattice`."""

    axes: list[Int[np.ndarray, " _"]]  # split axis of each node, level by level; -1 for a leaf
    box: Int[np.ndarray, " leaves"]  # number of each leaf's box in the lattice, in tree order


def best_tree(lattice: Lattice, costs: Float[np.ndarray, " boxes"], price: float, max_depth: int) -> SampledTree:
    """Return the tree of boxes whose leaves have the least sum of ``costs`` (one per box) plus ``price`` per leaf."""
    total, choice = costs + price, np.full(len(costs), -1, np.int8)
    for shape in list(lattice.first)[::-1]:
        if sum(shape) < max_depth:
            here, axis_here = lattice.of_shape(total, shape), lattice.of_shape(choice, shape)
            for axis in range(2):
                if halves := lattice.halves(total, shape, axis):
                    split_cost = halves[0] + halves[1]
                    cheaper = split_cost < here
                    here[cheaper], axis_here[cheaper] = split_cost[cheaper], axis
    axes, leaves, here = [], [], np.zeros(1, np.int64)
    while len(here):
        axis = choice[here].astype(np.int64)
        is_leaf = axis < 0
        axes.append(axis)
        leaves.append(here[is_leaf])
        here = lattice.child[axis[~is_leaf], here[~is_leaf]].ravel()
    return SampledTree(axes, np.concatenate(leaves)[leaf_order(axes)])


_ATTEMPTS, _FULL = 10, 0.985  # prices to try for one goal; used share of the limits at which a tree is large enough
_ROOM = 64  # one byte in this many is reserved for changes to visible sources
_FIRST_RATE, _LEAST_RATE, _MOST_RATE = 3.0, 1.5, 25.0  # price ~ size of the file**-rate
_BEYOND, _LARGEST_STEP = 0.1, 8.0  # an extrapolated price aims beyond the limits; steps of logarithms of the price


def _largest_tree(
    lattice: Lattice, fits: BoxFits, files: ConeFiles, limits: Limits, num_leaves: float
) -> SampledTree:
    # Search the price per leaf at which the tree of least cost plus prices fills the limits.
    peak_weight = PEAK_WEIGHT / num_leaves
    largest = SampledTree([np.full(1, -1)], np.zeros(1, np.int64))
    limits.require_room(files.num_bytes(fits.source[:1], limits))
    price, attempts = float(np.log(max(fits.integral[0] / num_leaves**2, np.finfo(float).tiny))), []
    for _ in range(_ATTEMPTS):
        while True:
            tree = best_tree(lattice, fits.integral + peak_weight * fits.largest, np.exp(price), limits.max_depth)
            estimated = tree.box[fits.is_estimated[tree.box]]
            if not len(estimated):
                break
            fits.evaluate(lattice, estimated)
        num_bytes = files.num_bytes(fits.source[tree.box], limits) * (_ROOM + 1) / _ROOM
        excess = float(np.log(max(len(tree.box) / limits.max_leaves, num_bytes / limits.max_bytes)))
        is_final = excess <= 0 and len(tree.box) == len(largest.box) and len(attempts) > 1
        if excess <= 0 and len(tree.box) >= len(largest.box):
            largest = tree
        if is_final or np.log(_FULL) <= excess <= 0:
            break
        # Interpolate between the prices of the best tree that fits and the one that does not, or extrapolate.
        attempts.append((price, excess))
        within, beyond = ([attempt for attempt in attempts if (attempt[1] > 0) == side] for side in (False, True))
        if within and beyond:
            (high, below), (low, above) = min(within), max(beyond)
            price = high + np.clip(below / (below - above), 0.1, 0.9) * (low - high)
        else:
            rate = _FIRST_RATE
            if len(attempts) > 1 and attempts[-2][1] != excess:
                rate = float(np.clip((attempts[-2][0] - price) / (excess - attempts[-2][1]), _LEAST_RATE, _MOST_RATE))
            step = rate * (excess + np.copysign(_BEYOND, excess))
            price += float(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))
    return largest


def _options(lattice: Lattice, fits: BoxFits, box: Int[np.ndarray, " leaves"], shortfall: float) -> LeafOptions:
    # Candidates for each leaf's source: the sources of most of its samples, and its present source.
    goal, options, mixed = fits.goal, [], np.flatnonzero(fits.is_mixed[box])
    count = len(goal.sources.points)
    for shape, place, first, offset in lattice.by_shape(box[mixed]):
        leaf, now, index = mixed[place], fits.source[box[mixed[place]]], np.arange(len(place))
        used = goal.source[first[:, None] + lattice.samples[shape][1]]
        key, frequency = np.unique((index[:, None] * count + used)[used >= 0], return_counts=True)
        key = key[np.lexsort((-frequency, key // count))]
        key = key[np.arange(len(key)) - np.searchsorted(key // count, key // count) < _MOST_OPTIONS]
        row, source = np.divmod(np.unique(np.append(key, index * count + now)), count)
        integral, largest, hidden = option_errors(goal, first[row], offset, source, shortfall)
        size = np.maximum(goal.table[first[:, None] + offset, 3].sum(axis=1), np.finfo(float).tiny)[row]
        mean, total = integral / size, len(offset) << sum(shape)
        options.append(
            (leaf[row], source, source == now[row], hidden == 0, mean, hidden / size, largest, integral, size / total)
        )
    return LeafOptions(*map(np.concatenate, zip(*options, strict=True)))


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """A function that builds trees of cone leaves for distances to goals in one workspace, one goal at a time."""

    shared: Any
    lattice: Lattice
    files: ConeFiles
    domain: Box
    limits: Limits
    num_leaves: float
    goals_at_once: ClassVar[int] = 1

    def __call__(self, oracles: Sequence[FamilyFn]) -> tuple[list[tuple[Tree, StoredCones] | None], None]:
        """Return the largest tree within the limits and its leaves, None without a path; and no sources of leaves."""
        (oracle,) = oracles
        goal = goal_samples(oracle, self.shared)
        if (goal.source < 0).all():
            return [None], None
        fits = fit_boxes(self.lattice, goal, query_resolution(goal.table[:, 2]))
        files = self.files.of_goal(oracle.sources)
        tree = _largest_tree(self.lattice, fits, files, self.limits, self.num_leaves)
        source, total, most = fits.source[tree.box], fits.integral[tree.box].sum(), fits.largest[tree.box].max()
        if fits.is_mixed[tree.box].any():
            shortfall = LEAST_SHORTFALL * float(self.domain.width.max())
            options = _options(self.lattice, fits, tree.box, shortfall)
            source = change_sources(source, options, float(total), float(most), partial(files.fit, self.limits))
        return [(tree_of_axes(tree.axes, 2), files.stored(source))], None


def family_task(first: FamilyFn, domain: Box, limits: Limits) -> FamilyTask | WorstFirst | None:
    """Return a builder of cone leaves for goals in ``first``'s workspace; None if limits allow too many leaves."""
    # Estimate the number of leaves that the limits allow.
    bits = max(limits.max_bytes - limits.file_size(2, 1, 0), 0) * 8
    of_sources = min(_BITS_A_SOURCE * len(first.sources.points), _MOST_OF_SOURCES * bits)
    of_proof = limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
    num_leaves = max(1.0, min(float(limits.max_leaves), (bits - of_sources) / (_BITS_A_LEAF + of_proof)))
    if num_leaves > _MOST_LEAVES:
        return None
    if limits.proof is not Proof.NONE:
        return WorstFirst(domain, limits, num_leaves)
    halvings = max(_LEAST_HALVINGS, int(np.ceil(np.log2(_SAMPLES_A_LEAF * num_leaves) / 2)))
    halvings = min(halvings, _MOST_HALVINGS, limits.max_axis_depth)
    place = np.stack(np.divmod(np.arange(1 << 2 * halvings), 1 << halvings), axis=1)
    cells = Cells(np.full(place.shape, halvings), place)
    shared, files = first.shared_samples(*cells.boxes(domain)), ConeFiles(first.sources, domain)
    return FamilyTask(shared, Lattice(halvings), files, domain, limits, num_leaves)
