import pickle
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, walled

from plr_jax.plr import ConstructionInterrupted, construct
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.limits import BudgetTooSmall, check_limits, check_memory, grow

NAMES = ("max_depth", "max_leaves", "max_bytes", "tolerance")


def four_each(dim, num_leaves):
    return 4 * num_leaves


def limits(dim=2, least_bytes: int | float = 2, has_deep_trees=False, **given):
    return check_limits(
        dim, least_bytes, has_deep_trees, four_each, *(given.get(name) for name in NAMES), Proof.NONE, 13
    )


def test_no_limit_means_512_leaves():
    found = limits()
    assert (found.max_leaves, found.max_depth, found.max_bytes, found.tolerance) == (512, 60, np.inf, 0.0)


def test_limits_are_kept_as_they_are():
    found = limits(max_depth=9, max_leaves=50, max_bytes=4000, tolerance=0.1)
    assert (found.max_leaves, found.max_depth, found.max_bytes, found.tolerance) == (50, 9, 4000.0, 0.1)


def test_a_budget_of_bytes_bounds_the_leaves():
    """No more than the tables of that budget have room for: 2,048 bytes of at least two a leaf."""
    assert limits(max_bytes=2048).max_leaves == 1024
    assert limits(max_bytes=2048, least_bytes=1).max_leaves == 2048
    assert limits(max_bytes=2048, least_bytes=0.5).max_leaves == 4096
    assert limits(max_bytes=2048, max_leaves=17).max_leaves == 17


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"max_bytes": 2048}, 7),
        ({"max_bytes": 2049}, 8),
        ({"max_bytes": 8192}, 8),
        ({"max_bytes": 8193}, 9),
        ({"max_bytes": 32768}, 9),
        ({"max_bytes": 32769}, 14),
        ({"max_bytes": 1024, "least_bytes": 1}, 7),  # twice the leaves
        ({"max_bytes": 2048, "least_bytes": 1}, 8),
        ({"max_bytes": 16384, "least_bytes": 1}, 9),
        ({"max_bytes": 16385, "least_bytes": 1}, 14),
        ({"tolerance": 0.1}, 14),
        ({"max_depth": 20}, 14),
        ({"max_leaves": 512}, 7),
        ({"max_leaves": 513}, 8),
        ({"max_bytes": 10**6, "max_leaves": 512}, 7),
        ({"max_bytes": 256, "least_bytes": 0.5}, 7),
        ({"max_bytes": 512, "least_bytes": 0.5}, 7),
        ({"max_bytes": 513, "least_bytes": 0.5}, 8),
        ({"max_bytes": 256, "least_bytes": 0.5, "has_deep_trees": True}, 13),
        ({"max_leaves": 512, "least_bytes": 0.5, "has_deep_trees": True}, 13),
        ({"max_bytes": 2048, "dim": 3}, 9),
        ({"max_bytes": 2048, "dim": 10}, 2),
        ({"max_bytes": 2048, "dim": 40}, 1),
    ],
)
def test_how_often_an_axis_may_be_halved(given, expected):
    assert limits(**given).max_axis_depth == expected


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
    arguments = [given.get(name) for name in NAMES]
    with pytest.raises(ValueError, match=message):
        unchecked(2, 2, False, four_each, *arguments, Proof.NONE, 13)


unchecked = getattr(check_limits, "__wrapped__", check_limits)  # by annotations, as outside of the tests


def test_a_tree_larger_than_memory_is_refused():
    check_memory(1e5)
    with pytest.raises(ValueError, match=r"The limits allow 5e\+14 leaves or more.*Give a smaller max_depth"):
        check_memory(1e15)


def test_growth_ends_where_nothing_is_left_to_split():
    assert grow([0], lambda tree: [*tree, 0] if len(tree) < 5 else None, limits(max_leaves=100)) == [0] * 5


def test_an_interrupt_loses_the_round_alone():
    def split_some(tree):
        if len(tree) == 3:
            raise KeyboardInterrupt
        return [*tree, 0]

    with pytest.warns(ConstructionInterrupted, match="Interrupted at 3 leaves: the PLR is the one built so far"):
        assert grow([0], split_some, limits(max_leaves=100)) == [0] * 3


def test_an_interrupted_construction_gives_what_there_is(leaf):
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


def test_a_construction_that_ends_warns_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        construct(walled, UNIT, max_leaves=5)


def test_a_budget_that_is_too_small_says_how_much_is_enough_in_other_processes_too():
    found = limits(max_bytes=40)
    found.require_room(40)
    with pytest.raises(BudgetTooSmall, match=r"^max_bytes=40 is too small: one leaf takes 41 bytes; allow") as caught:
        found.require_room(41)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.num_bytes) == (str(caught.value), 41)
