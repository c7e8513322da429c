"""Functions that are multilinear in every leaf and continuous across free faces: which values at corners are free.

Faces across the seam of a periodic axis are like any other: a corner at one end of the axis and one at the other are
one point.

Every corner of every leaf is a *node*. Across a face that is free the functions of its two leaves must agree at the
corners of what they share. A corner of both makes their nodes one; a corner of one of them alone, which *hangs* on
the other, takes the other's interpolation there. A hanging corner has larger denominators than the corners it is
interpolated from (in the sum of their exponents over the axes), so these dependencies have no cycles. Walls tie
nothing: a mesh point in a wall has several nodes.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.faces import SharedFaces, eliminated, face_points, parents_of_corners, require_few, resolve
from plr_jax.plr.tree import Tree, corner_bits

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Weights in the equations of a space: in all, or for every leaf where that is more. Trees that split random leaves
# have 2,000 a leaf in 6 dimensions and 50 in 3. Solving the equations may make several times as many.
_MOST_WEIGHTS, _MOST_WEIGHTS_OF_LEAF, _GROWTH = 2**20, 2**8, 4


@dataclass(frozen=True, eq=False)
class NodalSpace:
    """A basis of the continuous functions on a tied partition.

    Attributes:
        tree: The partition.
        group: Number of the tied nodes to which each node belongs; nodes are numbered ``leaf * 2**dim + corner``.
        hanging: Groups that hang on a larger leaf.
        on_leaf: That leaf, for each hanging group.
        at: Where on it, from 0 to 1 along each axis.
        masters: Groups whose values are free, coarse ones first.
        level: A master's denominator as an exponent of two, summed over the axes; ascending.
        values: Maps values of the masters to values of all nodes; 0 for the nodes of unreachable leaves.
        prediction: Maps values of the masters to a guess for each from coarser ones, the middle of an edge.
    """

    tree: Tree
    group: Int[np.ndarray, "nodes"]
    hanging: Int[np.ndarray, "hanging"]
    on_leaf: Int[np.ndarray, "hanging"]
    at: Float[np.ndarray, "hanging dim"]
    masters: Int[np.ndarray, "masters"]
    level: Int[np.ndarray, "masters"]
    values: "csr_array"
    prediction: "csr_array"

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.tree.cells.dim


def nodal_space(tree: Tree, tied: SharedFaces, unreachable: Bool[np.ndarray, "leaves"]) -> NodalSpace:
    """The functions that are continuous across the tied faces; unreachable leaves, of which none has one, hold none.

    Raises ``ValueError`` if the leaves hang on one another so often that working that out would take too long.
    """
    from scipy.sparse import coo_array, csr_array
    from scipy.sparse.csgraph import connected_components

    cells, dim, bits = tree.leaves, tree.cells.dim, corner_bits(tree.cells.dim)
    num_nodes = len(cells) << dim
    most = max(_MOST_WEIGHTS, _MOST_WEIGHTS_OF_LEAF * len(cells))
    require_few(len(tied) * 2 ** (dim - 1), most)
    # 1. The corners of what two leaves share of a face, in the coordinates of both: there their functions agree.
    leaves, places = [], []
    for axis in range(dim):
        faces, w = tied[tied.axis == axis], bits[bits[:, axis] == 0].astype(float)
        x = face_points(cells, faces, w).reshape(-1, dim)
        leaves.append(np.repeat(np.stack([faces.lower, faces.upper]), len(w), axis=1))
        places.append(np.ldexp(x, cells.depth[leaves[-1]]) - cells.position[leaves[-1]])
        places[-1][:, :, axis] = [[1.0], [0.0]]  # across a seam too, where the upper leaf is at 0 of the domain
    leaf, t = np.concatenate(leaves, axis=1), np.concatenate(places, axis=1)
    is_end = (t == 0) | (t == 1)
    is_corner = is_end.all(axis=2)
    is_shared = is_corner.all(axis=0)
    node = (leaf << dim) + t.astype(np.int64) @ (1 << np.arange(dim)[::-1])  # of those that are corners of the leaf
    # 2. Nodes that are one point of tied leaves are one group; groups are numbered in the order of the nodes.
    pairs = tuple(node[:, is_shared])
    graph = coo_array((np.ones(len(pairs[0])), pairs), (num_nodes, num_nodes))
    _, label = connected_components(graph, directed=False)
    _, first_node, group = np.unique(label, return_index=True, return_inverse=True)
    group, num_groups = np.argsort(np.argsort(first_node))[group], len(first_node)
    # 3. Groups that hang on another leaf, the first of several; they follow from groups that are free.
    hangs = is_corner & ~is_corner[::-1]
    hanging, first = np.unique(group[node[hangs]], return_index=True)
    on_leaf, at = leaf[::-1][hangs][first], t[::-1][hangs][first]
    is_free = np.ones(num_groups)
    is_free[hanging] = 0
    of_groups = resolve(_interpolation(group, on_leaf, at, hanging, (num_groups, num_groups)), is_free)
    # 4. The level of a group: the exponents of the denominators of its point, summed over the axes.
    numerator = (cells.position[:, None] + bits).reshape(-1, dim)
    depth = np.repeat(cells.depth, len(bits), axis=0)
    lowest_bit = np.frexp((numerator & -numerator).astype(float))[1] - 1
    level = np.zeros(num_groups, np.int64)
    level[group] = np.where(numerator == 0, 0, depth - np.minimum(lowest_bit, depth)).sum(axis=1)
    # 5. In space a corner may hang on two leaves of which neither implies the other: their values must agree.
    if dim > 2:
        row = np.flatnonzero(~is_shared)
        require_few(float(np.sum(2.0 ** np.count_nonzero(~is_end[:, row], axis=2))), most)
        below, above = (
            _interpolation(group, leaf[side, row], t[side, row], np.arange(len(row)), (len(row), num_groups))
            for side in range(2)
        )
        rows = csr_array(below - above)
        require_few(int(np.diff(of_groups.indptr)[rows.indices].sum()), _GROWTH * most)
        of_groups = of_groups @ eliminated(csr_array(rows @ of_groups), level, _GROWTH * most)
    # 6. The masters: groups of reachable leaves that follow from no others.
    is_master = np.zeros(num_groups, bool)
    is_master[group.reshape(len(cells), -1)[~unreachable]] = True
    is_master[hanging] = False
    is_master &= of_groups.diagonal() == 1
    masters = np.flatnonzero(is_master)
    masters = masters[np.argsort(level[masters], kind="stable")]
    values = csr_array(of_groups[group][:, masters])
    # 7. A guess for each master: the mean, over its nodes, of the middle of the edge that a split halved there.
    ends, is_made = parents_of_corners(tree)
    counts = is_made[..., None] & ~unreachable[ends >> dim] & ~unreachable[:, None, None]
    master = np.full(num_groups, -1)
    master[masters] = np.arange(len(masters))
    row = np.broadcast_to(master[group].reshape(is_made.shape)[..., None], ends.shape)
    counts &= row >= 0
    weight = 1.0 / np.maximum(np.bincount(row[counts], minlength=len(masters)), 1)
    mean = csr_array((weight[row[counts]], (row[counts], ends[counts])), (len(masters), num_nodes))
    prediction = csr_array(mean @ values)
    return NodalSpace(tree, group, hanging, on_leaf, at, masters, level[masters], values, prediction)


def _interpolation(
    group: Int[np.ndarray, "nodes"],
    leaf: Int[np.ndarray, "n"],
    t: Float[np.ndarray, "n dim"],
    row: Int[np.ndarray, "n"],
    shape: tuple[int, int],
) -> "csr_array":
    """Maps values of the groups to values at points ``t`` of leaves, each in a row of the result."""
    from scipy.sparse import csr_array

    point, corner, weight = np.arange(len(t)), np.zeros(len(t), np.int64), np.ones(len(t))
    for axis in range(t.shape[1]):  # where a point is at an end, the other one counts nothing
        along = t[point, axis]
        lower, upper = along < 1, along > 0
        weight = np.append((weight * (1 - along))[lower], (weight * along)[upper])
        corner = np.append(2 * corner[lower], 2 * corner[upper] + 1)
        point = np.append(point[lower], point[upper])
    return csr_array((weight, (row[point], group[(leaf[point] << t.shape[1]) + corner])), shape)


# What a leaf's function is made of: corner values (order 0), or corner values and derivatives (order 1).
#
# Order 0 interpolates the values at a cell's corners multilinearly. Order 1 adds cubic Hermite interpolation, as in
# the element of Bogner, Fox and Schmit (1965): its derivatives at a corner are means over the leaves tied there of
# those of the multilinear functions, so they follow from the same values. A hanging corner takes value and
# derivatives from the cubic of the leaf it hangs on; half a cubic is the cubic of its own end points, so nothing
# jumps there either.


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
    from scipy.sparse import csr_array, diags_array, kron

    kinds, group, leaf_depth = corner_bits(space.dim), space.group, space.tree.leaves.depth
    size, num_groups, nodes = len(kinds), int(group.max()) + 1, np.arange(len(group))
    depth = np.repeat(leaf_depth, size, axis=0)
    is_answered = np.diff(space.values.indptr) > 0
    # 1. Groups that do not hang: means of the (mixed) derivatives, at corners, of the leaves' multilinear functions.
    is_averaged = is_answered & ~np.isin(group, space.hanging)
    of_masters = csr_array((num_groups * size, len(space.masters)))
    for kind, along in enumerate(kinds):
        table = np.ones((1, 1))
        for is_along in along:
            table = np.kron(table, [[-1, 1], [-1, 1]] if is_along else np.eye(2))
        every_leaf = kron(diags_array(np.ones(len(leaf_depth))), csr_array(table))
        differences = csr_array(diags_array(np.ldexp(1.0, depth @ along)) @ every_leaf)
        # Where two cells meet, the difference over the smaller one is the better derivative.
        weight = np.ldexp(1.0, depth @ along) * is_averaged
        weight /= np.bincount(group, weight)[group] + (weight == 0)
        mean = csr_array((weight, (group * size + kind, nodes)), (num_groups * size, len(nodes)))
        of_masters = of_masters + mean @ (differences @ space.values)
    # 2. Groups that hang, from the numbers of the leaf that each hangs on.
    on_depth, on_group = leaf_depth[space.on_leaf], group.reshape(-1, size)[space.on_leaf]
    to_leaf = np.tile(np.ldexp(1.0, -(on_depth @ kinds.T)), size)  # by corner, then kind
    columns = (on_group[:, :, None] * size + np.arange(size)).reshape(len(on_group), size * size)
    rows, weights = [], []
    for kind, along in enumerate(kinds):
        weights.append(_derivatives(1, space.at, along) * to_leaf * np.ldexp(1.0, on_depth @ along)[:, None])
        rows.append(np.broadcast_to((space.hanging * size + kind)[:, None], columns.shape))
    entries = np.stack(weights).ravel(), (np.stack(rows).ravel(), np.tile(columns, (size, 1)).ravel())
    of_hanging = csr_array(entries, (num_groups * size, num_groups * size))
    is_free = np.ones((num_groups, size))
    is_free[space.hanging] = 0
    of_groups = resolve(of_hanging, is_free.ravel()) @ csr_array(of_masters)
    # 3. The numbers of all leaves, by corner, then kind.
    scale = np.ldexp(1.0, -(depth @ kinds.T))
    row, kind = np.nonzero(np.broadcast_to(is_answered[:, None], scale.shape))
    place = row * size + kind, group[row] * size + kind
    return csr_array(csr_array((scale[row, kind], place), (scale.size, num_groups * size)) @ of_groups)
