import os
from pathlib import Path

import numpy as np
import pytest
import shapely

from plr_jax import DiscRobot, RectangleRobot, scenes

DATA = os.environ.get("PLR_JAX_DATA")
needs_data = pytest.mark.skipif(DATA is None, reason="PLR_JAX_DATA is not set: third-party problems are absent")

PROBLEM = """
environment:
  min: [0, 0]
  max: [6, 4.5]
  obstacles:
    - {type: box, center: [3, 1], size: [1, 2]}
robots:
  - {type: unicycle_first_order_0_sphere, start: [1, 1, 0.5], goal: [5, 1, 0]}
  - {type: unicycle_first_order_0_sphere, start: [5, 3, 3.14], goal: [1, 3, 0]}
"""


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "problem.yaml").write_text(text)
        return tmp_path / "problem.yaml"

    return write


def test_discs_lose_their_headings_and_in_a_mixed_team_rectangles_keep_theirs(write):
    problem = scenes.read_dbcbs(write(PROBLEM))
    assert problem.robots == (DiscRobot(0.4),) * 2
    np.testing.assert_array_equal(problem.starts, [[1, 1], [5, 3]])
    np.testing.assert_array_equal(problem.goals, [[5, 1], [1, 3]])
    free = shapely.box(0, 0, 6, 4.5) - shapely.box(2.5, 0, 3.5, 2)
    assert shapely.symmetric_difference(problem.workspace.free_space, free).area < 1e-9
    mixed = scenes.read_dbcbs(write(PROBLEM.replace("_sphere, start: [5", ", start: [5")))
    assert mixed.robots == (DiscRobot(0.4), RectangleRobot(0.5, 0.25))
    np.testing.assert_array_equal(mixed.starts, [[1, 1, 0], [5, 3, 3.14]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "expected YAML"),
        ("[1, 2]", 'the keys "environment" and "robots"'),
        ("", 'the keys "environment" and "robots"'),
        (PROBLEM.replace("max:", "maximum:"), '"environment" to have the keys'),
        (PROBLEM.replace("type: box", "type: sphere"), "obstacle 0 to be a box"),
        (PROBLEM.replace("size: [1, 2]", "size: [1]"), "obstacle 0 to be a box"),
        (PROBLEM.replace("size: [1, 2]", "size: big"), "obstacle 0 to be a box"),
        (PROBLEM.replace("size: [1, 2]", "size: [1, 2, 3]"), "obstacle 0 to be a box"),
        (PROBLEM.replace("size: [1, 2]", "size: [1, .nan]"), "obstacle 0 to be a box"),
        (PROBLEM.replace("- {type: box", "- 3 #"), "obstacle 0 to be a box"),
        (PROBLEM.replace("type: unicycle_first_order_0_sphere", "type: [1]"), r"robot 0 has type \[1\]; known are"),
        (PROBLEM.replace("unicycle_first_order_0_sphere", "car1_v0"), "robot 0 has type 'car1_v0'; known are"),
        (PROBLEM.replace("start: [1, 1, 0.5]", "start: [1]"), "robot 0 to have a start of at least 2 numbers"),
        (PROBLEM.replace("start: [1, 1, 0.5]", "start: here"), "robot 0 to have a start of at least 2 numbers"),
        (PROBLEM.replace(", goal: [5, 1, 0]", ""), 'robot 0 to have the keys "type", "start" and "goal"'),
        (PROBLEM.split("robots:")[0] + "robots: 3", '"robots" to be a list'),
        (PROBLEM.split("robots:")[0] + "robots: []", "at least one robot"),
        (PROBLEM.replace("goal: [1, 3, 0]", "goal: [5, 1.7, 0]"), "Robots 0 and 1 overlap at their goals"),
        (PROBLEM.replace("start: [1, 1, 0.5]", "start: [2.2, 1, 0]"), r"Robot 0 starts in collision with obstacle 0"),
    ],
)
def test_broken_problems_are_refused(text, message, write):
    with pytest.raises(ValueError, match=rf"problem\.yaml: .*{message}"):
        scenes.read_dbcbs(write(text))


def test_trajectories_of_different_length_wait_at_their_end(write):
    path = write("result:\n- states: [[0, 1, 2, 9], [3, 4, 5, 9]]\n- states: [[6, 7, 8, 9]]\n")
    np.testing.assert_array_equal(scenes.read_trajectories(path), [[[0, 1, 2], [6, 7, 8]], [[3, 4, 5], [6, 7, 8]]])


@pytest.mark.parametrize(
    "text",
    [
        *("", "3", "result: 3", "result: []", "states: [[1, 2]]\nresult: [{}]", "states: []", "states: {}"),
        *("states: [[a, b, c]]", "states: ['123']", "states: [['1', '2', '3']]", "states: [[0, 1], [2, 3, 4]]"),
        *(f"states: [[0, 0, 0], [1, {number}, 0]]" for number in (".nan", ".inf", "-.inf", "1.0e+999")),
    ],
)
def test_what_holds_no_trajectories_is_refused(text, write):
    with pytest.raises(ValueError, match=r'problem\.yaml: expected (trajectories|"result" to be a list)'):
        scenes.read_trajectories(write(text))


def test_a_small_file_cannot_mean_a_huge_path(write):
    long = "- states: [" + "[0, 0, 0], " * 4000 + "]\n"
    with pytest.raises(ValueError, match=r"problem\.yaml: expected .* at most 10,000,000 .*, got 4001 x 4000"):
        scenes.read_trajectories(write("result:\n" + long + "- states: [[0, 0, 0]]\n" * 4000))


@needs_data
def test_all_problems_load_but_the_infeasible_one():
    paths = sorted(Path(DATA, "dbcbs").glob("*.yaml"))
    assert len(paths) > 15
    for path in paths:
        if path.stem == "infeasible_0":
            with pytest.raises(ValueError, match=r"Robots 0 and 1 overlap at their goals: .* \(clearance -0.8\)"):
                scenes.read_dbcbs(path)
            continue
        problem = scenes.read_dbcbs(path)
        discs = path.stem.endswith("_sphere") or path.stem == "wall"
        assert problem.dof == (2 if discs else 3)
        assert len({type(robot) for robot in problem.robots}) == 1


@needs_data
def test_problems_with_trailers_are_refused():
    with pytest.raises(ValueError, match="robot 0 has type 'car1_v0'"):
        scenes.read_dbcbs(Path(DATA, "dynobench/multirobot/example/swap2_trailer.yaml"))
