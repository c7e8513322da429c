import json
import re
from itertools import count

import numpy as np
import pytest
from building_scenes import two_floors
from cli_helpers import done, mistake, run
from PIL import Image

from plr_jax import VisibilityGraph, construct, construct_pairs, load, save, scenes
from plr_jax.geometry.cell_sight import CellSources

MAZE = scenes.maze().workspace
ORACLE = VisibilityGraph(MAZE, scenes.maze().goals[0])
LABEL = "maze --goal=0.06,0.07"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.plr"


def test_build_keeps_budget_and_prints_summary(path):
    printed = done("build", "maze", "-o", path, "--max-bytes", 700, "--leaf", "cone")
    assert path.stat().st_size <= 700
    plr = load(path)
    assert f"{path}: {path.stat().st_size} bytes; {plr.num_leaves:,} leaves, depth {plr.depth}" in printed
    assert plr.label == LABEL
    kind, proven = re.search(r"leaf    (\w+): no error above (\S+), proven", printed).groups()
    assert kind == plr.leaf.name and plr.max_error <= float(proven) <= 1.01 * plr.max_error  # rounded up
    largest, mean = map(float, re.search(r"error   max (\S+), mean (\S+) over", printed).groups())
    assert 0 < mean < largest <= plr.max_error
    assert "% of the largest distance" in printed and "s to build" in printed
    for title, header in (("in C   ", plr.c_header("a")), ("compact", plr.c_header("a", compact=True))):
        cost = re.search(rf"^{title} (On a Cortex-M4: .*)$", printed, re.MULTILINE)[1]
        assert f"\n   {cost}\n   Functions: distance, waypoint.\n" in header


def test_build_reads_pictures_with_options(path, tmp_path):
    gray = np.full((100, 100), 255, np.uint8)
    gray[20:25, :40] = 0
    gray[50:52, 50:52] = 0  # a speck of 4 pixels
    Image.fromarray(gray).save(tmp_path / "scan.png")
    (tmp_path / "scan.yaml").write_text("image: scan.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    limits = ["--goal", "1,1", "-o", path, "--leaf", "plane", "--max-bytes", 200, "--drop-specks", 4]
    for name, options, summary in (
        ("scan.png", [], "map     8 vertices, 100 x 100\n"),
        ("scan.png", ["--resolution", 0.05], "map     8 vertices, 5 x 5\n"),
        ("scan.yaml", ["--radius", 0.3], ", 4.4 x 4.4\n"),
    ):
        assert summary in done("build", tmp_path / name, *limits, *options)


def test_build_says_if_the_tolerance_was_not_reached(path, tmp_path):
    gray = np.full((6, 8), 255, np.uint8)
    gray[2, :4] = gray[3, 4:7] = 0  # walls that touch only in the point (4, 3), where no small error can be proven
    command = ["build", tmp_path / "scan.png", "--goal", "1,1", "-o", path, "--leaf", "cone", "--tolerance", 0.01]
    Image.fromarray(gray).save(tmp_path / "scan.png")
    assert "--tolerance 0.01 was not reached" in done(*command)
    gray[2, 4] = 0  # thicker
    Image.fromarray(gray).save(tmp_path / "scan.png")
    assert "not reached" not in done(*command) and load(path).max_error < 0.0101


def test_build_writes_what_construct_returns(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done("build", "maze", "--leaf", "plane", "--max-bytes", 700, "--tolerance", 0.01)
    limits = {"max_bytes": 700 - len(LABEL) - 2, "tolerance": 0.01}  # the file has room for its label
    plr = construct(ORACLE, MAZE.bounds, leaf="plane", certified=True, **limits)
    assert (tmp_path / "maze.plr").read_bytes() == plr.with_label(LABEL).to_bytes()


def test_build_for_several_goals_stores_the_nearest(path, drawn):
    goals = ["--goal", "0.06,0.07", "-g", "0.9,0.1"]
    printed = done("build", "maze", *goals, "-o", path, "--leaf", "cone", "--max-bytes", 600)
    assert "proven" in printed and load(path).label == "maze '--goal=0.06,0.07;0.9,0.1'"
    answers = done("query", path, "--bounds", "--which", input="0.9,0.1\n0.07,0.07\n2,2\n").split()
    assert [answer.split(",")[3] for answer in answers] == ["1", "0", "-1"]
    done("plot", path, "-o", path.with_suffix(".png"))
    assert drawn == [("distance", 6, [0.06, 0.07, 0.9, 0.1])]


def test_reader_warning_prints_one_line_to_stderr(path, tmp_path, drawn):
    town = tmp_path / "town.geojson"
    ring = [[11.40, 48.10], [11.41, 48.10], [11.41, 48.11], [11.40, 48.10]]
    town.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    limits = ("--max-bytes", 200, "--leaf", "plane")
    for command in (["build", town, "--goal", "11.401,48.109", "-o", path, *limits], ["plot", path, "-o", path]):
        result = run(*command[:-1], f"{path}.png" if command[0] == "plot" else command[-1])
        assert result.exit_code == 0, result.output
        assert result.stderr.startswith(f"Warning: {town}: coordinates look like degrees")
        assert result.stderr.count("\n") == 1 and ".py" not in result.stderr


def test_too_small_budget_error_names_a_sufficient_one(path):
    def sufficient_bytes(size):
        result = run("build", "maze", "-o", path, "--max-bytes", size)
        said = rf"Error: --max-bytes {size} is too small: allow at least ([0-9]+)\.\n"
        assert result.exit_code == 2 and not path.exists()
        return int(re.fullmatch(said, result.stderr)[1])

    enough = sufficient_bytes(3)
    assert sufficient_bytes(enough - 1) == enough
    done("build", "maze", "-o", path, "--max-bytes", enough)
    assert path.stat().st_size <= enough


def test_interrupted_build_keeps_proven_leaves(path, monkeypatch):
    parts, calls = CellSources.parts, count()

    def interrupt_later(self, *arguments):
        if next(calls) == 3:
            raise KeyboardInterrupt
        return parts(self, *arguments)

    monkeypatch.setattr(CellSources, "parts", interrupt_later)
    result = run("build", "maze", "-o", path, "--leaf", "plane")
    assert result.exit_code == 130
    assert re.fullmatch(r"Interrupted: .*out.plr holds the [0-9]+ leaves built so far.\n", result.stderr)
    plr = load(path)
    assert plr.num_leaves > 1 and plr.leaf.name == "plane" and plr.max_error > 0
    x = MAZE.sample_free(500, 0)
    lower, upper = plr.numpy().bounds(x)
    assert ((lower <= ORACLE(x)) & (ORACLE(x) <= upper)).all()


def test_interrupt_before_first_leaf_writes_nothing(path, monkeypatch):
    def interrupt(self, domain):
        raise KeyboardInterrupt

    monkeypatch.setattr(VisibilityGraph, "cell_sources", interrupt)
    result = run("build", "maze", "-o", path)
    assert (result.exit_code, result.stderr) == (130, "Interrupted.\n") and not path.exists()


def test_leaf_bounds_narrow_query_bounds_of_proven_files(path):
    widths = []
    for options in ([], ["--leaf-bounds"]):
        done("build", "maze", "--leaf", "cone", "--max-bytes", 400, *options, "-o", path)
        printed = done("query", path, "-", "--bounds", input="0.3,0.85\n0.9,0.9\n")
        distance, lower, upper = np.loadtxt(printed.splitlines(), delimiter=",").T
        assert ((lower <= distance) & (distance <= upper)).all()
        widths.append((upper - lower).mean())
    assert widths[1] < widths[0]
    save(construct(lambda x: np.hypot(*x.T), MAZE.bounds, max_leaves=4), path)
    assert "Nothing is proven of this PLR" in mistake("query", path, "--bounds", input="0.3,0.85\n")


def test_radius_grows_obstacles(path, drawn):
    printed = done("build", "maze", "--radius", 0.02, "--leaf", "plane", "--max-bytes", 300, "-o", path)
    assert "the disc's own distances are not smaller" in printed
    plr, workspace = load(path), MAZE.inflate(0.02)
    assert plr.label == "maze --goal=0.06,0.07 --radius=0.02" and plr.domain == workspace.bounds
    x = workspace.sample_free(200, seed=0)
    assert np.abs(plr.numpy()(x) - VisibilityGraph(workspace, (0.06, 0.07))(x)).max() <= plr.max_error
    done("plot", path, "--kind", "error", "-o", path.with_suffix(".png"))
    assert drawn == [("error", len(workspace.obstacles), [0.06, 0.07])]


def test_buildings_are_built_and_queried_by_floor(path, tmp_path):
    building = two_floors()
    scenes.save_building(building, file := tmp_path / "home.json")
    assert "proven" in done("build", file, "-o", path, "--goal", "0,10,1", "--leaf", "cone", "--max-bytes", 1500)
    assert path.stat().st_size <= 1500 and load(path).plane.label == str(file)
    (tmp_path / "x.csv").write_text("floor,x,y\n1,5,6\n0,2,9\n0,10,1\n7,1,1\n0.5,1,1\n")
    rows = np.genfromtxt(done("query", path, tmp_path / "x.csv", "--which", "--bounds").splitlines(), delimiter=",")
    exact = building.oracle(0, (10, 1))
    np.testing.assert_allclose(rows[:3, 0], exact([1, 0, 0], [(5, 6), (2, 9), (10, 1)]), atol=0.3)
    assert rows[:, 3].tolist() == [2, -1, -1, -2, -2] and np.isnan(rows[3:, :3]).all()
    assert "BuildingPLR" in done("info", path)
    done("view", path, "-o", tmp_path / "home.html")
    printed, header = done("export", path, "-o", tmp_path / "home.h"), (tmp_path / "home.h").read_text()
    assert "home_distance(int floor" in header and printed.endswith("numbers.\n        Functions: distance.\n")
    of_floors, of_plane = (re.search(r"On a Cortex-M4: (\S+) bytes", text)[1] for text in (printed, header))
    assert int(of_floors.replace(",", "")) - int(of_plane.replace(",", "")) == 2 * 8 * 4  # 2 floors, 8 words each
    assert "3 numbers FLOOR,X,Y" in mistake("build", file, "-o", path, "--goal", "10,1")
    assert "must be an integer >= 0, got 0.5" in mistake("build", file, "-o", path, "--goal", "0.5,10,1")
    assert "read without options" in mistake("build", file, "-o", path, "--goal", "0,10,1", "--radius", 1)
    assert "becomes a C header" in mistake("export", path, "--js", "-o", tmp_path / "home.mjs")
    save(construct_pairs(building), pairs := tmp_path / "home.pairs")
    assert "build a PLR of one goal" in mistake("export", pairs, "--goal", "1,1", "-o", tmp_path / "home.h")
