import struct

import numpy as np
import pytest
import shapely
from volume_files import stl_files

from plr_jax import Box, scenes
from plr_jax.scenes._meshes import triangulated
from plr_jax.scenes._volumes import free_of_mesh


def box(lo, hi):
    """The triangles of a box's surface."""
    corners = np.array([[(lo, hi)[bit >> axis & 1][axis] for axis in range(3)] for bit in range(8)], float)
    sides = [(2, 0, 3, 1), (4, 6, 5, 7), (0, 4, 1, 5), (2, 3, 6, 7), (0, 2, 4, 6), (1, 5, 3, 7)]
    return corners[[triangle for a, b, c, d in sides for triangle in ((a, b, d), (a, c, d))]]


def met_voxels(triangle, shape):
    """Which closed voxels a triangle meets: those that none of thirteen axes separates from it."""
    corners = triangle - (np.moveaxis(np.indices(shape), 0, -1)[..., None, :] + 0.5)  # from centers of voxels
    edges = np.roll(triangle, -1, axis=0) - triangle
    met = np.ones(shape, bool)
    for axis in [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(a, b) for a in np.eye(3) for b in edges)]:
        reach = 0.5 * np.abs(axis).sum() + 1e-7 * np.linalg.norm(axis)
        along = corners @ axis
        met &= (along.min(axis=-1) <= reach) & (along.max(axis=-1) >= -reach)
    return met


@pytest.mark.parametrize("kind", ["any", "grid corners", "slender", "one point", "beyond bounds"])
def test_voxels_that_triangle_meets_are_blocked(kind):
    rng, shape = np.random.default_rng(0), (4, 6, 5)
    for _ in range(6):
        triangle = rng.uniform(-1, 7, (3, 3))
        if kind == "grid corners":
            triangle = np.rint(triangle)
        if kind == "slender":
            triangle[2] = triangle[rng.integers(2)] + 1e-9 * rng.random(3)
        if kind == "one point":
            triangle[1:] = triangle[0] = np.clip(triangle[0], 0, 4)
        if kind == "beyond bounds":
            triangle[0] *= 300
        free = free_of_mesh(triangle[None], 1.0, Box((0, 0, 0), shape), fill=False)
        np.testing.assert_array_equal(free, ~met_voxels(triangle, shape))


def test_surface_between_voxels_blocks_both_sides():
    free = free_of_mesh(box((1, 1, 1), (2, 3, 3)), 1.0, Box((0, 0, 0), (5, 5, 5)), fill=False)
    assert corner_indices(~free) == ([0, 0, 0], [2, 3, 3]) and (~free).sum() == 3 * 4 * 4


def test_enclosed_voxels_are_blocked_by_fill():
    room, bounds = box((0.5, 0.5, 0.5), (7.5, 7.5, 7.5)), Box((0, 0, 0), (9, 9, 9))
    filled, hollow = (free_of_mesh(room, 1.0, bounds, fill) for fill in (True, False))
    assert (~filled).sum() == 8**3 and (~hollow).sum() == 8**3 - 6**3
    # Without one of its sides it encloses nothing.
    np.testing.assert_array_equal(*(free_of_mesh(room[2:], 1.0, bounds, fill) for fill in (True, False)))


def corner_indices(voxels):
    """The lowest and the highest index of true voxels along each axis."""
    return np.argwhere(voxels).min(axis=0).tolist(), np.argwhere(voxels).max(axis=0).tolist()


def test_voxels_begin_at_lower_corner_of_bounds(tmp_path):
    room = obj_of(box((-1, 0.1, 5), (1.1, 2, 6)))
    free = read(tmp_path, room, "room.obj", pitch=0.25)
    assert free.shape == (9, 8, 4) and not free[[0, -1]].any() and free[1:-1, 1:-1, 1:-1].all()
    around = read(tmp_path, room, "room.obj", pitch=0.5, bounds=((-2, 0, 4), (2, 3.2, 8)))
    assert around.shape == (8, 7, 8)
    assert corner_indices(~around) == ([1, 0, 1], [6, 4, 4])


def test_stl_is_read_as_binary_or_text(tmp_path):
    binary, text = stl_files()
    expected = read(tmp_path, binary, "a.stl", pitch=0.25)
    assert expected.shape == (13, 4, 6)
    variants = [b"solid room".ljust(80) + binary[80:], binary + b"\0", binary + bytes(49), text, text.upper()]
    variants += [text.replace(b"\n", b"\r\n  "), text + text.replace(b"room", b"other"), text.replace(b"room", b"")]
    for data in variants:
        np.testing.assert_array_equal(read(tmp_path, data, "b.stl", pitch=0.25), expected)


def test_damaged_stl_raises(tmp_path):
    binary, text = stl_files()
    for promised in (0, 9, 11, 2**32 - 1):
        with pytest.raises(ValueError, match=rf"promises {promised:,} triangles, its bytes hold 10"):
            read(tmp_path, binary[:80] + struct.pack("<I", promised) + binary[84:], "a.stl", pitch=0.25)
    for data in (binary[:-1], binary[:-50], binary[:84], binary[:40], text[:-20], text.replace(b"vertex", b"", 1)):
        with pytest.raises(ValueError, match=r"a\.stl: expected a mesh"):
            read(tmp_path, data, "a.stl", pitch=0.25)


def test_obj_does_not_load_files_it_names(tmp_path):
    (tmp_path / "walls.mtl").write_text("newmtl wall\nmap_Kd /dev/zero\n")
    head = "# Möbel\nmtllib walls.mtl\nusemtl wall\n".encode("latin-1")
    assert read(tmp_path, head + obj_of(box((0, 0, 0), (4, 4, 4))), "room.obj").sum() == 8


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_options_raise(tmp_path):
    for options, message in [
        ({}, "expected a pitch, the side of a voxel, for a mesh"),
        ({"pitch": 0}, "pitch must be a positive finite number, got 0"),
        ({"pitch": 1e-3}, r"at most 16,777,216 voxels, got 4000 x 4000 x 4000: give a larger pitch"),
        ({"pitch": 1e-320}, "at most 16,777,216 voxels, got inf x inf x inf"),
        ({"pitch": 1, "bounds": ((0, 0), (1, 1))}, "bounds of a mesh must be a Box of three axes"),
        ({"pitch": 1, "bounds": 3}, r"bounds must be a Box or its corners \(lo, hi\), got 3"),
        ({"pitch": 1e-10, "bounds": ((0, 0, 0), (1e-9, 1e-9, 1e-9))}, "triangles within 1,073,741,824 voxels"),
        ({"pitch": 4}, "at least one free voxel"),
    ]:
        room = obj_of(box((0, 0, 0), (4, 4, 4)))
        with pytest.raises(ValueError, match=rf"room\.obj: .*{message}"):
            read(tmp_path, room, "room.obj", **{"pitch": None, "fill": True} | options)


def test_too_many_met_voxels_raise(monkeypatch):
    triangles = np.array([[[0, 0, 0], [50, 0, 50], [0, 50, 50.0]]] * 4)
    assert not free_of_mesh(triangles, 1.0, None, fill=False).all()
    for limit, most in (("_MOST_ROWS", 3000), ("_MOST_MET", 5000)):
        with monkeypatch.context() as changed, pytest.raises(ValueError, match=r"too many voxels.* larger pitch"):
            changed.setattr(f"plr_jax.scenes._volumes.{limit}", most)
            free_of_mesh(triangles, 1.0, None, fill=False)


def test_file_without_mesh_raises(tmp_path):
    for text in ("", "\0" * 84, "v 0 0 0\n", "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "f 1 2 3\n", "\0\1"):
        for ending in ("obj", "stl", "ply"):
            with pytest.raises(ValueError, match=rf"wrong\.{ending}: expected a mesh"):
                read(tmp_path, text.encode(), f"wrong.{ending}")


# --- polygons -------------------------------------------------------------------------------------------

# A wall of 10 x 4 whose outline goes around a door of 2.2 x 2.1: 4 of its 40 voxels are open.
DOOR = [(0, 0), (3.9, 0), (3.9, 2.1), (6.1, 2.1), (6.1, 0), (10, 0), (10, 4), (0, 4)]
# The same wall with a window, which a cut joins to the outside: voxels (4, 1), (5, 1), (4, 2) and (5, 2) are open.
WINDOW = [(0, 0), (10, 0), (10, 4), (0, 4), (0, 0), (3.9, 0.9), (3.9, 3.1), (6.1, 3.1), (6.1, 0.9), (3.9, 0.9)]


def obj_of(polygons):
    lines = ["v {} {} {}".format(*corner) for polygon in polygons for corner in polygon]
    ends = np.cumsum([len(polygon) for polygon in polygons])
    lines += ["f " + " ".join(map(str, range(e - len(p) + 1, e + 1))) for e, p in zip(ends, polygons, strict=True)]
    return "\n".join(lines).encode()


def ply_of(polygons, order, kinds="Bi", has_extras=False):
    """A PLY file of polygons; ``kinds`` are the types of a face's size and indices, as codes of ``struct``."""
    names = {"B": "uchar", "H": "ushort", "i": "int", "I": "uint"}
    before, after = ["list uchar float texcoord", "float quality"], ["short part", "int16 other"]
    corners = [corner for polygon in polygons for corner in polygon]
    properties = [f"list {names[kinds[0]]} {names[kinds[1]]} vertex_index"]
    properties = [*before, *properties, *after] if has_extras else properties
    header = [f"ply\nformat {order} 1.0\ncomment made by hand\nelement vertex {len(corners)}\nproperty uchar red"]
    header += [f"property double {axis}" for axis in "zxy"] + [f"element face {len(polygons)}"]
    header += [f"property {each}" for each in properties] + ["end_header\n"]
    rows, numbers = [("B3d", 7, z, x, y) for x, y, z in corners], iter(range(len(corners)))
    for polygon in polygons:
        row = [len(polygon), *(next(numbers) for _ in polygon)]
        form = kinds[0] + str(len(polygon)) + kinds[1]
        rows.append(("B3f" + form + "hh", 2, 0, 1, 0.5, *row, 3, 4) if has_extras else (form, *row))
    if order == "ascii":
        return ("\n".join(header) + "\n".join(" ".join(map(str, row)) for _, *row in rows)).encode()
    prefix = ">" if "big" in order else "<"
    return "\n".join(header).encode() + b"".join(struct.pack(prefix + form, *row) for form, *row in rows)


def read(folder, data, name, **options):
    (folder / name).write_bytes(data)
    return scenes.read_volume(folder / name, **{"pitch": 1.0, "fill": False} | options)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("outline", "is_open"), [(DOOR, np.s_[4:6, 0:2]), (WINDOW, np.s_[4:6, 1:3])])
def test_concave_faces_leave_openings_free(axis, outline, is_open, tmp_path):
    expected = np.zeros((10, 4), bool)
    expected[is_open] = True
    shape = np.insert(np.array((10, 4)), axis, 2)
    for shift in range(0, len(outline), 3):
        for turn in (1, -1):
            corners = np.array(outline if outline is WINDOW else np.roll(outline, shift, axis=0)[::turn], float)
            wall = np.insert(corners, axis, 0.5, axis=1)  # in the plane across the axis
            free = read(tmp_path, obj_of([wall]), "wall.obj", bounds=((0, 0, 0), shape))
            np.testing.assert_array_equal(free.take(0, axis), expected)
            assert free.take(1, axis).all()


@pytest.mark.parametrize("size", [4, 5, 12])
def test_triangles_fill_polygons_exactly(size):
    rng = np.random.default_rng(size)
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, size))
        outline = rng.uniform(0.2, 1, size)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        polygon = shapely.Polygon(outline)
        if not polygon.is_valid:
            continue
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        triangles = triangulated((np.insert(outline, 2, 0.3, axis=1) @ turn)[None]) @ turn.T
        np.testing.assert_allclose(triangles[..., 2], 0.3)
        flat = shapely.polygons(triangles[..., :2])
        assert shapely.area(flat).sum() == pytest.approx(polygon.area)
        assert shapely.area(shapely.union_all(flat)) == pytest.approx(polygon.area)
        assert shapely.difference(shapely.union_all(flat), polygon).area < 1e-12
        assert len(triangles) == size - 2


def test_degenerate_faces_are_triangulated():
    def areas(*corners):
        sides = np.diff(triangulated(np.array([corners], float)), axis=1)
        return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2

    assert areas((0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 2, 0)) == pytest.approx(2)  # which crosses itself
    assert areas((0, 0, 0), (0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)) == pytest.approx(1)  # a corner twice
    assert areas((0, 0, 0), (0, 3, 0), (0, 4, 0), (0, 3, 0), (0, 3, 2)) == pytest.approx(3)  # with a spike
    assert areas((0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 0, 2), (0, 0, 2)) == pytest.approx(4)  # straight at a corner
    line = triangulated(np.array([[(0, 0, 0), (1, 1, 1), (3, 3, 3), (2, 2, 2)]], float))
    np.testing.assert_array_equal([line.min(axis=(0, 1)), line.max(axis=(0, 1))], [(0, 0, 0), (3, 3, 3)])
    # A quad that is not flat keeps its corners, so that nothing opens between it and its neighbors.
    bent = np.array([(0, 0, 0), (4, 0, 1), (4, 4, 0), (0, 4, 1)], float)
    np.testing.assert_array_equal(np.unique(triangulated(bent[None]).reshape(-1, 3), axis=0), np.unique(bent, axis=0))


ROOM = box((0.5, 0.5, 0.5), (3.5, 2.5, 2.5))
QUADS = [[(0.5, y, 0.5), (3.5, y, 0.5), (3.5, y, 2.5), (0.5, y, 2.5)] for y in (0.5, 2.5)]
MIXED = [*ROOM[:4].tolist(), *QUADS, *ROOM[8:].tolist(), [(0, 0, 0), (1, 1, 1)]]  # and a line, which is no face
AROUND = {"bounds": ((0, 0, 0), (4, 3, 3))}


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("options", [{}, {"kinds": "iI"}, {"kinds": "HH"}, {"has_extras": True}], ids=range(4))
def test_ply_of_all_types_is_read(order, options, tmp_path):
    # Quads take the place of two of the six sides; the room is 2 x 1 x 1 voxels inside a shell.
    data = ply_of(MIXED, order, **options)
    free = read(tmp_path, data, "room.ply", **AROUND)
    assert free.sum() == 2 and free[1:3, 1, 1].all()
    np.testing.assert_array_equal(read(tmp_path, data + b"\n", "room.ply", **AROUND), free)
    with pytest.raises(ValueError, match=r"room\.ply: expected a mesh"):
        read(tmp_path, data[:-7], "room.ply", **AROUND)


def test_ply_elements_may_be_reordered_or_empty(tmp_path):
    header = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nelement edge 0\n"
    header += "property int a\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    free = read(tmp_path, header.encode() + b"3 2 1 0\n0 0 0\n3 0 1\n0 3 2", "a.ply")
    triangle = [[(0, 0, 0), (3, 0, 1), (0, 3, 2)]]
    np.testing.assert_array_equal(free, read(tmp_path, obj_of(triangle), "b.obj"))


def test_broken_ply_raises(tmp_path):
    for change, message in [
        ((b"format ascii", b"format binary_middle_endian"), "expected a mesh"),
        ((b"element face 11", b"element face -1"), "element 'face' cannot have -1 rows"),
        ((b"element face 11", b"element face 99"), "expected a mesh"),
        ((b"vertex_index", b"corners"), "expected a mesh of faces"),
        ((b"\n3 0 1 2", b"\n3 0 1 99"), "expected a mesh"),
        ((b"\n3 0 1 2", b"\n3 0 1 -2"), "the index of a corner is not an integer"),
        ((b"\n3 0 1 2", b"\n3 0 1 2.5"), "the index of a corner is not an integer"),
        ((b"\n3 0 1 2", b"\n-3 0 1 2"), "a list cannot have -3.0 entries"),
        ((b"\n3 0 1 2", b"\n3.7 0 1 2"), "a list cannot have 3.7 entries"),
        ((b"\n3 0 1 2", b"\n3 0 1 x"), "expected a mesh"),
        ((b"property double x", b"property double u"), "expected a mesh"),
    ]:
        data = ply_of(MIXED, "ascii")
        assert change[0] in data
        with pytest.raises(ValueError, match=rf"room\.ply: .*{message}"):
            read(tmp_path, data.replace(*change), "room.ply", **AROUND)


def test_obj_indices_count_from_one_or_backward(tmp_path):
    lines = [b"o room # a comment", b"vn 0 0 1", b"vt 0 0"]
    for polygon in MIXED:
        lines += [b"v %r %r %r 1.0" % tuple(corner) for corner in polygon]
        lines.append(b"f " + b" ".join(b"%d//1" % -i for i in range(len(polygon), 0, -1)) + b" # a face")
    lines.append(b"f 1/1/1 \\\n 2/1/1 3/1/1\nl 1 2\np 1")
    free = read(tmp_path, b"\r\n".join(lines), "room.obj", **AROUND)
    np.testing.assert_array_equal(free, read(tmp_path, obj_of(MIXED), "b.obj", **AROUND))
    assert free.sum() == 2
    for wrong in (b"f 1 2 0", b"f 1 2 99", b"f 1 2 -99", b"f 1 2 x", b"f 1 2 3.5"):
        with pytest.raises(ValueError, match=r"c\.obj: expected a mesh"):
            read(tmp_path, b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + wrong, "c.obj")
