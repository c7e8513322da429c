"""What a planner does within a step ends at the deadline, and is the same in portions."""

import numpy as np
import pytest
from planner_helpers import ROOM, joint_lattice_of, planned, search_budget
from team_helpers import MIXED, team_of

from plr_jax import BLOptions, DiscRobot, Problem, bl_plan, scenes
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners import Status, straight_line
from plr_jax.planners import lacam as team_moves
from plr_jax.planners import searches as level
from plr_jax.planners.bl import search as best_first
from plr_jax.planners.bl.search import heuristic_table, tabulate
from plr_jax.planners.lattice.build import PRIMITIVES
from plr_jax.planners.replanning import Conflicts
from plr_jax.planners.searches import Searches
from plr_jax.planners.smoothing import shorten, shorten_in_corridors

NEVER, LONG_AGO = float("inf"), -1.0  # on the clock
FAR_OFF = 1e12


def build(problem, deadline=NEVER, step=0.5):
    test = JointMotionTest(problem.workspace, problem.robots, deadline)
    lattices = level.build_level(problem, test, step, PRIMITIVES)
    assert lattices
    return lattices


def zigzag():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 1), (1, 8)], [(9, 1), (9, 8)])
    path = problem.starts + np.linspace(0, 1, 17)[:, None, None] * (problem.goals - problem.starts)
    path[1:-1:2, :, 1] += 0.2
    return problem, path


@pytest.mark.parametrize("searcher", ["lacam", "bl"])
def test_a_search_that_runs_out_of_time_within_a_step(searcher, monkeypatch):
    def too_late(*_):
        raise TimeoutError

    monkeypatch.setattr(JointMotionTest, "apart", too_late)
    monkeypatch.setattr(team_moves, "motions_apart", too_late)
    solution = bl_plan(scenes.four_rooms(2), None, BLOptions(searchers=(searcher,)))
    assert solution.status is Status.TIME_LIMIT
    assert not solution.solved


def test_every_test_of_motions_knows_the_deadline():
    lattices, budget = build(scenes.crowd(25)), search_budget()
    budget.deadline = LONG_AGO
    searches = Searches(lattices, None, 2.0, BLOptions(), budget)
    assert "lacam" in searches.running
    with pytest.raises(TimeoutError):
        heuristic_table(lattices.joint, searches.tables, 2.0, None, LONG_AGO)
    with pytest.raises(TimeoutError):
        Conflicts(lattices.kinds, 1e-9, searches.held).of(0, np.arange(5), 0)
    with pytest.raises(TimeoutError):
        searches.running["lacam"].moves(np.arange(25))


def test_shortening_ends_with_the_path_so_far():
    problem, path = zigzag()
    late = JointMotionTest(problem.workspace, problem.robots, LONG_AGO)
    np.testing.assert_array_equal(shorten(problem, path, late), path)
    np.testing.assert_array_equal(shorten_in_corridors(problem, path, late, 0.2), path)
    in_time = JointMotionTest(problem.workspace, problem.robots, FAR_OFF)
    assert (shorten(problem, path, in_time) != path).any()


def test_what_cannot_be_cut_short_is_not_begun_without_the_time(monkeypatch):
    problem = scenes.four_rooms(2)
    build(problem, FAR_OFF)
    monkeypatch.setattr(level, "_SECONDS", FAR_OFF)
    with pytest.raises(TimeoutError, match="before the edges of the lattices were known"):
        build(problem, FAR_OFF)
    build(problem)  # no limit


def test_costs_to_go_in_portions(monkeypatch):
    problem = scenes.door(6)
    whole = build(problem)
    monkeypatch.setattr(level, "_NODES", 1)
    for costs, expected in zip(build(problem).costs_to_go, whole.costs_to_go, strict=True):
        np.testing.assert_array_equal(costs, expected)


def test_moves_of_a_team_in_portions(monkeypatch):
    joint, moves = team_of(MIXED, 0.5)
    state = np.array([lattice.start for lattice in joint.lattices])
    state[2] = state[0]  # discs of one kind that meet
    whole = moves(state)
    monkeypatch.setattr(team_moves, "_MOST", 1)
    assert moves(state) == whole
    assert any(whole.neighbors)


def test_children_in_portions(monkeypatch):
    problem = scenes.four_rooms(2)
    options = {"searchers": ("bl",), "step": 0.5}
    whole = planned(problem, **options)
    sizes = []
    find = best_first.best_successors
    monkeypatch.setattr(best_first, "_PRODUCTS", 1)
    monkeypatch.setattr(best_first, "best_successors", lambda *a: sizes.append(len(a[2])) or find(*a))
    some = planned(problem, **options)
    np.testing.assert_array_equal(some.path, whole.path)
    assert some.stats.num_expansions == whole.stats.num_expansions
    assert set(sizes) == {1}


def test_tables_of_large_teams_are_evaluated_in_smaller_portions(monkeypatch):
    problem = scenes.crowd(40)
    joint, heuristic = joint_lattice_of(problem, 0.2), straight_line(problem)
    rows = []

    class Counting:
        def __call__(self, q):
            return heuristic(q)

        def per_robot(self, q):
            rows.append(q.shape[0] * q.shape[1])
            return heuristic.per_robot(q)

    whole = tabulate(joint, heuristic)
    monkeypatch.setattr("plr_jax.planners.bl.search._CHUNK", 300)
    for column, expected in zip(tabulate(joint, Counting()), whole, strict=True):
        np.testing.assert_array_equal(column, expected)
    assert max(rows) <= 300 * 16
