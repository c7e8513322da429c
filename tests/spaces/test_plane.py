import numpy as np
import pytest
import shapely
from robot_helpers import BAR, WING
from space_helpers import (
    BOUNDS,
    check_classification,
    check_motions,
    keep_clear,
    random_boxes,
    random_workspace,
    rectangle,
)

from plr_jax import (
    CellState,
    ConfigurationSpace,
    DiscRobot,
    FreeTest,
    MotionCost,
    PlaneSpace,
    Problem,
    Workspace,
    validate,
)

BLOCKED, FREE, MIXED = CellState
DISC = DiscRobot(0.25)


def states(space, *boxes):
    lo, hi = np.array(boxes, dtype=float).reshape(-1, 2, 2).transpose(1, 0, 2)
    return space.classify(lo, hi).tolist()


def test_a_plane_is_a_configuration_space():
    space = PlaneSpace(Workspace(BOUNDS))
    assert isinstance(space, ConfigurationSpace) and isinstance(space, FreeTest)
    assert space.domain == space.workspace.bounds
    assert space.motion_cost == MotionCost((((0, 1), 1.0),))


def test_boxes_beside_a_wall_are_told_exactly():
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 1, 2, 2)]))
    assert states(space, (0, 0, 1, 1), (1, 0, 2, 1), (0, 0, 4, 1), (2, 2, 4, 3)) == [FREE] * 4
    assert states(space, (1, 1, 2, 2), (1.25, 1.25, 1.5, 1.5), (1, 1.5, 1.5, 2), (4, 0, 5, 1)) == [BLOCKED] * 4
    assert states(space, (0.5, 1, 1.5, 2), (0, 0, 1.01, 1.01), (0, 0, 4, 3), (3, 2, 4.5, 3)) == [MIXED] * 4


def test_a_box_that_two_touching_walls_cover_together_is_blocked():
    for robot in (None, DISC):
        workspace = Workspace(BOUNDS, [rectangle(1, 1, 2, 2), rectangle(2, 0.5, 3, 2.5)])
        space = PlaneSpace(workspace, robot) if robot else PlaneSpace(workspace)
        assert states(space, (1.5, 1.25, 2.5, 1.75), (1, 1, 3, 2)) == [BLOCKED, BLOCKED]
    at_the_bounds = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 0, 2, 1)]))
    assert states(at_the_bounds, (1.25, -0.5, 1.75, 0.5)) == [BLOCKED]


def test_a_gap_that_a_disc_does_not_fit_through_is_blocked_though_no_wall_covers_it():
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 0, 2, 1.4), rectangle(1, 1.8, 2, 3)]), DISC)
    assert states(space, (1, 1.4, 2, 1.8), (0.95, 1.2, 2.05, 2)) == [BLOCKED, BLOCKED]
    assert not space.is_free([[1.5, 1.6]])[0]


def test_a_gap_exactly_as_wide_as_a_disc_stays_open():
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 0, 2, 1.25), rectangle(1, 1.75, 2, 3)]), DISC)
    assert states(space, (1.25, 1.25, 1.75, 1.75), (1.25, 1.25, 1.75, 1.5)) == [MIXED, MIXED]
    assert space.are_free([[0.5, 1.5]], [[2.5, 1.5]])[0]


@pytest.mark.parametrize("thickness", [1e-3, 1e-7])
def test_a_thin_wall_through_a_box_leaves_it_mixed(thickness):
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(2, 0, 2 + thickness, 3)]))
    assert states(space, (1.5, 1, 2.5, 2), (1.5, 1, 2, 2)) == [MIXED, FREE]
    assert not space.are_free([[1.5, 1.5]], [[2.5, 1.5]])[0]


def test_boxes_are_mixed_or_free_around_the_round_corner_of_what_a_disc_keeps_off():
    space = PlaneSpace(Workspace(BOUNDS, [rectangle(1, 1, 2, 2)]), DISC)
    s = 0.25 / np.sqrt(2)  # where the diagonal leaves the rounded corner (2, 2)
    boxes = [
        (2 + s + 1e-6, 2 + s + 1e-6, 2.5, 2.5),
        (2, 2, 2 + 0.98 * s, 2 + 0.98 * s),
        (2, 2, 2 + 1.01 * s, 2 + 1.01 * s),
    ]
    assert states(space, *boxes) == [FREE, BLOCKED, MIXED]


@pytest.mark.parametrize("robot", [None, DiscRobot(0.2)])
@pytest.mark.parametrize("seed", range(4))
def test_samples_agree_with_what_is_proven(seed, robot):
    workspace = random_workspace(seed)
    space = PlaneSpace(workspace, robot) if robot else PlaneSpace(workspace)
    lo, hi = random_boxes(np.random.default_rng(seed), space.domain, 400)
    radius = space.robot.rounding
    state = check_classification(space, lambda q: keep_clear(workspace, shapely.points(q), radius), lo, hi, 9)
    assert set(state) == set(CellState)
    # Exact, but for a disc beside corners: compared with an obstacle grown by fine arcs.
    grown = workspace.free_space if robot is None else workspace.free_space.boundary.buffer(0.2, quad_segs=64)
    free = workspace.free_space if robot is None else workspace.free_space.difference(grown)
    boxes = shapely.box(*lo.T, *hi.T)
    share = shapely.area(shapely.intersection(boxes, free)) / shapely.area(boxes)
    assert (state[share > 1 - 1e-9] == FREE).all() or robot is not None
    assert (state[share > 1 - 1e-12] != BLOCKED).all()
    assert (state[(share > 1e-6) & (share < 0.99)] == MIXED).all()
    assert (state[shapely.distance(boxes, free) > 0.005 * 0.2] == BLOCKED).all()


@pytest.mark.parametrize("robot", [None, DISC])
def test_motions_are_those_that_validate_accepts(robot):
    workspace = Workspace(BOUNDS, [rectangle(1, 1, 2, 2)])
    space = PlaneSpace(workspace, robot) if robot else PlaneSpace(workspace)
    rng = np.random.default_rng(5)
    q = rng.uniform(0.3, (3.7, 2.7), (200, 2))
    q = q[space.is_free(q)]
    q0, q1 = q[: len(q) // 2], q[len(q) // 2 : 2 * (len(q) // 2)]
    problems = [Problem(workspace, [space.robot], [a], [b]) for a, b in zip(q0, q1, strict=True)]
    expected = [validate(p, np.stack([p.starts, p.goals])).valid for p in problems]
    free = space.are_free(q0, q1)
    assert free.tolist() == expected
    assert 0 < free.sum() < len(free)


@pytest.mark.parametrize("robot", [None, DiscRobot(0.2)])
def test_motions_are_free_where_their_samples_are(robot):
    workspace = random_workspace(7)
    space = PlaneSpace(workspace, robot) if robot else PlaneSpace(workspace)
    q0, q1 = np.random.default_rng(7).uniform(0, (4, 3), (2, 400, 2))
    radius = space.robot.rounding
    proven, sampled = check_motions(space, lambda q: keep_clear(workspace, shapely.points(q), radius), q0, q1, 257)
    assert (sampled & ~proven).sum() <= 2 and proven.sum() > 20


def test_what_is_not_finite_is_not_free():
    space = PlaneSpace(Workspace(BOUNDS), DISC)
    q = np.array([[1.0, 1.0], [np.nan, 1.0], [np.inf, 1.0], [-1.0, 1.0]])
    assert space.is_free(q).tolist() == [True, False, False, False]
    assert space.are_free(q[[0] * 4], q).tolist() == [True, False, False, False]


def test_bad_input_is_refused():
    workspace = Workspace(BOUNDS)
    space = PlaneSpace(workspace)
    with pytest.raises(ValueError, match="must be a Workspace"):
        PlaneSpace(BOUNDS)
    for robot in (BAR, WING, "disc"):
        with pytest.raises(ValueError, match=r"a point or a disc.*RigidBodySpace"):
            PlaneSpace(workspace, robot)
    with pytest.raises(ValueError, match="no free space"):
        PlaneSpace(workspace, DiscRobot(1.6))
    with pytest.raises(ValueError, match=r"q must have shape \(n, 2\)"):
        space.is_free([[0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="as many starts as ends"):
        space.are_free([[0.0, 0.0]], np.zeros((2, 2)))
    with pytest.raises(ValueError, match="as many lower corners"):
        space.classify([[0.0, 0.0]], np.ones((2, 2)))
    with pytest.raises(ValueError, match=r"hi nowhere below lo.*box 1"):
        space.classify([[0.0, 0.0], [1.0, 0.0]], [[1.0, 1.0], [0.0, 1.0]])
    with pytest.raises(ValueError, match="finite corners"):
        space.classify([[0.0, np.nan]], [[1.0, 1.0]])


def test_no_boxes_and_no_motions_are_fine():
    space, none = PlaneSpace(Workspace(BOUNDS)), np.zeros((0, 2))
    assert space.classify(none, none).shape == space.is_free(none).shape == space.are_free(none, none).shape == (0,)


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
