"""What :func:`optimize_paths` is given, checked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import as_finite, as_number, as_numbers, require_integer
from plr_jax._problem import Problem
from plr_jax._pytree import as_pytree
from plr_jax._types import ArrayLike, DimensionedFn


def differentiable(problem: Problem, distance_fns: Sequence[Any] | None) -> tuple[Any, ...]:
    """The distance functions as pytrees, after a trial."""
    fns = () if distance_fns is None else tuple(distance_fns)
    if fns and len(fns) != len(problem.robots):
        raise ValueError(f"distance_fns must be one a robot, {len(problem.robots)}, got {len(fns)}.")
    for i, fn in enumerate(fns):
        dim = fn.dim if isinstance(fn, DimensionedFn) else problem.dof
        if not 1 <= dim <= problem.dof:
            raise ValueError(f"distance_fns[{i}] takes {dim} coordinates, configurations have {problem.dof}.")
        points = jax.ShapeDtypeStruct((2, dim), jnp.float32)
        try:
            shape = jax.eval_shape(fn, points).shape
        except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
            raise ValueError(f"distance_fns[{i}] must be a function that JAX can trace, such as a PLR.") from error
        if shape != (2,):
            raise ValueError(
                f"distance_fns[{i}] must take points (n, dim) to distances (n,), got {shape} for 2 points."
            )
    return tuple(map(_as_argument, fns))


@dataclass(frozen=True)
class _OfLeadingCoordinates:
    """A function of the leading coordinates; equal for equal functions, so that JAX compiles once."""

    fn: Callable[[Array], Array]
    dim: int

    def __call__(self, q: Array) -> Array:
        return self.fn(q[:, : self.dim])


def _as_argument(fn: Any) -> Any:
    pytree = as_pytree(fn)
    if pytree is fn or not isinstance(fn, DimensionedFn):
        return pytree
    return as_pytree(_OfLeadingCoordinates(fn, fn.dim))  # a Partial does not pass on the attribute ``dim``


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
    num_retimings: int,
    num_iterations: int,
    margin: float | int | None,
    smoothness: float | int,
    makespan_factor: float | int,
    seed: int,
) -> None:
    """Raise ``ValueError`` for an option out of its range."""
    for name, value, least in (
        ("num_retimings", num_retimings, 0),
        ("num_iterations", num_iterations, 1),
        ("seed", seed, 0),
    ):
        require_integer(name, value, least)
    if margin is not None:
        as_finite("margin", margin, positive=True)
    as_finite("smoothness", smoothness)
    as_number("makespan_factor", makespan_factor, "a number of at least 1, or inf", lambda factor: factor >= 1)
