"""Evaluation of several PLRs, one for each robot of a team, compiled as one function."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import padded, padded_size, slices
from plr_jax.plr.query import bounds_of_tables, evaluate_tables
from plr_jax.plr.tables import Tables

Bands = tuple[Float[Array, "2 _"] | None, ...]
# Compiled batch sizes. Padding is cheap while a call's overhead dominates; tiny sizes avoid a thread switch in JAX.
_SIZES = (1, 4, 16, 64, 256, 1024, 2048, 4096, 8192, 16384, 32768)
_CHUNK = _SIZES[-1]  # larger batches are split, so that computation overlaps with copies between NumPy and JAX


@dataclass(frozen=True, eq=False)
class TableStack:
    """A function that evaluates one PLR per robot: it maps joint configurations to distances, or to lower bounds."""

    plrs: tuple[Any, ...]  # a PLR for each robot
    bands: Bands  # arguments of :func:`bounds_of_tables` for a robot's lower bound; None for its distance

    def __call__(self, q: Float[np.ndarray, "n robots dof"]) -> Float[np.ndarray, "n robots"]:
        """Return each robot's distance (or lower bound) at the joint configurations ``q``.

        The PLR of a robot is evaluated at as many leading coordinates of the robot's configuration as the PLR has
        dimensions.
        """
        if q.ndim != 3 or q.shape[1] != len(self.plrs):
            raise ValueError(f"Joint configurations must have shape (n, {len(self.plrs)}, dof), got {q.shape}.")
        for i, plr in enumerate(self.plrs):
            if plr.dim > q.shape[2]:
                need = f"The PLR of robot {i} needs {plr.dim} coordinates"
                raise ValueError(f"{need}, got configurations of {q.shape[2]}.")
        distances = np.empty(q.shape[1::-1])  # a row for each robot
        # Dispatch all calls before waiting for the first result.
        answers = [(part, self._answer(q[part])) for part in slices(len(q), _CHUNK)]
        for part, answer in answers:
            for column, of_robot in zip(distances[:, part], answer, strict=True):
                column[:] = np.asarray(of_robot)[: len(column)]  # without padding
        return distances.T

    def _answer(self, q: Float[np.ndarray, "n robots dof"]) -> tuple[Array, ...]:
        """Return an array of distances (or lower bounds) for each robot, with one entry per joint configuration.

        ``q`` is first padded by zeros up to one of few batch sizes, so that few sizes are compiled. The arrays have
        this padded length.
        """
        q = padded(q.astype(np.float64, copy=False), padded_size(len(q), _SIZES))
        pairs = [plr.tables_and_points(q[:, i, : plr.dim]) for i, plr in enumerate(self.plrs)]
        dtype = jax.dtypes.canonicalize_dtype(np.float64)
        tables, points = zip(*pairs, strict=True)
        return _evaluate(tables, self.bands, tuple(x.astype(dtype) for x in points))


@jax.jit
def _evaluate(tables: tuple[Tables, ...], bands: Bands, points: tuple[Float[Array, "n _"], ...]) -> tuple[Array, ...]:
    def of_robot(of_plr: Tables, band: Float[Array, "2 _"] | None, x: Float[Array, "n _"]) -> Array:
        return evaluate_tables(of_plr, x) if band is None else bounds_of_tables(of_plr, band, x)[0]

    # One array for each robot, since XLA would compute a single array in one slower loop.
    return tuple(map(of_robot, tables, bands, points))
