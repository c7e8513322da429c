import numpy as np
import pytest
import shapely

from plr_jax.geometry.boundary import as_polygon, as_polygons, triangulate
from plr_jax.geometry.workspace import Workspace

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
BOW_TIE = [[1.0, 1], [2, 2], [2, 1], [1, 2]]
FAR, FARTHER = shapely.box(5, 0, 6, 1), shapely.box(8, 0, 9, 1)


@pytest.mark.parametrize(
    ("read", "shape", "message"),
    [
        (as_polygon, np.array(BOW_TIE), "P is not a simple polygon.*Self-intersection"),
        (as_polygon, shapely.Polygon(BOW_TIE), "P is not a simple polygon"),
        (as_polygon, 1e155 * np.array(SQUARE), "P must have coordinates up to 1e\\+100"),
        (as_polygon, np.array([[1.0, 1], [2, 2], [2, 2], [1, 1]]), "P has 2 distinct vertices"),
        (as_polygon, np.array([[1.0, 1], [2, 2], [3, 3]]), "P has zero area"),
        (as_polygon, np.array([[1.0, 1], [np.nan, 2], [2, 1]]), "P must have finite coordinates"),
        (as_polygon, shapely.LineString([[1, 1], [2, 2]]), "P must be a polygon, got a LineString"),
        (as_polygon, "ring", r"P must be numbers"),
        (as_polygons, 5, r"Ps must be a list of rings \(n, 2\) or Shapely polygons, got 5"),
        (as_polygons, shapely.GeometryCollection([FAR, shapely.Point(1, 1)]), "P 1 must be a polygon, got a Point"),
        (as_polygons, SQUARE, r"P 0 must have shape \(n, 2\), got \(2,\). Put a single ring into a list"),
    ],
)
def test_invalid_polygons_raise(read, shape, message):
    with pytest.raises(ValueError, match=message):
        read("P", shape)


@pytest.mark.parametrize(
    ("shapes", "expected"),
    [
        (FAR, [FAR]),
        ([[*SQUARE, SQUARE[0]], shapely.LinearRing(SQUARE)], [shapely.Polygon(SQUARE)] * 2),
        (shapely.MultiPolygon([FAR, FARTHER]), [shapely.MultiPolygon([FAR, FARTHER])]),
        (shapely.GeometryCollection([FAR, shapely.GeometryCollection([FARTHER])]), [FAR, FARTHER]),
        (shapely.GeometryCollection(), []),
        ((shape for shape in (np.array(SQUARE), FAR)), [shapely.Polygon(SQUARE), FAR]),
    ],
)
def test_rings_and_shapely_geometries_are_read(shapes, expected):
    assert all(a.equals(b) for a, b in zip(as_polygons("P", shapes), expected, strict=True))


def check_triangles_fill_lattice(seed):
    """Free space among unit squares that touch one another."""
    blocked = np.argwhere(np.random.default_rng(seed).random((10, 10)) < 0.3)
    region = Workspace(((0, 0), (10, 10)), list(shapely.box(*blocked.T, *blocked.T + 1))).free_space
    triangles = shapely.polygons(triangulate(region))
    assert shapely.area(triangles).sum() == pytest.approx(region.area)
    assert shapely.covers(region.buffer(1e-9), triangles).all()


@pytest.mark.parametrize("seed", [0, 30254])
def test_triangles_fill_a_region_whose_rings_touch(seed):
    """GEOS was seen to fail at the second region: it found no convex corner."""
    check_triangles_fill_lattice(seed)


def test_region_that_geos_cannot_triangulate_is_cut(monkeypatch):
    def of_simple_ones(region, whole=shapely.constrained_delaunay_triangles):
        if shapely.get_num_coordinates(region) > 12:
            raise shapely.errors.GEOSException("Unable to find a convex corner")
        return whole(region)

    monkeypatch.setattr(shapely, "constrained_delaunay_triangles", of_simple_ones)
    check_triangles_fill_lattice(0)
