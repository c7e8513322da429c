import numpy as np
import pytest
import shapely

from plr_jax.geometry.boundary import as_polygons, triangulate
from plr_jax.geometry.workspace import Workspace

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
BOW_TIE = [[1.0, 1], [2, 2], [2, 1], [1, 2]]
FAR, FARTHER = shapely.box(5, 0, 6, 1), shapely.box(8, 0, 9, 1)


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
    """Check the triangles of the free space among unit squares that touch one another."""
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
