"""What :func:`place` is given, checked."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, as_points, require_integer, shortened
from plr_jax._pytree import as_pytree
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace
from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective

_TRIED = 3


def location_problem(
    distance: Callable[[Any, Any], Any],
    workspace: Workspace,
    demand: ArrayLike,
    objective: str,
    weights: ArrayLike | None,
) -> LocationProblem:
    """The problem that the arguments state."""
    if not isinstance(workspace, Workspace):
        raise ValueError(f"workspace must be a Workspace, got {shortened(workspace)}.")
    try:
        of_all = PlacementObjective(objective)
    except ValueError:
        raise ValueError(f"objective must be 'sum' or 'max', got {shortened(objective)}.") from None
    points = _free_points(workspace, demand)
    return LocationProblem(workspace, _pair_distance(distance), of_all, points, _positive(weights, len(points)))


def check_counts(k: int, num_points: int, num_restarts: int, num_iterations: int, seed: int) -> None:
    """Raise ``ValueError`` for a number out of its range."""
    for name, value, least in (
        ("k", k, 1),
        ("num_restarts", num_restarts, 1),
        ("num_iterations", num_iterations, 1),
        ("seed", seed, 0),
    ):
        require_integer(name, value, least)
    if k > num_points:
        raise ValueError(f"k must be at most the number of demand points, {num_points:,}, got {k:,}.")


def _free_points(workspace: Workspace, demand: ArrayLike) -> Float[np.ndarray, "n 2"]:
    points = as_points("demand", demand, 2)
    if not len(points):
        raise ValueError("demand must have at least one point, got none.")
    blocked = np.flatnonzero(~workspace.is_free(points))
    if blocked.size:
        raise ValueError(
            f"demand must be points of free space: {blocked.size:,} of {len(points):,} are in an obstacle, outside "
            f"the bounds or not finite, such as {points[blocked[0]].tolist()}, number {blocked[0]}; leave them out."
        )
    return points


def _positive(weights: ArrayLike | None, count: int) -> Float[np.ndarray, "n"]:
    if weights is None:
        return np.ones(count)
    found = as_numbers("weights", weights, f"numbers of shape ({count},)")
    if found.shape != (count,):
        raise ValueError(f"weights must be one number a demand point, shape ({count},), got shape {found.shape}.")
    bad = np.flatnonzero(~((found > 0) & np.isfinite(found)))
    if bad.size:
        raise ValueError(
            f"weights must be positive and finite, got {found[bad[0]]} for demand point {bad[0]}; leave points out "
            "that do not count."
        )
    return found


def _pair_distance(distance: Callable[[Any, Any], Any]) -> Any:
    """The distance of two points as a pytree, after a trial."""
    expected = "distance must be a function that JAX can trace, such as a PairPLR, of points x and y (m, 2)"
    points = jax.ShapeDtypeStruct((_TRIED, 2), jnp.float32)
    try:
        found = jax.eval_shape(distance, points, points)
        shape, is_real = found.shape, jnp.issubdtype(found.dtype, jnp.floating)
    except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
        raise ValueError(f"{expected}, got {shortened(distance)}.") from error
    if shape != (_TRIED,) or not is_real:
        raise ValueError(
            f"{expected} to their distances (m,), got {found.dtype} of shape {shape} for {_TRIED} pairs."
        )
    return as_pytree(distance)
