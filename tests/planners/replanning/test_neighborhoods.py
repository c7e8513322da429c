"""Robots planned anew, each and together: valid paths that never cost more."""

import numpy as np
import pytest
from reservation_helpers import TEAMS, blocked_from_scratch, table_of

from plr_jax import validate
from plr_jax.planners.replanning import replan_each, replan_neighborhoods, replan_together


@pytest.mark.parametrize("name", TEAMS)
def test_every_table_is_a_valid_path_of_what_it_says_to_cost(name):
    joint, table = table_of(name)
    rng, costs = np.random.default_rng(0), [table.cost.sum()]
    for change in (replan_each, lambda t: replan_neighborhoods(t, 8, rng)):
        change(table)
        costs.append(table.cost.sum())
        report = validate(joint.problem, joint.configurations(table.state))
        assert report.valid and report.cost == pytest.approx(costs[-1])
        assert (table.cost >= table.least * (1 - 1e-9)).all()
        for blocked, fresh in zip(table.blocked, blocked_from_scratch(table), strict=True):
            np.testing.assert_array_equal(blocked, fresh)
    assert costs[0] > costs[1] >= costs[2]


def test_robots_that_gain_nothing_together_lose_nothing():
    _, table = table_of("rooms")
    replan_each(table)
    rng = np.random.default_rng(1)
    for _ in range(12):
        cost = table.cost.copy()
        gained = replan_together(table, rng.permutation(4).tolist())
        assert gained == (table.cost.sum() < cost.sum() * (1 - 1e-9))
        if not gained:
            assert table.cost.sum() <= cost.sum() * (1 + 1e-9)
        for blocked, fresh in zip(table.blocked, blocked_from_scratch(table), strict=True):
            np.testing.assert_array_equal(blocked, fresh)
