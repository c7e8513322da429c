"""Measure errors of an approximate distance function, and costs and durations of paths.

`error_map` compares an approximation with the exact function at given points, `error_grid` on a grid of points.
`path_cost` and `makespan` take a problem and a path of its robots.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_distances, as_points, as_values
from plr_jax._problem import makespan, path_cost
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.geometry.box import Slice
from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces import FreeTest

__all__ = ["ErrorReport", "error_grid", "error_map", "makespan", "path_cost"]
_QUANTILES = (0.5, 0.9, 0.99, 0.999)
_DIGITS = 4  # digits of a printed position, relative to the largest distance


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True)
class ErrorReport:
    """Statistics of the error ``|L(x) - V(x)|`` of an approximation ``L`` of a distance function ``V``.

    Errors and distances are in workspace units. Errors are taken at the points where both functions are finite.

    Attributes:
        max: Largest error.
        mean: Mean error.
        quantiles: For each share 0.5, 0.9, 0.99 and 0.999, the error that this share of the points does not exceed.
        max_at: Point of the largest error, ``(dim,)``.
        max_distance: Largest finite distance ``V``, as a scale for the errors.
        num_points: Number of all points ``x``.
        num_unreachable: Number of points where ``V`` is infinite; the error is undefined there.
        num_unanswered: Number of points where ``V`` is finite and ``L`` is not.
        num_invented: Number of points where ``V`` is infinite and ``L`` is finite.
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
        decimals = _DIGITS - math.floor(math.log10(self.max_distance or 1.0))
        where = ", ".join(f"{round(c, max(decimals, 0)):.15g}" for c in self.max_at)
        num, unanswered = self.num_points - self.num_unreachable, self.num_unanswered
        text = f"max error {self.max:.3g} at ({where}), mean {self.mean:.3g}, over {num:,} points"
        return text + (f"; {unanswered:,} of them not answered" if unanswered else "")


def error_map(approximation: Callable[[ArrayLike], ArrayLike], distance_fn: DistanceFn, x: ArrayLike) -> ErrorReport:
    """Measure the error of an approximation at given points: ``epsilon_g`` of Putman et al., Section IV-A.

    Args:
        approximation: A PLR, or any function of points ``(n, dim)`` that returns ``(n,)`` numbers.
        distance_fn: The exact distance function, ``(n, dim) -> (n,)``; infinite where the goal is unreachable.
        x: Points ``(n, dim)``, at least one: for example ``workspace.sample_free(n, seed)``, or cell centers,
            ``workspace.bounds.grid(resolution).reshape(-1, 2)``. Points that are not free count as unreachable.

    Raises:
        ValueError: If ``x`` has another shape or no rows, no point has a finite distance and a finite approximation,
            the distance function is NaN at a point, or a function returns a wrong shape.
    """
    x = as_points("x", x)
    if len(x) == 0:
        raise ValueError("x must hold at least one point, got none.")
    distance = as_distances("The distance function", distance_fn(x.copy()), x)
    answer = as_values("The approximation", approximation(x.copy()), len(x))
    reachable, answered = np.isfinite(distance), np.isfinite(answer)
    if not (is_compared := reachable & answered).any():
        finite = f"of {len(x)} points, the distance function is finite at {reachable.sum()}"
        raise ValueError(f"No error is defined: {finite}, and the approximation is finite at none of these.")
    error = np.abs(answer[is_compared] - distance[is_compared])
    worst = int(np.argmax(error))
    return ErrorReport(
        max=float(error[worst]),
        mean=float(error.mean()),
        quantiles={q: float(np.quantile(error, q)) for q in _QUANTILES},
        max_at=tuple(map(float, x[is_compared][worst])),
        max_distance=float(distance[reachable].max()),
        num_points=len(x),
        num_unreachable=int((~reachable).sum()),
        num_unanswered=int((reachable & ~answered).sum()),
        num_invented=int((answered & ~reachable).sum()),
    )


def error_grid(
    approximation: Callable[[ArrayLike], ArrayLike],
    distance_fn: DistanceFn,
    workspace: Workspace | FreeTest,
    *,
    at: Mapping[int, float | int] | None = None,
    resolution: int = 512,
) -> Float[np.ndarray, "rows columns"]:
    """Compute the error ``|L(x) - V(x)|`` on a grid of cell centers over the workspace, as in Fig. 2 of the paper.

    Args:
        approximation: A PLR, or another function, as in :func:`error_map`.
        distance_fn: The exact distance function.
        workspace: The workspace, or a configuration space. Errors are computed only at its free points.
        at: For more than two dimensions, the slice that the grid covers: a dict from axis to coordinate, for all axes
            but two.
        resolution: Number of nearly square cells along the longer side of the bounds, at least 1.

    Returns:
        Errors ``(rows, columns)``; row 0 has the lowest ``y``. The error is NaN where a cell center is not free or
        the distance is infinite, and ``inf`` where the distance is finite but the approximation is not.

    Raises:
        ValueError: If a function returns a wrong shape, the distance function returns NaN, ``at`` leaves other than
            two axes or lies outside the domain, or the resolution is less than 1.
    """
    domain = workspace.bounds if isinstance(workspace, Workspace) else workspace.domain
    centers = Slice.of(domain, at).grid(resolution)
    points = centers.reshape(-1, domain.dim)
    free = workspace.is_free(points)
    distance = np.full(len(points), np.inf)
    distance[free] = as_distances("The distance function", distance_fn(points[free]), points[free])
    reachable = np.isfinite(distance)
    error = np.full(len(points), np.nan)
    answer = as_values("The approximation", approximation(points[reachable]), int(reachable.sum()))
    error[reachable] = np.abs(np.where(np.isnan(answer), np.inf, answer) - distance[reachable])
    return error.reshape(centers.shape[:2])
