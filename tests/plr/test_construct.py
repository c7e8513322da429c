"""Construction: accuracy, limits, rules, weights, and the best of all leaf models."""

import warnings

import numpy as np
import pytest
import shape_checks
from plr_helpers import UNIT, cone, walled

from plr_jax import Box, BuildOptions, VisibilityGraph, Workspace, construct, scenes
from plr_jax.plr import center_error, cyclic_axis, maximum_depth
from plr_jax.plr.growth import ConstructionInterrupted, grow

MAZE = scenes.maze()
ORACLE = VisibilityGraph(MAZE.workspace, MAZE.goals[0])
CONES = {"distance_fn": ORACLE, "leaf": "cone"}


def errors_of(plr, n=20_000, exact=walled):
    x = np.random.default_rng(0).random((n, plr.dim))
    x = x[np.isfinite(exact(x))]
    return np.abs(np.asarray(plr(x)) - exact(x))


def test_a_linear_function_needs_one_leaf(leaf):
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, leaf=leaf, max_leaves=100)
    assert plr.num_leaves == 1 and plr.depth == 0
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-6)
    np.testing.assert_allclose(plr.intercept, [1], atol=1e-6)
    assert construct(cone, UNIT, leaf=leaf, max_depth=0).num_leaves == 1


def test_the_papers_configuration_splits_every_cell_nine_times_in_turn():
    plr = construct(cone, UNIT, max_depth=9, options=BuildOptions(should_split=maximum_depth, split=cyclic_axis))
    assert plr.num_leaves == 512
    np.testing.assert_array_equal(np.unique(plr.cells.depth, axis=0), [[5, 4]])


def test_a_tolerance_bounds_the_error_at_the_samples_or_at_the_centers():
    plr = construct(cone, UNIT, tolerance=0.01, options=BuildOptions(should_split=center_error, split=cyclic_axis))
    middle = np.mean(plr.leaf_boxes, axis=0)
    assert np.abs(plr(middle) - cone(middle)).max() <= 0.01 + 1e-6
    assert 4 < plr.num_leaves < 100
    error = errors_of(construct(walled, UNIT, tolerance=0.004))
    assert np.quantile(error, 0.999) <= 0.004 and error.max() <= 0.008


def test_error_falls_with_leaves():
    """Planes are of second order: in 2-D four times the leaves should give about a quarter of the error."""
    errors = np.array([errors_of(construct(walled, UNIT, max_leaves=n)).mean() for n in (16, 64, 256, 1024)])
    assert np.all(errors[1:] < 0.45 * errors[:-1])


def test_slivers_of_free_space_show_their_errors():
    """A notch in the wall of a strip: its leaves had too few samples to show their error of 0.16."""
    ring = [(0, 5), (23, 5), (23, 6), (24, 6), (24, 5), (40, 5), (40, 46), (0, 46)]
    workspace = Workspace(((0, 0), (40, 46)), [ring])
    exact = VisibilityGraph(workspace, (3, 3))
    plr = construct(exact, workspace.bounds, max_bytes=4096)
    x = workspace.sample_free(20_000, seed=0)
    assert np.abs(np.asarray(plr(x)) - exact(x)).max() < 0.06


def test_the_same_seed_gives_the_same_plr_and_another_seed_another(leaf):
    """Masked distances mean inf: once the mask was lost, and what stood under it was a distance."""

    def masked(x):
        distance = walled(x)
        return np.ma.masked_array(np.where(np.isinf(distance), 0.0, distance), np.isinf(distance))

    first, again, other = (
        construct(fn, UNIT, leaf=leaf, max_leaves=12, seed=seed, options=BuildOptions(num_samples=32))
        for fn, seed in ((walled, 1), (masked, 1), (walled, 2))
    )
    assert first.to_bytes() == again.to_bytes() != other.to_bytes()


def test_a_margin_takes_samples_from_beyond_the_cell():
    seen = []
    construct(lambda x: seen.append(x) or cone(x), UNIT, max_leaves=1, options=BuildOptions(margin=0.5))
    assert np.concatenate(seen).min() < -0.4 and np.concatenate(seen).max() > 1.4


def test_weights_say_where_accuracy_matters_whatever_their_scale():
    left, even, scaled = (
        construct(walled, UNIT, max_leaves=60, options=BuildOptions(weight_fn=weight_fn))
        for weight_fn in (lambda x: np.where(x[:, 0] < 0.4, 10.0, 0.1), None, lambda x: np.full(len(x), 1e-7))
    )
    np.testing.assert_array_equal(scaled.cells.depth, even.cells.depth)
    x = np.random.default_rng(0).random((5000, 2)) * [0.4, 1]
    error = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (left, even)]
    assert error[0] < 0.5 * error[1]


@pytest.mark.parametrize("dim", [1, 3, 6])
def test_any_dimension(dim):
    plr = construct(lambda x: cone(3 * x - 1), Box(np.zeros(dim), np.ones(dim)), max_leaves=300)
    assert errors_of(plr, 2000, lambda x: cone(3 * x - 1)).mean() < 0.1 * np.sqrt(dim)


def test_many_axes_can_still_be_split():
    assert (
        construct(cone, ([-1] * 30, [1] * 30), max_leaves=20, options=BuildOptions(num_samples=64)).num_leaves == 20
    )


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"options": BuildOptions(num_samples=2)}, "num_samples must be an integer >= 3, got 2"),
        (
            {"options": BuildOptions(num_samples=4), "leaf": "continuous"},
            "num_samples must be an integer >= 5, got 4",
        ),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"leaf": 7}, r"leaf must be a leaf model or its name, one of 'plane', .*, got 7"),
        ({"leaf": "cubic"}, "one of 'plane', 'continuous', 'smooth', 'cone', got 'cubic'"),
        ({"domain": ((0, 0), (1, 0))}, "positive width"),
        ({"domain": (3 * [0], 3 * [1]), "leaf": "smooth"}, "up to 2 dimensions, got 3. Use continuous ones"),
        (
            {"domain": (7 * [0], 7 * [1]), "leaf": "continuous"},
            "up to 6 dimensions, got 7. Use planes",
        ),
        ({"distance_fn": ORACLE, "leaf": "best", "max_bytes": "x"}, "max_bytes must be an integer >= 1, got 'x'"),
        ({"leaf": "cone"}, "Use leaf='continuous' for any other"),
        ({"domain": (3 * [0], 3 * [1]), "leaf": "cone"}, "in 3 dimensions"),
        (CONES | {"max_bytes": 20}, "max_bytes=20 is too small: one leaf takes"),
        *(
            (CONES | {"options": BuildOptions(**rule)}, "or use leaf='continuous'")
            for rule in ({"weight_fn": cone}, {"should_split": maximum_depth}, {"split": cyclic_axis})
        ),
        *(
            ({"leaf": leaf, "options": BuildOptions(**rule)}, message)
            for leaf in ("plane", "continuous")
            for rule, message in (
                ({"split": lambda fit: np.full(len(fit.cells), 5)}, "split must return one axis from 0 to 1 a cell"),
                ({"split": lambda fit: np.zeros(0, int)}, "split must return one axis"),
                ({"should_split": lambda fit: np.ones(len(fit.cells) + 1)}, "should_split must return one priority"),
                ({"should_split": lambda fit: np.full(len(fit.cells), np.nan)}, "must return one priority a cell"),
            )
        ),
        *(
            ({"leaf": leaf} | options, message)
            for leaf in ("plane", "continuous", "smooth")
            for options, message in (
                ({"distance_fn": lambda x: np.full(len(x), 1e31)}, "scale them down"),
                ({"distance_fn": lambda x: np.full(len(x), 1e100)}, "scale them down"),
                ({"distance_fn": lambda x: np.full(len(x), np.inf)}, "found nothing reachable"),
                ({"distance_fn": lambda x: np.full(len(x), np.nan)}, "distance_fn gives NaN at"),
                ({"domain": ((0, 0), (1e39, 1e39))}, "The domain must be within"),
                ({"domain": ((0, 0), (1e-39, 1e-39))}, "The domain must be within"),
                ({"max_bytes": 13}, r"max_bytes=13 is too small: one leaf takes [123]\d bytes"),
            )
        ),
    ],
)
def test_bad_options_are_refused(options, message):
    """A header of 4 bytes, the domain in 5 and a checksum of 4 are 13 without any leaf."""
    with pytest.raises(ValueError, match=message):
        construct(**({"distance_fn": cone, "domain": UNIT, "max_leaves": 4} | options))


@pytest.mark.parametrize("leaf", ["plane", "best"])
def test_a_goal_that_most_free_points_do_not_reach_is_told_once(leaf):
    workspace = Workspace(((0, 0), (2, 1)), [[(0.5, 0), (0.6, 0), (0.6, 1), (0.5, 1)]])
    oracle = VisibilityGraph(workspace, (0.2, 0.5))
    with pytest.warns(UserWarning, match=r"The goal cannot be reached from 7\d % of 9\d\d free points") as told:
        construct(oracle, workspace.bounds, leaf=leaf, max_leaves=4)
    assert len(told) == 1 and (shape_checks.IS_ON or told[0].filename == __file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        construct(oracle.with_goal((1.5, 0.5)), workspace.bounds, leaf=leaf, max_leaves=4)


def mean_error(plr, oracle, x):
    return np.abs(np.asarray(plr(x)) - oracle(x)).mean()


def test_corners_that_have_no_room_are_not_named_and_the_error_is_the_smaller():
    free = np.ones((42, 42), bool)
    free[3::6, 3::6] = False  # 196 corners
    workspace = Workspace.from_mask(free)
    oracle, x = VisibilityGraph(workspace, (1, 1)), workspace.sample_free(2000, 0)
    best, cones = (construct(oracle, workspace.bounds, leaf=leaf, max_bytes=160) for leaf in ("best", "cone"))
    assert best.leaf.name == "continuous" and mean_error(best, oracle, x) < 0.8 * mean_error(cones, oracle, x)
    assert construct(ORACLE, UNIT, leaf="best", max_bytes=200).leaf.name == "cone"


@pytest.mark.parametrize("limit", [{"max_bytes": 80}, {"max_leaves": 20}])  # too few for cones alone
def test_the_least_mean_error_is_taken(limit):
    x = MAZE.workspace.sample_free(20_000, 1)
    built = [construct(ORACLE, UNIT, leaf=leaf, **limit) for leaf in ("continuous", "cone")]
    best = construct(ORACLE, UNIT, leaf="best", **limit)
    assert best.to_bytes() == min(built, key=lambda plr: mean_error(plr, ORACLE, x)).to_bytes()


def test_what_has_no_corners_has_continuous_leaves_or_planes_where_there_are_too_many_axes():
    asked = []

    def norm(x):
        asked.append(len(x))
        return np.linalg.norm(x, axis=1)

    for dim, name in ((3, "continuous"), (7, "plane")):
        box = Box([-1] * dim, [1] * dim)
        asked.clear()
        best = construct(norm, box, leaf="best", max_leaves=3)
        total = sum(asked)
        assert best.leaf.name == name and best.to_bytes() == construct(norm, box, leaf=name, max_leaves=3).to_bytes()
        assert sum(asked) == 2 * total, "nothing is asked for a choice of one"


@pytest.mark.parametrize("step", ["leaves.continuous.grow", "_construct._mean_error"])
def test_an_interrupt_keeps_the_best_so_far(step, monkeypatch):
    """While a model is grown, or while models are compared."""

    def interrupt(*_):
        raise KeyboardInterrupt

    interrupted = (lambda tree, split, limits: grow(tree, interrupt, limits)) if "grow" in step else interrupt
    monkeypatch.setattr(f"plr_jax.plr.{step}", interrupted)
    with pytest.warns(ConstructionInterrupted, match="the best one built so far"):
        assert construct(ORACLE, UNIT, leaf="best", max_bytes=80).leaf.name == "continuous"
