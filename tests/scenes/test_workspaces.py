"""One door for all maps."""

import json

import pytest

from plr_jax import scenes


def test_files_are_known_by_their_ending_and_what_is_in_them(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "scene.json")
    (tmp_path / "polygons.json").write_text(json.dumps({"outer": [[0, 0], [3, 0], [0, 3]]}))
    (tmp_path / "grid.MAP").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    (tmp_path / "map.pgm").write_bytes(b"P5 3 2 255 " + b"\xff" * 6)
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.5\norigin: [0, 0, 0]")
    expected = {"scene.json": scenes.maze().workspace.free_space.area, "polygons.json": 4.5, "grid.MAP": 2}
    for name, area in {**expected, "map.yaml": 1.5}.items():
        assert scenes.read_workspace(tmp_path / name).free_space.area == pytest.approx(area)


@pytest.mark.parametrize("text", ["image: a.pgm\norigin: [0, 0, 0]", "resolution: 0.05", "negate: 0", "mode: raw"])
def test_a_map_server_file_that_lacks_a_key_is_told_so(text, tmp_path):
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"map\.yaml: expected the keys image, resolution, origin; missing "):
        scenes.read_workspace(tmp_path / "map.yaml")


def test_what_cannot_be_read_is_said_by_name(tmp_path):
    with pytest.raises(ValueError, match=r"a\.doc: expected a file that ends in one of \.map, \.json"):
        scenes.read_workspace(tmp_path / "a.doc")
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    with pytest.raises(ValueError, match=r"a\.map: expected options of this kind of file .squeeze., got resolution"):
        scenes.read_workspace(tmp_path / "a.map", resolution=2)
    for name in ("a.json", "a.yaml"):
        (tmp_path / name).write_text("[" * 10**5)
        with pytest.raises(ValueError, match=rf"{name}: "):
            scenes.read_workspace(tmp_path / name)
