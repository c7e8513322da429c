"""Motions through a space that only tests configurations, such as by a collision checker of one's own."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int8

from plr_jax._arrays import parts
from plr_jax.spaces import CellState, CheckedSpace

_TESTS_AT_ONCE = 1 << 18
_MOST_TESTS = 1 << 18  # of one motion


@dataclass(frozen=True, eq=False)
class MotionTests(CheckedSpace):
    """A space that only tests configurations, whose motions are free if they are wherever they are tested."""

    resolution: float

    def classify(self, lo: Float[np.ndarray, "n dof"], hi: Float[np.ndarray, "n dof"]) -> Int8[np.ndarray, "n"]:
        return np.full(len(lo), CellState.MIXED, np.int8)

    def are_free(self, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, "n"]:
        change, lengths = self.domain.difference(q1, q0), self.motion_cost.lengths(q0, q1, self.domain)
        if (lengths > _MOST_TESTS * self.resolution).any():
            raise ValueError(
                f"resolution={self.resolution:g} asks for more than {_MOST_TESTS:,} tests of one motion, which costs "
                f"{lengths.max():g}: give a larger one."
            )
        # First at both ends, then between any two tests, and so on: what is blocked is mostly found early.
        free, halvings = self.is_free(q0) & self.is_free(q1), 0
        while len(rows := np.flatnonzero(free & (lengths > self.resolution * 2**halvings))):
            share = (np.arange(2**halvings) + 0.5) / 2**halvings
            for part in parts(np.full(len(rows), len(share)), _TESTS_AT_ONCE):
                motion = rows[part]
                q = self.domain.wrapped(q0[motion, None] + share[:, None] * change[motion, None])
                free[motion] = self.is_free(q.reshape(-1, q.shape[2])).reshape(q.shape[:2]).all(axis=1)
            halvings += 1
        return free
