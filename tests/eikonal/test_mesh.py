import itertools

import networkx
import numpy as np
import pytest
from eikonal_helpers import EMPTY, BoxSpace, mesh_of, random_mesh
from scipy import ndimage
from space_helpers import SteadyCurrent, random_boxes

from plr_jax import VoxelSpace
from plr_jax.eikonal.mesh import Mesh, coarse_mesh, with_open_contacts
from plr_jax.eikonal.program import cell_costs
from plr_jax.eikonal.solve import SampledSpace
from plr_jax.geometry.box import Box
from plr_jax.plr.tree import PLACING, corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace

BLOCKED, FREE, MIXED = CellState
UNIT = Box((0, 0), (1, 1))
SPACE = BoxSpace(Box((0, 0), (2, 1), (True, False)), [(0.3, 0.2), (1.1, 0.7)])
SAMPLED = SampledSpace(SPACE, 0)


def mesh_in(space, num_cells=16, max_cells=4096):
    return coarse_mesh(space, num_cells, max_cells)


def ends(cells):
    return np.ldexp(cells.position.astype(float), -cells.depth), np.ldexp(cells.position + 1.0, -cells.depth)


def test_points_are_located_in_half_open_cells():
    """Points outside are in the nearest cell."""
    meshes = [mesh_in(BoxSpace(UNIT)), *(random_mesh(1, dim, rounds=(0, 6, 5, 3)[dim]) for dim in (1, 2, 3))]
    for _ in range(12):
        meshes[0] = meshes[0].refined(meshes[0].locate(np.array([[0.3, 0.6]])), BoxSpace(UNIT))
    for mesh in meshes:
        rng, (lo, hi), dim = np.random.default_rng(0), ends(mesh.cells), mesh.dim
        near = np.array([0.3, 0.6, 0.0])[:dim] + 2.0 ** -rng.uniform(0, 14, (400, 1)) * rng.uniform(-1, 1, (400, dim))
        x = np.concatenate([rng.uniform(-0.5, 1.5, (300, dim)), lo, near, np.eye(dim), np.ones((1, dim))])
        inside = np.clip(x, 0, 1)[:, None]
        expected = np.argmax(np.all((lo <= inside) & ((inside < hi) | (hi == 1)), axis=2), axis=1)
        np.testing.assert_array_equal(mesh.locate(x), expected)


@pytest.mark.parametrize("periodic", [(False, False), (True, False)])
def test_cells_are_connected_through_open_faces(periodic):
    for seed in range(4):
        mesh = random_mesh(seed, 2, rounds=3, blocked=0.5, periodic=periodic)
        (lo, hi), graph = ends(mesh.cells), networkx.Graph()
        graph.add_nodes_from(mesh.open_cells)
        for a, b in itertools.permutations(mesh.open_cells, 2):
            for axis, other in ((0, 1), (1, 0)):
                touch = hi[a, axis] == lo[b, axis] or (periodic[axis] and hi[a, axis] == 1 and lo[b, axis] == 0)
                if touch and max(lo[a, other], lo[b, other]) < min(hi[a, other], hi[b, other]):
                    graph.add_edge(a, b)
        cell = int(mesh.open_cells[seed])
        assert set(np.flatnonzero(mesh.connected_to(cell))) == networkx.node_connected_component(graph, cell)


def test_walls_on_halves_of_cells_need_few_cells():
    space = BoxSpace(UNIT, [(0.0, 0.5), (1.0, 0.5625)])
    mesh = mesh_in(space, 4, 4096)
    while (mixed := np.flatnonzero(mesh.state == MIXED)).size:
        mesh = mesh.refined(mixed, space)
    assert len(mesh.state) == 4 + 2 * 3  # both upper cells of four: three halvings along y each
    assert mesh.volumes[mesh.state == BLOCKED].sum() == 0.0625


def test_refinement_obeys_the_limit_of_cells():
    space = BoxSpace(UNIT, [(0.3, 0.3), (0.9, 0.6)])
    coarse = mesh_in(space, 64)
    for room in range(0, 150, 7):
        added = len(coarse.refined(np.arange(64), space, room).state) - 64
        assert room - 3 < added <= room


def test_grown_boxes_leave_the_domain_at_seams_only():
    mesh = mesh_in(BoxSpace(SPACE.domain))
    (lo, hi), grown = mesh.boxes, mesh.grown_boxes
    beside = PLACING * np.array([2.0, 1.0])
    expected = np.stack([lo - beside, hi + beside])
    expected[:, :, 1] = np.clip(expected[:, :, 1], 0, 1)
    np.testing.assert_allclose(grown, expected, atol=1e-15)


def test_refined_cells_fill_the_domain():
    space = BoxSpace(UNIT, [(0.3, 0.3), (0.9, 0.6)])
    coarse = mesh_in(space, 64)
    which = np.random.default_rng(0).choice(len(coarse.state), 20, replace=False)
    fine = coarse.refined(which, space)
    assert len(coarse.state) + 20 <= len(fine.state) < len(coarse.state) + 3 * 20
    np.testing.assert_allclose(fine.volumes.sum(), 1, rtol=1e-12)
    middle = np.mean(fine.boxes, axis=0)
    np.testing.assert_array_equal(mesh_of(UNIT, fine.cells, fine.state).locate(middle), np.arange(len(middle)))
    parent = coarse.locate(middle)
    sure = coarse.state[parent] != MIXED
    np.testing.assert_array_equal(fine.state[sure], coarse.state[parent][sure])
    assert set(fine.state[np.isin(parent, which) & ~sure]) == set(CellState)


@pytest.mark.parametrize(
    ("width", "scale", "num_cells", "most", "expected"),
    [
        # About cubes by the cost of motions.
        ((1, 1), (1, 1), 16, 4096, (2, 2)),
        ((4, 1), (1, 1), 16, 4096, (3, 1)),
        ((4, 1), (1, 4), 16, 4096, (2, 2)),
        ((1, 1, 8), (1, 1, 1), 16, 4096, (1, 1, 4)),
        # No more cells than asked for, or allowed.
        ((1, 1), (1, 1), 0, 4096, (0, 0)),
        ((8, 1), (1, 1), 30, 5, (2, 0)),
        ((8, 1), (1, 1), 30, 40, (4, 1)),
    ],
)
def test_coarse_cells_are_about_cubes(width, scale, num_cells, most, expected):
    blocks = [((axis,), weight) for axis, weight in enumerate(scale)]
    mesh = coarse_mesh(BoxSpace(Box(np.zeros(len(width)), width), blocks=blocks), num_cells, most)
    assert (mesh.cells.depth == expected).all() and len(mesh.state) == 2 ** sum(expected)
    assert (mesh.state == FREE).all() and (len(mesh.all_faces) == 0) == (len(mesh.state) == 1)


def test_periodic_axes_have_at_least_four_cells():
    mesh = mesh_in(BoxSpace(Box((0, 0), (8, 1), (False, True))), 1)
    assert (mesh.cells.depth[:, 1] >= 2).all()
    pairs = np.stack([mesh.all_faces.lower, mesh.all_faces.upper])
    assert len(np.unique(np.sort(pairs, axis=0), axis=1).T) == pairs.shape[1]
    space = BoxSpace(Box(np.zeros(3), np.ones(3), (True, False, True)))
    assert len(mesh_in(space, 1, 16).state) == 16
    with pytest.raises(ValueError, match="max_leaves must be at least 16 in a domain with 2 periodic axes, got 15"):
        mesh_in(space, 1, 15)


@pytest.mark.parametrize("periodic", [(False, False), (False, True), (True, True)])
def test_cells_share_nodes_at_their_corners(periodic):
    mesh = random_mesh(0, 2, rounds=3)
    mesh = Mesh(Box((0, 0), (1, 1), periodic), mesh.tree, mesh.state, mesh.is_flush)
    x = mesh.fractions(np.arange(len(mesh.state))[:, None], corner_bits(2))
    np.testing.assert_array_equal(mesh.nodes[mesh.corners], np.where(periodic, x % 1.0, x))
    assert len(np.unique(mesh.nodes, axis=0)) == len(mesh.nodes)


def test_bounds_contain_directional_costs_of_cells():
    current = SteadyCurrent((0.3, -0.2))
    mesh = mesh_in(EMPTY, 64, 64)
    costs = cell_costs(EMPTY, current, mesh)
    rng = np.random.default_rng(0)
    cell = rng.integers(len(mesh.state), size=2000)
    angle = rng.uniform(0, 2 * np.pi, len(cell))
    v = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    time = current.time(v)
    assert (costs.least_rate <= time).all() and (time <= costs.of_motions(v, cell) + 1e-12).all()
    midway = costs.midway.of_motions(v, cell)
    assert (midway < costs.of_motions(v, cell)).all() and abs(np.mean(midway / time) - 1) < 0.05


def test_sampled_states_and_motions_agree_with_proven_ones():
    assert isinstance(SAMPLED, ConfigurationSpace)
    lo, hi = random_boxes(np.random.default_rng(0), SPACE.domain, 400)
    proven, sampled = SPACE.classify(lo, hi), SAMPLED.classify(lo, hi)
    inside = np.all((lo > 0.001) & (hi < (1.99, 0.999)), axis=1)  # touching an obstacle is free
    assert (sampled[proven == FREE] == FREE).all() and (sampled[inside & (proven == BLOCKED)] != FREE).all()
    assert (sampled[proven == MIXED] == MIXED).mean() > 0.8
    assert SAMPLED.classify(np.array([[0.4, 0.3]]), np.array([[0.5, 0.4]])).tolist() == [BLOCKED]
    q0 = np.array([[0.1, 0.5], [0.1, 0.1], [1.9, 0.5], [0.1, 0.5]])
    q1 = np.array([[1.5, 0.5], [1.5, 0.1], [0.1, 0.5], [0.5, 0.5]])
    # The first motion wraps around the periodic axis.
    assert SAMPLED.are_free(q0, q1).tolist() == [True, True, True, False]


@pytest.mark.parametrize("width", [(1e6, 1e-3), (1e-6, 1.0, 1e6)])
def test_slender_cells_raise(width):
    space = BoxSpace(Box(np.zeros(len(width)), width))
    with pytest.raises(ValueError, match=rf"200,000 times as long as wide.*leave out axis {np.argmin(width)}"):
        mesh_in(space, 64, 64)


def voxel_states(free, num_cells):
    """Return the states of a mesh over voxels, before and after contacts are opened, by voxel."""
    space = VoxelSpace(free)
    mesh = coarse_mesh(space, num_cells, num_cells)
    opened = with_open_contacts(mesh, space)
    middle = (np.argwhere(np.ones(free.shape)) + 0.5) / free.shape
    return [each.state[each.locate(middle)].reshape(free.shape) for each in (mesh, opened)]


def test_blocked_cells_that_touch_in_a_corner_are_opened():
    free = np.ones((4, 4), bool)
    free[1, 1] = free[2, 2] = free[0, 3] = False  # the last one touches none
    before, after = voxel_states(free, 16)
    assert (before[[1, 2, 0], [1, 2, 3]] == BLOCKED).all()
    assert (after[[1, 2], [1, 2]] == MIXED).all() and after[0, 3] == BLOCKED


def is_parted(is_open):
    """Return whether open ones of 2 x 2 x 2 voxels are not connected by faces, around the center or half an edge."""
    slabs = [np.take(is_open, side, axis) for axis in range(3) for side in (0, 1)]
    return any(ndimage.label(part)[1] > 1 for part in (is_open, *slabs))


@pytest.mark.full
def test_cells_are_opened_only_where_contacts_part_voxels():
    num_opened = 0
    for bits in itertools.islice(itertools.product([False, True], repeat=8), 1, None):
        before, after = (state != BLOCKED for state in voxel_states(np.array(bits).reshape(2, 2, 2), 8))
        assert not is_parted(after) and (is_parted(before) or (after == before).all())
        num_opened += (after != before).any()
    assert num_opened > 50


def test_contacts_across_the_seam_are_opened():
    space = BoxSpace(Box((0, 0), (4, 4), (True, False)), [(0.0, 0.0), (1.0, 2.0)], [(3.0, 2.0), (4.0, 4.0)])
    mesh = coarse_mesh(space, 16, 16)
    opened = (mesh.state == BLOCKED) & (with_open_contacts(mesh, space).state != BLOCKED)
    np.testing.assert_array_equal(np.stack(mesh.boxes)[:, opened], [[(0, 0), (3.5, 2)], [(0.5, 2), (4, 4)]])
