import numpy as np
import pytest
from robot_helpers import BAR
from space_helpers import BOUNDS, rectangle, states

from plr_jax import RigidBodySpace, Workspace
from plr_jax.spaces import CellState

BLOCKED, FREE, MIXED = CellState
OPEN = Workspace(BOUNDS)
TUNNEL = Workspace(BOUNDS, [rectangle(0.5, 0, 3.5, 1.25), rectangle(0.5, 1.75, 3.5, 3)])
ANY = np.pi
AHEAD = rectangle(1, 0.5, 2, 2.5)


@pytest.mark.parametrize(
    ("obstacles", "boxes", "expected"),
    [
        # A body of 0.9 by 0.3 in a tunnel 0.5 wide: free along it, blocked across it and in walls, else mixed.
        (TUNNEL.obstacles, [(1.5, 1.48, -0.05, 2.5, 1.52, 0.05), (1.5, 1.4, 1.4, 1.6, 1.6, 1.7)], [FREE, BLOCKED]),
        (TUNNEL.obstacles, [(0, 0, -ANY, 4, 3, ANY), (1.5, 1.4, 0, 1.6, 1.6, 1.7)], [MIXED, MIXED]),
        (TUNNEL.obstacles, [(0.02, 0.02, -ANY, 0.1, 0.1, ANY), (1.5, 0.5, -9, 1.6, 0.6, 9)], [BLOCKED, BLOCKED]),
        # Far from the bounds every heading is free; beyond the bounds none is.
        ([], [(1, 1, -ANY, 3, 2, ANY), (0.5, 0.5, -9, 3.5, 2.5, 9)], [FREE, FREE]),
        ([], [(4.1, 1, -ANY, 4.2, 1.1, ANY), (3.95, 1, -ANY, 4, 1.1, ANY)], [BLOCKED, BLOCKED]),
        # Two touching walls block a box that neither blocks alone; a thin wall blocks a body that crosses it.
        ([AHEAD, AHEAD + np.array([1, 0])], [(1.6, 1.2, -ANY, 2.4, 1.8, ANY)], [BLOCKED]),
        ([rectangle(2, 0, 2 + 1e-6, 3)],
         [(1.98, 1, -0.05, 2.02, 1.04, 0.05), (1.5, 1, 1.5, 1.55, 1.1, 1.6), (1, 1, -ANY, 3, 2, ANY)],
         [BLOCKED, FREE, MIXED])
    ],
    ids=range(7)
)  # fmt: skip
def test_states_of_boxes_drawn_by_hand(obstacles, boxes, expected):
    assert states(RigidBodySpace(Workspace(BOUNDS, obstacles), BAR), *boxes) == expected


def test_bodies_turn_the_shorter_way():
    space = RigidBodySpace(TUNNEL, BAR)
    q0, q1 = np.array([[2.0, 1.5, np.pi - 0.1]]), np.array([[2.2, 1.5, 0.1 - np.pi]])
    assert space.are_free(q0, q1)[0]
    assert not space.are_free(q0, [[2.2, 1.5, 0.2]])[0]
    np.testing.assert_allclose(space.motion_cost.lengths(q0, q1, space.domain), 0.2 + 0.2 * np.hypot(0.45, 0.15))
