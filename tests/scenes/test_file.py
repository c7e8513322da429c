import json

import numpy as np
import pytest
import shapely

from plr_jax import scenes
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.shapes import DiscRobot, PointRobot, PolygonRobot, RectangleRobot

POINT = [PointRobot()]


def box(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


PROBLEMS = {
    "maze": scenes.maze,
    "thin_maze": scenes.thin_maze,
    "odd numbers": lambda: Problem(
        Workspace(((0.1, -1e-7), (np.pi, 1 / 3)), [box(0.7, 0.1, 1.1, 0.2)]),
        POINT,
        [(0.2, 0.1)],
        [(np.e, 0.3)],
    ),
    "blocked margin": lambda: Problem(Workspace(((0, 0), (4, 4)), [box(0, 0, 1, 4)]), POINT, [(2, 2)], [(3, 3)]),
    "two components, a hole": lambda: Problem(
        Workspace.from_polygons(
            [{"outer": box(0, 0, 4, 4), "holes": [box(1, 1, 2, 2)]}, {"outer": box(6, 0, 7, 1), "holes": []}]
        ),
        POINT * 2,
        [(0.5, 0.5), (6, 0)],
        [(3, 3), (7, 1)],
    ),
    "squeeze": lambda: Problem(
        Workspace(((0, 0), (2, 2)), [box(0, 0, 1, 1), box(1, 1, 2, 2)], squeeze=True),
        POINT,
        [(0.5, 1.5)],
        [(1.5, 0.5)],
    ),
    "a mixed team": lambda: Problem(
        Workspace(((0, 0), (9, 9)), [box(4, 4, 5, 5)]),
        [DiscRobot(1 / 3), RectangleRobot(0.7, 0.1), PointRobot()],
        [(1, 1, 0), (2, 2, np.pi), (3, 3, 0)],
        [(8, 8, 0), (7, 7, -1e-3), (6, 6, 0)],
        rotation_weight=0.3,
    ),
    "tangle": scenes.tangle,
    "a polygon": lambda: Problem(
        Workspace(((0, 0), (9, 9))),
        [PolygonRobot([(-1 / 3, -0.1), (0, 0.7), (1, 0)]), PointRobot()],
        [(1, 1, 0.1), (3, 3, 0)],
        [(8, 8, 0), (6, 6, 0)],
    ),
}


@pytest.mark.parametrize("make", PROBLEMS.values(), ids=PROBLEMS)
def test_a_problem_survives_the_file_exactly(make, tmp_path):
    problem = make()
    scenes.save(problem, tmp_path / "a.json")
    again = scenes.load(tmp_path / "a.json")
    np.testing.assert_array_equal(again.starts, problem.starts)
    np.testing.assert_array_equal(again.goals, problem.goals)
    assert again.robots == problem.robots
    assert again.rotation_weight == problem.rotation_weight
    assert again.workspace.bounds == problem.workspace.bounds
    assert again.workspace.squeeze == problem.workspace.squeeze
    saved = shapely.get_parts(problem.workspace.obstacles)
    np.testing.assert_array_equal(shapely.get_coordinates(again.workspace.obstacles), shapely.get_coordinates(saved))
    assert shapely.equals_exact(
        shapely.normalize(again.workspace.free_space), shapely.normalize(problem.workspace.free_space), 0.0
    )
    scenes.save(again, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_failed_save_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "maze.json"
    scenes.save(scenes.maze(), path)
    old = path.read_bytes()

    def fail(_):
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        scenes.save(scenes.thin_maze(), path)
    assert path.read_bytes() == old
    assert [path.name for path in tmp_path.iterdir()] == ["maze.json"]


def scene_dict(**changes):
    scene = {
        "format": "plr_jax scene",
        "version": 1,
        "workspace": {
            "bounds": [[0, 0], [1, 1]],
            "squeeze": False,
            "obstacles": [
                {"outer": box(0.2, 0.2, 0.4, 0.4)},
                {"outer": box(0.5, 0.5, 0.8, 0.8), "holes": [box(0.6, 0.6, 0.7, 0.7)]},
            ],
        },
        "robots": [{"shape": "point"}],
        "starts": [[0.1, 0.1]],
        "goals": [[0.9, 0.9]],
    }
    return {**scene, **changes}


def test_a_scene_made_by_hand_loads(tmp_path):
    path = tmp_path / "hand.json"
    path.write_text(json.dumps(scene_dict()))
    assert scenes.load(path).workspace.free_space.area == pytest.approx(1 - 0.04 - 0.09 + 0.01)
    assert scenes.is_scene(path)


def test_scenes_of_points_stay_readable_by_older_releases(tmp_path):
    for name, version in (("maze", 1), ("tangle", 2), ("a mixed team", 2), ("a polygon", 3)):
        scenes.save(PROBLEMS[name](), tmp_path / "a.json")
        assert json.loads((tmp_path / "a.json").read_text())["version"] == version


def test_a_key_that_version_1_does_not_know_is_ignored_there(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(scene_dict(rotation_weight=3)))
    assert scenes.load(tmp_path / "a.json").rotation_weight is None


def without(key):
    scene = scene_dict()
    del scene[key]
    return scene


WORKSPACE = scene_dict()["workspace"]
SQUARE = box(0.2, 0.2, 0.4, 0.4)


def with_obstacles(obstacles):
    return scene_dict(workspace={**WORKSPACE, "obstacles": obstacles})


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (scene_dict(version=4), "version 4, this release reads up to 3"),
        (scene_dict(version="1"), "version number"),
        (scene_dict(format="other"), "expected a scene file"),
        ([], "expected a scene file"),
        (without("goals"), "missing goals"),
        (scene_dict(robots=[{"shape": "disc", "radius": 1}]), "expected robot 0 to be like .* in version 1"),
        (scene_dict(version=2, robots=[{"shape": "disc"}]), "expected robot 0 to be like .*'radius'"),
        (scene_dict(version=2, robots=[{"shape": "disc", "radius": 1, "color": 2}]), "expected robot 0 to be like"),
        (scene_dict(version=2, robots=[{"shape": []}]), "expected robot 0 to be like"),
        (scene_dict(version=2, robots=["disc"]), "expected robot 0 to be like"),
        (scene_dict(version=2, robots=[{"shape": "disc", "radius": -1}]), "robot 0: DiscRobot radius must be"),
        (scene_dict(version=2, robots=[{"shape": "disc", "radius": "x"}]), "robot 0: DiscRobot radius must be"),
        (
            scene_dict(version=2, robots=[{"shape": "polygon", "vertices": SQUARE}]),
            "robot 0 to be like .* in version 2",
        ),
        (scene_dict(version=3, robots=[{"shape": "polygon", "vertices": SQUARE}]), "robot 0: PolygonRobot vertices"),
        (scene_dict(version=3, robots=[{"shape": "polygon", "vertices": "x"}]), "robot 0: PolygonRobot vertices"),
        (
            scene_dict(version=2, rotation_weight="x"),
            "rotation_weight must be a finite number of at least 0, got 'x'",
        ),
        (scene_dict(version=2, rotation_weight=-1), "rotation_weight must be a finite number"),
        (scene_dict(robots={}), '"robots" to be a list'),
        (scene_dict(goals=[[0.9, 2.0]]), "Robot 0 has its goal outside the bounds"),
        (scene_dict(goals=[["a", 2.0]]), "goals must be numbers"),
        (scene_dict(workspace={}), '"workspace" to have the keys'),
        (scene_dict(workspace={**WORKSPACE, "squeeze": 1}), '"squeeze" to be true or false'),
        (scene_dict(workspace={**WORKSPACE, "bounds": 3}), "must be a Box or its corners"),
        (scene_dict(workspace={**WORKSPACE, "bounds": [[0, 0], [0, 1]]}), "positive width"),
        (with_obstacles(3), '"obstacles" to be a list'),
        (with_obstacles([3]), "expected obstacle 0 to be"),
        (with_obstacles([{"holes": []}]), "expected obstacle 0 to be"),
        (with_obstacles([{"outer": [[0, 0], [1, 1]]}]), "Obstacle 0 has 2 distinct vertices"),
        (with_obstacles([{"outer": "ring"}]), "Obstacle 0"),
        (with_obstacles([{"outer": SQUARE, "holes": [3]}]), "a ring of obstacle 0"),
        (with_obstacles([{"outer": SQUARE, "holes": [[[0, 0]]]}]), "a ring of obstacle 0"),
        (with_obstacles([{"outer": SQUARE, "holes": [[["a", 0], [0, 1], [1, 1]]]}]), "a ring of obstacle 0"),
    ],
)
def test_broken_scenes_are_refused_by_name_and_reason(scene, message, tmp_path):
    path = tmp_path / "broken.json"
    path.write_text(json.dumps(scene))
    with pytest.raises(ValueError, match=rf"broken\.json: .*{message}"):
        scenes.load(path)


@pytest.mark.parametrize("content", [b"", b'{"format": "plr_jax scene", "vers', b"\xff\xfe\x00\x01", b"hello"])
def test_files_that_are_no_json_are_refused(content, tmp_path):
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"broken\.json: expected (JSON|text)"):
        scenes.load(path)
    assert not scenes.is_scene(path)


def test_a_truncated_scene_never_loads(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "maze.json")
    whole = (tmp_path / "maze.json").read_bytes().rstrip()
    for length in range(0, len(whole), 97):
        (tmp_path / "cut.json").write_bytes(whole[:length])
        with pytest.raises(ValueError, match="expected JSON"):
            scenes.load(tmp_path / "cut.json")


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        scenes.load(tmp_path / "none.json")
