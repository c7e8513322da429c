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


# The floor plan as drawn, in meters: walls, 0.16 thick, less doors, and furniture.
WALLS = [
    (0, 9.82, 15.58, 9.98),  # north of the hallway
    (0, 8.02, 15.58, 8.18),  # south of it
    *[(x - 0.08, 9.9, x + 0.08, 15) for x in (4.2, 8.4, 13.0, 15.5)],
    *[(x - 0.08, 0, x + 0.08, 8.1) for x in (5.4, 15.5)],
    (0, 4.52, 5.4, 4.68),  # restrooms above the kitchen
    (2.62, 4.6, 2.78, 8.1),
    *[(0, 6.2, 1.2, 6.26), (4.2, 6.2, 5.4, 6.26)],  # partitions
    *[(13.12, 0, 13.28, 2.6), (13.12, 2.52, 15.5, 2.68)],  # booth
    (15.5, 3.22, 20.2, 3.38),  # server room
    (17.7, 10.62, 24, 10.78),  # lounge
    (20.1, 0, 24, 3.38),  # terrace, outside
    (21.6, 4.6, 24, 8.3),  # stairs
]
DOORS = [
    *[(x, 9.8, x + width, 10) for x, width in ((2.9, 0.9), (4.7, 0.9), (11.6, 1.1), (13.9, 0.9))],
    *[(x, 8, x + width, 8.2) for x, width in ((1.1, 0.9), (3.4, 0.9), (6.1, 1.1), (13.8, 1.0))],
    (4.1, 13.7, 4.3, 14.6),  # between the offices
    *[(5.3, 3.2, 5.5, 4.1), (15.4, 5.2, 15.6, 6.3)],
    *[(13.1, 0.8, 13.3, 1.6), (18.4, 3.2, 19.3, 3.4), (19.1, 10.6, 20.5, 10.8)],
]
BOXES = [
    *[(0.9, 12.3, 1.7, 14.1), (2.2, 14.55, 3.4, 15), (7.8, 10.3, 8.4, 11.5), (9.7, 14.6, 11.7, 15)],  # offices
    *[(13.0, 11.2, 14.4, 11.6), (14.1, 12.7, 15.5, 13.1), (13.0, 14.1, 14.4, 14.5)],  # shelves
    *[(9.2, 8.1, 10.4, 8.6), (9.3, 3.8, 9.7, 4.2), (12.6, 3.8, 12.95, 4.2), (17.3, 9.1, 17.7, 9.5)],  # columns
    *[(13.2, 3.6, 14.6, 4.3), (14.2, 0.6, 14.9, 1.9), (16.3, 0.7, 17.1, 2.5), (17.9, 0.7, 18.7, 2.5)],
]
DESKS = [(7.9, 2.3), (7.9, 5.7), (11.1, 2.3), (11.1, 5.7)]
RINGS = [
    [(0, 0), (4.3, 0), (4.3, 0.6), (0.6, 0.6), (0.6, 3.1), (0, 3.1)],  # kitchen counter
    [(6.1, 14.4), (6.1, 13.7), (7.1, 13.7), (7.1, 12.2), (7.8, 12.2), (7.8, 14.4)],  # desk of the second office
    [(9.6, 12.0), (10.0, 11.6), (11.4, 11.6), (11.8, 12.0), (11.8, 13.4), (11.4, 13.8), (10.0, 13.8), (9.6, 13.4)],
    [(17.3, 5.3), (19.9, 5.3), (19.9, 5.9), (17.9, 5.9), (17.9, 7.3), (19.9, 7.3), (19.9, 7.9), (17.3, 7.9)],
    [(16.1, 14.6), (16.1, 12.4), (16.9, 12.4), (16.9, 13.8), (18.9, 13.8), (18.9, 14.6)],  # sofa
    [(21.2, 15), (24, 15), (24, 12.4)],  # the corner of the building that is cut off
    [(22.52, 12.19), (20.9, 13.69), (20.08, 12.81), (21.7, 11.31)],  # table along it
    [(2.6, 2.0), (3.2, 1.9), (3.7, 2.3), (3.8, 2.9), (3.4, 3.4), (2.8, 3.5), (2.3, 3.1), (2.2, 2.5)],
    [(3.1, 11.2), (2.85, 11.63), (2.35, 11.63), (2.1, 11.2), (2.35, 10.77), (2.85, 10.77)],
    [(18.7, 12.5), (18.4, 13.02), (17.8, 13.02), (17.55, 12.5), (17.8, 11.98), (18.4, 11.98)],
]


def floor_plan_obstacles():
    desks = [[(x - 1.25, y - 0.36, x + 1.25, y + 0.36), (x - 0.36, y - 1.25, x + 0.36, y + 1.25)] for x, y in DESKS]
    walls = boxes_union(WALLS) - boxes_union(DOORS)
    return shapely.union_all([walls, boxes_union(BOXES), *map(boxes_union, desks), *map(shapely.Polygon, RINGS)])


def test_floor_plan():
    problem = scenes.floor_plan()
    free = shapely.box(0, 0, 24, 15) - floor_plan_obstacles()
    check(problem, free, [PointRobot()], [((23.2, 11.6), (1.2, 1.2))])
    np.testing.assert_array_equal([problem.workspace.bounds.lo, problem.workspace.bounds.hi], [(0, 0), (24, 15)])
    assert free.geom_type == "Polygon"  # every room has a door
    assert len(shapely.get_coordinates(problem.workspace.free_space)) > 200


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
        (scenes.four_rooms, [(0,), (1,), (5,), (-3,)], "must have 2, 3, 4, 8 robots"),
        (scenes.cross, [(0,), (1,), (5,), (-3,)], "must have 2, 3 robots"),
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
