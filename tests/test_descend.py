"""Paths by descent along a field in a workspace; ``test_lookahead.py`` tests other spaces and costs."""

import math

import numpy as np
import pytest
import shapely
from descent_helpers import descended
from piece_helpers import SEEDS, TEN, box
from space_helpers import far_from, nothing_known

from plr_jax import NearestGoal, PlaneSpace, VisibilityGraph, Workspace, construct, descend, scenes
from plr_jax._descend import DescentStatus
from plr_jax.geometry.corners import find_corners
from plr_jax.spaces import LipschitzCost
from plr_jax.spaces._space import CheckedFreeTest

REACHED, STUCK, NOT_FREE = DescentStatus
UNDEFINED_COST = LipschitzCost(lambda q: q[:, 0] * math.nan, lipschitz=1.0, least=1.0)
ROOM, SQUARE = Workspace(TEN), Workspace(((0, 0), (2, 2)))
DOOR = Workspace(TEN, [box(4, 0, 6, 7), box(4, 8, 6, 10)])
TRAP = Workspace(TEN, [box(3, 2, 7, 3), box(3, 7, 7, 8), box(6, 2, 7, 8)])  # a U, open to the left
POCKET = Workspace(TEN, [box(1, 1, 4, 2), box(1, 3, 4, 4), box(1, 1, 2, 4), box(3, 1, 4, 4)])


# --- drawn by hand ---------------------------------------------------------------------------------------


def test_paths_through_a_door_turn_at_its_corners():
    goal = (8, 2)
    expected = [[(2, 2), (4, 7), (6, 7), goal], [(2, 9.5), (4, 8), (6, 7), goal], [(8, 9), goal]]
    expected += [[(4, 7), (6, 7), goal], [(6, 7), goal], [(5, 7), (6, 7), goal]]
    descent = descended(VisibilityGraph(DOOR, goal), DOOR, [path[0] for path in expected], goal)
    for path, vertices in zip(descent.paths, expected, strict=True):
        np.testing.assert_array_equal(path, vertices)
    # Vertices of shorter paths are padded with the goal.
    assert descent.vertices.shape == (6, 4, 2)
    np.testing.assert_array_equal(descent.vertices[2, 1:], [goal] * 3)


def test_paths_leave_a_trap():
    goal, starts = (9, 5), np.array([[5.0, 5.0], [5.9, 5.0], [5.9, 3.1], [1.0, 5.0]])
    exact = VisibilityGraph(TRAP, goal)(starts)
    np.testing.assert_allclose(descended(far_from(goal), TRAP, starts, goal).lengths, exact, rtol=1e-12)
    in_space = descended(far_from(goal), PlaneSpace(TRAP), starts, goal)
    assert (in_space.costs >= exact - 1e-9).all() and (in_space.costs <= 1.05 * exact).all()
    # The path of a start does not depend on other starts.
    alone = descended(far_from(goal), PlaneSpace(TRAP), starts[2:3], goal)
    np.testing.assert_array_equal(alone.paths[0], in_space.paths[2])
    assert alone.costs[0] == in_space.costs[2]


def test_errors_of_the_field_do_not_trap_paths():
    """Corners are closer together than the error of the field, which leads in circles around them."""
    problem = scenes.thin_maze()
    workspace, goal = problem.workspace, problem.goals[0]
    exact, rng, starts = VisibilityGraph(workspace, goal), np.random.default_rng(0), workspace.sample_free(80, 0)
    descent = descended(lambda x: exact(x) + rng.uniform(-0.2, 0.2, len(x)), workspace, starts, goal)
    assert descent.reached.all() and (descent.lengths <= exact(starts) + 2 * 0.2 * 8).all()


@pytest.mark.parametrize("is_exact", [True, False])
def test_paths_end_at_the_nearest_of_several_goals(is_exact):
    workspace = scenes.maze().workspace
    goals = [*workspace.sample_free(3, 7), find_corners(workspace)[0].points[0]]
    goals, starts = np.array([*goals, goals[0]]), workspace.sample_free(60, 1)
    starts[:5] = goals
    nearest = NearestGoal([VisibilityGraph(workspace, goal) for goal in goals])
    descent = descended(nearest if is_exact else nothing_known, workspace, starts, goals)
    least, ends = nearest(starts), descent.vertices[:, -1]
    assert descent.reached.all() and (descent.lengths >= least * (1 - 1e-12)).all()
    if is_exact:
        np.testing.assert_allclose(descent.lengths, least, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(ends, goals[nearest.which(starts)])


def test_paths_end_at_the_nearest_goal_whatever_the_field_is_at_goals():
    goals, starts = np.array([(2.0, 2.0), (8.0, 2.0)]), DOOR.sample_free(40, 0)
    oracles = [VisibilityGraph(DOOR, goal) for goal in goals]
    distances = np.stack([oracle(starts) for oracle in oracles])
    descent = descended(lambda x: np.minimum(oracles[0](x) + 6, oracles[1](x)), DOOR, starts, goals)
    np.testing.assert_allclose(descent.lengths, distances.min(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(descent.vertices[:, -1], goals[distances.argmin(axis=0)])
    assert (distances[0] < distances[1])[distances[0] + 6 > distances[1]].any(), "the field prefers the other goal"


def test_statuses_of_starts():
    starts = [(5, 5), (2.5, 2.5), (1.5, 1.5), (-1, 5), (np.nan, 5), (8, 8)]
    for space in (POCKET, PlaneSpace(POCKET)):
        descent = descended(VisibilityGraph(POCKET, (8, 8)), space, starts, (8, 8))
        assert descent.status.tolist() == [REACHED, STUCK, NOT_FREE, NOT_FREE, NOT_FREE, REACHED]
        assert "goal" in descent.status[0].value and "2 of 6" in repr(descent)
        np.testing.assert_array_equal(descent.counts, [2, 0, 0, 0, 0, 1])
        np.testing.assert_array_equal(descent.costs[1:], [math.inf] * 4 + [0.0])
        assert np.isnan(descent.vertices[1]).all()
    within = descended(nothing_known, POCKET, [(2.2, 2.2), (5, 5)], (2.5, 2.5))
    assert within.status.tolist() == [REACHED, STUCK]


def test_goals_on_corners_and_walls():
    starts = np.concatenate([DOOR.sample_free(10, 1), [(4, 7), (6, 8), (0, 0), (10, 10), (4, 3)]])
    for goal in ((4, 7), (5, 7), (6, 3), (10, 10), (6, 8), (4 + 1e-10, 7)):
        exact = VisibilityGraph(DOOR, goal)
        np.testing.assert_allclose(descended(exact, DOOR, starts, goal).lengths, exact(starts), atol=1e-8)


def overwriting_its_input(x):
    x -= (8, 2)
    return np.hypot(*x.T)


def test_useless_fields_still_give_shortest_paths():
    starts = DOOR.sample_free(20, 0)
    exact = VisibilityGraph(DOOR, (8, 2))(starts)
    for field in (lambda x: np.full(len(x), np.inf), lambda x: np.ma.masked_all(len(x)), overwriting_its_input):
        np.testing.assert_allclose(descended(field, DOOR, starts, (8, 2)).lengths, exact, rtol=1e-12)


@pytest.mark.parametrize("space", [ROOM, PlaneSpace(DOOR)])
def test_no_starts_give_no_paths(space):
    assert descended(nothing_known, space, np.empty((0, 2)), (8, 2)).vertices.shape[0] == 0


def test_paths_in_an_empty_room_are_straight():
    straight = descended(nothing_known, ROOM, ROOM.sample_free(20, 0), (2, 3))
    assert straight.reached.all() and (straight.counts == 2).all()


@pytest.mark.parametrize(
    ("field", "space", "starts", "goal", "cost_map", "message"),
    [
        (nothing_known, DOOR, np.zeros(2), (8, 2), None, r"starts must have shape \(n, 2\).*starts\[None\]"),
        (nothing_known, DOOR, [(1, 1)], (8, 2, 0), None, "The goal must be one point"),
        (nothing_known, DOOR, [(1, 1)], (5, 2), None, "The goal must be in free space"),
        (nothing_known, DOOR, [(1, 1)], [(1, 1), (5, 2)], None, r"must be in free space, got \[5.0, 2.0\]"),
        (nothing_known, DOOR, [(1, 1)], np.empty((0, 2)), None, "one point .* or several .* got none"),
        (None, DOOR, [(1, 1)], (8, 2), None, "distance_fn must be a function, got None"),
        (lambda x: x, DOOR, [(1, 1)], (8, 2), None, "one number per point"),
        (lambda x: np.full(len(x), -np.inf), DOOR, [(1, 1)], (8, 2), None, "-inf at .*use inf"),
        (lambda x: np.full(len(x), np.nan), PlaneSpace(DOOR), [(1, 1)], (8, 2), None, "NaN at .*use inf"),
        (nothing_known, 3, [(1, 1)], (1, 1), None, "space must be a configuration space"),
        (nothing_known, CheckedFreeTest(PlaneSpace(DOOR)), [(1, 1)], (1, 1), None, "must have classify and are_free"),
        (nothing_known, PlaneSpace(SQUARE), [(1, 1)], (3, 1), None, "The goal must be a free configuration"),
        (nothing_known, PlaneSpace(SQUARE), [(1, 1)], (1, 1, 1), None, "The goal must be one point"),
        (nothing_known, SQUARE, [(1, 1)], (1, 1), 2.0, "cost_map must be a CostMap"),
        (nothing_known, SQUARE, [(0.5, 0.5)], (1, 1), UNDEFINED_COST, "finite numbers of at least 1"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_arguments_raise(field, space, starts, goal, cost_map, message):
    with pytest.raises(ValueError, match=message):
        descend(field, space, starts, goal, cost_map=cost_map)


# --- PLRs ------------------------------------------------------------------------------------------------


def test_paths_along_a_plr_are_shortest():
    problem = scenes.thin_maze()
    workspace, goal = problem.workspace, problem.goals[0]
    exact, starts = VisibilityGraph(workspace, goal), workspace.sample_free(100, 3)
    plr = construct(exact, workspace.bounds, max_bytes=1024)
    descent = descended(plr, workspace, starts, goal)
    np.testing.assert_allclose(descent.lengths, exact(starts), rtol=1e-9)
    np.testing.assert_array_equal(descend(plr, workspace, starts, goal).vertices, descent.vertices)
    # The path of a start does not depend on other starts.
    np.testing.assert_array_equal(descend(plr, workspace, starts[7:8], goal).paths[0], descent.paths[7])


def test_accurate_field_saves_visibility_tests(monkeypatch):
    problem, is_visible, tests = scenes.floor_plan(), Workspace.is_visible, []
    workspace, goal = problem.workspace, problem.goals[0]

    def counted(self, a, b):
        tests[-1] += len(a)
        return is_visible(self, a, b)

    monkeypatch.setattr(Workspace, "is_visible", counted)
    for field in (VisibilityGraph(workspace, goal), nothing_known):
        tests.append(0)
        descend(field, workspace, np.empty((0, 2)), goal)
    assert 0 < 2 * tests[0] < tests[1]


# --- any obstacles ---------------------------------------------------------------------------------------


def hall(seed):
    """Return a workspace of up to five convex obstacles on a lattice, which may touch, and a goal on the lattice."""
    rng, lattice = np.random.default_rng(seed), np.argwhere(np.ones((41, 41))) / 4
    corners = rng.integers(0, 33, (seed % 6, 1, 2))
    hulls = [shapely.MultiPoint((corner + rng.integers(0, 13, (5, 2))) / 4).convex_hull for corner in corners]
    workspace = Workspace(((-1, -1), (12, 12)), hulls)
    return workspace, rng.permutation(lattice[workspace.is_free(lattice)])[0]


@pytest.mark.parametrize("seed", [*SEEDS, *range(24, 30)])
def test_every_start_with_a_path_reaches_the_goal(seed):
    (workspace, goal), error = hall(seed), seed / 8
    exact, rng = VisibilityGraph(workspace, goal), np.random.default_rng(seed)
    starts = np.concatenate([workspace.sample_free(10, seed), rng.uniform(-1.5, 12.5, (5, 2))])
    distance = exact(starts)
    np.testing.assert_allclose(descended(exact, workspace, starts, goal).lengths, distance, rtol=1e-7, atol=1e-7)
    for field in (lambda x: exact(x) + rng.uniform(-error, error, len(x)), nothing_known):
        descent = descended(field, workspace, starts, goal)
        np.testing.assert_array_equal(descent.reached, np.isfinite(distance))
        assert (descent.lengths >= distance - 1e-7).all()
