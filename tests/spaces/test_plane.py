import numpy as np
import pytest
import shapely
from robot_helpers import BAR, POINT, WING
from space_helpers import (
    BOUNDS,
    check_classification,
    keep_clear,
    random_boxes,
    random_workspace,
    rectangle,
    states,
)

from plr_jax import CellState, DiscRobot, PlaneSpace, Workspace

BLOCKED, FREE, MIXED = CellState
DISC = DiscRobot(0.25)


def space_of(robot, *walls):
    return PlaneSpace(Workspace(BOUNDS, [rectangle(*wall) for wall in walls]), robot)


WALL, LEAN = (1, 1, 2, 2), (2, 0.5, 3, 2.5)
S = 0.25 / np.sqrt(2)  # so far beyond a corner its diagonal leaves what a disc keeps off


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
        # A gap that a disc does not fit through is blocked though no wall covers it; one as wide as it stays open.
        (space_of(DISC, (1, 0, 2, 1.4), (1, 1.8, 2, 3)), [(1, 1.4, 2, 1.8), (0.95, 1.2, 2.05, 2)], BLOCKED),
        (space_of(DISC, (1, 0, 2, 1.25), (1, 1.75, 2, 3)), [(1.25, 1.25, 1.75, x) for x in (1.75, 1.5)], MIXED),
        (space_of(POINT, (2, 0, 2 + 1e-7, 3)), [(1.5, 1, 2.5, 2)], MIXED),
        (space_of(POINT, (2, 0, 2 + 1e-7, 3)), [(1.5, 1, 2, 2)], FREE),
        # Around the round corner of what a disc keeps off.
        (space_of(DISC, WALL), [(2 + S + 1e-6, 2 + S + 1e-6, 2.5, 2.5)], FREE),
        (space_of(DISC, WALL), [(2, 2, 2 + 0.98 * S, 2 + 0.98 * S)], BLOCKED),
        (space_of(DISC, WALL), [(2, 2, 2 + 1.01 * S, 2 + 1.01 * S)], MIXED),
    ],
    ids=range(13),
)
def test_boxes_drawn_by_hand(space, boxes, expected):
    assert states(space, *boxes) == [expected] * len(boxes)


@pytest.mark.parametrize("robot", [POINT, DiscRobot(0.2)])
@pytest.mark.parametrize("seed", range(2))
def test_samples_agree_with_what_is_proven(seed, robot):
    workspace = random_workspace(seed)
    space = PlaneSpace(workspace, robot)
    lo, hi = random_boxes(np.random.default_rng(seed), space.domain, 400)
    radius = space.robot.rounding
    state = check_classification(space, lambda q: keep_clear(workspace, shapely.points(q), radius), lo, hi, 9)
    assert set(state) == set(CellState)
    # Exact, but for a disc beside corners: compared with an obstacle grown by fine arcs.
    grown = workspace.free_space if robot == POINT else workspace.free_space.boundary.buffer(0.2, quad_segs=64)
    free = workspace.free_space if robot == POINT else workspace.free_space.difference(grown)
    boxes = shapely.box(*lo.T, *hi.T)
    share = shapely.area(shapely.intersection(boxes, free)) / shapely.area(boxes)
    assert (state[share > 1 - 1e-9] == FREE).all() or robot != POINT
    assert (state[share > 1 - 1e-12] != BLOCKED).all()
    assert (state[(share > 1e-6) & (share < 0.99)] == MIXED).all()
    assert (state[shapely.distance(boxes, free) > 0.005 * 0.2] == BLOCKED).all()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("workspace", "robot", "message"),
    [
        (BOUNDS, DISC, "must be a Workspace"),
        *((Workspace(BOUNDS), robot, r"a point or a disc.*RigidBodySpace") for robot in (BAR, WING, "disc")),
        (Workspace(BOUNDS), DiscRobot(1.6), "no free space"),
    ],
)
def test_bad_input_is_refused(workspace, robot, message):
    with pytest.raises(ValueError, match=message):
        PlaneSpace(workspace, robot)


def test_boxes_are_seen_from_where_all_their_free_samples_are():
    """By sampling: a corner of a box, or a point in or beside it, that sees the box sees every free point of it."""
    rng = np.random.default_rng(0)
    counts = np.zeros(2, int)
    for seed in range(4):
        workspace = random_workspace(seed)
        space = PlaneSpace(workspace)
        lo, hi = random_boxes(rng, space.domain, 400)
        bits = rng.integers(0, 2, (400, 2))
        q = np.where(rng.random((400, 1)) < 0.7, np.where(bits == 1, hi, lo), lo + rng.random((400, 2)) * (hi - lo))
        sees = space.sees_boxes(q, lo, hi)
        share = rng.random((60, 2))
        x = (lo[:, None] + share * (hi - lo)[:, None]).reshape(-1, 2)
        free = workspace.clearance(x) >= 0
        visible = workspace.is_visible(x, np.repeat(q, 60, axis=0))
        all_visible = (visible | ~free).reshape(400, 60).all(axis=1)
        assert all_visible[sees].all()
        counts += [sees.sum(), (all_visible & ~sees & space.is_free(q)).sum()]
    assert counts[0] > 4 * counts[1]  # few that seem to be seen are not proven to be


def test_a_box_beside_a_wall_is_seen_from_its_free_corners():
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 1, 2, 2)]))

    def sees(q, lo, hi):
        return space.sees_boxes([q], [lo], [hi])[0]

    assert sees((0.5, 0.5), (0.5, 0.5), (0.9, 0.9)) and sees((0.5, 1.2), (0.5, 1.2), (1.5, 1.6))
    assert not sees((1.5, 1.2), (0.5, 1.2), (1.5, 1.6))  # in the wall
    around = (0.5, 0.5), (1.5, 1.5)  # a corner stands into the box
    assert sees((0.5, 0.5), *around) and not sees((1.5, 0.5), *around) and not sees((0.5, 1.5), *around)
    assert not sees((0.5, 0.5), (0.5, 0.5), (2.5, 2.5))  # a hole
    cut = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 0, 1.1, 3)]))
    assert not cut.sees_boxes([[0.5, 0.5]], [[0.5, 0.5]], [[1.5, 1.5]])[0]
    assert not PlaneSpace(space.workspace, DISC).sees_boxes([[0.5, 0.5]], [[0.5, 0.5]], [[0.7, 0.7]])[0]
    with pytest.raises(ValueError, match="as many"):
        space.sees_boxes(np.zeros((2, 2)), np.zeros((1, 2)), np.ones((1, 2)))


@pytest.mark.parametrize("squeeze", [False, True])
def test_no_path_passes_a_point_in_which_obstacles_touch(squeeze):
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 1, 2, 2), rectangle(2, 0.5, 3, 1)], squeeze=squeeze))
    beside = states(space, (1.5, 0.5, 2, 1), (2, 1, 2.5, 1.5))
    assert beside == ([FREE, FREE] if squeeze else [MIXED, MIXED])
    assert states(space, (1.5, 0.5, 1.9, 1), (2, 1.1, 2.5, 1.5)) == [FREE, FREE]
    q, lo, hi = np.array([[2.0, 1.0], [1.5, 0.5]]), np.array([[1.5, 0.5]] * 2), np.array([[2.0, 1.0]] * 2)
    assert space.sees_boxes(q, lo, hi).tolist() == [squeeze, True]
    assert PlaneSpace(space.workspace, DiscRobot(0.1)).classify([[1.5, 0.5]], [[1.9, 0.9]]).tolist() == [FREE]
