"""Polygons of masks, compared with unions of squares by Shapely and with connected components of pixels."""

import numpy as np
import pytest
import scipy.ndimage
import shapely

from plr_jax import VisibilityGraph, Workspace
from plr_jax.geometry.masks import CLEARANCE, placed_region, region_of_mask, rounded_one_by_one, without_specks

TOLERANCES = (0.25, 0.5, 0.8, 1.5)


def drawn(*rows):
    """Return a mask from text: its first row is the lowest, and a dot is a free pixel."""
    return np.array([list(row) for row in rows]) == "."


@pytest.mark.parametrize("seed", range(9))
def test_simplified_outlines_keep_distance_and_components(seed):
    rng = np.random.default_rng(seed)
    free = rng.random(rng.integers(1, 13, 2)) < rng.choice([0.3, 0.5, 0.7, 0.9])
    free.flat[0] = True
    free = np.kron(free, np.ones((2, 2), bool)) if seed % 3 == 0 else free
    row, column = np.nonzero(free)
    pixels = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    (label, count), exact = scipy.ndimage.label(free), region_of_mask(free, 0)
    assert exact.is_valid and shapely.symmetric_difference(exact, pixels).area == 0 and len(exact.geoms) == count
    middles = shapely.points(np.argwhere(free)[:, ::-1] + 0.5)
    for tolerance in TOLERANCES:
        region = region_of_mask(free, tolerance)
        assert region.is_valid
        assert shapely.hausdorff_distance(region.boundary, pixels.boundary, 0.05) <= tolerance
        assert shapely.hausdorff_distance(pixels.boundary, region.boundary, 0.05) <= tolerance
        holes, exact_holes = (sorted(len(part.interiors) for part in each.geoms) for each in (region, exact))
        assert holes == exact_holes and min(part.area for part in region.geoms) > CLEARANCE**2
        assert shapely.get_num_coordinates(region) <= shapely.get_num_coordinates(exact)
        if tolerance == 0.5:  # each part belongs to one component of pixels and contains most of their middles
            held = shapely.intersects(shapely.get_parts(region)[:, None], middles)
            for component in range(1, count + 1):
                assert held[:, label[free] == component].any(axis=1).sum() == 1


@pytest.mark.parametrize("seed", range(8))
def test_passages_two_pixels_wide_stay_open(seed):
    """A square of two by two pixels slides wherever it fits: its middle stays free on the way."""
    rng = np.random.default_rng(seed)
    free = np.kron(rng.random((9, 11)) < 0.6, np.ones((2, 2), bool)) | (rng.random((18, 22)) < 0.05)
    free[:2, :2] = True
    workspace = Workspace.from_mask(free)
    fits = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]
    for dy, dx in ((0, 1), (1, 0)):
        row, column = np.nonzero(fits[: 17 - dy, : 21 - dx] & fits[dy:, dx:])
        begin = np.stack([column + 1.0, row + 1.0], axis=1)
        assert workspace.is_visible(begin, begin + np.array([dx, dy])).all()


def test_simplification_straightens_inclined_walls():
    y, x = np.indices((80, 100)) + 0.5
    free = np.abs(x * np.sin(0.37) - (y - 10) * np.cos(0.37)) < 9
    exact, half = (Workspace.from_mask(free, tolerance=tolerance) for tolerance in (0, 0.5))
    assert len(half.boundary.vertices) < 0.5 * len(exact.boundary.vertices)


def test_rectangle_keeps_its_corners():
    free = np.ones((30, 40), bool)
    free[10:20, 5:9] = False
    workspace = Workspace.from_mask(free)
    (obstacle,) = workspace.obstacles
    assert obstacle.equals(shapely.box(5, 10, 9, 20))


def test_small_obstacles_and_free_specks_are_dropped():
    free = drawn("......", ".#..#.", "..#...", "......", "######", "#.##..")
    dropped = without_specks(free, 2)  # two obstacles; then two free places
    np.testing.assert_array_equal(dropped, drawn("......", "......", "......", "......", "######", "######"))
    # The two that touch in a corner are one obstacle of two pixels, the one at the right of one.
    np.testing.assert_array_equal(without_specks(free, 1)[:4], drawn("......", ".#....", "..#...", "......"))


def test_masks_are_placed_by_origin_yaw_and_first_row():
    free = drawn("..", ".#", ".#")
    np.testing.assert_array_equal(Workspace.from_mask(free, 0.5, (1, 2)).bounds.hi, [2, 3.5])
    top = Workspace.from_mask(free, 0.5, (1, 2), row0="top", tolerance=0)
    np.testing.assert_array_equal(top.is_free([(1.75, 3.25), (1.75, 2.25), (1.25, 2.25)]), [True, False, True])
    turned = Workspace.from_mask(free, 0.5, (1, 2, np.pi / 2), tolerance=0)
    np.testing.assert_allclose([turned.bounds.lo, turned.bounds.hi], [(-0.5, 2), (1, 3)], atol=1e-12)
    np.testing.assert_array_equal(turned.is_free([(0.75, 2.75), (0.25, 2.75)]), [True, False])


@pytest.mark.parametrize("origin", [(0, 0), (3e5, 5e6, 0.3)])
@pytest.mark.parametrize("resolution", [1e-90, 9e-6, 0.05, 1e90])
def test_pixels_stay_free_or_blocked_at_any_scale(resolution, origin):
    """A mask is refused, or its pixels are free and blocked as given."""
    free = np.kron(np.random.default_rng(0).random((6, 7)) < 0.7, np.ones((2, 2), bool))
    if resolution < 8e-12 * np.abs(origin).max():
        with pytest.raises(ValueError, match="resolution must be at least"):
            Workspace.from_mask(free, resolution, origin)
        return
    workspace = Workspace.from_mask(free, resolution, origin)
    yaw = (*origin, 0)[2]
    turn = np.array([(np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))])
    row, column = np.indices(free.shape)
    middles = np.stack([column, row], axis=-1).reshape(-1, 2) + 0.5
    x = np.array(origin[:2]) + resolution * middles @ turn
    np.testing.assert_array_equal(workspace.is_free(x), free.ravel())


def test_diagonal_pixels_are_passed_only_by_squeezing():
    for squeeze in (False, True):
        oracle = VisibilityGraph(Workspace.from_mask(drawn(".#", "#."), squeeze=squeeze), (0.5, 0.5))
        assert np.isfinite(oracle(np.array([[1.5, 1.5]])))[0] == squeeze


def test_region_rounded_vertex_by_vertex_equals_set_precision_of_shapely():
    rng = np.random.default_rng(0)
    free = np.kron(rng.random((15, 20)) < 0.7, np.ones((2, 2), bool)) | (rng.random((30, 40)) < 0.1)
    region = placed_region(free, 5e-5, (3e5, 5e6, 2), row0="bottom", tolerance=0.5, drop_specks=0)
    grid = 2.0 ** np.floor(np.log2(5e-5 / 4e3))
    rounded, expected = rounded_one_by_one(region, grid), shapely.set_precision(region, grid)
    assert rounded.is_valid and shapely.equals_exact(rounded.normalize(), expected.normalize())
