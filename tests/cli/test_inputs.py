"""Inputs of commands: maps and their options, goals, numbers."""

import numpy as np
import pytest
from PIL import Image

from plr_jax import scenes
from plr_jax.cli.inputs import NamedMap, check_output, parse_goals


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1", "1e400,1", "1,2;", "1 2"])
def test_goal_must_be_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goals(["0,0", text])
    np.testing.assert_array_equal(parse_goals(["1, -2.5e1", "0,3"]), [(1, -25), (0, 3)])


@pytest.mark.parametrize(
    ("name", "area", "goal"),
    [
        ("thin_maze", scenes.thin_maze().workspace.free_space.area, scenes.thin_maze().goals[0]),
        ("grid.map", 5, None),
        ("polygons.json", 4.5, None),
        ("maze.json", scenes.maze().workspace.free_space.area, scenes.maze().goals[0]),
        ("MAZE.JSON", scenes.maze().workspace.free_space.area, scenes.maze().goals[0]),
        ("team.json", scenes.four_rooms(2).workspace.free_space.area, None),  # two robots: the user chooses a goal
    ],
)
def test_maps_are_scenes_or_files(name, area, goal, maps, monkeypatch):
    monkeypatch.chdir(maps)
    workspace, found = NamedMap(name, None, {}).read()
    assert workspace.free_space.area == pytest.approx(area)
    assert found is None if goal is None else (found == goal).all()
    assert NamedMap(name, np.eye(2), {}).read()[1].tolist() == [[1, 0], [0, 1]]


def test_labels_name_maps():
    scan = "'a scan.png' --goal=-1.5,2000.0 --resolution=0.05 --drop-specks=4"
    for label in (scan, "maze", """'it'"'"'s.geojson' '--goal=0.0,0.1;-1.0,2.5' --polygons=free"""):
        assert NamedMap.of_label(label).label == label
    named = NamedMap.of_label(scan)
    assert (named.name, named.options) == ("a scan.png", {"resolution": 0.05, "drop_specks": 4})
    np.testing.assert_array_equal(named.goals, [(-1.5, 2e3)])
    for other in ("", "kitchen", "the kitchen", "a.png --goal=x", "a.png --radius", "a.png --frame=1", "a.png 'b"):
        assert NamedMap.of_label(other) is None


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    gray = np.full((4, 6), 200, np.uint8)
    gray[1, 2] = 0
    Image.fromarray(gray).save(folder / "a.png")
    (folder / "scan.yaml").write_text("image: a.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    return folder


OPTIONS = {"resolution": 0.05, "polygons": "free"}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("d.txt", {}, r"d\.txt: expected a file that ends in one of \.map, "),
        ("maze", OPTIONS, "maze is a scene, which is read without options, got resolution, polygons"),
        ("maze.json", OPTIONS, r"expected options of .* \(none\), got resolution, polygons\."),
        ("scan.yaml", OPTIONS, r"expected options of .*drop_specks.*, got resolution, polygons\."),
        ("a.png", {"threshold": 0.9}, "No pixel"),
    ],
)
def test_options_of_other_readers_are_refused(name, options, message, maps, pictures, monkeypatch):
    monkeypatch.chdir(pictures if (pictures / name).exists() else maps)
    with pytest.raises(ValueError, match=message):
        NamedMap(name, None, options).read()


def test_outputs_without_permission_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)  # the tests may run as root, who may all
    with pytest.raises(ValueError, match="a file that you may write"):
        check_output(tmp_path / "a.json", (".json",))
    check_output(None, (".json",))
