"""Starts and goals on lattices: exact, told apart, and each robot's own."""

import networkx as nx
import numpy as np
import pytest
import shapely
from lattice_helpers import BAR, WALLS, lattice_of, offsets_between, reaches_goal, visited
from planner_helpers import ROOM, deepest_overlap, graph_of, nudged_team

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace
from plr_jax.planners.lattice.build import PRIMITIVES, build_lattices


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("step", [0.9, 2.0, 40.0])
def test_ends_are_exact(seed, step):
    rng = np.random.default_rng(seed)
    problem = Problem(ROOM, [BAR], *np.column_stack([rng.uniform(1, 9, (2, 2)), rng.uniform(-9, 9, 2)])[:, None])
    lattice = lattice_of(problem, step)
    np.testing.assert_array_equal(lattice.q[lattice.start], problem.starts[0])
    np.testing.assert_array_equal(lattice.q[lattice.goal], problem.goals[0])
    assert lattice.start != lattice.goal


@pytest.mark.parametrize(
    ("start", "goal"),
    [
        ((5.1, 5.1, 0), (5.3, 5.2, 0)),
        ((5.1, 5.1, 0.01), (5.1, 5.1, -0.02)),
        ((5.1, 5.1, 0.01), (5.1, 5.1, -0.02 + 4 * np.pi)),
        ((5.1, 5.1, 3.1), (5.1, 5.1, -3.1)),
        ((5.1, 5.1, 0), (5.1 + 1e-9, 5.1, 0)),
        ((0.9, 9.1, 0), (0.7, 9.1, 0)),
    ],
    ids=["place", "heading", "heading-wrapped", "half-turn", "near", "corner"],
)
def test_ends_in_one_cell_are_told_apart(start, goal):
    problem = Problem(ROOM, [BAR], [start], [goal])
    lattice = lattice_of(problem, 1.0)
    assert lattice.start != lattice.goal
    np.testing.assert_array_equal(lattice.q[[lattice.start, lattice.goal]], [start, goal])
    assert reaches_goal(lattice)
    cheapest = nx.dijkstra_path_length(graph_of(lattice), lattice.start, lattice.goal, "cost")
    way = np.hypot(goal[0] - start[0], goal[1] - start[1])
    turn = abs(np.angle(np.exp(1j * (goal[2] - start[2]))))
    assert cheapest == pytest.approx(way + BAR.circumscribed_radius * turn, abs=1e-9)


def motions_at_ends(problem, robot, lattice, step):
    """The motions from and to a start and a goal, by their definition: 1 where they are free, 0.5 where unsure."""

    def offsets(pairs):
        q0, q1 = lattice.q[pairs[:, 0]], lattice.q[pairs[:, 1]]
        return offsets_between(problem.workspace, robot, step, q0, q1).tolist()

    start, goal = lattice.start, lattice.goal
    (offset,) = offsets(np.array([[start, goal]]))
    same_cell = start != goal and not any(offset)
    cells = np.setdiff1d(np.arange(lattice.table.num_cells), lattice.ends.cell).tolist()
    pairs = [pair for end in {start, goal} for cell in cells for pair in ((end, cell), (cell, end))]
    pairs = np.array([*pairs, (start, goal), (goal, start)])
    leads = [tuple(offset) in PRIMITIVES for offset in offsets(pairs)]
    leads[-2:] = [leads[-2] or same_cell, leads[-1] or same_cell]
    pairs = pairs[leads]
    depth = deepest_overlap(problem.workspace, robot, lattice.q[pairs[:, 0]], lattice.q[pairs[:, 1]])
    free = np.select([depth < -1e-3, depth > 1e-3], [1.0, 0.0], 0.5)
    motions = dict(zip(map(tuple, pairs.tolist()), free.tolist(), strict=True))
    if same_cell:  # to the goal first
        for cell in cells:
            if (cell, goal) in motions:
                motions[cell, start] = min(motions[cell, start], 1 - motions[cell, goal])
    return motions


@pytest.mark.parametrize("robot", [DiscRobot(0.15), RectangleRobot(0.4, 0.1)], ids=["discs", "bars"])
@pytest.mark.parametrize("step", [0.5, 1.0, 3.0])
def test_motions_to_and_from_ends_are_those_of_their_definition(robot, step):
    problem, num_blocked = nudged_team(robot), 0
    for i, lattice in enumerate(build_lattices(problem, step, PRIMITIVES)):
        dof = robot.dof
        np.testing.assert_array_equal(lattice.q[lattice.goal], problem.goals[i, :dof])
        np.testing.assert_allclose(lattice.q[lattice.start][:2], problem.starts[i, :2])
        graph, visited_nodes = graph_of(lattice), set(visited(lattice).tolist())
        expected = motions_at_ends(problem, robot, lattice, step)
        found = {(u, v) for u, v in graph.edges if {u, v} <= visited_nodes and {u, v} & {lattice.start, lattice.goal}}
        for motion, is_free in expected.items():
            if is_free != 0.5:
                assert (motion in found) == (is_free == 1)
                num_blocked += is_free == 0
        assert found <= set(expected)
        blocked = np.isinf(lattice.cost)
        np.testing.assert_array_equal(lattice.child[blocked], np.nonzero(blocked)[0])
        for u, v in found:
            turn = np.angle(np.exp(1j * (lattice.q[v] - lattice.q[u])[2:])).sum()
            way = np.hypot(*(lattice.q[v] - lattice.q[u])[:2]) + problem.rotation_weights[i] * abs(turn)
            assert graph.edges[u, v]["cost"] == pytest.approx(way)
    assert num_blocked > 3


def test_a_cell_that_a_wall_parts_is_entered_on_both_sides():
    # The goal, right of the wall, is entered from the right; the start, left of it, from the left.
    workspace = Workspace(((0, 0), (3, 3)), [shapely.box(1.49, 1, 1.51, 2)])
    lattice = lattice_of(Problem(workspace, [PointRobot()], [(1.4, 1.5)], [(1.6, 1.5)]), 1.0)
    graph = graph_of(lattice)
    left, right = (int(np.flatnonzero((lattice.q == q).all(axis=1))[0]) for q in ((0.5, 1.5), (2.5, 1.5)))
    assert graph.has_edge(left, lattice.start) and not graph.has_edge(left, lattice.goal)
    assert graph.has_edge(right, lattice.goal) and not graph.has_edge(right, lattice.start)
    assert not graph.has_edge(lattice.start, lattice.goal) and reaches_goal(lattice)


def test_an_end_is_entered_where_the_representative_of_its_cell_is_not():
    # A wall bars the way from the left to the middle of the cell, but not to the goal near its lower edge.
    workspace = Workspace(((0, 0), (3, 1)), [shapely.box(1.1, 0.3, 1.2, 1)])
    lattice = lattice_of(Problem(workspace, [PointRobot()], [(0.9, 0.1)], [(1.5, 0.1)]), 1.0)
    middle = int(lattice.ends.cell[1])
    np.testing.assert_array_equal(lattice.q[middle], (1.5, 0.5))
    assert lattice.goal in graph_of(lattice)[lattice.start] and middle not in graph_of(lattice)[lattice.start]


def test_a_start_that_is_the_goal():
    lattice = lattice_of(Problem(ROOM, [DiscRobot(0.4)], [(3.3, 3.4)], [(3.3, 3.4)]), 1.0)
    assert lattice.start == lattice.goal and reaches_goal(lattice)
    np.testing.assert_array_equal(lattice.q[lattice.start], (3.3, 3.4))


def test_a_lattice_with_no_blocked_cell():
    lattice = lattice_of(Problem(ROOM, [PointRobot()], [(1, 1)], [(9, 9)]), 1.0)
    assert len(lattice.q) == 100 + 2 and reaches_goal(lattice)


def test_touching_ends_are_part_of_the_lattice():
    problem = Problem(ROOM, [DiscRobot(0.4)], [(0.4, 0.4)], [(9.6, 9.6)])
    assert reaches_goal(lattice_of(problem, 0.5))


# Teams


def test_equal_robots_share_motions_and_have_their_own_ends():
    problem = Problem(
        WALLS, [DiscRobot(0.4)] * 2 + [PointRobot()], [(0.7, 0.6), (0.9, 4), (1.5, 2)], [(5, 1), (3, 1), (3, 3)]
    )
    first, second, third = build_lattices(problem, 0.5, PRIMITIVES)
    for lattice, start, goal in zip((first, second, third), problem.starts, problem.goals, strict=True):
        np.testing.assert_array_equal(lattice.q[[lattice.start, lattice.goal]], [start, goal])
    assert first.table is second.table and first.table is not third.table
    for lattice, robot, start, goal in zip(
        (first, second, third), problem.robots, problem.starts, problem.goals, strict=True
    ):
        twin = lattice_of(Problem(WALLS, [robot], [start], [goal]), 0.5)
        costs = [
            nx.single_source_dijkstra_path_length(graph_of(each), each.start, weight="cost")
            for each in (lattice, twin)
        ]
        assert costs[0][lattice.goal] == costs[1][twin.goal] and len(costs[0]) == len(costs[1])


def test_nobody_passes_the_ends_of_another():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(3.1, 3.1), (7, 7)], [(5.2, 3.3), (1, 7)])
    near, far = build_lattices(problem, 1.0, PRIMITIVES)
    assert near.table is far.table and len({near.start, near.goal, far.start, far.goal}) == 4
    reached = nx.descendants(graph_of(far), far.start)
    assert far.goal in reached and near.start not in reached and near.goal not in reached


def test_robots_with_both_ends_in_one_cell_share_motions_and_change_none_of_another():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(3.1, 3.1), (7, 7)], [(3.2, 3.3), (1, 7)])
    near, far = build_lattices(problem, 1.0, PRIMITIVES)
    assert near.table is far.table and near.start != near.goal
    twin = lattice_of(Problem(ROOM, [DiscRobot(0.4)], [(7, 7)], [(1, 7)]), 1.0)
    motions = []
    for lattice in (far, twin):
        graph = graph_of(lattice)
        reached = graph.subgraph({lattice.start, *nx.descendants(graph, lattice.start)})
        motions.append({(*lattice.q[u], *lattice.q[v], cost) for u, v, cost in reached.edges.data("cost")})
    assert motions[0] == motions[1]
