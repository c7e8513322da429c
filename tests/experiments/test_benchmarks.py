"""What the benchmark's sections count and sum up, and the rivals that are of our own making."""

import numpy as np
import pytest
import shapely

from experiments.benchmarks import _oracle
from experiments.benchmarks._numba_loop import numba_loop
from experiments.benchmarks._rivals import (
    filled_grid,
    map_coordinates,
    scipy_grid,
    sixteen_bit_grid,
)
from plr_jax import BuildOptions, VisibilityGraph, Workspace, construct, scenes

pytestmark = pytest.mark.full

WALL = Workspace(((0, 0), (1, 1)), [[(0.45, 0), (0.55, 0), (0.55, 0.8), (0.45, 0.8)]])
EXACT = VisibilityGraph(WALL, (0.2, 0.3))


@pytest.mark.parametrize(("dim", "limit", "two_levels"), [(2, 300, False), (5, 2_000, True)])
def test_numba_loop_answers_what_the_plr_answers(dim, limit, two_levels):
    pytest.importorskip("numba")
    tip = np.linspace(-1.3, 2.1, dim)
    domain = (np.full(dim, -3.0), np.linspace(2, 5, dim))
    plr = construct(
        lambda x: np.linalg.norm(x - tip, axis=1) ** 0.5,
        domain,
        max_leaves=limit,
        options=BuildOptions(num_samples=32),
    )
    assert (plr.tables.blocks is not None) == two_levels
    x = np.random.default_rng(0).uniform(-4, 5.5, (20_000, dim)).astype(np.float32)
    expected = np.asarray(plr(x))
    answered = np.isfinite(expected)
    assert answered.any() and np.isinf(expected).any()
    answers = numba_loop(plr, False)(x)
    assert np.array_equal(np.isinf(answers), np.isinf(expected))
    # A point on a cell's face, to within rounding, may be given to either side.
    assert np.mean(np.abs(answers[answered] - expected[answered]) > 1e-5) < 1e-3


def test_grids_fill_their_bytes_agree_and_are_filled_in_obstacles_by_the_nearest_free_node():
    grid, short = filled_grid(WALL, EXACT, 2_000), sixteen_bit_grid(WALL, EXACT, 2_000)
    assert grid.num_bytes == 4 * grid.values.size <= 2_000 and np.isfinite(grid.values).all()
    assert short.num_bytes == 2 * short.values.size <= 2_000 and short.values.size > 1.8 * grid.values.size
    x = WALL.sample_free(500, 1)
    assert np.allclose(scipy_grid(grid).on_host(x), map_coordinates(grid).on_host(x), atol=1e-5)
    full = filled_grid(WALL, EXACT, 4_000)
    assert np.abs(short.values - full.values).max() <= np.ptp(full.values) / 2**16
    _, values, _ = filled_grid(WALL, EXACT, 4 * 21 * 21)
    inside = values[9:12, 4]  # x = 0.45, 0.5, 0.55 at y = 0.2: the wall's sides are free
    assert inside[0] == np.float32(np.hypot(0.25, 0.1)) and inside[1] in (inside[0], inside[2])


def test_rivals_get_the_same_free_space_and_obstacles_that_overlap_where_ours_touch():
    for workspace in (scenes.maze().workspace, _oracle.polygon_field(40, 0)[0]):
        obstacles = _oracle._obstacles(workspace.free_space, 1.0)
        assert all(not obstacle.interiors for obstacle in obstacles)
        within = shapely.difference(shapely.box(*workspace.free_space.bounds), shapely.union_all(obstacles))
        assert shapely.symmetric_difference(within, workspace.free_space).area < 1e-6
    squares = [[(1, 1), (2, 1), (2, 2), (1, 2)], [(2, 2), (3, 2), (3, 3), (2, 3)]]
    touching, apart = (
        _oracle._polygons(Workspace(((0, 0), (4, 4)), squares[:n]), np.array([0.5, 0.5]))["holes"] for n in (2, 1)
    )
    assert len(touching) == 1
    assert sorted(map(tuple, apart[0])) == sorted(map(tuple, np.array(squares[0], float).tolist()))
