import io
import json
import re
import warnings

import numpy as np
import pytest
from cli_helpers import done, mistake, run
from PIL import Image
from volume_files import VOXELS, stl_files

import plr_jax
from plr_jax import ConstructionInterrupted, VisibilityGraph, construct, load, save, scenes, solve_eikonal
from plr_jax.cli.app import saying
from plr_jax.cli.inputs import NamedMap
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


def test_specks_of_a_picture_are_told(path, tmp_path):
    gray = np.full((400, 400), 255, np.uint8)
    gray[50:60, :150], gray[100, 100] = 0, 0
    Image.fromarray(gray).save(tmp_path / "scan.png")
    command = ["build", tmp_path / "scan.png", "--goal", "1,1", "--resolution", 0.05, "-o", path, "--leaf", "plane"]
    said = done(*command, "--max-leaves", 9)
    assert "map     12 vertices, 4 of them of specks (1; --drop-specks N drops" in said
    np.testing.assert_allclose(load(path).domain.hi, 20)
    assert "map     8 vertices\n" in done(*command, "--drop-specks", 1, "--max-leaves", 8)


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


def test_a_goal_beyond_the_polygons_of_geojson_is_told_of_the_bbox(path, tmp_path):
    yard, ring = tmp_path / "yard.geojson", [[2, 2], [4, 2], [4, 3], [2, 2]]
    document = {"type": "Polygon", "coordinates": [ring]}
    command = ["build", yard, "--goal", "1,1", "-o", path, "--max-leaves", 4, "--leaf", "plane"]
    yard.write_text(json.dumps(document))
    error = mistake(*command)
    assert "goal [1.0, 1.0] lies outside the bounds Box([2.0, 2.0], [4.0, 3.0])" in error and '"bbox"' in error
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
        ("mace", [], "must be a scene (maze, thin_maze, floor_plan) or a map's file"),
        ("none.map", ["--goal", "1,1"], "none.map: No such file or directory"),
        ("grid.map", [], "give one with --goal X,Y"),
        ("team.json", [], "one for each of several robots"),
        ("maze", ["--goal", "1;2"], "--goal must be two numbers X,Y"),
        ("bow.json", ["--goal", "0.5,0.1"], "bow.json"),
        ("maze", ["--goal", "0.5,0.45"], "goal [0.5, 0.45] lies in an obstacle"),
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
        assert result.exit_code == 2 and "a goal is one argument X,Y" in result.output.replace("\n", " ")


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
    assert len(calls) > last_call, "what there is, is proven"
    plr = load(path)
    assert plr.num_leaves > 1 and plr.leaf.name == "plane" and plr.max_error > 0


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
    assert result.exit_code == 2 and "Nothing is proven" in result.stderr


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
        with saying("reading a"):
            assert stream.getvalue() == said[0]
        assert stream.getvalue() == "".join(said)


def test_a_round_robot_has_a_radius(tmp_path):
    path = tmp_path / "maze.plr"
    done("build", "maze", "--radius", 0.02, "--leaf", "plane", "--max-leaves", 30, "-o", path)
    plr, workspace = plr_jax.load(path), scenes.maze().workspace.inflate(0.02)
    assert plr.label == "maze --goal=0.06,0.07 --radius=0.02" and plr.domain == workspace.bounds
    x = workspace.sample_free(1000, seed=0)
    exact = plr_jax.VisibilityGraph(workspace, (0.06, 0.07))(x)
    assert np.abs(plr(x) - exact).max() <= plr.max_error
    done("plot", path, "--kind", "error", "-o", tmp_path / "error.png")  # beside the same distance
    assert "leaves no free space" in mistake("build", "maze", "--radius", 1, "-o", path)


@pytest.fixture(scope="module")
def volumes(tmp_path_factory):
    """A folder of volumes, in which the commands run."""
    folder = tmp_path_factory.mktemp("volumes")
    np.save(folder / "hall.npy", np.ones((4, 3, 2), bool))
    np.save(folder / "floor.npy", np.ones((4, 3), bool))
    (folder / "cave.3dmap").write_text(VOXELS)
    (folder / "room.stl").write_bytes(stl_files()[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def table(text):
    return np.array([[float(number) for number in line.split(",")] for line in text.splitlines()])


@pytest.mark.usefixtures("volumes")
def test_a_file_of_a_volume_keeps_its_budget_and_answers_x_y_z_within_proven_bounds():
    said = done("build", "hall.npy", "--goal", "1,1,1", "--max-leaves", 20, "--max-bytes", 200, "--resolution", 0.5)
    plr = load("hall.plr")
    assert 150 < plr.num_bytes <= 200 and plr.label == "hall.npy --goal=1,1,1 --resolution=0.5"
    np.testing.assert_array_equal([plr.domain.lo, plr.domain.hi], [(0, 0, 0), (2, 1.5, 1)])
    assert f"wrote   hall.plr: {plr.num_bytes} bytes; {plr.num_leaves} leaves, depth {plr.depth}\n" in said
    assert f"leaf    continuous: no error above {plr.max_error:.3g}, proven\nbounds  " in said
    assert "in the mean of 20,000 random free points that reach the goal\n" in said
    x = np.random.default_rng(0).uniform(plr.domain.lo, plr.domain.hi, (50, 3))
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in x.tolist())
    answer, lower, upper = table(done("query", "hall.plr", "--bounds", input=rows)).T
    distance = np.linalg.norm(x - 1, axis=1)
    assert (lower <= distance + 1e-6).all() and (distance <= upper + 1e-6).all()
    assert np.abs(answer - distance).max() <= plr.max_error
    assert "has 3 axes, and a picture has two" in mistake("plot", "hall.plr", "-o", "hall.png")


@pytest.mark.usefixtures("volumes")
def test_points_without_a_bound_from_above_are_told():
    said = done("build", "cave.3dmap", "--goal", "6,1.5,3", "--max-leaves", 8, "-o", "cave.plr")
    assert "leaf    continuous: bounds of every leaf, proven" in said and "more --max-bytes or --max-leaves" in said


@pytest.mark.parametrize(
    ("volume", "shape", "lo", "hi"),
    [
        (NamedMap("hall.npy", "1,1,1"), (4, 3, 2), (0, 0, 0), (4, 3, 2)),
        (NamedMap("hall.npy", "1,1,1", box="-1,0,0,3,6,2"), (4, 3, 2), (-1, 0, 0), (3, 6, 2)),
        (NamedMap("floor.npy", ".5,.5", resolution=0.25, radius=0.1), (4, 3), (0, 0), (1, 0.75)),
        (NamedMap("cave.3dmap", "1,1,1"), (12, 9, 6), (0, 0, 0), (12, 9, 6)),
        (NamedMap("room.stl", "1,.5,.5", 0.25, enclosed="free"), (13, 4, 6), (-1, 0, 0), (2.25, 1, 1.5)),
        (NamedMap("room.stl", "1,2,.5", 0.5, box="-2,-1,-1,3,3,2"), (10, 8, 6), (-2, -1, -1), (3, 3, 2)),
    ],
)
@pytest.mark.usefixtures("volumes")
def test_a_volume_is_read_as_the_options_say(volume, shape, lo, hi):
    if volume.name.endswith(".stl"):
        pytest.importorskip("trimesh")
    space, goal = volume.read_volume()
    np.testing.assert_array_equal([space.domain.lo, space.domain.hi], [lo, hi])
    assert space.free.shape == shape and space.radius == (volume.radius or 0)
    assert space.is_free(goal[None])[0]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["hall.npy"], "hall.npy has no goal of its own: give one with --goal X,Y,Z."),
        (["hall.npy", "--goal", "1,1"], "--goal must be three numbers X,Y,Z in one argument, such as 3,28,5, got"),
        (["hall.npy", "--goal", "1,1,9"], "goal must be a free configuration"),
        (["hall.npy", "--goal", "1,1,1", "--leaf", "cone", "--max-depth", 9], "is built without --max-depth, --leaf"),
        (["hall.npy", "--goal", "1,1,1", "--enclosed", "free"], "leave out --enclosed"),
        (["hall.npy", "--goal", "1,1,1", "--box", "0,0,1"], "--box must be two corners X,Y,Z,X,Y,Z"),
        (["hall.npy", "--goal", "1,1,1", "--box", "0,0,1,1"], "bounds must have 3 axes, as free has"),
        (["floor.npy", "--goal", "1,1", "--box", "0,0,1,1", "--resolution", 2], "leave out --resolution"),
        (["room.stl", "--goal", "1,1,1"], "room.stl is a mesh: give the side of a voxel with --resolution"),
        (["room.stl", "--goal", "1,1,1", "--resolution", 1, "--enclosed", "no"], "must be blocked or free, got 'no'"),
        (["maze", "--box", "0,0,1,1"], "--box and --enclosed are for volumes, and maze is none"),
        (["none.npy", "--goal", "1,1,1"], "none.npy: No such file or directory"),
    ],
)
@pytest.mark.usefixtures("volumes")
def test_mistakes_with_volumes_are_explained(command, message):
    assert message in mistake("build", *command, "-o", "none.plr")


@pytest.mark.usefixtures("volumes")
def test_a_budget_too_small_for_a_volume_is_told_with_one_that_is_enough():
    command = ["build", "cave.3dmap", "--goal", "6,1.5,3", "-o", "few.plr", "--max-leaves", 100, "--max-bytes"]
    least = int(mistake(*command, 3).split("allow at least ")[1].removesuffix(".\n"))
    assert f"allow at least {least}." in mistake(*command, least - 1)
    done(*command, least)
    assert load("few.plr").num_bytes <= least


@pytest.mark.usefixtures("volumes")
def test_a_mesh_that_leaves_nothing_free_is_told_what_to_do():
    pytest.importorskip("trimesh")
    error = mistake("build", "room.stl", "--goal", "1,.5,.5", "--resolution", 1, "-o", "none.plr")
    assert "--enclosed free leaves those that its surface encloses" in error


@pytest.mark.usefixtures("volumes")
def test_a_goal_of_three_arguments_is_told_how_to_be_one():
    result = run("build", "hall.npy", "--goal", "1,", "-2", "0.5")
    assert result.exit_code == 2 and "write --goal 1,-2,0.5" in result.output.replace("\n", " ")


@pytest.mark.usefixtures("volumes")
def test_interrupting_a_volume_keeps_what_there_is_and_ends_with_130(monkeypatch):
    def interrupted(*arguments, **limits):
        warnings.warn("interrupted", ConstructionInterrupted, stacklevel=1)
        return solve_eikonal(*arguments, **limits)

    monkeypatch.setattr("plr_jax.solve_eikonal", interrupted)
    result = run("build", "floor.npy", "--goal", "1,1", "-o", "part.plr", "--max-leaves", 4)
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == f"Interrupted: part.plr holds the {load('part.plr').num_leaves} leaves built so far.\n"
