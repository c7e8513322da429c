import pytest
from cli_helpers import mistake, run

from plr_jax.plr import load, save


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
    save(load(plane).with_label("elsewhere.png --goal=0,0"), unlabeled)
    assert "elsewhere.png" in mistake("plot", unlabeled, "-o", tmp_path / "a.png")
