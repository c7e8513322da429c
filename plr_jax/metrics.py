"""How far an approximation of a distance function is from the distance function."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._box import Box
from plr_jax._types import ArrayLike, DistanceFn, Distances, Points
from plr_jax._workspace import Workspace

_QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass(frozen=True)
class ErrorReport:
    """Error ``|L(x) - V(x)|`` of an approximation ``L`` of a distance function ``V``, over many points.

    ``max``, ``mean`` and ``quantiles`` are over the points where both are finite, in workspace units; the
    points where only one of them is are counted instead. All fields are plain numbers, fit for JSON.

    Attributes:
        max: Largest error.
        mean: Mean error.
        quantiles: Errors not exceeded by a share 0.5, 0.9, 0.99 and 0.999 of the points.
        max_at: The point of the largest error, ``(dim,)``.
        max_distance: Largest distance ``V``; a scale for the errors.
        num_points: Points asked about.
        num_unreachable: Points where ``V`` is infinite: no error is defined there.
        num_unanswered: Points where ``V`` is finite and ``L`` is not. Should be 0; an approximation that
            prunes a search must not leave any.
        num_invented: Points where ``V`` is infinite and ``L`` is finite.
    """

    max: float
    mean: float
    quantiles: dict[float, float]
    max_at: tuple[float, ...]
    max_distance: float
    num_points: int
    num_unreachable: int
    num_unanswered: int
    num_invented: int

    def __str__(self) -> str:
        where = ", ".join(f"{c:.4g}" for c in self.max_at)
        text = (
            f"max error {self.max:.3g} at ({where}), mean {self.mean:.3g}, "
            f"over {self.num_points - self.num_unreachable:,} points"
        )
        return text + (f"; {self.num_unanswered:,} of them not answered" if self.num_unanswered else "")


def error_map(
    approximation: Callable[[ArrayLike], ArrayLike],
    distance_fn: DistanceFn,
    where: Workspace | Points,
    *,
    resolution: int = 256,
    num_random: int = 0,
    seed: int = 0,
) -> ErrorReport:
    """Measure an approximation against a distance function over free space.

    Args:
        approximation: What is judged: a PLR, or any function from points ``(n, dim)`` to ``(n,)`` numbers.
        distance_fn: The reference, ``(n, dim) -> (n,)``; infinite where unreachable.
        where: A workspace, whose free points are taken; or the points themselves, ``(n, dim)``.
        resolution: For a workspace: a grid of square cells, this many along its longer side, is laid over
            the bounds, and the cell centers that are free are taken. 0 for no grid.
        num_random: For a workspace: this many uniformly random free points are taken besides.
        seed: Seed of the random points.

    Returns:
        The report.

    Raises:
        ValueError: If there is no point, the reference is infinite at all of them, either function gives the
            wrong shape, or the reference gives NaN.

    References:
        The error ``epsilon_g`` of Putman et al., Section IV-A, Fig. 2 and Table I.
    """
    if isinstance(where, Workspace):
        points = _free_points(where, resolution, num_random, seed)
    else:
        points = np.asarray(where, dtype=np.float64)
    if points.ndim != 2 or len(points) == 0:
        raise ValueError(f"Expected points of shape (n, dim) with n >= 1, got {points.shape}.")
    distance = _reference(distance_fn, points)
    return _report(points, distance, _answers("approximation", approximation, points))


def error_grid(
    approximation: Callable[[ArrayLike], ArrayLike],
    distance_fn: DistanceFn,
    workspace: Workspace,
    *,
    resolution: int = 512,
) -> Float[np.ndarray, "rows columns"]:
    """Error ``|L(x) - V(x)|`` at the cell centers of a grid over the workspace: the picture of Fig. 2.

    Args:
        approximation: What is judged, as in :func:`error_map`.
        distance_fn: The reference.
        workspace: Where.
        resolution: Number of square cells along the longer side of the bounds.

    Returns:
        Errors, row 0 at the lowest ``y``. NaN where not free or not reachable; infinite where the
        approximation has no answer for a reachable point.

    Raises:
        ValueError: If either function gives the wrong shape, or the reference gives NaN.
    """
    centers = grid_centers(workspace.bounds, resolution)
    points = centers.reshape(-1, 2)
    free = workspace.is_free(points)
    distance = np.full(len(points), np.inf)
    distance[free] = _reference(distance_fn, points[free])
    reachable = np.isfinite(distance)
    error = np.full(len(points), np.nan)
    answer = _answers("approximation", approximation, points[reachable])
    error[reachable] = np.abs(np.where(np.isnan(answer), np.inf, answer) - distance[reachable])
    return error.reshape(centers.shape[:2])


def grid_centers(bounds: Box, resolution: int) -> Float[np.ndarray, "rows columns 2"]:
    """Cell centers of a grid of (nearly) square cells over a 2-D box.

    Args:
        bounds: The box.
        resolution: Number of cells along its longer side, at least 1.

    Returns:
        The centers, row 0 at the lowest ``y``.
    """
    if resolution < 1:
        raise ValueError(f"The grid needs a resolution of at least 1, got {resolution}.")
    columns, rows = np.maximum(1, np.rint(resolution * bounds.width / bounds.width.max())).astype(int)
    x = bounds.lo[0] + bounds.width[0] * (np.arange(columns) + 0.5) / columns
    y = bounds.lo[1] + bounds.width[1] * (np.arange(rows) + 0.5) / rows
    return np.stack(np.meshgrid(x, y), axis=-1)


def _free_points(workspace: Workspace, resolution: int, num_random: int, seed: int) -> Points:
    parts = []
    if resolution > 0:
        centers = grid_centers(workspace.bounds, resolution).reshape(-1, 2)
        parts.append(centers[workspace.is_free(centers)])
    if num_random > 0:
        parts.append(workspace.sample_free(num_random, seed))
    return np.concatenate(parts) if parts else np.empty((0, 2))


def _answers(name: str, function: Callable[[ArrayLike], ArrayLike], points: Points) -> Distances:
    answers = np.asarray(function(points), dtype=np.float64)
    if answers.shape != (len(points),):
        raise ValueError(f"The {name} must give one number a point, shape ({len(points)},), got {answers.shape}.")
    return answers


def _reference(distance_fn: DistanceFn, points: Points) -> Distances:
    distance = _answers("distance function", distance_fn, points)
    if np.isnan(distance).any():
        raise ValueError(f"The distance function gives NaN at {points[np.isnan(distance)][0]}.")
    return distance


def _report(points: Points, distance: Distances, answer: Distances) -> ErrorReport:
    reachable, answered = np.isfinite(distance), np.isfinite(answer)
    both = reachable & answered
    if not both.any():
        raise ValueError(
            f"No error is defined: of {len(points)} points the distance function is finite at "
            f"{reachable.sum()}, and the approximation at none of those."
        )
    error = np.abs(answer[both] - distance[both])
    worst = int(np.argmax(error))
    return ErrorReport(
        max=float(error[worst]),
        mean=float(error.mean()),
        quantiles={q: float(np.quantile(error, q)) for q in _QUANTILES},
        max_at=tuple(map(float, points[both][worst])),
        max_distance=float(distance[reachable].max()),
        num_points=len(points),
        num_unreachable=int((~reachable).sum()),
        num_unanswered=int((reachable & ~answered).sum()),
        num_invented=int((answered & ~reachable).sum()),
    )
