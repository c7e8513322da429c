import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from space_helpers import CENTERS, RADII, check_classification, check_motions, of_drone, random_boxes, states

from plr_jax import Box, CellState, ClearanceSpace, MotionCost, PlanarArm, Workspace, solve_eikonal

BLOCKED, FREE, MIXED = CellState
PI = np.pi
HALL = Box((0, 0, 0), (4, 4, 3))
DRONE = ClearanceSpace(HALL, of_drone, 1)


def keep_off_spheres(q0, q1):
    """Return whether segments keep 0.2 off every sphere, by the nearest point of each segment."""
    along = q1 - q0
    to_center = CENTERS - q0[:, None]
    share = np.clip(np.sum(to_center * along[:, None], axis=2) / np.sum(along**2, axis=1)[:, None], 0, 1)
    gap = np.linalg.norm(to_center - share[..., None] * along[:, None], axis=2) - RADII
    return (gap > 0.2 + 1e-9).all(axis=1)


# An arm of two joints among discs.
DISCS = np.array([[0.9, 0.9, 0.3], [-1.2, 0.4, 0.25], [0.3, -1.4, 0.4]])
LENGTHS = np.array([1.0, 0.8])


def of_arm(q):
    """Return the clearance of an arm: the distance of its links, as segments, to the discs."""
    heading = np.cumsum(q, axis=1)
    links = LENGTHS[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=2)
    ends = np.concatenate([np.zeros((len(q), 1, 2)), np.cumsum(links, axis=1)], axis=1)
    to_center = DISCS[:, None, :2] - ends[:, None, :-1]  # (n, discs, links, 2)
    share = np.clip(np.sum(to_center * links[:, None], axis=3) / LENGTHS**2, 0, 1)
    gap = np.linalg.norm(to_center - share[..., None] * links[:, None], axis=3) - DISCS[:, None, 2]
    return gap.min(axis=(1, 2))


TURNS = Box((-PI, -PI), (PI, PI), periodic=(True, True))
ARM = ClearanceSpace(TURNS, of_arm, [LENGTHS.sum(), LENGTHS[1]])


def planar_arm(scale):
    """Return the arm among polygons of 64 sides, inscribed in circles of scaled radii."""
    discs = [shapely.Point(x, y).buffer(scale * r, quad_segs=16) for x, y, r in DISCS]
    return PlanarArm(Workspace(((-4, -4), (4, 4)), discs), LENGTHS, (0, 0))


WITHIN, AROUND = planar_arm(1.0), planar_arm(1.0 / np.cos(PI / 64))  # polygons in the discs, and around the discs


def test_motions_cost_their_length_by_default():
    assert DRONE.motion_cost == MotionCost((((0, 1, 2), 1.0),))
    np.testing.assert_array_equal(DRONE.lipschitz, [1, 1, 1])
    costly = MotionCost((((0, 1), 1.0), ((2,), 3.0)))
    assert ClearanceSpace(HALL, of_drone, 1, costly).motion_cost == costly


def test_touching_is_free_and_outside_is_not():
    line = ClearanceSpace(((0,), (4,)), lambda q: q[:, 0] - 1, 1)
    q = np.array([[1.0], [0.99], [4.0], [4.01], [-0.1], [np.nan], [np.inf]])
    assert line.is_free(q).tolist() == [True, False, True, False, False, False, False]
    assert line.are_free(np.full((7, 1), 3.0), q).tolist() == [False, False, True, False, False, False, False]


def test_states_of_boxes_computed_by_hand():
    line = ClearanceSpace(((0, 0), (4, 4)), lambda q: q[:, 0] - 1, [1, 0])
    boxes = [((1.1, 0), (2, 4)), ((0, 0), (0.9, 4)), ((0.9, 0), (1.1, 1)), ((1.0, 0), (2, 1)), ((2, 3), (3, 5))]
    assert states(line, *boxes) == [FREE, BLOCKED, MIXED, MIXED, MIXED]
    assert states(line, ((5, 0), (6, 1)), ((3.0, 1), (3.0, 1)), ((0.5, 1), (0.5, 3))) == [BLOCKED, FREE, BLOCKED]


def test_free_motions_keep_clear_of_spheres():
    rng = np.random.default_rng(0)
    q0, q1 = HALL.lo + rng.random((2, 1000, 3)) * HALL.width
    proven, _ = check_motions(DRONE, lambda q: of_drone(q) >= 0, q0, q1)
    assert keep_off_spheres(q0, q1)[proven].all()
    assert (proven == keep_off_spheres(q0, q1)).mean() > 0.995 and proven.mean() > 0.35


def test_motions_close_along_obstacles_are_proven_free():
    for gap, expected in ((0.01, True), (0.004, True), (0.001, False), (0.0, False)):
        q0, q1 = [[0.0, gap]], [[4.0, gap]]
        assert ClearanceSpace(((0, 0), (4, 4)), lambda q: q[:, 1], 1).are_free(q0, q1)[0] == expected


def test_clearance_of_arm_agrees_with_planar_arm():
    rng = np.random.default_rng(1)
    q = rng.uniform(-PI, PI, (1000, 2))
    free = ARM.is_free(q)
    assert (WITHIN.is_free(q) | ~free).all() and (~AROUND.is_free(q) | free).all() and 0.2 < free.mean() < 0.9
    lo, hi = random_boxes(rng, TURNS, 800)
    state, within, around = (space.classify(lo, hi) for space in (ARM, WITHIN, AROUND))
    assert not ((state == FREE) & (within == BLOCKED)).any() and not ((state == BLOCKED) & (around == FREE)).any()
    check_classification(ARM, ARM.is_free, lo[:300], hi[:300], per_axis=5)
    assert (state != MIXED).mean() > 0.65 * (within != MIXED).mean()
    q0, q1 = q[:500], np.where(rng.random((500, 1)) < 0.5, q[500:], q[:500] + rng.normal(0, 0.5, (500, 2)))
    proven, _ = check_motions(ARM, ARM.is_free, q0, q1)
    assert WITHIN.are_free(q0, q1)[proven].mean() > 0.99
    assert (proven == AROUND.are_free(q0, q1)).mean() > 0.98


def test_angles_count_modulo_full_turns():
    q = np.array([[3.0, 0.1], [-3.0, 0.2]])
    np.testing.assert_array_equal(ARM.is_free(q), ARM.is_free(q + np.array([2 * PI, -6 * PI])))
    assert states(ARM, ((3.0, -0.1), (3.05, 0.1))) == states(ARM, ((3.0 - 4 * PI, -0.1), (3.05 - 4 * PI, 0.1)))
    seam = ClearanceSpace(TURNS, lambda q: np.abs(q[:, 0]) - 2, 1)
    assert seam.are_free([[3.0, 0]], [[-3.0, 0]])[0] and states(seam, ((3.0, 0), (3.3, 1))) == [FREE]


def around_a_sphere(x, goal, center, radius):
    """Return lengths of shortest paths around a sphere: two tangents and an arc, in a plane through its center."""
    a, b = x - center, goal - center
    far, near = np.linalg.norm(a, axis=1), np.linalg.norm(b)
    angle = np.arccos(np.clip(a @ b / (far * near), -1, 1)) - np.arccos(radius / far) - np.arccos(radius / near)
    tangents = np.sqrt(far**2 - radius**2) + np.sqrt(near**2 - radius**2)
    return np.where(angle > 0, tangents + radius * angle, np.linalg.norm(x - goal, axis=1))


@pytest.mark.full
def test_solver_bounds_contain_path_length_around_sphere():
    center, goal = np.array([2, 2, 1.5]), np.array([0.4, 1.9, 1.4])
    space = ClearanceSpace(HALL, lambda q: np.linalg.norm(q - center, axis=1) - 0.8, 1)
    plr = solve_eikonal(space, goal, max_leaves=600)
    x = HALL.lo + np.random.default_rng(3).random((4000, 3)) * HALL.width
    x = x[space.is_free(x)]
    distance = around_a_sphere(x, goal, center, 0.8)
    lower, upper = map(np.asarray, plr.bounds(x))
    assert (distance > np.linalg.norm(x - goal, axis=1) + 1e-9).mean() > 0.1
    assert (lower <= distance + 1e-6).all() and (distance <= upper + 1e-6).all()
    assert (lower > 0.5 * distance).mean() > 0.7 and np.isfinite(upper).mean() > 0.2


def test_clearances_of_32_bits_allow_for_rounding():
    def in_single(q):
        return jnp.linalg.norm(jnp.asarray(q, jnp.float32) - 1e3, axis=1) - 1.0

    space = ClearanceSpace(((1e3, 1e3), (1e3 + 4, 1e3 + 4)), in_single, 1)
    lo = np.array([[1e3 + 1, 1e3], [1e3 + 1.1, 1e3]])
    assert space.classify(lo, lo + 1e-5).tolist() == [MIXED, FREE]
    assert space.are_free(lo, lo + np.array([1, 0])).tolist() == [False, True]


@pytest.mark.parametrize(("lipschitz", "axis"), [([1.0, 1.0, 0.2], 2), (0.4, r"\d"), ([0.0, 1.0, 1.0], 0)])
def test_too_small_lipschitz_constants_raise(lipschitz, axis):
    space = ClearanceSpace(HALL, of_drone, lipschitz)
    lo, hi = random_boxes(np.random.default_rng(5), HALL, 200, 3)
    with pytest.raises(ValueError, match=r"lipschitz must bound how fast the clearance changes, .* is .* at \["):
        space.are_free(lo, hi)
    with pytest.raises(ValueError, match=rf"at \[.* and .* at \[.*Axis {axis} needs at least 0\.\d+\.$"):
        space.classify(lo, hi)
    with pytest.raises(ValueError, match=f"Axis {axis} needs"):
        solve_eikonal(space, (0.1, 0.1, 0.1), max_leaves=500)


def test_errors_name_the_least_lipschitz_constants():
    steep = ClearanceSpace(((0, 0), (4, 4)), lambda q: 3 * q[:, 0] - q[:, 1], [1, 0.5])
    with pytest.raises(ValueError) as error:
        steep.are_free([[1.0, 1.0]], [[2.0, 0.5]])
    assert str(error.value).endswith(
        "clearance is 2 at [1.0, 1.0] and 5.5 at [2.0, 0.5]: they differ by 3.5, where [1.0, 0.5] allows 1.25. Raise "
        "the constant of one axis to at least: axis 0 3.25, or axis 1 5; or those of all axes to 2.33333."
    )
    with pytest.raises(ValueError, match=r"differ by 3, where .* allows 1\. Axis 0 needs at least 3\.$"):
        steep.are_free([[1.0, 1.0]], [[2.0, 1.0]])
    # Exact constants raise no error.
    tight = ClearanceSpace(((0, 0), (4, 4)), lambda q: 3 * q[:, 0] - q[:, 1], [3, 1])
    lo, hi = random_boxes(np.random.default_rng(6), tight.domain, 2000, 20)
    assert (np.bincount(tight.classify(lo, hi), minlength=3) > 100).all() and tight.are_free(lo, hi).any()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"domain": 3}, r"domain must be a Box or its corners \(lo, hi\), got 3"),
        ({"clearance": 3}, r"clearance must be a function of configurations \(n, dof\), got 3"),
        ({"clearance": lambda q: q}, r"clearance must give one number per point, shape \(1,\), got \(1, 3\)"),
        ({"clearance": lambda q: q[:, 0] * np.nan}, r"clearance must return finite numbers, got nan at \[0.0, 0.0"),
        ({"lipschitz": -1.0}, "lipschitz must be a finite number of at least 0, got -1.0"),
        ({"lipschitz": [1, 1, -1]}, r"lipschitz must be at least 0 along each axis, got \[1.0, 1.0, -1.0\]"),
        ({"lipschitz": [1, 1]}, r"lipschitz must be one point of shape \(3,\), got shape \(2,\)"),
        ({"lipschitz": np.inf}, "lipschitz must be a finite number"),
        ({"lipschitz": None}, "lipschitz must be a finite number of at least 0, got None"),
        ({"motion_cost": MotionCost((((0, 1), 1.0),))}, "motion_cost must be a MotionCost of 3 axes, as the domain"),
        ({"motion_cost": 1.0}, "motion_cost must be a MotionCost of 3 axes, as the domain has, got 1.0"),
    ],
)
def test_invalid_arguments_raise(changed, message):
    with pytest.raises(ValueError, match=message):
        ClearanceSpace(**{"domain": HALL, "clearance": of_drone, "lipschitz": 1.0} | changed)


def test_infinite_clearance_raises():
    space = ClearanceSpace(HALL, lambda q: np.where(q[:, 0] > 2, np.inf, 1.0), 1.0)
    with pytest.raises(ValueError, match=r"clearance must return finite numbers, got inf at \[3.0, 0.5, 0.5\]"):
        space.is_free([[1.0, 0.5, 0.5], [3.0, 0.5, 0.5]])
