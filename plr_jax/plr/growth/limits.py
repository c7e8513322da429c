"""The limits of a construction: how deep, how many, how large, how exact."""

import os
from dataclasses import dataclass

import numpy as np

from plr_jax._arrays import require_integer
from plr_jax.plr.partition.tree import MAX_DEPTH
from plr_jax.plr.query.sizes import byte_class, max_axis_depth, rows_of_class

DEFAULT_MAX_LEAVES = 512
_BYTES_A_NODE = 200


@dataclass(frozen=True, eq=False)
class Limits:
    """When to stop: see :func:`construct`.

    No cell is halved more than ``max_axis_depth`` times along one axis, so that a query's tables fit their class.
    """

    max_depth: int
    max_axis_depth: int
    max_leaves: int
    max_bytes: float
    tolerance: float


def check_limits(
    dim: int,
    least_bytes: int,
    max_depth: int | None,
    max_leaves: int | None,
    max_bytes: int | None,
    tolerance: int | float | None,
) -> Limits:
    """Limits with every None replaced, after checking the ranges of what :func:`construct` is given."""
    for name, value, least in (
        ("max_depth", max_depth, 0),
        ("max_leaves", max_leaves, 1),
        ("max_bytes", max_bytes, 1),
    ):
        if value is not None:
            require_integer(name, value, least)
    if max_depth is not None and max_depth > MAX_DEPTH:
        raise ValueError(f"max_depth must be at most {MAX_DEPTH}, got {max_depth}.")
    if tolerance is not None and not (isinstance(tolerance, int | float | np.number) and 0 <= tolerance < np.inf):
        raise ValueError(f"tolerance must be a finite distance >= 0, got {tolerance!r}.")
    if max_depth is None and max_leaves is None and max_bytes is None and tolerance is None:
        max_leaves = DEFAULT_MAX_LEAVES
    # Of the largest file that the limits allow; None if they allow any.
    sizes = (max_bytes, None if max_leaves is None else 2 * least_bytes * max_leaves)
    table_class = min((byte_class(size) for size in sizes if size is not None), default=None)
    most_leaves = np.iinfo(np.int64).max if max_leaves is None else int(max_leaves)
    if max_bytes is not None:
        most_leaves = min(most_leaves, rows_of_class(byte_class(max_bytes), least_bytes))
    max_depth = MAX_DEPTH if max_depth is None else int(max_depth)
    if tolerance is None:
        check_memory(2.0 * min(float(most_leaves), 2.0**max_depth))
    return Limits(
        max_depth=max_depth,
        max_axis_depth=max_axis_depth(dim, table_class),
        max_leaves=most_leaves,
        max_bytes=np.inf if max_bytes is None else float(max_bytes),
        tolerance=0.0 if tolerance is None else float(tolerance),
    )


def check_memory(num_nodes: float) -> None:
    """Raise ``ValueError`` if a tree of so many nodes does not fit into this machine's memory."""
    needed = num_nodes * _BYTES_A_NODE
    if needed > _machine_bytes():
        raise ValueError(
            f"The limits allow {num_nodes / 2:.3g} leaves or more, which would need about {needed / 2**30:.3g} GiB; "
            f"this machine has {_machine_bytes() / 2**30:.3g}. Give a smaller max_depth, max_leaves, max_bytes "
            "or a tolerance."
        )


def _machine_bytes() -> float:
    """Physical memory; unlimited where the system does not say."""
    if not hasattr(os, "sysconf"):
        return np.inf
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
