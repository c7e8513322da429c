"""Distances on a grid of cells that JAX may trace: the public function :func:`grid_distance`."""

import warnings
from dataclasses import field
from functools import partial
from typing import Any, Literal, get_args, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from plr_jax._arrays import require_choice, require_integer
from plr_jax._compiled import broadcast_shape, pytree
from plr_jax._types import ArrayLike
from plr_jax.traced.any_angle import MAX_LATTICE, MOST_CORNERS, GridPaths, convex_corners
from plr_jax.traced.corner_paths import CornerPairs
from plr_jax.traced.fields import as_array, as_floats, as_points, distance, replace_nonfinite, require_one_map
from plr_jax.traced.steps import MOST_CELLS, Mask, StepPairs, Steps

Moves = Literal["any-angle", 4, 8]


@pytree
class GridDistance:
    """The distance from any point of a grid to a goal, made by :func:`grid_distance`; a pytree of arrays.

    ``is_complete`` is false if the map has more than ``max_corners`` corners where paths may bend. ``is_nan`` is true
    if a coordinate of the goal is NaN. In both cases, all distances are NaN. The shapes of the arrays depend only on
    the ``shape`` of the grid, ``(rows, columns)``, on ``moves`` and on ``max_corners``.
    """

    paths: Steps | GridPaths
    is_complete: Bool[Array, "*maps"]
    is_nan: Bool[Array, "*maps"]
    shape: tuple[int, int] = field(metadata={"static": True})

    @property
    def has_no_answers(self) -> Bool[Array, ""]:
        """Whether all distances are NaN."""
        return self.is_nan | ~self.is_complete

    @property
    def cells(self) -> Float[Array, "h w"]:
        """Distances of the centers of all cells to the goal, computed at each access."""
        require_one_map(self, "jax.vmap(lambda field: field.cells)(fields)")
        return _cells(self)

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance from each point to the goal, ``(...)``, in cell sides.

        ``x`` has rows ``(x, y)``, ``(..., 2)``. Distances are ``inf`` with gradient 0 outside the grid, inside
        blocked cells and where no path exists. They are NaN where a coordinate of the point or goal is NaN, and if
        ``is_complete`` is false. ``ValueError`` if points are not real. Points of an integer type are corners of
        cells, and give a ``UserWarning``.
        """
        require_one_map(self, "jax.vmap(lambda field, x: field(x))(fields, x)")
        return distance(self, *_as_floats(x=as_points("x", x)))

    def __repr__(self) -> str:
        return f"GridDistance({self.shape[0]} x {self.shape[1]} cells, {type(self.paths).__name__})"


@pytree
class GridDistances:
    """The distance between any two points of a grid; made by :func:`grid_distance` without a goal."""

    paths: StepPairs | CornerPairs
    is_complete: Bool[Array, "*maps"]

    @property
    def has_no_answers(self) -> Bool[Array, ""]:
        """Whether all distances are NaN."""
        return ~self.is_complete

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance between each point of ``x`` and the point of ``y`` at the same index, in cell sides.

        Both arrays are real, ``(..., 2)``, with rows ``(x, y)``. Their leading axes must broadcast, else
        ``ValueError``. Distances are ``inf`` or NaN as for :class:`GridDistance`.
        """
        require_one_map(self, "jax.vmap(lambda field, x, y: field(x, y))(fields, x, y)")
        x, y = as_points("x", x), as_points("y", y)
        broadcast_shape("x and y", x, y)
        return distance(self, *_as_floats(x=x, y=y))

    def __repr__(self) -> str:
        return f"GridDistances({type(self.paths).__name__})"


@overload
def grid_distance(
    free: ArrayLike, goal: None, *, moves: Moves = "any-angle", max_corners: int | None = None
) -> GridDistances: ...
@overload
def grid_distance(
    free: ArrayLike, goal: ArrayLike, *, moves: Moves = "any-angle", max_corners: int | None = None
) -> GridDistance: ...
def grid_distance(
    free: ArrayLike, goal: ArrayLike | None, *, moves: Moves = "any-angle", max_corners: int | None = None
) -> GridDistance | GridDistances:
    """Return a function that measures shortest paths on a grid of free and blocked cells, also inside ``jit``.

        field = plr_jax.grid_distance(free, goal)
        field(x)  # distances (n,) to the goal from points x, (n, 2)

    Maps and goals may be created inside ``jax.jit`` and batched by ``jax.vmap``. Any-angle distances have gradients
    with respect to points and goal; for ``moves`` of 4 or 8, gradients are 0.

    Cell ``[i, j]`` covers ``x`` in ``[j, j + 1]`` and ``y`` in ``[i, i + 1]``; everything beyond the grid is blocked.
    A point on a boundary between cells counts as free if one of the cells is free. The center of cell ``[i, j]`` is
    ``(j + 0.5, i + 0.5)``. Integer points are corners of cells, and give a ``UserWarning``. Invalid arguments raise
    ``ValueError``, also in tracing.

    If the agent moves between neighboring cells, ``moves=4`` or ``moves=8`` is several times faster than any-angle
    paths. If the agent stands on cell centers, compute ``field.cells`` once and index ``cells[row, column]``. This is
    faster than to call ``field(x)`` in each step.

    Args:
        free: Which cells are free, booleans ``(h, w)``.
        goal: Goal ``(x, y)``, ``(2,)``. None: the result is a :class:`GridDistances`, of pairs of points.
        moves: Kind of paths.

            - ``"any-angle"``: all paths outside blocked cells. They may touch walls, but not pass between two blocked
              cells that share only a corner. Distances are those of ``VisibilityGraph`` in
              ``Workspace.from_mask(free, tolerance=0)``.
            - 4: steps between cells that share a side, from the point's cell to the goal's cell.
            - 8: also diagonal steps, of length sqrt(2), if both cells beside the step are free.
        max_corners: For any-angle paths only: the largest number of convex corners of blocked cells, where paths can
            bend. Maps with more corners give NaN, and ``is_complete`` is false. Time and memory grow with the square
            of this number; without a goal, time grows with its cube. It is at most 4,096. Default: the number of
            cell corners inside the grid, ``(h - 1) * (w - 1)``, if this is at most 256 (17 x 17 cells), else half
            of this number.
    """
    mask = as_array(free, "free must be an array of booleans (h, w)")
    if mask.dtype != bool or mask.ndim != 2 or not mask.size:
        expected = "free must be booleans of shape (h, w), rows along y, with at least one cell"
        raise ValueError(f"{expected}, got {mask.dtype} of shape {mask.shape}: is it `grid == 0`, one map at a time?")
    h, w = mask.shape
    require_choice("moves", moves, get_args(Moves))
    if max_corners is not None:
        require_integer("max_corners", max_corners, 1)
        if moves != "any-angle":
            got = f"{max_corners} with moves={moves}"
            raise ValueError(f"max_corners requires any-angle paths, got {got}: leave it out.")
    if goal is not None:
        goal = as_points("goal", goal)
        if goal.ndim != 1:
            raise ValueError(f"goal must be one point of shape (2,), got shape {goal.shape}: use jax.vmap for more.")
        (goal,) = _as_floats(goal=goal)
    num_corners = 0
    if moves == "any-angle":
        num_inner = (h - 1) * (w - 1)  # corners of cells inside the grid
        default = num_inner if num_inner <= MAX_LATTICE else (num_inner + 1) // 2
        num_corners = max(1, min(num_inner, max_corners or default))
        if num_corners > MOST_CORNERS:
            got = f"{num_corners:,} on {h} x {w} cells: pass max_corners, or use moves=8"
            raise ValueError(f"Any-angle paths allow at most {MOST_CORNERS:,} corners, got {got}.")
    elif moves == 8 and h * w > MOST_CELLS:
        raise ValueError(f"free must have at most {MOST_CELLS:,} cells for moves=8, got {h} x {w}: use moves=4.")
    return _make(mask, goal, moves, num_corners)


# Each call is one compiled program: compiling even a single operation takes 30 ms.


@partial(jax.jit, static_argnames=("moves", "num_corners"))
def _make(free: Mask, goal: Float[Array, "2"] | None, moves: Moves, num_corners: int) -> GridDistance | GridDistances:
    h, w = free.shape
    start, is_complete = None if goal is None else replace_nonfinite(goal), jnp.array(True)
    paths: Any
    if moves == "any-angle":
        corners, is_complete = convex_corners(free, num_corners)
        paths = CornerPairs.of_map(corners) if start is None else GridPaths.to_goals(corners, start[None])
    else:
        paths = StepPairs.of_grid(free, moves) if start is None else Steps.to_goal(free, start, moves)
    if goal is None:
        return GridDistances(paths, is_complete)
    return GridDistance(paths, is_complete, jnp.isnan(goal).any(), (h, w))


@jax.jit
def _cells(field: GridDistance) -> Float[Array, "h w"]:
    h, w = field.shape
    # Any-angle paths pad maps of one row or column.
    return jnp.where(field.has_no_answers, jnp.nan, field.paths.cells()[:h, :w])


def _as_floats(**points: Array | np.ndarray) -> list[Float[Array | np.ndarray, "*batch 2"]]:
    """Convert points, given by name, to floats of at least 32 bits; warn once if some are integers."""
    if names := [name for name, x in points.items() if jnp.issubdtype(x.dtype, jnp.integer)]:
        advice = "add 0.5 to (column, row) for the center of a cell, or pass floats if you mean a corner"
        message = f"Integer points are corners of cells, got integers for {' and '.join(names)}: {advice}."
        warnings.warn(message, stacklevel=3)  # the line that calls grid_distance or the field
    return [as_floats(x) for x in points.values()]
