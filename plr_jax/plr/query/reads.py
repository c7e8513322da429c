"""Reads of tables in JAX, also of many PLRs one behind the other, and arithmetic that no compiler fuses."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer, UInt32

from plr_jax.plr.query.grid import WORD_BITS


@dataclass(frozen=True, eq=False)
class Picked:
    """An array that differs from point to point: as it were one of several, which one ``start`` says.

    It is indexed as an array is, up to numbers, of which there is one a point.

    Attributes:
        flat: The several arrays, one behind the other.
        shape: Of one of them.
        start: Where in ``flat`` each point's begins.
        dtype: The type of numbers that are read.
    """

    flat: Array
    shape: tuple[int, ...]
    start: UInt32[Array, "*batch"]
    dtype: Any

    @property
    def ndim(self) -> int:
        """Number of axes of one of them."""
        return len(self.shape)

    def astype(self, dtype: Any) -> "Picked":
        """The same, of numbers of another type."""
        return replace(self, dtype=dtype)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self.shape[0]))

    def __getitem__(self, key: Any) -> Any:
        first, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(first, slice):
            return jnp.stack([self[(i, *rest)] for i in range(*first.indices(self.shape[0]))])
        size = prod(self.shape[1:])
        inner = replace(self, shape=self.shape[1:], start=self.start + np.uint32(int(first) * size))
        if rest:
            return inner[tuple(rest)]
        return inner if inner.shape else inner.read(np.uint32(0))

    def read(self, index: Any) -> Array:
        """The number at an index of each point's array, which has one axis or none."""
        return self.flat.at[self.start + index].get(mode="promise_in_bounds").astype(self.dtype)


def gather(table: Integer[Array, "n"] | Float[Array, "n"] | Picked, index: UInt32[Array, "*batch"]):
    """Entries of a table at indices that it has."""
    if isinstance(table, Picked):
        return table.read(index)
    return table.at[index].get(mode="promise_in_bounds")


def shift_right(x: UInt32[Array, "*batch"], by: UInt32[Array, "*#batch"]) -> UInt32[Array, "*batch"]:
    """Shift by less than 32 bits, which the mask tells the compiler: it then need not provide for more."""
    return x >> (by & np.uint32(WORD_BITS - 1))


@jax.custom_jvp
def rounded(value: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """A product or sum that no compiler combines with what follows: none knows that the condition changes nothing."""
    return jnp.where(value == value, value, jnp.nan)


@rounded.defjvp
def _rounded_with_tangent(primals, tangents):
    return rounded(primals[0]), tangents[0]
