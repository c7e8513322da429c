import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import BAR, DISC, PEBBLE, WING, AnyShape, random_motions, shapes, sled
from space_helpers import (
    BOUNDS,
    check_classification,
    check_motions,
    keep_clear,
    random_boxes,
    random_workspace,
    rectangle,
    states,
)

from plr_jax import CellState, RectangleRobot, RigidBodySpace, Workspace

BLOCKED, FREE, MIXED = CellState
STADIUM = AnyShape(((-0.1, 0.0), (0.5, 0.0)), rounding=0.1)
OFF_CENTER = AnyShape(((0.1, -0.1), (0.5, -0.1), (0.5, 0.1), (0.1, 0.1)), rounding=0.15)
NEEDLE = RectangleRobot(1.0, 0.02)
BODIES = {"bar": BAR, "wing": WING, "pebble": PEBBLE, "stadium": STADIUM, "off center": OFF_CENTER, "needle": NEEDLE}
OPEN = Workspace(BOUNDS)
TUNNEL = Workspace(BOUNDS, [rectangle(0.5, 0, 3.5, 1.25), rectangle(0.5, 1.75, 3.5, 3)])


def twin(workspace, robot):
    return lambda q: keep_clear(workspace, shapes(robot, q), robot.rounding)


ANY = np.pi
AHEAD = rectangle(1, 0.5, 2, 2.5)


@pytest.mark.parametrize(
    ("obstacles", "boxes", "expected"),
    [
        # 0.9 by 0.3 in a tunnel 0.5 wide: it lies along, across, either; in the walls.
        (TUNNEL.obstacles, [(1.5, 1.48, -0.05, 2.5, 1.52, 0.05), (1.5, 1.4, 1.4, 1.6, 1.6, 1.7)], [FREE, BLOCKED]),
        (TUNNEL.obstacles, [(0, 0, -ANY, 4, 3, ANY), (1.5, 1.4, 0, 1.6, 1.6, 1.7)], [MIXED, MIXED]),
        (TUNNEL.obstacles, [(0.02, 0.02, -ANY, 0.1, 0.1, ANY), (1.5, 0.5, -9, 1.6, 0.6, 9)], [BLOCKED, BLOCKED]),
        # Room all around is free for every heading; beyond the bounds there is none.
        ([], [(1, 1, -ANY, 3, 2, ANY), (0.5, 0.5, -9, 3.5, 2.5, 9)], [FREE, FREE]),
        ([], [(4.1, 1, -ANY, 4.2, 1.1, ANY), (3.95, 1, -ANY, 4, 1.1, ANY)], [BLOCKED, BLOCKED]),
        # Two walls that touch block what each alone would not, a thin one what stands in it.
        ([AHEAD, AHEAD + np.array([1, 0])], [(1.6, 1.2, -ANY, 2.4, 1.8, ANY)], [BLOCKED]),
        ([rectangle(2, 0, 2 + 1e-6, 3)],
         [(1.98, 1, -0.05, 2.02, 1.04, 0.05), (1.5, 1, 1.5, 1.55, 1.1, 1.6), (1, 1, -ANY, 3, 2, ANY)],
         [BLOCKED, FREE, MIXED])
    ],
    ids=range(7)
)  # fmt: skip
def test_boxes_of_a_bar_drawn_by_hand(obstacles, boxes, expected):
    assert states(RigidBodySpace(Workspace(BOUNDS, obstacles), BAR), *boxes) == expected


def test_headings_are_the_same_after_a_full_turn():
    workspace, rng = random_workspace(3), np.random.default_rng(3)
    space = RigidBodySpace(workspace, WING)
    lo, hi = random_boxes(rng, space.domain, 300)
    state = space.classify(lo, hi)
    assert len(set(state)) == 3
    for turns in (-1, 2):
        shift = np.array([0, 0, 2 * np.pi * turns])
        assert (space.classify(lo + shift, hi + shift) == state).mean() > 0.99
        check_classification(space, twin(workspace, WING), lo + shift, hi + shift, 4)
    assert (space.is_free(lo) == space.is_free(lo + np.array([0, 0, 2 * np.pi]))).all()


def test_turns_go_the_shorter_way_over_the_seam():
    space = RigidBodySpace(TUNNEL, BAR)
    q0, q1 = np.array([[2.0, 1.5, np.pi - 0.1]]), np.array([[2.2, 1.5, 0.1 - np.pi]])
    assert space.are_free(q0, q1)[0]
    assert not space.are_free(q0, [[2.2, 1.5, 0.2]])[0]
    np.testing.assert_allclose(space.motion_cost.lengths(q0, q1, space.domain), 0.2 + 0.2 * np.hypot(0.45, 0.15))


@pytest.mark.parametrize("body", BODIES)
def test_samples_agree_with_what_is_proven(body):
    workspace, robot = random_workspace(len(body) % 2), BODIES[body]
    space = RigidBodySpace(workspace, robot)
    lo, hi = random_boxes(np.random.default_rng(0), space.domain, 600)
    state = check_classification(space, twin(workspace, robot), lo, hi, 5)
    assert set(state) == set(CellState)


@pytest.mark.full
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(sorted(BODIES)))
def test_random_boxes_beside_walls(seed, body):
    workspace, robot = random_workspace(seed % 7), BODIES[body]
    rng = np.random.default_rng(seed)
    walls = shapely.get_coordinates(shapely.segmentize(workspace.free_space.boundary, 0.2))
    center = np.column_stack([rng.choice(walls, 50) + rng.normal(0, 0.3, (50, 2)), rng.uniform(-9, 9, 50)])
    half = rng.choice([0.0, 0.01, 0.1, 0.5], (50, 3))
    check_classification(RigidBodySpace(workspace, robot), twin(workspace, robot), center - half, center + half, 4)


@pytest.mark.full
@pytest.mark.parametrize("body", BODIES)
def test_small_boxes_are_told(body):
    """Of boxes a thousandth wide most are free or blocked, and none is blocked the center of which is free."""
    workspace, robot = random_workspace(1), BODIES[body]
    space = RigidBodySpace(workspace, robot)
    q = np.random.default_rng(1).uniform(space.domain.lo, space.domain.hi, (400, 3))
    state = space.classify(q - 5e-4, q + 5e-4)
    free = twin(workspace, robot)(q)
    assert (state == MIXED).mean() < 0.1 and (state[free] != BLOCKED).all() and (state[~free] != FREE).all()


@pytest.mark.parametrize("body", BODIES)
def test_motions_are_free_where_their_samples_are(body):
    workspace, robot = random_workspace(5), BODIES[body]
    space = RigidBodySpace(workspace, robot)
    q0, q1 = random_motions(np.random.default_rng(5), 400, 3, 0.3, 2)
    proven, sampled = check_motions(space, twin(workspace, robot), q0, q1, 129)
    assert (sampled & ~proven).sum() <= 2 and proven.sum() >= 5


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("workspace", "robot", "options", "message"),
    [
        *((OPEN, robot, (), r"must have a heading.*PlaneSpace") for robot in (DISC, sled(), "bar")),
        (OPEN, AnyShape(((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))), (), "convex"),
        *((OPEN, BAR, (w,), "rotation_weight must be a positive finite number") for w in (0, -1.0, np.inf)),
        (None, BAR, (), "must be a Workspace"),
    ],
)
def test_bad_input_is_refused(workspace, robot, options, message):
    with pytest.raises(ValueError, match=message):
        RigidBodySpace(workspace, robot, *options)
