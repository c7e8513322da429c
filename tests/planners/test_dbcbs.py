"""The planner on the problems of db-CBS, their robots holonomic."""

from pathlib import Path

import pytest
from planner_helpers import planned

from plr_jax import scenes
from plr_jax.planners import Status


@pytest.mark.parametrize(
    "name",
    [
        "alcove_unicycle",
        "alcove_unicycle_sphere",
        "at_goal_unicycle",
        "at_goal_unicycle_sphere",
        "classic",
        "gen_p10_n2_0_unicycle_sphere",
        "swap2_unicycle",
        "swap2_unicycle_sphere",
        "gen_p10_n4_0_unicycle_sphere",
        "gen_p10_n8_0_unicycle_sphere",
        "swap3_unicycle_sphere",
        "swap4_unicycle_sphere",
        "wall",
        "window2_unicycle",
        "window4_unicycle_sphere",
    ],
)
def test_problems_of_dbcbs(data_dir, name):
    solution = planned(scenes.read_dbcbs(Path(data_dir, "dbcbs", f"{name}.yaml")))
    assert solution.status is Status.SOLVED


def test_an_infeasible_problem_of_dbcbs_is_refused(data_dir):
    with pytest.raises(ValueError, match="Robots 0 and 1 overlap at their goals"):
        scenes.read_dbcbs(Path(data_dir, "dbcbs", "infeasible_0.yaml"))
