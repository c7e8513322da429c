import numpy as np
import pytest
from plr_helpers import UNIT, cone, walled

from plr_jax import VisibilityGraph, Workspace
from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, center_error, construct, cyclic_axis, maximum_depth


def free_points(n):
    x = np.random.default_rng(0).random((n, 2))
    return x[np.isfinite(walled(x))]


def test_a_linear_function_needs_one_leaf(leaf):
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, leaf=leaf, max_leaves=100)
    assert plr.num_leaves == 1 and plr.depth == 0
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-6)
    np.testing.assert_allclose(plr.intercept, [1], atol=1e-6)


def test_the_papers_configuration_splits_every_cell_nine_times_in_turn():
    plr = construct(cone, UNIT, max_depth=9, should_split=maximum_depth, split=cyclic_axis)
    assert plr.num_leaves == 512
    np.testing.assert_array_equal(np.unique(plr.cells.depth, axis=0), [[5, 4]])


def test_center_error_with_a_tolerance_splits_until_the_centers_are_close():
    plr = construct(cone, UNIT, tolerance=0.01, should_split=center_error, split=cyclic_axis)
    lo, hi = plr.leaf_boxes
    assert np.abs(plr((lo + hi) / 2) - cone((lo + hi) / 2)).max() <= 0.01 + 1e-6
    assert 4 < plr.num_leaves < 100


def test_a_tolerance_bounds_the_error_at_the_samples():
    plr = construct(walled, UNIT, tolerance=0.004)
    x = free_points(20_000)
    error = np.abs(np.asarray(plr(x)) - walled(x))
    assert np.quantile(error, 0.999) <= 0.004 and error.max() <= 0.008


def test_limits_combine():
    plr = construct(walled, UNIT, max_leaves=50, max_depth=4, max_bytes=10_000)
    assert plr.num_leaves <= 16 and plr.depth == 4


def test_no_depth_is_one_leaf(leaf):
    assert construct(cone, UNIT, leaf=leaf, max_depth=0).num_leaves == 1


def test_error_falls_with_leaves():
    x = free_points(10_000)
    errors = [
        np.abs(np.asarray(construct(walled, UNIT, max_leaves=leaves)(x)) - walled(x)).mean()
        for leaves in (16, 64, 256, 1024)
    ]
    # Planes are of second order: in 2-D four times the leaves should give about a quarter of the error.
    assert np.all(np.array(errors[1:]) < 0.45 * np.array(errors[:-1]))


def test_slivers_of_free_space_show_their_errors():
    """A notch in the wall of a strip: its leaves had too few samples to show their error of 0.16."""
    ring = [(0, 5), (23, 5), (23, 6), (24, 6), (24, 5), (40, 5), (40, 46), (0, 46)]
    workspace = Workspace(((0, 0), (40, 46)), [ring])
    exact = VisibilityGraph(workspace, (3, 3))
    plr = construct(exact, workspace.bounds, max_bytes=4096)
    x = workspace.sample_free(20_000, seed=0)
    assert np.abs(np.asarray(plr(x)) - exact(x)).max() < 0.06


def test_the_same_seed_gives_the_same_plr_and_another_seed_another(leaf):
    first, again, other = (
        construct(walled, UNIT, leaf=leaf, max_leaves=12, num_samples=32, seed=seed) for seed in (1, 1, 2)
    )
    assert first.to_bytes() == again.to_bytes() != other.to_bytes()


def test_a_margin_takes_samples_from_beyond_the_cell():
    seen = []
    construct(lambda x: seen.append(x) or cone(x), UNIT, max_leaves=1, margin=0.5)
    assert np.concatenate(seen).min() < -0.4 and np.concatenate(seen).max() > 1.4


def test_weights_say_where_accuracy_matters():
    left = construct(walled, UNIT, max_leaves=60, weight_fn=lambda x: np.where(x[:, 0] < 0.4, 10.0, 0.1))
    even = construct(walled, UNIT, max_leaves=60)
    x = np.random.default_rng(0).random((5000, 2)) * [0.4, 1]
    error = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (left, even)]
    assert error[0] < 0.5 * error[1]


def test_the_scale_of_the_weights_changes_nothing():
    plain = construct(walled, UNIT, max_leaves=100)
    scaled = construct(walled, UNIT, max_leaves=100, weight_fn=lambda x: np.full(len(x), 1e-7))
    np.testing.assert_array_equal(scaled.cells.depth, plain.cells.depth)


def test_masked_distances_mean_inf(leaf):
    """Once the mask was lost, and what stood under it was a distance."""

    def masked(x):
        distance = walled(x)
        return np.ma.masked_array(np.where(np.isinf(distance), 0.0, distance), np.isinf(distance))

    plr, expected = (construct(fn, UNIT, leaf=leaf, max_leaves=12, num_samples=32) for fn in (masked, walled))
    assert plr.to_bytes() == expected.to_bytes()


@pytest.mark.parametrize("factor", [1e31, 1e100])
def test_distances_beyond_floats_are_refused(leaf, factor):
    with pytest.raises(ValueError, match="scale them down"):
        construct(lambda x: np.full(len(x), factor), UNIT, leaf=leaf, max_leaves=5)


@pytest.mark.parametrize("size", [1e39, 1e-39])
def test_domains_beyond_floats_are_refused(leaf, size):
    with pytest.raises(ValueError, match="The domain must be within"):
        construct(lambda x: np.ones(len(x)), ((0, 0), (size, size)), leaf=leaf, max_leaves=5)


def test_own_rules_can_be_given(leaf):
    first_axis = lambda fit: np.zeros(len(fit.cells), int)  # noqa: E731
    plr = construct(cone, UNIT, leaf=leaf, max_depth=3, split=first_axis, should_split=maximum_depth)
    np.testing.assert_array_equal(plr.cells.depth, [[3, 0]] * 8)


@pytest.mark.parametrize("dim", [1, 3, 6])
def test_any_dimension(dim):
    plr = construct(cone, Box(np.full(dim, -1.0), np.full(dim, 2.0)), max_leaves=300)
    x = np.random.default_rng(0).uniform(-1, 2, size=(2000, dim))
    assert np.abs(np.asarray(plr(x)) - cone(x)).mean() < 0.1 * np.sqrt(dim)


def test_many_axes_can_still_be_split():
    plr = construct(cone, ([-1] * 30, [1] * 30), max_leaves=20, num_samples=64)
    assert plr.num_leaves == 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"num_samples": 2}, "num_samples must be an integer >= 3, got 2"),
        ({"num_samples": 4, "leaf": "continuous"}, "num_samples must be an integer >= 5, got 4"),
        ({"margin": -0.1}, "margin must be"),
        ({"margin": np.inf}, "margin must be"),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"leaf": "cubic"}, "one of 'plane', 'continuous', 'smooth', 'cone', got 'cubic'"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, UNIT, **({"max_leaves": 4} | options))


def test_a_goal_that_no_sample_reaches_is_an_error(leaf):
    with pytest.raises(ValueError, match="found nothing reachable"):
        construct(lambda x: np.full(len(x), np.inf), UNIT, leaf=leaf)


def test_a_domain_without_width_is_refused():
    with pytest.raises(ValueError, match="positive width"):
        construct(cone, ((0, 0), (1, 0)))


def test_bad_oracles_are_refused(leaf):
    with pytest.raises(ValueError, match="distance_fn gives NaN at"):
        construct(lambda x: np.full(len(x), np.nan), UNIT, leaf=leaf)


def test_a_model_with_options_is_the_model_of_its_name():
    plr = construct(walled, UNIT, max_leaves=20, leaf=Plane(coefficient_bits=10))
    assert plr.leaf == Plane() and plr.stored.bits == 10
