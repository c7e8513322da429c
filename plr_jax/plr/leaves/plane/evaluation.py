"""The value of a leaf's plane, in JAX."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.lookup import number_of_leaf
from plr_jax.plr.query.tables import Frame, Tables, table_corners


def heights_and_slopes(
    domain: Box, cells: Cells, planes: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves terms"]:
    """What a query reads of every leaf: its plane's value at the domain's rounded lower corner, and its slopes."""
    lo, hi = cells.boxes(domain)
    slope = planes[:, 1:] * 2 / (hi - lo)
    to_center = (lo + hi) / 2 - table_corners(domain)[0]
    return np.column_stack([planes[:, 0] - np.sum(slope * to_center, axis=1), slope])


def evaluate_plane(
    tables: Tables, leaf: UInt32[Array, "*batch"], x: Float[Array, "*batch dim"]
) -> Float[Array, "*batch"]:
    """Value of each point's plane."""
    corner, terms = tables.frame[Frame.LO].astype(x.dtype), 1 + tables.dim
    value = number_of_leaf(tables, leaf, 0, terms).astype(x.dtype)
    for axis in range(tables.dim):
        value += number_of_leaf(tables, leaf, 1 + axis, terms).astype(x.dtype) * (x[..., axis] - corner[axis])
    return jnp.asarray(value)
