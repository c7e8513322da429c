"""Helpers for tests of the planner: small problems, lattices as graphs, and heuristics."""

import time
from itertools import combinations, product

import networkx as nx
import numpy as np
import pytest
import shapely

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, robot_distance_fns, scenes, validate
from plr_jax.collision.motions import JointMotionTest, motions_apart
from plr_jax.planners import BLOptions, bl_plan, sum_of_distances
from plr_jax.planners._solution import SearchBudget
from plr_jax.planners.lattice import JointLattice

ROOM = Workspace(((0, 0), (10, 10)))
TRIO = Problem(
    ROOM,
    [DiscRobot(0.4), RectangleRobot(1.2, 0.4), PointRobot()],
    [(1, 1, 5), (1, 8, 0), (5, 1, 0)],
    [(9, 1, 5), (9, 8, 1), (5, 5, 0)],
)
TIGHT = Workspace(((0, 0), (3, 3)), [shapely.box(1.4, 1.4, 1.6, 1.6)])
TIGHT_TEAM = Problem(
    TIGHT,
    [DiscRobot(0.3), RectangleRobot(0.8, 0.3), PointRobot()],
    [(0.5, 0.5, 1), (2.5, 2.5, 0.1), (0.5, 2.5, 2)],
    [(2.5, 2.5, 0), (0.6, 0.6, 0), (2.5, 0.5, 0)],
)
DOOR, ROOMS = scenes.single_door(), scenes.four_rooms(2)
SLIT = Workspace(((0, 0), (6, 5)), [shapely.box(2.45, 1, 2.55, 2.9)])


def hallway(length):
    """Return a problem of two discs that must swap in a hallway too narrow to pass."""
    ends = [(0.5, 0.5), (length - 0.5, 0.5)]
    return Problem(Workspace(((0, 0), (length, 1))), [DiscRobot(0.4)] * 2, ends, ends[::-1])


def nudged_team(robot):
    """Return a team of equal robots whose starts and goals share few cells of side 1.

    One cell has both ends of a robot, the start of another and the goal of a third. Another has a wall between the
    ends of a robot. One robot starts at its goal.
    """
    x, y = np.array([(0.7, 0.6), (3.2, 3.3), (0.3, 0.2), (5.5, 1.5), (2.2, 2.2), (4.1, 0.9)]).T
    to_x, to_y = np.array([(0.3, 0.4), (3.2, 3.3), (5.5, 0.5), (0.75, 0.85), (2.8, 2.3), (4.1, 0.9)]).T
    heading = np.array([0.1, 2.0, 3.0, -1.0, 1.6, 6.2])
    turn = np.array([0.2, 4 * np.pi, 1.0, 2.0, -0.1, -2 * np.pi - 0.1])
    starts, goals = np.stack([x, y, heading], axis=1), np.stack([to_x, to_y, heading + turn], axis=1)
    return Problem(SLIT, [robot] * len(x), starts[:, : robot.dof], goals[:, : robot.dof])


def nudged_discs(num_rows):
    """Return a square of discs in the open, with each goal a little beside the start."""
    starts = np.array(list(product(2 * np.arange(num_rows) + 1.03, repeat=2)))
    room = Workspace(((0, 0), (2 * num_rows, 2 * num_rows)))
    return Problem(room, [DiscRobot(0.2)] * len(starts), starts, starts + 0.1)


def exact(problem):
    return sum_of_distances(robot_distance_fns(problem))


def planned(problem, heuristic, **options):
    """Return a solution after checking its validity, exact ends, and bounds; None is the planner's own heuristic."""
    solution = bl_plan(problem, heuristic, BLOptions(**options))
    assert solution.solved, solution
    report = validate(problem, solution.path)
    assert report.valid, report.message
    np.testing.assert_array_equal(solution.path[[0, -1]], [problem.starts, problem.goals])
    assert solution.cost == pytest.approx(report.cost, rel=1e-12)
    assert solution.lower_bound <= solution.cost * (1 + 1e-12)
    assert solution.makespan <= solution.cost * (1 + 1e-12)
    seconds, costs = np.array(solution.stats.history).T
    assert (np.diff(seconds) >= 0).all() and (np.diff(costs) < 0).all()
    assert costs[-1] == solution.cost and solution.stats.first_solution == seconds[0]
    return solution


def joint_lattice_of(problem, step, deadline=np.inf):
    return JointLattice(problem, step, JointMotionTest(problem.workspace, problem.robots, deadline))


def search_budget(max_expansions=np.inf, max_memory=np.inf, seconds=60.0):
    return SearchBudget(time.perf_counter() + seconds, max_expansions, max_memory)


def graph_of(lattice):
    """Return the free motions of a lattice as a graph, without those that stay."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(lattice.q)))
    node, primitive = np.nonzero(np.isfinite(lattice.cost[:, 1:]))
    edges = np.stack([node, lattice.child[node, primitive + 1]], axis=1).tolist()
    for (begin, end), cost in zip(edges, lattice.cost[node, primitive + 1].tolist(), strict=True):
        graph.add_edge(begin, end, cost=cost)
    return graph


def apart(joint, state, primitive):
    """Return whether joint primitives keep all pairs of robots apart, by a loop over pairs."""
    robots, tolerance = joint.problem.robots, joint.problem.workspace.tolerance
    clear = np.ones(len(state), dtype=bool)
    for i, j in combinations(range(len(robots)), 2):
        motions = []
        for k in (i, j):
            lattice = joint.lattices[k]
            motions += [robots[k], lattice.q[state[:, k]], lattice.q[lattice.child[state[:, k], primitive[:, k]]]]
        clear &= motions_apart(*motions, tolerance)
    return clear


def reachable(joint):
    """Return all joint configurations that sequences of joint motions reach."""
    start = tuple(lattice.start for lattice in joint.lattices)
    primitive = np.array(list(product(*(range(each.child.shape[1]) for each in joint.lattices))), dtype=np.uint8)
    reached, newest = {start}, [start]
    while newest:
        state = np.repeat(np.array([newest.pop()]), len(primitive), axis=0)
        children, costs = joint.move(state, primitive)
        free = np.isfinite(costs) & apart(joint, state, primitive)
        for child in map(tuple, children[free].tolist()):
            if child not in reached:
                reached.add(child)
                newest.append(child)
    return reached
