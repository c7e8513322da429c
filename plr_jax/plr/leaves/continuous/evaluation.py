"""Leaves as polynomials of the place in their cells."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import product_in_order
from plr_jax.plr.leaves.continuous.basis import monomials
from plr_jax.plr.partition.cells import Cells


def numbers_of_polynomials(
    order: int, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves count"]:
    """What a query reads of every leaf: the numbers of its cell, and coefficients by powers of the place in it.

    Along each axis the number 1 is the domain, and the halves of ``i`` are ``2 i`` and ``2 i + 1``. The exponent of
    such a number, as a 32-bit float, says how many such intervals span the domain.
    """
    is_inf = np.isinf(coefficients[:, 0])
    powers = product_in_order(np.where(is_inf[:, None], 0.0, coefficients), monomials(order, cells.dim))
    powers[is_inf, 0] = np.inf
    return np.concatenate([np.ldexp(1.0, cells.depth) + cells.position, powers], axis=1)


def polynomial(powers: int, coefficients: Sequence[Any], t: Sequence[Any]) -> Any:
    """Horner's rule along the first coordinate, whose coefficients are polynomials of the others."""
    if not t:
        return coefficients[0]
    stride = len(coefficients) // powers
    parts = [coefficients[power * stride : (power + 1) * stride] for power in range(powers)]
    total, *others = (polynomial(powers, part, t[1:]) for part in reversed(parts))
    for term in others:
        total = total * t[0] + term
    return total
