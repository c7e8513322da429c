import numpy as np
import pytest
from cli_helpers import mistake, run
from PIL import Image

from plr_jax._io import load, save


@pytest.mark.parametrize("kind", ["distance", "cells", "surface", "error"])
def test_plot_writes_pictures(kind, plane, tmp_path):
    path = tmp_path / "picture.png"
    result = run("plot", plane, "--map", "maze", "--kind", kind, "-o", path)
    assert result.exit_code == 0, result.output
    assert path.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {path}" in result.stdout


@pytest.mark.parametrize("kind", ["distance", "error"])
def test_plot_knows_map_and_goal_from_the_file(kind, plane, tmp_path):
    for name, options in (("own", []), ("given", ["--map", "maze"])):
        result = run("plot", plane, *options, "--kind", kind, "-o", tmp_path / f"{name}.png")
        assert result.exit_code == 0, result.output
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "given.png").read_bytes()


def test_plot_finds_a_map_beside_the_file(tmp_path, monkeypatch):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..@\n")
    monkeypatch.chdir(tmp_path / "maps")
    assert run("build", "a.map", "--goal", "0.5,0.5", "--leaf", "cone").exit_code == 0
    monkeypatch.chdir(tmp_path)
    result = run("plot", tmp_path / "maps" / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")
    assert result.exit_code == 0, result.output


def test_plot_takes_goal_and_options_of_a_map_from_the_file(tmp_path):
    gray = np.full((40, 60), 255, np.uint8)
    gray[10:30, 30:33] = 0
    Image.fromarray(gray).save(tmp_path / "scan.png")
    Image.fromarray(gray).save(tmp_path / "copy.png")
    path, options = tmp_path / "scan.plr", ["--resolution", 0.05]
    result = run("build", tmp_path / "scan.png", "--goal", "0.3,0.3", *options, "-o", path, "--max-bytes", 500)
    assert result.exit_code == 0, result.output
    pictures = []
    for number, given in enumerate(
        ([], ["--map", tmp_path / "scan.png"], ["--map", tmp_path / "copy.png", *options])
    ):
        picture = tmp_path / f"{number}.png"
        result = run("plot", path, *given, "--kind", "error", "-o", picture)
        assert (result.exit_code, result.stderr) == (0, "")
        pictures.append(picture.read_bytes())
    assert pictures[0] == pictures[1] == pictures[2]
    for given in (["--resolution", 1], ["--map", tmp_path / "copy.png"]):
        result = run("plot", path, *given, "-o", tmp_path / "other.png")
        assert result.exit_code == 0 and result.stderr.count("\n") == 1
        assert "Warning: the map is Box([0.0, 0.0], [60.0, 40.0])" in result.stderr
        assert "covers Box([0.0, 0.0], [3.0, 2.0])" in result.stderr


def test_the_error_is_drawn_for_the_goal_of_the_file(tmp_path):
    path = tmp_path / "maze.plr"
    assert run("build", "maze", "--goal", "0.9,0.1", "-o", path, "--max-bytes", 500).exit_code == 0
    for name, given in (("a", []), ("b", ["--map", "maze"]), ("c", ["--goal", "0.06,0.07"])):
        assert run("plot", path, *given, "--kind", "error", "-o", tmp_path / f"{name}.png").exit_code == 0
    a, b, c = ((tmp_path / f"{name}.png").read_bytes() for name in "abc")
    assert a == b != c


def test_plot_needs_no_map(plane, tmp_path):
    assert run("plot", plane, "-o", tmp_path / "picture.svg").exit_code == 0
    assert (tmp_path / "picture.svg").read_text().startswith("<?xml")


def test_plot_says_which_file_it_wrote(plane, tmp_path):
    result = run("plot", plane, "-o", tmp_path / "pic")
    assert result.stdout == f"wrote {tmp_path / 'pic.png'}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["pic.png"]


def test_plot_explains_mistakes(plane, tmp_path):
    unlabeled = tmp_path / "unlabeled.plr"
    save(load(plane).with_label(""), unlabeled)
    assert "give --map" in mistake("plot", unlabeled, "--kind", "error", "-o", tmp_path / "a.png")
    assert "a.docx must end in .png or .pdf or .svg" in mistake("plot", plane, "-o", tmp_path / "a.docx")
    assert "none: No such folder" in mistake("plot", plane, "-o", tmp_path / "none" / "a.png")
    assert "--goal needs --map" in mistake("plot", unlabeled, "--goal", "0,0", "-o", tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["distance", "cells"])
def test_a_file_is_drawn_where_its_map_is_not(kind, plane, tmp_path):
    path, alone = tmp_path / "far.plr", tmp_path / "alone.plr"
    save(load(plane).with_label("elsewhere/scan.png --goal=0.06,0.07"), path)
    save(load(plane).with_label(""), alone)
    result = run("plot", path, "--kind", kind, "-o", tmp_path / "a.png")
    reason = "elsewhere/scan.png: No such file or directory"
    said = f"the map that {path} was built of cannot be read ({reason}): name it with --map"
    assert result.exit_code == 0, result.output
    assert result.stderr == f"Warning: {said}; drawn without its obstacles.\n"
    goal = ["--map", "maze", "--goal", "0.06,0.07"]
    pictures = []
    for name, file, given in (("b", alone, []), ("c", path, goal)):
        result = run("plot", file, "--kind", kind, *given, "-o", tmp_path / f"{name}.png")
        assert (result.exit_code, result.stderr) == (0, "")
        pictures.append((tmp_path / f"{name}.png").read_bytes())
    without_goal, with_walls = pictures
    drawn = (tmp_path / "a.png").read_bytes()
    assert drawn != with_walls
    assert (drawn == without_goal) == (kind != "distance")  # of which the goal is drawn
    assert said in mistake("plot", path, "--kind", "error", "-o", tmp_path / "a.png")
    assert said in mistake("plot", path, "--kind", kind, "--resolution", 2, "-o", tmp_path / "a.png")
    missing = mistake("plot", path, "--map", tmp_path / "none.png", "-o", tmp_path / "a.png")
    assert missing == f"Error: {tmp_path / 'none.png'}: No such file or directory\n"


@pytest.mark.parametrize("label", ["the kitchen", "kitchen", "scan.png --goal=here"])
def test_a_label_that_names_no_map_is_any_text(label, plane, tmp_path):
    save(load(plane).with_label(label), tmp_path / "a.plr")
    result = run("plot", tmp_path / "a.plr", "-o", tmp_path / "a.png")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "does not say of which map" in mistake(
        "plot", tmp_path / "a.plr", "--kind", "error", "-o", tmp_path / "a.png"
    )
