"""Errors of commands: one line that says what was expected, and no output file."""

import shlex

import pytest
from cli_helpers import mistake, run

from plr_jax import load, save


@pytest.fixture(scope="module")
def folder(maze, pairs, maps, tmp_path_factory):
    """Return a folder of good and bad files, which commands must not change."""
    folder = tmp_path_factory.mktemp("mistakes")
    for path in (maze, *pairs, *maps.iterdir()):
        (folder / path.name).symlink_to(path)
    save(load(maze).with_label(""), folder / "unlabeled.plr")
    (folder / "foreign.plr").write_text("not a PLR at all, but long enough to hold a header")
    (folder / "points.csv").write_text("0.1,0.1\n")
    (folder / "folder.png").mkdir()
    return folder


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("build mace", "must be a scene (maze, thin_maze, floor_plan) or a file of a map"),
        ("build none.map --goal 1,1", "none.map: No such file or directory"),
        ("build grid.map", "give --goal X,Y"),
        ("build team.json", "one for each of several robots"),
        ("build maze" + " --goal 0.1234567890123456,0.1" * 60, "its 60 goals, got "),
        ("build bow.json --goal 0.5,0.1", "bow.json"),
        ("build maze --goal 0.5,0.45", "goal [0.5, 0.45] lies in an obstacle"),
        ("build maze --radius 1", "leaves no free space"),
        ("build maze -o none/a.plr", "in a folder that exists"),
        ("build maze -o folder.png", "folder.png must be a file that you may write"),
        ("build maze -o " + "x" * 300, "File name too long"),
        ("query maze.plr", "stdin has no points"),
        ("query maze.plr none.csv", "No such file"),
        ("query foreign.plr", "foreign.plr"),
        ("query maze.pairs --which", "--which needs a file of a PLR"),
        ("export maze.plr --goal 0,0 -o a.h", "leave out --goal"),
        ("export maze.plr -o a.txt", "must end in .h"),
        ("export maze.plr --js -o a.h", "must end in .mjs"),
        ("export maze.plr --js --compact -o a.mjs", "--compact is for C headers"),
        ("export maze.pairs -o a.h", "any two points: give one of them with --goal"),
        ("export grid.pairs --goal 0,0 -o a.h", "leave out --js, --goal and --compact"),
        ("view maze.plr -o a.png", "must end in .html"),
        ("plot grid.pairs -o a.png", "any two points: give one of them with --goal"),
        ("plot grid.pairs --goal 0,0 --kind cells -o a.png", "--kind must be distance"),
        ("plot unlabeled.plr --kind error -o a.png", "does not name its map and goal"),
        ("plot maze.plr --goal 0,0 -o a.png", "leave out --goal"),
        ("plot unlabeled.plr --map none.png -o a.png", "(none.png: No such file or directory): name it with --map"),
        ("plot none.plr -o a.docx", "a.docx must end in .png or .pdf or .svg"),
        ("plan four_roms", "SCENE must be a scene (single_door, four_rooms, "),
        ("plan polygons.json", "polygons.json: expected a scene file"),
        ("plan four_rooms --robots 5", "four_rooms must have 2, 3, 4, 8 robots, got 5"),
        ("plan tangle --robots 2", "--robots is for the scenes four_rooms and cross, got 'tangle'"),
        ("plan maze --time-limit -1", "time_limit must be"),
        ("plan maze -o a.csv", "a.csv must end in .json"),
        ("plan maze --animation a.mp4", "a.mp4 must end in .gif or .html"),
        ("plan maze --picture a.txt", "a.txt must end in .png or .pdf or .svg"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_commands_explain_mistakes(command, message, folder, monkeypatch):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert message in mistake(*shlex.split(command), input="")
    assert sorted(folder.iterdir()) == before


def test_usage_errors_say_what_is_expected():
    for command, message in (
        ("build maze --goal 3 28", "unexpected extra argument"),
        ("plot maze.plr -o a.png --kind surface", "is not one of 'distance', 'cells', 'error'"),
    ):
        result = run(*command.split())
        assert result.exit_code == 2 and message in " ".join(result.stderr.replace("│", "").split())
