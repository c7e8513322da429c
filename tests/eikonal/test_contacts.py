import itertools

import networkx
import numpy as np
from eikonal_helpers import BoxSpace

from plr_jax import Box, CellState, VoxelSpace
from plr_jax.eikonal.contacts import with_open_contacts
from plr_jax.eikonal.mesh import coarse_mesh

MIXED, BLOCKED = CellState.MIXED, CellState.BLOCKED


def states(free, num_cells):
    """The states of a mesh over voxels, before and after contacts are opened, by voxel."""
    space = VoxelSpace(free)
    mesh = coarse_mesh(space, np.ones(free.ndim), num_cells, num_cells)
    opened = with_open_contacts(mesh, space)
    middle = (np.argwhere(np.ones(free.shape)) + 0.5) / free.shape
    return [each.state[each.locate(middle)].reshape(free.shape) for each in (mesh, opened)]


def test_only_blocked_cells_between_two_that_touch_in_a_corner_are_opened():
    free = np.ones((4, 4), bool)
    free[1, 1] = free[2, 2] = free[0, 3] = False  # the last one touches none
    before, after = states(free, 16)
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


def test_no_place_in_space_is_parted_any_more_and_where_none_was_nothing_changes():
    num_opened = 0
    for bits in itertools.product([False, True], repeat=8):
        free = np.array(bits).reshape(2, 2, 2)
        if not free.any():
            continue
        before, after = states(free, 8)
        assert not parted_places(after != BLOCKED)
        assert parted_places(before != BLOCKED) or (after == before).all()
        num_opened += (after != before).any()
    assert num_opened > 50


def test_the_seam_of_a_periodic_axis_has_contacts_too():
    space = BoxSpace(Box((0, 0), (4, 4), (True, False)), [(0.0, 0.0), (1.0, 2.0)], [(3.0, 2.0), (4.0, 4.0)])
    mesh = coarse_mesh(space, np.ones(2), 16, 16)
    opened = (mesh.state == BLOCKED) & (with_open_contacts(mesh, space).state != BLOCKED)
    np.testing.assert_array_equal(np.stack(mesh.boxes)[:, opened], [[(0, 0), (3.5, 2)], [(0.5, 2), (4, 4)]])
