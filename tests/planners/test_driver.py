"""The planner: problems that it solves (an independent test checks each path), its heuristics and its options."""

import numpy as np
import pytest
import shapely
from planner_helpers import DOOR, ROOM, ROOMS, exact, hallway, joint_lattice_of, nudged_discs, nudged_team, planned

from experiments import _dbcbs
from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, robot_distance_fns, scenes, validate
from plr_jax.planners import BLOptions, Status, bl_plan, driver, replan, straight_line, sum_of_distances, zero

LARGE = Workspace(((0, 0), (1000, 1000)))


# Problems that must be solved, and the cost of their solutions


@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(DOOR, id="door"),
        pytest.param(scenes.four_rooms(3), id="rooms"),
        pytest.param(scenes.cross(2), id="cross"),
        pytest.param(scenes.tangle(), id="tangle", marks=pytest.mark.full),
    ],
)
def test_scenes_are_solved_near_the_shortest_ways(problem):
    solution = planned(problem, None)
    assert solution.status is Status.SOLVED
    # The robots' own shortest ways bound the joint cost, except for the rounding of inflated corners.
    alone = float(exact(problem)(problem.starts[None])[0])
    assert solution.cost >= (1 - 1e-3) * alone
    # Measured: up to 1.03 for discs, and up to 1.31 for rectangles, whose turns the bound leaves out.
    assert solution.cost <= (1.05 if problem.dof == 2 else 1.35) * alone


def test_full_ring_of_discs_rotates():
    """Each disc almost fills its cell of a ring. The discs cannot all pass the corners at once."""
    starts = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]) + 0.5
    workspace = Workspace(((0, 0), (3, 3)), [shapely.box(1, 1, 2, 2)])
    problem = Problem(workspace, [DiscRobot(0.4)] * len(starts), starts, np.roll(starts, -1, axis=0))
    solution = bl_plan(problem, options=BLOptions(max_expansions=1000))
    assert solution.solved and validate(problem, solution.path).valid
    assert len(starts) - 1e-9 <= solution.cost < 1.05 * len(starts)  # each goes a side of a cell at least


def test_points_go_around_contact_at_cell_center():
    boxes = [[(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 1), (2, 1), (2, 2), (1, 2)]]  # they touch at (1, 1)
    workspace, above, below = Workspace(((-1, -1), (3, 3)), boxes), (0.5, 1.5), (1.5, 0.5)
    solution = planned(Problem(workspace, [PointRobot()], [above], [below]), None, step=0.8)
    assert 2 + np.sqrt(2) - 1e-9 <= solution.cost < 4.5  # around either box
    # A robot that ends at the contact may come from any side. Another robot must not go through it.
    team = Problem(workspace, [PointRobot()] * 3, [above, below, (1, 1)], [(1, 1), (1, 1), above])
    assert planned(team, None, step=0.8).cost == pytest.approx(3 * np.sqrt(0.5))


@pytest.mark.parametrize("slack", [0.0, 1e-9])
def test_discs_pass_in_a_stem_as_wide_as_they_are(slack):
    """Two discs change ends of a T whose lattices are too coarse: the path is the shortened sequential one."""
    walls = [shapely.box(0, 1, 1, 2), shapely.box(2, 1, 3, 2)]
    ends = [(0.5, 0.5), (2.5, 0.5)]
    problem = Problem(Workspace(((0, 0), (3, 2)), walls), [DiscRobot(0.5 - slack)] * 2, ends, ends[::-1])
    solution = planned(problem, None)
    assert solution.status is Status.SOLVED and solution.cost < 5.6 and solution.stats.num_expansions < 500
    assert planned(problem, None, cost_factor=1.42).cost <= 1.42 * 4, "shortening alone meets the factor"


CROWD = scenes.crowd(8, seed=3)
BAY = Workspace(((0, 0), (7, 2.2)), [shapely.box(0, 1, 3.1, 2.2), shapely.box(4.05, 1, 7, 2.2)])
TINY = Workspace(((0, 1e6), (0.06, 1e6 + 0.04)), [shapely.box(0.02, 1e6, 0.03, 1e6 + 0.03)])
SOLVED = {
    "a crowd": (CROWD, {"heuristic": straight_line(CROWD), "step": 0.4}),
    "a bay narrower than a cell of the first lattice": (
        Problem(BAY, [DiscRobot(0.45)] * 2, [(0.6, 0.5), (6.4, 0.5)], [(6.4, 0.5), (0.6, 0.5)]), {}),
    "a disc that is small in a large map": (
        Problem(LARGE, [DiscRobot(1e-3)], [(1, 2)], [(990, 20)]), {"max_expansions": 2000}),
    "walls far from the origin": (Problem(TINY, [PointRobot()], [(0.01, 1e6 + 0.01)], [(0.05, 1e6 + 0.011)]), {}),
    "ends that touch walls and one another": (
        Problem(ROOM, [DiscRobot(0.5)] * 2, [(0.5, 0.5), (1.5, 0.5)], [(9.5, 9.5), (8.5, 9.5)]), {}),
    "goals of discs in the cells of starts": (nudged_team(DiscRobot(0.15)), {"searchers": ("bl",), "step": 1.0}),
}  # fmt: skip


@pytest.mark.parametrize(("problem", "options"), SOLVED.values(), ids=SOLVED)
def test_problem_is_solved(problem, options):
    planned(problem, **{"heuristic": None, **options})


def test_step_fits_the_robots_that_replan():
    robots, starts = [DiscRobot(3.65), DiscRobot(0.3)], [(5, 3.65), (0.5, 0.5)]
    before = Problem(ROOM, robots, starts, [(5, 3.65), (0.5, 9.5)])
    problem = Problem(ROOM, robots, starts, [(5, 3.65), (9.5, 0.5)])
    assert driver.first_step(problem) == 0.3
    solution = replan(problem, bl_plan(before), 0.0, standing=[0])
    assert solution.stats.found_by == "replan" and validate(problem, solution.path).valid


def test_robot_may_be_wider_than_workspace_by_tolerance():
    workspace = Workspace(((1e10, 1e10), (1e10 + 1, 1e10 + 1)))
    start, goal = (1e10 + 0.5, 1e10 + 0.5), (1e10 + 0.501, 1e10 + 0.5)
    problem = Problem(workspace, [DiscRobot(0.5 + workspace.tolerance / 2)], [start], [goal])
    assert driver.first_step(problem) == 1.0


def test_crowds_take_wider_steps():
    steps = [driver.first_step(scenes.crowd(size)) for size in (40, 100, 200, 500)]
    assert steps[0] == steps[1] == pytest.approx(0.4) and steps[1] < steps[2] <= steps[3] < 0.8
    halls = Workspace(((0, 0), (31, 15)), [shapely.box(15, 0, 16, 6.9), shapely.box(15, 8.1, 16, 15)])
    places = [(1 + 1.4 * i, 1 + 1.44 * j) for i in range(10) for j in range(10)]
    places += [(31 - x, y) for x, y in places]
    problem = Problem(halls, [DiscRobot(0.4)] * 200, places, places[::-1])
    assert driver.first_step(problem) == 0.4, "a wider step would miss the door"


def test_passage_that_first_lattice_misses_is_found():
    lower, upper = [(4.5, 0), (5.5, 0), (5.5, 2.69), (4.5, 2.69)], [(4.5, 3.51), (5.5, 3.51), (5.5, 8.8), (4.5, 8.8)]
    workspace = Workspace(((0, 0), (10, 10)), [lower, upper])
    problem = Problem(workspace, [DiscRobot(0.4)] * 2, [(1, 3), (1, 5)], [(9, 3), (9, 5)])
    assert bl_plan(problem, options=BLOptions(("lacam",), step=0.4)).cost > 27
    assert planned(problem, exact(problem), searchers=("lacam",)).cost < 17.2


@pytest.mark.parametrize("weight", [None, 0.0])
def test_start_at_goal_costs_nothing(weight):
    problem = Problem(ROOM, [DiscRobot(0.4), DiscRobot(0.5)], [(1, 1), (5, 5)], [(1, 1), (5, 5)])
    solution = planned(problem, straight_line(problem), heuristic_weight=weight)
    assert solution.status is Status.SOLVED and solution.cost == solution.makespan == solution.lower_bound == 0
    assert solution.stats.num_expansions == 0


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_whole_turn_costs_nothing(start):
    problem = Problem(ROOM, [RectangleRobot(1, 0.5)], [(5, 5, start)], [(5, 5, start + 2 * np.pi)])
    solution = planned(problem, straight_line(problem), time_limit=20)
    assert solution.cost == pytest.approx(0, abs=1e-12)


def test_many_robots_with_near_goals_go_straight():
    problem = nudged_discs(4)
    solution = bl_plan(problem)
    assert solution.solved and validate(problem, solution.path).valid
    assert solution.cost == pytest.approx(16 * np.hypot(0.1, 0.1))
    # 1,600 cells: one table of their motions, and a column of costs for each robot.
    assert solution.stats.num_bytes < 5e6


@pytest.mark.parametrize("robot", [PointRobot(), DiscRobot(0.3), RectangleRobot(1, 0.4)])
def test_empty_room_is_crossed_straight(robot):
    dof = 3 if isinstance(robot, RectangleRobot) else 2
    problem = Problem(ROOM, [robot], [(1.03, 2.1, 0.3)[:dof]], [(8.7, 6.9, -0.9)[:dof]])
    solution = planned(problem, straight_line(problem), cost_factor=1.0)
    assert solution.status is Status.SOLVED and solution.cost == pytest.approx(solution.lower_bound, rel=1e-9)


# Where nothing is found


@pytest.mark.parametrize(("problem", "step", "num_nodes"), [(hallway(5), 1.0, 10), (ROOMS, 1e12, 0)])
def test_problem_without_path_is_exhausted(problem, step, num_nodes):
    solution = bl_plan(problem, zero(), BLOptions(("bl",), step=step, time_limit=5))
    assert solution.status is Status.EXHAUSTED and solution.path is None and solution.cost == np.inf
    assert solution.stats.num_nodes == num_nodes and solution.stats.history == ()
    assert len(solution.samples) == max(num_nodes, 1)
    np.testing.assert_array_equal(solution.samples[0], problem.starts)


# Samples and statistics


def test_samples_are_free_and_statistics_add_up():
    solution = planned(ROOMS, exact(ROOMS), step=0.5)
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


# Heuristics and options


def test_default_heuristic_is_cost_along_lattice():
    solution = bl_plan(DOOR, options=BLOptions(searchers=("bl",), step=0.4, heuristic_weight=1.0))
    (least,) = joint_lattice_of(DOOR, 0.4).least_costs
    assert solution.stats.history[0][1] == pytest.approx(least, rel=1e-6) and solution.stats.num_nodes < 100


def test_better_heuristics_need_fewer_nodes():
    of_points = sum_of_distances(robot_distance_fns(DOOR, inflated=False))  # the paper's
    distances, paper, line, nothing = (
        planned(DOOR, heuristic).stats.num_nodes
        for heuristic in (exact(DOOR), of_points, straight_line(DOOR), zero())
    )
    assert distances < line < nothing and 6 * max(distances, paper) <= nothing


def test_plans_repeat_whatever_is_planned_between():
    options = {"heuristic": exact(ROOMS), "cost_factor": 1.0, "max_expansions": 20}
    first = planned(ROOMS, **options)
    planned(DOOR, exact(DOOR), step=0.5)
    again = planned(ROOMS, **options)
    np.testing.assert_array_equal(first.path, again.path)
    np.testing.assert_array_equal(first.samples, again.samples)
    assert first.stats.num_expansions == again.stats.num_expansions > 0 and first.status is again.status


@pytest.mark.parametrize("name", driver.SEARCHES)
def test_planner_knows_searches_only_by_their_table(name, monkeypatch):
    monkeypatch.setitem(driver.SEARCHES, "new", driver.SEARCHES[name])
    known, new = (planned(ROOMS, None, step=0.5, searchers=(each,), max_expansions=400) for each in (name, "new"))
    np.testing.assert_array_equal(known.path, new.path)
    assert known.stats.found_by == name and new.stats.found_by == "new"


# Refusals


@pytest.mark.usefixtures("unchecked_types")
def test_other_objects_as_heuristic_raise():
    for heuristic, message in (
        (zero, r"the result of zero\(\), got zero itself: call it"),
        (sum_of_distances, r"the result of sum_of_distances\(distance_fns\), got sum_of_distances itself: call it"),
        (BLOptions(), r"bl_plan\(problem, options=BLOptions"),
        (robot_distance_fns(ROOMS), r"a sum over robots.* sum_of_distances\(distance_fns\)"),
        (lambda q: np.zeros(len(q)), r"a sum over robots with a method per_robot\(q\)"),
    ):
        with pytest.raises(ValueError, match=message):
            bl_plan(ROOMS, heuristic)


POSITIVE = ("step", "time_limit", "max_expansions", "max_memory")


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_options_raise():
    for name in POSITIVE:
        for value in (0.0, -5.0, float("nan")):
            with pytest.raises(ValueError, match=rf"{name} must be .*positive .*, got {value}"):
                BLOptions(**{name: value})
    for value in (float("inf"), 10**400):
        with pytest.raises(ValueError, match="step must be None or a positive finite number"):
            BLOptions(step=value)
    for value in (0.99, float("nan"), "2"):
        with pytest.raises(ValueError, match="cost_factor must be a number of at least 1, or inf"):
            BLOptions(cost_factor=value)
    for value in (-5.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="lower_bound must be a finite number of at least 0"):
            BLOptions(lower_bound=value)
    for value in (-0.1, float("inf"), 1e300):
        with pytest.raises(ValueError, match=r"heuristic_weight must be .* from 0 to 1e6"):
            BLOptions(heuristic_weight=value)
    for value in (5, [[]], iter(["bl"]), None, (), "bl"):
        with pytest.raises(ValueError, match="earchers must be"):
            BLOptions(searchers=value)


DBCBS = ["alcove_unicycle", "alcove_unicycle_sphere", "at_goal_unicycle", "classic", "gen_p10_n8_0_unicycle_sphere"]
DBCBS += ["swap4_unicycle_sphere", "wall", "window2_unicycle", "window4_unicycle_sphere"]


@pytest.mark.full
@pytest.mark.parametrize("name", DBCBS)
def test_published_problems_are_solved_by_holonomic_robots(data_dir, name):
    assert planned(_dbcbs.read_problem(data_dir / "dbcbs" / f"{name}.yaml"), None).status is Status.SOLVED


@pytest.mark.full
def test_published_infeasible_problem_is_refused(data_dir):
    with pytest.raises(ValueError, match="Robots 0 and 1 overlap at their goals"):
        _dbcbs.read_problem(data_dir / "dbcbs" / "infeasible_0.yaml")
