import itertools
import pickle
import subprocess
import sys
import time

import numpy as np
import pytest

from experiments.baselines import ompl as ompl_module
from experiments.baselines.ompl import Done, Found, Ready, ompl_plan
from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, path_cost, scenes, validate
from plr_jax.planners import Status

PLANNERS = ("RRTstar", "RRTConnect", "AORRTC", "BITstar")
SHORTEST = 12.79  # single_door: around the wall's corners at 0.4


@pytest.fixture(scope="module")
def ompl():
    pytest.importorskip("ompl", reason="OMPL baselines: pip install 'plr-jax[baselines]'")
    pytest.importorskip("numba", reason="OMPL baselines need numba")


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_door_is_passed_by_each_planner(ompl, planner):
    problem = scenes.single_door()
    solution = ompl_plan(problem, planner, seed=1, time_limit=20.0, cost_target=13.5)
    assert solution.status is Status.SOLVED
    report = validate(problem, solution.path)
    assert report.valid, report.message
    assert solution.cost == pytest.approx(report.cost, rel=1e-12) and solution.cost <= 13.5
    assert solution.cost > SHORTEST
    times, costs = zip(*solution.stats.history, strict=True)
    assert all(np.diff(times) >= 0)
    assert all(np.diff(costs) < 0)
    assert costs[-1] == solution.cost
    assert solution.stats.first_solution == times[0]
    assert solution.lower_bound < solution.cost
    assert solution.samples.shape == (solution.stats.num_nodes, 1, 2)
    assert solution.stats.num_children_scored > solution.stats.num_children_valid > 0
    assert set(solution.stats.seconds) == {"compile", "plan"}
    if planner != "AORRTC":  # it clears its graph
        assert problem.workspace.is_free(solution.samples[:, 0]).all()
        assert solution.stats.num_nodes > 2


def test_a_team_of_discs_is_planned_for(ompl):
    problem = scenes.four_rooms(2)
    solution = ompl_plan(problem, "RRTConnect", seed=0, time_limit=30.0, cost_target=60.0)
    assert solution.status is Status.SOLVED
    assert validate(problem, solution.path).valid


def test_a_rectangle_and_a_disc_change_sides(ompl):
    workspace = Workspace(((0, 0), (6, 4)), [[(2.8, 0), (3.2, 0), (3.2, 2.4), (2.8, 2.4)]])
    robots = [RectangleRobot(1.6, 0.4), DiscRobot(0.3)]
    # Headings beyond half a turn, as users have them; the disc's is arbitrary.
    starts, goals = [(1.2, 1.0, 3.5), (5.0, 1.0, 0.0)], [(4.8, 1.0, 7.0), (1.0, 1.0, 9.0)]
    problem = Problem(workspace, robots, starts, goals)
    solution = ompl_plan(problem, "RRTConnect", seed=2, time_limit=30.0, cost_target=40.0)
    assert solution.status is Status.SOLVED
    assert validate(problem, solution.path).valid
    assert solution.path is not None
    np.testing.assert_array_equal(solution.path[[0, -1]], [starts, goals])
    assert solution.cost == pytest.approx(path_cost(problem, solution.path))


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_straight_way_is_found(ompl, planner):
    problem = Problem(Workspace(((0, 0), (4, 4))), [PointRobot()], [(0.0, 0.0)], [(4.0, 3.0)])
    solution = ompl_plan(problem, planner, seed=4, time_limit=1.0, cost_target=5.5)
    assert validate(problem, solution.path).valid
    assert 5.0 <= solution.cost <= 5.5
    assert solution.status is Status.SOLVED


def test_the_time_limit_ends_a_trial_that_finds_nothing(ompl):
    begin = time.monotonic()
    solution = ompl_plan(scenes.tangle(), "RRTstar", seed=0, time_limit=0.05)
    assert solution.status is Status.TIME_LIMIT
    assert (solution.path, solution.cost, solution.stats.history) == (None, np.inf, ())
    assert solution.stats.first_solution == np.inf
    assert time.monotonic() - begin < 60


def test_seeds_tell_trials_apart_and_repeat_them(ompl):
    paths = []
    for seed in (5, 5, 6):
        solution = ompl_plan(scenes.single_door(), "RRTConnect", seed=seed, time_limit=10.0, cost_target=1000.0)
        assert solution.path is not None
        paths.append(solution.path)
    np.testing.assert_array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0], paths[2])


def test_ctrl_c_returns_the_best_so_far(ompl, monkeypatch):
    problem = scenes.single_door()
    workers = []
    popen = subprocess.Popen

    def remember(*args, **kwargs):
        workers.append(popen(*args, **kwargs))
        return workers[-1]

    load, calls = pickle.load, itertools.count()

    def load_until_interrupted(file):
        if next(calls) == 2:  # after Ready and the first path
            raise KeyboardInterrupt
        return load(file)

    monkeypatch.setattr(subprocess, "Popen", remember)
    monkeypatch.setattr(ompl_module.pickle, "load", load_until_interrupted)
    solution = ompl_plan(problem, "RRTConnect", seed=1, time_limit=300.0)
    assert solution.status is Status.INTERRUPTED
    assert validate(problem, solution.path).valid
    assert len(solution.stats.history) == 1
    assert workers[0].poll() is not None  # ended


def messages_of(problem, *middles):
    """A worker's messages with straight paths over a middle configuration."""
    found = []
    for seconds, middle in enumerate(middles):
        path = np.zeros((3, 1, 3))
        path[:, 0, :2] = problem.starts[0], middle, problem.goals[0]
        found.append(Found(float(seconds), path))
    return [Ready(0.5), *found, Done(True, 9.0, np.zeros((4, 1, 3)), 10, 6)]


def test_paths_that_are_not_valid_are_dropped():
    problem = Problem(
        Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 6), (4, 6)]]), [PointRobot()], [(1, 1)], [(9, 1)]
    )
    through, over, far_over = (5.0, 1.0), (5.0, 9.1), (5.0, 9.9)
    with pytest.warns(UserWarning, match="RRTstar is not valid and was dropped: Robot 0 collides with obstacle 0"):
        solution = ompl_module._solution(problem, "RRTstar", messages_of(problem, far_over, over, through), False)
    assert [seconds for seconds, _ in solution.stats.history] == [0.0, 1.0]
    assert solution.path is not None
    assert solution.path[1, 0].tolist() == list(over)
    with pytest.warns(UserWarning):
        solution = ompl_module._solution(problem, "RRTstar", messages_of(problem, through), False)
    assert not solution.solved
    assert solution.status is Status.TIME_LIMIT


@pytest.mark.parametrize("missing", ["ompl", "numba"])
def test_what_to_install_is_said(monkeypatch, missing):
    find = ompl_module.importlib.util.find_spec
    monkeypatch.setattr(ompl_module.importlib.util, "find_spec", lambda name: None if name == missing else find(name))
    with pytest.raises(ImportError, match=r"pip install 'plr-jax\[baselines\]'"):
        ompl_plan(scenes.single_door(), seed=0, time_limit=1.0)


def test_a_worker_that_dies_is_reported(ompl, monkeypatch):
    popen = subprocess.Popen
    monkeypatch.setattr(
        subprocess,
        "Popen",
        lambda command, **kwargs: popen([sys.executable, "-c", "raise OSError('gone')"], **kwargs),
    )
    with pytest.raises(RuntimeError, match=r"(?s)exit code 1.*OSError: gone"):
        ompl_plan(scenes.single_door(), seed=0, time_limit=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"planner": "PRM"}, "planner must be one of RRTstar, RRTConnect, AORRTC, BITstar, got 'PRM'"),
        ({"seed": -1}, "seed must be an integer from 0"),
        ({"time_limit": 0}, "time_limit must be a positive finite number, got 0"),
        ({"time_limit": float("nan")}, "time_limit must be a positive finite number, got nan"),
        ({"cost_target": -3.0}, "cost_target must be a positive finite number"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ompl_plan(scenes.single_door(), **{"seed": 0, "time_limit": 1.0, **arguments})
