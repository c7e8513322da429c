"""Robots planned anew among others: against NetworkX over time, and by the independent check."""

import time

import networkx as nx
import numpy as np
import pytest
from team_helpers import MIXED, search_of, team_of

from plr_jax import scenes, validate
from plr_jax.collision.pairs import motions_apart
from plr_jax.planners import Status
from plr_jax.planners.lacam.conflicts import Conflicts
from plr_jax.planners.lacam.timetable import (
    Timetable,
    num_bytes_of_timetable,
    replan_each,
    replan_neighbors,
    replan_together,
)

TEAMS = {"rooms": (scenes.four_rooms(4), 0.5), "crowd": (scenes.crowd(12), 0.4), "mixed": (MIXED, 0.6)}


def timetable_of(name, waiting=6, seconds=60.0):
    problem, step = TEAMS[name]
    search = search_of(problem, step)
    assert search.run(10_000) is Status.SOLVED
    state = np.concatenate([search.branch, np.repeat(search.branch[-1:], waiting, axis=0)])
    moves = search.moves
    deadline = time.perf_counter() + seconds
    return search.joint, Timetable(moves.kinds, moves.costs_to_go, state, problem.workspace.tolerance, deadline)


def blocked_from_scratch(timetable):
    fresh = Timetable(timetable.kinds, timetable.costs_to_go, timetable.state, timetable.conflicts.tolerance, np.inf)
    return fresh.blocked


def cheapest_by_networkx(joint, timetable, i):
    """The cost of robot ``i``'s cheapest path through time, each motion tested against the others' one by one."""
    lattice, state = joint.lattices[i], timetable.state
    others = [j for j in range(len(joint.lattices)) if j != i]
    graph = nx.DiGraph()
    reached = {lattice.start}
    for step in range(len(state) - 1):
        begin = np.repeat(sorted(reached), lattice.num_primitives)
        primitive = np.tile(np.arange(lattice.num_primitives), len(reached))
        free = np.isfinite(lattice.cost[begin, primitive])
        begin, primitive = begin[free], primitive[free]
        end = lattice.child[begin, primitive]
        clear = np.ones(len(begin), dtype=bool)
        robots, tolerance = joint.problem.robots, joint.problem.workspace.tolerance
        for j in others:
            q = joint.lattices[j].q[state[step : step + 2, j]]
            a0, a1 = lattice.q[begin], lattice.q[end]
            clear &= motions_apart(robots[i], a0, a1, robots[j], q[[0] * len(begin)], q[[1] * len(begin)], tolerance)
        cost = lattice.cost[begin, primitive]
        for b, e, c in zip(begin[clear].tolist(), end[clear].tolist(), cost[clear].tolist(), strict=True):
            known = graph.get_edge_data((step, b), (step + 1, e), {"cost": np.inf})["cost"]
            graph.add_edge((step, b), (step + 1, e), cost=min(c, known))
        reached = set(end[clear].tolist())
    return nx.dijkstra_path_length(graph, (0, lattice.start), (len(state) - 1, lattice.goal), "cost")


@pytest.mark.parametrize("name", TEAMS)
def test_conflicts_are_those_of_each_two_motions(name):
    problem, step = TEAMS[name]
    _, moves = team_of(problem, step)
    conflicts, rng = Conflicts(moves.kinds, problem.workspace.tolerance), np.random.default_rng(0)
    for a, ours in enumerate(moves.kinds):
        for b, others in enumerate(moves.kinds):
            edges = rng.integers(ours.edges.none, size=5)
            every = np.arange(others.edges.none)
            for edge, found in zip(edges.tolist(), conflicts.of(a, edges, b), strict=True):
                q0, q1 = (ours.table.q[[node[edge]] * len(every)] for node in (ours.edges.begin, ours.edges.end))
                p0, p1 = (others.table.q[node[every]] for node in (others.edges.begin, others.edges.end))
                free = motions_apart(ours.robot, q0, q1, others.robot, p0, p1, problem.workspace.tolerance)
                assert sorted(found.tolist()) == np.flatnonzero(~free).tolist()


@pytest.mark.parametrize("name", TEAMS)
def test_a_robot_gets_the_cheapest_path_among_the_others(name):
    joint, timetable = timetable_of(name)
    for i in range(min(4, timetable.num_robots)):
        expected = cheapest_by_networkx(joint, timetable, i)
        before = timetable.cost[i]
        timetable.leave(i)
        assert timetable.replan(i, before) and timetable.cost[i] == pytest.approx(expected, rel=1e-12)
        timetable.enter(i)
        assert timetable.cost[i] <= before * (1 + 1e-12)


@pytest.mark.parametrize("name", TEAMS)
def test_every_timetable_is_a_valid_path_of_what_it_says_to_cost(name):
    joint, timetable = timetable_of(name)
    rng, costs = np.random.default_rng(0), [timetable.cost.sum()]
    for change in (replan_each, lambda t: replan_neighbors(t, 8, rng)):
        change(timetable)
        costs.append(timetable.cost.sum())
        report = validate(joint.problem, joint.configurations(timetable.state))
        assert report.valid and report.cost == pytest.approx(costs[-1])
        assert (timetable.cost >= timetable.least * (1 - 1e-9)).all()
        for blocked, fresh in zip(timetable.blocked, blocked_from_scratch(timetable), strict=True):
            np.testing.assert_array_equal(blocked, fresh)
    assert costs[0] > costs[1] >= costs[2]


def test_a_group_that_gains_nothing_keeps_its_paths():
    _, timetable = timetable_of("rooms")
    replan_each(timetable)
    rng = np.random.default_rng(1)
    for _ in range(12):
        cost = timetable.cost.copy()
        gained = replan_together(timetable, rng.permutation(4).tolist())
        assert gained == (timetable.cost.sum() < cost.sum() * (1 - 1e-9))
        if not gained:
            assert timetable.cost.sum() <= cost.sum() * (1 + 1e-9)
        for blocked, fresh in zip(timetable.blocked, blocked_from_scratch(timetable), strict=True):
            np.testing.assert_array_equal(blocked, fresh)


def test_a_timetable_that_is_late_is_not_drawn_up():
    with pytest.raises(TimeoutError, match="deadline"):
        timetable_of("crowd", seconds=-1.0)


def test_a_timetable_takes_about_what_is_said():
    _, timetable = timetable_of("crowd")
    said = num_bytes_of_timetable(timetable.kinds, len(timetable.state))
    assert sum(blocked.nbytes for blocked in timetable.blocked) <= said


def test_after_the_deadline_paths_stay_as_they_are():
    _, timetable = timetable_of("crowd")
    state = timetable.state.copy()
    timetable.deadline = time.perf_counter() - 1
    replan_each(timetable)
    replan_neighbors(timetable, 5, np.random.default_rng(0))
    assert not replan_together(timetable, [0, 1, 2])
    np.testing.assert_array_equal(timetable.state, state)
    for blocked, fresh in zip(timetable.blocked, blocked_from_scratch(timetable), strict=True):
        np.testing.assert_array_equal(blocked, fresh)


def test_apart_is_what_the_joint_motion_test_says():
    joint, timetable = timetable_of("mixed")
    replan_each(timetable)
    q = joint.configurations(timetable.state)
    assert joint.test(q[:-1], q[1:]).all()
