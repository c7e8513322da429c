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


BLOCKED = [(0.3, 0.21), (0.6, 0.45), (0.3, 0.7), (0.81, 0.6), (0.43, 0.3), (0.21, 0.9)]
FREE = [(0.72, 0.21), (0.26, 0.45), (0.64, 0.7), (0.81, 0.84), (0.43, 0.37), (0.21, 0.78)]
BESIDE_THIN_WALLS = [(0.3, 0.2), (0.6, 0.44), (0.804, 0.6), (0.816, 0.6)]


def test_maze_walls_by_area_and_points():
    for scene, wall_area, free in [
        (scenes.maze, 0.04 * (0.71 + 0.73 + 0.63 + 0.36 + 0.13 + 0.21), FREE),
        (scenes.thin_maze, 0.01 * (0.71 + 0.73 + 0.63 + 0.375 + 0.145 + 0.21), FREE + BESIDE_THIN_WALLS),
    ]:
        workspace = scene().workspace
        assert workspace.free_space.area == pytest.approx(1 - wall_area, abs=1e-9)
        assert not workspace.is_free(np.array(BLOCKED)).any() and workspace.is_free(np.array(free)).all()


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_maze_is_one_piece_with_joined_walls(scene):
    problem = scene()
    assert problem.starts.tolist() == [[0.93, 0.95]] and problem.goals.tolist() == [[0.06, 0.07]]
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (1, 1)])
    free = problem.workspace.free_space
    assert free.geom_type == "Polygon"
    # Six walls, two of them joined to another.
    assert shapely.get_num_geometries(shapely.difference(shapely.box(0, 0, 1, 1), free)) == 4


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze, scenes.floor_plan])
def test_no_wall_lies_on_side_of_tree_cell(scene):
    """Splits of a tree lie at dyadic fractions of the width; ten levels of splits do not reach a wall."""
    workspace = scene().workspace
    corners = shapely.get_coordinates(workspace.free_space) / workspace.bounds.width
    inner = corners[(corners > 0) & (corners < 1)]
    assert ((inner * 2.0 ** np.arange(1, 11)[:, None]) % 1 != 0).all()


def union_of(boxes):
    return shapely.union_all([shapely.box(*box) for box in boxes])


DOORS = [(3, 4.5, 3.4, 5.5), (6.6, 4.5, 7, 5.5), (4.5, 3, 5.5, 3.4), (4.5, 6.6, 5.5, 7)]
FOUR_ROOMS = union_of([(3.4, 3.4, 6.6, 6.6), (0, 3, 3, 7), (7, 3, 10, 7), (3, 0, 7, 3), (3, 7, 7, 10), *DOORS])
FOUR_ENDS = [(1.37, 5.23, 8.71, 4.81), (8.56, 5.34, 1.52, 4.69), (4.87, 1.46, 5.31, 8.63), (5.28, 8.41, 4.72, 1.59)]
EIGHT_ENDS = [
    *[(1.1, 4.23, 9.03, 5.71), (0.97, 5.82, 8.94, 4.31), (8.91, 4.17, 1.13, 5.77), (9.06, 5.79, 1.04, 4.26)],
    *[(4.21, 1.07, 5.76, 8.97), (5.83, 0.94, 4.31, 9.08), (4.17, 8.93, 5.74, 1.02), (5.77, 9.04, 4.24, 0.96)],
]
CROSS = union_of([(0, 4.4, 10, 5.6), (4.4, 0, 5.6, 10)])
CROSS_ENDS = [(1.03, 5.04, 8.94, 4.97), (9.01, 4.93, 1.06, 5.02), (5.03, 1.04, 4.96, 8.97)]
DOORWAY = union_of([(0, 0, 4.8, 10), (5.2, 0, 10, 10), (4.8, 7, 5.2, 8)])
TANGLE = union_of([(0, 0, 8, 0.9), (3.15, -1.38, 4.85, 2.28)])
TANGLE_ENDS = [(1.2, 0.45, 0, 6.8, 0.45, 0), (6.8, 0.45, 0, 1.2, 0.45, 0)]


def test_scene_has_walls_robots_and_ends():
    for problem, free, robot, ends in [
        (scenes.single_door(), DOORWAY, DiscRobot(0.4), [(2.13, 2.07, 8.21, 1.94)]),
        *[(scenes.four_rooms(n), FOUR_ROOMS, DiscRobot(0.4), FOUR_ENDS[:n]) for n in (2, 3, 4)],
        (scenes.four_rooms(8), FOUR_ROOMS, DiscRobot(0.4), EIGHT_ENDS),
        *[(scenes.cross(n), CROSS, DiscRobot(0.4), CROSS_ENDS[:n]) for n in (2, 3)],
        (scenes.tangle(), TANGLE, RectangleRobot(1.8, 0.5), TANGLE_ENDS),
    ]:
        assert shapely.symmetric_difference(problem.workspace.free_space, free).area < 1e-9
        assert problem.robots == (robot,) * len(ends)
        np.testing.assert_array_equal(np.concatenate([problem.starts, problem.goals], axis=1), ends)


def test_floor_plan_by_area_perimeter_and_centroid():
    """The numbers are those of the plan as drawn: the union of walls less doors, and of the furniture."""
    problem = scenes.floor_plan()
    free = problem.workspace.free_space
    assert free.geom_type == "Polygon"  # every room has a door
    assert (free.area, free.length) == pytest.approx((274.399, 381.3235487), abs=1e-6)
    np.testing.assert_allclose(shapely.get_coordinates(free.centroid), [(11.26932668, 7.71128620)], atol=1e-6)
    assert len(shapely.get_coordinates(free)) > 200
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (24, 15)])
    assert problem.robots == (PointRobot(),)
    assert problem.starts.tolist() == [[23.2, 11.6]] and problem.goals.tolist() == [[1.2, 1.2]]


@pytest.mark.parametrize("num_robots", [2, 50])
def test_door_mirrors_starts_and_goals(num_robots):
    half = num_robots // 2
    left = [(1 + 1.7 * (k % 5), 2 + 3.9 * (k // 5)) for k in range(half)]
    starts = np.array(left + [(21 - x, y) for x, y in left])
    free = union_of([(0, 0, 10, 20), (11, 0, 21, 20), (10, 9.4, 11, 10.6)])
    problem = scenes.door(num_robots)
    np.testing.assert_allclose(problem.starts, starts)
    np.testing.assert_allclose(problem.goals, np.roll(starts, half, axis=0))
    assert problem.robots == (DiscRobot(0.4),) * num_robots
    assert shapely.symmetric_difference(problem.workspace.free_space, free).area < 1e-9


def test_crowd_is_spread_without_overlaps():
    problem = scenes.crowd(100, seed=2)
    (side, height), covered = problem.workspace.bounds.width, 100 * np.pi * 0.16
    assert side == height and covered / side**2 == pytest.approx(0.15) and not problem.workspace.obstacles
    for places in (problem.starts, problem.goals):
        away = np.hypot(*(places[:, None] - places).T)[~np.eye(100, dtype=bool)]
        assert away.min() >= 0.85 and places.min() >= 0.45 and places.max() <= side - 0.45
    again, other = scenes.crowd(100, 2), scenes.crowd(100, 3)
    np.testing.assert_array_equal(problem.starts, again.starts)
    assert (problem.starts != other.starts).any()
    # Uniform: the mean of the places is the middle, to a few standard errors.
    assert np.abs(np.concatenate([problem.starts, problem.goals]).mean(axis=0) / side - 0.5).max() < 0.1


@pytest.mark.parametrize(("make", "distance"), [(scenes.tangle, 0.1), (scenes.maze, 0.02)])
def test_perturbed_moves_only_starts_and_goals(make, distance):
    problem = make()
    variants = [scenes.perturbed(problem, seed, distance) for seed in (0, 1, 1)]
    for variant in variants:
        assert (variant.workspace, variant.robots) == (problem.workspace, problem.robots)
        assert variant.rotation_weight == problem.rotation_weight
        for name in ("starts", "goals"):
            moved = getattr(variant, name) - getattr(problem, name)
            away = np.linalg.norm(moved[:, :2], axis=1)
            assert ((away > 0) & (away <= distance)).all()
            if problem.dof == 3:
                turns = np.abs(moved[:, 2])
                assert ((turns > 0) & (turns <= distance / problem.robots[0].circumscribed_radius)).all()
    assert len({(variant.starts.tobytes(), variant.goals.tobytes()) for variant in variants}) == 2


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_arguments_raise():
    for make, arguments, message in [
        (scenes.door, [(number,) for number in (0, 1, 3, 52, 2.0, True, "2")], "num_robots must be an"),
        (scenes.crowd, [(number,) for number in (0, -1, 2.5, True)], "num_robots must be an integer"),
        (scenes.crowd, [(3, seed) for seed in (-1, 1.5, "a")], "seed must be an integer"),
        (scenes.four_rooms, [(0,), (1,), (5,), (-3,), (4.0,)], "must have 2, 3, 4, 8 robots"),
        (scenes.cross, [(0,), (1,), (5,), (-3,), (2.0,)], "must have 2, 3 robots"),
        (scenes.perturbed, [(scenes.cross(2), 0, each) for each in (0, -1.0, np.inf)], "distance must be a positive"),
    ]:
        for each in arguments:
            with pytest.raises(ValueError, match=message):
                make(*each)
