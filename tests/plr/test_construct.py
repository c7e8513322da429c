"""Construction: accuracy, limits, rules of splitting, the order of splits, and the best of all leaf models."""

import heapq
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shape_checks
from plr_helpers import UNIT, cone, walled

from plr_jax import Box, BuildOptions, GridGraph, VisibilityGraph, VoxelGraph, Workspace, construct, scenes
from plr_jax.plr import Plane, best_axis, center_error, cyclic_axis, growth, largest_error, maximum_depth
from plr_jax.plr._construct import _models_to_try
from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import ConstructionInterrupted, grow
from plr_jax.plr.leaves import leaf_names
from plr_jax.plr.leaves.base import GivenLimits, check_limits
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tree import Cells

MAZE = scenes.maze()
ORACLE = VisibilityGraph(MAZE.workspace, MAZE.goals[0])
CONES = {"distance_fn": ORACLE, "leaf": "cone"}


def errors_of(plr, n=20_000, exact=walled):
    x = np.random.default_rng(0).random((n, plr.dim))
    x = x[np.isfinite(exact(x))]
    return np.abs(np.asarray(plr(x)) - exact(x))


def errors_in_free_space(plr, oracle, workspace):
    x = workspace.sample_free(10_000, 1)
    return np.abs(np.asarray(plr(x)) - oracle(x))


def test_a_linear_function_needs_one_leaf(leaf):
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, leaf=leaf, max_leaves=100)
    assert plr.num_leaves == 1 and plr.depth == 0
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-6)
    np.testing.assert_allclose(plr.intercept, [1], atol=1e-6)
    assert construct(cone, UNIT, leaf=leaf, max_depth=0).num_leaves == 1


def test_papers_configuration_halves_all_cells_nine_times():
    plr = construct(cone, UNIT, max_depth=9, options=BuildOptions(should_split=maximum_depth, split=cyclic_axis))
    assert plr.num_leaves == 512
    np.testing.assert_array_equal(np.unique(plr.cells.depth, axis=0), [[5, 4]])


def test_tolerance_bounds_the_error_at_samples_or_centers():
    plr = construct(cone, UNIT, tolerance=0.01, options=BuildOptions(should_split=center_error, split=cyclic_axis))
    middle = np.mean(plr.leaf_boxes, axis=0)
    assert np.abs(plr(middle) - cone(middle)).max() <= 0.01 + 1e-6
    assert 4 < plr.num_leaves < 100
    error = errors_of(construct(walled, UNIT, tolerance=0.004))
    assert np.quantile(error, 0.999) <= 0.004 and error.max() <= 0.008


def test_error_falls_with_leaves():
    """Planes are of second order: in 2-D four times the leaves should give about a quarter of the error."""
    errors = np.array([errors_of(construct(walled, UNIT, max_leaves=n)).mean() for n in (16, 64, 256)])
    assert np.all(errors[1:] < 0.45 * errors[:-1])


def test_errors_in_slivers_of_free_space_are_small():
    """A notch in the wall of a strip. Its leaves once had too few samples to show their error of 0.16."""
    ring = [(0, 5), (23, 5), (23, 6), (24, 6), (24, 5), (40, 5), (40, 46), (0, 46)]
    workspace = Workspace(((0, 0), (40, 46)), [ring])
    exact = VisibilityGraph(workspace, (3, 3))
    plr = construct(exact, workspace.bounds, max_bytes=4096)
    assert errors_in_free_space(plr, exact, workspace).max() < 0.06


def test_seeds_decide_the_bytes():
    """Masked distances mean inf. Once the mask was lost, and masked numbers were distances."""

    def masked(x):
        distance = walled(x)
        return np.ma.masked_array(np.where(np.isinf(distance), 0.0, distance), np.isinf(distance))

    limits = {"leaf": "continuous", "max_leaves": 12, "options": BuildOptions(num_samples=32)}
    first, again, other = (construct(f, UNIT, seed=i, **limits) for f, i in ((walled, 1), (masked, 1), (walled, 2)))
    assert first.to_bytes() == again.to_bytes() != other.to_bytes()


def test_margin_samples_beyond_the_cell():
    seen = []
    construct(lambda x: seen.append(x) or cone(x), UNIT, max_leaves=1, options=BuildOptions(margin=0.5))
    assert np.concatenate(seen).min() < -0.4 and np.concatenate(seen).max() > 1.4


def test_a_wide_margin_finds_planes_for_cells_without_samples():
    # Cells whose samples lie beyond them are not cached, nor are the cells that contain them.
    plr = construct(ORACLE, MAZE.workspace.bounds, max_leaves=64, options=BuildOptions(margin=0.3))
    assert errors_in_free_space(plr, ORACLE, MAZE.workspace).mean() < 0.05


def test_weights_reduce_errors_whatever_their_scale():
    left, even, scaled = (
        construct(walled, UNIT, max_leaves=60, options=BuildOptions(weight_fn=weight_fn))
        for weight_fn in (lambda x: np.where(x[:, 0] < 0.4, 10.0, 0.1), None, lambda x: np.full(len(x), 1e-7))
    )
    np.testing.assert_array_equal(scaled.cells.depth, even.cells.depth)
    x = np.random.default_rng(0).random((5000, 2)) * [0.4, 1]
    error = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (left, even)]
    assert error[0] < 0.5 * error[1]


def rule(**options):
    return {"options": BuildOptions(**options)}


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"options": {"num_samples": 9}}, r"options must be BuildOptions\(...\), got {"),
        (rule(num_samples=2), "num_samples must be an integer >= 3, got 2"),
        (rule(num_samples=4) | {"leaf": "continuous"}, "samples must be an integer >= 5, got 4"),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"leaf": 7}, "leaf must be 'plane', .* or 'best', got 7"),
        ({"leaf": "cones"}, f"{', '.join(map(repr, leaf_names()))} or 'best', got 'cones'. Did you mean 'cone'"),
        ({"domain": ((0, 0), (1, 0))}, "positive width"),
        ({"domain": (3 * [0], 3 * [1]), "leaf": "smooth"}, "up to 2 dimensions, got 3. Use continuous leaves"),
        ({"domain": (7 * [0], 7 * [1]), "leaf": "continuous"}, "up to 6 dimensions, got 7. Use planes"),
        ({"leaf": "cone"}, "Use leaf='continuous' for any other"),
        ({"domain": (3 * [0], 3 * [1]), "leaf": "cone"}, "in 3 dimensions"),
        (CONES | {"max_bytes": 20}, "max_bytes=20 is too small: one leaf takes"),
        (CONES | rule(weight_fn=cone), "or use leaf='continuous'"),
        (CONES | rule(should_split=maximum_depth), "or use leaf='continuous'"),
        (CONES | rule(split=cyclic_axis), "or use leaf='continuous'"),
        *(
            ({"leaf": leaf} | options, message)
            for leaf in ("plane", "continuous")
            for options, message in (
                (rule(split=lambda fit: np.full(len(fit.cells), 5)), "split must return one axis from 0 to 1 a cell"),
                (rule(should_split=lambda fit: np.ones(len(fit.cells) + 1)), "should_split must return one priority"),
                (rule(should_split=lambda fit: np.full(len(fit.cells), np.nan)), "must return one priority a cell"),
                ({"distance_fn": lambda x: np.full(len(x), 1e31)}, "scale them down"),
                ({"distance_fn": lambda x: np.full(len(x), np.inf)}, "found nothing reachable"),
                ({"distance_fn": lambda x: np.full(len(x), np.nan)}, "distance_fn gives NaN at"),
                ({"domain": ((0, 0), (1e-39, 1e-39))}, "A domain's coordinates must be below"),
                ({"max_bytes": 13}, r"max_bytes=13 is too small: one leaf takes [123]\d bytes"),
            )
        ),
    ],
)
def test_bad_options_raise(options, message):
    """A header of 4 bytes, the domain in 5 and a checksum of 4 are 13 without any leaf."""
    with pytest.raises(ValueError, match=message):
        construct(**({"distance_fn": cone, "domain": UNIT, "max_leaves": 4} | options))


@pytest.mark.parametrize("leaf", ["plane", "best"])
def test_goal_cut_off_from_most_free_space_warns_once(leaf):
    workspace = Workspace(((0, 0), (2, 1)), [[(0.5, 0), (0.6, 0), (0.6, 1), (0.5, 1)]])
    oracle = VisibilityGraph(workspace, (0.2, 0.5))
    with pytest.warns(UserWarning, match=r"The goal cannot be reached from about 7\d% of free space") as caught:
        construct(oracle, workspace.bounds, leaf=leaf, max_leaves=40)
    assert len(caught) == 1 and (shape_checks.IS_ON or caught[0].filename == __file__)
    with pytest.warns(UserWarning, match=r"In up to about [34]\d? % of the domain, the PLR answers a finite number"):
        construct(oracle.with_goal((1.5, 0.5)), workspace.bounds, leaf=leaf, max_leaves=2)


CORNER = Workspace(((0, 0), (10, 10)), [[(0, 5), (5, 0), (5.3, 0), (0, 5.3)]])  # a slanted wall cuts a corner off


@pytest.mark.parametrize("certified", [False, True])
@pytest.mark.parametrize("leaf", leaf_names())
def test_points_that_cannot_reach_the_goal_answer_inf(leaf, certified):
    """Points within a 64th of the domain of others may answer a number."""
    oracle = VisibilityGraph(CORNER, (8, 8))
    plr = construct(oracle, CORNER.bounds, leaf=leaf, max_bytes=1500, certified=certified)
    x = CORNER.sample_free(4000, seed=0)
    reaches, is_far = CORNER.reachable(x, (8, 8)), (5.3 - x.sum(axis=1)) / 2**0.5 > 10 / 64
    answers = plr.numpy()(x)
    assert np.isinf(answers[is_far]).all() and np.isfinite(answers[reaches]).all() and plr.num_bytes <= 1500
    distances = oracle(x[reaches])
    assert np.abs(answers[reaches] - distances).mean() < 5e-3
    if certified:
        lower, upper = plr.numpy().bounds(x[reaches])
        assert (lower <= distances).all() and (distances <= upper).all() and plr.max_error < 0.3


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
def test_hardly_reached_domains_get_many_leaves(leaf):
    """Two roads of one cell in 90 x 90, of a function that knows them or not, and three tunnels in 24 x 24 x 24."""
    roads, tunnels = np.zeros((90, 90), bool), np.zeros((24, 24, 24), bool)
    roads[40] = roads[:, 13] = tunnels[:, 11, 5] = tunnels[7, :, 5] = tunnels[7, 11, :] = True
    grid = GridGraph(roads, (13.5, 40.5))
    for oracle, fn in ((grid, grid), (grid, grid.__call__), (VoxelGraph(tunnels, (7.5, 11.5, 5.5)), None)):
        domain = Box(np.zeros(oracle.dim), np.array(oracle.free.shape))
        plr = construct(fn or oracle, domain, leaf=leaf, max_leaves=300)
        x = np.argwhere(oracle.free if oracle.dim > 2 else oracle.free.T) + 0.5
        error = np.abs(plr.numpy()(x) - oracle(x))
        assert error.mean() < 0.02 * oracle(x).max() and plr.num_leaves > 100


# The best of all leaf models.


BEST = ["continuous", "smooth", "cone"]
PROVEN = ["plane", "continuous", "smooth"]


@pytest.mark.parametrize(
    ("dim", "num_corners", "proof", "max_bytes", "only_bytes", "expected"),
    [
        (2, None, Proof.NONE, 700, True, ["continuous"]),
        (6, None, Proof.NONE, 700, True, ["continuous"]),
        (7, None, Proof.NONE, 700, True, ["plane"]),
        (2, None, Proof.LEAVES, 700, True, PROVEN),
        (2, 50, Proof.NONE, 700, True, ["cone"]),  # a corner takes 7 bytes, all take at most half of the budget
        (2, 50, Proof.NONE, 700, False, BEST),
        (2, 51, Proof.NONE, 700, True, BEST),
        (2, 400, Proof.NONE, 700, True, BEST),  # at most four times the budget
        (2, 401, Proof.NONE, 700, True, ["continuous"]),
        (2, 400, Proof.LEAVES, 700, True, [*PROVEN, "cone"]),
        (2, 401, Proof.LEAVES, 700, True, PROVEN),
        (2, 401, Proof.NONE, None, False, BEST),
        (2, 401, Proof.NONE, 0, False, BEST),
    ],
)
def test_best_tries_models_that_fit(dim, num_corners, proof, max_bytes, only_bytes, expected):
    root = None
    if num_corners is not None:
        distances = np.append(np.zeros(num_corners), np.inf)  # an unreachable corner takes no bytes
        root = SimpleNamespace(sources=SimpleNamespace(distances=distances))
    assert _models_to_try(root, Box(dim * [0], dim * [1]), proof, max_bytes, only_bytes) == expected


def test_best_leaves_with_own_rules_are_no_cones():
    options = BuildOptions(weight_fn=lambda x: np.ones(len(x)))
    plr = construct(ORACLE, MAZE.workspace.bounds, leaf="best", max_leaves=4, options=options)
    assert plr.leaf.name in ("continuous", "smooth")


@pytest.mark.parametrize("limit", [{"max_bytes": 66}, pytest.param({"max_leaves": 20}, marks=pytest.mark.full)])
def test_best_leaves_have_the_smallest_error(limit):
    """The product of mean and largest error. Of 20 leaves, cones have the smallest mean, but err by far the most."""
    plrs = [construct(ORACLE, UNIT, leaf=leaf, **limit) for leaf in ("continuous", "smooth", "cone")]
    errors = [errors_in_free_space(plr, ORACLE, MAZE.workspace) for plr in plrs]
    best = plrs[np.argmin([error.mean() * error.max() for error in errors])]
    assert construct(ORACLE, UNIT, leaf="best", **limit).to_bytes() == best.to_bytes()


@pytest.mark.parametrize("step", ["leaves.continuous.grow", "_construct._error_of"])
def test_interrupt_keeps_the_best_model_so_far(step, monkeypatch):
    """While a model is grown, or while models are compared."""

    def interrupt(*_):
        raise KeyboardInterrupt

    interrupted = (lambda tree, split, limits: grow(tree, interrupt, limits)) if "grow" in step else interrupt
    monkeypatch.setattr(f"plr_jax.plr.{step}", interrupted)
    with pytest.warns(ConstructionInterrupted, match="the best one built so far"):
        assert construct(ORACLE, UNIT, leaf="best", max_bytes=80).leaf.name == "continuous"


AXIS_DEPTH = 7  # in the plane, for files of up to 2,048 bytes


def best_first_twin(distance_fn, max_leaves):
    """Best-first construction with a priority queue, one leaf at a time: the leaves."""
    patterns = [sample_pattern(2, num_samples, 0.0, 0) for num_samples in (192, 8 * 192)]
    sampler = Sampler(distance_fn, UNIT, None, *patterns, AXIS_DEPTH)

    def push(queue, cells):
        for cell in range(len(cells)):
            fit = sampler(cells[[cell]])
            fit = replace(sampler, pattern=sampler.dense_pattern)(cells[[cell]]) if fit.is_hardly_seen[0] else fit
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
@pytest.mark.parametrize("max_leaves", [1, 2, 50])
def test_batched_growth_equals_a_priority_queue(distance_fn, max_leaves, monkeypatch):
    plr = construct(distance_fn, UNIT, max_leaves=max_leaves)
    found = {(*depth, *position) for depth, position in zip(plr.cells.depth, plr.cells.position, strict=True)}
    assert found == best_first_twin(distance_fn, max_leaves)
    monkeypatch.setattr(growth, "_SAMPLES_AT_ONCE", 300)
    assert construct(distance_fn, UNIT, max_leaves=max_leaves).to_bytes() == plr.to_bytes()


def test_files_fill_the_budget_of_bytes_with_few_errors():
    """The number of bits that is chosen errs about as little as the best fixed one."""
    error = {}
    for bits in (None, 8, 12, 16, 32):
        for budget in (100, 1000):
            plr = construct(walled, UNIT, max_bytes=budget, leaf=Plane(coefficient_bits=bits))
            assert plr.num_bytes <= budget and (budget < 1000 or plr.num_bytes > budget - 20)
        error[bits] = errors_of(plr, 5000).mean()
    assert error[None] < 1.1 * min(error[8], error[12], error[16])
    assert error[None] < 0.7 * error[32]
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, max_bytes=2048)  # where leaves need no bytes
    assert plr.num_leaves == 1
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-3)


def limits(dim=2, least_bytes: int | float = 2, has_deep_trees=False, **given):
    size = lambda dim, leaves: 4 * leaves  # noqa: E731
    model = SimpleNamespace(least_bytes=least_bytes, has_deep_trees=has_deep_trees, bytes_without_budget=size)
    return check_limits(model, dim, Proof.NONE, 13, GivenLimits(**given))


@pytest.mark.parametrize(
    ("given", "expected"),  # leaves, depth, bytes, tolerance
    [
        ({}, (512, 60, np.inf, 0)),
        ({"max_depth": 9, "max_leaves": 50, "max_bytes": 4000, "tolerance": 0.1}, (50, 9, 4000, 0.1)),
        # Not more leaves than fit into the budget: by default, each takes at least two bytes.
        ({"max_bytes": 2048}, (1024, 60, 2048, 0)),
        ({"max_bytes": 2048, "least_bytes": 1}, (2048, 60, 2048, 0)),
        ({"max_bytes": 2048, "least_bytes": 0.5}, (4096, 60, 2048, 0)),
        ({"max_bytes": 2048, "max_leaves": 17}, (17, 60, 2048, 0)),
    ],
)
def test_default_limits(given, expected):
    found = limits(**given)
    assert (found.max_leaves, found.max_depth, found.max_bytes, found.tolerance) == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, [(2048, 7), (2049, 8), (8192, 8), (8193, 9), (32768, 9), (32769, 14)]),
        ({"least_bytes": 1}, [(1024, 7), (2048, 8), (16384, 9), (16385, 14)]),  # twice the leaves
        ({"least_bytes": 0.5}, [(256, 7), (512, 7), (513, 8)]),
        ({"least_bytes": 0.5, "has_deep_trees": True}, [(256, 14)]),
        ({"max_leaves": 512}, [(10**6, 7), (None, 7)]),
        ({"max_leaves": 513}, [(None, 8)]),
        ({"max_leaves": 512, "least_bytes": 0.5, "has_deep_trees": True}, [(None, 14)]),
        ({"tolerance": 0.1}, [(None, 14)]),
        ({"max_depth": 20}, [(None, 14)]),
        ({"dim": 3}, [(2048, 9)]),
        ({"dim": 10}, [(2048, 2)]),
        ({"dim": 40}, [(2048, 1)]),
    ],
)
def test_default_max_axis_depth_follows_size_limits(given, expected):
    for max_bytes, depth in expected:
        assert limits(**given, max_bytes=max_bytes).max_axis_depth == depth


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"max_depth": -1}, "max_depth must be an integer >= 0, got -1"),
        ({"max_depth": 2.5}, "max_depth must be an integer >= 0, got 2.5"),
        ({"max_depth": 61}, "max_depth must be at most 60, got 61"),
        ({"max_depth": 60}, "would need about .* GiB; this machine has"),
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"max_leaves": 10**12}, r"The limits allow 1e\+12 leaves or more, .*Reduce max_depth"),
        ({"max_bytes": 0}, "max_bytes must be an integer >= 1"),
        ({"tolerance": -0.1}, "tolerance must be a finite number of at least 0"),
        ({"tolerance": np.nan}, "tolerance must be a finite number of at least 0"),
        ({"tolerance": np.inf}, "tolerance must be a finite number of at least 0"),
    ],
)
def test_limits_out_of_range_raise(given, message):
    with pytest.raises(ValueError, match=message):
        limits(**given)


def test_growth_ends_without_splits_or_at_an_interrupt():
    assert growth.grow([0], lambda tree: [*tree, 0] if len(tree) < 5 else None, limits(max_leaves=100)) == [0] * 5

    def split_some(tree):
        if len(tree) == 3:
            raise KeyboardInterrupt
        return [*tree, 0]

    with pytest.warns(ConstructionInterrupted, match="Interrupted at 3 leaves: the PLR is the one built so far"):
        assert growth.grow([0], split_some, limits(max_leaves=100)) == [0] * 3


def test_too_small_budget_says_the_least_and_can_be_pickled():
    found = limits(max_bytes=40)
    found.require_room(40)
    with pytest.raises(growth.BudgetTooSmall, match=r"^max_bytes=40 is too small: one leaf takes 41 bytes") as caught:
        found.require_room(41)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.num_bytes) == (str(caught.value), 41)


def test_every_prefix_of_the_order_of_splits_is_a_tree():
    """Node 2 has the key of its parent, node 0, which comes first."""
    key = np.array([0.9, 0.2, 0.9, growth.NEVER, 0.1])
    child = np.array([1, -1, 3, -1, -1])
    cells = Cells.root(2)[np.zeros(5, int)]
    tree = growth.Nodes(cells, np.zeros((5, 3)), np.zeros(5), np.zeros(5), np.zeros(5, int), key, child, key > 1)
    order = growth.split_order(tree)
    assert order.tolist() == [0, 2, 1, 4] and len(tree) == 3
    assert [tree.leaves_of_splits(order[:n]).tolist() for n in range(3)] == [[0], [1, 2], [1, 3, 4]]


@pytest.mark.parametrize(("dim", "most"), [(3, 0.02), (6, 0.1)])
def test_planes_approximate_cones_in_many_dimensions(dim, most):
    x = np.random.default_rng(0).random((2000, dim))
    plr = construct(lambda x: cone(3 * x - 1), Box(np.zeros(dim), np.ones(dim)), max_leaves=300)
    assert np.abs(plr.numpy()(x) - cone(3 * x - 1)).mean() < most
