import numpy as np
import pytest
from plr_helpers import UNIT, points, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import PLR, construct
from plr_jax.plr.query import points as stack_module


@pytest.fixture(scope="module")
def team():
    """PLRs of all leaf models, of other sizes and dimensions, one far from the origin."""
    far = Box((1e6, 1e6), (1e6 + 2, 1e6 + 2))
    return [
        construct(walled, UNIT, max_leaves=40),
        construct(lambda x: walled(x[:, :2]) + 0.1 * x[:, 2], Box([0.0] * 3, [1.0] * 3), max_leaves=60),
        construct(walled, UNIT, leaf="continuous", max_leaves=20),
        construct(walled, UNIT, leaf="smooth", max_leaves=20),
        construct(lambda x: np.hypot(*(x - 1e6 - 0.3).T), far, max_leaves=40),
    ]


def joint(n):
    q = 2 * np.random.default_rng(1).random((n, 5, 3)) - 0.5
    q[:, -1] += 1e6
    q[:1, :, 0] = np.nan
    return q


@pytest.mark.parametrize("n", [0, 1, 60])
def test_a_stack_equals_the_plrs_bit_for_bit(team, n):
    q = joint(n)
    found = PLR.stack(team)(q)
    assert found.shape == (n, 5) and found.dtype == np.float64
    for i, plr in enumerate(team):
        np.testing.assert_array_equal(found[:, i], np.asarray(plr(q[:, i, : plr.dim]), np.float64))


def test_chunks_of_a_batch_change_nothing(team, monkeypatch):
    q = joint(60)
    whole = PLR.stack(team[:2])(q[:, :2])
    monkeypatch.setattr(stack_module, "_CHUNK", 4)
    np.testing.assert_array_equal(PLR.stack(team[:2])(q[:, :2]), whole)


def test_teams_that_do_not_fit_are_refused(team):
    stacked = PLR.stack(team[:2])
    with pytest.raises(ValueError, match=r"shape \(n, 2, dof\), got \(5, 3, 3\)"):
        stacked(np.zeros((5, 3, 3)))
    with pytest.raises(ValueError, match=r"shape \(n, 2, dof\), got \(5, 2\)"):
        unchecked(stacked, np.zeros((5, 2)))
    with pytest.raises(ValueError, match="The PLR of robot 1 has 3 dimensions, got 2"):
        stacked(np.zeros((5, 2, 2)))


def unchecked(stacked, q):
    """A call as outside of the tests, where annotations are not enforced."""
    return getattr(type(stacked).__call__, "__wrapped__", type(stacked).__call__)(stacked, q)


def test_points_of_one_robot_do_not_move_anothers_answer(team):
    q = np.repeat(points(50, 3)[:, None], 2, axis=1)
    first = PLR.stack([team[0], team[2]])(q)
    q[:, 1] = 0.5
    np.testing.assert_array_equal(PLR.stack([team[0], team[2]])(q)[:, 0], first[:, 0])
