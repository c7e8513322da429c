"""The value of a leaf's polynomial, in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from plr_jax.plr.leaves.continuous.basis import POWERS, monomials
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.frame import Frame
from plr_jax.plr.query.lookup import number_of_leaf, zero_if_differentiated
from plr_jax.plr.query.tables import Tables

_EXPONENT = np.uint32(0xFF800000)  # and sign, of a 32-bit float


def numbers_of_polynomials(
    order: int, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves count"]:
    """What a query reads of every leaf: the numbers of its cell, and coefficients by powers of the place in it.

    Along each axis the number 1 is the domain, and the halves of ``i`` are ``2 i`` and ``2 i + 1``. The exponent of
    such a number, as a 32-bit float, says how many such intervals span the domain.
    """
    is_inf = np.isinf(coefficients[:, 0])
    powers = np.where(is_inf[:, None], 0.0, coefficients) @ monomials(order, cells.dim)
    powers[is_inf, 0] = np.inf
    return np.concatenate([np.ldexp(1.0, cells.depth) + cells.position, powers], axis=1)


def evaluate_polynomial(
    order: int,
    tables: Tables,
    leaf: UInt32[Array, "*batch"],
    x: Float[Array, "*batch dim"],
    outside: Bool[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """Value of each point's polynomial."""
    frame, t = tables.frame.astype(x.dtype), []
    count = tables.dim + POWERS[order] ** tables.dim
    for axis in range(tables.dim):
        u = (x[..., axis] - frame[Frame.LO, axis]) * frame[Frame.SCALE, axis] + (frame[Frame.START, axis] - 1)
        along = _coordinate_in_cell(u, number_of_leaf(tables, leaf, axis, count))
        t.append(zero_if_differentiated(along, outside))
    coefficients = [number_of_leaf(tables, leaf, which, count) for which in range(tables.dim, count)]
    return jnp.asarray(_polynomial(POWERS[order], coefficients, t))


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
