"""The public function :func:`grid_distance`: distances on a grid of cells that may be traced by JAX."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from plr_jax._arrays import require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.traced.any_angle import MAX_LATTICE, MOST_CORNERS, CornerPairs, CornerPaths, convex_corners
from plr_jax.traced.steps import MOST_CELLS, Mask, Points, StepPairs, Steps

Moves = Literal["any-angle", 4, 8]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GridDistance:
    """The distance from any point of a grid to a goal; made by :func:`grid_distance`.

    It is a pytree of arrays whose shapes depend only on the shape of the grid, ``moves`` and ``max_corners``.

    Attributes:
        is_complete: Whether the map has at most ``max_corners`` corners at which paths may bend; if not, distances
            are NaN. Always true for ``moves`` of 4 or 8.
        is_nan: Whether a coordinate of the goal is NaN; all distances are NaN then.
        shape: Rows and columns of the grid.
    """

    paths: Steps | CornerPaths
    is_complete: Bool[Array, "*maps"]
    is_nan: Bool[Array, "*maps"]
    shape: tuple[int, int] = field(metadata={"static": True})

    @property
    def cells(self) -> Float[Array, "h w"]:
        """Distances of the centers of all cells to the goal, computed at each access."""
        h, w = self.shape
        return jnp.where(self.is_nan | ~self.is_complete, jnp.nan, self.paths.cells()[:h, :w])

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance of each point to the goal.

        Args:
            x: Points ``(x, y)``, ``(..., 2)``.

        Returns:
            Distances in cell sides, ``(...)``. They are ``inf`` with gradient 0 outside the grid, inside blocked
            cells and where no path exists, and NaN where a coordinate of the point or goal is NaN, or if
            ``is_complete`` is false.

        Raises:
            ValueError: If ``x`` has a wrong shape or is not real.
        """
        x = _as_points("x", x)
        is_nan = jnp.isnan(x).any(axis=-1) | self.is_nan | ~self.is_complete
        return jnp.where(is_nan, jnp.nan, _distance(self.paths, _finite(x)))

    def __repr__(self) -> str:
        return f"GridDistance({self.shape[0]} x {self.shape[1]} cells, {type(self.paths).__name__})"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GridDistances:
    """The distance between any two points of a grid; made by :func:`grid_distance` without a goal.

    ``is_complete`` tells whether the map has at most ``max_corners`` corners; if not, distances are NaN.
    """

    paths: StepPairs | CornerPairs
    is_complete: Bool[Array, "*maps"]

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Return the distance from each point ``x`` to the point ``y`` in its place; see :class:`GridDistance`.

        Args:
            x: Points ``(x, y)``, ``(..., 2)``.
            y: Other ends, ``(..., 2)``; leading axes broadcast with those of ``x``, else ``ValueError``.
        """
        x, y = _as_points("x", x), _as_points("y", y)
        try:
            x, y = jnp.broadcast_arrays(x, y)
        except ValueError:
            raise ValueError(f"x and y must broadcast, got shapes {x.shape} and {y.shape}.") from None
        is_nan = (jnp.isnan(x) | jnp.isnan(y)).any(axis=-1) | ~self.is_complete
        return jnp.where(is_nan, jnp.nan, _distance(self.paths, _finite(x), _finite(y)))

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

    Maps and goals may be created inside ``jax.jit``, batched by ``jax.vmap``, and distances differentiated by
    ``jax.grad`` with respect to points and goal (the gradient is 0 for ``moves`` of 4 or 8). Cell ``[i, j]`` covers
    ``x`` in ``[j, j + 1]`` and ``y`` in ``[i, i + 1]``; everything beyond the grid is blocked. A point on a boundary
    between cells counts as free if one of them is.

    Args:
        free: Which cells are free, booleans ``(h, w)``.
        goal: Goal ``(x, y)``, ``(2,)``, or None for distances between any two points.
        moves: Kind of paths. ``"any-angle"``: all paths outside blocked cells; they may touch walls, but not pass
            between two blocked cells that share only a corner. These are the distances of ``VisibilityGraph`` in
            ``Workspace.from_mask(free, tolerance=0)``. 4: steps between cells that share a side, from the point's
            cell to the goal's. 8: also diagonal steps, of length sqrt(2), if both adjacent cells are free.
        max_corners: For any-angle paths only: most convex corners of blocked cells, where paths can bend. Time and
            memory grow with its square. Maps with more corners give NaN and ``is_complete`` false. Default: all cell
            corners inside grids with at most 256 of them (17 x 17 cells), else half of them.

    Returns:
        A function of points, or of pairs of points if ``goal`` is None.

    Raises:
        ValueError: If ``free`` is no non-empty boolean matrix, ``goal`` no point, ``moves`` or ``max_corners``
            invalid, or the grid too large. Also raised during tracing.
    """
    mask = _as_mask(free)
    h, w = mask.shape
    if not isinstance(moves, str | int) or moves not in ("any-angle", 4, 8):
        raise ValueError(f'moves must be "any-angle", 4 or 8, got {shortened(moves)}.')
    if max_corners is not None:
        require_integer("max_corners", max_corners, 1)
        if moves != "any-angle":
            raise ValueError(
                f"max_corners requires any-angle paths, got {max_corners} with moves={moves}: leave it out."
            )
    point = None if goal is None else _as_points("goal", goal)
    if point is not None and point.ndim != 1:
        raise ValueError(f"goal must be one point of shape (2,), got shape {point.shape}: use jax.vmap for more.")
    if moves == "any-angle":
        inside = (h - 1) * (w - 1)
        count = min(inside, max_corners or (inside if inside <= MAX_LATTICE else -(-inside // 2)))
        if count > MOST_CORNERS:
            raise ValueError(
                f"Any-angle paths allow at most {MOST_CORNERS:,} corners, got {count:,} on {h} x {w} cells: "
                "pass max_corners, or use moves=8."
            )
        count = max(1, count)
    elif moves == 8 and h * w > MOST_CELLS:
        raise ValueError(f"free must have at most {MOST_CELLS:,} cells for moves=8, got {h} x {w}: use moves=4.")
    else:
        count = 0
    if point is None:
        pairs, is_complete = _pairs(mask, moves, count)
        return GridDistances(pairs, is_complete)
    paths, is_complete = _paths(mask, _finite(point), moves, count)
    return GridDistance(paths, is_complete, jnp.isnan(point).any(), (h, w))


@partial(jax.jit, static_argnames=("moves", "count"))
def _paths(
    free: Mask, goal: Float[Array, "2"], moves: Moves, count: int
) -> tuple[Steps | CornerPaths, Bool[Array, ""]]:
    if moves != "any-angle":
        return Steps.to_goal(free, goal, moves), jnp.array(True)
    corners, is_complete = convex_corners(free, count)
    return CornerPaths.to_goal(corners, goal), is_complete


@partial(jax.jit, static_argnames=("moves", "count"))
def _pairs(free: Mask, moves: Moves, count: int) -> tuple[StepPairs | CornerPairs, Bool[Array, ""]]:
    if moves != "any-angle":
        return StepPairs.of_grid(free, moves), jnp.array(True)
    corners, is_complete = convex_corners(free, count)
    return CornerPairs.of_grid(corners), is_complete


@jax.jit
def _distance(paths: Any, *points: Points) -> Float[Array, "*batch"]:
    return paths.distance(*(x.reshape(-1, 2) for x in points)).reshape(points[0].shape[:-1])


def _as_mask(free: ArrayLike) -> Mask:
    try:
        mask = jnp.asarray(free)
    except (TypeError, ValueError):
        raise ValueError(f"free must be an array of booleans (h, w), got {shortened(free)}.") from None
    if mask.dtype != bool or mask.ndim != 2 or not mask.size:
        expected = "free must be booleans of shape (h, w), rows along y, with at least one cell"
        raise ValueError(f"{expected}, got {mask.dtype} of shape {mask.shape}: is it `grid == 0`, one map at a time?")
    return mask


def _as_points(name: str, value: ArrayLike) -> Points:
    try:
        points = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be points (..., 2), got {shortened(value)}.") from None
    is_real = jnp.issubdtype(points.dtype, jnp.floating) or jnp.issubdtype(points.dtype, jnp.integer)
    if not is_real or points.ndim == 0 or points.shape[-1] != 2:
        raise ValueError(
            f"{name} must be real numbers of shape (..., 2), rows (x, y), got {points.dtype} of shape {points.shape}."
        )
    is_wide = jnp.issubdtype(points.dtype, jnp.floating) and points.dtype.itemsize >= 4
    return points if is_wide else points.astype(jnp.zeros(()).dtype)  # JAX's default float type


def _finite(x: Points) -> Points:
    """Replace points that are not finite by a point outside every grid."""
    return jnp.where(jnp.isfinite(x), x, -1)
