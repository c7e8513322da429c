import itertools

import networkx
import numpy as np
import pytest
from eikonal_helpers import BoxSpace, mesh_of, random_mesh

from plr_jax.eikonal.mesh import Mesh, coarse_mesh
from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import PLACING, Cells, corner_bits
from plr_jax.spaces import CellState

BLOCKED, FREE, MIXED = CellState
UNIT = Box((0, 0), (1, 1))


def locate_by_search(mesh, x):
    """The cell of each fraction of the domain: half-open boxes, of which the last ones are closed."""
    lo = np.ldexp(mesh.cells.position.astype(float), -mesh.cells.depth)
    hi = np.ldexp(mesh.cells.position + 1.0, -mesh.cells.depth)
    return [int(np.flatnonzero(np.all((lo <= p) & ((p < hi) | (hi == 1)), axis=1))[0]) for p in x]


def refined_often(space, rounds, goal=(0.3, 0.6), num_cells=16):
    """Cells that hold or touch a point are halved again and again."""
    mesh = coarse_mesh(space, np.ones(space.domain.dim), num_cells, 4096)
    for _ in range(rounds):
        lo, hi = mesh.boxes
        mesh = mesh.refined(np.flatnonzero(np.all((lo <= goal) & (goal <= hi), axis=1)), space)
    return mesh


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_points_are_located_as_by_search(dim):
    mesh = random_mesh(1, dim, rounds=(0, 6, 5, 3)[dim])
    rng = np.random.default_rng(0)
    corners = np.ldexp(mesh.cells.position.astype(float), -mesh.cells.depth)
    x = np.concatenate([rng.random((300, dim)), corners, np.eye(dim), np.ones((1, dim))])
    assert mesh.locate(x).tolist() == locate_by_search(mesh, x)


def test_points_in_tiny_cells_are_located():
    space = BoxSpace(UNIT)
    mesh = refined_often(space, 12)
    assert mesh.cells.depth.max() > 12
    rng = np.random.default_rng(0)
    x = np.clip(np.array([0.3, 0.6]) + 2.0 ** -rng.uniform(0, 14, (400, 1)) * rng.uniform(-1, 1, (400, 2)), 0, 1)
    assert mesh.locate(x).tolist() == locate_by_search(mesh, x)


def test_points_outside_are_in_the_nearest_cell():
    mesh = random_mesh(2, 2)
    outside = np.array([[-0.5, 0.3], [1.5, 0.3], [0.7, 1.01], [-1.0, 2.0]])
    np.testing.assert_array_equal(mesh.locate(outside), mesh.locate(np.clip(outside, 0, 1)))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_fractions_and_points_of_cells_are_inverse(dim):
    mesh, rng = random_mesh(3, dim), np.random.default_rng(0)
    cell, t = rng.integers(len(mesh.state), size=50), rng.random((50, dim))
    x = mesh.fractions(cell, t)
    np.testing.assert_allclose(mesh.local(cell, x), t, atol=1e-12)
    lo, hi = mesh.boxes
    np.testing.assert_allclose(mesh.domain.lo + mesh.domain.width * x, lo[cell] + t * (hi - lo)[cell], atol=1e-12)
    np.testing.assert_allclose(mesh.widths, hi - lo, rtol=1e-12)
    np.testing.assert_allclose(mesh.volumes.sum(), mesh.domain.width.prod(), rtol=1e-12)


@pytest.mark.parametrize("periodic", [None, (True, False)])
def test_cells_are_connected_through_open_faces(periodic):
    for seed in range(4):
        mesh = random_mesh(seed, 2, rounds=3, blocked=0.5, periodic=periodic)
        lo = np.ldexp(mesh.cells.position.astype(float), -mesh.cells.depth)
        hi = np.ldexp(mesh.cells.position + 1.0, -mesh.cells.depth)
        graph = networkx.Graph()
        graph.add_nodes_from(range(len(lo)))
        is_open = mesh.state != BLOCKED
        for a, b in itertools.permutations(np.flatnonzero(is_open), 2):
            for axis in range(2):
                other = 1 - axis
                touch = hi[a, axis] == lo[b, axis] or (
                    periodic is not None and periodic[axis] and hi[a, axis] == 1 and lo[b, axis] == 0
                )
                if touch and max(lo[a, other], lo[b, other]) < min(hi[a, other], hi[b, other]):
                    graph.add_edge(a, b)
        cell = int(mesh.open_cells[seed])
        assert set(np.flatnonzero(mesh.connected_to(cell))) == networkx.node_connected_component(graph, cell)


def test_closed_cells_count_as_blocked():
    mesh = random_mesh(4, 2, blocked=0.2)
    closed = np.arange(len(mesh.state)) % 3 == 0
    without = mesh.without(closed)
    assert (without.state[closed] == BLOCKED).all()
    np.testing.assert_array_equal(without.state[~closed], mesh.state[~closed])
    assert not set(without.faces.lower) & set(np.flatnonzero(closed))
    assert len(without.all_faces) == len(mesh.all_faces) == len(without.is_open_face)


def test_cells_are_what_the_space_proves():
    space = BoxSpace(Box((0, 0), (2, 1)), [(0.3, 0.2), (1.1, 0.7)], [(1.5, 0.5), (1.6, 1)])
    mesh = coarse_mesh(space, np.ones(2), 500, 4096)
    lo, hi = mesh.boxes
    share = np.array(list(itertools.product(np.linspace(0, 1, 9), repeat=2)))
    samples = lo[:, None] + share * (hi - lo)[:, None]
    free = space.is_free(samples.reshape(-1, 2)).reshape(len(lo), -1)
    assert free[mesh.state == FREE].all() and not free[mesh.state == BLOCKED].any()
    assert set(mesh.state) == set(CellState)


def test_blocked_cells_keep_queries_off_walls():
    """A cell flush with a wall holds no free point, but rounding places free points beside it in it."""
    space = BoxSpace(UNIT, [(0.25, 0.25), (0.5, 0.75)])
    mesh = coarse_mesh(space, np.ones(2), 16, 4096)
    lo, hi = mesh.boxes
    inside = np.all((lo >= (0.25, 0.25)) & (hi <= (0.5, 0.75)), axis=1)
    assert inside.sum() == 2 and (mesh.state[inside] == MIXED).all()
    for _ in range(2):
        mesh = mesh.refined(np.flatnonzero(mesh.state == MIXED), space)
    lo, hi = mesh.boxes
    within = np.all((lo > (0.25, 0.25)) & (hi < (0.5, 0.75)), axis=1)
    assert within.any() and (mesh.state[within] == BLOCKED).all()
    blocked = mesh.state == BLOCKED
    assert (lo[blocked] >= 0.25 + PLACING).all() and (hi[blocked] <= (0.5, 0.75)).all()


def test_blocked_cells_at_the_border_of_the_domain_are_blocked():
    mesh = coarse_mesh(BoxSpace(UNIT, [(0.0, 0.0), (0.6, 1.0)]), np.ones(2), 16, 4096)
    _, hi = mesh.boxes
    np.testing.assert_array_equal(mesh.state == BLOCKED, hi[:, 0] <= 0.5)


def test_grown_boxes_leave_the_domain_around_periodic_axes_alone():
    mesh = coarse_mesh(BoxSpace(Box((0, 0), (2, 1), (True, False))), np.ones(2), 16, 4096)
    (lo, hi), (grown_lo, grown_hi) = mesh.boxes, mesh.grown_boxes
    beside = PLACING * np.array([2.0, 1.0])
    np.testing.assert_allclose(grown_lo[:, 0], lo[:, 0] - beside[0], atol=1e-15)
    np.testing.assert_allclose(grown_hi[:, 0], hi[:, 0] + beside[0], atol=1e-15)
    np.testing.assert_allclose(grown_lo[:, 1], np.maximum(lo[:, 1] - beside[1], 0), atol=1e-15)
    np.testing.assert_allclose(grown_hi[:, 1], np.minimum(hi[:, 1] + beside[1], 1), atol=1e-15)


def test_refined_cells_fill_the_domain_and_are_classified_anew():
    space = BoxSpace(UNIT, [(0.3, 0.3), (0.9, 0.6)])
    coarse = coarse_mesh(space, np.ones(2), 64, 4096)
    which = np.random.default_rng(0).choice(len(coarse.state), 20, replace=False)
    fine = coarse.refined(which, space)
    assert len(fine.state) == len(coarse.state) + 3 * 20
    np.testing.assert_allclose(fine.volumes.sum(), 1, rtol=1e-12)
    lo, hi = fine.boxes
    middle = mesh_of(UNIT, fine.cells, fine.state).locate((lo + hi) / 2)
    np.testing.assert_array_equal(middle, np.arange(len(lo)))
    parent = coarse.locate((lo + hi) / 2)
    sure = coarse.state[parent] != MIXED
    np.testing.assert_array_equal(fine.state[sure], coarse.state[parent][sure])
    new = np.isin(parent, which) & ~sure
    assert set(fine.state[new]) == set(CellState)


@pytest.mark.parametrize(
    ("width", "scale", "expected"),
    [((1, 1), (1, 1), (2, 2)), ((4, 1), (1, 1), (3, 1)), ((4, 1), (1, 4), (2, 2)), ((1, 1, 8), (1, 1, 1), (1, 1, 4))],
)
def test_the_coarse_cells_are_about_cubes_by_what_motions_cost(width, scale, expected):
    space = BoxSpace(Box(np.zeros(len(width)), np.array(width, float)))
    mesh = coarse_mesh(space, np.array(scale, float), 16, 4096)
    assert (mesh.cells.depth == expected).all() and len(mesh.state) == 2 ** sum(expected)


def test_no_cell_touches_another_on_both_sides_of_a_periodic_axis():
    mesh = coarse_mesh(BoxSpace(Box((0, 0), (8, 1), (False, True))), np.ones(2), 1, 4096)
    assert (mesh.cells.depth[:, 1] >= 2).all()
    pairs = np.stack([mesh.all_faces.lower, mesh.all_faces.upper])
    assert len(np.unique(np.sort(pairs, axis=0), axis=1).T) == pairs.shape[1]


def test_one_cell_suffices_if_no_more_are_asked_for():
    mesh = coarse_mesh(BoxSpace(UNIT), np.ones(2), 0, 4096)
    assert len(mesh.state) == 1 and mesh.state[0] == FREE and len(mesh.all_faces) == 0
    cells = Cells.root(2)
    assert (mesh.cells.depth == cells.depth).all()


@pytest.mark.parametrize(("most", "expected"), [(1, (0, 0)), (2, (1, 0)), (5, (2, 0)), (8, (3, 0)), (40, (4, 1))])
def test_there_are_no_more_cells_than_allowed(most, expected):
    mesh = coarse_mesh(BoxSpace(Box((0, 0), (8, 1))), np.ones(2), 30, most)
    assert (mesh.cells.depth == expected).all()


def test_too_few_cells_for_periodic_axes_are_refused():
    space = BoxSpace(Box(np.zeros(3), np.ones(3), (True, False, True)))
    assert len(coarse_mesh(space, np.ones(3), 1, 16).state) == 16
    with pytest.raises(ValueError, match="max_leaves must be at least 16 in a domain with 2 periodic axes, got 15"):
        coarse_mesh(space, np.ones(3), 1, 15)


@pytest.mark.parametrize("periodic", [(False, False), (False, True), (True, True)])
def test_cells_share_the_nodes_at_their_corners(periodic):
    mesh = random_mesh(0, 2, rounds=3)
    mesh = Mesh(Box((0, 0), (1, 1), periodic), mesh.tree, mesh.state)
    x = mesh.fractions(np.arange(len(mesh.state))[:, None], corner_bits(2))
    np.testing.assert_array_equal(mesh.nodes[mesh.corners], np.where(periodic, x % 1.0, x))
    assert len(np.unique(mesh.nodes, axis=0)) == len(mesh.nodes)


def test_another_state_changes_all_that_is_said_of_open_cells_and_nothing_else():
    mesh = random_mesh(1, 2, rounds=3)
    _ = mesh.open_cells, mesh.is_open_face, mesh.faces, mesh.boxes, mesh.nodes, mesh.locate(mesh.nodes)
    closed = np.random.default_rng(0).random(len(mesh.state)) < 0.5
    other = mesh.without(closed)
    fresh = Mesh(mesh.domain, mesh.tree, other.state)
    np.testing.assert_array_equal(other.open_cells, np.flatnonzero(~closed & (mesh.state != BLOCKED)))
    np.testing.assert_array_equal(other.is_open_face, fresh.is_open_face)
    np.testing.assert_array_equal(other.faces.lower, fresh.faces.lower)
    np.testing.assert_array_equal(other.corners, fresh.corners)
    np.testing.assert_array_equal(other.locate(mesh.nodes), fresh.locate(mesh.nodes))
