"""A plane in every leaf, each fitted to its own samples: the paper's model."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import sum_of_columns
from plr_jax.geometry.box import Box
from plr_jax.geometry.cone_differences import cone_above_plane
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr.certificate.bounds import proven_errors
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.growth.best_first import Encoding, fit_sampled, grow_best_first
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.nodes import Nodes, nodes_of_fit
from plr_jax.plr.growth.rules import largest_error
from plr_jax.plr.leaves.base import (
    UNIT,
    Functions,
    Parameters,
    Rules,
    largest_coordinates,
    linear_mean_planes,
    linear_values,
    rounded_down,
)
from plr_jax.plr.leaves.plane.codec import (
    FLOAT_BITS,
    MAX_BITS,
    MIN_BITS,
    StoredPlanes,
    encode_planes,
    planes_bits,
    read_planes,
    write_planes,
)
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import levels_of
from plr_jax.plr.query.frame import Corner, table_corners
from plr_jax.plr.query.grid import MOST_ROWS
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler, with_unseen_planes

_BUDGET_BITS = range(8, 17)  # of center values, that construction chooses from under a budget of bytes


@dataclass(frozen=True)
class Plane:
    """Planes, which may jump from leaf to leaf. Coefficients: value at a leaf's center, half-differences.

    Args:
        coefficient_bits: Bits of a stored center value: 32 for floats, 4 to 20 for scaled integers, of which
            half-differences need fewer. None: 32 without ``max_bytes``; with it, those from 8 to 16 with which
            the expected error, of the fit and of the rounding together, is least.

    Raises:
        ValueError: If the bits are none of these.
    """

    coefficient_bits: int | None = None

    name = "plane"
    num_samples = 192
    least_bytes = 2
    has_deep_trees = False
    is_of_cells = False

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        """Their coefficients', and 32 KB at least: the plane next to a goal errs the less, the deeper it may be.

        In the plane that is up to 9 halvings along an axis, for which a smaller file's class may give too few slots.
        """
        return max((1 + dim) * FLOAT_BITS // 8 * num_leaves, MOST_ROWS * self.least_bytes)

    def __post_init__(self):
        bits = self.coefficient_bits
        if bits is not None and not isinstance(bits, int | np.integer):
            raise ValueError(f"coefficient_bits must be an integer, got {bits!r}.")
        if bits not in (None, FLOAT_BITS, *range(MIN_BITS, MAX_BITS + 1)):
            raise ValueError(
                f"coefficient_bits must be {FLOAT_BITS} (floats) or {MIN_BITS} to {MAX_BITS}, got {bits}."
            )

    def check_dim(self, dim: int) -> None:
        """Planes are for any number of axes."""

    def least_samples(self, dim: int) -> int:
        """With so many samples a plane passes through them."""
        return dim + 1

    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Cells, StoredPlanes]:
        """Grow the partition best-first, each leaf's plane fitted once."""
        by_proof = rules.should_split is largest_error and limits.proof is not Proof.NONE

        def nodes_of(fit: CellFit, bound: Float[np.ndarray, "cells"]) -> Nodes:
            fit = with_unseen_planes(fit, sampler)
            priority = self._proven_errors(fit, sampler) if by_proof else np.asarray(rules.should_split(fit), float)
            axis = np.asarray(rules.split(fit))
            return nodes_of_fit(fit, np.column_stack([fit.center, fit.half]), bound, priority, axis, limits)

        root = nodes_of(sampler.root(pieces_suffice=by_proof), np.array([np.inf]))

        def size(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> int:
            cells = nodes.cells[leaf]
            return limits.file_size(cells.dim, len(leaf), planes_bits(cells.depth, _stored(nodes, leaf, bits)))

        encoding = Encoding(self._choices(limits), size, _rounding_error)
        nodes, leaf, bits = grow_best_first(root, fit_sampled(sampler, nodes_of), limits, encoding)
        leaf = leaf[levels_of(nodes.cells[leaf])[1]]
        return nodes.cells[leaf], _stored(nodes, leaf, bits)

    def _proven_errors(self, fit: CellFit, sampler: Sampler) -> Float[np.ndarray, "cells"]:
        """Of the planes of cells."""
        assert sampler.memory is not None, "what has a proof answers for cells"
        planes = np.column_stack([np.where(np.isfinite(fit.center), fit.center, 0.0), fit.half])
        functions = *fit.cells.boxes(sampler.domain), planes
        return proven_errors(sampler.memory.sources(fit.cells), self.below_cones, functions)

    def _choices(self, limits: Limits) -> Sequence[int]:
        if self.coefficient_bits is not None:
            return [int(self.coefficient_bits)]
        return _BUDGET_BITS if np.isfinite(limits.max_bytes) else [FLOAT_BITS]

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredPlanes) -> None:
        """Append what the file keeps of the leaves."""
        write_planes(body, cells.depth, stored)

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredPlanes:
        """What :meth:`write` appended."""
        return read_planes(body, cells.depth)

    def unreachable(self, stored: StoredPlanes) -> Bool[np.ndarray, "leaves"]:
        """Which leaves have no sample that reaches the goal."""
        return stored.unreachable

    def coefficients(self, cells: Cells, stored: StoredPlanes) -> Float[np.ndarray, "leaves terms"]:
        """Center values, 0 for unreachable leaves, and half-differences."""
        center, half = stored.decode()
        return np.column_stack([np.where(stored.unreachable, 0.0, center), half])

    def basis(self, u: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n terms"]:
        """What the coefficients multiply at local coordinates ``u``."""
        return np.concatenate([np.ones((len(u), 1)), u], axis=1)

    def values(
        self,
        lo: Float[np.ndarray, "n dim"],
        hi: Float[np.ndarray, "n dim"],
        coefficients: Float[np.ndarray, "n terms"],
        x: Float[np.ndarray, "n dim"],
    ) -> Float[np.ndarray, "n"]:
        """Values at points of the functions of leaves, one a point."""
        return linear_values(self, lo, hi, coefficients, x)

    def mean_planes(
        self,
        lo: Float[np.ndarray, "leaves dim"],
        hi: Float[np.ndarray, "leaves dim"],
        coefficients: Float[np.ndarray, "leaves terms"],
    ) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
        """The mean plane of every leaf."""
        return linear_mean_planes(self, coefficients, lo.shape[1])

    def of_planes(
        self, center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
    ) -> Float[np.ndarray, "leaves terms"]:
        """Coefficients of planes."""
        return np.column_stack([center, half])

    def parameters(self, cells: Cells, stored: StoredPlanes) -> Parameters:
        """All coefficients are free."""
        values = self.coefficients(cells, stored).ravel()
        each = np.arange(len(values))
        return Parameters(values, each, each, np.ones(len(values)))

    def restored(self, stored: StoredPlanes, values: Float[np.ndarray, "parameters"]) -> Iterator[StoredPlanes]:
        """Other planes, with as many bits as before, then with fewer."""
        planes = values.reshape(len(stored.center), -1)
        center = np.where(stored.unreachable, np.inf, planes[:, 0])
        for bits in (stored.bits, *range(min(stored.bits - 1, MAX_BITS), MIN_BITS - 1, -1)):
            yield encode_planes(center, planes[:, 1:], bits)

    def raised(self, stored: StoredPlanes, shift: float) -> StoredPlanes:
        """All planes higher by a number, or by a little less."""
        if stored.bits == FLOAT_BITS:
            center, half = stored.decode()
            return encode_planes(rounded_down(center + shift), half, FLOAT_BITS)
        return replace(stored, offset=float(rounded_down(np.array(stored.offset + shift))))

    def numbers(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"], corner: Corner
    ) -> Float[np.ndarray, "leaves terms"]:
        """Its plane's value at the corner, and its slopes."""
        lo, hi = cells.boxes(domain)
        slope = coefficients[:, 1:] * 2 / (hi - lo)
        to_center = (lo + hi) / 2 - corner
        return np.column_stack([coefficients[:, 0] - sum_of_columns(slope * to_center), slope])

    def below_cones(
        self,
        lo: Float[np.ndarray, "n 2"],
        hi: Float[np.ndarray, "n 2"],
        coefficients: Float[np.ndarray, "n terms"],
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Extremes of cones minus planes, over convex pieces."""
        slope = coefficients[:, 1:] * 2 / (hi - lo)
        intercept = coefficients[:, 0] - (slope * (lo + hi)).sum(axis=1) / 2
        return cone_above_plane(pieces, apex, offset, slope, intercept)

    def differences(
        self, lo: Float[np.ndarray, "n dim"], hi: Float[np.ndarray, "n dim"], leaves: Functions, others: Functions
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Differences at the centers of boxes, and what the slopes' differences make of half their widths."""
        center, reach = (lo + hi) / 2, (hi - lo) / 2
        slope, other = (2 * planes[:, 1:] / (end - start) for start, end, planes in (leaves, others))
        apart = self.values(*leaves, center) - self.values(*others, center)
        spread = (np.abs(slope - other) * reach).sum(axis=1)
        return apart - spread, apart + spread

    def rounding(
        self, domain: Box, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
    ) -> Float[np.ndarray, "leaves"]:
        """Of the numbers, of the point, of its distance to the corner, of products and of sums."""
        numbers = np.abs(self.numbers(domain, cells, coefficients, table_corners(domain)[0]))
        terms = numbers[:, 0] + numbers[:, 1:] @ domain.width
        return 1.01 * UNIT * ((3 + domain.dim) * terms + numbers[:, 1:] @ largest_coordinates(domain))

    def num_numbers(self, dim: int) -> int:
        """The value at the corner, and slopes."""
        return 1 + dim

    def value(self, numbers: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        """The value at the corner, to which a product is added axis by axis."""
        value, *slopes = numbers
        for slope, along in zip(slopes, place, strict=True):
            value = value + slope * along
        return value


def _rounding_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Of rounding center and half-differences to a multiple of the step."""
    return float(_stored(nodes, leaf, bits).step * np.sqrt((1 + nodes.cells.dim / 3) / 12))


def _stored(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> StoredPlanes:
    return encode_planes(nodes.coefficients[leaf, 0], nodes.coefficients[leaf, 1:], bits)
