import numpy as np
import pytest
from plr_helpers import cone, walled

from plr_jax.geometry.box import Box
from plr_jax.plr.faces import shared_faces
from plr_jax.plr.leaves.continuous import FaceTests
from plr_jax.plr.tree import Cells, tree_of

SQUARE = Box((0, 0), (1, 1))


def grid(depth, dim=2):
    cells = Cells.root(dim)
    for axis in range(dim):
        for _ in range(depth):
            cells = cells.split(np.full(len(cells), axis))
    tree = tree_of(cells)
    return tree.leaves, shared_faces(tree)


def test_faces_in_a_wall_are_not_free():
    cells, faces = grid(4)
    free = FaceTests(walled, SQUARE).are_free(cells, faces)
    x = (np.maximum(cells.position[faces.lower], cells.position[faces.upper]) + 0.5) / 16  # a point beside the face
    inside = (faces.axis == 0) & (x[:, 0] > 0.42) & (x[:, 0] < 0.5) & (x[:, 1] < 0.65)
    assert inside.any() and not free[inside].any()
    away = (x[:, 0] < 0.35) | (x[:, 0] > 0.6) | (x[:, 1] > 0.8)
    assert free[away].all()


def test_a_face_on_the_edge_of_a_wall_is_not_free():
    cells, faces = grid(1)
    free = FaceTests(lambda x: np.where(x[:, 0] > 0.5, np.inf, 1.0), SQUARE).are_free(cells, faces)
    np.testing.assert_array_equal(free, (faces.axis == 1) & (cells.position[faces.lower, 0] == 0))


def test_a_face_is_tested_once():
    asked = []

    def counted(x):
        asked.append(len(x))
        return cone(x)

    tests = FaceTests(counted, SQUARE)
    for _ in range(2):
        assert tests.are_free(*grid(2)).all()
    assert len(asked) == 1


def test_intervals_and_boxes():
    for dim in (1, 3):
        cells, faces = grid(1, dim)
        assert FaceTests(cone, Box(np.zeros(dim), np.ones(dim))).are_free(cells, faces).all()


def test_a_distance_function_that_fails_beside_a_face_is_named():
    with pytest.raises(ValueError, match="distance_fn gives NaN"):
        FaceTests(lambda x: np.full(len(x), np.nan), SQUARE).are_free(*grid(1))
