import itertools

import numpy as np
import pytest
import shapely

from plr_jax import scenes
from plr_jax._robot import DiscRobot, RectangleRobot


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_start_goal_and_bounds(scene):
    problem = scene()
    assert len(problem.robots) == 1
    np.testing.assert_array_equal(problem.starts, [[0.93, 0.95]])
    np.testing.assert_array_equal(problem.goals, [[0.06, 0.07]])
    np.testing.assert_array_equal(problem.workspace.bounds.lo, [0, 0])
    np.testing.assert_array_equal(problem.workspace.bounds.hi, [1, 1])


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
    free = scene().workspace.free_space
    assert free.geom_type == "Polygon"
    blocked = shapely.difference(shapely.box(0, 0, 1, 1), free)
    assert shapely.get_num_geometries(blocked) == 4  # six walls, two of them joined to another


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_no_wall_side_lies_on_a_dyadic_line(scene):
    """Within the depths a tree of this size reaches, no split can coincide with a wall."""
    corners = shapely.get_coordinates(scene().workspace.free_space)
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


@pytest.mark.parametrize("num_robots", [0, 1, 5, -3])
def test_there_is_no_scene_of_another_number_of_robots(num_robots):
    for scene, choices in ((scenes.four_rooms, "2, 3, 4, 8"), (scenes.cross, "2, 3")):
        with pytest.raises(ValueError, match=f"has {choices} robots"):
            scene(num_robots)
