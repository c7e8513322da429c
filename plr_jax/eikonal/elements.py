"""Finite elements of degree 1 or 2 that are continuous across faces between cells that are not blocked.

A node on a face of a larger cell that has no node there *hangs*: it takes the value of the larger cell's polynomial.
The other nodes are degrees of freedom. Bernstein coefficients of the gradient (control vectors) enclose the gradient.
"""

from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from plr_jax.eikonal.mesh import Mesh
from plr_jax.plr.leaf_faces import eliminate_constraints, face_points, resolve_constraints

_MOST_WEIGHTS_OF_NODE = 2**8  # in the equations of nodes that hang on several cells
_QUADRATURE = {1: np.array([1, 1]) / 2, 2: np.array([1, 4, 1]) / 6}
_TO_BERNSTEIN = {1: np.eye(2), 2: np.array([[1, 0, 0], [-0.5, 2, -0.5], [0, 0, 1]])}


@dataclass(frozen=True, eq=False)
class FunctionSpace:
    """A finite-element space: polynomials of degree 1 or 2 in each mesh cell, continuous between unblocked cells."""

    mesh: Mesh
    degree: int
    lattice: Float[np.ndarray, "nodes dim"]  # the nodes of a cell, from 0 to 1 along each axis
    values: csr_array  # maps dofs to values at all nodes, `cell * nodes_of_cell + node`; 0 in blocked cells
    points: Float[np.ndarray, "dofs dim"]  # fractions of the domain
    node_of: Int[np.ndarray, " dofs"]  # a node of each degree of freedom, numbered like the rows of `values`

    def interpolation(self, cell: Int[np.ndarray, " n"], t: Float[np.ndarray, "n dim"]) -> csr_array:
        """Return the matrix from degrees of freedom to values at points of cells; ``t`` is from 0 to 1 in a cell."""
        return csr_array(_interpolation(self.degree, cell, t, len(self.mesh.state) * len(self.lattice)) @ self.values)

    def gradients(self, scale: Float[np.ndarray, " dim"]) -> list[csr_array]:
        # By axis, the matrix from degrees of freedom to Bernstein coefficients of the derivative, divided by `scale`.
        # Rows are `number * nodes_of_cell + control point` for the cells that are not blocked.
        mesh, degree, size = self.mesh, self.degree, len(self.lattice)
        rows = (mesh.open_cells[:, None] * size + np.arange(size)).ravel()
        values, width = csr_array(self.values[rows]), mesh.widths[mesh.open_cells] * scale
        # Along the axis of the derivative, for degree n and the Bernstein coefficients c_0 to c_n of the function:
        #   d_i = n * (c_(i+1) - c_i)                      coefficients of the derivative, of degree n - 1
        #   e_i = i / n * d_(i-1) + (1 - i / n) * d_i      the same function with degree n, as along other axes
        # The matrix from a cell's nodes to its control points is the Kronecker product of matrices of all axes.
        difference = degree * (np.eye(degree + 1)[1:] - np.eye(degree + 1)[:-1])
        weight = np.arange(degree + 1)[:, None] / degree
        raised = weight * np.eye(degree + 1, degree, -1) + (1 - weight) * np.eye(degree + 1, degree)
        along, operators = raised @ difference @ _TO_BERNSTEIN[degree], []
        for axis in range(mesh.dim):
            control = reduce(np.kron, [along if k == axis else _TO_BERNSTEIN[degree] for k in range(mesh.dim)])
            num, (i, j) = len(width), np.nonzero(control)
            entries = control[i, j] / width[:, axis, None]
            first = np.arange(num)[:, None] * size
            local = csr_array((entries.ravel(), ((first + i).ravel(), (first + j).ravel())), (num * size, num * size))
            operators.append(csr_array(local @ values))
        return operators

    def basis_integrals(self) -> Float[np.ndarray, " dofs"]:
        """Return the integral of each degree of freedom's basis function over the open cells of the mesh.

        The trapezoidal rule is exact for degree 1, Simpson's rule for degree 2.
        """
        mesh = self.mesh
        quadrature = reduce(np.multiply.outer, [_QUADRATURE[self.degree]] * mesh.dim).ravel()
        weights = mesh.volumes[mesh.open_cells, None] * quadrature
        rows = (mesh.open_cells[:, None] * len(quadrature) + np.arange(len(quadrature))).ravel()
        return np.asarray(self.values[rows].T @ weights.ravel())


def basis(degree: int, t: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n nodes"]:
    """Evaluate a cell's Lagrange basis functions, of degree 1 or 2, at points with coordinates ``t`` from 0 to 1."""
    if degree == 1:
        along = np.stack([1 - t, t], axis=-1)
    else:
        along = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)
    result = along[:, 0]
    for of_axis in along.transpose(1, 0, 2)[1:]:
        result = (result[:, :, None] * of_axis[:, None]).reshape(len(t), result.shape[1] * of_axis.shape[1])
    return result


def to_bernstein(degree: int, dim: int) -> Float[np.ndarray, "nodes nodes"]:
    """Return the matrix from a polynomial's values at a cell's equally spaced nodes to its Bernstein coefficients."""
    return reduce(np.kron, [_TO_BERNSTEIN[degree]] * dim)


def function_space(mesh: Mesh, degree: int) -> FunctionSpace:
    """Build the space of functions of ``degree`` 1 or 2 that are continuous between the unblocked cells of a mesh."""
    lattice = np.array(list(product(np.arange(degree + 1) / degree, repeat=mesh.dim)))
    size, num_nodes = len(lattice), len(mesh.state) * len(lattice)
    # 1. Find nodes that are one with a node of another cell, and nodes that hang on a cell, with their place in it.
    place = (degree + 1) ** np.arange(mesh.dim)[::-1]
    same, hanging, on_cell, at, crossing, places = [], [], [], [], [], []
    for axis in range(mesh.dim):
        faces = mesh.open_faces[mesh.open_faces.axis == axis]
        for cell, other, end in ((faces.lower, faces.upper, 1), (faces.upper, faces.lower, 0)):
            on_face = np.flatnonzero(lattice[:, axis] == end)
            t = mesh.local(other[:, None], mesh.fractions(cell[:, None], lattice[on_face]))
            t[:, :, axis] = 1 - end  # across a seam too
            face, index = np.nonzero(np.all((t >= 0) & (t <= 1), axis=2))
            node, where = cell[face] * size + on_face[index], t[face, index]
            is_node = np.all(where * degree == np.rint(where * degree), axis=1)
            twin = other[face] * size + np.rint(where * degree).astype(int) @ place
            same.append(np.stack([node, twin])[:, is_node])
            hanging.append(node[~is_node])
            on_cell.append(other[face[~is_node]])
            at.append(where[~is_node])
        # If cells are long along different axes, a corner of their shared face may be a node of neither.
        depth = mesh.cells.depth[faces.lower] - mesh.cells.depth[faces.upper]
        depth[:, axis] = 0
        faces = faces[(depth.min(axis=1) < 0) & (depth.max(axis=1) > 0)]
        x = face_points(mesh.cells, faces, lattice[lattice[:, axis] == 0])
        pair = np.repeat(np.stack([faces.lower, faces.upper]), x.shape[1], axis=1)
        t = mesh.local(pair, x.reshape(1, -1, mesh.dim))
        t[:, :, axis] = [[1.0], [0.0]]
        is_node = (t * degree == np.rint(t * degree)).all(axis=2).any(axis=0)
        crossing.append(pair[:, ~is_node])
        places.append(t[:, ~is_node])
    same, crossing, places = (np.concatenate(part, axis=1) for part in (same, crossing, places))
    hanging, on_cell, at = (np.concatenate(part) for part in (hanging, on_cell, at))
    # 2. Number groups of nodes that are one, and express hanging groups by free ones: a hanging group's value is the
    #    sum over the cell's nodes of the basis function at its place times the value of the node's group. Groups are
    #    replaced until only free ones remain: row i of `resolved` has their weights in the value of group i.
    tied = coo_array((np.ones(same.shape[1], bool), tuple(same)), (num_nodes, num_nodes))
    num_groups, group = connected_components(tied, directed=False)
    of_hanging, first = np.unique(group[hanging], return_index=True)
    where = np.repeat(of_hanging, size), group[on_cell[first, None] * size + np.arange(size)].ravel()
    is_free = np.ones(num_groups)
    is_free[of_hanging] = 0
    resolved = resolve_constraints(
        csr_array((basis(degree, at[first]).ravel(), where), (num_groups, num_groups)), is_free
    )
    # 3. A node may hang on two cells: their polynomials must agree there, a linear equation between values of free
    #    groups. Each equation is solved for a group with a node in the smallest cell, which is then no longer free.
    repeated = np.setdiff1d(np.arange(len(hanging)), first)
    if mesh.dim > 2 and len(repeated) + crossing.shape[1]:
        cell, node = np.divmod(hanging[repeated], size)
        here = np.append(cell, crossing[0]), np.append(lattice[node], places[0], axis=0)
        there = np.append(on_cell[repeated], crossing[1]), np.append(at[repeated], places[1], axis=0)
        of_group = csr_array((np.ones(num_nodes), (np.arange(num_nodes), group)), (num_nodes, num_groups))
        change = _interpolation(degree, *here, num_nodes) - _interpolation(degree, *there, num_nodes)
        depth = np.zeros(num_groups, np.int64)
        np.maximum.at(depth, group, np.repeat(mesh.cells.depth.sum(axis=1), size))
        rows = csr_array(change @ of_group @ resolved)
        resolved = csr_array(resolved @ eliminate_constraints(rows, depth, _MOST_WEIGHTS_OF_NODE * num_groups))
    # 4. The degrees of freedom are the free groups that have a node in an open cell.
    of_open = (mesh.open_cells[:, None] * size + np.arange(size)).ravel()
    node_of = np.full(num_groups, -1)
    node_of[group[of_open]] = of_open
    dofs = np.flatnonzero((node_of >= 0) & (resolved.diagonal() == 1))
    node_of = node_of[dofs]
    points = mesh.fractions(node_of // size, lattice[node_of % size])
    return FunctionSpace(mesh, degree, lattice, csr_array(resolved[group][:, dofs]), points, node_of)


def _interpolation(degree: int, cell: Int[np.ndarray, " n"], t: Float[np.ndarray, "n dim"], nodes: int) -> csr_array:
    weight = basis(degree, t)
    num, size = weight.shape
    columns = (cell[:, None] * size + np.arange(size)).ravel()
    return csr_array((weight.ravel(), (np.repeat(np.arange(num), size), columns)), (num, nodes))
