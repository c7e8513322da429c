"""What a leaf model is: the functions that leaves hold, how they are fitted, stored and evaluated."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, product_in_order, require_integer
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr.certificate import Proof
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import Corner, byte_class, is_far, max_axis_depth, rows_of_class
from plr_jax.plr.growth import DEFAULT_MAX_LEAVES, Limits, ShouldSplitRule, SplitRule, check_memory
from plr_jax.plr.sampling import Sampler
from plr_jax.plr.tree import MAX_DEPTH, Cells, Tree


class Rules(NamedTuple):
    """SHOULDSPLIT and SPLIT of Algorithm 1."""

    should_split: ShouldSplitRule
    split: SplitRule


UNIT = 2.0**-24
"""Largest relative error of rounding to 32-bit floats."""


class LeafModel(ABC):
    """A kind of leaf. Its instances are immutable and hashable: compiled queries are told apart by them.

    A leaf's function follows from its box and its *coefficients*; where the first of them is ``inf``, so is the
    value. What is *stored* is the model's own affair: an object that its ``write`` puts into a file and its ``read``
    gives back. What is abstract every model has to define; the others are defaults that it may override.

    Attributes:
        name: What ``construct(leaf=...)`` calls it.
        num_samples: Samples of a cell, unless others are asked for.
        least_bytes: Bytes of a file that a leaf takes at the least, a power of two, which may be a fraction.
        has_deep_trees: Whether small trees are deep, for which a query's tables have pages: see ``plr/tables.py``.
        is_cell_relative: Whether its functions are of the place in a cell, whose own numbers then stand before the others.
            Along each axis the number 1 is the domain, and the halves of ``i`` are ``2 i`` and ``2 i + 1``.
    """

    name: str
    num_samples: int = 96
    least_bytes: int | float = 1
    has_deep_trees: bool = False
    is_cell_relative: bool = False

    # How it is fitted.

    @abstractmethod
    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, Any]:
        """Grow a partition: its tree, and what is stored of the leaves in the order of the tree's traversal."""
        ...

    # How it is stored.

    @abstractmethod
    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: Any) -> None:
        """Append what a file keeps of the leaves."""
        ...

    @abstractmethod
    def read(self, body: BitReader, domain: Box, cells: Cells) -> Any:
        """What :meth:`write` appended; raises ``ValueError`` saying what is wrong with it."""
        ...

    @abstractmethod
    def coefficients(self, cells: Cells, stored: Any) -> Float[np.ndarray, "leaves terms"]:
        """Coefficients of every leaf's function.

        A leaf without a function, as nothing of it reaches the goal, has ``inf`` first and zeros after it.
        """
        ...

    # How it is evaluated.

    @abstractmethod
    def values(
        self,
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        coefficients: Float[np.ndarray, "n terms"],
        x: Float[np.ndarray, "n dim"],
    ) -> Float[np.ndarray, "n"]:
        """Values at points of the functions of leaves, which have boxes and finite coefficients, one a point."""
        ...

    @abstractmethod
    def leaf_parameters(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"], corner: Corner
    ) -> Float[np.ndarray, "leaves count"]:
        """What a query reads of every leaf; where the first coefficient is ``inf``, so is the value, of slope 0."""
        ...

    @abstractmethod
    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        """The value at a place, by operations whose order is part of the format: see ``plr/portable``.

        Args:
            parameters: Those of the leaf, without the ones of its cell; arrays, scalars or text of a program.
            place: Along each axis, from 0 to 1 in the leaf's cell or, unless it ``is_cell_relative``, how far from the
                domain's rounded lower corner.
            root: The square root.
        """
        ...

    # How well that is known, for proofs.

    @abstractmethod
    def cone_minus_leaf_bounds(
        self,
        lo: Float[np.ndarray, "n 2"],
        hi: Float[np.ndarray, "n 2"],
        coefficients: Float[np.ndarray, "n terms"],
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Bounds of cones ``offset + |x - apex|`` minus functions of leaves, over convex pieces, in the plane."""
        ...

    @abstractmethod
    def rounding_bounds(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
    ) -> Float[np.ndarray, "leaves"]:
        """Bound of how far a query in 32 bits, of a point of any precision, may be from each leaf's function."""
        ...

    # What follows.

    def num_leaf_parameters(self, dim: int) -> int:
        """How many :attr:`numbers` a query reads of a leaf: as of a value and one more along each axis."""
        return 1 + dim

    def check_dim(self, dim: int) -> None:  # noqa: B027
        """Raise ``ValueError`` if the model is not for so many axes; it is for any."""

    def min_samples(self, dim: int) -> int:
        """Samples of a cell that determine its function, at the least."""
        return self.num_leaf_parameters(dim)

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        """Bytes that so many leaves count without a budget: they may be as deep as in a file of that size.

        Their own file may be smaller, and its class give fewer slots than they then need.
        """
        return int(2 * self.least_bytes * num_leaves)

    def mean_planes(
        self,
        lo: Float[np.ndarray, "leaves dim"],
        hi: Float[np.ndarray, "leaves dim"],
        coefficients: Float[np.ndarray, "leaves terms"],
    ) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        """The mean plane of every leaf: value at the center, half-differences between opposite faces' centers."""
        center, half = (lo + hi) / 2, np.empty_like(lo)
        for axis in range(lo.shape[1]):
            step = np.where(np.arange(lo.shape[1]) == axis, (hi - lo) / 2, 0.0)
            above, below = (self.values(lo, hi, coefficients, center + sign * step) for sign in (1, -1))
            half[:, axis] = (above - below) / 2
        return self.values(lo, hi, coefficients, center), half


class LinearLeafModel(LeafModel):
    """Leaves whose functions are linear in their coefficients, so that they can be refined.

    In the local coordinates ``u`` of a leaf (``[-1, 1]`` along every axis) its function is
    ``basis(u) @ coefficients``.
    """

    @abstractmethod
    def basis(self, u: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n terms"]:
        """What the coefficients multiply at local coordinates ``u``."""
        ...

    @abstractmethod
    def coefficients_of_planes(
        self, center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
    ) -> Float[np.ndarray, "leaves terms"]:
        """Coefficients with which leaves hold planes, of given values at the center and half-differences."""
        ...

    def values(
        self,
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        coefficients: Float[np.ndarray, "n terms"],
        x: Float[np.ndarray, "n dim"],
    ) -> Float[np.ndarray, "n"]:
        """Values at points of the functions of leaves, one a point."""
        return np.sum(self.basis((2 * x - lo - hi) / (hi - lo)) * coefficients, axis=1)

    def mean_planes(
        self, lo: Any, hi: Any, coefficients: Float[np.ndarray, "leaves terms"]
    ) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        """The mean plane of every leaf."""
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
    """Limits with every None replaced, after checking the ranges of what :func:`construct` is given."""
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
    """Largest coordinate of a point that a query rounds to 32 bits, along each axis.

    Where the domain is far from the origin, points are counted from a corner before.
    """
    return domain.width if is_far(domain) else np.max([abs(domain.lo), abs(domain.hi), domain.width], axis=0)
