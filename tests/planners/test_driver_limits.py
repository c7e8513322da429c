"""The planner at its limits of expansions, memory, time and cost, and when it is interrupted."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from planner_helpers import DOOR, ROOMS, exact, hallway, joint_lattice_of, nudged_discs, nudged_team, planned
from team_helpers import FIVE

from plr_jax import BLOptions, Problem, RectangleRobot, Workspace, bl_plan, exact_lower_bound, scenes, validate, zero
from plr_jax.collision.motions import JointMotionTest
from plr_jax.planners import Status, best_first, driver, lacam, lattice, searches, straight_line, sum_of_distances
from plr_jax.planners.lacam import PIBT

DOOR_STRAIGHT = np.hypot(8.21 - 2.13, 2.07 - 1.94)
NUDGED_BARS = nudged_team(RectangleRobot(0.4, 0.1))


LIMITS = [
    ({"max_expansions": 3}, Status.EXPANSION_LIMIT),
    ({"max_memory": 4000}, Status.MEMORY_LIMIT),
    ({"max_memory": 1_500_000}, Status.MEMORY_LIMIT),
    ({"step": 1e-3, "max_memory": 1e8}, Status.MEMORY_LIMIT),
    ({"step": 1e-200}, Status.MEMORY_LIMIT),
    ({"step": 2e-2, "time_limit": 0.05}, Status.TIME_LIMIT),
    ({"time_limit": 1e-6}, Status.TIME_LIMIT),
]


@pytest.mark.parametrize(("options", "status"), LIMITS)
def test_planner_stops_at_limit(options, status):
    solution = bl_plan(ROOMS, zero(), BLOptions(("bl",), **options))
    assert solution.status is status and not solution.solved and solution.cost == np.inf
    # Discs that can go one after the other have a path, which is within the infinite cost factor.
    solution = planned(ROOMS, zero(), **options)
    assert solution.status is Status.SOLVED and solution.stats.found_by == "sequential"


@pytest.mark.parametrize("max_expansions", [1, 29, 29.5])
def test_expansions_never_exceed_their_limit(max_expansions):
    # Of a hallway no path leads out, so that the search widens to whole batches.
    solution = bl_plan(hallway(9), zero(), BLOptions(step=0.3, max_expansions=max_expansions))
    assert solution.status is Status.EXPANSION_LIMIT
    assert solution.stats.num_expansions == int(max_expansions)


def test_planner_stops_at_cost_factor():
    content = planned(ROOMS, exact(ROOMS), cost_factor=1.5, searchers=("bl",))
    assert content.status is Status.SOLVED and content.cost <= 1.5 * content.lower_bound
    assert content.stats.num_expansions == planned(ROOMS, exact(ROOMS), searchers=("bl",)).stats.num_expansions > 0
    content = planned(ROOMS, exact(ROOMS), cost_factor=1.5)
    assert content.status is Status.SOLVED and content.stats.num_expansions == 0


def test_planner_improves_its_path_until_limit():
    problem = scenes.cross(2)
    first = planned(problem, exact(problem))
    same = planned(problem, exact(problem), cost_factor=1.0, max_expansions=first.stats.num_expansions)
    assert same.cost <= first.cost
    best = planned(problem, exact(problem), cost_factor=1.0, max_expansions=first.stats.num_expansions + 120)
    assert best.status is Status.EXPANSION_LIMIT and best.cost < first.cost
    assert best.stats.num_expansions > first.stats.num_expansions


def test_lower_bound_option_counts():
    alone = exact_lower_bound(DOOR)
    solution = bl_plan(DOOR, straight_line(DOOR), BLOptions(cost_factor=1.05, lower_bound=alone))
    assert solution.status is Status.SOLVED and solution.lower_bound == alone
    assert solution.factor == solution.cost / solution.lower_bound <= 1.05
    below = bl_plan(DOOR, straight_line(DOOR), BLOptions(lower_bound=0.1))
    assert below.lower_bound == pytest.approx(DOOR_STRAIGHT), "straight lines are a better one"


def test_only_lower_bound_heuristics_prove_bounds():
    oracle = exact(DOOR)
    alone = float(oracle(DOOR.starts[None])[0])
    assert oracle.is_lower_bound and not sum_of_distances([lambda x: np.zeros(len(x))]).is_lower_bound
    solution = planned(DOOR, oracle)
    assert solution.lower_bound == pytest.approx(alone) and solution.lower_bound <= alone
    assert 1 <= solution.factor < 1.02 and 1 <= solution.motions_factor < 1.2
    unknown = bl_plan(DOOR, replace(oracle, per_robot=lambda q: 1e3 + oracle.per_robot(q), is_lower_bound=False))
    assert unknown.lower_bound == pytest.approx(DOOR_STRAIGHT), "it may be above the truth"


def test_free_turns_give_infinite_motions_factor():
    ends = [(4.5, 4.5, 0), (4.5, 5.5, 0)], [(4.5, 4.5, np.pi), (4.5, 5.5, np.pi)]
    problem = Problem(Workspace(((0, 0), (9, 10))), [RectangleRobot(3, 1)] * 2, *ends, rotation_weight=0)
    solution = bl_plan(problem, options=BLOptions(step=1.0))
    assert solution.solved and solution.cost > 0 and solution.motions_factor == np.inf


def interrupt_at(monkeypatch, owner, name, at):
    """Raise KeyboardInterrupt in the ``at``-th call of a function."""
    function, calls = getattr(owner, name), []

    def interrupted(*arguments):
        calls.append(name)
        if len(calls) == at:
            raise KeyboardInterrupt
        return function(*arguments)

    monkeypatch.setattr(owner, name, interrupted)


def test_interrupted_planner_returns_best_path(monkeypatch):
    first = planned(DOOR, exact(DOOR), step=0.5, searchers=("bl",))
    with monkeypatch.context() as patched:
        interrupt_at(patched, best_first.BestFirstSearch, "_add_child", 2 * first.stats.num_nodes)
        solution = planned(DOOR, exact(DOOR), step=0.5, cost_factor=1.0, searchers=("bl",))
    assert solution.status is Status.INTERRUPTED
    assert solution.cost <= first.cost and solution.stats.history[0][1] == first.stats.history[0][1]
    assert solution.stats.num_nodes > first.stats.num_nodes and solution.stats.seconds["search"] > 0
    for owner, name, at, num_nodes in ((searches, "tabulate", 1, 0), (PIBT, "find", 6, 6)):  # before the first path
        with monkeypatch.context() as patched:
            interrupt_at(patched, owner, name, at)
            problem = scenes.door(20)
            solution = bl_plan(problem, straight_line(problem), BLOptions(("lacam",)))
        assert solution.status is Status.INTERRUPTED and not solution.solved
        assert solution.stats.num_nodes == num_nodes and len(solution.samples) == max(num_nodes, 1)


def test_interrupted_sequential_path_gets_early_departures(monkeypatch):
    problem = scenes.four_rooms(3)
    interrupt_at(monkeypatch, driver, "first_step", 1)
    solution = planned(problem, None)
    assert solution.status is Status.INTERRUPTED and solution.makespan < 0.8 * solution.cost
    interrupt_at(monkeypatch, driver, "with_early_departures", 1)
    solution = planned(problem, None)
    assert solution.status is Status.INTERRUPTED and solution.makespan == pytest.approx(solution.cost)


def test_search_begins_only_if_its_tables_fit():
    problem = scenes.four_rooms(8)
    # The lattices fit, the tables of each robot's motions do not.
    solution = bl_plan(problem, options=BLOptions(searchers=("bl",), step=0.4, max_memory=1e6, time_limit=5))
    assert solution.status is Status.MEMORY_LIMIT and not solution.solved
    np.testing.assert_array_equal(solution.samples, problem.starts[None])
    assert 1e6 < solution.stats.num_bytes < 1.2e6
    # LaCAM has no such tables, so they do not count.
    solution = bl_plan(problem, options=BLOptions(searchers=("lacam",), step=0.4, max_memory=7.6e5))
    assert solution.status is Status.MEMORY_LIMIT and 7.6e5 <= solution.stats.num_bytes < 7.7e5


def test_coarser_lattice_is_tried_if_memory_is_short():
    problem = scenes.door(2)
    roomy = bl_plan(problem, options=BLOptions(searchers=("lacam",)))
    tight = bl_plan(problem, options=BLOptions(searchers=("lacam",), max_memory=0.95 * roomy.stats.num_bytes))
    # The solution states the bytes that the first lattice would have taken.
    assert tight.solved and tight.stats.num_bytes == roomy.stats.num_bytes
    assert tight.stats.history[0][1] != roomy.stats.history[0][1]
    none = bl_plan(problem, options=BLOptions(searchers=("lacam",), max_memory=1000))
    assert none.status is Status.MEMORY_LIMIT and none.stats.num_bytes > 1000


@pytest.mark.parametrize("limit", [0.05, 0.3])
def test_path_at_time_limit_is_valid(limit):
    problem = scenes.crowd(15)
    solution = bl_plan(problem, options=BLOptions(time_limit=limit, cost_factor=1.0))
    assert solution.status is Status.TIME_LIMIT
    if solution.solved:
        assert validate(problem, solution.path).valid and solution.motions_factor >= 1


# No other test uses these steps: motions are cached per workspace and step.
LATTICES = [(nudged_discs(4), 0.21), (nudged_discs(7), 1.9), (NUDGED_BARS, 0.51), (FIVE, 0.9)]


@pytest.mark.parametrize(("problem", "step"), LATTICES, ids=["fine", "coarse", "bars", "mixed"])
def test_lattice_bytes_match_estimate(problem, step):
    _ = joint_lattice_of(problem, 1.5 * step).costs_to_go  # fills caches that all steps share
    tracemalloc.start()
    try:
        joint = joint_lattice_of(problem, step)
        _ = joint.costs_to_go
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    said = searches.num_bytes(problem, step)
    assert 0.3 * said < held < 1.1 * said


@pytest.mark.parametrize("searcher", searches.SEARCHES)
def test_timeout_within_search_step_is_a_time_limit(searcher, monkeypatch):
    def too_late(*_):
        raise TimeoutError

    monkeypatch.setattr(JointMotionTest, "apart", too_late)
    monkeypatch.setattr(lacam, "motions_apart", too_late)
    solution = bl_plan(scenes.four_rooms(2), None, BLOptions(searchers=(searcher,)))
    assert solution.status is Status.TIME_LIMIT and not solution.solved


def test_costs_to_go_are_not_begun_without_enough_time(monkeypatch):
    monkeypatch.setattr(lattice, "_SECONDS", 1e12)
    with pytest.raises(TimeoutError, match="before the costs-to-go were known"):
        _ = joint_lattice_of(ROOMS, 0.5, 1e12).costs_to_go
    assert len(joint_lattice_of(ROOMS, 0.5).costs_to_go) == 2  # no limit
