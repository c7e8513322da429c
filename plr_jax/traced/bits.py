"""Cells of a grid as bits of words."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, UInt32

Mask = Bool[Array, "h w"]
Words = UInt32[Array, "h words"]
Shape = tuple[int, ...]

WORD = 32
"""Bits of a word."""
_PLACES = np.arange(WORD, dtype=np.uint32)[None, None]


def packed(cells: Mask) -> Words:
    """Rows of cells as bits, the first column the lowest bit of the first word."""
    h, w = cells.shape
    bits = jnp.pad(cells, ((0, 0), (0, -w % WORD))).reshape(h, -1, WORD)
    return (bits.astype(jnp.uint32) << _PLACES).sum(axis=2, dtype=jnp.uint32)


def unpacked(words: Words, w: int) -> UInt32[Array, "h w"]:
    """The bits of ``w`` columns, each 0 or 1."""
    bits = (words[:, :, None] >> _PLACES) & jnp.uint32(1)
    return bits.reshape(len(words), -1)[:, :w]


def beside(words: Words) -> Words:
    """The neighbors of cells, in their row and in the rows above and below."""
    in_row = (words << 1) | (words >> 1)
    if words.shape[1] > 1:
        carry, borrow = words[:, :-1] >> (WORD - 1), words[:, 1:] << (WORD - 1)
        in_row |= jnp.pad(carry, ((0, 0), (1, 0))) | jnp.pad(borrow, ((0, 0), (0, 1)))
    return in_row | jnp.pad(words[1:], ((0, 1), (0, 0))) | jnp.pad(words[:-1], ((1, 0), (0, 0)))
