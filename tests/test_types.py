"""Checks of shapes, members of protocols, and tests of boxes for points that reach a goal."""

import os

import numpy as np
import pytest
import shapely
from jaxtyping import TypeCheckError
from scipy import ndimage

from plr_jax import Box, Euclidean, GridField, GridGraph, Workspace, construct
from plr_jax._arrays import padded
from plr_jax._types import FAR_AWAY, DimensionedFn, PiecewiseFunction


@pytest.mark.skipif(os.environ.get("PLR_JAX_CHECK_SHAPES") != "1", reason="PLR_JAX_CHECK_SHAPES=1 checks shapes")
def test_wrong_shape_inside_package_raises():
    padded(np.zeros((2, 3)), 4)
    with pytest.raises(TypeCheckError):
        padded([0.0, 1.0], 4)


def test_plr_is_piecewise_function_filling_its_domain():
    oracle = Euclidean((0.5, 0.5))
    plr = construct(oracle, ((0, 0), (1, 1)), max_leaves=4)
    assert isinstance(plr, PiecewiseFunction) and not isinstance(oracle, PiecewiseFunction)
    assert isinstance(plr, DimensionedFn) and isinstance(oracle, DimensionedFn) and not isinstance(len, DimensionedFn)
    lo, hi = map(np.asarray, plr.leaf_boxes)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(np.prod(plr.domain.width))


# Boxes are compared with points in them, which an independent search over the parts of free space judges.
DOMAIN = Box([0.0, 0.0], [10.0, 10.0])
RINGS = [shapely.Point(x, y).buffer(1.9).difference(shapely.Point(x, y).buffer(1.4)) for x, y in ((3, 3), (7, 6.5))]


def check_boxes(reach, free, reached, at, rng):
    """``free`` and ``reached`` tell about the points ``at``, fractions of the domain ``(n, 2)``."""
    cut_off = at[free & ~reached]
    far = cut_off[[np.linalg.norm(at[reached] - x, axis=1).min() > FAR_AWAY for x in cut_off]]
    lo = rng.integers(0, num := 2 ** rng.integers(1, 6, (400, 2))) / num
    hi = lo + 1 / num

    def hold(x, margin):
        return ((x >= lo[:, None] + margin) & (x <= hi[:, None] - margin)).all(axis=2).any(axis=1)

    is_cut_off, is_border = reach.is_cut_off(lo, hi), reach.is_border(lo, hi)
    assert not (is_cut_off & hold(at[reached], 0)).any()
    assert not (hold(cut_off, 1e-6) & ~hold(at[reached], -0.02) & ~is_cut_off).any()
    assert not (hold(far, 1e-6) & hold(at[reached], 0) & ~is_border).any()
    assert not (is_border & is_cut_off).any() and is_border.any() and is_cut_off.any()


@pytest.mark.parametrize("goal", [(0.5, 0.5), (3.0, 3.0)])
def test_boxes_of_polygons(goal):
    workspace, rng = Workspace(DOMAIN, RINGS), np.random.default_rng(0)
    x = np.append(rng.random((4000, 2)) * 10, workspace.boundary.vertices, axis=0)
    home = next(part for part in workspace.free_space.geoms if part.distance(shapely.Point(goal)) == 0)
    reached = shapely.dwithin(home, shapely.points(x), 1e-9)
    assert (workspace.reachable(x, goal) == reached).all()
    check_boxes(workspace.reach(np.array([goal]), DOMAIN), workspace.is_free(x), reached, x / 10, rng)
    assert workspace.reach(np.array([(0.5, 0.5), (3, 3), (7, 6.5)]), DOMAIN) is None


@pytest.mark.parametrize("squeeze", [True, False])
def test_points_beyond_a_contact_are_reachable_by_squeezing(squeeze):
    workspace = Workspace(((0, 0), (4, 4)), [shapely.box(0, 2, 2, 4), shapely.box(2, 0, 4, 2)], squeeze=squeeze)
    assert workspace.reachable([(3, 3), (1, 1), (2, 2), (1, 3), (5, 5)], (1, 1)).tolist() == [squeeze, 1, 1, 0, 0]


def test_boxes_of_cells():
    rng = np.random.default_rng(3)
    free = ndimage.binary_dilation(rng.random((40, 30)) < 0.03, iterations=2)
    goal = np.argwhere(free)[0][::-1] + 0.5
    label = ndimage.label(free)[0]
    reached, domain = label == label[tuple(np.floor(goal[::-1]).astype(int))], Box([0.0, 0.0], [30.0, 40.0])
    at = rng.random((4000, 2))
    cell = tuple((at[:, ::-1] * free.shape).astype(int).T)
    distance = np.where(reached, 1.0, np.inf)
    for fn in (GridGraph(free, goal), GridField(distance, domain, free)):
        check_boxes(fn.reach(domain), free[cell], reached[cell], at, rng)
    with pytest.raises(ValueError, match=r"free must be booleans like values, of shape \(40, 30\)"):
        GridField(distance, domain, free[1:])


def test_boxes_beyond_a_grid_and_across_the_seam_of_a_periodic_one():
    free, reached = np.repeat([0, 1, 0, 1, 0], [1, 14, 2, 14, 1]) > 0, np.arange(32) < 15
    values, lo = np.where(reached & free, 1.0, np.inf), np.array([[0.0], [0.25], [0.5], [0.75]])
    for wraps, expected in ((False, [0, 1, 0, 0]), (True, [0, 1, 0, 1])):
        field = GridField(values, Box([0.0], [32.0], (wraps,)), free)
        assert field.reach(Box([0.0], [64.0])).is_cut_off(lo, lo + 0.25).tolist() == expected
