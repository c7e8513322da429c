"""Workspaces from polygons in GeoJSON, in well-known text (WKT) and in other JSON, and from files of any format."""

import json

import numpy as np
import pytest
import shapely

from plr_jax import Workspace, scenes

BOX, TABLE, SHELF = shapely.box(0, 0, 10, 8), shapely.box(2, 2, 4, 5), shapely.box(6, 1, 7, 3)


def written(folder, document, name="a.geojson"):
    text = document if isinstance(document, str) else json.dumps(document)
    (folder / name).write_text(text)
    return folder / name


def feature(geometry):
    coordinates = geometry and json.loads(shapely.to_geojson(geometry))
    return {"type": "Feature", "properties": {"name": "x"}, "geometry": coordinates}


def collection(*geometries, **more):
    return {"type": "FeatureCollection", "features": [feature(each) for each in geometries], **more}


def polygon(*rings):
    return {"type": "Polygon", "coordinates": list(rings)}


def test_bounds_are_given_or_bbox_or_extent(tmp_path):
    path = written(tmp_path, collection(TABLE, None, SHELF))
    given = scenes.read_geojson(path, bounds=((0, 0), (10, 8)))
    assert given.free_space.equals(Workspace(((0, 0), (10, 8)), [TABLE, SHELF]).free_space)
    np.testing.assert_array_equal(scenes.read_geojson(path).bounds.lo, [2, 1])
    for bbox in ([0, 0, 10, 8], [0, 0, -5, 10, 8, 5]):
        bounds = scenes.read_workspace(written(tmp_path, collection(TABLE, bbox=bbox))).bounds
        np.testing.assert_array_equal([bounds.lo, bounds.hi], [(0, 0), (10, 8)])


def test_polygons_may_be_free_space(tmp_path):
    path = written(tmp_path, collection(BOX - TABLE, shapely.box(10, 3, 12, 4)), "a.json")
    workspace = scenes.read_workspace(path, polygons="free")
    assert workspace.free_space.equals((BOX - TABLE) | shapely.box(10, 3, 12, 4))
    np.testing.assert_array_equal(workspace.bounds.hi, [12, 8])


def test_every_geometry_is_read(tmp_path):
    pair = shapely.MultiPolygon([TABLE, SHELF])
    for geometry in (pair, shapely.GeometryCollection([shapely.box(8, 5, 9, 7), pair]), BOX - TABLE):
        for document in (json.loads(shapely.to_geojson(geometry)), feature(geometry)):
            workspace = scenes.read_geojson(written(tmp_path, document), bounds=((-1, -1), (11, 9)))
            blocked = shapely.box(-1, -1, 11, 9) - workspace.free_space
            assert shapely.symmetric_difference(blocked, shapely.union_all(geometry)).area == 0


TRIANGLE = [[0, 0], [3, 0], [3, 3], [0, 0]]  # of area 4.5
EMPTY = [
    polygon([]),
    {"type": "MultiPolygon", "coordinates": [[], [[]]]},
    {"type": "GeometryCollection", "geometries": [polygon()]},
    {"type": "Point", "coordinates": []},
]
FEATURES = {"type": "FeatureCollection"}


def test_empty_geometry_is_skipped(tmp_path):
    for empty in EMPTY:
        inside = {"type": "GeometryCollection", "geometries": [empty, polygon(TRIANGLE)]}
        located = {"type": "Feature", "geometry": inside}
        for document in (inside, located, FEATURES | {"features": [feature(None), located]}):
            assert scenes.read_geojson(written(tmp_path, document), polygons="free").free_space.area == 4.5


def test_file_without_polygons_raises(tmp_path):
    for empty in [*EMPTY, FEATURES | {"features": []}, FEATURES | {"features": [feature(None)]}]:
        with pytest.raises(ValueError, match=r"a\.geojson: expected at least one polygon, got none"):
            scenes.read_geojson(written(tmp_path, empty))


def test_empty_holes_and_altitudes_are_dropped(tmp_path):
    hole = [[2, 0.5], [2.5, 0.5], [2.5, 1], [2, 1], [2, 0.5]]  # of area 0.25
    rings = [[[*corner, 7] for corner in TRIANGLE], [], hole, []]  # whose altitudes are dropped
    for document in (polygon(*rings), {"type": "MultiPolygon", "coordinates": [[], rings]}):
        assert scenes.read_geojson(written(tmp_path, document), polygons="free").free_space.area == 4.25


def test_coordinates_in_degrees_warn(tmp_path):
    town = shapely.box(13.37, 52.51, 13.38, 52.52)
    with pytest.warns(UserWarning, match=r"a\.geojson: coordinates look like degrees of longitude and latitude"):
        scenes.read_geojson(written(tmp_path, collection(town)), polygons="free")
    # Other coordinates do not warn; a warning is an error.
    for lo, width in (((0, 0), 1), ((3e5, 5e6), 10), ((13.37, 52.51), 1), ((0.37, 0.51), 0.1), ((150, 100), 0.1)):
        plane = shapely.box(*lo, *np.add(lo, width))
        scenes.read_geojson(written(tmp_path, collection(plane)), polygons="free")


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0]]


def test_broken_geojson_raises(tmp_path):
    other = "expected polygons in GeoJSON, got something else"
    for document, message in [
        ("[" * 10**5, "expected JSON"),
        ([1], "expected GeoJSON"),
        ({"type": "Topology"}, "expected GeoJSON"),
        (collection(TABLE, shapely.Point(1, 2)), "polygon 1 must be a polygon, got a Point"),
        (FEATURES | {"features": [3]}, other),
        (FEATURES, f"{other} .*features"),
        ({"type": "Feature", "id": 1}, f"{other} .*geometry"),
        ({"type": "Feature", "geometry": []}, other),
        ({"type": "Feature", "geometry": {"type": "Polygon"}}, f"{other} .*coordinates"),
        ({"type": "Polygon", "coordinates": 3}, f"{other} .*must be array"),
        (polygon(["12", "34", "57"]), f"{other} .*must be array"),
        (polygon([[True, False], [2, 0], [2, 1], [True, False]]), f"{other} .*must be number"),
        (polygon(SQUARE[:2]), f"{other} .*closed"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [NaN, 1], [1, 1], [0, 0]]]}', other),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [1e999, 1], [1, 1], [0, 0]]]}', other),
        (polygon([[0, 0], [2, 2], [2, 0], [0, 2], [0, 0]]), "polygon 0 is not a simple polygon"),
        (collection(TABLE, bbox=[1, 2]), '"bbox" must be 4 numbers'),
        (collection(TABLE, bbox=["0", 0, 1, 1]), '"bbox" must be 4 numbers'),
        (collection(TABLE), "no free space: .* bounding box .*: give larger bounds .* a \"bbox\".* polygons='free'"),
        (collection(TABLE, bbox=[2, 2, 4, 5]), "no free space: the obstacles cover its bounds.$"),
    ]:
        with pytest.raises(ValueError, match=rf"(?s)^\S*a\.geojson: .*{message}"):
            scenes.read_geojson(written(tmp_path, document))


def test_unknown_kind_of_polygons_raises(tmp_path, unchecked_types):
    with pytest.raises(ValueError, match="polygons must be 'obstacles' or 'free', got 'walls'"):
        scenes.read_geojson(written(tmp_path, collection(TABLE)), polygons="walls")


# --- well-known text -----------------------------------------------------------------------------------

# A room of 10 x 8 with a table of 2 x 3 in it, and a hallway of 2 x 1 beside it: 80 - 6 + 2.
ROOM = "((0 0, 10 0, 10 8, 0 8, 0 0), (2 2, 4 2, 4 5, 2 5, 2 2))"
HALLWAY = "((10 3, 12 3, 12 4, 10 4, 10 3))"


def test_polygons_in_wkt_are_free_space(tmp_path):
    for text, area in [
        (f"polygon{ROOM}\n\n", 74),
        (f"MULTIPOLYGON (EMPTY, {ROOM}, {HALLWAY})", 76),
        (f"MULTIPOLYGON ({ROOM}, ((5 5, 7 5, 7 7, 5 7, 5 5)))", 74),  # which overlap
        (f"GEOMETRYCOLLECTION (POLYGON {ROOM}, GEOMETRYCOLLECTION (MULTIPOLYGON ({HALLWAY})))", 76),
        ("POLYGON Z ((0 0 5, 3 0 5, 3 3 6, 0 0 5))", 4.5),
        ("POLYGON ZM ((0 0 5 1, 3 0 5 2, 3 3 6 3, 0 0 5 1))", 4.5),
        ("POLYGON ((0 0, 3 0, 3 3, 0 0), EMPTY)", 4.5),
        # Points that differ in dimension from one another, or from the dimension that WKT declares.
        ("POLYGON ((0 0 5, 3 0, 3 3 -1.5E+2, 0 0))", 4.5),
        ("polygonz((0 0, 3 0 inf,3 3\t1 2 , 0 0 nan))", 4.5),
        ("MULTIPOLYGON (((0 0, 3 0, 3 3, 0 0)), ((6 6 1, 8 6 1, 8 8 1, 6 6 1)))", 6.5),
        ("GEOMETRYCOLLECTION Z (POLYGON M EMPTY, POLYGON ((0 0, 3 0, 3 3, 0 0)), POINT Z EMPTY)", 4.5),
    ]:
        path = written(tmp_path, text, "a.wkt")
        assert scenes.read_workspace(path).free_space.area == pytest.approx(area, abs=1e-12)
        around = scenes.read_wkt(path, polygons="obstacles", bounds=((-5, -5), (15, 15)))
        assert around.free_space.area == pytest.approx(400 - area, abs=1e-12)


def test_published_walkable_area_is_read(data_dir):
    expected = shapely.from_wkt((data_dir / "jupedsim" / "arena.wkt").read_text())
    workspace = scenes.read_workspace(data_dir / "jupedsim" / "arena.wkt")
    assert workspace.free_space.area == pytest.approx(expected.area, rel=1e-9)
    np.testing.assert_allclose([*workspace.bounds.lo, *workspace.bounds.hi], expected.bounds)


HALL = "POLYGON ((0 0, 20 0, 20 10, 0 10, 0 0)"


@pytest.mark.parametrize(
    ("text", "area"),
    [
        (f"{HALL}, (8 10, 8 5, 9 5, 9 10, 8 10))", 195),  # a hole that shares a side with the rim
        (f"{HALL}, (8 10.000000000001, 8 5, 9 5, 9 10, 8 10.000000000001))", 195),
        (f"{HALL}, (2 2, 4 2, 4 4, 2 4, 2 2), (4 2, 6 2, 6 4, 4 4, 4 2))", 192),
        ("MULTIPOLYGON (((0 0, 2 0, 2 2, 0 2, 0 0)), ((2 0, 4 0, 4 2, 2 2, 2 0)))", 8),
        ("POLYGON ((0 0, 10 0, 10 10, 5 10, 7 5, 3 5, 5 10, 0 10, 0 0))", 90),  # a ring that touches itself
        (f"SRID = 32633; {HALL})", 200),
    ],
)
def test_touching_rings_and_extended_wkt_are_read(text, area, tmp_path):
    path = written(tmp_path, text, "a.wkt")
    assert scenes.read_wkt(path).free_space.area == pytest.approx(area)
    blocked = scenes.read_wkt(path, polygons="obstacles", bounds=((-1, -1), (30, 30)))
    assert blocked.free_space.area == pytest.approx(31**2 - area)


def test_broken_wkt_raises(tmp_path):
    for text, message in [
        ("", "expected one geometry in WKT"),
        ("POLYGON EMPTY", "expected at least one polygon, got none"),
        ("POLYGON ((0 0, 1 0, 1 1 2 3 4, 0 0))", "expected one geometry in WKT"),
        (f"POLYGON {ROOM}\nPOLYGON {HALLWAY}", "Put several geometries into a GEOMETRYCOLLECTION"),
        ("CURVEPOLYGON ((0 0, 1 0, 1 1, 0 0))", "expected one geometry in WKT, .*Nonlinear"),
        ("GEOMETRYCOLLECTION (" * 33 + f"POLYGON {HALLWAY}" + ")" * 33, "at most 32 deep"),
        ("GEOMETRYCOLLECTION (" * 10**5 + ")" * 10**5, "at most 32 deep"),
        ("POLYGON ((0 0, 1e999 0, 1 1, 0 0))", "polygon 0 must have finite coordinates"),
        (f"GEOMETRYCOLLECTION (POLYGON {HALLWAY}, POINT (1 1))", "polygon 1 must be a polygon, got a Point"),
    ]:
        with pytest.raises(ValueError, match=rf"(?s)^\S*a\.wkt: .*{message}"):
            scenes.read_wkt(written(tmp_path, text, "a.wkt"))


# --- polygons in JSON -------------------------------------------------------------------------------------

RING = [[0, 0], [4, 0], [4, 4], [0, 4]]
HOLE = [[1, 1], [1, 2], [2, 2], [2, 1]]


def test_polygons_of_every_form_are_free_space(tmp_path):
    walls = {"outer": RING, "holes": [HOLE]}
    forms = [{"components": [walls], "source": "none"}, walls, {"boundary": RING, "holes": [HOLE]}, {"outer": RING}]
    for data in forms:
        (tmp_path / "map.json").write_text(json.dumps(data))
        workspace = scenes.read_polygons(tmp_path / "map.json")
        assert shapely.equals(workspace.free_space, shapely.Polygon(RING, [HOLE][: len(data) - 1]))
        assert scenes.read_polygons(tmp_path / "map.json", squeeze=True).squeeze


def test_broken_polygons_raise(tmp_path):
    for text, message in [
        ("[1, 2", "expected JSON"),
        ("[1, 2]", 'expected {"components"'),
        ('{"holes": []}', 'expected {"components"'),
        ('{"components": 3}', 'expected {"components"'),
        ('{"components": [3]}', "Component 0 must be a mapping with an 'outer' ring"),
        ('{"components": [{"holes": []}]}', "Component 0 must be a mapping with an 'outer' ring"),
        ('{"components": []}', "."),
        ('{"outer": [[0, 0], [4, 0], [4, 4]], "holes": 3}', "Component 0 must be a mapping with an 'outer' ring"),
        ('{"outer": [[0, 0], [4, 0]]}', "."),
        ('{"outer": [[0, 0], [4, 4], [4, 0], [0, 4]]}', "."),
        ('{"outer": [[0, 0], [4, NaN], [4, 0]]}', "."),
        ('{"outer": "ring"}', "."),
    ]:
        path = tmp_path / "broken.json"
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"broken\.json: .*{message}"):
            scenes.read_polygons(path)


def test_published_extremitypathfinder_map(data_dir):
    workspace = scenes.read_polygons(data_dir / "extremitypathfinder/example.json")
    # Shoelace formula by hand: a 10 x 10 square with a dent of 5, less holes of 3.75 and 1.
    assert workspace.free_space.area == pytest.approx(95 - 3.75 - 1)


def test_reader_follows_from_ending_and_content(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "scene.json")
    (tmp_path / "polygons.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    (tmp_path / "grid.MAP").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    (tmp_path / "map.pgm").write_bytes(b"P5 3 2 255 " + b"\xff" * 6)
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.5\norigin: [0, 0, 0]")
    expected = {"scene.json": scenes.maze().workspace.free_space.area, "polygons.json": 4.5, "grid.MAP": 2}
    for name, area in {**expected, "map.pgm": 6, "map.yaml": 1.5}.items():
        assert scenes.read_workspace(tmp_path / name).free_space.area == pytest.approx(area)


def test_shapely_polygons_are_free_space():
    geometry = shapely.MultiPolygon([shapely.box(0, 0, 10, 8) - shapely.box(2, 2, 4, 5), shapely.box(10, 3, 12, 4)])
    assert scenes.read_workspace(geometry).free_space.area == 76
    wider = scenes.read_workspace(geometry, bounds=((-5, -5), (15, 15)))
    assert wider.free_space.area == 76 and wider.bounds.width.tolist() == [20, 20]
    with pytest.raises(ValueError, match=r"options of this kind of file \(bounds, squeeze\), got resolution"):
        scenes.read_workspace(geometry, resolution=1)


def test_unreadable_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"a\.doc: expected a file that ends in one of \.map, \.json"):
        scenes.read_workspace(tmp_path / "a.doc")
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    with pytest.raises(
        ValueError, match=r"a\.map: expected options of this kind of file .row0, squeeze., got resolution"
    ):
        scenes.read_workspace(tmp_path / "a.map", resolution=2)
    for name in ("a.json", "a.yaml"):
        (tmp_path / name).write_text("[" * 10**5)
        with pytest.raises(ValueError, match=rf"{name}: "):
            scenes.read_workspace(tmp_path / name)
