"""Robots planned again among the others: against NetworkX over time, and an independent test of paths."""

import time

import networkx as nx
import numpy as np
import pytest
from planner_helpers import search_budget
from team_helpers import TEAMS, search_of

from plr_jax import validate
from plr_jax.collision.motions import motions_apart
from plr_jax.planners import Status, reservations


def table_of(name, waiting=6, **limits):
    search = search_of(*TEAMS[name])
    assert search.run(10_000) is Status.SOLVED
    state = np.concatenate([search.solution_states, np.repeat(search.solution_states[-1:], waiting, axis=0)])
    table = reservations.ReservationTable(search.joint, state, search_budget(**limits))
    table.reserve([*range(state.shape[1])])
    return search.joint, table


def assert_blocked_as_from_scratch(table):
    fresh = reservations.ReservationTable(table.joint, table.state, search_budget())
    fresh.reserve([*range(table.state.shape[1])])
    for blocked, expected in zip(table.blocked, fresh.blocked, strict=True):
        np.testing.assert_array_equal(blocked, expected)


def cheapest_by_networkx(joint, table, i):
    """Return the cost of robot ``i``'s cheapest path through time among the motions of the others."""
    lattice, state = joint.lattices[i], table.state
    others = [j for j in range(len(joint.lattices)) if j != i]
    graph = nx.DiGraph()
    reached = {lattice.start}
    for step in range(len(state) - 1):
        begin = np.repeat(sorted(reached), lattice.cost.shape[1])
        primitive = np.tile(np.arange(lattice.cost.shape[1]), len(reached))
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


@pytest.mark.parametrize("name", ["rooms", "mixed"])
def test_replanned_robot_gets_cheapest_path(name):
    joint, table = table_of(name, waiting=3)
    expected, before = cheapest_by_networkx(joint, table, 0), table.cost[0]
    table.reserve([0], -1)
    assert table.replan(0, before) and table.cost[0] == pytest.approx(expected, rel=1e-12)
    table.reserve([0])
    assert table.cost[0] <= before * (1 + 1e-12)


def test_table_past_limit_raises():
    for error, limit in ((TimeoutError, {"seconds": -1.0}), (MemoryError, {"max_memory": 1e5})):
        with pytest.raises(error, match="before all collisions were found"):
            table_of("crowd", **limit)


def test_memory_use_counts_table_and_collisions():
    _, table = table_of("crowd")
    said = reservations.num_bytes_of_table(table.joint, len(table.state))
    taken = sum(blocked.nbytes for blocked in table.blocked)
    assert taken / 2 <= said <= 4 * taken
    known = [edges for of_pair in table._colliding_edges.values() for edges in of_pair.values()]
    assert table.budget.memory == table.memory_use.num_bytes >= said + sum(edges.nbytes for edges in known)
    assert all(edges.base is None for edges in known)
    table.memory_use.release()
    assert table.budget.memory == 0


def test_paths_stay_unchanged_past_deadline():
    _, table = table_of("crowd")
    state = table.state.copy()
    table.budget.deadline = time.perf_counter() - 1
    reservations.replan_each(table)
    reservations.replan_neighborhoods(table, 5, np.random.default_rng(0))
    assert not reservations.replan_together(table, [0, 1, 2])
    np.testing.assert_array_equal(table.state, state)
    assert_blocked_as_from_scratch(table)


@pytest.mark.parametrize("name", ["rooms", pytest.param("mixed", marks=pytest.mark.full)])
def test_every_table_is_a_valid_path_of_its_cost(name):
    joint, table = table_of(name)
    rng, costs = np.random.default_rng(0), [table.cost.sum()]

    def together(table):
        before = table.cost.sum()
        gained = reservations.replan_together(table, rng.permutation(min(len(table.cost), 4)).tolist())
        assert gained == (table.cost.sum() < before * (1 - 1e-9))

    def neighborhoods(table):
        reservations.replan_neighborhoods(table, 8, rng)

    for change in (reservations.replan_each, *[together] * 3, neighborhoods):
        change(table)
        costs.append(table.cost.sum())
        report = validate(joint.problem, joint.configurations(table.state))
        assert report.valid and report.cost == pytest.approx(costs[-1])
        assert (table.cost >= table.least_costs * (1 - 1e-9)).all()
        assert_blocked_as_from_scratch(table)
    assert costs[0] > costs[1] and (np.diff(costs) <= 1e-9 * costs[0]).all()
