"""The lattices of one step: what robots share, what they take, and that all work on them ends at the deadline."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from planner_helpers import joint_lattice_of, nudged_discs, nudged_team, planned, search_budget
from team_helpers import MIXED, team_of

from plr_jax import BLOptions, DiscRobot, Problem, RectangleRobot, bl_plan, scenes
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners import Status, best_first, driver, lacam, straight_line
from plr_jax.planners._options import PRIMITIVES

LONG_AGO, FAR_OFF, NEVER = -1.0, 1e12, float("inf")  # on the clock
NUDGED_BARS = nudged_team(RectangleRobot(0.4, 0.1))


def level_of(problem, step, deadline=NEVER):
    test = JointMotionTest(problem.workspace, problem.robots, deadline)
    level = driver.build_level(problem, test, step, PRIMITIVES)
    assert level is not None
    return level


@pytest.mark.parametrize("problem", [nudged_discs(8), NUDGED_BARS], ids=["discs", "bars"])
def test_robots_with_both_ends_in_one_cell_are_of_one_kind(problem):
    level = level_of(problem, 0.8)
    (kind,) = level.kinds
    assert kind.members.tolist() == list(range(len(problem.robots)))
    straight = np.hypot(*(problem.goals - problem.starts).T[:2])
    assert (level.least_costs >= straight * (1 - 1e-9)).all()
    if problem.dof == 2:
        np.testing.assert_allclose(level.least_costs, straight)


# Steps that no other test takes, as motions are kept for the next problem in a workspace.
@pytest.mark.parametrize(
    ("problem", "step"),
    [(nudged_discs(8), 0.21), (nudged_discs(15), 1.9), (NUDGED_BARS, 0.31), (MIXED, 0.39)],
    ids=["nudged discs", "coarse", "nudged bars", "mixed"],
)
def test_lattices_take_as_many_bytes_as_they_say(problem, step):
    level_of(problem, 1.5 * step)  # what is made once, for all steps
    tracemalloc.start()
    try:
        level = level_of(problem, step)
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert 0.3 * level.num_bytes < held < 1.1 * level.num_bytes


def test_a_table_is_counted_once_for_all_that_share_it_and_ends_count_as_nodes():
    alike = nudged_discs(4)
    unlike = Problem(alike.workspace, [DiscRobot(0.2 + 0.01 * i) for i in range(16)], alike.starts, alike.goals)
    assert driver.num_bytes(unlike, 0.5, 8) > 4 * driver.num_bytes(alike, 0.5, 8)
    coarse, fine = (driver.num_bytes(nudged_discs(1), step, 8) for step in (0.5, 0.25))
    assert fine / coarse == pytest.approx((64 + 2) / (16 + 2))


# Deadlines


@pytest.mark.parametrize("searcher", ["lacam", "bl"])
def test_a_search_that_runs_out_of_time_within_a_step(searcher, monkeypatch):
    def too_late(*_):
        raise TimeoutError

    monkeypatch.setattr(JointMotionTest, "apart", too_late)
    monkeypatch.setattr(lacam, "motions_apart", too_late)
    solution = bl_plan(scenes.four_rooms(2), None, BLOptions(searchers=(searcher,)))
    assert solution.status is Status.TIME_LIMIT
    assert not solution.solved


def test_every_test_of_motions_knows_the_deadline():
    level, budget = level_of(scenes.crowd(25), 0.5), search_budget()
    budget.deadline = LONG_AGO
    late = driver.Searches(level, None, 2.0, BLOptions(), budget)
    assert "lacam" in late.running
    with pytest.raises(TimeoutError):
        best_first.heuristic_table(level.joint, late.tables, 2.0, None, LONG_AGO)
    with pytest.raises(TimeoutError):
        late.running["lacam"].moves(np.arange(25))


def test_what_cannot_be_cut_short_is_not_begun_without_the_time(monkeypatch):
    problem = scenes.four_rooms(2)
    level_of(problem, 0.5, FAR_OFF)
    monkeypatch.setattr(driver, "_SECONDS", FAR_OFF)
    with pytest.raises(TimeoutError, match="before the costs-to-go were known"):
        level_of(problem, 0.5, FAR_OFF)
    level_of(problem, 0.5)  # no limit


# Portions


def test_costs_to_go_in_portions(monkeypatch):
    whole = level_of(scenes.door(6), 0.5)
    monkeypatch.setattr(driver, "_NODES", 1)
    for costs, expected in zip(level_of(scenes.door(6), 0.5).costs_to_go, whole.costs_to_go, strict=True):
        np.testing.assert_array_equal(costs, expected)


def test_moves_of_a_team_in_portions(monkeypatch):
    joint, moves = team_of(MIXED, 0.5)
    state = np.array([lattice.start for lattice in joint.lattices])
    state[2] = state[0]  # discs of one kind that meet
    whole = moves(state)
    monkeypatch.setattr(lacam, "_MOST", 1)
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
    problem, rows = scenes.crowd(40), []
    joint, heuristic = joint_lattice_of(problem, 0.2), straight_line(problem)
    whole = best_first.tabulate(joint, heuristic)
    counted = replace(heuristic, per_robot=lambda q: rows.append(q[..., 0].size) or heuristic.per_robot(q))
    monkeypatch.setattr(best_first, "_CHUNK", 300)
    for column, expected in zip(best_first.tabulate(joint, counted), whole, strict=True):
        np.testing.assert_array_equal(column, expected)
    assert 0 < max(rows) <= 300 * 16
