"""The distance of any two points by any metric: one PLR over the product of the space with itself."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from plr_jax._arrays import as_queries, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._construct import construct
from plr_jax.plr._plr import PLR


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class MetricPairs:
    """The distance between any two points of a box, by one PLR over pairs of them.

    Made by :func:`construct_metric_pairs`; of a file, by ``MetricPairs(load(path))``. It is a pytree of arrays.

    Attributes:
        plr: The PLR over the product of the box with itself, of the pairs whose first point comes first in the order
            of coordinates. :func:`save` writes it.
    """

    plr: PLR

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Float[Array, "*batch"]:
        """Approximate distance between points, in both arguments clean under ``jax.jit``, ``vmap`` and ``grad``.

        Args:
            x: Points, ``(..., dim)``, NumPy or JAX.
            y: Points, of a shape that broadcasts with that of ``x``.

        Returns:
            Distances, ``(...)``, at least 0: ``pairs(x, y) == pairs(y, x)`` to the last bit, and 0 for ``x == y``.
            ``inf`` outside the box, and in leaves no pair of which is joined; NaN for NaN.

        Raises:
            ValueError: If points have another last axis than ``dim``.
        """
        x, y = (p if isinstance(p, jax.Array) else as_queries(p) for p in (x, y))
        for name, points in (("x", x), ("y", y)):
            if points.ndim == 0 or points.shape[-1] != self.dim:
                raise ValueError(f"{name} must be points of shape (..., {self.dim}), got {points.shape}.")
        on_host = isinstance(x, np.ndarray) and isinstance(y, np.ndarray)
        module: Any = np if on_host else jnp  # NumPy's 64-bit points are placed as such
        x, y = module.broadcast_arrays(x, y)
        swaps = _comes_later(x, y)[..., None]
        value = self.plr(module.concatenate([module.where(swaps, y, x), module.where(swaps, x, y)], axis=-1))
        return jnp.where((x == y).all(axis=-1), jnp.zeros_like(value), jnp.maximum(value, 0))

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.plr.dim // 2

    @property
    def num_bytes(self) -> int:
        """Bytes of the file."""
        return self.plr.num_bytes


def construct_metric_pairs(
    distance_fn: Callable[[Any, Any], Any], domain: Box | tuple[ArrayLike, ArrayLike], **options: Any
) -> MetricPairs:
    """Build the distance between any two points of a box, of any symmetric distance function, from samples.

    It is a PLR over twice as many dimensions: what is left of a metric when nothing else is known of it. Of the
    distance in a planar workspace :func:`construct_pairs` knows more, and is exact.

    Args:
        distance_fn: Distance of each two of points ``(n, dim)`` and ``(n, dim)``, ``(n,)``, alike either way round;
            ``inf`` where no path joins them. Such as ``VisibilityGraph.between``.
        domain: The box that both points are of, a ``Box`` or its two corners, of at most 3 dimensions.
        **options: As for :func:`construct`: limits, the leaf, the seed and others.

    Returns:
        The distances. If interrupted (Ctrl-C), of the partition so far, as of :func:`construct`.

    Raises:
        ValueError: If the box has more than 3 dimensions, or as for :func:`construct`.

    References:
        "all-pairs" in Section II of the paper.
    """
    domain = Box.of(domain)
    if domain.dim > 3:
        raise ValueError(f"Pairs are of points of at most 3 dimensions, got a box of {domain.dim}.")
    if not callable(distance_fn):
        raise ValueError(f"distance_fn must be a function of x and y, got {shortened(distance_fn)}.")
    both = Box(np.tile(domain.lo, 2), np.tile(domain.hi, 2), 2 * tuple(domain.periodic))

    def in_order(pairs: Float[np.ndarray, "n both"]) -> Float[np.ndarray, "n"]:
        x, y = np.split(pairs, 2, axis=1)
        later = np.asarray(_comes_later(x, y))
        result = np.full(len(pairs), np.inf)
        result[~later] = distance_fn(x[~later], y[~later])
        return result

    return MetricPairs(construct(in_order, both, **options))


def _comes_later(x: Any, y: Any) -> Bool[Array, "*batch"] | Bool[np.ndarray, "*batch"]:
    """Whether points are behind others in the order of their coordinates, the first first."""
    later, equal = x[..., 0] > y[..., 0], x[..., 0] == y[..., 0]
    for axis in range(1, x.shape[-1]):
        later, equal = later | (equal & (x[..., axis] > y[..., axis])), equal & (x[..., axis] == y[..., axis])
    return later
