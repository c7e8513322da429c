"""Valid files of volumes: arrays, lists of voxels, and meshes of a box without a lid."""

import io
import struct

import numpy as np


def array_files() -> list[bytes]:
    rng, files = np.random.default_rng(0), []
    for shape, kind in (((30,), bool), ((6, 5), np.uint8), ((4, 5, 6), bool), ((3, 2, 3, 2), np.int64)):
        buffer = io.BytesIO()
        np.save(buffer, (rng.random(shape) < 0.7).astype(kind))
        files.append(buffer.getvalue())
    return files


VOXELS = "voxel 12 9 6\n" + "".join(f"{i} {i * i % 9} {i % 6}\n" for i in range(12))
_CORNERS = [(x, y, z) for z in (0, 1.5) for y in (0, 1) for x in (-1, 2.25)]
_FACES = [tuple(map(int, face)) for face in ["023", "031", "457", "476", "015", "054", "267", "273", "046", "137"]]
OBJ = "mtllib room.mtl\no room\nusemtl wall\n" + "".join("v {} {} {}\n".format(*corner) for corner in _CORNERS)
OBJ += "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in _FACES)
_PLY_HEADER = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
_PLY_HEADER += "element face {}\nproperty list uchar int vertex_indices\nend_header\n"


def ply_files() -> list[bytes]:
    sizes = len(_CORNERS), len(_FACES)
    corners, faces = (" ".join(map(str, corner)) for corner in _CORNERS), (f"3 {a} {b} {c}" for a, b, c in _FACES)
    text = _PLY_HEADER.format("ascii", *sizes) + "\n".join([*corners, *faces, ""])
    packed = [struct.pack("<3f", *corner) for corner in _CORNERS] + [struct.pack("<B3i", 3, *face) for face in _FACES]
    return [text.encode(), _PLY_HEADER.format("binary_little_endian", *sizes).encode() + b"".join(packed)]


def stl_files() -> list[bytes]:
    faces = [[_CORNERS[i] for i in face] for face in _FACES]
    packed = [struct.pack("<12fH", 0, 0, 1, *np.ravel(face), 0) for face in faces]
    facets = ("".join("vertex {} {} {}\n".format(*corner) for corner in face) for face in faces)
    text = "".join(f"facet normal 0 0 1\nouter loop\n{facet}endloop\nendfacet\n" for facet in facets)
    binary = bytes(80) + struct.pack("<I", len(faces)) + b"".join(packed)
    return [binary, f"solid room\n{text}endsolid room\n".encode()]
