import heapq

import numpy as np
import pytest
from plr_helpers import cone, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import (
    ConstructionInterrupted,
    _construct,
    best_axis,
    center_error,
    construct,
    cyclic_axis,
    largest_error,
    maximum_depth,
    midrange,
)
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_samples import fit_cells
from plr_jax.plr.sampling.pattern import sample_pattern

SQUARE = Box((0, 0), (1, 1))


def best_first_twin(distance_fn, max_leaves):
    """Best-first construction with a priority queue, one leaf at a time: boxes of the leaves."""
    pattern = sample_pattern(2, 192, 0.0, 0)

    def push(queue, cells):
        for cell in range(len(cells)):
            fit = fit_cells(cells[[cell]], SQUARE, distance_fn, None, pattern)
            heapq.heappush(queue, (-largest_error(fit)[0], len(queue), best_axis(fit), cells[[cell]]))

    queue, done = [], []
    push(queue, Cells.root(2))
    while queue and len(queue) + len(done) < max_leaves:
        priority, _, axis, cells = heapq.heappop(queue)
        if priority < -1e-6:
            push(queue, cells.split(axis))
        else:
            done.append(cells)
    leaves = [entry[3] for entry in queue] + done
    return {(*leaf.depth[0], *leaf.position[0]) for leaf in leaves}


@pytest.mark.parametrize("distance_fn", [walled, cone])
@pytest.mark.parametrize("max_leaves", [1, 2, 17, 60])
def test_rounds_build_the_tree_of_a_priority_queue(distance_fn, max_leaves):
    cells = construct(distance_fn, SQUARE, max_leaves=max_leaves).cells
    found = {(*depth, *position) for depth, position in zip(cells.depth, cells.position, strict=True)}
    assert found == best_first_twin(distance_fn, max_leaves)


def test_midrange_planes_need_fewer_leaves_for_a_tolerance():
    balanced = construct(cone, SQUARE, tolerance=0.002, compute_coefficients=midrange)
    plain = construct(cone, SQUARE, tolerance=0.002)
    x = np.random.default_rng(0).random((20_000, 2))
    assert np.abs(balanced(x) - cone(x)).max() < 1.2 * 0.002
    assert balanced.num_leaves < 0.8 * plain.num_leaves


def test_a_fit_of_the_callers_own():
    flat = lambda pattern, value, weight: (value.max(axis=1), 0 * value[:, :2])  # noqa: E731
    plr = construct(lambda x: x[:, 0], SQUARE, max_leaves=4, compute_coefficients=flat)
    np.testing.assert_allclose(plr.slope, 0)
    assert (plr(np.random.default_rng(0).random((100, 2))) >= 0.2).all()


def test_a_fit_of_the_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="compute_coefficients must return"):
        construct(cone, SQUARE, compute_coefficients=lambda pattern, value, weight: (value[:, 0], value[:, 1]))


def test_a_plane_needs_one_leaf():
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], SQUARE, max_leaves=100)
    assert plr.num_leaves == 1 and plr.depth == 0
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-6)
    np.testing.assert_allclose(plr.intercept, [1], atol=1e-6)


def test_the_papers_configuration_splits_every_cell_nine_times_in_turn():
    plr = construct(cone, SQUARE, max_depth=9, should_split=maximum_depth, split=cyclic_axis)
    assert plr.num_leaves == 512
    np.testing.assert_array_equal(np.unique(plr.cells.depth, axis=0), [[5, 4]])


def test_center_error_with_a_tolerance_splits_until_the_centers_are_close():
    plr = construct(cone, SQUARE, tolerance=0.01, should_split=center_error, split=cyclic_axis)
    lo, hi = plr.leaf_boxes
    assert np.abs(plr((lo + hi) / 2) - cone((lo + hi) / 2)).max() <= 0.01 + 1e-6
    assert 4 < plr.num_leaves < 100


def test_a_tolerance_bounds_the_error_at_the_samples():
    plr = construct(walled, SQUARE, tolerance=0.004)
    x = np.random.default_rng(0).random((20_000, 2))
    free = np.isfinite(walled(x))
    error = np.abs(np.asarray(plr(x))[free] - walled(x)[free])
    assert np.quantile(error, 0.999) <= 0.004 and error.max() <= 0.008


@pytest.mark.parametrize("budget", [80, 100, 1000, 4000])
@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_budget_of_bytes_is_kept_and_used(budget, bits):
    if bits == 32 and budget < 100:
        return
    plr = construct(walled, SQUARE, max_bytes=budget, coefficient_bits=bits)
    assert plr.num_bytes <= budget
    if budget >= 1000:
        assert plr.num_bytes > budget - 20


def test_limits_combine():
    plr = construct(walled, SQUARE, max_leaves=50, max_depth=4, max_bytes=10_000)
    assert plr.num_leaves <= 16 and plr.depth == 4


def test_no_limit_means_512_leaves():
    assert construct(walled, SQUARE).num_leaves == 512


def test_error_falls_with_leaves():
    x = np.random.default_rng(0).random((20_000, 2))
    free = np.isfinite(walled(x))
    errors = []
    for max_leaves in (16, 64, 256, 1024):
        plr = construct(walled, SQUARE, max_leaves=max_leaves)
        errors.append(np.abs(np.asarray(plr(x))[free] - walled(x)[free]).mean())
    # Planes are of second order: in 2-D four times the leaves should give about a quarter of the error.
    assert np.all(np.array(errors[1:]) < 0.45 * np.array(errors[:-1]))


def test_the_same_seed_gives_the_same_plr_and_another_seed_another():
    first, again, other = (construct(walled, SQUARE, max_leaves=60, seed=seed) for seed in (1, 1, 2))
    assert first.to_bytes() == again.to_bytes() != other.to_bytes()


def test_a_margin_takes_samples_from_beyond_the_cell():
    seen = []
    construct(lambda x: seen.append(x) or cone(x), SQUARE, max_leaves=1, margin=0.5)
    assert np.concatenate(seen).min() < -0.4 and np.concatenate(seen).max() > 1.4


def test_weights_say_where_accuracy_matters():
    left = construct(walled, SQUARE, max_leaves=60, weight_fn=lambda x: np.where(x[:, 0] < 0.4, 10.0, 0.1))
    even = construct(walled, SQUARE, max_leaves=60)
    x = np.random.default_rng(0).random((5000, 2)) * [0.4, 1]
    error = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (left, even)]
    assert error[0] < 0.5 * error[1]


def test_the_scale_of_the_weights_changes_nothing():
    plain = construct(walled, SQUARE, max_leaves=100)
    scaled = construct(walled, SQUARE, max_leaves=100, weight_fn=lambda x: np.full(len(x), 1e-7))
    np.testing.assert_array_equal(scaled.cells.depth, plain.cells.depth)


@pytest.mark.parametrize("factor", [1e31, 1e100])
def test_distances_beyond_floats_are_refused(factor):
    with pytest.raises(ValueError, match="scale them down"):
        construct(lambda x: np.full(len(x), factor), SQUARE, max_leaves=5)


@pytest.mark.parametrize("size", [1e39, 1e-39])
def test_domains_beyond_floats_are_refused(size):
    with pytest.raises(ValueError, match="The domain must be within"):
        construct(lambda x: np.ones(len(x)), ((0, 0), (size, size)), max_leaves=5)


def test_an_own_rule_can_be_given():
    plr = construct(
        cone, SQUARE, max_leaves=8, split=lambda fit: np.zeros(len(fit.cells), int), should_split=maximum_depth
    )
    np.testing.assert_array_equal(plr.cells.depth, [[3, 0]] * 8)


def test_any_dimension():
    for dim in (1, 3, 6):
        plr = construct(cone, Box(np.full(dim, -1.0), np.full(dim, 2.0)), max_leaves=300)
        x = np.random.default_rng(0).uniform(-1, 2, size=(2000, dim))
        assert np.abs(np.asarray(plr(x)) - cone(x)).mean() < 0.1 * np.sqrt(dim)


def test_chunks_of_samples_change_nothing(monkeypatch):
    whole = construct(walled, SQUARE, max_leaves=80)
    monkeypatch.setattr(_construct, "_SAMPLES_AT_ONCE", 300)
    assert construct(walled, SQUARE, max_leaves=80).to_bytes() == whole.to_bytes()


def test_an_interrupt_keeps_what_is_there():
    calls = []

    def interrupted(x):
        calls.append(len(x))
        if len(calls) == 6:
            raise KeyboardInterrupt
        return walled(x)

    with pytest.warns(ConstructionInterrupted, match="after [0-9]+ splits: the PLR is the one built so far"):
        plr = construct(interrupted, SQUARE, max_leaves=500)
    assert 4 <= plr.num_leaves < 500
    assert np.isfinite(np.asarray(plr(np.random.default_rng(0).random((100, 2))))).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_depth": -1}, "max_depth must be an integer >= 0, got -1"),
        ({"max_depth": 61}, "max_depth must be at most 60"),
        ({"max_depth": 60}, "would need about .* GiB; this machine has"),
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"max_leaves": 10**12}, "would need about"),
        ({"max_bytes": 20}, "max_bytes=20 is too small: one leaf takes 6. bytes"),
        ({"tolerance": -0.1}, "tolerance must be a finite distance >= 0"),
        ({"tolerance": np.nan}, "tolerance must be a finite distance >= 0"),
        ({"num_samples": 2}, "num_samples must be at least dim \\+ 1 = 3"),
        ({"margin": -0.1}, "margin must be"),
        ({"margin": np.inf}, "margin must be"),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"coefficient_bits": 21}, "coefficient_bits must be 32"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, SQUARE, **({"max_leaves": 4} | options if "max_depth" not in options else options))


def test_no_depth_is_one_leaf():
    assert construct(cone, SQUARE, max_depth=0).num_leaves == 1


def test_a_budget_goes_into_bits_where_leaves_need_none():
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], SQUARE, max_bytes=2048)
    assert plr.num_leaves == 1
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-3)


def test_many_axes_can_still_be_split():
    plr = construct(cone, ([-1] * 30, [1] * 30), max_leaves=20, num_samples=64)
    assert plr.num_leaves == 20


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"split": lambda fit: np.full(len(fit.cells), 5)}, "split must return one axis from 0 to 1 a cell"),
        ({"split": lambda fit: np.zeros(0, int)}, "split must return one axis"),
        ({"should_split": lambda fit: np.ones(len(fit.cells) + 1)}, "should_split must return one priority a cell"),
        ({"should_split": lambda fit: np.full(len(fit.cells), np.nan)}, "should_split must return one priority"),
    ],
)
def test_bad_rules_are_refused(rules, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, SQUARE, max_leaves=10, **rules)


def test_a_goal_that_no_sample_reaches_is_an_error():
    with pytest.raises(ValueError, match="found nothing reachable"):
        construct(lambda x: np.full(len(x), np.inf), SQUARE)


def test_a_domain_without_width_is_refused():
    with pytest.raises(ValueError, match="positive width"):
        construct(cone, ((0, 0), (1, 0)))


@pytest.mark.parametrize(
    ("oracle", "message"),
    [
        (lambda x: x, "one distance a point"),
        (lambda x: np.full(len(x), np.nan), "got nan at"),
        (lambda x: np.full(len(x), "far"), "an array of numbers"),
        (lambda x: {}, "an array of numbers"),
        (lambda x: 1j * cone(x), "got complex"),
    ],
)
def test_bad_oracles_are_refused(oracle, message):
    with pytest.raises(ValueError, match=message):
        construct(oracle, SQUARE)
