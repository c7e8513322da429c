import json
from dataclasses import replace
from functools import partial

import cli_helpers
import numpy as np
import pytest

import plr_jax
from plr_jax import BLOptions, PointRobot, Problem, Workspace, bl_plan, scenes, straight_line
from plr_jax.cli import plan as command
from plr_jax.planners import Status

run, done = partial(cli_helpers.run, "plan"), partial(cli_helpers.done, "plan")
SQUARE = Workspace(((0, 0), (10, 10)))
DOOR = scenes.single_door()


@pytest.fixture(scope="module")
def door():
    """Return a solution of the single door."""
    return bl_plan(DOOR, straight_line(DOOR))


def test_plan_four_rooms_writes_a_valid_path(tmp_path):
    files = [tmp_path / name for name in ("path.json", "path.html", "path.png")]
    outputs = ["-o", files[0], "--animation", files[1], "--picture", files[2]]
    text = done("four_rooms", "--robots", 2, *outputs)
    data, problem = json.loads(files[0].read_text()), scenes.four_rooms(2)
    report = plr_jax.validate(problem, data["path"])
    assert report.valid, report.message
    assert (report.cost, "SOLVED") == (data["cost"], data["status"])
    solution = plr_jax.Solution.load(files[0])
    np.testing.assert_array_equal(solution.path, data["path"])
    assert (solution.cost, solution.makespan) == (report.cost, plr_jax.metrics.makespan(problem, solution.path))
    assert files[1].read_text().startswith("<!doctype html>")
    assert files[2].read_bytes().startswith(b"\x89PNG")
    ratio = data["cost"] / data["lower_bound"]
    for line in (
        "four_rooms\n  robots     2",
        f"  cost       {data['cost']:.4g}, {ratio:.3f} times the lower bound of {data['lower_bound']:.4g}",
        f"  makespan   {data['makespan']:.4g}",
        f"  check      {report.message}",
        *(f"  wrote      {file}" for file in files),
    ):
        assert f"{line}\n" in text


def test_options_reach_the_planner(monkeypatch, door):
    calls = []
    monkeypatch.setattr("plr_jax.bl_plan", lambda problem, heuristic, options: calls.append(options) or door)
    done("single_door")
    done("single_door", "--cost-factor", 1.25, "--time-limit", 9.0)
    assert calls[0] == BLOptions(lower_bound=calls[0].lower_bound, time_limit=60.0)
    assert calls[1] == replace(calls[0], cost_factor=1.25, time_limit=9.0)


def test_robots_at_their_goals_cost_nothing(tmp_path):
    scenes.save(Problem(SQUARE, [PointRobot()] * 2, [(1, 1), (2, 2)], [(1, 1), (2, 2)]), tmp_path / "a.json")
    said = done(tmp_path / "a.json")
    assert "robots     2\n" in said and "cost       0, " in said


def test_plan_reads_scenes_and_files(maps):
    sizes = {name: len(command.read_problem(name, None).robots) for name in command._TEAM_SCENES}
    points = {"maze": 1, "thin_maze": 1, "floor_plan": 1}
    assert sizes == {"single_door": 1, "four_rooms": 4, "cross": 2, "tangle": 2, **points}
    assert [len(command.read_problem("four_rooms", n).robots) for n in (2, 3, 8)] == [2, 3, 8]
    assert len(command.read_problem("cross", 3).robots) == 3
    np.testing.assert_array_equal(command.read_problem(str(maps / "tangle.json"), None).goals, scenes.tangle().goals)


def ended(code, said, folder, *arguments):
    """Return the result of a command that must write nothing and fail with a code and a message."""
    result = run(*arguments, "-o", folder / "a.json")
    assert result.exit_code == code and result.stderr.startswith(said)
    assert not list(folder.iterdir())
    return result


def test_no_path_exits_with_1_and_writes_nothing(tmp_path):
    said = "Error: No path: the time limit was reached.\n"
    result = ended(1, said, tmp_path, "tangle", "--time-limit", 1e-6)
    assert "status     the time limit was reached\n" in result.stdout
    assert "cost       none: no path was found\n" in result.stdout


def test_invalid_path_exits_with_1_and_writes_nothing(tmp_path, monkeypatch, door):
    straight = np.stack([DOOR.starts, DOOR.goals])  # through the wall
    invalid = replace(door, path=straight, times=np.array([0, door.makespan]))
    monkeypatch.setattr("plr_jax.bl_plan", lambda *arguments: invalid)
    said = "Error: The path found is not valid, and was not written: "
    ended(1, said, tmp_path, "single_door")


def test_interrupted_search_writes_its_best_path(tmp_path, monkeypatch, door):
    monkeypatch.setattr("plr_jax.bl_plan", lambda *arguments: replace(door, status=Status.INTERRUPTED))
    result = run("single_door", "-o", tmp_path / "a.json")
    assert (result.exit_code, result.stderr) == (130, "Interrupted: the best path so far.\n")
    assert "status     interrupted by the user\n" in result.stdout
    np.testing.assert_array_equal(json.loads((tmp_path / "a.json").read_text())["path"], door.path)


def test_interrupt_before_first_path_writes_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("plr_jax.planners.driver.sequential_path", interrupt)
    ended(130, "Interrupted: no path yet.\n", tmp_path, "tangle")
    monkeypatch.setattr("plr_jax.oracles.VisibilityGraph.__call__", interrupt)
    ended(130, "Interrupted.\n", tmp_path, "four_rooms")
