"""The compiled queries of tables, of one PLR or of a team's, and the points that they are given."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import as_queries, padded_size
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr.frame import Outside
from plr_jax.plr.query import bounds_of_tables, evaluate_tables, lookup, waypoints_in_tables
from plr_jax.plr.tables import Tables

find_leaves = jax.jit(lookup)
"""The leaf of each point, as its index."""


@jax.jit
def evaluate_points(tables: Tables, x: Array) -> Float[Array, "*batch"]:
    """Checks and answers points; what is checked depends on shape and type alone, so it is checked once for each."""
    _check_points(tables, x)
    return evaluate_tables(tables, x)


@partial(jax.jit, static_argnames="outside")  # which would add a tenth to what a call of the other takes
def evaluate_points_anywhere(tables: Tables, x: Array, outside: Outside) -> Float[Array, "*batch"]:
    """The same with another answer outside the domain."""
    _check_points(tables, x)
    return evaluate_tables(tables, x, outside)


@jax.jit
def bound_points(band: Float[Array, "2 rows"], tables: Tables, x: Array) -> tuple[Float[Array, "*batch"], ...]:
    """Checks points and gives bounds."""
    _check_points(tables, x)
    return bounds_of_tables(tables, band, x)


@jax.jit
def waypoints_of_points(tables: Tables, x: Array) -> Float[Array, "*batch dim"]:
    """Checks points and gives sources."""
    _check_points(tables, x)
    return waypoints_in_tables(tables, x)


def as_array(x: ArrayLike) -> np.ndarray:
    """Points on the host. Integers become floats here, where they cannot wrap around, and masked numbers NaN."""
    x = as_queries(x)
    if x.dtype in (np.float32, np.float64):
        return x
    if x.dtype.kind in "iub" or (x.dtype.kind == "f" and x.dtype.itemsize > np.dtype(np.float64).itemsize):
        return x.astype(np.float64)
    _require_real(x)  # which JAX cannot even be shown
    return x


def _check_points(tables: Tables, x: Array) -> None:
    if x.ndim == 0 or x.shape[-1] != tables.dim:
        raise ValueError(f"Points must have shape (..., {tables.dim}), got {x.shape}.")
    _require_real(x)


def _require_real(x: Array | np.ndarray) -> None:
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise ValueError(f"Points must be real numbers, got an array of {x.dtype}.")


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """Placing points on the host: around periodic axes, and from a corner far from the origin.

    Attributes:
        domain: The domain, if it has a periodic axis; else None.
        corner: The corner from which the tables count coordinates; None for the origin.
    """

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The points as the tables want them."""
        if self.domain is not None:
            x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner


# A team's PLRs as one function: a whole batch of joint configurations in a few compiled calls.


# The sizes of batch that are compiled. Where a call costs more than its work, few of them waste little; a few points
# are worth their own, as JAX then computes at once instead of handing the work to another thread.
_SIZES = (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384, 32768)
_CHUNK = _SIZES[-1]  # of larger batches, chunks in flight overlap with the copies between NumPy and JAX


@dataclass(frozen=True, eq=False)
class TableStack:
    """The tables of several PLRs, one a robot, and how some want their points placed before they are rounded.

    See :meth:`PLR.stack`. Where there is a band, the lower bound is meant.
    """

    tables: tuple[Tables, ...]
    bands: tuple[Float[Array, "2 _"] | None, ...]
    placements: tuple[PointPlacement | None, ...]

    def __call__(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots"]:
        """Distance of every robot in every joint configuration, of which a PLR sees its leading coordinates."""
        shape = q.shape
        if len(shape) != 3 or shape[1] != len(self.tables):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.tables)}, dof), got {shape}.")
        for i, table in enumerate(self.tables):
            if table.dim > shape[2]:
                raise ValueError(f"The PLR of robot {i} has {table.dim} dimensions, got {shape[2]}.")
        distances = np.empty(q.shape[1::-1])
        starts = range(0, len(q), _CHUNK)
        # All calls are under way before the first result is waited for.
        answers = [_evaluate(self.tables, self.bands, self._padded(q[begin : begin + _CHUNK])) for begin in starts]
        for begin, answer in zip(starts, answers, strict=True):
            columns = distances[:, begin : begin + _CHUNK]
            for column, of_robot in zip(columns, answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]
        return distances.T

    def _padded(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "size robots dof"]:
        """The batch in the precision of JAX's floats, filled up to one of the compiled sizes."""
        size = padded_size(len(q), _SIZES)
        padded = np.empty((size, *q.shape[1:]), jax.dtypes.canonicalize_dtype(np.float64))
        padded[: len(q)], padded[len(q) :] = q, 0
        for i, (table, placement) in enumerate(zip(self.tables, self.placements, strict=True)):
            if placement is not None:
                padded[: len(q), i, : table.dim] = placement(q[:, i, : table.dim])
        return padded


@jax.jit
def _evaluate(
    tables: tuple[Tables, ...], bands: tuple[Float[Array, "2 _"] | None, ...], q: Float[Array, "n robots dof"]
) -> tuple[Float[Array, "n"], ...]:
    """Distances robot by robot: side by side in one array, they would be computed in one slower loop."""
    parts = [q[:, i, : table.dim] for i, table in enumerate(tables)]
    return tuple(
        evaluate_tables(table, part) if band is None else bounds_of_tables(table, band, part)[0]
        for table, band, part in zip(tables, bands, parts, strict=True)
    )
