import numpy as np
from scipy.optimize import least_squares

from plr_jax.plr.leaves.cone.sources import Cones, Samples, fit_families

PARENTS = np.array([0, 0, 1, 1, 4])


def family(noise, seed=0):
    """A root, its child, two children of that, and a root alone; samples of each, and cones a little off."""
    rng = np.random.default_rng(seed)
    point = rng.random((5, 2))
    offset = np.array([0.5, 0, 0, 0, 0.2])
    for each in (1, 2, 3):
        offset[each] = offset[PARENTS[each]] + np.linalg.norm(point[each] - point[PARENTS[each]])
    cones, samples = Cones(point, offset), []
    for each in range(5):
        x = rng.random((1, 40 + each, 2))
        distance = cones[[each]](x) + noise * rng.normal(size=x.shape[:2])
        samples.append(Samples(x, distance, np.ones(x.shape[:2])))
    rough = Cones(point + 1e-3 * rng.normal(size=point.shape), offset + 1e-3 * rng.normal(size=5))
    return cones, samples, rough


def test_offsets_follow_from_parents_and_roots_alone_stay():
    cones, samples, rough = family(0.0)
    found = fit_families(rough, samples, PARENTS)
    assert np.abs(found.point[:4] - cones.point[:4]).max() < 1e-12
    assert np.abs(found.offset[:4] - cones.offset[:4]).max() < 1e-12
    assert np.array_equal(found.point[4], rough.point[4]) and np.isclose(found.offset[4], rough.offset[4], atol=1e-15)


def test_as_a_general_solver_of_all_numbers_at_once():
    _, samples, rough = family(1e-3, seed=1)
    found = fit_families(rough, samples, PARENTS)

    def cones_of(numbers):
        point, offset = numbers[:8].reshape(4, 2), np.full(4, numbers[8])
        for each in (1, 2, 3):
            offset[each] = offset[PARENTS[each]] + np.linalg.norm(point[each] - point[PARENTS[each]])
        return Cones(point, offset)

    def errors(numbers):
        cones = cones_of(numbers)
        return np.concatenate([cones[[each]].errors(samples[each]).ravel() for each in range(4)])

    start = np.append(rough.point[:4].ravel(), rough.offset[0])
    twin = cones_of(least_squares(errors, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
    assert np.abs(found.point[:4] - twin.point).max() < 1e-7
    assert np.abs(found.offset[:4] - twin.offset).max() < 1e-7


def test_without_parents_nothing_changes():
    _, samples, rough = family(1e-3)
    assert fit_families(rough, samples, np.arange(5)) is rough
