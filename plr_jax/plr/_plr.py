"""The piecewise linear regression: a partition of a box and a plane in every leaf, ready to be queried."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from plr_jax._arrays import shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._stored import StoredFunction, as_padded_array
from plr_jax.plr.file.plr_file import decode, encode
from plr_jax.plr.leaves.plane.codec import LARGEST, StoredPlanes
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.neighbors import fill_unreachable
from plr_jax.plr.query.stack import TableStack
from plr_jax.plr.query.tables import Frame, Tables, build_tables, evaluate_tables, lookup, table_corners


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PLR(StoredFunction):
    """A distance function stored as planes over a binary space partition (Section III of the paper).

    Made by :func:`construct` and :func:`load`; ``plr(x)`` is :func:`evaluate`. A PLR is a pytree of arrays: a
    jitted function can close over it or take it as an argument. Inside such a function it can be queried; its
    other properties are for the host.

    Attributes:
        tables: What a query reads, derived from ``file`` alone.
        file: The bytes that :func:`save` writes, padded with zeros to a power of two.
    """

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Same as :func:`evaluate`."""
        if not isinstance(x, jax.Array):
            x = as_array(x)
        return _evaluate(self.tables, x)

    @staticmethod
    def stack(plrs: Sequence["PLR"]) -> TableStack:
        """One function of all robots' PLRs: a batch of joint configurations in one compiled call.

        Args:
            plrs: One PLR a robot; they may differ in size and dimension.

        Returns:
            A function of joint configurations ``(n, robots, dof)``, NumPy, that returns each robot's distance
            ``(n, robots)``, float64: bit for bit what its PLR answers for its leading coordinates.

        Raises:
            ValueError: If one is not a plain PLR. When called, if the robots are not as many as the PLRs, or a PLR
                has more dimensions than there are coordinates.
        """
        for i, plr in enumerate(plrs):
            if not isinstance(plr, PLR):
                raise ValueError(f"Only plain PLRs can be stacked, that of robot {i} is {shortened(plr)}.")
        return TableStack(tuple(plr.tables for plr in plrs))

    @cached_property
    def _leaves(self) -> tuple[Box, Cells, StoredPlanes]:
        return decode(self.to_bytes())

    @property
    def domain(self) -> Box:
        """The closed box that the PLR covers."""
        return self._leaves[0]

    @property
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's left-to-right traversal."""
        return self._leaves[1]

    @property
    def planes(self) -> StoredPlanes:
        """The leaves' planes as the file stores them."""
        return self._leaves[2]

    @property
    def num_unreachable(self) -> int:
        """Number of leaves that answer ``inf``."""
        return int(np.isinf(self.intercept).sum())

    @property
    def slope(self) -> Float[np.ndarray, "leaves dim"]:
        """Slope of every leaf's plane, the gradient of the PLR in that leaf."""
        return np.asarray(self.tables.coefficients[1:], np.float64)[:, : self.num_leaves].T

    @property
    def intercept(self) -> Float[np.ndarray, "leaves"]:
        """Intercept of every leaf: its plane is ``slope . x + intercept``; ``inf`` in an unreachable leaf."""
        at_corner = np.asarray(self.tables.coefficients[0], np.float64)[: self.num_leaves]
        return at_corner - self.slope @ np.asarray(self.tables.frame[Frame.LO], np.float64)

    def __repr__(self) -> str:
        return f"PLR(dim={self.dim}, num_leaves={self.num_leaves}, num_bytes={self.num_bytes}, {self.domain})"


def plr_from_bytes(data: bytes) -> PLR:
    """The PLR that a file's bytes hold.

    Args:
        data: What :meth:`PLR.to_bytes` gave.

    Raises:
        ValueError: If the bytes are not those of a PLR file of a version this release reads, or its planes are
            beyond 32-bit floats.
    """
    return _assemble(data, *decode(data))


def plr_of_leaves(domain: Box, cells: Cells, planes: StoredPlanes) -> PLR:
    """The PLR of these leaves, in any order: the one that its file gives, bit for bit, without reading it."""
    data, order = encode(domain, cells, planes)
    return _assemble(data, domain, cells[order], planes[order])


def _assemble(data: bytes, domain: Box, cells: Cells, planes: StoredPlanes) -> PLR:
    """Fill unreachable leaves from their neighbors, and build the tables. Every PLR comes into being here."""
    center, half = planes.decode()
    lo, hi = cells.boxes(domain)
    corner = table_corners(domain)[0]
    slope = half * 2 / (hi - lo)
    if not max(np.abs(slope).max(), np.abs(center[~planes.unreachable]).max(initial=0.0)) < LARGEST:
        raise ValueError("its distances or their slopes are too large for 32-bit floats; scale them down")
    to_center = (lo + hi) / 2 - corner
    at_corner = np.where(planes.unreachable, 0.0, center) - np.sum(slope * to_center, axis=1)
    slope, at_corner = fill_unreachable(cells, planes.unreachable, slope, at_corner)
    return PLR(build_tables(domain, cells, np.column_stack([at_corner, slope])), as_padded_array(data))


def evaluate(plr: StoredFunction, x: ArrayLike) -> Float[Array, "*batch"]:
    """Approximate distance at each point: the plane of the leaf that holds it (Section III-A of the paper).

    Clean under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; the gradient is the leaf's slope.

    Args:
        plr: The PLR, plain or continuous (see :class:`ContinuousPLR` for what that one answers).
        x: Points, ``(..., dim)``, NumPy or JAX, in the units of the domain. Computed in
            their own precision, at least 32 bits.

    Returns:
        Distances of shape ``(...)``. A PLR never tests collision: every point of the closed domain gets a finite
        value, in an obstacle too, except in leaves none of whose samples reaches the goal and that touch no leaf
        with one that does. Those, and points outside the domain, get ``inf``; a NaN coordinate gives NaN. The
        upper edge of the domain belongs to the last cell.

    Raises:
        ValueError: If the last axis of ``x`` is not ``dim`` long.
    """
    return plr(x)


@jax.jit
def _evaluate(tables: Tables, x: Array) -> Float[Array, "*batch"]:
    """Checks and answers points; what is checked depends on shape and type alone, so it is checked once for each."""
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    require_real(x)
    return evaluate_tables(tables, x)


def require_real(x: Array | np.ndarray) -> None:
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}.")


def as_array(x: ArrayLike) -> np.ndarray:
    """Points on the host. Integers become floats here, where they cannot wrap around."""
    try:
        x = np.asarray(x)
    except ValueError as error:
        raise ValueError(f"Points must be an array of numbers, got {x!r}.") from error
    if x.dtype in (np.float32, np.float64):
        return x
    if x.dtype.kind in "iub" or (x.dtype.kind == "f" and x.dtype.itemsize > np.dtype(np.float64).itemsize):
        return x.astype(np.float64)
    require_real(x)  # which JAX cannot even be shown
    return x


def leaf_of(plr: PLR, x: Float[np.ndarray, "*batch dim"]) -> Int[np.ndarray, "*batch"]:
    """Index of the leaf that answers for each point."""
    return np.asarray(_lookup(plr.tables, x)).astype(np.int64)


_lookup = jax.jit(lookup)
