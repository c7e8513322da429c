import numpy as np
import pytest
import scipy.optimize
from eikonal_helpers import BoxSpace
from scipy.sparse import vstack

from plr_jax.eikonal.lower import loss_at_goal, losses, slope_program
from plr_jax.eikonal.mesh import coarse_mesh
from plr_jax.geometry.box import Box
from plr_jax.spaces import LipschitzCost

UNIT = Box((0, 0), (1, 1))
WALLS = ([(0.3, 0.0), (0.55, 0.6)], [(0.7, 0.4), (0.8, 1.0)])


def program_of(space, goal, num_cells=16, cost_map=None, rounds=1):
    """The program on a mesh whose mixed cells are halved, so that nodes hang."""
    mesh = coarse_mesh(space, np.ones(space.domain.dim), num_cells, 4096)
    for _ in range(rounds):
        mesh = mesh.refined(np.flatnonzero(mesh.state == 2), space)
    return slope_program(mesh, space, cost_map, np.array(goal, float))


def mean(program, u):
    """Over open cells."""
    return program.weight @ u / program.weight.sum()


def solved(program, rounds=6):
    """The values after many iterations, 0 at the goal, over the factor by which they are too steep."""
    iterate = program.solve(150, program.zero(), (20, 40, 80))
    for _ in range(rounds - 1):
        iterate = program.solve(150, iterate, (40,))
    iterate, has_converged = program.solve_tightly(iterate, 300)
    assert has_converged
    u = iterate.values - program.at_goal(iterate.values)
    return u / max(1.0, program.slopes(u).max()), iterate


@pytest.mark.parametrize(("weights", "seed"), [((1.0, 1.0), 0), ((1.0, 2.5), 1), ((0.3, 1.0), 2)])
def test_the_best_function_is_that_of_a_linear_program(weights, seed):
    """Where each axis costs for itself, so that constraints are linear, HiGHS solves the program exactly."""
    blocks = (((0,), weights[0]), ((1,), weights[1]))
    space = BoxSpace(UNIT, *WALLS, blocks=blocks)
    goal = np.random.default_rng(seed).uniform(0, 0.25, 2)
    program = program_of(space, goal)
    cost = np.tile(program.sets.radius, 2)
    exact = scipy.optimize.linprog(
        -program.weight,
        A_ub=vstack([program.gradient, -program.gradient]),
        b_ub=np.append(cost, cost),
        A_eq=program.goal[None],
        b_eq=[0.0],
        bounds=(None, None),
    )
    u, _ = solved(program)
    best = mean(program, exact.x)
    assert program.slopes(exact.x).max() <= 1 + 1e-6
    assert 0.995 * best <= mean(program, u) <= best * (1 + 1e-6)


def test_the_best_function_is_that_of_a_general_method():
    """Euclidean slopes, by sequential quadratic programming."""
    program = program_of(BoxSpace(UNIT, [(0.5, 0.0), (1.0, 0.5)]), (0.1, 0.2), num_cells=4, rounds=0)
    parts = program.gradient.toarray().reshape(2, -1, len(program.weight))
    bound = program.sets.radius**2
    exact = scipy.optimize.minimize(
        lambda u: -program.weight @ u,
        np.zeros(len(program.weight)),
        jac=lambda u: -program.weight,
        method="SLSQP",
        constraints=[
            {
                "type": "ineq",
                "fun": lambda u: bound - ((parts @ u) ** 2).sum(axis=0),
                "jac": lambda u: -2 * np.einsum("ac,acd->cd", parts @ u, parts),
            },
            {"type": "eq", "fun": lambda u: program.goal @ u, "jac": lambda u: program.goal},
        ],
        options={"maxiter": 500, "ftol": 1e-10},
    )
    u, _ = solved(program)
    assert exact.success
    np.testing.assert_allclose(mean(program, u), mean(program, exact.x), rtol=3e-3)


def test_in_an_empty_square_it_is_just_below_the_distance():
    goal = np.array([0.3, 0.45])
    program = program_of(BoxSpace(UNIT), goal, num_cells=256)
    u, _ = solved(program, rounds=2)
    assert abs(program.at_goal(u)) < 1e-12
    rng, mesh = np.random.default_rng(0), program.space.mesh
    x = rng.random((3000, 2))
    cell = mesh.locate(x)
    value = program.space.interpolation(cell, mesh.local(cell, x)) @ u
    distance = np.linalg.norm(x - goal, axis=1)
    assert (value <= distance + 1e-9).all()
    assert np.mean(distance - value) < 0.07 * distance.mean()


def test_a_step_costs_what_the_cell_says():
    space, goal = BoxSpace(UNIT, *WALLS), (0.1, 0.2)
    plain = program_of(space, goal)
    tripled = program_of(space, goal, cost_map=LipschitzCost(lambda q: np.full(len(q), 3.0), 0.0, 3.0))
    np.testing.assert_allclose(tripled.sets.radius, 3 * plain.sets.radius)
    u, _ = solved(plain, rounds=1)
    np.testing.assert_allclose(tripled.slopes(3 * u), plain.slopes(u))
    np.testing.assert_allclose(mean(tripled, solved(tripled)[0]), 3 * mean(plain, solved(plain)[0]), rtol=2e-3)


def test_costs_of_cells_bound_slopes_there_alone():
    """Twice as dear on the right half: the best function rises twice as fast there."""

    class Halves:
        def __call__(self, q):
            return np.where(q[:, 0] < 0.5, 1.0, 2.0)

        def bounds(self, lo, hi):
            return np.where(lo[:, 0] < 0.5, 1.0, 2.0), np.where(hi[:, 0] > 0.5, 2.0, 1.0)

    space = BoxSpace(Box([0], [1]))
    program = program_of(space, [0.0], num_cells=8, cost_map=Halves())
    u, _ = solved(program)
    x = program.space.points[:, 0]
    np.testing.assert_allclose(u, np.where(x < 0.5, x, 2 * x - 0.5), atol=2e-3)


def test_the_largest_of_the_blocks_slopes_counts():
    space = BoxSpace(Box(np.zeros(3), np.ones(3)), blocks=(((0, 1), 2.0), ((2,), 0.5)))
    program = program_of(space, (0, 0, 0), num_cells=8)
    x = program.space.points
    np.testing.assert_allclose(program.slopes(x @ [0.6, 0.8, 0.0]), 0.5)
    np.testing.assert_allclose(program.slopes(x @ [0.0, 0.0, 1.0]), 2.0)
    np.testing.assert_allclose(program.slopes(x @ [0.6, 0.8, 1.0]), 2.0)
    flow = np.tile([[3.0], [4.0], [5.0]], len(program.sets.radius))
    np.testing.assert_allclose(program.sets.costs(flow), 10.0)


def test_only_what_the_goal_is_connected_to_has_values():
    cut = BoxSpace(UNIT, [(0.4, 0.0), (0.6, 1.0)])
    program = program_of(cut, (0.1, 0.2), num_cells=256)
    assert program.space.points[:, 0].max() < 0.6
    assert program.weight.sum() < 0.5


def test_losses_are_where_the_function_falls_short():
    space = BoxSpace(UNIT, [(0.5, 0.0), (0.6, 0.8)])
    program = program_of(space, (0.2, 0.2), num_cells=64)
    _, iterate = solved(program, rounds=2)
    loss = losses(program, iterate)
    mesh = program.space.mesh
    assert loss.shape == mesh.open_cells.shape and (loss >= 0).all()
    is_mixed = mesh.state[mesh.open_cells] == 2
    assert loss[is_mixed].sum() > 0.5 * loss.sum()


def test_more_iterations_never_end_with_a_worse_bound():
    program = program_of(BoxSpace(UNIT, *WALLS), (0.1, 0.2), num_cells=64)
    start, bounds = program.solve(20, program.zero()), []
    for most in (1, 11, 21, 500):
        iterate, has_converged = program.solve_tightly(start, most)
        u = iterate.values - program.at_goal(iterate.values)
        bounds.append(mean(program, program.rescaling(u)(u)))
        assert has_converged == (most == 500)
    assert (np.diff(bounds) >= 0).all() and bounds[-1] > bounds[0]


@pytest.mark.parametrize("periodic", [False, True])
def test_the_loss_at_the_goal_is_what_is_too_low_behind_it(periodic):
    """On four cells of a line the function is linear through the goal, and every flow gains what it costs."""
    space, goal = BoxSpace(Box([0], [1], [periodic])), np.array([0.3])
    program = program_of(space, goal, num_cells=4)
    u, iterate = solved(program)
    x = np.linspace(0, 1, 1001)[:, None]
    distance = space.motion_cost.lengths(x, np.tile(goal, (len(x), 1)), space.domain)
    cell = program.space.mesh.locate(x)
    behind = np.mean(distance - program.space.interpolation(cell, program.space.mesh.local(cell, x)) @ u)
    np.testing.assert_allclose(loss_at_goal(program, iterate, goal), behind, rtol=0.3)
