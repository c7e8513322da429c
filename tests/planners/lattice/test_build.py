from itertools import pairwise, product

import networkx as nx
import numpy as np
import pytest
from lattice_helpers import BAR, WALLS, lattice_of, offsets_between, reaches_goal, visited
from planner_helpers import FOUR_NEIGHBORS, ROOM, deepest_overlap, graph_of

from plr_jax import DiscRobot, PointRobot, Problem, scenes, validate
from plr_jax.planners.lattice.build import PRIMITIVES

ALONE = {
    "point": Problem(WALLS, [PointRobot()], [(0.7, 0.6)], [(5.3, 4.7)]),
    "disc": Problem(WALLS, [DiscRobot(0.4)], [(0.7, 0.6)], [(5.3, 4.5)]),
    "bar": Problem(WALLS, [BAR], [(0.9, 0.7, 0.2)], [(5.2, 4.5, -6.4)]),
}
STEPS = {"point": 0.4, "disc": 0.45, "bar": 0.7}


def tours(graph):
    """Walks along all motions, each from a node back to it."""
    for component in nx.strongly_connected_components(graph):
        part = graph.subgraph(component)
        if part.number_of_edges():
            yield [edge[0] for edge in nx.eulerian_circuit(part)]


# Motions


@pytest.mark.parametrize("kind", ALONE)
def test_every_motion_is_free_by_the_independent_check(kind):
    problem, lattice = ALONE[kind], lattice_of(ALONE[kind], STEPS[kind])
    graph = graph_of(lattice).subgraph(visited(lattice))
    walked = 0
    for tour in tours(graph):
        path = lattice.q[[*tour, tour[0]]][:, None]
        report = validate(Problem(problem.workspace, problem.robots, path[0], path[0]), path)
        assert report.valid, report.message
        walked += len(tour)
    assert walked == graph.number_of_edges() > 300


@pytest.mark.parametrize("kind", ALONE)
def test_motions_that_are_missing_collide(kind):
    problem, step = ALONE[kind], STEPS[kind]
    robot, lattice = problem.robots[0], lattice_of(problem, step)
    graph, num_blocked, nodes = graph_of(lattice), 0, visited(lattice)
    for node in nodes[:: 1 if kind != "bar" else 5].tolist():
        others = np.setdiff1d(nodes, [node, *graph[node]])
        offsets = offsets_between(
            problem.workspace, robot, step, np.repeat(lattice.q[[node]], len(others), axis=0), lattice.q[others]
        )
        others = others[[tuple(offset) in PRIMITIVES for offset in offsets.tolist()]]
        if len(others):
            ends = lattice.q[others]
            depth = deepest_overlap(problem.workspace, robot, np.repeat(lattice.q[[node]], len(ends), axis=0), ends)
            assert (depth > -1e-3).all(), "a motion is blocked that keeps well clear of all walls"
            num_blocked += len(others)
    assert num_blocked > 5


@pytest.mark.parametrize("kind", ALONE)
def test_motions_lead_to_the_cell_of_their_primitive(kind):
    problem, step = ALONE[kind], STEPS[kind]
    lattice = lattice_of(problem, step)
    primitives = [p for p in PRIMITIVES if kind == "bar" or p[2] == 0]
    assert lattice.cost.shape == (len(lattice.q), 1 + len(primitives))
    node, primitive = np.nonzero(
        np.isfinite(lattice.cost[:, 1:]) & np.isin(np.arange(len(lattice.q)), visited(lattice))[:, None]
    )
    child = lattice.child[node, primitive + 1]
    offsets = offsets_between(problem.workspace, problem.robots[0], step, lattice.q[node], lattice.q[child])
    np.testing.assert_array_equal(offsets, np.array(primitives)[primitive])


@pytest.mark.parametrize("kind", ["disc", "bar"])
def test_cells_without_a_configuration_have_a_blocked_center(kind):
    problem, step = ALONE[kind], STEPS[kind]
    robot, lattice, width = problem.robots[0], lattice_of(problem, step), problem.workspace.bounds.width
    columns, rows = np.ceil(width / step - 1e-9).astype(int)
    side, missing = width / (columns, rows), []
    occupied = {tuple(cell) for cell in np.floor(lattice.q[:, :2] / side).astype(int).tolist()}
    for cell in product(range(columns), range(rows)):
        if cell not in occupied:
            missing.append([*((np.array(cell) + 0.5) * side), 0.0][: 3 if kind == "bar" else 2])
    q = np.array(missing)
    assert len(q) > 3 and (deepest_overlap(problem.workspace, robot, q, q) > 0).all()


def test_staying_costs_nothing_and_blocked_primitives_lead_back():
    lattice = lattice_of(ALONE["bar"], 0.7)
    nodes = np.arange(len(lattice.q))
    np.testing.assert_array_equal(lattice.child[:, 0], nodes)
    assert (lattice.cost[:, 0] == 0).all()
    blocked = np.isinf(lattice.cost)
    assert blocked.any() and (lattice.child[blocked] == np.nonzero(blocked)[0]).all()


def test_costs_are_lengths_and_weighted_turns():
    problem = Problem(ROOM, [BAR], [(5.5, 5.5, 0)], [(1.5, 1.5, 0)], rotation_weight=2.0)
    lattice = lattice_of(problem, 1.0)
    turn = np.pi / 2 / np.ceil(np.pi / 2 / min(1 / BAR.circumscribed_radius, np.pi / 4))
    expected = [0.0, *(np.hypot(dx, dy) + 2.0 * abs(dt) * turn for dx, dy, dt in PRIMITIVES)]
    np.testing.assert_allclose(lattice.cost[lattice.start], expected, rtol=1e-12)


def test_stride():
    lattice = lattice_of(ALONE["disc"], 0.45)
    lengths = np.linalg.norm(lattice.q[lattice.child] - lattice.q[:, None], axis=2)
    assert lattice.stride == pytest.approx(lengths.max()) and lattice.stride > 0.45


# Headings


def test_headings_are_periodic():
    problem = Problem(ROOM, [BAR], [(5.25, 5.25, 0.4)], [(1, 1, 0)])
    lattice = lattice_of(problem, 0.5)
    left, right = (1 + PRIMITIVES.index((0, 0, turn)) for turn in (1, -1))
    for primitive, back in ((left, right), (right, left)):
        nodes = [lattice.start]
        while True:
            assert np.isfinite(lattice.cost[nodes[-1], primitive])
            assert lattice.child[lattice.child[nodes[-1], primitive], back] == nodes[-1]
            nodes.append(int(lattice.child[nodes[-1], primitive]))
            if nodes[-1] == lattice.start:
                break
        turned = sum(lattice.cost[node, primitive] for node in nodes[:-1]) / BAR.circumscribed_radius
        assert turned == pytest.approx(2 * np.pi) and len(nodes) > 4


# Reaching the goal


@pytest.mark.parametrize("step", [0.2, 0.4, 0.5, 1.0])
def test_passages_narrower_than_a_cell_are_found(step):
    assert reaches_goal(lattice_of(scenes.single_door(), step))


def test_primitives_of_four_neighbors():
    lattice = lattice_of(ALONE["point"], 0.5, FOUR_NEIGHBORS)
    assert lattice.child.shape[1] == 5
    away = [lattice.start, lattice.goal]
    inner = np.setdiff1d(np.arange(len(lattice.q)), [*away, *lattice.child[away].ravel()])
    moves = (lattice.q[lattice.child] - lattice.q[:, None])[inner]
    straight = np.isclose(moves, 0).any(axis=2) | np.isinf(lattice.cost[inner])
    assert straight.mean() > 0.8, "all but those to cells whose center is blocked run along an axis"


def test_without_turns_a_heading_is_never_left():
    translations = PRIMITIVES[:8]
    turned = Problem(ROOM, [BAR], [(2, 2, 0)], [(8, 8, 2)])
    lattice = lattice_of(turned, 1.0, translations)
    assert not reaches_goal(lattice) and reaches_goal(lattice_of(turned, 1.0))
    assert reaches_goal(lattice_of(Problem(ROOM, [BAR], [(2, 2, 0)], [(8, 8, 0)]), 1.0, translations))


# Paths


def test_each_branch_of_a_lattice_is_a_path():
    problem = scenes.single_door()
    lattice = lattice_of(problem, 0.4)
    nodes = nx.dijkstra_path(graph_of(lattice), lattice.start, lattice.goal, "cost")
    report = validate(problem, lattice.q[nodes][:, None])
    cheapest = sum(graph_of(lattice).edges[edge]["cost"] for edge in pairwise(nodes))
    assert report.valid and report.cost == pytest.approx(cheapest)
