"""Lattices against their definition, the independent check and NetworkX; lattices of teams."""

from itertools import product

import networkx as nx
import numpy as np
import pytest
import shapely
from planner_helpers import ROOM, graph_of, joint_lattice_of, nudged_discs, nudged_team
from robot_helpers import along, shapes
from team_helpers import FIVE

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax.planners import lattice as module
from plr_jax.planners.lattice import PRIMITIVES

BAR = RectangleRobot(1.3, 0.5)
WALLS = Workspace(
    ((0, 0), (6, 5)),
    [[(2, 0), (2.3, 0), (2.3, 3), (2, 3)], [(4, 2.1), (5, 3), (4.2, 4)], shapely.box(3, 4.3, 3.2, 5)],
)


def lattice_of(problem, step):
    return joint_lattice_of(problem, step).lattices[0]


def offsets_between(workspace, robot, step, q0, q1):
    """Return columns, rows and turns between the cells of configurations, by the definition of the grid."""
    width = workspace.bounds.width
    side = width / np.ceil(width / step - 1e-9)
    cells = [np.floor((q[:, :2] - workspace.bounds.lo) / side).astype(int) for q in (q0, q1)]
    cells = [np.clip(cell, 0, np.rint(width / side).astype(int) - 1) for cell in cells]
    offset = cells[1] - cells[0]
    if not isinstance(robot, RectangleRobot):
        return np.column_stack([offset, np.zeros(len(offset), int)])
    quarters = np.ceil(np.pi / 2 / min(step / robot.circumscribed_radius, np.pi / 4) - 1e-9)
    turn = np.pi / 2 / quarters
    sectors = [np.floor(q[:, 2] / turn + 0.5).astype(int) for q in (q0, q1)]
    turns = (sectors[1] - sectors[0]) % int(4 * quarters)
    return np.column_stack([offset, np.where(turns > 2 * quarters, turns - int(4 * quarters), turns)])


def deepest_overlap(workspace, robot, q0, q1):
    """Return how deep samples of each motion go into walls; negative if the motion keeps clear."""
    q0, q1 = (np.column_stack([q, np.zeros((len(q), 3 - q.shape[1]))]) for q in (q0, q1))
    box = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    beyond = box.buffer(10, join_style="mitre").difference(box)
    num_samples, region = 81, shapely.union_all([*workspace.obstacles, beyond])
    bodies = shapes(robot, along(q0, q1, num_samples))
    if isinstance(robot, RectangleRobot):
        overlap = shapely.intersection(bodies, region)
        depth = np.where(shapely.area(overlap) > 0, shapely.area(overlap) / robot.length, 0.0)
        depth = np.where(depth > 0, depth, -shapely.distance(bodies, region))
    else:
        inside = shapely.distance(bodies, shapely.boundary(region))
        distance = shapely.distance(bodies, region)
        depth = robot.rounding - np.where(distance > 0, distance, -inside)
    return depth.reshape(-1, num_samples).max(axis=1)


def visited(lattice):
    """Return the nodes of a lattice, without those that the start and the goal replace."""
    return np.setdiff1d(np.arange(len(lattice.q)), lattice.kind.terminals.cell[lattice.row])


def reaches_goal(lattice):
    return nx.has_path(graph_of(lattice), lattice.start, lattice.goal)


ALONE = {
    "point": Problem(WALLS, [PointRobot()], [(0.7, 0.6)], [(5.3, 4.7)]),
    "disc": Problem(WALLS, [DiscRobot(0.4)], [(0.7, 0.6)], [(5.3, 4.5)]),
    "bar": Problem(WALLS, [BAR], [(0.9, 0.7, 0.2)], [(5.2, 4.5, -6.4)]),
}
STEPS = {"point": 0.4, "disc": 0.45, "bar": 0.7}


@pytest.fixture(scope="module", params=ALONE)
def alone(request):
    """Return a problem of one robot, its step and its lattice."""
    problem, step = ALONE[request.param], STEPS[request.param]
    return problem, step, lattice_of(problem, step)


# Motions


def test_motions_exist_where_robot_keeps_clear(alone):
    problem, step, lattice = alone
    (robot,), graph, nodes, num_blocked = problem.robots, graph_of(lattice), visited(lattice), 0
    for node in nodes[:: 2 if problem.dof == 2 else 31].tolist():
        ends = np.setdiff1d(nodes, [node])
        begins = np.full(len(ends), node)
        offsets = offsets_between(problem.workspace, robot, step, lattice.q[begins], lattice.q[ends])
        is_near = [tuple(offset) in PRIMITIVES for offset in offsets.tolist()]
        begins, ends = begins[is_near], ends[is_near]
        depth = deepest_overlap(problem.workspace, robot, lattice.q[begins], lattice.q[ends])
        exists = np.isin(ends, list(graph[node]))
        assert set(ends[exists].tolist()) == set(graph[node]) & set(nodes.tolist())
        assert (depth[exists] < 1e-3).all() and (depth[~exists] > -1e-3).all()
        num_blocked += np.sum(~exists)
    assert num_blocked > 5


def test_cells_without_configuration_have_blocked_center(alone):
    problem, step, lattice = alone
    (robot,), width = problem.robots, problem.workspace.bounds.width
    columns, rows = np.ceil(width / step - 1e-9).astype(int)
    side, missing = width / (columns, rows), []
    occupied = {tuple(cell) for cell in np.floor(lattice.q[:, :2] / side).astype(int).tolist()}
    for cell in product(range(columns), range(rows)):
        if cell not in occupied:
            missing.append([*((np.array(cell) + 0.5) * side), 0.0][: problem.dof])
    if robot != PointRobot():  # points have a configuration in every cell that is not all wall
        q = np.array(missing)
        assert len(q) > 3 and (deepest_overlap(problem.workspace, robot, q, q) > 0).all()


def test_blocked_primitives_lead_back(alone):
    lattice = alone[2]
    np.testing.assert_array_equal(lattice.child[:, 0], np.arange(len(lattice.q)))
    assert (lattice.cost[:, 0] == 0).all()
    blocked = np.isinf(lattice.cost)
    assert blocked.any() and (lattice.child[blocked] == np.nonzero(blocked)[0]).all()
    lengths = np.linalg.norm((lattice.q[lattice.child] - lattice.q[:, None])[..., :2], axis=2)
    stride = lattice.kind.reach - lattice.kind.robot.circumscribed_radius
    assert stride == pytest.approx(lengths.max()) and stride > alone[1]


def test_costs_add_lengths_and_weighted_turns():
    problem = Problem(ROOM, [BAR], [(5.5, 5.5, 0)], [(1.5, 1.5, 0)], rotation_weight=2.0)
    lattice = lattice_of(problem, 1.0)
    turn = np.pi / 2 / np.ceil(np.pi / 2 / min(1 / BAR.circumscribed_radius, np.pi / 4))
    expected = [0.0, *(np.hypot(dx, dy) + 2.0 * abs(dt) * turn for dx, dy, dt in PRIMITIVES)]
    np.testing.assert_allclose(lattice.cost[lattice.start], expected, rtol=1e-12)


# Reaching the goal


@pytest.mark.parametrize("step", [0.4, 1.0])
def test_narrow_passages_are_found(step):
    assert reaches_goal(lattice_of(scenes.single_door(), step))


# Starts and goals


NEAR_ENDS = {
    "place": ((5.1, 5.1, 0), (5.3, 5.2, 0)),
    "wrapped heading": ((5.1, 5.1, 0.01), (5.1, 5.1, -0.02 + 4 * np.pi)),
    "half turn": ((5.1, 5.1, 3.1), (5.1, 5.1, -3.1)),
    "tiny distance": ((5.1, 5.1, 0), (5.1 + 1e-9, 5.1, 0)),
    "corner": ((0.9, 9.1, 0), (0.7, 9.1, 0)),
}


@pytest.mark.parametrize(("start", "goal"), NEAR_ENDS.values(), ids=NEAR_ENDS)
def test_start_and_goal_in_one_cell_are_two_nodes(start, goal):
    problem = Problem(ROOM, [BAR], [start], [goal])
    lattice = lattice_of(problem, 1.0)
    assert lattice.start != lattice.goal
    np.testing.assert_array_equal(lattice.q[[lattice.start, lattice.goal]], [start, goal])
    assert reaches_goal(lattice)
    cheapest = nx.dijkstra_path_length(graph_of(lattice), lattice.start, lattice.goal, "cost")
    way = np.hypot(goal[0] - start[0], goal[1] - start[1])
    turn = abs(np.angle(np.exp(1j * (goal[2] - start[2]))))
    assert cheapest == pytest.approx(way + BAR.circumscribed_radius * turn, abs=1e-9)


NUDGED = {"discs": nudged_team(DiscRobot(0.15)), "bars": nudged_team(RectangleRobot(0.4, 0.1))}


def num_cells(kind):
    return len(kind.q) - 2 * len(kind.members)  # the other nodes are starts and goals


def motions_at_ends(problem, robot, lattice, step):
    """Return the motions from and to a start and a goal by definition: 1 if free, 0 if blocked, 0.5 if unsure."""

    def offsets(pairs):
        q0, q1 = lattice.q[pairs[:, 0]], lattice.q[pairs[:, 1]]
        return offsets_between(problem.workspace, robot, step, q0, q1).tolist()

    start, goal = lattice.start, lattice.goal
    (offset,) = offsets(np.array([[start, goal]]))
    same_cell = start != goal and not any(offset)
    cells = np.setdiff1d(np.arange(num_cells(lattice.kind)), lattice.kind.terminals.cell[lattice.row]).tolist()
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


@pytest.mark.parametrize(("name", "step"), [("discs", 0.5), ("discs", 3.0), ("bars", 1.0)])
def test_motions_at_starts_and_goals_follow_definition(name, step):
    problem, num_blocked = NUDGED[name], 0
    robot = problem.robots[0]
    for i, lattice in enumerate(joint_lattice_of(problem, step).lattices):
        dof = robot.dof
        np.testing.assert_array_equal(lattice.q[lattice.goal], problem.goals[i, :dof])
        np.testing.assert_allclose(lattice.q[lattice.start][:2], problem.starts[i, :2])
        graph, visited_nodes = graph_of(lattice), set(visited(lattice).tolist())
        of_others = set(range(num_cells(lattice.kind), len(lattice.q))) - {lattice.start, lattice.goal}
        assert not of_others & nx.descendants(graph, lattice.start), "robots pass no ends of other robots"
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


# Teams


@pytest.mark.parametrize(("problem", "step"), [(FIVE, 1.2), (NUDGED["bars"], 1.5)], ids=["mixed", "bars"])
def test_costs_to_go_equal_networkx(problem, step):
    joint = joint_lattice_of(problem, step)
    for kind in joint.kinds:
        rows = np.arange(len(kind.members))
        costs = kind.costs_to_go(rows)
        for row, i in enumerate(kind.members.tolist()):
            lattice = joint.lattices[i]
            graph = graph_of(lattice).reverse()
            expected, paths = nx.single_source_dijkstra(graph, lattice.goal, weight="cost")
            assert costs[row, lattice.start] == pytest.approx(expected.get(lattice.start, np.inf), rel=1e-12)
            # Leave out ways through the start: it stands for its cell, and the cell's representative costs other.
            through = [node for node, path in paths.items() if lattice.start not in path[1:]]
            assert len(through) > 5
            least = np.array([expected[node] for node in through])
            assert (costs[row, through] <= least * (1 + 1e-12)).all()
            assert (np.isclose(costs[row, through], least, rtol=1e-12)).mean() > 0.9


def test_unreachable_goal_costs_infinity():
    boxes = [shapely.box(x, y, x + 0.9, y + 0.9) for x in (0.7, 2.4, 4.1) for y in (0.7, 2.4, 4.1)]
    problem = Problem(Workspace(((0, 0), (6, 6)), boxes), [DiscRobot(0.3)], [(0.35, 0.35)], [(5.6, 5.6)])
    answers = []
    for step in (0.25, 0.5, 1.5, 3.0):
        joint = joint_lattice_of(problem, step)
        answers.append(bool(np.isfinite(joint.least_costs[0])))
        assert answers[-1] == reaches_goal(joint.lattices[0])
    assert set(answers) == {True, False}


def test_costs_to_go_in_portions_equal_one_call(monkeypatch):
    problem = scenes.door(6)
    whole = joint_lattice_of(problem, 0.5).costs_to_go
    monkeypatch.setattr(module, "_NODES", 1)
    np.testing.assert_array_equal(joint_lattice_of(problem, 0.5).costs_to_go, whole)


def test_equal_robots_share_a_kind():
    problem = nudged_discs(5)
    joint = joint_lattice_of(problem, 0.8)
    (kind,) = joint.kinds
    assert kind.members.tolist() == list(range(25))
    np.testing.assert_allclose(joint.least_costs, np.hypot(*(problem.goals - problem.starts).T))


def test_costs_to_come_mirror_costs_to_go():
    # Motions cost the same in both directions, so that swapped ends have the same costs, backward.
    back = Problem(FIVE.workspace, FIVE.robots, FIVE.goals, FIVE.starts)
    for kind, mirrored in zip(joint_lattice_of(FIVE, 0.8).kinds, joint_lattice_of(back, 0.8).kinds, strict=True):
        rows, cells = np.arange(len(kind.members)), slice(num_cells(kind))
        come, go = np.stack([kind.costs_to_come(row)[cells] for row in rows]), mirrored.costs_to_go(rows)[:, cells]
        np.testing.assert_allclose(come, go, rtol=1e-9)
