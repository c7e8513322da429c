"""Boxes classified by samples: all that can be said where configurations alone can be tested."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax._types import ArrayLike
from plr_jax.plr.sampling.cell_fit import sample_pattern
from plr_jax.spaces import CellState, CheckedSpace

_NUM_SAMPLES = 8  # of a box, beside the corners and the center
_NUM_OF_MOTION = 33


@dataclass(frozen=True, eq=False)
class SampledSpace(CheckedSpace):
    """A configuration space whose boxes are what all their samples are; nothing of it is proven."""

    seed: int

    @cached_property
    def _samples(self) -> Float[np.ndarray, "k dim"]:
        return (1 + sample_pattern(self.domain.dim, _NUM_SAMPLES, 0.0, self.seed).u) / 2

    def classify(self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"]) -> Int8[np.ndarray, "n"]:
        """Free or blocked if all samples are, else mixed."""
        x = lo[:, None] + (hi - lo)[:, None] * self._samples
        free = self.is_free(x.reshape(-1, x.shape[2])).reshape(x.shape[:2])
        state = np.where(free.any(axis=1), CellState.MIXED, CellState.BLOCKED)
        return np.where(free.all(axis=1), CellState.FREE, state).astype(np.int8)

    def are_free(self, q0: ArrayLike, q1: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether all samples of straight motions are."""
        q0, q1 = np.asarray(q0, np.float64), np.asarray(q1, np.float64)
        x = q0[:, None] + self.domain.difference(q1, q0)[:, None] * np.linspace(0, 1, _NUM_OF_MOTION)[:, None]
        free = self.is_free(x.reshape(-1, self.domain.dim)).reshape(x.shape[:2])
        return np.asarray(free.all(axis=1))
