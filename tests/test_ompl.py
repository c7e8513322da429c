"""PLRs as heuristics of OMPL's planners."""

import sys

import numpy as np
import pytest

from plr_jax import Box, Euclidean, VisibilityGraph, construct, ompl_objective, scenes

base = pytest.importorskip("ompl.base", reason="OMPL is not installed: pip install 'plr-jax[ompl]'")
geometric = pytest.importorskip("ompl.geometric")
util = pytest.importorskip("ompl.util")


@pytest.fixture(scope="module")
def maze():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=512, certified="leaves")
    return problem, oracle, plr


def bounded(space, lo=0.0, hi=1.0):
    bounds = base.RealVectorBounds(2)
    bounds.setLow(lo)
    bounds.setHigh(hi)
    space.setBounds(bounds)
    return space


@pytest.fixture
def setup(maze):
    problem, _, _ = maze
    space = bounded(base.RealVectorStateSpace(2))
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: bool(problem.workspace.is_free([[state[0], state[1]]])[0]))
    setup.getSpaceInformation().setStateValidityCheckingResolution(0.002)
    setup.setStartAndGoalStates(*(state_at(space, each[0]) for each in (problem.starts, problem.goals)))
    return setup


def state_at(space, point):
    state = space.allocState()
    for axis, coordinate in enumerate(point):
        state[axis] = float(coordinate)
    return state


def test_motion_cost_heuristic_is_a_lower_bound_above_straight_lines(maze, setup):
    problem, oracle, plr = maze
    space, objective = setup.getStateSpace(), ompl_objective(setup.getSpaceInformation(), plr)
    x, y = problem.workspace.sample_free(60, 0), problem.workspace.sample_free(60, 1)
    y[:20] = problem.goals[0]
    true = oracle.between(x, y)
    states = zip(*([state_at(space, each) for each in points] for points in (x, y)), strict=True)
    found = np.array([objective.motionCostHeuristic(*pair).value() for pair in states])
    straight = np.linalg.norm(x - y, axis=1)
    assert (found <= true + 1e-12).all() and (found >= straight - 1e-12).all()
    np.testing.assert_allclose(found[:20], true[:20], atol=4 * plr.max_error)  # the cost-to-go
    assert (found[20:] > 1.05 * straight[20:]).mean() > 0.3


def test_motion_costs_its_length(maze, setup):
    space, objective = setup.getStateSpace(), ompl_objective(setup.getSpaceInformation(), maze[2])
    a, b = state_at(space, (0.1, 0.1)), state_at(space, (0.4, 0.5))
    assert objective.motionCost(a, b).value() == pytest.approx(0.5)


def test_bit_star_finds_short_valid_path(maze, setup):
    util.RNG.setSeed(1)
    problem, oracle, plr = maze
    asked = []

    def place(state):
        asked.append((state[0], state[1]))
        return asked[-1]

    objective = ompl_objective(setup.getSpaceInformation(), plr, coordinates=place)
    shortest = oracle(problem.starts[:1])[0]
    objective.setCostThreshold(base.Cost(1.15 * shortest))
    setup.setOptimizationObjective(objective)
    setup.setPlanner(geometric.BITstar(setup.getSpaceInformation()))
    assert setup.solve(30.0)
    path = setup.getSolutionPath()
    vertices = np.array([[path.getState(i)[0], path.getState(i)[1]] for i in range(path.getStateCount())])
    np.testing.assert_allclose(vertices[[0, -1]], [problem.starts[0], problem.goals[0]])
    assert problem.workspace.is_free(np.linspace(vertices[:-1], vertices[1:], 50).reshape(-1, 2)).mean() > 0.99
    assert shortest - 1e-9 <= np.linalg.norm(np.diff(vertices, axis=0), axis=1).sum() <= 1.2 * shortest
    assert len(asked) > 100


def test_heuristic_outside_domain_is_straight_distance(maze):
    space = bounded(base.RealVectorStateSpace(2), -5.0, 5.0)
    objective = ompl_objective(base.SpaceInformation(space), maze[2])
    inside, outside = state_at(space, maze[0].starts[0]), state_at(space, (-3, 0.5))
    for pair in ((inside, outside), (outside, inside), (outside, outside)):
        assert objective.motionCostHeuristic(*pair).value() == space.distance(*pair)


def test_heuristic_ignores_headings(maze):
    space = bounded(base.SE2StateSpace())
    objective = ompl_objective(base.SpaceInformation(space), maze[2])
    states = [space.allocState(), space.allocState()]
    for state, q in zip(states, (maze[0].starts[0], maze[0].goals[0]), strict=True):
        state.setX(float(q[0]))
        state.setY(float(q[1]))
        state.setYaw(0.3)
    found, true = objective.motionCostHeuristic(*states).value(), maze[1](maze[0].starts[:1])[0]
    assert true - 4 * maze[2].max_error <= found <= true


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_arguments_raise(maze, setup):
    information = setup.getSpaceInformation()
    unproven = construct(Euclidean((0.2, 0.2)), Box((0, 0), (0.5, 0.5)), max_leaves=10)
    with pytest.raises(ValueError, match="Nothing is proven"):
        ompl_objective(information, unproven)
    with pytest.raises(ValueError, match="plr must be a PLR, got <function"):
        ompl_objective(information, lambda x: x)
    with pytest.raises(ValueError, match=r"RealVectorStateSpace of 1 dimensions .* PLR of 2: pass coordinates="):
        ompl_objective(base.SpaceInformation(base.RealVectorStateSpace(1)), maze[2])


def test_missing_ompl_error_says_what_to_install(maze, monkeypatch):
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(ImportError, match=r"pip install 'plr-jax\[ompl\]'"):
        ompl_objective(None, maze[2])
