import json
from dataclasses import replace
from functools import partial

import cli_helpers
import numpy as np
import pytest

from plr_jax import Problem, Solution, Workspace, makespan, scenes, validate
from plr_jax.cli import _planning
from plr_jax.cli._inputs import TEAM_SCENES, Heuristic, read_problem, require_writable
from plr_jax.oracles import robot_distance_fns
from plr_jax.planners import BLOptions, Status, bl_plan, straight_line
from plr_jax.plr import construct
from plr_jax.robots.shapes import DiscRobot, PointRobot, PolygonRobot, RectangleRobot

run, mistake = (partial(command, "plan") for command in (cli_helpers.run, cli_helpers.mistake))
SQUARE = Workspace(((0, 0), (10, 10)))
YAML = """
environment:
  min: [0, 0]
  max: [4, 4]
  obstacles:
  - {type: box, center: [2, 1], size: [0.5, 2]}
robots:
- {type: unicycle_first_order_0_sphere, start: [1, 1, 0], goal: [3, 1, 0]}
"""


@pytest.fixture(scope="module")
def door():
    """A solution of the single door, for tests of what becomes of it."""
    problem = scenes.single_door()
    return bl_plan(problem, straight_line(problem))


@pytest.fixture
def planned(monkeypatch, door):
    """Calls of the planner, which answers at once."""
    calls = []

    def answer(problem, heuristic, options):
        calls.append(options)
        return door

    monkeypatch.setattr(_planning, "bl_plan", answer)
    return calls


def test_four_rooms_from_start_to_end(tmp_path):
    files = [tmp_path / name for name in ("path.json", "path.html", "path.png")]
    result = run(
        "four_rooms",
        "--robots",
        2,
        "--heuristic",
        "plr",
        "--plr-bytes",
        512,
        "-o",
        files[0],
        "--animation",
        files[1],
        "--picture",
        files[2],
    )
    assert result.exit_code == 0, result.output
    data, problem = json.loads(files[0].read_text()), scenes.four_rooms(2)
    report = validate(problem, data["path"])
    assert report.valid, report.message
    assert (report.cost, report.clearance, "SOLVED") == (data["cost"], data["clearance"], data["status"])
    assert np.shape(data["path"])[1:] == (2, 2)
    solution = Solution.load(files[0])
    np.testing.assert_array_equal(solution.path, data["path"])
    assert (solution.cost, solution.makespan) == (report.cost, makespan(problem, solution.path))
    np.testing.assert_array_equal(solution.path_at([0, solution.makespan]), [problem.starts, problem.goals])
    assert files[1].read_text().startswith("<!doctype html>")
    assert files[2].read_bytes().startswith(b"\x89PNG")
    lines = result.stdout.splitlines()
    assert lines[0] == "four_rooms"
    words = [line.split()[0] for line in lines[1:]]
    del words[4]  # a number: the search takes two lines
    before = ["robots", "heuristic", "status", "search", "cost", "makespan", "check"]
    assert words == [*before, "wrote", "wrote", "wrote", "seconds", "planning:"]
    text = result.stdout
    assert "robots     2 discs of radius 0.4\n" in text
    assert "plr: 2 PLRs, " in text and " bytes, built in " in text
    ratio = data["cost"] / data["lower_bound"]
    assert f"{data['cost']:.4g}, {ratio:.3f} times the lower bound of {data['lower_bound']:.4g}\n" in text
    assert f"makespan   {data['makespan']:.4g}\n" in text
    assert f"check      {report.message}\n" in text
    assert all(f"wrote      {file}\n" in text for file in files)


def test_a_gif_is_a_gif(tmp_path, planned):
    file = tmp_path / "a.gif"
    assert run("single_door", "--heuristic", "none", "--animation", file).exit_code == 0
    assert file.read_bytes().startswith(b"GIF89a")


def test_without_options_the_planner_has_its_own_defaults(planned):
    assert run("single_door", "--heuristic", "none").exit_code == 0
    bound = _planning.lower_bound(problem := scenes.single_door(), robot_distance_fns(problem))
    assert planned == [BLOptions(lower_bound=bound)]


@pytest.mark.parametrize(
    ("option", "field", "value"),
    [
        ("--step", "step", 0.25),
        ("--cell-size", "cell_size", 0.5),
        ("--weight", "heuristic_weight", 1.5),
        ("--batch", "batch", 7),
        ("--branching", "branching", 5),
        ("--width", "width", 99),
        ("--cost-factor", "cost_factor", 1.25),
        ("--time-limit", "time_limit", 9.0),
        ("--max-expansions", "max_expansions", 1000.0),
        ("--max-memory", "max_memory", 1e8),
    ],
)
def test_every_option_reaches_the_planner(option, field, value, planned):
    assert run("single_door", "--heuristic", "none", option, value).exit_code == 0
    assert [replace(options, lower_bound=None) for options in planned] == [BLOptions(**{field: value})]


def test_seed_and_bytes_reach_the_plrs(planned, monkeypatch):
    calls = []

    def small(oracle, domain, **options):
        calls.append(options)
        return construct(oracle, domain, max_leaves=2)

    monkeypatch.setattr(_planning, "construct", small)
    assert run("single_door", "--heuristic", "plr", "--plr-bytes", 700, "--seed", 5).exit_code == 0
    assert calls == [{"max_bytes": 700, "seed": 5}]


def test_heuristics_are_what_their_names_say():
    problem = scenes.single_door()
    exact, points = (robot_distance_fns(problem, inflated=inflated) for inflated in (True, False))
    q = problem.starts[None] + np.array([[[0.0, 0.0]], [[0.5, 3.0]]])
    values = {}
    assert _planning.heuristic_of(Heuristic.lattice, problem, exact, 1024, 0) == (None, [])
    for name in set(Heuristic) - {Heuristic.lattice}:
        function, plrs = _planning.heuristic_of(name, problem, exact, 1024, 0)
        values[name] = function(q)
        assert len(plrs) == (name in (Heuristic.plr, Heuristic.point_plr))
    assert not values[Heuristic.none].any()
    np.testing.assert_array_equal(values[Heuristic.straight_line], straight_line(problem)(q))
    np.testing.assert_array_equal(values[Heuristic.oracle], exact[0](q[:, 0]))
    np.testing.assert_allclose(values[Heuristic.plr], exact[0](q[:, 0]), atol=0.05)
    np.testing.assert_allclose(values[Heuristic.point_plr], points[0](q[:, 0]), atol=0.05)
    assert (values[Heuristic.plr] > values[Heuristic.point_plr] + 0.1).all()


def test_robots_of_one_size_and_goal_share_a_plr():
    robots = [PointRobot(), PointRobot(), DiscRobot(0.5), PointRobot()]
    goals = [(1, 1), (1, 1), (3, 1), (8, 8)]
    problem = Problem(SQUARE, robots, [(1, 9), (2, 9), (4, 9), (6, 9)], goals)
    function, plrs = _planning.heuristic_of(Heuristic.plr, problem, robot_distance_fns(problem), 300, 0)
    assert len(plrs) == 3
    assert function.per_robot(np.array([[[1.0, 5.0]] * 4]))[0, [0, 3]] == pytest.approx([4, np.hypot(7, 3)], abs=0.2)


def test_the_lower_bound_counts_ways_and_turns():
    disc, rectangle = DiscRobot(0.5), RectangleRobot(1.6, 1.2)  # half its diagonal: 1
    problem = Problem(SQUARE, [disc, rectangle], [(1, 1, 0), (5, 5, 0.5)], [(4, 5, 3), (8, 9, 6.2)])
    turn = 0.5 + 2 * np.pi - 6.2
    assert _planning.lower_bound(problem, robot_distance_fns(problem)) == pytest.approx(5 + 5 + turn)
    problem = scenes.single_door()
    oracle = robot_distance_fns(problem)
    assert _planning.lower_bound(problem, oracle) == pytest.approx(oracle[0](problem.starts)[0])


def test_a_start_that_its_oracle_does_not_know_counts_as_the_straight_line():
    problem = Problem(SQUARE, [PointRobot()], [(1, 1)], [(4, 5)])
    assert _planning.lower_bound(problem, [lambda x: np.full(len(x), np.inf)]) == pytest.approx(5)


def test_robots_that_have_arrived_need_no_way(tmp_path):
    scenes.save(Problem(SQUARE, [PointRobot()] * 2, [(1, 1), (2, 2)], [(1, 1), (2, 2)]), tmp_path / "a.json")
    result = run(tmp_path / "a.json", "--heuristic", "oracle")
    assert result.exit_code == 0, result.output
    assert "robots     2 points\n" in result.stdout and "cost       0\n" in result.stdout


def test_scenes_and_files_are_read(tmp_path):
    sizes = {name: len(read_problem(name, None).robots) for name in TEAM_SCENES}
    points = {"maze": 1, "thin_maze": 1, "floor_plan": 1}
    assert sizes == {"single_door": 1, "four_rooms": 4, "cross": 2, "tangle": 2, **points}
    assert [len(read_problem("four_rooms", n).robots) for n in (2, 3, 8)] == [2, 3, 8]
    assert len(read_problem("cross", 3).robots) == 3
    (tmp_path / "a.yaml").write_text(YAML)
    scenes.save(scenes.tangle(), tmp_path / "a.json")
    np.testing.assert_array_equal(read_problem(str(tmp_path / "a.json"), None).goals, scenes.tangle().goals)
    result = run(tmp_path / "a.yaml", "--heuristic", "oracle", "-o", tmp_path / "path.json")
    assert result.exit_code == 0, result.output
    path = json.loads((tmp_path / "path.json").read_text())["path"]
    assert validate(scenes.read_dbcbs(tmp_path / "a.yaml"), path).valid


TRIANGLE = [(-1, 0), (1, 0), (0, 1)]


def test_teams_in_words():
    team = [DiscRobot(0.4), PointRobot(), DiscRobot(0.4), RectangleRobot(1.8, 0.5), *[PolygonRobot(TRIANGLE)] * 2]
    words = "2 discs of radius 0.4, 1 point, 1 rectangle 1.8 x 0.5, 2 polygons of 3 corners 2 x 1"
    assert _planning.describe(team) == words


def test_mistakes_are_explained_before_any_work(tmp_path):
    assert "SCENE must be a scene (single_door, four_rooms, " in mistake("four_roms")
    assert "none.json: No such file or directory" in mistake(tmp_path / "none.json")
    (tmp_path / "a.json").write_text('{"outer": [[0, 0], [3, 0], [0, 3]]}')
    assert "a.json: expected a scene file" in mistake(tmp_path / "a.json")
    (tmp_path / "a.yaml").write_text("a: [1\nb: 2")
    assert "a.yaml: expected YAML" in mistake(tmp_path / "a.yaml")
    assert "four_rooms has 2, 3, 4, 8 robots; there is none with 5" in mistake("four_rooms", "--robots", 5)
    assert "cross has 2, 3 robots; there is none with 4" in mistake("cross", "--robots", 4)
    assert "--robots is for the scenes four_rooms and cross, not for 'tangle'" in mistake("tangle", "--robots", 2)
    assert "batch must be an integer of at least 1, got 0" in mistake("maze", "--batch", 0)
    assert "step must be None or a positive finite number" in mistake("maze", "--step", -1)
    assert "a.csv must end in .json" in mistake("maze", "-o", tmp_path / "a.csv")
    assert "a.mp4 must end in .gif or .html" in mistake("maze", "--animation", tmp_path / "a.mp4")
    assert "a.txt must end in .png or .pdf or .svg" in mistake("maze", "--picture", tmp_path / "a.txt")
    assert f"{tmp_path / 'none'}: No such folder" in mistake("maze", "-o", tmp_path / "none" / "a.json")
    (tmp_path / "folder.json").mkdir()
    assert "folder.json: Is a directory" in mistake("maze", "-o", tmp_path / "folder.json")


def test_the_help_shows_the_defaults_of_the_planner():
    text = " ".join(run("--help").stdout.replace("│", " ").split())
    for field in ("batch", "branching", "width", "cost_factor", "time_limit", "max_expansions", "max_memory"):
        option = text.split(f"--{field.replace('_', '-')} ")[1].split(" --")[0]
        assert f"[default: {getattr(BLOptions, field):g}]" in option


def test_a_file_that_must_not_be_written_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)  # the tests may run as root, who may all
    with pytest.raises(PermissionError):
        require_writable(tmp_path / "a.json", (".json",))
    require_writable(None, (".json",))


def test_an_unknown_heuristic_is_refused_with_those_known():
    result = run("maze", "--heuristic", "exact")
    assert result.exit_code == 2
    for name in Heuristic:
        assert f"'{name}'" in result.stderr


def test_an_impossible_problem_is_refused(data_dir):
    message = mistake(data_dir / "dbcbs" / "infeasible_0.yaml")
    assert "Robots 0 and 1 overlap at their goals" in message


def test_no_path_is_exit_code_1_and_nothing_is_written(tmp_path):
    result = run("four_rooms", "--heuristic", "none", "--max-expansions", 3, "-o", tmp_path / "a.json")
    assert result.exit_code == 1
    assert "status     the limit on expansions was reached\n" in result.stdout
    assert "cost       none: no path was found\n" in result.stdout
    assert result.stderr == "Error: No path: the limit on expansions was reached.\n"
    assert not list(tmp_path.iterdir())


def test_an_invalid_path_is_exit_code_1_and_is_not_written(tmp_path, monkeypatch, door):
    problem = scenes.single_door()
    through_the_wall = replace(
        door, path=np.stack([problem.starts, problem.goals]), times=np.array([0, door.makespan])
    )
    monkeypatch.setattr(_planning, "bl_plan", lambda *arguments: through_the_wall)
    result = run("single_door", "--heuristic", "none", "-o", tmp_path / "a.json")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: The path found is not valid, and was not written: ")
    assert not list(tmp_path.iterdir())


def test_an_interrupted_search_still_writes_its_best_path(tmp_path, monkeypatch, door):
    interrupted = replace(door, status=Status.INTERRUPTED)
    monkeypatch.setattr(_planning, "bl_plan", lambda *arguments: interrupted)
    result = run("single_door", "--heuristic", "none", "-o", tmp_path / "a.json")
    assert result.exit_code == 130
    assert result.stderr == "Interrupted: the best path so far.\n"
    assert "status     interrupted by the user\n" in result.stdout
    np.testing.assert_array_equal(json.loads((tmp_path / "a.json").read_text())["path"], door.path)


def test_interrupting_before_there_is_a_path_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(q):
        raise KeyboardInterrupt

    monkeypatch.setattr(_planning, "straight_line", lambda problem: interrupt)
    result = run("single_door", "--heuristic", "straight-line", "-o", tmp_path / "a.json")
    assert result.exit_code == 130
    assert result.stderr == "Interrupted: no path yet.\n"
    assert not list(tmp_path.iterdir())


def test_interrupting_the_plrs_ends_the_command(monkeypatch):
    calls = []

    def interrupt_later(self, x):
        calls.append(len(x))
        if len(calls) == 3:
            raise KeyboardInterrupt
        return np.hypot(*x.T)

    monkeypatch.setattr("plr_jax.oracles.VisibilityGraph.__call__", interrupt_later)
    result = run("four_rooms")
    assert result.exit_code == 130
    assert result.stderr == "Interrupted.\n"
    assert len(calls) == 3
