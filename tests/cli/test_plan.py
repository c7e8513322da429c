import json
from dataclasses import replace
from functools import partial

import cli_helpers
import numpy as np
import pytest

import plr_jax
from plr_jax import BLOptions, DiscRobot, PointRobot, Problem, Workspace, bl_plan, scenes, straight_line
from plr_jax.cli import plan as command
from plr_jax.cli.inputs import require_writable
from plr_jax.cli.plan import Heuristic
from plr_jax.planners import Status

run, done, mistake = (partial(f, "plan") for f in (cli_helpers.run, cli_helpers.done, cli_helpers.mistake))
SQUARE = Workspace(((0, 0), (10, 10)))
DOOR = scenes.single_door()


@pytest.fixture(scope="module")
def door():
    """Return a solution of the single door."""
    return bl_plan(DOOR, straight_line(DOOR))


@pytest.fixture
def planned(monkeypatch, door):
    """Replace the planner by one that answers at once; return the options of its calls."""
    calls = []
    monkeypatch.setattr("plr_jax.bl_plan", lambda problem, heuristic, options: calls.append(options) or door)
    return calls


def test_plan_four_rooms_writes_a_valid_path(tmp_path):
    files = [tmp_path / name for name in ("path.json", "path.html", "path.png")]
    outputs = ["-o", files[0], "--animation", files[1], "--picture", files[2]]
    text = done("four_rooms", "--robots", 2, "--heuristic", "plr", "--plr-bytes", 512, *outputs)
    data, problem = json.loads(files[0].read_text()), scenes.four_rooms(2)
    report = plr_jax.validate(problem, data["path"])
    assert report.valid, report.message
    assert (report.cost, "SOLVED") == (data["cost"], data["status"])
    solution = plr_jax.Solution.load(files[0])
    np.testing.assert_array_equal(solution.path, data["path"])
    assert (solution.cost, solution.makespan) == (report.cost, plr_jax.makespan(problem, solution.path))
    assert files[1].read_text().startswith("<!doctype html>")
    assert files[2].read_bytes().startswith(b"\x89PNG")
    ratio = data["cost"] / data["lower_bound"]
    for line in (
        "four_rooms\n  robots     2 discs of radius 0.4",
        f"  cost       {data['cost']:.4g}, {ratio:.3f} times the lower bound of {data['lower_bound']:.4g}",
        f"  makespan   {data['makespan']:.4g}",
        f"  check      {report.message}",
        *(f"  wrote      {file}" for file in files),
    ):
        assert f"{line}\n" in text
    assert "plr: 2 PLRs, " in text and " bytes\n" in text


def test_options_reach_the_planner(planned):
    for options, expected in (
        ([], BLOptions()),
        (["--step", 0.25], BLOptions(step=0.25)),
        (["--weight", 1.5], BLOptions(heuristic_weight=1.5)),
        (["--cost-factor", 1.25], BLOptions(cost_factor=1.25)),
        (["--time-limit", 9.0], BLOptions(time_limit=9.0)),
    ):
        done("single_door", "--heuristic", "none", *options)
        assert replace(planned.pop(), lower_bound=None) == expected


def test_heuristics_equal_their_distances():
    exact, points = (plr_jax.robot_distance_fns(DOOR, inflated=inflated) for inflated in (True, False))
    q = DOOR.starts[None] + np.array([[[0.0, 0.0]], [[0.5, 3.0]]])
    values = {}
    assert command._build_heuristic(Heuristic.lattice, DOOR, exact, 1024) == (None, [])
    for name in set(Heuristic) - {Heuristic.lattice}:
        function, plrs = command._build_heuristic(name, DOOR, exact, 1024)
        values[name] = function(q)
        assert len(plrs) == (name in (Heuristic.plr, Heuristic.point_plr))
    assert not values[Heuristic.none].any()
    np.testing.assert_array_equal(values[Heuristic.straight_line], straight_line(DOOR)(q))
    np.testing.assert_array_equal(values[Heuristic.oracle], exact[0](q[:, 0]))
    np.testing.assert_allclose(values[Heuristic.plr], exact[0](q[:, 0]), atol=0.05)
    np.testing.assert_allclose(values[Heuristic.point_plr], points[0](q[:, 0]), atol=0.05)
    assert (values[Heuristic.plr] > values[Heuristic.point_plr] + 0.1).all()


def test_robots_of_one_size_and_goal_share_a_plr():
    robots = [PointRobot(), PointRobot(), DiscRobot(0.5), PointRobot()]
    problem = Problem(SQUARE, robots, [(1, 9), (2, 9), (4, 9), (6, 9)], [(1, 1), (1, 1), (3, 1), (8, 8)])
    function, plrs = command._build_heuristic(Heuristic.plr, problem, plr_jax.robot_distance_fns(problem), 300)
    assert len(plrs) == 3
    assert function.per_robot(np.array([[[1.0, 5.0]] * 4]))[0, [0, 3]] == pytest.approx([4, np.hypot(7, 3)], abs=0.2)


def test_robots_at_their_goals_cost_nothing(tmp_path):
    scenes.save(Problem(SQUARE, [PointRobot()] * 2, [(1, 1), (2, 2)], [(1, 1), (2, 2)]), tmp_path / "a.json")
    said = done(tmp_path / "a.json", "--heuristic", "oracle")
    assert "robots     2 points\n" in said and "cost       0\n" in said


def test_plan_reads_scenes_and_files(maps):
    sizes = {name: len(command._read_problem(name, None).robots) for name in command._TEAM_SCENES}
    points = {"maze": 1, "thin_maze": 1, "floor_plan": 1}
    assert sizes == {"single_door": 1, "four_rooms": 4, "cross": 2, "tangle": 2, **points}
    assert [len(command._read_problem("four_rooms", n).robots) for n in (2, 3, 8)] == [2, 3, 8]
    assert len(command._read_problem("cross", 3).robots) == 3
    np.testing.assert_array_equal(command._read_problem(str(maps / "tangle.json"), None).goals, scenes.tangle().goals)


def test_describe_counts_robots_of_each_shape():
    team = [DiscRobot(0.4), PointRobot(), DiscRobot(0.4), plr_jax.RectangleRobot(1.8, 0.5)]
    team += [plr_jax.PolygonRobot([(-1, 0), (1, 0), (0, 1)])] * 2
    words = "2 discs of radius 0.4, 1 point, 1 rectangle 1.8 x 0.5, 2 polygons of 3 corners 2 x 1"
    assert command.describe(team) == words


def test_outputs_without_permission_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)  # the tests may run as root, who may all
    with pytest.raises(PermissionError):
        require_writable(tmp_path / "a.json", (".json",))
    require_writable(None, (".json",))


def ended(code, said, folder, *arguments):
    """Return the result of a command that must write nothing and fail with a code and a message."""
    result = run(*arguments, "-o", folder / "a.json")
    assert result.exit_code == code and result.stderr.startswith(said)
    assert not list(folder.iterdir())
    return result


def test_no_path_exits_with_1_and_writes_nothing(tmp_path):
    said = "Error: No path: the time limit was reached.\n"
    result = ended(1, said, tmp_path, "tangle", "--heuristic", "none", "--time-limit", 1e-6)
    assert "status     the time limit was reached\n" in result.stdout
    assert "cost       none: no path was found\n" in result.stdout


def test_invalid_path_exits_with_1_and_writes_nothing(tmp_path, monkeypatch, door):
    straight = np.stack([DOOR.starts, DOOR.goals])  # through the wall
    invalid = replace(door, path=straight, times=np.array([0, door.makespan]))
    monkeypatch.setattr("plr_jax.bl_plan", lambda *arguments: invalid)
    said = "Error: The path found is not valid, and was not written: "
    ended(1, said, tmp_path, "single_door", "--heuristic", "none")


def test_interrupted_search_writes_its_best_path(tmp_path, monkeypatch, door):
    monkeypatch.setattr("plr_jax.bl_plan", lambda *arguments: replace(door, status=Status.INTERRUPTED))
    result = run("single_door", "--heuristic", "none", "-o", tmp_path / "a.json")
    assert (result.exit_code, result.stderr) == (130, "Interrupted: the best path so far.\n")
    assert "status     interrupted by the user\n" in result.stdout
    np.testing.assert_array_equal(json.loads((tmp_path / "a.json").read_text())["path"], door.path)


def test_interrupt_before_first_path_writes_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    interrupt.per_robot = interrupt
    monkeypatch.setattr("plr_jax.straight_line", lambda problem: interrupt)
    ended(130, "Interrupted: no path yet.\n", tmp_path, "tangle", "--heuristic", "straight-line")
    monkeypatch.setattr("plr_jax.oracles.VisibilityGraph.__call__", interrupt)
    ended(130, "Interrupted.\n", tmp_path, "four_rooms", "--heuristic", "plr")
