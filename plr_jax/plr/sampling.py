"""Sample a distance function in cells, fit a plane to the samples of each cell, and run tasks on parallel workers."""

from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_distances, as_numbers, as_values, batches, row_products
from plr_jax._progress import Progress
from plr_jax._types import BoxTest, DistanceFn, Distances, Points, Reach, ReachFn
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.folding import Folding
from plr_jax.plr.source_cache import SourceCache, distances_in_cells
from plr_jax.plr.tree import Cells, Rows, corner_bits

# What cones and proofs need, for messages.
NEEDED = "a function in the plane that answers for whole cells: VisibilityGraph, or NearestGoal of these (not nested)"
# The longest side of a cell is at most 2**3 times its shortest, in fractions of the domain. That suffices for thin
# walls, and stops cells that lie mostly in an obstacle from being halved forever along one axis.
MAX_ASPECT_BITS = 3
_RANK_TOLERANCE = 1e-9  # relative size of singular values that count as zero
_FACE_WEIGHT = 0.01  # weight of samples on faces and corners, which hardly change fits; inside it is 1
_SAMPLES_PER_TERM = 2  # up to this many samples per coefficient that reach the goal, a plane may fit by chance
_POINTS_OF_TASK = 1024  # points that a parallel worker evaluates at once, whatever the number of workers
_FINE_DEPTH = 5  # halvings along each axis after which a cell is small enough to be judged by few samples


@dataclass(frozen=True, eq=False)
class Pattern:
    """The positions and weights of the samples in a cell, the same for all cells.

    Positions are local coordinates ``u``, from -1 to 1 across the cell along each axis. The first sample is the
    center. Samples may also lie beyond the cell.
    """

    u: Float[np.ndarray, "k dim"]
    weight: Float[np.ndarray, " k"]

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def design(self) -> Float[np.ndarray, "k terms"]:
        """Matrix ``[1 u]`` that maps a plane (center value, half of its rise along each axis) to sample values."""
        return np.concatenate([np.ones((len(self), 1)), self.u], axis=1)

    @cached_property
    def pseudo_inverse(self) -> Float[np.ndarray, "terms k"]:
        """Matrix that maps sample values to their weighted least-squares plane.

        A plane is its center value, then half of its rise across the cell along each axis.
        """
        root = np.sqrt(self.weight)
        return np.linalg.pinv(self.design * root[:, None]) * root

    @cached_property
    def halves(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        """For each axis, the design matrix of two separate planes, in the lower and in the upper half of a cell.

        The first ``1 + dim`` columns are for the lower half, the others for the upper half.
        """
        uppers = [self.u[:, axis, None] > 0 for axis in range(self.u.shape[1])]
        return [np.concatenate([self.design * ~upper, self.design * upper], axis=1) for upper in uppers]

    @cached_property
    def halves_bases(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        # Let W be the diagonal matrix of the weights, and the columns of U an orthonormal basis of all W^(1/2) f for
        # functions f that are a plane in either half of a cell. Two planes reduce the weighted sum of squares,
        # |W^(1/2) residual|**2, by |U' W^(1/2) residual|**2. This is |residual @ basis|**2 with the basis W^(1/2) U.
        root = np.sqrt(self.weight)[:, None]
        bases = []
        for design in self.halves:
            orthonormal, size, _ = np.linalg.svd(design * root, full_matrices=False)
            bases.append(root * orthonormal * (size > _RANK_TOLERANCE * size[0]))
        return bases


@lru_cache(maxsize=8)
def sample_pattern(dim: int, num_samples: int, margin: int | float, seed: int) -> Pattern:
    """Make a pattern of samples in a cell: its center, points inside and points on its faces.

    The corners are samples, too, if they are at most 1/4 of all samples. About 1/3 of all samples are on faces, to
    detect slivers of free space behind walls. With a ``margin`` above 0, samples are spread over a larger box, which
    extends beyond the cell by ``margin`` times its width on every side.
    """
    rng = np.random.default_rng(seed)
    corners = 2.0 * corner_bits(dim) - 1 if 4 * 2**dim <= num_samples else np.zeros((0, dim))
    per_face = num_samples // (6 * dim)
    sides = [(axis, side) for axis in range(dim) for side in (-1.0, 1.0)]
    faces = [np.insert(2 * lattice(per_face, rng.random(dim - 1)) - 1, *side, axis=1) for side in sides]
    num_inside = num_samples - 1 - len(corners) - len(faces) * per_face
    inside = 2 * lattice(num_inside, rng.random(dim)) - 1
    u = np.concatenate([np.zeros((1, dim)), inside, corners, *faces]) * (1 + 2 * margin)  # the center is the first
    return Pattern(u, np.repeat([1.0, _FACE_WEIGHT], [1 + num_inside, len(u) - 1 - num_inside]))


def lattice(num_points: int, shift: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "num_points dim"]:
    """Return evenly spread points in the unit cube, moved by ``shift`` modulo 1; in 2-D, a Fibonacci lattice."""
    # Steps are equal along the first axis; along other axes, they are the steps of Roberts' R sequence.
    dim, root = len(shift), 1.0
    for _ in range(64 if dim > 1 else 0):  # root ** dim == root + 1: the golden ratio in the plane
        root = (1 + root) ** (1 / dim)
    steps = np.concatenate([[1 / max(num_points, 1)], root ** -np.arange(1.0, dim)])[:dim]
    return (shift + np.arange(num_points)[:, None] * steps) % 1


# COMPUTECOEFFICIENTS of Algorithm 1: batched least squares for planes ``center + half . u`` in local coordinates
# ``u``. Cells whose samples all reach the goal have the same design matrix and share one pseudo-inverse.

# Ridge on the slope, relative to the sum W of the weights: the slope becomes zero along directions in which no sample
# varies. The ridge exceeds rounding errors of the normal matrix: these are below 2**16 * 9 * 2**-53 W < 1e-10 W in
# sums over at most 2**16 samples with coordinates of at most 3. It is far below W / 3, the matrix's eigenvalue for
# slopes if samples are spread evenly, so it changes such a fit by less than 1e-8.
_RIDGE = 1e-9
OfSamples: TypeAlias = Float[np.ndarray, "cells k"]
OfTerms: TypeAlias = Float[np.ndarray, "cells terms"]
Planes: TypeAlias = tuple[Float[np.ndarray, " cells"], Float[np.ndarray, "cells dim"]]
FitRule: TypeAlias = Callable[[Pattern, OfSamples, OfSamples], Planes]  # called like :func:`least_squares`


def least_squares(pattern: Pattern, value: OfSamples, weight: OfSamples) -> Planes:
    """Fit each cell's plane by weighted least squares, which gives small mean errors (Section III-A of the paper).

    The weight of a sample is the pattern's weight times ``weight``. If the samples of positive weight do not
    determine the plane, the slope has the least norm. So a single sample gives a constant plane, and no sample gives
    the plane 0.

    Args:
        pattern: The sample pattern.
        value: Distance at each sample of each cell, ``(cells, k)``, finite.
        weight: Weight of each sample, ``(cells, k)``, >= 0; 0 where the goal cannot be reached.

    Returns:
        Values at cell centers ``(cells,)``, and half of the rise across each cell along each axis ``(cells, dim)``.
    """
    plane = row_products(value, pattern.pseudo_inverse.T)
    if len(masked := np.flatnonzero((weight != 1).any(axis=1))):
        design, weight = pattern.design, weight[masked] * pattern.weight
        plane[masked] = solve_planes(design, weight, row_products(weight * value[masked], design))
    return plane[:, 0], plane[:, 1:]


def solve_planes(design: Float[np.ndarray, "k terms"], weight: OfSamples, projection: OfTerms) -> OfTerms:
    # Solve the normal equations of each cell, (D' W D + ridge) plane = projection = D' W value, with the design D and
    # the diagonal matrix W of the weights. The first column of D is 1. If all weights are 0, so is the plane.
    k, terms = design.shape
    products = (design[:, :, None] * design[:, None, :]).reshape(k, terms * terms)
    normal = row_products(weight, products).reshape(-1, terms, terms)
    total = normal[:, :1, 0]  # sum of the weights
    ridge = _RIDGE * total * (np.arange(terms) > 0) + (total == 0)  # none on the center value
    normal[:, range(terms), range(terms)] += ridge
    return np.linalg.solve(normal, projection[..., None])[..., 0]


WeightFn = Callable[[Points], Float[np.ndarray, " n"]]


def few_samples(dim: int) -> int:
    return _SAMPLES_PER_TERM * (1 + dim)


@dataclass(frozen=True, eq=False)
class CellFit(Rows):
    """Samples of a batch of cells and the plane fitted to each cell.

    Attributes:
        pattern: The sample pattern; its first sample is the center.
        max_axis_depth: Largest number of halvings of a cell along one axis.
        reachable: Whether the goal can be reached from each sample, ``(cells, k)``.
        weight: Error weight of each sample (``weight_fn``, or 1); 0 where the goal cannot be reached.
        value: Sampled distance; 0 where the goal cannot be reached.
        center: Value of the plane at the cell's center; ``inf`` for a cell without a sample that reaches the goal.
        half: Half of the plane's rise across the cell along each axis, ``(cells, dim)``.
        residual: Sampled distance minus the cell's function (the plane, unless the leaf model fits another function);
            0 where the goal cannot be reached.
        urgent_axis: Axis along which to halve an *urgent* cell, whose samples do not show its error; -1 for other
            cells. A cell is urgent in two cases. Case 1: it holds points that reach the goal, and, far from all such
            points, free points that do not (see :class:`Reach`). Case 2: the cell is large, few of its samples
            reach the goal, and only a small part of the domain reaches the goal.
        is_cut_off: Whether each cell holds free points that do not reach the goal, and no point that does.
    """

    cells: Cells
    pattern: Pattern
    max_axis_depth: int
    reachable: Bool[np.ndarray, "cells k"]
    weight: OfSamples
    value: OfSamples
    center: Float[np.ndarray, " cells"]
    half: Float[np.ndarray, "cells dim"]
    residual: OfSamples
    urgent_axis: Int[np.ndarray, " cells"]
    is_cut_off: Bool[np.ndarray, " cells"]

    @cached_property
    def masked(self) -> Int[np.ndarray, "masked"]:
        """Indices of the cells with a sample whose weight is not 1, such as one that does not reach the goal."""
        return np.flatnonzero((self.weight != 1).any(axis=1))

    @property
    def is_hardly_seen(self) -> Bool[np.ndarray, " cells"]:
        """Whether so few samples of a cell reach the goal that a plane may fit them all and be wrong elsewhere."""
        return self.reachable.sum(axis=1) <= few_samples(self.cells.dim)

    @property
    def noise(self) -> Float[np.ndarray, " cells"]:
        """The weighted error of each cell that no split can reduce: the resolution of 32-bit floats."""
        return np.finfo(np.float32).eps * np.abs(self.value).max(axis=1) * self.weight.max(axis=1)


@dataclass(frozen=True, eq=False)
class Sampler:
    """A function that samples the distance in cells and fits a plane to the samples of each cell."""

    distance_fn: DistanceFn
    domain: Box
    weight_fn: WeightFn | None
    pattern: Pattern
    dense_pattern: Pattern  # for cells where few samples reach the goal
    max_axis_depth: int
    compute_coefficients: FitRule = least_squares
    cache: SourceCache | None = None  # if known: samples in cells take distances from sources, which is faster
    reach: Reach | None = None  # if known
    is_sparse: bool = False  # whether little of the domain reaches the goal

    def __call__(self, cells: Cells) -> CellFit:
        """Sample the distance in cells; fit a plane to those samples of each cell from which the goal is reached."""
        pattern = self.pattern
        points = cells.points(pattern.u, self.domain)
        if reaches_beyond := (np.abs(pattern.u) > 1).any():
            points = self.domain.wrapped(points)
        x = points.reshape(-1, cells.dim)
        if self.cache is None or reaches_beyond:  # the cache is for points inside of the cells
            distance = call_oracle(self.distance_fn, x).reshape(len(cells), len(pattern))
        else:
            distance = distances_in_cells(self.cache.sources(cells), points)
        reachable = np.isfinite(distance)
        weight = reachable.astype(np.float64)
        if self.weight_fn is not None:
            weight *= call_weights(self.weight_fn, x).reshape(weight.shape)
        value = np.where(reachable, distance, 0.0)
        center, half = self.compute_coefficients(pattern, value, weights_of_fit(reachable, weight))
        _check_planes(center, half, cells)
        residual = value - (center[:, None] + row_products(half, pattern.u.T))
        residual *= reachable
        center = np.where(reachable.any(axis=1), center, np.inf)
        samples = reachable, weight, value
        urgent_axis = self._urgent_axes(cells, reachable.sum(axis=1))
        is_cut_off = np.zeros(len(cells), bool) if self.reach is None else self.reach.is_cut_off(*cells.fractions)
        return CellFit(cells, pattern, self.max_axis_depth, *samples, center, half, residual, urgent_axis, is_cut_off)

    def _urgent_axes(self, cells: Cells, num_reachable: Int[np.ndarray, " cells"]) -> Int[np.ndarray, " cells"]:
        # The axis along which to halve cells at the border of what reaches the goal, and coarse cells in which few
        # samples reach it; -1 for other cells.
        reach = self.reach
        axis = np.full(len(cells), -1) if reach is None else urgent_axes(cells, reach.is_border, self.max_axis_depth)
        if self.is_sparse:
            # Without a reach, a sample must show that the cell holds points that reach the goal.
            is_few = (num_reachable <= few_samples(cells.dim)) & ((num_reachable > 0) | (reach is not None))
            coarse = np.flatnonzero(is_few & (cells.depth < _FINE_DEPTH).any(axis=1))
            holds = (lambda lo, hi: np.ones(len(lo), bool)) if reach is None else reach.holds_reached
            # If both tests give an axis, either will do: take the larger number, as -1 stands for no axis.
            axis[coarse] = np.maximum(axis[coarse], urgent_axes(cells[coarse], holds, self.max_axis_depth))
        return axis

    def root(self, pieces_suffice: bool = False) -> CellFit:
        """Sample the whole domain as one cell; ``ValueError`` if no sample reaches the goal.

        There is no error in two cases. Case 1: the cell is *urgent* (see :class:`CellFit`), so that splits will find
        points that reach the goal. Case 2: ``pieces_suffice`` is True, and the oracle knows free space that reaches
        the goal.
        """
        fit = self(Cells.root(self.domain.dim))
        has_pieces = pieces_suffice and self.cache is not None and len(self.cache.sources(fit.cells).cell) > 0
        if not (fit.reachable.any() or has_pieces or fit.urgent_axis[0] >= 0):
            got = "distance_fn found nothing reachable: it must be finite somewhere in the domain, but was inf at all"
            advice = "Check that the goal is free and that the domain contains its surroundings"
            raise ValueError(f"{got} samples. {advice}. If free space is tiny, raise num_samples.")
        return fit

    def first_cells(self, most: int) -> CellFit:
        """Sample the domain as one cell, then halve *urgent* cells (see :class:`CellFit`), the largest first.

        Stop if no cell is urgent or there are ``most`` cells. ``ValueError`` if no sample of the resulting cells
        reaches the goal.
        """
        fit = self.root()
        while (room := most - len(fit)) > 0 and len(urgent := np.flatnonzero(fit.urgent_axis >= 0)):
            # Halve the largest urgent cells, all those of one size, if there is room.
            num_splits = fit.cells.depth[urgent].sum(axis=1)
            largest = urgent[num_splits == num_splits.min()][:room]
            halves = fit.cells[largest].split(fit.urgent_axis[largest])
            fit = fit[np.setdiff1d(np.arange(len(fit)), largest)].append(self(halves))
        if not fit.reachable.any():
            raise ValueError(f"No sample of {len(fit)} leaves reaches the goal. Allow more, or raise num_samples.")
        return fit


def reach_of(distance_fn: DistanceFn, domain: Box) -> Reach | None:
    return distance_fn.reach(domain) if isinstance(distance_fn, ReachFn) else None


def urgent_axes(cells: Cells, holds: BoxTest, max_axis_depth: int) -> Int[np.ndarray, " cells"]:
    """Return the axis along which to halve each cell that passes the test ``holds``; -1 for other cells.

    ``holds(lo, hi)`` tests boxes, given in fractions of the domain. The axis is the one along which the fewest of the
    two halves pass the test. Among several such axes, it is the one along which the cell is longest, in fractions of
    the domain. An axis that :func:`is_closed` excludes is not chosen; if all are excluded, axis 0 is.
    """
    axis = np.full(len(cells), -1)
    passing = np.flatnonzero(holds(*cells.fractions))
    depth = cells.depth[passing]
    score = np.empty(depth.shape)
    for k in range(cells.dim):
        halves = cells[passing].split(np.full(len(passing), k))
        score[:, k] = holds(*halves.fractions).reshape(-1, 2).sum(axis=1)  # 0, 1 or 2 halves
    score += depth / (1 + depth.max(initial=0))  # less than 1, so it only decides between equal numbers of halves
    score[is_closed(depth, max_axis_depth)] = np.inf
    axis[passing] = np.argmin(score, axis=1)
    return axis


def is_closed(depth: Int[np.ndarray, "cells dim"], max_axis_depth: int) -> Bool[np.ndarray, "cells dim"]:
    """Return, for each cell and axis, whether the axis is closed: the cell should not be halved along it.

    ``depth`` has the number of halvings of each cell along each axis. An axis is closed if this number is at least
    ``max_axis_depth``, or exceeds the number along another axis by at least ``MAX_ASPECT_BITS``.
    """
    return (depth - depth.min(axis=1, keepdims=True) >= MAX_ASPECT_BITS) | (depth >= max_axis_depth)


def fill_unsampled_planes(fit: CellFit, sampler: Sampler) -> CellFit:
    """Give planes to the cells in which free space, but no sample, reaches the goal; return the changed fit.

    Each plane is tangent to the distance at a point of the free space. All other cells keep their planes. Without
    ``sampler.cache``, a :class:`SourceCache`, nothing changes.
    """
    unseen = np.flatnonzero(~fit.reachable.any(axis=1))
    if sampler.cache is None or not len(unseen):
        return fit
    # In each such cell, take the largest convex piece of free space that reaches the goal. Let m be a point in the
    # piece, d(m) its distance to the goal, and s the source to which the shortest path from m goes first. Near m,
    #     d(x) ~ d(m) + gradient . (x - m),  where  gradient = (m - s) / |m - s|.
    visible = sampler.cache.sources(fit.cells[unseen])
    order = np.lexsort((-areas(visible.pieces), visible.cell))
    cell, first = np.unique(visible.cell[order], return_index=True)
    cell, piece = unseen[cell], order[first]
    m = visible.center[piece]
    from_source = m - visible.sources.points[visible.best[piece]]
    length = np.linalg.norm(from_source, axis=1, keepdims=True)
    gradient = np.divide(from_source, length, out=np.zeros_like(from_source), where=length > 0)
    lo, hi = (corner[cell] for corner in fit.cells.boxes(sampler.domain))
    center, half = fit.center.copy(), fit.half.copy()
    center[cell] = visible.distance[piece] + (gradient * ((lo + hi) / 2 - m)).sum(axis=1)
    half[cell] = gradient * (hi - lo) / 2
    return replace(fit, center=center, half=half)


def call_oracle(distance_fn: DistanceFn, x: Points) -> Distances:
    try:
        answer = distance_fn(x.copy())  # a copy, since the function may write to its argument
    except Exception as error:
        note = "distance_fn must return distances (n,) for points (n, dim)"
        error.add_note(f"{note}; it was called with shape {x.shape}.")
        raise
    return as_distances("distance_fn", answer, x)


def parallel_distances(distance_fn: DistanceFn, executor: Executor, x: Points) -> Distances:
    """Evaluate a distance function on the workers of an executor, in tasks of up to 1,024 points."""
    parts = enumerate(batches(x, _POINTS_OF_TASK))
    tasks = {number: partial(call_oracle, distance_fn, part) for number, part in parts}
    answers: dict[int, Distances] = {}
    run_tasks(executor, tasks, answers)
    # If workers died, this process computes the missing answers.
    return np.concatenate([np.empty(0), *(answers[i] if i in answers else task() for i, task in tasks.items())])


def run_tasks(
    pool: Executor, tasks: Mapping[Any, Callable[[], Any]], results: dict[Any, Any], progress: Progress | None = None
) -> None:
    """Run tasks on the workers of a pool, and add the result of each finished task to ``results``, by its key.

    If workers die or an interrupt (Ctrl-C) stops the computation, the results of some tasks stay missing.
    ``progress`` counts the items of the results.
    """
    key_of: dict[Future[Any], Any] = {}
    try:
        with suppress(BrokenExecutor):
            for key, task in tasks.items():
                key_of[pool.submit(task)] = key
        for future in as_completed(key_of):
            with suppress(BrokenExecutor):
                results[key_of[future]] = future.result()
                if progress is not None:
                    progress.update(len(future.result()))
    finally:  # after an interrupt or an error, keep also what is finished, but not collected yet
        for future, key in key_of.items():
            if not future.cancel() and future.done() and future.exception() is None:
                results[key] = future.result()


def call_weights(weight_fn: WeightFn, x: Points) -> Float[np.ndarray, " n"]:
    answer = as_numbers("weight_fn's answer", weight_fn(x.copy()), f"real numbers of shape ({len(x)},)")
    weight = as_values("weight_fn", answer, len(x))
    least, most = weight.min(initial=np.inf), weight.max(initial=-np.inf)  # NaN if any weight is
    if not (least >= 0 and most < np.inf):
        raise ValueError(f"weight_fn must return finite weights >= 0, got values from {least:g} to {most:g}.")
    return weight


def weights_of_fit(reachable: Bool[np.ndarray, "cells k"], weight: OfSamples) -> OfSamples:
    """Return the weights of samples in fits; in a cell where all are 0, samples that reach the goal get 1."""
    return np.where((weight > 0).any(axis=1, keepdims=True), weight, reachable)


def _check_planes(center: Float[np.ndarray, "..."], half: Float[np.ndarray, "..."], cells: Cells) -> None:
    if np.shape(center) != (len(cells),) or np.shape(half) != (len(cells), cells.dim):
        expected = f"shapes ({len(cells)},) and ({len(cells)}, {cells.dim}), the center value and half of the rise"
        got = f"got {np.shape(center)} and {np.shape(half)}"
        raise ValueError(f"compute_coefficients must return {expected} along each axis of each cell, {got}.")
    if any(np.ma.is_masked(part) or not np.isfinite(part).all() for part in (center, half)):
        raise ValueError("compute_coefficients must return finite planes, got NaN, infinity or masked numbers.")


def folded_distances(distance_fn: DistanceFn, folding: Folding, z: Points) -> Distances:
    return call_oracle(distance_fn, folding.unfold(z))


def folded_weights(weight_fn: WeightFn | None, folding: Folding, z: Points) -> Float[np.ndarray, " n"]:
    """Return, for each folded point ``z``, the largest weight of all points of the domain that mirrors map to ``z``.

    The result is 0 if no point of the domain is mapped to ``z``. Without a ``weight_fn``, all points have weight 1.
    """
    largest = np.zeros(len(z))
    for x, inside in folding.images(z):
        weight = 1.0 if weight_fn is None else call_weights(weight_fn, x[inside])
        largest[inside] = np.maximum(largest[inside], weight)
        if weight_fn is None and largest.all():
            break
    return largest
