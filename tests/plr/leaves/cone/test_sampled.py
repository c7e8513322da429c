"""Cones from samples alone: how well, at what size, and that every option keeps its meaning."""

import numpy as np
import pytest
from plr_helpers import UNIT, leaf_by_search, points, walled

from plr_jax import scenes
from plr_jax._io import load, save
from plr_jax.geometry.box import Box
from plr_jax.oracles import Euclidean, Roadmap, VisibilityGraph
from plr_jax.plr import construct, cyclic_axis, from_bytes, maximum_depth


def maze_oracle(scene):
    problem = scene()
    return problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])


def error_of(plr, distance_fn, x):
    distance = distance_fn(x)
    reached = np.isfinite(distance)
    return np.abs(np.asarray(plr(x), float)[reached] - distance[reached])


@pytest.mark.parametrize(
    ("scene", "kind"), [(scenes.maze, None), (scenes.maze, "normal"), (scenes.thin_maze, "uniform")]
)
def test_mazes_from_an_oracle_that_offers_nothing(scene, kind):
    workspace, oracle = maze_oracle(scene)
    rng = np.random.default_rng(0)
    draw = {None: np.zeros, "normal": lambda n: rng.normal(size=n), "uniform": lambda n: rng.uniform(-1, 1, n)}[kind]
    plr = construct(lambda x: oracle(x) + 1e-6 * draw(len(x)), workspace.bounds, leaf="cone", max_bytes=1024)
    assert plr.num_bytes <= 1024
    assert error_of(plr, oracle, workspace.sample_free(50_000, seed=3)).mean() < 5e-7


def test_the_same_of_sources_found_and_offered():
    """A function that offers sources, but no cells: about what samples tell."""
    workspace, oracle = maze_oracle(scenes.maze)

    class Sourced:
        sources = oracle.sources

        def __call__(self, x):
            return oracle(x)

    x = workspace.sample_free(20_000, seed=1)
    for distance_fn in (Sourced(), oracle.__call__):
        plr = construct(distance_fn, workspace.bounds, leaf="cone", max_bytes=700)
        assert error_of(plr, oracle, x).mean() < 1e-6
        known = np.linalg.norm(plr.stored.sources.points[:, None] - oracle.sources.points, axis=2).min(axis=1)
        assert np.sort(known)[:12].max() < 1e-8, "what a file resolves"


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_a_distance_without_obstacles_is_one_leaf_and_exact(dim):
    goal = np.linspace(0.2, 0.8, dim)
    oracle = Euclidean(goal)
    plr = construct(oracle.__call__, Box(np.zeros(dim), np.ones(dim)), leaf="cone", max_bytes=1024)
    assert plr.num_leaves == 1
    assert error_of(plr, oracle, points(1000, 0, dim)).max() < 5e-7


def roadmap(dim):
    domain = Box(np.zeros(dim), np.ones(dim))

    def is_free(x):
        return ~((np.abs(x[:, 0] - 0.5) < 0.1) & (x[:, 1] < 0.7))

    return domain, is_free, Roadmap(domain, is_free, np.full(dim, 0.1), 100, resolution=0.02)


@pytest.mark.parametrize(("dim", "max_bytes", "mean"), [(2, 1500, 1.5e-3), (3, 1500, 1.2e-2)])
def test_leaves_of_a_roadmap_choose_among_its_vertices(dim, max_bytes, mean):
    domain, is_free, oracle = roadmap(dim)
    plr = construct(oracle, domain, leaf="cone", max_bytes=max_bytes)
    stored, vertices = plr.stored.sources, oracle.graph.vertices
    gap = np.linalg.norm(stored.points[:, None] - vertices, axis=2)
    assert gap.min(axis=1).max() < 1e-6
    assert np.abs(stored.offsets - oracle.distances[gap.argmin(axis=1)]).max() < 1e-5
    assert plr.num_bytes <= max_bytes
    x = points(5000, 1, dim)
    assert error_of(plr, oracle, x[is_free(x)]).mean() < mean


def smooth(x):
    return 2 + np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1])


@pytest.mark.parametrize("function", [smooth, lambda x: np.abs(x).sum(axis=1), lambda x: np.full(len(x), 2.0)])
def test_what_is_no_distance_is_approached_by_leaves_with_sources_of_their_own(function):
    x = points(5000, 2)
    plrs = (construct(function, UNIT, leaf="cone", max_leaves=leaves) for leaves in (1, 20, 200))
    errors = [error_of(plr, function, x).mean() for plr in plrs]
    assert errors[0] > 1.5 * errors[1] > 3 * errors[2] and errors[2] < 0.02


def test_nothing_is_said_where_nothing_is_reached_and_all_else_is_exact_but_at_bends():
    plr = construct(walled, UNIT, leaf="cone", max_leaves=300)
    error = error_of(plr, walled, points(20_000, 3))
    assert np.median(error) < 2e-7 and error.mean() < 2e-5
    assert np.isfinite(np.asarray(plr(points(1000, 4)))).all()
    assert not plr.unreachable.any()


def test_the_same_seed_gives_the_same_bytes_and_files_give_them_back(tmp_path):
    plr, again = (construct(walled, UNIT, leaf="cone", max_bytes=400, seed=5) for _ in range(2))
    assert plr.to_bytes() == again.to_bytes() and plr.num_bytes == len(plr.to_bytes()) <= 400
    save(plr, tmp_path / "cones.plr")
    x = points(1000, 5).astype(np.float32)
    for loaded in (load(tmp_path / "cones.plr"), from_bytes(plr.to_bytes())):
        assert loaded.to_bytes() == plr.to_bytes()
        assert np.array_equal(np.asarray(loaded(x)), np.asarray(plr(x)))
    other = construct(walled, UNIT, leaf="cone", max_bytes=400, seed=6)
    assert other.to_bytes() != plr.to_bytes()


def test_every_leaf_has_the_best_of_the_sources_for_what_it_holds():
    """The brute-force twin: all points of a leaf, all sources."""
    plr = construct(walled, UNIT, leaf="cone", max_leaves=60)
    x = points(40_000, 6)
    distance = walled(x)
    x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
    leaf, sources = leaf_by_search(plr, x), plr.stored.sources
    value = sources.offsets + np.linalg.norm(x[:, None] - sources.points, axis=2)
    error = np.abs(value - distance[:, None])
    total = np.stack([np.bincount(leaf, column, plr.num_leaves) for column in error.T])
    chosen = total[plr.stored.source, np.arange(plr.num_leaves)]
    assert (chosen <= 1.5 * total.min(axis=0) + 0.02).all() and np.mean(chosen <= total.min(axis=0) + 1e-9) > 0.9


def test_limits_are_kept():
    assert construct(walled, UNIT, leaf="cone", max_leaves=7).num_leaves == 7
    assert construct(walled, UNIT, leaf="cone", max_depth=3).depth == 3
    loose, tight = (construct(walled, UNIT, leaf="cone", tolerance=t, max_leaves=500) for t in (0.05, 0.01))
    assert loose.num_leaves < tight.num_leaves
    assert error_of(tight, walled, points(20_000, 7)).max() < 0.02


def test_weights_say_where_leaves_go():
    heavy = construct(walled, UNIT, leaf="cone", max_leaves=40, weight_fn=lambda x: np.where(x[:, 1] > 0.7, 1.0, 0.0))
    even = construct(walled, UNIT, leaf="cone", max_leaves=40)
    x = points(20_000, 8)
    above = x[x[:, 1] > 0.7]
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
    workspace, oracle = maze_oracle(scenes.maze)
    plr = construct(oracle, workspace.bounds, leaf="cone", max_leaves=64, **options)
    twin = construct(oracle.__call__, workspace.bounds, leaf="cone", max_leaves=64, **options)
    assert plr.num_leaves == twin.num_leaves == 64
    if options.get("should_split") is maximum_depth:
        assert plr.depth == 6
    x = workspace.sample_free(5000, seed=9)
    assert abs(error_of(plr, oracle, x).mean() - error_of(twin, oracle, x).mean()) < 1e-2


def test_residuals_that_rules_see_are_of_cones():
    seen = []

    def rule(fit):
        seen.append(np.abs(fit.residual).max())
        return np.zeros(len(fit))

    construct(lambda x: np.linalg.norm(x - 0.3, axis=1), UNIT, leaf="cone", should_split=rule)
    assert max(seen) == 0.0


@pytest.mark.parametrize("options", [{"margin": 0.5}, {"num_samples": 5}, {"num_samples": 500}])
def test_other_samples(options):
    plr = construct(walled, UNIT, leaf="cone", max_leaves=200, **options)
    assert error_of(plr, walled, points(5000, 10)).mean() < 5e-3
