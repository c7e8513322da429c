"""Bounds of a coarser PLR are proven from the two alone: they hold wherever the finer one answers."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plr_helpers import UNIT, cone, points, random_contents

import plr_jax
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr.leaves import leaf_model, leaf_names

SCENE = plr_jax.scenes.maze()
ORACLE = plr_jax.VisibilityGraph(SCENE.workspace, SCENE.goals[0])


def corners_and_random(plr, n, seed):
    """Random points of the domain, and such on and beside the faces of its leaves."""
    rng = np.random.default_rng(seed)
    x = plr.domain.lo + plr.domain.width * rng.random((n, plr.dim))
    ends = np.concatenate(plr.cells.boxes(plr.domain))[rng.integers(2 * plr.num_leaves, size=n)]
    beside = np.where(rng.random((n, plr.dim)) < 0.5, ends, x).astype(np.float32)
    toward = rng.choice(np.array([-np.inf, np.inf], np.float32), beside.shape)
    return np.concatenate([x, beside, np.nextafter(beside, toward)])


def assert_within(coarse, plr, x):
    answer, (lower, upper) = np.asarray(plr(x), np.float64), map(np.asarray, coarse.bounds(x))
    known = np.isfinite(answer)
    assert known.any()
    assert (lower[known] <= np.maximum(answer[known], 0)).all() and (answer[known] <= upper[known]).all()


KINDS = [("plane", 3), ("continuous", 1), ("continuous", 2), ("cone", 2), ("smooth", 2)]


@pytest.mark.parametrize(("leaf", "dim"), KINDS)
def test_bounds_of_what_is_not_proven_are_of_its_answers(leaf, dim):
    def distance(x):
        return np.linalg.norm(x - 0.3, axis=1) + np.abs(x[:, 0] - 0.6) / 2

    plr = plr_jax.construct(distance, ([0] * dim, [1] * dim), leaf=leaf, max_bytes=1200)
    for leaf_bounds in (False, True):
        coarse = plr_jax.coarsen(plr, 300, leaf_bounds=leaf_bounds)
        assert coarse.num_bytes <= 300 and coarse.leaf.name == leaf and coarse.max_error is not None
        assert_within(coarse, plr, corners_and_random(coarse, 4000, 0))
        assert_within(coarse, plr, corners_and_random(plr, 4000, 1))


@pytest.mark.parametrize("leaf", ["plane", "continuous", "smooth"])
@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_rough_functions_hold(leaf, seed):
    contents = replace(random_contents(seed, 2, leaf.replace("smooth", "continuous")), leaf=leaf_model(leaf))
    plr = plr_of_leaves(contents)
    coarse = plr_jax.coarsen(plr, 150)
    assert_within(coarse, plr, corners_and_random(plr, 6000, seed))


def test_bounds_of_what_is_proven_are_of_the_distance():
    x = SCENE.workspace.sample_free(20_000, seed=0)
    exact = ORACLE(x)
    for leaf in ("plane", "cone"):
        plr = plr_jax.construct(ORACLE, SCENE.workspace.bounds, leaf=leaf, max_bytes=4000, certified=True)
        coarse = plr_jax.coarsen(plr, 1500)
        lower, upper = map(np.asarray, coarse.bounds(x))
        assert (lower <= exact).all() and (exact <= upper).all()
        assert np.abs(np.asarray(coarse(x)) - exact).max() <= coarse.max_error


def test_folded_and_periodic_plrs_are_coarsened():
    box = plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), periodic=(False, False, True))
    plr = plr_jax.construct(plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1), box, max_bytes=3000, leaf="continuous")
    coarse = plr_jax.coarsen(plr, 500)
    assert coarse.num_bytes <= 500
    rng = np.random.default_rng(0)
    x = box.lo + box.width * rng.random((20_000, 3))
    for each in (x, x.astype(np.float32), x + np.array([0, 0, 2 * np.pi])):
        assert_within(coarse, plr, each)
    again = plr_jax.from_bytes(coarse.to_bytes())
    np.testing.assert_array_equal(again.bounds(x[:100])[0], coarse.bounds(x[:100])[0])


@pytest.mark.usefixtures("unchecked_types")
def test_what_cannot_be_coarsened_is_refused():
    plr = plr_jax.construct(cone, UNIT, max_leaves=30)
    with pytest.raises(ValueError, match="Only a PLR can be coarsened"):
        plr_jax.coarsen(cone, 300)
    with pytest.raises(ValueError, match="max_bytes must be an integer >= 1, got 0"):
        plr_jax.coarsen(plr, 0)


@pytest.mark.parametrize(("leaf", "label"), [("plane", ""), *((leaf, "maze --goal=0,0") for leaf in leaf_names())])
def test_a_budget_that_is_too_small_is_told_with_one_that_is_enough(leaf, label):
    plr = plr_jax.construct(cone, UNIT, leaf=leaf, max_leaves=30).with_label(label)
    for max_bytes in (1, 20):
        with pytest.raises(ValueError, match=f"max_bytes={max_bytes} is too small: one leaf .* takes") as told:
            plr_jax.coarsen(plr, max_bytes)
    least = int(re.search(r"takes (\d+) bytes; allow at least that", str(told.value))[1])
    coarse = plr_jax.coarsen(plr, least)
    assert coarse.num_bytes <= least and coarse.label == label and coarse.max_error is not None
    with pytest.raises(ValueError, match="is too small"):
        plr_jax.coarsen(plr, least - 2)


def test_a_coarser_plr_of_a_plr_that_fits_is_as_good():
    plr = plr_jax.construct(lambda x: 1 + x[:, 0] / 2 + x[:, 1] / 4, UNIT, max_leaves=8)
    coarse = plr_jax.coarsen(plr, 200)
    assert coarse.max_error < 1e-2
    x = points(1000, 0)
    np.testing.assert_allclose(coarse(x), plr(x), rtol=0, atol=coarse.max_error)


@pytest.mark.parametrize("leaf", leaf_names())
def test_what_fits_stays_what_it_is(leaf):
    bounds = SCENE.workspace.bounds
    proven = plr_jax.construct(ORACLE, bounds, leaf=leaf, max_bytes=600, certified=True).with_label("maze")
    for max_bytes in (proven.num_bytes, 10**6):
        for leaf_bounds in (False, True):
            assert plr_jax.coarsen(proven, max_bytes, leaf_bounds=leaf_bounds) is proven
    assert plr_jax.coarsen(proven, proven.num_bytes - 1).num_bytes < proven.num_bytes
    plr = plr_jax.construct(ORACLE, bounds, leaf=leaf, max_bytes=600).with_label("maze")
    x = corners_and_random(plr, 4000, 0)
    for leaf_bounds in (False, True):
        same = plr_jax.coarsen(plr, 4000, leaf_bounds=leaf_bounds)
        assert same.label == "maze" and same.num_leaves == plr.num_leaves and same.max_error < 2e-3
        np.testing.assert_array_equal(same(x), plr(x))
        assert_within(same, plr, x)
    assert plr_jax.coarsen(plr, plr.num_bytes).num_bytes <= plr.num_bytes  # without room for a proof


@pytest.mark.parametrize(("leaf", "dim"), [("plane", 2), ("cone", 4)])
def test_every_budget_is_kept_and_used(leaf, dim):
    def distance(x):
        return np.linalg.norm(x - 0.3, axis=1) + np.sin(5 * x[:, 0]) / 4

    plr = plr_jax.construct(distance, ([0] * dim, [1] * dim), leaf=leaf, max_bytes=4000)
    for max_bytes in (300, 748):
        for leaf_bounds in (False, True):
            coarse = plr_jax.coarsen(plr, max_bytes, leaf_bounds=leaf_bounds)
            assert 0.8 * max_bytes < coarse.num_bytes <= max_bytes
