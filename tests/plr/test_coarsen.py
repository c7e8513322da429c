"""Bounds of a coarser PLR are proven from the two alone; files of several PLRs begin with the coarser ones."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plr_helpers import UNIT, cone, points, random_contents

import plr_jax
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import decode_cells
from plr_jax.plr.file.container import MOST_LAYERS
from plr_jax.plr.leaves import leaf_model

SCENE = plr_jax.scenes.maze()
ORACLE = plr_jax.VisibilityGraph(SCENE.workspace, SCENE.goals[0])
X = points(500, 0)


def corners_and_random(plr, seed, n=3000):
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


@pytest.mark.parametrize(("leaf", "dim"), [("plane", 3), ("continuous", 1), ("smooth", 2), ("cone", 2), ("cone", 4)])
def test_bounds_of_what_is_not_proven_are_of_its_answers_and_budgets_are_kept_and_used(leaf, dim):
    def distance(x):
        return np.linalg.norm(x - 0.3, axis=1) + np.sin(5 * x[:, 0]) / 4

    size, *budgets = (400, 150, 220) if leaf == "smooth" else (700, 200, 300)
    plr = plr_jax.construct(distance, ([0] * dim, [1] * dim), leaf=leaf, max_bytes=size).with_label("maze")
    for max_bytes, leaf_bounds in zip(budgets, (False, True), strict=True):
        coarse = plr_jax.coarsen(plr, max_bytes, leaf_bounds=leaf_bounds)
        assert coarse.num_bytes <= max_bytes and (leaf == "smooth" or coarse.num_bytes > 0.8 * max_bytes)
        assert coarse.leaf.name == leaf and coarse.label == "maze" and coarse.max_error is not None
        for each in (coarse, plr):
            assert_within(coarse, plr, corners_and_random(each, max_bytes))
    x = corners_and_random(plr, 0)
    same = plr_jax.coarsen(plr, 4000, leaf_bounds=True)
    assert same.label == "maze" and same.num_leaves == plr.num_leaves and same.max_error < 3e-3
    np.testing.assert_array_equal(same(x), plr(x))
    assert_within(same, plr, x)
    assert plr_jax.coarsen(plr, plr.num_bytes).num_bytes <= plr.num_bytes  # without room for a proof


@pytest.mark.parametrize("leaf", ["plane", "continuous", "smooth"])
@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_rough_functions_hold(leaf, seed):
    contents = replace(random_contents(seed, 2, leaf.replace("smooth", "continuous")), leaf=leaf_model(leaf))
    plr = plr_of_leaves(contents)
    assert_within(plr_jax.coarsen(plr, 150), plr, corners_and_random(plr, seed))


@pytest.mark.parametrize("leaf", ["plane", "cone"])
def test_bounds_of_what_is_proven_are_of_the_distance(leaf):
    x = SCENE.workspace.sample_free(9000, seed=0)
    plr = plr_jax.construct(ORACLE, SCENE.workspace.bounds, leaf=leaf, max_bytes=1200, certified=True)
    for leaf_bounds in (False, True):
        assert plr_jax.coarsen(plr, plr.num_bytes, leaf_bounds=leaf_bounds) is plr
    coarse = plr_jax.coarsen(plr, 500)
    lower, upper = map(np.asarray, coarse.bounds(x))
    assert (lower <= ORACLE(x)).all() and (ORACLE(x) <= upper).all()
    assert np.abs(np.asarray(coarse(x)) - ORACLE(x)).max() <= coarse.max_error


def test_folded_and_periodic_plrs_are_coarsened():
    box = plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), periodic=(False, False, True))
    plr = plr_jax.construct(plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1), box, max_bytes=500, leaf="continuous")
    coarse = plr_jax.coarsen(plr, 250)
    assert coarse.num_bytes <= 250
    x = box.lo + box.width * np.random.default_rng(0).random((9000, 3))
    for each in (x, x.astype(np.float32), x + np.array([0, 0, 2 * np.pi])):
        assert_within(coarse, plr, each)
    np.testing.assert_array_equal(plr_jax.from_bytes(coarse.to_bytes()).bounds(x), coarse.bounds(x))


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(("leaf", "label"), [("plane", ""), ("smooth", "maze --goal=0,0")])
def test_what_cannot_be_coarsened_is_refused_and_a_budget_that_is_too_small_with_one_that_is_enough(leaf, label):
    plr = plr_jax.construct(cone, UNIT, leaf=leaf, max_leaves=30).with_label(label)
    with pytest.raises(ValueError, match="Only a PLR can be coarsened"):
        plr_jax.coarsen(cone, 300)
    with pytest.raises(ValueError, match="max_bytes must be an integer >= 1, got 0"):
        plr_jax.coarsen(plr, 0)
    for max_bytes in (1, 20):
        with pytest.raises(ValueError, match=f"max_bytes={max_bytes} is too small: one leaf .* takes") as told:
            plr_jax.coarsen(plr, max_bytes)
    least = int(re.search(r"takes (\d+) bytes; allow at least that", str(told.value))[1])
    coarse = plr_jax.coarsen(plr, least)
    assert coarse.num_bytes <= least and coarse.label == label and coarse.max_error is not None
    with pytest.raises(ValueError, match="is too small"):
        plr_jax.coarsen(plr, least - 2)


@pytest.fixture(scope="module")
def layers():
    """PLRs of one map, of all models and kinds of proofs, each of more bytes than the one before."""
    options = [{"certified": True}, {}, {"certified": True, "leaf_bounds": True}, {}]
    kinds = zip(("cone", "continuous", "plane", "smooth"), (200, 300, 600, 900), options, strict=True)
    return [plr_jax.construct(ORACLE, UNIT, leaf=leaf, max_bytes=size, **rest) for leaf, size, rest in kinds]


def test_every_prefix_that_ends_at_a_mark_is_the_coarser_plr(layers, tmp_path):
    whole = plr_jax.progressive([layers[0].with_label("another"), *layers[1:]]).with_label("walls")
    data = whole.to_bytes()
    assert whole.num_bytes == len(data) <= sum(plr.num_bytes for plr in layers)  # whose headers are saved
    assert whole.label == "walls" and len(whole.file_marks) == 3
    assert whole.with_label("").with_label("walls").to_bytes() == data
    plr_jax.save(whole, tmp_path / "whole.plr")
    assert plr_jax.load(tmp_path / "whole.plr").to_bytes() == data
    np.testing.assert_array_equal(whole.numpy()(X), layers[-1].numpy()(X))
    assert (
        plr_jax.progressive([layers[2], plr_jax.progressive(layers)]).num_bytes < 1600
    )  # only the last layers count
    for number, (end, plr) in enumerate(zip((*whole.file_marks, len(data)), layers, strict=True)):
        cut = plr_jax.from_bytes(data[:end])
        assert cut.to_bytes() == data[:end] and cut.num_bytes == end and cut.leaf == plr.leaf
        assert cut.label == "walls" and cut.file_marks == whole.file_marks[:number] and cut.domain == plr.domain
        np.testing.assert_array_equal(cut(X), plr(X))
        np.testing.assert_array_equal(decode_cells(data[:end]).position, plr.cells.position)
        assert cut.max_error == plr.max_error
        if plr.max_error is not None:
            np.testing.assert_array_equal(cut.bounds(X), plr.bounds(X))


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda layers: [], "1 to 33"),
        (lambda layers: layers[:1] * (MOST_LAYERS + 2), "1 to 33"),
        (lambda layers: layers[::-1], "more bytes than the one before"),
        (lambda layers: [layers[0], layers[0]], "more bytes than the one before"),
        (lambda layers: [layers[0], plr_jax.construct(cone, ([0, 0], [1, 2]), max_leaves=50)], "one domain"),
        (lambda layers: [layers[0], 3], "must be PLRs"),
        (lambda layers: 3, "must be a list"),
    ],
)
def test_what_is_no_list_of_finer_and_finer_plrs_is_refused(layers, given, message):
    with pytest.raises(ValueError, match=message):
        plr_jax.progressive(given(layers))
