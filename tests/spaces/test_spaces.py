"""Properties of every configuration space: boxes and motions, compared with dense samples of an independent twin."""

import itertools
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from robot_helpers import BAR, PEBBLE, POINT, WING, AnyShape, shapes
from space_helpers import check_classification, check_motions, keep_clear, of_drone, random_boxes, random_workspace
from voxel_helpers import clearances

from plr_jax import Box, ClearanceSpace, DiscRobot, PlanarArm, RectangleRobot, RigidBodySpace, Workspace
from plr_jax.spaces import CellState, ConfigurationSpace, FreeTest, MotionCost, PlaneSpace, VoxelSpace

BLOCKED, FREE, MIXED = CellState
PI = np.pi
BODIES = {
    "point": POINT,
    "disc": DiscRobot(0.2),
    "bar": BAR,
    "wing": WING,
    "pebble": PEBBLE,
    "stadium": AnyShape(((-0.1, 0.0), (0.5, 0.0)), rounding=0.1),
    "off center": AnyShape(((0.1, -0.1), (0.5, -0.1), (0.5, 0.1), (0.1, 0.1)), rounding=0.15),
    "needle": RectangleRobot(1.0, 0.02),
}
ARMS = {  # seed, joints, width of links, whether links collide with one another
    "one joint": (0, 1, 0.0, False),
    "two joints": (0, 2, 0.0, False),
    "wide links": (1, 2, 0.1, False),
    "three joints": (0, 3, 0.05, False),
    "self-collision": (1, 3, 0.1, True),
}
BALLS = {"ball 1": (1, 0.4), "ball 2": (2, 1.3), "ball 3": (3, 0.3), "large ball 3": (3, 0.8), "ball 4": (4, 0.35)}


def random_arm(seed, joints, width, self_collision):
    """Return an arm on a base with room, in a random workspace."""
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    base = workspace.sample_free(200, seed)
    base = base[np.argmax(workspace.clearance(base))]
    return PlanarArm(workspace, rng.uniform(1.0, 2.0, joints) / joints, base, width, self_collision)


def arm_is_free(arm, q):
    """Test an arm's configurations: links one after the other, by complex numbers, as lines of Shapely."""
    position, turn, links = np.full(len(q), complex(*arm.base)), np.ones(len(q), complex), []
    for length, angle in zip(arm.lengths, q.T, strict=True):
        turn = turn * np.exp(1j * angle)
        ends = np.stack([position, position + length * turn], axis=1)
        links.append(shapely.linestrings(np.stack([ends.real, ends.imag], axis=2)))
        position = ends[:, 1]
    free = np.all([keep_clear(arm.workspace, link, arm.width / 2) for link in links], axis=0)
    if arm.self_collision:
        for a, b in itertools.combinations(range(len(links)), 2):
            free &= (b - a < 2) | (shapely.distance(links[a], links[b]) >= arm.width - 1e-8)
    return free


@cache
def space_of(name):
    """Return a space, an independent test of configurations, and how many samples an axis to take of a box."""
    if name in BODIES:
        robot, workspace = BODIES[name], random_workspace(len(name) % 2)
        space = PlaneSpace(workspace, robot) if robot.dof == 2 else RigidBodySpace(workspace, robot)
        return space, lambda q: keep_clear(workspace, shapes(robot, q), robot.rounding), 9 if robot.dof == 2 else 4
    if name in ARMS:
        arm = random_arm(*ARMS[name])
        return arm, lambda q: arm_is_free(arm, q), {1: 33, 2: 9, 3: 4}[arm.dof]
    if name == "drone":
        return ClearanceSpace(((0, 0, 0), (4, 4, 3)), of_drone, 1), lambda q: of_drone(q) >= 0, 4
    dim, radius = BALLS[name]
    free = np.random.default_rng(dim).random([12, 12, 8, 4][:dim]) > (0.06 if radius > 0.5 else 0.15)
    return VoxelSpace(free, radius=radius), lambda q: clearances(free, q) >= radius - 1e-9, 3


SPACES = [*BODIES, *ARMS, *BALLS, "drone"]


@pytest.mark.parametrize("name", SPACES)
def test_samples_agree_with_states_of_boxes(name):
    space, is_free, per_axis = space_of(name)
    lo, hi = random_boxes(np.random.default_rng(0), space.domain, 150)
    state = check_classification(space, is_free, lo, hi, per_axis)
    assert set(state) == set(CellState)
    if not isinstance(space, VoxelSpace | ClearanceSpace):
        # Headings and angles count modulo a full turn.
        shift = np.where(space.domain.periodic, 2 * PI, 0.0)
        for turns in (-2, 1):
            assert (space.classify(lo + turns * shift, hi + turns * shift) == state).mean() > 0.99


@pytest.mark.parametrize("name", [*list(BODIES)[2:], *ARMS])
def test_most_small_boxes_are_not_mixed(name):
    """No box a thousandth wide is blocked if its center is free, or free if its center is blocked."""
    space, is_free, _ = space_of(name)
    q = np.random.default_rng(1).uniform(space.domain.lo, space.domain.hi, (200, space.domain.dim))
    state, free = space.classify(q - 5e-4, q + 5e-4), is_free(q)
    assert (state == MIXED).mean() < 0.1 and (state[free] != BLOCKED).all() and (state[~free] != FREE).all()
    assert (space.is_free(q) == free).all() and len(set(free)) == 2


QUICK = {"point", "disc", "bar", "off center", "needle", "two joints", "self-collision", "ball 2", "ball 3", "drone"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.full) for n in SPACES])
def test_samples_agree_with_free_motions(name):
    space, is_free, _ = space_of(name)
    rng, domain = np.random.default_rng(5), space.domain
    q0 = domain.lo + rng.random((100, domain.dim)) * domain.width
    turned, moved = q0 + rng.uniform(-1.5, 1.5, q0.shape), q0 + rng.normal(0, 0.5, q0.shape)
    q1 = np.where(domain.periodic, turned, np.clip(moved, domain.lo, domain.hi))
    proven, sampled = check_motions(space, is_free, q0, q1)
    assert (sampled & ~proven).sum() <= 2 and proven.sum() >= 2


OPEN = Workspace(((-4, -4), (4, 4)))
TURNING = Box((-4, -4, -PI), (4, 4, PI), (False, False, True))
TORUS = Box((-PI,) * 3, (PI,) * 3, (True,) * 3)
VOXELS = np.ones((2, 2), bool)
PLANE_BLOCKS = (((0, 1), 1.0),)
ATTRIBUTES = {  # spaces, their domains, and the blocks of their motion costs
    "plane": (PlaneSpace(OPEN), OPEN.bounds, PLANE_BLOCKS),
    "body": (RigidBodySpace(OPEN, BAR), TURNING, (((0, 1), 1.0), ((2,), np.hypot(0.45, 0.15)))),
    "weighted body": (RigidBodySpace(OPEN, BAR, 2), TURNING, (((0, 1), 1.0), ((2,), 2.0))),
    "arm": (PlanarArm(OPEN, [1, 0.5, 0.5], (0, 0), 0.1, True), TORUS, (((0, 1, 2), 1.0),)),
    "clearance": (ClearanceSpace(OPEN.bounds, lambda q: np.ones(len(q)), 1), OPEN.bounds, PLANE_BLOCKS),
    "voxels": (VoxelSpace(VOXELS, OPEN.bounds), OPEN.bounds, PLANE_BLOCKS),
    "ball": (VoxelSpace(VOXELS, OPEN.bounds, 1), OPEN.bounds, PLANE_BLOCKS),
}


@pytest.mark.parametrize(("space", "domain", "blocks"), ATTRIBUTES.values(), ids=ATTRIBUTES)
@pytest.mark.usefixtures("unchecked_types")
def test_spaces_check_arguments_and_state_domain_and_cost(space, domain, blocks):
    assert isinstance(space, ConfigurationSpace) and isinstance(space, FreeTest)
    assert space.domain == domain and space.motion_cost == MotionCost(blocks)
    none = np.zeros((0, domain.dim))
    assert space.classify(none, none).shape == space.is_free(none).shape == space.are_free(none, none).shape == (0,)
    # Configurations that are not finite, or outside, are not free.
    q = np.zeros((4, domain.dim))
    q[1, 0], q[2, -1], q[3, 0] = np.nan, np.inf, 4.1
    expected = [True, False, False, domain.periodic[0]]
    assert space.is_free(q).tolist() == expected and space.are_free(q[[0] * 4], q).tolist() == expected
    one, two = np.zeros((1, domain.dim)), np.ones((2, domain.dim))
    for method, arguments, message in (
        ("is_free", [np.zeros((1, domain.dim + 1))], r"q must have shape \(n, "),
        ("are_free", [one, two], "as many starts as ends"),
        ("classify", [one, two], "as many lower corners"),
        ("classify", [two, two * [[1], [0]]], r"hi nowhere below lo.*box 1"),
        ("classify", [one * np.nan, one], "finite corners"),
        ("classify", [np.zeros((1, domain.dim + 1))] * 2, r"lo must have shape \(n, "),
    ):
        with pytest.raises(ValueError, match=message):
            getattr(space, method)(*arguments)


SHIP = Box((0, 0, -np.pi), (4, 3, np.pi), periodic=(False, False, True))


def test_motion_costs_are_weighted_lengths_of_blocks():
    cost = MotionCost((((0, 1), 2.0), ((2,), 0.5)))
    q0 = np.array([[0.0, 0, 0], [1, 1, 3], [1, 1, 3], [0, 0, 0]])
    q1 = np.array([[3.0, 4, 0], [1, 1, -3], [1, 2, 3 - 20 * np.pi], [0, np.nan, 0]])
    expected = [10, 0.5 * (2 * np.pi - 6), 2, np.nan]
    np.testing.assert_allclose(cost.lengths(q0, q1, SHIP), expected, atol=1e-12)
    np.testing.assert_array_equal(cost.scale, [2, 2, 0.5])
    assert cost.dof == 3 and cost.lengths(q0[:0], q1[:0], SHIP).shape == (0,)
    with pytest.raises(ValueError, match="A cost of 2 axes"):
        MotionCost((((0, 1), 1.0),)).lengths([[0.0, 0.0]], [[1.0, 1.0]], SHIP)


@pytest.mark.parametrize("axis", range(3))
def test_motion_costs_of_infinite_ends_are_infinite(axis):
    cost = MotionCost((((0, 1), 2.0), ((2,), 0.5)))
    for one, other in itertools.product([0.0, np.inf, -np.inf, np.nan], repeat=2):
        ends = np.zeros((2, 1, 3))
        ends[:, 0, axis] = one, other
        expected = np.nan if np.isnan([one, other]).any() else np.inf if np.isinf([one, other]).any() else 0.0
        np.testing.assert_array_equal(cost.lengths(*ends, SHIP), expected)


def test_motions_go_around_periodic_axes_only():
    cost = MotionCost((((0,), 1.0),))
    lengths = [cost.lengths([[0.1]], [[0.9]], Box((0,), (1,), (wraps,)))[0] for wraps in (False, True)]
    np.testing.assert_allclose(lengths, [0.8, 0.2])


def test_blocks_of_motion_costs_compare_by_value():
    cost = MotionCost([[[1, 0], 1], [np.array([2]), np.float64(3)]])
    assert cost == MotionCost((((1, 0), 1.0), ((2,), 3.0))) and len({cost, cost}) == 1


WALL = Workspace(((0, 0), (4, 3)), [shapely.box(1, 0, 1.5, 3)])


@pytest.mark.parametrize(
    ("space", "largest"),  # the first coordinate of points that the goal joins
    [
        (PlaneSpace(WALL), 1),
        (PlaneSpace(Workspace(WALL.bounds, [shapely.box(1, 0, 2, 1), shapely.box(1, 1.3, 2, 3)]), DiscRobot(0.2)), 1),
        (RigidBodySpace(WALL, RectangleRobot(0.4, 0.2)), 1),
        (VoxelSpace([True, False, True, True], ((0,), (4,))), 1),
    ],
)
def test_separated_spaces_hold_the_points_that_a_goal_joins_and_the_others(space, largest):
    domain, rng = space.domain, np.random.default_rng(0)
    goal = np.append(0.5, np.ones(domain.dim - 1))[None]
    joined, rest = space.separated(goal)
    x, (lo, hi) = rng.uniform(domain.lo, domain.hi, (2000, domain.dim)), random_boxes(rng, domain, 500)
    is_free, is_joined = space.is_free(x), x[:, 0] <= largest
    np.testing.assert_array_equal(joined.is_free(x), is_free & is_joined)
    np.testing.assert_array_equal(rest.is_free(x), is_free & ~is_joined)
    states, (here, there) = space.classify(lo, hi), (part.classify(lo, hi) for part in (joined, rest))
    assert ((here == CellState.BLOCKED) | (there == CellState.BLOCKED) | (states == CellState.MIXED)).all()
    assert (np.where(lo[:, 0] < largest, here, there) == states)[(states == CellState.FREE)].all()


def test_a_goal_in_a_corner_is_in_both_voxels_that_touch_there():
    corner, (joined, rest) = [[1.0, 1.0]], VoxelSpace(np.eye(2, dtype=bool)).separated([[0.5, 0.5]])
    assert joined.is_free(corner) and rest.is_free(corner)
    assert VoxelSpace(np.eye(2, dtype=bool)).separated(corner)[1] is None  # a goal in the corner is in both


def test_minimal_space_satisfies_free_test_protocol():
    ring = SimpleNamespace(domain=TURNING, motion_cost=MotionCost(PLANE_BLOCKS), is_free=lambda q: q[:, 0] > 1)
    assert isinstance(ring, FreeTest) and not isinstance(ring, ConfigurationSpace)
