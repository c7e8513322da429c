import json
import os
import subprocess
import sys

import numpy as np
import pytest
from cli_helpers import done, mistake, run
from PIL import Image

import plr_jax
from plr_jax import (
    Box,
    GridGraph,
    VisibilityGraph,
    construct,
    construct_grid_pairs,
    construct_pairs,
    load,
    save,
    scenes,
)
from plr_jax.cli.build import _LEAVES
from plr_jax.plr.leaves import leaf_names


def table(text):
    return np.array([[float(number) for number in line.split(",")] for line in text.splitlines()])


def test_query_prints_what_the_plr_answers(maze, tmp_path):
    points = np.random.default_rng(0).random((50, 2))
    (tmp_path / "points.csv").write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in points.tolist()))
    answers = np.array(done("query", maze, tmp_path / "points.csv").split(), np.float32)  # of nine digits
    np.testing.assert_array_equal(answers, load(maze).numpy()(points))


def test_query_reads_standard_input_and_prints_gradients(maze):
    said = run("query", maze, "--gradient", input="0.1,0.1\n3,3\nnan,0.1\na,b\n0.1,0.1\n0.1,nan\n").stdout
    first, outside, *rows = table(said)
    plr, x, shift = load(maze), np.array([0.1, 0.1]), 2e-3
    assert first[0] == pytest.approx(float(plr(x)), rel=1e-6)
    for axis, step in enumerate(shift * np.eye(2)):
        assert first[1 + axis] == pytest.approx(float(plr(x + step) - plr(x - step)) / (2 * shift), abs=1e-3)
    assert outside[0] == np.inf
    np.testing.assert_array_equal(np.isnan(rows), np.array([[True], [True], [False], [True]]) & np.ones(3, bool))


def test_one_bad_row_is_one_bad_row(plane):
    result = run("query", plane, input="0.1,0.2\na,b\nnan,1\n0.3,0.4\n")
    assert result.exit_code == 0
    np.testing.assert_array_equal(np.isfinite(table(result.stdout))[:, 0], [True, False, False, True])
    said = "stdin, line 2: expected 2 comma-separated numbers, got 'a,b'"
    assert result.stderr == f"Warning: {said}; the answer is nan.\n"
    strict = run("query", plane, "--strict", input="0.1,0.2\na,b\n0.3,0.4\n")
    assert (strict.exit_code, strict.stdout) == (2, result.stdout.split("nan")[0])
    assert strict.stderr == f"Error: {said}.\n"


def test_query_explains_mistakes(plane, tmp_path):
    (tmp_path / "foreign.plr").write_text("not a PLR at all, but long enough to hold a header")
    (tmp_path / "points.csv").write_bytes(b"\xff\xfe\x00")
    for arguments, message in (
        ([plane], "stdin has no points"),
        ([plane, tmp_path / "none.csv"], "no such file"),
        ([tmp_path / "none.plr"], "no such file"),
        ([tmp_path / "foreign.plr"], "foreign.plr"),
        ([plane, tmp_path / "points.csv"], "points.csv must be a text file"),
        ([plane, tmp_path], "is a directory"),
    ):
        assert message in mistake("query", *arguments, input="").lower()


def test_export_writes_a_header(plane, tmp_path):
    done("export", plane, "-o", tmp_path / "level_1.h")
    done("export", plane, "--c", "-o", tmp_path / "b.h", "--name", "level_1")
    for name in ("level_1.h", "b.h"):
        assert (tmp_path / name).read_text() == load(plane).c_header("level_1")
    done("export", plane, "--compact", "-o", tmp_path / "small.h")
    assert (tmp_path / "small.h").read_text() == load(plane).c_header("small", compact=True)
    assert "a C identifier" in mistake("export", plane, "--c", "-o", tmp_path / "1.h")
    assert "leave out --goal" in mistake("export", plane, "--goal", "0,0", "-o", tmp_path / "a.h")
    assert "must end in .h" in mistake("export", plane, "--c", "-o", tmp_path / "a.txt")
    assert "No such folder" in mistake("export", tmp_path / "none.plr", "--c", "-o", tmp_path / "none" / "a.h")


def test_export_writes_a_module(plane, tmp_path):
    assert "bytes of text" in done("export", plane, "--js", "-o", tmp_path / "maze.mjs")
    assert (tmp_path / "maze.mjs").read_text() == load(plane).js_module()
    assert "must end in .mjs" in mistake("export", plane, "--js", "-o", tmp_path / "a.h")
    for option in (("--name", "a"), ("--compact",)):
        assert f"{option[0]} is for C headers" in mistake("export", plane, "--js", *option, "-o", tmp_path / "a.mjs")


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """A file of pairs of the maze, with its label, and one of a small grid."""
    folder, of_maze = tmp_path_factory.mktemp("pairs"), construct_pairs(scenes.maze().workspace, max_bytes=400)
    save(of_maze.with_label("maze"), folder / "maze.pairs")
    save(construct_grid_pairs(GridGraph(np.array([[1, 1, 1], [1, 0, 1]], bool))), folder / "grid.pairs")
    return folder / "maze.pairs", folder / "grid.pairs"


@pytest.mark.full
def test_pairs_are_answered_drawn_and_exported(pairs, tmp_path):
    (points, grid), ends = pairs, "0.1,0.1,0.9,0.9\n0.5,0.1,0.5,0.1\n3,3,0.1,0.1\n"
    answers = table(run("query", points, "--bounds", input=ends).stdout)
    exact = VisibilityGraph(scenes.maze().workspace, (0.9, 0.9))([[0.1, 0.1]])[0]
    assert answers[0, 0] == pytest.approx(exact, rel=0.02) and answers[0, 1] <= exact <= answers[0, 2]
    assert answers[1, 0] == 0 and answers[2, 0] == np.inf
    assert done("query", grid, input="0,0,1.5,0.5\n0,1,2,1\n0,0,1,1\n").split() == ["1", "4", "inf"]
    for path, kind in ((points, "distance"), (points, "cells"), (points, "error"), (grid, "distance")):
        done("plot", path, "--goal", "0.1,0.1", "--kind", kind, "-o", tmp_path / "a.png")
    done("export", points, "--goal", "0.1,0.1", "-o", tmp_path / "maze.h")
    assert (tmp_path / "maze.h").read_text() == load(points).to((0.1, 0.1)).c_header("maze")
    for goal, module in (([], load(points)), (["--goal", "0.1,0.1"], load(points).to((0.1, 0.1)))):
        done("export", points, *goal, "--js", "-o", tmp_path / "maze.mjs")
        assert (tmp_path / "maze.mjs").read_text() == module.js_module()
    assert "grid.tables" in done("export", grid, "--c", "-o", tmp_path / "grid.h")
    header = load(grid).c_header("grid")
    assert (tmp_path / "grid.h").read_text() == header.text
    assert (tmp_path / "grid.tables").read_bytes() == header.table
    for arguments, message in (
        (["export", grid, "--js", "-o", tmp_path / "a.mjs"], "cells of a grid, which only C headers support"),
        (["export", points, "-o", tmp_path / "a.h"], "any two points: give one of them with --goal"),
        (["export", grid, "--goal", "0,0", "-o", tmp_path / "a.h"], "leave out --goal"),
        (["export", grid, "--compact", "-o", tmp_path / "a.h"], "leave out --compact"),
        (["plot", grid, "-o", tmp_path / "a.png"], "any two points: give one of them with --goal"),
        (["plot", grid, "--goal", "0,0", "--kind", "cells", "-o", tmp_path / "a.png"], "--kind must be distance"),
        (["query", points, "--gradient"], "--gradient and --which need a file of a PLR"),
        (
            ["plot", points, "--goal", "0,0", "--goal", "1,1", "-o", tmp_path / "a.png"],
            "give one of them with --goal",
        ),
    ):
        assert message in mistake(*arguments, input="")
    assert "holds      GridPairs\n" in done("info", grid)


@pytest.mark.usefixtures("unchecked_types")
def test_view_writes_a_page(maze, pairs, tmp_path):
    (points, grid), page = pairs, tmp_path / "a.html"
    assert "open it in a browser" in done("view", maze, "maze", "-o", page)
    assert page.read_text(encoding="utf-8") == plr_jax.plot.page(load(maze), scenes.maze().workspace).html
    assert "covers Box([0.0, 0.0], [1.0, 1.0])" in run("view", maze, "floor_plan", "-o", page).stderr
    done("view", points, "-o", page)
    assert page.read_text(encoding="utf-8") == plr_jax.plot.page(load(points)).html
    assert "needs a PLR or a PairPLR" in mistake("view", grid, "-o", page)
    assert "must end in .html" in mistake("view", maze, "-o", tmp_path / "a.png")


def test_info_is_told_to_programs_as_well(maze, pairs):
    plr, facts = load(maze), json.loads(done("info", maze, "--json"))
    assert facts["num_leaves"] == plr.num_leaves and facts["max_error"] == plr.max_error and facts["hi"] == [1, 1]
    of_pairs = [json.loads(done("info", path, "--json")) for path in pairs]
    assert [each["holds"] for each in of_pairs] == ["PairPLR", "GridPairs"] and of_pairs[0]["label"] == "maze"


def test_a_shell_completes_maps_and_choices():
    for words, expected in ((("build", "ma"), "maze"), (("build", "maze", "--leaf", "co"), "continuous\ncone")):
        completing = {"_PLR_JAX_COMPLETE": "complete_bash", "COMP_CWORD": str(len(words))}
        completing["COMP_WORDS"] = "plr-jax " + " ".join(words)
        code = "import sys; sys.argv[0] = 'plr-jax'; from plr_jax.cli import main; main()"
        found = subprocess.run(
            [sys.executable, "-c", code], check=True, env=os.environ | completing, capture_output=True, text=True
        )
        assert found.stdout.strip() == expected, found.stderr


def test_choices_in_the_help_are_those_there_are():
    assert set(_LEAVES) == {"best", *leaf_names()}
    assert "[best|plane|continuous|" in done("build", "--help")


def test_info_says_what_is_in_the_file(maze):
    said, plr = done("info", maze), load(maze)
    for text in (
        f"leaf       {maze.stem}\n",
        "label      maze --goal=0.06,0.07\n",
        "[0.0, 0.0] to [1.0, 1.0] (2-D)",
        f"{plr.num_leaves:,}, of which 0 unreachable",
        f"{plr.num_bytes:,} in the file, {plr.resident_bytes:,} in memory",
    ):
        assert text in said


@pytest.mark.parametrize(
    ("domain", "said"),
    [
        (Box((0, -1), (1, 1), periodic=(False, True)), "[0.0, -1.0] to [1.0, 1.0] (2-D, periodic along axes [1])"),
        (Box((0,), (146 * 0.05,)), "[0.0] to [7.3] (1-D)\n"),  # without what arithmetic made of the last digits
    ],
)
def test_info_tells_domains(domain, said, tmp_path):
    save(construct(lambda x: np.cos(np.pi * x[:, -1]), domain, max_leaves=3), tmp_path / "a.plr")
    assert "domain     " + said in done("info", tmp_path / "a.plr")


@pytest.mark.parametrize("escape", ["\x1b]0;title\x07\x1b[2J", "\x9b2J", "\r\n\u2028", "\u202e"])
def test_no_terminal_obeys_a_label(escape, plane, tmp_path):
    path, shown = tmp_path / "hostile.plr", escape.encode("unicode_escape").decode()
    save(load(plane).with_label(f"'{escape}.png' --goal=0,0"), path)
    told, drawn = done("info", path), run("plot", path, "-o", tmp_path / "a.png")
    assert f"label      '{shown}.png' --goal=0,0\n" in told
    assert drawn.exit_code == 0 and drawn.stderr.count("\n") == 1
    refused = mistake("plot", path, "--kind", "error", "-o", tmp_path / "a.png")
    for said in (told, drawn.output, refused):
        assert all(char.isprintable() or char == "\n" for char in said)


def test_what_cannot_be_written_is_found_out_before_any_work(tmp_path, monkeypatch):
    for name in ("scenes.maze", "_io.load"):
        monkeypatch.setattr(f"plr_jax.{name}", lambda *_: pytest.fail("this is work"))
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    for command, name, message in (
        (["build", "maze"], "none/a.png", "No such folder"),
        (["build", "maze"], "", "Is a directory"),
        (["build", "maze"], "loop", "Too many levels"),
        (["build", "maze"], "x" * 300, "File name too long"),
        (["build", "maze"], "file/a.png", "Not a directory"),
        (["plot", "a.plr"], "none/a.png", "No such folder"),
        (["plot", "a.plr"], "folder.png", "folder.png: Is a directory"),
    ):
        assert message in mistake(*command, "-o", tmp_path / name)


def test_what_is_read_is_not_written_over(plane, maps, tmp_path):
    for name in ("grid.map", "team.json"):
        (tmp_path / name).write_bytes((maps / name).read_bytes())
    (tmp_path / "header.h").symlink_to(plane)
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for command, name in (
        (["build", tmp_path / "grid.map", "--goal", "1,0.5"], "grid.map"),
        (["export", plane, "--c"], "header.h"),
        (["plan", tmp_path / "team.json"], "team.json"),
    ):
        assert "is an input and must not be overwritten" in mistake(*command, "-o", tmp_path / name)
    assert files == {path: path.read_bytes() for path in tmp_path.iterdir()}


@pytest.mark.full
def test_demo_writes_what_it_says(tmp_path, monkeypatch):
    pair = plr_jax.scenes.four_rooms(2)
    monkeypatch.setattr("plr_jax.scenes.four_rooms", lambda num_robots: pair)
    small = {"_PLR_POINTS": 1000, "_ORACLE_POINTS": 100, "DEFAULT_BYTES": 500, "_GIF_SECONDS": 0.2}
    for name, value in small.items():
        monkeypatch.setattr(f"plr_jax.cli.demo.{name}", value)
    said = done("demo", "--output", tmp_path / "new" / "folder")
    pictures = ("maze_distance.png", "maze_error.png", "maze_surface.png", "four_rooms.html", "four_rooms.gif")
    pages = ("maze.html", "four_rooms_distances.html")
    for name in ("maze.plr", *pictures, *pages):
        path = tmp_path / "new" / "folder" / name
        assert path.stat().st_size > 0
        assert str(path) in said
    for word in (
        "bytes in the file",
        "max 0.0",
        "mean 0.0",
        "PLR / oracle",
        "times the lower bound",
        "Valid: clearance",
    ):
        assert word in said


def test_the_package_runs_as_a_module():
    command = [sys.executable, "-m", "plr_jax", "--help"]
    assert "build" in subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_help_has_an_example_and_the_version_is_that_of_the_package():
    for command in ([], ["build"], ["query"], ["export"], ["view"], ["info"], ["plot"], ["plan"], ["demo"]):
        assert f"plr-jax {command[0] if command else 'demo'}" in done(*command, "--help")
    assert done("--version") == f"plr-jax {plr_jax.__version__}\n"


@pytest.fixture
def unlabeled(plane, tmp_path):
    save(load(plane).with_label(""), tmp_path / "unlabeled.plr")
    return tmp_path / "unlabeled.plr"


@pytest.mark.parametrize("kind", ["distance", "cells", "surface", "error"])
def test_plot_knows_map_and_goal_from_the_file(kind, plane, tmp_path):
    for name, options in (("own", []), ("given", ["--map", "maze"])):
        path = tmp_path / f"{name}.png"
        assert f"wrote {path}" in done("plot", plane, *options, "--kind", kind, "-o", path)
    own = (tmp_path / "own.png").read_bytes()
    assert own.startswith(b"\x89PNG") and own == (tmp_path / "given.png").read_bytes()


def test_plot_finds_a_map_beside_the_file(maps, tmp_path, monkeypatch):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a.map").write_bytes((maps / "grid.map").read_bytes())
    monkeypatch.chdir(tmp_path / "maps")
    done("build", "a.map", "--goal", "0.5,0.5", "--leaf", "plane", "--max-leaves", 4)
    monkeypatch.chdir(tmp_path)
    done("plot", tmp_path / "maps" / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")


def test_plot_takes_goal_and_options_of_a_map_from_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gray = np.full((40, 60), 255, np.uint8)
    gray[10:30, 30:33] = 0
    for name in ("scan.png", "copy.png"):
        Image.fromarray(gray).save(name)
    options = ["--resolution", 0.05]
    done("build", "scan.png", "--goal", "0.3,0.3", *options, "-o", "scan.plr", "--max-leaves", 9, "--leaf", "plane")
    pictures = set()
    for given in ([], ["--map", "scan.png"], ["--map", "copy.png --resolution=0.05"]):
        done("plot", "scan.plr", *given, "--kind", "error", "-o", "a.png")
        pictures.add((tmp_path / "a.png").read_bytes())
    assert len(pictures) == 1
    for given in (["--map", "scan.png --resolution=1"], ["--map", "copy.png"]):
        result = run("plot", "scan.plr", *given, "-o", "other.png")
        assert result.exit_code == 0 and result.stderr.count("\n") == 1
        assert "Warning: the map covers Box([0.0, 0.0], [60.0, 40.0])" in result.stderr
        assert "covers Box([0.0, 0.0], [3.0, 2.0])" in result.stderr


def test_the_error_is_drawn_for_the_goal_that_is_given_else_that_of_the_file(plane, tmp_path):
    pictures = []
    for given in ([], ["--map", "maze"], ["--goal", "0.9,0.1"]):
        done("plot", plane, *given, "--kind", "error", "-o", tmp_path / "a.png")
        pictures.append((tmp_path / "a.png").read_bytes())
    assert pictures[0] == pictures[1] != pictures[2]


def test_plot_needs_no_map_and_says_which_file_it_wrote(unlabeled, tmp_path):
    done("plot", unlabeled, "-o", tmp_path / "picture.svg")
    assert (tmp_path / "picture.svg").read_text().startswith("<?xml")
    assert done("plot", unlabeled, "-o", tmp_path / "pic") == f"wrote {tmp_path / 'pic.png'}\n"
    assert (tmp_path / "pic.png").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kind", "error", "-o", "a.png"], "give --map"),
        (["-o", "a.docx"], "a.docx must end in .png or .pdf or .svg"),
        (["-o", "none/a.png"], "none: No such folder"),
        (["--goal", "0,0", "-o", "a.png"], "give --map together with --goal"),
        (["--map", "none.png", "-o", "a.png"], "Error: none.png: No such file or directory\n"),
    ],
)
def test_plot_explains_mistakes(options, message, unlabeled, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in mistake("plot", unlabeled, *options)


@pytest.mark.parametrize("kind", ["distance", "cells"])
def test_a_file_is_drawn_where_its_map_is_not(kind, plane, unlabeled, tmp_path):
    path, picture = tmp_path / "far.plr", tmp_path / "a.png"
    save(load(plane).with_label("elsewhere/scan.png --goal=0.06,0.07"), path)
    result = run("plot", path, "--kind", kind, "-o", picture)
    reason = "elsewhere/scan.png: No such file or directory"
    said = f"the map that {path} was built from cannot be read ({reason}): name it with --map"
    assert result.exit_code == 0, result.output
    assert result.stderr == f"Warning: {said}; drawn without its obstacles.\n"
    drawn, pictures = picture.read_bytes(), []
    for file, given in ((unlabeled, []), (path, ["--map", "maze", "--goal", "0.06,0.07"])):
        done("plot", file, "--kind", kind, *given, "-o", picture)
        pictures.append(picture.read_bytes())
    without_goal, with_walls = pictures
    assert drawn != with_walls
    assert (drawn == without_goal) == (kind != "distance")  # of which the goal is drawn
    assert said in mistake("plot", path, "--kind", "error", "-o", picture)


@pytest.mark.parametrize("label", ["the kitchen", "kitchen", "scan.png --goal=here"])
def test_a_label_that_names_no_map_is_any_text(label, plane, tmp_path):
    save(load(plane).with_label(label), tmp_path / "a.plr")
    done("plot", tmp_path / "a.plr", "-o", tmp_path / "a.png")
    error = mistake("plot", tmp_path / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")
    assert "does not name its map" in error
