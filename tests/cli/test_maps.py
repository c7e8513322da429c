import json

import numpy as np
import pytest
from cli_helpers import run
from PIL import Image

from plr_jax import scenes
from plr_jax.cli._maps import NamedMap


def test_a_scene_of_two_robots_leaves_the_goal_to_the_user(tmp_path):
    problem = scenes.maze()
    double = type(problem)(problem.workspace, problem.robots * 2, [problem.starts[0]] * 2, [problem.goals[0]] * 2)
    scenes.save(double, tmp_path / "two.json")
    workspace, goal = NamedMap(str(tmp_path / "two.json")).read()
    assert goal is None
    assert workspace.bounds == problem.workspace.bounds


def test_a_map_is_a_scene_or_a_file_by_its_ending(tmp_path):
    for name, problem in (("thin_maze", scenes.thin_maze()), ("floor_plan", scenes.floor_plan())):
        workspace, goal = NamedMap(name).read()
        assert workspace.bounds == problem.workspace.bounds
        np.testing.assert_array_equal(goal, problem.goals[0])
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    (tmp_path / "b.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    for name, area in [("a.map", 2), ("b.json", 4.5)]:
        workspace, goal = NamedMap(str(tmp_path / name)).read()
        assert workspace.free_space.area == area
        assert goal is None
    scenes.save(scenes.maze(), tmp_path / "c.json")
    np.testing.assert_array_equal(NamedMap(str(tmp_path / "c.json")).read()[1], scenes.maze().goals[0])
    with pytest.raises(ValueError, match="MAP must be a scene"):
        NamedMap("d").read()
    with pytest.raises(ValueError, match=r"d\.txt: expected a file that ends in one of \.map, "):
        NamedMap("d.txt").read()


def test_a_goal_that_is_given_wins():
    np.testing.assert_array_equal(NamedMap("maze", "0.9,0.1").read()[1], [0.9, 0.1])


@pytest.mark.parametrize(
    "named",
    [
        NamedMap("maze"),
        NamedMap("a scan.png", "-1.5,2e3", resolution=0.05, threshold=0.25, drop_specks=4),
        NamedMap("it's.geojson", "0,0", polygons="free"),
    ],
)
def test_a_map_is_named_again_by_its_text(named):
    assert NamedMap.of(str(named)) == named


@pytest.mark.parametrize("text", ["", "a.png --resolution", "a.png --resolution=x", "a.png --frame=1", "a.png 'b"])
def test_a_text_that_names_no_map_is_refused(text):
    with pytest.raises(ValueError, match="expected a map and options"):
        NamedMap.of(text)


def test_scenes_and_grids_have_no_options_of_pictures(tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    for name in ("maze", str(tmp_path / "a.map")):
        with pytest.raises(ValueError, match="resolution"):
            NamedMap(name, resolution=2.0).read()


def test_options_are_refused_by_the_names_they_have_in_a_command(tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    (tmp_path / "b.yaml").write_text("image: b.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    given = {"resolution": 0.05, "polygons": "free", "drop_specks": 3}
    for name, said in (
        (
            "a.map",
            "--resolution, --drop-specks, --polygons is no option of maps of this kind; they have none of these.",
        ),
        ("b.yaml", "--resolution, --polygons is no option of maps of this kind; they have --drop-specks."),
    ):
        with pytest.raises(ValueError, match=f"{name}: {said}"):
            NamedMap(str(tmp_path / name), "0.5,0.5", **given).read()
    with pytest.raises(ValueError, match=r"leave out --resolution, --drop-specks, --polygons\."):
        NamedMap("maze", **given).read()


def test_a_picture_is_read_as_the_options_say(tmp_path):
    gray = np.full((4, 6), 200, np.uint8)
    gray[1, 2] = 0
    Image.fromarray(gray).save(tmp_path / "a.png")
    workspace, goal = NamedMap(str(tmp_path / "a.png"), "1,2", resolution=0.5, drop_specks=1).read()
    np.testing.assert_array_equal([workspace.bounds.hi, goal], [(3, 2), (1, 2)])
    assert workspace.free_space.area == 6
    with pytest.raises(ValueError, match="No pixel"):
        NamedMap(str(tmp_path / "a.png"), threshold=0.9).read()


def test_only_pictures_are_of_pixels(tmp_path):
    Image.fromarray(np.full((4, 6), 255, np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "scan.yaml").write_text("image: a.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
    (tmp_path / "team.yaml").write_text(
        "environment: {min: [0, 0], max: [3, 2]}\n"
        "robots: [{type: single_integrator_0, start: [1, 1, 0], goal: [2, 1, 0]}]\n"
    )
    (tmp_path / "b.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    scenes.save(scenes.maze(), tmp_path / "c.json")
    names = {"a.png": True, "scan.yaml": True, "team.yaml": False, "b.map": False, "c.json": False}
    found = {name: NamedMap(str(tmp_path / name)).is_of_pixels() for name in names}
    assert found == names and not NamedMap("maze").is_of_pixels()
    result = run("build", tmp_path / "team.yaml", "--goal", "1,1", "--max-leaves", 4, "-o", tmp_path / "team.plr")
    assert result.exit_code == 0 and "drop-specks" not in result.stdout and not result.stdout.startswith("map")
