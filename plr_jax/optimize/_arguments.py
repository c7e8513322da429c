"""What :func:`optimize_paths` is given, checked."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, require_integer
from plr_jax._problem import Problem
from plr_jax._types import ArrayLike


def differentiable(problem: Problem, distance_fns: Sequence[Any] | None) -> tuple[Any, ...]:
    """The distance functions as pytrees, after a trial."""
    fns = () if distance_fns is None else tuple(distance_fns)
    if fns and len(fns) != len(problem.robots):
        raise ValueError(f"distance_fns must be one a robot, {len(problem.robots)}, got {len(fns)}.")
    for i, fn in enumerate(fns):
        points = jax.ShapeDtypeStruct((2, getattr(fn, "dim", problem.dof)), jnp.float32)
        try:
            shape = jax.eval_shape(fn, points).shape
        except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
            raise ValueError(f"distance_fns[{i}] must be a function that JAX can trace, such as a PLR.") from error
        if shape != (2,):
            raise ValueError(
                f"distance_fns[{i}] must take points (n, dim) to distances (n,), got {shape} for 2 points."
            )
    return tuple(jax.tree_util.Partial(fn) if jax.tree.leaves(fn) == [fn] else fn for fn in fns)


def as_paths(problem: Problem, paths: ArrayLike) -> Float[np.ndarray, "guesses steps robots dof"]:
    """The given paths as a batch, checked."""
    shape = f"(steps, robots, dof) or (guesses, steps, robots, dof) with (robots, dof) = {problem.starts.shape}"
    batch = as_numbers("Paths", paths, f"numbers of shape {shape}")
    batch = batch[None] if batch.ndim == 3 else batch
    if batch.ndim != 4 or batch.shape[2:] != problem.starts.shape or 0 in batch.shape:
        raise ValueError(f"Paths must have shape {shape}, at least one guess of one step, got {np.shape(paths)}.")
    if not np.isfinite(batch).all():
        raise ValueError(f"Paths must be finite; path {np.argwhere(~np.isfinite(batch))[0, 0]} is not.")
    for row, wanted, name in ((0, problem.starts, "starts"), (-1, problem.goals, "goals")):
        for i, robot in enumerate(problem.robots):
            dof = robot.dof
            off = np.flatnonzero((batch[:, row, i, :dof] != wanted[i, :dof]).any(axis=1))
            if off.size:
                raise ValueError(
                    f"Path {off[0]} must have the problem's {name} as its {'first' if row == 0 else 'last'} row, got "
                    f"{batch[off[0], row, i, :dof].tolist()} for robot {i}, not {wanted[i, :dof].tolist()}."
                )
    return batch


def check_options(
    num_retimings: int, num_iterations: int, margin: float | int | None, smoothness: float | int, seed: int
) -> None:
    """Raise ``ValueError`` for an option out of its range."""
    for name, value, least in (
        ("num_retimings", num_retimings, 0),
        ("num_iterations", num_iterations, 1),
        ("seed", seed, 0),
    ):
        require_integer(name, value, least)
    if margin is not None and not (np.isfinite(margin) and margin > 0):
        raise ValueError(f"margin must be positive and finite, got {margin!r}.")
    if not (np.isfinite(smoothness) and smoothness >= 0):
        raise ValueError(f"smoothness must be finite and at least 0, got {smoothness!r}.")
