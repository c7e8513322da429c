import json

import numpy as np
import pytest

from plr_jax import scenes
from plr_jax.cli._inputs import map_and_goal, parse_goal


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1"])
def test_a_goal_is_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goal(text)
    np.testing.assert_array_equal(parse_goal("1, -2.5e1"), [1, -25])


def test_a_scene_of_two_robots_leaves_the_goal_to_the_user(tmp_path):
    problem = scenes.maze()
    double = type(problem)(problem.workspace, problem.robots * 2, [problem.starts[0]] * 2, [problem.goals[0]] * 2)
    scenes.save(double, tmp_path / "two.json")
    workspace, goal = map_and_goal(str(tmp_path / "two.json"), None)
    assert goal is None
    assert workspace.bounds == problem.workspace.bounds


def test_a_map_is_a_scene_or_a_file_by_its_ending(tmp_path):
    workspace, goal = map_and_goal("thin_maze", None)
    assert workspace.bounds == scenes.thin_maze().workspace.bounds
    np.testing.assert_array_equal(goal, scenes.thin_maze().goals[0])
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    (tmp_path / "b.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    for name, area in [("a.map", 2), ("b.json", 4.5)]:
        workspace, goal = map_and_goal(str(tmp_path / name), None)
        assert workspace.free_space.area == area
        assert goal is None
    scenes.save(scenes.maze(), tmp_path / "c.json")
    np.testing.assert_array_equal(map_and_goal(str(tmp_path / "c.json"), None)[1], scenes.maze().goals[0])
    with pytest.raises(ValueError, match="MAP must be a scene"):
        map_and_goal(str(tmp_path / "d.txt"), None)


def test_a_goal_that_is_given_wins():
    np.testing.assert_array_equal(map_and_goal("maze", "0.9,0.1")[1], [0.9, 0.1])
