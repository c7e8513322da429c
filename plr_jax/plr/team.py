"""Evaluation of one PLR for each robot of a team, compiled as one function."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import Float

from plr_jax._arrays import padded_size
from plr_jax.geometry.box import Box
from plr_jax.plr.query import bounds_of_tables, evaluate_tables
from plr_jax.plr.small_batches import SmallBatches
from plr_jax.plr.tables import AnyArray, Tables


@dataclass(frozen=True, eq=False)
class PointPlacement:
    """A function that wraps 64-bit points around periodic axes, then makes them relative to ``corner``."""

    domain: Box
    corner: Float[np.ndarray, " dim"] | None  # lower corner of a domain far from the origin; None: no change

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner


Bands = tuple[Float[AnyArray, "2 _"] | None, ...]
# Compiled batch sizes. Padding is cheap while a call's overhead dominates; tiny sizes avoid a thread switch in JAX.
_SIZES = (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384, 32768)
_CHUNK = _SIZES[-1]  # larger batches are split, so that computation overlaps with copies between NumPy and JAX


@dataclass(frozen=True, eq=False)
class TableStack:
    """A function that maps joint configurations to each robot's distance, or a lower bound of it, by its PLR."""

    tables: tuple[Tables, ...]
    bands: Bands  # arguments of :func:`bounds_of_tables` for a robot's lower bound; None for its distance
    placements: tuple[PointPlacement | None, ...]
    small_batches: SmallBatches = field(default_factory=SmallBatches)

    def __call__(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots"]:
        """Return each robot's distance; its PLR sees the leading coordinates of the robot's configuration."""
        shape = q.shape
        if len(shape) != 3 or shape[1] != len(self.tables):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.tables)}, dof), got {shape}.")
        for i, table in enumerate(self.tables):
            if table.dim > shape[2]:
                need = f"The PLR of robot {i} needs {table.dim} coordinates"
                raise ValueError(f"{need}, got configurations of {shape[2]}.")
        distances = np.empty(q.shape[1::-1])
        starts = range(0, len(q), _CHUNK)
        # Dispatch all calls before waiting for the first result.
        answers = [
            self.small_batches(_evaluate, (self.tables, self.bands), self._padded(q[begin : begin + _CHUNK]))
            for begin in starts
        ]
        for begin, answer in zip(starts, answers, strict=True):
            columns = distances[:, begin : begin + _CHUNK]
            for column, of_robot in zip(columns, answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]
        return distances.T

    def _padded(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "size robots dof"]:
        """Return joint configurations in the precision of JAX, with rows of zeros up to one of few batch sizes."""
        size = padded_size(len(q), _SIZES)
        padded = np.empty((size, *q.shape[1:]), jax.dtypes.canonicalize_dtype(np.float64))
        padded[: len(q)], padded[len(q) :] = q, 0
        for i, (table, placement) in enumerate(zip(self.tables, self.placements, strict=True)):
            if placement is not None:
                padded[: len(q), i, : table.dim] = placement(q[:, i, : table.dim])
        return padded


@jax.jit
def _evaluate(
    tables: tuple[Tables, ...], bands: Bands, q: Float[AnyArray, "n robots dof"]
) -> tuple[Float[AnyArray, " n"], ...]:
    # One array for each robot, since XLA would compute a single array in one slower loop.
    parts = [q[:, i, : table.dim] for i, table in enumerate(tables)]
    return tuple(
        evaluate_tables(table, part) if band is None else bounds_of_tables(table, band, part)[0]
        for table, band, part in zip(tables, bands, parts, strict=True)
    )
