"""Cones from samples alone: how well, at what size, and that every option keeps its meaning."""

import numpy as np
import pytest
from plr_helpers import UNIT, points, random_partition, walled

from plr_jax import Box, Euclidean, Roadmap, VisibilityGraph, scenes
from plr_jax.plr import construct, cyclic_axis, from_bytes, maximum_depth
from plr_jax.plr.leaves.cone.sampled import choose_sources, sample_weights
from plr_jax.plr.leaves.cone.sources import Cones
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def oracle_of(scene):
    problem = scene()
    return VisibilityGraph(problem.workspace, problem.goals[0])


def cones_of(distance_fn, domain=UNIT, **options):
    return construct(distance_fn, domain, leaf="cone", **options)


def error_of(plr, distance_fn, x):
    distance = distance_fn(x)
    reached = np.isfinite(distance)
    return np.abs(np.asarray(plr(x), float)[reached] - distance[reached])


@pytest.mark.parametrize(
    ("scene", "kind"), [(scenes.maze, None), (scenes.maze, "normal"), (scenes.thin_maze, "uniform")]
)
def test_mazes_from_an_oracle_that_offers_nothing(scene, kind):
    oracle, rng = oracle_of(scene), np.random.default_rng(0)
    draw = {None: np.zeros, "normal": lambda n: rng.normal(size=n), "uniform": lambda n: rng.uniform(-1, 1, n)}[kind]
    plr = cones_of(lambda x: oracle(x) + 1e-6 * draw(len(x)), oracle.workspace.bounds, max_bytes=1024)
    assert plr.num_bytes <= 1024
    assert error_of(plr, oracle, oracle.workspace.sample_free(20_000, seed=3)).mean() < 5e-7


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_a_distance_without_obstacles_is_one_leaf_and_exact(dim):
    oracle = Euclidean(np.linspace(0.2, 0.8, dim))
    plr = cones_of(oracle.__call__, Box(np.zeros(dim), np.ones(dim)), max_bytes=1024)
    assert plr.num_leaves == 1 and error_of(plr, oracle, points(1000, 0, dim)).max() < 5e-7


def test_leaves_of_a_roadmap_choose_among_its_vertices():
    def is_free(x):
        return ~((np.abs(x[:, 0] - 0.5) < 0.1) & (x[:, 1] < 0.7))

    domain = Box(np.zeros(3), np.ones(3))
    oracle = Roadmap(domain, is_free, np.full(3, 0.1), 100, resolution=0.02)
    plr = cones_of(oracle, domain, max_bytes=1500)
    stored, vertices = plr.stored.sources, oracle.graph.vertices
    gap = np.linalg.norm(stored.points[:, None] - vertices, axis=2)
    assert gap.min(axis=1).max() < 1e-6
    assert np.abs(stored.offsets - oracle.distances[gap.argmin(axis=1)]).max() < 1e-5
    x = points(5000, 1, 3)
    assert plr.num_bytes <= 1500 and error_of(plr, oracle, x[is_free(x)]).mean() < 1.2e-2


def smooth(x):
    return 2 + np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1])


@pytest.mark.parametrize("function", [smooth, lambda x: np.full(len(x), 2.0)])
def test_what_is_no_distance_is_approached_by_leaves_with_sources_of_their_own(function):
    plrs = (cones_of(function, max_leaves=leaves) for leaves in (1, 20, 200))
    errors = [error_of(plr, function, points(5000, 2)).mean() for plr in plrs]
    assert errors[0] > 1.5 * errors[1] > 3 * errors[2] and errors[2] < 0.02


def test_nothing_is_said_where_nothing_is_reached_and_all_else_is_exact_but_at_bends():
    plr, x = cones_of(walled, max_leaves=300), points(20_000, 3)
    error = error_of(plr, walled, x)
    assert np.median(error) < 2e-7 and error.mean() < 2e-5
    assert np.isfinite(np.asarray(plr(x))).all() and not plr.unreachable.any()


def test_the_same_seed_gives_the_same_bytes_and_files_give_them_back():
    plr, again, other = (cones_of(walled, max_bytes=400, seed=seed) for seed in (5, 5, 6))
    assert plr.to_bytes() == again.to_bytes() != other.to_bytes() and plr.num_bytes == len(plr.to_bytes()) <= 400
    loaded, x = from_bytes(plr.to_bytes()), points(1000, 5).astype(np.float32)
    assert loaded.to_bytes() == plr.to_bytes() and np.array_equal(np.asarray(loaded(x)), np.asarray(plr(x)))


def test_limits_are_kept_and_weights_say_where_leaves_go(samples):
    assert cones_of(walled, max_leaves=7).num_leaves == 7 and cones_of(walled, max_depth=3).depth == 3
    loose, tight = (cones_of(walled, tolerance=t, max_leaves=500) for t in (0.05, 0.01))
    assert loose.num_leaves < tight.num_leaves and error_of(tight, walled, samples[0]).max() < 0.02
    heavy, even = (
        cones_of(walled, max_leaves=40, weight_fn=weight_fn) for weight_fn in (lambda x: 1.0 * (x[:, 1] > 0.7), None)
    )
    above = samples[0][samples[0][:, 1] > 0.7]
    assert error_of(heavy, walled, above).mean() < 0.7 * error_of(even, walled, above).mean()


@pytest.mark.parametrize(
    "options",
    [
        {"weight_fn": lambda x: 1 + x[:, 0]},
        {"should_split": maximum_depth},
        {"split": cyclic_axis},
        {"should_split": lambda fit: np.abs(fit.residual).mean(axis=1)},
    ],
)
def test_rules_of_the_caller_are_of_samples_though_the_oracle_answers_for_cells(options):
    oracle = oracle_of(scenes.maze)
    plr, twin = (cones_of(fn, oracle.workspace.bounds, max_leaves=64, **options) for fn in (oracle, oracle.__call__))
    assert plr.num_leaves == twin.num_leaves == 64
    assert options.get("should_split") is not maximum_depth or plr.depth == 6
    x = oracle.workspace.sample_free(5000, seed=9)
    assert abs(error_of(plr, oracle, x).mean() - error_of(twin, oracle, x).mean()) < 1e-2


def test_residuals_that_rules_see_are_of_cones():
    seen = []

    def rule(fit):
        seen.append(np.abs(fit.residual).max())
        return np.zeros(len(fit))

    cones_of(lambda x: np.linalg.norm(x - 0.3, axis=1), should_split=rule)
    assert max(seen) == 0.0


@pytest.mark.parametrize("options", [{"margin": 0.5}, {"num_samples": 5}, {"num_samples": 500}])
def test_other_samples(options):
    assert error_of(cones_of(walled, max_leaves=200, **options), walled, points(5000, 10)).mean() < 5e-3


def fit_of(distance_fn, domain, cells, margin=0.0, weight_fn=None):
    pattern = sample_pattern(domain.dim, 40, margin, 0)
    return Sampler(distance_fn, domain, weight_fn, pattern, pattern, 20)(cells)


def costs_of(fit, domain, cones, cell):
    """Weighted absolute errors of each source at a cell's samples."""
    x = fit.cells.points(fit.pattern.u, domain)[cell]
    value = cones.offset[:, None] + np.linalg.norm(x - cones.point[:, None], axis=2)
    return sample_weights(fit)[cell] * np.abs(value - fit.value[cell])


@pytest.mark.parametrize("margin", [0.0, 0.3])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_choices_of_sources_are_those_of_a_brute_force_twin(dim, margin):
    rng, domain = np.random.default_rng(dim), Box(np.zeros(dim), np.ones(dim))
    cones = Cones(rng.random((30, dim)), rng.random(30))
    fit = fit_of(
        lambda x: np.min(cones.offset + np.linalg.norm(x[:, None] - cones.point, axis=2), axis=1),
        domain,
        random_partition(dim, dim, 30),
        margin,
    )
    choice = choose_sources(fit, cones, domain)
    for cell in range(len(fit)):
        costs = costs_of(fit, domain, cones, cell)
        least = costs.sum(axis=1).min()
        assert np.isclose(choice.cost[cell], least) and np.isclose(costs[choice.source[cell]].sum(), least)
        for axis, upper in enumerate(fit.pattern.u.T > 0):
            halves = [costs[:, half].sum(axis=1).min() for half in (upper, ~upper)]
            assert np.isclose(choice.split_cost[cell, axis], sum(halves))


def test_what_is_not_reached_has_no_source_and_weights_count():
    cones = Cones(np.array([[0.1, 0.1], [0.4, 0.7]]), np.array([0.0, np.hypot(0.3, 0.6)]))
    cells = Cells(np.full((1024, 2), 5), np.stack(np.divmod(np.arange(1024), 32), axis=1))
    fit = fit_of(walled, UNIT, cells, weight_fn=lambda x: (x[:, 1] > 0.5) * 1.0)
    choice, reached = choose_sources(fit, cones, UNIT), fit.reachable.any(axis=1)
    assert not reached.all()
    assert ((choice.source >= 0) == reached).all() and np.isinf(choice.cost[~reached]).all()
    for cell in np.flatnonzero(reached):
        assert np.isclose(choice.cost[cell], costs_of(fit, UNIT, cones, cell).sum(axis=1).min())


def test_without_sources_there_is_no_choice_and_where_none_comes_near_the_closest_is_taken():
    none = choose_sources(fit_of(walled, UNIT, random_partition(0, 2, 5)), Cones(np.zeros((0, 2)), np.zeros(0)), UNIT)
    assert (none.source == -1).all() and np.isinf(none.cost).all() and np.isinf(none.split_cost).all()
    fit = fit_of(lambda x: np.ones(len(x)), UNIT, random_partition(0, 2, 5))
    far = Cones(np.array([[0.5, 0.5], [0.5, 0.5]]), np.array([50.0, 20.0]))
    assert (choose_sources(fit, far, UNIT).source == 1).all()
