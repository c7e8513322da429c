"""Proofs: bounds of how far the distance is above and below what each leaf holds, and how a file keeps them.

Bounds are found by halving pieces of leaves. Bounds of a piece hold for all of it, and the error at its center is one
that is met. Pieces whose bounds are not much beyond errors that are met are done; the others are halved, which brings
both together. Where the distance at a center is known as a bound alone, bounds may be less tight.

A file keeps them as bits, after the leaves:

    largest error, a 32-bit float, negative where classes of leaves have bounds, which then follow
    classes: their number less one, in 4 bits, and codes of their lower bounds, then of their upper ones, 8 bits each;
      for every class but the last, the largest first, the set of those leaves, of all that are in no class before,
      that are not in this one either (see ``coding.py``)
    where each leaf has bounds: codes of all lower ones, then of all upper ones, 8 bits each
    if open leaves have a negative largest error: a straight line that bounds from below (see ``Certificate``), as
      32-bit floats

A bound is ``scale * 2**((code - 255) / 12)``, below or above what the leaf holds: a code more is 6 % more, and
the smallest is 4e-7 of the largest. All of them are rounded away from zero.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int, Integer, Shaped, UInt8

from plr_jax._arrays import take_ragged
from plr_jax._types import CellSources
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import LARGEST

# Bounds of how much the distance is above what a leaf holds, over all free points of a piece of it.
#
# The distance is nowhere above the cone of a source that all of the piece sees, and nowhere below the least cone of
# the sources that any of it may use. Where no source is seen by all, it is at most that of the piece's center, and
# the way there, which is free.


ConesAbove: TypeAlias = Callable[..., tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]]
"""Smallest and largest value, over pieces, of cones minus what leaves hold.

Its arguments are the pieces, apexes and offsets of cones, one a piece, and the row of the leaf that each piece is of.
"""


def bounds_of_pieces(
    visible: CellSources, piece: Int[np.ndarray, "n"], cones_above: ConesAbove
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Bounds of the distance minus what a leaf holds, over pieces, to within their ``slack``.

    A piece may be asked about several times, for other leaves each: rows are told apart by their place.
    """
    if not len(piece):
        return np.zeros(0), np.zeros(0)
    pairs, row = take_ragged(visible.first_pair, piece)
    source, sources = visible.source[pairs], visible.sources
    lowest, highest = cones_above(
        visible.pieces[:, piece[row]], sources.points[source], sources.distances[source], row
    )
    first = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
    lower = np.minimum.reduceat(lowest, first)
    upper = np.minimum.reduceat(np.where(visible.by_all[pairs], highest, np.inf), first)
    hidden = np.flatnonzero(np.isinf(upper))
    if len(hidden):
        of = piece[hidden]
        _, upper[hidden] = cones_above(visible.pieces[:, of], visible.center[of], visible.distance[of], hidden)
    return lower, upper


@dataclass(frozen=True, eq=False)
class LeafFunctions:
    """What leaves hold: functions of a leaf model, of finite coefficients in boxes.

    The model is a :class:`LeafModel`, whose file imports this one.
    """

    model: Any
    lo: Float[np.ndarray, "leaves dim"]
    hi: Float[np.ndarray, "leaves dim"]
    coefficients: Float[np.ndarray, "leaves terms"]

    def below_cones(self, leaf: Int[np.ndarray, "n"]) -> ConesAbove:
        """Return a function that bounds cones minus the functions of given leaves, from which rows choose."""

        def of_rows(pieces: Any, apex: Any, offset: Any, row: Any) -> Any:
            rows = leaf[row]
            functions = self.lo[rows], self.hi[rows], self.coefficients[rows]
            return self.model.below_cones(*functions, pieces, apex, offset)

        return of_rows

    def largest_errors(self, visible: CellSources) -> Float[np.ndarray, "leaves"]:
        """Bound the largest error in each leaf, from its sources as a cell; 0 where nothing reaches the goal."""
        lower, upper = bounds_of_pieces(visible, np.arange(len(visible.cell)), self.below_cones(visible.cell))
        errors = np.zeros(visible.num_cells)
        np.maximum.at(errors, visible.cell, np.maximum(-lower, upper))
        return errors


# Of halving, and of pieces to halve; then bounds are taken as they are, valid and not tight.
_MOST_ROUNDS, _MOST_PIECES = 48, 1 << 19
_OF_RANGE = 0.04  # of the range of errors that are met in a leaf, by which its bounds may be beyond them
LEAST_OF_LARGEST, _MOST_OF_LARGEST = 1e-3, 5e-3  # of the largest error, at least and at most so


@dataclass(frozen=True, eq=False)
class LeafBounds:
    """Bounds of the distance minus what each leaf holds, over all its points from which the goal can be reached."""

    lower: Float[np.ndarray, "leaves"]
    upper: Float[np.ndarray, "leaves"]


Errors: TypeAlias = Float[np.ndarray, "leaves"]
"""Of the distance minus what each leaf holds."""


def prove_bounds(
    functions: LeafFunctions,
    visible: CellSources,
    enough: Callable[[Errors, Errors], tuple[Errors, Errors]] | None = None,
) -> LeafBounds:
    """Bounds for leaves, whose sources are given as cells.

    In double precision; what it rounds is far below the ``slack`` of the sources, which is in the bounds.

    Args:
        functions: What the leaves hold.
        visible: Their sources.
        enough: What bounds of leaves need not be better than, given errors that are met; None: such as are close to
            these, or off by little of the largest error of all.
    """
    num_leaves = visible.num_cells
    lower, upper = np.zeros(num_leaves), np.zeros(num_leaves)
    least, most = np.zeros(num_leaves), np.zeros(num_leaves)  # of the errors that are met
    leaf = visible.cell
    for round_ in range(_MOST_ROUNDS):
        here = functions.lo[leaf], functions.hi[leaf], functions.coefficients[leaf]
        met = visible.distance - functions.model.values(*here, visible.center)
        np.minimum.at(least, leaf, met)
        np.maximum.at(most, leaf, met)
        below, above = bounds_of_pieces(visible, np.arange(len(leaf)), functions.below_cones(leaf))
        # Bounds that need not be better, given errors that are met.
        largest = max(most.max(initial=0.0), -least.min(initial=0.0))
        spare = (
            np.clip(_OF_RANGE * (most - least), LEAST_OF_LARGEST * largest, _MOST_OF_LARGEST * largest)
            + visible.slack
        )
        low_enough, high_enough = least - spare, most + spare
        if enough is not None:
            low, high = enough(least - visible.slack, most + visible.slack)
            low_enough = np.minimum(low_enough, low + visible.slack)
            high_enough = np.maximum(high_enough, high - visible.slack)
        open_ = (below < low_enough[leaf]) | (above > high_enough[leaf])
        open_ &= round_ < _MOST_ROUNDS - 1 and np.count_nonzero(open_) <= _MOST_PIECES
        np.minimum.at(lower, leaf[~open_], below[~open_])
        np.maximum.at(upper, leaf[~open_], above[~open_])
        if not open_.any():
            break
        visible = _halved(visible, np.flatnonzero(open_))
        leaf = leaf[open_][visible.cell // 2]
    return LeafBounds(lower - visible.slack, upper + visible.slack)


def _halved(visible: CellSources, piece: Int[np.ndarray, "open"]) -> CellSources:
    """Both halves of some pieces, each cut across where it is longest: two cells a piece."""
    alone = visible.pieces_as_cells(piece)
    lo, hi = visible.pieces[:, piece].min(axis=2).T, visible.pieces[:, piece].max(axis=2).T
    each = np.arange(len(piece))
    axis = np.argmax(hi - lo, axis=1)
    middle = (lo + hi)[each, axis] / 2
    lower_hi, upper_lo = hi.copy(), lo.copy()
    lower_hi[each, axis] = upper_lo[each, axis] = middle
    parent, is_upper = np.repeat(each, 2), np.tile([False, True], len(each))
    los, his = np.stack([lo, upper_lo], axis=1).reshape(-1, 2), np.stack([lower_hi, hi], axis=1).reshape(-1, 2)
    return alone.parts(parent, axis[parent], is_upper, los, his)


# Classes of leaves, each with bounds of its own, are nearly as narrow as bounds of every leaf, for few bits a leaf:
# most leaves are far better than the few worst, as those where walls touch.


_COUNT_BITS = 4
_BITS_A_CLASS = 53  # its bounds, and what a set takes besides its members
_PRICES = np.ldexp(1.0, -np.arange(60))  # of a bit, in widths of the one class that all leaves may be


def in_classes(
    codes: Integer[np.ndarray, "2 leaves"],
    code_factor: Float[np.ndarray, "codes"],
    volume: Float[np.ndarray, "leaves"],
    max_bits: int,
) -> Integer[np.ndarray, "2 leaves"]:
    """Codes of lower and upper bounds of the classes of leaves, of the least mean width for so many bits.

    A class is of leaves whose larger codes are in a range, and its codes are the largest of its leaves. The best
    ranges at a price of a bit are found by dynamic programming: the best ones up to each code end in some range, and
    before it are the best ones up to there. The price falls as long as there is room. Bounds are multiples of the
    factors of their codes.
    """
    rank, rank_of = np.unique(codes.max(axis=0), return_inverse=True)
    number = len(rank)

    def of_ranges(of_rank: Shaped[np.ndarray, "ranks"], fold: np.ufunc) -> Shaped[np.ndarray, "ranks ranks"]:
        """What folds up over all ranges, from a first rank to a last one."""
        return fold.accumulate(np.triu(np.broadcast_to(of_rank, (number, number))), axis=1)

    highest = np.zeros((2, number), codes.dtype)
    for of_rank, of_leaf in zip(highest, codes, strict=True):
        np.maximum.at(of_rank, rank_of, of_leaf)
    of_class = np.stack([of_ranges(each, np.maximum) for each in highest])
    width = of_ranges(np.bincount(rank_of, volume), np.add) * code_factor[of_class].sum(axis=0)
    members = of_ranges(np.bincount(rank_of).astype(float), np.add)
    bits = members * np.log2(codes.shape[1] / np.maximum(members, 1.0)) + _BITS_A_CLASS
    found, before = np.broadcast_to(of_class[:, :1, -1], codes.shape), None
    for price in _PRICES * width[0, -1]:
        costs, least, first = width + price * bits, np.zeros(number + 1), np.zeros(number, np.int64)
        for last in range(number):
            costs_to = least[: last + 1] + costs[: last + 1, last]
            first[last] = np.argmin(costs_to)
            least[last + 1] = costs_to[first[last]]
        best, end = np.empty_like(highest), number
        while end:
            start = first[end - 1]
            best[:, start:end] = of_class[:, start, end - 1, None]
            end = start
        if before is not None and (best == before).all():
            continue
        if not _fits(best[:, rank_of], max_bits):
            break
        found, before = best[:, rank_of], best
    return found


def requantize_bounds(
    codes: Integer[np.ndarray, "2 leaves"],
    classes: Integer[np.ndarray, "2 classes"],
    code_factor: Float[np.ndarray, "codes"],
    max_bits: int,
) -> Integer[np.ndarray, "2 leaves"] | None:
    """Codes of the narrowest of given classes that holds each leaf; None if there is none, or not room for them.

    After a change that keeps most leaves, most are in the class that they were in, and a file says the same of them.
    """
    classes = classes[:, np.argsort(code_factor[classes].sum(axis=0), kind="stable")]
    holds = (codes[:, None, :] <= classes[:, :, None]).all(axis=0)
    found = classes[:, holds.argmax(axis=0)]
    return found if holds.any(axis=0).all() and _fits(found, max_bits) else None


def _fits(codes: Integer[np.ndarray, "2 leaves"], max_bits: int) -> bool:
    if len(np.unique(_as_numbers(codes))) > 1 << _COUNT_BITS:
        return False
    body = BitWriter()
    write_classes(body, codes)
    return body.num_bits <= max_bits


def write_classes(body: BitWriter, codes: Integer[np.ndarray, "2 leaves"]) -> None:
    """Append bounds of classes, at most 16 different ones, and the class of each leaf."""
    _, first, class_of, size = np.unique(
        _as_numbers(codes), return_index=True, return_inverse=True, return_counts=True
    )
    classes, order = codes[:, first], np.argsort(-size, kind="stable")
    place = np.argsort(order)[class_of]
    body.write(np.array([len(order) - 1]), _COUNT_BITS).write(classes[:, order].ravel().astype(np.int64), _CODE_BITS)
    for each in range(len(order) - 1):
        body.write_set(place > each)
        place = place[place > each]


def distinct(codes: Integer[np.ndarray, "2 leaves"]) -> Integer[np.ndarray, "2 classes"]:
    """Each class once."""
    return codes[:, np.unique(_as_numbers(codes), return_index=True)[1]]


def _as_numbers(codes: Integer[np.ndarray, "2 leaves"]) -> Int[np.ndarray, "leaves"]:
    """Both codes of each as one number, in their order."""
    lower, upper = codes.astype(np.int64)
    return (lower << _CODE_BITS) + upper


def read_classes(body: BitReader, num_leaves: int) -> Int[np.ndarray, "2 leaves"]:
    """What :func:`write_classes` appended; raises ``ValueError`` saying what is wrong with it."""
    count = int(body.read_alike(1, _COUNT_BITS)[0]) + 1
    classes = body.read_alike(2 * count, _CODE_BITS).reshape(2, count)
    place, rest = np.zeros(num_leaves, np.int64), np.arange(num_leaves)
    for _ in range(count - 1):
        rest = rest[body.read_set(len(rest))]
        place[rest] += 1
    return classes[:, place]


_CODE_BITS, _MOST, _CODES_A_DOUBLING = 8, 255, 12
_A_CODE = 2.0 ** (1 / _CODES_A_DOUBLING)
_MAX_ERROR_BITS = 32
_BYTES_A_BIT, _LEAST_BITS = 16, 80  # of leaves, for each bit of classes: a 128th; with fewer bits there are none


class Proof(IntEnum):
    """What a file keeps of a proof; the numbers are those in files."""

    NONE = 0
    CLASSES = 1
    """Of classes of leaves; of all of them, the largest error alone, where there is no room for more."""
    LEAVES = 2
    OPEN_LEAVES = 3
    """Of leaves, some of which have no upper bound."""

    def num_bits(self, num_leaves: int, num_bytes: int) -> int:
        """Most bits that it takes, of leaves that take so many bytes."""
        of_leaves = _MAX_ERROR_BITS + 2 * _CODE_BITS * num_leaves
        return (0, _MAX_ERROR_BITS + _room_for_classes(num_bytes), of_leaves, of_leaves)[self]


def _room_for_classes(num_bytes: int) -> int:
    return bits if (bits := num_bytes // _BYTES_A_BIT) >= _LEAST_BITS else 0


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds of the distance minus what a PLR answers.

    Attributes:
        scale: Of the codes: the largest bound there is; exact in 32 bits.
        codes: How far below each leaf's function the distance may be, and above; None if only the scale is kept.
        proof: What of it is kept. Of open leaves the largest code of an upper bound says that there is none.
        straight: A lower bound by the straight line to the goal, for open leaves, or None. It is ``rate`` times the
            length, less a margin for rounding, but nowhere above the answer. Held are the goal, counted from the
            lower corner of the domain, the rate and the margin, as 32-bit floats.
    """

    scale: float
    codes: UInt8[np.ndarray, "2 leaves"] | None
    proof: Proof
    straight: Float[np.ndarray, "numbers"] | None = None

    @staticmethod
    def of(
        bounds: LeafBounds,
        rounding: Float[np.ndarray, "leaves"],
        proof: Proof,
        volume: Float[np.ndarray, "leaves"] | float = 1.0,
        num_bytes: int = 0,
        before: "Certificate | None" = None,
    ) -> "Certificate":
        """The certificate of bounds, and of what queries round; upper ones may be ``inf`` for open leaves.

        Classes are those of a certificate before, if these will do; else they are chosen for a small mean width over
        leaves of such volumes, which take so many bytes.
        """
        lower, upper = np.maximum(rounding - bounds.lower, 0.0), np.maximum(rounding + bounds.upper, 0.0)
        is_open = np.isinf(upper)
        largest = max(lower.max(), upper[~is_open].max(initial=0.0), np.finfo(np.float32).tiny)
        if proof is Proof.OPEN_LEAVES:
            largest *= 2.0 ** (1.1 / _CODES_A_DOUBLING)  # so that no bound has the largest code
        scale = float(np.nextafter(np.float32(largest), np.float32(np.inf)))
        codes = np.stack([_codes(lower, scale), _codes(np.where(is_open, scale, upper), scale)])
        if proof is Proof.CLASSES:
            room, factor = _room_for_classes(num_bytes), _of_codes(np.arange(_MOST + 1), 1.0)
            found = None
            if before is not None and before.codes is not None and largest <= before.scale < largest * _A_CODE:
                of_scale = np.stack([_codes(lower, before.scale), _codes(upper, before.scale)])
                found = requantize_bounds(of_scale, distinct(before.codes), factor, room)
                scale = scale if found is None else before.scale
            if found is None:
                found = in_classes(codes, factor, np.broadcast_to(volume, lower.shape), room)
            codes = None if (found == found[:, :1]).all() else found
        return Certificate(scale, codes, proof)

    @property
    def max_error(self) -> float:
        """Of the largest error anywhere; ``inf`` if a leaf has no upper bound."""
        return float("inf") if np.isinf(self.bounds()).any() else self.scale

    def bounds(self) -> Float[np.ndarray, "2 leaves_or_one"]:
        """What is to be added to answers for lower and upper bounds, exact in 32 bits: of each leaf, or of all."""
        if self.codes is None:
            return np.array([[-self.scale], [self.scale]])
        lower, upper = _of_codes(self.codes, self.scale)
        if self.proof is Proof.OPEN_LEAVES:
            upper[self.codes[1] == _MOST] = np.inf
        return np.stack([-lower, upper])

    @cached_property
    def _classes(self) -> Float[np.ndarray, "2 classes"]:
        """Bounds of all classes, the narrowest first."""
        bounds = self.bounds() if self.codes is None else replace(self, codes=distinct(self.codes)).bounds()
        return bounds[:, np.argsort(bounds[1] - bounds[0], kind="stable")]

    def enough(
        self,
        least: Float[np.ndarray, "leaves"],
        most: Float[np.ndarray, "leaves"],
        rounding: Float[np.ndarray, "leaves"],
    ) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves"]]:
        """Bounds of leaves than which better ones are not needed, given errors that are met.

        Those of the narrowest class that holds these, less what queries round; or such as are off by little of the
        largest error of all.
        """
        spare = LEAST_OF_LARGEST * self.scale
        least, most = least - spare, most + spare
        if self.proof is not Proof.CLASSES:
            return least, most
        lower, upper = self._classes
        holds = (least + spare - rounding >= lower[:, None]) & (most - spare + rounding <= upper[:, None])
        place, is_held = holds.argmax(axis=0), holds.any(axis=0)
        low, high = (np.where(is_held, each[place], 0.0) for each in (lower, upper))
        return np.minimum(least, low + rounding), np.maximum(most, high - rounding)

    def write(self, body: BitWriter) -> None:
        """Append it to a file."""
        classes = self.codes if self.proof is Proof.CLASSES else None
        has_more = classes is not None or self.straight is not None
        body.write_floats(np.array([-self.scale if has_more else self.scale]))
        if classes is not None:
            write_classes(body, classes)
        elif self.codes is not None:
            body.write(self.codes.ravel().astype(np.int64), _CODE_BITS)
        if self.straight is not None:
            body.write_floats(self.straight)


def read_certificate(body: BitReader, proof: Proof, num_leaves: int, dim: int) -> Certificate | None:
    """What :meth:`Certificate.write` appended; raises ``ValueError`` saying what is wrong with it."""
    if proof is Proof.NONE:
        return None
    scale, codes, straight = float(body.read_floats(1)[0]), None, None
    if not 0 < (scale if proof is Proof.LEAVES else abs(scale)) < LARGEST:
        raise ValueError(f"it states a largest error of {scale}")
    if scale < 0 and proof is Proof.CLASSES:
        codes = read_classes(body, num_leaves)
    elif proof is not Proof.CLASSES:
        codes = body.read_alike(2 * num_leaves, _CODE_BITS).reshape(2, num_leaves)
    if scale < 0 and proof is Proof.OPEN_LEAVES:
        straight = body.read_floats(dim + 2)
        if not (np.isfinite(straight).all() and (straight[dim:] >= 0).all()):
            raise ValueError("it states a straight line to the goal with numbers that are none")
    return Certificate(abs(scale), None if codes is None else codes.astype(np.uint8), proof, straight)


def _of_codes(code: Integer[np.ndarray, "*n"], scale: float) -> Float[np.ndarray, "*n"]:
    """Bounds of codes, as 32-bit floats that are not below them."""
    exact = scale * 2.0 ** ((code.astype(np.float64) - _MOST) / _CODES_A_DOUBLING)
    return np.nextafter(exact.astype(np.float32), np.float32(np.inf)).astype(np.float64)


def _codes(bound: Float[np.ndarray, "leaves"], scale: float) -> UInt8[np.ndarray, "leaves"]:
    """The smallest codes whose bounds are not below."""
    with np.errstate(divide="ignore"):
        code = np.ceil(_MOST + _CODES_A_DOUBLING * np.log2(bound / scale))
    code = np.clip(code, 0, _MOST).astype(np.uint8)
    short = (_of_codes(code, scale) < bound) & (code < _MOST)  # by rounding of the logarithm
    return code + short.astype(np.uint8)
