"""Readers of files, and valid files of each, which :mod:`hostile_files` mutates."""

import io
import json
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from building_scenes import GOAL, two_floors
from pair_helpers import serpentine
from PIL import Image
from volume_files import VOXELS, array_files

import plr_jax
from plr_jax import Box, DiscRobot, PointRobot, Problem, RectangleRobot, ReedsShepp, Workspace, construct, scenes
from plr_jax.plr.container import MAGIC, Header
from plr_jax.plr.leaves import leaf_names

_GRID = """type octile
height 4
width 12
map
@.GG.TT.SS.@
@..........@
@.@@...WW..@
@@@@@@@@@@@@
"""
_CRC = struct.Struct("<I")
_SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]
_POLYGONS = {"components": [{"outer": _SQUARE, "holes": [[[1, 1], [1, 2], [2, 2.5], [2, 1]]]}], "source": "none"}


_GEOJSON = """{"type": "FeatureCollection", "bbox": [-1, -1, 9, 9], "features": [{"type": "Feature",
"properties": null, "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]]}}]}"""
_WKT = "GEOMETRYCOLLECTION (POLYGON ((0 0 1, 4 0 1, 4 4 1, 0 0 1), EMPTY), MULTIPOLYGON (((5 0, 6 0, 6 1, 5 0))))"


@dataclass(frozen=True)
class Reader:
    """A reader, and valid files to mutate.

    Attributes:
        read: Reads a path.
        suffix: File name suffix.
        valid: Makes the contents of valid files.
        repaired: Repairs the checksums of a mutated file, or returns a binary file without checksums as it is; None
            for text files.
    """

    read: Callable[[Path], Any]
    suffix: str
    valid: Callable[[], list[bytes]]
    repaired: Callable[[bytes], bytes] | None = None


def _written(save: Callable[[Any, Path], None], values: Iterable[Any]) -> list[bytes]:
    files = []
    with tempfile.TemporaryDirectory() as folder:
        for value in values:
            save(value, Path(folder, "file.json"))
            files += [Path(folder, "file.json").read_bytes()]
    return files


def _scene_files() -> list[bytes]:
    rings = [_SQUARE, [[5, 5], [6, 5], [6, 6]]]
    holed = Workspace.from_polygons([{"outer": [[-1, -1], [9, -1], [9, 9], [-1, 9]], "holes": rings}])
    robots = [DiscRobot(0.25), RectangleRobot(0.7, 0.1), PointRobot()]
    starts, goals = [(8, 8, 0), (7, 1, 1), (1, 8, 0)], [(8, 0, 0), (6, 2, 2), (5, 8, 0)]
    team = Problem(holed, robots, starts, goals, rotation_weight=0.3)
    return _written(scenes.save, (scenes.maze(), scenes.tangle(), team))


def _solution_files() -> list[bytes]:
    problem = scenes.single_door()
    limits = (plr_jax.BLOptions(), plr_jax.BLOptions(max_expansions=1))
    return _written(plr_jax.Solution.save, (plr_jax.bl_plan(problem, options=each) for each in limits))


def _plr_files() -> list[bytes]:
    def distance(x: Any) -> Any:
        return np.where((x[:, 0] > 0.4) & (x[:, -1] < 0.3), np.inf, np.linalg.norm(x - 0.7, axis=1))

    kinds = [
        (2, {"leaf": "plane", "max_leaves": 20}),  # stores floats
        (3, {"leaf": "plane", "max_bytes": 300}),  # stores integers
        *((2, {"leaf": leaf, "max_leaves": 10}) for leaf in leaf_names() if leaf != "cone"),
    ]
    plrs = [construct(distance, Box([0.0] * dim, [1.0] * dim), **options) for dim, options in kinds]
    turned = ReedsShepp((0.1, 0.2, 0.4), 1), Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
    plrs += [plrs[0].with_label("room"), construct(*turned, max_leaves=6)]
    first = plr_jax.VisibilityGraph(Workspace(((0, 0), (8, 8)), [_SQUARE]), (6, 1))
    exits = plr_jax.NearestGoal([first, first.with_goal((1, 7)), first.with_goal((7, 7))])
    plrs += [construct(exits, first.workspace.bounds, leaf="cone", max_leaves=20, certified=True)]
    return [plr.to_bytes() for plr in plrs]


def _pairs_files() -> list[bytes]:
    small = plr_jax.construct_pairs(scenes.maze().workspace, max_bytes=600)
    return [small.to_bytes(), serpentine(8192).to_bytes()]


def _picture_files() -> list[bytes]:
    gray = np.full((12, 16), 255, np.uint8)
    gray[3:5, 4:] = gray[8:, 6] = 0
    modes = {"PNG": ("L", "RGBA"), "GIF": ("P",), "PPM": ("1", "L"), "BMP": ("RGB",), "TIFF": ("L",)}

    def written(kind: str, mode: str) -> bytes:
        buffer = io.BytesIO()
        Image.fromarray(gray).convert(mode).save(buffer, format=kind)
        return buffer.getvalue()

    return [written(kind, mode) for kind in modes for mode in modes[kind]]


def _with_checksums(data: bytes) -> bytes:
    """Repair the checksums of all chunks if a picture is a PNG."""
    result, rest = data[:8], data[8:]
    if result != b"\x89PNG\r\n\x1a\n":
        return data
    while len(rest) >= 12:
        size = min(int.from_bytes(rest[:4], "big"), len(rest) - 12)
        chunk, rest = rest[4 : 8 + size], rest[12 + size :]
        result += struct.pack(">I", size) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return result


def _with_checksum(data: bytes) -> bytes:
    """Repair the checksums of the layers of a PLR file, as far as its header says where they end."""
    try:
        header = Header.read(data)
    except ValueError:
        return data
    start, crc = len(header.data), zlib.crc32(header.data)
    for end in (*(mark for mark in header.marks if mark < len(data)), len(data)):
        crc = zlib.crc32(data[start : max(start, end - _CRC.size)], crc)
        if start + _CRC.size <= end:
            data = data[: end - _CRC.size] + _CRC.pack(crc) + data[end:]
        start = end
    return data


_MAP_SERVER = "image: room.pgm\nresolution: 0.05\norigin: [-1.5, 2.0, 0.25]\nnegate: 0\n"
_MAP_SERVER += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


_MODES = ("trinary", "scale", "raw")
_PICTURE = b"P5 6 5 255 " + bytes(6) + (b"\0" + b"\xff" * 3 + b"\x90\0") * 4


def _cost_map_of(mode: str) -> bytes:
    return f"{_MAP_SERVER.replace('0.25', '0.0')}mode: {mode}\n".encode()


def _with_picture(read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """Wrap a reader of map files so that it finds the picture in the folder of the file."""

    def reader(path: Path) -> Any:
        path.with_name("room.pgm").write_bytes(_PICTURE)
        return read(path)

    return reader


def _read_cost_map_of_picture(path: Path) -> Any:
    """Read a picture as a cost map, in a mode that depends on the file size."""
    mode = _MODES[path.stat().st_size % len(_MODES)]
    file = path.with_name(f"{path.name}.yaml")
    file.write_bytes(_cost_map_of(mode).replace(b"room.pgm", path.name.encode()))
    try:
        return scenes.read_cost_map(file)
    finally:
        file.unlink()


def _building_files() -> list[bytes]:
    return _written(scenes.save_building, [two_floors()])


def _plr_of_building_files() -> list[bytes]:
    return [two_floors().oracle(*GOAL).construct(max_bytes=500, certified=True).to_bytes()]


def _grid_pairs_files() -> list[bytes]:
    free = np.random.default_rng(0).random((20, 30)) < 0.8
    graphs = [plr_jax.GridGraph(free, connectivity=connectivity) for connectivity in (4, 8)]
    return [plr_jax.construct_grid_pairs(graph).to_bytes() for graph in graphs]


def _with_size_and_checksum(data: bytes) -> bytes:
    """Repair the size in the header and the checksum of a file of a grid."""
    size = 18  # bytes of the header, which ends with the size of the file
    data = data[: size - _CRC.size] + _CRC.pack(len(data)) + data[size : -_CRC.size]
    return data + _CRC.pack(zlib.crc32(data))


def _pairs_of_building_files() -> list[bytes]:
    return [plr_jax.construct_pairs(two_floors(), max_bytes=600).to_bytes()]


def _with_inner_checksum(data: bytes) -> bytes:
    start = data.find(MAGIC)
    return data if start < 0 else data[:start] + _with_checksum(data[start:])


READERS = {
    "scene": Reader(scenes.load, ".json", _scene_files),
    "solution": Reader(plr_jax.Solution.load, ".json", _solution_files),
    "polygons": Reader(scenes.read_polygons, ".json", lambda: [json.dumps(_POLYGONS).encode()]),
    "map": Reader(scenes.read_map, ".map", lambda: [_GRID.encode()]),
    "GeoJSON": Reader(scenes.read_geojson, ".geojson", lambda: [_GEOJSON.encode()]),
    "WKT": Reader(scenes.read_wkt, ".wkt", lambda: [_WKT.encode()]),
    "picture": Reader(scenes.read_image, ".png", _picture_files, _with_checksums),
    "map_server": Reader(_with_picture(scenes.read_map_server), ".yaml", lambda: [_MAP_SERVER.encode()]),
    "cost map": Reader(_with_picture(scenes.read_cost_map), ".yaml", lambda: [*map(_cost_map_of, _MODES)]),
    "picture of costs": Reader(_read_cost_map_of_picture, ".pgm", _picture_files, _with_checksums),
    "array": Reader(scenes.read_volume, ".npy", array_files, bytes),
    "voxels": Reader(scenes.read_volume, ".3dmap", lambda: [VOXELS.encode()]),
    "PLR": Reader(plr_jax.load, ".plr", _plr_files, _with_checksum),
    "NumPy": Reader(plr_jax.load_numpy, ".plr", _plr_files, _with_checksum),
    "building": Reader(scenes.read_building, ".json", _building_files),
    "PLR of a building": Reader(plr_jax.load, ".building", _plr_of_building_files, _with_inner_checksum),
    "pairs of a building": Reader(plr_jax.load, ".building", _pairs_of_building_files, _with_inner_checksum),
    "pairs of a grid": Reader(plr_jax.load, ".grid", _grid_pairs_files, _with_size_and_checksum),
    "pairs": Reader(plr_jax.load, ".plr", _pairs_files, _with_checksum),
}
