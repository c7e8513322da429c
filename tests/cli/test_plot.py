import numpy as np
import pytest
from cli_helpers import done, mistake, run
from PIL import Image

from plr_jax import load, save


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
    for given in ([], ["--map", "scan.png"], ["--map", "copy.png", *options]):
        done("plot", "scan.plr", *given, "--kind", "error", "-o", "a.png")
        pictures.add((tmp_path / "a.png").read_bytes())
    assert len(pictures) == 1
    for given in (["--resolution", 1], ["--map", "copy.png"]):
        result = run("plot", "scan.plr", *given, "-o", "other.png")
        assert result.exit_code == 0 and result.stderr.count("\n") == 1
        assert "Warning: the map is Box([0.0, 0.0], [60.0, 40.0])" in result.stderr
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
        (["--goal", "0,0", "-o", "a.png"], "--goal needs --map"),
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
    said = f"the map that {path} was built of cannot be read ({reason}): name it with --map"
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
    assert said in mistake("plot", path, "--kind", kind, "--resolution", 2, "-o", picture)


@pytest.mark.parametrize("label", ["the kitchen", "kitchen", "scan.png --goal=here"])
def test_a_label_that_names_no_map_is_any_text(label, plane, tmp_path):
    save(load(plane).with_label(label), tmp_path / "a.plr")
    done("plot", tmp_path / "a.plr", "-o", tmp_path / "a.png")
    error = mistake("plot", tmp_path / "a.plr", "--kind", "error", "-o", tmp_path / "a.png")
    assert "does not say of which map" in error
