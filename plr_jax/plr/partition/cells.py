"""Dyadic cells: the nodes of a binary space partition that halves one axis at a time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import mixed
from plr_jax.geometry.box import Box

PLACING = 2.0**-21
"""How far beside its cell, in widths of the domain, a query may place a point, as it computes in 32 bits."""


@dataclass(frozen=True, eq=False)
class Cells:
    """A batch of dyadic cells of one domain.

    Along each axis a cell is the interval ``lo + [position, position + 1] * (hi - lo) / 2**depth`` of the domain
    ``[lo, hi]``, so a partition is exact in integers and independent of the domain's units.

    Attributes:
        depth: Number of splits along each axis.
        position: Index of the cell among the ``2**depth`` cells of its size, along each axis.
    """

    depth: Int[np.ndarray, "cells dim"]
    position: Int[np.ndarray, "cells dim"]

    @staticmethod
    def root(dim: int) -> "Cells":
        """The one cell that covers the whole domain."""
        return Cells(np.zeros((1, dim), np.int64), np.zeros((1, dim), np.int64))

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.depth.shape[1]

    def __getitem__(self, index) -> "Cells":
        return Cells(self.depth[index], self.position[index])

    def append(self, *others: "Cells") -> "Cells":
        """These cells followed by the others."""
        parts = (self, *others)
        return Cells(
            np.concatenate([part.depth for part in parts]), np.concatenate([part.position for part in parts])
        )

    def boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Lower and upper corners of the cells in the units of the domain."""
        size = np.ldexp(1.0, -self.depth)
        return (
            domain.lo + domain.width * (self.position * size),
            domain.lo + domain.width * ((self.position + 1) * size),
        )

    def grown_boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Corners of boxes that hold all points for which a query may ask a cell, which places points in 32 bits."""
        lo, hi = self.boxes(domain)
        return lo - PLACING * domain.width, hi + PLACING * domain.width

    def longest_axis(self, domain: Box) -> Int[np.ndarray, "cells"]:
        """The axis along which each cell is widest, the first of equals, in the units of the domain."""
        return (domain.width * np.ldexp(1.0, -self.depth)).argmax(axis=1)

    def points(self, u: Float[np.ndarray, "k dim"], domain: Box) -> Float[np.ndarray, "cells k dim"]:
        """Points of the domain at the local coordinates ``u`` (``[-1, 1]`` spans a cell) of every cell."""
        x = np.empty((len(self), *u.shape))
        for axis in range(self.dim):  # NumPy is slow where the last axis is short
            fraction = (self.position[:, axis, None] + 0.5) + 0.5 * u[:, axis]
            fraction *= np.ldexp(1.0, -self.depth[:, axis])[:, None]
            x[:, :, axis] = domain.lo[axis] + domain.width[axis] * fraction
        return x

    def hashes(self) -> UInt64[np.ndarray, "cells"]:
        """A hash of each cell."""
        numbers = (np.int64(1) << self.depth) + self.position  # 1 for the whole, 2 and 3 for halves, and so on
        total = np.zeros(len(self), np.uint64)
        for along in numbers.T:
            total = mixed(total + along.astype(np.uint64))
        return total

    def split(self, axis: Int[np.ndarray, "cells"]) -> "Cells":
        """Halve each cell along its axis: ``2 * cells`` children, a cell's two side by side, lower first."""
        halved = np.eye(self.dim, dtype=np.int64)[axis]
        depth = np.repeat(self.depth + halved, 2, axis=0)
        position = np.repeat(self.position << halved, 2, axis=0)
        position[1::2] += halved
        return Cells(depth, position)

    def halves(self, axis: Int[np.ndarray, "cells"], is_upper: Bool[np.ndarray, "cells"]) -> "Cells":
        """The lower or the upper half of each cell along its axis."""
        halved = np.eye(self.dim, dtype=np.int64)[axis]
        return Cells(self.depth + halved, (self.position << halved) + halved * is_upper[:, None])


def grown_domain(domain: Box) -> Box:
    """The box that holds all points for which a query may ask a domain."""
    lo, hi = Cells.root(domain.dim).grown_boxes(domain)
    return Box(lo[0], hi[0])
