"""Measure the error of an approximate distance function."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_distances, as_points, as_values
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.geometry.box import Slice
from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces import FreeTest

__all__ = ["ErrorReport", "error_grid", "error_map"]

_QUANTILES = (0.5, 0.9, 0.99, 0.999)
_DIGITS = 4  # of the largest distance, to which a place is told, however far from the origin it is


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
        decimals = _DIGITS - math.floor(math.log10(self.max_distance or 1.0))
        where = ", ".join(f"{round(c, max(decimals, 0)):.15g}" for c in self.max_at)
        text = (
            f"max error {self.max:.3g} at ({where}), mean {self.mean:.3g}, "
            f"over {self.num_points - self.num_unreachable:,} points"
        )
        return text + (f"; {self.num_unanswered:,} of them not answered" if self.num_unanswered else "")


def error_map(
    approximation: Callable[[ArrayLike], ArrayLike],
    distance_fn: DistanceFn,
    x: ArrayLike,
) -> ErrorReport:
    """Measure an approximation against a distance function.

    Args:
        approximation: What is judged: a PLR, or any function from points ``(n, dim)`` to ``(n,)`` numbers.
        distance_fn: The reference, ``(n, dim) -> (n,)``; infinite where unreachable.
        x: Where, ``(n, dim)`` points, at least one: ``workspace.sample_free(n, seed)``, or the cell centers
            ``workspace.bounds.grid(resolution).reshape(-1, 2)``, of which those that are not free do not count.

    Returns:
        The report.

    Raises:
        ValueError: If ``x`` has another shape or no row, the reference is infinite at all points, either
            function gives the wrong shape, or the reference gives NaN.

    References:
        The error ``epsilon_g`` of Putman et al., Section IV-A, Fig. 2 and Table I.
    """
    x = as_points("x", x)
    if len(x) == 0:
        raise ValueError("An error needs points to be measured at, got none.")
    distance = as_distances("The distance function", distance_fn(x.copy()), x)
    answer = as_values("The approximation", approximation(x.copy()), len(x))
    reachable, answered = np.isfinite(distance), np.isfinite(answer)
    both = reachable & answered
    if not both.any():
        raise ValueError(
            f"No error is defined: of {len(x)} points the distance function is finite at "
            f"{reachable.sum()}, and the approximation at none of those."
        )
    error = np.abs(answer[both] - distance[both])
    worst = int(np.argmax(error))
    return ErrorReport(
        max=float(error[worst]),
        mean=float(error.mean()),
        quantiles={q: float(np.quantile(error, q)) for q in _QUANTILES},
        max_at=tuple(map(float, x[both][worst])),
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
    """Error ``|L(x) - V(x)|`` at the cell centers of a grid over the workspace: the picture of Fig. 2.

    Args:
        approximation: What is judged, as in :func:`error_map`.
        distance_fn: The reference.
        workspace: Where. In its place, a configuration space, whose free configurations count.
        at: Of a space of more than two dimensions, where the slice is that the grid is of: coordinates by axis,
            counted from 0, of all axes but two.
        resolution: Number of square cells along the longer side of the bounds.

    Returns:
        Errors, row 0 at the lowest ``y``. NaN where not free or not reachable; infinite where the
        approximation has no answer for a reachable point.

    Raises:
        ValueError: If either function gives the wrong shape, the reference gives NaN, ``at`` leaves other than two
            axes or leads outside the domain, or the resolution is less than 1.
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
