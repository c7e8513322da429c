"""Shortest paths over the cells of a grid."""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import as_finite_point, as_points, set_fields, shortened
from plr_jax._types import ArrayLike, Distances, Points
from plr_jax.geometry.masks import as_mask

_AT_ONCE = 2**22  # distances of cells held at a time
_OUTSIDE = -1


def legal_steps(
    free: Bool[np.ndarray, "rows columns"], connectivity: int
) -> tuple[Int[np.ndarray, "steps"], Int[np.ndarray, "steps"], Bool[np.ndarray, "steps"]]:
    """All legal steps, each in one of its directions: cells where they begin and end, and which ones are diagonal.

    Cells are numbered in row-major order.
    """
    rows, columns = np.nonzero(free)
    legal = np.pad(free, 1)
    begin, end, is_diagonal = [], [], []
    for down, right in [(0, 1), (1, 0)] + [(1, 1), (1, -1)] * (connectivity == 8):
        row, column = rows + 1, columns + 1
        can = legal[row + down, column + right] & legal[row + down, column] & legal[row, column + right]
        cell = (rows * free.shape[1] + columns)[can]
        begin.append(cell)
        end.append(cell + down * free.shape[1] + right)
        is_diagonal.append(np.full(len(cell), down * right != 0))
    return np.concatenate(begin), np.concatenate(end), np.concatenate(is_diagonal)


@dataclass(frozen=True, eq=False, init=False)
class GridGraph:
    """Number of steps over a grid to a goal, a `DistanceFn`, exact.

    A step leads to one of four neighbors and counts 1, or to one of eight, of which the diagonal ones count the
    square root of 2. A diagonal step cuts no corner: both cells beside it must be free. These are the rules of the
    Moving AI benchmarks and, with four neighbors, of the League of Robot Runners.

    The cell in row ``r`` and column ``c`` has the points with ``c <= x < c + 1`` and ``r <= y < r + 1``, as in
    :func:`scenes.read_map`, so that whole numbers are the columns and rows of ``.scen`` files. All points of a cell
    have the same distance.

    Args:
        free: Which cells are free, ``(rows, columns)``, as :func:`scenes.read_cells` reads them from a ``.map`` file.
        goal: A point of a free cell, ``(2,)``. None: there is none, and pairs alone can be asked for.
        connectivity: Neighbors of a cell, 4 or 8.

    Attributes:
        free: As given, read-only.
        connectivity: As given.
        goal: As given, read-only.

    Raises:
        ValueError: If ``free`` is no array of booleans of two axes with one entry at least, the goal is in no free
            cell, or there is another number of neighbors.

    References:
        N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE TCIAIG 4(2), 2012.
    """

    free: Bool[np.ndarray, "rows columns"]
    connectivity: int
    goal: Float[np.ndarray, "2"] | None
    dim: ClassVar[int] = 2
    """Number of coordinates of a point."""

    def __init__(self, free: ArrayLike, goal: ArrayLike | None = None, *, connectivity: int = 4):
        if isinstance(connectivity, bool) or connectivity not in (4, 8):
            raise ValueError(f"connectivity must be 4 or 8, got {shortened(connectivity)}.")
        cells = as_mask(free)
        if not cells.size:
            raise ValueError(f"free must have at least one cell, got shape {cells.shape}.")
        cells.flags.writeable = False
        set_fields(self, free=cells, connectivity=int(connectivity))
        set_fields(self, goal=None if goal is None else self._checked_goal(goal))

    def __repr__(self) -> str:
        rows, columns = self.free.shape
        return f"GridGraph({rows} x {columns} cells, {self.connectivity}-connected)"

    def with_goal(self, goal: ArrayLike) -> "GridGraph":
        """The same grid with another goal.

        Args:
            goal: A point of a free cell, ``(2,)``.

        Returns:
            The grid, sharing the graph.

        Raises:
            ValueError: If the goal is in no free cell.
        """
        _ = self._steps  # computed once, for all copies
        graph = copy(self)
        graph.__dict__.pop("_to_goal", None)
        set_fields(graph, goal=self._checked_goal(goal))
        return graph

    def __call__(self, x: ArrayLike) -> Distances:
        """Length of a shortest path from the cell of each point to the goal's.

        Args:
            x: Points, ``(n, 2)``.

        Returns:
            Distances in steps, ``(n,)``; ``inf`` in blocked cells, outside the grid, where no path leads to the goal,
            and for points with a NaN.

        Raises:
            ValueError: If ``x`` has another shape, or there is no goal.
        """
        cells = self._cells_of(as_points("x", x, 2))
        return np.where(cells == _OUTSIDE, np.inf, self._to_goal[cells])

    def between(self, x: ArrayLike, y: ArrayLike) -> Distances:
        """Length of a shortest path between the cells of points, pair by pair.

        Each different cell of ``x``, or of ``y`` if those are fewer, takes one search over the grid.

        Args:
            x: Points, ``(n, 2)``.
            y: Points, ``(n, 2)``.

        Returns:
            Distances in steps, ``(n,)``; ``inf`` as for a call.

        Raises:
            ValueError: If a shape is another, or the numbers of points differ.
        """
        x, y = as_points("x", x, 2), as_points("y", y, 2)
        if len(x) != len(y):
            raise ValueError(f"x and y must be as many points, got {len(x)} and {len(y)}.")
        ends = [self._cells_of(points) for points in (x, y)]
        begin, end = sorted(ends, key=lambda cells: len(np.unique(cells)))
        distances = np.full(len(x), np.inf)
        inside = np.flatnonzero((begin != _OUTSIDE) & (end != _OUTSIDE))
        inside = inside[np.argsort(begin[inside], kind="stable")]
        roots, first = np.unique(begin[inside], return_index=True)
        at_once = max(_AT_ONCE // self.free.size, 1)
        for some in range(0, len(roots), at_once):
            of_roots = self._search(roots[some : some + at_once])
            last = first[some + at_once] if some + at_once < len(roots) else len(inside)
            pairs = inside[first[some] : last]
            distances[pairs] = of_roots[np.searchsorted(roots, begin[pairs]) - some, end[pairs]]
        return distances

    @cached_property
    def _to_goal(self) -> Distances:
        """Distance of every cell, in row-major order."""
        if self.goal is None:
            raise ValueError("This grid has no goal: use GridGraph(free, goal), or with_goal(goal).")
        return self._search(self._cells_of(self.goal[None]))[0]

    @cached_property
    def _steps(self) -> csr_array:
        """Lengths of the legal steps, each in one of its directions, between cells in row-major order."""
        begin, end, is_diagonal = legal_steps(self.free, self.connectivity)
        return csr_array((np.where(is_diagonal, np.sqrt(2), 1), (begin, end)), shape=(self.free.size, self.free.size))

    def _search(self, roots: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k cells"]:
        """Distances of all cells from some; a blocked one is not even 0 from itself."""
        distances = csgraph.dijkstra(self._steps, directed=False, indices=roots, unweighted=self.connectivity == 4)
        distances[:, ~self.free.ravel()] = np.inf
        return distances

    def _cells_of(self, x: Points) -> Int[np.ndarray, "n"]:
        """The cell of each point, in row-major order, ``_OUTSIDE`` if it is in none."""
        rows, columns = self.free.shape
        inside = np.logical_and.reduce((x >= 0) & (x < (columns, rows)), axis=1)
        column, row = np.floor(np.where(inside[:, None], x, 0)).astype(np.intp).T
        return np.where(inside, row * columns + column, _OUTSIDE)

    def _checked_goal(self, goal: ArrayLike) -> Float[np.ndarray, "2"]:
        goal = as_finite_point("The goal", goal, 2)
        cell = self._cells_of(goal[None])[0]
        if cell == _OUTSIDE or not bool(self.free.ravel().take(cell)):
            raise ValueError(f"The goal must be in a free cell of the grid, got {goal.tolist()}.")
        return goal
