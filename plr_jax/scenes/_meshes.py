"""Readers of triangle meshes from STL, OBJ and PLY files; polygonal faces are cut into triangles."""

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
_MIN_CORNERS = 3  # fewest corners of a face; elements with fewer, such as lines, are skipped
_STL_HEADER = 84  # bytes of a binary STL file; the last four are the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_TYPES = dict(char="i1", uchar="u1", short="i2", ushort="u2", int="i4", uint="u4", float="f4", double="f8")
_PLY_FACES = ("vertex_indices", "vertex_index")
Polygons: TypeAlias = Float[np.ndarray, "n corners 3"]
Triangles: TypeAlias = Float[np.ndarray, "triangles 3 3"]


def read_mesh(path: Path) -> Triangles:
    """Read the faces of a mesh as triangles; ``ValueError`` if the file is no mesh or damaged."""
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ValueError(f"expected a mesh of at most {_MOST_BYTES:,} bytes, got a larger file.")
    reader = {".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply}[path.suffix.lower()]
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # invalid and overflowing coordinates are rejected below
            groups = reader(data)
            if sum(map(len, groups)) and all(np.isfinite(polygons).all() for polygons in groups):
                return np.concatenate([triangulated(polygons) for polygons in groups])
    except _DAMAGE as error:
        raise ValueError(f"expected a mesh, got something else or a damaged file ({error}).") from None
    raise ValueError("expected a mesh of faces with finite corners 'x y z', got no faces or other corners.")


def triangulated(polygons: Polygons) -> Triangles:
    """Cut plane polygons in space, all with the same number of corners, into triangles.

    Polygons may be concave, and outlines may touch themselves. If an outline crosses itself, the regions that it
    encloses are cut into triangles. An outline that encloses nothing gives triangles without area.
    """
    if polygons.shape[1] == 3:
        return polygons
    # 1. A quadrilateral is the fan of two triangles from its first corner, unless the fan folds over.
    fans = np.stack([np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape), polygons[:, 1:-1], polygons[:, 2:]], 2)
    normals = np.cross(fans[:, :, 1] - fans[:, :, 0], fans[:, :, 2] - fans[:, :, 0])
    is_right = (polygons.shape[1] == 4) & ((normals[:, 0] * normals[:, 1]).sum(axis=1) > 0)
    right, fans, polygons, normals = fans[is_right], fans[~is_right], polygons[~is_right], normals[~is_right]
    # 2. Project along the axis closest to the normal, which keeps the most area. GEOS keeps the third coordinate.
    axes = (np.abs(normals).sum(axis=1).argmax(axis=1)[:, None] + (1, 2, 3)) % 3
    seen: Any = shapely.polygons(np.take_along_axis(polygons, axes[:, None], axis=2))
    # 3. Triangulate. GEOS accepts outlines that touch themselves; those that cross are repaired first.
    crossed = ~shapely.is_valid(seen)
    seen[crossed] = shapely.make_valid(seen[crossed], method="structure", keep_collapsed=False)
    parts, polygon = shapely.get_parts(shapely.constrained_delaunay_triangles(seen), return_index=True)
    corners = shapely.get_coordinates(parts, include_z=True).reshape(-1, 4, 3)[:, :3]
    back = np.argsort(axes, axis=1)[polygon]
    is_flat = np.bincount(polygon, minlength=len(polygons)) == 0
    others = right.reshape(-1, 3, 3), fans[is_flat].reshape(-1, 3, 3)
    return np.concatenate([np.take_along_axis(corners, back[:, None], axis=2), *others])


def _read_stl(data: bytes) -> list[Polygons]:
    if b"\0" in data:  # no text has a zero byte; every binary file has one in its number of triangles
        promised = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
        count = max(0, len(data) - _STL_HEADER) // _STL_TRIANGLE.itemsize
        if promised != count:
            raise ValueError(f"its header promises {promised:,} triangles, its bytes hold {count:,}")
        return [np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)["corners"].astype(np.float64)]
    text = data.decode("ascii", "replace").lower()
    loops = re.findall(r"\bouter\s+loop\b(.*?)\bendloop\b", text, re.DOTALL)
    facets = [[vertex.split() for vertex in re.split(r"\bvertex\b", loop)[1:]] for loop in loops]
    if (
        "endsolid" not in text
        or len(facets) != text.count("endfacet")
        or min(map(len, facets), default=3) < _MIN_CORNERS
    ):
        raise ValueError("a facet of the STL text is incomplete, or the line 'endsolid' is missing")
    return _grouped(facets)


def _read_obj(data: bytes) -> list[Polygons]:
    corners, faces = [], []
    for line in data.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        match line.partition("#")[0].split():
            case ["v", x, y, z, *_]:
                corners.append((float(x), float(y), float(z)))
            case ["f", *references]:  # such as 3/1/2: corner, texture, normal; -1 is the latest corner
                numbers = [int(reference.partition("/")[0]) for reference in references]
                faces.append([number - 1 if number > 0 else len(corners) + number for number in numbers])
                if 0 in numbers or min(faces[-1], default=0) < 0:
                    raise ValueError(f"a face names corners that do not exist: {shortened(line)}")
    return _grouped([[corners[number] for number in face] for face in faces])


def _read_ply(data: bytes) -> list[Polygons]:
    # 1. Read the header: elements, each with a number of rows and properties, some of which are lists.
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
    if is_text := order == "=":  # numbers of text files are converted to doubles first
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for words that are not numbers
            body = np.fromstring(body, np.float64, sep=" ").tobytes()

    def type_of(name: str) -> np.dtype:
        return np.dtype("f8" if is_text else _PLY_TYPES.get(name, name)).newbyteorder(order)

    # 2. Read the rows of each element.
    corners, groups, at = np.empty((0, 3)), [], 0
    for element, count, properties in elements:
        if not 0 <= count <= len(body) or not properties:
            raise ValueError(
                f"element {shortened(element)} cannot have {count:,} rows and {len(properties)} properties"
            )
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
                        raise ValueError(f"a list cannot have {number} entries")
                    at += counter.size
                    if element == "face" and name in _PLY_FACES:
                        indices = kind
                        begin.append(at)
                        sizes.append(size)
                at += size * kind.itemsize
        if at > len(body):
            raise ValueError(f"its header promises {count:,} rows of {shortened(element)}, the file has fewer")
        if indices is not None:
            begin, sizes, of_bytes = np.array(begin), np.array(sizes), np.frombuffer(body, np.uint8)
            for size in np.unique(sizes[sizes >= _MIN_CORNERS]):
                rows = sliding_window_view(of_bytes, size * indices.itemsize)[begin[sizes == size]]
                groups.append(rows.view(indices))
    if any(((faces < 0) | (faces % 1 != 0)).any() for faces in groups):
        raise ValueError("the index of a corner is not an integer of at least 0")
    return [corners[faces.astype(np.int64)] for faces in groups]


def _grouped(polygons: Iterable[Sequence[Any]]) -> list[Polygons]:
    """Return polygons as arrays, one for each number of corners; polygons with too few corners are left out."""
    by_size = defaultdict(list)
    for polygon in polygons:
        by_size[len(polygon)].append(polygon)
    groups = [np.array(group, np.float64) for size, group in by_size.items() if size >= _MIN_CORNERS]
    if any(group.shape[2:] != (3,) for group in groups):
        raise ValueError("a corner does not have three coordinates")
    return groups
