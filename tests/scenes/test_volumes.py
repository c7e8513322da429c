import numpy as np
import pytest

from plr_jax import scenes


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
