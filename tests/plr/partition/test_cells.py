import numpy as np

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells


def test_root_covers_the_domain():
    lo, hi = Cells.root(2).boxes(Box((-1, 2), (3, 4)))
    np.testing.assert_array_equal(lo, [[-1, 2]])
    np.testing.assert_array_equal(hi, [[3, 4]])


def test_split_halves_one_axis_lower_child_first():
    children = Cells.root(2).split(np.array([1])).split(np.array([0, 1]))
    lo, hi = children.boxes(Box((0, 0), (8, 8)))
    np.testing.assert_array_equal(lo, [[0, 0], [4, 0], [0, 4], [0, 6]])
    np.testing.assert_array_equal(hi, [[4, 4], [8, 4], [8, 6], [8, 8]])


def test_points_are_the_local_coordinates_mapped_into_each_cell():
    cells = Cells.root(1).split(np.array([0]))
    x = cells.points(np.array([[-1.0], [0.0], [1.0]]), Box([10.0], [12.0]))
    np.testing.assert_array_equal(x[..., 0], [[10, 10.5, 11], [11, 11.5, 12]])
