"""Classes of leaves, each with bounds of its own: nearly as narrow as bounds of every leaf, for few bits a leaf.

Most leaves are far better than the few worst, as those where walls touch. As bits:

    number of classes, in 4 bits, and codes of their lower bounds, then of their upper ones, 8 bits each
    for every class but the last, the largest first, the set of those leaves, of all that are in no class before,
      that are not in this one either (see ``file/bits.py``)
"""

import numpy as np
from jaxtyping import Float, Int, Integer, Shaped

from plr_jax.plr.file.bits import BitReader, BitWriter

_COUNT_BITS, _CODE_BITS = 4, 8
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


def in_these_classes(
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
