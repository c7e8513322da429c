"""The function spaces of continuous and smooth leaves: finite elements on the leaves of a partition.

In each leaf, a function is multilinear (order 0) or cubic along each axis with a continuous gradient (order 1). Two
leaves are *tied* if paths can cross their common face: their functions must agree on the face. Every corner of every
leaf is a *node*. Nodes of tied leaves at one point form a *group* with one value. A corner inside the face of a tied
leaf *hangs* on that leaf: its value is interpolated from the leaf's corners. These lie on coarser dyadic levels, so a
value never depends on itself::

    o-----------o-----o     Three tied leaves, with 12 corners: the nodes.
    |           |  b  |     Each o is a group of 1 or 2 nodes.
    |     a     x-----o     x is a group of two nodes, corners of b and c. It hangs on its host leaf a:
    |           |  c  |     its value is the mean of a's corners above and below.
    o-----------o-----o
"""

import math
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import Distances, Points
from plr_jax.plr import leaf_faces
from plr_jax.plr.leaf_faces import Indices, SharedFaces
from plr_jax.plr.tree import Tree, corner_bits

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# The constraint equations have at most max(_MOST_WEIGHTS, _MOST_WEIGHTS_OF_LEAF * leaves) weights. Trees of random
# splits have 2,000 weights a leaf in 6 dimensions, 50 in 3.
_MOST_WEIGHTS = 2**20
_MOST_WEIGHTS_OF_LEAF = 2**8
_GROWTH = 4  # the elimination of constraints may use this many times more weights

# The local basis of a leaf. Order 0 is multilinear interpolation of corner values. Order 1 is cubic Hermite
# interpolation of corner values and derivatives, the rectangular element of Bogner, Fox and Schmit (1965). At a
# corner, derivatives are means over the multilinear functions of the leaves tied there. A hanging corner takes value
# and derivatives from the cubic of its host leaf; they determine the cubic on either half of the face, so the
# function stays continuous across it.
# By order: coefficients of the basis functions on [0, 1]. Axes: end of the interval, value or derivative, power of t.
#   order 0:  1 - t, t
#   order 1:  (1 - t)**2 (1 + 2 t), t (1 - t)**2;  t**2 (3 - 2 t), -t**2 (1 - t)
_BASIS_1D = (
    np.array([[1, -1], [0, 1]], float).reshape(2, 1, 2),
    np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], float).reshape(2, 2, 4),
)


class NodalSpace(NamedTuple):
    """The functions on the leaves of a tree that are continuous across certain (*tied*) faces between leaves.

    Functions may jump at other faces. The values at certain groups of nodes, the degrees of freedom, determine a
    function: see the module's docstring.
    """

    tree: Tree
    group: Int[np.ndarray, " nodes"]  # of each node ``leaf * 2**dim + corner``; nodes of a group share a value
    hanging: Int[np.ndarray, " hanging"]  # groups whose value is interpolated from an adjacent leaf
    host_leaf: Int[np.ndarray, " hanging"]  # the adjacent leaf
    host_position: Float[np.ndarray, "hanging dim"]  # of the group's point in the adjacent leaf, from 0 to 1
    free_dofs: Int[np.ndarray, " free_dofs"]  # groups whose values are free (degrees of freedom), sorted by ``level``
    level: Int[np.ndarray, " free_dofs"]  # binary digits of all coordinates of the point, in fractions of the domain
    values: "csr_array"  # from values of free groups to values of all nodes; 0 at nodes of unreachable leaves
    prediction: "csr_array"  # of free groups from coarser ones: the mean of the ends of the edge that a split halved


def nodal_space(tree: Tree, tied: SharedFaces, unreachable: Bool[np.ndarray, " leaves"]) -> NodalSpace:
    """Build the space of functions on the leaves of a tree that are continuous across the faces ``tied``.

    Leaves marked ``unreachable``, from which the goal cannot be reached, have no values. ``ValueError`` if the linear
    constraints between values at corners of leaves have too many weights.
    """
    from scipy.sparse import csr_array

    from plr_jax.geometry.graph import connected_groups  # imports SciPy

    num_leaves, dim = len(tree.leaves), tree.leaves.dim
    num_nodes = num_leaves << dim
    most = max(_MOST_WEIGHTS, _MOST_WEIGHTS_OF_LEAF * num_leaves)
    leaf_faces.check_num_weights(len(tied) * 2 ** (dim - 1), most)
    # 1. Constraint points, as points of both leaves: index 0 on the first axis of these arrays is the leaf below the
    #    face, index 1 the leaf above it. `t` is the position in the leaf, from 0 to 1 along each axis.
    corners = corner_bits(dim).astype(float)
    points = [leaf_faces.nodes_in_faces(tree.leaves, tied, axis, corners) for axis in range(dim)]
    leaf, t = (np.concatenate(parts, axis=1) for parts in zip(*points, strict=True))  # (2, points), (2, points, dim)
    is_end = (t == 0) | (t == 1)
    is_corner = is_end.all(axis=2)
    is_shared = is_corner.all(axis=0)  # corners of both leaves
    corner = t.astype(np.int64) @ (1 << np.arange(dim)[::-1])  # t == corner_bits[corner], if t is a corner
    node = (leaf << dim) + corner
    # 2. Groups: nodes of tied leaves that are the same point, numbered by their first node.
    label = connected_groups(num_nodes, node[:, is_shared])
    _, first_node = np.unique(label, return_index=True)
    num_groups, rank = len(first_node), np.argsort(np.argsort(first_node))  # of each label, by its first node
    group = rank[label]
    # 3. Hanging groups: corners of one leaf that are no corner of the other. Interpolate each from the first leaf on
    #    which it hangs, until only free groups remain. Row i of `of_groups` then has the weights of free groups in
    #    the value of group i.
    hangs = is_corner & ~is_corner[::-1]
    hanging, first_point = np.unique(group[node[hangs]], return_index=True)
    host_leaf, host_t = (of_others[::-1][hangs][first_point] for of_others in (leaf, t))
    step = _interpolation(group, host_leaf, host_t, hanging, (num_groups, num_groups))
    of_groups = leaf_faces.resolve_constraints(step, hanging)
    # 4. Level of a group, from its first node: exponents of two in the denominators of its point, summed over the
    #    axes. A corner's coordinate is numerator / 2**depth; the numerator's lowest bit tells by how much the
    #    fraction is reduced.
    numerator = tree.leaves.position[:, None] + corner_bits(dim)  # (leaves, corners, dim)
    depth = tree.leaves.depth[:, None]
    lowest_bit = np.frexp((numerator & -numerator).astype(float))[1] - 1
    levels = np.where(numerator == 0, 0, depth - np.minimum(lowest_bit, depth)).sum(axis=2)  # of nodes
    level = levels.ravel()[np.sort(first_node)]
    # 5. In 3 or more dimensions a corner may hang on two leaves, whose interpolations must agree there:
    #   (below - above) @ of_groups @ f == 0,     with f the values of free groups.
    # Each row is solved for the group of the highest level in it, which is then no longer free. The matrix of these
    # solutions turns any values into values that satisfy all rows.
    if dim > 2:
        row = np.flatnonzero(~is_shared)
        leaf_faces.check_num_weights(float(np.sum(2.0 ** np.count_nonzero(~is_end[:, row], axis=2))), most)
        shape = len(row), num_groups
        below, above = (_interpolation(group, leaf[i, row], t[i, row], np.arange(len(row)), shape) for i in range(2))
        rows = csr_array(below - above)
        leaf_faces.check_num_weights(int(np.diff(of_groups.indptr)[rows.indices].sum()), _GROWTH * most)
        of_groups = of_groups @ leaf_faces.eliminate_constraints(csr_array(rows @ of_groups), level, _GROWTH * most)
    # 6. Free degrees of freedom: groups of reachable leaves that depend on no other group.
    is_reachable = np.isin(np.arange(num_groups), group.reshape(num_leaves, -1)[~unreachable])
    free_dofs = np.flatnonzero(is_reachable & (of_groups.diagonal() == 1))
    free_dofs = free_dofs[np.argsort(level[free_dofs], kind="stable")]
    values = csr_array(of_groups[group][:, free_dofs])
    # 7. Prediction of degrees of freedom from coarser ones. At each node that a split made, the prediction is the
    #    mean of the ends of the edge that the split halved. It is averaged over the nodes of a degree of freedom. An
    #    end counts if both its leaf and the node's leaf are reachable.
    dof_of_group = np.full(num_groups, -1)
    dof_of_group[free_dofs] = np.arange(len(free_dofs))
    ends, is_made = leaf_faces.corner_parents(tree)  # (leaves, corners, 2), (leaves, corners)
    row = np.broadcast_to(dof_of_group[group].reshape(is_made.shape)[..., None], ends.shape)
    counts = is_made[..., None] & ~unreachable[ends >> dim] & ~unreachable[:, None, None] & (row >= 0)
    weight = 1.0 / np.maximum(np.bincount(row[counts], minlength=len(free_dofs)), 1)
    means = csr_array((weight[row[counts]], (row[counts], ends[counts])), (len(free_dofs), num_nodes))
    prediction = csr_array(means @ values)
    return NodalSpace(tree, group, hanging, host_leaf, host_t, free_dofs, level[free_dofs], values, prediction)


def _interpolation(
    group: Int[np.ndarray, " nodes"], leaf: Indices, t: Points, row: Indices, shape: tuple[int, int]
) -> "csr_array":
    from scipy.sparse import csr_array

    # Row ``row[i]`` interpolates values of groups (tied corners) at point ``t[i]`` of leaf ``leaf[i]``. A corner's
    # weight is a product over the axes: ``t`` along an axis at whose upper end the corner lies, else ``1 - t``. Each
    # axis appends a bit to the corners and so doubles the pairs (point, corner).
    point = np.arange(len(t))
    corner = np.zeros(len(t), np.int64)
    weight = np.ones(len(t))
    for axis in range(t.shape[1]):  # skip ends of weight 0
        along = t[point, axis]
        lower, upper = along < 1, along > 0
        weight = np.append((weight * (1 - along))[lower], (weight * along)[upper])
        corner = np.append(2 * corner[lower], 2 * corner[upper] + 1)
        point = np.append(point[lower], point[upper])
    return csr_array((weight, (row[point], group[(leaf[point] << t.shape[1]) + corner])), shape)


def basis_values(order: int, t: Points, kind: int = 0) -> Float[np.ndarray, "n terms"]:
    """Return the values of a leaf's basis functions (columns) at points ``t`` of its cell (rows).

    Points have coordinates from 0 to 1 across the cell. ``order`` is 0 for multilinear and 1 for cubic functions.
    ``kind`` has a bit for each axis, the last axis lowest: functions are differentiated once along each axis whose
    bit is 1.
    """
    # A basis function is a product of functions of one axis each: axis by axis, multiply the values so far, by corner
    # and kind, with the values of the axis's functions.
    _, kinds, num_powers = _BASIS_1D[order].shape
    n, dim = t.shape
    powers = np.arange(num_powers)
    values = np.ones((n, 1, 1))
    for axis, is_along in enumerate(corner_bits(dim)[kind]):
        slopes = powers * t[:, axis, None] ** np.maximum(powers - 1, 0)
        along = (slopes if is_along else t[:, axis, None] ** powers) @ _BASIS_1D[order].reshape(-1, num_powers).T
        values = np.einsum("ncm,nad->ncamd", values, along.reshape(n, 2, kinds))
        values = values.reshape(n, 2 ** (axis + 1), kinds ** (axis + 1))
    return values.reshape(n, (2 * kinds) ** dim)


def basis_monomials(order: int, dim: int) -> Float[np.ndarray, "terms powers"]:
    """Return each basis function as a polynomial of the coordinates ``t``: one row of coefficients per function.

    Each column is for a product of powers ``t[0]**i * t[1]**j * ...``; the exponent of the last axis varies fastest.
    """
    table = reduce(np.kron, [_BASIS_1D[order]] * dim)  # by corner, kind of derivative, and product of powers
    return table.reshape(-1, table.shape[2])


def enclosing_planes(
    powers: Float[np.ndarray, "n count count"], center: Points, reach: Points
) -> tuple[Distances, Points, Distances]:
    """Expand each leaf's polynomial, of two coordinates, at the center of a box in the leaf.

    Return the value and the gradient at the center, and an upper bound of the absolute sum of all other Taylor terms
    in the box. ``powers[:, p, q]`` are the coefficients of ``x**p y**q``. ``center`` and ``reach`` (half of the box's
    width along each axis) are in local coordinates, from 0 to 1 across the leaf.
    """
    # With powers P, f = sum of P[p, q] x**p y**q = sum of Q[a, b] (x - cx)**a (y - cy)**b over the exponents. Beside
    # Q[0, 0], Q[1, 0] and Q[0, 1], each term is at most |Q[a, b]| * reach_x**a * reach_y**b.
    count = powers.shape[1]
    # A shift has the coefficients of each power of x in powers of x - c, by the binomial theorem:
    #   x**n = sum over k of comb(n, k) * c**(n - k) * (x - c)**k.
    n, k = np.arange(count)[:, None], np.arange(count)
    binomials = np.array([[math.comb(i, j) for j in range(count)] for i in range(count)])  # 0 for j > i
    shifts = (binomials * center[:, axis, None, None] ** np.maximum(n - k, 0) for axis in range(2))
    powers = np.einsum("npq,npa,nqb->nab", powers, *shifts)
    x, y = (np.abs(reach[:, axis, None]) ** np.arange(count) for axis in range(2))
    terms = np.abs(powers) * x[:, :, None] * y[:, None]
    terms[:, 0, 0] = terms[:, 1, 0] = terms[:, 0, 1] = 0.0
    return powers[:, 0, 0], np.stack([powers[:, 1, 0], powers[:, 0, 1]], axis=1), terms.sum(axis=(1, 2))


def coefficient_matrix(order: int, space: NodalSpace) -> "csr_array":
    """Return the matrix that maps the degrees of freedom of a function to the coefficients of all leaves.

    The degrees of freedom are the values that determine the function. The coefficients of a leaf belong to the basis
    functions of :func:`basis_values`. Rows of the matrix are sorted by leaf.
    """
    from scipy.sparse import csr_array, diags_array, kron

    if order == 0:
        return space.values
    # A kind k has a bit for each axis along which it differentiates: kind 0 is the value. D[g, k] is the derivative
    # of kind k, by fractions of the domain, at group g; h is the depth of a leaf, whose widths are 2**-h. At place t
    # of the leaf (0 to 1 along each axis), its function with the Hermite basis B is
    #   f(t) = sum over corners c and kinds k of B[c, k](t) * 2**-(h . k) * D[group of c, k].
    # In vectors and matrices, D[g, k] has the row or column `index[g, k]`.
    kinds, group = corner_bits(space.tree.cells.dim), space.group
    index = np.arange((int(group.max()) + 1) * len(kinds)).reshape(-1, len(kinds))
    depth = np.repeat(space.tree.leaves.depth, len(kinds), axis=0)  # h, of each node's leaf
    has_value = np.diff(space.values.indptr) > 0  # of each node
    # 1. From the free degrees of freedom to D at groups that do not hang: the mean over the group's nodes of (mixed)
    #    derivatives of the leaves' multilinear functions. The derivative of kind k is 2**(h . k) times a difference
    #    of corner values along each axis of the kind.
    means = csr_array((index.size, len(space.free_dofs)))
    is_averaged = has_value & ~np.isin(group, space.hanging)
    for kind, along in enumerate(kinds):
        in_leaf = reduce(np.kron, [np.array([[-1.0, 1.0]] * 2) if is_along else np.eye(2) for is_along in along])
        differences = kron(diags_array(np.ones(len(space.tree.leaves))), csr_array(in_leaf))
        scale = np.ldexp(1.0, depth @ along)  # 2**(h . k)
        # The derivative in the smaller of two adjacent cells is the better one, so it weighs more.
        weight = scale * is_averaged
        weight /= np.bincount(group, weight)[group] + (weight == 0)
        mean = csr_array((weight, (index[group, kind], np.arange(len(group)))), (index.size, len(group)))
        means = means + mean @ (csr_array(diags_array(scale) @ differences) @ space.values)
    # 2. From D at corners of host leaves to D at hanging groups. The derivative of kind j of a host's function f is
    #      2**(h . j) * sum over corners c and kinds k of B'[c, k](t) * 2**-(h . k) * D[group of c, k],
    #    with B'[c, k] the derivative of kind j of B[c, k].
    hosts = group.reshape(-1, len(kinds))[space.host_leaf]  # groups of corners c
    to_domain = np.ldexp(1.0, space.tree.leaves.depth[space.host_leaf] @ kinds.T)  # 2**(h . j), (hanging, kinds)
    to_leaf = np.tile(1 / to_domain, len(kinds))  # 2**-(h . k), by corner, then kind
    basis = np.stack([basis_values(1, space.host_position, kind) for kind in range(len(kinds))])  # by kind and group
    weights = basis * to_leaf * to_domain.T[:, :, None]
    rows = np.broadcast_to(index[space.hanging].T[:, :, None], weights.shape)
    columns = np.broadcast_to(index[hosts].reshape(weights.shape[1:]), weights.shape)
    of_hosts = csr_array((weights.ravel(), (rows.ravel(), columns.ravel())), (index.size, index.size))
    # 3. D at all groups, and the coefficients of all leaves, by corner, then kind: 2**-(h . k) * D[group of c, k].
    of_groups = leaf_faces.resolve_constraints(of_hosts, index[space.hanging].ravel()) @ csr_array(means)
    scale = np.ldexp(1.0, -(depth @ kinds.T))
    row = np.arange(scale.size).reshape(scale.shape)
    place = row[has_value].ravel(), index[group[has_value]].ravel()
    return csr_array(csr_array((scale[has_value].ravel(), place), (scale.size, index.size)) @ of_groups)
