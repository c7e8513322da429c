"""Approximate distances between any two points for any metric: one PLR over the product of the space with itself."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from plr_jax._arrays import as_queries, is_traced, require_function
from plr_jax._compiled import pytree
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._construct import construct
from plr_jax.plr._plr import PLR
from plr_jax.plr.frame import Frame


@pytree
class MetricPairs:
    """Approximate distances between any two points of a box, stored as one PLR over pairs of points.

    Make it by :func:`construct_metric_pairs`. It is a pytree of arrays. Its ``plr`` covers the product of the box
    with itself. To write a file, use ``save(pairs.plr, path)``; to load a file, use ``MetricPairs(load(path))``.
    """

    plr: PLR

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Return approximate distances, also under ``jax.jit``, ``vmap`` and ``grad`` in both arguments.

        Points ``x`` and ``y``, ``(..., dim)`` (else ``ValueError``), are NumPy or JAX arrays whose shapes broadcast.
        Distances, ``(...)``, are at least 0, symmetric to the last bit, and 0 for ``x == y`` in the box. They are
        ``inf`` outside the box and in leaves without a sampled pair of points that a path joins, NaN for NaN.
        """
        x, y = (p if isinstance(p, jax.Array) else as_queries(p) for p in (x, y))
        for name, points in (("x", x), ("y", y)):
            if points.ndim == 0 or points.shape[-1] != self.dim:
                raise ValueError(f"{name} must be points of shape (..., {self.dim}), got {points.shape}.")
        on_host = all(isinstance(each, np.ndarray) for each in (x, y)) and not is_traced(self.plr.file)
        module: Any = np if on_host else jnp  # NumPy points keep 64 bits
        x, y = module.broadcast_arrays(x, y)
        # 1. Wrap points along periodic axes: the PLR was built of wrapped points, in their order.
        lo, hi, periodic = self._ends()
        if periodic.any():
            lo, hi, x, y = (module.asarray(each, module.result_type(x, y, np.float32)) for each in (lo, hi, x, y))
            x, y = (module.where(periodic, lo + (p - lo) % (hi - lo), p) for p in (x, y))
        # 2. Sort the points of each pair lexicographically, and ask the PLR.
        swaps = _comes_later(x, y)[..., None]
        value = self.plr(module.concatenate([module.where(swaps, y, x), module.where(swaps, x, y)], axis=-1))
        lo, hi = (each.astype(module.result_type(x, np.float32)) for each in (lo, hi))
        is_one_point = ((x == y) & (lo <= x) & (x <= hi)).all(axis=-1)
        return jnp.where(is_one_point, jnp.zeros_like(value), jnp.maximum(value, 0))

    def _ends(self) -> tuple[Any, Any, Bool[np.ndarray, "dim"]]:
        """Return the lower and the upper corner of the box of points, and which of its axes are periodic."""
        # If JAX traces the file, the corners come from the tables, in two parts of 32 bits each.
        periodic = np.isin(np.arange(self.dim), self.plr.tables.periodic)
        if not is_traced(self.plr.file):
            return self.plr.domain.lo[: self.dim], self.plr.domain.hi[: self.dim], periodic
        frame = self.plr.tables.frame[:, : self.dim]
        return frame[Frame.LO] + frame[Frame.LO_REST], frame[Frame.HI] - frame[Frame.HI_REST], periodic

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.plr.dim // 2

    @property
    def num_bytes(self) -> int:
        """Size of the file in bytes."""
        return self.plr.num_bytes


def construct_metric_pairs(
    distance_fn: Callable[[Any, Any], Any], domain: Box | tuple[ArrayLike, ArrayLike], **options: Any
) -> MetricPairs:
    """Build a PLR of any symmetric distance function of two points in a box, from samples.

        pairs = plr_jax.construct_metric_pairs(graph.between, workspace.bounds, max_bytes=2**16)
        pairs(x, y)  # approximate distances (n,) of points x and y, both (n, dim)

    The PLR has twice as many dimensions as the box. For distances in a planar workspace use :func:`construct_pairs`,
    which is nearly exact. If interrupted (Ctrl-C), the result has the partition so far. Reference: "all-pairs" in
    Section II of the paper.

    Args:
        distance_fn: Distances ``(n,)`` between two arrays of points ``(n, dim)``, symmetric, ``inf`` without a path.
        domain: The box of both points, a ``Box`` or its two corners, of at most 3 dimensions, else ``ValueError``.
        **options: Options of :func:`construct`, such as limits, leaf model and seed.
    """
    if (domain := Box.of(domain)).dim > 3:
        raise ValueError(f"The box of a metric may have at most 3 dimensions, got {domain.dim}.")
    require_function("distance_fn", distance_fn)
    box_of_pairs = Box(np.tile(domain.lo, 2), np.tile(domain.hi, 2), 2 * tuple(domain.periodic))

    def ordered_distances(pairs: Float[np.ndarray, "n both"]) -> Float[np.ndarray, " n"]:
        # Only sorted pairs have a distance. A call asks for no others.
        x, y = np.split(pairs, 2, axis=1)
        later = np.asarray(_comes_later(x, y))
        result = np.full(len(pairs), np.inf)
        result[~later] = distance_fn(x[~later], y[~later])
        return result

    return MetricPairs(construct(ordered_distances, box_of_pairs, **options))


def _comes_later(x: Any, y: Any) -> Bool[Array, "*batch"] | Bool[np.ndarray, "*batch"]:
    """Return whether each point of ``x`` comes later in lexicographic order than the point of ``y`` in its row."""
    later, equal = x[..., 0] > y[..., 0], x[..., 0] == y[..., 0]
    for axis in range(1, x.shape[-1]):
        later, equal = later | (equal & (x[..., axis] > y[..., axis])), equal & (x[..., axis] == y[..., axis])
    return later
