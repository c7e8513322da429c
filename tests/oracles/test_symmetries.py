import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import Dubins, Euclidean, ReedsShepp, Roadmap, Workspace
from plr_jax._types import SymmetricFn, Symmetry

GOAL = (0.3, -0.8, 2.2)
ORACLES = [Dubins(GOAL, 1.7), ReedsShepp(GOAL, 1.7), Euclidean(GOAL), Euclidean((1.0, 2.0))]
COORDINATE = st.floats(-20, 20)


def image(symmetry, x):
    return x @ symmetry.matrix.T + symmetry.offset


@pytest.mark.parametrize("oracle", ORACLES, ids=lambda oracle: type(oracle).__name__)
@given(st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_images_are_as_far_from_the_goal(oracle, point):
    x = np.array([point[: oracle.dim]])
    assert isinstance(oracle, SymmetricFn) and oracle.symmetries
    for symmetry in oracle.symmetries:
        np.testing.assert_allclose(oracle(image(symmetry, x)), oracle(x), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("oracle", ORACLES, ids=lambda oracle: type(oracle).__name__)
def test_they_are_isometries_that_keep_the_goal(oracle):
    for symmetry in oracle.symmetries:
        np.testing.assert_allclose(symmetry.matrix @ symmetry.matrix.T, np.eye(oracle.dim), atol=1e-15)
        np.testing.assert_allclose(image(symmetry, oracle.goal), oracle.goal, atol=1e-15)
        assert np.abs(symmetry.matrix - np.eye(oracle.dim)).max() > 0.1


def test_those_of_cars_mirror_the_goal_s_axes():
    pose = np.array([3.0, 2.0, 0.5])
    along, across = ReedsShepp((0, 0, 0), 1).symmetries
    np.testing.assert_allclose(image(along, pose), (3, -2, -0.5))
    np.testing.assert_allclose(image(across, pose), (-3, 2, -0.5))
    np.testing.assert_allclose(image(along, image(across, pose)), (-3, -2, 0.5))
    (along,) = Dubins((0, 0, 0), 1).symmetries
    np.testing.assert_allclose(image(along, pose), (3, -2, -0.5))
    forward = Dubins((0, 0, 0), 1)
    assert abs(forward(image(across, pose)[None]) - forward(pose[None])) > 1  # a car that cannot reverse


def test_a_goal_that_is_turned_turns_them():
    along, across = ReedsShepp((1, 2, np.pi / 2), 1).symmetries
    np.testing.assert_allclose(image(along, np.array([4, 7, np.pi / 2 + 0.1])), (-2, 7, np.pi / 2 - 0.1))
    np.testing.assert_allclose(image(across, np.array([4, 7, np.pi / 2 + 0.1])), (4, -3, np.pi / 2 - 0.1))


def test_what_states_none():
    room = Workspace(((0, 0), (1, 1)))
    assert not isinstance(Roadmap.from_workspace(room, (0.5, 0.5), 5), SymmetricFn)


def test_a_symmetry_about_a_point():
    turn = Symmetry.about(np.array([1.0, 2.0]), np.array([[0.0, -1.0], [1.0, 0.0]]))
    np.testing.assert_allclose(image(turn, np.array([3.0, 2.0])), (1, 4))
