"""Workspaces read from files whose format follows from their ending and content."""

import json

import pytest
import shapely

from plr_jax import scenes


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
    with pytest.raises(ValueError, match=r"a\.map: expected options of this kind of file .squeeze., got resolution"):
        scenes.read_workspace(tmp_path / "a.map", resolution=2)
    for name in ("a.json", "a.yaml"):
        (tmp_path / name).write_text("[" * 10**5)
        with pytest.raises(ValueError, match=rf"{name}: "):
            scenes.read_workspace(tmp_path / name)
