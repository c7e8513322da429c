"""The limits of a construction: how deep, how many, how large, how exact."""

import os
from dataclasses import dataclass

import numpy as np

from plr_jax._arrays import require_integer
from plr_jax.plr.leaves.plane.codec import FLOAT_BITS, MAX_BITS, MIN_BITS
from plr_jax.plr.partition.levels import MAX_DEPTH

DEFAULT_MAX_LEAVES = 512
_BYTES_A_NODE = 200


@dataclass(frozen=True, eq=False)
class Limits:
    """When to stop: see :func:`construct`."""

    max_depth: int
    max_leaves: int
    max_bytes: float
    tolerance: float
    coefficient_bits: int | None


def check_limits(
    max_depth: int | None,
    max_leaves: int | None,
    max_bytes: int | None,
    tolerance: int | float | None,
    coefficient_bits: int | None,
) -> Limits:
    """Limits with every None replaced, after checking their ranges."""
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
    if coefficient_bits is not None and not isinstance(coefficient_bits, int | np.integer):
        raise ValueError(f"coefficient_bits must be an integer, got {coefficient_bits!r}.")
    if coefficient_bits not in (None, FLOAT_BITS, *range(MIN_BITS, MAX_BITS + 1)):
        raise ValueError(
            f"coefficient_bits must be {FLOAT_BITS} (floats) or {MIN_BITS} to {MAX_BITS}, got {coefficient_bits}."
        )
    if max_depth is None and max_leaves is None and max_bytes is None and tolerance is None:
        max_leaves = DEFAULT_MAX_LEAVES
    most_leaves = min(
        max_leaves or np.inf, 8 * (max_bytes or np.inf), 2.0 ** (MAX_DEPTH if max_depth is None else max_depth)
    )
    if tolerance is None:
        check_memory(2.0 * most_leaves)
    return Limits(
        max_depth=MAX_DEPTH if max_depth is None else int(max_depth),
        max_leaves=np.iinfo(np.int64).max if max_leaves is None else int(max_leaves),
        max_bytes=np.inf if max_bytes is None else float(max_bytes),
        tolerance=0.0 if tolerance is None else float(tolerance),
        coefficient_bits=coefficient_bits,
    )


def check_memory(num_nodes: float) -> None:
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
