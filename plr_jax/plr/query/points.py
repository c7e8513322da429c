"""Points as a query takes them, or an error that says what was expected."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from plr_jax._types import ArrayLike
from plr_jax.plr.query.tables import Tables


def as_array(x: ArrayLike) -> np.ndarray:
    """Points on the host. Integers become floats here, where they cannot wrap around."""
    try:
        x = np.asarray(x)
    except ValueError as error:
        raise ValueError(f"Points must be an array of numbers, got {x!r}.") from error
    if x.dtype in (np.float32, np.float64):
        return x
    if x.dtype.kind in "iub" or (x.dtype.kind == "f" and x.dtype.itemsize > np.dtype(np.float64).itemsize):
        return x.astype(np.float64)
    _require_real(x)  # which JAX cannot even be shown
    return x


def require_points(tables: Tables, x: Array) -> None:
    """Raise ``ValueError`` if an array does not hold points for these tables, by its shape and type alone."""
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    _require_real(x)


def _require_real(x: Array | np.ndarray) -> None:
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}.")
