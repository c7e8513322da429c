"""Invalid arguments, and invalid answers of given functions, raise errors that name what was expected."""

import numpy as np
import pytest
from robot_helpers import BAR, DISC, WING, AnyShape, sled
from space_helpers import BOUNDS, SteadyCurrent, of_drone

from plr_jax import Box, ClearanceSpace, DiscRobot, PlanarArm, RigidBodySpace, VoxelSpace, Workspace
from plr_jax.spaces import LipschitzCost, MotionCost, PlaneSpace, RasterCost
from plr_jax.spaces._costs import cost_bounds

OPEN = Workspace(((-4.0, -4.0), (4.0, 4.0)))
HALL = Box((0, 0, 0), (4, 4, 3))
UNIT, STRIP = ((0, 0), (1, 1)), ((0, 0), (8, 1))
CHECKERS = np.eye(2, dtype=bool)
CLOCKWISE = AnyShape(((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)))
infinite_clearance = ClearanceSpace(HALL, lambda q: np.where(q[:, 0] > 2, np.inf, 1.0), 1.0).is_free
BLOCK = ((0,), 1.0)
ZEROS, ONE = np.zeros((1, 2)), np.ones(1)


def positive_cost(q):
    return np.ones(len(q))


def inflated(values, *radii, **options):
    return RasterCost(values, STRIP).inflated(*radii, **options)


def costmap(value, **options):
    return RasterCost.from_costmap([[value]], STRIP, **options)


def pulled(*pulls):
    """Ask for the bounds of a directional cost that answers these pulls."""
    cost = SteadyCurrent((0.2, -0.1))
    cost.pulls = lambda lo, hi: pulls if len(pulls) > 1 else pulls[0]
    cost_bounds(MotionCost([((0, 1), 1.0)]), cost, ZEROS, ZEROS + 1)


def cost_of(answer):
    """Ask for the bounds of a cost at two boxes, for which the cost function gives an answer."""
    LipschitzCost(lambda q: answer, 1.0, 0.5).bounds(np.zeros((2, 2)), np.ones((2, 2)))


CASES = [
    (PlaneSpace, (BOUNDS, DISC), "must be a Workspace"),
    *((PlaneSpace, (OPEN, robot), r"a point or a disc.*RigidBodySpace") for robot in (BAR, WING, "disc")),
    (PlaneSpace, (OPEN, DiscRobot(4.1)), "no free space"),
    (RigidBodySpace, (None, BAR), "must be a Workspace"),
    *((RigidBodySpace, (OPEN, robot), r"must have a heading.*PlaneSpace") for robot in (DISC, sled(), "bar")),
    (RigidBodySpace, (OPEN, CLOCKWISE), "convex"),
    *((RigidBodySpace, (OPEN, BAR, w), "rotation_weight must be a positive finite") for w in (0, -1.0, np.inf)),
    (PlanarArm, (None, [1], (0, 0)), "must be a Workspace"),
    (PlanarArm, (OPEN, [], (0, 0)), "lengths"),
    (PlanarArm, (OPEN, [1, 0], (0, 0)), r"must be positive, got \[1.0, 0.0\]"),
    (PlanarArm, (OPEN, [1, np.nan], (0, 0)), "finite"),
    (PlanarArm, (OPEN, [1], (0, 0, 0)), "base"),
    (PlanarArm, (OPEN, [1], (5, 0)), "must have a clearance of at least 0, half the width"),
    (PlanarArm, (OPEN, [1], (3.9, 0), 0.3), "at least 0.15, .* got 0.1"),
    (PlanarArm, (OPEN, [1], (0, 0), -1.0), "width must be a finite number of at least 0"),
    (PlanarArm, (OPEN, [1, 1, 1], (0, 0), 0.0, True), "got 0: give a width"),
    (VoxelSpace, (CHECKERS.astype(int),), r"booleans of 1 to 4 axes.* got int64 of shape \(2, 2\)"),
    (VoxelSpace, (np.ones((1,) * 5, bool),), "1 to 4 axes"),
    (VoxelSpace, (np.ma.masked_array(CHECKERS, CHECKERS),), "some masked"),
    (VoxelSpace, (np.zeros((2, 2), bool),), "at least one free voxel"),
    (VoxelSpace, (CHECKERS, ((0,), (1,))), "bounds must have 2 axes"),
    (VoxelSpace, (CHECKERS, Box((0, 0), (1, 1), (True, False))), "must not have periodic axes"),
    (VoxelSpace, (CHECKERS, ((1e9, 0), (1e9 + 1e-6, 1))), "sides of at least"),
    (VoxelSpace, (CHECKERS, None, -1), "radius must be"),
    (VoxelSpace, (CHECKERS, None, 1e200), "radius must be at most"),
    (VoxelSpace, (CHECKERS, None, 1e-12), "radius must be 0 for a point, or at least"),
    (ClearanceSpace, (3, of_drone, 1), r"domain must be a Box or its corners \(lo, hi\), got 3"),
    (ClearanceSpace, (HALL, 3, 1), r"clearance must be a function of configurations \(n, dof\), got 3"),
    (ClearanceSpace, (HALL, lambda q: q, 1), r"clearance must give one number per point, shape \(1,\), got \(1, 3\)"),
    (ClearanceSpace, (HALL, lambda q: q[:, 0] * np.nan, 1), r"clearance must return finite .* got nan at \[0.0, 0.0"),
    (infinite_clearance, ([[1.0, 0.5, 0.5], [3.0, 0.5, 0.5]],), r"finite numbers, got inf at \[3.0, 0.5, 0.5\]"),
    (ClearanceSpace, (HALL, of_drone, -1.0), "lipschitz must be a finite number of at least 0, got -1.0"),
    (ClearanceSpace, (HALL, of_drone, [1, 1, -1]), r"lipschitz must be at least 0 .* got \[1.0, 1.0, -1.0\]"),
    (ClearanceSpace, (HALL, of_drone, [1, 1]), r"lipschitz must be one point of shape \(3,\), got shape \(2,\)"),
    (ClearanceSpace, (HALL, of_drone, None), "lipschitz must be a finite number of at least 0, got None"),
    (ClearanceSpace, (HALL, of_drone, 1, MotionCost([((0, 1), 1.0)])), "a MotionCost of 3 axes, as the domain"),
    (ClearanceSpace, (HALL, of_drone, 1, 1.0), "motion_cost must be a MotionCost of 3 axes, .* got 1.0"),
    (MotionCost, ((),), "each axis"),
    (MotionCost, ((((0, 2), 1.0),),), r"each axis.*\[0, 2\]"),
    (MotionCost, ((((0, 1), 1.0), ((1,), 1.0)),), r"each axis.*\[0, 1, 1\]"),
    *((MotionCost, ((((0,), w),),), "weight of a block must be a positive finite") for w in (0.0, np.inf)),
    *((MotionCost, (((axes, 1.0),),), "one or more integer axes") for axes in ((0.5,), (), (True,))),
    *((MotionCost, (blocks,), "pairs .axes, weight., such as") for blocks in (((*BLOCK, 2.0),), 3)),
    (LipschitzCost, (3.0, 1.0, 1.0), r"cost_fn must be a function of configurations \(n, dof\), got 3.0"),
    *((LipschitzCost, (positive_cost, wrong, 1.0), "lipschitz must") for wrong in (-1.0, np.nan, np.inf, "much")),
    *((LipschitzCost, (positive_cost, 1.0, wrong), "least must") for wrong in (0.0, -2.0, np.nan)),
    (LipschitzCost(lambda q: 1.0, 1.0, 0.5), (ZEROS,), r"one number per point, shape \(1,\), got \(\)"),
    (cost_of, (1.0,), r"one number per point, shape \(2,\), got \(\)"),
    (cost_of, (np.zeros((2, 2)),), r"one number per point, shape \(2,\), got \(2, 2\)"),
    (cost_of, (np.array([1.0, 0.1]),), "finite numbers of at least 0.5, got 0.1 at"),
    (cost_of, (np.array([1.0, np.nan]),), "got nan at"),
    (cost_of, (np.array([np.inf, 1.0]),), "got inf at"),
    (pulled, (3,), "pulls must be two arrays of vectors and two of numbers, got 3"),
    (pulled, (np.zeros((1, 3)), ZEROS, ONE, ONE), r"finite vectors of shape \(1, 2\)"),
    (pulled, (ZEROS, np.nan * ZEROS, ONE, ONE), r"finite vectors of shape \(1, 2\)"),
    (pulled, (ZEROS, ZEROS, 2 * ONE, ONE), "least nowhere above most"),
    (pulled, (ZEROS, ZEROS, np.ones(2), ONE), "one number per point"),
    (RasterCost, ([1.0, 2], UNIT), r"a raster of 2 axes, one per axis.* and at most 4, .* got shape \(2,\)"),
    (RasterCost, (np.ones((1,) * 5), ((0,) * 5, (1,) * 5)), "at most 4"),
    (RasterCost, (np.ones((0, 2)), UNIT), "at least one cell"),
    (RasterCost, ([[1.0, 0]], UNIT), r"from 1e-30 to 1e\+30.* got 0 at \(0, 1\)\. .* use RasterCost.from_costmap"),
    (RasterCost, ([[1.0], [-np.inf]], UNIT), r"got -inf at \(1, 0\)"),
    (RasterCost, ([[1e31]], UNIT), "got 1e"),
    (RasterCost, ([["a"]], UNIT), "values must be factors on a raster of 2 axes, got"),
    (RasterCost, ([[1.0]], 5), r"The bounds must be a Box or its corners"),
    (RasterCost, ([[1.0]],), "bounds must be the box that the cells fill, got None"),
    (RasterCost, ([[1.0]], UNIT, "cubic"), "interpolation must be 'bilinear' or 'nearest', got 'cubic'"),
    (RasterCost, ([[np.nan]], UNIT), "leave a cell that is not blocked"),
    (costmap, (256,), "got 256.0"),
    (VoxelSpace, (CHECKERS[:0],), "at least one free voxel"),
    (MotionCost, ((((-1, 0), 1.0),),), "each axis"),
    (ClearanceSpace, (HALL, of_drone, np.inf), "finite number"),
    (RasterCost.from_occupancy_grid, ([[101]], STRIP), "from -1 to 100, .* use from_costmap, got 101.0"),
    (costmap, (-1,), "from 0 to 255, .* use from_occupancy_grid, got -1.0"),
    (costmap, (np.nan,), "got nan"),
    (costmap, ("x",), "values must be numbers from 0 to 255"),
    (costmap, (254,), "leave a cell that is not blocked"),
    (lambda: costmap(0, cost_travel_multiplier=-1), (), "cost_travel_multiplier must"),
    (lambda: costmap(0, unknown_is_free=1), (), "unknown_is_free must be True or False"),
    (inflated, ([[1.0, np.inf]], 9), "leave a cell that is not blocked"),
    (inflated, ([[1.0]], -1), "inscribed_radius must"),
    (lambda: inflated([[1.0]], 1, inflation_radius=np.inf), (), "inflation_radius must"),
    (lambda: inflated([[1.0]], 1, cost_scaling_factor="x"), (), "cost_scaling_factor must"),
]


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(("call", "arguments", "message"), CASES)
def test_invalid_arguments_raise(call, arguments, message):
    with pytest.raises(ValueError, match=message):
        call(*arguments)
