"""Cells of a grid as bits of words."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int32, UInt32

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


def marked(shape: Shape, row: Int32[Array, ""], column: Int32[Array, ""]) -> Words:
    """The bits of a grid of which one cell alone is set."""
    rows, words = jnp.indices((shape[0], -(-shape[1] // WORD)), dtype=jnp.int32)
    bit = jnp.uint32(1) << (column % WORD).astype(jnp.uint32)
    return jnp.where((rows == row) & (words == column // WORD), bit, jnp.uint32(0))


def beside(words: UInt32[Array, "h words *batch"]) -> UInt32[Array, "h words *batch"]:
    """The neighbors of cells, in their row and in the rows above and below."""
    in_row = (words << 1) | (words >> 1)
    if words.shape[1] > 1:
        none = jnp.zeros_like(words[:, :1])
        in_row |= jnp.concatenate([none, words[:, :-1] >> (WORD - 1)], axis=1)
        in_row |= jnp.concatenate([words[:, 1:] << (WORD - 1), none], axis=1)
    none = jnp.zeros_like(words[:1])
    return in_row | jnp.concatenate([words[1:], none]) | jnp.concatenate([none, words[:-1]])
