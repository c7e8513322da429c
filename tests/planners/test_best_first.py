import heapq

import networkx as nx
import numpy as np
import pytest
import shapely
from planner_helpers import (
    FOUR_NEIGHBORS,
    ROOM,
    exact,
    graph_of,
    hallway,
    heuristic_table,
    joint_lattice_of,
    reachable,
    search_budget,
)

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace, scenes, validate
from plr_jax.planners import BLOptions, Status, straight_line, zero
from plr_jax.planners._options import PRIMITIVES
from plr_jax.planners.best_first import BestFirstSearch, bytes_of_tables, claimed_cells

BLOCKS = Workspace(((0, 0), (8, 8)), [shapely.box(2, 0, 3, 6), shapely.box(5, 2, 6, 8), shapely.box(0, 6.0, 1, 7)])
LABYRINTH = Problem(BLOCKS, [DiscRobot(0.3)], [(0.5, 0.5)], [(7.5, 7.5)])
CELL = Problem(Workspace(((0, 0), (3, 2))), [DiscRobot(0.4)] * 2, [(0.5, 0.5), (2.5, 1.5)], [(2.5, 1.5), (0.5, 0.5)])
ENDS = [(0.5, 0.5), (1.5, 0.5), (2.5, 1.5)]
THREE = Problem(CELL.workspace, [DiscRobot(0.4)] * 3, ENDS, ENDS[::-1])
MIXED = Problem(
    Workspace(((0, 0), (2, 2))),
    [DiscRobot(0.3), RectangleRobot(0.8, 0.3)],
    [(0.5, 0.5, 1), (1.5, 1.5, 0)],
    [(1.5, 1.5, 1), (0.5, 0.5, 0)],
)


def search_of(problem, step, heuristic=None, weight=1.0, primitives=PRIMITIVES, limits=None, **options):
    joint = joint_lattice_of(problem, step, primitives)
    estimate = heuristic_table(joint, heuristic or straight_line(problem), weight)
    return BestFirstSearch(joint, estimate, BLOptions(**{"batch": 1, **options}), limits or search_budget())


def run_on(search):
    """Search until something other than a pause comes of it."""
    status, turn = None, 256
    while status is None:
        status = search.run(turn)
        turn *= 2
    return status


def nodes_by_the_book(lattice, table, weight):
    """Nodes in the order in which best-first search with partial expansion makes them, one robot and child a time."""
    term = (lattice.cost + weight * table[lattice.child]).astype(np.float32)
    states, costs, claimed, found = [lattice.start], [0.0], {lattice.start}, lattice.start == lattice.goal
    frontier, pushed, left = [(weight * table[lattice.start], 0, 0)], 0, {}
    while frontier and not found:
        node = heapq.heappop(frontier)[2]
        state = states[node]
        if node not in left:
            order = np.argsort(term[state], kind="stable")
            left[node] = [int(p) for p in order if np.isfinite(term[state, p])]
        unclaimed = [p for p in left[node] if lattice.child[state, p] not in claimed]
        if unclaimed:
            best, child = unclaimed[0], int(lattice.child[state, unclaimed[0]])
            states.append(child)
            costs.append(costs[node] + lattice.cost[state, best])
            claimed.add(child)
            pushed += 1
            heapq.heappush(frontier, (costs[node] + term[state, best], -pushed, len(states) - 1))
            found = child == lattice.goal
        left[node] = [p for p in unclaimed[1:] if lattice.child[state, p] not in claimed]
        if left[node]:
            pushed += 1
            heapq.heappush(frontier, (costs[node] + term[state, left[node][0]], -pushed, node))
    return states, costs


# What is found


@pytest.mark.parametrize("branching", [1, 10_000])
def test_without_heuristic_every_cell_has_its_distance_where_motions_are_equal(branching):
    # A cell is claimed when a child is made, not when it is expanded. On four neighbors of equal cost, the nodes of
    # one cost come before those of the next, and no two of one cost are neighbors: then the first claim is the best.
    search = search_of(LABYRINTH, 1.0, zero(), 0.0, FOUR_NEIGHBORS, branching=branching)
    search.goal = np.array([-1])
    (lattice,) = search.joint.lattices
    assert run_on(search) is Status.EXHAUSTED
    expected = nx.single_source_dijkstra_path_length(graph_of(lattice), lattice.start, weight="cost")
    costs = dict(zip(search.state[:, 0].tolist(), search.costs, strict=True))
    assert costs == expected and costs[lattice.goal] == 24.0


@pytest.mark.parametrize(
    ("problem", "step", "weight"),
    [
        (scenes.single_door(), 0.4, 0.0),
        (scenes.single_door(), 0.4, 1.0),
        (scenes.maze(), 0.04, 2.0),
        (LABYRINTH, 0.6, 3.0),
    ],
    ids=["door-0", "door-1", "maze-2", "labyrinth-3"],
)
def test_nodes_come_in_the_order_of_the_book(problem, step, weight):
    search = search_of(problem, step, weight=weight)
    assert run_on(search) is Status.SOLVED
    states, costs = nodes_by_the_book(search.joint.lattices[0], search.estimate.tables[0], weight)
    assert search.state[:, 0].tolist() == states
    np.testing.assert_allclose(search.costs, costs, rtol=1e-12)


@pytest.mark.parametrize(
    ("problem", "branching", "batch", "weight"),
    [
        (scenes.single_door(), 1, 1, 0.0),
        (scenes.single_door(), 3, 16, 1.0),
        (scenes.single_door(), 100, 16, 5.0),
        (scenes.cross(2), 1, 16, 2.0),
        (scenes.cross(2), 1000, 16, 2.0),
    ],
)
def test_a_branch_is_a_sequence_of_motions_that_costs_what_the_tree_says(problem, branching, batch, weight):
    search = search_of(problem, 0.5, exact(problem), weight, branching=branching, batch=batch)
    assert run_on(search) is Status.SOLVED
    lattices, (first, *_, last) = search.joint.lattices, search.branch
    assert [(each.start, each.goal) for each in lattices] == list(zip(first, last, strict=True))
    report = validate(problem, search.joint.configurations(search.branch))
    assert report.valid and report.cost == pytest.approx(search.costs[search.found])
    least = sum(nx.dijkstra_path_length(graph_of(each), each.start, each.goal, "cost") for each in lattices)
    assert report.cost >= least - 1e-9


# What is exhausted


@pytest.mark.parametrize(
    ("problem", "options"),
    [
        (hallway(2), {"width": 1}),
        (hallway(4), {}),
        (hallway(4), {"width": 1}),
        (CELL, {}),
        (CELL, {"batch": 16, "branching": 100}),
        (CELL, {"width": 1}),
        (CELL, {"width": 5, "branching": 2, "batch": 4}),
        (THREE, {"width": 8, "batch": 4}),
        (MIXED, {}),
        (MIXED, {"width": 3, "batch": 8}),
    ],
    ids=lambda value: value.workspace.bounds.hi.tolist().__repr__() if isinstance(value, Problem) else str(value),
)
def test_an_empty_frontier_means_that_all_reachable_states_are_nodes(problem, options):
    search = search_of(problem, 1.0, **options)
    search.goal = np.full(len(problem.robots), -1)  # nowhere
    expected = reachable(search.joint)
    assert run_on(search) is Status.EXHAUSTED
    states = list(map(tuple, search.state.tolist()))
    assert len(states) == len(set(states)) == search.budget.num_nodes and set(states) == expected
    assert not search.successors and search.budget.num_children_valid >= len(states) - 1


def test_claimed_cells():
    problem = Problem(ROOM, [RectangleRobot(1.2, 0.5)], [(1, 1, 0)], [(8.3, 8.3, 1)])
    (lattice,) = joint_lattice_of(problem, 1.0).lattices
    np.testing.assert_array_equal(claimed_cells(lattice, 0.65, None), np.arange(len(lattice.q)))
    cells = claimed_cells(lattice, 0.65, 2.0)
    key = np.floor(lattice.q * (1, 1, 0.65) / 2.0)
    for node in range(0, len(lattice.q), 37):
        alike = (key == key[node]).all(axis=1)
        alike[lattice.goal] = False
        if node != lattice.goal:
            np.testing.assert_array_equal(cells == cells[node], alike)
    assert (cells == cells[lattice.goal]).sum() == 1


# Limits, pauses and determinism


@pytest.mark.parametrize(
    ("limit", "status", "is_at_it"),
    [
        ({"max_expansions": 40}, Status.EXPANSION_LIMIT, lambda search: search.budget.num_expansions == 40),
        (
            {"max_memory": 400_000},
            Status.MEMORY_LIMIT,
            lambda search: search.budget.memory >= 400_000 and 1 < len(search.states) < 1000,
        ),
        ({"seconds": 0.0}, Status.TIME_LIMIT, lambda search: len(search.states) == 1),
    ],
)
def test_limits(limit, status, is_at_it):
    search = search_of(scenes.four_rooms(2), 0.4, zero(), 0.0, batch=8, limits=search_budget(**limit))
    assert search.run(10_000) is status and search.found is None and is_at_it(search)


def test_memory_counts_what_is_kept_and_forgets_what_is_used_up():
    search = search_of(CELL, 1.0)
    search.goal = np.full(2, -1)
    assert run_on(search) is Status.EXHAUSTED
    of_nodes = search.budget.memory - bytes_of_tables(search.joint) - search.most_products
    per_node = of_nodes / (len(search.states) - 1)
    assert per_node == int(per_node) and per_node > 100, "only nodes are left"


def test_a_paused_search_goes_on_where_it_was():
    problem = scenes.four_rooms(2)
    whole, paused = (search_of(problem, 0.4, weight=1.0, batch=16) for _ in range(2))
    assert run_on(whole) is Status.SOLVED
    pauses, turn = 0, 5
    while (status := paused.run(turn)) is None:
        assert paused.budget.num_expansions >= turn
        turn, pauses = turn + 5, pauses + 1
    assert status is Status.SOLVED and pauses > 2
    np.testing.assert_array_equal(paused.state, whole.state)
    np.testing.assert_array_equal(paused.branch, whole.branch)
