import itertools

import numpy as np
import pytest

from experiments.baselines.ompl import Done, Found, Ready, ompl_prioritized, task_of
from plr_jax import (
    DiscRobot,
    PointRobot,
    PolygonRobot,
    Problem,
    RectangleRobot,
    Workspace,
    path_cost,
    scenes,
    validate,
)
from plr_jax.planners import Status

pytest.importorskip("ompl.base", reason="OMPL baselines: pip install 'plr-jax[baselines]'")
motions = pytest.importorskip("experiments.baselines.ompl_motions", reason="OMPL baselines need numba")
tracks = pytest.importorskip("experiments.baselines.ompl_tracks")
worker = pytest.importorskip("experiments.baselines.ompl_prioritized_worker")

BOX = [(2.0, 2.0), (3.0, 2.0), (3.0, 3.0), (2.0, 3.0)]
WORKSPACE = Workspace(((0, 0), (5, 5)), [BOX])
DISC, POINT = DiscRobot(0.3), PointRobot()
HORIZON = 10.0


def problem_of(*robots, workspace=WORKSPACE):
    """Robots along the bottom, to be moved to the top in reversed order."""
    along = np.linspace(0.5, 4.5, len(robots))
    starts, goals = (np.stack([along, np.full(len(robots), y)], axis=1) for y in (0.5, 4.5))
    return Problem(workspace, robots, starts, goals[::-1])


def kernel_of(problem, robot, others=()):
    """The compiled test of one robot's motions among the others' tracks, in order."""
    task = task_of(problem, "prioritized", 0, 1.0, None)
    scene = motions.Scene(task.sizes[[robot]], task.walls, task.tolerance)
    rest = [other for other in range(len(problem.robots)) if other != robot]
    reaches = [task.sizes[robot, 2] + task.sizes[other, 2] - task.tolerance for other in rest][: len(others)]
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


@pytest.mark.parametrize("radii", [(0.0, 0.8, 0.0), (0.3, 0.0, 0.2), (0.1, 0.6, 0.3)])
@pytest.mark.parametrize("longest", [0.0, 0.2, 4.0])
def test_motions_keep_away_from_tracks_as_many_samples_of_them_say(radii, longest):
    rng = np.random.default_rng(11)
    robots = [DiscRobot(radius) if radius else PointRobot() for radius in radii]
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
        got = kernel_of(problem, 0, others)(a, b)
        num_free += surely_free
        num_caught += surely_caught
        assert not (surely_free and not got)
        assert not (surely_caught and got)
    assert num_free > 200
    assert num_caught > 20


def test_points_may_meet_as_bodies_that_touch_may():
    problem = problem_of(POINT, POINT)
    crossing = np.array([(1.0, 1.0, 0.0), (1.0, 5.0, 8.0), (1.0, 5.0, 10.0)])
    assert kernel_of(problem, 0, [crossing])((0.5, 2, 1), (1.5, 2, 3))  # at (1, 2) at time 2, both


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
def test_a_motion_alone_by_hand(a, b, free):
    assert kernel_of(problem_of(DISC, DISC), 0)(a, b) == free


def test_a_disc_passes_others_by_hand():
    problem = problem_of(DISC, DiscRobot(0.2), DiscRobot(0.4))
    rests = np.array([(3.0, 1.1, 0.0), (3.0, 1.1, 10.0)])
    departs = np.array([(1.0, 4.5, 0.0), (1.0, 4.5, 4.0), (4.6, 4.5, 8.0), (4.6, 4.5, 10.0)])  # 0.9 fast
    is_free = kernel_of(problem, 0, [rests, departs])
    assert is_free((0.5, 0.6, 0), (4.5, 0.6, 5))  # 0.5 away, touching
    assert not is_free((0.5, 0.6 + 1e-6, 0), (4.5, 0.6 + 1e-6, 5))
    # In the place that the other has left, from when it is 0.7 away on.
    left = 4.0 + 0.7 / 0.9
    assert is_free((1.0, 4.5, left + 1e-9), (1.0, 4.5, 10))
    assert not is_free((1.0, 4.5, left - 1e-6), (1.0, 4.5, 10))
    # Behind it, at its speed and 0.7 away, and as it arrives.
    assert is_free((0.3, 4.5, 4), (3.9, 4.5, 8))
    assert not is_free((0.3, 4.5, 4), (3.9 + 1e-6, 4.5, 8))


def test_states_of_both_spaces_are_read_as_they_are_written():
    planner = planner_of(problem_of(DISC, DISC))
    for information in (planner._timed, planner._metric):
        row = np.array([1.25, -3.5, 7.75])
        np.testing.assert_array_equal(tracks.row_of(worker._state(information, row)), row)


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
    assert found is not None
    shorter = planner.shorten(found, 60.0)
    is_free = kernel_of(problem, 0, [straight])
    for track in (found, shorter):
        np.testing.assert_array_equal(track[[0, -1]], [(1, 0.5, 0), (4, 0.5, HORIZON)])
        assert all(is_free(a, b) for a, b in itertools.pairwise(track))
        assert validate(problem, worker.joint_path([track, straight])[..., :2]).valid
    assert 3 < worker._length(shorter) <= worker._length(found)


def test_no_path_is_planned_where_the_other_rests_in_the_way():
    problem = problem_of(DISC, DISC)
    planner = planner_of(problem)
    x, y = problem.goals[0]
    planner.turn_to(0, {1: np.array([(x, y, 0.0), (x, y, HORIZON)])})
    assert planner.plan(0.0, HORIZON, 0.05) is None


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


def test_a_team_is_planned_for_until_its_path_costs_no_more_than_the_target():
    problem = scenes.four_rooms(3)
    solution = ompl_prioritized(problem, seed=1, time_limit=60.0, cost_target=21.95)
    assert solution.status is Status.SOLVED
    report = validate(problem, solution.path)
    assert report.valid, report.message
    assert solution.cost == pytest.approx(report.cost, rel=1e-12)
    assert solution.lower_bound < solution.cost <= 21.95
    assert solution.path is not None
    np.testing.assert_array_equal(solution.path[0], problem.starts)
    np.testing.assert_array_equal(solution.path[-1], problem.goals)
    times, costs = zip(*solution.stats.history, strict=True)
    assert all(np.diff(times) >= 0)
    assert all(np.diff(costs) < 0)
    assert costs[-1] == solution.cost
    assert all(cost > 21.95 for cost in costs[:-1])  # the first path as good ends it
    assert solution.samples.shape == (solution.stats.num_nodes, 3, 2) == (0, 3, 2)
    assert solution.stats.num_children_scored > solution.stats.num_children_valid > 0
    assert set(solution.stats.seconds) == {"compile", "plan"}


def test_a_better_path_is_looked_for_until_the_time_is_over():
    problem = problem_of(DISC, POINT, DiscRobot(0.2))
    solution = ompl_prioritized(problem, seed=0, time_limit=1.0)
    assert solution.status is Status.TIME_LIMIT
    assert solution.solved and validate(problem, solution.path).valid
    assert len(solution.stats.history) > 1
    assert solution.stats.seconds["plan"] >= 1.0
    assert solution.cost == path_cost(problem, solution.path)


def test_robots_that_are_where_they_should_be_make_way():
    problem = Problem(
        Workspace(((0, 0), (6, 2)), [[(0, 1), (2.4, 1), (2.4, 2), (0, 2)], [(3.6, 1), (6, 1), (6, 2), (3.6, 2)]]),
        [DISC, DISC],
        [(0.5, 0.5), (3.0, 0.5)],
        [(5.5, 0.5), (3.0, 0.5)],
    )
    solution = ompl_prioritized(problem, seed=3, time_limit=60.0, cost_target=8.0)
    assert solution.status is Status.SOLVED
    assert validate(problem, solution.path).valid
    assert solution.cost > 5.0


def test_the_time_limit_ends_a_trial_that_finds_nothing():
    corridor = Workspace(((0, 0), (6, 1)))
    problem = Problem(corridor, [DISC, DISC], [(1, 0.5), (5, 0.5)], [(5, 0.5), (1, 0.5)])
    solution = ompl_prioritized(problem, seed=0, time_limit=0.3)
    assert solution.status is Status.TIME_LIMIT
    assert (solution.path, solution.cost, solution.stats.history) == (None, np.inf, ())
    assert solution.stats.seconds["plan"] >= 0.3
    assert solution.stats.num_children_scored > 0


def test_the_worker_says_when_it_is_ready_what_it_finds_and_when_it_is_done():
    problem = problem_of(DISC, POINT)
    messages = []
    messages.append(worker.run(task_of(problem, "prioritized", 0, 60.0, 12.0), messages.append))
    assert [type(message) for message in messages] == [Ready, *[Found] * (len(messages) - 2), Done]
    *_, found, done = messages
    assert done.finished and done.seconds >= found.seconds
    assert path_cost(problem, found.path[..., :2]) <= 12.0
    assert done.num_checked > done.num_free > 0


def test_seeds_tell_trials_apart_and_repeat_them():
    problem = Problem(WORKSPACE, [DISC], [(1, 1)], [(4, 4)])
    paths = []
    for seed in (5, 5, 6):
        solution = ompl_prioritized(problem, seed=seed, time_limit=60.0, cost_target=1000.0)
        assert solution.path is not None
        paths.append(solution.path)
    np.testing.assert_array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0], paths[2])


@pytest.mark.parametrize(
    "robot",
    [RectangleRobot(0.4, 0.2), PolygonRobot([(-0.2, -0.1), (0.2, -0.1), (0.0, 0.2)])],
)
def test_robots_that_are_not_round_are_refused(robot):
    problem = Problem(WORKSPACE, [DISC, robot], [(1, 1, 0), (4, 1, 0)], [(1, 4, 0), (4, 4, 0)])
    with pytest.raises(ValueError, match=f"takes points and discs; robot 1 is {type(robot).__name__}"):
        ompl_prioritized(problem, seed=0, time_limit=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed must be an integer from 0"),
        ({"seed": 2**32 - 1}, "seed must be an integer from 0"),
        ({"seed": 0.5}, "seed must be an integer from 0"),
        ({"time_limit": 0}, "time_limit must be a positive finite number, got 0"),
        ({"time_limit": float("inf")}, "time_limit must be a positive finite number, got inf"),
        ({"cost_target": 0.0}, "cost_target must be a positive finite number, got 0.0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ompl_prioritized(problem_of(DISC), **{"seed": 0, "time_limit": 1.0, **arguments})
