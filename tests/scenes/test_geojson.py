import json
import warnings

import numpy as np
import pytest
import shapely

from plr_jax import Box, Workspace, scenes

BOX, TABLE = shapely.box(0, 0, 10, 8), shapely.box(2, 2, 4, 5)


def written(folder, document, name="a.geojson"):
    text = document if isinstance(document, str) else json.dumps(document)
    (folder / name).write_text(text)
    return folder / name


def feature(geometry):
    return {
        "type": "Feature",
        "properties": {"name": "x"},
        "geometry": geometry and json.loads(shapely.to_geojson(geometry)),
    }


def collection(*geometries, **more):
    return {"type": "FeatureCollection", "features": [feature(each) for each in geometries], **more}


def test_polygons_are_obstacles_within_bounds_or_their_own_bounding_box(tmp_path):
    path = written(tmp_path, collection(TABLE, None, shapely.box(6, 1, 7, 3)))
    given = scenes.read_geojson(path, bounds=((0, 0), (10, 8)))
    assert given.free_space.equals(Workspace(((0, 0), (10, 8)), [TABLE, shapely.box(6, 1, 7, 3)]).free_space)
    np.testing.assert_array_equal(scenes.read_geojson(path).bounds.lo, [2, 1])
    with_box = written(tmp_path, collection(TABLE, bbox=[0, 0, 10, 8]))
    np.testing.assert_array_equal(scenes.read_geojson(with_box).bounds.hi, [10, 8])
    with_box = written(tmp_path, collection(TABLE, bbox=[0, 0, -5, 10, 8, 5]))
    np.testing.assert_array_equal(scenes.read_workspace(with_box).bounds.hi, [10, 8])


def test_polygons_may_be_free_space(tmp_path):
    path = written(tmp_path, collection(BOX - TABLE, shapely.box(10, 3, 12, 4)), "a.json")
    workspace = scenes.read_workspace(path, polygons="free")
    assert workspace.free_space.equals((BOX - TABLE) | shapely.box(10, 3, 12, 4))
    np.testing.assert_array_equal(workspace.bounds.hi, [12, 8])


def test_free_polygons_that_differ_by_rounding_are_joined(tmp_path):
    path = written(tmp_path, collection(shapely.box(0, 0, 1, 1), shapely.box(1 + 1e-13, 0, 2, 1)))
    assert scenes.read_geojson(path, polygons="free").free_space.equals(shapely.box(0, 0, 2, 1))
    wider = scenes.read_geojson(path, polygons="free", bounds=((0.5, 0), (3, 1)))
    assert wider.free_space.equals(shapely.box(0.5, 0, 2, 1)) and wider.bounds == Box((0.5, 0), (3, 1))


@pytest.mark.parametrize(
    "geometry",
    [
        TABLE,
        shapely.MultiPolygon([TABLE, shapely.box(6, 1, 7, 3)]),
        shapely.GeometryCollection([TABLE, shapely.GeometryCollection([shapely.box(6, 1, 7, 3)])]),
        BOX - TABLE,
    ],
)
def test_geometries_stand_alone_too(geometry, tmp_path):
    for document in (json.loads(shapely.to_geojson(geometry)), feature(geometry)):
        workspace = scenes.read_geojson(written(tmp_path, document), bounds=((-1, -1), (11, 9)))
        blocked = shapely.box(-1, -1, 11, 9) - workspace.free_space
        assert shapely.symmetric_difference(blocked, shapely.union_all(geometry)).area == 0


def test_altitudes_are_dropped(tmp_path):
    ring = [[0, 0, 5], [3, 0, 5], [3, 3, 5], [0, 0, 5]]
    path = written(tmp_path, {"type": "Polygon", "coordinates": [ring]})
    assert scenes.read_geojson(path, polygons="free").free_space.area == 4.5


def test_degrees_are_warned_of(tmp_path):
    town = shapely.box(13.37, 52.51, 13.38, 52.52) - shapely.box(13.374, 52.513, 13.376, 52.515)
    with pytest.warns(UserWarning, match=r"a\.geojson: coordinates look like degrees of longitude and latitude"):
        scenes.read_geojson(written(tmp_path, collection(town)), polygons="free")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenes.read_geojson(written(tmp_path, collection(shapely.box(0, 0, 1, 1))), polygons="free")
        scenes.read_geojson(written(tmp_path, collection(shapely.box(3e5, 5e6, 3e5 + 10, 5e6 + 9))), polygons="free")


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0]]


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("", "expected JSON"),
        ("[" * 10**5, "expected JSON"),
        ([1], "expected GeoJSON"),
        ({"type": "Topology"}, "expected GeoJSON"),
        (collection(), "the file has no polygon"),
        (collection(shapely.Point(1, 2)), r"features\[0\]: expected Polygon, .* got 'Point'"),
        (collection(TABLE, shapely.LineString([(0, 0), (1, 1)])), r"features\[1\]: .* got 'LineString'"),
        ({"type": "FeatureCollection", "features": [3]}, r"features\[0\]: expected a GeoJSON object, got 3"),
        ({"type": "FeatureCollection"}, "expected"),
        ({"type": "Polygon", "coordinates": 3}, "polygon: expected a list of rings"),
        ({"type": "Polygon", "coordinates": []}, "polygon: expected a list of rings"),
        ({"type": "Polygon", "coordinates": [SQUARE[:2]]}, "at least 3 finite points"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [1], [1, 1]]]}, "at least 3 finite points"),
        ({"type": "Polygon", "coordinates": [[[0, 0], ["a", 1], [1, 1]]]}, "at least 3 finite points"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [NaN, 1], [1, 1]]]}', "at least 3 finite points"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [1e999, 1], [1, 1]]]}', "at least 3 finite points"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [2, 2], [2, 0], [0, 2]]]}, "polygon is not a simple polygon"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [1, 1], [2, 2]]]}, "zero area"),
        (collection(TABLE, bbox=[1, 2]), '"bbox" to be 4 or 6 numbers'),
        (collection(TABLE, bbox=["a", 0, 1, 1]), "must be numbers"),
        (collection(TABLE), "no free space"),
    ],
    ids=range(21),
)
def test_what_is_no_map_is_refused_by_name(document, message, tmp_path):
    with pytest.raises(ValueError, match=rf"(?s)^\S*a\.geojson: .*{message}"):
        scenes.read_geojson(written(tmp_path, document))


def test_polygons_are_one_of_two(tmp_path, unchecked_types):
    with pytest.raises(ValueError, match="polygons must be 'obstacles' or 'free', got 'walls'"):
        scenes.read_geojson(written(tmp_path, collection(TABLE)), polygons="walls")
