import heapq

import numpy as np
import pytest
from plr_helpers import UNIT, cone, lstsq_plane, sampler_of, walled

from plr_jax import construct
from plr_jax.plr import Plane, best_axis, center_error, cyclic_axis, largest_error, maximum_depth
from plr_jax.plr import growth as best_first
from plr_jax.plr.growth import MAX_ASPECT_BITS, _sum_of_squares_after_split
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tree import Cells

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
def test_rounds_build_the_tree_of_a_priority_queue(distance_fn, max_leaves, monkeypatch):
    plr = construct(distance_fn, UNIT, max_leaves=max_leaves)
    found = {(*depth, *position) for depth, position in zip(plr.cells.depth, plr.cells.position, strict=True)}
    assert found == best_first_twin(distance_fn, max_leaves)
    monkeypatch.setattr(best_first, "_SAMPLES_AT_ONCE", 300)
    assert construct(distance_fn, UNIT, max_leaves=max_leaves).to_bytes() == plr.to_bytes()


def test_a_budget_of_bytes_is_kept_and_used_and_bits_are_traded_for_leaves():
    """The choice errs no more than any one number of bits (but for what sampling makes of it)."""
    x = np.random.default_rng(0).random((5000, 2))
    x, error = x[np.isfinite(walled(x))], {}
    for bits in (None, 8, 12, 16, 32):
        for budget in (100, 1000):
            plr = construct(walled, UNIT, max_bytes=budget, leaf=Plane(coefficient_bits=bits))
            assert plr.num_bytes <= budget and (budget < 1000 or plr.num_bytes > budget - 20)
        error[bits] = np.abs(np.asarray(plr(x)) - walled(x)).mean()
    assert error[None] < 1.1 * min(error[8], error[12], error[16])
    assert error[None] < 0.7 * error[32]
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, max_bytes=2048)  # where leaves need no bytes
    assert plr.num_leaves == 1
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-3)


# Rules.


def fit(distance_fn, cells=None, weight_fn=None, max_axis_depth=14):
    return sampler_of(distance_fn, UNIT, weight_fn, 64, max_axis_depth)(Cells.root(2) if cells is None else cells)


def test_best_axis_is_the_one_along_which_the_function_bends_and_that_may_still_be_halved():
    assert best_axis(fit(lambda x: np.abs(x[:, 0] - 0.5) + x[:, 1]))[0] == 0
    assert best_axis(fit(lambda x: np.abs(x[:, 1] - 0.5) + x[:, 0]))[0] == 1
    bend = lambda x: np.abs(x[:, 0] - 0.125) + 1e-3 * np.abs(x[:, 1] - 0.3)  # noqa: E731
    cells = Cells(np.array([[2, 0]]), np.array([[0, 0]]))
    assert [best_axis(fit(bend, cells, max_axis_depth=most))[0] for most in (14, 2)] == [0, 1]


def test_best_axis_never_makes_needles():
    cells, aspects = Cells.root(2), set()
    for _ in range(10):
        cells = cells.split(best_axis(fit(lambda x: (x[:, 0] > 1 / 3) * 1.0, cells)))
        aspects.add(int(np.ptp(cells.depth, axis=1).max()))
    assert max(aspects) == MAX_ASPECT_BITS


def test_sum_of_squares_after_split_equals_two_separate_fits():
    rng = np.random.default_rng(3)
    pattern = sample_pattern(2, 50, 0.0, 0)
    blocked = rng.random((2, 50)) < [[0.0], [0.4]]
    table = np.where(blocked, np.inf, rng.random((2, 50)))
    found = Sampler(lambda x: table.ravel(), UNIT, None, pattern, pattern, 14)(Cells.root(2).split(np.array([0])))
    for cell in range(2):
        for axis in range(2):
            expected = 0.0
            for side in (pattern.u[:, axis] <= 0, pattern.u[:, axis] > 0):
                keep = side & ~blocked[cell]
                plane = lstsq_plane(pattern.u[keep], table[cell, keep], pattern.weight[keep])
                rest = table[cell, keep] - plane[0] - pattern.u[keep] @ plane[1:]
                expected += np.sum(pattern.weight[keep] * rest**2)
            assert _sum_of_squares_after_split(found)[cell, axis] == pytest.approx(expected, rel=1e-6)


def test_cyclic_axis_takes_turns_and_maximum_depth_splits_all_but_blocked_cells():
    cells = Cells.root(2)
    for axis in (0, 1, 0, 1):
        chosen = cyclic_axis(fit(lambda x: x[:, 0], cells))
        assert (chosen == axis).all()
        cells = cells.split(chosen)
    halves = Cells.root(2).split(np.array([0]))
    priority = maximum_depth(fit(lambda x: np.where(x[:, 0] < 0.5, 1.0, np.inf), halves))
    np.testing.assert_array_equal(priority, [np.inf, 0])


def test_largest_error_is_the_largest_weighted_residual_and_center_error_that_at_the_center_unless_it_is_blocked():
    found = fit(lambda x: (x[:, 0] > 0.9) * 1.0, weight_fn=lambda x: 2.0 - x[:, 0])
    x = found.cells.points(found.pattern.u, UNIT)[0]
    expected = np.max((2 - x[:, 0]) * np.abs(found.residual[0]))
    np.testing.assert_allclose(largest_error(found), expected)
    assert expected > 0.1
    bump = fit(lambda x: 1.0 * (np.abs(x - 0.5).max(axis=1) < 0.01))
    assert center_error(bump)[0] == np.abs(bump.residual[0, 0]) > 0.5
    corner = fit(lambda x: 1.0 * (x.min(axis=1) > 0.9))
    assert center_error(corner)[0] < largest_error(corner)[0]
    blocked = fit(lambda x: np.where(np.abs(x - 0.5).max(axis=1) < 0.1, np.inf, x[:, 0] > 0.5))
    assert center_error(blocked)[0] == largest_error(blocked)[0] > 0.1
