import warnings

import numpy as np
import pytest
from eikonal_helpers import BoxSpace, check_bounds
from hypothesis import given, settings
from hypothesis import strategies as st
from space_helpers import BOUNDS, random_workspace, rectangle

from plr_jax import (
    CellState,
    DiscRobot,
    PlaneSpace,
    VisibilityGraph,
    Workspace,
    from_bytes,
    load,
    save,
    scenes,
    solve_eikonal,
)
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.limits import ConstructionInterrupted
from plr_jax.spaces import LipschitzCost

EMPTY = PlaneSpace(Workspace(((0, 0), (1, 1))))
ROOM = Workspace(BOUNDS, [rectangle(1, 1, 2, 2), rectangle(2.3, 0, 2.4, 1.3)])
GOALS = {
    "inside": (0.3, 0.4),
    "on a dyadic point": (0.5, 0.375),
    "on a wall": (1.37, 1.0),
    "in a corner": (1.0, 2.0),
    "between walls": (2.3, 0.0),
    "in a corner of the domain": (4.0, 3.0),
    "at the border": (0.0, 1.234),
    "just beside a wall": (0.9999999, 1.5),
}


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


@pytest.mark.parametrize("goal", GOALS.values(), ids=GOALS)
def test_bounds_hold_the_exact_distance_for_any_goal(goal):
    plr = solve_eikonal(PlaneSpace(ROOM), goal, max_leaves=400)
    distance, lower, upper = check_bounds(plr, ROOM, VisibilityGraph(ROOM, goal))
    known = np.isfinite(upper)
    assert known.mean() > 0.9
    assert np.mean((upper - lower)[known]) < 0.3 * distance.mean()


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.integers(10, 250), st.sampled_from([None, 150, 600]))
def test_bounds_hold_the_exact_distance_on_random_maps(seed, max_leaves, max_bytes):
    workspace = random_workspace(seed)
    goal = workspace.sample_free(1, seed)[0]
    plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=max_leaves, max_bytes=max_bytes)
    check_bounds(plr, workspace, VisibilityGraph(workspace, goal), 1500, seed)


@pytest.mark.parametrize("max_bytes", [None, 300])
def test_bounds_hold_on_the_maze_with_thin_walls(max_bytes):
    problem = scenes.thin_maze()
    goal = problem.goals[0, :2]
    plr = solve_eikonal(PlaneSpace(problem.workspace), goal, max_leaves=1500, max_bytes=max_bytes)
    _, _lower, upper = check_bounds(plr, problem.workspace, VisibilityGraph(problem.workspace, goal), 10_000)
    assert np.isfinite(upper).mean() > 0.5 and plr.max_error == np.inf
    assert max_bytes is None or plr.num_bytes <= max_bytes


@pytest.mark.parametrize("squeeze", [False, True])
def test_bounds_hold_where_obstacles_touch_in_a_dyadic_point(squeeze):
    workspace = Workspace(BOUNDS, [rectangle(1, 1.5, 2, 2.25), rectangle(2, 0.75, 3, 1.5)], squeeze=squeeze)
    for goal in ((1.9, 1.4), (2.0, 1.5)):
        for max_bytes in (None, 400):
            plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=300, max_bytes=max_bytes)
            check_bounds(plr, workspace, VisibilityGraph(workspace, goal))


def test_bounds_hold_along_walls_of_almost_no_thickness():
    for thickness in (1e-3, 1e-6, 1e-7):
        workspace = Workspace(BOUNDS, [rectangle(2, 0, 2 + thickness, 2.6), rectangle(1, 0.4, 1.0 + thickness, 3)])
        plr = solve_eikonal(PlaneSpace(workspace), (0.3, 0.4), max_leaves=500)
        check_bounds(plr, workspace, VisibilityGraph(workspace, (0.3, 0.4)))


def test_bounds_hold_where_a_gap_joins_two_rooms():
    for gap in (0.05, 1e-3, 1e-5):
        workspace = Workspace(BOUNDS, [rectangle(2, 0, 2.5, 1.3), rectangle(2, 1.3 + gap, 2.5, 3)])
        plr = solve_eikonal(PlaneSpace(workspace), (0.3, 0.4), max_leaves=500)
        distance, _, _ = check_bounds(plr, workspace, VisibilityGraph(workspace, (0.3, 0.4)))
        assert distance.max() > 3


@pytest.mark.parametrize("max_bytes", [None, 300])
def test_rooms_that_are_cut_off_answer_inf_or_borrow(max_bytes):
    workspace = Workspace(BOUNDS, [rectangle(1.3, 0, 2.9, 3)])
    plr = solve_eikonal(PlaneSpace(workspace), (0.3, 0.4), max_leaves=300, max_bytes=max_bytes)
    check_bounds(plr, workspace, VisibilityGraph(workspace, (0.3, 0.4)))
    assert max_bytes or np.isinf(plr([[3.5, 1.5]])).all()
    assert np.isfinite(plr([[1.2, 1.5], [0.0, 0.0]])).all()


def test_bounds_hold_for_discs():
    problem, radius = scenes.single_door(), 0.4
    space, goal = PlaneSpace(problem.workspace, DiscRobot(radius)), problem.goals[0, :2]
    plr = solve_eikonal(space, goal, max_leaves=800)
    x = problem.workspace.inflate(radius).sample_free(4000, 0)
    # Arcs around corners are polygons within, whose distances are below the truth by at most 0.16 %; a radius that is
    # larger by so much that they hold the arcs gives distances above.
    below = VisibilityGraph(problem.workspace.inflate(radius), goal)(x)
    above = VisibilityGraph(problem.workspace.inflate(radius * 1.005), goal)(x)
    lower, upper = (np.asarray(bound) for bound in plr.bounds(x))
    assert (lower <= above + 1e-9).all() and (upper >= below - 1e-9).all()
    assert np.isfinite(upper).mean() > 0.8


@pytest.mark.parametrize("max_bytes", [None, 400])
def test_the_two_ends_of_a_periodic_axis_are_one_place(max_bytes):
    space = BoxSpace(Box((-2, 0), (2, 1), (True, False)), [(-0.7, 0.0), (-0.4, 0.6)])
    plr = solve_eikonal(space, (1.7, 0.3), max_leaves=400, max_bytes=max_bytes)
    y = np.linspace(0, 1, 301)
    ends = [np.stack([np.full_like(y, x), y], axis=1) for x in (-2.0, 2.0, 6.0)]
    for of in (plr, lambda x: np.stack(plr.bounds(x))):
        answers = [np.asarray(of(x)) for x in ends]
        np.testing.assert_array_equal(answers[0], answers[1])
        np.testing.assert_array_equal(answers[0], answers[2])
    # Unrolled, with the goal in the middle, it is a room of the plane: paths do not pass the seam on the far side.
    unrolled = Workspace(((-1.3, 0), (3.7, 1)), [rectangle(3.3, 0, 3.6, 0.6), rectangle(-0.7, 0, -0.4, 0.6)])
    x = unrolled.sample_free(4000, 0)
    x = x[np.abs(x[:, 0] - 1.7) < 1.9]
    distance = VisibilityGraph(unrolled, (1.7, 0.3))(x)
    lower, upper = (np.asarray(bound) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all()
    near = np.abs(x[:, 0] - 1.7) < 0.5  # where no way around is shorter
    assert (distance[near] <= upper[near] + 1e-9).all() and np.isfinite(upper).mean() > 0.9


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
@pytest.mark.parametrize("periodic", [False, True])
def test_bounds_hold_in_an_empty_box_of_any_dimension(dim, periodic):
    width = np.array([1.0, 2.0, 0.7, 1.0])[:dim]
    domain = Box(np.zeros(dim), width, [periodic] * dim)
    space, goal = BoxSpace(domain), width * 0.3
    plr = solve_eikonal(space, goal, max_leaves=(0, 60, 200, 600, 800)[dim])
    x = np.random.default_rng(0).random((3000, dim)) * width
    distance = space.motion_cost.lengths(x, np.tile(goal, (len(x), 1)), domain)
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()
    assert plr.max_error < np.inf
    assert np.mean(upper - lower) < (0, 0.05, 0.2, 0.7, 1.2)[dim] * distance.mean()


def test_bounds_hold_around_a_box_in_space():
    """Obstacles as high as the domain: the distance is that of the plane and the height, by Pythagoras."""
    plane = Workspace(((0, 0), (1, 1)), [rectangle(0.3, 0.2, 0.7, 0.6)])
    space = BoxSpace(Box(np.zeros(3), np.array([1, 1, 0.5])), [(0.3, 0.2, 0.0), (0.7, 0.6, 0.5)])
    goal = np.array([0.1, 0.3, 0.2])
    plr = solve_eikonal(space, goal, max_leaves=1500)
    x = np.column_stack([plane.sample_free(3000, 0), np.random.default_rng(0).uniform(0, 0.5, 3000)])
    distance = np.hypot(VisibilityGraph(plane, goal[:2])(x[:, :2]), x[:, 2] - goal[2])
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()
    assert np.isfinite(upper).mean() > 0.5


def test_costs_of_blocks_of_axes_add_up():
    space = BoxSpace(Box((0, 0), (1, 2)), blocks=(((0,), 2.0), ((1,), 0.5)))
    plr = solve_eikonal(space, (0.25, 1.5), max_leaves=200)
    x = np.random.default_rng(0).random((2000, 2)) * (1, 2)
    distance = 2 * np.abs(x[:, 0] - 0.25) + 0.5 * np.abs(x[:, 1] - 1.5)
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()
    np.testing.assert_allclose(plr(x), distance, atol=0.02)


def test_twice_the_cost_is_twice_the_distance():
    workspace = random_workspace(3)
    goal = workspace.sample_free(1, 3)[0]
    double = LipschitzCost(lambda q: np.full(len(q), 2.0), 0.0, 2.0)
    one = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=200)
    two = solve_eikonal(PlaneSpace(workspace), goal, cost_map=double, max_leaves=200)
    x = workspace.sample_free(1000, 0)
    np.testing.assert_allclose(two(x), 2 * np.asarray(one(x)), rtol=1e-6)
    distance = 2 * VisibilityGraph(workspace, goal)(x)
    lower, upper = (np.asarray(bound) for bound in two.bounds(x))
    assert (lower <= distance + 1e-9).all() and (distance <= upper + 1e-9).all()


class TwoGrounds:
    """Half planes of factors 1 and ``dear``, the interface at ``y = level``."""

    def __init__(self, level, dear):
        self.level, self.dear = level, dear

    def __call__(self, q):
        return np.where(np.asarray(q)[:, 1] < self.level, 1.0, self.dear)

    def bounds(self, lo, hi):
        return np.where(lo[:, 1] < self.level, 1.0, self.dear), np.where(hi[:, 1] > self.level, self.dear, 1.0)


def refracted(x, goal, level, dear, num=20_001):
    """Fermat's principle, by trying where to cross; the goal is below the level, along which one may also run."""
    cross = np.linspace(-1, 2, num)
    below = np.hypot(cross - goal[0], level - goal[1])
    result = []
    for px, py in x:
        if py >= level:
            result.append((below + dear * np.hypot(cross - px, py - level)).min())
        else:
            result.append(np.hypot(px - goal[0], py - goal[1]))
    return np.array(result)


@pytest.mark.parametrize("level", [0.5, 0.37])
def test_bounds_hold_where_paths_are_refracted(level):
    goal, dear = (0.2, 0.1), 3.0
    plr = solve_eikonal(EMPTY, goal, cost_map=TwoGrounds(level, dear), max_leaves=800)
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.random((600, 2)), np.column_stack([rng.random(60), level + rng.normal(0, 1e-7, 60)])])
    distance = refracted(x, goal, level, dear)
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-6).all() and (distance <= upper + 1e-6).all()
    assert np.mean(distance - lower) < 0.08 * distance.mean()


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
    with pytest.raises(ValueError, match="bounds must be two arrays"):
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
