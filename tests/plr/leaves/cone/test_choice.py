import numpy as np
import pytest
from plr_helpers import UNIT, random_partition, walled

from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.cone.sampled import choose_sources, sample_weights
from plr_jax.plr.leaves.cone.sources import Cones
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def fit_of(distance_fn, domain, cells, margin=0.0, weight_fn=None):
    pattern = sample_pattern(domain.dim, 40, margin, 0)
    return Sampler(distance_fn, domain, weight_fn, pattern, pattern, 20)(cells)


def cost_of(fit, domain, cones, cell, source, which):
    """Weighted sum of absolute errors over some of a cell's samples."""
    x = fit.cells.points(fit.pattern.u, domain)[cell]
    value = cones.offset[source] + np.linalg.norm(x - cones.point[source], axis=1)
    return float((sample_weights(fit)[cell] * np.abs(value - fit.value[cell]))[which].sum())


@pytest.mark.parametrize("margin", [0.0, 0.3])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_brute_force_twin(dim, margin):
    rng = np.random.default_rng(dim)
    cones = Cones(rng.random((30, dim)), rng.random(30))
    domain = Box(np.zeros(dim), np.ones(dim))
    fit = fit_of(
        lambda x: np.min(cones.offset + np.linalg.norm(x[:, None] - cones.point, axis=2), axis=1),
        domain,
        random_partition(dim, dim, 30),
        margin,
    )
    choice, upper = choose_sources(fit, cones, domain), fit.pattern.u > 0
    for cell in range(len(fit)):
        costs = [cost_of(fit, domain, cones, cell, source, slice(None)) for source in range(30)]
        assert np.isclose(choice.cost[cell], min(costs)) and np.isclose(costs[choice.source[cell]], min(costs))
        for axis in range(dim):
            halves = [
                min(cost_of(fit, domain, cones, cell, source, half[:, axis]) for source in range(30))
                for half in (upper, ~upper)
            ]
            assert np.isclose(choice.split_cost[cell, axis], sum(halves))


def test_what_is_not_reached_has_no_source_and_weights_count():
    cones = Cones(np.array([[0.1, 0.1], [0.4, 0.7]]), np.array([0.0, np.hypot(0.3, 0.6)]))
    cells = Cells(np.full((1024, 2), 5), np.stack(np.divmod(np.arange(1024), 32), axis=1))
    fit = fit_of(walled, UNIT, cells, weight_fn=lambda x: (x[:, 1] > 0.5) * 1.0)
    choice = choose_sources(fit, cones, UNIT)
    reached = fit.reachable.any(axis=1)
    assert not reached.all()
    assert ((choice.source >= 0) == reached).all() and np.isinf(choice.cost[~reached]).all()
    for cell in np.flatnonzero(reached):
        costs = [cost_of(fit, UNIT, cones, cell, source, slice(None)) for source in range(2)]
        assert np.isclose(choice.cost[cell], min(costs))


def test_without_sources_there_is_no_choice():
    fit = fit_of(walled, UNIT, random_partition(0, 2, 5))
    choice = choose_sources(fit, Cones(np.zeros((0, 2)), np.zeros(0)), UNIT)
    assert (choice.source == -1).all() and np.isinf(choice.cost).all() and np.isinf(choice.split_cost).all()


def test_where_no_cone_comes_near_the_closest_is_taken():
    cones = Cones(np.array([[0.5, 0.5], [0.5, 0.5]]), np.array([50.0, 20.0]))
    fit = fit_of(lambda x: np.ones(len(x)), UNIT, random_partition(0, 2, 5))
    assert (choose_sources(fit, cones, UNIT).source == 1).all()
