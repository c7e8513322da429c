import io
import json
import re
import warnings

import numpy as np
import pytest
from cli_helpers import done, mistake, run
from PIL import Image

import plr_jax
from plr_jax import VisibilityGraph, construct, load, save, scenes
from plr_jax.cli.app import progress
from plr_jax.geometry.cell_sight import CellSources
from plr_jax.plr.leaves import leaf_names

MAZE = scenes.maze().workspace
ORACLE = VisibilityGraph(MAZE, scenes.maze().goals[0])
LABEL = "maze --goal=0.06,0.07"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.plr"


def test_build_keeps_the_budget_and_says_what_it_made(path):
    said = done("build", "maze", "-o", path, "--max-bytes", 700)
    assert path.stat().st_size <= 700
    plr = load(path)
    assert f"{path}: {path.stat().st_size} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}" in said
    assert plr.label == LABEL
    assert f"leaf    {plr.leaf.name}: no error above {plr.max_error:.3g}, proven" in said
    largest, mean = map(float, re.search(r"error   max (\S+), mean (\S+) over", said).groups())
    assert 0 < mean < largest <= plr.max_error
    assert "% of the largest distance" in said and "s to build" in said


@pytest.mark.parametrize("name", ["scan.png", "scan.yaml"])
def test_specks_are_counted_in_pixels_before_the_map_is_inflated(name, path, tmp_path):
    gray = np.full((400, 400), 255, np.uint8)
    gray[50:60, :150] = 0
    gray[100, 100] = gray[200:202, 200:202] = 0  # specks of 1 and 4 pixels
    gray[300, 300], gray[301, 301] = 0, 0  # one of 2, which touch in a corner
    gray[250, 100:105] = 0  # 5 pixels: none
    gray[52:54, 50] = 255  # a free place of 2
    Image.fromarray(gray).save(tmp_path / "scan.png")
    (tmp_path / "scan.yaml").write_text("image: scan.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    command = ["build", tmp_path / name, "--goal", "1,1", "-o", path, "--leaf", "plane", "--max-leaves", 9]
    command += ["--resolution", 0.05] if name == "scan.png" else []
    for radius, upper in ((), 20), (("--radius", 0.3), 19.7):
        said = done(*command, *radius)
        specks = r"4 specks of at most 4 pixels \(--drop-specks 4 drops them\)"
        assert re.search(rf"map     [0-9]+ vertices, [0-9.]+ x [0-9.]+ workspace units, {specks}\n", said)
        np.testing.assert_allclose(load(path).domain.hi, upper)
    assert "units, 1 speck of at most 4" in done(*command, "--drop-specks", 2)  # the one of 4 pixels
    assert re.search("map     [0-9]+ vertices, 20 x 20 workspace units\n", done(*command, "--drop-specks", 4))
    if name == "scan.png":
        assert "vertices, 400 x 400 pixels\n" in done(*command[:-2], "--drop-specks", 4)


def test_build_reports_where_a_contact_of_walls_limits_the_proof(path, tmp_path):
    gray = np.full((6, 8), 255, np.uint8)
    gray[2, :4] = gray[3, 4:7] = 0  # walls that touch only in the point (4, 3)
    command = ["build", tmp_path / "scan.png", "--goal", "1,1", "-o", path, "--leaf", "cone", "--tolerance", 0.01]
    Image.fromarray(gray).save(tmp_path / "scan.png")
    said, note = done(*command), "walls touch in the point (4, 3), where the distance jumps by up to "
    assert "--tolerance 0.01 was not reached" in said
    assert load(path).max_error >= float(said.split(note)[1].split(":")[0]) / 2 > 3
    gray[2, 4] = 0  # thicker
    Image.fromarray(gray).save(tmp_path / "scan.png")
    said = done(*command)
    assert load(path).max_error < 0.0101 and "touch" not in said and "not reached" not in said


def test_build_is_construct(path, tmp_path, monkeypatch):
    limits = {"max_bytes": 700, "max_leaves": 9, "max_depth": 4, "tolerance": 0.01, "seed": 3}
    options = [word for name, value in limits.items() for word in (f"--{name.replace('_', '-')}", value)]
    limits["max_bytes"] -= len(LABEL) + 4  # for which there is room in the file
    built = {leaf: construct(ORACLE, MAZE.bounds, leaf=leaf, certified=True, **limits) for leaf in leaf_names()}
    for leaf, plr in built.items():
        done("build", "maze", "--leaf", leaf, "-o", path, *options)
        assert path.read_bytes() == plr.with_label(LABEL).to_bytes()
    monkeypatch.chdir(tmp_path)
    done("build", "maze", *options)
    assert load("maze.plr").max_error == min(plr.max_error for plr in built.values())


def test_several_goals_make_a_file_that_names_the_nearest(tmp_path):
    path, goals = tmp_path / "exits.plr", ["--goal", "0.06,0.07", "-g", "0.9,0.1"]
    said = done("build", "maze", *goals, "-o", path, "--leaf", "cone", "--max-bytes", 600)
    assert "proven" in said and load(path).label == "maze '--goal=0.06,0.07;0.9,0.1'"
    answers = done("query", path, "--bounds", "--which", input="0.9,0.1\n0.07,0.07\n2,2\n").split()
    assert [answer.split(",")[3] for answer in answers] == ["1", "0", "-1"]
    for kind in ("distance", "error"):
        done("plot", path, "--kind", kind, "-o", tmp_path / "a.png")
    one = tmp_path / "one.plr"
    done("build", "maze", "-o", one, "--leaf", "cone", "--max-bytes", 300)
    assert "build it with --leaf cone and several --goal" in mistake("query", one, "--which", input="0.1,0.1\n")


def test_a_goal_beyond_the_polygons_of_geojson_is_told_of_the_bbox(path, tmp_path):
    yard, ring = tmp_path / "yard.geojson", [[2, 2], [4, 2], [4, 3], [2, 2]]
    document = {"type": "Polygon", "coordinates": [ring]}
    command = ["build", yard, "--goal", "1,1", "-o", path, "--max-leaves", 4, "--leaf", "plane"]
    yard.write_text(json.dumps(document))
    error = mistake(*command)
    assert "goal must be within the bounds Box([2.0, 2.0], [4.0, 3.0])" in error and '"bbox"' in error
    yard.write_text(json.dumps({**document, "bbox": [0, 0, 6, 5]}))
    done(*command)
    assert '"bbox"' in done("build", "--help")


def test_what_a_reader_warns_of_is_a_line(path, tmp_path):
    town = tmp_path / "town.geojson"
    ring = [[11.40, 48.10], [11.41, 48.10], [11.41, 48.11], [11.40, 48.10]]
    town.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    limits = ("--max-leaves", 4, "--leaf", "plane")
    for command in (["build", town, "--goal", "11.401,48.109", "-o", path, *limits], ["plot", path, "-o", path]):
        result = run(*command[:-1], f"{path}.png" if command[0] == "plot" else command[-1])
        assert result.exit_code == 0, result.output
        assert result.stderr.startswith(f"Warning: {town}: coordinates look like degrees")
        assert result.stderr.count("\n") == 1 and ".py" not in result.stderr


@pytest.mark.parametrize(
    ("map_", "options", "message"),
    [
        ("mace", [], "must be a scene (maze, thin_maze, floor_plan) or a file of a map"),
        ("none.map", ["--goal", "1,1"], "none.map: No such file or directory"),
        ("grid.map", [], "give --goal X,Y"),
        ("team.json", [], "one for each of several robots"),
        ("maze", ["--goal", "1;2"], "--goal must be two numbers X,Y"),
        ("maze", ["--goal", "1,1", "--goal", "2"], "such as 3,28, got '2'"),
        ("maze", ["--goal", "0.1234567890123456,0.1"] * 60, "of 60 goals: give fewer goals, or fewer digits"),
        ("bow.json", ["--goal", "0.5,0.1"], "bow.json"),
        ("maze", ["--goal", "0.5,0.45"], "goal [0.5, 0.45] lies in an obstacle"),
        ("cave.3dmap", ["--goal", "1,1,1"], "MAP must be a map in the plane, got the volume cave.3dmap"),
        ("maze", ["--goal", "1.5,0.5"], "goal [1.5, 0.5] lies outside the bounds"),
    ],
)
def test_build_explains_mistakes(map_, options, message, path, maps, monkeypatch):
    monkeypatch.chdir(maps)
    assert message in mistake("build", map_, *options, "-o", path)
    assert not path.exists()


@pytest.mark.parametrize("leaf", ["best", "plane"])
def test_a_budget_that_is_too_small_is_told_with_one_that_is_enough(leaf, path):
    def said(option, size, *others):
        error = mistake("build", "maze", "--leaf", leaf, "-o", path, option, size, *others)
        assert f"Error: {option} {size} is too small: " in error
        return int(re.search(r"allow at least ([0-9]+)\.", error).group(1))

    enough = said("--max-bytes", 3)
    assert said("--max-bytes", enough - 1) == enough
    done("build", "maze", "--leaf", leaf, "-o", path, "--max-bytes", enough)
    assert path.stat().st_size <= enough


def test_a_goal_of_two_arguments_is_told_how_to_be_one():
    for goal in (("3", "28"), ("-3", "2.5")):
        result = run("build", "maze", "--goal", *goal)
        assert result.exit_code == 2 and "a goal must be one argument X,Y" in result.output.replace("\n", " ")


def test_interrupting_a_build_keeps_what_is_there_and_ends_with_130(path, monkeypatch):
    calls, last_call = [], 4
    parts = CellSources.parts

    def interrupt_later(self, *arguments):
        calls.append(len(arguments))
        if len(calls) == last_call:
            raise KeyboardInterrupt
        return parts(self, *arguments)

    monkeypatch.setattr(CellSources, "parts", interrupt_later)
    result = run("build", "maze", "-o", path, "--leaf", "plane")
    assert result.exit_code == 130
    assert re.fullmatch(r"Interrupted: .*out.plr holds the [0-9]+ leaves built so far.\n", result.stderr)
    plr = load(path)
    assert plr.num_leaves > 1 and plr.leaf.name == "plane" and plr.max_error > 0
    x = MAZE.sample_free(2_000, 0)
    lower, upper = plr.bounds(x)
    assert ((lower <= ORACLE(x)) & (ORACLE(x) <= upper)).all(), "what there is, is proven"


def test_bounds_of_cells_are_narrower_and_need_a_proof(path):
    widths = []
    for options in ([], ["--leaf-bounds"]):
        done("build", "maze", "--leaf", "cone", "--max-bytes", 400, *options, "-o", path)
        said = done("query", path, "-", "--bounds", input="0.3,0.85\n0.9,0.9\n")
        distance, lower, upper = np.loadtxt(said.splitlines(), delimiter=",").T
        assert ((lower <= distance) & (distance <= upper)).all()
        widths.append((upper - lower).mean())
    assert widths[1] < widths[0]
    save(construct(lambda x: np.hypot(*x.T), MAZE.bounds, max_leaves=4), path)
    result = run("query", path, "-", "--bounds", input="0.3,0.85\n")
    assert result.exit_code == 2 and "--bounds needs a file with proven bounds" in result.stderr


def test_a_warning_of_something_else_does_not_end_a_build_and_an_interrupt_before_a_tree_leaves_nothing(
    path, monkeypatch
):
    cell_sources = VisibilityGraph.cell_sources

    def with_warning(self, domain):
        warnings.warn("of something else", RuntimeWarning, stacklevel=1)
        return cell_sources(self, domain)

    def interrupt(self, domain):
        raise KeyboardInterrupt

    monkeypatch.setattr(VisibilityGraph, "cell_sources", interrupt)
    result = run("build", "maze", "-o", path)
    assert (result.exit_code, result.stderr) == (130, "Interrupted.\n") and not path.exists()
    monkeypatch.setattr(VisibilityGraph, "cell_sources", with_warning)
    result = run("build", "maze", "--max-bytes", 300, "-o", path)
    assert (result.exit_code, result.stderr) == (0, "Warning: of something else\n")
    assert "leaf    cone: no error above" in result.stdout


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self):
        return True


def test_a_terminal_shows_what_is_being_done_and_then_no_more(monkeypatch):
    for stream, said in ((Terminal(), ["reading a ...", "\r\x1b[K"]), (io.StringIO(), ["", ""])):
        monkeypatch.setattr("sys.stderr", stream)
        with progress("reading a"):
            assert stream.getvalue() == said[0]
        assert stream.getvalue() == "".join(said)


def test_a_round_robot_has_a_radius(tmp_path):
    path = tmp_path / "maze.plr"
    said = done("build", "maze", "--radius", 0.02, "--leaf", "plane", "--max-leaves", 30, "-o", path)
    assert "the disc's own distances are not smaller" in said
    plr, workspace = plr_jax.load(path), scenes.maze().workspace.inflate(0.02)
    assert plr.label == "maze --goal=0.06,0.07 --radius=0.02" and plr.domain == workspace.bounds
    x = workspace.sample_free(1000, seed=0)
    exact = plr_jax.VisibilityGraph(workspace, (0.06, 0.07))(x)
    assert np.abs(plr(x) - exact).max() <= plr.max_error
    # Obstacles that Shapely grows by polygons around the circles of the radius have longer ways.
    grown = [obstacle.buffer(0.02 / np.cos(np.pi / 64), quad_segs=16) for obstacle in MAZE.obstacles]
    outside = plr_jax.Workspace(workspace.bounds, grown)
    x, exact = x[outside.is_free(x)], exact[outside.is_free(x)]
    assert len(x) > 900 and (plr_jax.VisibilityGraph(outside, (0.06, 0.07))(x) >= exact - 1e-9).all()
    done("plot", path, "--kind", "error", "-o", tmp_path / "error.png")  # beside the same distance
    assert "leaves no free space" in mistake("build", "maze", "--radius", 1, "-o", path)
