"""Lazy search: every path by the independent check, an empty stack against all states that can be reached."""

import numpy as np
import pytest
from planner_helpers import FOUR_NEIGHBORS, TRANSLATIONS, hallway, reachable, search_budget
from team_helpers import MIXED, search_of

from plr_jax import Problem, scenes, validate
from plr_jax.planners import Status


@pytest.mark.parametrize(
    ("problem", "step"),
    [
        (scenes.four_rooms(4), 0.4),
        (scenes.four_rooms(8), 0.4),
        (scenes.cross(3), 0.4),
        (scenes.door(20), 0.4),
        (scenes.crowd(25), 0.4),
        (scenes.crowd(40, seed=3), 0.4),
        (MIXED, 0.5),
    ],
    ids=["rooms-4", "rooms-8", "cross", "door", "crowd", "crowd-40", "mixed"],
)
def test_paths_are_valid_motions_of_the_lattices(problem, step):
    search = search_of(problem, step)
    assert search.run(10_000) is Status.SOLVED
    state = search.branch
    for i, lattice in enumerate(search.joint.lattices):
        assert (state[0, i], state[-1, i]) == (lattice.start, lattice.goal)
        for begin, end in zip(state[:-1, i], state[1:, i], strict=True):
            assert end in lattice.child[begin][np.isfinite(lattice.cost[begin])]
    report = validate(problem, search.joint.configurations(state))
    assert report.valid, report.message
    assert len(search.state) == search.budget.num_nodes and len(np.unique(search.state, axis=0)) == len(search.state)


@pytest.mark.parametrize("length", [3, 4, 5])
def test_an_empty_stack_means_that_all_reachable_states_are_nodes(length):
    search = search_of(hallway(length), 1.0)
    assert search.run(10**6) is Status.EXHAUSTED and search.found is None
    assert set(map(tuple, search.state.tolist())) == reachable(search.joint)


def test_turning_robots_that_cannot_turn_exhaust_it():
    search = search_of(scenes.tangle(), 0.9, TRANSLATIONS)
    assert search.run(10**6) is Status.EXHAUSTED
    assert set(map(tuple, search.state.tolist())) == reachable(search.joint)


def test_a_paused_search_goes_on_where_it_was():
    whole, paused = search_of(scenes.door(20), 0.4), search_of(scenes.door(20), 0.4)
    assert whole.run(10_000) is Status.SOLVED
    for patience in (2, 3, 5):
        assert paused.run(patience) is None and paused.num_idle == patience
    assert paused.run(10_000) is Status.SOLVED
    np.testing.assert_array_equal(whole.branch, paused.branch)


def test_limits():
    assert search_of(scenes.door(20), 0.4, budget=search_budget(max_expansions=7)).run(100) is Status.EXPANSION_LIMIT
    assert search_of(scenes.door(20), 0.4, budget=search_budget(max_memory=1e4)).run(100) is Status.MEMORY_LIMIT
    assert search_of(scenes.door(20), 0.4, budget=search_budget(seconds=-1.0)).run(100) is Status.TIME_LIMIT
    budget = search_budget()
    search = search_of(scenes.door(20), 0.4, FOUR_NEIGHBORS, budget)
    assert search.run(5) is None and budget.memory == search.held.num_bytes > 0


def test_a_team_at_its_goals_is_solved_from_the_start():
    problem = scenes.door(4)
    search = search_of(Problem(problem.workspace, problem.robots, problem.goals, problem.goals), 0.4)
    assert search.run(1) is Status.SOLVED and len(search.branch) == 1
