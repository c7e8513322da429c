"""The baselines of OMPL: compiled tests of motions against the package's own, workers, and what becomes of paths."""

import itertools
import math

import numpy as np
import pytest
from robot_helpers import random_motions

from experiments.baselines import ompl as ompl_module
from experiments.baselines.ompl import Done, Found, Ready, ompl_plan, ompl_prioritized, task_of
from plr_jax import (
    DiscRobot,
    PointRobot,
    Problem,
    RectangleRobot,
    Workspace,
    path_cost,
    scenes,
    validate,
)
from plr_jax.collision.team import motions_apart
from plr_jax.collision.walls import MotionTest
from plr_jax.planners import Status
from plr_jax.robots.robot import shorter_turn

pytest.importorskip("ompl.base", reason="OMPL baselines: pip install 'plr-jax[baselines]'")
motions = pytest.importorskip("experiments.baselines.ompl_motions", reason="OMPL baselines need numba")
tracks = pytest.importorskip("experiments.baselines.ompl_tracks")
joint = pytest.importorskip("experiments.baselines.ompl_worker")
worker = pytest.importorskip("experiments.baselines.ompl_prioritized_worker")

BOX, WEDGE = [(2.0, 2.0), (3.0, 2.0), (3.0, 3.0), (2.0, 3.0)], [(0.5, 3.0), (1.2, 4.0), (0.2, 4.2)]
WORKSPACE, DISC, POINT = Workspace(((0, 0), (5, 5)), [BOX]), DiscRobot(0.3), PointRobot()
TEAMS = {
    "discs": [DISC, DiscRobot(0.15), POINT],
    "mixed": [DISC, RectangleRobot(0.9, 0.3), POINT, RectangleRobot(0.5, 0.4)],
}
HORIZON = 10.0


def problem_of(*robots, workspace=WORKSPACE):
    """Robots along the bottom, to be moved to the top in reversed order."""
    turns = any(isinstance(robot, RectangleRobot) for robot in robots)
    starts, goals = np.zeros((2, len(robots), 3 if turns else 2))
    starts[:, 0] = goals[::-1, 0] = np.linspace(0.5, 4.5, len(robots))
    starts[:, 1], goals[:, 1] = 0.5, 4.5
    return Problem(workspace, robots, starts, goals)


def scene_of(problem):
    task = task_of(problem, "RRTConnect", 0, 1.0, None)
    return motions.Scene(task.sizes, task.walls, task.tolerance)


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("step", [0.0, 0.3, 1.2])
def test_joint_motions_are_free_as_the_packages_own_tests_say(team, step):
    problem = problem_of(*TEAMS[team], workspace=Workspace(((0, 0), (5, 5)), [BOX, WEDGE]))
    robots, workspace, rng, n = problem.robots, problem.workspace, np.random.default_rng(7), 2000
    moved = [random_motions(rng, n, 5.0, step, min(step, 2.5)) for _ in robots]
    q0, q1 = (np.stack([motion[end] for motion in moved], axis=1) for end in (0, 1))
    scene = scene_of(problem)
    got = np.array([motions.is_motion_free(a, b, scene.address) for a, b in zip(q0, q1, strict=True)])
    expected = np.ones(n, dtype=bool)
    for i, robot in enumerate(robots):
        expected &= workspace.is_free(q0[:, i, :2]) & MotionTest(workspace, robot)(q0[:, i], q1[:, i])
        for j in range(i):
            both = (robots[j], q0[:, j], q1[:, j])
            expected &= motions_apart(robot, q0[:, i], q1[:, i], *both, workspace.tolerance)
    assert 5 < expected.sum() < n - 5
    assert not (got & ~expected).any()
    # Near contact with a turning rectangle, the kernel may refuse.
    assert (expected & ~got).sum() <= (2 if team == "mixed" else 0)


BAR = RectangleRobot(1.0, 0.2)


@pytest.mark.parametrize(
    ("robot", "q0", "q1", "free"),
    [
        (DISC, (1.0, 2.5), (1.7, 2.5), True),  # up to the box, touching
        (DISC, (1.0, 2.5), (1.7 + 1e-6, 2.5), False),
        (DISC, (1.0, 1.0), (4.0, 4.0), False),  # through the box
        (DISC, (2.5, 2.5), (2.5, 2.5), False),  # inside, nothing of it near an edge
        (DISC, (0.3, 0.3), (4.7, 0.3), True),  # along the bounds
        (DISC, (-1.0, 0.5), (-1.0, 0.5), False),  # outside the bounds
        (POINT, (2.5, 2.5), (2.5, 2.5), False),
        (POINT, (2.0, 2.5), (2.0, 2.5), True),
        (POINT, (3.0, 3.0), (3.0, 3.0), True),
        (POINT, (0.0, 0.0), (0.0, 0.0), True),
        (POINT, (5.1, 1.0), (5.1, 1.0), False),
        (BAR, (1.62, 1.1, math.pi - 0.2), (1.62, 1.1, 0.2 - math.pi), True),  # through pi, not through 0
        (BAR, (1.62, 2.5, math.pi / 2), (1.62, 2.5, math.pi / 2), True),
        (BAR, (1.62, 2.5, math.pi / 2), (1.62, 2.5, 0.0), False),
    ],
)
def test_a_motion_by_hand(robot, q0, q1, free):
    a, b = (np.array([[*q, 0.0][:3]]) for q in (q0, q1))
    assert motions.is_motion_free(a, b, scene_of(problem_of(robot)).address) == free


def test_turns_are_those_of_the_package_to_the_bit():
    rng = np.random.default_rng(5)
    first = rng.uniform(-10, 10, 400)
    last = np.concatenate([rng.uniform(-10, 10, 200), first[200:] + rng.choice([-1, 1], 200) * math.pi])
    turns = [motions._turn(*pair) for pair in zip(first, last, strict=True)]
    np.testing.assert_array_equal(turns, shorter_turn(first, last))
    np.testing.assert_allclose(turns[200:], math.pi)


@pytest.mark.parametrize("problem", [scenes.four_rooms(3), problem_of(*TEAMS["mixed"])])
def test_states_are_read_as_they_are_written_and_their_distance_is_our_cost(problem):
    task = task_of(problem, "RRTConnect", 0, 1.0, None)
    space, scene = joint._space(task), scene_of(problem)
    rng = np.random.default_rng(3)
    path = np.zeros((2, len(problem.robots), 3))
    path[..., :2] = rng.uniform(problem.workspace.bounds.lo, problem.workspace.bounds.hi, path[..., :2].shape)
    path[:, task.sizes[:, 0] > 0, 2] = rng.uniform(-3.1, 3.1, (2, int((task.sizes[:, 0] > 0).sum())))
    first, last = (joint._state(space, task, q) for q in path)
    np.testing.assert_array_equal([motions.configurations_of(state, scene) for state in (first, last)], path)
    assert space.distance(first, last) == pytest.approx(path_cost(problem, path[..., : problem.dof]), rel=1e-12)
    free = motions.is_free(id(first), id(last), scene.address)
    assert scene.num_checked == 1 and free == motions.is_motion_free(*path, scene.address)


def checked(problem, solution, target):
    """Fails unless the target was reached by a valid path, in a history that falls."""
    assert solution.status is Status.SOLVED
    report = validate(problem, solution.path)
    assert report.valid, report.message
    np.testing.assert_array_equal(solution.path[[0, -1]], [problem.starts, problem.goals])
    assert solution.lower_bound < solution.cost == pytest.approx(report.cost, rel=1e-12) and solution.cost <= target
    times, costs = zip(*solution.stats.history, strict=True)
    assert all(np.diff(times) >= 0) and all(np.diff(costs) < 0)
    assert costs[-1] == solution.cost
    assert solution.stats.num_children_scored > solution.stats.num_children_valid > 0
    assert set(solution.stats.seconds) == {"compile", "plan"}


def test_a_rectangle_and_a_disc_change_sides():
    """With headings beyond half a turn, as users have them; the disc's is arbitrary."""
    workspace = Workspace(((0, 0), (6, 4)), [[(2.8, 0), (3.2, 0), (3.2, 2.4), (2.8, 2.4)]])
    starts, goals = [(1.2, 1.0, 3.5), (5.0, 1.0, 0.0)], [(4.8, 1.0, 7.0), (1.0, 1.0, 9.0)]
    problem = Problem(workspace, [RectangleRobot(1.6, 0.4), DISC], starts, goals)
    checked(problem, ompl_plan(problem, "RRTConnect", seed=2, time_limit=30.0, cost_target=40.0), 40.0)


def test_paths_that_are_not_valid_are_dropped():
    walls = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 6), (4, 6)]])
    problem = Problem(walls, [POINT], [(1, 1)], [(9, 1)])
    through, over, far_over = (
        np.array([[(1, 1, 0)], [(*middle, 0)], [(9, 1, 0)]], float) for middle in ((5, 1), (5, 9.1), (5, 9.9))
    )

    def found(*paths):
        messages = [Found(float(seconds), path) for seconds, path in enumerate(paths)]
        messages = [Ready(0.5), *messages, Done(True, 9.0, np.zeros((4, 1, 3)), 10, 6)]
        with pytest.warns(UserWarning, match="is not valid and was dropped: Robot 0 collides with obstacle 0"):
            return ompl_module._solution(problem, "RRTstar", messages, False)

    solution = found(far_over, over, through)
    assert [seconds for seconds, _ in solution.stats.history] == [0.0, 1.0]
    np.testing.assert_array_equal(solution.path, over[..., :2])
    assert found(through).status is Status.TIME_LIMIT


def among(problem, others=()):
    """The compiled test of the first robot's motions (x, y, time) among the others' tracks, in order."""
    task = task_of(problem, "prioritized", 0, 1.0, None)
    scene = motions.Scene(task.sizes[[0]], task.walls, task.tolerance)
    reaches = [task.sizes[0, 2] + size - task.tolerance for size in task.sizes[1 : 1 + len(others), 2]]
    traffic = tracks.Traffic(others, reaches)

    def is_free(a, b):
        return tracks.is_motion_free_among(np.array(a, float), np.array(b, float), scene.address, traffic.address)

    return is_free


def random_track(rng):
    """A track from time 0 to the horizon that also rests."""
    times = np.concatenate([[0.0], np.sort(rng.uniform(0, HORIZON, 6)), [HORIZON]])
    places = rng.uniform(0, 5, (len(times), 2))
    places[4] = places[3]
    return np.column_stack([places, times])


def places_at(track, times):
    return np.stack([np.interp(times, track[:, 2], track[:, axis]) for axis in range(2)], axis=1)


@pytest.mark.parametrize(
    ("radii", "longest"), [((0.0, 0.8, 0.0), 0.2), ((0.3, 0.0, 0.2), 4.0), ((0.1, 0.6, 0.3), 0.0)]
)
def test_motions_keep_away_from_tracks_as_many_samples_of_them_say(radii, longest):
    rng = np.random.default_rng(11)
    robots = [DiscRobot(radius) if radius else POINT for radius in radii]
    problem = problem_of(*robots, workspace=Workspace(((-9, -9), (14, 14))))
    num_free = num_caught = 0
    for _ in range(600):
        others = [random_track(rng) for _ in robots[1:]]
        duration = rng.uniform(0, longest)
        begin = rng.uniform(0, HORIZON - duration)
        angle, way = rng.uniform(0, 2 * np.pi), rng.uniform(0, duration)
        a = np.array([*rng.uniform(0, 5, 2), begin])
        b = a + np.array([way * np.cos(angle), way * np.sin(angle), duration])
        times = np.linspace(begin, begin + duration, 1001)
        places = places_at(np.array([a, b]), times)
        surely_free, surely_caught = True, False
        for other, radius in zip(others, radii[1:], strict=True):
            gap = np.hypot(*(places_at(other, times) - places).T).min() - radii[0] - radius
            speed = 1 + (np.hypot(*np.diff(other[:, :2], axis=0).T) / np.diff(other[:, 2])).max()
            surely_free &= gap > speed * duration / 1000
            surely_caught |= gap < -1e-6
        got = among(problem, others)(a, b)
        num_free += surely_free
        num_caught += surely_caught
        assert not (surely_free and not got)
        assert not (surely_caught and got)
    assert num_free > 200
    assert num_caught > 20


@pytest.mark.parametrize(
    ("a", "b", "free"),
    [
        ((1, 0.5, 0), (2, 0.5, 1), True),  # as fast as can be
        ((1, 0.5, 0), (2, 0.5, 0.999), False),
        ((1, 0.5, 1), (1, 0.5, 1), True),
        ((1, 0.5, 1), (2, 0.5, 0), False),  # back in time
        ((1, 0.5, 1), (1, 0.5, 0.5), False),
        ((1, 1, 0), (4, 4, 9), False),  # through the box
        ((0.3, 0.3, 0), (4.7, 0.3, 9), True),  # along the bounds
        ((0.3, 0.3, 0), (4.7, 0.29, 9), False),
    ],
)
def test_a_motion_in_time_by_hand(a, b, free):
    assert among(problem_of(DISC, DISC))(a, b) == free


def planner_of(problem):
    task = task_of(problem, "prioritized", 0, 1.0, None)
    scenes_alone = [motions.Scene(size[None], task.walls, task.tolerance) for size in task.sizes]
    planner = worker._Planner(task, scenes_alone, HORIZON)
    planner.check()
    return planner


def test_a_robot_is_planned_for_among_one_that_crosses_its_way():
    problem = Problem(WORKSPACE, [DISC, DISC], [(1, 0.5), (4, 0.5)], [(4, 0.5), (1, 0.5)])
    planner = planner_of(problem)
    straight = np.array([(4.0, 0.5, 0.0), (1.0, 0.5, HORIZON)])
    planner.turn_to(0, {1: straight})
    found = planner.plan(0.0, HORIZON, 60.0)
    shorter = planner.shorten(found, 60.0)
    for track in (found, shorter):
        np.testing.assert_array_equal(track[[0, -1]], [(1, 0.5, 0), (4, 0.5, HORIZON)])
        assert all(among(problem, [straight])(a, b) for a, b in itertools.pairwise(track))
        assert validate(problem, worker.joint_path([track, straight])[..., :2]).valid
    assert 3 < worker._length(shorter) <= worker._length(found)
    planner.turn_to(0, {1: np.array([(4, 0.5, 0.0), (4, 0.5, HORIZON)])})  # rests in the way
    assert planner.plan(0.0, HORIZON, 0.05) is None
    for information in (planner._timed, planner._metric):
        row = np.array([1.25, -3.5, 7.75])
        np.testing.assert_array_equal(tracks.row_of(worker._state(information, row)), row)


def test_times_are_such_that_a_robot_may_rest_before_and_after():
    problem = problem_of(DISC, DISC)
    planner, rng = planner_of(problem), np.random.default_rng(0)
    (x, y), (far_x, far_y) = problem.starts[0], problem.goals[0]
    # The other comes to the start, from which it is 0.6 away at time 3.4.
    coming = np.array([(4.5, y, 0.0), (x, y, 4.0), (x, y, HORIZON)])
    planner.turn_to(0, {1: coming})
    drawn = {planner.times(2.0, rng) for _ in range(40)}
    assert len(drawn) > 20
    for departure, arrival in drawn:
        assert 0 <= departure <= 3.4 + 1e-9
        assert departure + 2 <= arrival <= HORIZON
    rows = np.array([(x, y, 1.0), (far_x, far_y, 9.0)])
    whole = planner.whole(rows)
    np.testing.assert_array_equal(whole, [(x, y, 0.0), *rows, (far_x, far_y, HORIZON)])
    np.testing.assert_array_equal(planner.whole(whole), whole)


def test_tracks_are_put_together_by_time():
    first = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 2.0), (2.0, 2.0, 4.0)])
    second = np.array([(5.0, 5.0, 0.0), (5.0, 5.0, 3.0), (5.0, 4.0, 4.0)])
    path = worker.joint_path([first, second])
    np.testing.assert_allclose(path[:, 0], [(0, 0, 0), (2, 0, 0), (2, 1, 0), (2, 2, 0)])
    np.testing.assert_allclose(path[:, 1], [(5, 5, 0), (5, 5, 0), (5, 5, 0), (5, 4, 0)])


def test_a_team_is_planned_for_one_by_one():
    problem = scenes.four_rooms(3)
    solution = ompl_prioritized(problem, seed=1, time_limit=60.0, cost_target=21.95)
    checked(problem, solution, 21.95)
    assert all(cost > 21.95 for _, cost in solution.stats.history[:-1])  # the first path as good ends it
    assert solution.samples.shape == (solution.stats.num_nodes, 3, 2) == (0, 3, 2)
