"""Folding points in JAX: see ``folding/folding.py`` for what that means."""

from dataclasses import dataclass, field
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.query.frame import folding_numbers, frame_of, mirrored_axes
from plr_jax.plr.query.reads import Picked, rounded


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FoldedWindow:
    """A domain whose points are folded before their leaves are looked up.

    Attributes:
        frame: The domain, as ``Tables.frame`` is one.
        center: The center in 32-bit floats, and what they leave of it.
        corners: Of the box of folded points, rounded inward; infinite along periodic axes.
        axes: The axes of folded coordinates, one a row; None if they are those of the domain.
        mirrors: For each mirror its pivot, and the axes that it reverses.
        periodic: The periodic axes.
    """

    frame: Float[Array, "7 dim"] | Picked
    center: Float[Array, "2 dim"] | Picked
    corners: Float[Array, "2 dim"] | Picked
    axes: Float[Array, "dim dim"] | Picked | None
    mirrors: tuple[tuple[int, tuple[int, ...]], ...] = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]

    @staticmethod
    def of(folding: Folding, origin: Float[np.ndarray, "dim"]) -> "FoldedWindow":
        """The same folding, for queries of points counted from an origin."""
        center, corners = folding_numbers(folding, origin)
        return FoldedWindow(
            frame=jnp.asarray(frame_of(folding.domain.moved(-origin))),
            center=jnp.asarray(center),
            corners=jnp.asarray(corners),
            axes=jnp.asarray(folding.axes.astype(np.float32)) if folding.is_turned else None,
            mirrors=mirrored_axes(folding),
            periodic=tuple(map(int, np.flatnonzero(folding.domain.periodic))),
        )

    def __call__(self, x: Float[Array, "*batch dim"], outside: Bool[Array, "*batch"]) -> Float[Array, "*batch dim"]:
        """The folded points; those ``outside`` the domain go to its center, from where nothing returns."""
        center, rest = self.center.astype(x.dtype)
        z = [jnp.where(outside, 0, rounded(x[..., axis] - center[axis]) - rest[axis]) for axis in range(self.dim)]
        if self.axes is not None:
            axes = self.axes.astype(x.dtype)
            z = [
                reduce(jnp.add, (rounded(axes[row, axis] * z[axis]) for axis in range(self.dim)))
                for row in range(self.dim)
            ]
        for pivot, reversed_axes in self.mirrors:
            is_behind = z[pivot] < 0
            for axis in reversed_axes:
                z[axis] = jnp.where(is_behind, -z[axis], z[axis])
        lo, hi = self.corners.astype(x.dtype)
        columns = [_clipped(z[axis], lo[axis], hi[axis]) for axis in range(self.dim)]
        # Computed once: a compiler would repeat all this wherever a coordinate is read.
        return jnp.moveaxis(jax.lax.optimization_barrier(jnp.stack(columns)), 0, -1)


@jax.custom_jvp
def _clipped(
    z: Float[Array, "*batch"], lo: Float[Array, "*#batch"], hi: Float[Array, "*#batch"]
) -> Float[Array, "*batch"]:
    """Coordinates that only rounding puts outside, moved inside; differentiated as if they were not moved."""
    return jnp.clip(z, lo, hi)


@_clipped.defjvp
def _clipped_with_tangent(primals, tangents):
    return _clipped(*primals), tangents[0]
