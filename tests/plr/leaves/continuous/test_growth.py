import numpy as np
import pytest
from plr_helpers import UNIT, cone

from plr_jax.plr import construct


def test_limits():
    assert construct(cone, UNIT, leaf="continuous", max_leaves=37).num_leaves == 37
    plr = construct(cone, UNIT, leaf="continuous", tolerance=0.01)
    x = np.random.default_rng(0).random((5000, 2))
    assert np.abs(np.asarray(plr(x)) - cone(x)).max() < 0.015
    assert plr.num_leaves < 60


@pytest.mark.parametrize("max_leaves", [100, 200, 400])
def test_exhausted_leaves_take_no_part_of_what_was_asked_for(max_leaves):
    """Leaves at a jump are halved until they may not be; once they were chosen, and 99, 193 and 380 leaves made."""

    def bumps_and_a_jump(x):
        return 2 + np.sin(40 * x[:, 0]) + 10 * (x[:, 0] > 1 / 3)

    plr = construct(bumps_and_a_jump, ([0.0], [1.0]), leaf="continuous", max_leaves=max_leaves, num_samples=48)
    assert plr.num_leaves == max_leaves


def test_limits_on_depth_are_kept():
    plr = construct(lambda x: 10.0 * (x[:, 0] > 1 / 3) + cone(x), UNIT, leaf="continuous", max_leaves=60, max_depth=7)
    assert plr.depth == 7 and plr.num_leaves == 60


def test_weights_draw_leaves():
    weight = lambda x: np.where(x[:, 0] > 0.5, 1.0, 0.001)  # noqa: E731
    plr = construct(cone, UNIT, leaf="continuous", max_leaves=64, weight_fn=weight)
    assert np.mean(plr.leaf_boxes[0][:, 0] >= 0.5) > 0.8


@pytest.mark.parametrize("budget", [100, 300, 700])
def test_a_budget_of_bytes_is_kept_and_used(budget):
    plr = construct(cone, UNIT, leaf="continuous", max_bytes=budget)
    assert 0.95 * budget < plr.num_bytes <= budget
