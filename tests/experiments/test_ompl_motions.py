import math

import numpy as np
import pytest
from robot_helpers import random_motions

from experiments.baselines.ompl import task_of
from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax.collision.team import motions_apart
from plr_jax.collision.walls import MotionTest
from plr_jax.robots.robot import shorter_turn

base = pytest.importorskip("ompl.base", reason="OMPL baselines: pip install 'plr-jax[baselines]'")
kernels = pytest.importorskip("experiments.baselines.ompl_motions", reason="OMPL baselines need numba")
worker = pytest.importorskip("experiments.baselines.ompl_worker")

BOX = [(2.0, 2.0), (3.0, 2.0), (3.0, 3.0), (2.0, 3.0)]
WEDGE = [(0.5, 3.0), (1.2, 4.0), (0.2, 4.2)]
WORKSPACE = Workspace(((0, 0), (5, 5)), [BOX, WEDGE])
TEAMS = {
    "points": [PointRobot(), PointRobot()],
    "discs": [DiscRobot(0.3), DiscRobot(0.15), PointRobot()],
    "rectangles": [RectangleRobot(0.9, 0.3), RectangleRobot(0.5, 0.4)],
    "mixed": [DiscRobot(0.3), RectangleRobot(0.9, 0.3), PointRobot()],
}


def problem_of(robots):
    dof = 3 if any(isinstance(robot, RectangleRobot) for robot in robots) else 2
    starts, goals = np.zeros((2, len(robots), dof))
    starts[:, 0] = goals[:, 0] = 0.8 + 1.5 * np.arange(len(robots))
    starts[:, 1], goals[:, 1] = 0.6, 4.5
    return Problem(WORKSPACE, robots, starts, goals)


def scene_of(problem):
    task = task_of(problem, "RRTConnect", 0, 1.0, None)
    return kernels.Scene(task.sizes, task.walls, task.tolerance)


def free_alone_and_together(problem, q0, q1):
    """What the package's own motion tests say of joint motions (n, robots, 3)."""
    robots, workspace = problem.robots, problem.workspace
    free = np.ones(len(q0), dtype=bool)
    for i, robot in enumerate(robots):
        free &= workspace.is_free(q0[:, i, :2]) & MotionTest(workspace, robot)(q0[:, i], q1[:, i])
        for j in range(i):
            both = (robots[j], q0[:, j], q1[:, j])
            free &= motions_apart(robot, q0[:, i], q1[:, i], *both, workspace.tolerance)
    return free


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("step", [0.0, 0.3, 1.2])
def test_motions_are_free_as_the_vectorized_tests_say(team, step):
    problem = problem_of(TEAMS[team])
    rng, n = np.random.default_rng(7), 4000
    motions = [random_motions(rng, n, 5.0, step, min(step, 2.5)) for _ in problem.robots]
    q0, q1 = (np.stack([motion[end] for motion in motions], axis=1) for end in (0, 1))
    scene = scene_of(problem)
    got = np.array([kernels.is_motion_free(a, b, scene.address) for a, b in zip(q0, q1, strict=True)])
    expected = free_alone_and_together(problem, q0, q1)
    assert 20 < expected.sum() < n - 20
    assert not (got & ~expected).any()
    # Near contact with a turning rectangle, the kernel may refuse.
    assert (expected & ~got).sum() <= (2 if team in ("rectangles", "mixed") else 0)


@pytest.mark.parametrize(
    ("q0", "q1", "free"),
    [
        ((1.0, 2.5), (1.7, 2.5), True),  # up to the box, touching
        ((1.0, 2.5), (1.7 + 1e-6, 2.5), False),
        ((1.0, 1.0), (4.0, 4.0), False),  # through the box
        ((2.5, 2.5), (2.5, 2.5), False),  # inside, nothing of it near an edge
        ((0.3, 0.3), (4.7, 0.3), True),  # along the bounds
        ((-1.0, 0.5), (-1.0, 0.5), False),  # outside the bounds
    ],
)
def test_a_disc_by_hand(q0, q1, free):
    scene = scene_of(problem_of([DiscRobot(0.3)]))
    a, b = (np.array([[*q, 0.0]]) for q in (q0, q1))
    assert kernels.is_motion_free(a, b, scene.address) == free


def test_a_point_inside_a_large_obstacle_is_caught_and_one_on_its_wall_is_free():
    scene = scene_of(problem_of([PointRobot()]))
    for x, y, free in ((2.5, 2.5, False), (2.0, 2.5, True), (3.0, 3.0, True), (0.0, 0.0, True), (5.1, 1.0, False)):
        q = np.array([[x, y, 0.0]])
        assert kernels.is_motion_free(q, q, scene.address) == free, (x, y)


def test_a_rectangle_turns_the_shorter_way():
    scene = scene_of(problem_of([RectangleRobot(1.0, 0.2)]))
    # Beside the box, clear of it while the heading goes through pi, not while it goes through 0.
    low, high = (np.array([[1.62, 1.1, heading]]) for heading in (math.pi - 0.2, -math.pi + 0.2))
    assert kernels.is_motion_free(low, high, scene.address)
    upright, flat = (np.array([[1.62, 2.5, heading]]) for heading in (math.pi / 2, 0.0))
    assert kernels.is_motion_free(upright, upright, scene.address)
    assert not kernels.is_motion_free(upright, flat, scene.address)


def test_turns_are_those_of_the_package_to_the_bit():
    rng = np.random.default_rng(5)
    first = rng.uniform(-10, 10, 400)
    last = np.concatenate([rng.uniform(-10, 10, 200), first[200:] + rng.choice([-1, 1], 200) * math.pi])
    turns = [kernels._turn(*pair) for pair in zip(first, last, strict=True)]
    np.testing.assert_array_equal(turns, shorter_turn(first, last))
    np.testing.assert_allclose(turns[200:], math.pi)


@pytest.mark.parametrize("problem", [scenes.four_rooms(3), scenes.tangle(), problem_of(TEAMS["mixed"])])
def test_states_are_read_as_they_are_written_and_their_distance_is_our_cost(problem):
    from plr_jax import path_cost

    task = task_of(problem, "RRTConnect", 0, 1.0, None)
    space, scene = worker._space(task), scene_of(problem)
    rng = np.random.default_rng(3)
    path = np.zeros((2, len(problem.robots), 3))
    path[..., :2] = rng.uniform(problem.workspace.bounds.lo, problem.workspace.bounds.hi, path[..., :2].shape)
    path[:, task.sizes[:, 0] > 0, 2] = rng.uniform(-3.1, 3.1, (2, int((task.sizes[:, 0] > 0).sum())))
    first, last = (worker._state(space, task, q) for q in path)
    np.testing.assert_array_equal(kernels.configurations_of(first, scene), path[0])
    np.testing.assert_array_equal(kernels.configurations_of(last, scene), path[1])
    assert space.distance(first, last) == pytest.approx(path_cost(problem, path[..., : problem.dof]), rel=1e-12)
    kernels.is_free(id(first), id(last), scene.address)
    assert scene.num_checked == 1
    assert kernels.is_free(id(first), id(last), scene.address) == kernels.is_motion_free(*path, scene.address)
