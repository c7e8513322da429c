"""Encode error bounds, and group leaves into classes that share bounds, for files (``portable/FORMAT.md``)."""

from bisect import bisect_left
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int, Integer, Shaped, UInt8

from plr_jax.plr.coding import BitReader, BitWriter

Codes: TypeAlias = Integer[np.ndarray, "2 leaves"]
CODE_BITS = 8  # of a code of a bound
# Code c stands for the bound  scale * 2**((c - 255) / 12),  rounded up: the largest code is the scale itself.
LARGEST_CODE = 255
CODES_A_DOUBLING = 12
_COUNT_BITS = 4  # bits of the number of classes less one
_BITS_A_CLASS = 2 * 8 + 37  # two codes of bounds, and the least bits of a set: its size and the order of its code
_PRICES = np.ldexp(1.0, -np.arange(60))  # prices per bit to try, in units of the width of one class of all leaves


def decode_bounds(code: Integer[np.ndarray, "*n"], scale: float) -> Float[np.ndarray, "*n"]:
    # The exact bound, rounded to 32 bits and then to the next larger number.
    exact = scale * 2.0 ** ((code.astype(np.float64) - LARGEST_CODE) / CODES_A_DOUBLING)
    return np.nextafter(exact.astype(np.float32), np.float32(np.inf)).astype(np.float64)


def encode_bounds(bound: Float[np.ndarray, " leaves"], scale: float) -> UInt8[np.ndarray, " leaves"]:
    # Codes whose bounds are at least ``bound``, from 0 to ``scale``: the least ones, but for rounding.
    with np.errstate(divide="ignore"):
        code = np.ceil(LARGEST_CODE + CODES_A_DOUBLING * np.log2(bound / scale))
    code = np.clip(code, 0, LARGEST_CODE).astype(np.uint8)
    short = (decode_bounds(code, scale) < bound) & (code < LARGEST_CODE)  # if the logarithm was rounded down
    return code + short.astype(np.uint8)


_BOUND_OF_CODE = decode_bounds(np.arange(LARGEST_CODE + 1), 1.0)  # in units of the scale


def classify_bounds(codes: Codes, volume: Float[np.ndarray, " leaves"], max_bits: int) -> Codes:
    """Group leaves into classes that share error bounds, so that the bounds take at most ``max_bits`` bits in a file.

    ``codes`` has each leaf's own lower (row 0) and upper (row 1) bound, as integers from 0 to 255 on a logarithmic
    scale: larger integers stand for wider bounds. Return the shared bounds, coded in this way, in the same shape.
    The sum over the leaves of ``volume`` times the width of the shared bounds is kept small.
    """
    # A leaf's rank is the rank of the larger of its two codes. A class has all leaves of consecutive ranks. Dynamic
    # programming finds the classes of least sum of weighted widths plus a price per bit; bisection finds the lowest
    # price at which the classes fit.
    # 1. For each range of ranks: codes of the shared bounds, total width of the leaves' bounds, and bits in a file.
    rank, rank_of = np.unique(codes.max(axis=0), return_inverse=True)
    num_ranks = len(rank)

    def of_ranges(of_rank: Shaped[np.ndarray, " ranks"], fold: np.ufunc) -> Shaped[np.ndarray, "ranks ranks"]:
        # Entry [i, j] folds ranks i to j. Zeros before rank i change neither sums nor maxima of values >= 0.
        return fold.accumulate(np.triu(np.broadcast_to(of_rank, (num_ranks, num_ranks))), axis=1)

    highest = np.zeros((2, num_ranks), codes.dtype)
    for of_rank, of_leaf in zip(highest, codes, strict=True):
        np.maximum.at(of_rank, rank_of, of_leaf)
    of_class = np.stack([of_ranges(of_rank, np.maximum) for of_rank in highest])
    width = of_ranges(np.bincount(rank_of, volume), np.add) * _BOUND_OF_CODE[of_class].sum(axis=0)
    members = of_ranges(np.bincount(rank_of).astype(float), np.add)
    # A set of m of n leaves takes about m log2(n / m) bits.
    bits = members * np.log2(codes.shape[1] / np.maximum(members, 1.0)) + _BITS_A_CLASS
    width, bits = np.ascontiguousarray(width.T), np.ascontiguousarray(bits.T)  # from now on [last rank, first rank]

    # 2. Dynamic programming over the last rank.
    def best_classes(price: float) -> Codes:
        # least[k] is the least cost of classes of the k lowest ranks: over all begins of the last class, the least of
        #   least[begin] + cost of a class of ranks begin to k - 1;     first_rank[k - 1] is this begin.
        costs = width + price * bits
        least = np.zeros(num_ranks + 1)
        first_rank = []
        for last in range(num_ranks):
            costs_to = least[: last + 1] + costs[last, : last + 1]
            first_rank.append(costs_to.argmin())
            least[last + 1] = costs_to[first_rank[-1]]
        # Walk back from the class of the highest rank.
        best = np.empty_like(highest)
        end = num_ranks
        while end:
            start = first_rank[end - 1]
            best[:, start:end] = of_class[:, start, end - 1, None]
            end = start
        return best[:, rank_of]

    # 3. Bisection: of the falling prices, find the last one at which classes fit. If none does, there is one class.
    prices = _PRICES * width[-1, 0]
    num_fitting = bisect_left(prices, True, key=lambda price: not _fits(best_classes(price), max_bits))
    return best_classes(prices[num_fitting - 1]) if num_fitting else np.broadcast_to(of_class[:, :1, -1], codes.shape)


def requantize_bounds(codes: Codes, shared: Integer[np.ndarray, "2 _"], max_bits: int) -> Codes | None:
    """Widen each leaf's bounds to the narrowest pair of bounds in ``shared`` that contains the leaf's bounds.

    Each column of ``shared`` has the codes of a pair; pairs may repeat. ``codes`` are as for :func:`classify_bounds`.
    Return the codes of the widened bounds; None if a leaf's bounds are in no pair, or the result takes more than
    ``max_bits`` bits in a file.
    """
    classes = shared[:, np.unique(_class_keys(shared), return_index=True)[1]]
    classes = classes[:, np.argsort(_BOUND_OF_CODE[classes].sum(axis=0), kind="stable")]
    holds = (codes[:, None, :] <= classes[:, :, None]).all(axis=0)  # (classes, leaves)
    widened = classes[:, holds.argmax(axis=0)]  # the first class that holds, which is the narrowest
    return widened if holds.any(axis=0).all() and _fits(widened, max_bits) else None


def _fits(codes: Codes, max_bits: int) -> bool:
    """Return whether the bounds with the codes ``codes`` take at most ``max_bits`` bits in a file."""
    can_count = len(np.unique(_class_keys(codes))) <= 1 << _COUNT_BITS
    return can_count and write_classes(BitWriter(), codes).num_bits <= max_bits


def write_classes(body: BitWriter, codes: Codes) -> BitWriter:
    """Write each leaf's column of ``codes``, its coded lower and upper error bound.

    The file gets all distinct columns, then which leaf has which column.
    """
    key, class_of, size = np.unique(_class_keys(codes), return_inverse=True, return_counts=True)
    classes = np.stack(np.divmod(key, 1 << CODE_BITS))
    order = np.argsort(-size, kind="stable")  # the largest class first, so that later sets are small
    place = np.argsort(order)[class_of]  # of each leaf's class in this order
    body.write(np.array([len(order) - 1]), _COUNT_BITS).write(classes[:, order].ravel(), CODE_BITS)
    for index in range(len(order) - 1):
        body.write_set(place > index)
        place = place[place > index]
    return body


def _class_keys(codes: Codes) -> Int[np.ndarray, " leaves"]:
    lower, upper = codes.astype(np.int64)
    return (lower << CODE_BITS) + upper


def read_classes(body: BitReader, num_leaves: int) -> Int[np.ndarray, "2 leaves"]:
    """Decode the pair of codes (row 0: lower, row 1: upper error bound) of each leaf.

    The file lists all distinct pairs (classes). Then, for each class in turn, it states which of the remaining leaves
    belong to a later class.
    """
    count = int(body.read_fixed_width(1, _COUNT_BITS)[0]) + 1
    classes = body.read_fixed_width(2 * count, CODE_BITS).reshape(2, count)
    place = np.zeros(num_leaves, np.int64)  # of each leaf's class
    leaf = np.arange(num_leaves)  # leaves that are in no earlier class
    for _ in range(count - 1):
        leaf = leaf[body.read_set(len(leaf))]
        place[leaf] += 1
    return classes[:, place]
