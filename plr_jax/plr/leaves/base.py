"""The interface of leaf models: how functions in leaves of a PLR, such as planes, are fitted, stored and bounded."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, product_in_order, require_integer
from plr_jax._types import CellSources, Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, cone_above_plane
from plr_jax.plr.certificate import Bounds, LeafFunctions, Proof
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.finite_elements import enclosing_planes
from plr_jax.plr.frame import Corner, is_far
from plr_jax.plr.growth import DEFAULT_MAX_LEAVES, Limits, ShouldSplitRule, SplitRule, check_memory
from plr_jax.plr.sampling import Sampler
from plr_jax.plr.sizes import byte_class, max_axis_depth, rows_of_class
from plr_jax.plr.tree import MAX_DEPTH, Cells, Tree

Coefficients: TypeAlias = Float[np.ndarray, "n terms"]
Parameters: TypeAlias = Float[np.ndarray, "n count"]


class Rules(NamedTuple):
    """The rules by which a construction splits leaves; see :data:`ShouldSplitRule`."""

    should_split: ShouldSplitRule
    split: SplitRule


class GivenLimits(NamedTuple):
    """The limits that :func:`construct` was given; None for each limit that was not given."""

    max_depth: int | None = None
    max_leaves: int | None = None
    max_bytes: int | None = None
    tolerance: int | float | None = None


MAX_TIED_DIM = 6  # largest dimension of continuous leaves, which have 64 corners there
UNIT = 2.0**-24  # largest relative error of rounding to 32-bit floats


class LeafModel(ABC):
    """A kind of function that leaves of a PLR hold, such as planes; models are hashable for compiled queries.

    The data of leaves has three forms:

    - *Stored* data, one object for all leaves, is what a file holds.
    - *Coefficients*, one row per leaf, determine the leaf's function in its box. If the first coefficient is ``inf``,
      the function is the constant ``inf``.
    - *Parameters*, one row per leaf, are the numbers that a query reads. If the model ``is_cell_relative``, each row
      begins with the number of the leaf's cell along each axis: the domain has number 1, and the halves of cell ``i``
      have the numbers ``2 i`` and ``2 i + 1``.
    """

    name: str
    num_samples: int = 96  # in a cell, by default
    max_dim: int | float = np.inf  # largest number of axes of a domain
    # About the fewest bytes of a leaf in a file, a power of two such as 0.5: sizes of tables follow (`sizes.py`).
    least_bytes: int | float = 1
    has_deep_trees: bool = False  # whether small files may have deep trees, whose lookup tables have pages
    is_cell_relative: bool = False  # whether functions take coordinates from 0 to 1 in the leaf's cell
    has_exact_cone_bounds: bool = False  # whether cone_minus_leaf_bounds are the least and largest difference
    splits_by_proven_error: bool = False  # whether, if certified, a tolerance limits proven errors, not sampled ones
    # Most bytes of code and of stack of the decoder in compact C headers, measured as `portable/c.py` says. Without a
    # decoder, both are 0.
    decoder_cost: tuple[int, int] = (0, 0)
    num_powers: int = 0  # of each coordinate in a leaf's polynomial, the exponents from 0; 0: plane or cone

    @abstractmethod
    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, Any, CellSources | None]:
        """Find a partition within the limits and fit its leaves.

        Return the tree, the leaves' stored data and, if the search computed them, the leaves' sources for a proof.
        """

    @abstractmethod
    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: Any) -> None:
        """Append the stored data of leaves, which are the ``cells`` of a domain, to the body of a file."""

    @abstractmethod
    def read(self, body: BitReader, domain: Box, cells: Cells) -> Any:
        """Read the stored data that :meth:`write` wrote; ``ValueError`` if it is invalid."""

    @abstractmethod
    def coefficients(self, cells: Cells, stored: Any) -> Coefficients:
        """Return the coefficients of the leaves' functions, decoded from the stored data."""

    @abstractmethod
    def values(self, lo: Points, hi: Points, coefficients: Coefficients, x: Points) -> Distances:
        """Return the value of the function of leaf ``i``, the box from ``lo[i]`` to ``hi[i]``, at point ``x[i]``."""

    @abstractmethod
    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        """Return the parameters of the leaves, the numbers that a query reads, one row per leaf.

        The query uses these numbers with points minus ``corner``.
        """

    @abstractmethod
    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        """Return a leaf's value at a point, by operations whose order is part of the file format.

        All numbers are arrays, scalars or expressions of generated code; ``root`` computes the square root of a
        number. ``parameters`` are the leaf's parameters without the numbers of its cell. ``place`` has the
        coordinates of the point: from 0 to 1 across the leaf if ``is_cell_relative``, else measured from the domain's
        lower corner.
        """

    @abstractmethod
    def cone_minus_leaf_bounds(self, leaf: LeafFunctions, pieces: Pieces, apex: Points, offset: Distances) -> Bounds:
        """Return lower and upper bounds of a cone minus a leaf's function, over a convex polygon in the leaf.

        Bounds ``i`` are for the function ``leaf[i]``, the polygon ``pieces[:, i]`` and the cone ``offset[i] + |x -
        apex[i]|``.
        """

    @abstractmethod
    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        """Return, for each leaf, an upper bound of the error of evaluating its function in 32-bit floats."""

    def num_leaf_parameters(self, dim: int) -> int:
        return dim + self.num_powers**dim if self.num_powers else 1 + dim

    def min_samples(self, dim: int) -> int:
        """Return the least number of samples in a cell: as many as a plane has coefficients, unless overridden."""
        return 1 + dim

    def check_domain(self, domain: Box) -> None:
        """Raise ``ValueError`` if the model does not support the domain."""
        if domain.dim > self.max_dim:
            expected = f"a domain of up to {self.max_dim} dimensions, got {domain.dim}"
            advice = f"Use {'continuous leaves or ' * (domain.dim <= MAX_TIED_DIM)}planes, which may jump, instead."
            raise ValueError(f"Leaves of kind {self.name!r} need {expected}. {advice}")

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        # The file size from which the largest depth of leaves follows, if ``num_leaves`` is the only limit.
        return int(2 * self.least_bytes * num_leaves)

    def mean_planes(self, lo: Points, hi: Points, coefficients: Coefficients) -> tuple[Distances, Points]:
        """Approximate each leaf's function by a plane; return the value at the leaf's center, and half of the rise.

        The rise is the change of the plane across the leaf along each axis.
        """
        # The rise along an axis is the difference of the values at the centers of the two faces.
        center = (lo + hi) / 2
        half = np.empty_like(lo)
        for axis in range(lo.shape[1]):
            step = np.where(np.arange(lo.shape[1]) == axis, (hi - lo) / 2, 0.0)
            above, below = (self.values(lo, hi, coefficients, center + sign * step) for sign in (1, -1))
            half[:, axis] = (above - below) / 2
        return self.values(lo, hi, coefficients, center), half


class LinearLeafModel(LeafModel):
    """A leaf model with functions ``basis(u) @ coefficients`` of coordinates ``u`` from -1 to 1 across the leaf."""

    @abstractmethod
    def basis(self, u: Points) -> Coefficients:
        """Return the basis functions (columns) at points ``u`` (rows) of a cell, with coordinates from -1 to 1."""

    @abstractmethod
    def coefficients_of_planes(self, center: Distances, half: Points) -> Coefficients:
        """Return the coefficients of planes, given by the value at each leaf's center and half of the plane's rise.

        The rise is the change of the plane across the leaf along each axis.
        """

    @abstractmethod
    def free_values(self, cells: Cells, stored: Any) -> tuple[Distances, Any]:
        """Return the *free values*, numbers that determine all leaf functions, and their matrix to coefficients.

        Free values, ``(values,)``, may be replaced by any finite numbers, as in training. The sparse matrix,
        ``(leaves * terms, values)``, times the free values gives the coefficients of one leaf after another. Rows of
        leaves without a function are 0.
        """

    @abstractmethod
    def with_free_values(self, stored: Any, values: Distances, step: float | None) -> Any:
        """Return stored data with other free values (:meth:`free_values`), rounded with a step of at most ``step``.

        If ``step`` is None, it is the step of ``stored``. A larger step is used if integers would get too large.
        """

    def values(self, lo: Points, hi: Points, coefficients: Coefficients, x: Points) -> Distances:
        return np.sum(self.basis((2 * x - lo - hi) / (hi - lo)) * coefficients, axis=1)

    def mean_planes(self, lo: Points, hi: Points, coefficients: Coefficients) -> tuple[Distances, Points]:
        # As in the base class, from the values at u = +-(1, 0, ...), +-(0, 1, ...), ... and u = 0: products with
        # basis(u).
        ends = np.eye(lo.shape[1])
        half = product_in_order(coefficients, (self.basis(ends) - self.basis(-ends)).T) / 2
        return product_in_order(coefficients, self.basis(0 * ends[:1]).T)[:, 0], half


class PolynomialLeafModel(LinearLeafModel):
    """A base class of leaf models with polynomials of coordinates ``t``, from 0 to 1 across the leaf.

    Each coordinate has exponents from 0 to ``num_powers - 1``. A query reads the coefficient of each product of
    powers; the exponent of the last axis varies fastest.
    """

    is_cell_relative = True

    @abstractmethod
    def monomials(self, dim: int) -> Float[np.ndarray, "terms powers"]:
        """Return the functions of :meth:`basis` as polynomials of ``t``: one row of coefficients per function."""

    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        is_inf = np.isinf(coefficients[:, 0])
        powers = product_in_order(np.where(is_inf[:, None], 0.0, coefficients), self.monomials(cells.dim))
        powers[is_inf, 0] = np.inf
        # The number of a cell along an axis: 2**depth + position (see :class:`LeafModel`).
        return np.concatenate([np.ldexp(1.0, cells.depth) + cells.position, powers], axis=1)

    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        # Horner's rule in place[0]: part k, the coefficient of place[0]**k, is a polynomial of the other coordinates.
        if not place:
            return parameters[0]
        stride = len(parameters) // self.num_powers
        parts = [parameters[power * stride : (power + 1) * stride] for power in range(self.num_powers)]
        total, *others = (self.value(part, place[1:], root) for part in reversed(parts))
        for term in others:
            total = total * place[0] + term
        return total

    def cone_minus_leaf_bounds(self, leaf: LeafFunctions, pieces: Pieces, apex: Points, offset: Distances) -> Bounds:
        # Taylor's expansion about the center c of a piece's bounding box: there, the leaf's function at x is
        #   value + slope . (x - c) = intercept + slope . x,    up to an error of at most `remainder`.
        # `center` and `half_width` are in local coordinates, from 0 to 1 across the leaf.
        piece_lo, piece_hi = pieces.min(axis=2).T, pieces.max(axis=2).T
        width = leaf.hi - leaf.lo
        center = ((piece_lo + piece_hi) / 2 - leaf.lo) / width
        half_width = (piece_hi - piece_lo) / 2 / width
        powers = (leaf.coefficients @ self.monomials(2)).reshape(-1, self.num_powers, self.num_powers)
        value, slope, remainder = enclosing_planes(powers, center, half_width)
        slope = slope / width
        intercept = value - (slope * (piece_lo + piece_hi)).sum(axis=1) / 2
        lowest, highest = cone_above_plane(pieces, apex, offset, slope, intercept)
        return lowest - remainder, highest + remainder

    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        powers = np.abs(np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients) @ self.monomials(cells.dim))
        num_powers = self.num_powers
        # Relative errors, in UNIT: of the local coordinate (coordinates and steps of its computation), times the
        # largest exponent; of Horner's rule, a product and a sum per step; and of the stored coefficients, 1. The
        # factor 1.02 covers products of these errors.
        of_place = (num_powers - 1) * np.ldexp(1.0, cells.depth) @ (largest_coordinates(domain) / domain.width + 4)
        return 1.02 * UNIT * powers.sum(axis=1) * (2 * num_powers * cells.dim + 1 + of_place)


def read_step(body: BitReader) -> list[float]:
    """Read the offset and the step of integers that stand for ``offset + step * integer``."""
    offset, step = body.read_floats(2).tolist()
    if not (np.isfinite(offset) and 0 < step < np.inf):
        raise ValueError(f"it states a step of {step} from {offset}")
    return [offset, step]


def check_limits(model: LeafModel, dim: int, proof: Proof, frame_bytes: int, given: GivenLimits) -> Limits:
    """Check the limits that :func:`construct` was given, and return them with defaults in place of None.

    ``proof`` is the kind of error bounds in the file. The file without leaves and bounds takes ``frame_bytes`` bytes.
    """
    # 1. Check the values.
    max_depth, max_leaves, max_bytes, tolerance = given
    for name, value, least in ("max_depth", max_depth, 0), ("max_leaves", max_leaves, 1), ("max_bytes", max_bytes, 1):
        if value is not None:
            require_integer(name, value, least)
    if max_depth is not None and max_depth > MAX_DEPTH:
        raise ValueError(f"max_depth must be at most {MAX_DEPTH}, got {max_depth}.")
    if tolerance is not None:
        as_finite("tolerance", tolerance)
    if given == GivenLimits():
        max_leaves = DEFAULT_MAX_LEAVES
    # 2. The lookup tables depend on the file's size: take the smaller of the sizes that the bytes and leaves allow.
    max_bytes = None if max_bytes is None else int(max_bytes)
    sizes = (max_bytes, None if max_leaves is None else model.bytes_without_budget(dim, int(max_leaves)))
    table_class = min((byte_class(size) for size in sizes if size is not None), default=None)
    # 3. Fill in defaults.
    most_leaves = np.iinfo(np.int64).max if max_leaves is None else int(max_leaves)
    if max_bytes is not None:
        most_leaves = min(most_leaves, rows_of_class(byte_class(max_bytes), model.least_bytes))
    max_depth = MAX_DEPTH if max_depth is None else int(max_depth)
    is_deep = model.has_deep_trees or proof in (Proof.CLASSES, Proof.LEAVES)
    if tolerance is None:
        check_memory(2.0 * min(float(most_leaves), 2.0**max_depth))
    axis_depth = max_axis_depth(dim, table_class, model.least_bytes, is_deep)
    most_bytes = np.inf if max_bytes is None else float(max_bytes)
    return Limits(max_depth, axis_depth, most_leaves, most_bytes, float(tolerance or 0), proof, frame_bytes)


def largest_coordinates(domain: Box) -> Float[np.ndarray, " dim"]:
    """Return an upper bound of the absolute coordinates that a query computes with, along each axis.

    In a domain far from the origin, coordinates are relative to its lower corner.
    """
    return domain.width if is_far(domain) else np.max([abs(domain.lo), abs(domain.hi), domain.width], axis=0)
