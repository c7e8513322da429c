"""Values at the corners of leaves, tied across free faces, all fitted at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, cone_above_plane
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import Corner
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.leaves.base import (
    UNIT,
    CornerLeafModel,
    Rules,
    largest_coordinates,
)
from plr_jax.plr.leaves.continuous.codec import (
    StoredValues,
    TiedPartition,
    numbers_of_polynomials,
    polynomial,
    read_values,
    write_values,
)
from plr_jax.plr.leaves.continuous.growth import grow_tied
from plr_jax.plr.leaves.continuous.space import (
    MAX_DIM_OF_ORDER,
    POWERS,
    design,
    enclosing_planes,
    monomials,
    numbers_of_leaves,
    numbers_of_planes,
)
from plr_jax.plr.partition.cells import Cells, Tree
from plr_jax.plr.partition.faces import SharedFaces
from plr_jax.plr.sampling.cell_fit import Sampler

_MOST_DOUBLINGS = 24  # of a step, with which values become a handful of bits


@dataclass(frozen=True)
class Continuous(CornerLeafModel):
    """Functions that do not jump across free faces: a face with a point whose two sides can both be reached.

    A face in a wall ties nothing, so nothing blends across walls. Coefficients are values at a leaf's corners, of
    order 1 derivatives there too (see ``space.py``).

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

    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Cells, StoredValues]:
        """Grow the partition, all values fitted again in every round."""
        stored = grow_tied(self.order, sampler, rules, limits)
        return stored.partition.tree.leaves, stored

    def of_corners(
        self,
        tree: Tree,
        faces: SharedFaces,
        tied: Bool[np.ndarray, "faces"],
        unreachable: Bool[np.ndarray, "leaves"],
        values: Float[np.ndarray, "leaves corners"],
        step: float,
    ) -> StoredValues:
        """What is stored of leaves with these values, of order 0; hanging corners follow from others."""
        partition = TiedPartition(tree, unreachable, faces, tied)
        space = partition.space
        of_group = np.zeros(int(space.group.max()) + 1)
        of_group[space.group] = values.ravel()
        return StoredValues.rounded(partition, of_group[space.masters], step)

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredValues) -> None:
        """Append what the file keeps of the leaves."""
        write_values(body, stored)

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredValues:
        """What :meth:`write` appended."""
        return read_values(body, cells, domain.periodic)

    def unreachable(self, stored: StoredValues) -> Bool[np.ndarray, "leaves"]:
        """Which leaves have no tied face and no sample that reaches the goal."""
        return stored.partition.unreachable

    def coefficients(self, cells: Cells, stored: StoredValues) -> Float[np.ndarray, "leaves terms"]:
        """Numbers of every leaf; 0 for unreachable ones."""
        of_masters = numbers_of_leaves(self.order, stored.partition.space).tocsr().sorted_indices().tocoo()
        terms = of_masters.data * stored.decode()[of_masters.col]  # summed in their order, on any processor alike
        return np.bincount(of_masters.row, terms, of_masters.shape[0]).reshape(len(cells), -1)

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
        """What a query reads of every leaf."""
        return numbers_of_polynomials(self.order, cells, coefficients)

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
