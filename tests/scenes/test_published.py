import itertools

import numpy as np
import pytest
import shapely

from plr_jax import DiscRobot, PointRobot, RectangleRobot, scenes


def test_maze_walls_by_area_and_by_points():
    workspace = scenes.maze().workspace
    # 0.71 + 0.73 + 0.63 + 0.36 + 0.13 + 0.21 of wall, 0.04 thick, nowhere overlapping.
    assert workspace.free_space.area == pytest.approx(1 - 0.04 * 2.77, abs=1e-9)
    blocked = [(0.3, 0.21), (0.6, 0.45), (0.3, 0.7), (0.81, 0.6), (0.43, 0.3), (0.21, 0.9)]
    free = [(0.72, 0.21), (0.26, 0.45), (0.64, 0.7), (0.81, 0.84), (0.43, 0.37), (0.21, 0.78)]
    assert not workspace.is_free(np.array(blocked)).any()
    assert workspace.is_free(np.array(free)).all()


def test_thin_maze_walls_by_area_and_by_points():
    workspace = scenes.thin_maze().workspace
    assert workspace.free_space.area == pytest.approx(1 - 0.01 * (0.71 + 0.73 + 0.63 + 0.375 + 0.145 + 0.21))
    assert not workspace.is_free(np.array([(0.3, 0.21), (0.6, 0.45), (0.3, 0.7), (0.81, 0.458)])).any()
    assert workspace.is_free(np.array([(0.3, 0.2), (0.6, 0.44), (0.804, 0.6), (0.816, 0.6)])).all()


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_free_space_is_one_piece_and_walls_that_touch_are_joined(scene):
    problem = scene()
    assert problem.starts.tolist() == [[0.93, 0.95]] and problem.goals.tolist() == [[0.06, 0.07]]
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (1, 1)])
    free = problem.workspace.free_space
    assert free.geom_type == "Polygon"
    blocked = shapely.difference(shapely.box(0, 0, 1, 1), free)
    assert shapely.get_num_geometries(blocked) == 4  # six walls, two of them joined to another


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze, scenes.floor_plan])
def test_no_wall_side_lies_on_a_dyadic_line(scene):
    """Within the depths a tree of this size reaches, no split can coincide with a wall."""
    workspace = scene().workspace
    corners = shapely.get_coordinates(workspace.free_space) / workspace.bounds.width
    inner = corners[(corners > 0) & (corners < 1)]
    for value, bits in itertools.product(np.unique(inner), range(1, 11)):
        assert (value * 2**bits) % 1 != 0


def boxes_union(boxes):
    return shapely.union_all([shapely.box(*box) for box in boxes])


def check(problem, free, robots, pairs):
    assert shapely.symmetric_difference(problem.workspace.free_space, free).area < 1e-9
    assert problem.robots == tuple(robots)
    np.testing.assert_array_equal(problem.starts, [start for start, _ in pairs])
    np.testing.assert_array_equal(problem.goals, [goal for _, goal in pairs])


def test_single_door():
    free = shapely.box(0, 0, 10, 10) - (shapely.box(4.8, 0, 5.2, 10) - shapely.box(4.8, 7, 5.2, 8))
    problem = scenes.single_door()
    check(problem, free, [DiscRobot(0.4)], [((2.13, 2.07), (8.21, 1.94))])
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (10, 10)])


FOUR_ROOMS = boxes_union(
    [
        (3.4, 3.4, 6.6, 6.6),
        *[(0, 3, 3, 7), (7, 3, 10, 7), (3, 0, 7, 3), (3, 7, 7, 10)],
        *[(3, 4.5, 3.4, 5.5), (6.6, 4.5, 7, 5.5), (4.5, 3, 5.5, 3.4), (4.5, 6.6, 5.5, 7)],
    ]
)
ONE_A_ROOM = [
    ((1.37, 5.23), (8.71, 4.81)),
    ((8.56, 5.34), (1.52, 4.69)),
    ((4.87, 1.46), (5.31, 8.63)),
    ((5.28, 8.41), (4.72, 1.59)),
]
TWO_A_ROOM = [
    ((1.1, 4.23), (9.03, 5.71)),
    ((0.97, 5.82), (8.94, 4.31)),
    ((8.91, 4.17), (1.13, 5.77)),
    ((9.06, 5.79), (1.04, 4.26)),
    ((4.21, 1.07), (5.76, 8.97)),
    ((5.83, 0.94), (4.31, 9.08)),
    ((4.17, 8.93), (5.74, 1.02)),
    ((5.77, 9.04), (4.24, 0.96)),
]


@pytest.mark.parametrize("num_robots", [2, 3, 4, 8])
def test_four_rooms(num_robots):
    pairs = TWO_A_ROOM if num_robots == 8 else ONE_A_ROOM[:num_robots]
    check(scenes.four_rooms(num_robots), FOUR_ROOMS, [DiscRobot(0.4)] * num_robots, pairs)


@pytest.mark.parametrize("num_robots", [2, 3])
def test_cross(num_robots):
    free = boxes_union([(0, 4.4, 10, 5.6), (4.4, 0, 5.6, 10)])
    pairs = [((1.03, 5.04), (8.94, 4.97)), ((9.01, 4.93), (1.06, 5.02)), ((5.03, 1.04), (4.96, 8.97))]
    check(scenes.cross(num_robots), free, [DiscRobot(0.4)] * num_robots, pairs[:num_robots])


def test_tangle():
    free = boxes_union([(0, 0, 8, 0.9), (3.15, -1.38, 4.85, 2.28)])
    left, right = (1.2, 0.45, 0), (6.8, 0.45, 0)
    problem = scenes.tangle()
    check(problem, free, [RectangleRobot(1.8, 0.5)] * 2, [(left, right), (right, left)])
    assert problem.rotation_weights[0] == pytest.approx(np.hypot(1.8, 0.5) / 2)


def test_floor_plan():
    """Every coordinate of it is known by the area, the length of its walls, or its center."""
    problem = scenes.floor_plan()
    free = problem.workspace.free_space
    check(problem, free, [PointRobot()], [((23.2, 11.6), (1.2, 1.2))])
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (24, 15)])
    assert free.geom_type == "Polygon"  # every room has a door
    assert (shapely.get_num_coordinates(free), len(free.interiors)) == (np.int32(312), 24)
    measures = (274.39900000023, 381.3235487520275, 11.269326676381752, 7.711286202451447)
    assert (free.area, free.length, free.centroid.x, free.centroid.y) == pytest.approx(measures, rel=1e-12)


@pytest.mark.parametrize("num_robots", [2, 10, 50])
def test_door(num_robots):
    half = num_robots // 2
    left = [(1 + 1.7 * (k % 5), 2 + 3.9 * (k // 5)) for k in range(half)]
    starts = np.array(left + [(21 - x, y) for x, y in left])
    free = boxes_union([(0, 0, 10, 20), (11, 0, 21, 20), (10, 9.4, 11, 10.6)])
    problem = scenes.door(num_robots)
    np.testing.assert_allclose(problem.starts, starts)
    np.testing.assert_allclose(problem.goals, np.roll(starts, half, axis=0))
    check(problem, free, [DiscRobot(0.4)] * num_robots, list(zip(problem.starts, problem.goals, strict=True)))


@pytest.mark.parametrize(("num_robots", "seed"), [(2, 0), (25, 0), (300, 2)])
def test_crowd(num_robots, seed):
    problem = scenes.crowd(num_robots, seed)
    (side, height), covered = problem.workspace.bounds.width, num_robots * np.pi * 0.16
    assert side == height and covered / side**2 == pytest.approx(0.15) and not problem.workspace.obstacles
    for places in (problem.starts, problem.goals):
        away = np.hypot(*(places[:, None] - places).T)[~np.eye(num_robots, dtype=bool)]
        assert away.min() >= 0.85 and places.min() >= 0.45 and places.max() <= side - 0.45
    again, other = scenes.crowd(num_robots, seed), scenes.crowd(num_robots, seed + 1)
    np.testing.assert_array_equal(problem.starts, again.starts)
    assert (problem.starts != other.starts).any()
    # Uniform: the mean of the places is the middle, to a few standard errors.
    if num_robots >= 100:
        assert np.abs(np.concatenate([problem.starts, problem.goals]).mean(axis=0) / side - 0.5).max() < 0.1


@pytest.mark.parametrize(
    "make",
    [scenes.single_door, lambda: scenes.four_rooms(8), lambda: scenes.cross(3), scenes.tangle, scenes.maze],
)
def test_starts_and_goals_move_a_little_and_nothing_else_does(make):
    problem = make()
    distance = 0.02 if problem.workspace.bounds.width.max() == 1 else 0.1
    variants = [scenes.perturbed(problem, seed, distance) for seed in (0, 1, 2, 2)]
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
    assert len({(variant.starts.tobytes(), variant.goals.tobytes()) for variant in variants}) == 3


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (scenes.door, [(number,) for number in (0, 1, 3, 52, 2.0, True, "2")], "num_robots must be an"),
        (scenes.crowd, [(number,) for number in (0, -1, 2.5, True)], "num_robots must be an integer"),
        (scenes.crowd, [(3, seed) for seed in (-1, 1.5, "a")], "seed must be an integer"),
        (scenes.four_rooms, [(0,), (1,), (5,), (-3,)], "has 2, 3, 4, 8 robots"),
        (scenes.cross, [(0,), (1,), (5,), (-3,)], "has 2, 3 robots"),
        (
            scenes.perturbed,
            [(scenes.cross(2), 0, distance) for distance in (0, -1.0, np.nan, np.inf)],
            "distance must be a positive finite number",
        ),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_there_is_no_other_scene(make, arguments, message):
    for each in arguments:
        with pytest.raises(ValueError, match=message):
            make(*each)
