"""Pytrees that ``jax.export`` can serialize, and functions that evaluate a compiled function on a large batch."""

import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from math import prod
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jaxtyping import Array, Shaped

from plr_jax._arrays import is_traced, padded

Class = TypeVar("Class", bound=type)
Columns = TypeVar("Columns")  # an array, or a tuple or another pytree of arrays
_PARTS = 8  # a batch of more than this many small parts is divided into large parts instead


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def pytree(of: Class) -> Class:
    """Make a class a frozen dataclass and a pytree that ``jax.export`` can serialize; use this as a decorator."""
    return serializable(jax.tree_util.register_dataclass(dataclass(frozen=True, eq=False)(of)))


def serializable(of: Class, default: Any = None, object_hook: Any = None) -> Class:
    """Let ``jax.export`` serialize functions with arguments of a registered pytree class; use this as a decorator.

    Static fields are stored as JSON, so that loading a file cannot run code. ``default`` and ``object_hook`` are
    passed on to ``json``: they encode and decode values of types that JSON does not have.
    """
    return export.register_pytree_node_serialization(
        of,
        serialized_name=f"plr_jax.{of.__name__}",
        serialize_auxdata=lambda static: json.dumps(static, default=default).encode(),
        deserialize_auxdata=lambda data: _with_tuples(json.loads(data, object_hook=object_hook)),
    )


def _with_tuples(value: Any) -> Any:
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


def num_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def has_doubles() -> bool:
    """Return whether JAX computes in 64 bits, as with ``jax_enable_x64``."""
    return jax.dtypes.canonicalize_dtype(np.float64) == np.float64


def is_on_one_host(*arrays: Array | np.ndarray) -> bool:
    """Return whether no array is traced or committed to a device, and all JAX arrays are on the same CPU.

    If no array is a JAX array, return whether JAX's default devices are CPUs.
    """
    if any(is_traced(array) or getattr(array, "committed", False) for array in arrays):
        return False
    devices = {device for array in arrays if isinstance(array, jax.Array) for device in array.devices()}
    return len(devices) <= 1 and all(device.platform == "cpu" for device in devices or jax.devices())


def answered_in_parts(
    answer: Callable[..., tuple[Array, ...]], sizes: tuple[int, int], *rows: Shaped[np.ndarray, "..."]
) -> tuple[np.ndarray, ...]:
    """Apply a compiled function to the rows of arrays, in equally large parts on all cores.

    The arrays ``rows`` have shapes ``(..., width)``. Their leading axes broadcast to ``batch``, the shape of each
    result. ``answer`` maps ``n`` rows of each array to a tuple of arrays ``(n,)``.

    ``answer`` is compiled once for each ``n``. So that it is compiled at most twice, each part has ``sizes[0]`` rows,
    or ``sizes[1]`` rows if the batch has more than ``8 * sizes[0]``. Zeros pad the last part.
    """
    batch = np.broadcast_shapes(*(column.shape[:-1] for column in rows))
    count = prod(batch)
    size = sizes[0] if count <= _PARTS * sizes[0] else sizes[1]
    whole = [np.broadcast_to(column, (*batch, column.shape[-1])) for column in rows]
    results: list[np.ndarray] = []  # made by the first part
    computes_in_double = has_doubles()

    def answer_part(first: int) -> None:
        # 1. Take the rows from `first` to `last` of the flat batch. Only arrays that are broadcast need a copy.
        last = min(first + size, count)
        part = [
            column.reshape(-1, column.shape[-1])[first:last]
            if column.flags.c_contiguous
            else column[np.unravel_index(np.arange(first, last), batch)]
            for column in whole
        ]
        # 2. Answer them, and store the answers; parts write to disjoint rows.
        with jax.enable_x64(computes_in_double):  # the setting may be local to the calling thread
            answers = answer(*(padded(column, size) for column in part))
        if not results:
            results.extend(np.empty(count, column.dtype) for column in answers)
        for result, column in zip(results, answers, strict=True):
            result[first:last] = np.asarray(column)[: last - first]

    answer_part(0)  # compiles the function, and shows the types of the answers
    if count > size:
        with ThreadPoolExecutor(num_cores()) as pool:
            list(pool.map(answer_part, range(size, count, size)))  # an exception cancels the parts that wait
    return tuple(result.reshape(batch) for result in results)


def part_by_part(answer: Callable[..., Columns], size: int, *rows: Any) -> Columns:
    """Apply a traceable function to arrays of equally many rows, in parts of ``size`` rows to save memory.

    The results of all parts are concatenated.
    """
    # Zeros pad the last part. A batch of symbolic size, as in exported functions, is one part.
    count = rows[0].shape[0]
    if export.is_symbolic_dim(count) or 0 < count <= size:
        return answer(*rows)
    filled = [jnp.pad(column, ((0, -count % size), *((0, 0),) * (column.ndim - 1))) for column in rows]
    parts = tuple(column.reshape(-1, size, *column.shape[1:]) for column in filled)
    columns = jax.lax.map(lambda part: answer(*part), parts)
    return jax.tree.map(lambda column: column.reshape(-1, *column.shape[2:])[:count], columns)


def broadcast_shape(names: str, x: Array | np.ndarray, y: Array | np.ndarray) -> tuple[int, ...]:
    """Return the shape to which two arrays broadcast.

    If the arrays do not broadcast, raise a ``ValueError``; its message begins with ``names``, such as "x and y".
    """
    try:
        return jnp.broadcast_shapes(x.shape, y.shape)
    except ValueError:
        raise ValueError(f"{names} must broadcast, got shapes {x.shape} and {y.shape}.") from None
