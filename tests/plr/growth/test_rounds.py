import warnings

import jax.numpy as jnp
import pytest
from plr_helpers import UNIT, walled

from plr_jax.plr import ConstructionInterrupted, construct
from plr_jax.plr.growth.limits import check_limits
from plr_jax.plr.growth.rounds import grow

LIMITS = check_limits(2, 2, None, 100, None, None)


def test_growth_ends_where_nothing_is_left_to_split():
    assert grow([0], lambda tree: [*tree, 0] if len(tree) < 5 else None, LIMITS) == [0] * 5


def test_an_interrupt_loses_the_round_alone():
    def split_some(tree):
        if len(tree) == 3:
            raise KeyboardInterrupt
        return [*tree, 0]

    with pytest.warns(ConstructionInterrupted, match="Interrupted at 3 leaves: the PLR is the one built so far"):
        assert grow([0], split_some, LIMITS) == [0] * 3


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
