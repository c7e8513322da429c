import numpy as np
from space_helpers import rectangle, states

from plr_jax import PlanarArm, Workspace
from plr_jax.spaces import CellState

BLOCKED, FREE, MIXED = CellState
OPEN = Workspace(((-4.0, -4.0), (4.0, 4.0)))


def among(*walls):
    return Workspace(OPEN.bounds, [rectangle(*wall) for wall in walls])


def test_joint_angles_are_relative_to_the_previous_link():
    q = np.array([[0, 0], [np.pi / 2, 0], [np.pi / 2, -np.pi / 2], [0, np.pi]])
    expected = [[[2.5, 0], [3.5, 0]], [[0.5, 2], [0.5, 3]], [[0.5, 2], [1.5, 2]], [[2.5, 0], [1.5, 0]]]
    joints = PlanarArm(OPEN, [2, 1], (0.5, 0)).forward(q)
    np.testing.assert_array_equal(joints[:, 0], [[0.5, 0]] * 4)
    np.testing.assert_allclose(joints[:, 1:], expected, atol=1e-12)


def test_walls_block_the_angles_toward_them():
    arm = PlanarArm(among((2.5, -1, 2.501, 1)), [2, 1], (0, 0))
    # Straight ahead crosses the wall; with the lower arm up the arm is free; between the two, some angles are.
    boxes = [((-0.05, -0.05), (0.05, 0.05)), ((-0.05, 1.5), (0.05, 1.7)), ((-0.05, 0), (0.05, 1.6))]
    assert states(arm, *boxes) == [BLOCKED, FREE, MIXED]
    # Beyond the end of the wall.
    assert states(arm, ((0.5, -0.01), (0.55, 0.01)), ((-np.pi, -np.pi), (np.pi, np.pi))) == [FREE, MIXED]
    assert arm.is_free([[0, 0], [0, 1.6], [0.5, 0]]).tolist() == [False, True, True]


def test_touching_walls_and_bounds_block_boxes():
    arm = PlanarArm(among((1, -1, 3, 0), (1, 0, 3, 1)), [2], (0, 0))
    assert states(arm, ((-0.2,), (0.2,)), ((1.0,), (2.0,))) == [BLOCKED, FREE]
    arm = PlanarArm(OPEN, [3, 2], (0, 0))
    assert states(arm, ((-0.1, -0.1), (0.1, 0.1)), ((-0.1, 2.5), (0.1, 2.7))) == [BLOCKED, FREE]


def test_wide_links_keep_half_their_width_from_walls():
    wall = among((1, 0.3, 2, 0.6))
    is_free = [PlanarArm(wall, [2.5], (0, 0), width).is_free([[0.0]])[0] for width in (0, 0.5, 0.6, 0.61)]
    assert is_free == [True, True, True, False]
    assert states(PlanarArm(wall, [2.5], (0, 0), 0.5), ((-0.01,), (0.01,)), ((0.03,), (0.2,))) == [FREE, MIXED]
    assert states(PlanarArm(wall, [2.5], (0, 0), 0.8), ((-0.01,), (0.01,))) == [BLOCKED]


def test_links_that_are_not_neighbors_collide():
    folded = np.array([[0.0, 2 * np.pi / 3, 2 * np.pi / 3]])  # a triangle: the tip is back at the base
    arm = PlanarArm(OPEN, [1, 1, 1], (0, 0), 0.1, self_collision=True)
    assert not arm.is_free(folded)[0] and PlanarArm(OPEN, [1, 1, 1], (0, 0), 0.1).is_free(folded)[0]
    assert states(arm, (folded[0] - 0.01, folded[0] + 0.01), ((-3, -1, -1), (3, 1, 1))) == [BLOCKED, MIXED]
    # How the base turns matters only beside the bounds.
    small = PlanarArm(OPEN, [0.1, 0.1, 0.1], (0, 0), 0.02, self_collision=True)
    assert [states(each, ((-9, -0.1, -0.1), (9, 0.1, 0.1))) for each in (arm, small)] == [[MIXED], [FREE]]
