import numpy as np
from eikonal_helpers import BoxSpace
from space_helpers import random_boxes

from plr_jax.eikonal.mesh import SampledSpace
from plr_jax.geometry.box import Box
from plr_jax.spaces import CellState, ConfigurationSpace

SPACE = BoxSpace(Box((0, 0), (2, 1), (True, False)), [(0.3, 0.2), (1.1, 0.7)])
SAMPLED = SampledSpace(SPACE, 0)


def test_it_is_a_configuration_space_of_the_same_domain_and_costs():
    assert isinstance(SAMPLED, ConfigurationSpace)
    assert SAMPLED.domain == SPACE.domain and SAMPLED.motion_cost == SPACE.motion_cost
    q = np.random.default_rng(0).random((100, 2))
    np.testing.assert_array_equal(SAMPLED.is_free(q), SPACE.is_free(q))


def test_boxes_are_what_is_proven_of_them_or_what_samples_missed():
    lo, hi = random_boxes(np.random.default_rng(0), SPACE.domain, 400)
    proven, sampled = SPACE.classify(lo, hi), SAMPLED.classify(lo, hi)
    sure = proven != CellState.MIXED
    inside = np.all((lo > 0.001) & (hi < (1.99, 0.999)), axis=1)  # what only touches an obstacle is free
    assert (sampled[proven == CellState.FREE] == CellState.FREE).all()
    assert (sampled[sure & inside & (proven == CellState.BLOCKED)] != CellState.FREE).all()
    assert (sampled[~sure] == CellState.MIXED).mean() > 0.8
    assert SAMPLED.classify(np.array([[0.4, 0.3]]), np.array([[0.5, 0.4]])).tolist() == [CellState.BLOCKED]


def test_motions_are_free_where_all_samples_are():
    q0 = np.array([[0.1, 0.5], [0.1, 0.1], [1.9, 0.5], [0.1, 0.5]])
    q1 = np.array([[1.5, 0.5], [1.5, 0.1], [0.1, 0.5], [0.5, 0.5]])
    assert SAMPLED.are_free(q0, q1).tolist() == [True, True, True, False]  # the first one goes around the back
    assert SAMPLED.are_free(q0, q1).tolist() == SPACE.are_free(q0, q1).tolist()
