"""The planner: problems that it solves, each path checked by an independent test, and what options do."""

import networkx as nx
import numpy as np
import pytest
import shapely
from planner_helpers import (
    FOUR_NEIGHBORS,
    ROOM,
    TRANSLATIONS,
    exact,
    graph_of,
    hallway,
    joint_lattice_of,
    nudged_discs,
    nudged_team,
    planned,
)

from experiments import _dbcbs
from plr_jax import (
    BLOptions,
    DiscRobot,
    PointRobot,
    Problem,
    RectangleRobot,
    Status,
    Workspace,
    bl_plan,
    replan,
    robot_distance_fns,
    scenes,
    straight_line,
    sum_of_distances,
    validate,
    zero,
)
from plr_jax.planners import driver

DOOR, ROOMS = scenes.single_door(), scenes.four_rooms(2)
DOOR_STRAIGHT = np.hypot(8.21 - 2.13, 2.07 - 1.94)
LARGE = Workspace(((0, 0), (1000, 1000)))


# What is solved


@pytest.mark.parametrize(
    "problem",
    [DOOR, scenes.maze(), scenes.four_rooms(4), scenes.four_rooms(8), scenes.cross(3), scenes.tangle()],
    ids=["door", "maze", "rooms-4", "rooms-8", "cross-3", "tangle"],
)
def test_scenes(problem):
    solution = planned(problem)
    assert solution.status is Status.SOLVED
    # The joint cost has the robots' own shortest ways as a bound, but for what inflating corners rounds off.
    alone = float(exact(problem)(problem.starts[None])[0])
    assert solution.cost >= (1 - 1e-3) * alone
    # Measured: up to 1.03 for discs, and up to 1.31 for rectangles, whose turns the bound leaves out.
    assert solution.cost <= (1.05 if problem.dof == 2 else 1.35) * alone


DBCBS = ["alcove_unicycle", "alcove_unicycle_sphere", "at_goal_unicycle", "classic", "gen_p10_n8_0_unicycle_sphere"]
DBCBS += ["swap4_unicycle_sphere", "wall", "window2_unicycle", "window4_unicycle_sphere"]


@pytest.mark.parametrize("name", DBCBS)
def test_problems_of_dbcbs_their_robots_holonomic(data_dir, name):
    assert planned(_dbcbs.read_problem(data_dir / "dbcbs" / f"{name}.yaml")).status is Status.SOLVED


def test_infeasible_problems_are_refused_before_planning(data_dir):
    with pytest.raises(ValueError, match="Robots 0 and 1 overlap at their goals"):
        _dbcbs.read_problem(data_dir / "dbcbs" / "infeasible_0.yaml")
    wall = Workspace(((0, 0), (6, 6)), [shapely.box(2, 0, 3, 6)])
    with pytest.raises(ValueError, match=r"Robot 0 has its goal .* cut off"):
        Problem(wall, [DiscRobot(0.3)], [(1, 1)], [(5, 5)])


CROWD = scenes.crowd(40, seed=3)
BAY = Workspace(((0, 0), (7, 2.2)), [shapely.box(0, 1, 3.1, 2.2), shapely.box(4.05, 1, 7, 2.2)])
TINY = Workspace(((0, 1e6), (0.06, 1e6 + 0.04)), [shapely.box(0.02, 1e6, 0.03, 1e6 + 0.03)])
SOLVED = {
    "a perturbed door": (scenes.perturbed(DOOR, 0), {}),
    "perturbed rooms": (scenes.perturbed(scenes.four_rooms(3), 1), {}),
    "a perturbed cross": (scenes.perturbed(scenes.cross(2), 2), {}),
    "a crowd": (CROWD, {"heuristic": straight_line(CROWD), "step": 0.4}),
    "a bay narrower than a cell of the first lattice": (
        Problem(BAY, [DiscRobot(0.45)] * 2, [(0.6, 0.5), (6.4, 0.5)], [(6.4, 0.5), (0.6, 0.5)]), {}),
    "a disc that is small in a large map": (
        Problem(LARGE, [DiscRobot(1e-3)], [(1, 2)], [(990, 20)]), {"max_expansions": 2000}),
    "a rectangle that is small in a large map": (
        Problem(LARGE, [RectangleRobot(2, 1)], [(1, 2, 0)], [(990, 20, 1)]), {"max_expansions": 2000}),
    "walls far from the origin": (Problem(TINY, [PointRobot()], [(0.01, 1e6 + 0.01)], [(0.05, 1e6 + 0.011)]), {}),
    "ends that touch walls and one another": (
        Problem(ROOM, [DiscRobot(0.5)] * 2, [(0.5, 0.5), (1.5, 0.5)], [(9.5, 9.5), (8.5, 9.5)]), {}),
    **{
        f"goals in the cells of starts, {robot}, by {searcher}": (
            nudged_team(robot), {"searchers": (searcher,), "step": 1.0})
        for robot in (DiscRobot(0.15), RectangleRobot(0.4, 0.1)) for searcher in ("lacam", "bl")
    },
    "four neighbors": (ROOMS, {"primitives": FOUR_NEIGHBORS, "step": 0.5}),
    "few children at a time": (ROOMS, {"branching": 20, "step": 0.5}),
    "one node at a time": (ROOMS, {"batch": 1, "step": 0.5}),
    "a narrow beam": (ROOMS, {"width": 9, "step": 0.5}),
}  # fmt: skip


@pytest.mark.parametrize(("problem", "options"), SOLVED.values(), ids=SOLVED)
def test_what_is_solved(problem, options):
    planned(problem, **options)


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


def test_packed_discs_move_from_place_to_place():
    places = np.array([(x + 0.5, y + 0.5) for x in range(3) for y in range(3)])
    starts, goals = places[:8], places[[7, 0, 1, 4, 8, 6, 3, 5]]
    problem = Problem(Workspace(((0, 0), (3, 3)), []), [DiscRobot(0.5)] * 8, starts, goals)
    assert driver.first_step(problem, 9) == 1.0
    planned(problem)


def test_small_robots_beside_large_ones_have_a_lattice_of_their_size():
    robots, starts = [DiscRobot(3.65), DiscRobot(0.3)], [(5, 3.65), (0.5, 0.5)]
    before = Problem(ROOM, robots, starts, [(5, 3.65), (0.5, 9.5)])
    problem = Problem(ROOM, robots, starts, [(5, 3.65), (9.5, 0.5)])
    assert driver.first_step(problem, 9) == 0.3
    solution = replan(problem, bl_plan(before), 0.0, standing=[0])
    assert solution.stats.found_by == "replan" and validate(problem, solution.path).valid


def test_a_robot_may_be_wider_than_its_workspace_by_the_tolerance():
    workspace = Workspace(((1e10, 1e10), (1e10 + 1, 1e10 + 1)))
    start, goal = (1e10 + 0.5, 1e10 + 0.5), (1e10 + 0.501, 1e10 + 0.5)
    problem = Problem(workspace, [DiscRobot(0.5 + workspace.tolerance / 2)], [start], [goal])
    assert driver.first_step(problem, 9) == 1.0


def test_crowds_take_wider_steps_than_a_few_robots():
    steps = [driver.first_step(scenes.crowd(size), 9) for size in (40, 100, 200, 500)]
    assert steps[0] == steps[1] == pytest.approx(0.4) and steps[1] < steps[2] <= steps[3] < 0.8
    halls = Workspace(((0, 0), (31, 15)), [shapely.box(15, 0, 16, 6.9), shapely.box(15, 8.1, 16, 15)])
    places = [(1 + 1.4 * i, 1 + 1.44 * j) for i in range(10) for j in range(10)]
    places += [(31 - x, y) for x, y in places]
    problem = Problem(halls, [DiscRobot(0.4)] * 200, places, places[::-1])
    assert driver.first_step(problem, 9) == 0.4, "the door is narrower than a wider step leaves it open"


def test_a_passage_that_the_first_lattice_lacks_is_found_where_the_way_around_is_long():
    lower, upper = [(4.5, 0), (5.5, 0), (5.5, 2.69), (4.5, 2.69)], [(4.5, 3.51), (5.5, 3.51), (5.5, 8.8), (4.5, 8.8)]
    workspace = Workspace(((0, 0), (10, 10)), [lower, upper])
    problem = Problem(workspace, [DiscRobot(0.4)] * 2, [(1, 3), (1, 5)], [(9, 3), (9, 5)])
    assert bl_plan(problem, options=BLOptions(("lacam",), step=0.4)).cost > 27
    for searchers in (("lacam",), ("bl",), ("lacam", "bl")):
        assert planned(problem, exact(problem), searchers=searchers).cost < 17.2


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


def test_many_robots_that_are_only_nudged_go_straight():
    problem = nudged_discs(8)
    solution = bl_plan(problem)
    assert solution.solved and validate(problem, solution.path).valid
    assert solution.cost == pytest.approx(64 * np.hypot(0.1, 0.1))
    # 6,400 cells: one table of their motions, and a column of costs for each robot.
    assert solution.stats.num_bytes < 2e7


@pytest.mark.parametrize("robot", [PointRobot(), DiscRobot(0.3), RectangleRobot(1, 0.4)])
def test_an_empty_room_is_crossed_straight(robot):
    dof = 3 if isinstance(robot, RectangleRobot) else 2
    problem = Problem(ROOM, [robot], [(1.03, 2.1, 0.3)[:dof]], [(8.7, 6.9, -0.9)[:dof]])
    solution = planned(problem, straight_line(problem), cost_factor=1.0)
    assert solution.status is Status.SOLVED and solution.cost == pytest.approx(solution.lower_bound, rel=1e-9)


# Where nothing is found


def test_tangle_by_translation_alone_exhausts_its_frontier():
    problem = scenes.tangle()
    solution = bl_plan(problem, straight_line(problem), BLOptions(("bl",), TRANSLATIONS, step=0.3))
    assert solution.status is Status.EXHAUSTED
    assert solution.path is None and solution.cost == np.inf and solution.stats.history == ()
    assert solution.stats.num_nodes > 500 and len(solution.samples) == solution.stats.num_nodes
    assert (solution.samples[:, :, 2] == problem.starts[:, 2]).all()


@pytest.mark.parametrize(
    ("problem", "options", "num_nodes"),
    [
        (hallway(5), {"searchers": ("bl",), "step": 1.0}, 10),
        # Out of reach on the lattice, which takes no search.
        (
            Problem(ROOM, [RectangleRobot(2, 1)], [(2, 2, 0)], [(8, 8, 1.5)]),
            {"primitives": TRANSLATIONS, "step": 1.0},
            0,
        ),
        (ROOMS, {"searchers": ("bl",), "step": 1e12, "time_limit": 5}, 0),  # a lattice of one cell
    ],
    ids=["robots that cannot pass", "a heading that is never reached", "a step beyond all bounds"],
)
def test_what_has_no_path_is_exhausted(problem, options, num_nodes):
    solution = bl_plan(problem, zero(), BLOptions(**options))
    assert solution.status is Status.EXHAUSTED and not solution.solved and solution.stats.num_nodes == num_nodes
    if not num_nodes:
        np.testing.assert_array_equal(solution.samples, problem.starts[None])


# What a solution tells


def test_samples_are_the_free_joint_configurations_of_the_nodes_and_statistics_add_up():
    solution = planned(ROOMS, step=0.5)
    samples, stats = solution.samples, solution.stats
    assert len(samples) == stats.num_nodes
    np.testing.assert_array_equal(samples[0], ROOMS.starts)
    assert len(np.unique(samples.reshape(len(samples), -1), axis=0)) == len(samples)
    for q in samples[::5]:
        Problem(ROOMS.workspace, ROOMS.robots, q, q)  # refuses what is in collision
    assert stats.num_children_scored >= stats.num_children_valid >= stats.num_nodes - 1 > 0
    assert {"lattice", "heuristic", "search", "shorten"} <= set(stats.seconds)
    assert all(seconds >= 0 for seconds in stats.seconds.values())
    assert sum(stats.seconds.values()) >= stats.first_solution * 0.5


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        ([(0, 1), (2, 3)], 2),
        ([(0, 1), (2, 3), (2, 3), (2, 3)], 2),
        ([(0, 1), (2, 3), (2, 1), (2, 3), (2, 3)], 4),  # the team is at its goals once before
        ([(2, 3), (2, 3)], 1),
        ([(2, 3)], 1),
    ],
)
def test_a_path_ends_when_all_have_arrived_for_good(rows, kept):
    state = np.array(rows)
    np.testing.assert_array_equal(driver.until_arrival(state), state[:kept])


# What heuristics and options do, and that nothing else does


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
    solution = bl_plan(DOOR, options=BLOptions(searchers=("bl",), step=0.4, heuristic_weight=1.0))
    (lattice,) = joint_lattice_of(DOOR, 0.4).lattices
    least = nx.dijkstra_path_length(graph_of(lattice), lattice.start, lattice.goal, "cost")
    assert solution.stats.history[0][1] == pytest.approx(least, rel=1e-6) and solution.stats.num_nodes < 100


def test_the_better_the_heuristic_the_fewer_the_nodes():
    of_points = sum_of_distances(robot_distance_fns(DOOR, inflated=False))  # the paper's
    distances, paper, line, nothing = (
        planned(DOOR, heuristic).stats.num_nodes
        for heuristic in (exact(DOOR), of_points, straight_line(DOOR), zero())
    )
    assert distances < line < nothing and 6 * max(distances, paper) <= nothing


@pytest.mark.parametrize("options", [{}, {"cost_factor": 1.0, "max_expansions": 60}], ids=["first", "improving"])
def test_two_runs_do_the_same_bit_for_bit_whatever_is_planned_between(options):
    problem = scenes.four_rooms(3)
    before = planned(problem, **options)
    planned(scenes.perturbed(problem, 1))
    planned(problem, step=0.5, primitives=FOUR_NEIGHBORS)
    assert same(before, planned(problem, **options))


def test_larger_cells_make_fewer_nodes_and_tiny_cells_change_nothing():
    # A child in its parent's own cell is dropped, so that motions must be about as long as the cells are wide.
    primitives = (*TRANSLATIONS, *((3 * x, 3 * y, 0) for x, y, _ in TRANSLATIONS))
    fine, tiny, coarse = (
        planned(DOOR, zero(), step=0.2, cell_size=size, primitives=primitives) for size in (None, 1e-3, 0.3)
    )
    assert same(fine, tiny) and coarse.stats.num_nodes < 0.7 * fine.stats.num_nodes
    fine, coarse = (planned(ROOMS, step=0.25, cell_size=size, searchers=("bl",)) for size in (None, 0.5))
    assert coarse.stats.num_nodes < fine.stats.num_nodes


def test_a_nudge_among_as_many_primitives_as_there_may_be():
    bar = Problem(Workspace(((0, 0), (2, 2))), [RectangleRobot(0.2, 0.1)], [(1.03, 1.03, 0.1)], [(1.13, 1.13, 0.1)])
    primitives = (*FOUR_NEIGHBORS, *((0, 0, turn) for turn in range(1, 251)))
    solution = planned(bar, searchers=("bl",), step=0.5, primitives=primitives)
    assert solution.cost == pytest.approx(np.hypot(0.1, 0.1))


# Refusals


class Bounding:
    is_lower_bound = True

    def __init__(self, answer):
        self.answer = answer

    def __call__(self, q):
        return self.answer


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("heuristic", "message"),
    [
        *((Bounding(answer), "heuristic") for answer in (0.0, None, np.zeros(0), np.zeros((1, 2)), "far")),
        (BLOptions(), r"bl_plan\(problem, options=BLOptions"),
        (robot_distance_fns(ROOMS), r"sum_of_distances\(distance_fns\)"),
    ],
)
def test_what_is_no_heuristic_is_refused(heuristic, message):
    with pytest.raises(ValueError, match=message):
        bl_plan(ROOMS, heuristic)
