"""Heuristics: sums over robots of straight lines, oracles and PLRs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planner_helpers import ROOM

from plr_jax import (
    BLOptions,
    Box,
    DiscRobot,
    Euclidean,
    PlaneSpace,
    Problem,
    RectangleRobot,
    RigidBodySpace,
    Workspace,
    bl_plan,
    construct,
    path_cost,
    robot_distance_fns,
    scenes,
    solve_eikonal,
    straight_line,
    sum_of_distances,
    validate,
    zero,
)

DISCS = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 1), (1, 9)], [(4, 5), (9, 9)])
MIXED = Problem(ROOM, [DiscRobot(0.4), RectangleRobot(2, 1)], [(1, 1, 0), (1, 8, 0)], [(4, 5, 0), (8, 8, 3)], 0.5)


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
    terms = straight_line(MIXED).per_robot([[(1, 1, 7.0), (8, 8, -3.0)]])
    assert np.allclose(terms, [[5, 0.5 * (2 * np.pi - 6)]], rtol=1e-14)


def test_distance_functions_get_their_dim_coordinates():
    heuristic = sum_of_distances([Euclidean((0, 0)), Euclidean((1, 1))])
    q = [[(3, 4), (1, 2)], [(0, 0), (4, 5)]]
    assert np.array_equal(heuristic.per_robot(q), [[5, 1], [0, 5]])
    assert np.array_equal(heuristic(q), [6, 5])
    both = sum_of_distances([Euclidean((0, 0)), Euclidean((0, 0, 0))])
    assert np.array_equal(both.per_robot([[(3, 4, 1), (3, 4, 12)]]), [[5, 13]])
    assert robot_distance_fns(scenes.four_rooms(2))[0].dim == 2 and Euclidean((1, 2, 3)).dim == 3


def test_empty_batch_gives_empty_heuristic():
    for heuristic in (zero(), straight_line(DISCS), sum_of_distances([taxicab, taxicab])):
        assert heuristic(np.empty((0, 2, 2))).shape == (0,)
        assert heuristic.per_robot(np.empty((0, 2, 2))).shape == (0, 2)


def test_infinite_distance_makes_sum_infinite():
    heuristic = sum_of_distances([taxicab, lambda x: np.where(x[:, 0] > 5, np.inf, 1.0)])
    assert np.array_equal(heuristic([[(1, 1), (6, 0)], [(1, 1), (4, 0)]]), [np.inf, 3])


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
    for heuristic in (zero(), straight_line(MIXED), sum_of_distances([Euclidean((1, 2)), Euclidean((3, 4, 5))])):
        assert np.array_equal(heuristic(q), heuristic.per_robot(q).sum(axis=1))


def test_function_without_dim_gets_all_coordinates_once():
    asked = []

    def distance(x):
        asked.append(x.shape)
        return np.abs(x).sum(axis=1)

    assert sum_of_distances([distance])([[(1, 2, 3)]])[0] == 6
    assert asked == [(1, 3)]
    for distance.dim, expected in ((2, 3), (3, 6)):
        assert sum_of_distances([distance])([[(1, 2, 3)]])[0] == expected


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


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("ask", "message"),
    [
        *(
            (lambda heuristic=heuristic, shape=shape: heuristic(np.zeros(shape)), r"must have shape \(n, 2, ")
            for heuristic in (LINE, SUM)
            for shape in ((4, 2), (4, 3, 2), (4, 2, 1), (4, 2, 4))
        ),
        (lambda: LINE(np.zeros((4, 2, 3))), r"must have shape \(n, 2, 2\), got \(4, 2, 3\)"),
        (lambda: zero()(DISCS.starts), r"Use q\[None\] for a single joint configuration"),
        *(
            (lambda q=q: zero()(q), "Joint configurations must")
            for q in ("word", [[[1, 2], [3]]], [[["a", "b"]]])
        ),
        *(
            (lambda fns=fns: sum_of_distances(fns), "distance_fns must|The distance function of robot 1 must")
            for fns in ([], taxicab, 3, [taxicab, 3])
        ),
        *(
            (lambda dim=dim: sum_of_distances([with_dim(dim)]), "`dim` of the distance function of robot 0")
            for dim in (0, 2.5, "2")
        ),
        (
            lambda: sum_of_distances([Euclidean((0, 0)), Euclidean((0, 0, 0))])(np.zeros((1, 2, 2))),
            "robot 1 takes 3 coordinates, but configurations have 2",
        ),
        *(
            (lambda result=result: sum_of_distances([taxicab, lambda x: result])(np.zeros((3, 2, 2))),
             r"The distance function of robot 1('s answer must be| must give)")
            for result in (np.zeros((3, 1)), np.zeros(2), 1.0, None, ["a"] * 3)
        ),
        (
            lambda: sum_of_distances([taxicab, lambda x: np.where(x[:, 0] == 2, np.nan, 1)])([[(1, 1), (2, 0)]]),
            r"robot 1 returned NaN at \[2.0, 0.0\]",
        ),
    ],
)  # fmt: skip
def test_invalid_heuristic_arguments_raise(ask, message):
    with pytest.raises(ValueError, match=message):
        ask()


def test_stack_of_plrs_refuses_other_teams(plrs):
    with pytest.raises(ValueError, match=r"shape \(n, 3, dof\), got \(5, 2, 3\)"):
        type(plrs[0]).stack(plrs)(np.zeros((5, 2, 3)))
    with pytest.raises(ValueError, match="robot 2 needs 3 coordinates, got configurations of 2"):
        sum_of_distances(plrs)(np.zeros((5, 3, 2)))


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


# Lower bounds


DOOR = Workspace(((0, 0), (4, 4)), [[(1.9, 0), (2.1, 0), (2.1, 1.7), (1.9, 1.7)],
                                    [(1.9, 2.3), (2.1, 2.3), (2.1, 4), (1.9, 4)]])  # fmt: skip
THROUGH = Problem(
    DOOR,
    [DiscRobot(0.2), RectangleRobot(0.9, 0.2)],
    [(0.5, 0.5, 0.0), (0.6, 3.2, math.pi / 2)],
    [(3.5, 3.4, 0.0), (3.4, 0.9, math.pi / 2)],
    0.4,
)


@pytest.fixture(scope="module")
def proven():
    """PLRs of a disc and of a rectangle that must turn to fit through a door."""
    disc, rectangle = THROUGH.robots
    return [
        solve_eikonal(PlaneSpace(DOOR, disc), THROUGH.goals[0, :2], max_leaves=500),
        solve_eikonal(
            RigidBodySpace(DOOR, rectangle, float(THROUGH.rotation_weights[1])), THROUGH.goals[1], max_leaves=2000
        ),
    ]


@pytest.mark.full
def test_only_lower_bounds_bound_costs(proven):
    estimate, bound = sum_of_distances(proven), sum_of_distances([plr.lower for plr in proven])
    assert not estimate.is_lower_bound and bound.is_lower_bound
    assert not sum_of_distances([proven[0].lower, proven[1]]).is_lower_bound
    assert sum_of_distances([robot_distance_fns(THROUGH)[0], proven[1].lower]).is_lower_bound
    starts = THROUGH.starts[None]
    assert (bound.per_robot(starts) <= estimate.per_robot(starts)).all()
    straight = straight_line(THROUGH)(starts)[0]
    guessed, known = (bl_plan(THROUGH, h, BLOptions(max_expansions=1)) for h in (estimate, bound))
    assert guessed.lower_bound == pytest.approx(straight, rel=1e-6)
    assert known.lower_bound == pytest.approx(max(straight, bound(starts)[0]), rel=1e-6)


@pytest.mark.full
def test_lower_bounds_are_below_costs_of_a_path(proven):
    """At each row of a path, the rest of the path costs each robot at least its bound, turns included."""
    solution = bl_plan(THROUGH)
    assert validate(THROUGH, solution.path).valid
    path = np.asarray(solution.path)
    change = np.diff(path, axis=0)
    angle = np.arccos(np.clip(np.cos(change[..., 2]), -1, 1))
    cost = np.hypot(change[..., 0], change[..., 1]) + angle * [0.0, 0.4]
    left = np.concatenate([np.cumsum(cost[::-1], axis=0)[::-1], np.zeros((1, 2))])
    bound = sum_of_distances([plr.lower for plr in proven]).per_robot(path)
    assert (bound <= left + 1e-6).all() and (bound.sum(axis=0) > 0.7 * left.sum(axis=0)).all()
    turned_away = THROUGH.goals[None] - [0, 0, 1.2]
    assert 0 < sum_of_distances([plr.lower for plr in proven]).per_robot(turned_away)[0, 1] <= 0.4 * 1.2
