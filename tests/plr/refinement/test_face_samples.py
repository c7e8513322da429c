import numpy as np
from plr_helpers import cone, walled

from plr_jax import Box
from plr_jax.plr import Plane, construct
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import Contents
from plr_jax.plr.leaves.plane import encode_planes
from plr_jax.plr.partition.cells import Cells, Level, tree_of
from plr_jax.plr.partition.faces import shared_faces
from plr_jax.plr.refinement.objective import sample_faces


def test_faces_are_free_and_each_point_lies_on_both_of_its_leaves(wall, wall_faces):
    plr = wall[0]
    (lo, hi), faces = plr.leaf_boxes, wall_faces
    assert np.isfinite(walled(faces.x)).all() and not plr.unreachable[faces.leaves].any()
    assert (np.abs(faces.u) <= 1 + 1e-12).all()
    for side in range(2):
        x = (lo + hi)[faces.leaves[:, side]] / 2 + faces.u[:, side] * (hi - lo)[faces.leaves[:, side]] / 2
        np.testing.assert_allclose(x, faces.x, atol=1e-12)
    below, above = faces.leaves.T
    touching = hi[below] == lo[above]
    assert (touching.sum(axis=1) >= 1).all() and (below != above).all()
    # The brute-force twin of which leaves meet: all pairs that share a part of a face which is free somewhere.
    u = np.linspace(0.01, 0.99, 50)
    sampled = set(map(tuple, faces.leaves.tolist()))
    for i, j in np.ndindex(len(lo), len(lo)):
        for axis in range(2):
            other = 1 - axis
            start, end = max(lo[i, other], lo[j, other]), min(hi[i, other], hi[j, other])
            if hi[i, axis] == lo[j, axis] and end > start and not plr.unreachable[[i, j]].any():
                x = np.empty((50, 2))
                x[:, axis], x[:, other] = hi[i, axis], start + u * (end - start)
                assert (i, j) in sampled or not np.isfinite(walled(x)).all()


def test_all_pieces_of_faces_are_sampled_alike():
    plr = construct(cone, Box([-1, -1, -1], [1, 1, 1]), max_leaves=40)
    tree = tree_of(plr.cells)
    faces, pieces = sample_faces(plr, cone, num_samples=5), shared_faces(tree)
    pairs, counts = np.unique(faces.leaves, axis=0, return_counts=True)
    assert (counts == 5).all() and len(np.unique(faces.x, axis=0)) == len(faces)
    np.testing.assert_array_equal(pairs, np.stack([pieces.lower, pieces.upper], axis=1))


def test_faces_of_a_file_that_splits_the_same_leaves_in_another_order():
    quarters = Cells.root(2).split(np.array([1])).split(np.array([0, 0]))
    every = np.array([True, True])
    levels = [
        Level(every[:1], np.array([1])),
        Level(every, np.array([0, 0])),
        Level(np.zeros(4, bool), np.zeros(0, int)),
    ]
    planes = encode_planes(np.arange(4.0), np.zeros((4, 2)), 32)
    plr = plr_of_leaves(Contents(Box([0, 0], [1, 1]), Plane(), levels, quarters, planes))
    faces = sample_faces(plr, cone, num_samples=1)
    assert (np.abs(faces.u) <= 1).all()
    # Lower left is 0, lower right 1, upper left 2, upper right 3.
    assert sorted(zip(faces.leaves.tolist(), faces.jumps(plr).tolist(), strict=True)) == [
        ([0, 1], 1.0),
        ([0, 2], 2.0),
        ([1, 3], 2.0),
        ([2, 3], 1.0),
    ]


def test_jumps_are_the_limits_of_the_plr_from_both_sides():
    plr = construct(cone, Box([-1, -1, -1], [1, 1, 1]), max_leaves=30)
    faces = sample_faces(plr, cone, num_samples=3, seed=5)
    axis = np.abs(np.abs(faces.u) - 1).sum(axis=1).argmin(axis=1)
    step = 1e-6 * np.eye(3)[axis]
    difference = np.asarray(plr(faces.x + step), float) - np.asarray(plr(faces.x - step), float)
    np.testing.assert_allclose(faces.jumps(plr), difference, atol=1e-5)
