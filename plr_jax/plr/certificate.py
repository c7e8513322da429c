"""Prove bounds of (distance - leaf function) by branch and bound; encode them in files (``portable/FORMAT.md``)."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from plr_jax._arrays import take_ragged
from plr_jax._types import CellSources
from plr_jax.plr import bound_classes as classes
from plr_jax.plr.bound_classes import CODE_BITS, LARGEST_CODE, decode_bounds, encode_bounds
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import LARGEST
from plr_jax.plr.tree import Cells, Rows

Bounds: TypeAlias = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
# Function ``(pieces, apex, offset, row)`` that bounds cones ``offset + |x - apex|`` minus leaf functions. It returns
# the lower and upper bounds over each piece. ``row`` has the index of each piece's leaf function.
ConeBoundsFn: TypeAlias = Callable[..., Bounds]


def bounds_of_pieces(visible: CellSources, piece: Int[np.ndarray, " n"], cones_above: ConeBoundsFn) -> Bounds:
    """Return lower and upper bounds of (distance to the goal - leaf function) over convex pieces of free space.

    ``visible`` has the *sources* of each piece: corners (or the goal) to which shortest paths from the piece go
    first; every piece has at least one. The cone of a source is its distance to the goal plus ``|x - source|``. The
    distance at ``x`` is at least the minimum of all cones. It is at most the cone of any source that the whole piece
    sees. If there is no such source, it is at most the distance at the piece's center plus the straight line to the
    center.

    Entry ``i`` of the results is for piece ``piece[i]``. ``cones_above`` gets the indices ``i``, which tell it the
    leaf function of each piece.
    """
    if not len(piece):
        return np.zeros(0), np.zeros(0)
    # 1. Bound (cone - leaf function) over the piece of each pair (piece, source). Pairs of a piece are consecutive.
    pairs, row = take_ragged(visible.first_pair, piece)
    source = visible.source[pairs]
    apex, offset = visible.sources.points[source], visible.sources.distances[source]
    lowest, highest = cones_above(visible.pieces[:, piece[row]], apex, offset, row)
    # 2. The lower bound is the least of all sources; the upper bound, of the sources that the whole piece sees.
    first_pair = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
    lower = np.minimum.reduceat(lowest, first_pair)
    upper = np.minimum.reduceat(np.where(visible.by_all[pairs], highest, np.inf), first_pair)
    # 3. Without such a source, the piece's center takes the place of a source.
    if len(unseen := np.flatnonzero(np.isinf(upper))):
        rows = piece[unseen]
        _, upper[unseen] = cones_above(visible.pieces[:, rows], visible.center[rows], visible.distance[rows], unseen)
    return lower, upper


@dataclass(frozen=True, eq=False)
class LeafFunctions(Rows):
    """The functions of several leaves; leaf ``i`` is the box from ``lo[i]`` to ``hi[i]``.

    ``coefficients`` are those of the leaf model ``model``.
    """

    model: Any  # a LeafModel, which this file may not import
    lo: Float[np.ndarray, "leaves dim"]
    hi: Float[np.ndarray, "leaves dim"]
    coefficients: Float[np.ndarray, "leaves terms"]

    def values(self, leaf: Int[np.ndarray, " n"], x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the value of the function of leaf ``leaf[i]`` at point ``x[i]``."""
        return self.model.values(self.lo[leaf], self.hi[leaf], self.coefficients[leaf], x)

    def bounds_of_pieces(self, visible: CellSources, leaf: Int[np.ndarray, " n"]) -> Bounds:
        """Return lower and upper bounds of (distance - leaf function) over each piece of free space in ``visible``.

        ``leaf`` has the index of the leaf that contains each piece.
        """

        def cones_above(pieces: Any, apex: Any, offset: Any, row: Any) -> Any:
            return self.model.cone_minus_leaf_bounds(self[leaf[row]], pieces, apex, offset)

        return bounds_of_pieces(visible, np.arange(len(leaf)), cones_above)

    def largest_errors(self, visible: CellSources) -> Float[np.ndarray, " leaves"]:
        """Return an upper bound of ``|distance - leaf function|`` in each leaf, which is a cell of ``visible``.

        The error may exceed the bound by ``visible.slack``, the uncertainty of distances. The bound is 0 in a leaf
        without points that reach the goal.
        """
        lower, upper = self.bounds_of_pieces(visible, visible.cell)
        errors = np.zeros(visible.num_cells)
        np.maximum.at(errors, visible.cell, np.maximum(-lower, upper))
        return errors


# Limits of branch and bound: more rounds or pieces would only tighten bounds.
_MOST_ROUNDS = 48  # most rounds in which pieces of a leaf are halved
_MOST_PIECES = 1 << 19  # most pieces that one round may halve
Errors: TypeAlias = Float[np.ndarray, " leaves"]
# Function ``sufficient(least, most, recompute)``: returns lower and upper bounds of errors that are tight enough.
# ``least`` is the smallest error found at points of each leaf, or 0 if that is smaller; ``most`` is the largest
# error, or 0 if that is larger. If ``recompute`` is False, the function may return about the same bounds as in the
# call before.
SufficientFn: TypeAlias = Callable[[Errors, Errors, bool], tuple[Errors, Errors]]


def prove_bounds(functions: LeafFunctions, visible: CellSources, sufficient: SufficientFn) -> tuple[Errors, Errors]:
    """Prove bounds of (distance to the goal - leaf function) for each leaf by branch and bound.

    Return lower and upper bounds over all points of each leaf that reach the goal. ``visible`` has convex pieces of
    the leaves' free space. Pieces are halved until their bounds are as tight as ``sufficient`` demands. The bounds
    include ``visible.slack``, the uncertainty of distances.
    """
    # Each leaf has an interval [least, most] of *attained* errors (distance - function), and each piece an interval
    # [below, above] that encloses its errors. Branch and bound closes the gap between both:
    #
    #      low      least      0         most     high           of the leaf
    #   ----|---------[========|===========]-------|-----
    #         [ below ... above ]                         tight enough: within [low, high]
    #    [ below ... above ]                              open: is halved
    #
    # Distances are known to `slack` only. So bounds are widened by `slack` at the end, and bounds within
    # [least - slack, most + slack] are tight enough.
    slack = visible.slack
    leaf = visible.cell  # of each piece of this round
    lower, upper, least, most = np.zeros((4, visible.num_cells))
    rounds = np.zeros(visible.num_cells, np.int64)  # in which pieces of each leaf were halved
    aside: list[tuple[Any, ...]] = []  # pieces of earlier rounds that may become open: (visible, leaf, below, above)

    def open_pieces(recompute: bool) -> Bool[np.ndarray, " pieces"]:
        # `sufficient` speaks of bounds widened by `slack`, `below` and `above` are not: convert there and back.
        low, high = sufficient(least - slack, most + slack, recompute)
        low, high = np.minimum(low + slack, least - slack), np.maximum(high - slack, most + slack)
        return ((below < low[leaf]) | (above > high[leaf])) & (rounds[leaf] < _MOST_ROUNDS)

    while True:
        # 1. Bound the errors of pieces. Errors at their centers are attained.
        attained = visible.distance - functions.values(leaf, visible.center)
        np.minimum.at(least, leaf, attained)
        np.maximum.at(most, leaf, attained)
        below, above = functions.bounds_of_pieces(visible, leaf)
        # 2. A piece is clear if all of it sees all its sources: its distance is the least of their cones. Then exact
        #    lower bounds are attained; of a single source, exact upper bounds too.
        num_sources = np.diff(visible.first_pair)
        is_clear = np.bincount(visible.piece, visible.by_all, len(leaf)) == num_sources
        if functions.model.has_exact_cone_bounds:
            is_single = is_clear & (num_sources == 1)
            np.minimum.at(least, leaf[is_clear], below[is_clear])
            np.maximum.at(most, leaf[is_single], above[is_single])
            is_clear &= ~is_single
        # 3. Errors at corners of the other clear pieces are attained: `x` has one corner of each.
        if len(rows := np.flatnonzero(is_clear)):
            pairs, piece = take_ragged(visible.first_pair, rows)
            source = visible.source[pairs]
            first_pair = np.cumsum(num_sources[rows]) - num_sources[rows]
            for x in visible.pieces[:, rows].transpose(2, 1, 0):
                to_source = np.linalg.norm(x[piece] - visible.sources.points[source], axis=1)
                distance = np.minimum.reduceat(visible.sources.distances[source] + to_source, first_pair)
                attained = distance - functions.values(leaf[rows], x)
                np.minimum.at(least, leaf[rows], attained)
                np.maximum.at(most, leaf[rows], attained)
        # 4. Find the pieces whose bounds are not tight enough. If there are none, take back the pieces of earlier
        #    rounds and test them again, since attained errors have changed.
        is_open = open_pieces(not rounds.any())
        if rounds.any() and not is_open.any():
            several, *columns = zip(*aside, (visible, leaf, below, above), strict=True)
            visible = several[0].append(*several[1:])
            leaf, below, above = map(np.concatenate, columns)
            aside = []
            is_open = open_pieces(True)
        if not 0 < np.count_nonzero(is_open) <= _MOST_PIECES:
            break
        # 5. Halve the open pieces. A piece that is not open counts at once if attained errors enclose its bounds, so
        #    that it can never be open; else it is put aside.
        rounds[np.unique(leaf[is_open])] += 1
        is_final = (below >= least[leaf] - slack) & (above <= most[leaf] + slack)
        np.minimum.at(lower, leaf[is_final], below[is_final])
        np.maximum.at(upper, leaf[is_final], above[is_final])
        rows = np.flatnonzero(~is_open & ~is_final)
        aside.append((visible.of_pieces(rows), leaf[rows], below[rows], above[rows]))
        visible = _halve_pieces(visible, np.flatnonzero(is_open))
        leaf = leaf[is_open][visible.cell // 2]
    # 6. A leaf's bounds enclose the bounds of all its pieces.
    for _, of_leaf, low, high in (*aside, (visible, leaf, below, above)):
        np.minimum.at(lower, of_leaf, low)
        np.maximum.at(upper, of_leaf, high)
    return lower - slack, upper + slack


def _halve_pieces(visible: CellSources, piece: Int[np.ndarray, "open"]) -> CellSources:
    """Cut each of the pieces with the indices ``piece`` in the middle of its bounding box, across the longest axis.

    In the result, the lower and the upper half of ``piece[i]`` are cells ``2 * i`` and ``2 * i + 1``.
    """
    parent, is_upper = np.repeat(np.arange(len(piece)), 2), np.tile([False, True], len(piece))
    lo, hi = (extreme(visible.pieces[:, piece], axis=2).T[parent] for extreme in (np.min, np.max))
    axis = np.argmax(hi - lo, axis=1)
    row = np.arange(len(parent))
    middle = (lo + hi)[row, axis] / 2
    lo[row[is_upper], axis[is_upper]] = middle[is_upper]
    hi[row[~is_upper], axis[~is_upper]] = middle[~is_upper]
    return visible.pieces_as_cells(piece).parts(parent, axis, is_upper, lo, hi)


_A_CODE = 2.0 ** (1 / classes.CODES_A_DOUBLING)  # ratio of the bounds of consecutive codes
_MAX_ERROR_BITS = 32  # the scale, a 32-bit float
_BYTES_A_BIT = 16  # classes get one bit for this many bytes of leaves
_LEAST_BITS = 80  # with fewer bits there are no classes


class Proof(IntEnum):
    """The kind of error bounds in a file: none, bounds that leaves share, or bounds of each leaf."""

    NONE = 0  # no bounds
    CLASSES = 1  # bounds that groups of leaves share; if there is no room, only the largest error of all leaves
    LEAVES = 2  # bounds of each leaf
    OPEN_LEAVES = 3  # bounds of each leaf, where a leaf with the largest upper code has no upper bound

    def num_bits(self, num_leaves: int, num_bytes: int) -> int:
        """Return the most bits of a proof in a file whose ``num_leaves`` leaves take ``num_bytes`` bytes."""
        of_leaves = _MAX_ERROR_BITS + 2 * CODE_BITS * num_leaves
        # The caller adds the bits of a ``StraightBound``.
        return (0, _MAX_ERROR_BITS + _bits_of_classes(num_bytes), of_leaves, of_leaves)[self]


# Bounds are tight enough if they exceed attained errors by
#   _OF_RANGE * range of the leaf's errors,  clipped to _LEAST_OF_LARGEST ... _MOST_OF_LARGEST * largest error of all.
_OF_RANGE = 0.04
_LEAST_OF_LARGEST = 1e-4
_MOST_OF_LARGEST = 5e-3
_SPARE_OF_CLASS = 1e-5  # for classes, this share of the scale instead, since few leaves determine their bounds
MOST_GOALS = 64  # most goals of a file to which straight lines give lower bounds: queries compare all of them


def _bits_of_classes(num_bytes: int) -> int:
    # The bits that classes may take in a file whose leaves take so many bytes; 0 for no classes.
    return bits if (bits := num_bytes // _BYTES_A_BIT) >= _LEAST_BITS else 0


@dataclass(frozen=True, eq=False)
class StraightBound:
    """A lower bound of the distance: the cost of the cheapest straight motion to a goal, minus a margin, at least 0.

    A motion by the vector ``d`` costs the sum, over groups of axes, of ``rate * |d[axes of the group]|``. Along
    periodic axes, motions go the short way around.
    """

    goals: Float[np.ndarray, "goals dim"]  # relative to the domain's lower corner
    groups: Float[np.ndarray, "groups dim"]  # 1 if an axis is in a group, else 0
    rates: Float[np.ndarray, " groups"]
    margin: float
    is_simple: bool  # one goal, one group, and no periodic axes: stored as release 0.2 does

    @property
    def arrays(self) -> list[Float[np.ndarray, "..."]]:
        return [np.asarray(values, np.float32) for values in (self.goals, self.groups, self.rates, self.margin)]

    @property
    def numbers(self) -> Float[np.ndarray, " _"]:
        """The numbers that a file stores: coordinates of the goals, rates of the groups, and the margin.

        Unless ``is_simple``, other numbers come first: the number of goals, negated, and the index of each axis's
        group.
        """
        header = [] if self.is_simple else [-len(self.goals), *self.groups.argmax(axis=0)]
        return np.concatenate([header, self.goals.ravel(), self.rates, [self.margin]])

    @property
    def num_bytes(self) -> int:
        return 4 * len(self.numbers)

    @staticmethod
    def read(body: BitReader, dim: int) -> "StraightBound":
        """Decode a lower bound from its :attr:`numbers` in a file of a ``dim``-dimensional domain.

        ``ValueError`` if the numbers are invalid.
        """
        # 1. The header, if any: number of goals, and group of each axis.
        first, num, group = body.read_floats(1), 1, np.zeros(dim)
        is_simple = not first[0] < 0  # else it is the number of goals, and no coordinate
        if not is_simple:
            num, group, first = -first[0], body.read_floats(dim), first[:0]
        if num not in range(1, MOST_GOALS + 1) or not np.isin(group, np.arange(dim)).all():
            raise ValueError("it states straight lines to a wrong number of goals, or with wrong groups of axes")
        # 2. Coordinates of the goals, rates of the groups, and the margin; the first number may be read already.
        size, count = int(num) * dim, int(group.max()) + 1
        numbers = np.append(first, body.read_floats(size + count + 1 - len(first)))
        if not (np.isfinite(numbers).all() and (numbers[size:] >= 0).all()):
            raise ValueError("it states a straight line to the goal with numbers that are none")
        groups = (group == np.arange(count)[:, None]).astype(np.float64)
        return StraightBound(numbers[:size].reshape(-1, dim), groups, numbers[size:-1], float(numbers[-1]), is_simple)


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds of (distance - value of a PLR), as a file stores them."""

    scale: float  # at least the largest finite bound, exact in 32 bits; codes stand for fractions of it
    codes: UInt8[np.ndarray, "2 leaves"] | None  # of lower and upper bounds; None if only the scale is stored
    proof: Proof

    @staticmethod
    def of(
        lower: Errors,
        upper: Errors,
        rounding: Errors,
        proof: Proof,
        volume: Errors | float = 1.0,
        num_bytes: int = 0,
        before: "Certificate | None" = None,
    ) -> "Certificate":
        """Encode bounds of each leaf's error, widened by ``rounding``, the error of 32-bit queries in the leaf.

        For ``Proof.CLASSES``, groups of leaves share bounds. The groups are chosen by the errors and by the
        ``volume`` of each leaf. Their bounds take at most 1/128 of ``num_bytes``, the size of all leaves in a file.
        If the shared bounds of an earlier certificate ``before`` suffice, they are used again.
        """
        # 1. Lengths of the intervals below and above the leaf's function, and a scale that is at least all of them.
        lower, upper = np.maximum(rounding - lower, 0.0), np.maximum(rounding + upper, 0.0)
        is_open = np.isinf(upper)
        largest = max(lower.max(), upper[~is_open].max(initial=0.0), np.finfo(np.float32).tiny)
        if proof is Proof.OPEN_LEAVES:
            largest *= 2.0 ** (1.1 / classes.CODES_A_DOUBLING)  # reserves the largest code for open leaves
        scale = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
        # 2. Without room for classes, the scale is the bound of all leaves.
        if proof is Proof.CLASSES and not (max_bits := _bits_of_classes(num_bytes)):
            return Certificate(scale, None, proof)
        codes = np.stack([encode_bounds(lower, scale), encode_bounds(np.where(is_open, scale, upper), scale)])
        # 3. Let leaves share codes: the classes of `before` if its scale still fits, else new ones.
        if proof is Proof.CLASSES:
            shared = None
            if before is not None and before.codes is not None and largest <= before.scale < largest * _A_CODE:
                of_scale = np.stack([encode_bounds(lower, before.scale), encode_bounds(upper, before.scale)])
                shared = classes.requantize_bounds(of_scale, before.codes, max_bits)
                scale = scale if shared is None else before.scale
            if shared is None:
                shared = classes.classify_bounds(codes, np.broadcast_to(volume, lower.shape), max_bits)
            codes = None if (shared == shared[:, :1]).all() else shared
        return Certificate(scale, codes, proof)

    @property
    def max_error(self) -> float:
        return float("inf") if np.isinf(self.bounds()).any() else self.scale

    def bounds(self) -> Float[np.ndarray, "2 leaves_or_one"]:
        """Return lower (row 0) and upper (row 1) bounds of (distance - PLR's value).

        There is a column for each leaf, or a single column for all leaves.
        """
        if self.codes is None:
            return np.array([[-self.scale], [self.scale]])
        lower, upper = decode_bounds(self.codes, self.scale)
        if self.proof is Proof.OPEN_LEAVES:
            upper[self.codes[1] == LARGEST_CODE] = np.inf
        return np.stack([-lower, upper])

    @cached_property
    def _classes(self) -> Float[np.ndarray, "2 classes"]:
        """Distinct pairs of a lower (row 0) and an upper (row 1) bound that leaves share, narrowest first."""
        # Pairs are sorted by the size of the lower bound, then of the upper bound.
        signs = np.array([[-1.0], [1.0]])
        bounds = signs * np.unique(signs * self.bounds(), axis=1)
        return bounds[:, np.argsort(bounds[1] - bounds[0], kind="stable")]

    def sufficient_bounds(self, least: Errors, most: Errors, rounding: Errors) -> tuple[Errors, Errors]:
        """Return lower and upper bounds of each leaf's error such that tighter bounds would hardly change the file.

        ``least`` and ``most`` are the smallest and the largest error attained in each leaf, so no bounds can be
        tighter than these. ``rounding`` is the error of 32-bit queries, by which :meth:`of` widens bounds before it
        encodes them.
        """
        if self.proof is not Proof.CLASSES:
            largest = max(most.max(initial=0.0), -least.min(initial=0.0))
            spare = np.clip(_OF_RANGE * (most - least), _LEAST_OF_LARGEST * largest, _MOST_OF_LARGEST * largest)
            return least - spare, most + spare
        # All bounds within the narrowest class that holds a leaf's attained errors encode to this class.
        lower, upper = self._classes
        holds = (least - rounding >= lower[:, None]) & (most + rounding <= upper[:, None])
        narrowest = holds.argmax(axis=0)
        low, high = (np.where(holds.any(axis=0), of_classes[narrowest], 0.0) for of_classes in (lower, upper))
        spare = _SPARE_OF_CLASS * self.scale
        return np.minimum(least - spare, low + rounding), np.maximum(most + spare, high - rounding)


def write_proof(body: BitWriter, certificate: Certificate | None, straight: StraightBound | None) -> Proof:
    """Append the error bounds and the straight-line bound to a file's body; return the kind of proof, for the header.

    Each of the two may be None: then the file has no such bounds.
    """
    if certificate is None:
        if straight is None:
            return Proof.NONE
        body.write_floats(np.append(np.inf, straight.numbers))
        return Proof.CLASSES
    # The sign of the scale tells whether classes or a straight-line bound follow.
    proof, codes = certificate.proof, certificate.codes
    of_classes = codes if proof is Proof.CLASSES else None
    has_more = of_classes is not None or straight is not None
    body.write_floats(np.array([-certificate.scale if has_more else certificate.scale]))
    if of_classes is not None:
        classes.write_classes(body, of_classes)
    elif codes is not None:
        body.write(codes.ravel().astype(np.int64), CODE_BITS)
    if straight is not None:
        body.write_floats(straight.numbers)
    return proof


def read_proof(body: BitReader, proof: Proof, cells: Cells) -> tuple[Certificate | None, StraightBound | None]:
    """Decode the error bounds and the straight-line bound of a file with the leaves ``cells``.

    This is the inverse of :func:`write_proof`. Bounds that the file lacks are None.
    """
    if proof is Proof.NONE:
        return None, None
    scale = float(body.read_floats(1)[0])
    if proof is Proof.CLASSES and scale == np.inf:
        return None, StraightBound.read(body, cells.dim)
    if not 0 < (scale if proof is Proof.LEAVES else abs(scale)) < LARGEST:
        raise ValueError(f"it states a largest error of {scale}")
    codes = None
    if proof is not Proof.CLASSES:
        codes = body.read_fixed_width(2 * len(cells), CODE_BITS).reshape(2, -1).astype(np.uint8)
    elif scale < 0:
        codes = classes.read_classes(body, len(cells)).astype(np.uint8)
    straight = StraightBound.read(body, cells.dim) if proof is Proof.OPEN_LEAVES and scale < 0 else None
    return Certificate(abs(scale), codes, proof), straight
