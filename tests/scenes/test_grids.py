import numpy as np
import pytest
import shapely

import plr_jax
from plr_jax import scenes

MAPS = ["dao/den009d", "dao/den101d", "dao/den312d", "dao/den520d", "da2/ht_store"]


def read_grid(path, *rows, **options):
    path.write_text(f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap\n" + "\n".join(rows) + "\n")
    return scenes.read_map(path, **options)


def test_letters_become_unit_squares(tmp_path):
    workspace = read_grid(tmp_path / "small.map", "@....", "T.@..", "OWSG@")
    passable = {(1, 0), (2, 0), (3, 0), (4, 0), (1, 1), (3, 1), (4, 1), (2, 2), (3, 2)}
    cells = [(x, y) for x in range(1, 5) for y in range(3)]
    # The cell (2, 2) touches (1, 1) in a corner only, and (3, 2) along a side.
    np.testing.assert_array_equal(workspace.is_free(np.array(cells) + 0.5), [cell in passable for cell in cells])
    assert workspace.free_space.area == len(passable)
    np.testing.assert_array_equal([workspace.bounds.lo, workspace.bounds.hi], [(1, 0), (5, 3)])


def test_boundary_of_blocked_cell_is_free(tmp_path):
    ring = read_grid(tmp_path / "ring.map", "...", ".@.", "...")
    assert ring.is_free(np.array([(1.0, 1.0), (1.5, 1.0), (2.0, 1.7)])).all()
    assert not ring.is_free(np.array([(1.5, 1.5)])).any()


def test_straight_walls_have_only_corner_points(tmp_path):
    hole = read_grid(tmp_path / "hole.map", *["." * 9] * 4, *["...@@@..."] * 3, *["." * 9] * 4)
    assert shapely.get_num_coordinates(hole.free_space) == 2 * (4 + 1)


def test_squeeze_is_passed_on(tmp_path):
    for squeeze in (True, False):
        assert read_grid(tmp_path / "touch.map", ".@", "@.", squeeze=squeeze).squeeze == squeeze


def test_first_row_is_at_the_bottom_or_at_the_top(tmp_path):
    rows = ["@....", "T.@..", "OWSG@"]
    bottom, top = (read_grid(tmp_path / "small.map", *rows, row0=row0) for row0 in ("bottom", "top"))
    cells = np.argwhere(scenes.read_cells(tmp_path / "small.map"))[:, ::-1]  # as points (x, y) of a .scen file
    assert bottom.is_free(cells + 0.5).all()
    assert top.is_free(np.stack([cells[:, 0] + 0.5, len(rows) - 0.5 - cells[:, 1]], axis=1)).all()
    assert top.free_space.area == bottom.free_space.area == len(cells)
    mirrored = shapely.transform(bottom.free_space, lambda points: [0, len(rows)] + points * [1, -1])
    assert shapely.symmetric_difference(top.free_space, mirrored).area == 0
    again = scenes.read_workspace(tmp_path / "small.map", row0="top")
    assert again.free_space.equals(top.free_space) and again.bounds == top.bounds
    with pytest.raises(
        ValueError, match=r"small\.map: row0 must be 'bottom' or 'top', got 'Top'. Did you mean 'top'"
    ):
        scenes.read_map(tmp_path / "small.map", row0="Top")


@pytest.mark.full
def test_scenarios_agree_with_both_orders_of_rows(data_dir):
    """Distances of a published problem's ends do not depend on which way y goes."""
    path = data_dir / "movingai/dao/den312d.map"
    scen = np.loadtxt(f"{path}.scen", skiprows=1, usecols=range(4, 9))[::200]
    height = len(scenes.read_cells(path))
    up, down = scenes.read_map(path, row0="top"), scenes.read_map(path)
    for x0, y0, x1, y1, octile in scen:
        lengths = [
            plr_jax.VisibilityGraph(down, (x1 + 0.5, y1 + 0.5))(np.array([(x0 + 0.5, y0 + 0.5)]))[0],
            plr_jax.VisibilityGraph(up, (x1 + 0.5, height - 0.5 - y1))(np.array([(x0 + 0.5, height - 0.5 - y0)]))[0],
        ]
        assert lengths[0] == pytest.approx(lengths[1]) and lengths[0] <= octile + 1e-6


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


def read_list(path, text):
    path.write_text(text)
    return scenes.read_volume(path)


def test_arrays_of_booleans_or_integers_are_read(tmp_path):
    for shape, kind in [((7,), bool), ((3, 4), np.uint8), ((2, 3, 4), ">i2"), ((2, 3, 2, 2), int)]:
        free = np.random.default_rng(0).random(shape) < 0.7
        for array in (free.astype(kind), np.asfortranarray(free.astype(kind))):
            np.save(tmp_path / "volume.npy", array)
            volume = scenes.read_volume(str(tmp_path / "volume.npy"))
            np.testing.assert_array_equal(volume, free)
            assert volume.dtype == bool and volume.flags["C_CONTIGUOUS"] and volume.flags["OWNDATA"]


def test_lists_name_blocked_voxels(tmp_path):
    path = tmp_path / "Small.3DMAP"
    free = read_list(path, "voxel 4 3 2\r\n0 2 1\r\n3 0 0\r\n\r\n3 0 0\r\n")
    assert free.shape == (4, 3, 2)
    assert np.argwhere(~free).tolist() == [[0, 2, 1], [3, 0, 0]]
    assert read_list(path, "voxel 4 3 2").all() and read_list(path, "voxel 1 1 1\n").all()


def test_broken_list_raises(tmp_path):
    for text, message in [
        ("", r"with first line 'voxel nx ny nz', got ''"),
        ("voxel 2 2 2 2\n", "expected a list of voxels"),
        ("voxel 2 -2 2\n", "expected a list of voxels"),
        ("voxel 2 2.0 2\n", "expected a list of voxels"),
        ("voxel 0 2 2\n", "expected one to 16,777,216 voxels in a file of this size, got 0 x 2 x 2"),
        ("voxel 500 500 500\n0 0 0\n", "one to 16,777,216 voxels in a file of this size, got 500 x 500 x 500"),
        ("voxel 2 2 2\n0 0\n", "expected a blocked voxel 'x y z' in each line, got '0 0'"),
        ("voxel 2 2 2\n0 0 0\n0 1\n", "expected a blocked voxel 'x y z' in each line .*columns changed from 3 to 2"),
        ("voxel 2 2 2\n0 0 a\n", "expected a blocked voxel 'x y z' in each line .*'a'"),
        ("voxel 2 2 2\n0 0 2\n", r"within \(2, 2, 2\), got \[0.0, 0.0, 2.0\]"),
        ("voxel 2 2 2\n0 -1 0\n", r"within \(2, 2, 2\), got \[0.0, -1.0, 0.0\]"),
        ("voxel 2 2 2\n0 0.5 0\n", r"got \[0.0, 0.5, 0.0\]"),
        ("voxel 1 1 1\n0 0 0\n", "at least one free voxel"),
    ]:
        with pytest.raises(ValueError, match=f"broken.3dmap: .*{message}"):
            read_list(tmp_path / "broken.3dmap", text)


def test_other_array_raises(tmp_path):
    for array, message in [
        (np.array([None, 1]), "Python objects"),
        (np.ones((2, 2)), "booleans, or integers 0 and 1, got other values or type, float64"),
        (np.array([0, 100]), "got other values or type, int64"),
        (np.array([0, -1]), "got other values or type, int64"),
        (np.ones(2, [("a", bool)]), "got other values or type"),
        (np.array(True), r"one to 4 axes .*shape \(\)"),
        (np.ones((1, 1, 1, 2, 1), bool), "one to 4 axes"),
        (np.zeros((0, 3), bool), "something else or a damaged file|one to 268,435,456 voxels"),
        (np.zeros((2, 2), bool), "at least one free voxel"),
    ]:
        np.save(tmp_path / "wrong.npy", array, allow_pickle=True)
        with pytest.raises(ValueError, match=f"wrong.npy: .*({message})"):
            scenes.read_volume(tmp_path / "wrong.npy")


def test_damaged_array_raises(tmp_path):
    path = tmp_path / "wrong.npy"
    np.save(path, np.ones((4, 4), bool))
    whole = path.read_bytes()
    assert whole[-16:] == b"\1" * 16
    for data in (b"", b"PK\3\4" + whole, whole[:-1], whole.replace(b"(4, 4)", b"(4,9**9)"), whole[:-1] + b"\2"):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"wrong\.npy: expected"):
            scenes.read_volume(path)
    with pytest.raises(FileNotFoundError, match=r"none\.npy"):
        scenes.read_volume(tmp_path / "none.npy")


def test_other_endings_raise(tmp_path):
    for name in ("volume.vox", "room.stl"):
        with pytest.raises(ValueError, match=rf"{name}: expected a file that ends in \.npy or \.3dmap; trimesh"):
            scenes.read_volume(tmp_path / name)
