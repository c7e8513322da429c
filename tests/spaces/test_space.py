import numpy as np
import pytest
from robot_helpers import BAR

from plr_jax import Box, ConfigurationSpace, FreeTest, MotionCost, PlanarArm, PlaneSpace, RigidBodySpace, Workspace

OPEN = Workspace(((-4, -4), (4, 4)))
ARM = PlanarArm(OPEN, [1, 0.5, 0.5], (0, 0), 0.1, self_collision=True)
PI = np.pi
SPACES = {  # and what their domains and costs are
    "plane": (PlaneSpace(OPEN), OPEN.bounds, (((0, 1), 1.0),)),
    "body": (RigidBodySpace(OPEN, BAR), Box((-4, -4, -PI), (4, 4, PI), (False, False, True)),
             (((0, 1), 1.0), ((2,), np.hypot(0.45, 0.15)))),
    "weighted body": (RigidBodySpace(OPEN, BAR, 2), Box((-4, -4, -PI), (4, 4, PI), (False, False, True)),
                      (((0, 1), 1.0), ((2,), 2.0))),
    "arm": (ARM, Box((-PI,) * 3, (PI,) * 3, (True,) * 3), (((0, 1, 2), 1.0),)),
}  # fmt: skip


@pytest.mark.parametrize(("space", "domain", "blocks"), SPACES.values(), ids=SPACES)
def test_what_all_spaces_have_in_common(space, domain, blocks):
    assert isinstance(space, ConfigurationSpace) and isinstance(space, FreeTest)
    assert space.domain == domain and space.motion_cost == MotionCost(blocks)
    none = np.zeros((0, domain.dim))
    assert space.classify(none, none).shape == space.is_free(none).shape == space.are_free(none, none).shape == (0,)
    # What is not finite is not free.
    q = np.zeros((3, domain.dim))
    q[1, 0], q[2, -1] = np.nan, np.inf
    assert space.is_free(q).tolist() == [True, False, False]
    assert space.are_free(q[[0] * 3], q).tolist() == [True, False, False]


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("method", "arguments", "message"),
    [
        ("is_free", [[[0.0, 0.0, 0.0, 0.0]]], r"q must have shape \(n, "),
        ("are_free", [np.zeros((1, 2)), np.zeros((2, 2))], "as many starts as ends"),
        ("classify", [np.zeros((1, 2)), np.ones((2, 2))], "as many lower corners"),
        ("classify", [[[0.0, 0.0], [1.0, 0.0]], [[1.0, 1.0], [0.0, 1.0]]], r"hi nowhere below lo.*box 1"),
        ("classify", [[[0.0, np.nan]], [[1.0, 1.0]]], "finite corners"),
        ("classify", [np.zeros((1, 4)), np.ones((1, 4))], r"lo must have shape \(n, 2\)"),
    ],
)
def test_other_configurations_and_boxes_are_refused(method, arguments, message):
    with pytest.raises(ValueError, match=message):
        getattr(PlaneSpace(OPEN), method)(*arguments)


SHIP = Box((0, 0, -np.pi), (4, 3, np.pi), periodic=(False, False, True))


def test_motions_cost_the_weighted_lengths_of_their_blocks():
    cost = MotionCost((((0, 1), 2.0), ((2,), 0.5)))
    q0 = np.array([[0.0, 0, 0], [1, 1, 3], [1, 1, 3], [0, 0, 0]])
    q1 = np.array([[3.0, 4, 0], [1, 1, -3], [1, 2, 3 - 20 * np.pi], [0, np.nan, 0]])
    expected = [10, 0.5 * (2 * np.pi - 6), 2, np.nan]
    np.testing.assert_allclose(cost.lengths(q0, q1, SHIP), expected, atol=1e-12)
    np.testing.assert_array_equal(cost.scale, [2, 2, 0.5])
    assert cost.dof == 3 and cost.lengths(q0[:0], q1[:0], SHIP).shape == (0,)


def test_only_periodic_axes_are_gone_around():
    line = Box((0,), (1,))
    lengths = [
        MotionCost((((0,), 1.0),)).lengths([[0.1]], [[0.9]], box)[0] for box in (line, Box((0,), (1,), (True,)))
    ]
    np.testing.assert_allclose(lengths, [0.8, 0.2])


def test_blocks_may_come_as_lists_and_are_compared_by_value():
    cost = MotionCost([[[1, 0], 1], [np.array([2]), np.float64(3)]])
    assert cost == MotionCost((((1, 0), 1.0), ((2,), 3.0))) and len({cost, cost}) == 1


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ((), "each axis"),
        ((((0, 2), 1.0),), r"each axis.*\[0, 2\]"),
        ((((0, 1), 1.0), ((1,), 1.0)), r"each axis.*\[0, 1, 1\]"),
        ((((-1, 0), 1.0),), "each axis"),
        ((((0,), 0.0),), "weight of a block must be a positive finite"),
        ((((0,), np.inf),), "weight of a block must be a positive finite"),
        ((((0.5,), 1.0),), "some integers"),
        ((((), 1.0),), "some integers"),
        ((((True,), 1.0),), "some integers"),
        ((((0,), 1.0, 2.0),), "axes, some integers, and a weight"),
        ((3,), "pairs of axes and a weight"),
        (3, "pairs of axes and a weight"),
    ],
)
def test_other_blocks_are_refused(blocks, message):
    with pytest.raises(ValueError, match=message):
        MotionCost(blocks)


def test_a_domain_of_another_dimension_is_refused():
    with pytest.raises(ValueError, match="A cost of 2 axes"):
        MotionCost((((0, 1), 1.0),)).lengths([[0.0, 0.0]], [[1.0, 1.0]], SHIP)


def test_a_space_of_ones_own_needs_only_to_say_what_is_free():
    class Ring:
        domain = Box((-2, -2), (2, 2))
        motion_cost = MotionCost((((0, 1), 1.0),))

        def is_free(self, q):
            return np.linalg.norm(q, axis=1) >= 1

    assert isinstance(Ring(), FreeTest) and not isinstance(Ring(), ConfigurationSpace)
