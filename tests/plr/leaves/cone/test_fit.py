import numpy as np
import pytest
from scipy.optimize import least_squares

from plr_jax.plr.leaves.cone.sources import Cones, Samples, fit_cones, normal_equations, refine_cones, slopes


def samples_in_boxes(seed, dim, cells=20, k=60, size=0.2):
    rng = np.random.default_rng(seed)
    x = rng.random((cells, 1, dim)) + size * rng.random((cells, k, dim))
    return rng, Samples(x, np.zeros((cells, k)), (rng.random((cells, k)) < 0.8).astype(float))


@pytest.mark.parametrize("dim", [1, 2, 3, 5])
def test_cones_are_found_exactly(dim):
    rng, samples = samples_in_boxes(dim, dim)
    cones = Cones(rng.normal(size=(20, dim)), rng.normal(size=20))
    samples = Samples(samples.x, cones(samples.x), samples.weight)
    found = fit_cones(samples, 100.0)
    assert np.abs(found.errors(samples)).max() < 1e-12
    if dim > 1:  # on a line the source and the offset cannot be told from one side of it
        assert np.abs(found.point - cones.point).max() < 1e-8
        assert np.abs(found.offset - cones.offset).max() < 1e-8


def test_far_from_the_origin_little_is_lost():
    rng, samples = samples_in_boxes(0, 2)
    cones = Cones(1e5 + rng.normal(size=(20, 2)), 1e4 + rng.normal(size=20))
    x = samples.x + 1e5
    found = fit_cones(Samples(x, cones(x), samples.weight), 100.0)
    assert np.abs(found.point - cones.point).max() < 1e-6


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
    _, samples = samples_in_boxes(1, 2, cells=3)
    samples = Samples(samples.x, function(samples.x), samples.weight)
    found = np.sqrt(fit_cones(samples, 100.0).mean_square(samples))
    for cell in range(len(samples)):
        assert found[cell] <= 1.1 * best_of_starts(samples[[cell]]) + 1e-4


def best_of_starts(samples):
    def errors(p):
        cone = Cones(p[None, :2], p[2:])
        return (np.sqrt(samples.weight) * cone.errors(samples)).ravel()

    rng = np.random.default_rng(0)
    starts = [np.append(rng.normal(size=2) * scale, 0.0) for scale in (0.3, 1, 5, 20) for _ in range(3)]
    least = min(2 * least_squares(errors, start).cost for start in starts)
    return np.sqrt(least / samples.weight.sum())


@pytest.mark.parametrize("num_samples", [0, 1, 2])
def test_a_few_samples_give_some_cone_through_them(num_samples):
    _, samples = samples_in_boxes(2, 2, cells=4)
    weight = np.where(np.arange(60) < num_samples, 1.0, 0.0) * np.ones((4, 1))
    samples = Samples(samples.x, samples.x[..., 0], weight)
    found = fit_cones(samples, 100.0)
    assert np.isfinite(found.point).all() and np.isfinite(found.offset).all()
    assert np.abs(found.errors(samples)).max() < 1e-6


def test_sources_are_no_farther_than_allowed():
    _, samples = samples_in_boxes(3, 2)
    samples = Samples(samples.x, samples.x[..., 1], samples.weight)
    found = fit_cones(samples, 50.0)
    assert np.linalg.norm(found.point - samples.mean(samples.x), axis=1).max() < 50 * (1 + 1e-12)
    assert np.abs(found.errors(samples)).max() < 1e-3, "a far source is nearly a plane"


def test_noise_averages_out_over_more_samples():
    rng, samples = samples_in_boxes(4, 2, cells=100, k=50, size=1.0)
    cone = Cones(np.array([[2.0, -1.0]]), np.array([0.5]))
    noisy = Samples(samples.x, cone(samples.x) + 1e-3 * rng.normal(size=samples.distance.shape), samples.weight)
    one = fit_cones(noisy, 100.0)
    together = refine_cones(noisy.as_one(), one[:1], 100.0)
    assert np.linalg.norm(together.point - cone.point) < 0.2 * np.linalg.norm(one.point - cone.point, axis=1).mean()
    covariance = np.linalg.inv(normal_equations(noisy.as_one(), together)[0][0])
    assert np.linalg.norm(together.point - cone.point) < 4 * 1e-3 * np.sqrt(np.trace(covariance))


def test_slopes_are_those_of_differences():
    rng, samples = samples_in_boxes(5, 3, cells=3)
    cones = Cones(rng.normal(size=(3, 3)), rng.normal(size=3))
    for term, step in enumerate(1e-6 * np.eye(4)):
        above, below = (Cones(cones.point + s * step[:3], cones.offset + s * step[3])(samples.x) for s in (1, -1))
        assert np.allclose(slopes(samples, cones)[..., term], (above - below) / 2e-6, atol=1e-8)
