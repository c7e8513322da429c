import warnings

import numpy as np
import pytest
from eikonal_helpers import EMPTY, GOALS, ROOM, BoxSpace, TwoGrounds, check_bounds

from plr_jax import (
    CellState,
    PlaneSpace,
    VisibilityGraph,
    Workspace,
    from_bytes,
    load,
    save,
    solve_eikonal,
)
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.limits import ConstructionInterrupted


class FreeOnly:
    """A space that tests configurations and proves nothing."""

    def __init__(self, space):
        self.domain, self.motion_cost, self.is_free = space.domain, space.motion_cost, space.is_free


class Interrupted:
    """A space that is interrupted when boxes are classified for the n-th time."""

    def __init__(self, space, calls):
        self.domain, self.motion_cost = space.domain, space.motion_cost
        self.is_free, self.are_free, self._classify, self.left = space.is_free, space.are_free, space.classify, calls

    def classify(self, lo, hi):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return self._classify(lo, hi)


def test_costs_of_blocks_of_axes_add_up():
    space = BoxSpace(Box((0, 0), (1, 2)), blocks=(((0,), 2.0), ((1,), 0.5)))
    plr = solve_eikonal(space, (0.25, 1.5), max_leaves=200)
    x = np.random.default_rng(0).random((2000, 2)) * (1, 2)
    distance = 2 * np.abs(x[:, 0] - 0.25) + 0.5 * np.abs(x[:, 1] - 1.5)
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()
    np.testing.assert_allclose(plr(x), distance, atol=0.02)


def test_of_a_space_that_only_tests_nothing_is_proven():
    goal = (0.3, 0.4)
    plr = solve_eikonal(FreeOnly(PlaneSpace(ROOM)), goal, max_leaves=600)
    x = ROOM.sample_free(2000, 0)
    distance = VisibilityGraph(ROOM, goal)(x)
    assert np.abs(np.asarray(plr(x)) - distance).mean() < 0.03 * distance.mean()
    assert plr.max_error is None
    with pytest.raises(ValueError, match="Nothing is proven"):
        plr.bounds(x)


def test_files_keep_what_is_proven_and_where_nothing_is(tmp_path):
    plr = solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=150)
    save(plr, tmp_path / "file.plr")
    x = ROOM.sample_free(2000, 0)
    for other in (load(tmp_path / "file.plr"), from_bytes(plr.to_bytes())):
        np.testing.assert_array_equal(np.stack(other.bounds(x)), np.stack(plr.bounds(x)))
        assert other.max_error == plr.max_error == np.inf
    assert np.isinf(plr.bounds(x)[1]).any()
    assert np.isfinite(solve_eikonal(EMPTY, (0.3, 0.4), max_leaves=20).max_error)


def test_the_same_arguments_give_the_same_bytes():
    for limits in ({"max_leaves": 200}, {"max_leaves": 200, "max_bytes": 300}):
        first, second = (solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), **limits).to_bytes() for _ in range(2))
        assert first == second


@pytest.mark.parametrize("max_leaves", [1, 2, 5, 17])
def test_few_leaves_are_enough(max_leaves):
    for goal in ((0.3, 0.4), (1.0, 1.0)):
        plr = solve_eikonal(PlaneSpace(ROOM), goal, max_leaves=max_leaves)
        assert 1 <= plr.num_leaves <= max_leaves
        check_bounds(plr, ROOM, VisibilityGraph(ROOM, goal), 500)
    assert solve_eikonal(EMPTY, (0.3, 0.4), max_leaves=max_leaves).num_leaves <= max_leaves


def test_a_tolerance_ends_it_early():
    few = solve_eikonal(EMPTY, (0.3, 0.4), max_leaves=2000, tolerance=0.03)
    more = solve_eikonal(EMPTY, (0.3, 0.4), max_leaves=2000, tolerance=0.01)
    assert 4 <= few.num_leaves < more.num_leaves < 1500


def test_more_leaves_are_closer_to_the_truth():
    gaps = []
    for max_leaves in (100, 400, 1600):
        plr = solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=max_leaves)
        distance, lower, _ = check_bounds(plr, ROOM, VisibilityGraph(ROOM, (0.3, 0.4)))
        gaps.append(np.mean(distance - lower))
    assert gaps[1] < 0.7 * gaps[0] and gaps[2] < 0.7 * gaps[1]


def test_files_are_as_small_as_asked():
    sizes = [
        solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=300, max_bytes=most).num_bytes for most in (120, 500)
    ]
    assert sizes[0] <= 120 < sizes[1] <= 500


def test_interrupts_keep_what_there_is():
    with pytest.warns(ConstructionInterrupted, match=r"Interrupted at \d+ of 600 cells"):
        plr = solve_eikonal(Interrupted(PlaneSpace(ROOM), 6), (0.3, 0.4), max_leaves=600)
    assert 30 < plr.num_leaves < 600
    check_bounds(plr, ROOM, VisibilityGraph(ROOM, (0.3, 0.4)), 500)


def test_interrupts_before_there_is_anything_are_passed_on():
    with pytest.raises(KeyboardInterrupt):
        solve_eikonal(Interrupted(PlaneSpace(ROOM), 1), (0.3, 0.4), max_leaves=600)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ((1.5, 1.5), r"goal must be a free configuration.*1\.5"),
        ((9.0, 1.5), "goal must be a free configuration"),
        ((0.3,), "goal must have 2 coordinates, as the space has axes, got 1"),
        ((0.3, 0.4, 0.5), "goal must have 2 coordinates"),
        ((np.nan, 0.4), "goal"),
        ("here", "goal"),
    ],
)
def test_bad_goals_are_refused(goal, message):
    with pytest.raises(ValueError, match=message):
        solve_eikonal(PlaneSpace(ROOM), goal)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"max_leaves": 0}, "max_leaves must be"),
        ({"max_leaves": 2.5}, "max_leaves must be"),
        ({"max_leaves": True}, "max_leaves must be"),
        ({"max_bytes": 0}, "max_bytes must be"),
        ({"max_bytes": "many"}, "max_bytes must be"),
        ({"tolerance": -1.0}, "tolerance must be"),
        ({"tolerance": np.nan}, "tolerance must be"),
        ({"seed": -1}, "seed must be"),
        ({"cost_map": 2.0}, "cost_map must be a CostMap, such as LipschitzCost, got 2.0"),
        ({"cost_map": lambda q: 1.0}, "cost_map must be a CostMap"),
    ],
)
def test_bad_arguments_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), **changed)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("space", [ROOM, None, 3, "plane", lambda q: True])
def test_what_is_no_space_is_refused(space):
    with pytest.raises(ValueError, match="space must be a configuration space, such as PlaneSpace"):
        solve_eikonal(space, (0.3, 0.4))


def test_a_budget_too_small_for_one_leaf_is_refused():
    with pytest.raises(ValueError, match=r"max_bytes=20 is too small: one leaf takes \d+ bytes"):
        solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=100, max_bytes=20)


class BadMap(TwoGrounds):
    def __init__(self, lower, upper):
        self._lower, self._upper = lower, upper

    def bounds(self, lo, hi):
        return np.full(len(lo), self._lower), np.full(len(lo), self._upper)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("bounds", [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, np.inf), (np.nan, 1.0), (1.0, np.nan)])
def test_bounds_of_costs_that_make_no_sense_are_refused(bounds):
    with pytest.raises(ValueError, match=r"positive and finite, lower nowhere above upper, got .* over \["):
        solve_eikonal(EMPTY, (0.3, 0.4), cost_map=BadMap(*bounds), max_leaves=20)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("bounds", [3.0, (np.ones(2), np.ones(2)), (np.ones(1), np.ones(2)), "low and high", None])
def test_bounds_of_costs_of_another_shape_are_refused(bounds):
    cost_map = TwoGrounds(0.5, 2.0)
    cost_map.bounds = lambda lo, hi: bounds
    with pytest.raises(
        ValueError, match=r"bounds('s answer)? must (be two arrays|be real numbers|give one number a point)"
    ):
        solve_eikonal(EMPTY, (0.3, 0.4), cost_map=cost_map, max_leaves=20)


def test_there_are_no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for goal in GOALS.values():
            solve_eikonal(PlaneSpace(ROOM), goal, max_leaves=60)
        solve_eikonal(BoxSpace(Box([0], [1])), (0.0,), max_leaves=1)


def test_nothing_free_but_the_goals_cell_is_no_problem():
    space = BoxSpace(Box((0, 0), (1, 1)), [(0.0, 0.0), (1.0, 0.97)])
    plr = solve_eikonal(space, (0.5, 0.99), max_leaves=300)
    x = np.random.default_rng(0).uniform((0, 0.97), (1, 1), (1000, 2))
    distance = np.linalg.norm(x - (0.5, 0.99), axis=1)
    lower, upper = (np.asarray(bound) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()
    assert (space.classify(*plr.leaf_boxes) == CellState.BLOCKED).any()


def test_the_estimate_is_far_nearer_than_the_bounds_and_knows_walls_thinner_than_cells():
    walls = [[(x, y), (x + 0.01, y), (x + 0.01, y + 1.2), (x, y + 1.2)] for x, y in ((0.6, 0.0), (1.3, 0.3))]
    workspace = Workspace(((0, 0), (2, 1.5)), walls)
    goal = np.array([1.9, 0.2])
    plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=2_000)
    x = workspace.sample_free(5_000, 0)
    distance = VisibilityGraph(workspace, goal)(x)
    lower, _ = plr.bounds(x)
    assert (np.asarray(lower) <= distance).all()
    error = np.abs(np.asarray(plr(x)) - distance).mean()
    assert error < 0.01 * distance.mean() and error < 0.1 * (distance - np.asarray(lower)).mean()
