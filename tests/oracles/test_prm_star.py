"""The parts of PRM*: tests of motions, the draws, and the radius."""

import pickle

import numpy as np
import pytest
from oracle_helpers import CUT, GAP, NOTHING, UNIT, free_points, roadmap

from plr_jax.geometry.box import Box
from plr_jax.oracles import Roadmap
from plr_jax.oracles._metric import metric_of
from plr_jax.oracles._roadmap import checked_is_free, checked_is_visible, prm_star_radius

LINE = Box([0.0], [10.0])


def sampled_test(resolution, is_free=lambda x: np.ones(len(x), dtype=bool), domain=LINE, weights=None):
    """A sampled test of motions, and the list of all configurations it tests."""
    tested = []

    def recorded(x):
        tested.append(x)
        return is_free(x)

    return checked_is_visible(metric_of(domain, weights), checked_is_free(domain, recorded), None, resolution), tested


@pytest.mark.parametrize(("length", "num_inner"), [(0.0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (2.0, 3), (2.1, 4)])
def test_a_motion_is_tested_evenly_at_steps_of_at_most_the_resolution(length, num_inner):
    is_visible, tested = sampled_test(0.5)
    assert is_visible(np.array([[3.0]]), np.array([[3.0 + length]]))[0]
    inner = np.concatenate([np.empty((0, 1)), *tested])[:, 0]
    np.testing.assert_allclose(inner, np.linspace(3.0, 3.0 + length, num_inner + 2)[1:-1])


def test_a_motion_is_tested_the_short_way_around_at_weighted_steps():
    is_visible, tested = sampled_test(0.5, domain=Box([0.0], [10.0], [True]), weights=[0.5])
    assert is_visible(np.array([[9.0], [1.5]]), np.array([[2.0], [19.5]])).all()
    inner = np.concatenate(tested)[:, 0]
    np.testing.assert_allclose(np.sort(inner), [0, 0.5, 1])  # at 10 and 11; at 0.5 on the way down to -0.5


def test_each_motion_is_judged_by_its_own_configurations():
    is_visible, _ = sampled_test(0.1, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    a = np.array([[1.0], [1.0], [7.0], [4.0], [6.0], [3.0]])
    b = np.array([[3.0], [6.0], [2.0], [4.0], [9.0], [3.05]])
    np.testing.assert_array_equal(is_visible(a, b), [True, False, False, True, True, True])
    assert is_visible(a[:0], b[:0]).shape == (0,)


def test_nothing_is_free_outside_the_domain_and_the_test_is_not_asked_there():
    def is_free(x):
        assert LINE.contains(x).all()
        return x[:, 0] > 1

    inside = checked_is_free(LINE, is_free)
    x = np.array([[0.5], [2.0], [-1.0], [11.0], [np.nan]])
    np.testing.assert_array_equal(inside(x), [False, True, False, False, False])
    np.testing.assert_array_equal(inside(x[2:]), [False, False, False])


def test_radius_is_that_of_prm_star():
    assert prm_star_radius(1000, 2, 0.5) == pytest.approx(2 * np.sqrt(1.5 * 0.5 / np.pi * np.log(1000) / 1000))
    assert prm_star_radius(500, 3, 2.0) == pytest.approx(
        2 * np.cbrt(4 / 3 * 2.0 / (4 / 3 * np.pi) * np.log(500) / 500)
    )
    assert roadmap(NOTHING, num_samples=299).radius == pytest.approx(prm_star_radius(300, 2, 1.0))
    assert roadmap(CUT, num_samples=1999).radius == pytest.approx(prm_star_radius(2000, 2, 0.9), rel=0.02)


def test_vanishing_free_space_is_refused():
    with pytest.raises(ValueError, match="tighten the domain"):
        Roadmap(UNIT, lambda x: np.all(x < 1e-3, axis=1), (0, 0), 10, resolution=0.1)


def test_sampled_motions_approach_the_exact_test():
    x = free_points(GAP, 100)
    exact, sampled = roadmap(GAP), roadmap(GAP, is_visible=None, resolution=0.002)
    edges = {frozenset(e) for e in exact.graph.edges.tolist()}
    missed = {frozenset(e) for e in sampled.graph.edges.tolist()} - edges
    assert edges <= {frozenset(e) for e in sampled.graph.edges.tolist()}  # a free motion is never refused
    assert len(missed) <= 0.01 * len(edges)  # what clips a corner by less than the step
    assert np.all(sampled(x) <= exact(x) + 1e-12)


@pytest.mark.parametrize("exact", [True, False])
def test_a_roadmap_can_be_pickled_if_its_tests_can(exact):
    tests = {"is_visible": NOTHING.is_visible} if exact else {"resolution": 0.1}
    oracle = Roadmap(UNIT, NOTHING.is_free, (0.1, 0.1), 50, **tests)
    x = free_points(NOTHING, 40)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(oracle))(x), oracle(x))
