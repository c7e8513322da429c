import itertools

import numpy as np
import pytest
import shapely

from plr_jax import scenes


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
