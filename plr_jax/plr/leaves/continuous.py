"""The leaf models ``"continuous"`` and ``"smooth"``: piecewise functions that are continuous except across walls.

The unknowns are the function's values at the corners of all leaves. Two leaves share the unknowns of a *free* face
between the leaves, a face that paths can cross. Each round of the construction splits the leaves of largest error;
then one sparse least-squares problem fits all values again. A file stores each value as an integer, the difference
from a prediction by values of coarser cells.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import hash64, index_of, row_products, set_fields
from plr_jax._types import DistanceFn, Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.finite_elements import NodalSpace, basis_monomials, basis_values, coefficient_matrix, nodal_space
from plr_jax.plr.frame import LARGEST
from plr_jax.plr.growth import Limits, check_memory, checked_axes, checked_priorities, grow, is_within_depth
from plr_jax.plr.leaf_faces import SharedFaces, face_points, shared_faces
from plr_jax.plr.leaves.base import MAX_TIED_DIM, UNIT, Coefficients, PolynomialLeafModel, Rules, read_step
from plr_jax.plr.sampling import CellFit, OfSamples, Sampler, call_oracle, sample_pattern, weights_of_fit
from plr_jax.plr.tree import Cells, Tree, corner_bits, tree_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Conjugate gradients stop at this relative residual; after so many steps, a direct solver takes over.
_RESIDUAL = 1e-10
_MOST_STEPS = 200
_MOST_DIM_OF_FACTORS = 2  # in more dimensions, sparse factors fill in too much


def solve_normal(normal: "csr_array", moments: Float[np.ndarray, " n"], dim: int) -> Float[np.ndarray, " n"]:
    """Solve ``normal @ x = moments`` for ``x``, with a symmetric positive definite matrix ``normal``.

    ``dim`` is the dimension of the domain. If it is above 2, try conjugate gradients first. If it is at most 2, or
    conjugate gradients take too many steps, factor the matrix.
    """
    from scipy.sparse import csc_array, diags_array
    from scipy.sparse.linalg import splu

    # With S = diag(normal)**-1/2, solve (S normal S) y = S moments; then x = S y. The scaled matrix is well
    # conditioned for leaves of all sizes.
    # SciPy's ``cg`` calls BLAS, whose busy threads take several times the CPU time; ``np.einsum`` starts no threads.
    if dim > _MOST_DIM_OF_FACTORS:
        scale = 1 / np.sqrt(normal.diagonal())
        matrix = (diags_array(scale) @ normal @ diags_array(scale)).tocsr()
        residual = direction = scale * moments
        values = np.zeros_like(residual)
        initial_square = square = np.einsum("i,i", residual, residual)
        for _ in range(_MOST_STEPS):
            if square <= _RESIDUAL**2 * initial_square:
                return scale * values
            image = matrix @ direction
            step = square / np.einsum("i,i", direction, image)
            values = values + step * direction
            residual = residual - step * image
            previous_square, square = square, np.einsum("i,i", residual, residual)
            direction = residual + square / previous_square * direction
    # Without pivoting, which a positive definite matrix does not need, the factors have a quarter of the entries.
    lu = splu(csc_array(normal), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return lu.solve(moments)


_NUM_POINTS = 32  # test points of a face
_FEW = 4  # points that are tested first; they suffice for most free faces
_BESIDE = 1e-6  # distance of test points from the face, in fractions of the domain: far below the smallest cell
_INSET = 0.998  # test points fill this share of the face, since its ends belong to other faces too


class FaceTests:
    """A test of faces between leaves: a face is *free* if paths can cross it.

    A face counts as free if, next to one of its test points, distances are finite on both sides of the face.
    """

    def __init__(self, distance_fn: DistanceFn, domain: Box) -> None:
        self._distance_fn, self._domain = distance_fn, domain
        self._keys, self._free = np.zeros(0, np.uint64), np.zeros(0, bool)  # of the faces of the last call

    def are_free(self, cells: Cells, faces: SharedFaces) -> Bool[np.ndarray, " faces"]:
        """Return whether each face is free: distances are finite on both sides of one of its test points.

        ``cells`` are the leaves to which the indices in ``faces`` refer. Faces of the previous call are not tested
        again.
        """
        domain = self._domain
        # 1. Recall the faces of the call before. A key identifies a face by its lower cell, its upper cell and its
        # axis: with periodic axes, a cell may share a face along each axis with itself.
        hashes = cells.hashes()
        keys = hash64(hash64(hashes[faces.lower]) + hashes[faces.upper]) + faces.axis.astype(np.uint64)
        known = index_of(self._keys, keys)  # -1 for a new face, which counts as not free
        is_free = np.append(self._free, False)[known]
        # 2. Test all other faces at pairs of points, one on either side of the face, first at few pairs:
        #      below . | . above        distances at both are finite: the face is free
        # Places are fractions of a face; face_points ignores the coordinate along the face's axis.
        places = (1 + _INSET * sample_pattern(domain.dim, _NUM_POINTS, 0.0, 0).u) / 2
        for tested_places in (places[:_FEW], places[_FEW:]):
            if len(unsure := np.flatnonzero((known < 0) & ~is_free)):
                tested = faces[unsure]
                x = face_points(cells, tested, tested_places)  # (faces, points, dim)
                across = _BESIDE * np.eye(domain.dim)[tested.axis][:, None]  # (faces, 1, dim)
                sides = [domain.lo + domain.width * (x + sign * across) for sign in (-1, 1)]
                points_beside = domain.wrapped(np.concatenate(sides)).reshape(-1, domain.dim)
                below, above = np.isfinite(call_oracle(self._distance_fn, points_beside)).reshape(2, *x.shape[:2])
                is_free[unsure] = np.any(below & above, axis=1)
        self._keys, self._free = keys, is_free
        return is_free


@dataclass(frozen=True, eq=False)
class TiedPartition:
    """A partition into leaves whose functions must agree on *tied* faces.

    A face between two leaves is tied if paths can cross it.
    """

    tree: Tree
    unreachable: Bool[np.ndarray, " leaves"]
    faces: SharedFaces
    tied: Bool[np.ndarray, " faces"]

    @cached_property
    def space(self) -> NodalSpace:
        return nodal_space(self.tree, self.faces[self.tied], self.unreachable)

    def may_be_tied(self) -> Bool[np.ndarray, " faces"]:
        return ~(self.unreachable[self.faces.lower] | self.unreachable[self.faces.upper])


@dataclass(frozen=True, eq=False)
class StoredValues:
    """The degrees of freedom of a continuous function, quantized as in a file: ``offset + step * code``.

    A degree of freedom is the function's value at a corner of leaves. A corner inside a face of a larger leaf has no
    degree of freedom: its value is interpolated. The derivatives of a smooth function follow from its values.
    """

    partition: TiedPartition
    offset: float
    step: float
    code: Int[np.ndarray, " free_dofs"]

    @staticmethod
    def quantize(partition: TiedPartition, values: Float[np.ndarray, " free_dofs"], step: float) -> "StoredValues":
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
        offset, step = float(np.float32(values.mean())), float(np.float32(step))
        return StoredValues(partition, offset, step, np.rint((values - offset) / step).astype(np.int64))

    @staticmethod
    def quantize_corners(partition: TiedPartition, values: Coefficients, step: float) -> "StoredValues":
        # Decoded values are at least 0. A group takes the value at the last of its corners. Values at hanging corners
        # (inside another leaf's face) are ignored.
        space = partition.space
        of_group = np.zeros(int(space.group.max()) + 1)
        of_group[space.group] = values.ravel()
        stored = StoredValues.quantize(partition, of_group[space.free_dofs], step)
        return replace(stored, code=np.maximum(stored.code, int(np.ceil(-stored.offset / stored.step))))

    def decode(self) -> Float[np.ndarray, " free_dofs"]:
        return self.offset + self.step * self.code

    def write(self, body: BitWriter) -> None:
        partition, space = self.partition, self.partition.space
        body.write_floats(np.array([self.offset, self.step]))
        body.write_set(partition.unreachable)
        body.write_set(~partition.tied[partition.may_be_tied()])
        # A value is stored as the difference from its prediction. This depends on values of lower levels only, so
        # that a reader can decode level by level.
        surplus = self.code - np.rint(space.prediction @ self.code).astype(np.int64)
        for level in _level_slices(space.level):
            body.write_signed(surplus[level])


def _level_slices(level: Int[np.ndarray, " free_dofs"]) -> list[slice]:
    # A slice for each level; values are sorted by level.
    starts = np.flatnonzero(np.diff(level, prepend=-1)).tolist()
    return [slice(start, end) for start, end in zip(starts, [*starts[1:], len(level)], strict=True)]


# Rounds. Each splits some leaves before all values are fitted again.
_MOST_SPLIT = 0.5  # largest share of the leaves that are split
_LEAST_SPLIT = 1 / 32  # least share of the leaves that are split
_FEW_LEAVES = 1 / 32  # of the splits that the limits allow: fewer leaves than these are all split
# Largest share of the splits that the limits allow. Errors change when adjacent leaves are split: if the last round
# split many leaves, some leaves would keep several times the error of other leaves.
_SHARE_OF_ALLOWED = 0.4
_WORTH_A_ROUND = 1 / 50  # growth ends if the byte limit has room for fewer than one split per 50 leaves
# Split priority is error * volume**power: power 0 aims at a small largest error, power 1 at a small mean error.
_VOLUME_POWER = 0.25
# Rounding. Values are rounded to the mean error: more leaves reduce the error further than more digits. Near the byte
# limit, growth of continuous leaves plans for a step of twice the mean error.
_FULL = 1.8  # mean errors: growth ends if the step is larger
_MOST_MEAN_ERRORS = 3.0  # mean errors: a larger step is not raised; a round whose file is still too large is rejected
_SMALLEST_STEP = 2.0**-22  # in units of the largest distance: the resolution of 32-bit floats
# Weight of the difference between a value and its prediction, relative to the samples of a cell: so small that it
# decides only values that no sample determines, inside walls.
_PREDICTION_WEIGHT = 1e-7
_UNPREDICTED = 1e-3  # factor of the difference from the mean value, for values without a prediction


@dataclass(frozen=True, eq=False)
class _FittedPartition:
    """A partition into leaves, the values fitted to the leaves, and the size of the file in bytes."""

    fit: CellFit
    stored: StoredValues
    num_bytes: int
    is_full: bool  # whether values had to be rounded so coarsely to fit into the byte limit that growth ends

    def __len__(self) -> int:
        return len(self.fit)


class _Rounds:
    """A construction in rounds: each round splits the leaves of largest error, then fits all leaves again."""

    def __init__(self, order: int, sampler: Sampler, rules: Rules, limits: Limits) -> None:
        self._order, self._sampler, self._rules, self._limits = order, sampler, rules, limits
        self._face_tests = FaceTests(sampler.distance_fn, sampler.domain)
        self._max_splits = limits.max_leaves

    def next(self, now: _FittedPartition) -> _FittedPartition | None:
        """Return the partition after one more round; None if growth ends.

        Growth ends if no more leaves fit into the limits, or if no leaf has an error worth a split.
        """
        while True:
            leaf, axis = self._next_splits(now)
            if len(leaf) == 0:
                return None
            children = self._sampler(now.fit.cells[leaf].split(axis))
            unsplit = np.setdiff1d(np.arange(len(now)), leaf)
            check_memory(2.0 * (len(unsplit) + len(children)))
            grown = self.fit_leaves(now.fit[unsplit].append(children))
            if grown.num_bytes <= self._limits.max_bytes:
                return grown
            self._max_splits = len(leaf) // 2  # too large: try half as many splits

    def _next_splits(self, now: _FittedPartition) -> tuple[Int[np.ndarray, " splits"], Int[np.ndarray, " splits"]]:
        """Return the leaves to split next (as indices) and their split axes; both arrays are empty if growth ends."""
        fit, limits = now.fit, self._limits
        # 1. Estimate how many splits the limits allow, if the file grows in proportion to the leaves. For continuous
        # leaves, count it with a doubled step, which saves one bit per value. Smooth leaves need the finer step.
        num_allowed = limits.max_leaves - len(now)
        if np.isfinite(limits.max_bytes):
            num_bytes = now.num_bytes - (len(now.stored.code) / 8 if self._order == 0 else 0)
            by_bytes = int(np.ceil(len(now) * (limits.max_bytes / num_bytes - 1)))
            num_allowed = min(num_allowed, self._max_splits, by_bytes)
            if now.is_full or num_allowed < _WORTH_A_ROUND * len(now):
                num_allowed = 0
        # 2. Choose how many of these splits to make in this round.
        num_splits = max(int(np.ceil(_SHARE_OF_ALLOWED * num_allowed)), int(_LEAST_SPLIT * len(now)))
        most_split = 1.0 if len(now) < _FEW_LEAVES * num_allowed else _MOST_SPLIT
        num_splits = min(num_splits, int(np.ceil(most_split * len(now))), num_allowed)
        # 3. Sort the leaves that may be split by priority.
        error = checked_priorities(fit, self._rules.should_split(fit))
        can_split = (fit.cells.depth < fit.max_axis_depth).any(axis=1)  # along some axis
        is_worth_it = (error > np.maximum(limits.tolerance, fit.noise)) & can_split
        priority = np.where(is_worth_it, error * 2.0 ** (-_VOLUME_POWER * fit.cells.depth.sum(axis=1)), 0.0)
        best = np.argsort(-priority, kind="stable")[: np.count_nonzero(is_worth_it)]
        # 4. Choose axes of the first leaves; if depth limits exclude some of them, of the leaves that follow.
        leaf, axis = np.empty(0, np.int64), np.empty(0, np.int64)
        while len(best) and len(leaf) < num_splits:
            tried, best = np.split(best, [num_splits - len(leaf)])
            tried_axis = checked_axes(fit[tried], self._rules.split(fit[tried]))
            may_split = is_within_depth(fit.cells[tried], tried_axis, limits)
            leaf = np.append(leaf, tried[may_split])
            axis = np.append(axis, tried_axis[may_split])
        return leaf, axis

    def fit_leaves(self, fit: CellFit) -> _FittedPartition:
        """Fit a function, continuous except across walls, to the samples of all leaves by least squares.

        The leaves in ``fit`` may have any order; the result has them from left to right in the tree. Fitted values
        are rounded to multiples of the mean error of the fit, or more coarsely if the byte limit asks for it. The
        file may still exceed the limit.
        """
        # 1. Sort the leaves by the tree, and find out which ones share values.
        tree = tree_of(fit.cells)
        fit = fit[tree.order]
        faces = shared_faces(tree, self._sampler.domain.periodic)
        tied = self._face_tests.are_free(tree.leaves, faces)
        unreachable = ~np.any(fit.reachable, axis=1)
        # A leaf with a free face is reachable even if none of its samples is.
        unreachable[np.append(faces[tied].lower, faces[tied].upper)] = False
        partition = TiedPartition(tree, unreachable, faces, tied)
        # 2. Fit values. Weights grow with the square root of cell volume: a compromise between mean error (volume)
        # and largest error (equal weights).
        of_cell = 2.0 ** (-0.5 * fit.cells.depth.sum(axis=1))
        weight = weights_of_fit(fit.reachable, fit.weight) * fit.pattern.weight * (of_cell / of_cell.mean())[:, None]
        values, residual = fit_values(self._order, partition.space, fit, weight)
        # 3. Round values to steps of their mean error; raise the step until the file fits, or the step is too large.
        mean_error = float(np.sum(weight * np.abs(residual)) / np.sum(weight))
        least = max(mean_error, _SMALLEST_STEP * float(np.abs(fit.value).max()), float(np.finfo(np.float32).tiny))
        step = least
        while True:
            stored = StoredValues.quantize(partition, values, step)
            stored.write(body := BitWriter())
            num_bytes = self._limits.file_size(fit.cells.dim, len(fit), body.num_bits, int(fit.is_cut_off.sum()))
            # Bits per value over the limit; doubling the step saves one.
            excess = 8 * (num_bytes - self._limits.max_bytes) / len(values)
            if excess <= 0 or step > _MOST_MEAN_ERRORS * least:
                return _FittedPartition(replace(fit, residual=residual), stored, num_bytes, step > _FULL * least)
            step *= 2 ** max(excess, 0.01)


def fit_values(order: int, space: NodalSpace, fit: CellFit, weight: OfSamples) -> tuple[Distances, OfSamples]:
    """Fit a finite-element function to the samples of leaves by weighted least squares.

    ``order`` is 0 for multilinear and 1 for cubic functions; ``weight`` has the weight of each sample. Return the
    values of the degrees of freedom, and the sampled distance minus the function at each sample (0 if the sample's
    weight is 0).
    """
    from scipy.sparse import bsr_array, diags_array

    # Minimize sum(w (f - d)^2) + lambda |x - P x|^2 over the values x. The function is f = B C x (C: coefficients, B:
    # basis functions at the samples), P x is the prediction, and lambda is small. Distances d and values x are
    # measured from the mean distance. A value without a prediction has the term (_UNPREDICTED x)^2 instead. So with
    # W = diag(w) and D = I - P (_UNPREDICTED in place of 1 for such values), the normal equations are
    #   (C^T (B^T W B) C + lambda D^T D) x = C^T B^T W d.
    # B is the same in all leaves: B^T W B has a block (terms, terms) for each leaf, on the diagonal.
    coefficients = coefficient_matrix(order, space)  # C
    functions = basis_values(order, (fit.pattern.u + 1) / 2)  # B in a leaf, (k, terms)
    terms, leaves = functions.shape[1], len(fit)
    products = (functions[:, :, None] * functions[:, None, :]).reshape(len(functions), -1)
    offsets = np.arange(leaves + 1)  # one block in each block row
    blocks = bsr_array((row_products(weight, products).reshape(-1, terms, terms), offsets[:-1], offsets))
    squares = coefficients.T @ (blocks @ coefficients)
    is_predicted = np.diff(space.prediction.indptr) > 0
    deviation = diags_array(np.where(is_predicted, 1.0, _UNPREDICTED)) - space.prediction  # D
    normal = squares + (_PREDICTION_WEIGHT * fit.pattern.weight.sum()) * (deviation.T @ deviation)
    mean = np.sum(weight * fit.value) / np.sum(weight)
    moments = row_products(weight * (fit.value - mean), functions).ravel()  # B^T W d
    values = mean + solve_normal(normal, coefficients.T @ moments, fit.cells.dim)
    errors = fit.value - row_products((coefficients @ values).reshape(leaves, terms), functions.T)
    return values, np.where(weight > 0, errors, 0.0)


@dataclass(frozen=True)
class Continuous(PolynomialLeafModel):
    """The leaf models ``"continuous"`` and ``"smooth"``: functions do not jump across free faces of leaves.

    A face between two leaves is free if the goal can be reached from both sides of some point of the face. Functions
    may jump across walls. Coefficients are the values at a leaf's corners and, for order 1, the derivatives there.

    Args:
        order: 0: continuous values, multilinear in every leaf (``"continuous"``), in at most 6 dimensions. 1:
            continuous gradients as well, cubic along every axis (``"smooth"``), in 1 or 2 dimensions: the rectangular
            element of Bogner, Fox and Schmit, 1965. Other values raise ``ValueError``.
    """

    order: int = 0

    def __post_init__(self):
        if self.order not in (0, 1):
            raise ValueError(f"order must be 0 or 1, got {self.order!r}.")
        # In 3 dimensions, a corner of smooth leaves may hang on two leaves with different cubics.
        name, num_powers, max_dim = (("continuous", 2, MAX_TIED_DIM), ("smooth", 4, 2))[self.order]
        decoder_cost = ((3_700, 800), (6_500, 5_600))[self.order]
        set_fields(self, name=name, num_powers=num_powers, max_dim=max_dim, decoder_cost=decoder_cost)

    def min_samples(self, dim: int) -> int:
        return 2**dim + 1  # one more than corners, whose values determine a leaf's function

    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, StoredValues, None]:
        rounds = _Rounds(self.order, sampler, rules, limits)
        first = rounds.fit_leaves(sampler.first_cells(limits.max_leaves))
        while first.num_bytes > limits.max_bytes and len(first) > 1:
            first = rounds.fit_leaves(sampler.first_cells(len(first) // 2))
        limits.require_room(first.num_bytes)
        stored = grow(first, rounds.next, limits).stored
        return stored.partition.tree, stored, None

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredValues) -> None:
        stored.write(body)

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredValues:
        offset, step = read_step(body)
        tree = tree_of(cells)
        if (np.diff(tree.order) < 0).any():
            raise ValueError("its tree splits in another order than tied leaves; this library did not write it")
        faces = shared_faces(tree, domain.periodic)
        partition = TiedPartition(tree, body.read_set(len(cells)), faces, np.zeros(len(faces), bool))
        may_be_tied = partition.may_be_tied()
        partition.tied[may_be_tied] = ~body.read_set(int(np.count_nonzero(may_be_tied)))
        space = partition.space
        code = np.zeros(len(space.free_dofs), np.int64)
        for level in _level_slices(space.level):
            surplus = body.read_signed(level.stop - level.start)
            code[level] = surplus + np.rint(space.prediction[level] @ code).astype(np.int64)
        return StoredValues(partition, offset, step, code)

    def coefficients(self, cells: Cells, stored: StoredValues) -> Coefficients:
        of_free_dofs = coefficient_matrix(self.order, stored.partition.space).tocsr().sorted_indices().tocoo()
        # bincount adds in a fixed order, so that all machines get the same bits.
        terms = of_free_dofs.data * stored.decode()[of_free_dofs.col]
        coefficients = np.bincount(of_free_dofs.row, terms, of_free_dofs.shape[0]).reshape(len(cells), -1)
        coefficients[stored.partition.unreachable, 0] = np.inf
        return coefficients

    def free_values(self, cells: Cells, stored: StoredValues) -> tuple[Distances, "csr_array"]:
        return stored.decode(), coefficient_matrix(self.order, stored.partition.space)

    def with_free_values(self, stored: StoredValues, values: Distances, step: float | None) -> StoredValues:
        difference = values - stored.offset
        least = max(UNIT * np.abs(difference).max(initial=0.0), np.finfo(np.float32).tiny)
        step = float(np.float32(max(step or stored.step, least)))  # codes fit 25 bits
        return replace(stored, step=step, code=np.rint(difference / step).astype(np.int64))

    def basis(self, u: Points) -> Coefficients:
        return basis_values(self.order, (u + 1) / 2)

    def coefficients_of_planes(self, center: Distances, half: Points) -> Coefficients:
        corners = corner_bits(half.shape[1])
        values = center[:, None] + half @ (2 * corners - 1).T
        if self.order == 0:
            return values
        coefficients = np.zeros((*values.shape, len(corners)))
        coefficients[:, :, 0] = values
        along_one_axis = 1 << np.arange(half.shape[1])[::-1]  # kinds of derivatives
        coefficients[:, :, along_one_axis] = 2 * half[:, None]  # a leaf has width 1 in t
        return coefficients.reshape(len(values), -1)

    def monomials(self, dim: int) -> Float[np.ndarray, "terms powers"]:
        return basis_monomials(self.order, dim)
