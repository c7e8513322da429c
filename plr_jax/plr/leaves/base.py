"""The interface of leaf models, such as planes: how functions of leaves are fitted, stored, evaluated and bounded."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, product_in_order, require_integer
from plr_jax._types import Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr.certificate import Proof
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import Corner, byte_class, is_far, max_axis_depth, rows_of_class
from plr_jax.plr.growth import DEFAULT_MAX_LEAVES, Limits, ShouldSplitRule, SplitRule, check_memory
from plr_jax.plr.sampling import Sampler
from plr_jax.plr.tree import MAX_DEPTH, Cells, Tree

Coefficients: TypeAlias = Float[np.ndarray, "n terms"]
Parameters: TypeAlias = Float[np.ndarray, "n count"]


class Rules(NamedTuple):
    should_split: ShouldSplitRule
    split: SplitRule


UNIT = 2.0**-24  # largest relative error of rounding to 32-bit floats


class LeafModel(ABC):
    """A kind of leaf, such as planes; immutable and hashable, as it is a key of the cache of compiled queries.

    Leaf data has three forms. *Stored* data is that of a file, for all leaves together. *Coefficients* determine a
    leaf's function in its box: the constant ``inf`` if the first is ``inf``. *Parameters* are the numbers that a
    query reads. If the model ``is_cell_relative``, the parameters begin with the number of the leaf's cell along each
    axis: the domain has number 1, and the halves of cell ``i`` have ``2 i`` and ``2 i + 1``.
    """

    name: str
    num_samples: int = 96  # in a cell, by default
    least_bytes: int | float = 1  # of a leaf in a file, a power of two that may be a fraction
    has_deep_trees: bool = False  # whether small files may have deep trees, whose lookup tables have pages
    is_cell_relative: bool = False  # whether functions take coordinates from 0 to 1 in the leaf's cell
    has_exact_cone_bounds: bool = False  # whether cone_minus_leaf_bounds are the least and largest difference

    @abstractmethod
    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, Any]:
        """Grow a partition; return its tree, and the stored form of its leaves in the tree's order."""

    @abstractmethod
    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: Any) -> None: ...

    @abstractmethod
    def read(self, body: BitReader, domain: Box, cells: Cells) -> Any: ...

    @abstractmethod
    def coefficients(self, cells: Cells, stored: Any) -> Coefficients:
        """Return the coefficients of all leaves; ``inf`` and zeros for leaves that are stored as unreachable."""

    @abstractmethod
    def values(self, lo: Points, hi: Points, coefficients: Coefficients, x: Points) -> Distances:
        """Return the value of each leaf's function at one point, for finite coefficients."""

    @abstractmethod
    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        """Return the numbers that a query reads for each leaf, for coordinates relative to ``corner``."""

    @abstractmethod
    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        """Return a leaf's value at a point; the order of operations is part of the file format.

        Arguments are arrays, scalars or generated code. ``parameters`` lack the cell's numbers; ``root`` is a square
        root. ``place`` is from 0 to 1 across the cell if ``is_cell_relative``, else from the domain's lower corner.
        """

    @abstractmethod
    def cone_minus_leaf_bounds(
        self, lo: Points, hi: Points, coefficients: Coefficients, pieces: Pieces, apex: Points, offset: Distances
    ) -> tuple[Distances, Distances]:
        """Return lower and upper bounds of ``(offset + |x - apex|) - leaf function`` over convex pieces of leaves."""

    @abstractmethod
    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        """Bound the difference between a 32-bit query at a point of any precision and each leaf's exact function."""

    def num_leaf_parameters(self, dim: int) -> int:
        return 1 + dim

    def check_dim(self, dim: int) -> None:  # noqa: B027
        """Raise ``ValueError`` if the model does not support domains of ``dim`` axes."""

    def min_samples(self, dim: int) -> int:
        return self.num_leaf_parameters(dim)

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        """Return the file size, in bytes, that bounds the depth of cells if ``num_leaves`` is the only limit."""
        return int(2 * self.least_bytes * num_leaves)

    def mean_planes(self, lo: Points, hi: Points, coefficients: Coefficients) -> tuple[Distances, Points]:
        """Return the value at each leaf's center, and half of the rise between opposite face centers."""
        center, half = (lo + hi) / 2, np.empty_like(lo)
        for axis in range(lo.shape[1]):
            step = np.where(np.arange(lo.shape[1]) == axis, (hi - lo) / 2, 0.0)
            above, below = (self.values(lo, hi, coefficients, center + sign * step) for sign in (1, -1))
            half[:, axis] = (above - below) / 2
        return self.values(lo, hi, coefficients, center), half


class LinearLeafModel(LeafModel):
    """A leaf model with functions ``basis(u) @ coefficients`` of coordinates ``u`` from -1 to 1 across the leaf."""

    @abstractmethod
    def basis(self, u: Points) -> Coefficients: ...

    @abstractmethod
    def coefficients_of_planes(self, center: Distances, half: Points) -> Coefficients:
        """Return coefficients of planes, given by their center values and half of their rise along each axis."""

    def values(self, lo: Points, hi: Points, coefficients: Coefficients, x: Points) -> Distances:
        return np.sum(self.basis((2 * x - lo - hi) / (hi - lo)) * coefficients, axis=1)

    def mean_planes(self, lo: Points, hi: Points, coefficients: Coefficients) -> tuple[Distances, Points]:
        ends = np.eye(lo.shape[1])
        half = product_in_order(coefficients, (self.basis(ends) - self.basis(-ends)).T) / 2
        return product_in_order(coefficients, self.basis(0 * ends[:1]).T)[:, 0], half


def check_limits(
    model: LeafModel,
    dim: int,
    max_depth: int | None,
    max_leaves: int | None,
    max_bytes: int | None,
    tolerance: int | float | None,
    proof: Proof,
    frame_bytes: int,
) -> Limits:
    """Check the limits given to :func:`construct`, and replace every None by its default."""
    for name, value, least in (
        ("max_depth", max_depth, 0),
        ("max_leaves", max_leaves, 1),
        ("max_bytes", max_bytes, 1),
    ):
        if value is not None:
            require_integer(name, value, least)
    if max_depth is not None and max_depth > MAX_DEPTH:
        raise ValueError(f"max_depth must be at most {MAX_DEPTH}, got {max_depth}.")
    if tolerance is not None:
        as_finite("tolerance", tolerance)
    if max_depth is None and max_leaves is None and max_bytes is None and tolerance is None:
        max_leaves = DEFAULT_MAX_LEAVES
    max_bytes = None if max_bytes is None else int(max_bytes)
    sizes = (max_bytes, None if max_leaves is None else model.bytes_without_budget(dim, int(max_leaves)))
    table_class = min((byte_class(size) for size in sizes if size is not None), default=None)
    most_leaves = np.iinfo(np.int64).max if max_leaves is None else int(max_leaves)
    if max_bytes is not None:
        most_leaves = min(most_leaves, rows_of_class(byte_class(max_bytes), model.least_bytes))
    max_depth = MAX_DEPTH if max_depth is None else int(max_depth)
    is_deep = model.has_deep_trees or proof in (Proof.CLASSES, Proof.LEAVES)
    if tolerance is None:
        check_memory(2.0 * min(float(most_leaves), 2.0**max_depth))
    return Limits(
        max_depth=max_depth,
        max_axis_depth=max_axis_depth(dim, table_class, model.least_bytes, is_deep),
        max_leaves=most_leaves,
        max_bytes=np.inf if max_bytes is None else float(max_bytes),
        tolerance=0.0 if tolerance is None else float(tolerance),
        proof=proof,
        frame_bytes=frame_bytes,
    )


def largest_coordinates(domain: Box) -> Float[np.ndarray, "dim"]:
    """Return the largest coordinates in a domain, relative to its lower corner if it is far from the origin."""
    return domain.width if is_far(domain) else np.max([abs(domain.lo), abs(domain.hi), domain.width], axis=0)
