"""The commands ``query``, ``info``, ``plot``, ``export`` and ``view``, which read files of PLRs and pairs."""

import json
import warnings

import numpy as np
import pytest
from cli_helpers import done, mistake, run
from PIL import Image

import plr_jax
from plr_jax import Box, VisibilityGraph, construct, load, save, scenes
from plr_jax.cli.inputs import SCENES
from plr_jax.cli.plan import _TEAM_SCENES
from plr_jax.plr import ConstructionInterrupted

GOAL, NUM_OBSTACLES = [0.06, 0.07], 6  # of the maze


def table(text):
    return np.array([[float(number) for number in line.split(",")] for line in text.splitlines()])


def test_query_prints_distances_of_points(maze, tmp_path):
    points = np.random.default_rng(0).random((50, 2))
    (tmp_path / "points.csv").write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in points.tolist()))
    answers = np.array(done("query", maze, tmp_path / "points.csv").split(), np.float32)  # printed with nine digits
    np.testing.assert_array_equal(answers, load(maze).numpy()(points))


def test_bad_row_gets_nan_and_a_warning(maze):
    result = run("query", maze, input="0.1,0.2\na,b\nnan,1\n0.3,0.4\n")
    assert result.exit_code == 0 and result.stderr.startswith("Warning: stdin, line 2: expected 2 ")
    np.testing.assert_array_equal(np.isfinite(table(result.stdout))[:, 0], [True, False, False, True])


def test_export_writes_headers_and_modules(maze, tmp_path):
    plr = load(maze).numpy()
    for options, name, text in (
        (["--c"], "level_1.h", plr.c_header("level_1")),
        (["--compact"], "small.h", plr.c_header("small", compact=True)),
        (["--js"], "maze.mjs", plr.js_module()),
    ):
        first, *costs = done("export", maze, *options, "-o", tmp_path / name).splitlines()
        assert "bytes of text" in first and (tmp_path / name).read_text() == text
        if "--js" in options:
            assert costs == []
            continue
        assert all(line.strip() in text for line in costs[:2]) and costs[0].strip().startswith("On a Cortex-M4: ")
        assert costs[0].endswith("; float and double numbers." if "--compact" in options else "; float numbers.")
        assert "a waypoint needs leaf 'cone'" in costs[1] and "Estimate: " in costs[2] and len(costs) == 4


def test_query_answers_pairs(pairs):
    (points, grid), ends = pairs, "0.1,0.1,0.9,0.9\n0.5,0.1,0.5,0.1\n3,3,0.1,0.1\n"
    answers = table(done("query", points, "--bounds", input=ends))
    exact = VisibilityGraph(scenes.maze().workspace, (0.9, 0.9))([[0.1, 0.1]])[0]
    assert answers[0, 0] == pytest.approx(exact, rel=0.02) and answers[0, 1] <= exact <= answers[0, 2]
    assert answers[1, 0] == 0 and answers[2, 0] == np.inf
    assert done("query", grid, input="0,0,1.5,0.5\n0,1,2,1\n0,0,1,1\n").split() == ["1", "4", "inf"]
    of_pairs = [json.loads(done("info", path, "--json")) for path in pairs]
    assert [each["holds"] for each in of_pairs] == ["PairPLR", "GridPairs"] and of_pairs[0]["label"] == "maze"


def test_pairs_are_plotted_and_exported(pairs, drawn, tmp_path):
    points, grid = pairs
    to_goal = ["--goal", "0.1,0.1"]
    for path, kind in ((points, "distance"), (points, "error"), (grid, "distance")):
        done("plot", path, *to_goal, "--kind", kind, "-o", tmp_path / "a.png")
    assert drawn == [(*drawing, [0.1, 0.1]) for drawing in (("distance", 6), ("error", 6), ("distance", 0))]
    printed = done("export", points, *to_goal, "--compact", "-o", tmp_path / "maze.h")
    assert "; float numbers." in printed and printed.endswith("\n        Functions: distance, waypoint.\n")
    done("export", points, *to_goal, "-o", tmp_path / "maze.h")
    assert (tmp_path / "maze.h").read_text() == load(points).to((0.1, 0.1)).c_header("maze")
    done("export", points, "--js", "-o", tmp_path / "maze.mjs")
    assert (tmp_path / "maze.mjs").read_text() == load(points).js_module()
    assert "grid.tables" in done("export", grid, "--c", "-o", tmp_path / "grid.h")
    header = load(grid).c_header("grid")
    assert (tmp_path / "grid.h").read_text() == header.text
    assert (tmp_path / "grid.tables").read_bytes() == header.table


@pytest.mark.full
def test_error_picture_has_the_numbers_of_build(tmp_path, monkeypatch):
    axes = []
    monkeypatch.setattr("plr_jax.plot.save", lambda ax, path: axes.append(ax))
    printed = done("build", "maze", "-o", tmp_path / "a.plr", "--max-bytes", 400, "--leaf", "cone")
    done("plot", tmp_path / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")
    assert f"error   {axes[0].get_title()}\n" in printed and "max" in axes[0].get_title()


def test_view_writes_a_page(maze, pairs, tmp_path):
    page = tmp_path / "a.html"
    assert "open it in a browser" in done("view", maze, "maze", "-o", page)
    assert page.read_text(encoding="utf-8") == plr_jax.plot.page(load(maze), scenes.maze().workspace).html
    done("view", pairs[0], "-o", page)
    assert page.read_text(encoding="utf-8") == plr_jax.plot.page(load(pairs[0])).html


@pytest.mark.parametrize(
    ("words", "expected"), [(["build", "ma"], "maze"), (["build", "maze", "--leaf", "co"], "continuous\ncone")]
)
def test_shell_completes_maps_and_choices(words, expected):
    environment = {"_PLR_JAX_COMPLETE": "complete_bash", "COMP_CWORD": str(len(words))}
    environment["COMP_WORDS"] = "plr-jax " + " ".join(words)
    assert run(env=environment, prog_name="plr-jax").stdout.strip() == expected


def test_info_describes_the_file(maze, tmp_path):
    printed, plr = done("info", maze), load(maze)
    assert f"\nleaf            plane\nresident_bytes  {plr.resident_bytes}\n" in printed
    facts = json.loads(done("info", maze, "--json"))
    assert [line.split()[0] for line in printed.splitlines()] == list(facts)
    names = ("label", "num_bytes", "num_leaves", "num_unreachable", "depth", "max_error", "resident_bytes")
    assert {name: facts[name] for name in names} == {name: getattr(plr, name) for name in names}
    domain = Box((0, -1), (146 * 0.05, 1), periodic=(False, True))  # 7.3 with a rounding error
    save(construct(lambda x: np.cos(np.pi * x[:, -1]), domain, max_leaves=3), tmp_path / "a.plr")
    facts = json.loads(done("info", tmp_path / "a.plr", "--json"))
    assert (facts["lo"], facts["hi"], facts["periodic_axes"]) == ([0, -1], [7.3, 1], [1])


@pytest.mark.parametrize("escape", ["\x1b]0;title\x07\x1b[2J", "\x9b2J", "\r\n\u2028", "\u202e"])
def test_labels_cannot_control_the_terminal(escape, maze, drawn, tmp_path):
    path, shown = tmp_path / "hostile.plr", escape.encode("unicode_escape").decode()
    save(load(maze).with_label(f"'{escape}.png' --goal=0,0"), path)
    info, plot = done("info", path), run("plot", path, "-o", tmp_path / "a.png")
    assert f"label           '{shown}.png' --goal=0,0\n" in info
    assert plot.exit_code == 0 and plot.stderr.count("\n") == 1
    refused = mistake("plot", path, "--kind", "error", "-o", tmp_path / "a.png")
    for printed in (info, plot.output, refused):
        assert all(char.isprintable() or char == "\n" for char in printed)


def test_inputs_are_not_overwritten(maze, maps, tmp_path):
    for name in ("grid.map", "team.json"):
        (tmp_path / name).write_bytes((maps / name).read_bytes())
    (tmp_path / "header.h").symlink_to(maze)
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for command, name in (
        (["build", tmp_path / "grid.map", "--goal", "1,0.5"], "grid.map"),
        (["export", maze, "--c"], "header.h"),
        (["plan", tmp_path / "team.json"], "team.json"),
    ):
        assert "is an input and must not be overwritten" in mistake(*command, "-o", tmp_path / name)
    assert files == {path: path.read_bytes() for path in tmp_path.iterdir()}


def test_interrupted_demo_ends(tmp_path, monkeypatch):
    def interrupted(*arguments, **options):
        warnings.warn("Interrupted: the PLR is incomplete.", ConstructionInterrupted, stacklevel=1)
        return construct(*arguments, max_leaves=4, **options)

    monkeypatch.setattr("plr_jax.construct", interrupted)
    result = run("demo", "--output", tmp_path)
    assert result.exit_code == 130
    assert result.stderr == f"Interrupted: {tmp_path / 'maze.plr'} holds the 4 leaves built so far.\n"


@pytest.mark.full
def test_demo_writes_and_prints_all_files(tmp_path, monkeypatch):
    pair = scenes.four_rooms(2)
    monkeypatch.setattr("plr_jax.scenes.four_rooms", lambda num_robots: pair)
    small = {"_PLR_POINTS": 1000, "_ORACLE_POINTS": 100, "DEFAULT_BYTES": 500, "_GIF_SECONDS": 0.2}
    for name, value in small.items():
        monkeypatch.setattr(f"plr_jax.cli.demo.{name}", value)
    printed = done("demo", "--output", tmp_path / "new" / "folder")
    files = ["maze.plr", "maze.html", "four_rooms.html", "four_rooms.gif", "four_rooms_distances.html"]
    files += [f"maze_{kind}.png" for kind in ("distance", "cells", "error")]
    for name in files:
        path = tmp_path / "new" / "folder" / name
        assert path.stat().st_size > 0 and str(path) in printed


def test_help_has_examples_and_choices():
    for command in ([], ["build"], ["query"], ["export"], ["view"], ["info"], ["plot"], ["plan"], ["demo"]):
        assert f"plr-jax {command[0] if command else 'demo'}" in done(*command, "--help")
    assert done("--version") == f"plr-jax {plr_jax.__version__}\n"


@pytest.mark.parametrize(("command", "names"), [("build", SCENES), ("plan", _TEAM_SCENES)])
def test_help_lists_all_scenes(command, names):
    words = done(command, "--help").replace("│", " ").split()
    assert f"A scene ({', '.join(names)})" in " ".join(words)


@pytest.mark.parametrize(("kind", "goal"), [("distance", GOAL), ("cells", None), ("error", GOAL)])
def test_plot_draws_map_and_goal_of_the_file(kind, goal, maze, drawn, tmp_path):
    for options in ([], ["--map", "maze"]):
        done("plot", maze, *options, "--kind", kind, "-o", tmp_path / "a.png")
    assert drawn == [(kind, NUM_OBSTACLES, goal)] * 2


def test_plot_writes_pictures(maze, tmp_path):
    for name, begin in (("a.png", b"\x89PNG"), ("a.svg", b"<?xml")):
        assert f"wrote {tmp_path / name}" in done("plot", maze, "--kind", "cells", "-o", tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)


def test_plot_finds_a_map_beside_the_file_and_reads_it_with_its_options(drawn, tmp_path, monkeypatch):
    gray = np.full((40, 60), 255, np.uint8)
    gray[10:30, 30:33] = 0
    (tmp_path / "maps").mkdir()
    Image.fromarray(gray).save(tmp_path / "maps" / "scan.png")
    monkeypatch.chdir(tmp_path / "maps")
    options = ["--resolution", 0.05, "--max-bytes", 300, "--leaf", "plane"]
    done("build", "scan.png", "--goal", "0.3,0.3", *options)
    monkeypatch.chdir(tmp_path)
    done("plot", "maps/scan.plr", "--kind", "error", "-o", "a.png")
    (tmp_path / "maps" / "scan.png").rename("copy.png")
    done("plot", "maps/scan.plr", "--map", "copy.png", "--kind", "error", "-o", "a.png")
    assert drawn == [("error", 1, [0.3, 0.3])] * 2


@pytest.mark.parametrize(("kind", "goal"), [("distance", GOAL), ("cells", None)])
def test_plot_without_map_draws_no_obstacles(kind, goal, maze, drawn, tmp_path):
    path, picture = tmp_path / "far.plr", tmp_path / "a.png"
    save(load(maze).with_label("elsewhere/scan.png --goal=0.06,0.07"), path)
    result = run("plot", path, "--kind", kind, "-o", picture)
    reason = "elsewhere/scan.png: No such file or directory"
    message = f"the map that {path} was built from cannot be read ({reason}): name it with --map"
    assert result.exit_code == 0, result.output
    assert result.stderr == f"Warning: {message}; drawn without its obstacles.\n"
    done("plot", path, "--kind", kind, "--map", "maze", "-o", picture)
    assert drawn == [(kind, 0, goal), (kind, NUM_OBSTACLES, goal)]
    assert message in mistake("plot", path, "--kind", "error", "-o", picture)


@pytest.mark.parametrize("label", ["the kitchen", "kitchen", "scan.png --goal=here"])
def test_labels_need_not_name_a_map(label, maze, drawn, tmp_path):
    save(load(maze).with_label(label), tmp_path / "a.plr")
    done("plot", tmp_path / "a.plr", "-o", tmp_path / "a.png")
    assert drawn == [("distance", 0, None)]
    error = mistake("plot", tmp_path / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")
    assert "does not name its map" in error
