import pickle
import warnings
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, cone, sampler_of, walled

from plr_jax.plr import BuildOptions, ConstructionInterrupted, construct, growth
from plr_jax.plr.certificate import Proof
from plr_jax.plr.leaves.base import check_limits
from plr_jax.plr.tree import Cells

pytestmark = pytest.mark.usefixtures("unchecked_types")  # a namespace stands for a leaf model


def limits(dim=2, least_bytes: int | float = 2, has_deep_trees=False, **given):
    most = (given.get(name) for name in ("max_depth", "max_leaves", "max_bytes", "tolerance"))
    size = lambda dim, leaves: 4 * leaves  # noqa: E731
    model = SimpleNamespace(least_bytes=least_bytes, has_deep_trees=has_deep_trees, bytes_without_budget=size)
    return check_limits(model, dim, *most, Proof.NONE, 13)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, (512, 60, np.inf, 0)),
        ({"max_depth": 9, "max_leaves": 50, "max_bytes": 4000, "tolerance": 0.1}, (50, 9, 4000, 0.1)),
        # No more than the tables of that budget have room for: 2,048 bytes of at least two a leaf.
        ({"max_bytes": 2048}, (1024, 60, 2048, 0)),
        ({"max_bytes": 2048, "least_bytes": 1}, (2048, 60, 2048, 0)),
        ({"max_bytes": 2048, "least_bytes": 0.5}, (4096, 60, 2048, 0)),
        ({"max_bytes": 2048, "max_leaves": 17}, (17, 60, 2048, 0)),
    ],
)
def test_a_budget_of_bytes_bounds_the_leaves_and_no_limit_means_512(given, expected):
    found = limits(**given)
    assert (found.max_leaves, found.max_depth, found.max_bytes, found.tolerance) == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, [(2048, 7), (2049, 8), (8192, 8), (8193, 9), (32768, 9), (32769, 14)]),
        ({"least_bytes": 1}, [(1024, 7), (2048, 8), (16384, 9), (16385, 14)]),  # twice the leaves
        ({"least_bytes": 0.5}, [(256, 7), (512, 7), (513, 8)]),
        ({"least_bytes": 0.5, "has_deep_trees": True}, [(256, 13)]),
        ({"max_leaves": 512}, [(10**6, 7), (None, 7)]),
        ({"max_leaves": 513}, [(None, 8)]),
        ({"max_leaves": 512, "least_bytes": 0.5, "has_deep_trees": True}, [(None, 13)]),
        ({"tolerance": 0.1}, [(None, 14)]),
        ({"max_depth": 20}, [(None, 14)]),
        ({"dim": 3}, [(2048, 9)]),
        ({"dim": 10}, [(2048, 2)]),
        ({"dim": 40}, [(2048, 1)]),
    ],
)
def test_how_often_an_axis_may_be_halved(given, expected):
    assert [limits(**given, max_bytes=most).max_axis_depth for most, _ in expected] == [
        depth for _, depth in expected
    ]


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"max_depth": -1}, "max_depth must be an integer >= 0, got -1"),
        ({"max_depth": 2.5}, "max_depth must be an integer >= 0, got 2.5"),
        ({"max_depth": 61}, "max_depth must be at most 60, got 61"),
        ({"max_depth": 60}, "would need about .* GiB; this machine has"),
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"max_leaves": 10**12}, "would need about"),
        ({"max_bytes": 0}, "max_bytes must be an integer >= 1"),
        ({"tolerance": -0.1}, "tolerance must be a finite number of at least 0"),
        ({"tolerance": np.nan}, "tolerance must be a finite number of at least 0"),
        ({"tolerance": np.inf}, "tolerance must be a finite number of at least 0"),
    ],
)
def test_limits_out_of_range_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        limits(**given)


def test_a_tree_larger_than_memory_is_refused():
    growth.check_memory(1e5)
    with pytest.raises(ValueError, match=r"The limits allow 5e\+14 leaves or more.*Give a smaller max_depth"):
        growth.check_memory(1e15)


def test_growth_ends_where_nothing_is_left_to_split_and_an_interrupt_loses_the_round_alone():
    assert growth.grow([0], lambda tree: [*tree, 0] if len(tree) < 5 else None, limits(max_leaves=100)) == [0] * 5

    def split_some(tree):
        if len(tree) == 3:
            raise KeyboardInterrupt
        return [*tree, 0]

    with pytest.warns(ConstructionInterrupted, match="Interrupted at 3 leaves: the PLR is the one built so far"):
        assert growth.grow([0], split_some, limits(max_leaves=100)) == [0] * 3


def test_an_interrupted_construction_gives_what_there_is_and_another_warns_of_nothing(leaf):
    calls = []

    def interrupted(x):
        calls.append(len(x))
        if len(calls) == 8:
            raise KeyboardInterrupt
        return walled(x)

    with pytest.warns(ConstructionInterrupted, match="the PLR is the one built so far") as caught:
        plr = construct(interrupted, UNIT, leaf=leaf, max_leaves=500)
    assert 1 < plr.num_leaves < 500
    assert jnp.isfinite(plr(jnp.array([0.3, 0.3])))
    assert f"at {plr.num_leaves} leaves" in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        construct(walled, UNIT, leaf=leaf, max_leaves=5)


def test_a_budget_that_is_too_small_says_how_much_is_enough_in_other_processes_too():
    found = limits(max_bytes=40)
    found.require_room(40)
    with pytest.raises(growth.BudgetTooSmall, match=r"^max_bytes=40 is too small: one leaf takes 41 bytes") as caught:
        found.require_room(41)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.num_bytes) == (str(caught.value), 41)


# Nodes.


@pytest.mark.parametrize(
    ("priority", "bound", "given", "key"),
    [
        ([0.3, 0.7], 0.5, {}, [0.3, 0.5]),  # never above the parents' one
        ([0.3, 0.7], 1.0, {"tolerance": 0.3}, [growth.NEVER, 0.7]),
        ([0.3, 0.7], 1.0, {"max_depth": 1}, [growth.NEVER, growth.NEVER]),
        ([0.0, 1e-9], 1.0, {}, [growth.NEVER, growth.NEVER]),
    ],
)
def test_a_key_is_the_priority_unless_the_limits_close_a_node(priority, bound, given, key):
    """Of the two halves of the square along x, which a plane fits badly. Errors are means, and shares volumes."""
    fit = sampler_of(cone, UNIT, None, 32)(Cells.root(2).split(np.array([0])))
    coefficients, bounds = np.column_stack([fit.center, fit.half]), np.full(2, bound)
    found = growth.nodes_of_fit(fit, coefficients, bounds, np.array(priority), np.zeros(2, int), limits(**given))
    assert found.key.tolist() == key
    np.testing.assert_allclose(found.share, [0.5, 0.5])
    np.testing.assert_allclose(found.error, np.average(np.abs(fit.residual), axis=1, weights=fit.pattern.weight))


def test_every_prefix_of_the_order_of_splits_is_a_tree():
    """Node 2's key is its parent's; of equal keys the earlier node, the parent, comes first."""
    key = np.array([0.9, 0.2, 0.9, growth.NEVER, 0.1])
    child = np.array([1, -1, 3, -1, -1])
    cells = Cells.root(2)[np.zeros(5, int)]
    tree = growth.Nodes(cells, np.zeros((5, 3)), np.zeros(5), np.zeros(5), np.zeros(5, int), key, child)
    order = growth.split_order(tree)
    assert order.tolist() == [0, 2, 1, 4] and len(tree) == 3
    assert [tree.leaves_after(order[:n]).tolist() for n in range(3)] == [[0], [1, 2], [1, 3, 4]]


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"split": lambda fit: np.full(len(fit.cells), 5)}, "split must return one axis from 0 to 1 a cell"),
        ({"split": lambda fit: np.zeros(0, int)}, "split must return one axis"),
        ({"should_split": lambda fit: np.ones(len(fit.cells) + 1)}, "should_split must return one priority a cell"),
        ({"should_split": lambda fit: np.full(len(fit.cells), np.nan)}, "should_split must return one priority"),
    ],
)
def test_bad_rules_are_refused(leaf, rules, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, UNIT, leaf=leaf, max_leaves=10, options=BuildOptions(**rules))
