import heapq

import numpy as np
import pytest
from plr_helpers import UNIT, cone, walled

from plr_jax.plr import Plane, best_axis, construct, largest_error
from plr_jax.plr.growth import best_first
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern

AXIS_DEPTH = 7  # in the plane, for files of up to 2,048 bytes


def best_first_twin(distance_fn, max_leaves):
    """Best-first construction with a priority queue, one leaf at a time: the leaves."""
    patterns = [sample_pattern(2, num_samples, 0.0, 0) for num_samples in (192, 8 * 192)]
    sampler = Sampler(distance_fn, UNIT, None, *patterns, AXIS_DEPTH)

    def push(queue, cells):
        for cell in range(len(cells)):
            fit = sampler(cells[[cell]])
            fit = sampler.densely(cells[[cell]]) if fit.is_hardly_seen[0] else fit
            heapq.heappush(queue, (-largest_error(fit)[0], len(queue), best_axis(fit), cells[[cell]]))

    queue, done = [], []
    push(queue, Cells.root(2))
    while queue and len(queue) + len(done) < max_leaves:
        priority, _, axis, cells = heapq.heappop(queue)
        if priority < -1e-6 and cells.depth[0, axis[0]] < AXIS_DEPTH:
            push(queue, cells.split(axis))
        else:
            done.append(cells)
    leaves = [entry[3] for entry in queue] + done
    return {(*leaf.depth[0], *leaf.position[0]) for leaf in leaves}


@pytest.mark.parametrize("distance_fn", [walled, cone])
@pytest.mark.parametrize("max_leaves", [1, 2, 17, 60])
def test_rounds_build_the_tree_of_a_priority_queue(distance_fn, max_leaves):
    cells = construct(distance_fn, UNIT, max_leaves=max_leaves).cells
    found = {(*depth, *position) for depth, position in zip(cells.depth, cells.position, strict=True)}
    assert found == best_first_twin(distance_fn, max_leaves)


def test_chunks_of_samples_change_nothing(monkeypatch):
    whole = construct(walled, UNIT, max_leaves=80)
    monkeypatch.setattr(best_first, "_SAMPLES_AT_ONCE", 300)
    assert construct(walled, UNIT, max_leaves=80).to_bytes() == whole.to_bytes()


@pytest.mark.parametrize("budget", [80, 100, 1000, 4000])
@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_budget_of_bytes_is_kept_and_used(budget, bits):
    if bits == 32 and budget < 100:
        return
    plr = construct(walled, UNIT, max_bytes=budget, leaf=Plane(coefficient_bits=bits))
    assert plr.num_bytes <= budget
    if budget >= 1000:
        assert plr.num_bytes > budget - 20


def test_a_budget_goes_into_bits_where_leaves_need_none():
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, max_bytes=2048)
    assert plr.num_leaves == 1
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-3)


def test_bits_are_traded_for_leaves():
    """The choice errs no more than any one number of bits (but for what sampling makes of it)."""
    x = np.random.default_rng(0).random((5000, 2))
    x = x[np.isfinite(walled(x))]
    error = {}
    for bits in (None, 8, 12, 16, 32):
        plr = construct(walled, UNIT, max_bytes=1000, leaf=Plane(coefficient_bits=bits))
        error[bits] = np.abs(np.asarray(plr(x)) - walled(x)).mean()
    assert error[None] < 1.1 * min(error[8], error[12], error[16])
    assert error[None] < 0.7 * error[32]


def test_one_leaf_that_does_not_fit_is_refused(leaf):
    """A header of 4 bytes, the domain in 5 and a checksum of 4 are 13 without any leaf."""
    with pytest.raises(ValueError, match=r"max_bytes=13 is too small: one leaf takes [123]\d bytes"):
        construct(cone, UNIT, leaf=leaf, max_bytes=13)
