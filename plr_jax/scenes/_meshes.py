"""Readers of meshes: the polygons of STL, OBJ and PLY files, cut into triangles."""

import re
import struct
import warnings
from array import array
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from shapely.errors import ShapelyError

from plr_jax._arrays import shortened

MESH_ENDINGS = (".stl", ".obj", ".ply")
_DAMAGE = ValueError, TypeError, LookupError, OverflowError, DeprecationWarning, struct.error, ShapelyError
_MOST_BYTES = 2**26
_MIN_CORNERS = 3  # corners of a face; what has fewer, such as a line, is no part of the surface
_STL_HEADER = 84  # bytes of a binary STL file, of which the last four are the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_TYPES = dict(char="i1", uchar="u1", short="i2", ushort="u2", int="i4", uint="u4", float="f4", double="f8")
_PLY_FACES = ("vertex_indices", "vertex_index")

Polygons: TypeAlias = Float[np.ndarray, "n corners 3"]
Triangles: TypeAlias = Float[np.ndarray, "n 3 3"]


def read_mesh(path: Path) -> Triangles:
    """Read the triangles of a mesh; ``ValueError`` if the file is none, is damaged or too large."""
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ValueError(f"expected a mesh of at most {_MOST_BYTES:,} bytes, got a larger file.")
    reader = {".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply}[path.suffix.lower()]
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are none, and of coordinates too large
            groups = reader(data)
            if sum(map(len, groups)) and all(np.isfinite(polygons).all() for polygons in groups):
                return np.concatenate([triangulated(polygons) for polygons in groups])
    except _DAMAGE as error:
        raise ValueError(f"expected a mesh, got something else or a damaged file ({error}).") from None
    raise ValueError("expected a mesh of faces with corners 'x y z', finite ones, got none or others.")


def triangulated(polygons: Polygons) -> Triangles:
    """Cut polygons with equally many corners, each in a plane, into triangles without new corners.

    They may be concave. An outline may come back to a corner, as those of faces with holes do that a cut joins to
    the outside. Where it crosses itself, what it encloses is cut; where it encloses nothing, triangles have no area.
    """
    if polygons.shape[1] == 3:
        return polygons
    # 1. The fan of a quadrilateral is right unless it folds.
    fans = np.stack([np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape), polygons[:, 1:-1], polygons[:, 2:]], 2)
    normals = np.cross(fans[:, :, 1] - fans[:, :, 0], fans[:, :, 2] - fans[:, :, 0])
    is_right = (polygons.shape[1] == 4) & ((normals[:, 0] * normals[:, 1]).sum(axis=1) > 0)
    right, fans, polygons, normals = fans[is_right], fans[~is_right], polygons[~is_right], normals[~is_right]
    # 2. Seen along the axis that is nearest to the normal, a polygon has the most area. GEOS keeps third coordinates.
    axes = (np.abs(normals).sum(axis=1).argmax(axis=1)[:, None] + (1, 2, 3)) % 3
    seen: Any = shapely.polygons(np.take_along_axis(polygons, axes[:, None], axis=2))
    # 3. GEOS takes outlines that touch themselves, but none that cross.
    crossed = ~shapely.is_valid(seen)
    seen[crossed] = shapely.make_valid(seen[crossed], method="structure", keep_collapsed=False)
    parts, polygon = shapely.get_parts(shapely.constrained_delaunay_triangles(seen), return_index=True)
    corners = shapely.get_coordinates(parts, include_z=True).reshape(-1, 4, 3)[:, :3]
    back = np.argsort(axes, axis=1)[polygon]
    is_flat = np.bincount(polygon, minlength=len(polygons)) == 0
    others = right.reshape(-1, 3, 3), fans[is_flat].reshape(-1, 3, 3)
    return np.concatenate([np.take_along_axis(corners, back[:, None], axis=2), *others])


def _read_stl(data: bytes) -> list[Polygons]:
    if b"\0" in data:  # as in no text, and in the number of triangles of any binary file
        promised = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
        count = max(0, len(data) - _STL_HEADER) // _STL_TRIANGLE.itemsize
        if promised != count:
            raise ValueError(f"its header promises {promised:,} triangles, and it has the bytes of {count:,}")
        return [np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)["corners"].astype(np.float64)]
    text = data.decode("ascii", "replace").lower()
    loops = re.findall(r"\bouter\s+loop\b(.*?)\bendloop\b", text, re.DOTALL)
    facets = [[vertex.split() for vertex in re.split(r"\bvertex\b", loop)[1:]] for loop in loops]
    if (
        "endsolid" not in text
        or len(facets) != text.count("endfacet")
        or min(map(len, facets), default=3) < _MIN_CORNERS
    ):
        raise ValueError("a facet of the STL text is not whole, or the line 'endsolid' is missing")
    return _grouped(facets)


def _read_obj(data: bytes) -> list[Polygons]:
    corners, faces = [], []
    for line in data.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        match line.partition("#")[0].split():
            case ["v", x, y, z, *_]:
                corners.append((float(x), float(y), float(z)))
            case ["f", *references]:  # such as 3/1/2: a corner, its texture and its normal; -1 is the last one so far
                numbers = [int(reference.partition("/")[0]) for reference in references]
                faces.append([number - 1 if number > 0 else len(corners) + number for number in numbers])
                if 0 in numbers or min(faces[-1], default=0) < 0:
                    raise ValueError(f"no such corners: {shortened(line)}")
    return _grouped([[corners[number] for number in face] for face in faces])


def _read_ply(data: bytes) -> list[Polygons]:
    # 1. The header: elements, each with a number of rows and with properties, some of which are lists.
    header, _, body = data.partition(b"end_header")
    body = body.partition(b"\n")[2]
    order: Any = None
    elements = []
    for line in header.decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", kind, _]:
                order = _PLY_ORDERS[kind]
            case ["element", element, count]:
                elements.append((element, int(count), []))
            case ["property", "list", counts, items, name]:
                elements[-1][2].append((name, items, counts))
            case ["property", kind, name]:
                elements[-1][2].append((name, kind, None))
    if not data.startswith(b"ply") or order is None:
        raise ValueError("not a PLY file: expected 'ply' and a format in its first lines")
    if is_text := order == "=":  # whose numbers are read as doubles
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # about what is no number
            body = np.fromstring(body, np.float64, sep=" ").tobytes()

    def type_of(name: str) -> np.dtype:
        return np.dtype("f8" if is_text else _PLY_TYPES.get(name, name)).newbyteorder(order)

    # 2. The rows of one element after the other.
    corners, groups, at = np.empty((0, 3)), [], 0
    for element, count, properties in elements:
        if not 0 <= count <= len(body) or not properties:
            raise ValueError(f"no such element: {shortened(element)} with {count:,} rows")
        kinds = [(name, type_of(kind)) for name, kind, _ in properties]
        if not any(counts for _, _, counts in properties):
            rows = np.frombuffer(body, np.dtype(kinds), count, at)
            at += rows.nbytes
            if element == "vertex":
                corners = np.stack([rows[along].astype(np.float64) for along in "xyz"], axis=1)
            continue
        counters = [counts and struct.Struct(order + type_of(counts).char) for _, _, counts in properties]
        begin, sizes, indices = array("q"), array("q"), None
        for _ in range(count):
            for (name, kind), counter in zip(kinds, counters, strict=True):
                size = 1
                if counter is not None:
                    (number,) = counter.unpack_from(body, at)
                    size = int(number)
                    if size != number or size < 0:
                        raise ValueError(f"a list of {number} entries")
                    at += counter.size
                    if element == "face" and name in _PLY_FACES:
                        indices = kind
                        begin.append(at)
                        sizes.append(size)
                at += size * kind.itemsize
        if at > len(body):
            raise ValueError(f"its header promises {count:,} rows of {shortened(element)}, and it has fewer")
        if indices is not None:
            begin, sizes, of_bytes = np.array(begin), np.array(sizes), np.frombuffer(body, np.uint8)
            for size in np.unique(sizes[sizes >= _MIN_CORNERS]):
                rows = sliding_window_view(of_bytes, size * indices.itemsize)[begin[sizes == size]]
                groups.append(rows.view(indices))
    if any(((faces < 0) | (faces % 1 != 0)).any() for faces in groups):
        raise ValueError("the index of a corner is no whole number of at least 0")
    return [corners[faces.astype(np.int64)] for faces in groups]


def _grouped(polygons: Iterable[Sequence[Any]]) -> list[Polygons]:
    """Polygons by their numbers of corners, three at least."""
    by_size = defaultdict(list)
    for polygon in polygons:
        by_size[len(polygon)].append(polygon)
    groups = [np.array(group, np.float64) for size, group in by_size.items() if size >= _MIN_CORNERS]
    if any(group.shape[2:] != (3,) for group in groups):
        raise ValueError("a corner has not three coordinates")
    return groups
