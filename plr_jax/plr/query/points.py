"""The compiled queries of tables, and the points that they are given: checked, and placed before they are rounded."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import as_queries
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr.query.frame import Outside
from plr_jax.plr.query.lookup import bounds_of_tables, evaluate_tables, lookup, waypoints_in_tables
from plr_jax.plr.query.tables import Tables

find_leaves = jax.jit(lookup)
"""The leaf of each point, as its index."""


@jax.jit
def evaluate_points(tables: Tables, x: Array) -> Float[Array, "*batch"]:
    """Checks and answers points; what is checked depends on shape and type alone, so it is checked once for each."""
    _check_points(tables, x)
    return evaluate_tables(tables, x)


@partial(jax.jit, static_argnames="outside")  # which would add a tenth to what a call of the other takes
def evaluate_points_anywhere(tables: Tables, x: Array, outside: Outside) -> Float[Array, "*batch"]:
    """The same with another answer outside the domain."""
    _check_points(tables, x)
    return evaluate_tables(tables, x, outside)


@jax.jit
def bound_points(band: Float[Array, "2 rows"], tables: Tables, x: Array) -> tuple[Float[Array, "*batch"], ...]:
    """Checks points and gives bounds."""
    _check_points(tables, x)
    return bounds_of_tables(tables, band, x)


@jax.jit
def waypoints_of_points(tables: Tables, x: Array) -> Float[Array, "*batch dim"]:
    """Checks points and gives sources."""
    _check_points(tables, x)
    return waypoints_in_tables(tables, x)


def as_array(x: ArrayLike) -> np.ndarray:
    """Points on the host. Integers become floats here, where they cannot wrap around, and masked numbers NaN."""
    x = as_queries(x)
    if x.dtype in (np.float32, np.float64):
        return x
    if x.dtype.kind in "iub" or (x.dtype.kind == "f" and x.dtype.itemsize > np.dtype(np.float64).itemsize):
        return x.astype(np.float64)
    _require_real(x)  # which JAX cannot even be shown
    return x


def _check_points(tables: Tables, x: Array) -> None:
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    _require_real(x)


def _require_real(x: Array | np.ndarray) -> None:
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}.")


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """Placing points on the host: around periodic axes, and from a corner far from the origin.

    Attributes:
        domain: The domain, if it has a periodic axis; else None.
        corner: The corner from which the tables count coordinates; None for the origin.
    """

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The points as the tables want them."""
        if self.domain is not None:
            x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner
