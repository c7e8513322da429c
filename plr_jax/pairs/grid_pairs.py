"""Distances between all pairs of cells of a grid."""

import os
import struct
import zlib
from concurrent.futures import Executor
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int32, UInt8

from plr_jax._arrays import as_finite_point, as_numbers, require_integer, shortened
from plr_jax._types import ArrayLike, CellGraph
from plr_jax.geometry.box import Box
from plr_jax.pairs.grid_corners import CONNECTIVITIES, MOST_BYTES, TablesTooLarge
from plr_jax.pairs.grid_header import GridHeader, grid_header
from plr_jax.pairs.grid_landmarks import (
    MOST_LANDMARKS,
    LandmarkTables,
    bounds_around,
    evaluate_bounds,
    landmark_tables,
    landmarks_within,
)
from plr_jax.pairs.grid_query import (
    SLACK,
    GridTables,
    corners_from,
    distances_around,
    evaluate_pairs,
    evaluate_to,
    tables_of,
)
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.container import GRID_MAGIC
from plr_jax.plr.work import as_executor, require_path

# The file of the distances between all pairs of cells of a grid: the grid, and how many landmarks bound them if they
# are not exact, from which all else follows.
#
# All numbers are little-endian:
#
#     4s      magic, b"PGP\n"
#     u8      version: 1, or 2 if distances are bounded by landmarks
#     u8      connectivity, 4 or 8
#     u32     number of rows
#     u32     number of columns
#     u32     size of the whole file in bytes
#     u32     number of landmarks of each part of the grid; not in version 1
#     ...     bit stream, see ``plr/coding.py``: the set of the cells that differ from the one above, in row-major
#             order; above the first row all are blocked
#     u32     CRC-32 of all bytes before


MOST_CELLS = 2**22
"""Cells of the largest grid."""

_EXACT, _BOUNDED = 1, 2  # versions
_HEADER, _NUMBER, _CRC = struct.Struct("<4sBBIII"), struct.Struct("<I"), struct.Struct("<I")


def encode_grid(free: Bool[np.ndarray, "rows columns"], connectivity: int, num_landmarks: int = 0) -> bytes:
    """The bytes of a grid's file; without landmarks if distances are exact."""
    body = BitWriter().write_set(np.diff(free, axis=0, prepend=False).ravel()).to_bytes()
    version, body = (_BOUNDED, _NUMBER.pack(num_landmarks) + body) if num_landmarks else (_EXACT, body)
    size = _HEADER.size + len(body) + _CRC.size
    data = _HEADER.pack(GRID_MAGIC, version, connectivity, *free.shape, size) + body
    return data + _CRC.pack(zlib.crc32(data))


def decode_grid(data: bytes) -> tuple[Bool[np.ndarray, "rows columns"], int, int]:
    """What a file's bytes hold, as it was encoded; raises ``ValueError`` saying what is wrong."""
    if not data.startswith(GRID_MAGIC):
        raise ValueError("it does not start like a file of pairs of a grid")
    if len(data) < _HEADER.size + _CRC.size:
        raise ValueError("the data end too early")
    _, version, connectivity, rows, columns, size = _HEADER.unpack_from(data)
    if version not in (_EXACT, _BOUNDED):
        raise ValueError(f"it has format version {version}, this release reads versions {_EXACT} and {_BOUNDED}")
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, its header states {size}: the file is truncated or corrupt")
    if zlib.crc32(data[: -_CRC.size]) != _CRC.unpack(data[-_CRC.size :])[0]:
        raise ValueError("its checksum does not match: the file is corrupt")
    if connectivity not in CONNECTIVITIES:
        raise ValueError(f"it states a connectivity of {connectivity}, not 4 or 8")
    if not 0 < rows * columns <= MOST_CELLS:
        raise ValueError(f"it states {rows} x {columns} cells, not 1 to {MOST_CELLS}")
    rest, num_landmarks = data[_HEADER.size : -_CRC.size], 0
    if version == _BOUNDED:
        if len(rest) < _NUMBER.size:
            raise ValueError("the data end too early")
        (num_landmarks,), rest = _NUMBER.unpack_from(rest), rest[_NUMBER.size :]
        if not 0 < num_landmarks <= MOST_LANDMARKS:
            raise ValueError(f"it states {num_landmarks} landmarks, not 1 to {MOST_LANDMARKS}")
    body = BitReader(rest)
    differs = body.read_set(rows * columns).reshape(rows, columns)
    if not body.at_end():
        raise ValueError("it holds more data than its cells need")
    free = np.logical_xor.accumulate(differs, axis=0)
    if num_landmarks and not 0 < 2 * num_landmarks * np.count_nonzero(free) <= MOST_BYTES:
        raise ValueError(f"it states {num_landmarks} landmarks of {np.count_nonzero(free)} free cells")
    return free, connectivity, num_landmarks


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class DistanceToCell:
    """Distance to one cell of a grid, a `DistanceFn`; made by :meth:`GridPairs.to`.

    Attributes:
        tables: Those of all pairs.
        goal: Row and column of the cell.
        from_goal: Distance of each corner to it, in units, by way of corners; of none if distances are bounds.
    """

    tables: GridTables | LandmarkTables
    goal: Int[Array, "2"]
    from_goal: Int32[Array, "corners"]

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return 2

    @property
    def domain(self) -> Box:
        """The box of all cells."""
        return _box_of(self.tables)

    @property
    def is_lower_bound(self) -> bool:
        """True: it is never above the distance over the grid."""
        return True

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """What :meth:`GridPairs.__call__` answers with the goal, bit for bit.

        Args:
            x: Points, ``(..., 2)``.

        Returns:
            Distances in steps, ``(...)``; ``inf`` as there.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = _as_points("x", x)
        if isinstance(self.tables, LandmarkTables):
            return evaluate_bounds(self.tables, x, jax.numpy.broadcast_to(self.goal[::-1], x.shape), above=False)
        return evaluate_to(self.tables, self.from_goal, self.goal, x)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GridPairs:
    """Length of a shortest path between any two cells of a grid, never above the truth.

    Made by :func:`construct_grid_pairs`. Its file holds the map alone, in one or two kilobytes where the map has a
    quarter of a million cells; corners of obstacles, their distances, and lists of the corners of each cell follow
    from it when it is loaded, in as much time as building took: a second, or some of two million cells; with
    landmarks, as their searches take one after the other. On
    4-connected grids answers are exact. On 8-connected ones they are as exact as 32-bit floats, always rounded down,
    by less than 1e-6 of themselves; whole numbers of straight steps are exact. ``plr_jax/pairs/GRIDS.md`` has the
    proof.

    Where exact tables take more bytes than allowed, answers are lower bounds instead, and ``num_landmarks`` is not 0:
    the largest difference of the distances to landmarks (a differential heuristic), at least the distance without
    obstacles. They are exact of cells that see each other, and still ``inf`` where no path joins the cells. They are
    consistent: a step changes them by its length at most, or, of grids whose paths are longer than 32,767 steps or
    that are 8-connected, by that and what 16 bits round, under 1/30,000 of the longest path.

    It is a pytree of arrays: a jitted function can close over it or take it as an argument.

    Attributes:
        tables: What a query reads.
        file: The bytes that :func:`save` writes.
    """

    tables: GridTables | LandmarkTables
    file: UInt8[Array, "bytes"] | UInt8[np.ndarray, "bytes"]

    def __repr__(self) -> str:
        rows, columns = self.tables.shape
        bounds = f", bounds by {self.num_landmarks} landmarks" if self.num_landmarks else ""
        connectivity = f"{self.tables.connectivity}-connected"
        return f"GridPairs({rows} x {columns} cells, {connectivity}, {self.num_bytes} bytes{bounds})"

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Number of steps, or length, of a shortest path between the cells of points, or its lower bound.

        Symmetric bit for bit, and 0 within a cell. A function is compiled for each shape of points.

        Args:
            x: Points, ``(..., 2)``; the cell in row ``r`` and column ``c`` has those with ``c <= x < c + 1`` and
                ``r <= y < r + 1``.
            y: Points that broadcast against them.

        Returns:
            Distances, ``(...)``. ``inf`` if no path joins the cells, one is blocked, or
            a point is outside the grid or has a NaN.

        Raises:
            ValueError: If the shapes do not fit.
        """
        points = _as_points("x", x), _as_points("y", y)
        try:
            shape = np.broadcast_shapes(*(one.shape for one in points))
        except ValueError:
            raise ValueError(f"x and y must be of one shape, got {points[0].shape} and {points[1].shape}.") from None
        points = [jax.numpy.broadcast_to(one, shape) for one in points]
        if isinstance(self.tables, LandmarkTables):
            return evaluate_bounds(self.tables, *points, above=False)
        return evaluate_pairs(self.tables, *points)

    def bounds(self, x: ArrayLike, y: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Proven bounds of the length of a shortest path: what is answered, and above it what rounding may take off.

        With landmarks the upper bound is the shortest way over one of them, far above the distance of cells that are
        near each other and not near one.

        Args:
            x: Points, as for a call.
            y: Points that broadcast against them.

        Returns:
            Lower and upper bounds, ``(...)`` each; equal on 4-connected grids without landmarks.

        Raises:
            ValueError: As for a call.
        """
        lower = self(x, y)
        if isinstance(self.tables, LandmarkTables):
            points = (jax.numpy.broadcast_to(_as_points("", one), (*lower.shape, 2)) for one in (x, y))
            upper = evaluate_bounds(self.tables, *points, above=True)
            return lower, upper if self.tables.connectivity == 4 else upper * (1 + SLACK)
        return lower, lower if self.tables.connectivity == 4 else lower * (1 + SLACK)

    def window(self, goals: ArrayLike, positions: ArrayLike, radius: int) -> Int32[Array, "n width width"]:
        """Steps to goals from all cells around agents, as many rows and columns to each side as ``radius``.

        Of pairs with landmarks, their lower bounds.

        A function is compiled for each number of agents and radius. It may be called in jitted functions.

        Args:
            goals: A point of the goal's cell of each agent, ``(n, 2)``.
            positions: A point of the cell that each agent is in, ``(n, 2)``.
            radius: Cells to each side, at least 0.

        Returns:
            Distances, ``(n, 2 radius + 1, 2 radius + 1)``, by rows and columns, in steps; of 8-connected grids
            rounded down to whole ones. -1 in cells from which no path leads to the goal: blocked ones, those outside
            the grid, and all where the agent is outside of it, or the goal is or is blocked.

        Raises:
            ValueError: If the points have other shapes, or the radius is no such number.
        """
        require_integer("radius", radius, 0)
        goals, positions = _as_points("goals", goals), _as_points("positions", positions)
        if goals.ndim != 2 or goals.shape != positions.shape:
            raise ValueError(f"goals and positions must be (n, 2) both, got {goals.shape} and {positions.shape}.")
        if not len(goals):
            return jax.numpy.zeros((0, 2 * int(radius) + 1, 2 * int(radius) + 1), jax.numpy.int32)
        if isinstance(self.tables, LandmarkTables):
            return bounds_around(self.tables, goals, positions, radius=int(radius))
        return distances_around(self.tables, goals, positions, radius=int(radius))

    def to(self, goal: ArrayLike) -> DistanceToCell:
        """Distances to one cell, several times as fast a query where they are exact.

        Args:
            goal: A point of the cell, ``(2,)``.

        Returns:
            The distance function.

        Raises:
            ValueError: If the goal is in no free cell.
        """
        goal = as_finite_point("The goal", goal, 2)
        if not np.isfinite(self(goal, goal)):
            raise ValueError(f"The goal must be in a free cell of the grid, got {goal.tolist()}.")
        cell = jax.numpy.asarray(np.floor(goal)[::-1].astype(np.int32))
        if isinstance(self.tables, LandmarkTables):
            return DistanceToCell(self.tables, cell, jax.numpy.zeros(0, jax.numpy.int32))
        return DistanceToCell(self.tables, cell, corners_from(self.tables, cell))

    @property
    def domain(self) -> Box:
        """The box of all cells."""
        return _box_of(self.tables)

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
        """Number of corners of obstacles between which distances are kept; 0 with landmarks."""
        return 0 if isinstance(self.tables, LandmarkTables) else len(self.tables.row)

    @property
    def num_landmarks(self) -> int:
        """Number of landmarks that each part of the grid has; 0 if distances are exact."""
        return self.tables.num_landmarks if isinstance(self.tables, LandmarkTables) else 0

    def to_bytes(self) -> bytes:
        """The bytes of the file, documented in ``plr_jax/pairs/grid_pairs.py``."""
        return np.asarray(self.file).tobytes()

    def c_header(self, name: str) -> GridHeader:
        """Code of C99, also valid C++, that answers as this does, and the file of tables that it reads.

        ``int32_t NAME_steps(uint32_t from, uint32_t to)`` takes cells by their numbers in row-major order. Programs
        map the file (``mmap``) or read it, and give its bytes to ``NAME_open``. Nothing is allocated, and threads
        may ask at once.

        Args:
            name: With which all that the header defines begins, an identifier of C.

        Returns:
            The ``text`` of the header, and the bytes of its ``table``.

        Raises:
            ValueError: If the name is no identifier, or distances are bounds by landmarks.
        """
        if isinstance(self.tables, LandmarkTables):
            raise ValueError("C is written of exact distances, and these are bounds: allow more max_bytes.")
        return grid_header(self.tables, name)

    @staticmethod
    def from_bytes(data: bytes) -> "GridPairs":
        """What :meth:`to_bytes` gave; it answers alike, bit for bit.

        This takes as long as construction, of landmarks with one process. If interrupted (Ctrl-C), there is nothing.

        Args:
            data: The bytes.

        Returns:
            The distances of pairs.

        Raises:
            ValueError: If the bytes are truncated, corrupt, or none of such a file, or as for
                :func:`construct_grid_pairs`.
        """
        if not isinstance(data, bytes | bytearray | memoryview):
            raise ValueError(f"The bytes of a file are expected, got {shortened(data)}.")
        data = bytes(data)
        free, connectivity, num_landmarks = decode_grid(data)
        if num_landmarks:
            return GridPairs(landmark_tables(free, connectivity, num_landmarks), np.frombuffer(data, np.uint8))
        return GridPairs(tables_of(free, connectivity), np.frombuffer(data, np.uint8))


def construct_grid_pairs(
    graph: CellGraph | ArrayLike,
    *,
    max_bytes: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> GridPairs:
    """Distances between all pairs of cells of a grid.

    Of two million cells of a game's map that takes some seconds, and a gigabyte; most of it goes with the number of
    cells times that of corners which each is taut at. Up to 2**14 corners of obstacles all distances between these
    are kept; of more, as mazes have, those that narrow passages leave over. Where that is too much, ``max_bytes``
    gives proven bounds.

    Args:
        graph: The grid, such as a :class:`GridGraph`, with or without a goal; at most 2**22 cells. Or which cells are
            free, ``(rows, columns)``, of a 4-connected one.
        max_bytes: Most bytes of the arrays that a query reads (``resident_bytes``); the file has the map alone. If
            exact tables take more, or one of them more than 2**30, there are lower and upper bounds, by as many
            landmarks as there is room for, 2 bytes each a free cell, up to 1,024. None: exact.
        executor: What searches from landmarks, four at once: threads, processes, a cluster's, such as Dask's
            ``Client.get_executor()``. Any gives the same tables. Of exact ones nothing takes so long that processes
            would gain. None: threads, which SciPy lets search one after the other.
        checkpoint: A file in which distances from landmarks are kept as they are found, 2 bytes a free cell each.
            Called again with the same arguments, construction goes on with what is left, even if the process was
            killed, to the same tables and the same file. Of exact tables nothing is kept. None: none.

    Returns:
        The distances, a pytree. If interrupted (Ctrl-C), there are none, and ``KeyboardInterrupt`` is raised.

    Raises:
        ValueError: If ``graph`` is no grid, or has more than 2**22 cells, paths of an 8-connected one are longer than
            a million steps, or may be longer than half a million where distances are bounds, ``max_bytes`` has room
            for neither exact tables nor one landmark, the checkpoint is of other work, or without ``max_bytes`` exact
            tables would take more bytes, or minutes.
        OSError: If the checkpoint cannot be read or written.

    References:
        See ``plr_jax/pairs/GRIDS.md``.
    """
    if not isinstance(graph, CellGraph):
        from plr_jax.oracles import GridGraph  # and with it Shapely, which queries need not

        try:
            graph = GridGraph(graph)
        except ValueError as error:
            message = f"graph must be a grid, such as GridGraph(free), or its free cells, got {shortened(graph)}."
            raise ValueError(message) from error
    if graph.free.size > MOST_CELLS:
        raise ValueError(f"graph must have at most {MOST_CELLS} cells, got {graph.free.size}.")
    if checkpoint is not None:
        require_path(checkpoint)
    executor = as_executor(executor)
    most_bytes, exact_bytes = MOST_BYTES, None
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
        most_bytes = min(int(max_bytes), MOST_BYTES)
    try:
        tables = tables_of(graph.free, graph.connectivity, most_bytes)
        pairs = GridPairs(tables, np.frombuffer(encode_grid(graph.free, graph.connectivity), np.uint8))
        exact_bytes = pairs.resident_bytes
        if max_bytes is None or exact_bytes <= max_bytes:
            return pairs
        if not graph.free.any():
            raise ValueError(f"max_bytes must be at least {exact_bytes} for this grid, got {max_bytes}.")
        del tables, pairs
    except TablesTooLarge:
        if max_bytes is None:
            raise
    num_landmarks = landmarks_within(graph.free, graph.connectivity, int(max_bytes), exact_bytes)
    data = encode_grid(graph.free, graph.connectivity, num_landmarks)
    tables = landmark_tables(graph.free, graph.connectivity, num_landmarks, executor, checkpoint)
    return GridPairs(tables, np.frombuffer(data, np.uint8))


def _box_of(tables: GridTables | LandmarkTables) -> Box:
    return Box((0, 0), tables.shape[::-1])


def _as_points(name: str, x: ArrayLike) -> Array | np.ndarray:
    """Points ``(..., 2)``; those of NumPy rounded down to whole numbers in their own precision."""
    if not isinstance(x, jax.Array):
        x = np.clip(np.floor(as_numbers(name, x, "points (..., 2)")), -1, MOST_CELLS)  # both are outside
    elif jax.numpy.iscomplexobj(x):
        raise ValueError(f"{name} must be points (..., 2) of real numbers, got an array of {x.dtype}.")
    if x.shape[-1:] != (2,):
        raise ValueError(f"{name} must have shape (..., 2), got {x.shape}.")
    return x
