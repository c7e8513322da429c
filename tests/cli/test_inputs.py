"""Inputs of commands: maps and their options, goals, numbers."""

import numpy as np
import pytest
from PIL import Image

from plr_jax import scenes
from plr_jax.cli.app import numbers_of
from plr_jax.cli.inputs import NamedMap, parse_goals


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1", "1_0,2", "1e400,1", "1,2;"])
def test_goal_must_be_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goals(text)
    np.testing.assert_array_equal(parse_goals("1, -2.5e1;0,3"), [(1, -25), (0, 3)])


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1,-2.5e-1", [1, -0.25]),
        (" +.5 ,\t3.\r", [0.5, 3]),
        ("-inf,Infinity,1E400", [-np.inf, np.inf, np.inf]),
        ("nan,-NaN", [np.nan, np.nan]),
        *((text, []) for text in ("1_0", "1,1_0", "0x10", "1,", "1 2", ".", "e5", "", "\u0661", "\u00a01")),
        ("1" * 100_000 + "x", []),  # must not take quadratic time
    ],
)
def test_only_decimal_numbers_are_read(text, numbers):
    np.testing.assert_array_equal(numbers_of(text), numbers)


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
    workspace, found = NamedMap(name).read()
    assert workspace.free_space.area == pytest.approx(area)
    assert found is None if goal is None else (found == goal).all()
    assert NamedMap(name, "0.9,0.1;0,0").read()[1].tolist() == [[0.9, 0.1], [0, 0]]


@pytest.mark.parametrize(
    "named",
    [
        NamedMap("maze"),
        NamedMap("a scan.png", "-1.5,2e3", resolution=0.05, threshold=0.25, drop_specks=4),
        NamedMap("it's.geojson", "0,0;-1,2.5", polygons="free"),
    ],
)
def test_named_map_survives_conversion_to_text(named):
    assert NamedMap.parse(str(named)) == named


@pytest.mark.parametrize("text", ["", "a.png --resolution", "a.png --resolution=x", "a.png --frame=1", "a.png 'b"])
def test_text_that_names_no_map_is_refused(text):
    with pytest.raises(ValueError, match="expected a map and its options"):
        NamedMap.parse(text)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    gray = np.full((4, 6), 200, np.uint8)
    gray[1, 2] = 0
    Image.fromarray(gray).save(folder / "a.png")
    (folder / "scan.yaml").write_text("image: a.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    return folder


OPTIONS = {"resolution": 0.05, "polygons": "free", "drop_specks": 3}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("d", {}, "MAP must be a scene"),
        ("d.txt", {}, r"d\.txt: expected a file that ends in one of \.map, "),
        ("maze", {"resolution": 2.0}, "resolution"),
        ("maze", OPTIONS, r"leave out --resolution, --drop-specks, --polygons\."),
        ("grid.map", OPTIONS, r"expected options of .* \(none\), got --resolution, --drop-specks, --polygons\."),
        ("scan.yaml", OPTIONS, r"expected options of .* \(--drop-specks\), got --resolution, --polygons\."),
        ("a.png", {"threshold": 0.9}, "No pixel"),
    ],
)
def test_options_of_other_readers_are_refused(name, options, message, maps, pictures, monkeypatch):
    monkeypatch.chdir(pictures if (pictures / name).exists() else maps)
    with pytest.raises(ValueError, match=message):
        NamedMap(name, "0.5,0.5", **options).read()


def test_options_of_pictures_are_used(pictures):
    workspace, goal = NamedMap(str(pictures / "a.png"), "1,2", resolution=0.5, drop_specks=1).read()
    np.testing.assert_array_equal([workspace.bounds.hi, *goal], [(3, 2), (1, 2)])
    assert workspace.free_space.area == 6
