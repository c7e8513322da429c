"""The lattices of one step: what robots share, and what they take."""

import tracemalloc

import numpy as np
import pytest
from planner_helpers import nudged_discs, nudged_team
from team_helpers import MIXED

from plr_jax import DiscRobot, Problem, RectangleRobot, scenes
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners.lattice.build import PRIMITIVES
from plr_jax.planners.searches import build_level, num_bytes


def level_of(problem, step):
    test = JointMotionTest(problem.workspace, problem.robots)
    level = build_level(problem, test, step, PRIMITIVES)
    assert level is not None
    return level


@pytest.mark.parametrize("problem", [nudged_discs(8), nudged_team(RectangleRobot(0.4, 0.1))], ids=["discs", "bars"])
def test_robots_with_both_ends_in_one_cell_are_of_one_kind(problem):
    level = level_of(problem, 0.8)
    (kind,) = level.kinds
    assert kind.members.tolist() == list(range(len(problem.robots)))
    straight = np.hypot(*(problem.goals - problem.starts).T[:2])
    assert (level.least_costs >= straight * (1 - 1e-9)).all()
    if problem.dof == 2:
        np.testing.assert_allclose(level.least_costs, straight)


# Steps that no other test takes, as motions are kept for the next problem in a workspace.
@pytest.mark.parametrize(
    ("problem", "step"),
    [
        (nudged_discs(8), 0.21),
        (nudged_discs(15), 1.9),
        (nudged_team(RectangleRobot(0.4, 0.1)), 0.31),
        (scenes.crowd(25), 0.41),
        (MIXED, 0.39),
    ],
    ids=["nudged discs", "coarse", "nudged bars", "crowd", "mixed"],
)
def test_lattices_take_as_many_bytes_as_they_say(problem, step):
    level_of(problem, 1.5 * step)  # what is made once, for all steps
    tracemalloc.start()
    try:
        level = level_of(problem, step)
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert 0.3 * level.num_bytes < held < 1.1 * level.num_bytes


def test_a_table_is_counted_once_for_all_that_share_it():
    alike = nudged_discs(4)
    unlike = Problem(alike.workspace, [DiscRobot(0.2 + 0.01 * i) for i in range(16)], alike.starts, alike.goals)
    assert num_bytes(unlike, 0.5, 8) > 4 * num_bytes(alike, 0.5, 8)


def test_starts_and_goals_count_as_nodes():
    coarse, fine = (num_bytes(nudged_discs(1), step, 8) for step in (0.5, 0.25))
    assert fine / coarse == pytest.approx((64 + 2) / (16 + 2))
