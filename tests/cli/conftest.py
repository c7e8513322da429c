import json
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest
from cli_helpers import done

from plr_jax import GridGraph, construct_grid_pairs, construct_pairs, save, scenes


@pytest.fixture(scope="session")
def maze(tmp_path_factory):
    """Return the path of a PLR file of the maze."""
    path = tmp_path_factory.mktemp("maze") / "maze.plr"
    done("build", "maze", "-o", path, "--max-bytes", 300, "--leaf", "plane")
    return path


@pytest.fixture(scope="session")
def pairs(tmp_path_factory):
    """Return the paths of files of pairs: of the maze, with its label, and of a small grid."""
    folder, of_maze = tmp_path_factory.mktemp("pairs"), construct_pairs(scenes.maze().workspace, max_bytes=400)
    save(of_maze.with_label("maze"), folder / "maze.pairs")
    save(construct_grid_pairs(GridGraph(np.array([[1, 1, 1], [1, 0, 1]], bool))), folder / "grid.pairs")
    return folder / "maze.pairs", folder / "grid.pairs"


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


@pytest.fixture
def drawn(monkeypatch):
    """Return a list of what `plot` draws, instead of drawing: kind, number of obstacles, coordinates of goals."""
    drawings = []

    def record(kind, shown, workspace=None, goal=None):
        goal = goal if kind != "error" else shown.goal  # an oracle is recorded in place of its errors
        num_obstacles = 0 if workspace is None else len(workspace.obstacles)
        drawings.append((kind, num_obstacles, None if goal is None else goal.ravel().tolist()))
        return Mock()  # axes

    monkeypatch.setattr("plr_jax.metrics.error_grid", lambda plr, oracle, workspace: oracle)
    for name, kind in (("contours", "distance"), ("cells", "cells"), ("error", "error")):
        monkeypatch.setattr(f"plr_jax.plot.plot_{name}", partial(record, kind))
    monkeypatch.setattr("plr_jax.plot.save", lambda ax, path: None)
    return drawings
