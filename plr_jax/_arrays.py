"""Arrays and numbers from outside: of the right shape and range, or an error that says what was expected."""

import reprlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Shaped

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


def as_values(name: str, value: ArrayLike, n: int) -> Float[np.ndarray, "n"]:
    """What a function says of a batch of points, one number a point, as a float64 array.

    Args:
        name: What the function is called in an error.
        value: What it returned; NaN and infinity are let through. Masked entries are no answer: ``inf``.
        n: Number of points.

    Returns:
        The values, ``(n,)``.

    Raises:
        ValueError: If the shape is another one, or the values are not real numbers.
    """
    if isinstance(value, np.ma.MaskedArray):
        value = np.where(np.ma.getmaskarray(value), np.inf, value.data)
    values = as_numbers(f"{name}'s answer", value, f"real numbers of shape ({n},)")
    if values.shape != (n,):
        raise ValueError(f"{name} must give one number a point, shape ({n},), got {values.shape}.")
    return values


def as_distances(name: str, value: ArrayLike, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
    """What a distance function says of points, as a float64 array: the one check of an oracle's answer.

    Args:
        name: What the function is called in an error.
        value: What it returned. Masked entries mean ``inf``.
        x: The points it was given.

    Returns:
        The distances, ``(n,)``; ``inf`` where the goal cannot be reached.

    Raises:
        ValueError: As :func:`as_values`, or if a distance is NaN or ``-inf``.
    """
    distances = as_values(name, value, len(x))
    bad = np.flatnonzero(np.isnan(distances) | (distances == -np.inf))
    if bad.size:
        value = "NaN" if np.isnan(distances[bad[0]]) else "-inf"
        raise ValueError(f"{name} gives {value} at {x[bad[0]].tolist()}; use inf for unreachable.")
    return distances


def require_integer(name: str, value: object, least: int) -> None:
    """Raise ``ValueError`` if a value is not an integer that is large enough."""
    if not (isinstance(value, int | np.integer) and value >= least):
        raise ValueError(f"{name} must be an integer >= {least}, got {value!r}.")


def padded_size(n: int, sizes: Sequence[int] = ()) -> int:
    """Rows to fill an array up to, so that compiled functions see arrays of few sizes.

    Args:
        n: Rows that there are.
        sizes: Sizes to choose from, increasing.

    Returns:
        The least of the sizes that is at least ``n``, else the next power of two.
    """
    return next((size for size in sizes if size >= n), 1 << max(n - 1, 0).bit_length())


def padded(rows: Shaped[np.ndarray, "n *row"], size: int, fill: ArrayLike = 0) -> Shaped[np.ndarray, "padded *row"]:
    """An array filled up to a size, as :func:`padded_size` gives.

    Args:
        rows: The array; no rows are fine.
        size: Rows of the result, at least as many.
        fill: One row, or what broadcasts to one, for the rest.

    Returns:
        A copy of the same type, the rows first.
    """
    result = np.empty((size, *rows.shape[1:]), rows.dtype)
    result[: len(rows)], result[len(rows) :] = rows, fill
    return result


def shortened(value: object) -> str:
    """A value as an error shows it: its ``repr`` in at most 200 characters, of which the rest is never built."""
    try:
        text = _REPR.repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, lists without end
        text = f"a very large {type(value).__name__}"
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
