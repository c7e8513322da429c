import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import shapely
from piece_helpers import SEEDS, TEN, box, general_workspace

from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace

BLOCK = Workspace(TEN, [box(3, 3, 7, 6)])
# Two blocks that touch in (5, 5), and one that touches the lower bound with its tip.
DIAGONAL = [box(3, 3, 5, 5), box(5, 5, 7, 7), np.array([[2.0, 0], [1, 1], [3, 1]])]


def check_visible(workspace, seen, hidden, rotation=((1, 0), (0, 1))):
    """Check which segments, given by their ends, are visible, in either direction."""
    a, b = np.array([*seen, *hidden], float).transpose(1, 0, 2) @ np.transpose(rotation)
    for ends in ((a, b), (b, a)):
        np.testing.assert_array_equal(workspace.is_visible(*ends), np.arange(len(a)) < len(seen))


def test_vertices_of_obstacles_are_in_the_order_given():
    ring, other, hole = box(1, 1, 5, 5)[::-1], box(6, 6, 7, 9), box(2, 2, 4, 3)[[2, 0, 1]]
    several = shapely.MultiPolygon([(ring, [hole]), (other, [])])
    workspace = Workspace(TEN, [np.vstack([other, other[:1]]), several, box(-1, 8, 1, 11)])
    rings = [other, ring, hole, other, box(-1, 8, 1, 11)]
    np.testing.assert_array_equal(workspace.obstacle_vertices, np.vstack(rings))
    np.testing.assert_array_equal(workspace.with_obstacles(remove=[1]).obstacle_vertices, np.vstack(rings[::4]))
    assert Workspace(TEN).obstacle_vertices.shape == (0, 2)


def test_free_space_is_closed():
    x = [[0, 0], [10, 10], [3, 3], [5, 3], [3, 4], [5, 5], [3 + 1e-10, 4], [3 + 1e-6, 4], [10.001, 5], [np.inf, 1]]
    expected = [True, True, True, True, True, False, True, False, False, False]
    np.testing.assert_array_equal(BLOCK.is_free(np.array(x)), expected)
    np.testing.assert_allclose(BLOCK.clearance([[3, 4], [0, 5], [np.nan, 0]]), [0, 0, np.nan], atol=1e-12)


def test_segments_may_touch_walls_and_corners():
    along_sides = [((0, 3), (10, 3)), ((3, 0), (3, 10)), ((0, 0), (10, 0)), ((3, 4), (3, 4))]
    grazing_a_corner = [((2, 4), (4, 2))]
    through = [((2, 4.01), (4.01, 2)), ((2, 4), (4.5, 2)), ((3, 3), (7, 6)), ((3, 4), (7, 4)), ((5, 4), (5, 4))]
    leaving_the_bounds = [((1, 1), (11, 1)), ((1, 1), (np.nan, 1))]
    check_visible(BLOCK, along_sides + grazing_a_corner, through + leaving_the_bounds)


@pytest.mark.parametrize("squeeze", [False, True])
def test_point_contact_is_passed_only_by_squeezing(squeeze):
    workspace = Workspace(TEN, DIAGONAL, squeeze=squeeze)
    seen = [((4, 6), (5, 5)), ((6, 4), (5, 5)), ((4, 5), (5, 5)), ((5, 3), (5, 5)), ((3, 5), (5, 7))]
    # Between the blocks, along the walls of both of them, and along the bound under the tip.
    through = [((4, 6), (6, 4)), ((4, 5), (6, 5)), ((5, 3), (5, 6)), ((1, 0), (3, 0))]
    hidden = [((4, 6), (6.1, 4))]
    check_visible(workspace, *((seen + through, hidden) if squeeze else (seen, through + hidden)))
    assert workspace.is_free(np.array([[5.0, 5.0], [2.0, 0.0]])).all()


@pytest.mark.parametrize(("width", "turn"), [(3e-10, 0), (3e-10, 0.3), (1e-9, 0.3), (1e-8, 0), (1e-6, 0.3)])
def test_walls_thinner_than_the_tolerance_are_not_crossed(width, turn):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    hanging = [box(6, 5, 6 + width, 8), box(5.5, 8, 6.5, 9)]
    bent = np.array([[2, 2], [2.5, 5], [2, 8], [2 + width, 8], [2.5 + width, 5], [2 + width, 2]])
    needle = np.array([[8, 1], [8 + 1e3 * width, 1], [8, 7.5]])
    walls = [wall @ rotation.T for wall in (box(4, 2, 4 + width, 8), *hanging, bent, needle)]
    hidden = [((3, 3), (5, 3)), ((1, 5), (3, 5)), ((1, 4), (3, 4)), ((5.5, 6), (6.5, 6.5)), ((7, 4), (9, 4))]
    # Past the end of a wall, along it, and from the wall itself.
    seen = [((3, 2), (5, 2)), ((4, 1), (4, 9)), ((3.999, 3), (3.999, 7))]
    seen += [((4 + width, 3), (5, 3)), ((2.5 + width, 5), (3, 2))]
    check_visible(Workspace(((-5, -5), (15, 15)), walls), seen, hidden, rotation)


def test_touching_a_contact_from_one_side_is_free():
    # The tip (5, 5) of a wedge touches a block's side; both are seen along the other side of the block.
    workspace = Workspace(TEN, [box(5, 4, 6, 8), np.array([[5.0, 5], [2, 6], [2, 5.5]])])
    check_visible(workspace, [((5, 3), (5, 5)), ((5, 3), (5, 4))], [((5, 3), (5, 6))])
    # Over the touching tips of two wedges, along the upper side of one of them or of both.
    for left, right in ((5, 5), (4.9, 5), (5, 4.9)):
        wedges = [np.array([[5.0, 5], [2, left], [2, 3]]), np.array([[5.0, 5], [8, 3], [8, right]])]
        check_visible(Workspace(TEN, wedges), [((3, 5), (7, 5))], [((5, 6), (5, 3))])


def test_obstacles_may_overlap_touch_and_leave_the_bounds():
    workspace = Workspace(TEN, [box(-5, 4, 6, 5), box(4, 3, 8, 6), box(8, 3, 12, 6)])
    assert workspace.free_space.area == pytest.approx(100 - (4 * 1 + 4 * 3 + 2 * 3))
    assert len(workspace.free_space.geoms) == 2
    assert workspace.bounds == Box((0, 0), (10, 10))
    assert len(workspace.obstacles) == 3
    # The shared side of two obstacles is not a passage, and collinear vertices are gone.
    np.testing.assert_array_equal(workspace.is_free(np.array([[8.0, 4.0], [8.0, 3.0]])), [False, True])
    assert len(workspace.boundary.vertices) == 4 + 2 + 2 + 4


def test_from_polygons_intersects_components_with_bounds():
    ring, far = shapely.Polygon(box(0, 0, 4, 4), [box(1, 1, 2, 2)]), shapely.box(6, 0, 8, 4)
    holes = box(4.5, 3, 5, 3.5), box(4.75, 3.25, 5.5, 4.5)  # which overlap, and leave the outer ring
    parts = [shapely.MultiPolygon([ring, far]), {"outer": box(4, 3, 6, 4), "holes": holes}]
    cut = shapely.box(4, 3, 6, 4) - shapely.union_all([shapely.Polygon(hole) for hole in holes])
    whole = shapely.union_all([ring, far, cut])
    assert Workspace.from_polygons(parts).bounds == Box((0, 0), (8, 4))
    for bounds in (Box((-1, -1), (9, 9)), Box((1.5, 1.5), (7, 5)), Box((4, 0), (6, 4))):
        workspace = Workspace.from_polygons(parts, bounds)
        region = shapely.box(*bounds.lo, *bounds.hi)
        assert workspace.bounds == bounds
        assert shapely.symmetric_difference(workspace.free_space, region & whole).area == 0
        assert shapely.union_all(workspace.obstacles).equals(region - whole)


def test_from_polygons_reads_collections_and_drops_altitudes():
    room = shapely.Polygon([(0, 0, 5), (4, 0, 5), (4, 3, 5), (0, 3, 5)], [[(1, 1, 5), (2, 1, 5), (2, 2, 5)]])
    rooms = shapely.GeometryCollection([room, shapely.box(4, 1, 6, 2)])
    nested = shapely.GeometryCollection([rooms])
    for components in (shapely.MultiPolygon(list(rooms.geoms)), rooms, [rooms], nested, [nested, shapely.Polygon()]):
        workspace = Workspace.from_polygons(components)
        assert workspace.free_space.area == 12 - 0.5 + 2 and not workspace.free_space.has_z
        assert workspace.bounds == Box((0, 0), (6, 3))
    assert Workspace.from_polygons(room).free_space.area == 11.5


def test_components_apart_by_rounding_are_joined():
    """The components touch at vertices, or along a part of a side."""
    for y0, y1 in ((0, 1), (-1, 2)):
        right = shapely.box(1 + 1e-13, y0, 2, y1)
        workspace = Workspace.from_polygons([shapely.box(0, 0, 1, 1), right])
        assert workspace.is_visible([(0.5, 0.5)], [(1.5, 0.5)])[0]
        assert isinstance(workspace.free_space, shapely.Polygon)


def test_gap_closed_by_rounding_is_no_obstacle():
    """A gap between components that is too thin to be stored as an obstacle."""
    parts = [shapely.box(0, 0, 1, 1), shapely.box(1 + 1e-13, -1, 2, 2)]
    parts += [shapely.box(0, y, 1.5, y + 1) for y in (-1, 1)]
    workspace = Workspace.from_polygons([*parts, shapely.box(3, -1, 4, 2)])
    (obstacle,) = workspace.obstacles
    assert obstacle.equals(shapely.box(2, -1, 3, 2))
    assert Workspace(workspace.bounds, workspace.obstacles).free_space.equals(workspace.free_space)


@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_inflated_free_space_is_bounded_by_clearance(seed, outside):
    radius, workspace = 0.05 + 0.2 * (seed % 6), general_workspace(np.random.default_rng(seed))
    inflated = workspace.inflate(radius, outside)
    assert inflated.bounds == Box((radius, radius), 10 - np.array([radius, radius]))
    y = workspace.sample_free(300, seed)
    clearance, free = workspace.clearance(y), inflated.is_free(y)
    least, most = (1, 1.09) if outside else (math.cos(math.pi / 32), 1)
    assert free[clearance >= most * radius + 1e-9].all()
    assert not free[clearance < least * radius - 1e-9].any()


def test_inflate_keeps_squeeze():
    assert Workspace(TEN, DIAGONAL, squeeze=True).inflate(0.1).squeeze
    assert BLOCK.inflate(0.0) is BLOCK


@pytest.mark.parametrize("seed", SEEDS)
def test_queries_equal_shapely_on_plain_difference(seed):
    workspace = general_workspace(np.random.default_rng(seed))
    free = shapely.box(0, 0, 10, 10) - shapely.union_all([shapely.Polygon(o) for o in workspace.obstacles])
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-0.5, 10.5, (2, 100, 2))
    np.testing.assert_array_equal(workspace.is_free(a), shapely.intersects_xy(free, a[:, 0], a[:, 1]))
    segments = shapely.linestrings(np.stack([a, b], axis=1))
    np.testing.assert_array_equal(workspace.is_visible(a, b), shapely.covers(free, segments))
    distance = shapely.distance(shapely.points(a), free.boundary)
    np.testing.assert_allclose(workspace.clearance(a), np.where(workspace.is_free(a), distance, -distance), atol=1e-9)


def test_samples_are_free_uniform_and_reproducible():
    x = BLOCK.sample_free(40_000, seed=3)
    assert BLOCK.is_free(x).all()
    np.testing.assert_array_equal(x, BLOCK.sample_free(40_000, seed=3))
    assert not np.array_equal(x, BLOCK.sample_free(40_000, seed=4))
    # Each third of the width holds its share of free area (within five standard deviations).
    share = [(x[:, 0] < 3).mean(), ((x[:, 0] >= 3) & (x[:, 0] <= 7)).mean()]
    np.testing.assert_allclose(share, [30 / 88, 28 / 88], atol=5 * 0.5 / math.sqrt(40_000))
    assert BLOCK.sample_free(0, 0).shape == (0, 2)


def test_thin_free_space_is_sampled():
    thin = Workspace(TEN, [box(0, 0, 10, 10 - 1e-7)])
    x = thin.sample_free(1000, seed=0)
    assert thin.is_free(x).all() and x[:, 1].min() >= 10 - 1.1e-7 and np.ptp(x[:, 0]) > 9.9


def test_visibility_tolerance_ignores_shallow_crossings():
    workspace = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.6, 0), (0.6, 0.5), (0.4, 0.5)]])
    a, b = np.array([[0.1, 0.5 - 1e-6]]), np.array([[0.9, 0.5 - 1e-6]])
    for tolerance, visible in ((None, False), (0, False), (5e-7, False), (2e-6, True)):
        assert workspace.is_visible(a, b, tolerance).tolist() == [visible]


def test_queries_from_threads_equal_serial_queries():
    workspace = Workspace(TEN, [box(x, y, x + 0.5, y + 0.5) for x in range(4) for y in range(4)])
    a, b = workspace.sample_free(300, 0), workspace.sample_free(300, 1)
    with ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(lambda _: (workspace.is_visible(a, b), workspace.clearance(a)), range(12)))
    for visible, clearance in answers:
        np.testing.assert_array_equal(visible, workspace.is_visible(a, b))
        np.testing.assert_array_equal(clearance, workspace.clearance(a))
