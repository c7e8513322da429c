"""The leaf model ``"plane"``, and the base class of leaf models that fit each leaf to the samples in this leaf alone.

The base class grows the tree best first, and writes files. A file stores coefficients as scaled integers or as 32-bit
floats; ``portable/FORMAT.md`` describes the bits. All coefficients but the first, the value at the center, shrink as
cells are halved. So the file has a bit width for each of these coefficients and each number of halvings.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import sum_of_columns
from plr_jax._types import Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, cone_above_plane
from plr_jax.plr.certificate import Bounds, LeafFunctions, Proof
from plr_jax.plr.coding import BitReader, BitWriter, floats_of_bits
from plr_jax.plr.frame import LARGEST, Corner, table_corners
from plr_jax.plr.growth import Encoding, Limits, Nodes, Priorities, grow_best_first, largest_error, nodes_of_fit
from plr_jax.plr.leaves import base
from plr_jax.plr.leaves.base import Coefficients, Parameters
from plr_jax.plr.sampling import CellFit, Sampler, fill_unsampled_planes
from plr_jax.plr.sizes import MOST_ROWS
from plr_jax.plr.tree import Cells, Tree, tree_of

FLOAT_BITS = 32  # bits of a center value that is stored as a float
MIN_BITS, MAX_BITS = 4, 20  # bits of a center value that is stored as an integer
_BUDGET_BITS = range(8, 17)  # such bits to choose from under a byte budget
_FLOAT_INF = 0x7F800000  # bits of the 32-bit float inf
_WIDTH_BITS = 6  # bits in which the file states a number of bits, of center values or of other coefficients


class StoredCoefficients(NamedTuple):
    """The coefficients of all leaves, with the integers of a file.

    The coefficients of a leaf are ``offset + step * center``, the value at its center, and ``step * others``. If
    ``bits`` is 32, ``center`` and ``others`` are the bits of 32-bit floats instead; these are the coefficients.
    """

    bits: int  # of ``center``; 32: ``center`` and ``others`` are bit patterns of floats
    offset: float
    step: float
    center: Int[np.ndarray, " leaves"]  # the largest number (inf, if floats) marks a leaf that cannot reach the goal
    others: Int[np.ndarray, "leaves others"]

    @property
    def unreachable(self) -> Bool[np.ndarray, " leaves"]:
        return self.center == unreachable_code(self.bits)

    def widths(self, halvings: Int[np.ndarray, "leaves others"]) -> list[Int[np.ndarray, " levels"]]:
        """Return the bit widths of ``others`` in a file: for each coefficient, an array, indexed by ``halvings``."""
        # An integer n takes floor(log2 |n|) + 1 bits (the exponent that frexp returns), and one for its sign.
        widths = []
        for index, most in enumerate(halvings.max(axis=0)):
            largest = np.zeros(most + 1, np.int64)
            np.maximum.at(largest, halvings[:, index], np.abs(self.others[:, index]))
            bits = np.frexp(largest)[1] + (largest > 0)
            widths.append(np.full_like(largest, FLOAT_BITS) if self.bits == FLOAT_BITS else bits.astype(np.int64))
        return widths

    def decode(self) -> tuple[Float[np.ndarray, " leaves"], Float[np.ndarray, "leaves others"]]:
        if self.bits == FLOAT_BITS:
            return floats_of_bits(self.center), floats_of_bits(self.others)
        center = np.where(self.unreachable, np.inf, self.offset + self.step * self.center)
        return center, self.step * self.others


def unreachable_code(bits: int) -> int:
    return _FLOAT_INF if bits == FLOAT_BITS else (1 << bits) - 1


def quantize(center: Distances, others: Coefficients, bits: int) -> StoredCoefficients:
    """Quantize coefficients to integers, with ``bits`` bits per center value; for 32 bits, store floats instead.

    ``center`` has the value at each leaf's center, or ``inf`` for a leaf that cannot reach the goal. ``others`` has
    the other coefficients. ``ValueError`` if values are too large to be stored.
    """
    is_reachable = np.isfinite(center)
    if max(np.abs(center[is_reachable]).max(initial=0.0), np.abs(others[is_reachable]).max(initial=0.0)) > LARGEST:
        raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
    others = np.where(is_reachable[:, None], others, 0.0)
    if bits == FLOAT_BITS:
        # Bit patterns: of center values as unsigned, of `others` as signed integers, as `read` returns them.
        of_center, of_others = (x.astype(np.float32).view(np.int32).astype(np.int64) for x in (center, others))
        return StoredCoefficients(bits, 0.0, 1.0, of_center & 0xFFFFFFFF, of_others)
    # Codes of center values go from 0, at or just below the least value, to the largest before `unreachable_code`.
    # Offset and step are exact in 32 bits; ``others`` take at most 9 bits more than ``center``.
    values = center[is_reachable] if is_reachable.any() else np.zeros(1)
    largest_code = unreachable_code(bits) - 1
    offset = float(np.nextafter(np.float32(values.min()), np.float32(-np.inf)))
    spread = max(values.max() - offset, np.abs(others).max(initial=0.0) * 2**-8)
    step = float(np.nextafter(np.float32(spread / largest_code), np.float32(np.inf)))
    code = np.rint((np.where(is_reachable, center, offset) - offset) / step)
    code = np.where(is_reachable, np.clip(code, 0, largest_code), unreachable_code(bits)).astype(np.int64)
    return StoredCoefficients(bits, offset, step, code, np.rint(others / step).astype(np.int64))


@dataclass(frozen=True)
class IndependentLeafModel(base.LinearLeafModel):
    """A base class of leaf models that fit the function of each leaf to the samples in this leaf alone.

    Functions may jump between leaves. The first coefficient is the value at a leaf's center. The others shrink as the
    cell is halved: see :meth:`halvings`. There are ``min_samples(dim)`` coefficients. ``coefficient_bits`` is the
    number of bits of a stored center value, as in :class:`Plane`.
    """

    coefficient_bits: int | None = None
    splits_by_proven_error = True

    def __post_init__(self):
        bits, allowed = self.coefficient_bits, (FLOAT_BITS, *range(MIN_BITS, MAX_BITS + 1))
        if bits is not None and not (isinstance(bits, int | np.integer) and bits in allowed):
            expected = f"an integer, {FLOAT_BITS} (floats) or {MIN_BITS} to {MAX_BITS}"
            raise ValueError(f"coefficient_bits must be {expected}, got {bits!r}.")

    @abstractmethod
    def halvings(self, cells: Cells) -> Int[np.ndarray, "leaves others"]:
        """Return the number of halvings that have shrunk each coefficient but the first of each leaf.

        For planes, this is the depth along the coefficient's axis. In a file, coefficients that have the same index
        and as many halvings have one bit width.
        """

    def fit_functions(self, fit: CellFit) -> tuple[CellFit, Coefficients]:
        """Fit a function to the samples of each cell; return ``fit`` with its residuals, and its coefficients.

        By default, functions are the planes of ``fit``. A cell without samples that reach the goal may have a plane,
        too (:func:`fill_unsampled_planes`). If the center value of a cell's plane is ``inf``, the first coefficient
        of the cell must be ``inf``.
        """
        return fit, self.coefficients_of_planes(fit.center, fit.half)

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        # 32 KB allow 9 halvings along each axis of the plane; deep cells next to the goal have smaller errors.
        return max(self.min_samples(dim) * FLOAT_BITS // 8 * num_leaves, int(MOST_ROWS * self.least_bytes))

    def construct(self, sampler: Sampler, rules: base.Rules, limits: Limits) -> tuple[Tree, StoredCoefficients, None]:
        by_proof = rules.should_split is largest_error and limits.proof is not Proof.NONE
        choices = [FLOAT_BITS] if np.isinf(limits.max_bytes) else _BUDGET_BITS
        choices = choices if self.coefficient_bits is None else [int(self.coefficient_bits)]

        # 1. Nodes of the tree are cells with functions and priorities: proven errors if possible, else the rule's.
        def nodes_of(fit: CellFit, parent_key: Priorities) -> Nodes:
            fit, coefficients = self.fit_functions(fill_unsampled_planes(fit, sampler))
            if by_proof and sampler.cache is not None:
                finite = np.where(np.isfinite(coefficients), coefficients, 0.0)
                functions = LeafFunctions(self, *fit.cells.boxes(sampler.domain), finite)
                priority = functions.largest_errors(sampler.cache.sources(fit.cells))
            else:
                priority = rules.should_split(fit)
            return nodes_of_fit(fit, coefficients, parent_key, priority, rules.split(fit), limits)

        # 2. The bits per value decide the size of a file and its rounding errors. The error of a coefficient has the
        # variance step**2 / 12, and each but the first is multiplied by a function. For planes, this is a coordinate
        # from -1 to 1, whose square has the mean 1/3. Others are taken to be alike: step**2 / 12 * (1 + others / 3).

        def stored(nodes: Nodes, leaf: Int[np.ndarray, " leaves"], bits: int) -> StoredCoefficients:
            return quantize(nodes.coefficients[leaf, 0], nodes.coefficients[leaf, 1:], bits)

        def size(nodes: Nodes, leaf: Int[np.ndarray, " leaves"], bits: int) -> int:
            self.write(body := BitWriter(), sampler.domain, nodes.cells[leaf], stored(nodes, leaf, bits))
            num_cut_off = int(np.count_nonzero(nodes.is_cut_off[leaf]))
            return limits.file_size(nodes.cells.dim, len(leaf), body.num_bits, num_cut_off)

        def rounding_error(nodes: Nodes, leaf: Int[np.ndarray, " leaves"], bits: int) -> float:
            num_others = nodes.coefficients.shape[1] - 1
            return float(stored(nodes, leaf, bits).step * np.sqrt((1 + num_others / 3) / 12))

        # 3. Grow the tree.
        root = nodes_of(sampler.root(pieces_suffice=by_proof), np.array([np.inf]))
        nodes, leaf, bits = grow_best_first(root, sampler, nodes_of, limits, Encoding(choices, size, rounding_error))
        tree = tree_of(nodes.cells[leaf])
        return tree, stored(nodes, leaf[tree.order], bits), None

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredCoefficients) -> None:
        is_reachable, halvings = ~stored.unreachable, self.halvings(cells)
        widths = stored.widths(halvings)
        body.write(np.array([stored.bits]), _WIDTH_BITS)
        if stored.bits != FLOAT_BITS:
            body.write_floats(np.array([stored.offset, stored.step]))
        for each in widths:
            body.write(each, _WIDTH_BITS)
        body.write(stored.center, stored.bits)
        for index, each in enumerate(widths):
            width = each[halvings[is_reachable, index]]
            body.write(stored.others[is_reachable, index] & ((1 << width) - 1), width)  # two's complement

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredCoefficients:
        bits, offset, step = int(body.read_fixed_width(1, _WIDTH_BITS)[0]), 0.0, 1.0
        if not (bits == FLOAT_BITS or MIN_BITS <= bits <= MAX_BITS):
            raise ValueError(f"it states {bits}-bit values")
        if bits != FLOAT_BITS:
            offset, step = base.read_step(body)
        halvings = self.halvings(cells)
        widths = [body.read_fixed_width(int(most) + 1, _WIDTH_BITS) for most in halvings.max(axis=0)]
        if max(each.max() for each in widths) > FLOAT_BITS:
            raise ValueError(f"it states numbers of more than {FLOAT_BITS} bits")
        center, others = body.read_fixed_width(len(cells), bits), np.zeros(halvings.shape, np.int64)
        is_reachable = center != unreachable_code(bits)
        for index, each in enumerate(widths):
            width = each[halvings[is_reachable, index]]
            code = body.read(width)  # two's complement
            others[is_reachable, index] = code - np.where(code >= (1 << width) / 2, 1 << width, 0)
        return StoredCoefficients(bits, offset, step, center, others)

    def coefficients(self, cells: Cells, stored: StoredCoefficients) -> Coefficients:
        return np.column_stack(stored.decode())

    def free_values(self, cells: Cells, stored: StoredCoefficients) -> tuple[Distances, Any]:
        from scipy.sparse import csc_array, eye_array

        numbers = self.coefficients(cells, stored)
        is_free = np.repeat(~stored.unreachable, numbers.shape[1])
        return numbers.ravel()[is_free], csc_array(eye_array(len(is_free)))[:, is_free]

    def with_free_values(self, stored: StoredCoefficients, values: Distances, step: float | None) -> Any:
        # The offset is chosen again, which may raise the step a little: allow for 0.1%.
        step = step or (stored.bits < FLOAT_BITS) * 1.001 * stored.step
        numbers = np.column_stack(stored.decode())
        numbers[~stored.unreachable] = values.reshape(-1, numbers.shape[1])
        choices = *range(MIN_BITS, MAX_BITS + 1), FLOAT_BITS
        quantized = (quantize(numbers[:, 0], numbers[:, 1:], bits) for bits in choices)
        return next(each for each in quantized if each.step <= step or each.bits == FLOAT_BITS)


class Plane(IndependentLeafModel):
    """The leaf model ``"plane"``: one plane (affine function) in every leaf; the function may jump between leaves.

    Coefficients are the value at a leaf's center, then half of the rise across the leaf along each axis.

    Args:
        coefficient_bits: Bits of a stored center value: 32 for floats, 4 to 20 for scaled integers. Slopes usually
            take fewer bits. None: 32 without ``max_bytes``; with ``max_bytes``, the number from 8 to 16 with the
            smallest expected error of fit and rounding. Other values raise ``ValueError``.
    """

    name = "plane"
    num_samples = 192
    least_bytes = 2
    has_exact_cone_bounds = True
    decoder_cost = 4_300, 600

    def halvings(self, cells: Cells) -> Int[np.ndarray, "leaves others"]:
        return cells.depth

    def basis(self, u: Points) -> Coefficients:
        return np.concatenate([np.ones((len(u), 1)), u], axis=1)

    def coefficients_of_planes(self, center: Distances, half: Points) -> Coefficients:
        return np.column_stack([center, half])

    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        # Value at the corner, and slopes: center value + slope . (x - center), as value + slope . (x - corner).
        lo, hi = cells.boxes(domain)
        slope = coefficients[:, 1:] * 2 / (hi - lo)
        return np.column_stack([coefficients[:, 0] - sum_of_columns(slope * ((lo + hi) / 2 - corner)), slope])

    def cone_minus_leaf_bounds(self, leaf: LeafFunctions, pieces: Pieces, apex: Points, offset: Distances) -> Bounds:
        slope = leaf.coefficients[:, 1:] * 2 / (leaf.hi - leaf.lo)
        intercept = leaf.coefficients[:, 0] - (slope * (leaf.lo + leaf.hi)).sum(axis=1) / 2
        return cone_above_plane(pieces, apex, offset, slope, intercept)

    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        # Relative errors, in UNIT: of each parameter, offset and product, 1; of the sums of up to 1 + dim terms, dim.
        # Coordinates have absolute errors. The factor 1.01 covers products of these errors.
        parameters = np.abs(self.leaf_parameters(domain, cells, coefficients, table_corners(domain)[0]))
        terms = parameters[:, 0] + parameters[:, 1:] @ domain.width
        return 1.01 * base.UNIT * ((3 + domain.dim) * terms + parameters[:, 1:] @ base.largest_coordinates(domain))

    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        value, *slopes = parameters
        for slope, along in zip(slopes, place, strict=True):
            value = value + slope * along
        return value
