"""What heuristics and options do to a search, and that nothing else does: two runs are the same."""

from functools import cache

import networkx as nx
import numpy as np
import pytest
from planner_helpers import FOUR_NEIGHBORS, TRANSLATIONS, exact, graph_of, joint_lattice_of, planned

from plr_jax import BLOptions, Problem, RectangleRobot, Workspace, bl_plan, robot_distance_fns, scenes
from plr_jax.planners import Status, straight_line, sum_of_distances, zero


def same(first, second):
    """Whether two solutions are alike bit for bit, but for seconds."""
    counts = [
        (s.stats.num_nodes, s.stats.num_expansions, s.stats.num_children_scored, s.stats.num_children_valid)
        for s in (first, second)
    ]
    return (
        np.array_equal(first.path, second.path)
        and np.array_equal(first.samples, second.samples)
        and counts[0] == counts[1]
        and (first.cost, first.makespan, first.status) == (second.cost, second.makespan, second.status)
    )


def test_without_a_heuristic_costs_along_the_lattice_guide():
    problem = scenes.single_door()
    solution = bl_plan(problem, options=BLOptions(searchers=("bl",), step=0.4, heuristic_weight=1.0))
    (lattice,) = joint_lattice_of(problem, 0.4).lattices
    least = nx.dijkstra_path_length(graph_of(lattice), lattice.start, lattice.goal, "cost")
    assert solution.stats.history[0][1] == pytest.approx(least, rel=1e-6) and solution.stats.num_nodes < 100


@cache
def nodes(kind):
    problem = scenes.single_door()
    heuristic = {"zero": zero(), "line": straight_line(problem), "distances": exact(problem)}[kind]
    return planned(problem, heuristic).stats.num_nodes


def test_the_better_the_heuristic_the_fewer_the_nodes():
    assert nodes("distances") < nodes("line") < nodes("zero")
    assert 6 * nodes("distances") <= nodes("zero")


def test_the_point_robot_heuristic_of_the_paper_helps():
    problem = scenes.single_door()
    heuristic = sum_of_distances(robot_distance_fns(problem, inflated=False))
    assert 6 * planned(problem, heuristic).stats.num_nodes <= nodes("zero")


@pytest.mark.parametrize("options", [{}, {"cost_factor": 1.0, "max_expansions": 60}], ids=["first", "improving"])
def test_two_runs_do_the_same_bit_for_bit(options):
    problem = scenes.four_rooms(3)
    assert same(*(planned(problem, **options) for _ in range(2)))


def test_two_problems_that_are_planned_in_turn_do_not_touch_one_another():
    first, second = scenes.four_rooms(2), scenes.perturbed(scenes.four_rooms(2), 1)
    before = planned(first)
    planned(second)
    planned(first, step=0.5, primitives=FOUR_NEIGHBORS)
    assert same(before, planned(first))


def test_larger_cells_make_fewer_nodes():
    # A child in its parent's own cell is dropped, so that motions must be about as long as the cells are wide.
    problem, primitives = scenes.single_door(), (*TRANSLATIONS, *(3 * np.array(TRANSLATIONS)).tolist())
    primitives = tuple(map(tuple, primitives))
    fine, coarse = (
        planned(problem, zero(), step=0.2, cell_size=size, primitives=primitives).stats.num_nodes
        for size in (None, 0.3)
    )
    assert coarse < 0.7 * fine


def test_tiny_cells_change_nothing():
    problem = scenes.single_door()
    assert same(*(planned(problem, zero(), step=0.5, cell_size=size) for size in (None, 1e-3)))


def test_larger_cells_of_a_team():
    problem = scenes.four_rooms(2)
    fine, coarse = (
        planned(problem, step=0.25, cell_size=size, searchers=("bl",)).stats.num_nodes for size in (None, 0.5)
    )
    assert coarse < fine


def test_a_nudge_among_as_many_primitives_as_there_may_be():
    bar = Problem(Workspace(((0, 0), (2, 2))), [RectangleRobot(0.2, 0.1)], [(1.03, 1.03, 0.1)], [(1.13, 1.13, 0.1)])
    primitives = (*FOUR_NEIGHBORS, *((0, 0, turn) for turn in range(1, 251)))
    solution = planned(bar, searchers=("bl",), step=0.5, primitives=primitives)
    assert solution.cost == pytest.approx(np.hypot(0.1, 0.1))


@pytest.mark.parametrize("options", [{"primitives": FOUR_NEIGHBORS}, {"branching": 20}, {"batch": 1}, {"width": 9}])
def test_other_options_solve_too(options):
    planned(scenes.four_rooms(2), step=0.5, **options)


@pytest.mark.parametrize("answer", [0.0, None, np.zeros(0), np.zeros((1, 2)), "far"])
def test_a_bounding_heuristic_that_answers_something_else_is_refused(answer, unchecked_types):
    class Bounding:
        is_lower_bound = True

        def __call__(self, q):
            return answer

    with pytest.raises(ValueError, match="heuristic"):
        bl_plan(scenes.four_rooms(2), Bounding())


def test_a_step_beyond_all_bounds_is_a_lattice_of_one_cell():
    solution = bl_plan(scenes.four_rooms(2), options=BLOptions(step=1e12, time_limit=5))
    assert solution.status is Status.EXHAUSTED and not solution.solved


def test_nothing_is_proven_of_lattices_on_which_each_robot_alone_moves_at_no_cost():
    ends = [(10.5, 10.5, 0), (10.5, 11.5, 0)], [(10.5, 10.5, np.pi), (10.5, 11.5, np.pi)]
    problem = Problem(Workspace(((0, 0), (20, 20))), [RectangleRobot(3, 1)] * 2, *ends, rotation_weight=0)
    solution = bl_plan(problem, options=BLOptions(step=1.0))
    assert solution.solved and solution.cost > 0 and solution.motions_factor == np.inf


def test_options_in_the_place_of_the_heuristic_are_refused():
    with pytest.raises(ValueError, match=r"bl_plan\(problem, options=BLOptions"):
        bl_plan(scenes.single_door(), BLOptions())


def test_distance_functions_alone_are_no_heuristic():
    problem = scenes.four_rooms(2)
    with pytest.raises(ValueError, match=r"sum_of_distances\(distance_fns\)"):
        bl_plan(problem, robot_distance_fns(problem))
