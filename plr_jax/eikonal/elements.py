"""Finite elements of degree 1 or 2 that are continuous across faces between cells that are not blocked.

A node *hangs* if it lies on a face of a larger cell, but is no node of that cell: its value is then the value of the
larger cell's polynomial. The other nodes are the degrees of freedom. In a cell, the gradient lies in the convex hull
of its Bernstein coefficients, the *control vectors*.

    o-----o--o--o
    |     |  |  |       Degree 1: the node h on the face of the larger cell hangs, with half the sum of the values at
    |     h--o--o       both ends of this face. Nodes of several cells at one point are one node if open faces join
    |     |  |  |       these cells.
    o-----o--o--o
"""

from functools import reduce
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, eye_array, kron

from plr_jax.eikonal.mesh import Mesh
from plr_jax.geometry.graph import connected_groups
from plr_jax.plr.leaf_faces import eliminate_constraints, nodes_in_faces, resolve_constraints

Numbers: TypeAlias = Float[np.ndarray, " n"]
Curve: TypeAlias = tuple[Float[np.ndarray, " levels"], Float[np.ndarray, " levels"]]  # breakpoints and values
# Step 3 of `function_space` eliminates variables. The elimination raises `ValueError` if it takes more additions than
# this number times the number of groups of nodes, so that its time is limited.
_MOST_WEIGHTS_OF_NODE = 2**8
# By the degree, along one axis: weights of the trapezoidal rule and of Simpson's rule, and the matrix from values at
# equally spaced nodes to Bernstein coefficients. For degree 2, the middle one is 2 * f(1/2) - (f(0) + f(1)) / 2.
_QUADRATURE = {1: np.array([1, 1]) / 2, 2: np.array([1, 4, 1]) / 6}
_TO_BERNSTEIN = {1: np.eye(2), 2: np.array([[1, 0, 0], [-0.5, 2, -0.5], [0, 0, 1]])}


class FunctionSpace(NamedTuple):
    """A finite-element space: polynomials of degree 1 or 2 along each axis in each cell of a mesh.

    The functions are continuous across faces between cells that are not blocked.
    """

    mesh: Mesh
    degree: int
    lattice: Float[np.ndarray, "nodes dim"]  # the nodes of a cell, from 0 to 1 along each axis
    values: csr_array  # maps dofs to values at all nodes, `cell * nodes_of_cell + node`; 0 in blocked cells
    points: Float[np.ndarray, "dofs dim"]  # fractions of the domain
    node_of: Int[np.ndarray, " dofs"]  # a node of each degree of freedom, numbered like the rows of `values`

    def interpolation(self, cell: Int[np.ndarray, " n"], t: Float[np.ndarray, "n dim"]) -> csr_array:
        """Return the sparse matrix that maps degrees of freedom to values at points, one row for each point.

        Point ``i`` has the local coordinates ``t[i]``, from 0 to 1, in cell ``cell[i]``.
        """
        return csr_array(_interpolation(self.degree, cell, t, len(self.mesh.state) * len(self.lattice)) @ self.values)

    def gradients(self, scale: Float[np.ndarray, " dim"]) -> list[csr_array]:
        """Return, for each axis, the matrix from degrees of freedom to Bernstein coefficients of the derivative.

        The derivative along an axis is divided by the axis's ``scale``. The matrix has one row for each control point
        of each open cell (a cell that is not blocked), cell by cell.
        """
        # 1. The values at the nodes of open cells, and the widths of these cells.
        mesh, degree, size = self.mesh, self.degree, len(self.lattice)
        values = csr_array(self.values[_nodes_of_cells(mesh.open_cells, size)])
        width = mesh.widths[mesh.open_cells] * scale
        # 2. Along the axis of the derivative, for degree n and the Bernstein coefficients c_0 to c_n of the function:
        #      d_i = n * (c_(i+1) - c_i)                      coefficients of the derivative, of degree n - 1
        #      e_i = i / n * d_(i-1) + (1 - i / n) * d_i      the same function with degree n, as along other axes
        #    The matrix from a cell's nodes to its control points is the Kronecker product of matrices of all axes.
        difference = degree * (np.eye(degree + 1)[1:] - np.eye(degree + 1)[:-1])
        weight = np.arange(degree + 1)[:, None] / degree
        raised = weight * np.eye(degree + 1, degree, -1) + (1 - weight) * np.eye(degree + 1, degree)
        derivative = raised @ difference @ _TO_BERNSTEIN[degree]
        operators = []
        for axis in range(mesh.dim):
            control = reduce(np.kron, [derivative if k == axis else _TO_BERNSTEIN[degree] for k in range(mesh.dim)])
            local = kron(eye_array(len(width)), control, "csr")  # a block for each cell
            local.data /= np.repeat(width[:, axis], np.count_nonzero(control))
            operators.append(csr_array(local @ values))
        return operators

    def basis_integrals(self) -> Float[np.ndarray, " dofs"]:
        """Return the integral of each degree of freedom's basis function over the open cells of the mesh.

        The trapezoidal rule is exact for degree 1, Simpson's rule for degree 2.
        """
        cells = self.mesh.open_cells
        quadrature = reduce(np.multiply.outer, [_QUADRATURE[self.degree]] * self.mesh.dim).ravel()
        weights = self.mesh.volumes[cells, None] * quadrature
        return np.asarray(self.values[_nodes_of_cells(cells, len(quadrature))].T @ weights.ravel())


def basis(degree: int, t: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n nodes"]:
    """Evaluate the Lagrange basis functions of a cell, of degree 1 or 2, at points with local coordinates ``t``.

    Local coordinates run from 0 to 1 along each axis of the cell.
    """
    if degree == 1:
        along = np.stack([1 - t, t], axis=-1)
    else:
        along = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)
    # The products over axes, in the order of nodes: the last axis changes fastest.
    result = along[:, 0]
    for of_axis in along.transpose(1, 0, 2)[1:]:
        result = (result[:, :, None] * of_axis[:, None]).reshape(len(t), result.shape[1] * of_axis.shape[1])
    return result


def to_bernstein(degree: int, dim: int) -> Float[np.ndarray, "nodes nodes"]:
    """Return the matrix from a polynomial's values at a cell's equally spaced nodes to its Bernstein coefficients."""
    return reduce(np.kron, [_TO_BERNSTEIN[degree]] * dim)


def function_space(mesh: Mesh, degree: int) -> FunctionSpace:
    """Build the finite-element space of ``degree`` 1 or 2 on a mesh (see :class:`FunctionSpace`)."""
    lattice = np.array(list(product(np.arange(degree + 1) / degree, repeat=mesh.dim)))
    size, num_nodes = len(lattice), len(mesh.state) * len(lattice)
    # 1. Compare the nodes of each two cells that share an open face. `nodes_in_faces` returns points of the shared
    #    part of the face, with all nodes of both cells there, and their local coordinates `t` in both cells `cell`.
    #    Index 0 on the first axis of both is for the cell below the face, index 1 for the cell above it. A point is
    #    a) a node of both cells: the two nodes are one (`twins`);
    #    b) a node of one cell only: this node hangs on the other cell. `hanging` has such nodes, `on_cell` the other
    #       cells, and `at` the local coordinates of the nodes in them;
    #    c) a node of neither cell, such as a corner (x) of the part that cells long along different axes share:
    #       `crossing` has both cells, and `places` the local coordinates of the point in both.
    #       o------o
    #       | b    |          A face of cell a (wide) and a face of cell b (high) lie in one plane.
    #   o---x------x---o
    #   | a |      |   |
    #   o---x------x---o
    #       o------o
    stride = (degree + 1) ** np.arange(mesh.dim)[::-1]  # from the place of a node in the lattice to its index
    twins, hangers, crossings = [], [], []
    for axis in range(mesh.dim):
        cell, t = nodes_in_faces(mesh.cells, mesh.open_faces, axis, lattice)
        is_node = np.all(t * degree == np.rint(t * degree), axis=2)
        node = cell * size + np.rint(t * degree).astype(int) @ stride
        hangs, is_crossing = is_node & ~is_node[::-1], ~is_node.any(axis=0)
        twins.append(node[:, is_node.all(axis=0)])
        hangers.append((node[hangs], cell[::-1][hangs], t[::-1][hangs]))
        crossings.append((cell[:, is_crossing], t[:, is_crossing]))
    hanging, on_cell, at = (np.concatenate(rows) for rows in zip(*hangers, strict=True))
    crossing, places = (np.concatenate(columns, axis=1) for columns in zip(*crossings, strict=True))
    # 2. Number groups of nodes that are one, and express hanging groups by free ones: a hanging group's value is the
    #    sum over the cell's nodes of the basis function at its place times the value of the node's group. Groups are
    #    replaced until only free ones remain: row i of `resolved` has their weights in the value of group i.
    group = connected_groups(num_nodes, np.concatenate(twins, axis=1))
    num_groups = int(group.max()) + 1
    of_hanging, first = np.unique(group[hanging], return_index=True)
    entries = np.repeat(of_hanging, size), group[_nodes_of_cells(on_cell[first], size)]
    sums = csr_array((basis(degree, at[first]).ravel(), entries), (num_groups, num_groups))
    resolved = resolve_constraints(sums, of_hanging)
    # 3. A node may hang on two cells, and a corner of a face may be a node of neither cell. The polynomials of both
    #    cells must agree there, a linear equation between values of free groups. Each equation is solved for a group
    #    with a node in the smallest cell (the deepest one), which is then no longer free.
    repeated = np.setdiff1d(np.arange(len(hanging)), first)
    if mesh.dim > 2 and len(repeated) + crossing.shape[1]:
        cell, node = np.divmod(hanging[repeated], size)
        in_one = np.append(cell, crossing[0]), np.append(lattice[node], places[0], axis=0)
        in_other = np.append(on_cell[repeated], crossing[1]), np.append(at[repeated], places[1], axis=0)
        of_group = csr_array((np.ones(num_nodes), (np.arange(num_nodes), group)), (num_nodes, num_groups))
        change = _interpolation(degree, *in_one, num_nodes) - _interpolation(degree, *in_other, num_nodes)
        depth = np.zeros(num_groups, np.int64)
        np.maximum.at(depth, group, np.repeat(mesh.cells.depth.sum(axis=1), size))
        rows = csr_array(change @ of_group @ resolved)
        resolved = csr_array(resolved @ eliminate_constraints(rows, depth, _MOST_WEIGHTS_OF_NODE * num_groups))
    # 4. The degrees of freedom are the free groups that have a node in an open cell.
    of_open = _nodes_of_cells(mesh.open_cells, size)
    node_of = np.full(num_groups, -1)
    node_of[group[of_open]] = of_open
    dofs = np.flatnonzero((node_of >= 0) & (resolved.diagonal() == 1))
    node_of = node_of[dofs]
    points = mesh.fractions(node_of // size, lattice[node_of % size])
    return FunctionSpace(mesh, degree, lattice, csr_array(resolved[group][:, dofs]), points, node_of)


def _nodes_of_cells(cells: Int[np.ndarray, " n"], size: int) -> Int[np.ndarray, " nodes"]:
    # The nodes of cells, numbered `cell * size + node of the cell`.
    return (cells[:, None] * size + np.arange(size)).ravel()


def _interpolation(degree: int, cell: Int[np.ndarray, " n"], t: Float[np.ndarray, "n dim"], nodes: int) -> csr_array:
    # The matrix from values at all nodes (as many as `nodes`) to values at the points `t` of cells.
    weight = basis(degree, t)
    num, size = weight.shape
    return csr_array((weight.ravel(), (np.repeat(np.arange(num), size), _nodes_of_cells(cell, size))), (num, nodes))


def rescaling_of(lowest: Numbers, highest: Numbers, factor: Numbers) -> Curve:
    """Return the breakpoints and the values of a piecewise linear function ``g`` such that ``g(u)`` is not too steep.

    In cell ``i``, a function ``u`` has values from ``lowest[i]`` to ``highest[i]``, and its slope is up to
    ``factor[i]`` times the slope allowed there. So ``g`` has slopes of at most ``1 / factor[i]`` between these two
    values, and of at most 1 everywhere. Also, ``g(0)`` is 0.
    """
    # Between neighbor levels, g has the slope 1 / max(1, factors of all cells whose values include this interval). By
    # the chain rule, the slope of g(u) in a cell is the slope of g times the slope of u, so at most the allowed one.
    # 1. The levels: where the values of cells that are too steep begin and end.
    too_steep = np.argsort(factor, kind="stable")
    too_steep = too_steep[factor[too_steep] > 1]
    level = np.unique(np.concatenate([lowest[too_steep], highest[too_steep], [lowest.min(), 0.0, highest.max()]]))
    # 2. The largest factor between neighbor levels: cells come by ascending factor, so the last one to write has it.
    largest = np.ones(len(level) - 1)
    first, last = np.searchsorted(level, lowest), np.searchsorted(level, highest)
    for cell in too_steep.tolist():
        largest[first[cell] : last[cell]] = factor[cell]
    # 3. The sum of slope times length, with g(0) = 0.
    value = np.append(0.0, np.cumsum(np.diff(level) / largest))
    return level, value - np.interp(0.0, level, value)
