"""A team's PLRs as one function: a whole batch of joint configurations in a few compiled calls."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import padded_size
from plr_jax.plr.query.lookup import bounds_of_tables, evaluate_tables
from plr_jax.plr.query.points import PointPlacement
from plr_jax.plr.query.tables import Tables

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
        self._require_fit(q.shape)
        distances = np.empty(q.shape[1::-1])
        starts = range(0, len(q), _CHUNK)
        # All calls are under way before the first result is waited for.
        answers = [_evaluate(self.tables, self.bands, self._padded(q[begin : begin + _CHUNK])) for begin in starts]
        for begin, answer in zip(starts, answers, strict=True):
            columns = distances[:, begin : begin + _CHUNK]
            for column, of_robot in zip(columns, answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]
        return distances.T

    def _require_fit(self, shape: tuple[int, ...]) -> None:
        if len(shape) != 3 or shape[1] != len(self.tables):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.tables)}, dof), got {shape}.")
        for i, table in enumerate(self.tables):
            if table.dim > shape[2]:
                raise ValueError(f"The PLR of robot {i} has {table.dim} dimensions, got {shape[2]}.")

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
