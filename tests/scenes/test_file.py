import json

import numpy as np
import pytest
import shapely

from plr_jax import DiscRobot, PointRobot, PolygonRobot, Problem, RectangleRobot, Workspace, scenes

POINT = [PointRobot()]


def box(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


HOLED = Workspace.from_polygons([shapely.box(0, 0, 4, 4) - shapely.box(1, 1, 2, 2), shapely.box(6, 0, 7, 1)])
CORNERS = [box(0, 0, 1, 1), box(1, 1, 2, 2)]
TRIANGLE = PolygonRobot([(-1 / 3, -0.1), (0, 0.7), (1, 0)])
ODD = Workspace(((0.1, -1e-7), (np.pi, 1 / 3)), [box(0.7, 0.1, 1.1, 0.2)])
ONE_REMOVED = Workspace(((0, 0), (4, 4)), [box(1, 1, 2, 2), box(3, 3, 4, 4)]).with_obstacles(remove=[0])
MIXED_TEAM = Problem(
    Workspace(((0, 0), (9, 9)), [box(4, 4, 5, 5)]),
    [DiscRobot(1 / 3), RectangleRobot(0.7, 0.1), PointRobot()],
    [(1, 1, 0), (2, 2, np.pi), (3, 3, 0)],
    [(8, 8, 0), (7, 7, -1e-3), (6, 6, 0)],
    rotation_weight=0.3,
)
PROBLEMS = {  # and the oldest version of the format that can hold each
    "odd numbers": (Problem(ODD, POINT, [(0.2, 0.1)], [(np.e, 0.3)]), 1),
    "blocked margin": (Problem(Workspace(((0, 0), (4, 4)), [box(0, 0, 1, 4)]), POINT, [(2, 2)], [(3, 3)]), 1),
    "two parts, a hole": (Problem(HOLED, POINT * 2, [(0.5, 0.5), (6, 0)], [(3, 3), (7, 1)]), 1),
    "squeeze": (Problem(Workspace(((0, 0), (2, 2)), CORNERS, squeeze=True), POINT, [(0.5, 1.5)], [(1.5, 0.5)]), 1),
    "removed obstacle": (Problem(ONE_REMOVED, POINT, [(1.5, 1.5)], [(2, 2)]), 1),
    "mixed team": (MIXED_TEAM, 2),
    "polygon": (Problem(Workspace(((0, 0), (9, 9))), [TRIANGLE], [(1, 1, 0.1)], [(8, 8, 0)]), 3),
}


@pytest.mark.parametrize(("problem", "version"), PROBLEMS.values(), ids=PROBLEMS)
def test_saved_problem_loads_exactly(problem, version, tmp_path):
    scenes.save(problem, tmp_path / "a.json")
    again = scenes.load(tmp_path / "a.json")
    np.testing.assert_array_equal(again.starts, problem.starts)
    np.testing.assert_array_equal(again.goals, problem.goals)
    assert (again.robots, again.rotation_weight) == (problem.robots, problem.rotation_weight)
    assert again.workspace.bounds == problem.workspace.bounds
    assert again.workspace.squeeze == problem.workspace.squeeze
    saved = shapely.get_parts(problem.workspace.obstacles)
    np.testing.assert_array_equal(shapely.get_coordinates(again.workspace.obstacles), shapely.get_coordinates(saved))
    free, expected = (shapely.normalize(each.workspace.free_space) for each in (again, problem))
    assert shapely.equals_exact(free, expected, 0.0)
    scenes.save(again, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert json.loads((tmp_path / "a.json").read_text())["version"] == version


def test_failed_save_keeps_old_file(tmp_path, monkeypatch):
    (tmp_path / "a.json").write_text("old")
    monkeypatch.delattr("os.replace")
    with pytest.raises(AttributeError):
        scenes.save(MIXED_TEAM, tmp_path / "a.json")
    assert (tmp_path / "a.json").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


SQUARE = box(0.2, 0.2, 0.4, 0.4)
WORKSPACE = {
    "bounds": [[0, 0], [1, 1]],
    "squeeze": False,
    "obstacles": [{"outer": SQUARE}, {"outer": box(0.5, 0.5, 0.8, 0.8), "holes": [box(0.6, 0.6, 0.7, 0.7)]}],
}


def scene(version=1, **changes):
    ends = {"starts": [[0.1, 0.1]], "goals": [[0.9, 0.9]]}
    known = {"format": "plr_jax scene", "workspace": WORKSPACE, "robots": [{"shape": "point"}], **ends}
    return {**known, "version": version, **changes}


def robot(version, entry):
    return scene(version, robots=[entry])


def workspace(**changes):
    return scene(workspace={**WORKSPACE, **changes})


def obstacle(**rings):
    return workspace(obstacles=[rings])


def test_handwritten_scene_loads(tmp_path):
    path = tmp_path / "hand.json"
    path.write_text(json.dumps(scene(rotation_weight=3)))  # a key that version 1 ignores
    assert scenes.load(path).workspace.free_space.area == pytest.approx(1 - 0.04 - 0.09 + 0.01)
    assert scenes.load(path).rotation_weight is None
    assert scenes.is_scene(path)


def test_broken_scene_raises(tmp_path):
    for document, message in [
        (scene(4), "version 4, this release reads up to 3"),
        (scene("1"), "version number"),
        (scene(format="other"), "expected a scene file"),
        ([], "expected a scene file"),
        ({key: value for key, value in scene().items() if key != "goals"}, "missing goals"),
        (robot(1, {"shape": "disc", "radius": 1}), "expected robot 0 to be like .* in version 1"),
        (robot(2, {"shape": "disc"}), "expected robot 0 to be like .*'radius'"),
        (robot(2, {"shape": "disc", "radius": 1, "color": 2}), "expected robot 0 to be like"),
        (robot(2, {"shape": []}), "expected robot 0 to be like"),
        (robot(2, {"shape": "disc", "radius": -1}), "robot 0: DiscRobot radius must be"),
        (robot(2, {"shape": "polygon", "vertices": SQUARE}), "robot 0 to be like .* in version 2"),
        (robot(3, {"shape": "polygon", "vertices": "x"}), "robot 0: PolygonRobot vertices"),
        (scene(2, rotation_weight="x"), "rotation_weight must be a finite number of at least 0, got 'x'"),
        (scene(robots={}), '"robots" to be a list'),
        (scene(goals=[[0.9, 2.0]]), "Robot 0 has its goal outside the bounds"),
        (scene(workspace={}), '"workspace" to have the keys'),
        (workspace(squeeze=1), '"squeeze" to be true or false'),
        (workspace(obstacles=3), '"obstacles" to be a list'),
        (workspace(obstacles=[3]), "expected obstacle 0 to be"),
        (obstacle(holes=[]), "expected obstacle 0 to be"),
        (obstacle(outer=SQUARE, holes=3), "expected obstacle 0 to be"),
        (obstacle(outer=[[0, 0], [1, 1]]), "Obstacle 0 has 2 distinct vertices"),
        (obstacle(outer=SQUARE, holes=[[[0, 0]]]), "rings of obstacle 0"),
    ]:
        path = tmp_path / "broken.json"
        path.write_text(json.dumps(document))
        with pytest.raises(ValueError, match=rf"broken\.json: .*{message}"):
            scenes.load(path)


def test_file_without_json_is_no_scene(tmp_path):
    path = tmp_path / "broken.json"
    for content in (b"", b'{"format": "plr_jax scene", "vers', b"\xff\xfe\x00\x01"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"broken\.json: expected (JSON|text)"):
            scenes.load(path)
        assert not scenes.is_scene(path)
