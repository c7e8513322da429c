"""The benchmark's sections about approximators: query, gradient, accuracy; and the rivals they compare."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.benchmarks import _accuracy, _gradient, _query
from experiments.benchmarks._numba_loop import numba_loop
from experiments.benchmarks._rivals import (
    Rival,
    filled_grid,
    make_all,
    map_coordinates,
    scipy_grid,
    sixteen_bit_grid,
    train_network,
    travel_time_grid,
    triangles,
)
from plr_jax import VisibilityGraph, Workspace, construct, scenes

GOAL = np.array([0.4, 0.3])


def empty_square():
    workspace = Workspace(((0, 0), (1, 1)))
    return workspace, VisibilityGraph(workspace, GOAL)


def wall_square():
    """A wall that leaves a gap at the top."""
    workspace = Workspace(((0, 0), (1, 1)), [np.array([(0.45, 0), (0.55, 0), (0.55, 0.8), (0.45, 0.8)])])
    return workspace, VisibilityGraph(workspace, np.array([0.2, 0.3]))


@pytest.mark.parametrize(
    ("dim", "limit", "two_levels"),
    [(2, {"max_leaves": 300}, False), (2, {"tolerance": 0.02}, True), (5, {"max_leaves": 2_000}, True)],
)
def test_numba_loop_answers_what_the_plr_answers(dim, limit, two_levels):
    pytest.importorskip("numba")
    tip = np.linspace(-1.3, 2.1, dim)
    domain = (np.full(dim, -3.0), np.linspace(2, 5, dim))
    plr = construct(lambda x: np.linalg.norm(x - tip, axis=1) ** 0.5, domain, num_samples=32, **limit)
    assert (plr.tables.blocks is not None) == two_levels
    x = np.random.default_rng(0).uniform(-4, 5.5, (20_000, dim)).astype(np.float32)
    expected = np.asarray(plr(x))
    answered = np.isfinite(expected)
    assert answered.any() and np.isinf(expected).any()
    for parallel in (False, True):
        answers = numba_loop(plr, parallel)(x)
        assert np.array_equal(np.isinf(answers), np.isinf(expected))
        away = np.abs(answers[answered] - expected[answered])
        # A point on a cell's face, to within rounding, may be given to either side.
        assert np.mean(away > 1e-5) < 1e-3


def test_grids_fill_their_bytes_and_agree():
    workspace, exact = wall_square()
    grid = filled_grid(workspace, exact, 2_000)
    assert grid.num_bytes == 4 * grid.values.size <= 2_000 and np.isfinite(grid.values).all()
    short = sixteen_bit_grid(workspace, exact, 2_000)
    assert short.num_bytes == 2 * short.values.size <= 2_000 and short.values.size > 1.8 * grid.values.size
    x = workspace.sample_free(500, 1)
    assert np.allclose(scipy_grid(grid).on_host(x), map_coordinates(grid).on_host(x), atol=1e-5)
    full = filled_grid(workspace, exact, 4_000)
    assert np.abs(short.values - full.values).max() <= np.ptp(full.values) / 2**16


def test_nodes_in_obstacles_take_the_value_of_the_nearest_free_node():
    workspace, exact = wall_square()
    _, values, _ = filled_grid(workspace, exact, 4 * 21 * 21)
    inside = values[9:12, 4]  # x = 0.45, 0.5, 0.55 at y = 0.2: the wall's sides are free
    assert inside[0] == np.float32(np.hypot(0.25, 0.1)) and inside[1] in (inside[0], inside[2])


def test_triangles_answer_everywhere_within_their_bytes():
    workspace, exact = wall_square()
    x = workspace.sample_free(3_000, 0)
    rival = triangles(workspace, 1_200, x, exact(x))
    assert rival.num_bytes == 1_200 == 12 * len(rival.answer.points)
    x = workspace.sample_free(1_000, 1)
    assert np.isfinite(rival.on_host(x)).all()


def test_travel_times_are_near_the_distance_and_missing_beside_walls():
    pytest.importorskip("skfmm")
    workspace, exact = wall_square()
    field = scipy_grid(travel_time_grid(workspace, np.array([0.2, 0.3]), 40_000))
    x = workspace.sample_free(2_000, 0)
    answers = field.on_host(x)
    answered = np.isfinite(answers)
    assert 0 < np.sum(~answered) < 200
    assert np.abs(answers - exact(x))[answered].max() < 0.05


def test_network_keeps_its_bytes_and_learns():
    _, exact = empty_square()
    x = np.random.default_rng(0).random((2_000, 2))
    for dtype, num_bytes in ((jnp.float32, 2_000), (jnp.float16, 1_000)):
        network = train_network(x, exact(x), num_bytes, 100, 0, dtype)
        assert 0.85 * num_bytes < network.num_bytes <= num_bytes
        assert np.abs(network.on_host(x) - exact(x)).mean() < 0.05
    assert jax.grad(network.function)(jnp.asarray(GOAL + 0.2, jnp.float32)).shape == (2,)


def test_linear_trees_count_their_packed_bytes():
    pytest.importorskip("lightgbm")
    from experiments.benchmarks._rivals import linear_trees

    _, exact = empty_square()
    x = np.random.default_rng(0).random((2_000, 2))
    trees = linear_trees(x, exact(x), 20, 2, 0)
    assert trees.num_bytes == 13 + 17 * 40
    assert np.abs(trees.on_host(x) - exact(x)).mean() < 0.02


def test_central_differences_are_gradients():
    x = np.random.default_rng(0).random((100, 2))
    values, slopes = _gradient.central_differences(lambda x: x[:, 0] ** 2 + 3 * x[:, 1], x, 1e-3)
    assert np.allclose(values, x[:, 0] ** 2 + 3 * x[:, 1])
    assert np.allclose(slopes, np.stack([2 * x[:, 0], np.full(100, 3.0)], axis=1))


def test_summary_counts_what_is_not_answered():
    summary = _accuracy.summary(np.array([1.0, np.nan, 3.0, np.inf]))
    assert (summary["mean"], summary["max"], summary["points"], summary["unanswered"]) == (2, 3, 4, 2)
    assert _accuracy.summary(np.array([np.nan]))["mean"] is None


def test_what_is_not_installed_is_skipped_with_a_reason():
    def absent():
        import no_such_package_as_this  # noqa: F401  # type: ignore[reportMissingImports]

    made, skipped = make_all({"one": lambda: 1, "other": absent})
    assert made == {"one": 1}
    assert skipped == {"other": "no_such_package_as_this is not installed: pip install '.[baselines]'"}


def test_a_rival_answers_points_of_any_precision_as_float64():
    x = np.random.default_rng(0).random((5, 2))
    on_device = Rival(0, jax.jit(lambda x: x[:, 0]), True)
    assert on_device.on_host(x).dtype == np.float64
    assert np.allclose(on_device.on_host(x), x[:, 0])


def test_compilations_are_counted():
    with _query.compilations() as compiled:
        jax.jit(lambda x: x * 3 + 1)(np.ones(7)).block_until_ready()
    assert len(compiled) == 1
    plr, _ = _query.maze_plr(64, 0)
    x = scenes.maze().workspace.sample_free(3, 0)
    plr(x)
    with _query.compilations() as compiled:
        plr(x)
    assert not compiled
