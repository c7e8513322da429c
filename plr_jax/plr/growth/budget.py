"""Spending a budget of bytes: the best tree among prefixes of the splits, and the bits its numbers are worth."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.nodes import Nodes, split_order

_BYTES_SLACK = 1.15  # leaves grown beyond the budget, so that fewer bits for more leaves is a choice
_ROUNDING_SHARE = 0.2  # of the error of the fit, that of rounding when bytes do not matter much


@dataclass(frozen=True)
class Encoding:
    """How a model whose leaves are fitted one by one stores them, with a choice of how many bits.

    Attributes:
        choices: Bits that construction chooses from.
        size: Bytes of the file of these leaves, in so many bits.
        rounding_error: Root mean square, over the cells, of what rounding to so many bits changes.
    """

    choices: Sequence[int]
    size: Callable[[Nodes, Int[np.ndarray, "leaves"], int], int]
    rounding_error: Callable[[Nodes, Int[np.ndarray, "leaves"], int], float]


def splits_allowed(nodes: Nodes, order: Int[np.ndarray, "splits"], limits: Limits, encoding: Encoding) -> int:
    """How many splits the limits may allow at most, judged by the bytes a leaf takes so far."""
    allowed = limits.max_leaves - 1
    if np.isfinite(limits.max_bytes):
        leaf = nodes.leaves_after(order[nodes.child[order] >= 0][:allowed])
        enough = _ROUNDING_SHARE * _fit_error(nodes, leaf)
        bits = min(encoding.choices, key=lambda bits: abs(encoding.rounding_error(nodes, leaf, bits) - enough))
        a_leaf = encoding.size(nodes, leaf, bits) / len(leaf)
        allowed = min(allowed, int(_BYTES_SLACK * limits.max_bytes / a_leaf) + 1)
    return allowed


def choose_leaves(nodes: Nodes, limits: Limits, encoding: Encoding) -> tuple[Int[np.ndarray, "leaves"], int]:
    """Leaves of the best tree within the limits, and the bits to store them with.

    Raises:
        ValueError: If the budget of bytes is too small for one leaf.
    """
    order = split_order(nodes)
    order = order[nodes.child[order] >= 0][: limits.max_leaves - 1]
    within = [(_leaves_within(nodes, order, limits.max_bytes, encoding, bits), bits) for bits in encoding.choices]
    leaf, bits = min(within, key=lambda choice: (_expected_error(nodes, encoding, *choice), -choice[1]))
    if len(leaf) == 0:
        smallest = encoding.size(nodes, np.zeros(1, np.int64), min(encoding.choices))
        raise ValueError(
            f"max_bytes={limits.max_bytes:g} is too small: one leaf takes {smallest} bytes; allow at least that."
        )
    return leaf, bits


def _leaves_within(
    nodes: Nodes, order: Int[np.ndarray, "splits"], max_bytes: float, encoding: Encoding, bits: int
) -> Int[np.ndarray, "leaves"]:
    """Leaves of the largest tree of the given order that fits into so many bytes; none if not even the root does."""
    if np.isinf(max_bytes):
        return nodes.leaves_after(order)

    def size(num_splits: int) -> int:
        return encoding.size(nodes, nodes.leaves_after(order[:num_splits]), bits)

    enough = bisect_right(range(len(order) + 1), max_bytes, key=size)
    return nodes.leaves_after(order[: enough - 1]) if enough else np.empty(0, np.int64)


def _expected_error(nodes: Nodes, encoding: Encoding, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Mean error over reachable points: of the fit and of the rounding, which are independent."""
    if len(leaf) == 0:
        return np.inf
    return float(np.hypot(_fit_error(nodes, leaf), encoding.rounding_error(nodes, leaf, bits)))


def _fit_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"]) -> float:
    return float(np.sum(nodes.share[leaf] * nodes.error[leaf]) / np.sum(nodes.share[leaf]))
