"""Distances between all pairs of cells of a grid: queries, the file (``FORMAT.md``), and C code."""

import re
import struct
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int32, UInt8

from plr_jax._arrays import as_finite_point, as_numbers, require_integer, shortened
from plr_jax._compiled import broadcast_shape, is_on_one_host, pytree
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.pairs import grid_query
from plr_jax.pairs.grid_corners import DIAGONAL, FAR, STRAIGHT, CornerTable
from plr_jax.pairs.grid_query import BLOCK, GROUP, SLACK, GridTables, corners_from, tables_of
from plr_jax.pairs.grid_window import distances_around
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.container import GRID_MAGIC
from plr_jax.plr.portable.writers import require_identifier

MOST_CELLS = 2**22  # of a grid
_VERSION = 1  # of the file format
_HEADER = struct.Struct("<4sBBIII")  # magic, version, connectivity, rows, columns, size of the file in bytes
_CRC = struct.Struct("<I")
_ALIGNED = 64  # bytes to which tables of the C file are aligned
_TEMPLATE = Path(__file__).with_name("grid_pairs.h")  # sections after lines "@@ name", with marks "@NAME@"
_C_MAGIC = b"plr_jax grid 1\n\0"


def encode_grid(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> bytes:
    """Return the bytes of a grid's file: header, one bit for each cell (entropy-coded), checksum (``FORMAT.md``)."""
    # The bits tell which cells differ from the cell above, so most are 0.
    body = BitWriter().write_set(np.diff(free, axis=0, prepend=False).ravel()).to_bytes()
    size = _HEADER.size + len(body) + _CRC.size
    data = _HEADER.pack(GRID_MAGIC, _VERSION, connectivity, *free.shape, size) + body
    return data + _CRC.pack(zlib.crc32(data))


def decode_grid(data: bytes) -> tuple[Bool[np.ndarray, "rows columns"], int]:
    """Decode a grid's file: which cells are free, and the connectivity; ``ValueError`` if the data are invalid."""
    if not data.startswith(GRID_MAGIC):
        raise ValueError("it does not start like a file of pairs of a grid")
    if len(data) < _HEADER.size + _CRC.size:
        raise ValueError("the data end too early")
    _, version, connectivity, rows, columns, size = _HEADER.unpack_from(data)
    if version != _VERSION:
        raise ValueError(f"it has format version {version}, this release reads version {_VERSION}")
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, its header states {size}: the file is truncated or corrupt")
    if zlib.crc32(data[: -_CRC.size]) != _CRC.unpack(data[-_CRC.size :])[0]:
        raise ValueError("its checksum does not match: the file is corrupt")
    if connectivity not in STRAIGHT:
        raise ValueError(f"it states a connectivity of {connectivity}, not 4 or 8")
    if not 0 < rows * columns <= MOST_CELLS:
        raise ValueError(f"it states {rows} x {columns} cells, not 1 to {MOST_CELLS}")
    body = BitReader(data[_HEADER.size : -_CRC.size])
    differs_from_above = body.read_set(rows * columns).reshape(rows, columns)
    body.require_end("its cells need")
    return np.logical_xor.accumulate(differs_from_above, axis=0), connectivity


class GridHeader(NamedTuple):
    """C code for a grid: the ``text`` of a C header, and ``table``, the bytes of the file that the code reads."""

    text: str
    table: bytes


@pytree
class DistanceToCell:
    """The distance to one cell of a grid as a function of points, made by :meth:`GridPairs.to`."""

    tables: GridTables
    goal: Int[Array, "2"]  # row and column of the cell
    from_goal: Int32[Array, " corners"]  # lengths of shortest paths to the corners of obstacles, in units
    dim: ClassVar[int] = 2
    is_lower_bound: ClassVar[bool] = True

    @property
    def domain(self) -> Box:
        """The box of all cells."""
        return Box((0, 0), self.tables.shape[::-1])

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Return distances ``(...)`` in steps from the cells of points ``(..., 2)`` to the goal cell.

        The result is bit for bit that of :class:`GridPairs`.
        """
        return grid_query.evaluate_to(self.tables, self.from_goal, self.goal, _as_points("x", x))


@pytree
class GridPairs:
    """Lengths of shortest paths between any two cells of a grid, never above the truth.

    Made by :func:`construct_grid_pairs`: a pytree of arrays, which a jitted function can close over or take as an
    argument. Answers are exact on 4-connected grids. On 8-connected grids they are rounded down, by less than a
    millionth; whole numbers of straight steps are exact. ``plr_jax/pairs/GRIDS.md`` has the proof. The ``file``,
    which :func:`save` writes, holds only the map, in 3 to 20 kilobytes for the maps of ``experiments/fleets``. On
    loading, the ``tables`` that a query reads are built again, in the time of a construction.
    """

    tables: GridTables
    file: UInt8[Array, "bytes"] | UInt8[np.ndarray, "bytes"]

    def __repr__(self) -> str:
        rows, columns = self.tables.shape
        return f"GridPairs({rows} x {columns} cells, {self.tables.connectivity}-connected, {self.num_bytes} bytes)"

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Return lengths of shortest paths between the cells of points; diagonal steps (if any) count ``sqrt(2)``.

        Lengths are in steps. The shapes of points ``x`` and ``y``, ``(..., 2)``, must broadcast, else ``ValueError``.
        The cell in row ``r`` and column ``c`` has the points ``(a, b)`` with ``c <= a < c + 1`` and
        ``r <= b < r + 1``. Lengths, ``(...)``, are symmetric bit for bit, and 0 within a cell. They are ``inf`` if no
        path joins the cells, a cell is blocked, or a point is outside the grid or NaN. For many points, a function is
        compiled for each shape of the arrays.
        """
        points = _as_points("x", x), _as_points("y", y)
        shape = broadcast_shape("x and y", *points)
        if is_on_one_host(*points, self.tables.blocks):  # NumPy answers few pairs without compiling
            few = grid_query.evaluate_few(self.tables, *(np.broadcast_to(np.asarray(p), shape) for p in points))
            if few is not None:
                return jax.numpy.asarray(few)
        return grid_query.evaluate_pairs(self.tables, *(jax.numpy.broadcast_to(p, shape) for p in points))

    def bounds(self, x: ArrayLike, y: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return proven lower and upper bounds, ``(...)`` each, of the lengths of shortest paths.

        Points are given as for a call. The lower bound is the answer of a call. On 4-connected grids, the upper bound
        equals the lower bound. On 8-connected grids, the upper bound is ``1 + 2**-20`` times the lower bound, which
        covers all rounding.
        """
        lower = self(x, y)
        return lower, lower if self.tables.connectivity == 4 else lower * (1 + SLACK)

    def window(self, goals: ArrayLike, positions: ArrayLike, radius: int) -> Int32[Array, "n width width"]:
        """Return the path length to each agent's goal from all cells of a square around the agent, in whole steps.

        The result has the axes agent, row (along ``y``) and column: ``(n, 2 radius + 1, 2 radius + 1)``. Lengths are
        rounded down. They are -1 in blocked cells, outside the grid, without a path, and in all cells if the agent or
        the goal is outside the grid. The method works inside jitted functions. It compiles once for each number of
        agents and each radius.

        Args:
            goals: A point in the goal cell of each agent, ``(n, 2)``, else ``ValueError``.
            positions: A point in the cell of each agent, ``(n, 2)``.
            radius: Cells on each side of an agent, an integer of at least 0, else ``ValueError``.
        """
        require_integer("radius", radius, 0)
        goals, positions = _as_points("goals", goals), _as_points("positions", positions)
        if goals.ndim != 2 or goals.shape != positions.shape:
            expected = "goals and positions must be points (x, y), (n, 2) both"
            raise ValueError(f"{expected}, got {goals.shape} and {positions.shape}.")
        if not len(goals):
            return jax.numpy.zeros((0, 2 * int(radius) + 1, 2 * int(radius) + 1), jax.numpy.int32)
        return distances_around(self.tables, goals, positions, radius=int(radius))

    def to(self, goal: ArrayLike) -> DistanceToCell:
        """Return the distance function of one goal, a point ``(2,)`` in a free cell, else ``ValueError``."""
        goal = as_finite_point("The goal", goal, 2)
        if not np.isfinite(self(goal, goal)):
            raise ValueError(f"The goal must be in a free cell of the grid, got {goal.tolist()}.")
        cell = jax.numpy.asarray(np.floor(goal)[::-1].astype(np.int32))
        return DistanceToCell(self.tables, cell, corners_from(self.tables, cell))

    @property
    def domain(self) -> Box:
        """The box of all cells."""
        return Box((0, 0), self.tables.shape[::-1])

    @property
    def num_bytes(self) -> int:
        """Size of the file that :func:`save` writes."""
        return len(self.file)

    @property
    def resident_bytes(self) -> int:
        """Bytes of the arrays that a query reads."""
        return sum(table.nbytes for table in jax.tree_util.tree_leaves(self.tables))

    @property
    def num_corners(self) -> int:
        """Number of obstacle corners at which paths may bend."""
        return len(self.tables.row)

    def to_bytes(self) -> bytes:
        """Return the bytes of the file, documented in ``plr_jax/pairs/FORMAT.md``."""
        return np.asarray(self.file).tobytes()

    def c_header(self, name: str) -> GridHeader:
        """Return C99 code, also valid C++, that answers the same queries, and the file of tables that it reads.

        ``int32_t NAME_steps(uint32_t from, uint32_t to)`` takes cells by their indices in row-major order. A program
        maps the file into memory (``mmap``) or reads it, and passes the bytes to ``NAME_open``. The code allocates
        nothing and is safe in threads. ``name``, a C identifier (else ``ValueError``), replaces NAME in all
        definitions.
        """
        require_identifier(name)
        tables, distances = self.tables, self.tables.distances
        names = "free", "sums", "group_block", "cell_block", "blocks", "row", "column"
        arrays = {key: getattr(tables, key) for key in names}
        arrays |= {field.name: getattr(distances, field.name) for field in fields(distances)}
        # 1. Write the file of tables, little-endian and aligned, and a C function that reads each table.
        file, accessors = _C_MAGIC, []
        for table_name, array in arrays.items():
            data = np.ascontiguousarray(np.asarray(array)).astype(array.dtype.newbyteorder("<"))
            file += bytes(-len(file) % _ALIGNED)
            c_type = f"{'u' if data.dtype.kind == 'u' else ''}int{8 * data.dtype.itemsize}_t"
            value = f"((const {c_type} *)(const void *)({name}_data + {len(file)}u))[i]"
            accessors += [f"static inline int32_t {name}_{table_name}(uint32_t i)", f"{{ return (int32_t){value}; }}"]
            file += data.tobytes()
        file += zlib.crc32(file).to_bytes(4, "little")
        # 2. Write the text: sections of the template, with marks replaced by constants of the grid.
        template = _TEMPLATE.read_text(encoding="utf-8")
        sections = dict(re.findall(r"^@@ ([\w ]+)\n(.*?)(?=^@@|\Z)", template, re.M | re.S))
        group_block, cell_block = np.asarray(tables.group_block), np.asarray(tables.cell_block)
        first_block = group_block[np.arange(len(cell_block)) // GROUP] + cell_block  # of each cell
        rows, columns = tables.shape
        sight, kind = f"sight {tables.connectivity}", "table" if isinstance(distances, CornerTable) else "labels"
        centers = len(distances.between_centers) if isinstance(distances, CornerTable) else 0
        most = BLOCK * max(int(np.diff(first_block).max()), 1)  # corners of a cell
        crc = int.from_bytes(file[-4:], "little")
        # Sections of the template come first: they have marks, too.
        marks: dict[str, Any] = {"SIGHT": sections[sight], "DISTANCES": sections[f"distances by {kind}"]}
        marks |= {"ARRAYS": "\n".join(accessors), "SIZE": f"{len(file):,}", "BYTES": len(file), "CRC": crc}
        marks |= {"ROWS": rows, "COLUMNS": columns, "CELLS": rows * columns, "CONNECTIVITY": tables.connectivity}
        marks |= {"CENTERS": centers, "MOST": most, "BLOCK": BLOCK, "GROUP": GROUP, "NAME": name}
        marks |= {"FAR": FAR, "UNIT": STRAIGHT[tables.connectivity], "DIAGONAL": DIAGONAL[tables.connectivity]}
        text = sections["header"]
        for mark, value in marks.items():
            text = text.replace(f"@{mark}@", str(value))
        return GridHeader(text, file)

    @staticmethod
    def from_bytes(data: bytes) -> "GridPairs":
        """Restore a GridPairs, with bit for bit the same answers, from the result of :meth:`to_bytes`.

        This takes as long as construction. An interrupt (Ctrl-C) discards the work. ``ValueError`` if the bytes are
        truncated, corrupt or of another kind, or as for :func:`construct_grid_pairs`.
        """
        if not isinstance(data, bytes | bytearray | memoryview):
            raise ValueError(f"The bytes of a file are expected, got {shortened(data)}.")
        data = bytes(data)
        return GridPairs(tables_of(*decode_grid(data)), np.frombuffer(data, np.uint8))


def construct_grid_pairs(graph: ArrayLike) -> GridPairs:
    """Build a function of the distance between any two cells of a grid.

        pairs = plr_jax.construct_grid_pairs(free)
        pairs(x, y)  # path lengths (n,) between the cells of points x and y, both (n, 2); a diagonal step has sqrt(2)

    ``graph`` is a :class:`GridGraph`, with or without a goal, or an array of booleans ``(rows, columns)``, True in
    free cells, for a 4-connected grid. A game map of 2.2 million free cells takes 5 s and 1.0 GB of memory, or 15 s
    and 1.4 GB if it is 8-connected. ``plr_jax/pairs/GRIDS.md`` has the method. An interrupt (Ctrl-C) raises
    ``KeyboardInterrupt``. ``ValueError`` if ``graph`` is not a grid, lets paths squeeze, has more than 2**22 cells or
    (if 8-connected) paths of over a million steps, or if its obstacles have too many corners for a table of 2**30
    bytes or for a construction within minutes.
    """
    from plr_jax.oracles import GridGraph  # imports Shapely, which queries do not need

    if not isinstance(graph, GridGraph):
        try:
            graph = GridGraph(graph)
        except ValueError as error:
            raise ValueError(f"graph must be a grid, such as GridGraph(free), or its free cells. {error}") from error
    if graph.squeeze:
        reason = "its paths turn at other corners than those of the tables"
        raise ValueError(f"graph must not have squeeze=True: {reason}.")
    if graph.free.size > MOST_CELLS:
        raise ValueError(f"graph must have at most {MOST_CELLS} cells, got {graph.free.size}.")
    tables = tables_of(graph.free, graph.connectivity)
    return GridPairs(tables, np.frombuffer(encode_grid(graph.free, graph.connectivity), np.uint8))


def _as_points(name: str, x: ArrayLike) -> Array | np.ndarray:
    """Check and return points ``(..., 2)``; coordinates are rounded down to integers unless in a JAX array."""
    if not isinstance(x, jax.Array):
        # Round down before numbers become 32-bit. Both limits are outside of every grid.
        x = np.clip(np.floor(as_numbers(name, x, "points (..., 2)")), -1, MOST_CELLS)
    elif jax.numpy.iscomplexobj(x):
        raise ValueError(f"{name} must be points (..., 2) of real numbers, got an array of {x.dtype}.")
    if x.shape[-1:] != (2,):
        raise ValueError(f"{name} must have shape (..., 2), got {x.shape}.")
    return x
