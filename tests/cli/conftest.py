import json

import pytest
from cli_helpers import run

from plr_jax import scenes


def built(leaf, folder):
    path = folder / f"{leaf}.plr"
    result = run("build", "maze", "-o", path, "--max-bytes", 300, "--leaf", leaf)
    assert result.exit_code == 0, result.output
    return path


@pytest.fixture(scope="session", params=["plane", "continuous", "smooth"])
def maze(request, tmp_path_factory):
    """Return a file of the maze, one for each kind of leaves."""
    return built(request.param, tmp_path_factory.mktemp("maze"))


@pytest.fixture(scope="session")
def plane(tmp_path_factory):
    """Return a file, for tests in which the kind of leaves makes no difference."""
    return built("plane", tmp_path_factory.mktemp("plane"))


@pytest.fixture(scope="session")
def maps(tmp_path_factory):
    """Return a folder of maps of every kind, which tests must not change."""
    folder = tmp_path_factory.mktemp("maps")
    (folder / "grid.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..@\n")
    (folder / "polygons.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    (folder / "bow.json").write_text(json.dumps({"outer": [[0, 0], [1, 1], [1, 0], [0, 1]]}))
    scenes.save(scenes.maze(), folder / "maze.json")
    (folder / "MAZE.JSON").write_bytes((folder / "maze.json").read_bytes())
    scenes.save(scenes.four_rooms(2), folder / "team.json")
    scenes.save(scenes.tangle(), folder / "tangle.json")
    return folder
