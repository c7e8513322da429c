import itertools

import numpy as np
import pytest
import scipy.optimize
from eikonal_helpers import ROOM, BoxSpace
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import vstack
from space_helpers import Slow

from plr_jax import PlaneSpace, Workspace, solve_eikonal
from plr_jax._progress import Progress
from plr_jax.eikonal import solve
from plr_jax.eikonal.mesh import coarse_mesh
from plr_jax.eikonal.program import SlopeProgram, rescaling_of
from plr_jax.eikonal.solve import SlopeSolver
from plr_jax.geometry.box import Box
from plr_jax.spaces import CellState

UNIT = Box((0, 0), (1, 1))
WALLS = ([(0.3, 0.0), (0.55, 0.6)], [(0.7, 0.4), (0.8, 1.0)])
THIN_WALL = Workspace(((0, 0), (1, 1)), [[(0.52, 0.0), (0.523, 0.0), (0.523, 0.8), (0.52, 0.8)]])
# Multiples of 1/8, so that ends of intervals meet often.
LEVEL = st.integers(-8, 40).map(lambda k: k / 8)
CELLS = st.lists(st.tuples(LEVEL, LEVEL, st.sampled_from([0.0, 0.5, 1.0, 1.25, 2.0, 4.0])), min_size=1, max_size=12)


def program_of(space, goal, num_cells=16, cost_map=None, rounds=1):
    """Return the program on a mesh whose mixed cells are halved, so that nodes hang."""
    mesh = coarse_mesh(space, num_cells, 4096)
    for _ in range(rounds):
        mesh = mesh.refined(np.flatnonzero(mesh.state == 2), space)
    return SlopeProgram.on(mesh, space, cost_map, np.array([goal], float))


def slopes(program, u):
    """Return the factors by which slopes at control points are too steep; at most 1 where they are not."""
    return program.sets.factors(program.gradients(u))


def mean(program, u):
    """Return the mean of a function over open cells."""
    return program.weight @ u / program.weight.sum()


def solved(program, rounds=6):
    """Return values after many iterations, 0 at the goal and scaled to allowed slopes; and the iterate."""
    iterate = program.solve(150, None, (20, 40, 80))
    for _ in range(rounds - 1):
        iterate = program.solve(150, iterate, (40,))
    iterate, has_converged = program.solve_thoroughly(iterate, 300)
    assert has_converged
    u = iterate.values - program.goal @ iterate.values
    return u / max(1.0, slopes(program, u).max()), iterate


@pytest.mark.parametrize(("weights", "seed"), [((1.0, 2.5), 1), ((0.3, 1.0), 2)])
def test_solution_is_that_of_a_linear_program(weights, seed):
    """If each axis has its own norm, constraints are linear, and HiGHS solves the program exactly."""
    space = BoxSpace(UNIT, *WALLS, blocks=(((0,), weights[0]), ((1,), weights[1])))
    program = program_of(space, np.random.default_rng(seed).uniform(0, 0.25, 2))
    exact = scipy.optimize.linprog(
        -program.weight,
        A_ub=vstack([program.gradient, -program.gradient]),
        b_ub=np.tile(program.sets.radius, 4),
        A_eq=program.goal[None],
        b_eq=[0.0],
        bounds=(None, None),
    )
    best = mean(program, exact.x)
    assert slopes(program, exact.x).max() <= 1 + 1e-6
    assert 0.995 * best <= mean(program, solved(program)[0]) <= best * (1 + 1e-6)


@pytest.mark.parametrize("periodic", [False, True])
def test_loss_at_the_goal_is_the_shortfall_behind_it(periodic):
    """On four cells of a line the function is linear through the goal."""
    space, goal = BoxSpace(Box([0], [1], [periodic])), np.array([0.3])
    program = program_of(space, goal, num_cells=4)
    u, iterate = solved(program)
    mesh, x = program.space.mesh, np.linspace(0, 1, 1001)[:, None]
    cell = mesh.locate(x)
    short = space.straight(x, goal) - program.space.interpolation(cell, mesh.local(cell, x)) @ u
    np.testing.assert_allclose(program.losses_at_goals(iterate).sum(), np.mean(short), rtol=0.3)


def test_slopes_obey_costs_of_their_cells():
    """Motions cost twice as much on the right half: the solution rises twice as fast there."""
    program = program_of(BoxSpace(Box([0], [1])), [0.0], num_cells=8, cost_map=Slow([0.5 - 1e-12], [9.0], 2.0))
    x = program.space.points[:, 0]
    np.testing.assert_allclose(solved(program)[0], np.where(x < 0.5, x, 2 * x - 0.5), atol=2e-3)


def test_steepest_block_of_axes_counts():
    space = BoxSpace(Box(np.zeros(3), np.ones(3)), blocks=(((0, 1), 2.0), ((2,), 0.5)))
    program = program_of(space, (0, 0, 0), num_cells=8)
    for slope, factor in (([0.6, 0.8, 0.0], 0.5), ([0.0, 0.0, 1.0], 2.0), ([0.6, 0.8, 1.0], 2.0)):
        np.testing.assert_allclose(slopes(program, program.space.points @ slope), factor)
    flow = np.tile([[3.0], [4.0], [5.0]], len(program.sets.radius))
    np.testing.assert_allclose(program.sets.costs(flow), 10.0)


def test_cells_cut_off_from_the_goal_have_no_values():
    program = program_of(BoxSpace(UNIT, [(0.4, 0.0), (0.6, 1.0)]), (0.1, 0.2), num_cells=256)
    assert program.space.points[:, 0].max() < 0.6 and program.weight.sum() < 0.5


def test_losses_are_largest_in_mixed_cells():
    program = program_of(BoxSpace(UNIT, [(0.5, 0.0), (0.6, 0.8)]), (0.2, 0.2), num_cells=64)
    loss, mesh = program.losses(solved(program, rounds=2)[1]), program.space.mesh
    assert loss.shape == mesh.open_cells.shape and (loss >= 0).all()
    assert loss[mesh.state[mesh.open_cells] == CellState.MIXED].sum() > 0.5 * loss.sum()


def test_more_iterations_never_worsen_the_bound():
    program = program_of(BoxSpace(UNIT, *WALLS), (0.1, 0.2), num_cells=64)
    start, bounds = program.solve(20, None), []
    for most in (1, 11, 21, 500):
        iterate, has_converged = program.solve_thoroughly(start, most)
        u = iterate.values - program.goal @ iterate.values
        bounds.append(mean(program, np.interp(u, *program.rescaling(u))))
        assert has_converged == (most == 500)
    assert (np.diff(bounds) >= 0).all() and bounds[-1] > bounds[0]


@given(CELLS)
def test_rescaling_slope_is_inverse_of_largest_factor(cells):
    """The integral is a sum over intervals of an eighth; no rescaled slope is too steep."""
    lowest, highest, factor = np.array(cells).T
    lowest, highest = np.minimum(lowest, highest), np.maximum(lowest, highest)
    (level, value), ends = rescaling_of(lowest, highest, factor), np.arange(-8, 41) / 8
    middle = ends[:-1, None] + 1 / 16
    steepest = np.where((lowest < middle) & (middle < highest), factor, 1.0).max(axis=1, initial=1.0)
    integral = np.append(0.0, np.cumsum(1 / 8 / steepest))
    u = np.linspace(min(lowest.min(), 0), max(highest.max(), 0), 41)
    np.testing.assert_allclose(np.interp(u, level, value), np.interp(u, ends, integral - integral[8]), atol=1e-12)
    assert np.interp(0.0, level, value) == 0
    assert (np.diff(level) > 0).all() and (np.diff(value) > 0).all()


def solver_of(workspace, max_cells):
    """Return a solver after all refinements."""
    solver = SlopeSolver(PlaneSpace(workspace), None, np.array([[0.9, 0.1]]), max_cells, 0.0)
    solver.refine(Progress("solve", "cells"))
    return solver


def test_mixed_cells_with_thin_walls_count_as_blocked():
    solver = solver_of(THIN_WALL, 200)
    likely, mixed = solver.mesh_without_mixed(), solver.mesh.state == CellState.MIXED
    np.testing.assert_array_equal(likely.state[~mixed], solver.mesh.state[~mixed])
    lo, hi = likely.boxes
    crossed = mixed & (hi[:, 1] < 0.5) & (lo[:, 0] > 0.3)
    assert crossed.any() and (likely.state[crossed] == CellState.BLOCKED).all()


def test_mixed_cells_with_small_obstacles_count_as_free():
    places = [np.array(place) for place in itertools.product(np.arange(7) / 8 + 0.03, repeat=2)]
    corners = np.array([(0, 0), (0.02, 0), (0.02, 0.02), (0, 0.02)])
    solver = solver_of(Workspace(((0, 0), (1, 1)), [place + corners for place in places]), 80)
    likely, mixed = solver.mesh_without_mixed(), solver.mesh.state == CellState.MIXED
    assert mixed.sum() > 20 and np.mean(likely.state[mixed] == CellState.FREE) > 0.4


def test_thin_walls_are_refined_first():
    mesh = solver_of(THIN_WALL, 400).mesh
    lo, hi = mesh.boxes
    at_wall = (lo[:, 0] < 0.523) & (hi[:, 0] > 0.52) & (lo[:, 1] < 0.7)
    assert mesh.widths[at_wall].mean() < 0.3 * mesh.widths[~at_wall].mean()


def test_solver_that_has_not_converged_warns(monkeypatch):
    monkeypatch.setattr(solve, "_MOST", 11)
    with pytest.warns(UserWarning, match="has not converged in 11 iterations: the bounds hold"):
        solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=20)
