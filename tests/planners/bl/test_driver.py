from functools import cache

import numpy as np
import pytest
import shapely
from planner_helpers import FOUR_NEIGHBORS, ROOM, exact, hallway, joint_lattice_of, planned

from plr_jax import (
    BLOptions,
    DiscRobot,
    PointRobot,
    Problem,
    RectangleRobot,
    Workspace,
    bl_plan,
    scenes,
)
from plr_jax.planners import Status, straight_line, sum_of_distances, zero
from plr_jax.planners.bl.driver import claimed_cells
from plr_jax.planners.bl.lattice import PRIMITIVES

TRANSLATIONS = PRIMITIVES[:8]


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


# The scenes


@pytest.mark.parametrize(
    "scene",
    [
        scenes.single_door,
        scenes.maze,
        lambda: scenes.four_rooms(2),
        lambda: scenes.four_rooms(3),
        lambda: scenes.four_rooms(4),
        lambda: scenes.four_rooms(8),
        lambda: scenes.cross(2),
        lambda: scenes.cross(3),
        scenes.tangle,
    ],
    ids=["single_door", "maze", "rooms-2", "rooms-3", "rooms-4", "rooms-8", "cross-2", "cross-3", "tangle"],
)
def test_scenes(scene):
    problem = scene()
    solution = planned(problem)
    assert solution.status is Status.SOLVED
    # The joint cost has the robots' own shortest ways as a bound, but for what inflating corners rounds off.
    alone = float(exact(problem)(problem.starts[None])[0])
    assert solution.cost >= (1 - 1e-3) * alone
    if problem.dof == 2:
        assert solution.cost <= 1.6 * alone


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "problem",
    [scenes.single_door(), scenes.four_rooms(3), scenes.cross(2)],
    ids=["single_door", "rooms-3", "cross-2"],
)
def test_perturbed_starts_and_goals(problem, seed):
    planned(scenes.perturbed(problem, seed))


def test_a_team_of_unequal_robots():
    workspace = Workspace(((0, 0), (8, 6)), [shapely.box(3.8, 0, 4.2, 2), shapely.box(3.8, 4, 4.2, 6)])
    robots = [PointRobot(), DiscRobot(0.5), RectangleRobot(1.4, 0.5)]
    starts = [(1, 1, 9), (1, 5, 8), (6.5, 5, 0.5)]
    goals = [(7, 5, 9), (6.5, 1.5, 8), (1.2, 1.2, 2)]
    problem = Problem(workspace, robots, starts, goals)
    solution = planned(problem)
    assert (solution.path[:, :2, 2] == (9, 8)).all(), "round robots keep the heading of their start"


def test_a_robot_on_its_goal_leaves_and_comes_back():
    bay = Workspace(((0, 0), (7, 2.2)), [shapely.box(0, 1, 3, 2.2), shapely.box(4.2, 1, 7, 2.2)])
    problem = Problem(bay, [DiscRobot(0.45)] * 2, [(0.6, 0.5), (3.6, 0.5)], [(6.4, 0.5), (3.6, 0.5)])
    solution = planned(problem)
    away = solution.path[:, 1, 1]
    assert away[0] == away[-1] == 0.5 and away.max() > 1.3, "the second robot waits in the bay"


def test_two_discs_in_a_bay_narrower_than_a_cell_of_the_first_lattice():
    bay = Workspace(((0, 0), (7, 2.2)), [shapely.box(0, 1, 3.1, 2.2), shapely.box(4.05, 1, 7, 2.2)])
    planned(Problem(bay, [DiscRobot(0.45)] * 2, [(0.6, 0.5), (6.4, 0.5)], [(6.4, 0.5), (0.6, 0.5)]))


# Problems that are hardly problems


@pytest.mark.parametrize("weight", [None, 0.0])
def test_a_start_that_is_the_goal(weight):
    problem = Problem(ROOM, [DiscRobot(0.4), DiscRobot(0.5)], [(1, 1), (5, 5)], [(1, 1), (5, 5)])
    solution = planned(problem, straight_line(problem), heuristic_weight=weight)
    assert solution.status is Status.SOLVED and solution.cost == solution.makespan == solution.lower_bound == 0
    assert solution.stats.num_expansions == 0


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_goal_that_is_the_start_but_for_a_whole_turn(start):
    problem = Problem(ROOM, [RectangleRobot(1, 0.5)], [(5, 5, start)], [(5, 5, start + 2 * np.pi)])
    solution = planned(problem, straight_line(problem), time_limit=20)
    assert solution.cost == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("robot", [PointRobot(), DiscRobot(0.3), RectangleRobot(1, 0.4)])
def test_an_empty_room_is_crossed_straight(robot):
    dof = 3 if isinstance(robot, RectangleRobot) else 2
    problem = Problem(ROOM, [robot], [(1.03, 2.1, 0.3)[:dof]], [(8.7, 6.9, -0.9)[:dof]])
    solution = planned(problem, straight_line(problem), cost_factor=1.0)
    assert solution.status is Status.SOLVED and solution.cost == pytest.approx(solution.lower_bound, rel=1e-9)


def test_ends_that_touch_walls_and_one_another():
    problem = Problem(ROOM, [DiscRobot(0.5)] * 2, [(0.5, 0.5), (1.5, 0.5)], [(9.5, 9.5), (8.5, 9.5)])
    planned(problem, straight_line(problem))


# Where nothing is found


def test_tangle_by_translation_alone_exhausts_its_frontier():
    problem = scenes.tangle()
    solution = bl_plan(problem, straight_line(problem), BLOptions(primitives=TRANSLATIONS, step=0.3))
    assert solution.status is Status.EXHAUSTED
    assert solution.path is None and solution.cost == np.inf and solution.stats.history == ()
    assert solution.stats.num_nodes > 500 and len(solution.samples) == solution.stats.num_nodes
    assert (solution.samples[:, :, 2] == problem.starts[:, 2]).all()


def test_robots_that_cannot_pass():
    solution = bl_plan(hallway(5), zero(), BLOptions(step=1.0))
    assert solution.status is Status.EXHAUSTED and not solution.solved and solution.stats.num_nodes == 10


def test_a_goal_out_of_reach_on_the_lattice_is_exhausted_without_a_search():
    problem = Problem(ROOM, [RectangleRobot(2, 1)], [(2, 2, 0)], [(8, 8, 1.5)])
    solution = bl_plan(problem, zero(), BLOptions(primitives=TRANSLATIONS, step=1.0))
    assert solution.status is Status.EXHAUSTED and solution.stats.num_nodes == 0
    np.testing.assert_array_equal(solution.samples, problem.starts[None])


def test_infeasible_problems_are_refused_before_planning():
    with pytest.raises(ValueError, match=r"Robot 0 has its goal .* cut off"):
        wall = Workspace(((0, 0), (6, 6)), [shapely.box(2, 0, 3, 6)])
        Problem(wall, [DiscRobot(0.3)], [(1, 1)], [(5, 5)])


# When it stops


@pytest.mark.parametrize(
    ("options", "status"),
    [
        ({"max_expansions": 3}, Status.EXPANSION_LIMIT),
        ({"max_memory": 4000}, Status.MEMORY_LIMIT),
        ({"max_memory": 1_500_000}, Status.MEMORY_LIMIT),
        ({"step": 1e-3, "max_memory": 1e8}, Status.MEMORY_LIMIT),
        ({"step": 1e-200}, Status.MEMORY_LIMIT),
        ({"step": 2e-2, "time_limit": 0.05}, Status.TIME_LIMIT),
        ({"time_limit": 1e-6}, Status.TIME_LIMIT),
    ],
)
def test_limits(options, status):
    problem = scenes.four_rooms(2)
    solution = bl_plan(problem, zero(), BLOptions(**options))
    assert solution.status is status and not solution.solved and solution.cost == np.inf


@pytest.mark.parametrize("max_expansions", [1, 29, 29.5])
def test_expansions_are_never_more_than_asked_for(max_expansions):
    # Of a hallway no path leads out, so that the search widens to whole batches.
    solution = bl_plan(hallway(9), zero(), BLOptions(step=0.3, max_expansions=max_expansions))
    assert solution.status is Status.EXPANSION_LIMIT
    assert solution.stats.num_expansions == int(max_expansions)


def test_without_a_heuristic_straight_lines_guide():
    problem = scenes.single_door()
    assert same(bl_plan(problem), planned(problem, straight_line(problem)))


def test_lattices_count_as_memory():
    problem = scenes.single_door()
    for max_memory, begun in ((4000, False), (1_500_000, True)):
        solution = bl_plan(problem, zero(), BLOptions(max_memory=max_memory, cell_size=1e-3, step=0.5))
        assert (solution.stats.num_nodes > 0) is begun


@pytest.mark.parametrize("robot", [DiscRobot(1e-3), RectangleRobot(2, 1)], ids=["disc", "rectangle"])
def test_a_small_robot_in_a_large_map(robot):
    workspace = Workspace(((0, 0), (1000, 1000)))
    dof = 3 if isinstance(robot, RectangleRobot) else 2
    problem = Problem(workspace, [robot], [(1, 2, 0)[:dof]], [(990, 20, 1)[:dof]])
    planned(problem, straight_line(problem), max_expansions=2000)


def test_walls_far_from_the_origin_are_touched_alike():
    workspace = Workspace(((0, 1e6), (0.06, 1e6 + 0.04)), [shapely.box(0.02, 1e6, 0.03, 1e6 + 0.03)])
    problem = Problem(workspace, [PointRobot()], [(0.01, 1e6 + 0.01)], [(0.05, 1e6 + 0.011)])
    planned(problem, straight_line(problem))


def test_a_cost_factor_is_met_by_the_first_path_that_is_good_enough():
    problem = scenes.four_rooms(2)
    content = planned(problem, cost_factor=1.5)
    assert content.status is Status.SOLVED and content.cost <= 1.5 * content.lower_bound
    assert content.stats.num_expansions == planned(problem).stats.num_expansions


def test_an_improving_planner_goes_on_until_its_limit():
    problem = scenes.cross(2)
    first = planned(problem)
    better = planned(problem, cost_factor=1.0, max_expansions=first.stats.num_expansions + 250)
    best = planned(problem, cost_factor=1.0, max_expansions=first.stats.num_expansions + 500)
    assert better.status is best.status is Status.EXPANSION_LIMIT
    assert best.cost <= better.cost <= first.cost and best.cost < first.cost
    assert best.stats.num_expansions > better.stats.num_expansions > first.stats.num_expansions
    assert [cost for _, cost in best.stats.history][: len(better.stats.history)] == [
        cost for _, cost in better.stats.history
    ]


def test_on_a_given_lattice_improving_ends():
    problem = scenes.single_door()
    solution = planned(problem, cost_factor=1.0, step=0.5)
    assert solution.status is Status.EXHAUSTED and solution.cost > solution.lower_bound


def test_a_lower_bound_of_the_caller_counts():
    problem = scenes.single_door()
    alone = float(exact(problem)(problem.starts[None])[0])
    solution = planned(problem, cost_factor=1.05, lower_bound=0.999 * alone)
    assert solution.status is Status.SOLVED and solution.lower_bound == 0.999 * alone
    below = planned(problem, lower_bound=0.1)
    assert below.lower_bound == pytest.approx(np.hypot(8.21 - 2.13, 2.07 - 1.94)), "straight lines are a better one"


class Interruption:
    """A straight line's plain function that the user interrupts at some call."""

    def __init__(self, problem, at):
        self.line, self.at, self.calls = straight_line(problem), at, 0

    def __call__(self, q):
        self.calls += 1
        if self.calls == self.at:
            raise KeyboardInterrupt
        return self.line(q)


def test_an_interrupted_planner_returns_what_it_has():
    problem = scenes.single_door()
    whole = Interruption(problem, None)
    first = planned(problem, whole, step=0.5)
    solution = planned(problem, Interruption(problem, whole.calls + 5), step=0.5, cost_factor=1.0)
    assert solution.status is Status.INTERRUPTED
    assert solution.cost <= first.cost and solution.stats.history[0][1] == first.stats.history[0][1]
    assert solution.stats.num_nodes > first.stats.num_nodes and solution.stats.seconds["search"] > 0


@pytest.mark.parametrize("at", [1, 4])
def test_an_interruption_before_the_first_path(at):
    problem = scenes.single_door()
    solution = bl_plan(problem, Interruption(problem, at), BLOptions(step=0.5))
    assert solution.status is Status.INTERRUPTED and not solution.solved
    assert len(solution.samples) == max(solution.stats.num_nodes, 1)


# What options and heuristics do


@cache
def nodes(kind):
    problem = scenes.single_door()
    heuristic = {"zero": zero(), "line": straight_line(problem), "distances": exact(problem)}[kind]
    return planned(problem, heuristic).stats.num_nodes


def test_the_better_the_heuristic_the_fewer_the_nodes():
    assert nodes("distances") < nodes("line") < nodes("zero")
    assert 6 * nodes("distances") <= nodes("zero")


def test_the_point_robot_heuristic_of_the_paper_helps():
    from plr_jax import robot_distance_fns

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
    fine, coarse = (planned(problem, step=0.25, cell_size=size).stats.num_nodes for size in (None, 0.5))
    assert coarse < fine


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


@pytest.mark.parametrize("options", [{"primitives": FOUR_NEIGHBORS}, {"branching": 20}, {"batch": 1}, {"width": 9}])
def test_other_options_solve_too(options):
    planned(scenes.four_rooms(2), step=0.5, **options)


def test_samples_are_the_free_joint_configurations_of_the_nodes():
    problem = scenes.four_rooms(2)
    solution = planned(problem, step=0.5)
    assert len(solution.samples) == solution.stats.num_nodes
    np.testing.assert_array_equal(solution.samples[0], problem.starts)
    assert len(np.unique(solution.samples.reshape(len(solution.samples), -1), axis=0)) == len(solution.samples)
    for q in solution.samples[::5]:
        Problem(problem.workspace, problem.robots, q, q)  # refuses what is in collision


def test_statistics():
    stats = planned(scenes.four_rooms(2)).stats
    assert stats.num_children_scored >= stats.num_children_valid >= stats.num_nodes - 1 > 0
    assert {"lattice", "heuristic", "search", "shorten"} <= set(stats.seconds)
    assert all(seconds >= 0 for seconds in stats.seconds.values())
    assert sum(stats.seconds.values()) >= stats.first_solution * 0.5
