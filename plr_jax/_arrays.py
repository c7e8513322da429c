"""Checks of the arguments that users pass to public functions, and helpers for NumPy arrays.

The helpers pad arrays, split and hash them, and index *ragged* arrays: consecutive runs of different lengths.

A function ``as_...`` checks a value, and returns it in the stated type. A bad value raises a ``ValueError``; the
message calls the value ``name``. NaN and infinity are accepted, and float64 arrays are returned without a copy,
unless stated otherwise.
"""

import math
import reprlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import reduce
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt64

from plr_jax._types import ArrayLike

IndexPairs: TypeAlias = tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]
_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxstring, _REPR.maxother, _REPR.maxlong = 3, 80, 160, 80
_LONGEST = 200  # most characters of a value in an error
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)  # of SplitMix64


def as_points(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, "n dim"]:
    """Check points, one per row, and return them as float64.

    If ``dim`` is None, points may have any number of coordinates, at least 1.
    """
    expected = f"shape (n, {'dim' if dim is None else dim})"
    points = as_numbers(name, value, f"numbers of {expected}")
    if points.ndim != 2 or points.shape[1] != (dim or max(1, points.shape[1])):
        single = points.ndim == 1 and points.size == (dim or max(1, points.size))
        hint = f" Use {name}[None] for a single point." if single else ""
        hint = f" Use {name}.T for rows of points." if _is_transposed(points, dim) else hint
        raise ValueError(f"{name} must have {expected}, got {points.shape}.{hint}")
    return points


def _is_transposed(points: Shaped[np.ndarray, "..."], dim: int | None) -> bool:
    return points.ndim == 2 and len(points) == dim and points.shape[1] > 3


def as_point(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, " dim"]:
    """Check one point, and return it as float64.

    If ``dim`` is None, the point may have any number of coordinates, at least 1.
    """
    expected = f"shape ({'dim' if dim is None else dim},)"
    point = as_numbers(name, value, f"numbers of {expected}")
    if point.ndim != 1 or point.size != (dim or max(1, point.size)):
        raise ValueError(f"{name} must be one point of {expected}, got shape {point.shape}.")
    return point


def as_finite_point(name: str, value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, " dim"]:
    """Check one point with finite coordinates, such as a goal; return a read-only float64 copy."""
    point = as_point(name, value, dim).copy()
    if not np.isfinite(point).all():
        raise ValueError(f"{name} must have finite coordinates, got {point.tolist()}.")
    point.flags.writeable = False
    return point


def is_traced(value: object) -> bool:
    """Return whether a value is a JAX tracer, or the exception that JAX raises if a tracer is used as an array.

    Only the name of the value's type is read, so that JAX need not be imported.
    """
    return "Tracer" in type(value).__name__


def as_numbers(name: str, value: ArrayLike, expected: str) -> Float[np.ndarray, "..."]:
    """Check an array of real numbers without masked entries, and return it as float64.

    ``expected`` describes a valid array in error messages.
    """
    try:
        numbers = np.asarray(value)
        if value is None or numbers.dtype.kind in "cUSMm":  # NumPy would convert strings, dates and complex numbers
            raise TypeError
        numbers = np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be {expected}, got {shortened(value)}.{_if_traced(error)}") from None
    if np.ma.is_masked(value):
        raise ValueError(f"{name} must be {expected}, and some are masked.")
    return numbers


def as_cells(expected: str, value: ArrayLike, fits: Callable[..., bool], hint: str = "") -> Bool[np.ndarray, "..."]:
    """Check an array of booleans without masked entries, one for each cell of a grid; return a copy in C order.

    ``fits`` returns whether a shape of the array is valid. ``expected`` begins every error message. ``hint`` ends the
    message if the value is an array of a wrong type or shape, or is masked.
    """
    try:
        cells = np.array(value, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{expected}, got {shortened(value)}.{_if_traced(error)}") from None
    if cells.dtype != bool or not fits(cells.shape) or np.ma.is_masked(value):
        masked = ", some masked" if np.ma.is_masked(value) else ""
        raise ValueError(f"{expected}, got {cells.dtype} of shape {cells.shape}{masked}.{hint}")
    return cells


def _if_traced(value: object) -> str:
    """Return advice for an error message if :func:`is_traced` holds for a value, else an empty text."""
    reason = "Workspaces, oracles and planners take concrete arrays, not those that JAX traces"
    advice = "inside jit, call them by jax.pure_callback. For distances on traced maps, use grid_distance."
    return f" {reason}: {advice}" if is_traced(value) else ""


def is_single(value: ArrayLike) -> bool:
    """Return whether NumPy converts a value to an array of 32-bit floats; False for a masked array."""
    try:
        return np.asarray(value).dtype == np.float32 and not np.ma.isMaskedArray(value)
    except (TypeError, ValueError):
        return False


def as_queries(value: ArrayLike, dim: int | None = None) -> Float[np.ndarray, "..."]:
    """Check query points ``(..., dim)`` and return them as 32-bit or 64-bit floats; masked numbers become NaN.

    Arrays of 32-bit floats without a mask keep their type. All other real numbers become float64, also JAX's
    ``bfloat16`` and 8-bit floats.
    """
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(np.float64), np.nan)
    try:
        points = np.asarray(value)
    except (TypeError, ValueError) as error:
        advice = " JAX traces them: use load instead of load_numpy, and pass one array, jnp.asarray(x)."
        message = f"Points must be an array of numbers, got {shortened(value)}.{advice if is_traced(error) else ''}"
        raise ValueError(message) from error
    # NumPy does not count narrow floats of JAX as numbers.
    if points.dtype.kind not in "iubf" and not points.dtype.name.startswith(("bfloat", "float8")):
        raise ValueError(f"Points must be real numbers, got an array of {points.dtype}.")
    if dim is not None and (points.ndim == 0 or points.shape[-1] != dim):
        hint = " Transpose them: one point a row." if _is_transposed(points, dim) else ""
        raise ValueError(f"Points must have shape (..., {dim}), got {points.shape}.{hint}")
    return points if points.dtype in (np.float32, np.float64) else points.astype(np.float64)


def filled_with_inf(value: ArrayLike) -> ArrayLike:
    """Convert a masked array to an ordinary array, with ``inf`` for masked entries; return other values unchanged."""
    if isinstance(value, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(value), np.inf, value.data)
    return value


def as_values(name: str, value: ArrayLike, n: int) -> Float[np.ndarray, " n"]:
    """Check that ``value``, the result of a function called ``name`` for ``n`` points, is one real number per point.

    Return the result as float64; masked entries become ``inf``.
    """
    values = as_numbers(f"{name}'s answer", filled_with_inf(value), f"real numbers of shape ({n},)")
    if values.shape != (n,):
        called = f"it is called with a batch of points ({n}, dim)"
        raise ValueError(f"{name} must give one number per point, shape ({n},), got {values.shape}; {called}.")
    return values


def as_booleans(name: str, value: ArrayLike, n: int) -> Bool[np.ndarray, " n"]:
    """Check that ``value``, the result of a function called ``name`` for ``n`` points, is one boolean per point.

    No entry may be masked. Return the result as an array.
    """
    return as_cells(f"{name} must give one boolean per point, shape ({n},)", value, (n,).__eq__)


def as_distances(name: str, value: ArrayLike, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, " n"]:
    """Check the distances ``value`` that a function called ``name`` returned for points ``x``.

    Check and return them like :func:`as_values`. In addition, no distance may be NaN or ``-inf``.
    """
    distances = as_values(name, value, len(x))
    bad = np.flatnonzero(np.isnan(distances) | (distances == -np.inf))
    if bad.size:
        value = "NaN" if np.isnan(distances[bad[0]]) else "-inf"
        raise ValueError(f"{name} gives {value} at {x[bad[0]].tolist()}; use inf for unreachable points.")
    return distances


def require_integer(name: str, value: object, least: int) -> None:
    if not (isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= least):
        hint = f" Use {int(value)}." if isinstance(value, float) and value.is_integer() and value >= least else ""
        raise ValueError(f"{name} must be an integer >= {least}, got {shortened(value)}.{hint}")


def as_number(name: str, value: object, expected: str, in_range: Callable[[float], bool]) -> float:
    """Check a real number for which ``in_range`` returns True, and return it as a float.

    ``expected`` describes a valid number in error messages. For a value that is no number, and for an integer too
    large for a float, ``in_range`` is called with NaN, for which it must return False.
    """
    number = math.nan
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        with suppress(OverflowError):
            number = float(value)
    if not in_range(number):
        raise ValueError(f"{name} must be {expected}, got {shortened(value)}.{_if_traced(value)}")
    return number


def as_finite(name: str, value: object, *, positive: bool = False) -> float:
    """Check a finite number of at least 0 (above 0 if ``positive``), and return it as a float."""
    if positive:
        return as_number(name, value, "a positive finite number", lambda number: 0 < number < math.inf)
    return as_number(name, value, "a finite number of at least 0", lambda number: 0 <= number < math.inf)


def as_offsets(value: ArrayLike | None, count: int) -> Float[np.ndarray, " goals"]:
    """Check costs of using goals, ``(count,)``, finite and at least 0, and return them; None stands for zeros."""
    form = f"{count} finite numbers of at least 0, one per goal"
    costs = as_numbers("offsets", np.zeros(count) if value is None else value, form)
    if costs.shape != (count,) or not ((costs >= 0) & np.isfinite(costs)).all():
        raise ValueError(f"offsets must be {form}, got {shortened(value)}.")
    return costs


def padded_size(n: int, sizes: Sequence[int] = ()) -> int:
    """Return the number of rows to which ``n`` rows are padded, so that compiled functions see few shapes.

    The result is the first of ``sizes`` that is at least ``n``. If all are less, it is the next power of two.
    """
    return next((size for size in sizes if size >= n), 1 << max(n - 1, 0).bit_length())


def size_in_eighths(n: int) -> int:
    """Return the number of rows to which ``n`` rows are padded: at most ``n * 9 / 8``.

    There are at most 8 such numbers between a power of two and the next one.
    """
    # The next power of two, P, is below 2 * n, so P / 16 is below n / 8. Sizes are multiples of P / 16.
    step = max(1, padded_size(n) // 16)
    return -(-n // step) * step


def padded(
    rows: Shaped[np.ndarray, " n *row"], size: int | None = None, fill: ArrayLike = 0
) -> Shaped[np.ndarray, " padded *row"]:
    """Return a copy of ``rows`` with rows of ``fill`` appended, ``size`` rows in all.

    If ``size`` is None, it is a power of two (:func:`padded_size`).
    """
    size = padded_size(len(rows)) if size is None else size
    return np.concatenate([rows, np.full((size - len(rows), *rows.shape[1:]), fill, rows.dtype)])


def require_type(name: str, value: object, kind: Any, expected: str, advice: str = "") -> None:
    """Raise a ``ValueError`` that states what is ``expected``, unless a value is an instance of ``kind``."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be {expected}, got {shortened(value)}.{advice}")


def require_choice(name: str, value: object, choices: Sequence[str | int]) -> None:
    """Raise a ``ValueError`` that suggests a choice of similar spelling, unless a value is one of ``choices``."""
    if getattr(value, "ndim", 0) or value not in choices:
        spelled = {str(choice): choice for choice in choices}
        close = get_close_matches(str(value).lower(), spelled, 1)
        hint = f" Did you mean {spelled[close[0]]!r}?" if close and isinstance(value, str) else ""
        *others, last = map(repr, choices)
        raise ValueError(f"{name} must be {', '.join(others)} or {last}, got {shortened(value)}.{hint}")


def as_bool(name: str, value: object) -> bool:
    require_type(name, value, bool | np.bool, "True or False")
    return bool(value)


def ragged_indices(counts: Int[np.ndarray, " runs"]) -> IndexPairs:
    """Return, for each item of consecutive runs, the index of its run, and the item's index within this run.

    Run ``i`` has ``counts[i]`` items.
    """
    # Counts [2, 0, 3] give the runs [0, 0, 2, 2, 2] and the indices [0, 1, 0, 1, 2].
    run = np.repeat(np.arange(len(counts)), counts)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts)


def concatenated(objects: Sequence[object], *names: str) -> list[Shaped[np.ndarray, "..."]]:
    """Return, for each attribute name, the concatenation of this attribute's arrays over all objects."""
    return [np.concatenate([getattr(item, name) for item in objects]) for name in names]


def parts(counts: Int[np.ndarray, " items"], most: int) -> list[slice]:
    """Split items into consecutive slices. In each slice, the ``counts`` of the items sum to about ``most``.

    A slice with a single item may have a larger sum.
    """
    # A slice ends before each item at which the sum of counts reaches or passes a multiple of `most`.
    ends = np.flatnonzero(np.diff(np.cumsum(counts) // most)) + 1
    return [slice(*pair) for pair in pairwise([0, *ends.tolist(), len(counts)])]


def slices(count: int, size: int | np.integer) -> Iterator[slice]:
    """Split ``count`` items into consecutive slices of ``size`` items; the last one may have fewer."""
    return (slice(begin, begin + size) for begin in range(0, count, size))


def batches(rows: Any, size: int) -> Iterator[Any]:
    """Yield consecutive slices of an array or a list, with at most ``size`` rows each; nothing if it is empty."""
    return (rows[begin : begin + size] for begin in range(0, len(rows), size))


def path_from_root(parents: Sequence[int] | Int[np.ndarray, " n"], node: int) -> list[int]:
    """Return the nodes of a tree on the path from its root to a node; the root has a negative parent."""
    path = [node]
    while (parent := int(parents[path[-1]])) >= 0:
        path.append(parent)
    return path[::-1]


def index_of(values: Shaped[np.ndarray, " known"], wanted: Shaped[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return, for each entry of ``wanted``, its index in ``values``, or -1. The ``values`` must be distinct."""
    if not len(values):
        return np.full(len(wanted), -1)
    order = np.argsort(values)
    place = order[np.minimum(np.searchsorted(values, wanted, sorter=order), len(values) - 1)]
    return np.where(values[place] == wanted, place, -1)


def take_ragged(first: Int[np.ndarray, " runs_plus_one"], runs: Int[np.ndarray, " chosen"]) -> IndexPairs:
    """Return the indices of all items of some runs, and for each item the position of its run in ``runs``.

    ``runs`` are indices of runs. Run ``i`` has the items from ``first[i]`` up to, not including, ``first[i + 1]``.
    """
    run, place = ragged_indices(first[runs + 1] - first[runs])
    return first[runs][run] + place, run


def sum_of_columns(terms: Float[np.ndarray, "n terms"]) -> Float[np.ndarray, " n"]:
    """Sum each row from left to right, so that all CPUs round equally; ``np.sum`` adds in CPU-dependent blocks."""
    return reduce(np.add, terms.T)


def row_products(a: Float[np.ndarray, "n terms"], b: Float[np.ndarray, "..."]) -> Float[np.ndarray, "n ..."]:
    """Return ``a @ b``, computed row by row.

    For a large product, BLAS would start threads that take more CPU time than the product.
    """
    return np.matmul(a[:, None], b)[:, 0]


def product_in_order(a: Float[np.ndarray, "n terms"], b: Float[np.ndarray, "terms m"]) -> Float[np.ndarray, "n m"]:
    """Return ``a @ b`` with each entry summed from left to right, so that all CPUs round equally."""
    # The sum of outer products of the columns of `a` and the rows of `b`.
    total = np.zeros((len(a), b.shape[1]))
    for column, row in zip(a.T, b, strict=True):
        total += column[:, None] * row
    return total


def hash64(numbers: Int[np.ndarray, " n"] | UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Hash integers so that every output bit depends on all input bits (SplitMix64, Steele et al., 2014)."""
    bits = numbers.astype(np.uint64) * _FACTORS[0]
    bits = (bits ^ (bits >> np.uint64(30))) * _FACTORS[1]
    bits = (bits ^ (bits >> np.uint64(27))) * _FACTORS[2]
    return bits ^ (bits >> np.uint64(31))


def format_numbers(numbers: Float[np.ndarray, " n"]) -> list[float]:
    """Round numbers to 12 significant digits for messages, to hide rounding errors."""
    return [float(f"{number:.12g}") for number in numbers.tolist()]


def set_fields(value: object, **fields: object) -> None:
    """Set attributes of an object of a frozen dataclass."""
    for name, content in fields.items():
        object.__setattr__(value, name, content)


@dataclass(frozen=True, eq=False)
class PickledWithoutCaches:
    """A base class of dataclasses whose pickles hold only the fields, and no cached properties."""

    def __getstate__(self) -> dict[str, object]:
        return {field.name: getattr(self, field.name) for field in fields(self)}


_MUTATORS = ("with_", "add", "insert", "move", "remove", "replace", "set_", "update")


def no_attribute(value: object, name: str, when_changed: str) -> AttributeError:
    """Return the ``AttributeError`` for an object ``value`` without the attribute ``name``.

    If the name begins like a method that changes an object, such as ``add``, the message ends with the text
    ``when_changed``.
    """
    advice = f" {when_changed}" if name.startswith(_MUTATORS) else ""
    return AttributeError(f"A {type(value).__name__} has no attribute {name!r}.{advice}")


def as_list(name: str, value: object, expected: str, fits: Callable[[Any], bool]) -> list[Any]:
    """Check an iterable of one or more items, for each of which ``fits`` returns True, and return it as a list.

    ``expected`` describes the items in error messages.
    """
    items = list(value) if isinstance(value, Iterable) else []
    if not items:
        hint = " Put a single one into a list." if not isinstance(value, Iterable) and fits(value) else ""
        raise ValueError(f"{name} must be a list of {expected}, got {shortened(value)}.{hint}")
    for i, item in enumerate(items):
        if not fits(item):
            raise ValueError(f"{name} must be a list of {expected}, got {shortened(item)} at index {i}.")
    return items


def require_function(name: str, value: object) -> None:
    require_type(name, value, Callable, "a function")


def shortened(value: object) -> str:
    """Return the ``repr`` of a value for an error message, cut to 200 characters."""
    try:
        text = _REPR.repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a recursive list
        text = f"a very large {type(value).__name__}"
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def require_time(deadline: float, purpose: str, seconds: float = 0.0) -> None:
    """Raise a ``TimeoutError`` if fewer than ``seconds`` remain until a deadline, a time of ``time.perf_counter``.

    The message is "The deadline passed before ...", with the text ``purpose`` at its end.
    """
    if time.perf_counter() + seconds > deadline:
        raise TimeoutError(f"The deadline passed before {purpose}.")
