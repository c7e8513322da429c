"""Building a continuous PLR: fit all values at once, split where the fit errs, tie, and fit again."""

import warnings
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._arrays import require_integer
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.plr._construct import ConstructionInterrupted
from plr_jax.plr.growth.limits import Limits, check_limits, check_memory
from plr_jax.plr.growth.rules import best_axis, largest_error, max_axis_depth
from plr_jax.plr.leaves.continuous.basis import MAX_DIM_OF_ORDER
from plr_jax.plr.leaves.continuous.codec import Partition, StoredValues, encode
from plr_jax.plr.leaves.continuous.evaluation import ContinuousPLR, continuous_from_bytes
from plr_jax.plr.leaves.continuous.fit import Samples, fit_values, residuals
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import shared_faces, tree_of
from plr_jax.plr.partition.levels import MAX_DEPTH
from plr_jax.plr.sampling.cell_samples import CellFit, WeightFn, fit_cells
from plr_jax.plr.sampling.free_faces import FaceTests
from plr_jax.plr.sampling.pattern import Pattern, sample_pattern

_MOST_SPLIT = 0.5  # of the leaves in one round, before all are fitted again
_ROUNDS_TO_END = 64  # a round splits at least one in so many leaves, while the limits allow
# Between the largest error (0) and the mean error (1): a cell counts by its volume to this power.
_VOLUME_POWER = 0.25
# Values are rounded to multiples of this times the mean error: bits for leaves rather than for digits.
_STEP_PER_MEAN_ERROR = 1.0
_SMALLEST_STEP = 2.0**-22  # of the largest distance: what 32-bit floats hold


def construct_continuous(
    distance_fn: DistanceFn,
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    order: int = 0,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    num_samples: int = 96,
    weight_fn: WeightFn | None = None,
    seed: int = 0,
) -> ContinuousPLR:
    """Build an approximation of a distance function that is continuous wherever one can walk.

    In place of a plane a leaf it stores values at the leaves' corners, shared by all leaves that meet there without a
    wall between them. In rounds, all values are fitted at once (a sparse least-squares problem), and the leaves of
    the largest error, weighted by the fourth root of their volume, are split along their best axis.

    Any limits may be combined; construction stops at the first that is met. Without any, at 512 leaves.

    Args:
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` where it cannot be reached.
        domain: The box to cover, a ``Box`` or its two corners.
        order: 0 for a continuous function, multilinear in every leaf; in up to 6 dimensions. 1 for a continuous
            gradient as well, cubic along every axis; in 1 or 2 dimensions.
        max_leaves: Largest number of leaves.
        max_bytes: Largest size of the file.
        tolerance: Leaves whose largest (weighted) sample error is at most this are not split.
        num_samples: Samples of a leaf, at least ``2**dim + 1``.
        weight_fn: Weight of the error at each of a batch of points, finite and >= 0; where accuracy matters.
        seed: Seed of the samples' scrambling. The same seed gives the same function.

    Returns:
        The function. If interrupted (Ctrl-C), the one fitted last, with a ``ConstructionInterrupted`` warning.

    Raises:
        ValueError: If an argument is out of its range, the limits allow a tree larger than memory, a budget is too
            small for one leaf, ``distance_fn`` returns a wrong shape or NaN, or no sample reaches the goal.

    References:
        Bogner, Fox, Schmit, "The generation of inter-element-compatible stiffness and mass matrices by the use of
        interpolation formulas", 1965, for order 1.
    """
    domain = Box.of(domain)
    limits = check_limits(None, max_leaves, max_bytes, tolerance, None)
    _check(order, domain.dim, num_samples, seed)
    pattern = sample_pattern(domain.dim, int(num_samples), 0.0, int(seed))
    rounds = _Rounds(distance_fn, domain, int(order), weight_fn, pattern)
    fitted = rounds.first()
    if len(fitted.data) > limits.max_bytes:
        raise ValueError(
            f"max_bytes={limits.max_bytes:g} is too small: one leaf takes {len(fitted.data)} bytes; allow that."
        )
    return continuous_from_bytes(_grow(rounds, fitted, limits).data)


def _check(order: int, dim: int, num_samples: int, seed: int) -> None:
    if order not in (0, 1):
        raise ValueError(f"order must be 0 (continuous) or 1 (with a continuous gradient), got {order!r}.")
    if dim > MAX_DIM_OF_ORDER[order]:
        raise ValueError(
            f"Continuity of order {order} is for up to {MAX_DIM_OF_ORDER[order]} dimensions, got {dim}. Use "
            f"{'order=0 or ' if order else ''}construct, whose planes may jump, instead."
        )
    if not isinstance(num_samples, int | np.integer) or num_samples <= 2**dim:
        raise ValueError(f"num_samples must be at least 2**dim + 1 = {2**dim + 1}, got {num_samples}.")
    require_integer("seed", seed, 0)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A partition with its continuous function.

    Attributes:
        cells: Samples of the leaves; their residuals are those of the continuous function.
        value: Sampled distances, 0 where the goal cannot be reached.
        data: The file.
    """

    cells: CellFit
    value: Float[np.ndarray, "leaves k"]
    data: bytes

    def __len__(self) -> int:
        return len(self.value)


def _grow(rounds: "_Rounds", fitted: _Fitted, limits: Limits) -> _Fitted:
    """Split and fit in rounds, smaller ones at the end, up to the limits."""
    with tqdm(desc="construct", unit=" leaves", delay=2, leave=False, disable=None) as progress:
        try:
            most = limits.max_leaves
            while True:
                leaf, axis = _next_splits(fitted, limits, most)
                if not len(leaf):
                    return fitted
                grown = rounds.next(fitted, leaf, axis)
                if len(grown.data) > limits.max_bytes:
                    most = len(leaf) // 2
                    if _ROUNDS_TO_END * most < len(fitted):
                        return fitted
                    continue
                progress.update(len(grown) - len(fitted))
                fitted = grown
        except KeyboardInterrupt:
            warnings.warn(
                f"Interrupted at {len(fitted)} leaves: the function is the one fitted last.",
                ConstructionInterrupted,
                stacklevel=3,
            )
    return fitted


def _next_splits(
    fitted: _Fitted, limits: Limits, most: int
) -> tuple[Int[np.ndarray, "splits"], Int[np.ndarray, "splits"]]:
    """Leaves to split in this round, at most so many, and the axis of each."""
    room = limits.max_leaves - len(fitted)
    if np.isfinite(limits.max_bytes):
        room = min(room, int(len(fitted) * (limits.max_bytes / len(fitted.data) - 1)))
    # The better half of what there is room for: errors change as neighbors are split.
    number = max((room + 1) // 2, len(fitted) // _ROUNDS_TO_END, 1)
    number = min(number, int(np.ceil(_MOST_SPLIT * len(fitted))), limits.max_leaves - len(fitted), most)
    cells, error = fitted.cells.cells, largest_error(fitted.cells)
    noise = np.finfo(np.float32).eps * np.abs(fitted.value).max(axis=1) * fitted.cells.weight.max(axis=1)
    depth = cells.depth.sum(axis=1)
    priority = np.where(error > np.maximum(limits.tolerance, noise), error * 2.0 ** (-_VOLUME_POWER * depth), 0.0)
    priority[depth >= MAX_DEPTH] = 0.0
    leaf = np.argsort(-priority, kind="stable")[:number]
    leaf = leaf[priority[leaf] > 0]
    axis = best_axis(_selected(fitted.cells, leaf)) if len(leaf) else np.zeros(0, np.int64)
    may_split = cells.depth[leaf, axis] < max_axis_depth(cells.dim)
    return leaf[may_split], axis[may_split]


class _Rounds:
    """One construction: what stays the same from round to round."""

    def __init__(
        self, distance_fn: DistanceFn, domain: Box, order: int, weight_fn: WeightFn | None, pattern: Pattern
    ) -> None:
        self._sample = lambda cells: fit_cells(cells, domain, distance_fn, weight_fn, pattern)
        self._domain, self._order, self._pattern = domain, order, pattern
        self._face_tests = FaceTests(distance_fn, domain)

    def first(self) -> _Fitted:
        """The whole domain as one leaf."""
        cells = self._sample(Cells.root(self._domain.dim))
        if not cells.reachable.any():
            raise ValueError(
                "distance_fn found nothing reachable: it returned inf at every sample of the domain. Check that the "
                "goal lies in free space and that the domain is the part of the world it is in; if free space is a "
                "tiny part of the domain, raise num_samples."
            )
        return self._fitted(cells, _sampled_values(cells))

    def next(self, fitted: _Fitted, leaf: Int[np.ndarray, "splits"], axis: Int[np.ndarray, "splits"]) -> _Fitted:
        """Some leaves split, and the function fitted again."""
        children = self._sample(fitted.cells.cells[leaf].split(axis))
        kept = np.setdiff1d(np.arange(len(fitted)), leaf)
        value = np.concatenate([fitted.value[kept], _sampled_values(children)])
        check_memory(2.0 * len(value))
        return self._fitted(_joined(_selected(fitted.cells, kept), children), value)

    def _fitted(self, cells: CellFit, value: Float[np.ndarray, "leaves k"]) -> _Fitted:
        tree = tree_of(cells.cells)
        cells, value = _selected(cells, tree.order), value[tree.order]
        faces = shared_faces(tree)
        tied = self._face_tests.are_free(tree.leaves, faces)
        unreachable = ~np.any(cells.reachable, axis=1)
        unreachable[faces[tied].lower] = unreachable[faces[tied].upper] = False
        partition = Partition(tree, unreachable, faces, tied)
        space = partition.space()
        samples = self._samples(cells, value)
        values, numbers = fit_values(self._order, space, samples)
        residual = residuals(self._order, numbers, samples)
        data = encode(self._domain, self._order, partition, space, _rounded(values, residual, samples))
        return _Fitted(replace(cells, residual=residual), value, data)

    def _samples(self, cells: CellFit, value: Float[np.ndarray, "leaves k"]) -> Samples:
        """Samples as the fit weighs them: cells by the root of their volume, a compromise of errors."""
        weight = np.where((cells.weight > 0).any(axis=1, keepdims=True), cells.weight, cells.reachable)
        of_cell = 2.0 ** (-0.5 * cells.cells.depth.sum(axis=1))
        return Samples(self._pattern, value, weight * self._pattern.weight * (of_cell / of_cell.mean())[:, None])


def _rounded(
    values: Float[np.ndarray, "masters"], residual: Float[np.ndarray, "leaves k"], samples: Samples
) -> StoredValues:
    """Values as they are stored, rounded about as coarsely as they err."""
    mean_error = float(np.sum(samples.weight * np.abs(residual)) / np.sum(samples.weight))
    step = max(_STEP_PER_MEAN_ERROR * mean_error, _SMALLEST_STEP * float(np.abs(samples.value).max()))
    return StoredValues.rounded(values, max(step, float(np.finfo(np.float32).tiny)))


def _sampled_values(cells: CellFit) -> Float[np.ndarray, "cells k"]:
    """The distances that were sampled, 0 where the goal cannot be reached."""
    center = np.where(np.isfinite(cells.center), cells.center, 0.0)
    plane = center[:, None] + cells.half @ cells.pattern.u.T
    return np.where(cells.reachable, cells.residual + plane, 0.0)


def _selected(cells: CellFit, index: Int[np.ndarray, "n"]) -> CellFit:
    return replace(cells, cells=cells.cells[index], **{name: getattr(cells, name)[index] for name in _COLUMNS})


def _joined(first: CellFit, second: CellFit) -> CellFit:
    columns = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in _COLUMNS}
    return replace(first, cells=first.cells.append(second.cells), **columns)


_COLUMNS = [column.name for column in fields(CellFit) if column.name not in ("cells", "pattern")]
