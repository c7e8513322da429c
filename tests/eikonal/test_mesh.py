import itertools

import networkx
import numpy as np
import pytest
from eikonal_helpers import EMPTY, BoxSpace, mesh_of, random_mesh
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


def test_points_are_located_as_by_search_and_those_outside_in_the_nearest_cell():
    """Half-open boxes, of which the last ones are closed."""
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


def test_cells_are_what_the_space_proves():
    space = BoxSpace(Box((0, 0), (2, 1)), [(0.3, 0.2), (1.1, 0.7)], [(1.5, 0.5), (1.6, 1)])
    mesh = mesh_in(space, 500)
    lo, hi = mesh.boxes
    share = np.array(list(itertools.product(np.linspace(0, 1, 9), repeat=2)))
    samples = lo[:, None] + share * (hi - lo)[:, None]
    free = space.is_free(samples.reshape(-1, 2)).reshape(len(lo), -1)
    inner = ((share > 0) & (share < 1)).all(axis=1)
    assert free[mesh.state == FREE].all() and not free[mesh.state == BLOCKED][:, inner].any()
    assert set(mesh.state) == set(CellState)


def test_blocked_cells_that_queries_may_place_free_points_in_are_flush_with_others():
    space = BoxSpace(UNIT, [(0.25, 0.25), (0.5, 0.75)])
    coarse = mesh_in(space)
    for mesh in (coarse, coarse.refined(coarse.open_cells, space)):
        lo, hi = mesh.boxes
        blocked = np.all((lo >= (0.25, 0.25)) & (hi <= (0.5, 0.75)), axis=1)
        np.testing.assert_array_equal(mesh.state == BLOCKED, blocked)
        inner = np.all((lo > (0.25, 0.25)) & (hi < (0.5, 0.75)), axis=1)
        np.testing.assert_array_equal(mesh.is_flush, blocked & ~inner)
        touch = [
            (i, j)
            for i, j in itertools.product(np.flatnonzero(mesh.is_flush), mesh.open_cells)
            if (np.maximum(lo[i], lo[j]) <= np.minimum(hi[i], hi[j])).all()
        ]
        assert sorted(zip(*mesh.flush_pairs, strict=True)) == touch and touch


def test_walls_flush_with_halves_of_cells_take_few_of_them():
    space = BoxSpace(UNIT, [(0.0, 0.5), (1.0, 0.5625)])
    mesh = mesh_in(space, 4, 4096)
    while (mixed := np.flatnonzero(mesh.state == MIXED)).size:
        mesh = mesh.refined(mixed, space)
    assert len(mesh.state) == 4 + 2 * 3  # both upper cells of four: three halvings along y each
    assert mesh.volumes[mesh.state == BLOCKED].sum() == 0.0625


def test_no_more_cells_come_of_refining_than_there_is_room_for():
    space = BoxSpace(UNIT, [(0.3, 0.3), (0.9, 0.6)])
    coarse = mesh_in(space, 64)
    for room in range(0, 150, 7):
        added = len(coarse.refined(np.arange(64), space, room).state) - 64
        assert room - 3 < added <= room


def test_grown_boxes_leave_the_domain_around_periodic_axes_alone():
    mesh = mesh_in(BoxSpace(SPACE.domain))
    (lo, hi), grown = mesh.boxes, mesh.grown_boxes
    beside = PLACING * np.array([2.0, 1.0])
    expected = np.stack([lo - beside, hi + beside])
    expected[:, :, 1] = np.clip(expected[:, :, 1], 0, 1)
    np.testing.assert_allclose(grown, expected, atol=1e-15)


def test_refined_cells_fill_the_domain_and_are_classified_anew():
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
        # About cubes by what motions cost.
        ((1, 1), (1, 1), 16, 4096, (2, 2)),
        ((4, 1), (1, 1), 16, 4096, (3, 1)),
        ((4, 1), (1, 4), 16, 4096, (2, 2)),
        ((1, 1, 8), (1, 1, 1), 16, 4096, (1, 1, 4)),
        # No more cells than asked for, or allowed.
        ((1, 1), (1, 1), 0, 4096, (0, 0)),
        *(((8, 1), (1, 1), 30, most, depth) for most, depth in ((1, (0, 0)), (2, (1, 0)), (5, (2, 0)))),
        *(((8, 1), (1, 1), 30, most, depth) for most, depth in ((8, (3, 0)), (40, (4, 1)))),
    ],
)
def test_how_often_the_coarse_cells_are_halved(width, scale, num_cells, most, expected):
    mesh = coarse_mesh(
        BoxSpace(Box(np.zeros(len(width)), width), blocks=[((i,), w) for i, w in enumerate(scale)]), num_cells, most
    )
    assert (mesh.cells.depth == expected).all() and len(mesh.state) == 2 ** sum(expected)
    assert (mesh.state == FREE).all() and (len(mesh.all_faces) == 0) == (len(mesh.state) == 1)


def test_no_cell_touches_another_on_both_sides_of_a_periodic_axis():
    mesh = mesh_in(BoxSpace(Box((0, 0), (8, 1), (False, True))), 1)
    assert (mesh.cells.depth[:, 1] >= 2).all()
    pairs = np.stack([mesh.all_faces.lower, mesh.all_faces.upper])
    assert len(np.unique(np.sort(pairs, axis=0), axis=1).T) == pairs.shape[1]
    space = BoxSpace(Box(np.zeros(3), np.ones(3), (True, False, True)))
    assert len(mesh_in(space, 1, 16).state) == 16
    with pytest.raises(ValueError, match="max_leaves must be at least 16 in a domain with 2 periodic axes, got 15"):
        mesh_in(space, 1, 15)


@pytest.mark.parametrize("periodic", [(False, False), (False, True), (True, True)])
def test_cells_share_the_nodes_at_their_corners(periodic):
    mesh = random_mesh(0, 2, rounds=3)
    mesh = Mesh(Box((0, 0), (1, 1), periodic), mesh.tree, mesh.state, mesh.is_flush)
    x = mesh.fractions(np.arange(len(mesh.state))[:, None], corner_bits(2))
    np.testing.assert_array_equal(mesh.nodes[mesh.corners], np.where(periodic, x % 1.0, x))
    assert len(np.unique(mesh.nodes, axis=0)) == len(mesh.nodes)


def test_costs_are_between_their_bounds_whichever_way_motions_go():
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


# --- by samples alone ------------------------------------------------------------------------------------


def test_boxes_are_what_is_proven_of_them_or_what_samples_missed():
    assert isinstance(SAMPLED, ConfigurationSpace)
    assert SAMPLED.domain == SPACE.domain and SAMPLED.motion_cost == SPACE.motion_cost
    q = np.random.default_rng(0).random((100, 2))
    np.testing.assert_array_equal(SAMPLED.is_free(q), SPACE.is_free(q))
    lo, hi = random_boxes(np.random.default_rng(0), SPACE.domain, 400)
    proven, sampled = SPACE.classify(lo, hi), SAMPLED.classify(lo, hi)
    inside = np.all((lo > 0.001) & (hi < (1.99, 0.999)), axis=1)  # what only touches an obstacle is free
    assert (sampled[proven == FREE] == FREE).all()
    assert (sampled[inside & (proven == BLOCKED)] != FREE).all()
    assert (sampled[proven == MIXED] == MIXED).mean() > 0.8
    assert SAMPLED.classify(np.array([[0.4, 0.3]]), np.array([[0.5, 0.4]])).tolist() == [BLOCKED]


def test_motions_are_free_where_all_samples_are():
    q0 = np.array([[0.1, 0.5], [0.1, 0.1], [1.9, 0.5], [0.1, 0.5]])
    q1 = np.array([[1.5, 0.5], [1.5, 0.1], [0.1, 0.5], [0.5, 0.5]])
    assert SAMPLED.are_free(q0, q1).tolist() == [True, True, True, False]  # the first one goes around the back
    assert SAMPLED.are_free(q0, q1).tolist() == SPACE.are_free(q0, q1).tolist()


@pytest.mark.parametrize("width", [(1e6, 1e-3), (1e-6, 1.0, 1e6)])
def test_cells_that_are_too_slender_are_refused(width):
    space = BoxSpace(Box(np.zeros(len(width)), width))
    with pytest.raises(ValueError, match=rf"200,000 times as long as wide.*leave out axis {np.argmin(width)}"):
        mesh_in(space, 64, 64)


# --- contacts ------------------------------------------------------------------------------------------


def voxel_states(free, num_cells):
    """The states of a mesh over voxels, before and after contacts are opened, by voxel."""
    space = VoxelSpace(free)
    mesh = coarse_mesh(space, num_cells, num_cells)
    opened = with_open_contacts(mesh, space)
    middle = (np.argwhere(np.ones(free.shape)) + 0.5) / free.shape
    return [each.state[each.locate(middle)].reshape(free.shape) for each in (mesh, opened)]


def test_only_blocked_cells_between_two_that_touch_in_a_corner_are_opened():
    free = np.ones((4, 4), bool)
    free[1, 1] = free[2, 2] = free[0, 3] = False  # the last one touches none
    before, after = voxel_states(free, 16)
    assert (before[[1, 2, 0], [1, 2, 3]] == BLOCKED).all()
    assert (after[[1, 2], [1, 2]] == MIXED).all() and after[0, 3] == BLOCKED


def parted_places(is_open):
    """Of 2 x 2 x 2 voxels, which places inside have open ones around them without a way around through open ones."""
    found = []
    for across in [(0, 1, 2), *itertools.combinations(range(3), 2)]:
        for side in (0, 1) if len(across) == 2 else (None,):
            (*_, along) = sorted({0, 1, 2} - set(across)) or [None]
            around = [v for v in itertools.product((0, 1), repeat=3) if side is None or v[along] == side]
            graph = networkx.Graph()
            graph.add_nodes_from(v for v in around if is_open[v])
            pairs = itertools.combinations(list(graph), 2)
            graph.add_edges_from((a, b) for a, b in pairs if np.abs(np.subtract(a, b)).sum() == 1)
            if len(graph) and not networkx.is_connected(graph):
                found.append((across, side))
    return found


@pytest.mark.full
def test_no_place_in_space_is_parted_any_more_and_where_none_was_nothing_changes():
    num_opened = 0
    for bits in itertools.product([False, True], repeat=8):
        free = np.array(bits).reshape(2, 2, 2)
        if not free.any():
            continue
        before, after = voxel_states(free, 8)
        assert not parted_places(after != BLOCKED)
        assert parted_places(before != BLOCKED) or (after == before).all()
        num_opened += (after != before).any()
    assert num_opened > 50


def test_the_seam_of_a_periodic_axis_has_contacts_too():
    space = BoxSpace(Box((0, 0), (4, 4), (True, False)), [(0.0, 0.0), (1.0, 2.0)], [(3.0, 2.0), (4.0, 4.0)])
    mesh = coarse_mesh(space, 16, 16)
    opened = (mesh.state == BLOCKED) & (with_open_contacts(mesh, space).state != BLOCKED)
    np.testing.assert_array_equal(np.stack(mesh.boxes)[:, opened], [[(0, 0), (3.5, 2)], [(0.5, 2), (4, 4)]])
