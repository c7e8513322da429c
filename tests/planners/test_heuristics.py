"""Heuristics: sums over robots of straight lines, oracles and PLRs."""

from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planner_helpers import ROOM

from plr_jax import Box, DiscRobot, Euclidean, Problem, RectangleRobot, construct, load
from plr_jax.metrics import path_cost
from plr_jax.planners import straight_line, sum_of_distances, zero

DISCS = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 1), (1, 9)], [(4, 5), (9, 9)])
PAIR = Problem(ROOM, [DiscRobot(0.4), RectangleRobot(2, 1)], [(1, 1, 0), (1, 8, 0)], [(4, 5, 0), (8, 8, 3)], 0.5)


def taxicab(x):
    return np.abs(x).sum(axis=1)


# Hand values


def test_zero_is_zero_for_any_team():
    assert np.array_equal(zero()(np.ones((3, 5, 2))), np.zeros(3))
    assert np.array_equal(zero().per_robot(np.ones((3, 5, 3))), np.zeros((3, 5)))


def test_straight_line_adds_lengths_and_shorter_turns():
    q = [[(1, 1), (9, 9)], [(4, 5), (6, 5)]]
    assert np.array_equal(straight_line(DISCS).per_robot(q), [[5, 0], [0, 5]])
    assert np.array_equal(straight_line(DISCS)(q), [5, 5])
    terms = straight_line(PAIR).per_robot([[(1, 1, 7.0), (8, 8, -3.0)]])
    assert np.allclose(terms, [[5, 0.5 * (2 * np.pi - 6)]], rtol=1e-14)


def test_distance_functions_get_their_dim_coordinates():
    heuristic = sum_of_distances([Euclidean((0, 0)), Euclidean((1, 1))])
    q = [[(3, 4), (1, 2)], [(0, 0), (4, 5)]]
    assert np.array_equal(heuristic.per_robot(q), [[5, 1], [0, 5]])
    assert np.array_equal(heuristic(q), [6, 5])
    both = sum_of_distances([Euclidean((0, 0)), Euclidean((0, 0, 0))])
    assert np.array_equal(both.per_robot([[(3, 4, 1), (3, 4, 12)]]), [[5, 13]])


def test_empty_batches_and_infinite_distances():
    blocked = sum_of_distances([taxicab, lambda x: np.where(x[:, 0] > 5, np.inf, 1.0)])
    assert np.array_equal(blocked([[(1, 1), (6, 0)], [(1, 1), (4, 0)]]), [np.inf, 3])
    for heuristic in (zero(), straight_line(DISCS), blocked):
        assert heuristic(np.empty((0, 2, 2))).shape == (0,)
        assert heuristic.per_robot(np.empty((0, 2, 2))).shape == (0, 2)


# Laws


@given(st.integers(0, 2**32 - 1))
def test_straight_line_bounds_every_path_from_below(seed):
    rng = np.random.default_rng(seed)
    for problem in (DISCS, PAIR):
        middle = rng.uniform(-7, 17, (rng.integers(1, 5), *problem.goals.shape))
        path = np.concatenate([middle, problem.goals[None]])
        assert straight_line(problem)(path[:1])[0] <= path_cost(problem, path) * (1 + 1e-12) + 1e-12


def test_function_without_dim_gets_all_coordinates_once():
    asked = []
    assert sum_of_distances([lambda x: asked.append(x.shape) or taxicab(x)])([[(1, 2, 3)]])[0] == 6
    assert asked == [(1, 3)]


def test_errors_of_distance_functions_carry_a_hint():
    class NoFuelError(IndexError):
        pass

    def distance(x):
        raise NoFuelError("no fuel")

    with pytest.raises(NoFuelError, match="no fuel") as caught:
        sum_of_distances([Euclidean((0, 0)), distance])([[(1, 2, 3), (1, 2, 3)]])
    (note,) = caught.value.__notes__
    assert "robot 1 was given (x, y, theta)" in note and "fn.dim = 2" in note
    with pytest.raises(NoFuelError) as caught:
        sum_of_distances([distance])([[(1, 2)]])
    assert not hasattr(caught.value, "__notes__")


# A team in one call


@pytest.fixture(scope="module")
def plrs():
    """PLRs of different sizes and dimensions, the last with two-level tables."""

    def bent(x):
        return np.abs(x - 0.3).sum(axis=1)

    planes = [construct(bent, Box((0, 0), (1, 1)), max_leaves=leaves) for leaves in (3, 200)]
    return [*planes, construct(bent, Box((0, 0, 0), (1, 1, 7)), max_depth=19)]


def test_stack_of_plrs_equals_single_plrs(plrs):
    assert plrs[-1].tables.blocks is not None
    heuristic = sum_of_distances(plrs)
    for n in (1, 17, 3_000):
        q = np.random.default_rng(n).uniform(-0.1, 1.1, (n, 3, 3))
        expected = np.stack([plr(q[:, i, : plr.dim]) for i, plr in enumerate(plrs)], axis=1).astype(np.float64)
        assert np.isinf(expected).any() or n < 10
        assert np.array_equal(heuristic.per_robot(q), expected)
        beside = sum_of_distances([plrs[1], taxicab])
        assert np.array_equal(beside.per_robot(q[:, 1:, :2])[:, 0], expected[:, 1])
    np.testing.assert_allclose(jax.jit(heuristic)(q[:99]), heuristic(q[:99]), rtol=1e-6)  # 32-bit sums


def test_distance_functions_get_few_batch_sizes():
    sizes = []

    def distance(x):
        sizes.append(len(x))
        return np.hypot(x[:, 0], x[:, 1])

    heuristic = sum_of_distances([distance, taxicab])
    q = np.random.default_rng(0).uniform(0, 9, (9_000, 2, 2))
    for n in (*range(1, 33), 500, 1_000, 1_020, 9_000):
        expected = np.stack([np.hypot(*q[:n, 0].T), taxicab(q[:n, 1])], axis=1)
        assert np.allclose(heuristic.per_robot(q[:n]), expected, rtol=1e-6)
    assert sorted(set(sizes)) == [1, 2, 4, 8, 16, 32, 512, 1024, 4096]


# Refusals, and infinite estimates


def with_dim(dim):
    def distance(x):
        return x[:, 0]

    distance.dim = dim
    return distance


LINE, SUM = straight_line(DISCS), sum_of_distances([taxicab, taxicab])


UNEQUAL = sum_of_distances([Euclidean((0, 0)), Euclidean((0, 0, 0))])


def with_answer(answer):
    return sum_of_distances([taxicab, lambda x: answer])


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_configurations_and_answers_raise():
    for heuristic, q, message in (
        *((LINE, np.zeros(s), r"must have shape \(n, 2, ") for s in ((4, 2), (4, 3, 2), (4, 2, 1), (4, 2, 4))),
        (SUM, np.zeros((4, 3, 2)), r"must have shape \(n, 2, "),
        (LINE, np.zeros((4, 2, 3)), r"must have shape \(n, 2, 2\), got \(4, 2, 3\)"),
        (zero(), DISCS.starts, r"Use q\[None\] for a single joint configuration"),
        *((zero(), q, "Joint configurations must") for q in ("word", [[[1, 2], [3]]], [[["a", "b"]]])),
        (UNEQUAL, np.zeros((1, 2, 2)), "robot 1 takes 3 coordinates, but configurations have 2"),
        (with_answer(np.zeros((4, 1))), np.zeros((3, 2, 2)), "distance function of robot 1 must give"),
        (with_answer(1.0), np.zeros((3, 2, 2)), "distance function of robot 1 must give"),
        (with_answer(["a"] * 3), np.zeros((3, 2, 2)), "robot 1's answer must be"),
        (with_answer(np.full(2, np.nan)), [[(1, 1), (2, 0)]] * 2, r"robot 1 returned NaN at \[2.0, 0.0\]"),
    ):
        with pytest.raises(ValueError, match=message):
            heuristic(q)


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_distance_functions_raise():
    for fns in ([], taxicab, 3, [taxicab, 3]):
        with pytest.raises(ValueError, match=r"distance_fns must|The distance function of robot 1 must"):
            sum_of_distances(fns)
    for dim in (0, 2.5, "2"):
        with pytest.raises(ValueError, match="`dim` of the distance function of robot 0"):
            sum_of_distances([with_dim(dim)])


def test_stack_of_plrs_refuses_other_teams(plrs):
    with pytest.raises(ValueError, match=r"shape \(n, 3, dof\), got \(5, 2, 3\)"):
        type(plrs[0]).stack(plrs)(np.zeros((5, 2, 3)))
    with pytest.raises(ValueError, match="robot 2 needs 3 coordinates, got configurations of 2"):
        sum_of_distances(plrs)(np.zeros((5, 3, 2)))


def test_sum_bounds_costs_only_if_all_functions_do():
    plr = load(Path(__file__).parent.parent / "plr" / "vectors" / "maze_of_cones.plr")
    assert sum_of_distances([plr.lower, Euclidean((0, 0))]).is_lower_bound
    assert not sum_of_distances([plr.lower, plr]).is_lower_bound


class Stacked:
    """Functions that answer all at once, with masks."""

    def __call__(self, x):
        return np.ma.masked_greater(x[:, 0], 5)

    @staticmethod
    def stack(fns):
        return lambda q: np.ma.masked_greater(q[..., 0], 5)


def test_masked_distances_are_infinite():
    heuristic = sum_of_distances([lambda x: np.ma.masked_greater(x[:, 0], 5)])
    np.testing.assert_array_equal(heuristic([[(1, 0)], [(9, 0)]]), [1, np.inf])
    terms = sum_of_distances([Stacked(), Stacked()]).per_robot([[(1, 0), (9, 0)]])
    assert type(terms) is np.ndarray and terms.tolist() == [[1, np.inf]]


def test_nan_configurations_have_infinite_heuristic(plrs):
    q = np.zeros((2, 2, 2))
    q[1, 0, 1] = np.nan
    for heuristic in (LINE, SUM):
        assert np.array_equal(np.isinf(heuristic(q)), [False, True])
    of_plrs = sum_of_distances(plrs).per_robot(np.pad(q, ((0, 0), (0, 1), (0, 1))))
    assert np.array_equal(np.isinf(of_plrs), [[False] * 3, [True, False, False]])
