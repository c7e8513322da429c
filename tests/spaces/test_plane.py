import numpy as np
import pytest
import shapely
from robot_helpers import POINT
from space_helpers import BOUNDS, random_boxes, random_workspace, rectangle, states

from plr_jax import DiscRobot, PlaneSpace, Workspace
from plr_jax.spaces import CellState

BLOCKED, FREE, MIXED = CellState
DISC = DiscRobot(0.25)


def space_of(robot, *walls):
    return PlaneSpace(Workspace(BOUNDS, [rectangle(*wall) for wall in walls]), robot)


WALL, LEAN = (1, 1, 2, 2), (2, 0.5, 3, 2.5)
S = 0.25 / np.sqrt(2)  # a disc at this offset along both axes touches the corner


@pytest.mark.parametrize(
    ("space", "boxes", "expected"),
    [
        (space_of(POINT, WALL), [(0, 0, 1, 1), (1, 0, 2, 1), (0, 0, 4, 1), (2, 2, 4, 3)], FREE),
        (space_of(POINT, WALL), [WALL, (1.25, 1.25, 1.5, 1.5), (1, 1.5, 1.5, 2), (4, 0, 5, 1)], BLOCKED),
        (space_of(POINT, WALL), [(0.5, 1, 1.5, 2), (0, 0, 1.01, 1.01), (0, 0, 4, 3), (3, 2, 4.5, 3)], MIXED),
        # Two walls that touch, and a wall and the bounds, cover boxes together.
        (space_of(POINT, WALL, LEAN), [(1.5, 1.25, 2.5, 1.75), (1, 1, 3, 2)], BLOCKED),
        (space_of(DISC, WALL, LEAN), [(1.5, 1.25, 2.5, 1.75), (1, 1, 3, 2)], BLOCKED),
        (space_of(POINT, (1, 0, 2, 1)), [(1.25, -0.5, 1.75, 0.5)], BLOCKED),
        # A gap narrower than a disc is blocked though no wall covers it; a gap as wide as the disc stays open.
        (space_of(DISC, (1, 0, 2, 1.4), (1, 1.8, 2, 3)), [(1, 1.4, 2, 1.8), (0.95, 1.2, 2.05, 2)], BLOCKED),
        (space_of(DISC, (1, 0, 2, 1.25), (1, 1.75, 2, 3)), [(1.25, 1.25, 1.75, x) for x in (1.75, 1.5)], MIXED),
        (space_of(POINT, (2, 0, 2 + 1e-7, 3)), [(1.5, 1, 2.5, 2)], MIXED),
        (space_of(POINT, (2, 0, 2 + 1e-7, 3)), [(1.5, 1, 2, 2)], FREE),
        # Around the round corner of the obstacle grown by the disc.
        (space_of(DISC, WALL), [(2 + S + 1e-6, 2 + S + 1e-6, 2.5, 2.5)], FREE),
        (space_of(DISC, WALL), [(2, 2, 2 + 0.98 * S, 2 + 0.98 * S)], BLOCKED),
        (space_of(DISC, WALL), [(2, 2, 2 + 1.01 * S, 2 + 1.01 * S)], MIXED),
    ],
)
def test_states_of_boxes_drawn_by_hand(space, boxes, expected):
    assert states(space, *boxes) == [expected] * len(boxes)


@pytest.mark.parametrize("robot", [POINT, DiscRobot(0.2)])
@pytest.mark.parametrize("seed", range(2))
def test_states_of_boxes_follow_their_free_area(seed, robot):
    """States are exact, except for a disc beside corners: compared with an obstacle grown by fine arcs."""
    workspace = random_workspace(seed)
    space = PlaneSpace(workspace, robot)
    lo, hi = random_boxes(np.random.default_rng(seed), space.domain, 200)
    state = space.classify(lo, hi)
    free = workspace.free_space
    if robot != POINT:
        free = free.difference(free.boundary.buffer(0.2, quad_segs=64))
    boxes = shapely.box(*lo.T, *hi.T)
    share = shapely.area(shapely.intersection(boxes, free)) / shapely.area(boxes)
    assert (state[share > 1 - 1e-9] == FREE).all() or robot != POINT
    assert (state[share > 1 - 1e-12] != BLOCKED).all()
    assert (state[(share > 1e-6) & (share < 0.99)] == MIXED).all()
    assert (state[shapely.distance(boxes, free) > 0.005 * 0.2] == BLOCKED).all()
    assert set(state) == set(CellState)


def test_seen_boxes_have_only_visible_samples():
    """A point in a box, often a corner, that sees the box sees every free point of it."""
    rng, n = np.random.default_rng(0), 200
    counts = np.zeros(2, int)
    for seed in range(2):
        workspace = random_workspace(seed)
        space = PlaneSpace(workspace)
        lo, hi = random_boxes(rng, space.domain, n)
        share = np.where(rng.random((n, 1)) < 0.7, rng.integers(0, 2, (n, 2)), rng.random((n, 2)))
        q = lo + share * (hi - lo)
        sees = space.sees_boxes(q, lo, hi)
        x = (lo[:, None] + rng.random((40, 2)) * (hi - lo)[:, None]).reshape(-1, 2)
        visible = workspace.is_visible(x, np.repeat(q, 40, axis=0)) | (workspace.clearance(x) < 0)
        all_visible = visible.reshape(n, 40).all(axis=1)
        assert all_visible[sees].all()
        counts += [sees.sum(), (all_visible & ~sees & space.is_free(q)).sum()]
    assert counts[0] > 4 * counts[1]  # few boxes that seem visible are not proven visible


def test_boxes_beside_walls_are_seen_from_free_corners():
    space = space_of(POINT, WALL)

    def sees(q, lo, hi, space=space):
        return space.sees_boxes([q], [lo], [hi])[0]

    assert sees((0.5, 0.5), (0.5, 0.5), (0.9, 0.9)) and sees((0.5, 1.2), (0.5, 1.2), (1.5, 1.6))
    assert not sees((1.5, 1.2), (0.5, 1.2), (1.5, 1.6))  # in the wall
    around = (0.5, 0.5), (1.5, 1.5)  # a corner of the wall is in the box
    assert sees((0.5, 0.5), *around) and not sees((1.5, 0.5), *around) and not sees((0.5, 1.5), *around)
    assert not sees((0.5, 0.5), (0.5, 0.5), (2.5, 2.5))  # the wall is in the box
    assert not sees((0.5, 0.5), *around, space_of(POINT, (1, 0, 1.1, 3)))
    assert not sees((0.5, 0.5), (0.5, 0.5), (0.7, 0.7), space_of(DISC, WALL))
    with pytest.raises(ValueError, match="as many"):
        space.sees_boxes(np.zeros((2, 2)), np.zeros((1, 2)), np.ones((1, 2)))


@pytest.mark.parametrize("squeeze", [False, True])
def test_no_box_is_free_at_a_contact_of_obstacles(squeeze):
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 1, 2, 2), rectangle(2, 0.5, 3, 1)], squeeze=squeeze))
    assert states(space, (1.5, 0.5, 2, 1), (2, 1, 2.5, 1.5)) == [FREE if squeeze else MIXED] * 2
    assert states(space, (1.5, 0.5, 1.9, 1), (2, 1.1, 2.5, 1.5)) == [FREE, FREE]
    q, lo, hi = np.array([[2.0, 1.0], [1.5, 0.5]]), np.array([[1.5, 0.5]] * 2), np.array([[2.0, 1.0]] * 2)
    assert space.sees_boxes(q, lo, hi).tolist() == [squeeze, True]
    assert states(PlaneSpace(space.workspace, DiscRobot(0.1)), (1.5, 0.5, 1.9, 0.9)) == [FREE]
