import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells, corner_bits, tree_of
from plr_jax.plr.partition.faces import face_points, parents_of_corners, shared_faces


def test_a_tree_of_three_leaves():
    tree = tree_of(three_leaves())
    np.testing.assert_array_equal(tree.child, [1, -1, 3, -1, -1])
    np.testing.assert_array_equal(tree.node_of_leaf, [1, 3, 4])
    faces = shared_faces(tree)
    np.testing.assert_array_equal([faces.lower, faces.upper, faces.axis], [[0, 0, 1], [1, 2, 2], [0, 0, 1]])
    np.testing.assert_array_equal(
        face_points(tree.leaves, faces, np.array([[0.7, 0.5]]))[:2, 0], [[0.5, 0.25], [0.5, 0.75]]
    )


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_leaves_are_the_cells_in_one_order(seed, dim):
    cells = random_partition(seed, dim, 20)
    shuffled = cells[np.random.default_rng(seed).permutation(len(cells))]
    leaves, again = tree_of(cells).leaves, tree_of(shuffled).leaves
    np.testing.assert_array_equal(again.position, leaves.position)
    np.testing.assert_array_equal(shuffled[tree_of(shuffled).order].position, leaves.position)
    rows = np.concatenate([leaves.depth, leaves.position], axis=1).tolist()
    assert sorted(rows) == sorted(np.concatenate([cells.depth, cells.position], axis=1).tolist())


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_faces_are_those_found_by_comparing_all_boxes(seed, dim):
    tree = tree_of(random_partition(seed, dim, 20))
    cells = tree.leaves
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    expected = set()
    for a in range(len(cells)):
        for b in range(len(cells)):
            for axis in range(dim):
                others = np.arange(dim) != axis
                overlap = np.all((np.minimum(hi[a], hi[b]) > np.maximum(lo[a], lo[b]))[others])
                if hi[a, axis] == lo[b, axis] and overlap:
                    expected.add((a, b, axis))
    faces = shared_faces(tree)
    found = list(zip(faces.lower.tolist(), faces.upper.tolist(), faces.axis.tolist(), strict=True))
    assert sorted(expected) == found


def test_faces_across_the_seam_of_three_leaves():
    """The left half spans the periodic axis 1, so it touches itself; across axis 0 it touches both others twice."""
    tree = tree_of(three_leaves())
    faces = shared_faces(tree, (True, True))
    expected = [(0, 0, 1), (0, 1, 0), (0, 2, 0), (1, 0, 0), (1, 2, 1), (2, 0, 0), (2, 1, 1)]
    assert list(zip(faces.lower.tolist(), faces.upper.tolist(), faces.axis.tolist(), strict=True)) == expected
    points = face_points(tree.leaves, faces, np.array([[0.7, 0.5]]))[:, 0]
    seams = [0, 3, 5, 6]
    np.testing.assert_array_equal(points[seams], [[0.35, 1], [1, 0.25], [1, 0.75], [0.85, 1]])
    assert len(shared_faces(tree_of(Cells.root(3)), (True, False, True))) == 2


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), data=st.data())
def test_faces_on_a_torus_are_those_found_by_comparing_all_boxes(seed, dim, data):
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    tree = tree_of(random_partition(seed, dim, 20))
    cells = tree.leaves
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    expected = {}
    for a in range(len(cells)):
        for b in range(len(cells)):
            for axis in range(dim):
                low, high = np.maximum(lo[a], lo[b]), np.minimum(hi[a], hi[b])
                at_seam = periodic[axis] and hi[a, axis] == 1 and lo[b, axis] == 0
                if (hi[a, axis] == lo[b, axis] or at_seam) and (low < high)[np.arange(dim) != axis].all():
                    low[axis] = high[axis] = hi[a, axis]
                    expected[a, b, axis] = low, high
    faces = shared_faces(tree, periodic)
    found = list(zip(faces.lower.tolist(), faces.upper.tolist(), faces.axis.tolist(), strict=True))
    assert sorted(expected) == found
    ends = face_points(cells, faces, np.repeat([[0.0], [1.0]], dim, axis=1))
    np.testing.assert_array_equal(ends, np.array([expected[face] for face in found]).reshape(ends.shape))


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_a_corner_is_the_middle_of_its_parents(seed, dim):
    tree = tree_of(random_partition(seed, dim, 20))
    cells = tree.leaves
    ends, is_made = parents_of_corners(tree)
    corner = ((cells.position[:, None] + corner_bits(dim)) * 0.5 ** cells.depth[:, None]).reshape(-1, dim)
    middle = corner[ends].mean(axis=2)
    np.testing.assert_array_equal(middle[is_made], corner.reshape(*is_made.shape, dim)[is_made])
    of_domain = np.isin(corner, [0, 1]).all(axis=1).reshape(is_made.shape)
    np.testing.assert_array_equal(is_made, ~of_domain)
