import jax.numpy as jnp
import numpy as np
import pytest
from eikonal_helpers import check_between, use_few_nodes
from space_helpers import of_drone, random_boxes, states

from plr_jax import Box, ClearanceSpace, solve_eikonal
from plr_jax.spaces import CellState, MotionCost

BLOCKED, FREE, MIXED = CellState
PI = np.pi
HALL = Box((0, 0, 0), (4, 4, 3))
DRONE = ClearanceSpace(HALL, of_drone, 1)


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


def test_motions_close_along_obstacles_are_proven_free():
    for gap, expected in ((0.01, True), (0.004, True), (0.001, False), (0.0, False)):
        q0, q1 = [[0.0, gap]], [[4.0, gap]]
        assert ClearanceSpace(((0, 0), (4, 4)), lambda q: q[:, 1], 1).are_free(q0, q1)[0] == expected


def test_motions_and_boxes_cross_the_seam_of_periodic_axes():
    space = ClearanceSpace(Box((-PI, -PI), (PI, PI), (True, True)), lambda q: np.abs(q[:, 0]) - 2, 1)
    assert space.are_free([[3.0, 0]], [[-3.0, 0]])[0] and not space.are_free([[2.5, 0]], [[0.5, 0]])[0]
    turns = 2 * PI * np.arange(-3, 3)
    assert space.is_free(np.column_stack([3.0 + turns, turns])).all()
    for turn in turns:
        assert states(space, ((3.0 + turn, 0), (3.3 + turn, 1)), ((turn, 0), (1 + turn, 1))) == [FREE, BLOCKED]


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


@pytest.mark.filterwarnings("ignore:At .* of the corners of cells")  # few leaves
def test_solver_bounds_contain_lengths_around_a_sphere(monkeypatch):
    use_few_nodes(monkeypatch)
    center, goal, r = np.array([2, 2, 1.5]), np.array([0.4, 1.9, 1.4]), 0.8
    space = ClearanceSpace(HALL, lambda q: np.linalg.norm(q - center, axis=1) - r, 1)
    x = np.random.default_rng(3).random((2000, 3)) * HALL.width
    x = x[space.is_free(x)]
    far, near = np.linalg.norm(x - center, axis=1), np.linalg.norm(goal - center)
    angle = np.arccos((x - center) @ (goal - center) / (far * near)) - np.arccos(r / far) - np.arccos(r / near)
    around = np.sqrt(far**2 - r**2) + np.sqrt(near**2 - r**2) + r * angle
    distance = np.where(angle > 0, around, np.linalg.norm(x - goal, axis=1))
    _, lower, upper = check_between(solve_eikonal(space, goal, max_leaves=200), x, distance, 1e-6)
    assert (angle > 0).mean() > 0.1 and (lower > 0.5 * distance).all() and np.isfinite(upper).mean() > 0.05


@pytest.mark.parametrize("corner", [(1e-3, 0.1, 7.0), (-1e6, -0.3, -1e-9), (-PI, 1e5, 123.4)])
def test_cells_at_faces_of_any_domain_are_inside(corner, monkeypatch):
    use_few_nodes(monkeypatch)
    lo = np.array(corner)
    space = ClearanceSpace((lo, lo + np.array([0.1, 1e3, 1.7])), lambda q: np.ones(len(q)), 0)
    assert np.isfinite(solve_eikonal(space, lo, max_leaves=8).max_error)
