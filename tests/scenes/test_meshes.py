import sys

import numpy as np
import pytest
from volume_files import stl_files

from plr_jax import Box, scenes
from plr_jax.scenes._volumes import free_of_mesh

CUBE = [[2, 0, 3], [0, 1, 3], [4, 6, 7], [5, 4, 7], [0, 4, 5], [1, 0, 5], [2, 3, 7], [6, 2, 7], [0, 2, 6], [4, 0, 6]]
CUBE += [[1, 5, 7], [3, 1, 7]]


def box(lo, hi):
    """The triangles of a box's surface."""
    corners = np.array([[(lo, hi)[bit >> axis & 1][axis] for axis in range(3)] for bit in range(8)], float)
    return corners[CUBE]


def written(path, triangles):
    """An OBJ file of triangles."""
    corners = "".join("v {} {} {}\n".format(*corner) for corner in triangles.reshape(-1, 3).tolist())
    faces = "".join(f"f {i + 1} {i + 2} {i + 3}\n" for i in range(0, 3 * len(triangles), 3))
    path.write_text(corners + faces)
    return path


def meets(triangle, voxel):
    """The twin: whether a triangle meets a closed voxel, by thirteen axes that may separate the two."""
    corners = triangle - (voxel + 0.5)
    edges = np.roll(corners, -1, axis=0) - corners
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(a, b) for a in np.eye(3) for b in edges)]
    reach = [0.5 * np.abs(axis).sum() + 1e-7 * np.linalg.norm(axis) for axis in axes]
    along = [corners @ axis for axis in axes]
    return all(a.min() <= r and a.max() >= -r for a, r in zip(along, reach, strict=True))


@pytest.mark.parametrize("kind", ["any", "of corners of the grid", "slender", "of one point", "beyond the bounds"])
def test_voxels_that_a_triangle_meets_are_blocked_and_no_others(kind):
    rng, shape = np.random.default_rng(0), (4, 6, 5)
    for _ in range(6):
        triangle = rng.uniform(-1, 7, (3, 3))
        if kind == "of corners of the grid":
            triangle = np.rint(triangle)
        if kind == "slender":
            triangle[2] = triangle[rng.integers(2)] + 1e-9 * rng.random(3)
        if kind == "of one point":
            triangle[1:] = triangle[0] = np.clip(triangle[0], 0, 4)
        if kind == "beyond the bounds":
            triangle[0] *= 300
        free = free_of_mesh(triangle[None], 1.0, Box((0, 0, 0), shape), fill=False)
        expected = [not meets(triangle, np.array(voxel)) for voxel in np.ndindex(shape)]
        assert free.shape == shape
        np.testing.assert_array_equal(free.ravel(), expected)


def test_a_sphere_is_blocked_and_what_it_does_not_touch_is_free():
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=3).triangles
    free = free_of_mesh(sphere, 0.1, None, fill=True)
    assert free.shape == (20, 20, 20)
    corners = np.stack(np.meshgrid(*[np.arange(21) / 10 - 1] * 3, indexing="ij"), axis=-1)
    radii = np.linalg.norm(corners, axis=-1)
    of_voxel = [radii[i : i + 20, j : j + 20, k : k + 20] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    nearest, farthest = np.min(of_voxel, axis=0), np.max(of_voxel, axis=0)
    assert free[nearest > 1].all() and not free[farthest < 0.98].any()


def test_surfaces_in_planes_of_the_grid_block_both_sides():
    free = free_of_mesh(box((1, 1, 1), (2, 3, 3)), 1.0, Box((0, 0, 0), (5, 5, 5)), fill=False)
    blocked = np.argwhere(~free)
    np.testing.assert_array_equal(blocked.min(axis=0), [0, 0, 0])
    np.testing.assert_array_equal(blocked.max(axis=0), [2, 3, 3])
    assert (~free).sum() == 3 * 4 * 4


def test_what_is_enclosed_is_blocked_unless_it_is_to_stay_free():
    room = box((0.5, 0.5, 0.5), (7.5, 7.5, 7.5))
    filled, hollow = (free_of_mesh(room, 1.0, Box((0, 0, 0), (9, 9, 9)), fill) for fill in (True, False))
    assert (~filled).sum() == 8**3 and (~hollow).sum() == 8**3 - 6**3
    # Without one of its sides it encloses nothing.
    np.testing.assert_array_equal(
        *(free_of_mesh(room[2:], 1.0, Box((0, 0, 0), (9, 9, 9)), fill) for fill in (True, False))
    )


@pytest.mark.parametrize("ending", ["obj", "stl", "ply"])
def test_files_of_meshes(ending, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(box((-1, 0.1, 5), (1.1, 2, 6))))
    path = tmp_path / f"room.{ending}"
    mesh.export(path)
    free = scenes.read_volume(path, pitch=0.25, fill=False)
    assert free.shape == (9, 8, 4) and not free[[0, -1]].any() and free[1:-1, 1:-1, 1:-1].all()
    around = scenes.read_volume(path, pitch=0.5, bounds=((-2, 0, 4), (2, 3.2, 8)))
    assert around.shape == (8, 7, 8)
    assert np.argwhere(~around).min(axis=0).tolist() == [1, 0, 1] and np.argwhere(~around).max(axis=0).tolist() == [
        6,
        4,
        4,
    ]


def test_a_text_in_another_encoding_is_read_and_files_that_it_names_are_not(tmp_path):
    pytest.importorskip("trimesh")
    path = written(tmp_path / "room.obj", box((0, 0, 0), (4, 4, 4)))
    (tmp_path / "walls.mtl").write_text("newmtl wall\nmap_Kd /dev/zero\n")
    path.write_bytes("# Möbel\nmtllib walls.mtl\nusemtl wall\n".encode("latin-1") + path.read_bytes())
    assert scenes.read_volume(path, pitch=1, fill=False).sum() == 8


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "a mesh needs a pitch, the width of its voxels: give one"),
        ({"pitch": 0}, "pitch must be a positive finite number, got 0"),
        ({"pitch": 1e-3}, r"at most 16,777,216 voxels, got 4000 x 4000 x 4000: give a larger pitch"),
        ({"pitch": 1e-320}, "at most 16,777,216 voxels, got inf x inf x inf"),
        ({"pitch": 1, "bounds": ((0, 0), (1, 1))}, "bounds of a mesh must be a Box of three axes"),
        ({"pitch": 1, "bounds": 3}, r"bounds must be a Box or its corners \(lo, hi\), got 3"),
        ({"pitch": 1e-10, "bounds": ((0, 0, 0), (1e-9, 1e-9, 1e-9))}, "triangles within 1,073,741,824 voxels"),
        ({"pitch": 4}, "no free voxel"),
    ],
)
def test_a_callers_mistakes(options, message, tmp_path):
    pytest.importorskip("trimesh")
    path = written(tmp_path / "room.obj", box((0, 0, 0), (4, 4, 4)))
    with pytest.raises(ValueError, match=rf"room\.obj: .*{message}"):
        scenes.read_volume(path, **options)


def test_too_much_work_is_refused(monkeypatch):
    triangles = np.array([[[0, 0, 0], [50, 0, 50], [0, 50, 50.0]]] * 4)
    assert not free_of_mesh(triangles, 1.0, None, fill=False).all()
    for limit, most in (("_MOST_ROWS", 3000), ("_MOST_MET", 5000)):
        with monkeypatch.context() as changed, pytest.raises(ValueError, match=r"too many voxels.* larger pitch"):
            changed.setattr(f"plr_jax.scenes._volumes.{limit}", most)
            free_of_mesh(triangles, 1.0, None, fill=False)


@pytest.mark.parametrize("text", ["", "v 0 0 0\n", "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "f 1 2 3\n", "\0\1"])
def test_what_is_no_mesh_is_refused(text, tmp_path):
    pytest.importorskip("trimesh")
    for ending in ("obj", "stl", "ply"):
        path = tmp_path / f"wrong.{ending}"
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"wrong\.{ending}: expected a mesh"):
            scenes.read_volume(path, pitch=1.0)


def test_without_trimesh_an_error_says_how_to_install_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"trimesh, which is not installed: pip install 'plr-jax\[meshes\]'"):
        scenes.read_volume(tmp_path / "room.stl", pitch=1.0)


def test_what_trimesh_logs_of_parts_that_it_does_without_is_not_shown(tmp_path, caplog):
    pytest.importorskip("trimesh")
    path = tmp_path / "room.stl"
    path.write_bytes(stl_files()[1].replace(b"normal 0", b"normal x"))
    assert scenes.read_volume(path, pitch=0.25, fill=False).shape == (13, 4, 6)
    assert not caplog.records
