"""Distances on grids: shortest paths over cells or voxels, and interpolated fields from other libraries."""

from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32
from scipy.sparse import csgraph, csr_array

from plr_jax import _arrays
from plr_jax._types import ArrayLike, Distances, Points, Reach
from plr_jax.geometry.box import Box
from plr_jax.geometry.masks import Mask, as_mask
from plr_jax.geometry.voxels import VoxelGrid, are_disconnected, reach_of_cells

Grid: TypeAlias = Float[np.ndarray, "..."]
_DISTANCES = 2**22  # distances of cells in memory at a time (32 MiB)
_POINTS = 8192  # points interpolated at a time, so that their arrays stay in the cache
_AXES = {6: 1, 18: 2, 26: 3}  # number of axes along which a step may lead at once, by number of neighbors
_ROUNDING = 1e-9  # relative margin by which a bucket is narrower than the shortest step


class _CellGraph(ABC):
    """The base class of shortest-path distances over the free cells of a grid, along steps between neighbors.

    The grid is padded with one layer of blocked cells. A flat cell index is an index of the padded, raveled array.
    """

    goal: Float[np.ndarray, " dim"] | None
    dim: ClassVar[int]
    """Number of coordinates of a point."""
    bounds: Box
    """The box that the cells fill."""
    _padded: Bool[np.ndarray, "..."]  # whether each cell is free
    _steps: Any  # free steps between neighbors: a sparse matrix of lengths, or a bit for each voxel and direction
    _to_goal: Distances  # distance of each cell to the goal

    def with_goal(self, goal: ArrayLike) -> Self:
        """Return a graph with the same cells and steps, and another goal ``(dim,)``.

        ``ValueError`` is raised if the goal is not in a free cell.
        """
        _ = self._steps  # computed once, for all copies
        graph: Any = copy(self)
        graph.__dict__.pop("_to_goal", None)
        graph._set_goal(goal)
        return graph

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the length of a shortest path from the cell of each point ``(n, dim)`` to the goal's cell, ``(n,)``.

        The length is ``inf`` for points in blocked cells, outside the grid, without a path to the goal, or with a
        NaN. ``ValueError`` if there is no goal.
        """
        return self._to_goal[self._cells_of("x", x)]

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach the goal, or free points that do not.

        Paths lead from cell to cell.
        """
        inside = (slice(1, -1),) * self.dim
        free = self._padded[inside]
        reached = np.isfinite(self._to_goal).reshape(self._padded.shape)[inside]
        if self.dim == 2:  # rows are y
            free, reached = free.T, reached.T
        return reach_of_cells(reached, free & ~reached, self.bounds, domain)

    def _set_goal(self, goal: ArrayLike) -> None:
        goal = _arrays.as_finite_point("The goal", self.bounds.settled(goal, self._are_in_free_cells), self.dim)
        if not self._are_in_free_cells(goal[None])[0]:
            raise ValueError(f"The goal must be a point in a free cell of {self.bounds}, got {goal.tolist()}.")
        _arrays.set_fields(self, goal=goal)

    def _are_in_free_cells(self, x: Points) -> Bool[np.ndarray, " n"]:
        return self._padded.ravel()[self._cells_at(x)]

    def _cells_of(self, name: str, x: ArrayLike) -> Int[np.ndarray, " n"]:
        return self._cells_at(_arrays.as_points(name, self.bounds.settled(x, self._are_in_free_cells), self.dim))

    @abstractmethod
    def _cells_at(self, x: Points) -> Int[np.ndarray, " n"]:
        """Return the flat index of the cell of each point, 0 (a blocked cell) for a point outside the grid."""


@dataclass(frozen=True, eq=False, init=False)
class GridGraph(_CellGraph):
    """Exact length of shortest paths over the cells of a 2-D grid, a `DistanceFn`.

    A step leads to one of 4 neighbors and has length 1, or to one of 8, where diagonal steps have length sqrt(2). A
    diagonal step must not cut a corner: both cells beside it must be free, unless ``squeeze`` is set. These are the
    rules of the Moving AI benchmarks (N. Sturtevant, IEEE TCIAIG 4(2), 2012) and, with 4 neighbors, of the League of
    Robot Runners.

    The cell in row ``r`` and column ``c`` contains the points with ``c <= x < c + 1`` and ``r <= y < r + 1``, as in
    :func:`scenes.read_map`. So the columns and rows of ``.scen`` files can be used as ``x`` and ``y``. All points of
    a cell have the same distance. Invalid arguments raise ``ValueError``.

    Args:
        free: Whether each cell is free, ``(rows, columns)``, as :func:`scenes.read_cells` reads a ``.map`` file.
        goal: A point in a free cell, ``(2,)``. None: only :meth:`between` can be used.
        connectivity: Number of neighbors of a cell, 4 or 8.
        squeeze: Whether diagonal steps may pass beside blocked cells; needs 8 neighbors. Networks on rasters, such as
            roads of one cell, are commonly connected in this way.
    """

    free: Mask
    connectivity: int
    squeeze: bool
    goal: Float[np.ndarray, "2"] | None
    dim: ClassVar[int] = 2

    def __init__(
        self, free: ArrayLike, goal: ArrayLike | None = None, *, connectivity: int = 4, squeeze: bool = False
    ):
        _arrays.require_choice("connectivity", connectivity, (4, 8))
        if _arrays.as_bool("squeeze", squeeze) and connectivity == 4:
            raise ValueError("squeeze=True needs connectivity=8, with diagonal steps, got connectivity=4.")
        if not (cells := as_mask(free)).size:
            raise ValueError(f"free must have at least one cell, got shape {cells.shape}.")
        cells.flags.writeable = False
        _arrays.set_fields(self, free=cells, _padded=np.pad(cells, 1), bounds=Box(np.zeros(2), cells.shape[::-1]))
        _arrays.set_fields(self, connectivity=int(connectivity), squeeze=bool(squeeze), goal=None)
        if goal is not None:
            self._set_goal(goal)

    def __repr__(self) -> str:
        squeeze = ", squeeze=True" if self.squeeze else ""
        return f"GridGraph({' x '.join(map(str, self.free.shape))} cells, {self.connectivity}-connected{squeeze})"

    def between(self, x: ArrayLike, y: ArrayLike) -> Distances:
        """Return the length of a shortest path from the cell of ``x[i]`` to the cell of ``y[i]`` for each ``i``.

        Points are ``(n, 2)``, lengths ``(n,)``. Each distinct cell of ``x`` takes one search over the grid, or each
        of ``y`` if these are fewer. The length is ``inf`` if there is no path, or if a point is in a blocked cell,
        outside the grid, or has a NaN.
        """
        ends = self._cells_of("x", x), self._cells_of("y", y)
        if len(ends[0]) != len(ends[1]):
            raise ValueError(f"x and y must be equally many points, got {len(ends[0])} and {len(ends[1])}.")
        # Distances are the same in both directions, so search from the side that has fewer distinct cells.
        begin, end = sorted(ends, key=lambda cells: len(np.unique(cells)))
        roots, root = np.unique(begin, return_inverse=True)
        distances = np.empty(len(begin))
        at_once = max(_DISTANCES // self.free.size, 1)
        for first in range(0, len(roots), at_once):
            pairs = np.flatnonzero((root >= first) & (root < first + at_once))
            distances[pairs] = self._search(roots[first : first + at_once])[root[pairs] - first, end[pairs]]
        return distances

    @cached_property
    def _to_goal(self) -> Distances:
        if self.goal is None:
            raise ValueError("The grid must have a goal: use GridGraph(free, goal), or with_goal(goal).")
        return self._search(self._cells_of("The goal", self.goal[None]))[0]

    @cached_property
    def _steps(self) -> csr_array:
        # Return the graph of the padded grid, with each edge once.
        free, columns = self._padded, self._padded.shape[1]
        row, column = np.nonzero(free)
        edges = []
        for down, right in [(0, 1), (1, 0)] + [(1, 1), (1, -1)] * (self.connectivity == 8):
            are_free = free[row + down, column] & free[row, column + right]  # the cells beside a diagonal step
            can = free[row + down, column + right] & (are_free | self.squeeze)
            begin = (row * columns + column)[can]
            edges.append((begin, begin + down * columns + right, np.full(len(begin), np.hypot(down, right))))
        begin, end, length = (np.concatenate(column) for column in zip(*edges, strict=True))
        return csr_array((length, (begin, end)), shape=2 * (free.size,))

    def _search(self, roots: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k cells"]:
        distances = csgraph.dijkstra(self._steps, directed=False, indices=roots, unweighted=self.connectivity == 4)
        distances[:, ~self._padded.ravel()] = np.inf  # also of blocked cells from themselves
        return distances

    def _cells_at(self, x: Points) -> Int[np.ndarray, " n"]:
        rows, columns = self.free.shape
        inside = np.logical_and.reduce((x >= 0) & (x < (columns, rows)), axis=1)
        column, row = np.floor(np.where(inside[:, None], x, -1)).astype(np.intp).T
        return (row + 1) * (columns + 2) + column + 1


@dataclass(frozen=True, eq=False, init=False)
class VoxelGraph(_CellGraph):
    """Exact length of shortest paths from voxel to voxel, a `DistanceFn`.

    A step leads from a voxel's center to the center of a neighbor across one of its 6 faces. With 18 moves, it may
    also lead across one of 12 edges, with 26 moves also across one of 8 corners. All voxels of the box that the step
    spans must be free, so it cuts no edge or corner. In voxels of side 1, steps have lengths 1, sqrt(2) and sqrt(3).

    The length is never below that of the shortest any-angle path between the two centers. In open space, for cubes
    and 26 moves, it is at most 12.9 % above. A point on a face between two voxels belongs to the upper voxel, a point
    on an upper bound of the box to the last voxel. Invalid arguments raise ``ValueError``.

    Args:
        free: Whether each voxel is free, booleans ``(nx, ny, nz)``, indexed ``[i, j, k]`` as in :class:`VoxelSpace`;
            at least one must be free.
        goal: A point in a free voxel, ``(3,)``; distances are measured from the voxel's center.
        moves: Number of neighbors of a voxel, 6, 18 or 26.
        bounds: The box that the voxels fill, or its corners ``(lo, hi)``, without periodic axes. None: voxels of side
            1, the first with its corner at 0.
    """

    grid: VoxelGrid
    free: Bool[np.ndarray, "nx ny nz"]
    bounds: Box
    moves: int
    goal: Float[np.ndarray, "3"]
    dim: ClassVar[int] = 3

    def __init__(self, free: ArrayLike, goal: ArrayLike, moves: int = 26, bounds: Box | ArrayLike | None = None):
        _arrays.require_choice("moves", moves, [*_AXES])
        grid = VoxelGrid.of(free, bounds, range(3, 4))
        _arrays.set_fields(self, grid=grid, free=grid.free, bounds=grid.bounds, moves=int(moves), _padded=grid.padded)
        self._set_goal(goal)

    def __repr__(self) -> str:
        return f"VoxelGraph({' x '.join(map(str, self.free.shape))} voxels, {self.moves} moves)"

    @property
    def lengths(self) -> Float[np.ndarray, "x y z"]:
        """Distance of every voxel to the goal, with a layer of ``inf`` around the grid."""
        return self._to_goal.reshape(self.grid.padded.shape)

    def _cells_at(self, x: Points) -> Int[np.ndarray, " n"]:
        inside = self.bounds.contains(x)
        x = np.where(inside[:, None], x, self.bounds.lo)
        below, above = self.grid.numbers(x.T)
        # A point on a face is in two voxels: take the upper one, but on the upper bound of the grid the last voxel.
        number = np.where(self.bounds.hi[:, None] == x.T, below, above)
        return np.where(inside, np.ravel_multi_index(tuple(number), self.grid.padded.shape), 0)

    @cached_property
    def _steps(self) -> tuple[Int[np.ndarray, "steps 3"], UInt32[np.ndarray, " voxels"]]:
        # Return the changes of a voxel's three indices, one row per step; and for each voxel a number with a bit per
        # step, which is set if the step is free.
        steps = np.array(list(product((-1, 0, 1), repeat=3)))
        num_axes = np.count_nonzero(steps, axis=1)
        steps = steps[(num_axes > 0) & (num_axes <= _AXES[self.moves])]
        padded, legal = self.grid.padded, np.zeros(self.grid.padded.shape, np.uint32)
        for bit, step in enumerate(steps):
            may_step = np.ones(self.free.shape, bool)
            for part in product(*[(0, change) if change else (0,) for change in step]):
                may_step &= padded[tuple(slice(1 + k, n - 1 + k) for k, n in zip(part, padded.shape, strict=True))]
            legal[1:-1, 1:-1, 1:-1] |= may_step.astype(np.uint32) << np.uint32(bit)
        return steps, legal.ravel()

    @cached_property
    def _to_goal(self) -> Distances:
        # Dial, "Algorithm 360: Shortest-path forest with topological ordering" (1969). Bucket i holds voxels whose
        # distance is from i to i + 1 widths. A bucket is narrower than the shortest step, so every step leads to a
        # later bucket. So the distances in the first bucket are final, and all its steps are taken at once.
        steps, legal = self._steps
        bits = np.arange(len(steps), dtype=np.uint32)
        # Changes of the flat index. They equal the changes in bytes, since each boolean takes one byte.
        jumps = np.sum(steps * self.grid.padded.strides, axis=1)
        lengths = np.linalg.norm(steps * self.grid.sides, axis=1)
        width = lengths.min() * (1 - _ROUNDING)
        distance = np.full(self.grid.padded.size, np.inf)
        root = self._cells_of("The goal", self.goal[None])
        distance[root] = 0.0
        buckets = {0: [root]}
        while buckets:
            # 1. Take the voxels of the first bucket, without voxels that have moved to an earlier bucket since then.
            first = min(buckets)
            voxels = np.concatenate(buckets.pop(first))
            voxels = np.unique(voxels[(distance[voxels] / width).astype(np.int64) == first])
            # 2. Take all their legal steps.
            begin, step = np.nonzero((legal[voxels][:, None] >> bits) & np.uint32(1))
            end = voxels[begin] + jumps[step]
            length = distance[voxels][begin] + lengths[step]
            # 3. Put the voxels that become nearer into their new buckets.
            is_nearer = length < distance[end]
            end, length = end[is_nearer], length[is_nearer]
            np.minimum.at(distance, end, length)
            bucket = (length / width).astype(np.int64)
            for number in np.unique(bucket).tolist():
                buckets.setdefault(number, []).append(end[bucket == number])
        return distance


@dataclass(frozen=True, eq=False, init=False)
class GridField:
    """Distances from another library at the cell centers of a grid, interpolated between them.

    The **last** axis of the array runs along the first coordinate of a point. In 2-D, ``values[row, column]`` belongs
    to ``(x, y)`` with ``x`` in that column and ``y`` in that row, row 0 at the lowest ``y``, as in :meth:`Box.grid`.
    This is the layout of scikit-fmm over a ``meshgrid`` and of xarray with ascending dimensions ``("y", "x")``. For a
    raster with row 0 at the top give ``values[::-1]``, for a table ``[x, y, ...]`` give ``values.T``.

    Interpolation is multilinear between the centers of cells with a value. If some centers around a point have no
    value, the weights of the other centers are scaled to sum to 1. If the cells with a value around a point are not
    connected through common faces, the point has the value of its own cell. A point beyond the outermost centers has
    the distance of the nearest point between centers. Invalid arguments raise ``ValueError``.

    Args:
        values: Distance at each center, in any dimension, at least 0; ``inf``, NaN or masked where the goal cannot be
            reached. It is kept as a read-only array, with ``inf`` in place of NaN and masked entries.
        bounds: The box that the cells fill, or its corners ``(lo, hi)``: corners of outer cells, not centers.
            Periodic axes wrap around.
        free: Whether each cell is free, booleans like ``values``, so that a PLR answers ``inf`` in free cells without
            a distance. None: cells without a distance count as obstacles.
    """

    values: Float[np.ndarray, "..."]
    bounds: Box
    free: Bool[np.ndarray, "..."]

    def __init__(self, values: ArrayLike, bounds: Box | ArrayLike, free: ArrayLike | None = None):
        bounds = Box.of(bounds, "The bounds")
        expected = f"distances on a grid of {bounds.dim} axes"
        numbers = np.array(_arrays.as_numbers("values", _arrays.filled_with_inf(values), expected), order="C")
        if numbers.ndim != bounds.dim or numbers.size == 0:
            must = f"{expected}, as the bounds have, the last one along x, with at least one cell"
            raise ValueError(f"values must be {must}, got shape {numbers.shape}.")
        numbers[np.isnan(numbers)] = np.inf
        if numbers.min() < 0:
            cell = tuple(map(int, np.unravel_index(np.argmin(numbers), numbers.shape)))
            mask = "mask cells without a distance"
            clip = "use np.maximum(values, 0) for a field that is negative inside the goal"
            raise ValueError(f"values must be at least 0, got {numbers[cell]:g} at {cell}; {mask}, and {clip}.")
        must = f"free must be booleans like values, of shape {numbers.shape}, none masked"
        is_free = np.isfinite(numbers) if free is None else _arrays.as_cells(must, free, numbers.shape.__eq__)
        numbers.flags.writeable = is_free.flags.writeable = False
        _arrays.set_fields(self, values=numbers, bounds=bounds, free=is_free)

    def __repr__(self) -> str:
        return f"GridField({' x '.join(map(str, self.values.shape))} cells, {self.bounds})"

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.bounds.dim

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the interpolated distance ``(n,)`` at each point ``(n, dim)``.

        The distance is ``inf`` if the cell of the point has no value, and for points outside the bounds or with a
        NaN.
        """
        x = _arrays.as_points("x", self.bounds.settled(x, lambda single: np.isfinite(self(single))), self.dim)
        distances = np.full(len(x), np.inf)
        inside = np.flatnonzero(self.bounds.contains(x))
        for rows in _arrays.batches(inside, _POINTS):
            values, is_known = self.interpolated(x[rows])
            distances[rows[is_known]] = values[is_known]
        return distances

    def interpolated(self, x: Points) -> tuple[Distances, Bool[np.ndarray, " n"]]:
        """Return the interpolated distance at each point, and whether the cell that contains the point has a value.

        Points must lie in the box ``bounds``. The distance is ``inf`` if no cell around the point has a value.
        """
        from scipy import ndimage  # slow to import, and needed only here

        # Places are in units of cells, in the order of the array's axes: cell k lies from k to k + 1. The arrays of
        # `_padded` have one more cell in front, so place k + 1/2, the center of cell k, has the index k + 1 there.
        shape = np.array(self.values.shape)[:, None]
        places = ((self.bounds.wrapped(x) - self.bounds.lo) / self.bounds.width).T[::-1] * shape
        padded, filled, weights, is_split = self._padded
        values = ndimage.map_coordinates(padded, places + 0.5, order=1)
        is_known = np.ones(len(x), bool)
        # A center without a value is NaN even if its weight is 0, so NaN marks all points beside such centers.
        if len(unknown := np.flatnonzero(np.isnan(values))):
            places = places[:, unknown]
            in_cell = self.values[tuple(np.minimum(places.astype(np.intp), shape - 1))]
            total, weight = (ndimage.map_coordinates(table, places + 0.5, order=1) for table in (filled, weights))
            mean = np.divide(total, weight, out=np.full(len(unknown), np.inf), where=weight > 0)
            if is_split is not None:
                mean = np.where(is_split[tuple((places + 0.5).astype(np.intp))], in_cell, mean)
            values[unknown], is_known[unknown] = mean, np.isfinite(in_cell)
        return values, is_known

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold cells with a distance, or free cells without a distance."""
        reached = np.isfinite(self.values).T
        return reach_of_cells(reached, self.free.T & ~reached, self.bounds, domain)

    @cached_property
    def _padded(self) -> tuple[Grid, Grid, Grid, Bool[np.ndarray, "..."] | None]:
        # Return four arrays. The first three have a layer of copied cells around the grid:
        #   padded    the distance, NaN in cells without a value
        #   filled    the distance, 0 in cells without a value
        #   weights   1 in cells with a value, else 0
        #   is_split  for each box between neighboring centers, whether its cells with a value touch only at an edge
        #             or corner: no distances are interpolated there. None: there is no such box.
        padded = np.where(np.isfinite(self.values), self.values, np.nan)
        for axis, is_periodic in enumerate(self.bounds.periodic[::-1]):
            padded = padded.take(np.arange(-1, padded.shape[axis] + 1), axis, mode="wrap" if is_periodic else "clip")
        is_known = ~np.isnan(padded)
        has_gaps = padded.ndim > 1 and not is_known.all()
        is_split = are_disconnected(is_known, range(padded.ndim)) if has_gaps else None
        return padded, np.where(is_known, padded, 0.0), is_known.astype(float), is_split
