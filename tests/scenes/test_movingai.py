import numpy as np
import pytest
import shapely

from plr_jax import scenes

MAPS = ["dao/den009d", "dao/den101d", "dao/den312d", "dao/den520d", "da2/ht_store"]


def read(path, *rows, **options):
    path.write_text(f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap\n" + "\n".join(rows) + "\n")
    return scenes.read_map(path, **options)


def test_letters_become_unit_squares(tmp_path):
    workspace = read(tmp_path / "small.map", "@....", "T.@..", "OWSG@")
    passable = {(1, 0), (2, 0), (3, 0), (4, 0), (1, 1), (3, 1), (4, 1), (2, 2), (3, 2)}
    cells = [(x, y) for x in range(1, 5) for y in range(3)]
    # The cell (2, 2) touches (1, 1) in a corner only, and (3, 2) along a side.
    np.testing.assert_array_equal(workspace.is_free(np.array(cells) + 0.5), [cell in passable for cell in cells])
    assert workspace.free_space.area == len(passable)
    np.testing.assert_array_equal([workspace.bounds.lo, workspace.bounds.hi], [(1, 0), (5, 3)])


def test_boundary_of_blocked_cell_is_free(tmp_path):
    ring = read(tmp_path / "ring.map", "...", ".@.", "...")
    assert ring.is_free(np.array([(1.0, 1.0), (1.5, 1.0), (2.0, 1.7)])).all()
    assert not ring.is_free(np.array([(1.5, 1.5)])).any()


def test_straight_walls_have_only_corner_points(tmp_path):
    hole = read(tmp_path / "hole.map", *["." * 9] * 4, *["...@@@..."] * 3, *["." * 9] * 4)
    assert shapely.get_num_coordinates(hole.free_space) == 2 * (4 + 1)


def test_squeeze_is_passed_on(tmp_path):
    for squeeze in (True, False):
        assert read(tmp_path / "touch.map", ".@", "@.", squeeze=squeeze).squeeze == squeeze


BROKEN = [
    ("", "expected a Moving AI map"),
    ("type octile\nheight 2\nwidth x\nmap\n..\n..\n", "expected a Moving AI map"),
    ("type octile\nheight 0\nwidth 2\nmap\n", "expected a Moving AI map"),
    ("type octile\nheight 3\nwidth 2\nmap\n..\n..\n", "expected 3 rows, as the header says, got 2"),
    ("type octile\nheight 2\nwidth 2\nmap\n..\n...\n", "line 6: expected 2 cells, got 3"),
    ("type octile\nheight 1\nwidth 2\nmap\n@T\n", "at least one passable cell"),
]


def test_broken_file_raises(tmp_path):
    path = tmp_path / "broken.map"
    for text, message in BROKEN:
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"broken\.map.*{message}"):
            scenes.read_map(path)


@pytest.mark.parametrize("name", [*(f"movingai/{name}" for name in MAPS), "polyanya_arena/arena"])
def test_published_map_equals_its_published_polygons(name, data_dir):
    from_cells = scenes.read_map(data_dir / f"{name}.map")
    from_polygons = scenes.read_polygons(data_dir / f"{name}_polygons.json")
    assert shapely.symmetric_difference(from_cells.free_space, from_polygons.free_space).area == 0.0
    assert from_cells.bounds == from_polygons.bounds
    text = (data_dir / f"{name}.map").read_text()
    assert from_cells.free_space.area == text.split("map\n", 1)[1].count(".")
