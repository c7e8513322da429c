import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import (
    Box,
    DiscRobot,
    Problem,
    RectangleRobot,
    Workspace,
    bl_plan,
    construct,
    path_cost,
    robot_distance_fns,
    sba_star_plan,
    scenes,
)
from plr_jax._types import DimensionedFn, SeparableHeuristic, StackableDistanceFn
from plr_jax.oracles import Euclidean
from plr_jax.planners._heuristics import _distance_fns, estimates, straight_line, sum_of_distances, zero

ROOM = Workspace(((0, 0), (10, 10)))
DISCS = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 1), (1, 9)], [(4, 5), (9, 9)])
MIXED = Problem(ROOM, [DiscRobot(0.4), RectangleRobot(2, 1)], [(1, 1, 0), (1, 8, 0)], [(4, 5, 0), (8, 8, 3)], 0.5)


def euclidean_to(*goal):
    return Euclidean(goal)


def taxicab(x):
    return np.abs(x).sum(axis=1)


# Hand values


def test_zero_is_zero_for_any_team():
    assert np.array_equal(zero()(np.ones((3, 5, 2))), np.zeros(3))
    assert np.array_equal(zero().per_robot(np.ones((3, 5, 3))), np.zeros((3, 5)))


def test_straight_line_of_discs():
    q = [[(1, 1), (9, 9)], [(4, 5), (6, 5)]]
    assert np.array_equal(straight_line(DISCS).per_robot(q), [[5, 0], [0, 5]])
    assert np.array_equal(straight_line(DISCS)(q), [5, 5])


def test_straight_line_turns_the_shorter_way_and_ignores_the_heading_of_discs():
    q = [[(1, 1, 7.0), (8, 8, -3.0)]]
    expected = 0.5 * (2 * np.pi - 6)
    assert np.allclose(straight_line(MIXED).per_robot(q), [[5, expected]], rtol=1e-14)


def test_sum_of_distances_of_euclideans():
    heuristic = sum_of_distances([euclidean_to(0, 0), euclidean_to(1, 1)])
    q = [[(3, 4), (1, 2)], [(0, 0), (4, 5)]]
    assert np.array_equal(heuristic.per_robot(q), [[5, 1], [0, 5]])
    assert np.array_equal(heuristic(q), [6, 5])


def test_an_empty_batch():
    for heuristic in (zero(), straight_line(DISCS), sum_of_distances([taxicab, taxicab])):
        assert heuristic(np.empty((0, 2, 2))).shape == (0,)
        assert heuristic.per_robot(np.empty((0, 2, 2))).shape == (0, 2)


def test_infinite_where_a_robot_has_no_way():
    heuristic = sum_of_distances([taxicab, lambda x: np.where(x[:, 0] > 5, np.inf, 1.0)])
    assert np.array_equal(heuristic([[(1, 1), (6, 0)], [(1, 1), (4, 0)]]), [np.inf, 3])


def test_results_on_the_device_come_to_the_host():
    heuristic = sum_of_distances([lambda x: jnp.abs(jnp.asarray(x)).sum(axis=1), taxicab])
    value = heuristic([[(1, 2), (3, 4)]])
    assert isinstance(value, np.ndarray) and value.dtype == np.float64 and value[0] == 10


# Laws


@given(st.integers(0, 2**32 - 1))
def test_straight_line_bounds_every_path_from_below(seed):
    rng = np.random.default_rng(seed)
    for problem in (DISCS, MIXED):
        middle = rng.uniform(-7, 17, (rng.integers(1, 5), *problem.goals.shape))
        path = np.concatenate([middle, problem.goals[None]])
        assert straight_line(problem)(path[:1])[0] <= path_cost(problem, path) * (1 + 1e-12) + 1e-12


@given(st.integers(0, 2**32 - 1))
def test_terms_sum_to_the_heuristic(seed):
    q = np.random.default_rng(seed).uniform(-7, 17, (9, 2, 3))
    for heuristic in (zero(), straight_line(MIXED), sum_of_distances([euclidean_to(1, 2), euclidean_to(3, 4, 5)])):
        assert np.array_equal(heuristic(q), heuristic.per_robot(q).sum(axis=1))


def test_distances_of_the_inflated_workspace_are_no_shorter_than_straight_lines():
    problem = scenes.four_rooms(2)
    q = np.stack([problem.workspace.inflate(0.4).sample_free(500, seed) for seed in range(2)], axis=1)
    exact = sum_of_distances(robot_distance_fns(problem))
    assert (exact.per_robot(q) >= straight_line(problem).per_robot(q) - 1e-9).all()


# How many coordinates a function sees


def test_a_function_of_the_plane_sees_the_position_of_a_rectangle():
    q = [[(3, 4, 1), (3, 4, 12)]]
    assert np.array_equal(sum_of_distances([euclidean_to(0, 0), euclidean_to(0, 0, 0)]).per_robot(q), [[5, 13]])


def test_a_function_without_dim_is_asked_once_and_sees_all_coordinates():
    asked = []

    def distance(x):
        asked.append(x.shape)
        return np.abs(x).sum(axis=1)

    assert sum_of_distances([distance])([[(1, 2, 3)]])[0] == 6
    assert asked == [(1, 3)]
    for distance.dim, expected in ((2, 3), (3, 6)):
        assert sum_of_distances([distance])([[(1, 2, 3)]])[0] == expected


def test_what_a_function_raises_comes_through_with_a_hint():
    class NoFuelError(IndexError):
        pass

    def distance(x):
        raise NoFuelError("no fuel")

    with pytest.raises(NoFuelError, match="no fuel") as caught:
        sum_of_distances([euclidean_to(0, 0), distance])([[(1, 2, 3), (1, 2, 3)]])
    (note,) = caught.value.__notes__
    assert "robot 1 was given (x, y, theta)" in note and "fn.dim = 2" in note
    with pytest.raises(NoFuelError) as caught:
        sum_of_distances([distance])([[(1, 2)]])
    assert not hasattr(caught.value, "__notes__")


def test_a_function_of_more_coordinates_than_there_are():
    with pytest.raises(ValueError, match="robot 1 takes 3 coordinates, configurations have 2"):
        sum_of_distances([euclidean_to(0, 0), euclidean_to(0, 0, 0)])(np.zeros((1, 2, 2)))


def test_oracles_say_how_many_coordinates_they_take():
    oracle = robot_distance_fns(scenes.four_rooms(2))[0]
    assert oracle.dim == 2 and Euclidean((1, 2, 3)).dim == 3


# A team in one call


def plrs_of_a_team():
    """PLRs of different sizes and dimensions, the last with two-level tables."""

    def bent(x):
        return np.abs(x - 0.3).sum(axis=1)

    planes = [construct(bent, Box((0, 0), (1, 1)), max_leaves=leaves) for leaves in (3, 200)]
    return [*planes, construct(bent, Box((0, 0, 0), (1, 1, 7)), max_depth=19)]


def test_a_stack_of_plrs_equals_the_plrs_bit_for_bit():
    plrs = plrs_of_a_team()
    assert plrs[-1].tables.blocks is not None
    heuristic = sum_of_distances(plrs)
    for n in (1, 17, 70_000):
        q = np.random.default_rng(n).uniform(-0.1, 1.1, (n, 3, 3))
        expected = np.stack([plr(q[:, i, : plr.dim]) for i, plr in enumerate(plrs)], axis=1).astype(np.float64)
        assert np.isinf(expected).any() or n < 10
        assert np.array_equal(heuristic.per_robot(q), expected)


def test_a_type_that_offers_a_stack_is_called_all_at_once():
    class Constant:
        dim = 2

        def __init__(self, value):
            self.value = value

        def __call__(self, x):
            raise AssertionError("called for one robot")

        @staticmethod
        def stack(fns):
            return lambda q: np.tile([fn.value for fn in fns], (len(q), 1)).astype(float)

    assert np.array_equal(sum_of_distances([Constant(1), Constant(2)])(np.zeros((4, 2, 2))), [3, 3, 3, 3])


def test_a_stack_refuses_another_team():
    plrs = plrs_of_a_team()
    with pytest.raises(ValueError, match=r"shape \(n, 3, dof\), got \(5, 2, 3\)"):
        type(plrs[0]).stack(plrs)(np.zeros((5, 2, 3)))
    with pytest.raises(ValueError, match="robot 2 has 3 dimensions, got 2"):
        sum_of_distances(plrs)(np.zeros((5, 3, 2)))


def test_plrs_beside_other_functions():
    plr = plrs_of_a_team()[1]
    q = np.random.default_rng(0).uniform(0, 1, (10, 2, 2))
    heuristic = sum_of_distances([plr, taxicab])
    assert np.array_equal(heuristic.per_robot(q)[:, 0], np.asarray(plr(q[:, 0]), np.float64))


def test_distance_functions_see_few_batch_sizes():
    sizes = []

    @jax.jit
    def compiled(x):
        sizes.append(len(x))  # once a compilation
        return jnp.hypot(x[:, 0], x[:, 1])

    heuristic = sum_of_distances([compiled, taxicab])
    q = np.random.default_rng(0).uniform(0, 9, (9_000, 2, 2))
    for n in (*range(1, 33), 500, 1_000, 1_020, 9_000):
        expected = np.stack([np.hypot(*q[:n, 0].T), taxicab(q[:n, 1])], axis=1)
        assert np.allclose(heuristic.per_robot(q[:n]), expected, rtol=1e-6)
    assert sizes == [1, 2, 4, 8, 16, 32, 512, 1024, 4096]


def test_what_functions_may_offer_is_told_by_protocols():
    plr = plrs_of_a_team()[0]
    assert isinstance(plr, StackableDistanceFn) and isinstance(plr, DimensionedFn)
    assert isinstance(euclidean_to(1, 2), DimensionedFn) and not isinstance(euclidean_to(1, 2), StackableDistanceFn)
    assert not isinstance(taxicab, DimensionedFn)
    for heuristic in (zero(), straight_line(DISCS), sum_of_distances([taxicab])):
        assert isinstance(heuristic, SeparableHeuristic)
    assert not isinstance(taxicab, SeparableHeuristic)


# Refusals


@pytest.mark.parametrize(
    ("factory", "call"),
    [
        (zero, r"zero\(\)"),
        (straight_line, r"straight_line\(problem\)"),
        (sum_of_distances, r"sum_of_distances\(dist"),
    ],
)
@pytest.mark.parametrize("plan", [bl_plan, sba_star_plan])
def test_a_factory_that_was_not_called_is_refused(plan, factory, call):
    with pytest.raises(ValueError, match=rf"what {call}.* returns, got {factory.__name__} itself: call it"):
        plan(DISCS, factory)


@pytest.mark.parametrize("shape", [(4, 2), (4, 3, 2), (4, 2, 1), (4, 2, 4)])
def test_joint_configurations_of_another_shape(shape):
    for heuristic in (straight_line(DISCS), sum_of_distances([taxicab, taxicab])):
        with pytest.raises(ValueError, match=r"Joint configurations must have shape \(n, 2, "):
            heuristic(np.zeros(shape))


def test_a_straight_line_refuses_configurations_of_other_robots():
    with pytest.raises(ValueError, match=r"must have shape \(n, 2, 2\), got \(4, 2, 3\)"):
        straight_line(DISCS)(np.zeros((4, 2, 3)))


def test_a_single_joint_configuration_gets_a_hint():
    with pytest.raises(ValueError, match=r"Use q\[None\] for a single one"):
        zero()(DISCS.starts)


@pytest.mark.parametrize("value", ["word", [[[1, 2], [3]]], [[["a", "b"]]]])
def test_joint_configurations_that_are_no_numbers(value):
    with pytest.raises(ValueError, match="Joint configurations must"):
        zero()(value)


@pytest.mark.parametrize("value", [[], taxicab, 3, [taxicab, 3]])
def test_distance_functions_that_are_none(value):
    # Not by way of the public name, whose annotation the tests check first.
    with pytest.raises(ValueError, match=r"distance_fns must|The distance function of robot 1 must"):
        _distance_fns(value)


@pytest.mark.parametrize("dim", [0, 2.5, "2"])
def test_a_dim_that_is_none(dim):
    def distance(x):
        return x[:, 0]

    distance.dim = dim
    with pytest.raises(ValueError, match="`dim` of the distance function of robot 0"):
        sum_of_distances([distance])


@pytest.mark.parametrize("result", [np.zeros((3, 1)), np.zeros(2), 1.0, None, ["a"] * 3])
def test_results_of_another_shape_name_the_robot(result):
    with pytest.raises(ValueError, match=r"The distance function of robot 1('s answer must be| must give)"):
        sum_of_distances([taxicab, lambda x: result])(np.zeros((3, 2, 2)))


def test_masked_distances_are_infinite():
    heuristic = sum_of_distances([lambda x: np.ma.masked_greater(x[:, 0], 5)])
    np.testing.assert_array_equal(heuristic([[(1, 0)], [(9, 0)]]), [1, np.inf])


class Stacked:
    """Functions that answer all at once, with masks."""

    def __call__(self, x):
        return np.ma.masked_greater(x[:, 0], 5)

    @staticmethod
    def stack(fns):
        return lambda q: np.ma.masked_greater(q[..., 0], 5)


def test_masked_distances_of_a_stack_are_infinite():
    terms = sum_of_distances([Stacked(), Stacked()]).per_robot([[(1, 0), (9, 0)]])
    assert type(terms) is np.ndarray and terms.tolist() == [[1, np.inf]]


def test_masked_estimates_are_infinite():
    q = np.array([[(1.0, 0)], [(9, 0)], [(-1, 0)]])
    np.testing.assert_array_equal(estimates(lambda q: np.ma.masked_greater(q[:, 0, 0], 5), q), [1, np.inf, 0])


def test_nan_from_a_function_names_the_robot_and_the_place():
    with pytest.raises(ValueError, match=r"robot 1 returned NaN at \[2.0, 0.0\]"):
        sum_of_distances([taxicab, lambda x: np.where(x[:, 0] == 2, np.nan, 1)])([[(1, 1), (1, 1)], [(1, 1), (2, 0)]])


def test_configurations_that_are_not_finite_have_no_estimate():
    q = np.zeros((2, 2, 2))
    q[1, 0, 1] = np.nan
    for heuristic in (straight_line(DISCS), sum_of_distances([taxicab, taxicab])):
        assert np.array_equal(np.isinf(heuristic(q)), [False, True])
    plr = plrs_of_a_team()[0]
    assert np.array_equal(np.isinf(sum_of_distances([plr, plr]).per_robot(q)), [[False, False], [True, False]])
