import numpy as np
import pytest

from plr_jax.plr.leaves.cone.sources import Clusters, Cones, Patches, Samples, cluster_patches

SOURCES = Cones(np.array([[0.1, 0.2], [2.0, 1.0], [0.5, -3.0]]), np.array([0.0, 1.0, 0.3]))


def patches_of(noise, seed=0):
    """Ten cells for each of three sources, in some order."""
    rng = np.random.default_rng(seed)
    source = rng.permutation(np.repeat(np.arange(3), 10))
    x = rng.random((30, 1, 2)) + 0.2 * rng.random((30, 60, 2))
    distance = SOURCES[source](x) + noise * rng.normal(size=(30, 60))
    return Patches.fitted(Samples(x, distance, np.ones((30, 60))), 100.0)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_each_source_is_found_once_with_all_its_samples(noise):
    clusters = cluster_patches(patches_of(noise), max(noise, 1e-12), 100.0)
    assert len(clusters.cones) == 3 and sorted(s.x.shape[1] for s in clusters.samples) == [600] * 3
    nearest = np.linalg.norm(clusters.cones.point[:, None] - SOURCES.point, axis=2).argmin(axis=1)
    assert sorted(nearest) == [0, 1, 2]
    off = np.linalg.norm(clusters.cones.point - SOURCES.point[nearest], axis=1)
    assert off.max() < max(20 * noise, 1e-12)


def test_errors_of_patches_are_those_of_the_noise():
    patches = patches_of(1e-3)
    assert 0.9e-3 < np.median(patches.error) < 1.1e-3
    assert patches.are_of_noise(1e-3).all() and not patches.are_of_noise(3e-4).any()


def test_cells_are_explained_where_every_sample_lies_on_some_cone():
    x = np.random.default_rng(1).random((2, 50, 2))
    several = np.where(np.arange(50) < 25, SOURCES[[0, 0]](x), SOURCES[[1, 1]](x))
    weight = np.ones((2, 50))
    several[1, 7] += 0.1
    clusters = Clusters(SOURCES, [])
    assert clusters.explain(Samples(x, several, weight), 1e-9).tolist() == [True, False]
    weight[1, 7] = 0
    assert clusters.explain(Samples(x, several, weight), 1e-9).tolist() == [True, True]
