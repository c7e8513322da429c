"""Joint configurations and motions of a team on its lattices, and which of them collide."""

from itertools import product

import networkx as nx
import numpy as np
import pytest
import shapely
from planner_helpers import FOUR_NEIGHBORS, graph_of, joint_lattice_of, nudged_team
from team_helpers import MIXED

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax.planners.lattice.build import PRIMITIVES
from plr_jax.planners.lattice.joint import kinds_of

NUDGED = {"nudged discs": nudged_team(DiscRobot(0.15)), "nudged bars": nudged_team(RectangleRobot(0.4, 0.1))}


def random_boxes(seed):
    rng = np.random.default_rng(seed)
    corners, sizes = rng.uniform(0.8, 4.5, (6, 2)), rng.uniform(0.05, 1.6, (6, 2))
    return Workspace(
        ((0, 0), (6, 6)), [shapely.box(*lo, *(lo + size)) for lo, size in zip(corners, sizes, strict=True)]
    )


@pytest.mark.parametrize(
    "problem",
    [MIXED, scenes.four_rooms(4), scenes.door(6), *NUDGED.values()],
    ids=["mixed", "rooms", "door", *NUDGED],
)
def test_motions_of_all_robots_at_once_are_those_of_each(problem):
    joint = joint_lattice_of(problem, 0.5)
    rng = np.random.default_rng(0)
    for kind in kinds_of(joint):
        for _ in range(40):
            # Near the ends, where motions differ from robot to robot.
            around = np.unique(kind.table.child[kind.ends.node.ravel()])
            node = np.array([rng.choice([*around, *kind.ends.node[row]]) for row in range(len(kind.members))])
            node = np.where(node >= kind.table.num_cells, kind.ends.node[:, 0], node)
            child, cost = kind.motions(node)
            for row, i in enumerate(kind.members.tolist()):
                np.testing.assert_array_equal(child[row], joint.lattices[i].child[node[row]])
                np.testing.assert_array_equal(cost[row], joint.lattices[i].cost[node[row]])


@pytest.mark.parametrize(
    ("problem", "step"),
    [(MIXED, 0.9), (MIXED, 1.5), *((problem, 1.0) for problem in NUDGED.values())],
    ids=["0.9", "1.5", *NUDGED],
)
def test_costs_to_go_are_those_that_networkx_finds(problem, step):
    joint = joint_lattice_of(problem, step)
    for kind in kinds_of(joint):
        rows = np.arange(len(kind.members))
        costs = kind.edges.costs_to_go(rows)
        for row, i in enumerate(kind.members.tolist()):
            lattice = joint.lattices[i]
            graph = graph_of(lattice).reverse()
            expected = nx.single_source_dijkstra_path_length(graph, lattice.goal, weight="cost")
            assert costs[row, lattice.start] == pytest.approx(expected.get(lattice.start, np.inf), rel=1e-12)
            # Ways by the start are left out, as it stands for its cell: costs by that cell's representative differ.
            paths = {node: nx.dijkstra_path(graph, lattice.goal, node, "cost") for node in expected}
            through = [node for node, path in paths.items() if lattice.start not in path[1:]]
            assert len(through) > 5
            least = np.array([expected[node] for node in through])
            assert (costs[row, through] <= least * (1 + 1e-12)).all()
            assert (np.isclose(costs[row, through], least, rtol=1e-12)).mean() > 0.9


def test_a_goal_out_of_reach_costs_infinitely_much_as_networkx_says():
    answers = set()
    for seed, step, primitives in product(
        range(3), (0.5, 1.5), (PRIMITIVES, FOUR_NEIGHBORS[::2], ((2, 1, 0), (-1, 2, 0)))
    ):
        try:
            problem = Problem(random_boxes(seed), [DiscRobot(0.3)], [(0.4, 0.4)], [(5.6, 5.6)])
        except ValueError:  # no way for the disc
            continue
        joint = joint_lattice_of(problem, step, primitives)
        (kind,), (lattice,) = kinds_of(joint), joint.lattices
        cost = kind.edges.costs_to_go(np.zeros(1, np.intp))[0, lattice.start]
        answers.add(bool(np.isfinite(cost)))
        assert np.isfinite(cost) == nx.has_path(graph_of(lattice), lattice.start, lattice.goal)
    assert answers == {True, False}


def test_costs_to_come_mirror_costs_to_go():
    # Motions here cost as much one way as the other; a table of swapped ends has the same costs, backward.
    there = MIXED
    back = Problem(MIXED.workspace, MIXED.robots, MIXED.goals, MIXED.starts)
    for kind, mirrored in zip(
        kinds_of(joint_lattice_of(there, 0.5)), kinds_of(joint_lattice_of(back, 0.5)), strict=True
    ):
        rows, cells = np.arange(len(kind.members)), slice(kind.table.num_cells)
        come, go = kind.edges.costs_to_come(rows)[:, cells], mirrored.edges.costs_to_go(rows)[:, cells]
        np.testing.assert_allclose(come, go, rtol=1e-9)


@pytest.mark.parametrize(
    ("problem", "step"),
    [(MIXED, 0.5), (MIXED, 1.1), *((problem, 1.0) for problem in NUDGED.values())],
    ids=["0.5", "1.1", *NUDGED],
)
def test_edges_into_a_node_are_the_motions_of_each_robot(problem, step):
    joint = joint_lattice_of(problem, step)
    for kind in kinds_of(joint):
        edges = kind.edges
        for row, i in enumerate(kind.members.tolist()):
            lattice, into = joint.lattices[i], edges.into_nodes(row)
            cells = set(lattice.ends.cell.tolist())
            others = set(kind.ends.node.ravel().tolist()) - {lattice.start, lattice.goal}
            found = {
                (int(edges.begin[edge]), node, float(edges.cost[edge]))
                for node in range(len(lattice.q))
                for edge in into[:, node]
                if edge != edges.num_edges
            }
            assert not cells & {end for _, end, _ in found}
            begin, primitive = np.nonzero(np.isfinite(lattice.cost))
            expected = {
                (int(b), int(lattice.child[b, p]), float(lattice.cost[b, p]))
                for b, p in zip(begin, primitive, strict=True)
            }
            visited = {edge for edge in expected if not {edge[0], edge[1]} & (cells | others)}
            assert {edge for edge in found if not {edge[0], edge[1]} & (cells | others)} == visited
