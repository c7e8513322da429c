"""Finite elements: functions that are polynomials in every cell of a mesh and continuous across its open faces.

A cell holds the values at a lattice of nodes, ``degree + 1`` along every axis. Nodes of two cells at one point of an
open face are one; a node that lies on a face of a larger cell, but at no node of it, *hangs* there and takes its
value. The other nodes are the degrees of freedom. The gradient is a polynomial too: in Bernstein's form its control
vectors enclose it, so that what holds for all of them, if it is convex, holds everywhere in the cell.
"""

from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from plr_jax.eikonal.mesh import Mesh
from plr_jax.plr.partition.faces import eliminated, face_points, resolve


class _Ties(NamedTuple):
    """What makes functions continuous across faces.

    Attributes:
        same: Nodes that are one with a node of another cell.
        hanging: Nodes that lie elsewhere on another cell's face.
        on_cell: That cell.
        at: Where in it, from 0 to 1.
        crossing: Two cells that are long along different axes, so that a function on what they have in common of a
            face has a node that is a node of neither.
        places: Where that is in both.
    """

    same: Int[np.ndarray, "2 pairs"]
    hanging: Int[np.ndarray, "m"]
    on_cell: Int[np.ndarray, "m"]
    at: Float[np.ndarray, "m dim"]
    crossing: Int[np.ndarray, "2 k"]
    places: Float[np.ndarray, "2 k dim"]


@dataclass(frozen=True, eq=False)
class FunctionSpace:
    """The continuous piecewise polynomials of a degree, 1 or 2 along every axis, on a mesh.

    Attributes:
        mesh: The cells.
        degree: Of the polynomials along each axis.
        values: Maps degrees of freedom to values at all nodes, numbered ``cell * nodes_of_cell + node``; 0 in blocked
            cells.
        points: Where each degree of freedom is, as a fraction of the domain.
        node_of: A node that is this degree of freedom.
    """

    mesh: Mesh
    degree: int
    values: csr_array
    points: Float[np.ndarray, "dofs dim"]
    node_of: Int[np.ndarray, "dofs"]

    @property
    def lattice(self) -> Float[np.ndarray, "nodes dim"]:
        """The nodes of a cell, from 0 to 1 along each axis."""
        return _lattice(self.degree, self.mesh.dim)

    def interpolation(self, cell: Int[np.ndarray, "n"], t: Float[np.ndarray, "n dim"]) -> csr_array:
        """Maps degrees of freedom to values at points ``t``, from 0 to 1, of cells."""
        weight = basis(self.degree, t)
        num, size = weight.shape
        columns = (cell[:, None] * size + np.arange(size)).ravel()
        shape = (num, len(self.mesh.state) * size)
        rows = csr_array((weight.ravel(), (np.repeat(np.arange(num), size), columns)), shape)
        return csr_array(rows @ self.values)

    def gradients(self, scale: Float[np.ndarray, "dim"]) -> list[csr_array]:
        """Maps degrees of freedom to control values of each partial derivative over the mesh's open cells.

        Rows are numbered ``open cell * nodes_of_cell + control point``; derivatives are by coordinates times a scale.
        """
        mesh, size = self.mesh, len(self.lattice)
        rows = (mesh.open_cells[:, None] * size + np.arange(size)).ravel()
        values, width = csr_array(self.values[rows]), mesh.widths[mesh.open_cells] * scale
        operators = []
        for axis in range(mesh.dim):
            # Maps values at nodes to control values of a partial derivative, its degree raised to that of the others.
            degree = self.degree
            difference = degree * (np.eye(degree + 1)[1:] - np.eye(degree + 1)[:-1])
            share = np.arange(degree + 1)[:, None] / degree
            raised = share * np.eye(degree + 1, degree, -1) + (1 - share) * np.eye(degree + 1, degree)
            along = raised @ difference @ _TO_BERNSTEIN[degree]
            control = reduce(np.kron, [along if each == axis else _TO_BERNSTEIN[degree] for each in range(mesh.dim)])
            num, (i, j) = len(width), np.nonzero(control)
            entries = control[i, j] / width[:, axis, None]
            first = np.arange(num)[:, None] * size
            local = csr_array((entries.ravel(), ((first + i).ravel(), (first + j).ravel())), (num * size, num * size))
            operators.append(csr_array(local @ values))
        return operators

    def integrals(self) -> Float[np.ndarray, "dofs"]:
        """The integral over all open cells of each degree of freedom's basis function."""
        mesh = self.mesh
        share = reduce(np.multiply.outer, [_QUADRATURE[self.degree]] * mesh.dim).ravel()
        weights = mesh.volumes[mesh.open_cells, None] * share
        rows = (mesh.open_cells[:, None] * len(share) + np.arange(len(share))).ravel()
        return np.asarray(self.values[rows].T @ weights.ravel())


_MOST_WEIGHTS_OF_NODE = 2**8  # in the equations of nodes that hang on several cells
_QUADRATURE = {1: np.array([1, 1]) / 2, 2: np.array([1, 4, 1]) / 6}
_TO_BERNSTEIN = {1: np.eye(2), 2: np.array([[1, 0, 0], [-0.5, 2, -0.5], [0, 0, 1]])}


def basis(degree: int, t: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n nodes"]:
    """What the nodes' basis functions are at points from 0 to 1 of a cell."""
    if degree == 1:
        along = np.stack([1 - t, t], axis=-1)
    else:
        along = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)
    return reduce(_products, along.transpose(1, 0, 2))


def _products(a: Float[np.ndarray, "n i"], b: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n ij"]:
    """All products of two rows' numbers, row by row."""
    return (a[:, :, None] * b[:, None]).reshape(len(a), a.shape[1] * b.shape[1])


def to_bernstein(degree: int, dim: int) -> Float[np.ndarray, "nodes nodes"]:
    """Maps values at the nodes of a cell to the control values of the polynomial."""
    return reduce(np.kron, [_TO_BERNSTEIN[degree]] * dim)


def function_space(mesh: Mesh, degree: int) -> FunctionSpace:
    """The continuous functions on a mesh."""
    lattice = _lattice(degree, mesh.dim)
    ties, num_nodes = _ties(mesh, degree, lattice), len(mesh.state) * len(lattice)
    tied = coo_array((np.ones(ties.same.shape[1], bool), tuple(ties.same)), (num_nodes, num_nodes))
    num_groups, group = connected_components(tied, directed=False)
    resolved = _resolved(mesh, degree, ties, group, num_groups)
    of_open = (mesh.open_cells[:, None] * len(lattice) + np.arange(len(lattice))).ravel()
    node_of = np.full(num_groups, -1)
    node_of[group[of_open]] = of_open
    dofs = np.flatnonzero((node_of >= 0) & (resolved.diagonal() == 1))
    node_of = node_of[dofs]
    points = mesh.fractions(node_of // len(lattice), lattice[node_of % len(lattice)])
    return FunctionSpace(mesh, degree, csr_array(resolved[group][:, dofs]), points, node_of)


def _resolved(
    mesh: Mesh, degree: int, ties: _Ties, group: Int[np.ndarray, "all_nodes"], num_groups: int
) -> csr_array:
    """What the values of groups of nodes are made of: those of groups that are free."""
    hanging, first = np.unique(group[ties.hanging], return_index=True)
    size, shape = (degree + 1) ** mesh.dim, (num_groups, num_groups)
    on = group[ties.on_cell[:, None] * size + np.arange(size)]
    weight = basis(degree, ties.at)
    where = np.repeat(hanging, size), on[first].ravel()
    is_free = np.ones(num_groups)
    is_free[hanging] = 0
    resolved = resolve(csr_array((weight[first].ravel(), where), shape), is_free)
    if mesh.dim <= 2:
        return resolved
    # Between blocked cells a node may hang on two cells of which neither implies the other, and where cells that are
    # long along different axes meet, a corner of what they have in common is a node of neither.
    again = np.setdiff1d(np.arange(len(on)), first)
    cell, node = np.divmod(ties.hanging[again], size)
    here = np.append(cell, ties.crossing[0]), np.append(_lattice(degree, mesh.dim)[node], ties.places[0], axis=0)
    there = np.append(ties.on_cell[again], ties.crossing[1]), np.append(ties.at[again], ties.places[1], axis=0)
    if not len(here[0]):
        return resolved
    values = []
    for cells, t in (here, there):
        where = np.repeat(np.arange(len(t)), size), group[cells[:, None] * size + np.arange(size)].ravel()
        values.append(csr_array((basis(degree, t).ravel(), where), (len(t), num_groups)))
    depth = np.zeros(num_groups, np.int64)
    np.maximum.at(depth, group, np.repeat(mesh.cells.depth.sum(axis=1), size))
    rows = csr_array((values[0] - values[1]) @ resolved)
    return csr_array(resolved @ eliminated(rows, depth, _MOST_WEIGHTS_OF_NODE * num_groups))


def _lattice(degree: int, dim: int) -> Float[np.ndarray, "nodes dim"]:
    return np.array(list(product(np.arange(degree + 1) / degree, repeat=dim)))


def _ties(mesh: Mesh, degree: int, lattice: Float[np.ndarray, "nodes dim"]) -> _Ties:
    place = (degree + 1) ** np.arange(mesh.dim)[::-1]
    same, hanging, on_cell, at, crossing, places = [], [], [], [], [], []
    for axis in range(mesh.dim):
        faces = mesh.faces[mesh.faces.axis == axis]
        for cell, other, end in ((faces.lower, faces.upper, 1), (faces.upper, faces.lower, 0)):
            on_face = np.flatnonzero(lattice[:, axis] == end)
            t = mesh.local(other[:, None], mesh.fractions(cell[:, None], lattice[on_face]))
            t[:, :, axis] = 1 - end  # across the seam of a periodic axis too
            face, index = np.nonzero(np.all((t >= 0) & (t <= 1), axis=2))
            node, where = cell[face] * len(lattice) + on_face[index], t[face, index]
            is_node = np.all(where * degree == np.rint(where * degree), axis=1)
            twin = other[face] * len(lattice) + np.rint(where * degree).astype(int) @ place
            same.append(np.stack([node, twin])[:, is_node])
            hanging.append(node[~is_node])
            on_cell.append(other[face[~is_node]])
            at.append(where[~is_node])
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
    ends = (np.concatenate(part, axis=1) for part in (crossing, places))
    return _Ties(np.concatenate(same, axis=1), *(np.concatenate(part) for part in (hanging, on_cell, at)), *ends)
