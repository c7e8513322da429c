import io
import json

import numpy as np
import pytest

from plr_jax import scenes
from plr_jax.cli._inputs import map_and_goal, parse_goal, parse_points, read_text


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1"])
def test_a_goal_is_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goal(text)
    np.testing.assert_array_equal(parse_goal("1, -2.5e1"), [1, -25])


@pytest.mark.parametrize(
    "text", ["1,2\n3,4", "1,2\n3,4\n", "x,y\n1,2\n3,4\n\n", " 1 , 2 \r\n3,4\r\n", '"x","y"\n1,2\n3,4\n']
)
def test_points_come_with_or_without_a_header(text):
    np.testing.assert_array_equal(parse_points("p", text, 2), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n\n3,4\n", "p, line 2: .*got ''"),
        ("x,y\n1,2\n3,nan\n", "p, line 3: .*got '3,nan'"),
        ("1,2\n3,inf\n", "p, line 2"),
        ("1,2\n3\n", "p, line 2"),
        ("1,2,3\n", "p, line 1"),
        ("1,b\n1,2\n", "p, line 1"),  # half a number: no header
        ("1,2\n1;2\n", "p, line 2"),
        ("1;2\n1,2\n", "p, line 1"),  # nor numbers apart from each other in another way
        ("1 2\n", "p, line 1"),
        ("nan,nan\n1,2\n", "p, line 1"),
        ("\n1,2\n", "p, line 1"),
        ("x,y\n", "p has no points"),
        ("\n\n", "p has no points"),
    ],
)
def test_broken_points_are_refused_by_line(text, message):
    with pytest.raises(ValueError, match=message):
        parse_points("p", text, 2)


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


def test_text_comes_from_a_file_or_from_standard_input(tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_bytes("\ufeff1,2\n".encode())  # a byte order mark, as spreadsheets write it
    assert read_text(str(tmp_path / "a.csv")) == (str(tmp_path / "a.csv"), "1,2\n")
    monkeypatch.setattr("sys.stdin", io.StringIO("3,4\n"))
    assert read_text("-") == ("stdin", "3,4\n")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="is not a text file"):
        read_text(str(tmp_path / "b.csv"))
