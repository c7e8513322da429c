from itertools import product

import numpy as np
import pytest
from eikonal_helpers import mesh_of, random_mesh

from plr_jax.eikonal.elements import basis, function_space, to_bernstein
from plr_jax.geometry.box import Box
from plr_jax.plr.leaf_faces import face_points
from plr_jax.plr.tree import Cells
from plr_jax.spaces import CellState

of_any_dimension = pytest.mark.parametrize(("dim", "degree"), list(product((1, 2, 3), (1, 2))))
ROUNDS = (0, 5, 4, 2)  # by dimension


def random_function(mesh, degree, seed=0):
    """Return a space, a random function of it, and its values at the nodes of each cell."""
    space = function_space(mesh, degree)
    dofs = np.random.default_rng(seed).normal(size=len(space.points))
    return space, dofs, (space.values @ dofs).reshape(len(mesh.state), -1)


def values(degree, nodal, cell, t):
    return np.sum(basis(degree, t) * nodal[cell], axis=1)


def check_continuous(mesh, degree, seed):
    """Check at random points of open faces that a random function has the same value on both sides."""
    _, _, nodal = random_function(mesh, degree, seed)
    w = np.random.default_rng(1).random((6, mesh.dim))
    x = face_points(mesh.cells, mesh.open_faces, w)
    sides = []
    for cell, end in ((mesh.open_faces.lower, 1.0), (mesh.open_faces.upper, 0.0)):
        t = mesh.local(np.broadcast_to(cell[:, None], x.shape[:2]), x)
        t[np.arange(len(cell)), :, mesh.open_faces.axis] = end
        sides.append(values(degree, nodal, np.repeat(cell, len(w)), t.reshape(-1, mesh.dim)))
    np.testing.assert_allclose(*sides, rtol=0, atol=1e-12)
    assert (nodal[mesh.state == CellState.BLOCKED] == 0).all()


@of_any_dimension
def test_functions_are_continuous_across_open_faces(dim, degree):
    for seed, periodic in product(range(3), (None, [True] * dim)):
        mesh = random_mesh(seed, dim, rounds=ROUNDS[dim], blocked=(0.0, 0.3, 0.6)[seed], periodic=periodic)
        check_continuous(mesh, degree, seed)


def test_nodes_that_hang_on_two_cells_agree_with_both():
    """Two large cells touch along an edge; small ones between them reach both, and a blocked one parts them."""
    for seed in range(20):
        check_continuous(random_mesh(seed, 3, rounds=2, blocked=0.5), 1, seed)


def test_functions_jump_only_across_blocked_cells():
    mesh = random_mesh(3, 2, rounds=4, blocked=0.7)
    parts = mesh, mesh.with_state(np.where(mesh.connected_to(0), mesh.state, np.int8(CellState.BLOCKED)))
    assert len(function_space(parts[0], 2).points) > len(function_space(parts[1], 2).points)
    row = mesh_of(Box([0], [1]), Cells(np.full((4, 1), 2), np.arange(4)[:, None]), np.int8([1, 0, 1, 1]))
    np.testing.assert_array_equal(np.sort(function_space(row, 1).points[:, 0]), [0, 0.25, 0.5, 0.75, 1])


@of_any_dimension
def test_space_contains_polynomials_of_its_degree(dim, degree):
    mesh, rng = random_mesh(5, dim, rounds=ROUNDS[dim], blocked=0.2), np.random.default_rng(2)
    space, powers = function_space(mesh, degree), np.array(list(product(range(degree + 1), repeat=dim)))
    weights = rng.normal(size=len(powers))
    cell, t = rng.choice(mesh.open_cells, 200), rng.random((200, dim))
    values, expected = (np.prod(x[:, None] ** powers, 2) @ weights for x in (space.points, mesh.fractions(cell, t)))
    np.testing.assert_allclose(space.interpolation(cell, t) @ values, expected, atol=1e-12)


@of_any_dimension
def test_control_vectors_enclose_the_gradient(dim, degree):
    mesh = random_mesh(7, dim, rounds=2, blocked=0.2)
    space, dofs, nodal = random_function(mesh, degree)
    scale = np.array([1.0, 2.0, 0.5])[:dim]
    t, step = np.random.default_rng(0).uniform(0.01, 0.99, (40, dim)), 1e-6
    for axis, operator in enumerate(space.gradients(scale)):
        control = (operator @ dofs).reshape(len(mesh.open_cells), -1)
        for cell, bounds in zip(mesh.open_cells, control, strict=True):
            each, move = np.full(len(t), cell), step * np.eye(dim)[axis]
            rise = values(degree, nodal, each, t + move) - values(degree, nodal, each, t - move)
            slope, rounding = rise / (2 * step * mesh.widths[cell, axis] * scale[axis]), 1e-6 * np.abs(bounds).max()
            # The control values are those of a Bernstein polynomial, the derivative, which is within their hull.
            from_control = basis(degree, t) @ np.linalg.solve(to_bernstein(degree, dim), bounds)
            np.testing.assert_allclose(from_control, slope, rtol=1e-6, atol=rounding)
            assert bounds.min() - rounding <= slope.min() and slope.max() <= bounds.max() + rounding


@of_any_dimension
def test_basis_integrals_equal_quadrature(dim, degree):
    mesh = random_mesh(9, dim, rounds=2, blocked=0.3)
    space, dofs, nodal = random_function(mesh, degree)
    node, weight = np.polynomial.legendre.leggauss(3)
    t = np.array(list(product((node + 1) / 2, repeat=dim)))
    share = np.prod(list(product(weight / 2, repeat=dim)), axis=1)
    expected = sum(mesh.volumes[c] * share @ values(degree, nodal, np.full(len(t), c), t) for c in mesh.open_cells)
    np.testing.assert_allclose(space.basis_integrals() @ dofs, expected, rtol=1e-12)
    np.testing.assert_allclose(space.basis_integrals().sum(), mesh.volumes[mesh.open_cells].sum(), rtol=1e-12)


def test_degrees_of_freedom_are_values_at_their_points():
    single = mesh_of(Box([0, 0], [1, 2]), Cells.root(2), np.int8([CellState.FREE]))
    for mesh in (random_mesh(11, 2, rounds=4, blocked=0.3), single):
        space = function_space(mesh, 2)
        np.testing.assert_array_equal(space.values[space.node_of].toarray(), np.eye(len(space.points)))
    assert len(space.points) == 9
