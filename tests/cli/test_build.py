import io
import json
import re
import time
import warnings

import numpy as np
import pytest
from cli_helpers import mistake, run
from PIL import Image

import plr_jax
from plr_jax import VisibilityGraph, construct, scenes
from plr_jax._io import load, save
from plr_jax.cli._app import saying
from plr_jax.cli._build import build_file
from plr_jax.oracles.cells.cell_sources import VisibleSources
from plr_jax.plr import _construct, from_bytes
from plr_jax.plr.leaves import leaf_names


def test_build_makes_every_kind(maze):
    assert load(maze).leaf.name == maze.stem
    assert maze.stat().st_size <= 300


def test_build_keeps_the_budget_and_says_what_it_made(tmp_path):
    path = tmp_path / "out.plr"
    result = run("build", "maze", "-o", path, "--max-bytes", 700)
    assert result.exit_code == 0
    assert path.stat().st_size <= 700
    plr = load(path)
    assert f"{path}: {path.stat().st_size} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}" in result.stdout
    assert plr.label == "maze --goal=0.06,0.07"
    assert f"leaf    {plr.leaf.name}: no error above {plr.max_error:.3g}, proven" in result.stdout
    largest, mean = map(float, re.search(r"error   max (\S+), mean (\S+) over", result.stdout).groups())
    assert 0 < mean < largest <= plr.max_error
    for word in ("% of the largest distance", "s to build"):
        assert word in result.stdout


def test_a_picture_is_built_and_drawn_and_its_specks_are_told(tmp_path):
    gray = np.full((400, 400), 255, np.uint8)
    gray[50:60, :150], gray[100, 100] = 0, 0
    Image.fromarray(gray).save(tmp_path / "scan.png")
    path, options = tmp_path / "scan.plr", ["--goal", "1,1", "--resolution", 0.05]
    result = run("build", tmp_path / "scan.png", *options, "-o", path, "--max-leaves", 40, "--leaf", "plane")
    assert result.exit_code == 0, result.output
    assert "map     12 vertices, 4 of them of specks (1; --drop-specks N drops" in result.stdout
    assert result.stderr == ""
    np.testing.assert_allclose(load(path).domain.hi, 20)
    result = run("plot", path, "--map", tmp_path / "scan.png", *options, "-o", tmp_path / "scan.svg")
    assert result.exit_code == 0, result.output
    dropped = run("build", tmp_path / "scan.png", *options, "--drop-specks", 1, "-o", path, "--max-leaves", 8)
    assert "map     8 vertices\n" in dropped.stdout


def test_a_budget_that_cannot_name_the_corners_is_not_tried_with_leaves_that_do(tmp_path):
    gray = np.full((60, 60), 255, np.uint8)
    gray[3::6, 3::6] = 0
    Image.fromarray(gray).save(tmp_path / "dots.png")
    for max_bytes, is_tried in ((300, False), (2000, True)):
        options = ["--goal", "1,1", "-o", tmp_path / "dots.plr", "--max-bytes", max_bytes]
        result = run("build", tmp_path / "dots.png", *options)
        assert result.exit_code == 0, result.output
        assert ("cone" in result.stdout) == is_tried


def test_cones_are_built_alone_where_all_corners_have_room(tmp_path):
    for options, is_alone in (
        (["--max-bytes", 200], True),  # of 13 corners
        (["--max-bytes", 80], False),
        (["--max-bytes", 200, "--max-leaves", 20], False),
        (["--tolerance", 0.05], True),
    ):
        result = run("build", "maze", "-o", tmp_path / "out.plr", *options)
        assert result.exit_code == 0, result.output
        built = re.search(r"^leaf    (\w+): no error above \S+, proven(.*)$", result.stdout, re.MULTILINE)
        assert built is not None
        assert (built[1] == "cone" and not built[2]) == is_alone


def test_build_takes_every_kind_of_map(tmp_path):
    (tmp_path / "small.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..@\n")
    scenes.save(scenes.maze(), tmp_path / "scene.json")
    (tmp_path / "polygons.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    for name, goal in [("small.map", "0.5,0.5"), ("scene.json", None), ("polygons.json", "1,1")]:
        path = tmp_path / f"{name}.plr"
        given = ["--goal", goal] if goal else []
        result = run("build", tmp_path / name, *given, "-o", path, "--max-leaves", 8)
        assert result.exit_code == 0, result.output
        assert load(path).num_leaves <= 8


def test_build_is_deterministic_and_its_goal_can_be_chosen(tmp_path):
    for name, extra in [("a", []), ("b", []), ("c", ["--goal", "0.9,0.1"])]:
        assert run("build", "maze", "-o", tmp_path / name, "--max-leaves", 20, *extra).exit_code == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    at_goal = np.asarray(load(tmp_path / "c")(np.array([[0.9, 0.1]])))
    assert at_goal[0] < 0.1 < np.asarray(load(tmp_path / "a")(np.array([[0.9, 0.1]])))[0]


def test_build_prepares_a_map_once(tmp_path, monkeypatch):
    out, oracle = tmp_path / "out.plr", tmp_path / "maze.npz"
    limits = ("-o", out, "--max-leaves", 20)
    assert run("build", "maze", *limits, "--oracle", oracle, "--goal", "0.9,0.1").exit_code == 0
    assert run("build", "maze", *limits).exit_code == 0
    expected = out.read_bytes()
    monkeypatch.setattr("plr_jax.oracles._visibility_graph.corner_visibility", None)
    assert run("build", "maze", *limits, "--oracle", oracle).exit_code == 0
    assert out.read_bytes() == expected
    assert "maze.npz was prepared for another map" in mistake("build", "thin_maze", *limits, "--oracle", oracle)
    limits = ("-o", tmp_path / "b.plr", "--max-leaves", 20)
    assert "cannot be read as a visibility graph" in mistake("build", "maze", *limits, "--oracle", out)


def test_build_names_its_file_after_the_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("build", "maze", "--max-depth", 3).exit_code == 0
    assert load(tmp_path / "maze.plr").depth <= 3


def test_build_is_construct(tmp_path):
    limits = {"max_bytes": 700, "max_leaves": 9, "max_depth": 4, "tolerance": 0.01, "seed": 3}
    options = [word for name, value in limits.items() for word in (f"--{name.replace('_', '-')}", value)]
    workspace = scenes.maze().workspace
    oracle = VisibilityGraph(workspace, scenes.maze().goals[0])
    label = "maze --goal=0.06,0.07"
    limits["max_bytes"] -= len(label) + 4  # for which there is room in the file
    built = {leaf: construct(oracle, workspace.bounds, leaf=leaf, certified=True, **limits) for leaf in leaf_names()}
    for leaf, plr in built.items():
        assert run("build", "maze", "--leaf", leaf, "-o", tmp_path / "out.plr", *options).exit_code == 0
        assert (tmp_path / "out.plr").read_bytes() == plr.with_label(label).to_bytes()
    assert run("build", "maze", "-o", tmp_path / "best.plr", *options).exit_code == 0
    assert load(tmp_path / "best.plr").max_error == min(plr.max_error for plr in built.values())


def test_build_begins_a_file_with_coarser_ones(tmp_path):
    path, prefixes = tmp_path / "out.plr", (300, 1000)
    options = [word for prefix in prefixes for word in ("--prefix", prefix)]
    result = run("build", "maze", "-o", path, "--leaf", "cone", "--max-bytes", 4000, *options)
    assert result.exit_code == 0, result.output
    plr, data = load(path), path.read_bytes()
    assert len(data) <= 4000 and len(plr.file_marks) == 2
    x = scenes.maze().workspace.sample_free(2000, seed=0)
    exact, errors = VisibilityGraph(scenes.maze().workspace, scenes.maze().goals[0])(x), []
    for most, mark in zip((*prefixes, 4000), (*plr.file_marks, len(data)), strict=True):
        assert most - 100 < mark <= most
        found = from_bytes(data[:mark])
        errors.append(found.max_error)
        assert np.abs(np.asarray(found(x)) - exact).max() <= found.max_error
        assert found.label == plr.label
    assert errors == sorted(errors, reverse=True)
    assert f"coarser in its first {plr.file_marks[0]}, {plr.file_marks[1]}" in result.stdout
    told = run("info", path).stdout
    for mark in plr.file_marks:
        part = from_bytes(data[:mark])
        proof = f"{part.num_leaves:,} leaves, proof largest error {part.max_error:.3g}\n"
        assert f"coarser    in its first {mark} bytes: {proof}" in told
    (tmp_path / "cut.plr").write_bytes(data[: plr.file_marks[0]])
    assert "coarser" not in run("info", tmp_path / "cut.plr").stdout
    assert "Prefixes must rise" in mistake("build", "maze", "-o", path, "--prefix", 500, "--prefix", 400)
    assert "Prefixes must rise" in mistake("build", "maze", "-o", path, "--max-bytes", 500, "--prefix", 500)


def test_a_goal_beyond_the_polygons_of_geojson_is_told_of_the_bbox(tmp_path):
    path, ring = tmp_path / "yard.geojson", [[2, 2], [4, 2], [4, 3], [2, 2]]
    yard, out = {"type": "Polygon", "coordinates": [ring]}, ("-o", tmp_path / "out.plr", "--max-leaves", 4)
    path.write_text(json.dumps(yard))
    error = mistake("build", path, "--goal", "1,1", *out)
    assert "goal [1.0, 1.0] lies outside the bounds Box([2.0, 2.0], [4.0, 3.0])" in error and '"bbox"' in error
    path.write_text(json.dumps({**yard, "bbox": [0, 0, 6, 5]}))
    assert run("build", path, "--goal", "1,1", *out).exit_code == 0
    assert '"bbox"' in run("build", "--help").stdout


def test_what_a_reader_warns_of_is_a_line(tmp_path):
    town = [[11.40, 48.10], [11.41, 48.10], [11.41, 48.11], [11.40, 48.10]]
    path, out = tmp_path / "town.geojson", tmp_path / "town.plr"
    path.write_text(json.dumps({"type": "Polygon", "coordinates": [town]}))
    limits = ("--max-leaves", 4, "--leaf", "plane")
    for command in (
        ["build", path, "--goal", "11.401,48.109", "-o", out, *limits],
        ["plot", out, "-o", f"{out}.png"],
    ):
        result = run(*command)
        assert result.exit_code == 0, result.output
        assert result.stderr.startswith(f"Warning: {path}: coordinates look like degrees")
        assert result.stderr.count("\n") == 1 and ".py" not in result.stderr


def test_build_explains_mistakes(tmp_path):
    (tmp_path / "small.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..@\n")
    scenes.save(scenes.four_rooms(2), tmp_path / "team.json")
    (tmp_path / "bow.json").write_text(json.dumps({"outer": [[0, 0], [1, 1], [1, 0], [0, 1]]}))
    out = ("-o", tmp_path / "out.plr")
    assert "must be a scene (maze, thin_maze, floor_plan) or a map's file" in mistake("build", "mace", *out)
    assert "none.map: No such file or directory" in mistake("build", tmp_path / "none.map", "--goal", "1,1", *out)
    assert "give one with --goal X,Y" in mistake("build", tmp_path / "small.map", *out)
    assert "one for each of several robots" in mistake("build", tmp_path / "team.json", *out)
    assert "--goal must be two numbers X,Y" in mistake("build", "maze", "--goal", "1;2", *out)
    assert "bow.json" in mistake("build", tmp_path / "bow.json", "--goal", "0.5,0.1", *out)
    assert "goal [0.5, 0.45] lies in an obstacle" in mistake("build", "maze", "--goal", "0.5,0.45", *out)
    assert "goal [1.5, 0.5] lies outside the bounds" in mistake("build", "maze", "--goal", "1.5,0.5", *out)
    assert not (tmp_path / "out.plr").exists()


@pytest.mark.parametrize("leaf", ["best", "plane"])
def test_a_budget_that_is_too_small_is_told_with_one_that_is_enough(leaf, tmp_path):
    def said(option, size, *others):
        error = mistake("build", "maze", "--leaf", leaf, "-o", path, option, size, *others)
        assert f"Error: {option} {size} is too small: " in error
        return int(re.search(r"allow at least ([0-9]+)\.", error).group(1))

    path = tmp_path / "out.plr"
    enough = said("--max-bytes", 3)
    assert said("--max-bytes", enough - 1) == enough
    assert run("build", "maze", "--leaf", leaf, "-o", path, "--max-bytes", enough).exit_code == 0
    assert path.stat().st_size <= enough
    with_mark = said("--prefix", 3)
    assert said("--prefix", with_mark - 1) == with_mark > enough


def test_a_file_that_has_no_room_for_finer_ones_is_told_how_much_is_too_little(tmp_path):
    options = ["--leaf", "plane", "-o", tmp_path / "out.plr", "--prefix", 300]
    error = mistake("build", "maze", *options, "--max-bytes", 350)
    assert "--max-bytes 350 is too small" in error
    least = int(re.search(r"allow more than ([0-9]+)\.", error).group(1))
    assert f"allow more than {least}." in mistake("build", "maze", *options, "--max-bytes", least)
    assert run("build", "maze", *options, "--max-bytes", least + 20).exit_code == 0


@pytest.mark.parametrize("goal", [("3", "28"), ("3,", "28"), ("-3", "2.5")])
def test_a_goal_of_two_arguments_is_told_how_to_be_one(goal):
    result = run("build", "maze", "--goal", *goal)
    assert result.exit_code == 2 and "a goal is one argument X,Y" in result.output.replace("\n", " ")


def test_interrupting_a_build_keeps_what_is_there_and_ends_with_130(tmp_path, monkeypatch):
    calls, last_call = [], 4
    parts = VisibleSources.parts

    def interrupt_later(self, *arguments):
        calls.append(len(arguments))
        if len(calls) == last_call:
            raise KeyboardInterrupt
        return parts(self, *arguments)

    monkeypatch.setattr(VisibleSources, "parts", interrupt_later)
    result = run("build", "maze", "-o", tmp_path / "out.plr", "--leaf", "plane")
    assert result.exit_code == 130
    assert re.fullmatch(r"Interrupted: .*out.plr holds the [0-9]+ leaves built so far.\n", result.stderr)
    assert len(calls) > last_call, "what there is, is proven"
    plr = plr_jax.load(tmp_path / "out.plr")
    assert plr.num_leaves > 1 and plr.leaf.name == "plane" and plr.max_error > 0


def test_a_prefix_as_large_as_what_comes_after_it_is_left_out(tmp_path):
    path = tmp_path / "out.plr"
    result = run("build", "maze", "-o", path, "--tolerance", 0.2, "--prefix", 300, "--leaf", "plane")
    assert result.exit_code == 0 and load(path).file_marks == () and load(path).max_error <= 0.2
    assert "prefixes as large as what comes after them are left out" in result.stderr


def test_an_interrupt_keeps_the_prefixes_that_are_done(tmp_path, monkeypatch):
    build, calls = _construct.construct_leaves, []

    def interrupted(*arguments, **limits):
        calls.append(limits["max_bytes"])
        if len(calls) == 1:
            return build(*arguments, **limits)
        warnings.warn("interrupted", plr_jax.plr.ConstructionInterrupted, stacklevel=1)
        return build(*arguments, **{**limits, "max_bytes": 100})

    monkeypatch.setattr(_construct, "construct_leaves", interrupted)
    path = tmp_path / "out.plr"
    result = run("build", "maze", "-o", path, "--max-bytes", 900, "--prefix", 300, "--leaf", "plane")
    assert result.exit_code == 130 and len(calls) == 2
    assert load(path).max_error > 0 and 200 < load(path).num_bytes <= 300


def test_bounds_of_cells_are_narrower_and_need_a_proof(tmp_path):
    widths = []
    for options in ([], ["--leaf-bounds"]):
        assert (
            run("build", "maze", "--leaf", "cone", "--max-bytes", 400, *options, "-o", tmp_path / "a.plr").exit_code
            == 0
        )
        result = run("query", tmp_path / "a.plr", "-", "--bounds", input="0.3,0.85\n0.9,0.9\n")
        distance, lower, upper = np.loadtxt(result.stdout.splitlines(), delimiter=",").T
        assert ((lower <= distance) & (distance <= upper)).all()
        widths.append((upper - lower).mean())
    assert widths[1] < widths[0]
    save(construct(lambda x: np.hypot(*x.T), ([0, 0], [1, 1]), max_leaves=4), tmp_path / "b.plr")
    result = run("query", tmp_path / "b.plr", "-", "--bounds", input="0.3,0.85\n")
    assert result.exit_code == 2 and "Nothing is proven" in result.stderr


def test_a_warning_of_something_else_does_not_end_a_build(tmp_path, monkeypatch):
    cell_sources = plr_jax.VisibilityGraph.cell_sources

    def with_warning(self, domain):
        warnings.warn("of something else", RuntimeWarning, stacklevel=1)
        return cell_sources(self, domain)

    monkeypatch.setattr(plr_jax.VisibilityGraph, "cell_sources", with_warning)
    result = run("build", "maze", "--max-bytes", 300, "-o", tmp_path / "out.plr")
    assert result.stderr == "Warning: of something else\n"
    assert result.exit_code == 0 and "leaf    cone: no error above" in result.stdout


def test_interrupting_before_there_is_a_tree_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(self, domain):
        raise KeyboardInterrupt

    monkeypatch.setattr("plr_jax.oracles.VisibilityGraph.cell_sources", interrupt)
    result = run("build", "maze", "-o", tmp_path / "out.plr")
    assert result.exit_code == 130
    assert result.stderr == "Interrupted.\n"
    assert not (tmp_path / "out.plr").exists()


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("prefixes", [(), (80,)])  # too few bytes for cones alone
def test_a_terminal_shows_what_is_being_built_of_how_much(prefixes, monkeypatch):
    maze = scenes.maze()
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    oracle = VisibilityGraph(maze.workspace, maze.goals[0])
    build_file(oracle, "", prefixes, "best", False, seed=0, max_bytes=700, max_leaves=500)
    said = terminal.getvalue()
    parts = ["part 1 of 2", "part 2 of 2"] if prefixes else ["file"]
    places = [
        re.search(rf"{part}: leaves of kind '{name}': .*\b{number}/{len(leaf_names())} ", said).start()
        for part in parts
        for number, name in enumerate(leaf_names())
    ]
    assert places == sorted(places)
    assert said.split("\r")[-1].strip() == "", "nothing of it is left"
    monkeypatch.setattr("sys.stderr", file := io.StringIO())
    build_file(oracle, "", prefixes, "plane", False, seed=0, max_bytes=700)
    assert file.getvalue() == ""


def test_a_terminal_shows_how_many_leaves_are_built(tmp_path, monkeypatch):
    """As long as it takes: here the clock of progress bars runs a thousand times faster."""
    maze, now = scenes.maze(), time.time
    monkeypatch.setattr("tqdm.std.time", lambda: 1000 * now())
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    oracle = VisibilityGraph(maze.workspace, maze.goals[0])
    for name in leaf_names():
        build_file(oracle, "", (), name, False, seed=0, max_bytes=None, max_leaves=200)
        assert re.search(r"construct: .*[1-9]\d*/200 ", terminal.getvalue())
        terminal.truncate(0)


def test_a_terminal_shows_what_is_being_done_and_then_no_more(monkeypatch):
    for stream, said in ((Terminal(), ["reading a ...", "\r\x1b[K"]), (io.StringIO(), ["", ""])):
        monkeypatch.setattr("sys.stderr", stream)
        with saying("reading a"):
            assert stream.getvalue() == said[0]
        assert stream.getvalue() == "".join(said)
