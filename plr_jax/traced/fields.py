"""Checks of points, and answers of NaN, that all distance functions on traced maps (*fields*) share."""

from contextlib import suppress
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import shortened
from plr_jax._types import ArrayLike

FAR = 1e18  # outside every map; its square does not overflow


@jax.jit
def distance(field: Any, *points: Float[Array, "*#batch 2"]) -> Float[Array, "*batch"]:
    """Return the distance of each point to the field's goal or, given two arrays of points, between their points.

    The distance is NaN where a coordinate is NaN, and everywhere if ``field.has_no_answers``.
    """
    ends = jnp.broadcast_arrays(*points)
    is_nan = reduce(jnp.logical_or, [jnp.isnan(x).any(axis=-1) for x in ends]) | field.has_no_answers
    value = field.paths.distance(*(replace_nonfinite(x).reshape(-1, 2) for x in ends))
    return jnp.where(is_nan, jnp.nan, value.reshape(is_nan.shape))


def replace_nonfinite(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    return jnp.where(jnp.isfinite(x), x, -FAR)


def require_one_map(field: Any, call: str) -> None:
    """Raise ``ValueError`` if a field made under ``jax.vmap`` is called outside; the message recommends ``call``."""
    if maps := jnp.shape(field.has_no_answers):
        batch = " x ".join(map(str, maps))
        raise ValueError(f"This field holds a batch of {batch} maps (it was made under vmap): use it as {call}.")


def as_points(name: str, value: ArrayLike) -> Array | np.ndarray:
    points = as_array(value, f"{name} must be points (..., 2)")
    is_real = jnp.issubdtype(points.dtype, jnp.floating) or jnp.issubdtype(points.dtype, jnp.integer)
    if not is_real or points.ndim == 0 or points.shape[-1] != 2:
        got = f"{points.dtype} of shape {points.shape}"
        raise ValueError(f"{name} must be real numbers of shape (..., 2), rows (x, y), got {got}.")
    return points


def as_array(value: ArrayLike, expected: str) -> Array | np.ndarray:
    """Convert a value to an array; if this fails, raise a ``ValueError`` that begins with ``expected``."""
    try:
        if isinstance(value, jax.Array):
            return value
        # NumPy converts booleans and floats, for which JAX would compile a program. It refuses two kinds of lists:
        # - of traced numbers (TracerArrayConversionError), which JAX converts below;
        # - ragged ones (ValueError), which JAX refuses, too.
        with suppress(jax.errors.TracerArrayConversionError, ValueError), np.errstate(over="ignore"):
            array = np.asarray(value)
            if array.dtype.kind in "bf":
                return array.astype(jax.dtypes.canonicalize_dtype(array.dtype), copy=False)
        return jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{expected}, got {shortened(value)}.") from None


def as_floats(value: Array | np.ndarray) -> Array | np.ndarray:
    """Convert numbers to floats of at least 32 bits."""
    is_wide = jnp.issubdtype(value.dtype, jnp.floating) and value.dtype.itemsize >= 4
    return value if is_wide else value.astype(jax.dtypes.canonicalize_dtype(np.float64))
