import io
import zipfile

import numpy as np
import pytest
import shapely
from oracle_helpers import TEN

from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph

BLOCKS = [shapely.box(2, 2, 4, 4), shapely.box(4, 4, 6, 6), shapely.Polygon([(6, 1), (9, 2), (7, 3)])]


@pytest.fixture
def path(tmp_path):
    """A file of the oracle to (1, 1) among the blocks."""
    VisibilityGraph(Workspace(TEN, BLOCKS), (1, 1)).save(tmp_path / "oracle.npz")
    return tmp_path / "oracle.npz"


@pytest.mark.parametrize("squeeze", [False, True])
def test_what_is_loaded_answers_alike(tmp_path, squeeze):
    workspace = Workspace(TEN, BLOCKS, squeeze=squeeze)
    oracle, x = VisibilityGraph(workspace, (1, 1)), workspace.sample_free(300, 0)
    oracle.save(tmp_path / "oracle.npz")
    loaded = VisibilityGraph.load(tmp_path / "oracle.npz")
    np.testing.assert_array_equal(loaded(x), oracle(x))
    np.testing.assert_array_equal(loaded.with_goal((9, 9))(x), VisibilityGraph(workspace, (9, 9))(x))
    np.testing.assert_array_equal(loaded.graph.edges, oracle.graph.edges)
    assert loaded.workspace.bounds == workspace.bounds and loaded.workspace.squeeze == squeeze
    assert loaded.workspace.free_space.equals_exact(workspace.free_space)
    assert [a.equals_exact(b) for a, b in zip(loaded.workspace.obstacles, BLOCKS, strict=True)] == [True] * 3


def test_a_workspace_without_corners(tmp_path):
    VisibilityGraph(Workspace(TEN), (1, 1)).save(tmp_path / "oracle.npz")
    np.testing.assert_array_equal(VisibilityGraph.load(tmp_path / "oracle.npz")(np.array([[4.0, 5.0]])), [5.0])


def test_nothing_is_prepared_again(path, monkeypatch):
    monkeypatch.setattr("plr_jax.oracles._visibility_graph.corner_visibility", None)
    VisibilityGraph.load(path)


def rewritten(path, **changes):
    """The file with some arrays replaced, or left out where None is given."""
    arrays = {**np.load(path), **changes}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def wkb(geometry):
    return np.frombuffer(shapely.to_wkb(geometry), np.uint8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "version 2, this release reads version 1"),
        ({"key": None}, "has no key.npy"),
        ({"goal": np.array([1, 2])}, "goal has numbers of kind i"),
        ({"goal": np.ones(3)}, r"shape \(3,\)"),
        ({"goal": np.array([np.nan, 1])}, "not finite"),
        ({"goal": np.array([3.0, 3.0])}, "lies in an obstacle"),
        ({"bounds": np.array([[1.0, 1], [0, 0]])}, "lo"),
        ({"free_space": np.zeros(9, np.uint8)}, "cannot be read"),
        ({"free_space": wkb(shapely.Point(1, 1))}, "free space is no valid polygon"),
        ({"free_space": wkb(shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]))}, "free space is no valid polygon"),
        ({"free_space": wkb(shapely.box(0, 0, 10, 10))}, "one visibility polygon for each of 0 corners"),
        ({"obstacles": wkb(shapely.Point(1, 1))}, "must be a polygon"),
        ({"edges": np.array([[0, 99]])}, "names corners or walls"),
        ({"edges": np.array([[0, 0]])}, "two different vertices"),
        ({"key": np.array([object()])}, "kind O"),
    ],
)
def test_nonsense_is_refused_by_name(path, changes, message):
    rewritten(path, **changes)
    with pytest.raises(ValueError, match=message) as error:
        VisibilityGraph.load(path)
    assert str(error.value).startswith(f"{path} cannot be read as a visibility graph: ")


@pytest.mark.parametrize("name", ["first", "key", "edge", "cut"])
def test_polygons_that_are_cut_short_or_out_of_order_are_refused(path, name):
    array = np.load(path)[name]
    for other in (array[:-1], array[:0], array + 99, array - 99):
        rewritten(path, **{name: other})
        with pytest.raises(ValueError, match="cannot be read as a visibility graph"):
            VisibilityGraph.load(path)


def test_damaged_files_are_refused_by_name(path):
    data, rng = path.read_bytes(), np.random.default_rng(0)
    with pytest.raises(OSError, match="none"):
        VisibilityGraph.load(path.with_name("none.npz"))
    for number in range(200):
        damaged = bytearray(data)
        if number % 2:
            damaged = damaged[: rng.integers(len(data))]
        else:
            for place in rng.integers(0, len(data), 3):
                damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            VisibilityGraph.load(path)
        except ValueError as error:
            assert str(path) in str(error)
        else:
            assert number % 2 == 0  # where nothing that is read was hit


@pytest.mark.parametrize(("place", "byte"), [(60, 0x35), (10, 0x03), (50, 0x40), (8, 0x46)])
def test_headers_that_are_no_python_are_refused(path, place, byte):
    with zipfile.ZipFile(path) as archive:
        members = {name: bytearray(archive.read(name)) for name in archive.namelist()}
    members["version.npy"][place] ^= byte
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, bytes(data))
    with pytest.raises(ValueError, match="cannot be read as a visibility graph"):
        VisibilityGraph.load(path)


def test_every_byte_of_the_directory_may_be_wrong(path):
    data = path.read_bytes()
    for place in range(data.rindex(b"PK\5\6") - 70, len(data)):
        for byte in (1, 0x80, 0xFF):
            path.write_bytes(data[:place] + bytes([data[place] ^ byte]) + data[place + 1 :])
            try:
                VisibilityGraph.load(path)
            except ValueError as error:
                assert str(path) in str(error)


def test_a_file_cannot_ask_for_more_than_it_holds(path):
    """Neither by a shape that it does not fill nor by compression."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**50,)})
    huge = {**members, "key.npy": header.getvalue()}
    for arrays, method, message in (
        (huge, zipfile.ZIP_STORED, "key is incomplete"),
        (members, zipfile.ZIP_DEFLATED, "compressed"),
    ):
        with zipfile.ZipFile(path, "w", method) as archive:
            for name, data in arrays.items():
                archive.writestr(name, data)
        with pytest.raises(ValueError, match=message):
            VisibilityGraph.load(path)
