"""Spending a budget of bytes: the best tree among prefixes of the splits, and the bits its planes are worth."""

import numpy as np
from jaxtyping import Int

from plr_jax.plr.file.plr_file import size_in_bytes
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.nodes import Nodes, split_order
from plr_jax.plr.leaves.plane.codec import FLOAT_BITS, StoredPlanes, encode_planes

_BUDGET_BITS = range(8, 17)  # center values that construction chooses from under a budget of bytes
_BYTES_SLACK = 1.15  # leaves grown beyond the budget, so that fewer bits for more leaves is a choice


def splits_allowed(nodes: Nodes, order: Int[np.ndarray, "splits"], limits: Limits) -> int:
    """How many splits the limits may allow at most, judged by the bytes a leaf takes so far."""
    allowed = limits.max_leaves - 1
    if np.isfinite(limits.max_bytes):
        leaf = _leaves_after(nodes, order[nodes.child[order] >= 0][:allowed])
        a_leaf = _size(nodes, leaf, _sufficient_bits(nodes, leaf, limits)) / len(leaf)
        allowed = min(allowed, int(_BYTES_SLACK * limits.max_bytes / a_leaf) + 1)
    return allowed


def choose_leaves(nodes: Nodes, limits: Limits) -> tuple[Int[np.ndarray, "leaves"], StoredPlanes]:
    """Leaves of the best tree within the limits, and their planes as they are stored.

    Raises:
        ValueError: If the budget of bytes is too small for one leaf.
    """
    order = split_order(nodes)
    order = order[nodes.child[order] >= 0][: limits.max_leaves - 1]
    if not np.isfinite(limits.max_bytes):
        leaf = _leaves_after(nodes, order)
        return leaf, _stored(nodes, leaf, limits.coefficient_bits or FLOAT_BITS)
    choices = _BUDGET_BITS if limits.coefficient_bits is None else [limits.coefficient_bits]
    within = [(_leaves_within(nodes, order, limits.max_bytes, bits), bits) for bits in choices]
    leaf, bits = min(within, key=lambda choice: (_expected_error(nodes, *choice), -choice[1]))
    if len(leaf) == 0:
        smallest = _size(nodes, np.zeros(1, np.int64), min(choices))
        raise ValueError(
            f"max_bytes={limits.max_bytes:g} is too small: one leaf takes {smallest} bytes; allow at least that."
        )
    return leaf, _stored(nodes, leaf, bits)


def _leaves_within(
    nodes: Nodes, order: Int[np.ndarray, "splits"], max_bytes: float, bits: int
) -> Int[np.ndarray, "leaves"]:
    """Leaves of the largest tree of the given order that fits into so many bytes; none if not even the root does."""
    enough, too_many = -1, len(order) + 1
    while too_many - enough > 1:
        middle = (enough + too_many) // 2
        fits = _size(nodes, _leaves_after(nodes, order[:middle]), bits) <= max_bytes
        enough, too_many = (middle, too_many) if fits else (enough, middle)
    return _leaves_after(nodes, order[:enough]) if enough >= 0 else np.empty(0, np.int64)


def _leaves_after(nodes: Nodes, splits: Int[np.ndarray, "splits"]) -> Int[np.ndarray, "leaves"]:
    """Leaves of the tree whose inner nodes are the given ones."""
    is_leaf = np.zeros(len(nodes.key), bool)
    is_leaf[0] = True
    is_leaf[nodes.child[splits]] = is_leaf[nodes.child[splits] + 1] = True
    is_leaf[splits] = False
    return np.flatnonzero(is_leaf)


def _stored(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> StoredPlanes:
    return encode_planes(nodes.center[leaf], nodes.half[leaf], bits)


def _size(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> int:
    return size_in_bytes(nodes.cells[leaf], _stored(nodes, leaf, bits))


def _sufficient_bits(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], limits: Limits) -> int:
    """Bits that would be chosen for these leaves if bytes did not matter much."""
    if limits.coefficient_bits is not None:
        return limits.coefficient_bits
    return min(_BUDGET_BITS, key=lambda bits: abs(_rounding_error(nodes, leaf, bits) - 0.2 * _fit_error(nodes, leaf)))


def _expected_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Mean error over reachable points: of the fit and of the rounding, which are independent."""
    if len(leaf) == 0:
        return np.inf
    return float(np.hypot(_fit_error(nodes, leaf), _rounding_error(nodes, leaf, bits)))


def _fit_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"]) -> float:
    return float(np.sum(nodes.share[leaf] * nodes.error[leaf]) / np.sum(nodes.share[leaf]))


def _rounding_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Root mean square, over the cells, of rounding center and half-differences to a multiple of the step."""
    return float(_stored(nodes, leaf, bits).step * np.sqrt((1 + nodes.cells.dim / 3) / 12))
