"""The continuous PLR: one number a corner in place of a plane a leaf, and no jump where nothing is in the way."""

from dataclasses import dataclass, field
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Num

from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr._plr import as_array, require_real
from plr_jax.plr._stored import StoredFunction, as_padded_array
from plr_jax.plr.leaves.continuous.basis import design, monomials, numbers_of_leaves
from plr_jax.plr.leaves.continuous.codec import Partition, decode, decode_partition
from plr_jax.plr.leaves.plane.codec import LARGEST
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.neighbors import fill_unreachable
from plr_jax.plr.query.tables import Frame, Tables, build_tables, lookup, number_of_leaf, outside_domain

_POWERS = (2, 4)  # of t along each axis, by order of continuity
_EXPONENT = np.uint32(0xFF800000)  # and sign, of a 32-bit float


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ContinuousPLR(StoredFunction):
    """A distance function stored as values at the corners of a binary space partition's leaves.

    Made by :func:`construct_continuous` and :func:`load`. Between a leaf's corners it is
    multilinear (order 0) or multicubic (order 1). Across a free face (a face with a point whose two sides can both be
    reached) nothing jumps: order 0 is continuous there, order 1 has a continuous gradient too. A face in a wall ties
    nothing, so nothing blends across walls.

    It is a pytree of arrays, as a :class:`PLR` is, and answers under ``jax.jit``, ``jax.vmap`` and ``jax.grad``.

    Attributes:
        tables: What a query reads, derived from ``file`` alone. ``tables.planes`` has a row a leaf: for every axis
            the number of its cell (see ``_cell_numbers``), then coefficients by powers of the coordinates in it.
        file: The bytes of the file, padded with zeros to a power of two.
        order: Order of continuity.
    """

    order: int = field(metadata={"static": True})

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Approximate distance at each point.

        Args:
            x: Points, ``(..., dim)``, NumPy or JAX, in the units of the domain. Computed in their own precision, at
                least 32 bits; coefficients are 32-bit floats.

        Returns:
            Distances of shape ``(...)``. As for a :class:`PLR`, obstacles are not tested: every point of the closed
            domain gets a finite value, except in leaves of which nothing can be reached and that touch no leaf of
            which something can. Those, and points outside the domain, get ``inf``; a NaN coordinate gives NaN. A
            gradient is finite everywhere, and zero where the distance is ``inf``.

        Raises:
            ValueError: If the last axis of ``x`` is not ``dim`` long.
        """
        if not isinstance(x, jax.Array):
            x = as_array(x)
        return _evaluate(self.order, self.tables, x)

    @cached_property
    def _partition(self) -> tuple[Box, Partition]:
        return decode_partition(self.to_bytes())

    @property
    def domain(self) -> Box:
        """The closed box that is covered."""
        return self._partition[0]

    @property
    def partition(self) -> Partition:
        """The leaves and their faces, those across which the function is continuous among them."""
        return self._partition[1]

    @property
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's left-to-right traversal."""
        return self.partition.tree.leaves

    @property
    def num_unreachable(self) -> int:
        """Number of leaves that answer ``inf``."""
        lo, hi = self.leaf_boxes
        return int(np.isinf(self((lo + hi) / 2)).sum())

    def __repr__(self) -> str:
        return (
            f"ContinuousPLR(dim={self.dim}, order={self.order}, num_leaves={self.num_leaves}, "
            f"num_bytes={self.num_bytes}, {self.domain})"
        )


def continuous_from_bytes(data: bytes) -> ContinuousPLR:
    """The continuous PLR that a file's bytes hold.

    Every one comes into being here, so a loaded one equals the one that was saved, bit for bit.

    Args:
        data: What :meth:`ContinuousPLR.to_bytes` gave.

    Raises:
        ValueError: If the bytes are not those of such a file of a version this release reads.
    """
    domain, order, partition, space, values = decode(data)
    leaves = partition.tree.leaves
    numbers = (numbers_of_leaves(order, space) @ values.decode()).reshape(len(leaves), -1)
    coefficients = _coefficients(order, leaves, partition, numbers)
    tables = build_tables(domain, leaves, np.concatenate([_cell_numbers(leaves), coefficients], axis=1))
    return ContinuousPLR(tables, as_padded_array(data), order)


def _coefficients(
    order: int, leaves: Cells, partition: Partition, numbers: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves powers"]:
    """Coefficients of every leaf's function by powers of the coordinates in it; ``inf`` where it has none.

    Unreachable leaves beside a reachable one continue a plane of that one's value and mean slope at its center.
    """
    coefficients = numbers @ monomials(order, leaves.dim)
    if not np.abs(coefficients).max() < LARGEST:
        raise ValueError("its distances or their slopes are too large for 32-bit floats; scale them down")
    unreachable = partition.unreachable
    if unreachable.any():
        count = np.ldexp(1.0, leaves.depth)
        at_center, slope = _mean_planes(order, numbers, leaves.dim)
        slope *= count
        center = (leaves.position + 0.5) / count
        slope, intercept = fill_unreachable(leaves, unreachable, slope, at_center - np.sum(slope * center, axis=1))
        coefficients[unreachable] = 0.0
        linear = _POWERS[order] ** np.arange(leaves.dim)[::-1]
        coefficients[np.ix_(unreachable, linear)] = (slope / count)[unreachable]
        at_corner = intercept + np.sum(slope * leaves.position / count, axis=1)
        coefficients[unreachable, 0] = at_corner[unreachable]
    return coefficients


def _cell_numbers(leaves: Cells) -> Float[np.ndarray, "leaves dim"]:
    """Number of each leaf's interval along each axis: 1 is the domain, the halves of ``i`` are ``2i`` and ``2i + 1``.

    As a 32-bit float, its exponent says how many such intervals span the domain.
    """
    return np.ldexp(1.0, leaves.depth) + leaves.position


def _mean_planes(
    order: int, numbers: Float[np.ndarray, "leaves terms"], dim: int
) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
    """Value at the center, and differences of the values in the middle of opposite faces."""
    center = np.full((1, dim), 0.5)
    ends = [center + sign * 0.5 * np.eye(dim) for sign in (-1, 1)]
    low, high = (numbers @ design(order, points).T for points in ends)
    return (numbers @ design(order, center).T)[:, 0], high - low


@partial(jax.jit, static_argnames="order")
def _evaluate(order: int, tables: Tables, x: Num[Array, "..."]) -> Float[Array, "*batch"]:
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    require_real(x)
    x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
    outside, answer = outside_domain(tables, x)
    leaf, frame, t = lookup(tables, jax.lax.stop_gradient(x)), tables.frame.astype(x.dtype), []
    count = tables.dim + _POWERS[order] ** tables.dim
    for axis in range(tables.dim):
        u = (x[..., axis] - frame[Frame.LO, axis]) * frame[Frame.SCALE, axis] + (frame[Frame.START, axis] - 1)
        along = _coordinate_in_cell(u, number_of_leaf(tables, leaf, axis, count))
        t.append(_zero_if_differentiated(along, outside))
    coefficients = [number_of_leaf(tables, leaf, which, count) for which in range(tables.dim, count)]
    return jnp.where(outside, answer, _polynomial(_POWERS[order], coefficients, t))


@jax.custom_jvp
def _zero_if_differentiated(t: Float[Array, "*batch"], outside: Bool[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The coordinates, but zero outside the domain where differentiated: zero times a gradient at inf is NaN."""
    return t


@_zero_if_differentiated.defjvp
def _zero_with_tangent(primals, tangents):
    t, outside = primals
    return (jnp.where(outside, jnp.zeros_like(t), t), jnp.where(outside, jnp.zeros_like(t), tangents[0]))


def _coordinate_in_cell(u: Float[Array, "*batch"], number: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Coordinate, from 0 to 1, in the interval of that number, of a point at ``u`` of the domain.

    Where the lookup rounds a point across a border, the coordinate is beyond 0 or 1 by as much. Products and the
    difference are exact, so both leaves at a face see the same point.
    """
    exponent = jax.lax.bitcast_convert_type(number, jnp.uint32) & _EXPONENT
    count = jax.lax.bitcast_convert_type(exponent, jnp.float32)
    return u * count.astype(u.dtype) - (number - count).astype(u.dtype)


def _polynomial(
    powers: int, coefficients: list[Float[Array, "*batch"]], t: list[Float[Array, "*batch"]]
) -> Float[Array, "*batch"]:
    """Horner's rule along the first coordinate, whose coefficients are polynomials of the others."""
    if not t:
        return coefficients[0]
    stride = len(coefficients) // powers
    parts = [coefficients[power * stride : (power + 1) * stride] for power in range(powers)]
    terms = [_polynomial(powers, part, t[1:]) for part in parts]
    total = terms[-1].astype(t[0].dtype)
    for term in reversed(terms[:-1]):
        total = total * t[0] + term
    return total
