"""What a leaf's function is made of: corner values (order 0), or corner values and derivatives (order 1).

Order 0 interpolates the values at a cell's corners multilinearly. Order 1 adds cubic Hermite interpolation, as in the
element of Bogner, Fox and Schmit (1965): its derivatives at a corner are means over the leaves tied there of those of
the multilinear functions, so they follow from the same values. A hanging corner takes value and derivatives from the
cubic of the leaf it hangs on; half a cubic is the cubic of its own end points, so nothing jumps there either.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.leaves.continuous.space import NodalSpace
from plr_jax.plr.partition.dependencies import resolve
from plr_jax.plr.partition.tree import corner_bits

if TYPE_CHECKING:
    from scipy.sparse import csr_array

POWERS = (2, 4)  # of t along each axis, by order of continuity
MAX_DIM_OF_ORDER = (6, 2)  # 2**6 corners a leaf; in 3-D a corner may hang on two leaves whose cubics disagree there

# By order: for both ends of [0, 1] and the kinds of number there, a function's coefficients by powers of t. Those of
# order 1 are cubics: of the value at 0, the derivative at 0, the value at 1, the derivative at 1.
_ALONG = (
    np.array([[1, -1], [0, 1]], float).reshape(2, 1, 2),
    np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], float).reshape(2, 2, 4),
)


def design(order: int, t: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n terms"]:
    """Values at points ``t`` of a cell, from 0 to 1 along each axis, of the functions that its numbers multiply."""
    return _derivatives(order, t, np.zeros(t.shape[1], np.int64))


def numbers_of_leaves(order: int, space: NodalSpace) -> "csr_array":
    """Maps values of the masters to the numbers of all leaves, ``terms`` a leaf, as :func:`design` wants them."""
    return space.values if order == 0 else _values_and_derivatives(space)


def numbers_of_planes(
    order: int, center: Float[np.ndarray, "leaves"], half: Float[np.ndarray, "leaves dim"]
) -> Float[np.ndarray, "leaves terms"]:
    """The numbers of leaves that hold planes, of given values at the center and half-differences."""
    corners = corner_bits(half.shape[1])
    values = center[:, None] + half @ (2 * corners - 1).T
    if order == 0:
        return values
    numbers = np.zeros((*values.shape, len(corners)))
    numbers[:, :, 0] = values
    for axis, kind in enumerate(1 << np.arange(half.shape[1])[::-1]):
        numbers[:, :, kind] = 2 * half[:, axis, None]  # by t, which spans a leaf from 0 to 1
    return numbers.reshape(len(values), -1)


def monomials(order: int, dim: int) -> Float[np.ndarray, "terms powers"]:
    """For every number of a cell the coefficients of its function by powers of ``t``, the last axis fastest."""
    along = _ALONG[order]
    table = np.ones((1, 1, 1))
    for _ in range(dim):
        table = np.einsum("cmp,adq->camdpq", table, along).reshape(
            2 * table.shape[0], along.shape[1] * table.shape[1], along.shape[2] * table.shape[2]
        )
    return table.reshape(-1, table.shape[2])


def enclosing_planes(
    order: int,
    numbers: Float[np.ndarray, "n terms"],
    center: Float[np.ndarray, "n 2"],
    reach: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Planes near functions in the plane, in boxes that reach so far from a center, from 0 to 1 along each cell.

    Value and slope of each at the center, and how far at most the function is from it: the sum of what terms of
    higher order amount to where they are largest.
    """
    count = POWERS[order]
    powers = (numbers @ monomials(order, 2)).reshape(-1, count, count)
    shifts = (_shifted_powers(count, center[:, axis]) for axis in range(2))
    powers = np.einsum("npq,npa,nqb->nab", powers, *shifts)
    x, y = (np.abs(reach[:, axis, None]) ** np.arange(count) for axis in range(2))
    terms = np.abs(powers) * x[:, :, None] * y[:, None]
    terms[:, 0, 0] = terms[:, 1, 0] = terms[:, 0, 1] = 0.0
    return powers[:, 0, 0], np.stack([powers[:, 1, 0], powers[:, 0, 1]], axis=1), terms.sum(axis=(1, 2))


def on_boxes(
    order: int,
    lo: Float[np.ndarray, "n dim"],
    hi: Float[np.ndarray, "n dim"],
    numbers: Float[np.ndarray, "n terms"],
    box_lo: Float[np.ndarray, "n dim"],
    box_hi: Float[np.ndarray, "n dim"],
) -> Float[np.ndarray, "n powers"]:
    """Coefficients in the Bernstein bases of boxes of functions of cells, which they may reach out of.

    Over its box a function is nowhere beyond the least and the largest of them (Farin, "Curves and surfaces for
    CAGD", chapter 6).
    """
    count, dim = POWERS[order], lo.shape[1]
    start, width = (box_lo - lo) / (hi - lo), (box_hi - box_lo) / (hi - lo)
    to_bernstein = np.array([[math.comb(i, j) / math.comb(count - 1, j) for i in range(count)] for j in range(count)])
    powers = numbers @ monomials(order, dim)
    for axis in range(dim):
        # t = start + width * s, by powers of s, and these in Bernstein's basis.
        change = _shifted_powers(count, start[:, axis]) * width[:, axis, None, None] ** np.arange(count)
        powers = powers.reshape(len(powers), count**axis, count, -1)
        powers = np.einsum("napb,npq,qr->narb", powers, change, to_bernstein).reshape(len(powers), -1)
    return powers


def _shifted_powers(count: int, center: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n power power"]:
    """Powers of ``t`` as polynomials of ``t - center``."""
    power, of_difference = np.arange(count)[:, None], np.arange(count)
    ways = np.array([[math.comb(n, k) for k in range(count)] for n in range(count)])
    return ways * center[:, None, None] ** np.maximum(power - of_difference, 0)


def _derivatives(
    order: int, t: Float[np.ndarray, "n dim"], derivative: Int[np.ndarray, "dim"]
) -> Float[np.ndarray, "n terms"]:
    """A mixed derivative of all functions: by corner, then by what the number is a derivative along."""
    n, (_, kinds, num_powers) = len(t), _ALONG[order].shape
    values, powers = np.ones((n, 1, 1)), np.arange(num_powers)
    for axis, is_along in enumerate(derivative):
        slopes = powers * t[:, axis, None] ** np.maximum(powers - 1, 0)
        along = (slopes if is_along else t[:, axis, None] ** powers) @ _ALONG[order].reshape(-1, num_powers).T
        values = np.einsum("ncm,nad->ncamd", values, along.reshape(n, 2, kinds))
        values = values.reshape(n, 2 ** (axis + 1), kinds ** (axis + 1))
    return values.reshape(n, (2 * kinds) ** t.shape[1])


def _values_and_derivatives(space: NodalSpace) -> "csr_array":
    """Numbers of order 1. Derivatives are by fractions of the domain, until each leaf scales them to its own size."""
    from scipy.sparse import csr_array

    kinds = corner_bits(space.dim)
    num_groups = int(space.group.max()) + 1
    of_masters = _free_numbers(space, kinds, num_groups)
    is_free = np.ones((num_groups, len(kinds)))
    is_free[space.hanging] = 0
    of_groups = resolve(_hanging_numbers(space, kinds, num_groups), is_free.ravel()) @ of_masters
    depth = np.repeat(space.tree.leaves.depth, len(kinds), axis=0)
    scale = np.ldexp(1.0, -(depth @ kinds.T))
    is_answered = np.diff(space.values.indptr) > 0
    rows, kind = np.nonzero(np.broadcast_to(is_answered[:, None], scale.shape))
    pick = csr_array(
        (scale[rows, kind], (rows * len(kinds) + kind, space.group[rows] * len(kinds) + kind)),
        (scale.size, num_groups * len(kinds)),
    )
    return csr_array(pick @ of_groups)


def _free_numbers(space: NodalSpace, kinds: Int[np.ndarray, "kinds dim"], num_groups: int) -> "csr_array":
    """Values and mean derivatives of the groups that do not hang; rows of the others are zero."""
    from scipy.sparse import csr_array

    nodes = np.arange(len(space.group))
    corners = 2**space.dim
    depth = np.repeat(space.tree.leaves.depth, corners, axis=0)
    answered = np.diff(space.values.indptr) > 0
    answered &= ~np.isin(space.group, space.hanging)
    total = csr_array((num_groups * len(kinds), len(space.masters)))
    for kind, along in enumerate(kinds):
        # Where two cells meet, the difference over the smaller one is the better derivative.
        weight = np.ldexp(1.0, depth @ along) * answered
        weight /= np.bincount(space.group, weight)[space.group] + (weight == 0)
        mean = csr_array((weight, (space.group * len(kinds) + kind, nodes)), (num_groups * len(kinds), len(nodes)))
        total = total + mean @ (_differences(space, along) @ space.values)
    return csr_array(total)


def _differences(space: NodalSpace, along: Int[np.ndarray, "dim"]) -> "csr_array":
    """The (mixed) derivative along some axes of every leaf's multilinear function at its corners."""
    from scipy.sparse import csr_array, diags_array, kron

    table = np.ones((1, 1))
    for is_along in along:
        table = np.kron(table, [[-1, 1], [-1, 1]] if is_along else np.eye(2))
    depth = np.repeat(space.tree.leaves.depth, len(table), axis=0)
    every_leaf = kron(diags_array(np.ones(len(space.tree.node_of_leaf))), csr_array(table))
    return csr_array(diags_array(np.ldexp(1.0, depth @ along)) @ every_leaf)


def _hanging_numbers(space: NodalSpace, kinds: Int[np.ndarray, "kinds dim"], num_groups: int) -> "csr_array":
    """Values and derivatives of the groups that hang, from the numbers of the leaf each hangs on."""
    from scipy.sparse import csr_array

    size = len(kinds)
    depth = space.tree.leaves.depth[space.on_leaf]
    to_leaf = np.tile(np.ldexp(1.0, -(depth @ kinds.T)), size)  # by corner, then kind
    group = space.group.reshape(-1, 2**space.dim)[space.on_leaf]
    columns = (group[:, :, None] * size + np.arange(size)).reshape(len(group), size * size)
    rows, weights = [], []
    for kind, along in enumerate(kinds):
        weights.append(_derivatives(1, space.at, along) * to_leaf * np.ldexp(1.0, depth @ along)[:, None])
        rows.append(np.broadcast_to((space.hanging * size + kind)[:, None], columns.shape))
    table = np.stack(weights).ravel(), (np.stack(rows).ravel(), np.tile(columns, (size, 1)).ravel())
    return csr_array(table, (num_groups * size, num_groups * size))
