"""Arrays and numbers from outside: of the right shape and range, or an error that says what was expected."""

import reprlib

import numpy as np
from jaxtyping import Float

from plr_jax._types import ArrayLike

_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxstring, _REPR.maxother, _REPR.maxlong = 3, 80, 160, 80
_LONGEST = 200


def as_points(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, "n dim"]:
    """A batch of points as a float64 array.

    Args:
        name: What the points are called in an error.
        value: Anything array-like of shape ``(n, dim)``; NaN and infinity are let through.
        dim: Coordinates a point; any number of them, but at least one, where not given.

    Returns:
        The points, ``(n, dim)``; the given array itself where it is one of float64.

    Raises:
        ValueError: If the shape is another one, or the values are not numbers.
    """
    expected = f"shape (n, {'dim' if dim is None else dim})"
    points = as_numbers(name, value, f"numbers of {expected}")
    if points.ndim != 2 or points.shape[1] != (dim or max(1, points.shape[1])):
        single = points.ndim == 1 and points.size == (dim or max(1, points.size))
        hint = f" Use {name}[None] for a single point." if single else ""
        raise ValueError(f"{name} must have {expected}, got {points.shape}.{hint}")
    return points


def as_point(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, "dim"]:
    """One point as a float64 array.

    Args:
        name: What the point is called in an error.
        value: Anything array-like of shape ``(dim,)``; NaN and infinity are let through.
        dim: Number of coordinates; any, but at least one, where not given.

    Returns:
        The point, ``(dim,)``; the given array itself where it is one of float64.

    Raises:
        ValueError: If the shape is another one, or the values are not numbers.
    """
    expected = f"shape ({'dim' if dim is None else dim},)"
    point = as_numbers(name, value, f"numbers of {expected}")
    if point.ndim != 1 or point.size != (dim or max(1, point.size)):
        raise ValueError(f"{name} must be one point of {expected}, got shape {point.shape}.")
    return point


def as_finite_point(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, "dim"]:
    """One point to be kept, such as a goal: a read-only copy, free of NaN and infinity.

    Args:
        name: What the point is called in an error.
        value: Anything array-like of shape ``(dim,)``.
        dim: Number of coordinates; any, but at least one, where not given.

    Returns:
        The point, ``(dim,)``.

    Raises:
        ValueError: If the shape is another one, or a value is not a finite number.
    """
    point = as_point(name, value, dim).copy()
    if not np.isfinite(point).all():
        raise ValueError(f"{name} must have finite coordinates, got {point.tolist()}.")
    point.flags.writeable = False
    return point


def as_numbers(name: str, value: ArrayLike, expected: str) -> Float[np.ndarray, "..."]:
    """An array of any shape as one of float64.

    Args:
        name: What the numbers are called in an error.
        value: Anything array-like; NaN and infinity are let through.
        expected: What they must be, after "must be".

    Returns:
        The numbers; the given array itself where it is one of float64.

    Raises:
        ValueError: If the values are not real numbers.
    """
    try:
        numbers = np.asarray(value)
        if np.iscomplexobj(numbers):  # whose imaginary parts NumPy would drop
            raise TypeError
        return np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be {expected}, got {shortened(value)}.") from None


def require_integer(name: str, value: object, least: int) -> None:
    """Raise ``ValueError`` if a value is not an integer that is large enough."""
    if not (isinstance(value, int | np.integer) and value >= least):
        raise ValueError(f"{name} must be an integer >= {least}, got {value!r}.")


def shortened(value: object) -> str:
    """A value as an error shows it: its ``repr`` in at most 200 characters, of which the rest is never built."""
    try:
        text = _REPR.repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, lists without end
        text = f"a very large {type(value).__name__}"
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
