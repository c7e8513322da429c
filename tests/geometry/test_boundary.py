import math

import numpy as np
import pytest
import shapely

from plr_jax.geometry.boundary import as_polygon, as_polygons, triangulate
from plr_jax.geometry.vectors import arc, pseudo_angle, turn_between
from plr_jax.geometry.workspace import Workspace

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
FAR, FARTHER = shapely.box(5, 0, 6, 1), shapely.box(8, 0, 9, 1)


@pytest.mark.parametrize(
    ("ring", "message"),
    [
        (np.array([[1.0, 1], [2, 2], [2, 1], [1, 2]]), "P is not a simple polygon.*Self-intersection"),
        (1e155 * np.array(SQUARE), "P must have coordinates up to 1e\\+100"),
        (np.array([[1.0, 1], [2, 2], [2, 2], [1, 1]]), "P has 2 distinct vertices"),
        (np.array([[1.0, 1], [2, 2], [3, 3]]), "P has zero area"),
        (np.array([[1.0, 1], [np.nan, 2], [2, 1]]), "P must have finite coordinates"),
        ((1, 2), r"P must have shape \(n, 2\), got \(2,\). Put a single ring into a list"),
        (shapely.LineString([[1, 1], [2, 2]]), "P must be a polygon, got a LineString"),
        ("ring", r"P must be numbers"),
        (shapely.Polygon([[1, 1], [2, 2], [2, 1], [1, 2]]), "P is not a simple polygon"),
    ],
)
def test_invalid_rings_are_refused_by_name_and_reason(ring, message):
    with pytest.raises(ValueError, match=message):
        as_polygon("P", ring)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (5, r"Ps must be a list of rings \(n, 2\) or Shapely polygons, got 5"),
        (shapely.Point(1, 1), "P 0 must be a polygon, got a Point"),
        (shapely.GeometryCollection([FAR, shapely.Point(1, 1)]), "P 1 must be a polygon, got a Point"),
        (SQUARE, r"P 0 must have shape \(n, 2\), got \(2,\). Put a single ring into a list"),
    ],
)
def test_what_is_no_collection_of_polygons_is_refused(shapes, message):
    with pytest.raises(ValueError, match=message):
        as_polygons("P", shapes)


@pytest.mark.parametrize(
    ("shapes", "expected"),
    [
        (FAR, [FAR]),
        ([[*SQUARE, SQUARE[0]], shapely.LinearRing(SQUARE)], [shapely.Polygon(SQUARE)] * 2),
        (shapely.MultiPolygon([FAR, FARTHER]), [shapely.MultiPolygon([FAR, FARTHER])]),
        (shapely.GeometryCollection([FAR, shapely.GeometryCollection([FARTHER])]), [FAR, FARTHER]),
        (shapely.GeometryCollection(), []),
        ((shape for shape in (SQUARE, FAR)), [shapely.Polygon(SQUARE), FAR]),
        (
            [shapely.GeometryCollection([FAR, shapely.MultiPolygon([FARTHER])]), np.array(SQUARE)],
            [FAR, shapely.MultiPolygon([FARTHER]), shapely.Polygon(SQUARE)],
        ),
    ],
)
def test_polygons_may_be_given_in_any_of_the_usual_ways(shapes, expected):
    assert all(a.equals(b) for a, b in zip(as_polygons("P", shapes), expected, strict=True))
    assert as_polygon("P", FAR) is FAR


def lattice_region(seed):
    """The free space among unit squares that touch one another."""
    blocked = np.argwhere(np.random.default_rng(seed).random((10, 10)) < 0.3)
    return Workspace(((0, 0), (10, 10)), list(shapely.box(*blocked.T, *blocked.T + 1))).free_space


def assert_filled(region):
    triangles = shapely.polygons(triangulate(region))
    assert shapely.area(triangles).sum() == pytest.approx(region.area)
    assert shapely.covers(region.buffer(1e-9), triangles).all()


@pytest.mark.parametrize("seed", [0, 1, 30254])
def test_triangles_fill_a_region_whose_rings_touch(seed):
    """At the last GEOS was seen to fail: it found no convex corner."""
    assert_filled(lattice_region(seed))


def test_regions_that_geos_cannot_triangulate_are_cut(monkeypatch):
    def of_simple_ones(region, whole=shapely.constrained_delaunay_triangles):
        if shapely.get_num_coordinates(region) > 12:
            raise shapely.errors.GEOSException("Unable to find a convex corner")
        return whole(region)

    monkeypatch.setattr(shapely, "constrained_delaunay_triangles", of_simple_ones)
    assert_filled(lattice_region(0))


def test_pseudo_angle_of_the_axes():
    dx, dy = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1], [0, 0]]).T
    np.testing.assert_array_equal(pseudo_angle(dx, dy), [0, 1, 2, 3, 0])


def test_an_arc_is_inscribed_and_ends_exactly():
    center, start, end = np.array([1.0, 2.0]), np.array([0.5, 0.0]), np.array([0.0, -0.5])
    points = arc(center, start, end, 12)
    assert len(points) == 1 + 12
    np.testing.assert_array_equal(points[[0, -1]], [center + start, center + end])
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 0.5)
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(chord, 2 * 0.5 * math.sin(math.pi / 16))


def test_turns_are_counterclockwise():
    east, north = np.array([2.0, 0.0]), np.array([0.0, 3.0])
    turns = turn_between(np.array([east, north, east, east]), np.array([north, east, -north, east]))
    np.testing.assert_allclose(turns, [math.pi / 2, 3 * math.pi / 2, 3 * math.pi / 2, 0])
