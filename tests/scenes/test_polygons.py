import json

import pytest
import shapely

from plr_jax import scenes

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]
HOLE = [[1, 1], [1, 2], [2, 2], [2, 1]]


def test_polygons_of_every_form_are_free_space(tmp_path):
    for data in [
        {"components": [{"outer": SQUARE, "holes": [HOLE]}], "source": "ignored"},
        {"outer": SQUARE, "holes": [HOLE]},
        {"boundary": SQUARE, "holes": [HOLE]},
        {"outer": SQUARE},
    ]:
        (tmp_path / "map.json").write_text(json.dumps(data))
        workspace = scenes.read_polygons(tmp_path / "map.json")
        assert shapely.equals(workspace.free_space, shapely.Polygon(SQUARE, [HOLE][: len(data) - 1]))
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
