"""Collision of a whole team along simultaneous straight motions: with the workspace, and of each two robots."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.collision.pairs import motions_apart
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class JointMotionTest:
    """Whether straight joint motions of a team are free: of obstacles, and of collisions between robots."""

    workspace: Workspace
    robots: Sequence[Robot]

    @cached_property
    def of_walls(self) -> tuple[MotionTest, ...]:
        """Each robot's own motion test."""
        return tuple(motion_test(self.workspace, robot) for robot in self.robots)

    def __call__(
        self, q0: Float[np.ndarray, "n robots dof"], q1: Float[np.ndarray, "n robots dof"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether joint motions from ``q0`` to ``q1`` keep all robots clear of walls and of one another."""
        left = np.arange(len(q0))
        for i, test in enumerate(self.of_walls):
            left = left[test(q0[left, i], q1[left, i])]
        for i, j in combinations(range(len(self.robots)), 2):
            left = left[self.apart(i, q0[left, i], q1[left, i], j, q0[left, j], q1[left, j])]
        free = np.zeros(len(q0), dtype=bool)
        free[left] = True
        return free

    def apart(
        self,
        i: int,
        a0: Float[np.ndarray, "*#batch dof_a"],
        a1: Float[np.ndarray, "*#batch dof_a"],
        j: int,
        b0: Float[np.ndarray, "*#batch dof_b"],
        b1: Float[np.ndarray, "*#batch dof_b"],
    ) -> Bool[np.ndarray, "*batch"]:
        """Whether robots ``i`` and ``j`` keep clear of one another, as :func:`motions_apart` says."""
        return motions_apart(self.robots[i], a0, a1, self.robots[j], b0, b1, self.workspace.tolerance)

    def apart_from_others(
        self,
        i: int,
        q0: Float[np.ndarray, "*#batch dof"],
        q1: Float[np.ndarray, "*#batch dof"],
        path: Float[np.ndarray, "steps robots dof"],
        motion: Int[np.ndarray, "*#batch"],
        but: Sequence[int] = (),
    ) -> Bool[np.ndarray, "*batch"]:
        """Whether motions of robot ``i`` keep clear of the others but some, each of which makes a motion of its path.

        Meanwhile they go from row ``motion`` of the path, of joint configurations, to the next.
        """
        apart = np.ones(np.broadcast_shapes(q0.shape[:-1], q1.shape[:-1], motion.shape), dtype=bool)
        for j in set(range(len(self.robots))) - {i, *but}:
            apart &= self.apart(i, q0, q1, j, path[motion, j], path[motion + 1, j])
        return apart
