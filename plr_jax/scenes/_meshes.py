"""Read triangle meshes from STL, OBJ and PLY files; faces with more than three corners are cut into triangles."""

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
    """Read the faces of a mesh as triangles, ``(triangles, 3 corners, 3 coordinates)``.

    The file must end in ``.stl``, ``.obj`` or ``.ply``; the ending tells the format. ``ValueError`` is raised if the
    file is no such mesh, too large or damaged.
    """
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise ValueError(f"expected a mesh of at most {_MOST_BYTES:,} bytes, got a larger file.")
    reader = {".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply}[path.suffix.lower()]
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # invalid and overflowing coordinates are rejected below
            groups = reader(data)  # one array of polygons per number of corners
            if sum(map(len, groups)) and all(np.isfinite(polygons).all() for polygons in groups):
                return np.concatenate([triangulated(polygons) for polygons in groups])
    except _DAMAGE as error:
        raise ValueError(f"expected a mesh, got something else or a damaged file ({error}).") from None
    raise ValueError("expected a mesh of faces with finite corners 'x y z', got no faces or other corners.")


def triangulated(polygons: Polygons) -> Triangles:
    """Cut plane polygons in space, ``(n, corners, 3)``, into triangles, ``(triangles, 3 corners, 3 coordinates)``.

    Polygons may be concave, and an outline may touch itself. If an outline crosses itself, the regions that it
    encloses are cut into triangles. An outline that encloses nothing gives triangles without area.
    """
    if polygons.shape[1] == 3:
        return polygons
    # 1. Make the fan of triangles from each polygon's first corner: (polygon, triangle, corner, coordinate).
    #      3---2    A quadrilateral is its fan of two triangles, unless the fan folds over: then the normals of the
    #      | / |    two triangles point in opposite directions.
    #      0---1
    fans = np.stack([np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape), polygons[:, 1:-1], polygons[:, 2:]], 2)
    normals = np.cross(fans[:, :, 1] - fans[:, :, 0], fans[:, :, 2] - fans[:, :, 0])
    is_simple = (polygons.shape[1] == 4) & ((normals[:, 0] * normals[:, 1]).sum(axis=1) > 0)
    simple_fans = fans[is_simple]
    fans, polygons, normals = (rows[~is_simple] for rows in (fans, polygons, normals))
    # 2. Project the other polygons along the axis k closest to the normal, which keeps the most area: reorder the
    #    coordinates to (k + 1, k + 2, k), modulo 3. GEOS works in the first two, and carries the third along.
    axes = (np.abs(normals).sum(axis=1).argmax(axis=1)[:, None] + (1, 2, 3)) % 3
    projected: Any = shapely.polygons(np.take_along_axis(polygons, axes[:, None], axis=2))
    # 3. Triangulate. GEOS accepts outlines that touch themselves; outlines that cross themselves are repaired first.
    is_crossed = ~shapely.is_valid(projected)
    projected[is_crossed] = shapely.make_valid(projected[is_crossed], method="structure", keep_collapsed=False)
    parts, polygon = shapely.get_parts(shapely.constrained_delaunay_triangles(projected), return_index=True)
    # Rings repeat their first corner.
    corners = shapely.get_coordinates(parts, include_z=True).reshape(-1, 4, 3)[:, :3]
    # 4. Restore the order of coordinates. A polygon without triangles encloses nothing: its fan has no area.
    inverse = np.argsort(axes, axis=1)[polygon]
    is_flat = np.bincount(polygon, minlength=len(polygons)) == 0
    others = simple_fans.reshape(-1, 3, 3), fans[is_flat].reshape(-1, 3, 3)
    return np.concatenate([np.take_along_axis(corners, inverse[:, None], axis=2), *others])


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
    is_complete = "endsolid" in text and len(facets) == text.count("endfacet")
    if not is_complete or min(map(len, facets), default=_MIN_CORNERS) < _MIN_CORNERS:
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
    return _grouped([[corners[index] for index in face] for face in faces])


def _read_ply(data: bytes) -> list[Polygons]:
    # 1. Read the header: elements (name, number of rows, properties). A property is (name, type, type of the length),
    #    where the last is None unless the property is a list.
    header, _, body = data.partition(b"end_header")
    body = body.partition(b"\n")[2]
    order: Any = None  # byte order
    elements = []
    for line in header.decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", kind, _]:
                order = _PLY_ORDERS[kind]
            case ["element", element, count]:
                elements.append((element, int(count), []))
            case ["property", "list", length_kind, kind, name]:
                elements[-1][2].append((name, kind, length_kind))
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

    # 2. Read the rows of each element, from the byte `at` on.
    corners, groups = np.empty((0, 3)), []
    at = 0
    for element, count, properties in elements:
        if not 0 <= count <= len(body) or not properties:
            got = f"{count:,} rows and {len(properties)} properties"
            raise ValueError(f"element {shortened(element)} cannot have {got}")
        types = [(name, type_of(kind)) for name, kind, _ in properties]
        # 2a. Rows of equal length, without lists, are one structured array.
        if not any(length_kind for _, _, length_kind in properties):
            rows = np.frombuffer(body, np.dtype(types), count, at)
            at += rows.nbytes
            if element == "vertex":
                corners = np.stack([rows[along].astype(np.float64) for along in "xyz"], axis=1)
            continue
        # 2b. Else skip from property to property, and note where each face's list of indices begins, and its length.
        lengths = [kind and struct.Struct(order + type_of(kind).char) for _, _, kind in properties]
        begin, sizes = array("q"), array("q")
        index_type = None
        for _ in range(count):
            for (name, item_type), length in zip(types, lengths, strict=True):
                size = 1
                if length is not None:
                    (number,) = length.unpack_from(body, at)
                    size = int(number)
                    if size != number or size < 0:
                        raise ValueError(f"a list cannot have {number} entries")
                    at += length.size
                    if element == "face" and name in _PLY_FACES:
                        index_type = item_type
                        begin.append(at)
                        sizes.append(size)
                at += size * item_type.itemsize
        if at > len(body):
            raise ValueError(f"its header promises {count:,} rows of {shortened(element)}, the file has fewer")
        # 2c. Gather the lists of indices, one array for each length.
        if index_type is not None:
            begin, sizes = np.array(begin), np.array(sizes)
            body_bytes = np.frombuffer(body, np.uint8)
            for size in np.unique(sizes[sizes >= _MIN_CORNERS]):
                rows = sliding_window_view(body_bytes, size * index_type.itemsize)[begin[sizes == size]]
                groups.append(rows.view(index_type))
    # 3. Replace indices by corners; indices of text files, and of some binary ones, are floats.
    if any(((faces < 0) | (faces % 1 != 0)).any() for faces in groups):
        raise ValueError("the index of a corner is not an integer of at least 0")
    return [corners[faces.astype(np.int64)] for faces in groups]


def _grouped(polygons: Iterable[Sequence[Any]]) -> list[Polygons]:
    """Return lists of corners as arrays ``(n, corners, 3)``, one array for each number of corners.

    Polygons with fewer than three corners are left out.
    """
    by_size = defaultdict(list)
    for polygon in polygons:
        by_size[len(polygon)].append(polygon)
    groups = [np.array(group, np.float64) for size, group in by_size.items() if size >= _MIN_CORNERS]
    if any(group.shape[2:] != (3,) for group in groups):
        raise ValueError("a corner does not have three coordinates")
    return groups
