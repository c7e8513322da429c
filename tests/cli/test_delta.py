"""Deltas at the command line: what diff writes, patch makes the new file of, byte for byte."""

import re

import pytest
from cli_helpers import done, mistake

from plr_jax import VisibilityGraph, construct, load, save, scenes


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Cones of the maze, before and after a box is set down."""
    folder, problem = tmp_path_factory.mktemp("cones"), scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    changed = workspace.with_obstacles([[(0.5, 0.3), (0.6, 0.3), (0.6, 0.35)]])
    for name, each in (("old.plr", workspace), ("new.plr", changed)):
        oracle = VisibilityGraph(each, goal)
        save(construct(oracle, workspace.bounds, leaf="cone", max_bytes=400, certified=True), folder / name)
    return folder / "old.plr", folder / "new.plr"


def test_what_diff_writes_patch_takes(files, tmp_path):
    old, new = files
    delta, made = tmp_path / "maze.delta", tmp_path / "maze.plr"
    told = done("diff", old, new, "--output", delta)
    size = len(delta.read_bytes())
    assert f": {size:,} bytes, of a file of {new.stat().st_size:,}" in told and size < 400
    assert done("patch", old, delta, "--output", made) == f"wrote {made}: {new.stat().st_size:,} bytes\n"
    assert made.read_bytes() == new.read_bytes()
    assert delta.read_bytes() == load(new).delta(load(old))
    made.write_bytes(old.read_bytes())
    done("patch", made, delta, "-o", made)  # in its place
    assert made.read_bytes() == new.read_bytes()


def test_mistakes_are_explained(files, plane, tmp_path):
    old, new = files
    delta = tmp_path / "maze.delta"
    done("diff", old, new, "-o", delta)
    assert "maze.delta. The delta cannot be used: it is of another file" in mistake(
        "patch", new, delta, "-o", "a.plr"
    )
    assert "new.plr. The delta cannot be used: it does not start like one" in mistake(
        "patch", old, new, "-o", "a.plr"
    )
    assert "maze.delta cannot be read as a PLR" in mistake("diff", delta, new, "-o", tmp_path / "b")
    assert "is read, and would be written over" in mistake("diff", old, new, "-o", new)
    assert "No such file" in mistake("patch", old, tmp_path / "none", "-o", tmp_path / "b")
    assert not (tmp_path / "b").exists()
    done("diff", plane, new, "-o", delta)  # of other leaves
    done("patch", plane, delta, "-o", tmp_path / "b.plr")
    assert (tmp_path / "b.plr").read_bytes() == new.read_bytes()


def test_tables_are_exported_apart_and_their_header_stays(files, tmp_path):
    texts = []
    for file in files:
        told = done("export", file, "-o", tmp_path / "maze.h", "--tables", tmp_path / "maze.tables")
        texts.append((tmp_path / "maze.h").read_text())
        tables = (tmp_path / "maze.tables").read_bytes()
        assert tables == load(file).c_tables() and re.search(rf"maze\.tables: {len(tables):,} bytes", told)
    assert texts[0] == texts[1] == load(files[0]).c_header("maze", loads_tables=True)
    assert "must end in .tables" in mistake("export", files[0], "-o", tmp_path / "a.h", "--tables", tmp_path / "a.h")
