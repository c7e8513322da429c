"""Values at the corners of leaves, tied across free faces, all fitted at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import product_in_order, row_products
from plr_jax._types import DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, cone_above_plane
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.faces import SharedFaces, face_points, shared_faces
from plr_jax.plr.finite_elements import (
    MAX_DIM_OF_ORDER,
    POWERS,
    NodalSpace,
    design,
    enclosing_planes,
    monomials,
    nodal_space,
    numbers_of_leaves,
    numbers_of_planes,
)
from plr_jax.plr.frame import LARGEST, Corner
from plr_jax.plr.growth import Limits, check_memory, check_rules, grow, is_open, least_priority
from plr_jax.plr.leaves.base import (
    UNIT,
    LinearLeafModel,
    Rules,
    largest_coordinates,
)
from plr_jax.plr.sampling import CellFit, Sampler, call_oracle, sample_pattern, weights_of_fit
from plr_jax.plr.tree import Cells, Tree, tree_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_RESIDUAL, _MOST_STEPS = 1e-10, 200  # of conjugate gradients


def solve_normal(normal: "csr_array", moments: Float[np.ndarray, "n"], dim: int) -> Float[np.ndarray, "n"]:
    """Solve equations whose matrix is symmetric and positive definite.

    In up to two dimensions by its factors. In more of them factors fill in far more than the matrix holds, so there
    by conjugate gradients, to a relative residual of 1e-10, and by factors only if that takes long. Where samples
    determine all values, the matrix divided by its diagonal is well conditioned, whatever the sizes of leaves.
    """
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import splu

    if dim > _MOST_DIM_OF_FACTORS:
        scale = 1 / np.sqrt(normal.diagonal())
        values = _conjugate_gradients((diags_array(scale) @ normal @ diags_array(scale)).tocsr(), scale * moments)
        if values is not None:
            return scale * values
    # Without pivoting, the factors of such a matrix fill in a quarter as much.
    options = {"SymmetricMode": True}
    factors = splu(csc_array(normal), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve(moments)


def _conjugate_gradients(matrix: "csr_array", right: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"] | None:
    """Solve a symmetric positive definite system; None if ``_MOST_STEPS`` steps leave too large a residual.

    SciPy's ``cg`` computes inner products with BLAS, whose threads wait busily and cost several times the solve.
    ``np.einsum`` starts no threads.
    """
    values, residual, direction = np.zeros_like(right), right, right
    square = first = np.einsum("i,i", right, right)
    for _ in range(_MOST_STEPS):
        if square <= _RESIDUAL**2 * first:
            return values
        image = matrix @ direction
        step = square / np.einsum("i,i", direction, image)
        values, residual = values + step * direction, residual - step * image
        before, square = square, np.einsum("i,i", residual, residual)
        direction = residual + square / before * direction
    return None


_NUM_POINTS = 32
_FEW = 4  # points that most free faces need
_BESIDE = 1e-6  # how far from a face its two sides are, in fractions of the domain: well within the smallest cell
_INSET = 0.998  # keeps the points off the ends of a face, which belong to other faces too


class FaceTests:
    """Whether faces are free; each is tested once, however often it is asked about.

    A piece of a face is free if somewhere on it both sides can be reached.
    """

    def __init__(self, distance_fn: DistanceFn, domain: Box) -> None:
        self._distance_fn = distance_fn
        self._domain = domain
        self._known: dict[bytes, bool] = {}

    def are_free(self, cells: Cells, faces: SharedFaces) -> Bool[np.ndarray, "faces"]:
        """Whether each face is free: both sides can be reached at one of its points or more."""
        domain = self._domain
        geometry = np.concatenate(
            [part[side] for part in (cells.depth, cells.position) for side in (faces.lower, faces.upper)], axis=1
        )
        geometry = np.column_stack([geometry, faces.axis])  # a cell may share faces with itself along several axes
        keys = [row.tobytes() for row in geometry]
        new = np.array([index for index, key in enumerate(keys) if key not in self._known], np.int64)
        free = np.zeros(len(new), bool)
        # Fractions of a face; along its own axis, whichever that is, it has no width.
        points = (1 + _INSET * sample_pattern(domain.dim, _NUM_POINTS, 0.0, 0).u) / 2
        for some in (points[:_FEW], points[_FEW:]):
            unsure = np.flatnonzero(~free)
            if len(some) and len(unsure):
                tested = faces[new[unsure]]
                x = face_points(cells, tested, some)
                across = _BESIDE * np.eye(domain.dim)[tested.axis][:, None]
                sides = [domain.lo + domain.width * (x + sign * across) for sign in (-1, 1)]
                both = domain.wrapped(np.concatenate(sides)).reshape(-1, domain.dim)
                below, above = np.isfinite(call_oracle(self._distance_fn, both)).reshape(2, *x.shape[:2])
                free[unsure] = np.any(below & above, axis=1)
        self._known |= {keys[index]: bool(is_free) for index, is_free in zip(new, free, strict=True)}
        return np.array([self._known[key] for key in keys], bool)


# Leaves as polynomials of the place in their cells.


def polynomial(powers: int, coefficients: Sequence[Any], t: Sequence[Any]) -> Any:
    """Horner's rule along the first coordinate, whose coefficients are polynomials of the others."""
    if not t:
        return coefficients[0]
    stride = len(coefficients) // powers
    parts = [coefficients[power * stride : (power + 1) * stride] for power in range(powers)]
    total, *others = (polynomial(powers, part, t[1:]) for part in reversed(parts))
    for term in others:
        total = total * t[0] + term
    return total


@dataclass(frozen=True, eq=False)
class TiedPartition:
    """Leaves, the faces they share, and across which of them functions are continuous: none of unreachable ones."""

    tree: Tree
    unreachable: Bool[np.ndarray, "leaves"]
    faces: SharedFaces
    tied: Bool[np.ndarray, "faces"]

    @cached_property
    def space(self) -> NodalSpace:
        """The continuous functions on these leaves."""
        return nodal_space(self.tree, self.faces[self.tied], self.unreachable)

    def between_reachable(self) -> Bool[np.ndarray, "faces"]:
        """Which faces may be tied."""
        return ~(self.unreachable[self.faces.lower] | self.unreachable[self.faces.upper])


@dataclass(frozen=True, eq=False)
class StoredValues:
    """Values of the masters as integers of one step: ``offset + step * code``."""

    partition: TiedPartition
    offset: float
    step: float
    code: Int[np.ndarray, "masters"]

    @staticmethod
    def rounded(partition: TiedPartition, values: Float[np.ndarray, "masters"], step: float) -> "StoredValues":
        """The nearest that can be stored; the step as a 32-bit float."""
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
        offset, step = float(np.float32(values.mean())), float(np.float32(step))
        return StoredValues(partition, offset, step, np.rint((values - offset) / step).astype(np.int64))

    @staticmethod
    def of_corners(
        partition: TiedPartition, values: Float[np.ndarray, "leaves corners"], step: float
    ) -> "StoredValues":
        """Round values of at least 0 at the corners of leaves, to such values; hanging corners follow from others."""
        space = partition.space
        of_group = np.zeros(int(space.group.max()) + 1)
        of_group[space.group] = values.ravel()
        stored = StoredValues.rounded(partition, of_group[space.masters], step)
        return replace(stored, code=np.maximum(stored.code, int(np.ceil(-stored.offset / stored.step))))

    def decode(self) -> Float[np.ndarray, "masters"]:
        """The values."""
        return self.offset + self.step * self.code

    def write(self, body: BitWriter) -> None:
        """Append ties and values."""
        partition, space = self.partition, self.partition.space
        body.write_floats(np.array([self.offset, self.step]))
        body.write_set(partition.unreachable)
        body.write_set(~partition.tied[partition.between_reachable()])
        surplus = self.code - np.rint(space.prediction @ self.code).astype(np.int64)
        for level in _level_slices(space.level):
            body.write_signed(surplus[level])


def read_values(body: BitReader, cells: Cells, periodic: tuple[bool, ...] = ()) -> StoredValues:
    """The next ties and values of leaves in a domain of ``periodic`` axes.

    Raises ``ValueError`` saying what is wrong with them.
    """
    offset, step = body.read_floats(2).tolist()
    if not (np.isfinite(offset) and 0 < step < np.inf):
        raise ValueError(f"it states a step of {step} from {offset}")
    tree = tree_of(cells)
    if (np.diff(tree.order) < 0).any():
        raise ValueError("its tree splits its leaves along other axes first than the tree of tied leaves does")
    faces = shared_faces(tree, periodic)
    partition = TiedPartition(tree, body.read_set(len(cells)), faces, np.zeros(len(faces), bool))
    may_be_tied = partition.between_reachable()
    partition.tied[may_be_tied] = ~body.read_set(int(np.count_nonzero(may_be_tied)))
    space = partition.space
    code = np.zeros(len(space.masters), np.int64)
    for level in _level_slices(space.level):
        surplus = body.read_signed(level.stop - level.start)
        code[level] = surplus + np.rint(space.prediction[level] @ code).astype(np.int64)
    return StoredValues(partition, offset, step, code)


def _level_slices(level: Int[np.ndarray, "masters"]) -> list[slice]:
    """Runs of masters of one level, which depend on earlier ones alone."""
    starts = np.flatnonzero(np.diff(level, prepend=-1)).tolist()
    return [slice(start, end) for start, end in zip(starts, [*starts[1:], len(level)], strict=True)]


_MOST_SPLIT = 0.5  # of the leaves in one round, before all are fitted again
# A round splits at least one in 16 leaves, and one in 64 where more exceed the budget of bytes.
_LEAST_SPLIT, _LEAST_SPLIT_AT_END = 1 / 16, 1 / 64
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
            if self._most < _LEAST_SPLIT_AT_END * len(now):
                return None

    def _next_splits(self, now: _Fitted) -> tuple[Int[np.ndarray, "splits"], Int[np.ndarray, "splits"]]:
        """Leaves to split in this round, and the axis of each."""
        fit, limits = now.fit, self._limits
        room = limits.max_leaves - len(now)
        if np.isfinite(limits.max_bytes):
            room = min(room, int(len(now) * (limits.max_bytes / now.num_bytes - 1)))
        # The better half of what there is room for: errors change as neighbors are split.
        number = max((room + 1) // 2, int(_LEAST_SPLIT * len(now)), 1)
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
        stored.write(body)
        num_bytes = self._limits.file_size(fit.cells.dim, len(fit), body.num_bits)
        return _Fitted(replace(fit, residual=residual), stored, num_bytes)


def fit_values(
    order: int, space: NodalSpace, fit: CellFit, weight: Float[np.ndarray, "leaves k"]
) -> tuple[Float[np.ndarray, "masters"], Float[np.ndarray, "leaves k"]]:
    """Values of the masters with which the function of the given order errs least at the leaves' samples.

    With them come the errors, sampled distance minus function; 0 where a sample has no weight.
    """
    from scipy.sparse import bsr_array, diags_array

    numbers = numbers_of_leaves(order, space)
    functions = design(order, (fit.pattern.u + 1) / 2)
    terms, leaves = functions.shape[1], len(fit)
    products = (functions[:, :, None] * functions[:, None, :]).reshape(len(functions), -1)
    each = np.arange(leaves + 1)
    of_leaves = bsr_array((row_products(weight, products).reshape(-1, terms, terms), each[:-1], each))
    squares = numbers.T @ (of_leaves @ numbers)
    is_predicted = np.diff(space.prediction.indptr) > 0
    surplus = diags_array(np.where(is_predicted, 1.0, _UNPREDICTED)) - space.prediction
    normal = squares + (_PREDICTION_WEIGHT * fit.pattern.weight.sum()) * (surplus.T @ surplus)
    mean = np.sum(weight * fit.value) / np.sum(weight)
    moments = row_products(weight * (fit.value - mean), functions).ravel()
    values = mean + solve_normal(normal, numbers.T @ moments, fit.cells.dim)
    errors = fit.value - row_products((numbers @ values).reshape(leaves, terms), functions.T)
    return values, np.where(weight > 0, errors, 0.0)


@dataclass(frozen=True)
class Continuous(LinearLeafModel):
    """Functions that do not jump across free faces: a face with a point whose two sides can both be reached.

    A face in a wall ties nothing, so nothing blends across walls. Coefficients are values at a leaf's corners, of
    order 1 derivatives there too (see ``plr/finite_elements.py``).

    Args:
        order: Of continuity: 0 for values, multilinear in every leaf; 1 for gradients too, cubic along every axis.

    Raises:
        ValueError: If the order is neither.
    """

    order: int = 0

    is_of_cells = True

    def __post_init__(self):
        if self.order not in (0, 1):
            raise ValueError(f"order must be 0 or 1, got {self.order!r}.")
        object.__setattr__(self, "name", ("continuous", "smooth")[self.order])

    def check_dim(self, dim: int) -> None:
        """Raise ``ValueError`` if the model is not for so many axes."""
        if dim > MAX_DIM_OF_ORDER[self.order]:
            raise ValueError(
                f"Leaves of kind {self.name!r} are for up to {MAX_DIM_OF_ORDER[self.order]} dimensions, got {dim}. "
                f"Use {'continuous ones or ' if self.order else ''}planes, which may jump, instead."
            )

    def least_samples(self, dim: int) -> int:
        """One more than a leaf has corners."""
        return 2**dim + 1

    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, StoredValues]:
        """Grow the partition, all values fitted again in every round."""
        stored = grow_tied(self.order, sampler, rules, limits)
        return stored.partition.tree, stored

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredValues) -> None:
        """Append what the file keeps of the leaves."""
        stored.write(body)

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredValues:
        """What :meth:`write` appended."""
        return read_values(body, cells, domain.periodic)

    def coefficients(self, cells: Cells, stored: StoredValues) -> Float[np.ndarray, "leaves terms"]:
        """Numbers of every leaf; ``inf``, then zeros, for one without a tied face and a reachable sample."""
        of_masters = numbers_of_leaves(self.order, stored.partition.space).tocsr().sorted_indices().tocoo()
        terms = of_masters.data * stored.decode()[of_masters.col]  # summed in their order, on any processor alike
        coefficients = np.bincount(of_masters.row, terms, of_masters.shape[0]).reshape(len(cells), -1)
        coefficients[stored.partition.unreachable, 0] = np.inf
        return coefficients

    def basis(self, u: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n terms"]:
        """What the coefficients multiply at local coordinates ``u``."""
        return design(self.order, (u + 1) / 2)

    def of_planes(
        self, center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
    ) -> Float[np.ndarray, "leaves terms"]:
        """Coefficients with which leaves hold planes."""
        return numbers_of_planes(self.order, center, half)

    def numbers(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"], corner: Corner
    ) -> Float[np.ndarray, "leaves count"]:
        """What a query reads of every leaf: the numbers of its cell, and coefficients by powers of the place in it.

        Along each axis the number 1 is the domain, and the halves of ``i`` are ``2 i`` and ``2 i + 1``. The exponent
        of such a number, as a 32-bit float, says how many such intervals span the domain.
        """
        is_inf = np.isinf(coefficients[:, 0])
        powers = product_in_order(np.where(is_inf[:, None], 0.0, coefficients), monomials(self.order, cells.dim))
        powers[is_inf, 0] = np.inf
        return np.concatenate([np.ldexp(1.0, cells.depth) + cells.position, powers], axis=1)

    def below_cones(
        self,
        lo: Float[np.ndarray, "n 2"],
        hi: Float[np.ndarray, "n 2"],
        coefficients: Float[np.ndarray, "n terms"],
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Bounds of cones minus polynomials, each of which is a plane but for a remainder, over convex pieces."""
        first, last = pieces.min(axis=2).T, pieces.max(axis=2).T
        width = hi - lo
        value, slope, remainder = enclosing_planes(
            self.order, coefficients, ((first + last) / 2 - lo) / width, (last - first) / 2 / width
        )
        slope = slope / width
        intercept = value - (slope * (first + last)).sum(axis=1) / 2
        lowest, highest = cone_above_plane(pieces, apex, offset, slope, intercept)
        return lowest - remainder, highest + remainder

    def rounding(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
    ) -> Float[np.ndarray, "leaves"]:
        """Of the point's place in its cell, and of the polynomial there."""
        finite = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
        powers = np.abs(finite @ monomials(self.order, cells.dim))
        highest = POWERS[self.order]
        places = largest_coordinates(domain) / domain.width + 4
        of_place = (highest - 1) * np.ldexp(1.0, cells.depth) @ places
        return 1.02 * UNIT * powers.sum(axis=1) * (2 * highest * cells.dim + 1 + of_place)

    def num_numbers(self, dim: int) -> int:
        """Those of the cell, and coefficients by powers of the place in it."""
        return dim + POWERS[self.order] ** dim

    def value(self, numbers: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        """The polynomial of the place, by Horner's rule."""
        return polynomial(POWERS[self.order], numbers, place)
