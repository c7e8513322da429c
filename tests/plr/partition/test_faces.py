import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import contents_of_planes, random_partition, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr._filled import filled_coefficients
from plr_jax.plr.leaves.plane.codec import encode_planes
from plr_jax.plr.partition import faces as of_faces
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import face_points, neighbor_of_largest_contact, parents_of_corners, shared_faces
from plr_jax.plr.partition.tree import corner_bits, tree_of


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


def lenders(cells, blocked, periodic=()):
    """For each blocked leaf the one that lends to it; -1 for none."""
    blocked = np.array(blocked, bool)
    return neighbor_of_largest_contact(cells, np.flatnonzero(blocked), np.flatnonzero(~blocked), periodic)


def slabs():
    """Four slabs: [0, 1/4], [1/4, 1/2], [1/2, 3/4] and [3/4, 1] along axis 0."""
    halves = Cells.root(2).split(np.array([0]))
    return halves.split(np.array([0, 0]))


def l_shape():
    """The left half, and of the right one its lowest quarter, the one above, and the upper half."""
    halves = Cells.root(2).split(np.array([0]))
    right = halves[[1]].split(np.array([1]))
    return halves[[0]].append(right[[0]].split(np.array([1])), right[[1]])


def test_only_direct_neighbors_lend():
    assert lenders(slabs(), [False, True, True, True]).tolist() == [0, -1, -1]


def test_neighbors_across_a_seam_lend():
    assert lenders(slabs(), [False, True, True, True], (True, False)).tolist() == [0, -1, 0]
    assert lenders(slabs(), [False, True, True, True], (False, True)).tolist() == [0, -1, -1]
    # The two halves touch in two places, of which none counts twice.
    assert lenders(l_shape(), [False, True, False, False], (True, True)).tolist() == [0]


def test_the_largest_contact_lends():
    assert lenders(l_shape(), [True, False, False, False]).tolist() == [3]


def test_nobody_to_lend_or_to_borrow():
    assert lenders(slabs(), [False] * 4).tolist() == []
    assert lenders(slabs(), [True] * 4).tolist() == [-1] * 4


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_exactly_the_blocked_leaves_that_touch_an_open_one_borrow_from_one_of_those(seed, dim):
    cells = random_partition(seed, dim, 25)
    blocked = np.random.default_rng(seed).random(len(cells)) < 0.7
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    for leaf, lender in zip(np.flatnonzero(blocked), lenders(cells, blocked), strict=True):
        touches = ~blocked & np.all((lo <= hi[leaf]) & (hi >= lo[leaf]), axis=1)
        assert touches[lender] if lender >= 0 else not touches.any()


def test_chunks_of_pairs_change_nothing(monkeypatch):
    cells = random_partition(0, 3, 60)
    blocked = np.random.default_rng(0).random(len(cells)) < 0.5
    whole = lenders(cells, blocked)
    monkeypatch.setattr(of_faces, "_PAIRS_AT_ONCE", 50)
    np.testing.assert_array_equal(lenders(cells, blocked), whole)


def test_a_borrower_continues_the_lenders_plane_and_the_others_answer_inf():
    """The plane ``1 + 14 x + 7 y``, whose value in the middle of the first slab is 1 + 14 / 8 + 7 / 2."""
    center = np.array([1 + 14 / 8 + 7 / 2, np.inf, np.inf, np.inf])
    half = np.array([[14 / 8, 7 / 2]] + [[0.0, 0.0]] * 3)
    contents = contents_of_planes(slabs(), encode_planes(center, half, 32))
    coefficients = filled_coefficients(contents)
    np.testing.assert_allclose(coefficients[1], [1 + 14 * 3 / 8 + 7 / 2, 14 / 8, 7 / 2])
    np.testing.assert_array_equal(coefficients[2:], [[np.inf, 0, 0]] * 2)


def test_a_borrower_continues_the_plane_across_the_seam():
    """The plane ``1 + 14 x + 7 y`` of the first slab goes on at ``x`` below 0, which is the last slab."""
    center = np.array([1 + 14 / 8 + 7 / 2, np.inf, np.inf, np.inf])
    half = np.array([[14 / 8, 7 / 2]] + [[0.0, 0.0]] * 3)
    domain = Box((0, 0), (1, 1), periodic=(True, False))
    coefficients = filled_coefficients(contents_of_planes(slabs(), encode_planes(center, half, 32), domain))
    np.testing.assert_allclose(coefficients[3], [1 - 14 / 8 + 7 / 2, 14 / 8, 7 / 2])
    assert np.isinf(coefficients[2, 0])


def test_a_larger_borrower_continues_the_plane_too():
    """The left half borrows ``3 y`` from the upper right quarter."""
    center = np.array([np.inf, np.inf, np.inf, 3 * 0.75])
    half = np.array([[0.0, 0.0]] * 3 + [[0.0, 3 / 4]])
    coefficients = filled_coefficients(contents_of_planes(l_shape(), encode_planes(center, half, 32)))
    np.testing.assert_allclose(coefficients[[0, 2]], [[1.5, 0, 1.5], [3 * 3 / 8, 0, 3 / 8]])
    assert np.isinf(coefficients[:, 0]).tolist() == [False, True, False, False]
