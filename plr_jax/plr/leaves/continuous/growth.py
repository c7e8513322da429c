"""Growing a partition whose leaves are tied: fit all values at once, split where the fit errs, tie, and fit again."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.coding import BitWriter
from plr_jax.plr.growth.limits import Limits, check_memory, check_rules, grow, is_open, least_priority
from plr_jax.plr.leaves.base import Rules
from plr_jax.plr.leaves.continuous.codec import StoredValues, TiedPartition, write_values
from plr_jax.plr.leaves.continuous.space import NodalSpace, design, numbers_of_leaves
from plr_jax.plr.leaves.sparse_squares import solve_by_descent, solve_sparse, weighted_squares
from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import shared_faces
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler, weights_of_fit
from plr_jax.plr.sampling.free_faces import FaceTests

_MOST_SPLIT = 0.5  # of the leaves in one round, before all are fitted again
_ROUNDS_TO_END = 64  # a round splits at least one in so many leaves, while the limits allow
# Between the largest error (0) and the mean error (1): a cell counts by its volume to this power.
_VOLUME_POWER = 0.25
# Values are rounded to multiples of this times the mean error: bits for leaves rather than for digits.
_STEP_PER_MEAN_ERROR = 1.0
_SMALLEST_STEP = 2.0**-22  # of the largest distance: what 32-bit floats hold
# How much a value that differs from what coarser ones predict counts beside a cell's samples: it decides only where
# samples do not, in a wall.
_PREDICTION_WEIGHT = 1e-7
_MOST_DIM_OF_FACTORS = 2  # beyond, factors of a sparse matrix fill in
_UNPREDICTED = 1e-3  # of that, for the corners of the domain, which only differ from the mean


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A partition with its continuous function; as long as it has leaves.

    ``fit`` has the samples of the leaves, in the order of the tree's traversal, with the residuals of the function.
    """

    fit: CellFit
    stored: StoredValues
    num_bytes: int

    def __len__(self) -> int:
        return len(self.fit)


def grow_tied(order: int, sampler: Sampler, rules: Rules, limits: Limits) -> StoredValues:
    """Split and fit in rounds, smaller ones at the end, up to the limits.

    Raises:
        BudgetTooSmall: If the budget of bytes is too small for one leaf.
    """
    rounds = _Rounds(order, sampler, rules, limits)
    root = rounds.fitted(sampler.root())
    limits.require_room(root.num_bytes)
    return grow(root, rounds.next, limits).stored


class _Rounds:
    """One construction: what stays the same from round to round, and how many splits the last one may make."""

    def __init__(self, order: int, sampler: Sampler, rules: Rules, limits: Limits) -> None:
        self._order, self._sampler, self._rules, self._limits = order, sampler, rules, limits
        self._face_tests = FaceTests(sampler.distance_fn, sampler.domain)
        self._most = limits.max_leaves

    def next(self, now: _Fitted) -> _Fitted | None:
        """Some leaves split, and the function fitted again; None if no more of them fit into the budget."""
        while True:
            leaf, axis = self._next_splits(now)
            if len(leaf) == 0:
                return None
            children = self._sampler(now.fit.cells[leaf].split(axis))
            kept = np.setdiff1d(np.arange(len(now)), leaf)
            check_memory(2.0 * (len(kept) + len(children)))
            grown = self.fitted(now.fit[kept].append(children))
            if grown.num_bytes <= self._limits.max_bytes:
                return grown
            self._most = len(leaf) // 2
            if _ROUNDS_TO_END * self._most < len(now):
                return None

    def _next_splits(self, now: _Fitted) -> tuple[Int[np.ndarray, "splits"], Int[np.ndarray, "splits"]]:
        """Leaves to split in this round, and the axis of each."""
        fit, limits = now.fit, self._limits
        room = limits.max_leaves - len(now)
        if np.isfinite(limits.max_bytes):
            room = min(room, int(len(now) * (limits.max_bytes / now.num_bytes - 1)))
        # The better half of what there is room for: errors change as neighbors are split.
        number = max((room + 1) // 2, len(now) // _ROUNDS_TO_END, 1)
        number = min(number, int(np.ceil(_MOST_SPLIT * len(now))), limits.max_leaves - len(now), self._most)
        error = np.asarray(self._rules.should_split(fit), float)
        check_rules(fit, error, np.zeros(len(fit), np.int64))
        worth_it = (error > least_priority(fit, limits)) & fit.can_split
        priority = np.where(worth_it, error * 2.0 ** (-_VOLUME_POWER * fit.cells.depth.sum(axis=1)), 0.0)
        best = np.argsort(-priority, kind="stable")[: np.count_nonzero(worth_it)]
        leaf, axis = np.zeros((2, 0), np.int64)
        for start in range(0, len(best), max(number, 1)):  # past those that the limits on depth keep
            some = best[start : start + number - len(leaf)] if number else best[:0]
            axis_of_some = np.asarray(self._rules.split(fit[some]))
            check_rules(fit[some], error[some], axis_of_some)
            may_split = is_open(fit.cells[some], axis_of_some, limits)
            leaf, axis = np.append(leaf, some[may_split]), np.append(axis, axis_of_some[may_split])
            if len(leaf) >= number:
                break
        return leaf, axis

    def fitted(self, fit: CellFit) -> _Fitted:
        """The function of least squared error on the given leaves, in any order."""
        tree = tree_of(fit.cells)
        fit = fit[tree.order]
        faces = shared_faces(tree, self._sampler.domain.periodic)
        tied = self._face_tests.are_free(tree.leaves, faces)
        unreachable = ~np.any(fit.reachable, axis=1)
        unreachable[faces[tied].lower] = unreachable[faces[tied].upper] = False
        partition = TiedPartition(tree, unreachable, faces, tied)
        # Samples as the fit weighs them: cells by the root of their volume, a compromise of errors.
        of_cell = 2.0 ** (-0.5 * fit.cells.depth.sum(axis=1))
        weight = weights_of_fit(fit.reachable, fit.weight) * fit.pattern.weight * (of_cell / of_cell.mean())[:, None]
        values, residual = fit_values(self._order, partition.space, fit, weight)
        # Values are rounded about as coarsely as they err.
        mean_error = float(np.sum(weight * np.abs(residual)) / np.sum(weight))
        step = max(_STEP_PER_MEAN_ERROR * mean_error, _SMALLEST_STEP * float(np.abs(fit.value).max()))
        stored = StoredValues.rounded(partition, values, max(step, float(np.finfo(np.float32).tiny)))
        body = BitWriter()
        write_values(body, stored)
        num_bytes = self._limits.file_size(fit.cells.dim, len(fit), body.num_bits)
        return _Fitted(replace(fit, residual=residual), stored, num_bytes)


def fit_values(
    order: int, space: NodalSpace, fit: CellFit, weight: Float[np.ndarray, "leaves k"]
) -> tuple[Float[np.ndarray, "masters"], Float[np.ndarray, "leaves k"]]:
    """Values of the masters with which the function of the given order errs least at the leaves' samples.

    With them come the errors, sampled distance minus function; 0 where a sample has no weight.
    """
    from scipy.sparse import diags_array

    numbers = numbers_of_leaves(order, space)
    functions = design(order, (fit.pattern.u + 1) / 2)
    terms, leaves = functions.shape[1], len(fit)
    products = (functions[:, :, None] * functions[:, None, :]).reshape(len(functions), -1)
    squares = weighted_squares(numbers, (weight @ products).reshape(-1, terms, terms))
    is_predicted = np.diff(space.prediction.indptr) > 0
    surplus = diags_array(np.where(is_predicted, 1.0, _UNPREDICTED)) - space.prediction
    normal = squares + (_PREDICTION_WEIGHT * fit.pattern.weight.sum()) * (surplus.T @ surplus)
    mean = np.sum(weight * fit.value) / np.sum(weight)
    moments = ((weight * (fit.value - mean)) @ functions).ravel()
    solve = solve_sparse if fit.cells.dim <= _MOST_DIM_OF_FACTORS else solve_by_descent
    values = mean + solve(normal, numbers.T @ moments)
    errors = fit.value - (numbers @ values).reshape(leaves, terms) @ functions.T
    return values, np.where(weight > 0, errors, 0.0)
