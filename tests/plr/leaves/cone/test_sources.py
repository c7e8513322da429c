"""Sources found in samples: cones that are fitted, clusters of them, families of parents, and where to look."""

import numpy as np
import pytest
from plr_helpers import UNIT
from scipy.optimize import least_squares

from plr_jax import Box, VisibilityGraph, scenes
from plr_jax.plr.leaves.cone.sources import (
    Clusters,
    Cones,
    Patches,
    Samples,
    cluster_patches,
    find_sources,
    fit_cones,
    fit_families,
    normal_equations,
    refine_cones,
)
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def samples_in_boxes(seed, dim, cells=20, k=60, size=0.2):
    rng = np.random.default_rng(seed)
    x = rng.random((cells, 1, dim)) + size * rng.random((cells, k, dim))
    return rng, Samples(x, np.zeros((cells, k)), (rng.random((cells, k)) < 0.8).astype(float))


def samples_of(function, seed, cells=20):
    _, samples = samples_in_boxes(seed, 2, cells)
    return Samples(samples.x, function(samples.x), samples.weight)


@pytest.mark.parametrize(("dim", "far"), [(1, 0.0), (2, 0.0), (3, 0.0), (5, 0.0), (2, 1e5)])
def test_cones_are_found_exactly(dim, far):
    """Far from the origin little is lost."""
    rng, samples = samples_in_boxes(dim, dim)
    cones, x = Cones(far + rng.normal(size=(20, dim)), far / 10 + rng.normal(size=20)), samples.x + far
    samples = Samples(x, cones(x), samples.weight)
    found = fit_cones(samples, 100.0)
    assert far or np.abs(found.errors(samples)).max() < 1e-12
    if dim > 1:  # on a line the source and the offset cannot be told from one side of it
        assert np.abs(found.point - cones.point).max() < (1e-6 if far else 1e-8)
        assert np.abs(found.offset - cones.offset).max() < (1e-6 if far else 1e-8)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: np.sin(3 * x[..., 0]) * np.cos(2 * x[..., 1]),
        lambda x: 0.3 * x[..., 0] + 2,
        lambda x: x[..., 0],
        lambda x: np.minimum(np.linalg.norm(x, axis=-1), np.linalg.norm(x - [2, 1], axis=-1)),
        lambda x: -np.linalg.norm(x - 3, axis=-1),
    ],
)
def test_no_worse_than_a_general_solver_from_many_starts(function):
    samples = samples_of(function, 1, cells=3)
    found = np.sqrt(fit_cones(samples, 100.0).mean_square(samples))
    for cell in range(len(samples)):
        assert found[cell] <= 1.1 * best_of_starts(samples[[cell]]) + 1e-4


def best_of_starts(samples):
    def errors(p):
        return (np.sqrt(samples.weight) * Cones(p[None, :2], p[2:]).errors(samples)).ravel()

    rng = np.random.default_rng(0)
    starts = [np.append(rng.normal(size=2) * scale, 0.0) for scale in (0.3, 1, 5, 20) for _ in range(3)]
    least = min(2 * least_squares(errors, start).cost for start in starts)
    return np.sqrt(least / samples.weight.sum())


@pytest.mark.parametrize("num_samples", [0, 1, 2])
def test_a_few_samples_give_some_cone_through_them(num_samples):
    samples = samples_of(lambda x: x[..., 0], 2, cells=4)
    weight = np.where(np.arange(60) < num_samples, 1.0, 0.0) * np.ones((4, 1))
    samples = Samples(samples.x, samples.distance, weight)
    found = fit_cones(samples, 100.0)
    assert np.isfinite(found.point).all() and np.isfinite(found.offset).all()
    assert np.abs(found.errors(samples)).max() < 1e-6


def test_sources_are_no_farther_than_allowed():
    samples = samples_of(lambda x: x[..., 1], 3)
    found = fit_cones(samples, 50.0)
    assert np.linalg.norm(found.point - samples.mean(samples.x), axis=1).max() < 50 * (1 + 1e-12)
    assert np.abs(found.errors(samples)).max() < 1e-3, "a far source is nearly a plane"


def test_noise_averages_out_over_more_samples():
    rng, samples = samples_in_boxes(4, 2, cells=100, k=50, size=1.0)
    cone = Cones(np.array([[2.0, -1.0]]), np.array([0.5]))
    noisy = Samples(samples.x, cone(samples.x) + 1e-3 * rng.normal(size=samples.distance.shape), samples.weight)
    one = fit_cones(noisy, 100.0)
    together = refine_cones(noisy.as_one(), one[:1], 100.0)
    error = np.linalg.norm(together.point - cone.point)
    assert error < 0.2 * np.linalg.norm(one.point - cone.point, axis=1).mean()
    covariance = np.linalg.inv(normal_equations(noisy.as_one(), together)[0][0])
    assert error < 4 * 1e-3 * np.sqrt(np.trace(covariance))


THREE = Cones(np.array([[0.1, 0.2], [2.0, 1.0], [0.5, -3.0]]), np.array([0.0, 1.0, 0.3]))


def patches_of(noise):
    """Ten cells for each of three sources, in some order."""
    rng = np.random.default_rng(0)
    source = rng.permutation(np.repeat(np.arange(3), 10))
    x = rng.random((30, 1, 2)) + 0.2 * rng.random((30, 60, 2))
    distance = THREE[source](x) + noise * rng.normal(size=(30, 60))
    return Patches.fitted(Samples(x, distance, np.ones((30, 60))), 100.0)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_each_source_is_found_once_with_all_its_samples(noise):
    patches = patches_of(noise)
    clusters = cluster_patches(patches, max(noise, 1e-12), 100.0)
    assert len(clusters.cones) == 3 and sorted(s.x.shape[1] for s in clusters.samples) == [600] * 3
    away = np.linalg.norm(clusters.cones.point[:, None] - THREE.point, axis=2)
    assert sorted(away.argmin(axis=1)) == [0, 1, 2] and away.min(axis=1).max() < max(20 * noise, 1e-12)
    if noise == 1e-3:
        assert 0.9e-3 < np.median(patches.error) < 1.1e-3
        assert patches.are_of_noise(1e-3).all() and not patches.are_of_noise(3e-4).any()


def test_cells_are_explained_where_every_sample_lies_on_some_cone():
    x = np.random.default_rng(1).random((2, 50, 2))
    several, weight = np.where(np.arange(50) < 25, THREE[[0, 0]](x), THREE[[1, 1]](x)), np.ones((2, 50))
    several[1, 7] += 0.1
    for of_other in (1, 0):
        weight[1, 7] = of_other
        explained = Clusters(THREE, []).explain(Samples(x, several, weight), 1e-9)
        assert explained.tolist() == [True, not of_other]


PARENTS = np.array([0, 0, 1, 1, 4])


def family_of(point, offset):
    """A root, its child, two children of that, and a root alone, or without it."""
    offset = offset.copy()
    for each in (1, 2, 3):
        offset[each] = offset[PARENTS[each]] + np.linalg.norm(point[each] - point[PARENTS[each]])
    return Cones(point, offset)


def sampled_family(noise, seed=0):
    """A family, samples of each, and cones a little off."""
    rng = np.random.default_rng(seed)
    cones, samples = family_of(rng.random((5, 2)), np.array([0.5, 0, 0, 0, 0.2])), []
    for each in range(5):
        x = rng.random((1, 40 + each, 2))
        samples.append(Samples(x, cones[[each]](x) + noise * rng.normal(size=x.shape[:2]), np.ones(x.shape[:2])))
    rough = Cones(cones.point + 1e-3 * rng.normal(size=(5, 2)), cones.offset + 1e-3 * rng.normal(size=5))
    return cones, samples, rough


def test_offsets_follow_from_parents_and_roots_alone_stay():
    cones, samples, rough = sampled_family(0.0)
    found = fit_families(rough, samples, PARENTS)
    assert np.abs(found.point[:4] - cones.point[:4]).max() < 1e-12
    assert np.abs(found.offset[:4] - cones.offset[:4]).max() < 1e-12
    assert np.array_equal(found.point[4], rough.point[4]) and np.isclose(found.offset[4], rough.offset[4], atol=1e-15)
    assert fit_families(rough, samples, np.arange(5)) is rough  # without parents nothing changes


def test_as_a_general_solver_of_all_numbers_at_once():
    _, samples, rough = sampled_family(1e-3, seed=1)
    found = fit_families(rough, samples, PARENTS)

    def cones_of(numbers):
        return family_of(numbers[:8].reshape(4, 2), np.append(numbers[8], np.zeros(3)))

    def errors(numbers):
        cones = cones_of(numbers)
        return np.concatenate([cones[[each]].errors(samples[each]).ravel() for each in range(4)])

    start = np.append(rough.point[:4].ravel(), rough.offset[0])
    twin = cones_of(least_squares(errors, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
    assert np.abs(found.point[:4] - twin.point).max() < 1e-7
    assert np.abs(found.offset[:4] - twin.offset).max() < 1e-7


def found_sources(distance_fn, domain=UNIT):
    pattern = sample_pattern(domain.dim, 96, 0.0, 0)
    return find_sources(Sampler(distance_fn, domain, None, pattern, pattern, 20))


def oracle_of(scene):
    problem = scene()
    return VisibilityGraph(problem.workspace, problem.goals[0])


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_corners_of_a_maze_are_found_exactly_each_once_with_its_parent(scene):
    oracle = oracle_of(scene)
    found = found_sources(oracle.__call__, oracle.workspace.bounds).sources
    gap = np.linalg.norm(found.points[:, None] - oracle.sources.points, axis=2)
    corner = gap.argmin(axis=1)
    assert gap.min(axis=1).max() < 1e-12 and len(np.unique(corner)) == len(corner) >= 12
    assert np.abs(found.distances - oracle.distances[corner]).max() < 1e-12
    assert np.array_equal(corner[found.parents], oracle.sources.parents[corner])


@pytest.mark.parametrize("kind", ["normal", "uniform"])
@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_noise_averages_out(scene, kind):
    rng, oracle = np.random.default_rng(7), oracle_of(scene)
    draw = {"normal": lambda n: rng.normal(size=n), "uniform": lambda n: rng.uniform(-1, 1, n)}[kind]
    found = found_sources(lambda x: oracle(x) + 1e-6 * draw(len(x)), oracle.workspace.bounds)
    gap = np.linalg.norm(found.sources.points[:, None] - oracle.sources.points, axis=2)
    assert len(found.sources.points) == 12 and len(np.unique(gap.argmin(axis=1))) == 12
    assert np.median(gap.min(axis=1)) < 3e-6 and gap.min(axis=1).max() < 5e-5
    assert 0.8 < found.noise / (1e-6 if kind == "normal" else 1e-6 / np.sqrt(3)) < 1.1
    is_root = found.sources.parents == np.arange(12)
    assert np.abs(found.sources.distances).min() < 1e-6 and 1 <= np.count_nonzero(is_root) <= 2


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_one_cone_is_one_source_in_any_dimension(dim):
    goal, seen = np.linspace(0.2, 0.8, dim), []
    domain = Box(np.zeros(dim), np.ones(dim))
    found = found_sources(lambda x: seen.append(len(x)) or np.linalg.norm(x - goal, axis=1), domain).sources
    assert len(found.points) == 1 and np.abs(found.points - goal).max() < 1e-12
    assert abs(found.distances[0]) < 1e-12 and sum(seen) == 96


def test_what_is_no_distance_has_none_and_the_number_of_samples_is_bounded():
    seen = []

    def rough(x):
        seen.append(len(x))
        return np.random.default_rng(len(seen)).random(len(x))

    def smooth(x):
        return 2 + np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1])

    for distance_fn in (smooth, lambda x: np.full(len(x), np.inf)):
        found = found_sources(distance_fn).sources
        assert len(found.points) == len(found.parents) == 0
    found_sources(rough)
    assert sum(seen) <= 96 * 2**11
